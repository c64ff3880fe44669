"""Faults first seen in logs in the forms of public data sets and games, written from a simulated drive; planted."""

import numpy as np
import pytest

from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording

DEG = 180.0 / np.pi


def _write(path, columns: dict[str, np.ndarray]) -> None:
    table = np.stack(list(columns.values()), 1)
    np.savetxt(path, table, delimiter=",", header=",".join(columns), comments="")


@pytest.mark.parametrize("zero", [90.0, 20.0])
def test_the_zero_of_yaw_is_where_the_car_goes_straight_and_not_the_mean_of_its_sideslip(tmp_path, zero):
    """A lap of left bends has a mean sideslip of half a degree, which made a v_y of 0.2 m/s from the pose."""
    t = np.arange(0.0, 60.0, 0.02)
    v, r = 22.0 + 5.0 * np.sin(0.4 * t), 0.15 * (1.0 + np.sin(0.7 * t))
    yaw = 0.15 * t - 0.15 / 0.7 * np.cos(0.7 * t)
    sideslip = 1.3 * r / v - 0.006 * v * r
    assert abs(np.mean(sideslip)) * DEG > 0.5
    step = 0.02 * np.stack([np.cos(yaw + sideslip), np.sin(yaw + sideslip)]) * v / np.cos(sideslip)
    x, y = np.cumsum(step, axis=1) - 0.5 * step
    _write(tmp_path / "log.csv", {"t": t, "posX": x, "posY": y, "yawPos": yaw + zero / DEG})
    found = draft_map(open_recording(tmp_path / "log.csv")).of("yaw")
    # A multiple of 90 degrees is exact; any other zero is known as well as the smoothing leaves it.
    assert found.offset * DEG == pytest.approx(-zero, abs=1e-3 if zero == 90.0 else 0.05)
