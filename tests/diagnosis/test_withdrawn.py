"""Held-out time takes names back where it gets worse with them, and says so."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis import engine
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.baselines import search
from split_cli.diagnosis.search.calibration import SelfTest
from split_cli.diagnosis.search.fitting import Fit
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.statement.result import Finding, ParameterEstimate, RemainderTest
from split_cli.diagnosis.verdict.withdrawn import as_leads, withdrawn, without_names
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
    assert withdrawn(FINDINGS, improved(-1.61, -1.91, -1.09)) == FINDINGS
    assert withdrawn(FINDINGS, improved(-1.61, -1.91, -1.09), {one.term for one in FINDINGS}) == FINDINGS[:1]
    assert not withdrawn(FINDINGS, improved(-0.5, -1.2, 0.1))  # by chance
    assert not withdrawn(FINDINGS, improved()) and not withdrawn(FINDINGS, None)


def test_what_is_taken_back_counts_as_unexplained():
    parts = tuple(SimpleNamespace(candidate=SimpleNamespace(term=one.term)) for one in FINDINGS)
    fit = Fit(parts, 0.0, np.empty(0), np.empty((0, 0)))
    selection = Selection(fit, fit, (), (), (), (True, True))
    remainder = RemainderTest(0.0, 0.2, 1.0, ())
    selection, left, rest = without_names(selection, FINDINGS, remainder, FINDINGS[:1])
    assert selection.named == (False, True) and left == FINDINGS[1:]
    assert rest == replace(remainder, share=pytest.approx(0.2 + 0.8 * 0.25))


def test_a_lead_says_by_how_much_held_out_time_gets_worse():
    (lead,) = as_leads(FINDINGS[:1], improved(-1.61, -1.91, -1.09), None)
    assert lead.term == "tire_relaxation" and not lead.limits
    assert "rises by 161 % with all identified effects (95 %: 109 to 191 %)" in lead.sentence
    assert "stands for something else" in lead.sentence


def test_held_out_time_is_asked_where_model_form_error_would_hide_what_has_no_name(monkeypatch):
    """All that differs has a name here; halves of a simulation that differ much leave that open."""
    planted = CATALOGUE["drive_gain"]({"drive_gain": 1.0, "brake_gain": 0.8})
    real = noisy(driven(72, (planted,), runs=6, seconds=8.0, spaced=9.0), 572)
    monkeypatch.setattr(engine, "measure_improvement", lambda *_: improved(-0.44, -1.14, -0.05))
    monkeypatch.setattr(engine, "detection_limits", lambda *_: ())
    monkeypatch.setattr(engine, "summarise", lambda *_: "")
    found = []

    def with_ratio(ratio, *arguments, **settings):
        found.append(found[0] if found else search(*arguments, **settings))
        return replace(found[0], self_test=SelfTest(ratio=ratio))

    for ratio, named in ((1.0, True), (1.01 * STANDARD.selection.much_over_noise, False)):
        monkeypatch.setattr(engine, "search", partial(with_ratio, ratio))
        said = engine.diagnose([real], road_car())
        assert bool(said.findings) is named and said.unexplained is not named
        assert [one.term for one in said.leads] == ([] if named else ["drive_gain"])
