"""Limits over speed against closed forms, and as files a planner reads."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.export.ggv import limits_over_speed, write_ggv
from split_cli.learning.region import Region
from split_cli.vehicle.parameters import EffectSpec
from tests.factories import road_car


def peak(tire, alpha_max: float) -> float:
    """Return the largest force of a curve within +-alpha_max."""
    alpha = np.linspace(0.0, alpha_max, 100_001)
    return float((tire.D * np.sin(tire.C * np.arctan(tire.B * alpha))).max())


def test_limits_of_a_plain_car_are_its_curves():
    car = road_car()
    region = Region.of(car)
    limits = limits_over_speed(car, region)
    front, rear = (peak(tire, region.alpha_max) for tire in (car.front_tire, car.rear_tire))
    # A turn at a_y: front m a l_r/L, rear m a l_f/L. The search over 181 angles misses a peak by 1e-4 of it.
    lateral = min(front / car.cg_to_rear_axle, rear / car.cg_to_front_axle) * car.wheelbase / car.mass
    np.testing.assert_allclose(limits.lateral, lateral, rtol=2e-4)
    np.testing.assert_allclose(limits.longitudinal, (front + rear) / car.mass, rtol=2e-4)
    rolling = car.rolling_resistance_front + car.rolling_resistance_rear
    force = car.max_torque / car.wheel_radius - rolling - car.drag_coefficient * limits.speed**2
    np.testing.assert_allclose(limits.machine, force / car.mass, rtol=1e-9)
    assert limits.speed[0] == region.minimum_speed


def test_downforce_raises_the_limits_with_the_square_of_speed():
    car = road_car(effects=(EffectSpec("aero_downforce", {"front": 1.0, "rear": 1.0}),))
    limits, plain = limits_over_speed(car, Region.of(car)), limits_over_speed(road_car(), Region.of(car))
    count = min(len(limits.speed), len(plain.speed))
    gain = limits.longitudinal[:count] - plain.longitudinal[:count]
    assert (gain > 0.0).all()
    np.testing.assert_allclose(gain / limits.speed[:count] ** 2, gain[0] / limits.speed[0] ** 2, rtol=1e-6)


def test_the_files_read_back(tmp_path):
    car = road_car()
    limits = limits_over_speed(car, Region.of(car))
    names = write_ggv(limits, tmp_path, "car")
    assert names == ("car_ggv.csv", "car_ax_max_machines.csv")
    table = np.loadtxt(tmp_path / "car_ggv.csv", delimiter=",")
    assert table == pytest.approx(np.column_stack([limits.speed, limits.longitudinal, limits.lateral]), abs=1e-4)
    assert (tmp_path / "car_ggv.csv").read_text().startswith("# v_mps,ax_max_mps2,ay_max_mps2\n")


def test_a_region_beyond_the_table_is_refused():
    region = replace(Region.of(road_car()), minimum_speed=999.0)
    with pytest.raises(SplitError, match="begins at 999 m/s, and a table of limits ends at 100"):
        limits_over_speed(road_car(), region)
