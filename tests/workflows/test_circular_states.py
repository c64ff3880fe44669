"""Where T was derived from the motion, the labels of v_x say nothing: every command says so, and judges v_x nowhere."""

from dataclasses import replace

import pytest

from split_cli.errors import SetError
from split_cli.learning.label_file import read_labels
from split_cli.learning.training_set import read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import read_drive, write_drive
from split_cli.logs.drive_metadata import CIRCULAR
from split_cli.scoring.export_warnings import reservations
from split_cli.scoring.report import EvaluationSettings
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.evaluate import evaluate_files
from split_cli.workflows.info import describe_file
from split_cli.workflows.label import label_drive
from split_cli.workflows.report.evaluation import evaluation_page
from split_cli.workflows.training.new_set import trust_notes
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import make_drive, road_car, write_forged_set

DERIVED = {"T": "derived: torque from measured a_x by the nominal model of road_car"}
PLAIN = TrainSettings(hyperparameters="default", trust="full")
SCORED = EvaluationSettings(predictors=("bcm",), rollout=())


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two drives that differ in where T is from, and two sets whose v_x has intervals of nearly no width."""
    where = tmp_path_factory.mktemp("circular")
    write_vehicle(road_car(), where / "car.yaml")
    for seed, (name, kinds) in enumerate((("measured", {"T": "command"}), ("derived", DERIVED))):
        drive = make_drive(seed, segments=20, seconds=3.0, vehicle=road_car())
        write_drive(replace(drive, metadata=replace(drive.metadata, kinds=kinds)), where / f"{name}.parquet")
        train_set([where / f"{name}.parquet"], where / "car.yaml", where / f"{name}.split", PLAIN)
        trained = read_set(where / f"{name}.split")
        narrow = [
            (1e-12, *variance[1:]) for variance in (trained.kernel.signal_variance, trained.kernel.noise_variance)
        ]
        kernel = replace(trained.kernel, signal_variance=narrow[0], noise_variance=narrow[1])
        write_set(replace(trained, kernel=kernel), where / f"{name}.split")
    return where


def notes_on(folder, drive, trained):
    run = evaluate_files([folder / f"{drive}.parquet"], None, SCORED, folder / f"{trained}.split")
    return run, [note for note in run.report.notes if "v_x" in note]


def test_intervals_of_v_x_are_judged_only_where_labels_and_training_speak_of_the_car(folder):
    _, notes = notes_on(folder, "measured", "measured")
    assert any("intervals of v_x are too narrow" in note for note in notes)
    run, notes = notes_on(folder, "derived", "measured")
    assert not any("too narrow" in note for note in notes)
    said = "errors and intervals of v_x say nothing of the car"
    assert sum(said in note for note in notes) == 1 and evaluation_page(run).count(said) == 1
    _, notes = notes_on(folder, "measured", "derived")
    assert not any("too narrow" in note for note in notes)
    assert any("the set knows nothing of errors of v_x" in note for note in notes)


def test_a_set_keeps_which_states_its_drives_say_nothing_of(folder, tmp_path):
    derived, measured = read_set(folder / "derived.split"), read_set(folder / "measured.split")
    assert derived.sources[0].circular == ("v_x",) and measured.sources[0].circular == ()
    assert b"circular" not in (folder / "measured.split").read_bytes()
    assert any("variance of v_x says nothing" in text for text in reservations(derived))
    assert not any("v_x" in text for text in reservations(measured))
    facts = describe_file(folder / "derived.split").facts
    assert any(name == "cannot say" and "v_x" in text for name, text in facts)
    # Labels carry it to a set that is trained without the drive.
    label_drive(folder / "derived.parquet", folder / "car.yaml", tmp_path / "labels.parquet")
    assert read_labels(tmp_path / "labels.parquet").circular == ("v_x",)
    write_forged_set(derived, tmp_path / "forged.split", lambda d: d["sources"][0].update(circular=["r"]))
    with pytest.raises(SetError, match="a state other than v_x, v_y"):
        read_set(tmp_path / "forged.split")


def test_a_mixture_names_the_drive_that_teaches_nothing_of_v_x(folder, tmp_path):
    drives = [folder / "measured.parquet", folder / "derived.parquet"]
    result = train_set(drives, folder / "car.yaml", tmp_path / "both.split", PLAIN)
    found = [note for note in result.notes if "pull its correction towards zero" in note]
    assert len(found) == 1 and found[0].startswith("the labels of v_x of derived.parquet say nothing")
    alone = train_set(drives[:1], folder / "car.yaml", tmp_path / "one.split", PLAIN)
    assert not any("towards zero" in note for note in alone.notes)
    assert read_drive(drives[1]).metadata.circular == ("v_x",)


def test_a_training_says_why_a_state_of_which_no_drive_says_anything_is_not_corrected():
    found = trust_notes(Trust((0.0, 0.0, 0.9), "held-out", 20), ("v_y",))
    assert found[0] == f"no correction of v_y is applied: {CIRCULAR['v_y']}"
    assert len(found) == 2 and found[1].startswith("no correction of v_x is applied: on held-out blocks")
