"""A long drive is evaluated piece by piece: every number is that of the drive in memory, to the bit."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.logs.columns_of_file import ColumnsOfFile
from split_cli.logs.drive import open_drive, read_drive, write_drive
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.rollouts import roll_out, rollout_starts
from split_cli.scoring.run import EvaluationRun
from split_cli.vehicle.parameters import EffectSpec, write_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.evaluate import evaluate_files
from split_cli.workflows.evaluation_notes import notes_on_parts
from split_cli.workflows.report.evaluation import evaluation_page
from tests.factories import MissingForce, make_drive, road_car

SETTINGS = EvaluationSettings(predictors=("rbcm",), rollout=(0.2,), sizes=())
LAGS = (EffectSpec("drive_lag", {"tau": 0.1}, "along"), EffectSpec("grip_fade", {"final_loss": 0.1, "tau": 9.0}))


def numbers(run: EvaluationRun) -> str:
    """Return all that an evaluation says but how long it took."""
    report = replace(run.report, scores=tuple(replace(s, time_per_query=None) for s in run.report.scores))
    with np.printoptions(floatmode="unique", threshold=10**9):
        return repr(report)


@pytest.mark.parametrize(
    ("effects", "settings"),
    [((), replace(SETTINGS, predictors=("fitc",))), (LAGS, replace(SETTINGS, features=("speed,steer_rate",)))],
    ids=["plain", "lags"],
)
def test_an_evaluation_is_the_same_to_the_bit_whatever_the_pieces(effects, settings, monkeypatch, tmp_path):
    drive = make_drive(3, segments=6, seconds=5.0, terms=[MissingForce({"front_lateral": 200.0})])
    write_drive(drive, tmp_path / "a.parquet")
    write_vehicle(road_car(effects=effects), tmp_path / "car.yaml")
    whole = evaluate_files([tmp_path / "a.parquet"], tmp_path / "car.yaml", settings)
    assert whole.rollouts and whole.report.noise_floor.rms is not None
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    monkeypatch.setattr("split_cli.learning.pieces.PIECE_ROWS", 333)
    pieces = evaluate_files([tmp_path / "a.parquet"], tmp_path / "car.yaml", settings)
    assert pieces.held[0][0].drive.stays_in_file and len(drive) > 4 * 333
    assert numbers(pieces) == numbers(whole)
    for one, other in zip(pieces.traces, whole.traces, strict=True):
        assert one.prediction.mean.tobytes() == other.prediction.mean.tobytes()
        assert one.held.z.tobytes() == other.held.z.tobytes()


def test_a_long_drive_without_a_stretch_for_a_rollout_has_none(monkeypatch, tmp_path):
    drive = make_drive(3, segments=2, seconds=2.0)
    write_drive(drive, tmp_path / "a.parquet")
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    opened = open_drive(tmp_path / "a.parquet")
    assert opened.stays_in_file
    none = rollout_starts(opened, np.ones(len(opened), dtype=bool), 1000, 1.0)
    model = SingleTrack(road_car())
    one, other = (roll_out(model, each, none, 100, 10) for each in (opened, drive))
    assert one.shape == other.shape == (0, 100, 6 if drive.has_position else 3)


def test_the_page_draws_a_stretch_of_a_long_drive_and_says_so(monkeypatch, tmp_path):
    drive = make_drive(3, segments=6, seconds=5.0, terms=[MissingForce({"front_lateral": 200.0})])
    write_drive(drive, tmp_path / "a.parquet")
    write_vehicle(road_car(), tmp_path / "car.yaml")
    for module in ("scoring.run", "workflows.evaluation_notes"):
        monkeypatch.setattr(f"split_cli.{module}.DRAWN_ROWS", 700)
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    run = evaluate_files([tmp_path / "a.parquet"], tmp_path / "car.yaml", SETTINGS)
    trace = run.traces[0]
    part = trace.drawn()
    assert len(part.held.drive) == len(part.held.z) == len(part.held.split.test) == 700 and len(part.tested) > 20
    at = np.searchsorted(trace.tested.t, part.tested.t)
    np.testing.assert_array_equal(trace.prediction.mean[at], part.prediction.mean)
    np.testing.assert_array_equal(part.held.drive["t"][part.tested.row], part.tested.t)
    assert f"the page draws {700 * drive.period / 60:.3g} minutes of a.parquet" in run.report.notes
    whole = f"trust was found on at most {700 * drive.period / 60:.3g} minutes of a.parquet"
    monkeypatch.setattr("split_cli.workflows.evaluation_notes.MOST_ROWS", 700)
    assert whole in notes_on_parts(run.held[0], True) and whole not in notes_on_parts(run.held[0], False)
    assert evaluation_page(run).endswith("</html>\n") or "</html>" in evaluation_page(run)[-20:]


def test_a_large_csv_stays_in_a_file_and_is_equal_to_the_one_that_is_read(monkeypatch, tmp_path):
    drive = make_drive(3, segments=3, seconds=4.0)
    names = [*drive.columns, "segment", "comment", "empty"]
    rows = [",".join(["vx [km/h]" if name == "vx" else name for name in names])]
    for number in range(len(drive)):
        values = [repr(float(drive[name][number] * (3.6 if name == "vx" else 1.0))) for name in drive.columns]
        rows.append(",".join([*values, str(drive.segment[number]), "wet", ""]))
    (tmp_path / "a.csv").write_text("\n".join(rows) + "\n")
    whole = read_drive(tmp_path / "a.csv")
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    assert not open_drive(tmp_path / "a.csv").stays_in_file
    monkeypatch.setattr("split_cli.logs.columns_of_file.SMALL_CSV", 100)
    opened = open_drive(tmp_path / "a.csv")
    assert isinstance(opened.columns, ColumnsOfFile) and opened.sha256 == whole.sha256
    assert (opened.name, opened.period) == (whole.name, whole.period)
    np.testing.assert_array_equal(opened.segment, whole.segment)
    assert list(opened.columns) == list(whole.columns)
    for name in whole.columns:
        np.testing.assert_array_equal(opened[name], whole[name])
    scratch = opened.columns.keeps.path
    assert scratch.exists()
    del opened
    assert not scratch.exists()
    (tmp_path / "a.csv").write_text("\n".join([*rows[:200], rows[200].replace("wet", "x,y"), *rows[201:]]) + "\n")
    with pytest.raises(Exception, match="cannot be read as a drive"):
        open_drive(tmp_path / "a.csv")
