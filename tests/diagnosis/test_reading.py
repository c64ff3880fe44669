"""Readings with reserve and to the letter."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import split_cli.diagnosis.search.reading as reading_module
from split_cli.diagnosis.innovations.case import Case, gather_case
from split_cli.diagnosis.innovations.evidence import integrated
from split_cli.diagnosis.innovations.judge import build_judge
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.place import places_of
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.reading import Reading, _brings_back, read
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.test_calibration import drive, recorded
from tests.factories import road_car


def term(name: str, **values: float) -> Term:
    kind = CATALOGUE[name]
    return kind({**{key: kind.neutral[key] for key in kind.units}, **values}, "")


def case_of(reality: Drive, simulation: Drive) -> Case:
    drives = [reality, simulation]
    places, _ = places_of(drives, road_car().wheelbase)
    series = [
        build_series(one, role, s) for one, role, (s, _) in zip(drives, ("real", "sim"), places, strict=True)
    ]
    return gather_case(road_car(), series)


def commanded(drive: Drive, gain: float) -> Drive:
    """Return a drive as a steering of that gain would have been commanded for the same motion."""
    return replace(drive, columns={**drive.columns, "delta": drive["delta"] / gain})


def read_it(reality: Drive, simulation: Drive, policy: Policy = STANDARD) -> Reading:
    case = case_of(reality, simulation)
    return read(case, build_candidates(road_car(), case.real[0].series), reach=0.35, policy=policy)


@pytest.fixture(scope="module")
def restless() -> Case:
    """Two recordings of one restless car, the second with a steering of three quarters."""
    reality = recorded(commanded(drive(2), 0.75), 2, restless=0.1)
    return case_of(reality, recorded(drive(1), 1, restless=0.1))


def letter_judge(case: Case):
    judge = build_judge(case.real, case.knowledge, case.common, case.keep, case.kinematics)
    return judge.believed_to_the_letter()


def test_to_the_letter_a_cost_is_that_of_the_simulations_own_function(restless):
    judge = letter_judge(restless)
    (one,) = restless.real
    for terms in ((), (term("steer_gain", gain=0.8),), (term("sensor_lever_arm", dx=0.5),)):
        rates = restless.common.rates(one.series, restless.knowledge.weights, terms)
        rows = one.rows(terms) - one.whitener(integrated(one.series, rates))
        kept = rows * one.weight[:, None] * restless.keep[0][:, None]
        assert judge.cost(terms) == pytest.approx(float(np.sum(kept**2)), rel=1e-9)


def test_to_the_letter_a_fit_is_where_a_scan_finds_the_least(restless):
    judge = letter_judge(restless)
    candidate = next(
        one for one in build_candidates(road_car(), restless.real[0].series) if one.term == "steer_gain"
    )
    fit = fit_parts(judge, (Part(candidate, {"gain": 0.9}),))
    scan = {gain: judge.cost((term("steer_gain", gain=gain),)) for gain in np.arange(0.6, 1.0, 0.01)}
    best = min(scan, key=scan.get)
    assert fit.cost <= scan[best] + 1e-6
    assert fit.parts[0].values["gain"] == pytest.approx(best, abs=0.011)
    assert best == pytest.approx(0.75, abs=0.03)


def test_what_brings_reality_back_is_named_where_misfit_is_much(monkeypatch):
    never = STANDARD.altered("selection", sure_level=0.0)
    simulation = recorded(drive(1), 1, restless=0.1)
    same = read_it(recorded(drive(2), 2, restless=0.1), simulation, never)
    assert same.known.ratio > 3.0
    assert not any(same.selection.named)
    reality = recorded(commanded(drive(2), 0.75), 2, restless=0.1)
    confirmed = read_it(reality, simulation, never)
    # The second reading names it too, and the first one's value stays.
    assert len(confirmed.judges) == 2 and not confirmed.structure.judge.to_the_letter
    assert [one.id for one in confirmed.selection.terms] == ["steer_gain"]
    monkeypatch.setattr(reading_module, "_ids", lambda selection: {id(selection)})
    reading = read_it(reality, simulation, never)
    assert reading.structure.judge.to_the_letter
    assert [one.id for one in reading.selection.terms] == ["steer_gain"]
    for one in (confirmed, reading):
        assert one.selection.terms[0].parameters["gain"] == pytest.approx(0.75, abs=0.03)


def test_a_name_beyond_all_doubt_is_not_read_again():
    """With reserve its value is as near the truth, and its interval knows what the simulation leaves open."""
    steps: list[str] = []
    case = case_of(
        recorded(commanded(drive(2), 0.75), 2, restless=0.1),
        recorded(drive(1), 1, restless=0.1),
    )
    candidates = build_candidates(road_car(), case.real[0].series)
    reading = read(case, candidates, reach=0.35, progress=steps.append)
    assert reading.known.ratio > 3.0 and reading.selection.first_p < STANDARD.selection.sure_level
    assert steps == ["comparing", "naming"] and len(reading.judges) == 1
    assert [one.id for one in reading.selection.terms] == ["steer_gain"]
    assert reading.selection.terms[0].parameters["gain"] == pytest.approx(0.75, abs=0.03)


def test_without_misfit_the_simulation_is_read_with_reserve():
    reading = read_it(recorded(commanded(drive(2), 0.9), 2), drive(1))
    assert not reading.structure.judge.to_the_letter
    assert "steer_gain" in [one.id for one in reading.selection.terms]


@pytest.mark.parametrize(
    ("names", "left", "reserved", "p_value", "expected"),
    [
        (["steer_gain"], 700.0, [], 1e-3, True),
        (["steer_gain"], 850.0, [], 1e-3, False),  # too small a share
        (["tire_stiffness"], 100.0, [], 0.0, False),  # moves nothing back to where the simulation was
        (["steer_gain", "tire_stiffness"], 100.0, [], 0.0, False),
        (["tire_stiffness"], 100.0, ["steer_offset", "tire_stiffness"], 0.0, True),  # both readings choose it
        (["tire_stiffness"], 850.0, ["tire_stiffness"], 0.0, False),
        (["tire_stiffness"], 100.0, ["tire_stiffness"], 1e-3, False),  # not beyond doubt
        ([], 100.0, ["tire_stiffness"], 0.0, False),
    ],
)
def test_what_is_believed_to_the_letter(names, left, reserved, p_value, expected):
    def fit(cost: float, terms=()) -> SimpleNamespace:
        parts = tuple(SimpleNamespace(candidate=SimpleNamespace(term=one)) for one in terms)
        return SimpleNamespace(cost=cost, parts=parts)

    terms = tuple(CATALOGUE[name](dict(CATALOGUE[name].neutral)) for name in names)
    selection = SimpleNamespace(terms=terms, base=fit(1000.0), chosen=fit(left), first_p=p_value)
    reserved = SimpleNamespace(chosen=fit(900.0, reserved))
    assert _brings_back(selection, reserved, STANDARD.selection) is expected


def test_wide_starts_lie_to_both_sides_and_inside_the_bounds():
    candidates = {
        one.label: one for one in build_candidates(road_car(), build_series(drive(1), "sim", np.zeros(4000)))
    }
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
    assert not scale.at_limit({"scale": 2.0})
    assert scale.at_limit({"scale": 3.0}) and scale.at_limit({"scale": 0.3})
    # No effect at all, all the drag there is, and a fade that lasts: natural ends.
    assert not delay.at_limit({"delay": 0.0}) and delay.at_limit({"delay": delay.ranges["delay"].upper})
    assert not drag.at_limit({"drag": drag.ranges["drag"].lower})
    assert not fade.at_limit({"final_loss": 0.2, "tau": fade.ranges["tau"].upper})
