"""Speed and yaw rate against position and yaw: a scale that is off is told, and physics like it is not named."""

from dataclasses import replace
from types import SimpleNamespace

import jsonschema
import numpy as np
import pytest

from split_cli.diagnosis.recording.kinematics import KinematicResiduals, build_kinematics
from split_cli.diagnosis.recording.scales import out_of_scale, scale_of, scales_as_terms
from split_cli.diagnosis.recording.witnesses import build_witnesses
from split_cli.diagnosis.search.baselines import SearchOutcome, with_witnessed_names
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.selection import Selection
from split_cli.diagnosis.search.term_tests import contradicts_yaw
from split_cli.diagnosis.statement.document import diagnosis_to_mapping, read_schema
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.verdict.findings import _stays_beside
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import (
    bare_objective,
    candidates_of,
    driven,
    faulty,
    light_evidence,
    noisy,
    prepared,
    verdict_of,
)
from tests.factories import road_car


def recording(seed: int, *terms, **scales: float) -> Drive:
    drive = noisy(driven(seed, terms, runs=8, seconds=8.0, spaced=9.0), seed + 500, position=0.01)
    columns = {name: by * drive[name] for name, by in scales.items()}
    return replace(drive, columns={**drive.columns, **columns}, sha256="")


def kinematics_of(seed: int, *terms, **scales: float) -> KinematicResiduals:
    return build_kinematics(prepared(recording(seed, *terms, **scales)))


@pytest.mark.parametrize(("channel", "name"), [("vx", "v_x"), ("r", "r")])
def test_a_scale_is_recovered(channel, name):
    for by in (1.0, 1.03, 0.98):
        scale, error = scale_of(name, [kinematics_of(21, **{channel: by})])
        assert error < 2e-3 and abs(scale - by) < 4.0 * error + 2e-4


def test_a_scale_is_the_ratio_of_sums_of_a_single_stretch():
    kinematics = kinematics_of(22, r=1.05)
    made, true = kinematics.against_position("r")
    scale, error = scale_of("r", [kinematics])
    assert scale == pytest.approx(float(made @ true / (true @ true)), abs=4.0 * error)


def test_what_is_out_of_scale_is_told_with_its_size():
    (sentence,) = out_of_scale([kinematics_of(23, vx=1.03)], [kinematics_of(24)])
    assert "the integral of v_x is 3 % more than" in sentence and "in the simulation they agree" in sentence
    (sentence,) = out_of_scale([kinematics_of(23, r=0.95)], [])
    assert "the integral of r is 5 % less than" in sentence and "simulation" not in sentence


def test_neither_physics_nor_a_habit_of_both_is_out_of_scale():
    heavy = faulty(recording(25, CATALOGUE["mass"]({"scale": 1.2})), angle=0.02, dx=0.5)
    assert not out_of_scale([build_kinematics(prepared(heavy))], [kinematics_of(26)])
    assert not out_of_scale([kinematics_of(25, vx=1.03)], [kinematics_of(26, vx=1.03)])
    assert not out_of_scale([kinematics_of(25, vx=1.008)], [kinematics_of(26)])
    assert not out_of_scale([], [])


def test_a_car_that_does_not_turn_tells_no_scale_of_its_yaw_rate():
    kinematics = kinematics_of(27)
    still = replace(kinematics, angle=np.zeros_like(kinematics.angle))
    assert scale_of("r", [still]) is None


@pytest.mark.parametrize("bias", [0.0, 0.02])
def test_yaw_denies_a_bias_of_the_yaw_rate_that_is_not_there(bias):
    """Mean changes of yaw against the mean integral of r: the share of the fault that they confirm is its size."""
    drive = recording(28)
    drive = replace(drive, columns={**drive.columns, "r": drive["r"] + bias})
    series = prepared(drive)
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))

    def denied(term: str, values: dict[str, float]) -> bool:
        (one,) = (one for one in candidates_of(objective, term) if not one.variant)
        return contradicts_yaw(objective, Fit((Part(one, values),), 0.0, np.empty(0), np.empty((0, 0))), 0)

    assert denied("yaw_rate_bias", {"r": 0.02}) is (bias == 0.0)
    assert denied("yaw_rate_scale", {"scale": 1.1}) or bias
    # What positions would show has a reference that may be turned as well.
    assert not denied("sensor_misalignment", {"angle": 0.05})


def test_a_yaw_that_was_integrated_from_the_yaw_rate_denies_nothing():
    drive = noisy(recording(28), 528)
    integrated = drive["yaw"].copy()
    for rows in drive.segments():
        integrated[rows] = np.concatenate([[0.0], np.cumsum(drive["r"][rows][:-1])]) * drive.period
    for yaw, of_its_own in ((drive["yaw"], True), (integrated, False), (np.round(integrated, 5), False)):
        series = prepared(replace(drive, columns={**drive.columns, "yaw": yaw}))
        objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))
        (one,) = (one for one in candidates_of(objective, "yaw_rate_bias") if not one.variant)
        fit = Fit((Part(one, {"r": 0.02}),), 0.0, np.empty(0), np.empty((0, 0)))
        assert contradicts_yaw(objective, fit, 0) is of_its_own


def test_where_drives_have_little_in_common_only_witnessed_faults_keep_their_names():
    series = prepared(recording(28))
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))
    acting = {"yaw_rate_scale": {"scale": 0.9}, "steer_gain": {"gain": 0.75}, "mass": {"scale": 1.2}}
    parts = tuple(Part(one, acting[one.term]) for one in candidates_of(objective, *acting) if not one.variant)
    fit = Fit(parts, 0.0, np.zeros(0), np.zeros((0, 0)))
    none = ((),) * len(parts)
    outcome = SearchOutcome(
        SimpleNamespace(objective=objective),
        None,
        Selection(fit, fit, (fit,), none, none, (True,) * len(parts)),
        None,
        1.5,
    )
    assert len(parts) == 3
    assert [one.id for one in with_witnessed_names(outcome).selection.terms] == ["yaw_rate_scale"]


def test_an_offset_of_the_steering_stays_beside_a_yaw_rate_out_of_scale_and_what_looks_like_one_does_not():
    drive = recording(29, CATALOGUE["steer_offset"]({"offset": 0.01}), r=0.95)
    series = prepared(drive)
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))
    scales = scales_as_terms([build_kinematics(series)], [])
    assert scales["yaw_rate_scale"] == pytest.approx(0.95, abs=2e-3)
    chosen = fit_parts(
        objective, [Part(one, dict(one.starts[0])) for one in candidates_of(objective, "steer_gain", "steer_offset")]
    )
    about = {"offset": (0.009, 0.011), "gain": (0.5, 1.5)}
    findings = [
        SimpleNamespace(
            term=part.candidate.term,
            parameters={name: ParameterEstimate(x, 0.0, "", about[name]) for name, x in part.values.items()},
        )
        for part in chosen.parts
    ]
    assert _stays_beside(objective, SimpleNamespace(chosen=chosen), findings, scales) == {"steer_offset"}
    elsewhere = {"offset": ParameterEstimate(0.02, 0.0, "", (0.019, 0.021))}
    narrow = [SimpleNamespace(term="steer_offset", parameters=elsewhere)]
    assert not _stays_beside(objective, SimpleNamespace(chosen=chosen), narrow, scales)


def test_a_speed_out_of_scale_is_named_beside_a_turned_sensor_and_contradicts_nothing_then():
    """Without position it would be a match or a mass: 3 % of speed are 3 % of every force."""
    said = verdict_of([faulty(recording(83, vx=1.03), angle=0.02)], road_car())
    findings = {one.term: one for one in said.findings}
    assert said.verdict == "mismatch" and set(findings) == {"speed_scale", "sensor_misalignment"}
    scale = findings["speed_scale"]
    low, high = scale.parameters["scale"].interval_95
    assert not scale.exported and low <= 1.03 <= high and high - low < 0.02
    assert not any("integral of" in reason for reason in said.not_judged)
    jsonschema.validate(diagnosis_to_mapping(said), read_schema())
