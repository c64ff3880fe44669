"""Writing of the HTML pages of a recording and of an evaluation, the latter with its figures."""

from pathlib import Path

from split_cli.files import atomic_write_text
from split_cli.logs.drive import Drive
from split_cli.plots.evaluation import FigureFiles, write_figures
from split_cli.scoring.run import EvaluationRun
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.drive_charts import recording_charts
from split_cli.workflows.report.evaluation import evaluation_charts, evaluation_page
from split_cli.workflows.report.recording import recording_page


def write_recording_report(drive: Drive, vehicle_path: str | Path | None, path: str | Path) -> None:
    """Write the page of a drive, beside the model of a vehicle file where one is given.

    Raises
    ------
    SplitError
        If the vehicle cannot be read or the page not be written.
    """
    vehicle = read_vehicle(vehicle_path) if vehicle_path is not None else None
    atomic_write_text(path, recording_page(drive, drive.metadata.quality, recording_charts(drive, vehicle)))


def write_evaluation(run: EvaluationRun, folder: str | Path) -> FigureFiles:
    """Write ``report.html`` of an evaluation, its charts and further figures into a folder, all or none."""
    charts = evaluation_charts(run)
    return write_figures(run, folder, charts, {"report.html": evaluation_page(run, charts)})
