"""`split evaluate` as a user runs it: its table, its JSON, its figures, and what it refuses."""

import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SplitError
from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import DriveMetadata, read_drive, write_drive
from split_cli.prediction import make_predictor
from split_cli.vehicle.parameters import read_vehicle, write_vehicle
from split_cli.vehicle.tire import MagicFormula
from tests.factories import MissingForce, make_drive, write_garage

TERM = MissingForce({"front_grip_loss": 0.15, "front_lateral": 150.0})
#: What every drive without metadata, and every other drive than the set's, has said of it.
PLAIN_NOTES = "T and delta: the recording does not say|lie farther than a length scale from every point"


@pytest.fixture(scope="module")
def garage(tmp_path_factory) -> Path:
    """A folder with two drives, a vehicle, another vehicle, and a set trained on the first drive."""
    folder = write_garage(tmp_path_factory.mktemp("garage"), segments=12, seconds=5.0, terms=[TERM])
    asked = ("train", folder / "d0.parquet", "--vehicle", folder / "car.yaml", "-o", folder / "a.split")
    trained = run(*asked, "--trust", "full")
    assert trained.exit_code == 0, trained.output
    return folder


def run(*arguments: object):
    return CliRunner().invoke(group, [str(part) for part in arguments], catch_exceptions=True)


@pytest.fixture(scope="module")
def told(garage) -> dict:
    """What the held-out protocol says of both drives, as JSON."""
    outcome = run(
        "evaluate",
        garage / "d0.parquet",
        garage / "d1.parquet",
        "--vehicle",
        garage / "car.yaml",
        "--predictor",
        "bcm,full",
        "--rollout",
        "0.4,0.8",
        "--json",
    )
    assert outcome.exit_code == 0, outcome.output
    return json.loads(outcome.stdout)


def test_the_keys_of_the_json_are_a_promise(told):
    assert told["format"] == "split-evaluation/1"
    parts = """settings vehicle drives sets scores noise_floor rollouts sizes comparisons verdicts intervals notes
        format"""
    assert sorted(told) == sorted(parts.split())
    scores = """name features drive points samples samples_valid rmse rmse_valid skill_nominal skill_velocity_held
        skill_label_held nlpd coverage_50 coverage_95 time_per_query uses_recorded_future"""
    drives = "name sha256 duration labels tested tested_valid in_sample held_out noise_floor notes"
    rollouts = "name features horizon starts diverged rmse distance"
    intervals = "name features near samples share coverage_50 coverage_90 coverage_95"
    parts = (("scores", scores), ("drives", drives), ("rollouts", rollouts), ("intervals", intervals))
    for part, names in parts:
        assert sorted(told[part][0]) == sorted(names.split())
    assert sorted(told["sets"][0]) == sorted(["features", "points", "cells", "kernel", "trust", "found"])
    names = "protocol predictors features sizes blocks holdout guard rollout horizon held trust any_vehicle"
    assert sorted(told["settings"]) == sorted(names.split())


def test_pooled_scores_are_those_of_the_drives_pooled_by_squares(told):
    for name in ("nominal", "velocity held", "bcm", "full"):
        alone = [entry for entry in told["scores"] if entry["name"] == name]
        pooled, parts = alone[0], alone[1:]
        assert pooled["drive"] == ""
        assert [entry["drive"] for entry in parts] == ["d0.parquet", "d1.parquet"]
        counts = np.array([entry["samples"] for entry in parts])
        squares = np.square([entry["rmse"] for entry in parts])
        np.testing.assert_allclose(pooled["rmse"], np.sqrt(counts @ squares / counts.sum()), rtol=1e-12)
        assert pooled["samples"] == counts.sum()
    by_name = {entry["name"]: entry for entry in told["scores"] if not entry["drive"]}
    # The planted loss of grip is a function of z2: what is left is far below the nominal error, and calibrated.
    assert by_name["full"]["rmse"][3] < 0.3 * by_name["nominal"]["rmse"][3]
    assert by_name["bcm"]["time_per_query"] < by_name["full"]["time_per_query"]
    assert by_name["nominal"]["skill_nominal"] == [0.0] * 4
    starts = {(entry["name"], entry["horizon"]): entry for entry in told["rollouts"]}
    assert starts["full", 0.8]["rmse"][2] < 0.5 * starts["nominal", 0.8]["rmse"][2]
    assert starts["full", 0.8]["distance"] is None


def test_a_set_is_scored_on_whole_drives_as_the_library_scores_it(garage):
    outcome = run("evaluate", garage / "d1.parquet", "--set", garage / "a.split", "--rollout", "", "--json")
    found = json.loads(outcome.stdout)
    drive, trained = read_drive(garage / "d1.parquet"), read_set(garage / "a.split")
    labels = compute_labels(drive, trained.vehicle, Z2, trained.region, horizon=trained.horizon)
    usable = labels.take(np.isfinite(labels.y).all(axis=1))
    error = usable.y - make_predictor("bcm", trained).predict(usable.z).mean
    scores = {entry["name"]: entry for entry in found["scores"]}
    np.testing.assert_allclose(scores["bcm"]["rmse"][:3], np.sqrt(np.mean(error**2, axis=0)), rtol=1e-10)
    np.testing.assert_allclose(scores["nominal"]["rmse"][:3], np.sqrt(np.mean(usable.y**2, axis=0)), rtol=1e-12)
    assert scores["bcm"]["samples"] == len(usable)
    assert found["rollouts"] == []
    assert not found["drives"][0]["in_sample"]
    assert all(re.search(PLAIN_NOTES, note) for note in found["notes"])


def test_the_tables_show_baselines_and_the_floor(garage):
    outcome = run("evaluate", garage / "d1.parquet", "--set", garage / "a.split", "--rollout", "0.4")
    assert outcome.exit_code == 0
    rows = [line.split("  ")[0] for line in outcome.stdout.splitlines()]
    for name in ("nominal", "velocity held", "last label held", "bcm"):
        assert name in rows
    assert any(line.startswith("noise floor") for line in rows)
    for word in ("NLPD", "in 95 %", "skill", "us/query", "m/s^2", "Rollouts", "position"):
        assert word in outcome.stdout
    # Not a terminal: no progress, and nothing to note but what every plain table leaves open.
    *noted, following = outcome.stderr.splitlines()
    assert all(re.search(PLAIN_NOTES, line) for line in noted)
    exported = f"split export {garage / 'a.split'} --target c -o a_controller/"
    assert following == f"next: where the correction helps, {exported}"
    # The last line is the verdict on the predictor that is named first, as a terminal shows it.
    assert rows[-1].startswith("projected z2 verdict: the correction helps")
    assert sum("verdict:" in line for line in rows) > 1


def test_scores_on_a_drive_the_set_was_trained_on_are_marked(garage, tmp_path):
    renamed = tmp_path / "another_name.parquet"
    renamed.write_bytes((garage / "d0.parquet").read_bytes())
    outcome = run("evaluate", renamed, garage / "d1.parquet", "--set", garage / "a.split", "--rollout", "", "--json")
    found = json.loads(outcome.stdout)
    assert [drive["in_sample"] for drive in found["drives"]] == [True, False]
    assert "note: IN SAMPLE: the set was trained on another_name.parquet" in outcome.stderr
    assert sum("IN SAMPLE" in note for note in found["notes"]) == 1
    alone = run("evaluate", renamed, "--set", garage / "a.split", "--rollout", "")
    assert alone.stdout.splitlines()[0].split(", ")[1] == "protocol in sample"


def test_without_a_set_the_drives_go_on_to_the_diagnosis(garage):
    vehicle = garage / "car.yaml"
    outcome = run("evaluate", garage / "d1.parquet", "--vehicle", vehicle, "--predictor", "bcm", "--rollout", "")
    expected = f"next: split diagnose --real {garage / 'd1.parquet'} --vehicle {vehicle} --out d1_diagnosis/"
    assert outcome.stderr.splitlines()[-1] == expected


def test_what_was_learned_leads_to_another_drive_and_not_to_an_export(garage):
    outcome = run("evaluate", garage / "d0.parquet", "--set", garage / "a.split", "--rollout", "", "--predictor", "bcm")
    following = f"split evaluate ANOTHER_DRIVE --set {garage / 'a.split'}"
    assert outcome.stderr.splitlines()[-1] == f"next: these drives were learned, so take another one, {following}"
    assert "split export" not in outcome.stderr


def test_a_vehicle_file_that_spins_leads_to_a_calibration_and_not_to_an_export(garage, tmp_path):
    """Tyres that carry less than the car asked of them: the verdict was that the correction helps."""
    car = read_vehicle(garage / "car.yaml")
    rear = car.rear_tire
    weak = replace(car, rear_tire=MagicFormula(rear.B / 0.35, rear.C, 0.35 * rear.D))
    write_vehicle(weak, tmp_path / "weak.yaml")
    asked = ("--vehicle", tmp_path / "weak.yaml")
    trained = run("train", garage / "d0.parquet", *asked, "-o", tmp_path / "weak.split", "--trust", "0,0,0")
    assert trained.exit_code == 0, trained.output
    outcome = run("evaluate", garage / "d1.parquet", *asked, "--set", tmp_path / "weak.split", "-o", tmp_path / "page")
    assert outcome.exit_code == 0, outcome.output
    assert "WARNING: the corrected model (projected) runs away, as in a spin: after 2 s" in outcome.stderr
    assert "note: d1.parquet: its rear axle carried" in outcome.stderr
    assert "The model runs away, with the correction and without" in (tmp_path / "page" / "report.html").read_text()
    following = outcome.stderr.splitlines()[-1]
    assert following.startswith("next: the vehicle file runs away on this driving") and "split calibrate" in following
    assert "split export" not in following


def test_the_papers_protocol_is_marked_in_sample_and_takes_100_samples(garage):
    arguments = ("evaluate", garage / "d1.parquet", "--vehicle", garage / "car.yaml", "--protocol", "paper")
    outcome = run(*arguments, "--features", "z1,z2", "--json")
    found = json.loads(outcome.stdout)
    assert "IN SAMPLE: the paper's protocol trains on the very lap it scores" in outcome.stderr
    assert [(entry["size"], entry["score"]["features"]) for entry in found["sizes"]] == [(100, "z1"), (100, "z2")]
    assert all(entry["score"]["points"] <= 100 for entry in found["sizes"])
    assert {entry["name"] for entry in found["scores"]} == {"nominal", "velocity held", "last label held"}
    assert found["rollouts"] == []


def test_fitc_is_said_to_know_the_future(garage, tmp_path):
    drive = read_drive(garage / "d1.parquet")
    write_drive(drive.select(slice(0, 2 * 251)), tmp_path / "d1.parquet")
    arguments = ("evaluate", tmp_path / "d1.parquet", "--set", garage / "a.split", "--predictor", "fitc,bcm")
    outcome = run(*arguments, "--rollout", "", "--json")
    scores = {entry["name"]: entry for entry in json.loads(outcome.stdout)["scores"]}
    assert scores["fitc"]["uses_recorded_future"]
    assert not scores["bcm"]["uses_recorded_future"]
    assert "recorded future" in outcome.stderr


def test_a_torque_derived_from_acceleration_is_noted(garage, tmp_path):
    kinds = {"T": "derived: torque from dv_x/dt - v_y r of smoothed v_x by the nominal model of test car"}
    drive = replace(read_drive(garage / "d1.parquet"), metadata=DriveMetadata(kinds=kinds))
    write_drive(drive, tmp_path / "derived.parquet")
    outcome = run("evaluate", tmp_path / "derived.parquet", "--set", garage / "a.split", "--rollout", "")
    assert "the longitudinal label then says nothing" in outcome.stderr
    told = [line for line in outcome.output.splitlines() if "verdict:" in line or "WARNING" in line]
    assert told and not any("v_x" in line for line in told)


def test_drives_of_another_label_interval_have_no_common_rollouts(garage, tmp_path):
    """At 50 Hz 0.05 s becomes 0.04 s, at 100 Hz it stays: steps of both cannot be pooled."""
    fine = make_drive(5, segments=6, seconds=5.0, period=0.01, terms=[TERM], name="fine.parquet")
    write_drive(fine, tmp_path / "fine.parquet")
    both = (tmp_path / "fine.parquet", garage / "d1.parquet")
    alone = json.loads(run("evaluate", both[0], "--set", garage / "a.split", "--json").stdout)
    outcome = run("evaluate", *both, "--set", garage / "a.split", "--json")
    assert "no rollouts of d1.parquet: its label interval is 0.04 s, not 0.05 s" in outcome.stderr
    assert json.loads(outcome.stdout)["rollouts"] == alone["rollouts"]


def test_rollouts_longer_than_every_drive_are_said_to_be_missing(garage):
    """The time of 1e308 s was an error of the program, and 1e9 s took all memory."""
    outcome = run("evaluate", garage / "d1.parquet", "--set", garage / "a.split", "--rollout", "1e308", "--json")
    assert "no stretch of test data lasts 1e+308 s" in outcome.stderr
    assert json.loads(outcome.stdout)["rollouts"] == []


def test_figures_are_written_and_named(garage, tmp_path):
    outcome = run("evaluate", garage / "d1.parquet", "--set", garage / "a.split", "-o", tmp_path / "figures", "--json")
    json.loads(outcome.stdout)
    names = {path.name for path in (tmp_path / "figures").iterdir()}
    assert {"label-vy.png", "growth.png", "coverage.png", "gg.png", "coverage-r.png", "strip-vy.png"} <= names
    assert f"split: {len(names) - 2} figures in {tmp_path / 'figures'}" in outcome.stderr
    assert "not drawn: sizes.png" in outcome.stderr


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--vehicle", "other.yaml", "--set", "a.split"), "was trained for another vehicle of the same name, test car"),
        ((), "needs a vehicle or a trained set"),
        (("a.split",), "is a trained set, not a drive. Name drives first, then the set: split eval"),
        (("--set", "a.split", "--predictor", "bmc"), "no predictor 'bmc'. Did you mean bcm"),
        (("--vehicle", "car.yaml", "--features", "alpha_f,alpha_q"), "no feature 'alpha_q'. Did you mean alpha_"),
        (("--set", "a.split", "--protocol", "paper"), "the paper's protocol trains on the lap that it scores"),
        (("--set", "a.split", "--sizes", "100"), "trains sets of its own, and --set gives one"),
        (("--vehicle", "car.yaml", "--sizes", "-5"), "holds a number that is not positive"),
        (("--vehicle", "car.yaml", "--rollout", "-1"), "holds a number that is not positive"),
        (("--vehicle", "car.yaml", "--features", ","), "no feature set or no predictor"),
        (("--vehicle", "car.yaml", "--holdout", "1.5"), "cannot be made"),
        (("--vehicle", "car.yaml", "--guard", "30"), "Use fewer blocks or a shorter guard"),
        (("--vehicle", "car.yaml", "--horizon", "-1"), "the label horizon is -1"),
        (("--vehicle", "car.yaml", "--horizon", "1e308"), "the label horizon is 1e+308"),
    ],
)
def test_what_makes_no_sense_is_refused_in_words(garage, arguments, message):
    named = [garage / part if part.endswith((".yaml", ".split")) else part for part in arguments]
    outcome = run("evaluate", garage / "d1.parquet", *named)
    assert isinstance(outcome.exception, SplitError), outcome.output
    assert message in str(outcome.exception)


def test_a_drive_too_short_or_too_slow_is_refused(garage, tmp_path):
    drive = read_drive(garage / "d1.parquet")
    write_drive(drive.select(slice(0, 40)), tmp_path / "short.parquet")
    slow = {**drive.columns, "vx": 0.01 * drive["vx"]}
    write_drive(replace(drive, columns=slow), tmp_path / "slow.parquet")
    for name, message in (("short", "of the drive for training"), ("slow", "inside the valid region")):
        outcome = run("evaluate", tmp_path / f"{name}.parquet", "--vehicle", garage / "car.yaml")
        assert isinstance(outcome.exception, SplitError), outcome.output
        assert message in str(outcome.exception)
        assert f"{name}.parquet" in str(outcome.exception)


def test_figures_need_a_folder_to_be_in(garage, tmp_path):
    (tmp_path / "file").touch()
    for place, said in ((tmp_path / "no" / "figures", "does not exist"), (tmp_path / "file", "is a file, a folder")):
        outcome = run("evaluate", garage / "d1.parquet", "--set", garage / "a.split", "-o", place)
        assert said in str(outcome.exception)
        # Before any work: half a minute of a diagnosis ended so.
        outcome = run("diagnose", "--real", garage / "d1.parquet", "--vehicle", "road_car", "--out", place)
        assert said in str(outcome.exception)
