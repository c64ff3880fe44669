"""Which terms are named: planted ones, against a search of every subset, and what must not be named."""

from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np
import pytest

import split_cli.diagnosis.search.forward as forward
import split_cli.diagnosis.search.selection as selecting
from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise_of
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, without_parts
from split_cli.diagnosis.search.forward import other_beginnings
from split_cli.diagnosis.search.selection import Selection, nothing
from split_cli.diagnosis.search.term_tests import term_size
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import (
    INFLATION,
    NAMES,
    candidates_of,
    driven,
    explorer,
    first_order,
    late,
    named,
    noisy_objective,
    objective_with,
    planted,
    selected,
)


def behind(inputs: np.ndarray, step: float, *, tau: float = 0.0, delay: float = 0.0) -> np.ndarray:
    """Return inputs (runs, K) behind a lag or a delay."""
    return first_order(inputs, tau, step) if tau else late(inputs, delay, step)


def test_nothing_is_named_where_nothing_is_planted(nominal_objective):
    selection = selected(nominal_objective, *NAMES, "mass")
    assert not selection.terms and not selection.rivals
    assert selection.first_p > 0.01
    assert selection.chosen.cost == pytest.approx(nominal_objective.cost(()), rel=1e-12)


def test_a_single_is_named():
    objective = objective_with(*planted(steer_gain=0.9))
    selection = selected(objective, *NAMES)
    assert named(selection) == {"steer_gain"}
    assert selection.first_p < 1e-10
    assert selection.chosen.terms[0].parameters["gain"] == pytest.approx(0.9, abs=0.005)


def test_a_pair_is_named_as_a_search_of_every_subset_would(pair, chosen_pair):
    candidates = candidates_of(pair, *NAMES)
    fits = [nothing(pair)] + [
        fit_parts(pair, [Part(one, dict(one.starts[0])) for one in several])
        for size in (1, 2, 3)
        for several in combinations(candidates, size)
    ]
    best = min(fits, key=Explorer(pair, (), INFLATION).price)
    assert set(best.names) == named(chosen_pair) == {"yaw_inertia", "aero_drag"}
    # Where the fits stop, 0.02 are left at most.
    assert chosen_pair.chosen.cost == pytest.approx(best.cost, abs=0.05)


def test_rivals_are_in_the_place_of_one_part_and_sorted(pair, chosen_pair):
    fit = chosen_pair.chosen
    for own, rivals, rest in zip(fit.parts, chosen_pair.rivals, chosen_pair.without, strict=True):
        others = {part.candidate.term for part in fit.parts} - {own.candidate.term}
        taken = [rival.fit.parts[-1].candidate.term for rival in rivals]
        assert own.candidate.term not in taken and not others & set(taken)
        left_out = set(NAMES) - {own.candidate.term} - others - set(taken)
        assert len(taken) >= STANDARD.selection.considered - 1 and len(set(taken)) == len(taken)
        # Who is left out saves less than half of what the part saves.
        for one in candidates_of(pair, *left_out) if left_out else ():
            costs = [fit_parts(pair, (*rest.parts, Part(one, dict(start)))).cost for start in one.starts]
            assert rest.cost - min(costs) < 0.5 * (rest.cost - fit.cost)
        assert all({part.candidate.term for part in rival.fit.parts[:-1]} == others for rival in rivals)
        excess = [rival.excess for rival in rivals]
        assert excess == sorted(excess) and excess[0] > 0.0
        for rival in rivals:
            dearer = rival.fit.complexity - fit.complexity
            expected = (rival.fit.cost - fit.cost) / INFLATION + STANDARD.selection.price * dearer
            assert rival.excess == pytest.approx(expected, rel=1e-9)


def test_too_small_to_name_is_kept_as_a_nuisance_and_the_search_goes_on():
    """60 N of resistance are seen before all else, since a constant adds up, but are below the noise of a step."""
    terms = planted(rolling_resistance=60.0, yaw_inertia=1.03)
    objective = objective_with(*terms)
    evidence = objective.evidence[0]
    assert (
        effects_to_noise_of(evidence, evidence.at, terms[:1]).max()
        < 0.09
        < effects_to_noise_of(evidence, evidence.at, terms[1:]).max()
    )
    candidates = candidates_of(objective, "rolling_resistance", "yaw_inertia", "steer_gain")
    first = explorer(objective, *candidates)(nothing(objective))[0]
    assert first.names == ("rolling_resistance",)
    selection = selected(objective, *candidates)
    assert named(selection) == {"yaw_inertia"}
    assert selection.chosen.names == ("rolling_resistance", "yaw_inertia")
    assert [bool(rivals) for rivals in selection.rivals] == list(selection.named)
    # What is kept as a nuisance takes nothing from what is named.
    values = {part.candidate.term: part.values for part in selection.chosen.parts}
    assert selection.terms[0].parameters == values["yaw_inertia"]
    assert values["yaw_inertia"]["scale"] == pytest.approx(1.03, abs=0.004)
    assert values["rolling_resistance"]["force"] == pytest.approx(60.0, abs=6.0)


def test_the_search_goes_on_beside_a_term_that_saves_in_a_few_moments(monkeypatch):
    """What is missing bends savings block by block: it stays if a further term is believed beside it alone."""
    objective = objective_with(*planted(steer_gain=0.95, yaw_inertia=1.12, aero_drag=0.5))
    candidates = candidates_of(objective, "steer_gain", "yaw_inertia", "aero_drag")

    def explorer(*names: str) -> Explorer:
        return Explorer(objective, tuple(one for one in candidates if one.term in names), INFLATION)

    base, everything = nothing(objective), explorer("steer_gain", "yaw_inertia", "aero_drag")
    begun = everything(base)[0]
    first, second = begun.names[0], everything(begun)[0].parts[-1].candidate.term

    def often(objective, fit, k, *rest):
        return fit.parts[k].candidate.term != second and second in fit.names

    monkeypatch.setattr(forward, "is_spread", often)
    found = forward.search_forward(everything, base, begun=begun)
    assert set(found.chosen.names) == {"steer_gain", "yaw_inertia", "aero_drag"} and found.names == 2
    assert second in found.history[0] and "a few moments" in found.history[0]
    # Nothing else to tell: it is refused as before, and does not end beside the others.
    alone = forward.search_forward(explorer(first, second), base, begun=begun)
    assert alone.chosen is begun and alone.with_refused.names == tuple(sorted((first, second)))
    assert alone.names == 1 and len(alone.history) == 1 and "would save" in alone.history[0]


def test_a_fast_effect_is_seen_beside_a_slow_one_of_ten_thousand_times_its_cost():
    """What is constant adds up over minutes; a car that turns later does not, and is no model-form error of it."""
    objective = objective_with(*planted(yaw_inertia=1.05, rolling_resistance=1500.0))
    selection = selected(objective, "yaw_inertia", "rolling_resistance")
    assert named(selection) == {"yaw_inertia", "rolling_resistance"}
    saved = {
        part.candidate.term: without.cost - selection.chosen.cost
        for part, without in zip(selection.chosen.parts, selection.without, strict=True)
    }
    assert saved["rolling_resistance"] > 1e3 * saved["yaw_inertia"]


def test_a_refused_term_stands_beside_what_is_named_where_it_saves_more_than_form_error():
    """10 N along the car are too small to be reported, and save a twentieth of what a steering gain does."""
    for force, nuisances in ((10.0, True), (1.0, False)):
        objective = objective_with(*planted(steer_gain=0.95, rolling_resistance=force))
        selection = selected(objective, *NAMES)
        assert named(selection) == {"steer_gain"}
        parts = [part.candidate.term for part in selection.chosen.parts]
        assert parts == ["steer_gain", *["rolling_resistance"] * nuisances]
        assert selection.named == (True, *[False] * nuisances)
        if nuisances:
            assert selection.chosen.parts[1].values["force"] == pytest.approx(force, abs=2.0)
            assert selection.history[-1] == "rolling_resistance kept as a nuisance"
            rivals = [rival.fit for rival in selection.rivals[0]]
            assert rivals and all("rolling_resistance" in fit.names for fit in rivals)


def test_names_are_given_in_the_order_of_size_not_of_finding():
    """A little steering offset, found before a third of the inertia more, is its model-form error all the same."""
    objective = objective_with(*planted(yaw_inertia=1.33, steer_offset=0.00035))
    candidates = {one.term: one for one in candidates_of(objective, "yaw_inertia", "steer_offset")}
    parts = [Part(candidates[name], dict(candidates[name].starts[0])) for name in ("steer_offset", "yaw_inertia")]
    explore = Explorer(objective, tuple(candidates.values()), INFLATION)
    for ordered, expected in ((parts, (False, True)), (parts[::-1], (True, False))):
        fit = fit_parts(objective, ordered)
        without = without_parts(objective, nothing(objective), fit)
        assert selecting._named_together(explore, fit, without, (True, True)) == expected
        # What is not sure is no name, and nothing is a model-form error of it.
        backwards = expected[::-1]
        assert selecting._named_together(explore, fit, without, backwards) == backwards


def test_two_terms_are_found_behind_one_that_is_the_best_alone():
    """Steering that lags and torque that comes late look like late sensors before they are told apart."""
    objective = objective_with(steer=partial(behind, tau=0.05), torque=partial(behind, delay=0.12))
    candidates = candidates_of(objective, "drive_lag", "drive_delay", "steer_lag", "steer_delay", "sensor_delay")
    first = explorer(objective, *candidates)(nothing(objective))[0]
    assert first.names == ("sensor_delay",)
    selection = selected(objective, *candidates)
    assert named(selection) == {"steer_lag", "drive_delay"}
    values = {part.candidate.term: part.values for part in selection.chosen.parts}
    assert values["steer_lag"]["tau"] == pytest.approx(0.05, rel=0.03)
    assert values["drive_delay"]["delay"] == pytest.approx(0.12, rel=0.03)


def test_two_terms_that_hide_each_other_are_found_beside_a_third(monkeypatch):
    """Steering that turns more and a stiffer differential: one at a time, two others stand for them."""
    true = {
        "steer_offset": {"offset": 0.01},
        "steer_gain": {"gain": 1.08},
        "yaw_moment_differential": {"yaw_damping": 2500.0},
    }
    objective = noisy_objective(driven(43, [CATALOGUE[term](values) for term, values in true.items()]), 3)
    tried = candidates_of(objective, *true, "cg_shift", "tire_stiffness", "yaw_inertia", "aero_downforce")
    explore = explorer(objective, *(one for one in tried if "slip" not in one.variant))  # the coupling is a weak one
    base = nothing(objective)
    found = forward.search_forward(explore, base, explore(base)).chosen
    assert set(found.names) == set(true)
    for part in found.parts:
        for name, value in true[part.candidate.term].items():
            assert part.values[name] == pytest.approx(value, rel=0.02)
    monkeypatch.setattr(forward, "hidden_pair", lambda explore, chosen, best: None)
    one_by_one = forward.search_forward(explore, base, explore(base)).chosen
    assert "steer_gain" not in one_by_one.names and one_by_one.cost > found.cost + 1000.0


def test_two_that_cancel_to_what_either_gets_wrong_are_no_pair():
    """Steering that arrives 40 ms late and is logged 38 ms late, where it is 2 ms late, beside a drag."""
    objective = noisy_objective(driven(43, [CATALOGUE["aero_drag"]({"drag": 0.5})]), 3)
    own = {one.term: one for one in candidates_of(objective, "aero_drag", "steer_delay", "steer_signal_delay")}

    def cancels(logged_late: float) -> bool:
        values = {
            "aero_drag": {"drag": 0.5},
            "steer_delay": {"delay": 0.04},
            "steer_signal_delay": {"delay": logged_late},
        }
        parts = tuple(Part(own[term], each) for term, each in values.items())
        return forward.cancel(objective, Fit(parts, 0.0, np.zeros(1), np.empty((1, 0))))

    assert cancels(0.038) and not cancels(0.02)


def test_one_term_is_preferred_to_two_that_say_the_same():
    """Late sensors are late steering and late torque at once; nothing tells them apart but their number."""
    objective = objective_with(steer=partial(behind, delay=0.012), torque=partial(behind, delay=0.012))
    candidates = candidates_of(objective, "drive_delay", "steer_delay", "sensor_delay")
    assert named(selected(objective, *candidates)) == {"sensor_delay"}


def test_other_beginnings_are_other_terms_that_save_nearly_as_much(pair):
    first = Explorer(pair, candidates_of(pair, *NAMES), INFLATION)(nothing(pair))
    everything = replace(STANDARD.selection, fair_share=1.0, beginnings=9)
    assert other_beginnings(first, nothing(pair), everything) == first[1:]
    assert len(other_beginnings(first, nothing(pair), replace(everything, beginnings=2))) == 2
    saved = nothing(pair).cost - first[0].cost
    for share in (0.05, 0.5):
        told = other_beginnings(first, nothing(pair), replace(everything, fair_share=share))
        assert told == [fit for fit in first[1:] if nothing(pair).cost - fit.cost > (1.0 - share) * saved]


@pytest.fixture(scope="module")
def moved() -> tuple[MarginalLikelihood, Selection]:
    """A centre of gravity that is 4 cm further ahead, gently driven: stiffness follows load, or it does not."""
    objective = objective_with(CATALOGUE["cg_shift"]({"dx": 0.04}, "degressive"))
    return objective, selected(objective, "cg_shift")


def test_siblings_are_the_other_variants_in_the_same_place(moved):
    objective, selection = moved
    assert named(selection) == {"cg_shift"} and not selection.rivals[0]
    own = selection.chosen.parts[0].candidate.variant
    told = {rival.fit.parts[-1].candidate.variant for rival in selection.siblings[0]}
    assert told == {"", "loaded", "degressive"} - {own}
    for rival in selection.siblings[0]:
        expected = (rival.fit.cost - selection.chosen.cost) / INFLATION
        assert rival.excess == pytest.approx(expected, rel=1e-9)


def test_two_nuisances_that_share_an_effect_become_one_name():
    objective = objective_with(steer=partial(behind, tau=0.03))
    lag, delay = candidates_of(objective, "steer_lag", "steer_delay")
    explore, base = Explorer(objective, (lag, delay), INFLATION), nothing(objective)
    both = fit_parts(objective, [Part(one, dict(one.starts[0])) for one in (lag, delay)])
    shared = selecting._examined(explore, base, both)
    history: list[str] = []
    alone = selecting._settled_nuisances(explore, replace(shared, named=(False, False)), history)
    assert named(alone) == {"steer_lag"} and "steer_delay gives way" in history[0]
    assert selecting._settled_nuisances(explore, alone, []) is alone


def test_a_name_that_is_none_without_a_nuisance_leaves_with_it(pair):
    parts = [Part(one, dict(one.starts[0])) for one in candidates_of(pair, *NAMES[:4])]
    explore, base = Explorer(pair, tuple(part.candidate for part in parts), INFLATION), nothing(pair)
    true = [part.candidate.term in ("yaw_inertia", "aero_drag") for part in parts]
    leaning = tuple(part.candidate.term != "rolling_resistance" for part in parts)
    selection, history = selecting._examined(explore, base, fit_parts(pair, parts)), []
    settled = selecting._settled_nuisances(explore, replace(selection, named=leaning), history)
    assert named(settled) == set(settled.chosen.names) == {"yaw_inertia", "aero_drag"}
    assert history == ["rolling_resistance leaves with steer_gain, of no name without it"]
    # Names that need none of the nuisances keep these.
    whole = replace(selection, named=tuple(true))
    assert selecting._settled_nuisances(explore, whole, []) is whole


def test_size_of_a_term_is_told_with_the_others_in_place(pair, chosen_pair):
    """Drag and inertia act apart: each is as large as alone."""
    fit = chosen_pair.chosen
    for k, term in enumerate(fit.terms):
        alone = effects_to_noise_of(pair.evidence[0], pair.evidence[0].at, (term,)).max()
        assert term_size(pair, fit, k) == pytest.approx(alone, rel=1e-6)


def test_what_wants_more_than_makes_sense_is_not_named():
    """Where the search ends before the truth, a value at its end stands for something else."""
    objective = noisy_objective(driven(31, (CATALOGUE["yaw_inertia"]({"scale": 0.78}),)), 7)
    (candidate,) = candidates_of(objective, "yaw_inertia")
    assert [one.id for one in selected(objective, candidate).terms] == ["yaw_inertia"]
    short = replace(candidate, ranges={"scale": replace(candidate.ranges["scale"], lower=0.9)})
    selection = selected(objective, short)
    assert selection.terms == () and len(selection.chosen.parts) == 1 and selection.first_p < 1e-6  # it stays
