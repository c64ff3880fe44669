"""A drive against a vehicle file: its own is never refused, another car is told by what contradicts."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import DriveError
from split_cli.logs.drive import Drive
from split_cli.scoring.vehicle_match import belonging, overloaded_axles, share_beyond
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
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


def test_an_axle_whose_tyres_the_drive_outdoes_is_named(drive):
    """A rear peak below what the rear axle carried: the model spins there, and every error is that of the spin."""
    car = road_car()
    assert overloaded_axles(drive, car, belonging(drive, car)) == ()
    weak = replace(car, rear_tire=MagicFormula(car.rear_tire.B / 0.3, car.rear_tire.C, 0.3 * car.rear_tire.D))
    (said,) = overloaded_axles(drive, weak, belonging(drive, weak))
    assert said.startswith("its rear axle carried ") and "D of rear_tire is 2040 N" in said
    changed = weak.with_effects(EffectSpec("friction_scale", {"scale": 3.0}))
    assert overloaded_axles(drive, changed, belonging(drive, changed)) == ()


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


def held_at_speed(vehicle, speed=20.0, steps=(0.0, 0.04, 0.0, -0.06, 0.0, 0.08), seconds=5.0, period=0.01):
    """Return a drive of the vehicle's own equations through steps of steering, at a speed that the torque keeps."""
    model = SingleTrack(vehicle)
    rows = np.repeat(steps, int(seconds / period))
    state, found = np.array([speed, 0.0, 0.0]), []
    delta = 0.0
    for target in rows:
        delta += np.clip(target - delta, -0.4 * period, 0.4 * period)
        coasting = model.velocity_derivative(*state, 0.0, delta)[0]
        torque = vehicle.mass * vehicle.wheel_radius * (speed - state[0] - coasting)
        found.append([*state, torque, delta])
        state = state + period * np.array(model.velocity_derivative(*state, torque, delta))
    vx, vy, r, torque, delta = np.array(found).T
    t = period * np.arange(len(rows))
    columns = {"t": t, "vx": vx, "vy": vy, "r": r, "T": torque, "delta": delta}
    return Drive("steps.parquet", columns, np.zeros(len(t), np.int32), period)


def test_a_torque_that_only_keeps_the_speed_in_turns_contradicts_no_car():
    """Against the plain torque the car's own step steer was refused: it "accelerated 0.33 times as much"."""
    drive = held_at_speed(road_car())
    assert vehicle_warnings([drive], road_car()) == ()
    assert belonging(drive, road_car()).traction == pytest.approx(1.0, abs=0.1)
    # A file that knows no resistance yet is not contradicted by the torque that overcomes them.
    bare = road_car(drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    assert vehicle_warnings([drive], bare) == ()


@pytest.mark.parametrize("factor", [0.1, 10.0])
def test_a_torque_before_the_gears_or_in_another_unit_is_refused_in_turns_and_on_a_lap(drive, factor):
    for own in (drive, held_at_speed(road_car())):
        other = replace(own, columns={**own.columns, "T": factor * own["T"]})
        with pytest.raises(DriveError, match="times as much for its torque"):
            vehicle_warnings([other], road_car())


def test_the_resistances_of_another_cars_file_do_not_hide_that_its_mass_is_another():
    """With the drag of a light car with wings the torque of a road car goes with nothing; without it, it does."""
    own = make_drive(7, segments=40, knot=1.0)
    light = road_car(mass=120.0, drag_coefficient=40.0)
    assert belonging(own, light).traction == pytest.approx(120.0 / road_car().mass, rel=0.3)
    with pytest.raises(DriveError, match="times as much for its torque"):
        vehicle_warnings([own], light)


def with_torque(drive, values, kind="command"):
    metadata = replace(drive.metadata, kinds={**drive.metadata.kinds, "T": kind})
    return replace(drive, columns={**drive.columns, "T": values}, metadata=metadata)


@pytest.mark.parametrize("kind", ["command", "derived: from throttle, of no car in particular"])
def test_a_torque_that_is_positive_when_braking_is_refused_with_its_remedy(drive, kind):
    """A set of it learned twice the torque as a correction; a pedal has an assumed size, but a sign like any other."""
    turned = with_torque(drive, -drive["T"], kind)
    with pytest.raises(
        DriveError, match=r"T is positive when braking\. Turn it with `scale: -1` in the map"
    ) as refused:
        vehicle_warnings([turned], road_car())
    assert "\n" not in str(refused.value)
    assert belonging(turned, road_car()).traction == pytest.approx(-1.0, abs=0.1)
    assert vehicle_warnings([with_torque(drive, drive["T"], kind)], road_car()) == ()


def test_a_torque_that_was_derived_from_the_motion_has_no_sign_of_its_own(drive):
    turned = with_torque(drive, -drive["T"], "derived: torque from measured a_x by the nominal model of test car")
    assert belonging(turned, road_car()).traction is None


def test_a_driver_who_gives_half_of_what_a_hill_takes_has_no_turned_torque():
    """Uphill he drives and slows down: levels go against the torque by 0.7 and more, what his foot does with it."""
    car = road_car(drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    rng = np.random.default_rng(3)
    period, rows = 0.05, 12_000
    t = period * np.arange(rows)
    hill = 0.6 * np.sin(2.0 * np.pi * t / 60.0)  # [m/s^2] that the slope takes
    foot = 0.08 * np.repeat(rng.standard_normal(rows // 30), 30)  # steps of 1.5 s
    given = 0.5 * hill + foot
    vx = 25.0 + period * np.cumsum(given - hill)
    vx -= np.polyval(np.polyfit(t, vx, 1), t) - 25.0  # the random walk that steps add up to
    still = 0.0 * t
    columns = {"t": t, "vx": vx, "vy": still, "r": still, "T": given * car.mass * car.wheel_radius, "delta": still}
    hilly = Drive("hills.parquet", columns, np.zeros(rows, np.int32), period)
    assert np.corrcoef(np.gradient(vx, period), given)[0, 1] < -0.7
    assert vehicle_warnings([hilly], car) == ()
