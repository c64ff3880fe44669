"""What a silence is worth: effects of the told size, and of others, planted and searched for."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Fit, Part, tangent
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import over_allowance
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.verdict.detectable import detection_limits
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import INFLATION, LEVEL, candidates_of, driven, faulty, late, noisy_objective, selected

NAMES = ("steer_gain", "aero_drag", "yaw_inertia", "steer_delay", "sensor_misalignment")


def objective_of(*terms) -> MarginalLikelihood:
    return noisy_objective(driven(31, terms), 7)


def smallest(objective: MarginalLikelihood, *objectives: MarginalLikelihood) -> dict[str, Detectable]:
    found = detection_limits((objective, *objectives), candidates_of(objective, *NAMES), INFLATION, LEVEL)
    return {one.term: one for one in found}


def named(objective: MarginalLikelihood) -> list[str]:
    selection = selected(objective, *NAMES)
    return [one.id for one in selection.terms]


@pytest.fixture(scope="module")
def sound() -> MarginalLikelihood:
    return objective_of()


@pytest.fixture(scope="module")
def told(sound) -> dict[str, Detectable]:
    return smallest(sound)


def test_every_term_is_told_once_with_units(told):
    assert sorted(told) == sorted(NAMES)
    for term, one in told.items():
        assert {name: unit for name, (_, unit) in one.parameters.items()} == dict(CATALOGUE[term].units)


@pytest.mark.parametrize("name", NAMES[:3])
def test_half_as_much_again_is_named_and_half_of_it_is_not(told, name):
    kind = CATALOGUE[name]
    ((parameter, (value, _)),) = told[name].parameters.items()
    neutral = kind.neutral[parameter]
    for share, expected in ((1.5, [name]), (0.5, [])):
        objective = objective_of(kind({parameter: neutral + share * (value - neutral)}, ""))
        assert named(objective) == expected


def test_so_it_is_with_a_delay_which_is_not_in_proportion_and_with_a_sensor(told):
    delay, angle = told["steer_delay"].parameters["delay"][0], told["sensor_misalignment"].parameters["angle"][0]
    for share, expected in ((1.5, True), (0.5, False)):
        behind = driven(31, steer=lambda inputs, step, by=share * delay: late(inputs, by, step))
        turned = faulty(driven(31), angle=share * angle)
        assert (named(noisy_objective(behind, 7)) == ["steer_delay"]) == expected
        assert (named(noisy_objective(turned, 7)) == ["sensor_misalignment"]) == expected


def test_beside_a_name_a_size_is_told_by_what_the_name_cannot_take_up(told):
    """Half as much again beside a named gain is named, too, and half of it is not; drag is as alone."""
    gain = CATALOGUE["steer_gain"]({"gain": 0.9}, "")
    objective = objective_of(gain)
    candidates = candidates_of(objective, *NAMES)
    chosen = selected(objective, *candidates).chosen
    found = detection_limits((objective,), candidates, INFLATION, LEVEL, named=chosen.parts)
    beside = {one.term: one.parameters for one in found}
    assert "steer_gain" not in beside and "steer_gain" in told  # its interval says how well it is known
    alone, value = told["yaw_inertia"].parameters["scale"][0], beside["yaw_inertia"]["scale"][0]
    assert abs(value - 1.0) > 1.2 * abs(alone - 1.0)
    drag = told["aero_drag"].parameters["drag"][0]
    assert beside["aero_drag"]["drag"][0] == pytest.approx(drag, rel=0.3)
    for share, expected in ((1.5, ["steer_gain", "yaw_inertia"]), (0.5, ["steer_gain"])):
        inertia = CATALOGUE["yaw_inertia"]({"scale": 1.0 + share * (value - 1.0)}, "")
        assert sorted(named(objective_of(gain, inertia))) == expected


def test_beside_a_name_recordings_that_show_what_was_reckoned_pass_at_once():
    """A size that is just over the model-form error of the named gain had been grown until none was told."""
    objective = objective_of(CATALOGUE["steer_gain"]({"gain": 0.9}, ""))
    chosen = selected(objective, "steer_gain").chosen
    asked = []

    def planted(objective: MarginalLikelihood, term: Term, others: Sequence[Term]) -> tuple[float, float]:
        asked.append(term)
        rows = [objective.whiten(objective.raw_residual(terms)) for terms in (others, (*others, term))]
        return float(np.sum((rows[1] - rows[0]) ** 2)), over_allowance(objective, (*others, term), tuple(others))

    candidates = candidates_of(objective, "steer_offset", "drive_gain", "drive_delay")
    ways = (None, planted)
    limits = [detection_limits((objective,), candidates, INFLATION, LEVEL, way, chosen.parts) for way in ways]
    for without, grown in zip(*limits, strict=True):
        assert grown.parameters and grown.parameters.keys() == without.parameters.keys()
        for name, (value, _) in grown.parameters.items():
            neutral = CATALOGUE[grown.term].neutral[name]
            assert value - neutral == pytest.approx(without.parameters[name][0] - neutral, rel=0.1)
    assert len(asked) < 25


def test_form_error_asks_for_more(sound, told):
    for form_error, factor, most in ((20.0, 1.0, 0), (2000.0, 1.4, 2)):
        found = smallest(replace(sound, form_error_inflation=form_error)).items()
        # Of the largest model-form error an interval may not be free at any size that a car has.
        assert sum(not one.parameters for _, one in found) <= most
        for term, one in ((term, one) for term, one in found if one.parameters):
            ((parameter, (value, _)),) = one.parameters.items()
            neutral = CATALOGUE[term].neutral[parameter]
            assert abs(value - neutral) > factor * abs(told[term].parameters[parameter][0] - neutral)


def test_what_alters_inputs_is_told_by_the_last_objective(sound, told):
    """More model-form error with a fixed baseline asks more of a steering gain; drag comes of the first."""
    both = smallest(sound, replace(sound, fixed_baseline=True, form_error_inflation=20.0))
    assert both["aero_drag"] == told["aero_drag"] and both["yaw_inertia"] == told["yaw_inertia"]
    assert 1.0 - both["steer_gain"].parameters["gain"][0] > 1.2 * (1.0 - told["steer_gain"].parameters["gain"][0])


def test_a_size_that_is_told_has_an_interval_without_no_effect(sound):
    """Model-form error widens the intervals of all that acts on tyres: with 0.45 of a size it takes 0.9 of it."""
    vague = replace(sound, policy=sound.policy.altered("selection", form_error_share=0.45))
    candidates = candidates_of(vague, *NAMES)
    for one in detection_limits((vague,), candidates, INFLATION, LEVEL):
        for name, (value, _) in one.parameters.items():
            own = next(one_way for one_way in candidates if one_way.term == one.term and {*one_way.ranges} == {name})
            part = Part(own, {name: value})
            slopes = tangent(vague, vague.raw_residual(()), part).slopes / own.ranges[name].step
            residuals = nothing(vague).residuals
            fit = Fit((part,), float(residuals @ residuals), residuals, slopes)
            low, high = parameter_estimates(vague, fit, recorded=False)[0][name].interval_95
            assert not low <= CATALOGUE[one.term].neutral[name] <= high
    # With 0.6 of it no size of what acts on tyres is apart from none.
    hopeless = replace(sound, policy=sound.policy.altered("selection", form_error_share=0.6))
    assert not smallest(hopeless)["steer_gain"].parameters and CATALOGUE["steer_gain"].through_tires


def test_what_is_told_holds_for_every_variant(sound):
    candidates = candidates_of(sound, "cg_shift")
    assert len(candidates) == 3

    def dx(*some) -> float:
        (one,) = detection_limits((sound,), some, INFLATION, LEVEL * len(some))
        return one.parameters["dx"][0]

    each = [dx(one) for one in candidates]
    assert dx(*candidates) == max(each) > 2.0 * min(each)


def test_each_parameter_is_told_as_if_it_were_there_alone(sound):
    """Softer front tyres alone take more to be seen than both axles' tyres, and as much as is told is named."""
    candidates = candidates_of(sound, "tire_stiffness", *NAMES)
    found = {one.term: one.parameters for one in detection_limits((sound,), candidates, INFLATION, LEVEL)}
    assert set(found["tire_stiffness"]) == {"front_scale", "rear_scale"}
    told = found["tire_stiffness"]["front_scale"][0]
    for share, expected in ((1.5, ["tire_stiffness"]), (0.5, [])):
        values = {"front_scale": 1.0 + share * (told - 1.0), "rear_scale": 1.0}
        objective = objective_of(CATALOGUE["tire_stiffness"](values, ""))
        selection = selected(objective, "tire_stiffness", *NAMES)
        assert [one.id for one in selection.terms] == expected


def test_an_effect_that_would_have_to_be_larger_than_any_is_told_at_no_size(sound):
    deaf = replace(sound, form_error_inflation=1e9)
    assert all(not one.parameters for one in smallest(deaf).values())


def test_more_noise_hides_more():
    quiet, loud = (smallest(noisy_objective(driven(31), 7, disturbance=level)) for level in (1e-8, 1e-2))
    for name in ("steer_gain", "yaw_inertia"):
        (key,) = quiet[name].parameters
        away = [abs(one[name].parameters[key][0] - CATALOGUE[name].neutral[key]) for one in (quiet, loud)]
        assert np.log(away[1] / away[0]) > 0.1
