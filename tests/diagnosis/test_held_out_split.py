"""What findings explain of the time kept out: shares known from each effect alone."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, build_objective
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.statement.result import Finding, ParameterEstimate
from split_cli.diagnosis.verdict.held_out_judgement import fit_without_held_out
from split_cli.diagnosis.verdict.held_out_split import HeldOut, explained_by, explained_shares, fitted_alone, hold_out
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import bare_objective, candidates_of, driven, light_evidence, noisy, prepared
from tests.factories import road_car

PAIR = CATALOGUE["aero_drag"]({"drag": 0.5}), CATALOGUE["yaw_inertia"]({"scale": 1.15})


def evidence_of(seed: int, *terms):
    return light_evidence(prepared(noisy(driven(seed, terms, runs=12), seed)))


def split_of(evidence, others=(), share: float = 0.25) -> HeldOut:
    every = [np.ones(len(one.at), dtype=bool) for one in (evidence, *others)]
    discrepancy = bare_objective(evidence).discrepancy
    policy = STANDARD.altered("comparison", holdout_share=share)
    return hold_out([evidence], every[:1], list(others), every[1:], None, discrepancy, (), policy)


def fitted(objective: MarginalLikelihood, *terms: str):
    parts = [Part(one, dict(one.starts[0])) for one in candidates_of(objective, *terms) if not one.variant]
    return fit_parts(objective, sorted(parts, key=lambda part: terms.index(part.candidate.term)))


@pytest.fixture(scope="module")
def paired():
    return evidence_of(51, *PAIR)


def test_the_last_time_is_kept_out_and_nothing_is_in_both(paired):
    split = split_of(paired)
    (training,), (testing,), (mask,) = split.training.keep, split.testing.keep, split.masks
    t = paired.series.t
    np.testing.assert_array_equal(mask, t > 0.75 * t[-1])
    assert not np.any(training & testing) and np.all(training | testing)
    assert paired.series.t[paired.at][training].max() <= 0.75 * t[-1] < paired.series.t[paired.at][testing].min()


def test_shares_of_a_pair_are_those_of_each_effect_alone(paired):
    """Drag is seen in v_x and inertia in r: what either explains is what it does alone."""
    split = split_of(paired)
    fit = fitted(split.training, "aero_drag", "yaw_inertia")
    shares = explained_shares(split, fit)
    testing = split.testing
    base = testing.residual(())
    alone = np.array([float(np.sum((testing.residual((term,)) - base) ** 2)) for term in PAIR])
    assert 0.05 < alone[0] / alone.sum() < 0.95
    # What is left after both is noise; the floor takes it off, known to some percent of what effects do.
    np.testing.assert_allclose(shares, alone / alone.sum(), atol=0.04)
    assert explained_by(split, fit, fit.terms) == pytest.approx(1.0, abs=0.04)
    assert explained_by(split, fit, fit.terms[:1]) == pytest.approx(shares[0], abs=0.04)
    assert explained_by(split, fit, ()) is None


def test_names_explain_what_they_take_by_themselves_though_a_nameless_part_could_take_it(paired):
    """Rolling resistance can stand for most of the drag: removed last, the drag seems to explain little of it."""
    split = split_of(paired)
    fit = fitted(split.training, "aero_drag", "rolling_resistance", "yaw_inertia")
    drag_last, _, inertia_last = explained_shares(split, fit)
    named = fitted_alone(split.training, fit, (True, False, True), (drag_of(0.5, 0.2, 0.8), inertia_of(1.12)))
    terms = tuple(part.term for part in named)
    assert explained_by(split, fit, terms) == pytest.approx(1.0, abs=0.04)
    assert drag_last + inertia_last < 0.9


def drag_of(value: float, low: float, high: float) -> Finding:
    told = {"drag": ParameterEstimate(value, 0.1, "N/(m/s)^2", (low, high))}
    return Finding("aero_drag", "", told, 0.5, (), "Said.", 1.0)


def inertia_of(value: float) -> Finding:
    told = {"scale": ParameterEstimate(value, 0.01, "1", (value - 0.05, value + 0.05))}
    return Finding("yaw_inertia", "", told, 0.5, (), "Said.", 1.0)


def test_a_name_alone_takes_what_it_explains_most_with_within_its_interval(paired):
    """Beside a rolling resistance that has no name, drag has another value than by itself, as a parabola has."""
    training = split_of(paired).training
    fit = fitted(training, "aero_drag", "rolling_resistance")
    best = fitted(training, "aero_drag").parts[0].values["drag"]
    joint = fit.parts[0].values["drag"]
    assert abs(joint - best) > 1e-3

    def alone(finding: Finding, named=(True, False)) -> float:
        return fitted_alone(training, fit, named, [finding])[0].values["drag"]

    assert alone(drag_of(joint, 0.0, 2.0)) == pytest.approx(best, rel=1e-3)
    assert alone(drag_of(joint, 0.0, 0.8 * best)) == pytest.approx(0.8 * best)
    assert alone(drag_of(0.0, -1.0, 1.0)) == 0.0  # which the drive does not show
    assert alone(drag_of(joint, 0.0, 2.0), (True, True)) == joint
    assert fitted_alone(training, fit, (False, False), []) == ()


def test_shares_are_of_what_is_above_the_noise():
    """A gain of a hundredth is a fraction of the noise, and explains all that there is to explain."""
    split = split_of(evidence_of(54, CATALOGUE["steer_gain"]({"gain": 0.985})))
    fit = fitted(split.training, "steer_gain")
    testing = split.testing
    saved = testing.cost(()) - testing.cost(fit.terms)
    assert 0.02 < saved / testing.cost(()) < 0.5
    (share,) = explained_shares(split, fit)
    assert share > 0.8


def test_half_of_a_pair_explains_its_half_only(paired):
    split = split_of(paired)
    both = explained_shares(split, fitted(split.training, "aero_drag", "yaw_inertia"))
    (one,) = explained_shares(split, fitted(split.training, "aero_drag"))
    assert one == pytest.approx(both[0], abs=0.04)


def test_a_wrong_term_explains_nothing(paired):
    split = split_of(paired)
    shares = explained_shares(split, fitted(split.training, "aero_drag", "yaw_inertia", "steer_offset"))
    assert shares[2] < 0.01 and shares[0] > 0.05 and shares[1] > 0.05


def test_a_term_that_fits_the_training_time_only_explains_nothing():
    """Grip that was lost, but only before the time kept out: shares are of that time."""
    lost, early = CATALOGUE["friction_scale"]({"scale": 0.85}), driven(52, runs=12)
    slippery = driven(52, (lost,), runs=12)
    before = early["t"] <= 0.75 * early["t"][-1]
    columns = {name: np.where(before, slippery[name], early[name]) for name in early.columns}
    drive = type(early)(early.name, columns, early.segment, early.period)
    split = split_of(light_evidence(prepared(noisy(drive, 3))))
    fit = fitted(split.training, "friction_scale")
    assert fit.terms[0].parameters["scale"] == pytest.approx(0.85, abs=0.02)
    assert explained_shares(split, fit) == (0.0,)


def test_recordings_named_for_it_are_kept_out_whole(paired):
    other = evidence_of(53, *PAIR)
    split = split_of(paired, [other])
    assert split.training.keep[0].all() and not split.masks[0].any()
    assert split.testing.evidence == (other,)
    shares = explained_shares(split, fitted(split.training, "aero_drag", "yaw_inertia"))
    assert sum(shares) == pytest.approx(1.0, abs=0.05)


def test_nothing_is_said_where_too_little_is_kept_out(paired):
    # 70 s hold some 1,500 rows of 0.04 s; 62 are asked for.
    split = split_of(paired, share=0.01)
    assert split.testing is None
    assert explained_shares(split, fitted(split.training, "aero_drag")) is None
    assert explained_shares(split_of(paired), nothing(split.training)) is None


def test_what_is_held_out_is_judged_with_the_fast_signal_of_a_late_channel():
    """Four samples late: what smoothing takes for noise of the yaw rate is as late as the rest."""
    reality = noisy(driven(71, runs=8, seconds=8.0), 71)
    late = np.concatenate([np.r_[[reality["r"][run][0]] * 4, reality["r"][run][:-4]] for run in reality.segments()])
    case = gather_case(road_car(), [prepared(replace(reality, columns={**reality.columns, "r": late}))])
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep, case.kinematics)
    one = next(one for one in candidates_of(objective, "channel_delay") if one.variant == "r")
    whole = fit_parts(objective, [Part(one, {"r": 0.04})])
    parted, moved = (
        fit_without_held_out(each, objective, whole, STANDARD) for each in (case, case.judged_with_residue())
    )
    assert moved.trained.parts[0].values["r"] == pytest.approx(0.04, abs=0.003)
    assert moved.trained.parts[0].values == parted.trained.parts[0].values  # no try of a fit moves noise
    costs = [one.split.testing.cost(one.trained.terms) for one in (parted, moved)]
    assert costs[1] < 0.9 * costs[0]
    assert moved.split.testing.cost(()) == parted.split.testing.cost(())
    errors = [one.improvement(one.trained.terms) for one in (parted, moved)]
    assert errors[0].before == errors[1].before
    beyond = [one.physics[2] ** 2 - one.noise_floor[2] ** 2 for one in errors]
    assert 0.0 < beyond[1] < 0.6 * beyond[0]
