"""`split label` and `split train` as a user runs them: files reopened with the library, values compared."""

import hashlib
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.learning.cells import recompute_gains
from split_cli.learning.features import Z1, Z2
from split_cli.learning.label_file import read_labels
from split_cli.learning.labels import compute_labels
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive, write_drive
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.cli.hostile import refused
from tests.factories import MissingForce, kernel_to_yaml, road_car, write_garage

TERM = MissingForce({"front_grip_loss": 0.1, "front_lateral": 150.0})


@pytest.fixture(scope="module")
def garage(tmp_path_factory) -> Path:
    """A folder with three drives, a vehicle and given hyperparameters."""
    folder = write_garage(tmp_path_factory.mktemp("garage"), 3, segments=40, seconds=3.0, terms=[TERM])
    (folder / "kernel.yaml").write_text(
        "length_scales: {alpha_f: 0.05, alpha_r: 0.05, torque_ratio: 0.3}\n"
        "signal_variance: {vx: 0.1, vy: 0.2, r: 0.1}\nnoise_variance: {vx: 0.01, vy: 0.01, r: 0.01}\n"
    )
    return folder


def run(*arguments: object):
    return CliRunner().invoke(group, [str(part) for part in arguments], catch_exceptions=True)


def digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def drives_of(garage: Path) -> list[Path]:
    return [garage / f"d{number}.parquet" for number in range(3)]


@pytest.mark.parametrize(
    ("features", "hyperparameters"),
    [("z2", "kernel.yaml"), ("z2", "default"), ("z1", "default"), ("alpha_f,alpha_r,speed,steer_rate", "default")],
)
def test_one_run_equals_appended_runs_and_any_batch(garage, tmp_path, features, hyperparameters):
    if hyperparameters == "kernel.yaml":
        hyperparameters = garage / hyperparameters
    first, second, third = drives_of(garage)
    common = ("--vehicle", garage / "car.yaml")
    new = ("--features", features, "--hyperparameters", hyperparameters, "--trust", "full")
    one, two = tmp_path / "one.split", tmp_path / "two.split"
    assert run("train", first, second, third, *common, *new, "-o", one).exit_code == 0
    assert run("train", first, *common, *new, "-o", two).exit_code == 0
    assert run("train", second, third, *common, "--append", "-o", two).exit_code == 0
    assert digest(one) == digest(two)
    settings = TrainSettings(features=features, hyperparameters=str(hyperparameters), trust="full")
    for batch in (37, 1000):
        train_set([first, second, third], garage / "car.yaml", two, settings, batch=batch)
        assert digest(one) == digest(two)
    assert read_set(one).size > 500


def test_a_fitted_kernel_is_kept_by_appending_and_repeats(garage, tmp_path):
    first, second, _ = drives_of(garage)
    one, two = tmp_path / "one.split", tmp_path / "two.split"
    for path in (one, two):
        assert run("train", first, "--vehicle", garage / "car.yaml", "-o", path, "--trust", "full").exit_code == 0
    assert digest(one) == digest(two)
    fitted = read_set(one)
    assert fitted.kernel.origin == "fitted"
    assert run("train", second, "--vehicle", garage / "car.yaml", "--append", "-o", one).exit_code == 0
    appended = read_set(one)
    assert appended.kernel.length_scales.tolist() == fitted.kernel.length_scales.tolist()
    # Given to a fresh run, the fitted values give the same points.
    given = tmp_path / "fitted.yaml"
    given.write_text(kernel_to_yaml(fitted.kernel, fitted.features))
    both = ("train", first, second, "--vehicle", garage / "car.yaml", "-o", two)
    assert run(*both, "--hyperparameters", given, "--trust", "full").exit_code == 0
    assert read_set(two).gamma.tobytes() == appended.gamma.tobytes()


def test_json_accounts_for_every_sample_and_matches_the_file(garage, tmp_path):
    path = tmp_path / "a.split"
    outcome = run(
        "train", *drives_of(garage), "--vehicle", garage / "car.yaml", "-o", path, "--json", "--trust", "full"
    )
    told = json.loads(outcome.stdout)
    trained = read_set(path)
    assert [row["drive"] for row in told["rows"]] == ["d0.parquet", "d1.parquet", "d2.parquet"]
    for row in [*told["rows"], told["total"]]:
        rejected = dict(row["rejected"])
        assert row["samples"] == row["accepted"] + sum(n for r, n in rejected.items() if r != "gain")
        assert row["accepted"] == row["updates"] + rejected["gain"]
        assert row["microseconds"] > 0
    assert told["total"]["points"] == trained.size
    assert told["total"]["cells"] == trained.cell_count
    assert told["total"]["valid_share"] == pytest.approx(trained.valid_share())
    assert told["total"]["samples"] == sum(row["samples"] for row in told["rows"])
    np.testing.assert_allclose(told["kernel"]["length_scales"], trained.kernel.length_scales, rtol=1e-12)
    assert trained.gamma.tobytes() == recompute_gains(trained).tobytes()


def test_the_table_has_a_row_a_drive_and_a_total(garage, tmp_path):
    made = ("--vehicle", garage / "car.yaml", "-o", tmp_path / "a.split", "--trust", "full")
    outcome = run("train", *drives_of(garage), *made)
    lines = outcome.stdout.splitlines()
    assert lines[0].split()[:5] == ["drive", "samples", "in", "valid", "region"]
    for column in ("gap", "redundant", "updates", "set size", "cells", "valid region %", "us/sample", "MB"):
        assert column in lines[0]
    assert [line.split()[0] for line in lines[2:6]] == ["d0.parquet", "d1.parquet", "d2.parquet", "total"]
    # Not a terminal: no progress; said once what these drives do not tell, and what comes next.
    assert [line.split(":")[0] for line in outcome.stderr.splitlines()] == ["note", "next", "next", "next"]
    # What was learned is no test of what was learned: first another drive, else held-out parts.
    unseen, held_out = (line for line in outcome.stderr.splitlines() if "split evaluate" in line)
    options = f"--vehicle {garage / 'car.yaml'} -o a_figures/"
    taken = f"split evaluate ANOTHER_DRIVE --set {tmp_path / 'a.split'} {options}"
    assert unseen == f"next: on a drive that was not learned, {taken}"
    drives = " ".join(str(path) for path in drives_of(garage))
    assert held_out == f"next: or, if there is none, on held-out parts of these, split evaluate {drives} {options}"
    exported = f"next: where the correction helps, split export {tmp_path / 'a.split'} --target c -o a_controller/"
    assert exported in outcome.stderr and "--held T,delta" in outcome.stderr


def test_points_are_the_labels_of_their_rows(garage, tmp_path):
    path = tmp_path / "a.split"
    options = ("--vehicle", garage / "car.yaml", "-o", path, "--hyperparameters", "default", "--trust", "full")
    assert run("train", *drives_of(garage), *options).exit_code == 0
    trained = read_set(path)
    for source, drive_path in enumerate(drives_of(garage)):
        drive = read_drive(drive_path)
        labels = compute_labels(drive, road_car(), Z2, stride=1)
        mine = trained.source == source
        place = np.searchsorted(labels.row, trained.row[mine])
        np.testing.assert_array_equal(trained.y[mine], labels.y[place])
        np.testing.assert_array_equal(trained.z[mine], labels.z[place])
        np.testing.assert_array_equal(trained.t[mine], drive["t"][trained.row[mine]])
        assert trained.sources[source].sha256 == drive.sha256


def test_excluded_time_is_not_learned(garage, tmp_path):
    path = tmp_path / "a.split"
    options = ("--vehicle", garage / "car.yaml", "-o", path, "--hyperparameters", "default", "--trust", "full")
    assert run("train", drives_of(garage)[0], *options, "--exclude", "20:60", "--exclude", "100:120").exit_code == 0
    trained = read_set(path)
    window = trained.sources[0].horizon
    for begin, end in ((20.0, 60.0), (100.0, 120.0)):
        assert not ((trained.t + window >= begin) & (trained.t < end)).any()
    assert trained.size > 300
    drive = read_drive(drives_of(garage)[0])
    rows = ~(((drive["t"] >= 20) & (drive["t"] < 60)) | ((drive["t"] >= 100) & (drive["t"] < 120)))
    settings = TrainSettings(hyperparameters="default", trust="full")
    train_set(drives_of(garage)[:1], garage / "car.yaml", tmp_path / "b.split", settings, rows=[rows])
    assert digest(path) == digest(tmp_path / "b.split")
    assert run("train", drives_of(garage)[0], *options, "--exclude", "60:20").exit_code == 2


def test_bad_input_is_one_line_and_exit_code_1(garage, tmp_path):
    car, good = garage / "car.yaml", drives_of(garage)[0]
    drive = read_drive(good)
    (tmp_path / "cut.parquet").write_bytes(good.read_bytes()[:5000])
    # A logger's export, all cells in quotes, that lies in the folder of drives.
    (tmp_path / "log.csv").write_text('"Time","GPS_Speed"\n' + '"sec","mph"\n' + '"0.05","31.1"\n' * 3)
    write_drive(drive.select(slice(0, 2)), tmp_path / "short.parquet")
    holes = np.where(np.arange(len(drive)) == 77, np.nan, drive["r"])
    for name, changed in (("holes", {"r": holes}), ("slow", {"vx": 0.01 * drive["vx"]})):
        write_drive(replace(drive, columns={**drive.columns, **changed}), tmp_path / f"{name}.parquet")
    for name, options, message in (
        ("cut.parquet", "", "cut.parquet: cannot be read as a drive"),
        ("none.parquet", "", "none.parquet: no such file"),
        (
            "log.csv",
            "",
            "is no drive: it has no column t. Did you mean Time? Give a recording to `split ingest` first.",
        ),
        ("short.parquet", "--horizon 0.1", "too short for a label"),
        ("holes.parquet", "", "non-finite values in r, the first in row 77"),
        ("slow.parquet", "", "no sample is inside the valid region"),
        (good, "--features alpha_q", "no feature 'alpha_q'. Did you mean alpha_"),
        (good, "--hyperparameters fti", "Give fit, default, or a YAML file"),
        (good, "--threshold 2", "the gain threshold is 2"),
        (good, "--trust 1,2", "the trust '1,2' cannot be read"),
        (good, "--horizon -1", "the label horizon is -1"),
        (good, "--stride 0", "the stride is 0"),
    ):
        asked = ("train", tmp_path / name, "--vehicle", car, *options.split(), "-o", tmp_path / "out.split")
        refused(*asked, says=(message,), output=tmp_path / "out.split")
    cut = tmp_path / "cut.split"
    cut.write_bytes(b"ARROW1")
    asked = ("train", good, "--vehicle", car, "--append", "-o", cut)
    refused(*asked, says=("not a whole trained set",), output=cut)


def test_label_writes_what_the_library_computes(garage, tmp_path):
    path = tmp_path / "labels.parquet"
    drive_path = drives_of(garage)[1]
    options = ("--vehicle", garage / "car.yaml", "-o", path, "--features", "z1", "--stride", "1", "--json")
    outcome = run("label", drive_path, *options)
    told = json.loads(outcome.stdout)
    labels = read_labels(path)
    expected = compute_labels(read_drive(drive_path), road_car(), Z1, stride=1)
    np.testing.assert_array_equal(labels.y, expected.y)
    np.testing.assert_array_equal(labels.row, expected.row)
    assert told["samples"] == len(expected)
    assert told["accepted"] == int(labels.accepted.sum())
    assert told["horizon"] == pytest.approx(0.04)  # 0.05 s at 50 Hz, rounded to two samples
    assert dict(told["rejected"]) == labels.counts()
    rms = np.sqrt(np.mean(labels.y[labels.accepted] ** 2, axis=0))
    np.testing.assert_allclose(told["rms"], rms)


def test_learning_twice_is_noted_and_changes_nothing(garage, tmp_path):
    path = tmp_path / "a.split"
    first = drives_of(garage)[0]
    run("train", first, "--vehicle", garage / "car.yaml", "-o", path, "--trust", "full")
    before = read_set(path)
    outcome = run("train", first, "--vehicle", garage / "car.yaml", "-o", path, "--append")
    assert "d0.parquet was learned before" in outcome.stderr
    after = read_set(path)
    # A sample met again: its own point is there (gain 0), or was turned away by points of greater gain.
    assert after.size == before.size
    assert after.sources[1].insertions == 0


def test_a_set_that_learned_next_to_nothing_is_said_to_and_leads_to_another_drive(garage, tmp_path):
    """Of 2,375 samples one was learned; the set was written without a word, and the next step was to evaluate it."""
    drive = read_drive(drives_of(garage)[0])
    short = tmp_path / "short.parquet"
    write_drive(drive.select(drive["t"] < drive["t"][0] + 2.0), short)
    outcome = run("train", short, "--vehicle", garage / "car.yaml", "-o", tmp_path / "s.split", "--trust", "full")
    assert outcome.exit_code == 0, outcome.output
    assert (
        f"split: WARNING: the set has learned {read_set(tmp_path / 's.split').sources[0].accepted} labels"
        in outcome.stderr
    )
    following = outcome.stderr.splitlines()[-1]
    assert following.startswith("next: too little was learned to be judged, so add a drive: split train ANOTHER_DRIVE")


def test_a_torque_derived_from_acceleration_is_told(garage, tmp_path):
    drive = read_drive(drives_of(garage)[0])
    kinds = {"T": "derived: torque from measured a_x by the nominal model of test car"}
    write_drive(replace(drive, metadata=replace(drive.metadata, kinds=kinds)), tmp_path / "derived.parquet")
    for name, output in (("label", "l.parquet"), ("train", "s.split")):
        outcome = run(name, tmp_path / "derived.parquet", "--vehicle", garage / "car.yaml", "-o", tmp_path / output)
        assert outcome.exit_code == 0
        assert "the longitudinal label then says nothing" in outcome.stderr
