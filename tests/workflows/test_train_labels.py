"""Training from files of labels: the set that the drives give, and a refusal of labels that do not fit."""

import json
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest

from split_cli.errors import DriveError, SetError
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive, write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.label import label_drive
from split_cli.workflows.training import labelled_drives
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import MissingForce, make_drive, road_car

QUICK = TrainSettings(hyperparameters="default", trust="full")


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A car, another one, two drives, and their labels."""
    root = tmp_path_factory.mktemp("labels")
    car = road_car()
    write_vehicle(car, root / "car.yaml")
    write_vehicle(road_car(mass=1600.0), root / "other.yaml")
    for seed, name in enumerate("ab"):
        terms = [MissingForce({"front_lateral": 150.0})]
        drive = make_drive(seed, segments=20, seconds=2.0, vehicle=car, terms=terms, name=f"{name}.parquet")
        write_drive(drive, root / drive.name)
        label_drive(root / drive.name, root / "car.yaml", root / f"{name}.labels.parquet")
    return root


def trained(folder: Path, output: Path, *names: str, settings: TrainSettings = QUICK, car: str = "car.yaml", **more):
    return train_set([folder / f"{name}.parquet" for name in names], folder / car, output, settings, **more)


@pytest.mark.parametrize("names", [("a.labels", "b.labels"), ("a", "b.labels"), ("a", "a.labels", "b")])
def test_labels_from_files_give_the_set_of_the_drives_bit_for_bit(folder, tmp_path, names):
    trained(folder, tmp_path / "drives.split", "a", "b")
    result = trained(folder, tmp_path / "files.split", *names)
    assert (tmp_path / "files.split").read_bytes() == (tmp_path / "drives.split").read_bytes()
    alone = [f"{name[0]}.parquet" for name in names if name.endswith("labels") and name[0] not in names]
    said = [note.split()[0] for note in result.notes if "learned from its labels" in note]
    assert said == alone


def test_appended_labels_continue_a_set(folder, tmp_path):
    trained(folder, tmp_path / "once.split", "a", "b")
    trained(folder, tmp_path / "twice.split", "a.labels")
    keep = TrainSettings()
    trained(folder, tmp_path / "twice.split", "b.labels", settings=keep, append=True)
    assert (tmp_path / "once.split").read_bytes() == (tmp_path / "twice.split").read_bytes()


def test_a_drive_is_labelled_once_and_not_at_all_beside_its_labels(folder, tmp_path, monkeypatch):
    counted: list[str] = []
    true = labelled_drives.compute_labels

    def counting(drive, *arguments, **keywords):
        counted.append(drive.name)
        return true(drive, *arguments, **keywords)

    monkeypatch.setattr(labelled_drives, "compute_labels", counting)
    # Grid, trust and learning all ask for labels.
    held_out = TrainSettings(hyperparameters="default")
    trained(folder, tmp_path / "all.split", "a", "b", settings=held_out)
    assert sorted(counted) == ["a.parquet", "b.parquet"]
    counted.clear()
    trained(folder, tmp_path / "beside.split", "a", "a.labels", "b", "b.labels", settings=held_out)
    assert counted == []
    assert (tmp_path / "all.split").read_bytes() == (tmp_path / "beside.split").read_bytes()


def test_labels_beyond_the_memory_kept_give_the_same_set(folder, tmp_path, monkeypatch):
    trained(folder, tmp_path / "kept.split", "a", "b")
    monkeypatch.setattr(labelled_drives, "KEPT_BYTES", 1)
    trained(folder, tmp_path / "spilled.split", "a", "b")
    assert (tmp_path / "kept.split").read_bytes() == (tmp_path / "spilled.split").read_bytes()


def test_stretches_that_are_excluded_are_those_of_the_drive(folder, tmp_path):
    """The oracle is a mask of the drive's rows: a window counts that touches one, its first and last included."""
    spans = ((1.0, 1.5), (20.0, 25.02))
    t = read_drive(folder / "a.parquet")["t"]
    allowed = ~np.any([(t >= begin) & (t < end) for begin, end in spans], axis=0)
    trained(folder, tmp_path / "rows.split", "a", rows=[allowed])
    without = TrainSettings(hyperparameters="default", trust="full", exclude=spans)
    trained(folder, tmp_path / "spans.split", "a", settings=without)
    assert (tmp_path / "spans.split").read_bytes() == (tmp_path / "rows.split").read_bytes()
    # Labels alone do not know how long a gap in their window is; those are not learned in either case.
    trained(folder, tmp_path / "labels.split", "a.labels", settings=without)
    of_rows, of_labels = (read_set(tmp_path / f"{name}.split") for name in ("rows", "labels"))
    for name in ("t", "row", "z", "y"):
        np.testing.assert_array_equal(getattr(of_labels, name), getattr(of_rows, name))


@pytest.mark.parametrize(
    ("settings", "car", "said"),
    [
        (QUICK, "other.yaml", "labels of another vehicle file"),
        (
            TrainSettings(hyperparameters="default", trust="full", horizon=0.2),
            "car.yaml",
            "label interval in samples: ",
        ),
        (TrainSettings(hyperparameters="default", trust="full", features="z1"), "car.yaml", "its features: alpha_f"),
        (TrainSettings(hyperparameters="default", trust="full", plain=True), "car.yaml", "plain labels: False"),
        (TrainSettings(hyperparameters="default", trust="full", stride=3), "car.yaml", "its stride"),
        (TrainSettings(hyperparameters="default", trust="full", held=("T",)), "car.yaml", "--held"),
        (TrainSettings(hyperparameters="default"), "car.yaml", "trust is estimated by predicting recordings"),
    ],
)
def test_labels_for_another_training_are_refused(folder, tmp_path, settings, car, said):
    with pytest.raises(SetError, match=said):
        trained(folder, tmp_path / "no.split", "a.labels", settings=settings, car=car)
    assert not (tmp_path / "no.split").exists()


def altered(source: Path, target: Path, rows: slice = slice(None), **columns) -> None:
    """Write a label file with some of its rows and other values, its marks as they were."""
    table = pyarrow.parquet.read_table(source)
    for name, change in columns.items():
        values = change(table[name].to_numpy().copy())
        table = table.set_column(table.column_names.index(name), name, pyarrow.array(values))
    pyarrow.parquet.write_table(table.slice(*rows.indices(table.num_rows)[:2]), target)


def test_a_label_file_that_is_not_whole_is_refused(folder, tmp_path):
    source, bad = folder / "a.labels.parquet", tmp_path / "bad.parquet"
    for change, said in (
        ({"rows": slice(0, 100)}, "100 rows, .* were written"),
        ({"y_vx": lambda y: np.full_like(y, np.nan)}, "not finite or too large"),
        ({"y_vx": lambda y: np.full_like(y, 1e300)}, "not finite or too large"),
        ({"t": lambda t: np.full_like(t, np.nan)}, "not finite or too large"),
        ({"row": lambda row: row[::-1]}, "out of order"),
    ):
        altered(source, bad, **change)
        with pytest.raises(DriveError, match=f"is not whole: .*{said}|is not whole: {said}"):
            train_set([bad], folder / "car.yaml", tmp_path / "no.split", QUICK)


def test_labels_have_to_lie_on_their_drive_and_be_given_once(folder, tmp_path):
    moved = tmp_path / "moved.parquet"
    altered(folder / "a.labels.parquet", moved, t=lambda t: t + 0.01)
    with pytest.raises(DriveError, match="does not lie on the rows of a.parquet"):
        train_set([folder / "a.parquet", moved], folder / "car.yaml", tmp_path / "no.split", QUICK)
    with pytest.raises(SetError, match="labels of one drive"):
        train_set([folder / "a.labels.parquet", moved], folder / "car.yaml", tmp_path / "no.split", QUICK)
    stored = json.loads(pyarrow.parquet.read_schema(moved).metadata[b"split"])
    assert stored["samples"] == pyarrow.parquet.read_metadata(moved).num_rows
