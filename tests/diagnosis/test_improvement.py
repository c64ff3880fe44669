"""Does it help: rollouts and shares against closed forms, planted terms and the noise that was put in."""

import math
from dataclasses import replace
from typing import ClassVar

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.objective import learn_discrepancy
from split_cli.diagnosis.innovations.rollouts import SharedRates, Stage, roll_out_stages, shared_rates
from split_cli.diagnosis.verdict.improvement import _bootstrap, improvable_removed, measure_improvement
from split_cli.diagnosis.verdict.label_errors import label_errors
from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.scoring.rollouts import roll_out
from split_cli.vehicle.effects import CATALOGUE, Term, build_terms
from split_cli.vehicle.integration import Situation, integrate_recorded
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.diagnosis.recordings import SIGMA, driven, light_evidence, noisy, prepared, recorded
from tests.factories import one_run, road_car

RESISTANCE = CATALOGUE["rolling_resistance"]({"force": 450.0})


class TurnedFromOutside(Term):
    """A constant yaw moment that no tyre lets build up."""

    id = "turned_from_outside"
    units: ClassVar = {"moment": "N m"}

    def external(self, flow):
        """Add the moment."""
        flow.moment = flow.moment + self.parameters["moment"]


@pytest.fixture(scope="module")
def resisted():
    return recorded(11, (RESISTANCE,))


def held_last_quarter(evidence) -> np.ndarray:
    return evidence.series.t > 0.75 * evidence.series.t[-1]


@pytest.fixture(scope="module")
def measured(resisted):
    discrepancy = build_shared_discrepancy(resisted.vehicle, resisted.series)
    return measure_improvement([(resisted, held_last_quarter(resisted))], (RESISTANCE,), discrepancy, None)


class TestPlantedResistance:
    """450 N on 1,500 kg: 0.3 m/s^2 that the simulation does not have, nothing else."""

    def test_before_grows_as_the_force_over_the_mass(self, measured):
        # Drag, the only feedback from speed, changes the loss by 2 c v t/m, some 2 % over 2 s; noise adds squared.
        for one in measured.rollouts:
            expected = math.hypot(0.3 * one.horizon, one.noise_floor[0])
            assert one.before[0] == pytest.approx(expected, rel=0.05)
        assert [one.horizon for one in measured.rollouts] == [0.5, 1.0, 2.0]

    def test_the_true_physics_reaches_the_noise_floor_in_every_channel(self, measured):
        # Rollouts overlap and share the noise of some 20 s: 10 % is two standard errors of an rms, steps of a
        # channel that hardly varies the more.
        for one in measured.rollouts:
            np.testing.assert_allclose(one.physics, one.noise_floor, rtol=0.2)
            for value, (low, high) in zip(one.physics, one.confidence["physics"], strict=True):
                assert low <= value <= high
        np.testing.assert_allclose(measured.physics, measured.noise_floor, rtol=0.12)

    def test_all_that_could_be_improved_is(self, measured):
        # One step of 0.3 m/s^2 is half its noise: the squares of 400 held-out labels are known to 7 %, which is a
        # quarter of what could be improved.
        share, low, high = measured.removed["physics"]
        assert share > 0.6 and low <= share <= high and 0.9 < high <= 1.0
        assert measured.before[0] == pytest.approx(math.hypot(0.3, measured.noise_floor[0]), rel=0.1)

    def test_split_alone_helps_and_beside_the_physics_adds_nothing(self, measured):
        last = measured.rollouts[-1]
        assert last.physics[0] < last.split_only[0] < 0.6 * last.before[0]
        assert last.after[0] < 2.0 * last.noise_floor[0]

    def test_persistence_is_the_velocity_held(self, resisted, measured):
        series, held = resisted.series, held_last_quarter(resisted)
        errors = roll_out_stages(resisted, {"before": Stage((), None)}, held)
        rows = np.searchsorted(series.t, errors.t)
        by_hand = np.square(series.measured[rows + 200] - series.measured[rows])
        np.testing.assert_allclose(errors.squared["persistence"][:, 2], by_hand, rtol=1e-12)
        assert all(np.array_equal(np.square(errors.signed[name]), one) for name, one in errors.squared.items())


def test_no_horizon_fits_into_too_little_held_out_time(resisted):
    held = resisted.series.t > resisted.series.t[-1] - 0.3
    assert roll_out_stages(resisted, {"before": Stage((), None)}, held) is None
    held = resisted.series.t > resisted.series.t[-1] - 1.6
    errors = roll_out_stages(resisted, {"before": Stage((), None)}, held)
    assert errors.horizons == (0.5, 1.0)


def test_nothing_is_told_of_held_out_time_without_a_step(resisted):
    discrepancy = build_shared_discrepancy(resisted.vehicle, resisted.series)
    held = resisted.series.t > resisted.series.t[-1] - 0.025
    assert measure_improvement([(resisted, held)], (RESISTANCE,), discrepancy, None) is None


def test_noise_floor_of_a_right_model_is_its_error(resisted):
    """The nominal car by itself, all runs: the floor counts noise at both ends as the recording has it."""
    plain = recorded(12)
    errors = roll_out_stages(plain, {"before": Stage((), None)}, np.ones(len(plain.series), dtype=bool))
    told, true = np.sqrt(errors.floor.mean(axis=0)), np.sqrt(errors.squared["before"].mean(axis=0))
    # 120 starts, noise estimated from the samples: 7 % of an rms in one standard error.
    np.testing.assert_allclose(told, true, rtol=0.2)
    assert told[0, 0] > SIGMA[0] and np.all(told >= 0.95 * SIGMA)


def test_what_the_simulation_knows_follows_the_model_away_from_the_recording(resisted):
    """Shared rates at another state: their slope against the dictionary evaluated there."""
    discrepancy = build_shared_discrepancy(resisted.vehicle, resisted.series)
    posterior = learn_discrepancy([resisted])
    shared = shared_rates(resisted.series, discrepancy, posterior)
    nuisances = np.array([0.05, 0.01, 0.002])
    moved = replace(resisted.series, predicted=resisted.series.predicted + nuisances)
    there = discrepancy.rates(moved, posterior.weights)
    rows = np.arange(len(nuisances), len(moved), 97)
    told = shared.at(rows, resisted.series.predicted[rows] + nuisances)
    change = np.abs(there[rows] - shared.base[rows]).mean(axis=0)
    # Linear in a small step: what is left is of second order.
    assert np.all(np.abs(told - there[rows]).mean(axis=0) < 0.1 * change)
    # And never more than the recording itself has shown.
    far = shared.at(rows, resisted.series.predicted[rows] + 1e3)
    assert np.all(np.abs(far - shared.base[rows]) <= np.abs(shared.base).max(axis=0) + 1e-12)


def test_knowing_the_resistance_already_leaves_nothing_to_improve():
    """What simulation and reality share is no gap: rollouts with it are at the floor without any term."""
    real, simulated = recorded(13, (RESISTANCE,)), recorded(14, (RESISTANCE,))
    discrepancy = build_shared_discrepancy(simulated.vehicle, simulated.series)
    posterior = learn_discrepancy([simulated])
    shared = shared_rates(real.series, discrepancy, posterior)
    held = np.ones(len(real.series), dtype=bool)
    errors = roll_out_stages(real, {"blind": Stage((), None), "taught": Stage((), shared)}, held)
    blind, taught = (np.sqrt(errors.squared[name][:, 2, 0].mean()) for name in ("blind", "taught"))
    # 0.3 m/s^2 over 2 s; the dictionary is learned from 80 s of noisy data.
    assert blind > 0.55 and taught < 0.15 * blind


def test_a_stretch_of_road_acts_where_it_lies():
    """A climb on 30 to 50 m, integrated in one piece, against rollouts that take the place from the recording."""
    climb = CATALOGUE["road_grade"]({"angle": 0.05, "s_start": 30.0, "s_end": 50.0}, "stretch")
    model, count, period = SingleTrack(road_car(), (climb,)), 401, 0.01
    zeros = np.zeros((1, 2))
    state, s, states, places = np.array([[20.0, 0.0, 0.0]]), 0.0, [[20.0, 0.0, 0.0]], [0.0]
    for _ in range(count - 1):
        after = integrate_recorded(model, state, zeros, zeros, period, 8, Situation(s=s))
        s += 0.5 * period * float(state[0, 0] + after[0, 0])
        state = after
        states.append(state[0])
        places.append(s)
    velocity = np.array(states)
    columns = {"s": np.array(places), **dict(zip(("vx", "vy", "r"), velocity.T, strict=True))}
    drive = one_run(columns, period, "climb")
    starts = np.array([0, 60, 200])
    path = roll_out(model, drive, starts, 40, 5)[:, -1, 0]
    flat = roll_out(SingleTrack(road_car()), drive, starts, 40, 5)[:, -1, 0]
    # Past the stretch (s = 50 m after 2.5 s at 20 m/s) both agree; over it g sin(0.05) acts for a second.
    np.testing.assert_allclose(path, velocity[starts + 200, 0], atol=0.005)
    assert flat[0] - velocity[200, 0] == pytest.approx(9.80665 * 0.05 * 0.5, rel=0.1)


def test_the_right_term_leaves_the_steps_of_the_car_without_the_fault():
    """Steering four samples late at saturated tyres: slip angles of the late command have another stiffness."""
    sound = noisy(driven(23, runs=8, steer=lambda angles, step: 1.8 * angles), 23)
    late = np.concatenate([np.r_[sound["delta"][run][4:], [sound["delta"][run][-1]] * 4] for run in sound.segments()])
    faulty = replace(sound, columns={**sound.columns, "delta": late})  # logged early, so that it acts late
    everything = np.ones(len(sound), dtype=bool)
    term = CATALOGUE["steer_delay"]({"delay": 4.0 * sound.period})
    ours, theirs = (
        label_errors(light_evidence(prepared(one)), terms, None, None, everything)
        for one, terms in ((faulty, (term,)), (sound, ()))
    )
    starts = np.array([run.start for run in sound.segments()])
    inner = (ours.labels.row[:, None] - starts)[:, :, None].min(axis=2)
    inner = np.where(inner >= 0, inner, 10**6).min(axis=1) > 4
    np.testing.assert_array_equal(ours.labels.row, theirs.labels.row)
    told, known = ours.steps("physics", ours.physics)[inner], theirs.steps("before", theirs.before)[inner]
    np.testing.assert_allclose(told, known, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(ours.physics[inner], theirs.before[inner], rtol=0.0, atol=1e-6)
    # Late commands find other slip angles, and Phi there is another one.
    assert np.abs(ours.phi_before - ours.phi_physics)[inner].max() > 0.05
    # Velocities held have no model, and a step's error is what they miss over its length.
    v, rows = theirs.persistence, theirs.labels.row
    series = prepared(sound)
    np.testing.assert_array_equal(v, (series.measured[rows + theirs.labels.window] - series.measured[rows]) / 0.05)


def test_rates_that_are_known_meet_a_tyre_whose_force_builds_up_within_the_step():
    """A yaw moment that the simulation knows, and relaxation that it lacks: both together are the car."""
    relaxation, rate = CATALOGUE["tire_relaxation"]({"length": 0.15}), 0.6  # [m], [rad/s^2]
    car = road_car()
    turned = TurnedFromOutside({"moment": rate * car.yaw_inertia})
    one = light_evidence(prepared(noisy(driven(29, (relaxation, turned), runs=8), 29)))
    count = len(one.series)
    base = np.tile([0.0, 0.0, rate], (count, 1))
    known = SharedRates(base, np.zeros((count, 3, 3)), one.series.smooth)
    everything = np.ones(count, dtype=bool)
    errors = label_errors(one, (relaxation,), known, known, everything)
    steps = errors.steps("physics", errors.physics)
    floor, labels = np.sqrt(errors.floor.mean(axis=0)), np.sqrt(len(steps))
    np.testing.assert_allclose(np.sqrt(np.mean(steps**2, axis=0)), floor, rtol=0.1)
    assert np.all(np.abs(steps.mean(axis=0)) < 4.0 * floor / labels)
    rolled = roll_out_stages(one, {"physics": Stage((relaxation,), known)}, everything, horizons=(0.05, 0.5))
    for k in range(2):
        np.testing.assert_allclose(
            np.sqrt(rolled.squared["physics"][:, k].mean(axis=0)), np.sqrt(rolled.floor[:, k].mean(axis=0)), rtol=0.25
        )


def test_labels_know_where_effects_of_the_vehicle_file_act():
    """A climb in the vehicle file: labels of a drive that brings no s against those of one that does."""
    climb = EffectSpec("road_grade", {"angle": 0.05, "s_start": 50.0, "s_end": 150.0}, "stretch")
    car = road_car(effects=(climb,))
    drive = noisy(driven(21, build_terms(car), runs=8), 21)
    series = prepared(drive)
    bare = replace(drive, columns={name: column for name, column in drive.columns.items() if name != "s"})
    evidence = replace(light_evidence(replace(series, drive=bare)), vehicle=car)
    held = np.ones(len(series), dtype=bool)
    errors = label_errors(evidence, (), None, None, held)
    told = compute_labels(drive, car, Z2)
    np.testing.assert_array_equal(errors.labels.row, told.row[np.isfinite(told.y).all(axis=1)])
    # The same place and time; of the yaw only whole turns and a constant time of start may differ.
    np.testing.assert_allclose(errors.before, told.y[np.isfinite(told.y).all(axis=1)], rtol=0.0, atol=1e-9)
    climbing = (series.s[errors.labels.row] > 55.0) & (series.s[errors.labels.row] < 145.0)
    noise = np.sqrt(errors.floor[:, 0].mean())
    # Without its place the climb of 0.49 m/s^2 would be missed; some 100 labels know their mean well enough.
    assert abs(errors.before[climbing, 0].mean()) < 4.0 * noise / np.sqrt(climbing.sum()) < 0.25


@pytest.mark.parametrize("blocks", [4, 12])
def test_intervals_cover_the_truth_also_from_few_blocks(blocks):
    """Errors of known size, of which blocks differ: 95 % intervals against 300 repetitions."""
    rng = np.random.default_rng(7)
    inside = 0
    for _ in range(300):
        size = np.sqrt(rng.gamma(8.0, 1.0 / 8.0, blocks)).repeat(20)[:, None]
        errors = rng.normal(0.0, 1.0, (20 * blocks, 3)) * size
        stages = {name: errors**2 for name in ("before", "physics", "split_only", "after")}
        intervals, _ = _bootstrap(stages, np.full_like(errors, 0.5), np.arange(20 * blocks) // 20)
        low, high = intervals["before"][0]
        inside += low <= 1.0 <= high
    # Binomial scatter of 300: 1.3 %; percentiles of a skewed mean of four are not exact.
    assert inside / 300 > (0.88 if blocks == 4 else 0.9)


def test_share_of_improvable_error():
    # By hand: (0.09 - 0.04) of (0.09 - 0.01) in one channel; the second was at the floor and has no say.
    assert improvable_removed((0.3, 0.1), (0.2, 0.5), (0.1, 0.1)) == pytest.approx(5.0 / 8.0)
    assert improvable_removed((0.3, 0.1), (0.05, 0.1), (0.1, 0.1)) == 1.0
    assert improvable_removed((0.3,), (0.4,), (0.1,)) < 0.0
    assert math.isnan(improvable_removed((0.1005,), (0.1,), (0.1,)))
    # Weighed by noise: metres and radians count alike once each is reported in its own noise.
    assert improvable_removed((3.0, 0.03), (1.0, 0.03), (1.0, 0.01)) == pytest.approx(0.5)
