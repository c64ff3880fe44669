"""Held-out time takes names back where it gets worse with them, and says so."""

from dataclasses import fields, replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis import engine
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.baselines import SearchOutcome, search
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.self_test import SelfTest
from split_cli.diagnosis.statement.improvement import CorrectedVehicle, StateChange
from split_cli.diagnosis.statement.result import Finding, ParameterEstimate, RemainderTest
from split_cli.diagnosis.verdict import held_out_judgement
from split_cli.diagnosis.verdict.withdrawn import as_leads, withdrawn, without_names
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import driven, noisy
from tests.factories import road_car


def finding(term: str, name: str, value: float, share: float) -> Finding:
    estimate = ParameterEstimate(value, 0.02, "1", (value - 0.04, value + 0.04))
    return Finding(term, "", {name: estimate}, share, (), "", 1.0, (), (), CATALOGUE[term].exported)


FINDINGS = (finding("tire_relaxation", "length", 0.18, 0.25), finding("sensor_lever_arm", "dx", 0.1, 0.5))


def improved(*removed: float) -> SimpleNamespace:
    return SimpleNamespace(removed={"physics": removed or None})


def test_names_are_taken_back_where_held_out_time_gets_worse_beyond_chance():
    """But for an instrument's whose witnesses confirm it; a witness of the car's effects there is none."""
    rises = improved(-1.61, -1.91, -1.09)
    assert withdrawn(FINDINGS, rises)[0] == FINDINGS
    assert withdrawn(FINDINGS, rises, confirmed={one.term for one in FINDINGS})[0] == FINDINGS[:1]
    for nothing in (improved(-0.5, -1.2, 0.1), improved(), None):  # the first is worse by chance
        assert withdrawn(FINDINGS, nothing) == ((), "")


def vehicle(*changes: float) -> CorrectedVehicle:
    """Return a corrected vehicle whose squared errors change by so many standard errors."""
    return CorrectedVehicle(tuple(StateChange("r", "rad/s", 2.0, 0.01, 0.02, 0.5, 0.0, one) for one in changes))


def test_names_of_the_car_are_taken_back_where_a_file_with_them_is_worse_and_nothing_better():
    gone, reason = withdrawn(FINDINGS, improved(0.27, -0.01, 0.41), vehicle(2.5, 0.3))
    assert gone == FINDINGS[:1] and "worse: r after 2 s (0.020 instead of 0.010 rad/s)" in reason
    for one in (vehicle(2.5, -2.5), vehicle(1.5, 0.3), None):
        assert withdrawn(FINDINGS, improved(), one) == ((), "")
    assert withdrawn(FINDINGS, improved(0.4, 0.1, 0.6), vehicle(2.5)) == ((), "")  # one step is better


def test_what_is_taken_back_counts_as_unexplained():
    parts = tuple(SimpleNamespace(candidate=SimpleNamespace(term=one.term)) for one in FINDINGS)
    fit = Fit(parts, 0.0, np.empty(0), np.empty((0, 0)))
    selection = Selection(fit, fit, (), (), (), (True, True))
    remainder = RemainderTest(0.0, 0.2, 1.0, ())
    selection, left, rest = without_names(selection, FINDINGS, remainder, FINDINGS[:1])
    assert selection.named == (False, True) and left == FINDINGS[1:]
    assert rest == replace(remainder, share=pytest.approx(0.2 + 0.8 * 0.25))


def test_a_lead_says_by_how_much_held_out_time_gets_worse():
    _, reason = withdrawn(FINDINGS, improved(-1.61, -1.91, -1.09))
    (lead,) = as_leads(FINDINGS[:1], reason, None)
    assert lead.term == "tire_relaxation" and not lead.limits
    assert "rises by 161 % with all identified effects (95 %: 109 to 191 %)" in lead.sentence
    assert "stands for something else" in lead.sentence


@pytest.fixture(scope="module")
def weak_brakes() -> tuple[Drive, SearchOutcome]:
    """A drive with brakes of 0.8, and what the search finds of it."""
    planted = CATALOGUE["drive_gain"]({"drive_gain": 1.0, "brake_gain": 0.8})
    real, found = noisy(driven(72, (planted,), runs=6, seconds=8.0, spaced=9.0), 572), []
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(
            engine, "search", lambda *parts, **settings: found.append(search(*parts, **settings)) or found[0]
        )
        patched.setattr(engine, "detection_limits", lambda *_: ())
        engine.diagnose([real], road_car(), improved=False)
    return real, found[0]


def test_held_out_time_is_asked_where_model_form_error_would_hide_what_has_no_name(monkeypatch, weak_brakes):
    """All that differs has a name here; halves of a simulation that differ much leave that open."""
    real, outcome = weak_brakes
    monkeypatch.setattr(held_out_judgement, "measure_improvement", lambda *_: improved(-0.44, -1.14, -0.05))
    monkeypatch.setattr(engine, "summarise", lambda *_: ())
    monkeypatch.setattr(engine, "detection_limits", lambda *_: ())
    for ratio, named in ((1.0, True), (1.01 * STANDARD.selection.much_over_noise, False)):
        found = replace(outcome, self_test=SelfTest(ratio=ratio))
        monkeypatch.setattr(engine, "search", lambda *_, found=found, **__: found)
        said = engine.diagnose([real], road_car())
        assert bool(said.findings) is named and said.unexplained is not named
        assert [one.term for one in said.leads] == ([] if named else ["drive_gain"])


class _OfNames(SearchOutcome):
    """An outcome in which no fit without names finds anything."""

    def remainder(self, residuals):
        _, structure, fit = super().remainder(residuals)
        return 1.0, structure, replace(fit, p_value=1.0)


def test_a_name_whose_interval_holds_no_effect_is_no_difference_if_nothing_else_shows_one(monkeypatch, weak_brakes):
    real, outcome = weak_brakes
    nowhere = replace(outcome.selection, partly=lambda: None)
    values = {one.name: getattr(outcome, one.name) for one in fields(outcome)}
    hidden = _OfNames(**{**values, "selection": nowhere})
    described = engine.describe(outcome)
    monkeypatch.setattr(engine, "detection_limits", lambda *_: ())
    for found, is_apart, verdict in (
        (hidden, True, "mismatch"),
        (hidden, False, "match"),
        (outcome, False, "mismatch"),  # by the gap as a whole
    ):
        monkeypatch.setattr(engine, "search", lambda *_, found=found, **__: found)
        monkeypatch.setattr(engine, "describe", lambda *_, apart=is_apart: replace(described, is_apart=apart))
        assert engine.diagnose([real], road_car(), improved=False).verdict == verdict
