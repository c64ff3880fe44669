"""Labels and training with a vehicle file that a diagnosis corrected: sensors' faults taken off, places told."""

import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.train import command as train_command
from split_cli.errors import DriveError
from split_cli.learning.features import FeatureSet
from split_cli.learning.label_file import read_labels
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import Drive, write_drive
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.parameters import EffectSpec, write_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.label import label_drive
from split_cli.workflows.recordings import RecordingCorrection
from tests.factories import one_run, road_car

CAR = road_car()
PATCH = EffectSpec("friction_patch", {"scale": 0.7, "s_start": 150.0, "s_end": 400.0})
LEVER = EffectSpec("sensor_lever_arm", {"dx": 0.5})
PERIOD = 0.01


@pytest.fixture(scope="module")
def recorded() -> Drive:
    """30 s of a slalom over a slippery stretch, recorded by a velocity sensor half a metre ahead of its place."""
    model = SingleTrack(CAR.with_effects(PATCH))
    count = 3001
    t = PERIOD * np.arange(count)
    steer, torque = 0.035 * np.sin(2.0 * t) + 0.01 * np.sin(7.0 * t), 150.0 + 300.0 * np.sin(0.9 * t)
    state, place = np.array([[0.0, 0.0, 0.2, 18.0, 0.0, 0.0]]), 0.0
    path = [state[0]]
    for k in range(count - 1):
        span = slice(k, k + 2)
        speed = float(np.hypot(state[0, 3], state[0, 4]))
        state, _ = integrate_with_memory(
            model, state, torque[None, span], steer[None, span], PERIOD, 2, Situation(t[k], place)
        )
        place += 0.5 * PERIOD * (speed + float(np.hypot(state[0, 3], state[0, 4])))
        path.append(state[0])
    columns = dict(zip(("X", "Y", "yaw", "vx", "vy", "r"), np.array(path).T, strict=True))
    columns |= {"t": t, "T": torque, "delta": steer}
    assert place > 420.0
    sensor = CATALOGUE["sensor_lever_arm"](dict(LEVER.parameters))
    columns = sensor.corrupt(columns, Recording.single(PERIOD, count))
    return one_run(columns, PERIOD, "real.parquet")


def residual(drive: Drive, vehicle, folder) -> tuple[np.ndarray, np.ndarray, tuple[str, ...]]:
    """Return y and t of accepted labels as `split label` writes them, and its notes."""
    write_vehicle(vehicle, folder / "vehicle.yaml")
    write_drive(drive, folder / "real.parquet")
    result = label_drive(folder / "real.parquet", folder / "vehicle.yaml", folder / "labels.parquet")
    labels = read_labels(folder / "labels.parquet")
    return labels.y[labels.accepted], labels.t[labels.accepted], result.notes


def test_a_corrected_vehicle_leaves_no_residual_of_a_slippery_stretch_seen_by_a_displaced_sensor(recorded, tmp_path):
    known, t, notes = residual(recorded, CAR.with_effects(PATCH, LEVER), tmp_path)
    assert any("counts along real.parquet" in note for note in notes)
    assert len(t) > 300
    # One window at either edge of the stretch straddles it by the few centimetres that |v| and v_x differ.
    assert np.quantile(np.abs(known), 0.98, axis=0).max() < 1e-2
    for partly in (CAR.with_effects(PATCH), CAR.with_effects(LEVER)):
        assert np.quantile(np.abs(residual(recorded, partly, tmp_path)[0]), 0.9, axis=0).max() > 0.1


def test_without_a_position_the_place_is_the_distance_driven(recorded, tmp_path):
    columns = {name: values for name, values in recorded.columns.items() if name not in ("X", "Y")}
    known, _, notes = residual(replace(recorded, columns=columns), CAR.with_effects(PATCH, LEVER), tmp_path)
    assert any("no position" in note for note in notes)
    # The displaced sensor sees a little more speed: a metre in 500, 60 ms at the edges.
    assert np.quantile(np.abs(known), 0.95, axis=0).max() < 1e-2


def test_a_drive_that_tells_its_places_is_believed(recorded, tmp_path):
    elsewhere = replace(recorded, columns={**recorded.columns, "s": np.full(len(recorded), 1000.0)})
    lever = CAR.with_effects(LEVER)
    told = residual(elsewhere, lever.with_effects(PATCH), tmp_path)[0]
    # A kilometre away the stretch does not matter.
    assert np.array_equal(told, residual(elsewhere, lever, tmp_path)[0])


def test_training_reads_drives_as_labels_do(recorded, tmp_path):
    write_vehicle(CAR.with_effects(PATCH, LEVER), tmp_path / "vehicle.yaml")
    write_drive(recorded, tmp_path / "real.parquet")
    arguments = ["real.parquet", "--vehicle", "vehicle.yaml", "--hyperparameters", "default", "-o", "car.split"]
    arguments = [str(tmp_path / a) if "." in a else a for a in arguments]
    done = CliRunner().invoke(train_command, [*arguments, "--json"], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    assert any("counts along" in note for note in json.loads(done.stdout)["notes"])
    learned = np.abs(read_set(tmp_path / "car.split").y)
    assert len(learned) > 100 and np.quantile(learned, 0.95, axis=0).max() < 1e-2


def test_a_vehicle_without_such_effects_takes_recordings_as_they_are(recorded):
    correct = RecordingCorrection(CAR.with_effects(EffectSpec("steer_lag", {"tau": 0.1})))
    assert correct(recorded).columns == recorded.columns and correct.notes == ()


def test_the_first_drive_is_known_again(recorded):
    correct = RecordingCorrection(CAR.with_effects(PATCH))
    second = replace(recorded, name="other.parquet", sha256="1")
    first = correct(recorded)["s"]
    correct(second)
    assert np.array_equal(correct(recorded)["s"], first) and len(correct.notes) == 1


def test_a_late_sensor_changes_when_features_are_seen_and_not_what_they_are(recorded):
    """Twenty samples later everything measured is seen, with the commands that belong to it."""
    delay = EffectSpec("sensor_delay", {"delay": 20 * PERIOD})
    late = CATALOGUE["sensor_delay"](dict(delay.parameters)).corrupt(
        recorded.columns, Recording.single(PERIOD, len(recorded))
    )
    features = FeatureSet(("alpha_f", "alpha_r", "torque_ratio", "delta", "vx"))
    seen = features.compute(SingleTrack(CAR.with_effects(delay)), replace(recorded, columns=late))
    there = features.compute(SingleTrack(CAR), recorded)
    assert np.allclose(seen[20:], there[:-20], rtol=0, atol=1e-12)
    assert np.abs(features.compute(SingleTrack(CAR), replace(recorded, columns=late))[20:] - there[:-20]).max() > 0.01


def test_a_state_of_a_term_is_a_feature(recorded):
    """A torque that rises over one sample arrives late, as the closed form of a first-order lag says."""
    tau, top = 0.2, 100
    torque = np.where(np.arange(len(recorded)) < top, 100.0, 500.0)
    risen = replace(recorded, columns=recorded.columns | {"T": torque})
    model = SingleTrack(CAR.with_effects(EffectSpec("drive_lag", {"tau": tau})))
    arrived = FeatureSet(("alpha_f", "drive_lag.torque")).compute(model, risen)[:, 1]
    behind = tau / PERIOD * (1.0 - np.exp(-PERIOD / tau))  # of the step, where the ramp ends
    since = PERIOD * (np.arange(len(recorded)) - top)
    expected = np.where(since < 0, 100.0, 500.0 - 400.0 * behind * np.exp(-since / tau))
    assert arrived == pytest.approx(expected, rel=1e-9)
    with pytest.raises(DriveError, match=r"'steer_lag\.angle' is a state of the term steer_lag, which .* lacks"):
        FeatureSet(("alpha_f", "steer_lag.angle")).compute(model, risen)
