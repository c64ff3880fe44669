"""What no real car can have is no finding, and is reported as a lead with what it would need."""

from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import Selection, nothing
from split_cli.diagnosis.statement.document import diagnosis_to_mapping, read_schema
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.verdict import leads
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Course, Range
from tests.diagnosis.recordings import INFLATION, candidates_of, driven, noisy, noisy_objective, selected, verdict_of
from tests.factories import road_car


def test_every_size_has_limits_with_a_source_and_starts_inside():
    course = Course(60.0, 400.0)
    for kind in CATALOGUE.values():
        for variant in kind.variants:
            search = kind.search(road_car(), course, variant)
            if search is None:
                continue
            for name, limits in search.ranges.items():
                assert limits.lower < limits.upper and limits.step > 0.0
                neutral = kind.neutral.get(name)
                if neutral is not None:
                    assert limits.source, (kind.id, name)
                    assert limits.lower <= neutral <= limits.upper, (kind.id, name)
            for start in search.starts:
                assert all(
                    search.ranges[name].lower <= value <= search.ranges[name].upper for name, value in start.items()
                )


def test_limits_grow_with_the_car():
    """Lengths are reported in wheelbases, times in their root: a tenth of the car has a tenth of the reach."""
    small = CATALOGUE["sensor_lever_arm"]
    assert small.sizes(road_car())["dx"] == pytest.approx(road_car().wheelbase)
    assert CATALOGUE["steer_lag"].sizes(road_car())["tau"] == pytest.approx(np.sqrt(road_car().wheelbase / 2.7))
    # Networks and clocks do not run faster in smaller cars.
    assert not CATALOGUE["steer_delay"].sizes(road_car()) and not CATALOGUE["channel_delay"].sizes(road_car())


def test_a_range_is_widened_about_what_is_neutral():
    assert Range(-0.1, 0.2, 0.01).widened(0.0) == Range(-0.4, 0.8, 0.01)
    assert Range(0.5, 2.0, 0.01).widened(1.0) == Range(0.125, 8.0, 0.01)
    assert Range(0.0, 0.5, 0.01).widened(0.0).lower == 0.0
    # A loss of 0.9 leaves 0.1, of which a quarter is left at most: grip has no other sign.
    assert Range(-1.0, 0.9, 0.01, share_of_whole=True).widened(0.0).upper == pytest.approx(0.975)
    assert Range(-1.0, 0.9, 0.01, share_of_whole=True).widened(0.0).lower == pytest.approx(-7.0)
    assert Range(-3.0, 9.0, 0.1, ends_at_none=True).widened(0.0) == Range(-3.0, 36.0, 0.1, ends_at_none=True)
    assert Range(-1.0, 9.0, 0.1, ends_complete=True).widened(0.0) == Range(-4.0, 9.0, 0.1, ends_complete=True)


def test_a_bank_that_no_road_has_is_a_lead(nominal_series):
    """Eighteen degrees of bank under the whole drive: seen, followed to its value, and not named."""
    planted = 0.3
    limit = next(one for one in build_candidates(road_car(), nominal_series) if one.label == "road_bank")
    assert limit.ranges["angle"].upper < planted
    real = noisy(driven(72, (CATALOGUE["road_bank"]({"angle": planted}),), runs=8, seconds=8.0, spaced=9.0), 572)
    said = verdict_of([real], road_car())
    assert said.verdict == "mismatch" and "road_bank" not in {one.term for one in said.findings}
    lead = said.leads[0]
    assert lead.term == "road_bank" and lead.share > 0.9
    assert lead.parameters["angle"].value == pytest.approx(planted, abs=0.02)
    assert lead.limits["angle"] == (limit.ranges["angle"].lower, limit.ranges["angle"].upper)
    assert "No real car" in lead.sentence and "AASHTO" in lead.sentence
    mapping = diagnosis_to_mapping(said)
    jsonschema.validate(mapping, read_schema())
    assert mapping["leads"][0]["term"] == "road_bank"


def test_beside_a_name_what_no_car_can_have_is_a_lead():
    """A steering that turns half as far, and a bank beside it: the search refuses it, and a lead says why."""
    planted = (CATALOGUE["steer_gain"]({"gain": 0.6}), CATALOGUE["road_bank"]({"angle": 0.2}))
    objective = noisy_objective(driven(73, planted, runs=4), 7)
    (bank,) = (one for one in candidates_of(objective, "road_bank") if not one.variant)
    short = replace(bank, ranges={"angle": replace(bank.ranges["angle"], lower=-0.1, upper=0.1)})
    selection = selected(objective, *candidates_of(objective, "steer_gain"), short)
    assert [one.id for one in selection.terms] == ["steer_gain"]
    (lead,) = leads.find_leads(objective, selection, INFLATION)
    assert lead.term == "road_bank" and lead.limits == {"angle": (-0.1, 0.1)}
    assert lead.parameters["angle"].value == pytest.approx(0.2, abs=0.02)
    assert lead.sentence.startswith("A lead, not a finding: what the findings leave would be explained if")
    # Asked beside what is chosen at last, whatever took its place; and not where nothing is named.
    asked = []
    counted = replace(selection, beside=lambda fit: asked.append(fit) or selection.beside(fit))
    assert leads.find_leads(objective, counted, INFLATION) == (lead,)
    leads.find_leads(objective, replace(counted, named=(False,) * len(selection.named)), INFLATION)
    assert [one is selection.chosen for one in asked] == [True]


def test_what_has_no_value_or_either_sign_is_no_lead(monkeypatch):
    objective = noisy_objective(driven(73, (CATALOGUE["road_bank"]({"angle": 0.3}),), runs=4), 7)
    (bank,) = (one for one in candidates_of(objective, "road_bank") if not one.variant)
    base, ended = nothing(objective), fit_parts(objective, [Part(bank, dict(bank.starts[0]))])
    selection = Selection(base, base, (), (), (), (), first=(ended,))
    (lead,) = leads.find_leads(objective, selection, INFLATION)
    assert lead.parameters["angle"].interval_95[0] > 0.0
    # Four times a range that is too short by far: the data want more still, and what that would be is unknown.
    short = replace(bank, ranges={"angle": replace(bank.ranges["angle"], lower=-0.02, upper=0.02)})
    further = fit_parts(objective, [Part(short, {"angle": 0.01})])
    assert leads.find_leads(objective, replace(selection, first=(further,)), INFLATION) == ()
    known = lead.parameters["angle"].covering(ParameterEstimate(-0.1, 0.1, "rad", (-0.3, 0.1)))
    monkeypatch.setattr(leads, "parameter_estimates", lambda *_: ({"angle": known},))
    assert leads.find_leads(objective, selection, INFLATION) == ()


def test_what_a_finding_explains_as_well_within_its_range_is_no_lead():
    """A yaw inertia six times too large, "explained as well" by the very effect that was named.

    A constant grade is a rolling resistance, as the forces have it.
    """
    objective = noisy_objective(driven(73, (CATALOGUE["rolling_resistance"]({"force": 400.0}),), runs=4), 7)
    (grade,) = (one for one in candidates_of(objective, "road_grade") if not one.variant)
    (rolling,) = candidates_of(objective, "rolling_resistance")
    flat = replace(grade, ranges={"angle": replace(grade.ranges["angle"], lower=-0.01, upper=0.01)})
    base = nothing(objective)
    ended, found = (
        fit_parts(objective, [Part(one, {name: value})])
        for one, name, value in ((flat, "angle", 0.009), (rolling, "force", 100.0))
    )
    nameless = Selection(base, found, (base,), ((),), ((),), (False,), first=(ended, found))
    (lead,) = leads.find_leads(objective, nameless, INFLATION)
    assert lead.term == "road_grade" and lead.instead == ("rolling_resistance",)
    named = replace(nameless, named=(True,), beside=lambda fit: ())
    assert leads.find_leads(objective, named, INFLATION) == ()


@pytest.mark.parametrize("angle", [0.05, 0.0])
def test_what_the_named_effects_may_hide_is_a_lead_with_its_value(angle):
    """A bank beside a steering gain: not part of the explanation, or part of it without a name; and not there."""
    planted = (CATALOGUE["steer_gain"]({"gain": 0.8}), *((CATALOGUE["road_bank"]({"angle": angle}),) if angle else ()))
    objective = noisy_objective(driven(73, planted, runs=4), 7)
    (gain,), (bank, *_) = candidates_of(objective, "steer_gain"), candidates_of(objective, "road_bank")
    explore, base = Explorer(objective, (gain, bank), INFLATION), nothing(objective)
    alone, other = (fit_parts(objective, [Part(one, dict(one.starts[0]))]) for one in (gain, bank))
    both = fit_parts(objective, (*other.parts, *alone.parts))
    one = Selection(base, alone, (base,), ((),), ((),), (True,), beside=explore)
    nameless = Selection(base, both, (alone, other), ((),) * 2, ((),) * 2, (False, True), beside=explore)
    for selection in (one, nameless):
        found = leads.find_leads(objective, selection, INFLATION)
        assert [lead.term for lead in found] == (["road_bank"] if angle else [])
        for lead in found:
            low, high = lead.parameters["angle"].interval_95
            assert low < angle < high and not lead.limits
            assert "may be as large" in lead.sentence and lead.share == pytest.approx(
                (alone.cost - both.cost) / (base.cost - selection.chosen.cost), rel=0.01
            )
    assert leads.find_leads(objective, replace(one, named=(False,)), INFLATION) == ()
