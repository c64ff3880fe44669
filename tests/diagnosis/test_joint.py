"""All terms at once: what a search one by one misses is found, and linear costs are those of refits."""

from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, Prior, fit_parts, fit_with_prior
from split_cli.diagnosis.search.joint import (
    _blocks,
    _everything_from,
    _leaving,
    _PartColumns,
    _worth,
    all_at_once,
    cheapest_first,
    estimated_removal_of_several,
    estimated_saving_of_all,
    near_neutral,
    out_of_local_minimum,
    without_needless,
)
from split_cli.diagnosis.search.selection import nothing
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import INFLATION, candidates_of, driven, explorer, late, noisy_objective


def evaluated(objective, parts) -> Fit:
    """Return parts at the values they have, not fitted."""
    residuals = objective.whiten(objective.raw_residual([part.term for part in parts]))
    return Fit(tuple(parts), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))


TRUE = {"aero_drag": {"drag": 0.6}, "yaw_inertia": {"scale": 1.15}, "yaw_moment_differential": {"yaw_damping": 1500.0}}
OTHERS = ("aero_downforce", "tire_stiffness", "friction_scale", "cg_shift", "rolling_resistance", "steer_gain")


@pytest.fixture(scope="module")
def explore() -> Explorer:
    objective = noisy_objective(driven(41, [CATALOGUE[term](values) for term, values in TRUE.items()]), 3)
    # The coupling of the differential is a weak one, which no slip limits.
    return explorer(objective, *(one for one in candidates_of(objective, *TRUE, *OTHERS) if "slip" not in one.variant))


def test_terms_that_a_wrong_beginning_hides_are_found(explore):
    base = nothing(explore.objective)
    wrong = [one for one in explore.candidates if one.term in ("aero_downforce", "cg_shift") and not one.variant]
    begun = fit_parts(explore.objective, [Part(one, dict(one.starts[0])) for one in wrong])
    assert estimated_saving_of_all(explore, begun) > 10.0 * explore.rules.price
    found = all_at_once(explore, base, begun)
    assert set(found.names) >= set(TRUE)
    for part in found.parts:
        for name, value in TRUE.get(part.candidate.term, {}).items():
            assert part.values[name] == pytest.approx(value, rel=0.1)
    assert explore.price(found) < explore.price(begun)
    # What is whole promises no more than chance gives the columns that are tried.
    assert estimated_saving_of_all(explore, found) < 3.0 * explore.rules.price


def test_no_part_hinders_an_explanation_that_is_at_its_least(explore):
    """A fit that ended with a downforce far off costs more than without it; begun again it does not."""
    base, (hinders,) = nothing(explore.objective), candidates_of(explore.objective, "aero_downforce")[:1]
    true = [Part(one, TRUE[one.term]) for one in explore.candidates if one.term in TRUE and not one.variant]
    stuck = evaluated(explore.objective, (*true, Part(hinders, dict(hinders.starts[0]))))
    assert fit_parts(explore.objective, true).cost < stuck.cost
    fit, without = out_of_local_minimum(explore, base, stuck)
    assert fit.cost < stuck.cost and [part.candidate for part in fit.parts] == [p.candidate for p in stuck.parts]
    assert min(one.cost for one in without) > fit.cost - explore.rules.tie * explore.variance_inflation
    least = fit_parts(explore.objective, (*true, near_neutral(stuck.parts[-1])))
    assert fit.cost == pytest.approx(least.cost, rel=1e-3)


def test_a_fit_starts_in_a_minimum_far_from_no_effect():
    """Steering a quarter of a second late: six steps from none do not get there, beside a known delay they do."""
    drag = CATALOGUE["aero_drag"]({"drag": 0.6})
    objective = noisy_objective(driven(41, [drag], steer=lambda inputs, step: late(inputs, 0.25, step)), 3)
    candidates = candidates_of(objective, "steer_delay", "aero_drag", *OTHERS)
    explore, base = Explorer(objective, tuple(candidates), INFLATION), nothing(objective)
    delay = next(one for one in candidates if one.term == "steer_delay")
    begun = fit_parts(objective, [Part(delay, {"delay": 0.25})])
    far, near = (fit_with_prior(objective, *_everything_from(explore, one))[0].cost for one in (base, begun))
    assert far > 10.0 * near
    found = {part.candidate.term: part.values for part in all_at_once(explore, base, begun).parts}
    assert found["steer_delay"]["delay"] == pytest.approx(0.25, abs=0.001)
    assert found["aero_drag"]["drag"] == pytest.approx(0.6, rel=0.02)


def test_linear_costs_of_leaving_are_those_of_refits(explore):
    by_term = {one.term: one for one in reversed(explore.candidates)}
    parts = [Part(by_term[term], dict(values)) for term, values in TRUE.items()]
    fit = fit_parts(explore.objective, parts)
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    slopes = fit.sensitivity * steps
    told = [one for one, _ in _worth(explore, _blocks(fit.parts), slopes.T @ slopes, np.zeros(len(steps)))]
    refitted = [
        (fit_parts(explore.objective, fit.parts[:k] + fit.parts[k + 1 :]).cost - fit.cost) / INFLATION
        - explore.rules.price
        for k in range(len(fit.parts))
    ]
    # Moments act by one over the inertia, of which a straight line at 1.15 has told 1/1.15 by the way to 1.
    told[list(TRUE).index("yaw_inertia")] *= 1.15**2
    assert told == pytest.approx(refitted, rel=0.1)
    assert without_needless(explore, fit).names == fit.names


def test_two_that_share_an_effect_are_each_worth_their_price_and_leave_together():
    """By closed form, all of a quadratic cost: (d^T H d)/V of those that leave, the rest refitted, less prices."""
    H, d = np.array([[50.0, 49.0, 0.3], [49.0, 50.0, -0.2], [0.3, -0.2, 40.0]]), np.array([2.1, -2.1, 3.0])
    part = SimpleNamespace(candidate=SimpleNamespace(complexity=1.0))
    blocks = [_PartColumns(part, np.array([k]), np.array([k]), d[k : k + 1]) for k in range(3)]
    told = SimpleNamespace(variance_inflation=1.0, rules=SimpleNamespace(price=8.0))

    def cost(gone: list[int]) -> float:
        return float(d[gone] @ np.linalg.solve(np.linalg.inv(H)[np.ix_(gone, gone)], d[gone])) - 8.0 * len(gone)

    assert min(cost([0]), cost([1]), cost([2])) > 0.0 > cost([0, 1])
    (first, _), (second, _) = gone = _leaving(told, blocks, H)
    assert {k for _, k in gone} == {0, 1} and first > 0.0
    assert first + second == pytest.approx(cost([0, 1]), rel=1e-6)


def test_what_leaves_together_is_a_refit_away(explore):
    by_term = {one.term: one for one in reversed(explore.candidates)}
    values = {**TRUE, "rolling_resistance": {"force": 20.0}, "steer_gain": {"gain": 1.001}}
    fit = fit_parts(explore.objective, [Part(by_term[term], dict(given)) for term, given in values.items()])
    promised, gone = estimated_removal_of_several(explore, fit)
    rest = fit_parts(explore.objective, [part for k, part in enumerate(fit.parts) if k not in gone], slopes_of=fit)
    assert set(rest.names) == set(TRUE)
    assert promised == pytest.approx(explore.price(rest) - explore.price(fit), abs=0.3)


def test_a_prior_holds_what_the_rows_do_not_tell(explore):
    """A narrow prior keeps a parameter, a wide one leaves it to the rows; curvature adds up."""
    one = next(one for one in explore.candidates if one.term == "yaw_inertia")
    free = fit_parts(explore.objective, [Part(one, {"scale": 1.05})])
    part = Part(one, {"scale": 1.05})
    wide, curvature = fit_with_prior(explore.objective, [part], [{"scale": Prior(1.0, 1e3)}])
    assert wide.parts[0].values["scale"] == pytest.approx(free.parts[0].values["scale"], rel=1e-3)
    deviation = one.ranges["scale"].step / np.sqrt(curvature[0, 0])
    held, both = fit_with_prior(explore.objective, [part], [{"scale": Prior(1.0, deviation)}])
    # A prior as wide as the rows' own deviation takes half of the way, and doubles the curvature.
    middle = 0.5 * (1.0 + free.parts[0].values["scale"])
    assert held.parts[0].values["scale"] == pytest.approx(middle, abs=0.2 * abs(middle - 1.0))
    assert both[0, 0] == pytest.approx(2.0 * curvature[0, 0], rel=0.3)


def test_parts_are_ordered_by_what_leaving_costs(explore):
    by_term = {one.term: one for one in reversed(explore.candidates)}
    none = Part(by_term["rolling_resistance"], {"force": 20.0})
    parts = [Part(by_term[term], dict(values)) for term, values in TRUE.items()]
    fit = fit_parts(explore.objective, [parts[0], none, *parts[1:]])
    order = cheapest_first(explore, fit)
    assert sorted(order) == [0, 1, 2, 3]
    costs = [fit_parts(explore.objective, fit.parts[:k] + fit.parts[k + 1 :]).cost for k in order]
    assert order[0] == 1 and costs[0] == min(costs) and costs[-1] == max(costs)
    assert without_needless(explore, fit).names == tuple(sorted(TRUE))
