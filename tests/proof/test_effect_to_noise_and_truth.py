"""Sizes are found for an effect-to-noise ratio, truths by fitting paired runs, and cases lie in their tiers."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.proof.cases import build_case
from split_cli.proof.concealed import CONCEALED
from split_cli.proof.plan import MIXED, TIERS, CasePlan, plan_case
from split_cli.proof.truth import (
    ExactDrive,
    Unreachable,
    error_to_noise,
    fit_effective,
    model_gain,
    removed_share,
    search_size,
)
from split_cli.proof.windows import FIRST, HORIZON, errors_of_terms
from split_cli.vehicle.effects import CATALOGUE


@pytest.fixture(scope="module")
def case():
    return build_case(CasePlan(3, 0, "single", ("steer_gain",), "realistic", *TIERS["realistic"]))


def test_effect_to_noise_of_an_error_is_its_rms_over_that_of_a_noise_difference():
    noise = np.array([0.01, 0.02, 0.001])
    error = np.zeros((4, 3))
    error[:, 1] = [0.03, -0.03, 0.03, -0.03]
    # rms 0.03 over sqrt(2) x 0.02; the other channels are silent.
    assert error_to_noise(error, noise) == pytest.approx(0.03 / (np.sqrt(2.0) * 0.02))


@pytest.mark.parametrize("power", [0.5, 1.0, 2.0])
def test_a_size_is_found_for_any_power_law(power):
    found = search_size(lambda size: 3.0 * size**power, 0.01, 10.0, 0.6)
    assert found.effect_to_noise == pytest.approx(0.6, rel=0.08)
    assert 3.0 * found.size**power == pytest.approx(found.effect_to_noise)


def test_a_dead_zone_and_a_lost_car_do_not_stop_the_search():
    def measure(size: float) -> float:
        if size > 0.5:
            raise SplitError("the car spun")
        return max(size - 0.1, 0.0)

    assert search_size(measure, 0.02, 2.0, 0.3).effect_to_noise == pytest.approx(0.3, rel=0.08)


def test_what_no_size_reaches_is_said_to_be_unreachable():
    with pytest.raises(Unreachable):
        search_size(lambda size: 0.1 * size, 0.5, 1.0, 1.0)


def test_a_case_lies_in_its_tier_and_its_truth_explains_it(case):
    low, high = TIERS["realistic"]
    assert low <= case.answer.total_effect_to_noise <= high
    (effect,) = case.answer.effects
    # A gain of the steering is the same physics in both models: the term must remove all but the tyre's build-up.
    assert case.answer.removed > 0.97
    assert effect.parameters["gain"] == pytest.approx(1.0 + np.sign(effect.parameters["gain"] - 1.0) * effect.size)


def test_drives_of_a_case_hide_what_is_in_them(case):
    for drive in filter(None, (case.real, case.sim)):
        assert drive.name in ("real", "sim")
        assert set(drive.columns) == {"t", "X", "Y", "yaw", "vx", "vy", "r", "ax", "ay", "T", "delta"}
    assert case.vehicle.name == "car" and not case.vehicle.effects


def test_the_real_drive_holds_the_noise_that_effects_are_measured_by(case):
    from split_cli.logs.assembling.noise import difference_noise

    for name, sigma in zip(("vx", "vy", "r"), case.noise, strict=True):
        # Third differences of some 8,000 samples are known to 2 %; motion adds a little.
        assert difference_noise(case.real[name], [(0, len(case.real))]) == pytest.approx(sigma, rel=0.08)


@pytest.mark.parametrize(
    ("term", "parameters"),
    [
        ("friction_scale", {"scale": 0.93}),
        ("tire_stiffness", {"front_scale": 0.95, "rear_scale": 1.04}),
        ("rolling_resistance", {"force": 60.0}),
        ("tire_relaxation", {"length": 0.3}),
        ("yaw_moment_differential", {"yaw_damping": 400.0}),
    ],
)
def test_effective_parameters_are_those_that_made_the_gap(case, term, parameters):
    # A gap made by the term itself has an exact answer, which least squares must return.
    kind = CATALOGUE[term]
    unknown = ExactDrive(case.heldout.columns, np.zeros_like(case.heldout.error))
    gap = model_gain(unknown, case.vehicle, [kind(parameters)])
    exact = replace(unknown, error=gap)
    found = fit_effective(exact, case.vehicle, term, {}, case.noise)
    for name, value in parameters.items():
        assert found[name] == pytest.approx(value, rel=1e-3)
    assert removed_share(exact, case.vehicle, [kind(found)], case.noise) > 0.9999


def test_removed_share_is_none_without_terms_and_negative_for_harm(case):
    exact = case.heldout
    gain = case.answer.effects[0].parameters["gain"]
    wrong = CATALOGUE["steer_gain"]({"gain": 2.0 - gain})
    assert removed_share(exact, case.vehicle, [], case.noise) == 0.0
    # The opposite gain doubles the gap: 1 - 2^2.
    assert removed_share(exact, case.vehicle, [wrong], case.noise) == pytest.approx(-3.0, abs=0.2)


def test_windows_do_not_overlap_and_begin_where_the_plant_s_do(case):
    columns = case.heldout.columns
    errors = errors_of_terms(columns, case.vehicle, ())
    assert abs(len(errors) - len(case.heldout.error)) <= 1
    assert len(errors) == (len(columns["t"]) - 1 - round(FIRST * 100)) // round(HORIZON * 100)


def test_plans_keep_their_proportions_and_go_round_all_terms():
    plans = [plan_case(5, number) for number in range(200)]
    share = {kind: sum(p.kind == kind for p in plans) for kind in MIXED}
    assert share == {"null": 70, "single": 80, "pair": 20, "strange": 30}
    singles = [p for p in plans if p.kind == "single"]
    assert {p.terms[0] for p in singles} == set(CONCEALED)
    assert {p.tier for p in singles} == set(TIERS)
    assert all(plan_case(5, p.number) == p for p in plans[:20])


def test_pairs_are_never_declared_to_look_alike():
    for number in range(300):
        plan = plan_case(6, number, ("pair",))
        first, second = plan.terms
        for one, other in ((first, second), (second, first)):
            assert all(other not in mimic.terms.split("+") for mimic in CATALOGUE[one].mimics)


@pytest.mark.parametrize("seed", [1000, 999_999, -1])
def test_seeds_between_development_and_report_are_refused(seed):
    with pytest.raises(SplitError, match="seed"):
        plan_case(seed, 0)
