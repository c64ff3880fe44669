"""Drives that are whole files and yet not what they should be: training says what is wrong with them, and truly."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import DriveError, SetError
from split_cli.logs.drive import write_drive
from split_cli.logs.drive_metadata import DriveMetadata
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import make_drive, road_car

PLAIN = TrainSettings(hyperparameters="default", trust="full")


@pytest.fixture(scope="module")
def sound():
    return replace(make_drive(0, segments=20, seconds=3.0, vehicle=road_car()), metadata=DriveMetadata())


def trained(folder, drive, settings=PLAIN, **columns):
    """Train on a drive with some columns changed."""
    made = {name: np.broadcast_to(values, (len(drive),)).astype(float) for name, values in columns.items()}
    write_drive(replace(drive, columns={**drive.columns, **made}), folder / "d.parquet")
    write_vehicle(road_car(), folder / "car.yaml")
    return train_set([folder / "d.parquet"], folder / "car.yaml", folder / "d.split", settings)


@pytest.mark.parametrize("turned", ["delta", "r"])
def test_a_turned_sign_of_the_steering_is_refused(sound, tmp_path, turned):
    """Nothing went with nothing, so nothing was said: a steering lag of 0.25 s was learned in its place."""
    other = sound
    if turned == "r":
        other = replace(sound, columns={**sound.columns, "vy": -sound["vy"]})
    with pytest.raises(DriveError, match="to the other side than it steers: the sign of delta or of r is turned"):
        trained(tmp_path, other, **{turned: -sound[turned]})
    assert not any("side" in note for note in trained(tmp_path, sound).notes)


def test_a_channel_without_a_number_is_not_sent_back_to_ingest(sound, tmp_path):
    with pytest.raises(DriveError, match=f"T holds no number in any of its {len(sound)} rows. Was it recorded"):
        trained(tmp_path, sound, T=np.nan)
    torque = np.array(sound["T"])
    torque[5] = np.nan
    with pytest.raises(DriveError, match="1 non-finite values in T, the first in row 5. Run .* ingest"):
        trained(tmp_path, sound, T=torque)


def test_channels_of_one_value_are_named_once(sound, tmp_path):
    notes = [note for note in trained(tmp_path, sound, vy=0.0, T=300.0).notes if "in every row" in note]
    assert notes == ["d.parquet: v_y is 0, T is 300 in every row. If that was not recorded, the labels are wrong"]
    assert not any("in every row" in note for note in trained(tmp_path, sound).notes)
    # What ingest has checked says so itself.
    checked = replace(sound, metadata=DriveMetadata(quality={"consistency": {"findings": []}}))
    assert not any("in every row" in note for note in trained(tmp_path, checked, vy=0.0).notes)


@pytest.mark.parametrize("factor", [-1.0, 0.05])
def test_a_drive_that_is_too_slow_or_backwards_is_told_the_speed_and_the_sign(sound, tmp_path, factor):
    slowest = f"slower than {road_car().minimum_speed:.3g} m/s"
    with pytest.raises(SetError, match=f"{slowest}.*unit and sign of v_x, which is positive ahead"):
        trained(tmp_path, sound, vx=factor * sound["vx"], vy=0.1 * sound["vy"])


def test_bounds_of_the_fit_are_one_note(sound, tmp_path):
    steady = {"vx": 20.0, "vy": 0.0, "r": 0.0, "T": 300.0, "delta": 0.0}
    settings = TrainSettings(hyperparameters="fit", trust="full")
    notes = [note for note in trained(tmp_path, sound, settings, **steady).notes if "on a bound" in note]
    assert len(notes) == 1 and notes[0].endswith("the labels do not determine them")
