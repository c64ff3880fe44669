"""Standard errors and intervals against replicates: what the noise really does to an estimate."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import term_size
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Range
from tests.diagnosis.recordings import candidates_of, driven, noisy_objective

REPLICATES = 64
TRUTH = {"scale": 1.1}


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Thirty seconds of a car whose yaw inertia is a tenth more."""
    return driven(41, (CATALOGUE["yaw_inertia"](TRUTH),), runs=6)


def by_chance(objective: MarginalLikelihood) -> MarginalLikelihood:
    """Return an objective under whose policy parameters have no systematic error."""
    exact = STANDARD.altered("reporting", systematic=0.0).altered("selection", form_error_share=0.0)
    return replace(objective, policy=exact)


def fitted(objective: MarginalLikelihood, term: str, values: dict[str, float]) -> Fit:
    (one, *_) = candidates_of(objective, term)
    return fit_parts(objective, [Part(one, dict(values))])


@pytest.fixture(scope="module")
def replicated(drive):
    """Values, standard errors and intervals, (REPLICATES,) each, and the last judge; systematic error left out."""
    out = []
    for seed in range(REPLICATES):
        objective = by_chance(noisy_objective(drive, 1000 + seed))
        (one,) = parameter_estimates(objective, fitted(objective, "yaw_inertia", TRUTH))
        out.append((one["scale"].value, one["scale"].std_error, *one["scale"].interval_95))
    return np.array(out)


def test_intervals_hold_the_truth_as_often_as_they_say(replicated):
    _, _, low, high = replicated.T
    held = np.mean((low <= TRUTH["scale"]) & (TRUTH["scale"] <= high))
    # Binomial deviation of 95 % in 64: 2.7 %. Above, the larger of two estimates of the variance is taken.
    assert 0.85 <= held <= 1.0


def test_the_standard_error_is_that_of_replicates(replicated):
    values, errors, low, high = replicated.T
    # Known to 9 % from 64; the sandwich over 18 blocks, or the curvature where that is more, lies above by some.
    assert 0.8 < np.mean(errors) / np.std(values, ddof=1) < 1.5
    assert np.all((low < values) & (values < high))
    # Student's t for 17 degrees of freedom.
    np.testing.assert_allclose((high - low) / errors, 2.0 * 2.1098, rtol=1e-4)


def test_the_truth_is_in_the_mean(replicated):
    values = replicated[:, 0]
    # Integration may take some thousandths of the inertia, a fiftieth of what it has more.
    assert np.mean(values) == pytest.approx(TRUTH["scale"], abs=2e-3)


def test_four_times_the_time_halves_the_error():
    errors = []
    for runs in (6, 24):
        objective = noisy_objective(driven(42, (CATALOGUE["yaw_inertia"](TRUTH),), runs=runs), 5)
        (one,) = parameter_estimates(objective, fitted(objective, "yaw_inertia", TRUTH))
        size = term_size(objective, fitted(objective, "yaw_inertia", TRUTH), 0)
        systematic = STANDARD.reporting.systematic * 0.1 / size
        errors.append(np.sqrt(one["scale"].std_error ** 2 - systematic**2))
    # Runs differ in what they excite; the sandwich is known to a tenth or two.
    assert errors[0] / errors[1] == pytest.approx(2.0, rel=0.35)


def test_both_parameters_of_a_pair_lie_in_their_intervals():
    truth = {"front_scale": 0.9, "rear_scale": 1.08}
    drive, held = driven(43, (CATALOGUE["tire_stiffness"](truth),), runs=8), []
    for seed in range(20):
        objective = noisy_objective(drive, seed)
        (one,) = parameter_estimates(objective, fitted(objective, "tire_stiffness", truth))
        held += [one[name].interval_95[0] <= truth[name] <= one[name].interval_95[1] for name in truth]
    # Forty: three misses too many would be 92 %; 85 % is four deviations from 95 %.
    assert np.mean(held) >= 0.85


def test_the_covariance_is_a_bootstrap_over_blocks(drive):
    """Blocks drawn again and again, the estimate moved by one Newton step: the deviation of that."""
    objective = noisy_objective(drive, 3)
    fit = fitted(objective, "yaw_inertia", TRUTH)
    # Twice the noise in every third block: curvature alone would not know.
    louder = np.where(objective.block % 3 == 0, 3.0, 1.0)
    fit = replace(fit, residuals=fit.residuals * louder)
    information = objective.block_sums(fit.sensitivity**2)[:, 0]
    scores = objective.block_sums(fit.sensitivity * fit.residuals[:, None])[:, 0]
    rng, blocks = np.random.default_rng(1), len(scores)
    draws = rng.integers(0, blocks, (4000, blocks))
    moved = -scores[draws].sum(axis=1) / information.sum()
    size = term_size(objective, fit, 0)
    (one,) = parameter_estimates(objective, fit)
    chance = np.sqrt(
        one["scale"].std_error ** 2 - (STANDARD.reporting.systematic * (one["scale"].value - 1.0) / size) ** 2
    )
    # A sandwich takes the scores' mean for zero, as it is at a fit's end; with these residuals it is not quite.
    expected = np.sqrt(np.mean(moved**2))
    mean = abs(scores.sum()) / information.sum()
    expected = np.sqrt(max(expected**2 - mean**2, 0.0) + mean**2 / blocks)
    assert chance == pytest.approx(expected * np.sqrt(blocks / (blocks - 1)), rel=0.05)
    assert chance > 1.3 / np.sqrt(information.sum())


def test_parameters_that_lean_against_each_other_are_known_as_a_bootstrap_says():
    """Front and rear stiffness: what one has too much the other makes up for, in every block alike."""
    truth = {"front_scale": 0.9, "rear_scale": 1.08}
    objective = noisy_objective(driven(43, (CATALOGUE["tire_stiffness"](truth),), runs=8), 2)
    fit = fitted(objective, "tire_stiffness", truth)
    louder = np.where(objective.block % 3 == 0, 3.0, 1.0)
    fit = replace(fit, residuals=fit.residuals * louder)
    J = fit.sensitivity
    correlation = np.linalg.inv(J.T @ J)
    assert abs(correlation[0, 1]) > 0.5 * np.sqrt(correlation[0, 0] * correlation[1, 1])
    scores = objective.block_sums(J * fit.residuals[:, None])
    scores -= scores.mean(axis=0)
    blocks = len(scores)
    draws = np.random.default_rng(1).integers(0, blocks, (4000, blocks))
    moved = -np.linalg.solve(J.T @ J, scores[draws].sum(axis=1).T)
    (told,) = parameter_estimates(by_chance(objective), fit)
    for name, expected in zip(("front_scale", "rear_scale"), moved.std(axis=1), strict=True):
        # Two parameters of some twenty blocks, and a mean that is not quite zero: a tenth or two.
        assert told[name].std_error == pytest.approx(expected, rel=0.2)


@pytest.fixture(scope="module")
def patched() -> tuple[MarginalLikelihood, Fit]:
    """A patch of 90 m on a lap of 400 m, driven over by twelve runs that begin anywhere."""
    truth = {"scale": 0.8, "s_start": 120.0, "s_end": 210.0}
    objective = noisy_objective(driven(44, (CATALOGUE["friction_patch"](truth),), runs=12), 6)
    (one,) = (each for each in candidates_of(objective, "friction_patch") if not each.variant)
    return objective, fit_parts(objective, [Part(one, dict(truth))])


@pytest.mark.parametrize(("name", "truth"), [("s_start", 120.0), ("s_end", 210.0)])
def test_an_end_of_a_stretch_is_known_as_far_as_the_cost_says(patched, name, truth):
    objective, fit = patched
    (told,) = parameter_estimates(objective, fit)
    low, high = told[name].interval_95
    assert low <= truth <= high and high - low < 60.0
    (part,) = fit.parts
    rise = 3.84 * 1.0
    places = np.arange(max(low - 20.0, 0.0), high + 20.0, 0.4)
    costs = np.array([objective.cost((Part(part.candidate, {**part.values, name: place}).term,)) for place in places])
    inside = places[costs <= fit.cost + rise]
    # The rise is that of one parameter at 95 %, or more where blocks say so: never a smaller interval than this.
    step = part.candidate.ranges[name].step
    assert low <= inside.min() + step and high >= inside.max() - step
    # Outside of the interval nothing is as good as that.
    assert costs[(places < low - step) | (places > high + step)].min() > fit.cost + rise


def test_systematic_error_is_a_share_of_the_effect(drive):
    """With next to no chance left, what is called the same in a car and a single track still is not exactly."""
    objective = noisy_objective(drive, 4)
    fit = fitted(objective, "yaw_inertia", TRUTH)
    certain = replace(fit, sensitivity=1e6 * fit.sensitivity)
    (one,) = parameter_estimates(objective, certain)
    away = one["scale"].value - 1.0
    assert one["scale"].std_error == pytest.approx(
        STANDARD.reporting.systematic * away / term_size(objective, fit, 0), rel=1e-3
    )


def test_form_error_widens_chance_and_systematic_error_by_its_root(drive):
    objective = noisy_objective(drive, 4)
    fit = fitted(objective, "yaw_inertia", TRUTH)
    (own,), (wide,) = (
        parameter_estimates(one, fit) for one in (objective, replace(objective, form_error_inflation=25.0))
    )
    away, size = wide["scale"].value - 1.0, term_size(objective, fit, 0)
    systematic = 5.0 * STANDARD.reporting.systematic * away / size
    chance = np.sqrt(wide["scale"].std_error ** 2 - systematic**2)
    assert chance == pytest.approx(5.0 / np.sqrt(np.sum(fit.sensitivity**2)), rel=1e-6)
    assert own["scale"].std_error < wide["scale"].std_error
    # Blocks that vary by more than that already tell it.
    (same,) = parameter_estimates(replace(objective, form_error_inflation=1e-3), fit)
    assert same["scale"].std_error == own["scale"].std_error


def test_no_parameters_no_estimates(nominal_objective):
    assert parameter_estimates(nominal_objective, nothing(nominal_objective)) == ()


def test_an_interval_ends_where_no_real_car_lies_beyond(drive):
    objective = noisy_objective(drive, 3)
    fit = fitted(objective, "yaw_inertia", TRUTH)
    physical = fit.parts[0].candidate.ranges["scale"]
    (known,) = parameter_estimates(objective, fit)
    assert physical.lower < known["scale"].interval_95[0] < known["scale"].interval_95[1] < physical.upper
    # With noise that hides the car altogether the data say nothing, and what a car can have is what is left.
    (unknown,) = parameter_estimates(objective, replace(fit, residuals=fit.residuals * 3000.0))
    assert unknown["scale"].interval_95 == (physical.lower, physical.upper)
    assert unknown["scale"].std_error > physical.upper - physical.lower


def test_of_brakes_that_are_not_used_nothing_is_known():
    """A car that never brakes, with weak driving torque: the brakes' gain moves no row."""
    weak = driven(47, (CATALOGUE["drive_gain"]({"drive_gain": 0.8, "brake_gain": 1.0}),), runs=6)
    objective = noisy_objective(replace(weak, columns={**weak.columns, "T": np.abs(weak["T"])}), 5)
    fit = fitted(objective, "drive_gain", {"drive_gain": 0.8, "brake_gain": 0.88})
    (told,) = parameter_estimates(objective, fit)
    physical = fit.parts[0].candidate.ranges["brake_gain"]
    assert told["brake_gain"].value == 1.0
    assert told["brake_gain"].interval_95 == (physical.lower, physical.upper)
    low, high = told["drive_gain"].interval_95
    assert 0.0 < high - low < 0.5
    weak_drive = ParameterEstimate(0.8, 0.02, "1", (0.76, 0.84))
    said = CATALOGUE["drive_gain"].statement({**told, "drive_gain": weak_drive})
    assert said.endswith("too weak (95 %: 16.0 to 24.0 %); of braking torque the drive tells nothing")


def test_intervals_hold_what_halves_of_the_simulation_differ_by(drive):
    """A saving of a quarter of its own is half its size: a deviation of half of what it is away from no effect."""
    objective = by_chance(noisy_objective(drive, 7))
    fit = fitted(objective, "yaw_inertia", TRUTH)
    alone = parameter_estimates(objective, fit)[0]["scale"]
    saved = nothing(objective).cost - fit.cost
    beside = replace(objective, self_test_savings={"yaw_inertia": 0.25 * saved})
    wide = parameter_estimates(beside, fitted(beside, "yaw_inertia", TRUTH))[0]["scale"]
    expected = np.hypot(alone.std_error, 0.5 * (alone.value - 1.0))
    # Costs are no parabola in a ratio, by its square, and what is saved holds some noise.
    assert wide.std_error == pytest.approx(expected, rel=0.15)


@pytest.mark.parametrize(("runs", "is_open"), [(6, False), (2, True)])
def test_an_axle_that_is_nearly_locked_has_a_least_damping_and_perhaps_no_largest(runs, is_open):
    """Far from an open axle more damping changes next to nothing, so that the cost is no parabola."""
    truth = {"yaw_damping": 1e5, "slip_stiffness": 0.1}
    locked = CATALOGUE["yaw_moment_differential"](truth, "slip")
    objective = by_chance(noisy_objective(driven(45, (locked,), runs=runs), 6))
    (one,) = (each for each in candidates_of(objective, "yaw_moment_differential") if each.variant == "slip")
    fit = fit_parts(objective, [Part(one, dict(truth))])
    (estimates,) = parameter_estimates(objective, fit)
    value, (low, high) = estimates["yaw_damping"].value, estimates["yaw_damping"].interval_95
    assert low <= truth["yaw_damping"] <= high
    assert (high == one.ranges["yaw_damping"].upper) == is_open

    def rise(damping: float) -> float:
        """Return by how much the cost rises, with the other parameter fitted again."""
        fixed = {**one.ranges, "yaw_damping": Range(damping * (1 - 1e-9), damping * (1 + 1e-9), 1e-9 * damping)}
        again = fit_parts(
            objective, [Part(replace(one, ranges=fixed), {**fit.parts[0].values, "yaw_damping": damping})]
        )
        return again.cost - fit.cost

    # One parameter at 95 %, or more where blocks of time say so.
    assert rise(low) > 3.84
    if is_open:
        assert low > 0.2 * value
    else:
        assert rise(high) == pytest.approx(rise(low), rel=0.1)
        assert high - value > 1.3 * (value - low)
