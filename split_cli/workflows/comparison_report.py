"""Write what a comparison found: the page and the table, both or none."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import spreadsheet_text
from split_cli.files import atomic_directory, write_digests
from split_cli.learning.features import Z2
from split_cli.learning.labels import Labels, compute_labels
from split_cli.logs.drive import Drive
from split_cli.plots.chart import Chart
from split_cli.plots.charts import (
    Subject,
    drive_charts,
    handling_charts,
    tire_charts_of_files,
    track_chart,
    whiteness_chart,
)
from split_cli.plots.palette import ROLES
from split_cli.prediction import make_predictor
from split_cli.scoring.application import Correction, left_by_model
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.compare import ComparedModel, ModelComparison
from split_cli.workflows.drive_charts import gathered
from split_cli.workflows.recordings import RecordingCorrection
from split_cli.workflows.report.comparison import comparison_page

_SHOWN = 4
_COLUMNS = (
    "drive",
    "model",
    "horizon_s",
    "state",
    "unit",
    "rmse",
    "low_95",
    "high_95",
    "fit_percent",
    "skill",
    "to_best",
    "to_best_low",
    "to_best_high",
    "best",
)


def write_comparison(
    compared: ModelComparison, models: Sequence[ComparedModel], drives: Sequence[Drive], output: str | Path
) -> None:
    """Write ``report.html``, ``compare.csv`` and their digests into a folder."""
    table = _table(compared)
    page = comparison_page(compared, _drive_charts(models, max(drives, key=len)), table)
    with atomic_directory(output) as folder:
        (folder / "report.html").write_text(page, encoding="utf-8")
        (folder / "compare.csv").write_text(table, encoding="utf-8", newline="")
        write_digests(folder)


def _table(compared: ModelComparison) -> str:
    text = io.StringIO(newline="")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(_COLUMNS)
    for name, scores in (("all", compared.scores), *compared.by_drive):
        for score in scores:
            for one in score.states:
                names = spreadsheet_text(name), spreadsheet_text(score.name)
                what = *names, score.horizon, one.state, one.unit
                numbers = one.rmse, *one.interval, one.fit, one.skill, *one.to_best
                writer.writerow((*what, *numbers, int(one.is_best)))
    return text.getvalue()


def _drive_charts(models: Sequence[ComparedModel], drive: Drive) -> tuple[Chart, ...]:
    """Return the charts of the longest drive with the first models; colours for more would not be told apart."""
    subjects = [Subject("measured", "measured", drive)]
    for model, role in zip(models[:_SHOWN], ROLES[1:], strict=False):
        own = RecordingCorrection(model.vehicle)(drive)
        subjects.append(Subject(model.name, role, own, model.vehicle, _correction(model, own)))
    vehicle = models[0].vehicle
    cars = [(one.name, one.role, one.vehicle) for one in subjects[1:]]
    return gathered(
        [
            lambda: drive_charts(subjects, vehicle),
            lambda: tire_charts_of_files(drive, cars),
            lambda: handling_charts(subjects, vehicle),
            lambda: [track_chart([("measured", "measured", drive)])],
            lambda: whiteness_chart([_left(*pair) for pair in zip(models, subjects[1:], strict=False)]),
        ]
    )


def _left(model: ComparedModel, shown: Subject) -> tuple[str, str, Labels, np.ndarray]:
    """Return name, role, and what a model leaves of the motion over one step, with its labels."""
    features = Z2 if model.trained is None else model.trained.features
    labels = compute_labels(shown.drive, model.vehicle, features)
    labels = labels.take(np.isfinite(labels.y).all(axis=1))
    if model.trained is None:
        return shown.name, shown.role, labels, labels.y
    predictor, z = make_predictor(model.predictor, model.trained), shown.correction.z
    left = left_by_model(predictor, shown.drive, z, labels)
    return shown.name, shown.role, labels, left - predictor.predict(labels.z).mean


def _correction(model: ComparedModel, drive: Drive) -> Correction | None:
    if model.trained is None:
        return None
    z = model.trained.features.compute(SingleTrack(model.vehicle), drive)
    predictor = make_predictor(model.predictor, model.trained)
    return Correction(model.trained.features, z, predictor.mean, predictor.mean_and_knowledge)
