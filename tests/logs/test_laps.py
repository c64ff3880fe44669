"""Laps are counted where a path comes back, and the set after the last lap is the one of the whole drive."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import DriveError
from split_cli.logs.drive import Drive
from split_cli.logs.laps import first_lap, lap_numbers
from tests.factories import one_run


def circle(laps: float, noise: float = 0.0, radius: float = 40.0, speed: float = 10.0) -> Drive:
    period = 0.02
    t = np.arange(0.0, laps * 2.0 * np.pi * radius / speed, period)
    angle = speed * t / radius
    rng = np.random.default_rng(3)
    columns = {
        "X": radius * np.sin(angle) + noise * rng.normal(size=len(t)),
        "Y": radius * (1.0 - np.cos(angle)) + noise * rng.normal(size=len(t)),
        "vx": np.full(len(t), speed),
        "r": np.full(len(t), speed / radius),
    }
    return one_run(columns, period, "circle")


@pytest.mark.parametrize("noise", [0.0, 0.02])
def test_a_circle_ends_its_laps_after_its_circumference(noise):
    drive = circle(3.4, noise=noise)
    lap = lap_numbers(drive, 2.7)
    ends = drive["t"][np.flatnonzero(np.diff(lap)) + 1]
    # A sample of 0.02 s, and noise of a lap's end along the path: 0.02 m at 10 m/s.
    np.testing.assert_allclose(ends, 2.0 * np.pi * 40.0 / 10.0 * np.array([1, 2, 3]), atol=0.03)


def test_an_open_path_has_no_laps():
    with pytest.raises(DriveError, match="never comes back"):
        lap_numbers(circle(0.9), 2.7)


def test_the_first_lap_is_all_of_a_drive_without_laps():
    drive, never_back = circle(2.5), circle(0.9)
    lap = first_lap(drive, 2.7)
    # One sample of 0.02 s.
    assert drive["t"][lap.stop] == pytest.approx(2.0 * np.pi * 40.0 / 10.0, abs=0.03)
    assert first_lap(never_back, 2.7) == slice(0, len(never_back))
    blind = {name: values for name, values in drive.columns.items() if name not in ("X", "Y")}
    assert first_lap(replace(drive, columns=blind), 2.7) == slice(0, len(drive))


def test_the_way_back_is_no_lap():
    there = circle(0.5)
    columns = {name: np.concatenate([values, values[::-1]]) for name, values in there.columns.items()}
    columns["t"] = np.arange(len(columns["t"])) * there.period
    back = replace(there, columns=columns, segment=np.zeros(len(columns["t"]), dtype=np.int32))
    with pytest.raises(DriveError, match="never comes back"):
        lap_numbers(back, 2.7)


def test_a_lap_channel_is_believed():
    drive = circle(2.0)
    own = np.where(drive["t"] < 7.0, 4.0, 5.0)
    numbered = replace(drive, columns={**drive.columns, "lap": own})
    np.testing.assert_array_equal(lap_numbers(numbered, 2.7), np.where(drive["t"] < 7.0, 1, 2))
