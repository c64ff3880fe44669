"""A drive against a vehicle file: its own is never refused, another car is told by what contradicts."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import DriveError
from split_cli.logs.drive import Drive
from split_cli.scoring.vehicle_match import belonging, share_beyond
from split_cli.vehicle.tire import MagicFormula
from split_cli.workflows.recordings import vehicle_warnings
from tests.factories import make_drive, make_training_set, road_car


@pytest.fixture(scope="module")
def drive():
    return make_drive(5, segments=40, knot=1.0)


def test_its_own_vehicle_is_not_doubted(drive):
    shown = belonging(drive, road_car())
    assert vehicle_warnings([drive], road_car()) == ()
    # The drive turns by the very equations; steady turning leaves out what is transient.
    assert 0.6 < shown.turning < 1.2 and 0.8 < shown.traction < 1.2


def test_a_car_of_another_size_is_refused_and_with_the_flag_warned_of(drive):
    small = road_car(
        cg_to_front_axle=0.16,
        cg_to_rear_axle=0.17,
        wheel_radius=0.05,
        mass=4.0,
        yaw_inertia=0.05,
        max_torque=2.0,
        max_brake_torque=2.0,
        front_tire=MagicFormula(9.0, 1.4, 18.0),
        rear_tire=MagicFormula(9.0, 1.4, 18.0),
    )
    with pytest.raises(DriveError, match="is not of the vehicle 'test car': it turns .* times as fast"):
        vehicle_warnings([drive], small)
    said = vehicle_warnings([drive], small, any_vehicle=True)
    assert said[0].startswith("WARNING: made.parquet is not of the vehicle")


def test_another_grip_is_told_by_its_size():
    """Tyres of the recorded car carry 0.45 of what the file says: a wet road against a dry file."""
    car = road_car()
    slippery = road_car(
        front_tire=replace(car.front_tire, D=0.45 * car.front_tire.D),
        rear_tire=replace(car.rear_tire, D=0.45 * car.rear_tire.D),
    )
    shown = belonging(make_drive(6, segments=40, vehicle=slippery, knot=1.0), car)
    assert shown.grip == pytest.approx(0.45, abs=0.03)
    assert shown.contradictions() == () and "they carry 0.45" in shown.doubts()[0]


def test_a_drive_that_hardly_moves_shows_nothing(drive):
    still = replace(drive, columns={**drive.columns, "vx": np.zeros(len(drive))})
    assert belonging(still, road_car()).contradictions() == ()


def test_the_share_of_features_beyond_the_points_is_that_of_what_was_moved_away():
    """Points themselves are none away; half of them moved by a thousand length scales are all of that half."""
    s = make_training_set(seed=8, points=200)
    moved = s.z.copy()
    moved[:100] += 1e3 * s.kernel.length_scales
    assert share_beyond(s, s.z) == 0.0 and share_beyond(s, moved) == 0.5
    # Along one feature alone, just inside and just outside one length scale of the outermost point.
    last = int(np.argmax(s.z[:, 0]))
    near = [s.z[last] + np.array([share, 0.0, 0.0]) * s.kernel.length_scales for share in (0.99, 1.01)]
    assert share_beyond(s, np.array(near)) == 0.5


def test_a_car_that_slides_carries_what_its_tyres_do_not_what_it_turns_by():
    """v_x r of a slide was told as 1.5 times the grip: the path bends by v_x r + dv_y/dt, here by nothing."""
    car = road_car()
    t = 0.01 * np.arange(4000)
    r = 2.0 * np.sin(2.0 * t)
    columns = {
        "t": t,
        "vx": np.full_like(t, 15.0),
        "vy": 15.0 * np.cos(2.0 * t),
        "r": r,
        "T": 0.0 * t,
        "delta": 0.0 * t,
    }
    drive = Drive("sliding", columns, np.zeros(len(t), np.int32), 0.01)
    assert belonging(drive, car).peak < 0.05
    without = Drive("turning", columns | {"vy": 0.0 * t}, np.zeros(len(t), np.int32), 0.01)
    carried = (car.front_tire.D + car.rear_tire.D) / car.mass
    assert belonging(without, car).peak == pytest.approx(30.0 / carried, rel=0.01)
