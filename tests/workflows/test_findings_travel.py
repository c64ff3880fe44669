"""What ingest found wrong with a drive is repeated by train and evaluate, kept in the set, and stops an export."""

from dataclasses import replace

import pytest

from split_cli.errors import SetError
from split_cli.learning.training_set import read_set, write_set
from split_cli.learning.trust import Trust
from split_cli.logs.drive import read_drive, write_drive
from split_cli.logs.drive_metadata import DriveMetadata
from split_cli.scoring.export_warnings import reservations
from split_cli.scoring.report import EvaluationSettings
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.evaluate import evaluate_files
from split_cli.workflows.export import export_doubts, export_set
from split_cli.workflows.info import describe_file
from split_cli.workflows.label import label_drive
from split_cli.workflows.training.train import TrainSettings, train_set
from tests.factories import make_drive, make_training_set, road_car

FINDING = {
    "check": "scale",
    "channel": "r",
    "measured": 57.3,
    "error": 0.1,
    "text": "r is in deg/s (r against dyaw/dt: slope 57.3). Set `unit: deg/s` in the map.",
}
MINOR = {
    "check": "bias on straights",
    "channel": "vy",
    "measured": 0.1,
    "error": 0.01,
    "text": "v_y reads +0.100 +- 0.010 m/s on straights at a median 14 m/s: an offset.",
}


@pytest.fixture
def told(tmp_path):
    drive = make_drive(0, segments=10, seconds=3.0, vehicle=road_car())
    for name, findings in (("faulty", [FINDING, MINOR]), ("minor", [MINOR]), ("good", [])):
        quality = {"consistency": {"findings": findings}}
        metadata = replace(drive.metadata, quality=quality)
        write_drive(replace(drive, metadata=metadata), tmp_path / f"{name}.parquet")
    write_vehicle(road_car(), tmp_path / "car.yaml")
    return tmp_path


def test_train_repeats_keeps_and_export_stops(told):
    settings = TrainSettings(hyperparameters="default", trust="full")
    for name in ("faulty", "minor", "good"):
        result = train_set([told / f"{name}.parquet"], told / "car.yaml", told / f"{name}.split", settings)
        both = "ingest found that r is in deg/s; v_y reads"
        assert any(both in note for note in result.notes) == (name == "faulty")
        assert any("v_y reads +0.100" in note for note in result.notes) == (name != "good")
    source = read_set(told / "faulty.split").sources[0]
    assert source.faults == ("r is in deg/s",) and source.remarks[0].startswith("v_y reads")
    # Without findings the file is as it was before there were any: the keys are not written.
    for key in (b"faults", b"remarks"):
        assert key in (told / "faulty.split").read_bytes() and key not in (told / "good.split").read_bytes()
    with pytest.raises(SetError, match="r is in deg/s.*--insist"):
        export_set(told / "faulty.split", told / "out", ["npz"], queries=100)
    assert not (told / "out").exists()
    done = export_set(told / "faulty.split", told / "out", ["npz"], queries=100, insist=True)
    assert "r is in deg/s" in done.doubts[0]
    minor = read_set(told / "minor.split")
    assert export_doubts(minor) == ()
    assert any("minor.parquet: ingest found that v_y reads" in text for text in reservations(minor))
    assert not any("ingest found" in text for text in reservations(read_set(told / "good.split")))
    judged = evaluate_files(
        [told / "good.parquet"], None, EvaluationSettings(predictors=("bcm",), rollout=()), told / "faulty.split"
    )
    assert any("faulty.parquet: ingest found that r is in deg/s; v_y" in note for note in judged.report.notes)
    assert ("ingest found", "; ".join((*source.faults, *source.remarks))) in describe_file(told / "faulty.split").facts


def test_labels_carry_what_ingest_found(told):
    label_drive(told / "faulty.parquet", told / "car.yaml", told / "labels.parquet")
    settings = TrainSettings(hyperparameters="default", trust="full")
    result = train_set([told / "labels.parquet"], told / "car.yaml", told / "l.split", settings)
    assert read_set(told / "l.split").sources[0].faults == ("r is in deg/s",)
    assert any("ingest found that r is in deg/s; v_y reads" in note for note in result.notes)


def test_faults_stay_when_the_set_goes_on(told):
    settings = TrainSettings(hyperparameters="default", trust="full")
    train_set([told / "faulty.parquet"], told / "car.yaml", told / "a.split", settings)
    other = replace(read_drive(told / "good.parquet"), name="other")
    columns = {**other.columns, "vx": other["vx"] + 0.01}
    write_drive(replace(other, columns=columns), told / "other.parquet")
    train_set([told / "other.parquet"], told / "car.yaml", told / "a.split", append=True)
    assert [source.faults for source in read_set(told / "a.split").sources] == [("r is in deg/s",), ()]


def test_evaluate_repeats(told):
    settings = EvaluationSettings(predictors=("rbcm",), rollout=(0.5,))
    run = evaluate_files([told / "faulty.parquet"], told / "car.yaml", settings)
    assert any("ingest found that r is in deg/s" in note for note in run.report.notes)


def test_a_set_that_corrects_nothing_or_has_seen_nothing_is_not_exported_unasked(tmp_path):
    trained = make_training_set(points=60)
    assert not any("nominal" in doubt for doubt in export_doubts(trained))
    nothing = replace(trained, trust=Trust((0.0, 0.0, 0.0), "given"))
    assert any("nominal model" in doubt for doubt in export_doubts(nothing))
    few = replace(trained, sources=tuple(replace(source, accepted=5) for source in trained.sources))
    assert any("5 labels" in doubt for doubt in export_doubts(few)) == bool(trained.sources)
    write_set(nothing, tmp_path / "a.split")
    with pytest.raises(SetError, match="should not drive a car"):
        export_set(tmp_path / "a.split", tmp_path / "out", ["npz"], queries=100)


def test_clauses_leave_figures_and_advice_away():
    def of(findings: object) -> DriveMetadata:
        return DriveMetadata(quality={"consistency": {"findings": findings}})

    found = of([FINDING, MINOR])
    bias = "v_y reads +0.100 +- 0.010 m/s on straights at a median 14 m/s"
    assert (found.faults, found.remarks) == (("r is in deg/s",), (bias,))
    assert DriveMetadata().remarks == DriveMetadata(quality={"consistency": None}).remarks == ()
    assert all(of(f).faults == of(f).remarks == () for f in (None, [], [{}]))
