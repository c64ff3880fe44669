"""`split calibrate` run as users run it: its files reopened, its figures compared."""

import json
import shlex
from pathlib import Path

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from split_cli.cli.calibrate import command
from split_cli.cli.main import group
from split_cli.logs.drive import Drive, DriveMetadata, read_drive, write_drive
from split_cli.scoring.splits import hold_out_blocks
from split_cli.vehicle.calibration.calibrate import CalibrationSettings
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.calibrate import calibrate_files
from tests.cli.hostile import refused


def run(*arguments):
    return CliRunner().invoke(command, [str(argument) for argument in arguments], catch_exceptions=False)


@pytest.fixture(scope="module")
def calibrated(sample_logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("calibrated")
    drive = sample_logs / "f1tenth_car_tests.parquet"
    start = sample_logs / "f1tenth_car_start.yaml"
    if not drive.is_file():
        pytest.skip("the sample logs are not here")
    result = run(drive, "--vehicle", start, "-o", folder / "car.yaml", "--figure", folder / "car.png", "--json")
    assert result.exit_code == 0, result.output
    return folder, json.loads(result.stdout)


def test_the_bundled_vehicle_file_is_what_the_documented_command_gives(calibrated, sample_logs):
    folder, _ = calibrated
    ours, bundled = read_vehicle(folder / "car.yaml"), read_vehicle(sample_logs / "f1tenth_car.yaml")
    for key in ("B", "C", "D"):
        for axle in ("front_tire", "rear_tire"):
            # Another NumPy may sum in another order; six digits are written.
            ours_value, bundled_value = (getattr(getattr(car, axle), key) for car in (ours, bundled))
            np.testing.assert_allclose(ours_value, bundled_value, rtol=1e-4)
    assert ours.origins == bundled.origins
    assert ours.drag_coefficient == pytest.approx(bundled.drag_coefficient, rel=1e-3)


def test_the_json_tells_curves_and_held_out_errors(calibrated):
    _, report = calibrated
    assert [curve["axle"] for curve in report["curves"]] == ["front", "rear"]
    for curve in report["curves"]:
        assert curve["held_out"]["calibrated"] < curve["held_out"]["start"] < curve["held_out"]["signal"]
        lower, force, upper = (np.array(curve[key]) for key in ("alike_lower", "force", "alike_upper"))
        covered = np.array(curve["slip_angle"]) <= curve["covered"]
        slack = curve["deviation_covered"]
        assert np.all((lower - slack <= force) & (force <= upper + slack), where=covered)
        # An open upper end of the peak is null, not a number.
        assert curve["peak"][1] is None or curve["peak"][1] > curve["peak"][0]
    assert any("peak is not identified" in remark for remark in report["remarks"])
    assert report["drives"][0]["name"] == "f1tenth_car_tests.parquet"


def test_the_file_names_its_drives_and_what_was_calibrated(calibrated):
    folder, report = calibrated
    text = (folder / "car.yaml").read_text()
    assert report["drives"][0]["sha256"][:16] in text
    car = read_vehicle(folder / "car.yaml")
    assert car.origins["front_tire.B"] == "calibrated"
    assert car.origins["front_tire.D"] == "assumed"
    assert car.origins["mass"] == "published"


def test_each_step_names_the_next_and_assumed_tyres_are_fitted_before_training(sample_logs, tmp_path, monkeypatch):
    """As a newcomer goes, whose vehicle file has the tyres of a template: by the printed lines alone."""
    monkeypatch.chdir(tmp_path)
    log, start = sample_logs / "f1tenth_laps.mcap", sample_logs / "f1tenth_car_start.yaml"
    step = f"split ingest {log} --vehicle {start} --map split_sim --end 40 -o lap.parquet"
    told = []
    for _ in range(2):
        done = CliRunner().invoke(group, shlex.split(step)[1:], catch_exceptions=False)
        told.append(done.stderr.partition("next: ")[2])
        step = told[-1][told[-1].index("split ") :]
    assert told[0].startswith(f"the tyres of {start.name} are assumed, fit them first: split calibrate lap.parquet ")
    made = "lap_calibrated.yaml"
    assert told[1] == f"split train lap.parquet --vehicle {made} -o lap.split\n"
    assert not read_vehicle(made).has_assumed_tires


def test_the_figure_is_a_png(calibrated):
    folder, _ = calibrated
    assert (folder / "car.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


def test_two_runs_give_equal_files(calibrated, sample_logs, tmp_path):
    folder, _ = calibrated
    drive, start = sample_logs / "f1tenth_car_tests.parquet", sample_logs / "f1tenth_car_start.yaml"
    assert run(drive, "--vehicle", start, "-o", tmp_path / "car.yaml").exit_code == 0
    assert (tmp_path / "car.yaml").read_bytes() == (folder / "car.yaml").read_bytes()


def test_tables_go_to_stdout_and_notes_to_stderr(sample_logs, tmp_path):
    result = run(
        sample_logs / "f1tenth_car_tests.parquet",
        "--vehicle",
        sample_logs / "f1tenth_car_start.yaml",
        "-o",
        tmp_path / "car.yaml",
        "--fit",
        "drag,rolling",
    )
    assert result.exit_code == 0
    assert "drag [N/(m/s)^2]" in result.stdout
    assert "note:" in result.stderr
    assert "note:" not in result.stdout
    # What was not asked for is as it was.
    start = read_vehicle(sample_logs / "f1tenth_car_start.yaml")
    assert read_vehicle(tmp_path / "car.yaml").front_tire == start.front_tire


def test_held_out_blocks_do_not_reach_the_calibration(sample_logs, tmp_path):
    # Whatever happens in the blocks that evaluation holds out, the vehicle file is the same.
    drive = read_drive(sample_logs / "f1tenth_car_tests.parquet")
    held_out = hold_out_blocks(drive).test
    spoiled = {name: values.copy() for name, values in drive.columns.items()}
    spoiled["vx"][held_out] += 1.0
    spoiled["vy"][held_out] += 5.0
    write_drive(Drive("spoiled", spoiled, drive.segment, drive.period), tmp_path / "spoiled.parquet")
    found = []
    for name in (sample_logs / "f1tenth_car_tests.parquet", tmp_path / "spoiled.parquet"):
        output = tmp_path / f"{name.stem}.yaml"
        arguments = (name, "--vehicle", sample_logs / "f1tenth_car_start.yaml", "-o", output, "--training-blocks")
        assert run(*arguments, "--fit", "drag,rolling").exit_code == 0
        found.append(read_vehicle(output))
    assert found[0].digest() == found[1].digest()
    assert "without the blocks of time" in (tmp_path / "spoiled.yaml").read_text()


def test_bad_input_is_one_line_and_leaves_the_old_file(sample_logs, tmp_path):
    start = sample_logs / "f1tenth_car_start.yaml"
    old = tmp_path / "car.yaml"
    old.write_text("old")
    drive = sample_logs / "f1tenth_car_tests.parquet"
    cases = [
        ((tmp_path / "none.parquet", "--vehicle", start), "no such file"),
        ((start, "--vehicle", start), "cannot be read as a drive"),
        ((drive, "--vehicle", tmp_path / "none.yaml"), "no such file"),
        ((drive, "--vehicle", start, "--fit", "tyres"), "tires"),
    ]
    for arguments, message in cases:
        refused("calibrate", *arguments, "-o", old, says=(message,), output=old)


def test_only_a_torque_that_was_derived_from_the_motion_cannot_give_resistances(sample_logs, tmp_path):
    drive = read_drive(sample_logs / "f1tenth_car_tests.parquet")
    drive = drive.stretch(0, len(drive) // 2)
    asked = ("--vehicle", sample_logs / "f1tenth_car_start.yaml", "--fit", "drag,rolling")

    def with_torque(kind: str) -> Path:
        path = tmp_path / "d.parquet"
        write_drive(Drive("d", drive.columns, drive.segment, drive.period, DriveMetadata(kinds={"T": kind})), path)
        return path

    derived, output = with_torque("derived: from acceleration"), tmp_path / "refused.yaml"
    refused("calibrate", derived, *asked, "-o", output, says=("--fit tires",), output=output)
    # Asked for nothing in particular, the tyres are fitted and the rest is told.
    whole = run(derived, *asked[:2], "-o", tmp_path / "tires.yaml")
    assert whole.exit_code == 0, whole.output
    assert "note: drag and rolling resistance are not fitted: the torque of d.parquet was derived" in whole.stderr
    assert "split calibrate --fit tires" in (tmp_path / "tires.yaml").read_text()
    # Pedals with an assumed map are a command: what they give is what the same torque gives.
    found = []
    for kind in ("command", "derived: torque from throttle by a map to 3 N m and brake times 4 N m a unit"):
        result = run(with_torque(kind), *asked, "-o", tmp_path / "car.yaml", "--json")
        assert result.exit_code == 0, result.output
        found.append(json.loads(result.stdout)["resistance"])
    assert found[0] == found[1]


def test_beside_a_drive_with_a_torque_the_others_give_what_they_can(sample_logs, tmp_path):
    drive = read_drive(sample_logs / "f1tenth_car_tests.parquet")
    paths = [tmp_path / "commanded.parquet", tmp_path / "derived.parquet"]
    for path, kind in zip(paths, ("command", "derived: from acceleration"), strict=True):
        write_drive(
            Drive(path.name, drive.columns, drive.segment, drive.period, DriveMetadata(kinds={"T": kind})), path
        )
    settings = CalibrationSettings(parts=("drag", "rolling"))
    start = sample_logs / "f1tenth_car_start.yaml"
    alone, both = (calibrate_files(given, start, None, settings)[0] for given in (paths[:1], paths))
    assert both.resistance.drag == alone.resistance.drag and both.resistance.samples == alone.resistance.samples
    assert both.remarks[0].startswith("drag and rolling resistance are fitted without derived.parquet: the torque was")


def test_convert_writes_a_vehicle_and_tells_the_deviation(tmp_path):
    source = tmp_path / "car_model.yaml"
    source.write_text(
        yaml.safe_dump(
            {
                "C_Pf": [4.8, 2.16, 0.65, 0.37],
                "C_Pr": [7.8, 2.9, 0.54, 0.66],
                "I_z": 0.058,
                "l_f": 0.162,
                "l_r": 0.145,
                "m": 3.54,
                "a_max": 3,
            }
        )
    )
    result = run("--convert", source, "-o", tmp_path / "car.yaml", "--json")
    assert result.exit_code == 0
    report = json.loads(result.stdout)
    assert report["kind"] == "ForzaETH"
    assert 0.0 < report["tires"][0]["largest_deviation"] < 1.0
    assert read_vehicle(tmp_path / "car.yaml").mass == 3.54
