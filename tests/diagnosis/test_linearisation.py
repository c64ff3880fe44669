"""How rates answer to deviations of the velocities: against differences of the model that has the memory itself."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.evidence import gather_evidence
from split_cli.diagnosis.innovations.linearisation import linearise, slopes
from split_cli.diagnosis.innovations.objective import build_objective
from split_cli.diagnosis.recording.series import Series, build_series, extended_model
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.recording import first_order_from_means, over_samples
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.diagnosis.recordings import case_of, noisy_series
from tests.diagnosis.test_self_test import drive, recorded
from tests.factories import road_car

CAR = read_vehicle(library_path("av21"))
#: A car of a tenth of the size: half of a deviation is gone within two samples of 10 ms.
SMALL = read_vehicle(Path(__file__).resolve().parents[2] / "sample_logs" / "f1tenth_car.yaml")
SMALL_NOISE = np.array([0.012, 0.010, 0.02])


@cache
def nominal_drive() -> Series:
    """Return a scripted drive of the nominal car."""
    return noisy_series(CAR, (), 41, "sim")


def relaxation(length: float) -> Term:
    return CATALOGUE["tire_relaxation"]({"length": length})


@pytest.mark.parametrize("length", [0.0, 0.1, 0.3, 2.0])
def test_it_is_the_derivative_of_a_model_with_memory(length):
    """By central differences of the model's rates along the recording, at a deviation that changes slowly."""
    series = nominal_drive()
    model = extended_model(CAR, (relaxation(length),))
    t = series.t[:, None]
    deviation = np.hstack([0.5 * np.sin(1.3 * t), np.sin(4.0 * t + 0.3), 0.2 * np.cos(2.0 * t)])
    ahead, behind = (series.rates(model, series.predicted + side * 1e-5 * deviation) for side in (1.0, -1.0))
    expected = (ahead - behind) / 2e-5
    found = over_samples(linearise(CAR, series, (relaxation(length),)).of_deviation(deviation), series.recording)
    inside = np.append(series.inside(), False)
    # Single samples differ more, where a prediction begins anew: one Jacobian is taken at the ends, one halfway.
    assert np.std((found - expected)[inside], axis=0) == pytest.approx(0.0, abs=0.02 * np.std(expected[inside]))


BENT = (CATALOGUE["tire_stiffness"]({"front_scale": 1.3, "rear_scale": 1.3}), CATALOGUE["yaw_inertia"]({"scale": 0.85}))


@pytest.mark.parametrize("length", [0.0, 0.4])
def test_it_is_the_derivative_of_a_model_with_found_terms(length):
    """By central differences of rates of the model with them, velocity by velocity."""
    series, late = nominal_drive(), (relaxation(length),)
    found = linearise(CAR, series, (*late, *BENT))
    plain = SingleTrack(CAR, BENT)
    at = (*series.predicted.T, series.torque, series.steer_angle)
    steps = 1e-5 * np.eye(3)
    expected = np.stack(
        [
            np.stack([ahead - behind for ahead, behind in zip(*pair, strict=True)], axis=-1) / 2e-5
            for pair in (
                [plain.velocity_derivative(*(series.predicted + side * step).T, *at[3:]) for side in (1.0, -1.0)]
                for step in steps
            )
        ],
        axis=-1,
    )
    assert found.jacobian == pytest.approx(expected, rel=1e-4, abs=1e-4)
    assert np.abs(found.jacobian - linearise(CAR, series, late).jacobian).max() > 1.0
    assert found.rate is None or found.immediate == pytest.approx(linearise(CAR, series, late).immediate, abs=1e-6)


def test_held_inputs_lead_over_a_sample_as_the_matrix_exponential_does():
    """y' = A y + b with constant b: y_1 - y_0 = h phi_1(h A) f_0, and f = A (y_0 + y_1)/2 + b halfway."""
    series = nominal_drive()
    found = linearise(CAR, series)
    assert found.to_motion is not None and len(found.to_motion) == len(series) - 1
    for k in (0, 300, 1700):
        A = 0.5 * (found.jacobian[k] + found.jacobian[k + 1])
        begin, b = np.array([1.0, -0.4, 0.2]), np.array([0.3, 5.0, -8.0])
        system = np.zeros((4, 4))
        system[:3, :3], system[:3, 3] = A, b
        end = (expm(series.period * system) @ np.append(begin, 1.0))[:3]
        halfway = series.period * (A @ (begin + end) / 2.0 + b)
        assert found.to_motion[k] @ halfway == pytest.approx(end - begin, rel=1e-9, abs=1e-12)
        # The rule of trapezia, without that factor, errs by a share of (h A)^2/12.
        assert np.abs(halfway - (end - begin)).max() > 0.003 * np.abs(end - begin).max()


def test_a_step_within_a_sample_adds_the_moment_of_its_place():
    """y' = A y + b u, and u steps after 3 ms of 10 ms: with the moment a twentieth of the error is left."""
    series = nominal_drive()
    found = linearise(CAR, series)
    A, h, ahead = 0.5 * (found.jacobian[300] + found.jacobian[301]), series.period, 0.003
    b, begin = np.array([0.1, 90.0, 60.0]), np.array([0.0, 0.3, -0.2])
    system = np.zeros((4, 4))
    system[:3, :3], system[:3, 3] = A, b
    halfway_through = (expm(ahead * system) @ np.append(begin, 0.0))[:3]  # u = 0, then 1
    end = (expm((h - ahead) * system) @ np.append(halfway_through, 1.0))[:3]
    mean, moment = (h - ahead) / h, -ahead * (h - ahead) / (2.0 * h**2)
    without = (end - begin) - found.to_motion[300] @ (h * (A @ (begin + end) / 2.0 + b * mean))
    left = without - h**2 * A @ b * moment
    assert np.linalg.norm(left) < 0.06 * np.linalg.norm(without)


def test_moments_of_late_commands():
    """Late by 1.3 samples: a step comes after three tenths of a sample. A lag makes a saw tooth of every step."""
    series, h = nominal_drive(), 0.01
    inside = np.zeros(len(series), dtype=bool)
    for begin, end in series.recording.segments:
        inside[begin + 60 : end - 1] = True
    delta = series.steer_angle
    late = series.steer_first_moment(CAR, (CATALOGUE["steer_delay"]({"delay": 0.013}),))
    expected = -(np.roll(delta, 1) - np.roll(delta, 2)) * 0.3 * 0.7 / 2.0
    assert late[inside] == pytest.approx(expected[inside], abs=0.07 * np.abs(expected).max())
    # With the lag, delta(s) = U - (U - u_0) exp(-s/tau) from u_0 at the begin of a sample.
    tau, moments = 0.02, series.steer_first_moment(CAR, (CATALOGUE["steer_lag"]({"tau": 0.02}),))
    at_begin = first_order_from_means(delta, 1.0 / tau, series.recording)
    s = (np.arange(2000) + 0.5) / 2000 * h
    shape = np.exp(-s / tau)
    tooth = np.mean((s - h / 2.0) * (shape - shape.mean())) / h
    expected = (delta - at_begin) * tooth
    assert moments[inside] == pytest.approx(expected[inside], abs=0.07 * np.abs(expected[inside]).max())


def test_steering_that_arrives_evenly_has_no_moment():
    series, late = nominal_drive(), CATALOGUE["steer_delay"]({"delay": 0.013})
    drive = Drive(series.drive.name, series.drive.columns, series.drive.segment, series.period)
    assert replace(series, drive=drive).steer_first_moment(CAR, (late,)) is None
    assert series.steer_first_moment(CAR, (CATALOGUE["steer_gain"]({"gain": 0.9}),)) is None
    assert linearise(CAR, series, (relaxation(0.4),)).of_first_moment(series.steer_first_moment(CAR, (late,))) == 0.0


def test_what_a_rad_adds_is_the_jacobian_times_the_derivative_by_the_steer_angle():
    series, step, h = nominal_drive(), 1e-5, 0.01
    found, at = linearise(CAR, series), (*series.predicted.T, series.torque)
    ahead, behind = (
        np.stack(SingleTrack(CAR).velocity_derivative(*at, series.steer_angle + side * step)) for side in (1.0, -1.0)
    )
    expected = ((ahead - behind) / (2.0 * step)).T
    assert found.by_steer == pytest.approx(expected, rel=1e-5, abs=1e-3)
    moment = np.sin(series.t)
    added = h**2 * np.einsum("nij,nj,n->ni", found.jacobian, expected, moment)[:-1]
    assert found.of_first_moment(moment) == pytest.approx(added, rel=1e-4, abs=1e-7)


@pytest.mark.parametrize("late", [(), (relaxation(0.4),)])
def test_inputs_that_go_on_between_samples_and_late_forces_turn_slowly(late):
    series = nominal_drive()
    drive = Drive(series.drive.name, series.drive.columns, series.drive.segment, series.period)
    continuous = replace(series, drive=drive)
    assert linearise(CAR, continuous, late).to_motion is None
    assert (linearise(CAR, series, late).to_motion is None) == bool(late)


def test_it_is_taken_at_the_commands_that_arrive():
    """Behind a lag and a gain: that of the model without them at such commands."""
    series = nominal_drive()
    acting = (CATALOGUE["steer_lag"]({"tau": 0.2}), CATALOGUE["drive_gain"]({"drive_gain": 0.8, "brake_gain": 0.8}))
    torque, steer = series.inputs(SingleTrack(CAR, acting), series.predicted)
    expected = SingleTrack(CAR).velocity_jacobian(*series.predicted.T, torque, steer)
    assert linearise(CAR, series, acting).jacobian == pytest.approx(expected)
    assert np.abs(linearise(CAR, series).jacobian - expected).max() > 1.0


def test_sensor_faults_are_no_part_of_the_model():
    series, faults = (
        nominal_drive(),
        [CATALOGUE["yaw_rate_bias"]({"bias": 0.1}), CATALOGUE["speed_scale"]({"scale": 1.1})],
    )
    assert np.array_equal(linearise(CAR, series, faults).jacobian, linearise(CAR, series).jacobian)


@pytest.mark.parametrize(
    ("seed", "third", "most"),
    [
        (71, (), 40.0),
        (72, (), 40.0),
        (71, (CATALOGUE["steer_lag"]({"tau": 0.04}),), 40.0),
        (71, (CATALOGUE["steer_delay"]({"delay": 0.013}),), 90.0),
    ],
)
def test_values_are_right_on_rows_about_what_was_found(seed, third, most):
    """About the nominal model the truth costs 1,100 to 1,500 more than other values: both effects err by 3 %."""
    truth = (*BENT, *third)
    series = noisy_series(CAR, truth, seed, "real")
    starts = {one.term: one for one in build_candidates(CAR, series) if one.variant == ""}
    begin = [Part(starts[one.id], starts[one.id].starts[0]) for one in truth]
    case, excess, inertia, rear = gather_case(CAR, [series]), [], [], []
    for one in (case, case.whitened_about(truth)):
        objective = build_objective(one.real, None, one.discrepancy, one.keep)
        fit = fit_parts(objective, begin)
        stiffer, slower = (part.term.parameters for part in fit.parts[:2])
        rear.append(stiffer["rear_scale"] / 1.3)
        inertia.append(slower["scale"] / 0.85)
        excess.append(objective.cost(truth) - fit.cost)
    assert excess[0] > 1000.0 and abs(rear[0] - 1.0) > 0.025 and abs(inertia[0] - 1.0) > 0.02
    # Three or four parameters would save as much by chance.
    assert excess[1] < most and rear[1] == pytest.approx(1.0, abs=0.012) and inertia[1] == pytest.approx(1.0, abs=0.006)


def test_a_force_that_builds_up_within_a_quarter_of_a_sample_does_so_at_once():
    series = nominal_drive()
    by_length = {length: linearise(CAR, series, (relaxation(length),)) for length in (0.0, 0.03, 0.3)}
    speed = float(np.median(series.predicted[:, 0]))
    assert speed * series.period / 4.0 == pytest.approx(0.05, abs=0.015)  # [m]
    assert by_length[0.0].rate is None and by_length[0.03].rate is None and by_length[0.3].rate is not None
    assert np.array_equal(by_length[0.03].jacobian, by_length[0.3].jacobian)


def test_lateral_forces_alone_build_up():
    """Of v_x' = ... + v_y r and v_y' = ... - v_x r the products answer at once, and so does drag."""
    series = nominal_drive()
    vx, vy, r = series.predicted.T
    zero = np.zeros(len(series))
    drag = -2.0 * CAR.drag_coefficient * vx / CAR.mass
    expected = np.array([[drag, r, vy], [-r, zero, -vx], [zero, zero, zero]]).transpose(2, 0, 1)
    assert linearise(CAR, series, (relaxation(0.4),)).immediate == pytest.approx(expected, abs=1e-6)


def test_a_relaxation_of_the_vehicle_file_counts():
    late = CAR.with_effects(EffectSpec("tire_relaxation", {"length": 0.4}))
    series = nominal_drive()
    own, given = linearise(late, series), linearise(CAR, series, (relaxation(0.4),))
    assert own.immediate == pytest.approx(given.immediate) and own.rate == pytest.approx(given.rate)


def small_series(terms: tuple[Term, ...], seed: int, runs: int = 16) -> Series:
    """Return runs of 6 s of the small car at 2 to 4 m/s, steered and driven at random, with sensor noise, at 100 Hz."""
    rng, step = np.random.default_rng(seed), 2.5e-3
    knots = np.arange(0.0, 6.2, 0.25)
    fine = step * np.arange(2401)
    angle, torque = (
        mean + size * np.array([np.interp(fine, knots, row) for row in rng.normal(0.0, 1.0, (runs, len(knots)))])
        for mean, size in ((0.0, 0.06), (0.06, 0.04))
    )
    zero, speed = np.zeros(runs), rng.uniform(2.0, 4.0, runs)
    state, memory = np.stack([zero, zero, zero, speed, zero, zero], axis=1), None
    path = [state]
    for k in range(0, 2400, 4):
        window, now = slice(k, k + 5), Situation(t=zero + k * step, s=zero, states=memory)
        state, memory = integrate_with_memory(
            SingleTrack(SMALL, terms), state, torque[:, window], angle[:, window], step, situation=now
        )
        path.append(state)
    velocity = np.stack(path, axis=1)[:, :, 3:].reshape(-1, 3)
    velocity = velocity + SMALL_NOISE * rng.standard_normal(velocity.shape)
    columns = dict(zip(("vx", "vy", "r"), velocity.T, strict=True))
    number = np.repeat(np.arange(runs, dtype=np.int32), 601)
    t = np.tile(0.01 * np.arange(601), runs) + 7.0 * number
    commands = {"t": t, "T": torque[:, ::4].ravel(), "delta": angle[:, ::4].ravel()}
    drive = Drive("small.parquet", {**commands, **columns}, number, 0.01)
    return build_series(drive, "sim", np.cumsum(0.01 * columns["vx"]))


def test_noise_shortens_no_relaxation_length():
    """With forces that answer to noise at once the mean of these drives is 0.142 m."""
    found = []
    for seed in (51, 52, 53):
        series = small_series((relaxation(0.12),), seed)
        case = gather_case(SMALL, [series, replace(series, role="real")])
        shared = {one.id: one for one in case.discrepancy.shared_terms}
        found.append(shared["tire_relaxation"].parameters["length"])
    assert np.mean(found) == pytest.approx(0.12, rel=0.13)


@pytest.mark.parametrize("seed", [61, 62, 63])
def test_a_length_that_only_reality_has_costs_least_where_it_is(seed):
    """Linearised with the nominal model the least cost is at 0.095 to 0.100 m, and 0.92 or 1.05 of the yaw inertia."""
    series = replace(small_series((relaxation(0.12),), seed), role="real")
    case = gather_case(SMALL, [series])
    objective = build_objective(case.real, None, case.discrepancy, case.keep)
    lengths, scales, inertia = np.linspace(0.06, 0.18, 25), np.linspace(0.9, 1.1, 41), CATALOGUE["yaw_inertia"]
    costs = [objective.cost((relaxation(length),)) for length in lengths]
    assert lengths[int(np.argmin(costs))] == pytest.approx(0.12, abs=0.011)
    costs = [objective.cost((relaxation(0.12), inertia({"scale": scale}))) for scale in scales]
    assert scales[int(np.argmin(costs))] == pytest.approx(1.0, abs=0.03)


def test_rows_of_the_right_model_are_of_unit_variance():
    series = small_series((relaxation(0.12),), 54)
    discrepancy = replace(build_shared_discrepancy(SMALL, series), shared_terms=(relaxation(0.12),))
    rows = gather_evidence(SMALL, series, discrepancy).nominal_rows
    # 2,400 rows: a variance is known to 3 %; the predictions' error enters, too.
    assert np.var(rows, axis=0) == pytest.approx([1.0, 1.0, 1.0], abs=0.2)


def test_slopes_are_the_jacobian_of_what_is_added():
    series, stiffer = nominal_drive(), (CATALOGUE["tire_stiffness"]({"front_scale": 1.6, "rear_scale": 1.3}),)
    at = (*series.predicted.T, series.torque, series.steer_angle)
    exact = [SingleTrack(CAR, terms).velocity_jacobian(*at) for terms in (stiffer, ())]

    def added(one: Series) -> np.ndarray:
        here = (*one.predicted.T, one.torque, one.steer_angle)
        rates = (SingleTrack(CAR, terms).velocity_derivative(*here) for terms in (stiffer, ()))
        return np.subtract(*(np.stack(one, axis=1) for one in rates))

    found = slopes(added, series)
    np.testing.assert_allclose(found, exact[0] - exact[1], atol=1e-5 * np.abs(exact[0]).max())


def test_what_the_simulation_adds_is_part_of_the_linearisation():
    """The nominal tyres are too soft by three fifths. A simulation without noise teaches nearly all of it."""
    stiffer = (CATALOGUE["tire_stiffness"]({"front_scale": 1.6, "rear_scale": 1.6}),)
    (one,) = case_of(recorded(drive(2, stiffer), 2), drive(1, stiffer)).real
    at = (*one.series.predicted.T, one.series.torque, one.series.steer_angle)
    truth, nominal = (SingleTrack(road_car(), terms).velocity_jacobian(*at) for terms in (stiffer, ()))
    wrong, now = (np.sqrt(np.mean((jacobian - truth) ** 2)) for jacobian in (nominal, one.linear.jacobian))
    assert now < 0.15 * wrong
