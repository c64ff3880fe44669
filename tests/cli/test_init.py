"""`split init`: two files that the next commands take, and what comes next."""

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.init import command
from split_cli.errors import SplitError, VehicleError
from split_cli.logs.signal_map import read_map
from split_cli.vehicle.parameters import read_vehicle


def test_the_drafted_files_are_read_and_every_missing_value_is_named_at_once(tmp_path, sample_logs):
    log = str(sample_logs / "road_small_workshop.csv")
    shown = CliRunner().invoke(command, [log, "-o", str(tmp_path / "car")], catch_exceptions=False)
    # Called as the log: a second log does not overwrite the first.
    assert shown.exit_code == 0 and "Run: split ingest" in shown.output
    assert shown.output.endswith("map.yaml -o road_small_workshop.parquet\n")
    drafted = {entry.channel: entry.sources[0] for entry in read_map(tmp_path / "car" / "map.yaml").channels}
    assert {"vx", "vy", "r", "T", "delta", "X", "Y", "yaw", "ax", "ay"} <= set(drafted)
    assert (drafted["vx"].unit, drafted["r"].unit, drafted["ax"].unit) == ("km/h", "deg/s", "g")
    with pytest.raises(VehicleError) as missing:
        read_vehicle(tmp_path / "car" / "vehicle.yaml")
    for key in ("mass", "yaw_inertia", "cg_to_front_axle", "wheel_radius", "max_torque", "rear_tire.D"):
        assert key in str(missing.value)
    # Filled in as a user would, the file is a vehicle.
    text = (tmp_path / "car" / "vehicle.yaml").read_text()
    for key, value in {
        "mass:": 1500,
        "yaw_inertia:": 2500,
        "cg_to_front_axle:": 1.2,
        "cg_to_rear_axle:": 1.5,
        "wheel_radius:": 0.3,
        "max_torque:": 2000,
        "cg_height:": 0.5,
        "drive_split_front:": 0,
    }.items():
        text = text.replace(f"\n{key} ", f"\n{key} {value} ")
    (tmp_path / "full.yaml").write_text(text.replace("D: }", "D: 7000}"))
    car = read_vehicle(tmp_path / "full.yaml")
    assert car.mass == 1500.0 and car.has_assumed_tires


def test_nothing_is_overwritten(tmp_path, sample_logs):
    (tmp_path / "map.yaml").write_text("mine")
    with pytest.raises(SplitError, match="exists already"):
        CliRunner().invoke(
            command,
            [str(sample_logs / "road_small_workshop.csv"), "-o", str(tmp_path)],
            catch_exceptions=False,
            standalone_mode=False,
        )
    assert (tmp_path / "map.yaml").read_text() == "mine" and not (tmp_path / "vehicle.yaml").exists()


def test_a_preset_that_fits_is_named_in_the_map_and_among_the_steps(tmp_path):
    """Autoware's reports, of which the draft cannot know that the base link is the rear axle."""
    status = "/vehicle/status"
    names = [f"{status}/velocity_status/{one}" for one in ("longitudinal_velocity", "lateral_velocity", "heading_rate")]
    names += [f"{status}/steering_status/steering_tire_angle", "t"]
    rows = "\n".join(",".join(f"{np.sin(0.01 * k + j):.4f}" for j in range(4)) + f",{0.02 * k}" for k in range(200))
    (tmp_path / "lap.csv").write_text(",".join(names) + "\n" + rows)
    done = CliRunner().invoke(command, [str(tmp_path / "lap.csv"), "-o", str(tmp_path / "car")], catch_exceptions=False)
    told = "The preset autoware fits this log: --map autoware can replace this draft."
    assert told in done.output and f"# {told}" in (tmp_path / "car" / "map.yaml").read_text()
