"""`split info` names every kind of file and tells what is in it."""

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SplitError
from split_cli.learning.features import FeatureSet
from split_cli.learning.training_set import write_set
from split_cli.logs.drive import Drive, write_drive
from split_cli.workflows.info import describe_file
from tests.factories import make_training_set


def facts(path) -> dict[str, str]:
    return dict(describe_file(path).facts)


def test_a_trained_set_tells_its_points_and_cells(tmp_path):
    trained = make_training_set(seed=3, points=400)
    path = tmp_path / "car.split"
    write_set(trained, path)
    assert describe_file(path).kind == "trained set"
    told = facts(path)
    assert told["points"].startswith(f"{trained.size} in {trained.cell_count} cells")
    assert trained.vehicle.digest()[:12] in told["vehicle"]
    for name, values in (("cell edges", trained.grid.edges), ("length scales", trained.kernel.length_scales)):
        front, rear, torque = (f"{value:.3g}" for value in values)
        assert told[name].startswith(f"alpha_f [rad] {front}, alpha_r [rad] {rear}, torque_ratio [1] {torque}")
    assert told["threshold"].startswith(f"gain [1] {trained.threshold:g},")


def test_a_feature_has_the_unit_of_its_channel_or_of_its_state():
    """Length scales of a set without units could be degrees."""
    features = FeatureSet(("speed", "steer_rate", "vx", "delta", "drive_lag.torque", "tire_relaxation.rear", "boost"))
    assert features.units == ("m/s", "rad/s", "m/s", "rad", "N m", "N", "")


def test_a_drive_tells_rate_segments_and_channels(tmp_path):
    time = np.arange(100) * 0.02
    columns = {"t": time, **{name: np.full(100, 7.0) for name in ("vx", "vy", "r", "T", "delta")}}
    write_drive(Drive("lap", columns, np.repeat([0, 1], 50).astype(np.int32), 0.02), tmp_path / "lap.parquet")
    told = facts(tmp_path / "lap.parquet")
    assert told["samples"] == "100 at 50 Hz, 2.0 s"
    assert told["segments"] == "2"


def test_a_recording_lists_array_elements_once(tmp_path, sample_logs):
    log = sample_logs / "road_handling_moderate.mcap"
    told = facts(log)
    assert "/imu/orientation_covariance[0..8]" in told
    assert "/imu/orientation_covariance[1]" not in told
    assert "sensor_msgs/msg/Imu" in told["/imu/angular_velocity.z"]


def test_a_vehicle_tells_where_its_values_come_from(sample_logs):
    described = describe_file(sample_logs / "road_car.yaml")
    assert described.kind == "vehicle"
    assert "front_tire.B" in dict(described.facts)["calibrated"]


def test_a_folder_with_a_page_tells_its_verdict_and_main_figures(tmp_path, sample_logs):
    vehicles = [str(sample_logs / name) for name in ("road_car.yaml", "road_car_start.yaml")]
    drive = str(sample_logs / "road_pair_sim.parquet")
    ran = CliRunner().invoke(group, ["compare", *vehicles, "--on", drive, "-o", str(tmp_path / "compared")])
    assert ran.exit_code == 0, ran.output
    described = describe_file(tmp_path / "compared")
    shown = dict(described.facts)
    assert described.kind == "comparison" and shown["verdict"].startswith("road_car.yaml is best")
    assert shown["of"] == "road_pair_sim.parquet" and shown["Models"].startswith("2")
    assert shown["beside it"] == "compare.csv" and shown["to check it"] == f"split verify {tmp_path / 'compared'}"
    assert (
        describe_file(tmp_path / "compared" / "report.html").facts == described.facts[: -len(("page", "csv", "check"))]
    )


def test_a_page_of_another_program_is_named_as_such(tmp_path):
    (tmp_path / "report.html").write_text("<header><b>other</b></header><main><h1 id='verdict'>x</h1></main>")
    with pytest.raises(SplitError, match="did not write"):
        describe_file(tmp_path)


@pytest.mark.parametrize(
    "name, content",
    [
        ("a.html", b"\xff\xfe<"),
        ("a.split", b"ARROW1"),
        ("a.parquet", b"PAR1"),
        ("a.json", b"[1"),
        ("a.yaml", b"a: [1"),
        ("a.mcap", b"\x89MCAP0\r\n"),
    ],
)
def test_a_damaged_file_is_a_clear_error(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content)
    with pytest.raises(SplitError, match=name):
        describe_file(path)
