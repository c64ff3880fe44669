"""Sets of effects in a nominal car: its equations with the true terms leave nothing but noise."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.proof import sets
from split_cli.proof.outcome import Named, Statement
from split_cli.proof.plan import CasePlan, plan_case
from split_cli.proof.scoring import score_case, score_of_cases
from split_cli.proof.windows import errors_of_terms
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import read_vehicle

HELD = ("T", "delta")


def test_sets_have_three_to_five_terms_that_are_not_declared_alike():
    for number in range(40):
        plan = plan_case(9, number, ("set", "nominal-set"))
        assert plan.kind == ("set", "nominal-set")[number % 2]
        assert 3 <= len(set(plan.terms)) == len(plan.terms) <= 5
        for term in plan.terms:
            alike = {name for mimic in CATALOGUE[term].mimics for name in mimic.terms.split("+")}
            assert not alike & (set(plan.terms) - {term})


def test_the_scripted_car_obeys_its_equations_with_the_terms_and_not_without():
    """Held commands, drag and a sensor ahead of its place: predicted over 0.05 s to what RK4 leaves."""
    car = replace(read_vehicle(library_path("genesis")), effects=())
    terms = [CATALOGUE["aero_drag"]({"drag": 0.5}), CATALOGUE["sensor_lever_arm"]({"dx": 0.3})]
    columns = sets.scripted_drive(car, terms, 3, runs=1, seconds=6.0)
    columns = {**columns, "s": np.zeros(len(columns["t"]))}
    clock = Recording.single(0.01, len(columns["t"]))
    true = terms[1].correct(columns, clock)
    left = errors_of_terms(true, car, terms[:1], held=HELD)
    without = errors_of_terms(true, car, (), held=HELD)
    assert np.abs(left).max() < 1e-5
    assert np.abs(without).max() > 1e3 * np.abs(left).max()


def test_a_set_is_scored_by_effects_by_strange_names_and_whole():
    plan = CasePlan(9, 0, "nominal-set", ("aero_drag", "steer_offset", "mass"), "", 0.35, 1.0)
    case = sets.build_nominal_set(plan)
    assert {effect.term for effect in case.answer.effects} == set(plan.terms)
    assert all(0.25 < effect.effect_to_noise < 1.4 for effect in case.answer.effects)
    assert case.real.held == HELD

    def rates(*findings: Named) -> dict[str, float]:
        said = Statement("mismatch", findings)
        scored = score_case("1", case.answer, said, None, case.noise, case.vehicle)
        return {what: rate.share for what, _, rate, _ in score_of_cases([scored]).targets if what.startswith("sets")}

    some = rates(Named("aero_drag"), Named("yaw_inertia"))
    assert list(some.values()) == pytest.approx([1.0 / 3.0, 0.5, 0.0])
    whole = rates(Named("aero_drag"), Named("steer_offset"), Named("drive_gain", {}, ("mass",)))
    assert list(whole.values()) == pytest.approx([1.0, 0.0, 1.0])


def test_hard_pairs_are_pairs_of_small_effects():
    plans = [plan_case(9, number, ("pair", "hard-pair")) for number in range(12)]
    hard = [plan for plan in plans if plan.kind == "hard-pair"]
    assert len(hard) == 4 and {plan.kind for plan in plans} == {"pair", "hard-pair"}
    assert all((plan.low, plan.high) == (0.12, 0.35) and len(set(plan.terms)) == 2 for plan in hard)


def test_no_set_has_what_no_real_car_has():
    """By hand: I_z/(m l_f l_r) of the Genesis is 1.05, and 1.3 is the most; a grip of 5.6 is beyond any tyre."""
    car = read_vehicle(library_path("genesis"))

    def possible(term: str, **values: float) -> bool:
        return sets._is_possible(car, CATALOGUE[term](values))

    assert possible("yaw_inertia", scale=1.2) and not possible("yaw_inertia", scale=1.3)
    assert possible("mass", scale=0.83) and not possible("mass", scale=0.78)
    assert possible("friction_scale", scale=1.2) and not possible("friction_scale", scale=5.6)
