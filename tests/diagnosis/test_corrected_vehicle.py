"""The corrected vehicle is judged: true physics is accepted, wrong physics is not, and files and words say so."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from jsonschema import Draft202012Validator

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part
from split_cli.diagnosis.statement.document import diagnosis_to_text, read_schema
from split_cli.diagnosis.statement.improvement import (
    NORMAL_95,
    CorrectedVehicle,
    HorizonErrors,
    Improvement,
    StateChange,
)
from split_cli.diagnosis.statement.result import Diagnosis, Finding, ParameterEstimate
from split_cli.diagnosis.statement.sentences import not_accepted, summarise
from split_cli.diagnosis.verdict.corrected_vehicle import judge_corrected
from split_cli.diagnosis.verdict.held_out_judgement import HeldOutFit, HeldOutJudgement, with_nameless_parts
from split_cli.diagnosis.verdict.held_out_split import HeldOut
from split_cli.diagnosis.verdict.label_errors import in_standard_errors
from split_cli.logs.drive_metadata import OF_REAR_TIRES
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import Range
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.diagnose import corrected_vehicle, write_diagnosis
from split_cli.workflows.drive_charts import diagnosis_charts
from split_cli.workflows.report.page import report_page
from split_cli.workflows.verifying.verify_folders import verify_diagnosis
from tests.diagnosis.recordings import recorded
from tests.factories import make_drive, road_car


def resistance(force: float):
    return CATALOGUE["rolling_resistance"]({"force": force})


@pytest.fixture(scope="module")
def judged():
    evidence = recorded(11, (resistance(450.0),))
    held = evidence.series.t > 0.75 * evidence.series.t[-1]
    return {force: judge_corrected([(evidence, held)], (resistance(force),)) for force in (450.0, -450.0)}


def test_true_physics_is_accepted_and_its_opposite_is_worse(judged):
    """450 N on 1,500 kg take 0.6 m/s in 2 s; left out that is the error, added with the wrong sign twice that."""
    right, wrong = judged[450.0], judged[-450.0]
    assert right.accepted and not wrong.accepted
    last = {one.channel: one for one in right.states if one.horizon == 2.0}
    assert last["v_x"].is_better and last["v_x"].corrected < 0.2 * last["v_x"].nominal
    # Within one step a force along the car moves nothing but v_x.
    assert [one.channel for one in wrong.states if one.is_worse and one.horizon < 0.1] == ["v_x"]
    far = next(one for one in wrong.states if (one.channel, one.horizon) == ("v_x", 2.0))
    assert far.corrected == pytest.approx(2.0 * far.nominal, rel=0.1)


@pytest.mark.parametrize(
    ("kinds", "judged"),
    [
        ({"T": "derived from v_x by the nominal model"}, ["v_y", "r"]),
        ({"vy": f"derived: from a_y {OF_REAR_TIRES}"}, ["v_x", "r"]),
    ],
)
def test_what_was_derived_by_the_model_leaves_its_state_out(kinds, judged):
    """A nominal model with a torque that was computed from v_x repeats v_x, so any resistance would seem wrong."""
    evidence = recorded(11, (resistance(450.0),))
    kinds = {**evidence.series.drive.metadata.kinds, **kinds}
    drive = replace(evidence.series.drive, metadata=replace(evidence.series.drive.metadata, kinds=kinds))
    derived = replace(evidence, series=replace(evidence.series, drive=drive))
    held = evidence.series.t > 0.75 * evidence.series.t[-1]
    wrong = judge_corrected([(derived, held)], (resistance(-450.0),))
    assert [one.channel for one in wrong.states] == judged * 2


def test_nothing_of_the_car_is_nothing_to_objective(judged):
    turned = CATALOGUE["sensor_misalignment"]({"angle": 0.02})
    evidence = recorded(11)
    assert judge_corrected([(evidence, np.ones(len(evidence.series), dtype=bool))], (turned,)) is None


def test_what_has_no_name_joins_the_file_where_the_names_alone_are_worse(tmp_path):
    """160 N less resistance and 300 N more by another name: the first alone is twice as wrong as neither."""
    less, more = resistance(-160.0), resistance(300.0)
    evidence = recorded(11, (less, more))
    held = evidence.series.t > 0.75 * evidence.series.t[-1]
    kind = Candidate("rolling_resistance", "", {"force": Range(-1000.0, 1000.0, 1.0)}, ())
    whole = Fit((Part(kind, {"force": -160.0}), Part(kind, {"force": 300.0})), 0.0, np.zeros(0), np.zeros((0, 2)))
    shared = build_shared_discrepancy(evidence.vehicle, evidence.series)
    case = SimpleNamespace(real=(evidence,), holdout=(), simulated=(), posterior=None, discrepancy=shared)
    fit = HeldOutFit(case, None, whole, HeldOut(None, None, (held,)), whole)
    alone = judge_corrected(fit.recordings, (less,))
    judged = HeldOutJudgement(found(alone, -160.0).findings, None, fit.improvement((less,)), alone)
    assert not alone.accepted
    # Nothing changes where every part has a name, or the whole fit is as bad.
    assert with_nameless_parts(fit, (True, True), judged) is judged
    bad = replace(whole, parts=(whole.parts[0], Part(kind, {"force": -300.0})))
    assert with_nameless_parts(replace(fit, whole=bad, trained=bad), (True, False), judged) is judged
    # Nor where it is right on the held-out drive alone.
    unlike = SimpleNamespace(**{**vars(case), "real": (recorded(12),), "holdout": (evidence,)})
    nowhere = HeldOut(None, None, (np.zeros(len(unlike.real[0].series), dtype=bool),))
    assert with_nameless_parts(replace(fit, case=unlike, split=nowhere), (True, False), judged) is judged
    joined = with_nameless_parts(fit, (True, False), judged)
    assert joined.corrected.accepted and joined.corrected.alone is alone
    assert [dict(one.parameters) for one in joined.corrected.further] == [{"force": 300.0}]
    assert joined.improvement.rollouts[-1].physics[0] < 0.2 * judged.improvement.rollouts[-1].physics[0]

    stated = replace(found(joined.corrected, -160.0), improvement=joined.improvement)
    write_diagnosis(stated, road_car(), tmp_path)
    effects = read_vehicle(tmp_path / "vehicle_corrected.yaml").effects
    assert sorted(dict(one.parameters)["force"] for one in effects) == [-160.0, 300.0]
    Draft202012Validator(read_schema()).validate(json.loads(diagnosis_to_text(stated)))
    failed = [one for one in verify_diagnosis(tmp_path) if one.passed is False]
    assert not failed, failed
    words = " ".join(summarise("mismatch", stated.findings, corrected=joined.corrected))
    assert "also holds rolling resistance (rolling_resistance)" in words
    assert "Without them the file would predict worse than the given one on held-out data: v_x" in words
    assert "also holds rolling resistance" in (tmp_path / "report.html").read_text(encoding="utf-8")


def found(corrected: CorrectedVehicle, value: float = -450.0) -> Diagnosis:
    force = ParameterEstimate(value, 10.0, "N", (value - 20.0, value + 20.0))
    finding = Finding("rolling_resistance", "", {"force": force}, 0.5, (), "Said.", 1.0)
    return Diagnosis("mismatch", 1e-9, 1.0, findings=(finding,), corrected_vehicle=corrected)


def test_a_vehicle_that_is_worse_is_marked_in_name_head_json_and_report(tmp_path, judged):
    accepted, rejected = found(judged[450.0]), found(judged[-450.0])
    write_diagnosis(accepted, road_car(), tmp_path)
    assert (tmp_path / "vehicle_corrected.yaml").exists()
    write_diagnosis(rejected, road_car(), tmp_path)
    # The earlier file would be taken for this diagnosis's.
    assert not (tmp_path / "vehicle_corrected.yaml").exists()
    head = (tmp_path / "vehicle_rejected.yaml").read_text(encoding="utf-8")
    assert head.startswith("# NOT ACCEPTED.") and "v_x after 2 s" in " ".join(head.replace("#", " ").split())
    assert yaml.safe_load(head)["effects"] and read_vehicle(tmp_path / "vehicle_rejected.yaml").effects
    told = json.loads((tmp_path / "diagnosis.json").read_text())["corrected_vehicle"]
    assert told["file"] == "vehicle_rejected.yaml" and told["accepted"] is False
    assert [one["worse"] for one in told["states"] if (one["channel"], one["horizon"]) == ("v_x", 2.0)] == [True]
    Draft202012Validator(read_schema()).validate(json.loads(diagnosis_to_text(rejected)))
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    # Before the summary that ends with it, and not where the file is better.
    assert 0 < page.index("Do not rely on these names yet") < page.index("Said.")
    assert "Do not rely on these names" not in report_page(accepted)
    assert not accepted.doubt and rejected.doubt.startswith("Do not rely on these names yet")
    assert "vehicle_rejected.yaml" in page and "vehicle_corrected.yaml" not in page


def test_the_file_holds_what_was_judged_and_that_is_verified(tmp_path, judged):
    alone = replace(judged[450.0], values={"rolling_resistance": {"force": 440.0}})
    write_diagnosis(found(alone), road_car(), tmp_path)
    (effect,) = read_vehicle(tmp_path / "vehicle_corrected.yaml").effects
    assert dict(effect.parameters) == {"force": 440.0}
    told = [one for one in verify_diagnosis(tmp_path) if "vehicle_corrected.yaml" in one.check]
    assert told and all(one.passed for one in told), told
    Draft202012Validator(read_schema()).validate(json.loads(diagnosis_to_text(found(alone))))


def test_the_charts_are_those_of_the_file(judged):
    """They drew values of a joint fit, of which the file holds others: names alone may make a car spin."""
    drive, car = make_drive(1, 3, 2.0, vehicle=road_car(), name="lap.parquet"), road_car()
    drawn = []
    for name, values in ((-450.0, {"rolling_resistance": {"force": 440.0}}), (440.0, {})):
        diagnosis = found(replace(judged[450.0], values=values))
        named = replace(diagnosis.findings[0].parameters["force"], value=name)
        diagnosis = replace(diagnosis, findings=(replace(diagnosis.findings[0], parameters={"force": named}),))
        charts = diagnosis_charts(diagnosis, car, corrected_vehicle(diagnosis, car), [drive])
        strip = next(one for one in charts if one.name == "strip-vx")
        drawn.append(next(line.y for line in strip.series if line.name == "with the identified effects"))
    np.testing.assert_array_equal(*drawn)


def improvement_of(last: HorizonErrors, removed=(0.5, 0.4, 0.6)) -> Improvement:
    row = (0.1, 0.1, 0.1)
    return Improvement(row, row, row, row, row, row, {}, (last,), {"physics": removed})


def test_the_summary_tells_what_changed_most_in_noise_and_what_got_worse():
    """v_x changes most in m/s, r most in noise (90 against 20 times), v_y gets worse beyond chance."""
    last = HorizonErrors(
        2.0,
        (3.0, 0.2, 0.1),
        (1.0, 0.3, 0.01),
        (3.0, 0.2, 0.1),
        (1.0, 0.3, 0.01),
        (2.0, 0.25, 0.05),
        (0.1, 0.01, 0.001),
        {},
        40,
        {"physics": (0.5, 3.0, -5.0)},
    )
    finding = found(CorrectedVehicle(())).findings
    text = " ".join(summarise("mismatch", finding, improvement=improvement_of(last)))
    assert "error of r changes from 0.10 to 0.010 rad/s (persistence: 0.050; noise floor: 0.0010)" in text
    assert "The error of v_y rises from 0.20 to 0.30 m/s" in text
    assert "Persistence still predicts v_y better." in text
    assert "v_x" not in text
    # A state that only changed within chance is not said to be worse.
    calm = replace(last, change={"physics": (0.5, 1.0, -5.0)})
    assert "rises" not in " ".join(summarise("mismatch", finding, improvement=improvement_of(calm)))


@pytest.mark.parametrize(
    ("removed", "words"),
    [
        ((0.5, 0.4, 0.6), "falls by 50 % (95 %: 40 to 60 %)"),
        ((-0.08, -0.51, 0.21), "rises by 8 % (95 %: -21 to 51 %, within chance)"),
        ((-0.3, -0.5, -0.1), "rises by 30 % (95 %: 10 to 50 %)"),
    ],
)
def test_an_error_that_rises_is_said_to_rise(removed, words):
    row = (0.1, 0.1, 0.1)
    last = HorizonErrors(2.0, row, row, row, row, row, (0.01, 0.01, 0.01), {}, 40)
    text = " ".join(
        summarise("mismatch", found(CorrectedVehicle(())).findings, improvement=improvement_of(last, removed))
    )
    assert f"the squared one-step error above the noise floor {words}." in text
    assert "Persistence" not in text


def test_a_state_is_worse_beyond_chance_and_beyond_noise_only():
    worse = StateChange("r", "rad/s", 2.0, 0.01, 0.02, 0.05, 0.001, 3.0)
    assert worse.is_worse and not worse.is_better
    assert not replace(worse, change=1.5).is_worse
    assert not replace(worse, noise_floor=0.03).is_worse


def test_a_file_that_spins_in_one_place_is_rejected_where_standard_errors_see_no_change():
    """One of six blocks holds the whole increase: the mean is one standard error of it, whatever its size."""
    increase = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1e6])
    assert in_standard_errors(np.repeat(increase, 3)[:, None], np.repeat(np.arange(6), 3))[0] < NORMAL_95
    spun = StateChange("v_x", "m/s", 2.0, 0.47, 3.57, 2.17, 0.02, 1.5)
    calm = StateChange("v_x", "m/s", 0.05, 0.04, 0.02, 0.11, 0.02, -1.3)
    rejected = CorrectedVehicle((calm, spun, replace(spun, channel="v_y", nominal=1.08, corrected=2.58)))
    assert rejected.runs_away and not rejected.accepted
    assert "v_x after 2 s (3.6 instead of 0.47 m/s)" in not_accepted(rejected)
    assert "velocities held as they are would be nearer (v_x 2.2 m/s" in not_accepted(rejected)
    nearly = replace(spun, nominal=0.0191, corrected=0.0194, persistence=0.01, change=9.0)
    assert "(0.0194 instead of 0.0191 m/s)" in not_accepted(CorrectedVehicle((nearly,)))
    # One velocity that is a little beyond the held one does not make a model that runs away.
    assert CorrectedVehicle((replace(spun, corrected=2.2), replace(spun, channel="v_y", corrected=1.0))).accepted
    # Where the given file is beyond the held velocities too, standard errors decide alone.
    assert CorrectedVehicle((replace(spun, nominal=2.5),)).accepted


def improvement_with(
    ways: dict[str, str], change: tuple[float, ...] = (-4.0, -5.0, 0.5), least: float = 0.7
) -> Improvement:
    """Return an improvement of three errors, of which terms change the squares by so many standard errors."""
    three = (1.0, 1.0, 1.0)
    last = HorizonErrors(2.0, three, three, three, three, three, three, {}, 10, {"physics": change})
    parts = {"before": ways, "physics": ways}
    removed = {"physics": (0.9, least, 1.0)}
    return Improvement(three, three, three, three, three, None, {}, (last,), removed, parts)


TAUGHT = {"longitudinal": "nominal", "lateral": "taught"}


def test_names_that_correct_the_simulation_hold_where_the_file_alone_gets_worse(judged):
    """A file lacks what the simulation has as well; that may cancel with an effect that only reality has."""
    rejected = found(judged[-450.0])
    held = replace(rejected, improvement=improvement_with(TAUGHT)).doubt
    assert held.startswith("The names hold beside the simulation.")
    for doubtful in (
        improvement_with({"longitudinal": "nominal", "lateral": "nominal"}),  # the simulation is not used
        improvement_with(TAUGHT, change=(-4.0, -5.0, 2.5)),  # r gets worse beyond chance
        improvement_with(TAUGHT, least=-0.1),  # nothing is removed for certain
    ):
        assert replace(rejected, improvement=doubtful).doubt.startswith("Do not rely on these names yet")
