"""Recordings as another car would have made them: the altered car's own equations hold in them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from split_cli.errors import SplitError
from split_cli.logs.drive import Drive, DriveMetadata
from split_cli.proof.altered_car import ALTERATIONS, altered_vehicle, driven_by, moved_reference
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import MagicFormula
from tests.factories import one_run

VEHICLE = Vehicle(
    "car",
    1500.0,
    2500.0,
    1.2,
    1.5,
    0.3,
    0.5,
    0.6,
    MagicFormula(9.0, 1.3, 8000.0),
    MagicFormula(10.0, 1.3, 6500.0),
    2000.0,
    5000.0,
    100.0,
    80.0,
    drag_coefficient=0.4,
)
SIZES = {"mass": 1.25, "friction_scale": 0.75, "tire_stiffness": 0.7, "cg_shift": 0.2}
_AT = np.arange(801) * 0.01


def _steer(t):
    return 0.05 * np.sin(1.1 * t) + 0.02 * np.sin(2.9 * t + 1.0)


def _speed(t):
    return 20.0 + 2.0 * np.sin(0.4 * t)


def _thrust(car: SingleTrack, t, vy, r) -> float:
    """Return the torque that keeps the speed, by two evaluations: thrust is linear in it for one sign."""
    wanted = 2.0 * 0.4 * np.cos(0.4 * t)
    torque = 300.0
    for _ in range(4):
        here, there = (car.velocity_derivative(_speed(t), vy, r, one, _steer(t))[0] for one in (torque, torque + 1))
        torque += (wanted - here) / (there - here)
    return torque


def _driven(vehicle: Vehicle):
    """Return the yaw angle, position, v_y, r (5, N) and the torque of a car steered so at that speed."""
    car = SingleTrack(vehicle, ())

    def rates(t, y):
        yaw, _, _, vy, r = y
        vx = _speed(t)
        across = car.velocity_derivative(vx, vy, r, _thrust(car, t, vy, r), _steer(t))[1:]
        return [r, vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw), *across]

    path = solve_ivp(rates, (0.0, _AT[-1]), np.zeros(5), t_eval=_AT, rtol=1e-9, atol=1e-10).y
    return path, np.array([_thrust(car, *x) for x in zip(_AT, *path[3:], strict=True)])


def _drive(vehicle: Vehicle) -> Drive:
    path, torque = _driven(vehicle)
    yaw, x, y, vy, r = path
    vx = _speed(_AT)
    dvx, dvy, _ = SingleTrack(vehicle, ()).velocity_derivative(vx, vy, r, torque, _steer(_AT))
    columns = {
        "t": _AT,
        "X": x,
        "Y": y,
        "yaw": yaw,
        "vx": vx,
        "vy": vy,
        "r": r,
        "T": torque,
        "delta": _steer(_AT),
        "ax": dvx - vy * r,
        "ay": dvy + vx * r,
    }
    return one_run(columns, 0.01, "car")


@pytest.fixture(scope="module")
def drive() -> Drive:
    return _drive(VEHICLE)


@pytest.mark.parametrize("term", ALTERATIONS)
def test_of_a_car_without_model_error_the_altered_drive_is_the_altered_car_s(term, drive):
    altered = altered_vehicle(VEHICLE, term, SIZES[term])
    found, true = driven_by(drive, VEHICLE, altered), _drive(altered)
    for name in ("vy", "r", "yaw", "X", "Y", "T", "ax", "ay"):
        scale = np.abs(drive[name] - true[name]).max()
        # Between samples channels run in straight lines: 1e-5 of a sine of 3 rad/s at 100 Hz, gathered by yaw.
        # In the first and the last 30 ms slopes are taken to one side.
        assert np.abs(found[name] - true[name])[3:-3].max() < 1e-2 * scale, name
    assert np.array_equal(found["vx"], drive["vx"]) and np.array_equal(found["delta"], drive["delta"])


@pytest.mark.parametrize("term", ALTERATIONS)
def test_the_term_s_own_equations_are_the_altered_car_s(term):
    parameters = {name: SIZES[term] for name in CATALOGUE[term].units}
    named = SingleTrack(VEHICLE, [CATALOGUE[term](parameters)])
    other = SingleTrack(altered_vehicle(VEHICLE, term, SIZES[term]), ())
    at = np.random.default_rng(5).uniform([10, -1, -0.6, -900, -0.1], [30, 1, 0.6, 900, 0.1], (50, 5)).T
    np.testing.assert_allclose(named.velocity_derivative(*at), other.velocity_derivative(*at), rtol=1e-12)


@pytest.mark.parametrize(
    ("how", "is_written"), [("throttle times peak", True), ("from dv_x/dt by the nominal model", False)]
)
def test_a_heavier_car_needs_more_torque_unless_its_torque_came_from_the_motion(drive, how, is_written):
    known = replace(drive, metadata=DriveMetadata(kinds={"T": f"derived: {how}"}))
    found = driven_by(known, VEHICLE, altered_vehicle(VEHICLE, "mass", 1.2))
    assert (np.abs(found["T"] - drive["T"]).max() > 10.0) == is_written


def test_the_forces_that_the_nominal_model_lacks_stay_as_they_were():
    # Of a softer car, told by a file that does not know: the labels against the file, at every moment.
    softer = _drive(altered_vehicle(VEHICLE, "tire_stiffness", 0.9))
    softer = softer.select(softer["t"] < 5.0)
    other = altered_vehicle(altered_vehicle(VEHICLE, "mass", 1.2), "cg_shift", 0.1)
    found = driven_by(softer, VEHICLE, other)

    def labels(one: Drive, vehicle: Vehicle) -> np.ndarray:
        rates = SingleTrack(vehicle, ()).velocity_derivative(*(one[n] for n in ("vx", "vy", "r", "T", "delta")))
        change = np.stack([np.gradient(one[name], 0.01) for name in ("vx", "vy", "r")])
        return np.linalg.solve(vehicle.force_matrix(), change - np.stack(rates))[:, 5:-5]

    before, after = labels(softer, VEHICLE), labels(found, other)
    assert np.abs(labels(found, VEHICLE) - before).max() > 0.2 * np.abs(before).max()
    # Slopes over 60 ms are right to (3 x 0.06)^2/24 of v_y' and r'.
    np.testing.assert_allclose(after, before, atol=2e-3 * VEHICLE.mass)


def test_a_biased_velocity_turns_no_car(drive):
    """A bias of v_y is a lateral force to the nominal model, and none that a moved CG lets turn the car."""
    altered = altered_vehicle(VEHICLE, "cg_shift", 0.2)
    short = drive.select(drive["t"] < 4.0)
    biased = replace(short, columns={**short.columns, "vy": short["vy"] - 0.1})
    found, true = (driven_by(one, VEHICLE, altered)["r"] - short["r"] for one in (biased, short))
    assert abs(np.mean(found - true)) < 0.02 * np.abs(true).max()


def test_a_car_that_would_spin_is_refused(drive):
    # Rear tyres at a tenth of their grip.
    loose = replace(VEHICLE, rear_tire=MagicFormula(100.0, 1.3, 650.0))
    with pytest.raises(SplitError, match="spun"):
        driven_by(drive, VEHICLE, loose)


def test_a_file_that_does_not_explain_the_drive_says_nothing_of_another_car(drive):
    # Wheels that steer to the other side.
    mirrored = replace(drive, columns={**drive.columns, "delta": -drive["delta"]})
    with pytest.raises(SplitError, match="explains 0 %"):
        driven_by(mirrored, VEHICLE, altered_vehicle(VEHICLE, "mass", 1.1))


def test_every_channel_of_a_moved_unit_is_a_rigid_body_s(drive):
    moved = moved_reference(drive, 0.8)
    # Velocity of the moved point from its position, and its acceleration from its own velocity.
    inner = slice(5, -5)
    ahead = 0.8 * np.stack([np.cos(drive["yaw"]), np.sin(drive["yaw"])])
    ground = np.gradient(np.stack([drive["X"], drive["Y"]]) + ahead, _AT, axis=1)
    across = -np.sin(moved["yaw"]) * ground[0] + np.cos(moved["yaw"]) * ground[1]
    np.testing.assert_allclose(across[inner], moved["vy"][inner], atol=2e-3)
    # The term that names it takes it off again.
    term = CATALOGUE["sensor_lever_arm"]({"dx": 0.8}, "unit")
    back = term.correct(moved.columns, Recording.single(0.01, len(_AT)))
    for name in ("vy", "ax", "ay"):
        # A change of r over 0.06 s in place of one over 0.02 s: (3 x 0.03)^2/6 of r', up to 1 rad/s^2 there.
        assert np.abs(back[name] - drive[name])[inner].max() < 5e-3, name
        assert np.abs(moved[name] - drive[name]).max() > 0.05, name
    felt = np.gradient(moved["vy"], _AT) + moved["vx"] * moved["r"]
    np.testing.assert_allclose(moved["ay"][inner], felt[inner], atol=5e-3)
    along = np.gradient(moved["vx"], _AT) - moved["vy"] * moved["r"]
    np.testing.assert_allclose(moved["ax"][inner], along[inner], atol=5e-3)
