"""A folder of drives is learned as its drives are, and a grown one costs only what is new."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SetError, SplitError
from split_cli.logs.drive import Drive, open_drive, read_drive, write_drive
from split_cli.scoring.report import EvaluationSettings
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.evaluate import evaluate_files
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import MissingForce, make_drive, road_car


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A car and three drives of it, the last one in a folder below."""
    root = tmp_path_factory.mktemp("drives")
    (root / "in" / "later").mkdir(parents=True)
    car = road_car()
    write_vehicle(car, root / "car.yaml")
    for seed, place in enumerate(("a", "b", "later/c")):
        terms = [MissingForce({"front_lateral": 150.0})]
        drive = make_drive(seed, segments=8, seconds=3.0, vehicle=car, terms=terms, name=f"{place[-1]}.parquet")
        write_drive(drive, root / "in" / f"{place}.parquet")
    return root


DEFAULT = TrainSettings(hyperparameters="default")


def test_a_folder_and_its_drives_give_the_same_set_bit_for_bit(folder, tmp_path):
    drives = [folder / "in" / name for name in ("a.parquet", "b.parquet", "later/c.parquet")]
    train_set(drives, folder / "car.yaml", tmp_path / "one.split", DEFAULT)
    train_set([folder / "in"], folder / "car.yaml", tmp_path / "all.split", DEFAULT)
    assert (tmp_path / "one.split").read_bytes() == (tmp_path / "all.split").read_bytes()


def test_a_long_drive_gives_the_same_set_bit_for_bit_as_a_short_one(folder, tmp_path, monkeypatch):
    drive = folder / "in" / "a.parquet"
    whole = train_set([drive], folder / "car.yaml", tmp_path / "whole.split")
    assert whole.trust.origin == "held-out"
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    monkeypatch.setattr("split_cli.learning.pieces.PIECE_ROWS", 333)
    pieces = train_set([drive], folder / "car.yaml", tmp_path / "pieces.split")
    assert (tmp_path / "whole.split").read_bytes() == (tmp_path / "pieces.split").read_bytes()
    assert pieces.notes == whole.notes


def test_trust_of_a_drive_beyond_its_bound_is_found_on_the_middle(folder, tmp_path, monkeypatch):
    drive = read_drive(folder / "in" / "a.parquet")
    write_drive(drive.stretch(104, 1104), tmp_path / "middle.parquet")
    middle = train_set([tmp_path / "middle.parquet"], folder / "car.yaml", tmp_path / "b.split", DEFAULT)
    for place in ("workflows.training.new_set", "scoring.evidence"):
        monkeypatch.setattr(f"split_cli.{place}.MOST_ROWS", 1000)
    whole = train_set([folder / "in" / "a.parquet"], folder / "car.yaml", tmp_path / "a.split", DEFAULT)
    assert "trust was found on the middle 0.333 minutes of a.parquet" in whole.notes
    # Labels of the whole drive are learned. They begin at other rows, so the evidence is alike, not the same.
    assert whole.total.samples > middle.total.samples + 100
    assert whole.trust.blocks == middle.trust.blocks
    assert whole.trust.share == pytest.approx(middle.trust.share, abs=0.3)


def test_of_a_grown_folder_only_what_is_new_is_learned(folder, tmp_path):
    shutil.copytree(folder / "in", tmp_path / "in")
    (tmp_path / "in" / "later" / "c.parquet").rename(tmp_path / "c.parquet")
    train_set([tmp_path / "in"], folder / "car.yaml", tmp_path / "a.split", DEFAULT)
    (tmp_path / "c.parquet").rename(tmp_path / "in" / "later" / "c.parquet")
    result = train_set([tmp_path / "in"], folder / "car.yaml", tmp_path / "a.split", append=True)
    assert any("drives were learned before and are left out" in note for note in result.notes)
    assert [row.drive for row in result.rows] == ["c.parquet"]
    before = (tmp_path / "a.split").read_bytes()
    with pytest.raises(SetError, match="all 3 drives were learned before"):
        train_set([tmp_path / "in"], folder / "car.yaml", tmp_path / "a.split", append=True)
    assert (tmp_path / "a.split").read_bytes() == before


def test_a_drive_that_changed_after_it_was_learned_is_noticed(folder, tmp_path):
    shutil.copytree(folder / "in", tmp_path / "in")
    train_set([tmp_path / "in"], folder / "car.yaml", tmp_path / "a.split", DEFAULT)
    changed, new = tmp_path / "in" / "b.parquet", tmp_path / "in" / "new.parquet"
    shutil.copy(tmp_path / "in" / "a.parquet", new)
    write_drive(read_drive(changed).stretch(0, 1000), changed)
    result = train_set([tmp_path / "in"], folder / "car.yaml", tmp_path / "a.split", append=True)
    assert [row.drive for row in result.rows] == ["b.parquet"]  # the copy is of the same content
    told = [note for note in result.notes if "has changed since the set learned it" in note]
    assert len(told) == 1 and told[0].startswith("b.parquet")


def test_a_copy_is_left_out_and_a_stretch_is_told_wherever_it_is_met(folder, tmp_path):
    known, other = folder / "in" / "a.parquet", folder / "in" / "b.parquet"
    drive = read_drive(known)
    copied = replace(drive, metadata=replace(drive.metadata, vehicle="told anew"))  # other bytes
    write_drive(copied, tmp_path / "copy.parquet")
    write_drive(drive.stretch(137, 700), tmp_path / "cut.parquet")
    car, once, twice = folder / "car.yaml", tmp_path / "once.split", tmp_path / "twice.split"
    train_set([known, other], car, once, DEFAULT)
    result = train_set([known, tmp_path / "copy.parquet", other], car, twice, DEFAULT)
    assert once.read_bytes() == twice.read_bytes()
    assert any(note.startswith("copy.parquet is a copy of a.parquet") for note in result.notes)

    settings = EvaluationSettings(rollout=(), blocks=4, guard=0.2)

    def notes(*drives: Path, trained: Path | None = once) -> list[str]:
        said = evaluate_files(drives, car, settings, trained).report.notes
        return [note for note in said if note.startswith("NOT UNSEEN")]

    assert not notes(folder / "in" / "later" / "c.parquet")
    assert "100 % of the points that it keeps of that drive are rows of copy" in notes(tmp_path / "copy.parquet")[0]
    (cut,) = notes(tmp_path / "cut.parquet")  # labels begin at rows of another phase: rows are compared
    assert "trained on a.parquet" in cut and 20 < int(cut.partition(", and ")[2].split()[0]) < 60
    assert len(notes(known, tmp_path / "cut.parquet", trained=None)) == 2  # each is learned and scored
    result = train_set([known, tmp_path / "cut.parquet", other], car, twice, DEFAULT)
    assert once.read_bytes() == twice.read_bytes()
    assert any(note.startswith("cut.parquet is a copy of a.parquet, or a stretch of it") for note in result.notes)
    added = train_set([tmp_path / "copy.parquet"], car, once, append=True)
    assert any("copy.parquet holds driving that was learned before, from a.parquet" in n for n in added.notes)


@pytest.mark.parametrize("every", [1, 2])
def test_a_copy_of_a_drive_with_a_long_stop_is_known(folder, tmp_path, every):
    """Rows at rest are all alike: of none it was known whether the other drive has them at the same time."""
    drive = read_drive(folder / "in" / "a.parquet")
    at_rest = (drive["t"] > 8.0) & (drive["t"] < 16.0)
    columns = {name: np.where(at_rest & (name != "t"), 0.0, values) for name, values in drive.columns.items()}
    stopped = replace(drive, columns=columns)
    kept = np.concatenate([np.arange(len(drive))[rows][::every] for rows in drive.segments()])
    thinned = {name: values[kept] for name, values in columns.items()}
    copied = replace(stopped, columns=thinned, segment=stopped.segment[kept], period=every * drive.period)
    write_drive(stopped, tmp_path / "stopped.parquet")
    write_drive(replace(copied, metadata=replace(drive.metadata, vehicle="told anew")), tmp_path / "copy.parquet")
    drives = [tmp_path / "stopped.parquet", tmp_path / "copy.parquet"]
    result = train_set(drives, folder / "car.yaml", tmp_path / "a.split", DEFAULT)
    assert any(note.startswith("copy.parquet is a copy of stopped.parquet") for note in result.notes)


@pytest.mark.parametrize("rate", [0.5, 0.4, 1.0 / 3.0, 0.8, 2.0])
def test_a_copy_at_another_rate_is_known_for_the_driving_that_it_is(folder, tmp_path, rate):
    known, other = folder / "in" / "a.parquet", folder / "in" / "b.parquet"
    drive, car, once = read_drive(known), folder / "car.yaml", tmp_path / "once.split"
    t = np.arange(drive["t"][0], drive["t"][-1], drive.period / rate)
    columns = {name: np.interp(t, drive["t"], values) for name, values in drive.columns.items()} | {"t": t}
    made = Drive("b.parquet", columns, np.zeros(len(t), dtype=np.int32), drive.period / rate, drive.metadata)
    # Its clock may begin anywhere.
    write_drive(replace(made, columns=columns | {"t": t + 1000.0}), tmp_path / "resampled.parquet")
    write_drive(made.stretch(len(t) // 4, len(t) // 2), tmp_path / "cut.parquet")
    train_set([known, other], car, once, DEFAULT)
    result = train_set([known, tmp_path / "resampled.parquet", other], car, tmp_path / "twice.split", DEFAULT)
    assert once.read_bytes() == (tmp_path / "twice.split").read_bytes()
    assert any(note.startswith("resampled.parquet is a copy of a.parquet") for note in result.notes)
    settings = EvaluationSettings(rollout=(), blocks=4, guard=0.2)
    said = evaluate_files([tmp_path / "cut.parquet"], car, settings, once).report.notes
    assert sum(note.startswith("NOT UNSEEN") and "trained on a.parquet" in note for note in said) == 1


class TestDrivesThatFail:
    """`--keep-going`: one damaged drive of a folder does not stop the others, and is not passed over in silence."""

    @pytest.fixture
    def damaged(self, folder, tmp_path) -> Path:
        shutil.copytree(folder / "in", tmp_path / "in")
        (tmp_path / "in" / "aa.parquet").write_bytes((folder / "in" / "a.parquet").read_bytes()[:1000])
        return tmp_path / "in"

    def test_training_learns_the_others_bit_for_bit(self, folder, damaged, tmp_path):
        with pytest.raises(SplitError, match="aa.parquet"):
            train_set([damaged], folder / "car.yaml", tmp_path / "no.split", DEFAULT)
        result = train_set([damaged], folder / "car.yaml", tmp_path / "some.split", DEFAULT, keep_going=True)
        train_set([folder / "in"], folder / "car.yaml", tmp_path / "all.split", DEFAULT)
        assert len(result.failures) == 1 and "aa.parquet" in result.failures[0]
        assert (tmp_path / "some.split").read_bytes() == (tmp_path / "all.split").read_bytes()

    def test_a_command_says_what_it_left_out_and_ends_with_1(self, folder, damaged, tmp_path):
        made = tmp_path / "some.split"
        for words in (
            ["train", damaged, "--vehicle", folder / "car.yaml", "-o", made, "--hyperparameters", "default"],
            ["evaluate", damaged, "--set", made, "--predictor", "projected", "--rollout", "0.5"],
        ):
            ran = CliRunner().invoke(group, [*map(str, words), "--keep-going"], standalone_mode=False)
            assert ran.exception is None and ran.return_value == 1
            assert "split: left out: " in ran.stderr and "aa.parquet" in ran.stderr

    def test_an_evaluation_reads_each_drive_once(self, folder, tmp_path, monkeypatch):
        train_set([folder / "in"], folder / "car.yaml", tmp_path / "all.split", DEFAULT)
        read: list[str] = []

        def counted(path, *given, **more):
            read.append(path.name)
            return open_drive(path, *given, **more)

        for module in ("split_cli.workflows.recordings", "split_cli.workflows.evaluate"):
            monkeypatch.setattr(f"{module}.open_drive", counted)
        drives = sorted((folder / "in").glob("*.parquet"))
        asked = EvaluationSettings(predictors=("projected",), rollout=())
        evaluate_files(drives, None, asked, tmp_path / "all.split", keep_going=True)
        assert sorted(read) == [path.name for path in drives]

    def test_where_all_fail_the_first_error_is_raised(self, folder, tmp_path):
        (tmp_path / "x.parquet").write_bytes(b"PAR1")
        with pytest.raises(SplitError, match="x.parquet"):
            train_set([tmp_path / "x.parquet"], folder / "car.yaml", tmp_path / "no.split", DEFAULT, keep_going=True)
