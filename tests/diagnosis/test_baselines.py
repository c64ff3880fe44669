"""Readings with a marginalised baseline and with a fixed baseline."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.evidence import integrated
from split_cli.diagnosis.innovations.objective import build_objective
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.search.baselines import (
    SearchOutcome,
    _brings_back,
    ends_beyond,
    reconciled,
    search,
    with_names_of_first,
)
from split_cli.diagnosis.search.candidates import Candidate, build_candidates
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, tangent
from split_cli.diagnosis.search.rivals import Rival
from split_cli.diagnosis.search.selection import Selection
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import INFLATION, case_of, explorer
from tests.diagnosis.test_self_test import drive, recorded
from tests.factories import road_car


def term(name: str, **values: float) -> Term:
    kind = CATALOGUE[name]
    return kind({**{key: kind.neutral[key] for key in kind.units}, **values}, "")


def commanded(drive: Drive, gain: float) -> Drive:
    """Return a drive as a steering of that gain would have been commanded for the same motion."""
    return replace(drive, columns={**drive.columns, "delta": drive["delta"] / gain})


def unsteady(seed: int) -> Drive:
    """Return a drive of a car whose grip comes and goes, which no function of the moment holds."""
    plain, slippery = drive(seed), drive(seed, (term("friction_scale", scale=0.5),))
    columns = {name: np.where(plain.segment % 2, slippery[name], plain[name]) for name in plain.columns}
    return replace(plain, columns=columns)


#: Of every family one or two, so that a search is short; those that could stand for a steering are all there.
TERMS = frozenset(
    """
    steer_gain steer_offset steer_delay steer_lag drive_gain mass yaw_inertia cg_shift aero_drag tire_stiffness
    friction_scale load_transfer yaw_rate_scale speed_scale sensor_lever_arm sensor_misalignment road_bank
    """.split()
)


def candidates_of(case: DiagnosisCase) -> list[Candidate]:
    return [one for one in build_candidates(road_car(), case.real[0].series) if one.term in TERMS]


def searched(reality: Drive, simulation: Drive) -> SearchOutcome:
    case = case_of(reality, simulation)
    return search(case, candidates_of(case), reach=0.35)


@pytest.fixture(scope="module")
def restless() -> DiagnosisCase:
    """Two recordings of one restless car, the second with a steering of three quarters."""
    reality = recorded(commanded(unsteady(2), 0.75), 2, restless=0.1)
    return case_of(reality, recorded(unsteady(1), 1, restless=0.1))


def fixed_objective(case: DiagnosisCase):
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep, case.kinematics)
    return objective.with_fixed_baseline()


def test_with_a_fixed_baseline_a_cost_is_that_of_the_simulations_own_function(restless):
    objective = fixed_objective(restless)
    (one,) = restless.real
    for terms in ((), (term("steer_gain", gain=0.8),), (term("sensor_lever_arm", dx=0.5),)):
        rates = restless.discrepancy.rates(one.series, restless.posterior.weights, terms)
        rows = one.rows(terms) - one.whitener(integrated(one.series, rates, one.linear))
        kept = rows * one.weight[:, None] * restless.keep[0][:, None]
        assert objective.cost(terms) == pytest.approx(float(np.sum(kept**2)), rel=1e-9)


def test_with_a_fixed_baseline_a_fit_is_where_a_scan_finds_the_least(restless):
    objective = fixed_objective(restless)
    candidate = next(one for one in build_candidates(road_car(), restless.real[0].series) if one.term == "steer_gain")
    fit = fit_parts(objective, (Part(candidate, {"gain": 0.9}),))
    scan = {gain: objective.cost((term("steer_gain", gain=gain),)) for gain in np.arange(0.6, 1.0, 0.01)}
    best = min(scan, key=scan.get)
    assert fit.cost <= scan[best] + 1e-6
    assert fit.parts[0].values["gain"] == pytest.approx(best, abs=0.011)
    assert best == pytest.approx(0.75, abs=0.05)  # on tyres that are the nominal ones half of the time


def test_beside_a_sensors_fault_a_fault_of_commands_promises_what_it_saves_there(restless):
    objective = fixed_objective(restless)
    arm, gain = (
        next(one for one in candidates_of(restless) if one.term == name) for name in ("sensor_lever_arm", "steer_gain")
    )
    displaced = Part(arm, {**arm.starts[0], "dx": 0.8})
    residuals = objective.raw_residual([displaced.term])
    current = Fit((displaced,), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))
    explore = explorer(objective, gain)
    ((promised, line), *_) = explore.estimated_costs(current)
    alone = min(one.cost(current) for one in explore.tangents())
    steps = np.linspace(0.7, 1.0, 16)
    best = min(objective.cost([displaced.term, term("steer_gain", gain=value)]) for value in steps)
    assert abs(promised - best) < 0.8 * abs(alone - best) < 0.1 * current.cost
    beside = tangent(objective, residuals, line.part, (displaced.term,))
    assert promised == pytest.approx(beside.cost(current), rel=1e-9)


def test_what_brings_reality_back_is_named_where_form_error_is_much(restless):
    """Without a fault the same recordings match: test_calibration."""
    steps: list[str] = []
    outcome = search(restless, candidates_of(restless), reach=0.35, progress=steps.append)
    assert outcome.self_test.ratio > STANDARD.selection.much_over_noise
    once = ["naming", "naming with a fixed baseline"]
    assert steps == ["comparing", *once, "naming again beside what was found", once[1]]
    assert len(outcome.objectives) == 2
    assert [term.id for term in outcome.selection.terms] == ["steer_gain"]
    assert outcome.selection.terms[0].parameters["gain"] == pytest.approx(0.75, abs=0.05)


def test_without_form_error_the_simulation_is_searched_with_a_marginalised_baseline():
    outcome = searched(recorded(commanded(drive(2), 0.9), 2), drive(1))
    assert not outcome.structure.objective.fixed_baseline
    assert "steer_gain" in [one.id for one in outcome.selection.terms]


def neutral(names: list[str]) -> tuple[Term, ...]:
    return tuple(CATALOGUE[name](dict(CATALOGUE[name].neutral)) for name in names)


@pytest.mark.parametrize(
    ("names", "marginalised", "p_value", "expected"),
    [
        (["steer_gain"], [], 1e-3, True),
        (["tire_stiffness"], [], 0.0, False),  # moves nothing back to where the simulation was
        (["steer_gain", "tire_stiffness"], [], 0.0, False),
        (["tire_stiffness"], ["steer_offset", "tire_stiffness"], 0.0, True),  # both readings choose it
        (["tire_stiffness"], ["tire_stiffness"], 1e-3, False),  # not beyond doubt
        ([], ["tire_stiffness"], 0.0, False),
    ],
)
def test_what_is_believed_with_a_fixed_baseline(names, marginalised, p_value, expected):
    selection = SimpleNamespace(terms=neutral(names), first_p=p_value)
    assert _brings_back(selection, searched_first(marginalised), STANDARD.selection) is expected


def part_of(name: str) -> SimpleNamespace:
    return SimpleNamespace(candidate=SimpleNamespace(term=name, variant="", effect=name, label=name))


def searched_first(names: list[str], rivals: tuple[Rival, ...] = (), named: bool = False) -> SearchOutcome:
    """Return a search that chose terms, each of which saves 1000, beside rivals of each."""
    chosen = SimpleNamespace(parts=[part_of(one) for one in names], cost=0.0)
    without = [SimpleNamespace(cost=1000.0) for _ in names]
    selection = SimpleNamespace(
        chosen=chosen, without=without, named=[named] * len(names), rivals=[rivals] * len(names)
    )
    return SimpleNamespace(selection=selection, structure=SimpleNamespace(objective=None))


@pytest.mark.parametrize(
    ("excess", "named", "p_value", "expected"),
    [
        (2.0, True, 0.0, True),  # a heavier car, that the first search cannot tell from less grip
        (2.0, True, 1e-3, False),  # not beyond doubt
        (900.0, True, 0.0, False),  # the first search tells it from less grip
        (2.0, False, 0.0, False),  # nothing is named, and has no class
    ],
)
def test_what_the_first_search_cannot_tell_from_its_name_is_believed(monkeypatch, excess, named, p_value, expected):
    monkeypatch.setattr("split_cli.diagnosis.search.selection.part_over_allowance", lambda *_: 100.0)
    rival = Rival(SimpleNamespace(parts=[part_of("mass")]), excess, 9.0)
    first = searched_first(["friction_scale"], (rival,), named)
    first.structure.objective = SimpleNamespace(policy=STANDARD, form_error_inflation=1.0)
    selection = SimpleNamespace(terms=neutral(["mass"]), first_p=p_value)
    assert _brings_back(selection, first, STANDARD.selection) is expected


@pytest.mark.parametrize(
    ("other", "excess", "expected"),
    [
        ("drive_gain", 2.0, ["steer_gain", "drive_gain"]),  # what the first search names explains as well
        ("drive_gain", 900.0, ["steer_gain", "rotating_mass"]),  # it explains less
        ("mass", 2.0, ["steer_gain", "rotating_mass"]),  # nobody names it
    ],
)
def test_a_fixed_baseline_names_what_the_first_search_names_where_it_explains_as_well(
    monkeypatch, other, excess, expected
):
    """Wheels that turn heavily, which alter no command, beside a weak torque, which the first search names."""
    module = "split_cli.diagnosis.search."
    monkeypatch.setattr(module + "selection.part_over_allowance", lambda *_: 100.0)
    monkeypatch.setattr(
        module + "baselines.with_chosen", lambda explore, selection, fit: replace(selection, chosen=fit)
    )
    names = ["steer_gain", "rotating_mass"]
    fit = SimpleNamespace(parts=[part_of("steer_gain"), part_of(other)], terms=neutral(["steer_gain", other]))
    chosen = SimpleNamespace(parts=[part_of(one) for one in names], terms=neutral(names), cost=0.0)
    none, rivals = ((), ()), ((), (Rival(fit, excess, 9.0),))
    selection = Selection(None, chosen, (SimpleNamespace(cost=1000.0),) * 2, rivals, none, (True, True))
    objective = SimpleNamespace(policy=STANDARD, form_error_inflation=1.0)
    again = SearchOutcome(SimpleNamespace(objective=objective), None, selection, None, INFLATION)
    first = SimpleNamespace(selection=SimpleNamespace(terms=neutral(["drive_gain"])))
    found = with_names_of_first(first, again, ())
    assert [one.id for one in found.selection.terms] == expected


def test_a_sure_name_lends_its_sureness_to_no_other(restless):
    """Of two names one saves much and one some; the fixed baseline confirms none, or the other."""
    candidates = {one.label: one for one in build_candidates(road_car(), restless.real[0].series)}
    parts = tuple(
        Part(candidates[name], {one: 0.01}) for name, one in (("steer_offset", "offset"), ("road_bank", "angle"))
    )
    chosen = Fit(parts, 1000.0, np.zeros(0), np.zeros((0, 0)))
    without = tuple(
        replace(chosen, parts=parts[1 - k :][:1], cost=1000.0 + saved) for k, saved in ((0, 1e5), (1, 30.0))
    )
    none = ((), ())
    both = Selection(chosen, chosen, without, none, none, (True, True), first_p=0.0)
    nobody = Selection(chosen, replace(chosen, parts=()), (), (), (), ())
    objective = fixed_objective(restless)

    def named(second: Selection) -> list[str]:
        one, other = (
            SearchOutcome(SimpleNamespace(objective=objective), None, s, None, INFLATION) for s in (both, second)
        )
        return [term.id for term in reconciled(one, other, STANDARD.selection).selection.terms]

    assert named(nobody) == ["steer_offset"]
    confirmed = Selection(chosen, replace(chosen, parts=parts[1:]), (), ((),), ((),), (True,))
    assert named(confirmed) == ["steer_offset", "road_bank"]


@pytest.mark.parametrize(("saved", "expected"), [(1e5, ["drive_gain", "steer_offset"]), (30.0, ["steer_offset"])])
def test_a_surer_name_takes_none_from_a_sure_one_beside_it(restless, saved, expected):
    """Both searches name an offset; the first is surer of it, and only the second sees a weak torque."""
    candidates = {one.label: one for one in build_candidates(road_car(), restless.real[0].series)}
    offset, torque = (Part(candidates[one], dict(candidates[one].starts[0])) for one in ("steer_offset", "drive_gain"))
    objective, every = fixed_objective(restless), ((), ())

    def outcome(parts, p_value) -> SearchOutcome:
        chosen = Fit(parts, 1000.0, np.zeros(0), np.zeros((0, 0)))
        rest = [(parts[:k] + parts[k + 1 :], saved if part is torque else 1e5) for k, part in enumerate(parts)]
        without = tuple(replace(chosen, parts=some, cost=1000.0 + more) for some, more in rest)
        selection = Selection(
            chosen, chosen, without, every[: len(parts)], every[: len(parts)], (True,) * len(parts), first_p=p_value
        )
        return SearchOutcome(SimpleNamespace(objective=objective), None, selection, None, INFLATION)

    believed = reconciled(outcome((offset,), 1e-160), outcome((torque, offset), 1e-60), STANDARD.selection)
    assert [one.id for one in believed.selection.terms] == expected


@pytest.mark.parametrize(
    ("first", "first_p", "second", "second_p", "expected"),
    [
        (["tire_stiffness"], 1e-3, ["steer_gain"], 1e-20, "second"),  # doubted physics gives way to a surer fault
        (["tire_stiffness"], 1e-4, ["steer_gain"], 1e-3, ""),  # and stays nameless beside one less sure
        (["road_bank"], 1e-30, ["steer_gain"], 1e-20, "first"),  # what is beyond doubt gives way to nothing less
        (["steer_offset"], 1e-4, ["steer_gain"], 1e-3, ""),
        (["steer_offset"], 1e-4, ["steer_offset"], 1e-3, "first"),  # confirmed: the value of the surer one
        (["steer_offset"], 1e-4, ["steer_offset"], 1e-20, "second"),
        (["steer_offset"], 1e-30, [], 1.0, "first"),
        (["steer_offset"], 1e-4, [], 1.0, ""),
        (["steer_offset", "tire_stiffness"], 1e-4, ["steer_offset"], 1e-3, "steer_offset"),  # each name by itself
        (["steer_offset", "tire_stiffness"], 1e-4, ["tire_stiffness"], 1e-3, ""),
        (["tire_stiffness", "steer_gain?"], 1e-4, ["steer_gain"], 1e-3, "second"),  # both have it, one unnamed
        (["tire_stiffness", "road_bank?"], 1e-4, ["steer_gain"], 1e-3, ""),
    ],
)
def test_the_surer_search_is_believed(restless, first, first_p, second, second_p, expected):
    candidates = {one.label: one for one in build_candidates(road_car(), restless.real[0].series)}
    objective = fixed_objective(restless)

    def outcome(names, p_value) -> SearchOutcome:
        own = [candidates[name.rstrip("?")] for name in names]  # a mark behind what has no name
        parts = tuple(Part(one, dict(one.starts[0])) for one in own)
        chosen = Fit(parts, 1.0, np.zeros(0), np.zeros((0, 0)))
        every, named = tuple(() for _ in names), tuple("?" not in name for name in names)
        selection = Selection(chosen, chosen, (), every, every, named, first_p=p_value)
        return SearchOutcome(SimpleNamespace(objective=objective), None, selection, None, INFLATION)

    one, other = outcome(first, first_p), outcome(second, second_p)
    believed = reconciled(one, other, STANDARD.selection)
    if expected in first:
        assert [term.id for term in believed.selection.terms] == [expected]
    elif expected:
        assert believed.selection is (one if expected == "first" else other).selection
    else:
        assert not any(believed.selection.named)


@pytest.mark.parametrize(
    ("offset", "p_value", "expected"), [(0.1, 1e-20, True), (0.1, 1e-3, False), (0.05, 1e-20, False)]
)
def test_what_would_need_more_than_a_car_has_is_a_difference_without_a_name(restless, offset, p_value, expected):
    candidates = {one.label: one for one in build_candidates(road_car(), restless.real[0].series)}
    objective = fixed_objective(restless)

    def outcome(parts, cost, p_value) -> SearchOutcome:
        chosen, base = (Fit(some, c, np.zeros(0), np.zeros((0, 0))) for some, c in ((parts, cost), ((), 100.0)))
        every = tuple(() for _ in parts)
        selection = Selection(
            base, chosen, tuple(base for _ in parts), every, every, tuple(False for _ in parts), first_p=p_value
        )
        return SearchOutcome(SimpleNamespace(objective=objective), None, selection, None, INFLATION)

    first, second = (
        outcome((), 100.0, 1.0),
        outcome((Part(candidates["steer_offset"], {"offset": offset}),), 10.0, p_value),
    )
    believed = reconciled(first, second, STANDARD.selection)
    assert believed.selection is (second if expected else first).selection
    assert ends_beyond(believed.selection, STANDARD) is expected and not believed.selection.terms


def test_wide_starts_lie_to_both_sides_and_inside_the_bounds():
    candidates = {one.label: one for one in build_candidates(road_car(), build_series(drive(1), "sim", np.zeros(4000)))}
    gain = candidates["steer_gain"]
    assert sorted(one["gain"] for one in gain.widely_started().starts) == pytest.approx(
        [0.76, 0.92, 0.98, 1.02, 1.08, 1.24]
    )
    for one in candidates.values():
        wide = one.widely_started()
        assert wide.starts[: len(one.starts)] == one.starts or len(one.starts) == 1
        for start in wide.starts:
            assert all(one.ranges[name].lower <= value <= one.ranges[name].upper for name, value in start.items())
    # A delay has starts of its own, of every size.
    assert candidates["steer_delay"].widely_started() is candidates["steer_delay"]


def test_values_at_the_end_of_their_search_are_told_from_others():
    series = build_series(drive(1), "sim", np.zeros(4000))
    candidates = {one.label: one for one in build_candidates(road_car(), series)}
    scale, drag, fade = (candidates[name] for name in ("yaw_inertia", "aero_drag", "grip_fade"))
    delay = candidates["steer_delay"]
    # The upper end is where I_z would be more than 1.3 m l_f l_r.
    assert not scale.at_limit({"scale": 1.2})
    assert scale.at_limit({"scale": scale.ranges["scale"].upper}) and scale.at_limit({"scale": 0.3})
    # No effect at all, all the drag there is, and a fade that lasts: natural ends.
    assert not delay.at_limit({"delay": 0.0}) and delay.at_limit({"delay": delay.ranges["delay"].upper})
    assert not drag.at_limit({"drag": drag.ranges["drag"].lower})
    assert not fade.at_limit({"final_loss": 0.2, "tau": fade.ranges["tau"].upper})
    # A locked axle is as stiff as can be. How stiff its tyres are along is no size of an effect.
    slip, weak = (candidates[f"yaw_moment_differential{variant}"] for variant in (" (slip)", ""))
    ends = {name: limit.upper for name, limit in slip.ranges.items()}
    assert not slip.at_limit(ends) and set(slip.away(ends)) == {"yaw_damping"}
    assert weak.at_limit({"yaw_damping": weak.ranges["yaw_damping"].upper})
