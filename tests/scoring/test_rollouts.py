"""Multi-step prediction where the answer is known: perfect models, constant missing forces, circular arcs."""

from dataclasses import replace

import numpy as np

from split_cli.learning.features import FeatureSet
from split_cli.logs.drive import Drive
from split_cli.scoring.rollouts import Correction, hold_velocity, roll_out, rollout_starts, score_rollouts
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import MissingForce, make_drive, road_car

CAR = road_car()


def with_position(drive: Drive, vehicle: Vehicle, terms=()) -> Drive:
    """Return one segment of a drive integrated anew with X, Y and yaw, from its first sample."""
    model = SingleTrack(vehicle, tuple(terms) or None)
    one = drive.select(slice(0, drive.segments()[0].stop))
    state = np.array([[3.0, -2.0, 0.7, one["vx"][0], one["vy"][0], one["r"][0]]])
    rows = [state]
    for k in range(len(one) - 1):
        span = slice(k, k + 2)
        state = integrate_recorded(model, state, one["T"][None, span], one["delta"][None, span], one.period, 8)
        rows.append(state)
    names = ("X", "Y", "yaw", "vx", "vy", "r")
    columns = {**one.columns, **dict(zip(names, np.concatenate(rows).T, strict=True))}
    return replace(one, columns=columns)


def rmse(drive: Drive, trajectory: np.ndarray, starts: np.ndarray, window: int):
    return score_rollouts(drive, starts, window, {"it": trajectory})["it"]


def test_the_model_that_made_a_drive_predicts_it_and_where_it_goes():
    drive = with_position(make_drive(5, segments=1, seconds=6.0, period=0.01, vehicle=CAR), CAR)
    starts = rollout_starts(drive, np.ones(len(drive), bool), 200, 1.0)
    sums = rmse(drive, roll_out(SingleTrack(CAR), drive, starts, 40, 5), starts, 5)
    # The drive took eight steps a sample, the rollout one or two: RK4 at |lambda| step <= 1 is good to 1e-4.
    assert sums.rmse.max() < 1e-4
    assert sums.distance.max() < 1e-3
    assert (sums.count, sums.diverged) == (200, 0)


def test_a_constant_missing_force_drifts_as_the_closed_form_and_its_correction_removes_it():
    """Straight ahead without drag: an error a of the rate makes a t in v_x and a t^2/2 in the position."""
    free = road_car(drag_coefficient=0.0, rolling_resistance_front=0.0, rolling_resistance_rear=0.0)
    base = make_drive(0, segments=1, seconds=4.0, period=0.01, vehicle=free)
    t = np.arange(len(base)) * base.period
    torque, missing = 400.0, 450.0
    rate = torque / (free.wheel_radius * free.mass) + missing / free.mass
    zero = np.zeros(len(base))
    motion = {"vx": 15.0 + rate * t, "X": 15.0 * t + 0.5 * rate * t**2, "Y": zero, "yaw": zero, "vy": zero, "r": zero}
    columns = {**base.columns, **motion, "T": zero + torque, "delta": zero}
    drive = replace(base, columns=columns)
    model, steps, window = SingleTrack(free), 40, 5
    starts = rollout_starts(drive, np.ones(len(drive), bool), steps * window, 1.0)
    elapsed = window * base.period * np.arange(1, steps + 1)
    nominal = rmse(drive, roll_out(model, drive, starts, steps, window), starts, window)
    np.testing.assert_allclose(nominal.rmse[:, 0], missing / free.mass * elapsed, rtol=1e-10)
    np.testing.assert_allclose(nominal.distance, 0.5 * missing / free.mass * elapsed**2, rtol=1e-9)
    lacking = np.array([missing / free.mass, 0.0, 0.0])
    features = FeatureSet(("vx",))
    correction = Correction(features, drive["vx"][:, None], lambda z: np.tile(lacking, (len(z), 1)))
    corrected = rmse(drive, roll_out(model, drive, starts, steps, window, correction), starts, window)
    assert corrected.rmse.max() < 1e-10
    # Velocity is corrected at the end of each step: the path within it still lacks a h^2/2, forty times.
    np.testing.assert_allclose(corrected.distance[-1], 40 * 0.5 * lacking[0] * 0.05**2, rtol=1e-6)


def test_the_true_lateral_residual_removes_the_error_the_more_the_shorter_the_step():
    """A front lateral force F misses in v_y' by F cos(delta)/m and in r' by F cos(delta) l_f/I_z."""
    force = 500.0
    drive = make_drive(
        6, segments=12, seconds=4.0, period=0.01, vehicle=CAR, terms=[MissingForce({"front_lateral": force})]
    )
    model = SingleTrack(CAR)

    def residual(z: np.ndarray) -> np.ndarray:
        across, along = force * np.cos(z[:, 0]), -force * np.sin(z[:, 0])
        arm = CAR.cg_to_front_axle / CAR.yaw_inertia
        return np.stack([along / CAR.mass, across / CAR.mass, across * arm], axis=1)

    correction = Correction(FeatureSet(("delta",)), drive["delta"][:, None], residual)
    starts = rollout_starts(drive, np.ones(len(drive), bool), 160, 5.0)

    def error(window: int, correct: Correction | None) -> np.ndarray:
        steps = 160 // window
        return rmse(drive, roll_out(model, drive, starts, steps, window, correct), starts, window).rmse[-1]

    nominal = error(4, None)
    corrected = [error(window, correction) for window in (8, 4, 2)]
    assert (corrected[1][1:] < 0.02 * nominal[1:]).all()
    # The residual acts on top of a step of f_h with Phi of its start: first order in the step at least.
    for coarse, fine in zip(corrected[:-1], corrected[1:], strict=True):
        assert (fine[1:] < 0.6 * coarse[1:]).all()


def test_a_vehicles_delay_acts_in_rollouts():
    """A car that steers 60 ms late, and a vehicle file that says so: nothing is left."""
    late = CATALOGUE["steer_delay"]({"delay": 0.06}, "")
    commanded = make_drive(7, segments=10, seconds=4.0, period=0.01, vehicle=CAR)
    shift = 6
    columns = dict(commanded.columns)
    for run in commanded.segments():
        ahead = columns["delta"][run]
        columns["delta"] = columns["delta"].copy()
        columns["delta"][run] = np.concatenate([ahead[shift:], np.full(shift, ahead[-1])])
    drive = replace(commanded, columns=columns)
    inside = np.ones(len(drive), bool)
    for run in drive.segments():
        inside[run.start : run.start + shift] = False  # what was commanded before the segment is not known
    starts = rollout_starts(drive, inside, 100, 5.0)
    told = rmse(drive, roll_out(SingleTrack(CAR, (late,)), drive, starts, 20, 5), starts, 5)
    untold = rmse(drive, roll_out(SingleTrack(CAR), drive, starts, 20, 5), starts, 5)
    assert told.rmse.max() < 2e-4
    assert untold.rmse[-1, 2] > 100 * told.rmse[-1, 2]


def test_velocities_held_make_a_circular_arc():
    drive = with_position(make_drive(8, segments=1, seconds=4.0, period=0.01, vehicle=CAR), CAR)
    starts = np.array([3, 50, 120])
    straight = replace(drive, columns={**drive.columns, "r": np.where(np.arange(len(drive)) == 50, 0.0, drive["r"])})
    held = hold_velocity(straight, starts, 30, 5)
    fine = 200
    for i, row in enumerate(starts):
        vx, vy, r, yaw = (straight[name][row] for name in ("vx", "vy", "r", "yaw"))
        time = (np.arange(30 * fine) + 0.5) * 0.05 / fine
        for place, rate in (
            ("X", vx * np.cos(yaw + r * time) - vy * np.sin(yaw + r * time)),
            ("Y", vx * np.sin(yaw + r * time) + vy * np.cos(yaw + r * time)),
        ):
            path = straight[place][row] + np.cumsum(rate)[fine - 1 :: fine] * 0.05 / fine
            # The midpoint rule with 0.25 ms is good to 1e-7 m over 1.5 s.
            np.testing.assert_allclose(held[i, :, 0 if place == "X" else 1], path, atol=1e-6)
        np.testing.assert_array_equal(held[i, :, 3:], np.tile([vx, vy, r], (30, 1)))


def test_starts_stay_on_their_rows_and_segments_and_are_spread():
    drive = make_drive(9, segments=5, seconds=4.0, vehicle=CAR)
    rows = np.zeros(len(drive), bool)
    rows[100:700] = True
    starts = rollout_starts(drive, rows, 50, 5.0, most=10**6)
    brute = [
        k
        for k in range(len(drive) - 50)
        if rows[k : k + 51].all()
        and (drive["vx"][k : k + 51] > 5.0).all()
        and drive.segment[k] == drive.segment[k + 50]
    ]
    np.testing.assert_array_equal(starts, brute)
    few = rollout_starts(drive, rows, 50, 5.0, most=7)
    assert len(few) == 7
    assert (few[0], few[-1]) == (starts[0], starts[-1])


def test_a_start_that_diverges_for_one_model_counts_for_none():
    drive = make_drive(10, segments=3, seconds=4.0, vehicle=CAR)
    starts = np.array([0, 20, 40])
    good = hold_velocity(drive, starts, 10, 2)
    bad = good.copy()
    bad[1, 5:, 0] = np.inf
    sums = score_rollouts(drive, starts, 2, {"good": good, "bad": bad})
    assert {(entry.count, entry.diverged) for entry in sums.values()} == {(2, 1)}
    alone = score_rollouts(drive, starts[[0, 2]], 2, {"good": good[[0, 2]]})["good"]
    np.testing.assert_array_equal(sums["good"].squared, alone.squared)
    both = alone + sums["good"]
    np.testing.assert_allclose(both.rmse, alone.rmse, rtol=1e-12)
    assert both.count == 4
    assert np.isnan(both.distance).all()  # no position was recorded
