"""What every term would add: promises against fits, and nothing worked out twice."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, build_objective
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.exploration import Explorer, nearest_start, repeats_a_delay
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, sensitivity_of, tangent
from split_cli.diagnosis.search.selection import nothing
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import (
    INFLATION,
    candidates_of,
    driven,
    explorer,
    late,
    noisy,
    noisy_objective,
    prepared,
)
from tests.factories import road_car

NAMES = ("aero_drag", "rolling_resistance", "steer_gain", "yaw_inertia", "tire_stiffness", "steer_lag")


@pytest.fixture(scope="module")
def objective() -> MarginalLikelihood:
    terms = (CATALOGUE["yaw_inertia"]({"scale": 1.12}), CATALOGUE["aero_drag"]({"drag": 0.5}))
    return noisy_objective(driven(21, terms), 5)


@pytest.fixture(scope="module")
def explore(objective) -> Explorer:
    return explorer(objective, *NAMES)


@pytest.fixture(scope="module")
def current(objective) -> Fit:
    (drag,) = candidates_of(objective, "aero_drag")
    return fit_parts(objective, [Part(drag, dict(drag.starts[0]))])


def label(fit: Fit) -> str:
    return fit.parts[-1].candidate.label


def test_the_price_of_a_parameter_is_counted_after_variance_inflation(objective, current):
    assert current.complexity == 1.0
    dear = replace(objective, policy=STANDARD.altered("selection", price=5.0))
    assert Explorer(dear, (), 2.0).price(current) == pytest.approx(0.5 * current.cost + 5.0)


def test_a_term_is_offered_once(explore, current):
    """Neither a term that is in, nor the same variant from two starts."""
    fits = explore(current)
    told = [label(fit) for fit in fits]
    assert sorted(told) == sorted({*NAMES} - {"aero_drag"})
    costs = [explore.price(fit) for fit in fits]
    assert costs == sorted(costs)


def test_what_was_explored_is_not_explored_again(objective, explore, current):
    """The same terms fitted again from elsewhere are the same explanation; with other values they are not."""
    fits = explore(current)
    (drag,) = candidates_of(objective, "aero_drag")
    assert explore(fit_parts(objective, [Part(drag, {"drag": 2.0})])) is fits
    bad = Fit(current.parts, current.cost + 10.0, current.residuals, current.sensitivity)
    assert explore(bad) is not fits
    assert explore(nothing(objective)) is not fits


def test_what_promises_too_little_is_fitted_only_among_the_first(objective, current):
    fresh = explorer(objective, *NAMES)
    first = fresh(current, worth=0.0)
    assert len(first) == fresh.rules.considered < len(NAMES) - 1
    fits = fresh(current)
    assert [fit.cost for fit in first] == pytest.approx([fit.cost for fit in fits[: len(first)]], abs=0.05)
    # Who wants fewer than there are gets all.
    assert fresh(current, worth=0.5 * current.cost) is fits


def test_promises_beside_another_term_are_close_to_fits(objective, explore, current):
    """Tangents are taken without the other term: of what a term saves they miss a few hundredths."""
    for fit in explore(current):
        starts = [Part(fit.parts[-1].candidate, dict(start)) for start in fit.parts[-1].candidate.starts]
        promised = min(tangent(objective, objective.residual(()), part).cost(current) for part in starts)
        saved = current.cost - fit.cost
        assert current.cost - promised == pytest.approx(saved, rel=0.1, abs=2.0), label(fit)
    best = explore(current)[0]
    assert label(best) == "yaw_inertia" and current.cost - best.cost > 100.0
    assert np.all(np.diff([fit.cost for fit in explore(current)][:2]) > 0.0)


def test_a_late_steering_is_found_beside_a_file_that_is_wrong_by_more():
    """A drive without the fault teaches what the file lacks; held where commands put it, that hides the fault."""
    own = (CATALOGUE["tire_stiffness"]({"front_scale": 0.25, "rear_scale": 0.35}),)
    real = driven(32, own, runs=6, steer=lambda commands, step: late(commands, 0.06, step))
    series = prepared(noisy(real, 2)), prepared(noisy(driven(31, own, runs=6), 1), "sim")
    case = gather_case(road_car(), series)
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep)
    explore = explorer(objective, "steer_delay", "aero_drag")
    found = {label(fit): fit for fit in explore(nothing(objective))}["steer_delay"]
    assert found.parts[0].values["delay"] == pytest.approx(0.06, rel=0.1)
    held = objective.whiten(objective.residual(found.terms))
    assert found.cost < 0.5 * nothing(objective).cost < 0.25 * float(held @ held)


def test_a_relative_starts_where_it_is_as_large(objective):
    (lag,), (delay,) = (candidates_of(objective, name) for name in ("steer_lag", "steer_delay"))
    starts = [one["delay"] for one in delay.starts]
    for tau in (1e-4, 0.006, 0.05, 0.4, 0.0):
        begun = nearest_start(delay, Part(lag, {"tau": tau}))["delay"]
        assert abs(np.log(begun / max(tau, 1e-9))) == min(abs(np.log(value / max(tau, 1e-9))) for value in starts)


def test_a_forgotten_sensitivity_is_worked_out_anew(objective, explore, current):
    """Held or forgotten, explorations are the same; what is worked out anew is what straight lines were."""
    held = explore(current)
    two = sum(fit.residuals.nbytes + fit.sensitivity.nbytes for fit in (current, held[0]))
    lean = Explorer(objective, tuple(candidates_of(objective, *NAMES)), INFLATION, held=two)
    fits = lean(replace(current))
    assert fits[0].sensitivity.size and not any(fit.sensitivity.size for fit in fits[1:])
    assert [fit.cost for fit in fits] == [fit.cost for fit in held]
    there, here = sensitivity_of(objective, fits[1]), held[1].sensitivity
    assert np.linalg.norm(there - here) < 0.02 * np.linalg.norm(here)
    assert fits[1].sensitivity is there
    further = [one(fit)[0] for one, fit in ((explore, held[1]), (lean, fits[1]))]
    assert lean(current) is not fits and [fit.cost for fit in lean(current)] == [fit.cost for fit in held]
    assert further[0].cost == pytest.approx(further[1].cost, abs=0.02)


@pytest.mark.parametrize(
    ("terms", "repeat"),
    [
        (["steer_delay", "steer_signal_delay"], True),  # steering that acts late, and is logged late: their difference
        (["steer_delay", "drive_delay", "sensor_delay"], True),  # three of two commands
        (["sensor_delay", "steer_signal_delay", "steer_delay"], True),
        (["steer_delay", "drive_delay"], False),
        (["sensor_delay", "steer_signal_delay"], False),  # torque and steering, late by unlike times
        (["steer_delay", "steer_lag", "mass", "channel_delay"], False),
        (["steer_delay"], False),
    ],
)
def test_delays_that_say_one_twice(terms, repeat):
    assert repeats_a_delay(terms) == repeat


def test_a_delay_that_is_stated_already_has_no_place_and_no_price():
    """Steering that acted 82 ms late and was logged 80 ms late was named in a car that was late by 2 ms."""
    objective = noisy_objective(driven(31, [CATALOGUE["steer_delay"]({"delay": 0.04})]), 2)
    explore = explorer(objective, "steer_delay", "steer_signal_delay", "drive_delay", "mass")
    acts, logged = (
        Part(one, {"delay": 0.04})
        for one in explore.candidates
        if one.term in ("steer_delay", "steer_signal_delay") and not one.variant
    )
    found = fit_parts(objective, (acts,))
    offered = {fit.parts[-1].candidate.term for fit in explore(found)}
    assert "steer_signal_delay" not in offered and "drive_delay" in offered
    assert explore.price(found) < np.inf and explore.price(replace(found, parts=(acts, logged))) == np.inf
