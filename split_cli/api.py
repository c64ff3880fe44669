"""What a notebook needs: read, label, train, evaluate, compare and diagnose, with tables as DataFrames.

May import: workflows and all below. pandas is imported only where a table is asked for.
"""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

from split_cli.diagnosis.engine import diagnose as diagnose_drives
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.errors import SplitError
from split_cli.learning.features import parse_features
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.label_file import label_columns
from split_cli.learning.labels import compute_labels
from split_cli.learning.training_set import TrainingSet, read_set
from split_cli.logs.drive import Drive, read_drive, with_inputs_alike
from split_cli.plots.chart import Chart
from split_cli.plots.draw import draw_chart
from split_cli.plots.evaluation import draw_figures
from split_cli.prediction import DEFAULT_PREDICTOR
from split_cli.scoring.handling.steering_response import SteeringResponse, steering_response
from split_cli.scoring.handling.understeer import DEG_PER_G, Understeer
from split_cli.scoring.handling.understeer import understeer_of as understeer
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.run import EvaluationRun
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.compare import ComparedModel, ModelComparison, compare_models
from split_cli.workflows.diagnose import IMPROVEMENT_COLUMNS, corrected_vehicle, improvement_rows
from split_cli.workflows.drive_charts import diagnosis_charts, recording_charts
from split_cli.workflows.evaluate import evaluate as evaluate_drives
from split_cli.workflows.recordings import RecordingCorrection
from split_cli.workflows.report.comparison import comparison_charts, comparison_page
from split_cli.workflows.report.evaluation import evaluation_charts, evaluation_page
from split_cli.workflows.report.page import report_page

__all__ = [
    "DEG_PER_G",
    "ComparisonResult",
    "DiagnosisResult",
    "EvaluationResult",
    "SteeringResponse",
    "Understeer",
    "charts",
    "compare",
    "diagnose",
    "draw_chart",
    "drive_table",
    "evaluate",
    "labels",
    "read_drive",
    "read_set",
    "read_vehicle",
    "rows_table",
    "steering_response",
    "train",
    "understeer",
]


def _frame(rows: Any, columns: Sequence[str] | None = None) -> Any:
    """Return rows (or columns by name) as a pandas DataFrame."""
    try:
        import pandas
    except ImportError:
        raise SplitError("tables need pandas", advice="pip install 'split-cli[notebook]'.") from None
    return pandas.DataFrame(rows, columns=columns)


def _by_state(name: str, values: Sequence[float]) -> dict[str, float]:
    """Return values of v_x, v_y, r (and their norm, where there are four) as columns of a row."""
    states = ("vx", "vy", "r", "norm")[: len(values)]
    return {f"{name}_{state}": float(value) for state, value in zip(states, values, strict=True)}


def rows_table(rows: Sequence[Any]) -> Any:
    """Return the rows of any result as a DataFrame: laps of a race or a training, candidates of a selection.

    Parameters
    ----------
    rows : sequence of dataclass
        Such as ``RaceResult.laps``, ``TrainResult.laps``, ``SetSelection.candidates``, ``ManeuverResult.runs`` or
        the drives that a calibration used. Fields keep their names and units. A field with several values becomes
        a column for each, ``rmse_0``, ``rmse_1`` and so on, in the order that the class documents.
    """

    def columns(row: Any) -> dict[str, Any]:
        out = {}
        for name, value in asdict(row).items():
            several = isinstance(value, tuple | list) or getattr(value, "ndim", 0) == 1
            out |= {f"{name}_{k}": one for k, one in enumerate(value)} if several else {name: value}
        return out

    return _frame([columns(row) for row in rows])


def drive_table(drive: Drive) -> Any:
    """Return the samples of a drive as a DataFrame, a column a channel [SI], with ``segment``."""
    return _frame({**drive.columns, "segment": drive.segment})


def labels(drive: Drive, vehicle: Vehicle, features: str = "z2", *, horizon: float = 0.05) -> Any:
    """Return what the nominal model gets wrong, sample by sample, as a DataFrame.

    Parameters
    ----------
    features : str
        ``z1``, ``z2`` or names separated by commas.
    horizon : float
        h [s].

    Returns
    -------
    DataFrame
        ``t`` [s], ``row``, ``segment``, the features, ``y_vx``, ``y_vy`` [m/s^2], ``y_r`` [rad/s^2], and
        ``reason`` why a sample is not learned from, empty for those that are.
    """
    found = compute_labels(RecordingCorrection(vehicle)(drive), vehicle, parse_features(features), horizon=horizon)
    return _frame({name: column.to_pylist() for name, column in label_columns(found).items()})


def train(drives: Drive | Sequence[Drive], vehicle: Vehicle, features: str = "z2") -> TrainingSet:
    """Return a set trained on drives in memory, with hyperparameters fitted to them, believed in full.

    `split train` also finds on held-out blocks how far each output is believed; `evaluate` does so as well.
    """
    correct = RecordingCorrection(vehicle)
    several = [drives] if isinstance(drives, Drive) else list(drives)
    found = [compute_labels(correct(drive), vehicle, parse_features(features)) for drive in several]
    return train_in_memory(found, vehicle)


@dataclass(frozen=True)
class EvaluationResult:
    """An evaluation: ``run`` holds everything, the rest shows it."""

    run: EvaluationRun

    @property
    def verdicts(self) -> tuple[str, ...]:
        """One sentence a predictor and feature set."""
        return self.run.report.verdicts

    @cached_property
    def scores(self) -> Any:
        """One-step errors in label units, skill and coverage, a row a model, as a DataFrame."""
        rows = []
        for one in self.run.report.scores:
            row = {"model": one.name, "features": one.features, "drive": one.drive or "all", "points": one.points}
            row |= _by_state("rmse", one.rmse) | {"skill": float(one.skill_velocity_held[3])}
            rows.append(row if one.coverage_95 is None else row | _by_state("in95", one.coverage_95))
        return _frame(rows)

    @cached_property
    def rollouts(self) -> Any:
        """Errors of runs on recorded inputs, a row a model and horizon, as a DataFrame."""
        rows = []
        for one in self.run.report.rollouts:
            row = {"model": one.name, "features": one.features, "horizon": one.horizon, "starts": one.starts}
            rows.append(row | _by_state("rmse", one.rmse) | {"distance": one.distance, "diverged": one.diverged})
        return _frame(rows)

    @cached_property
    def sizes(self) -> Any:
        """Errors of the dense process on the most informative samples, a row a size, as a DataFrame."""
        return _frame(
            [
                {"features": one.score.features, "points": one.score.points, **_by_state("rmse", one.score.rmse)}
                for one in self.run.report.sizes
            ]
        )

    @cached_property
    def intervals(self) -> Any:
        """Shares of labels inside 50, 90 and 95 % intervals, near the points and beyond, as a DataFrame."""
        rows = []
        for one in self.run.report.intervals:
            row = {"model": one.name, "features": one.features, "near": one.near, "samples": one.samples}
            row |= {"share": one.share} | _by_state("in50", one.coverage_50)
            rows.append(row | _by_state("in90", one.coverage_90) | _by_state("in95", one.coverage_95))
        return _frame(rows)

    @cached_property
    def comparisons(self) -> Any:
        """Every state at every horizon beside the nominal model and persistence, with 95 % intervals."""
        return _frame([asdict(one) for one in self.run.report.comparisons])

    @cached_property
    def charts(self) -> Mapping[str, Chart]:
        """The charts of the report by name; `draw_chart` makes a matplotlib figure of one."""
        return {chart.name: chart for chart in evaluation_charts(self.run)}

    @cached_property
    def figures(self) -> Mapping[str, Any]:
        """What `split evaluate -o` draws beside the charts of its report, as matplotlib objects by file name."""
        return draw_figures(self.run)[0]

    def page(self) -> str:
        """Return the report as HTML."""
        return evaluation_page(self.run, tuple(self.charts.values()))


def evaluate(
    drives: Drive | Sequence[Drive], vehicle: Vehicle | None = None, trained: TrainingSet | None = None, **settings: Any
) -> EvaluationResult:
    """Score predictors on drives; settings are those of `EvaluationSettings`, as `split evaluate` takes them."""
    several = [drives] if isinstance(drives, Drive) else list(drives)
    car = vehicle or (trained.nominal_vehicle if trained is not None else None)
    if car is None:
        raise SplitError("needs a vehicle or a trained set")
    return EvaluationResult(evaluate_drives(several, car, EvaluationSettings(**settings), trained))


@dataclass(frozen=True)
class ComparisonResult:
    """Models side by side: ``compared`` holds everything, the rest shows it."""

    compared: ModelComparison

    @cached_property
    def scores(self) -> Any:
        """A row a model, state and horizon, as a DataFrame."""
        return _frame(
            [
                {"model": score.name, "horizon": score.horizon, **asdict(one)}
                for score in self.compared.scores
                for one in score.states
            ]
        )

    @cached_property
    def charts(self) -> Mapping[str, Chart]:
        """The charts of the report by name."""
        return {chart.name: chart for chart in comparison_charts(self.compared)}

    def page(self) -> str:
        """Return the report as HTML."""
        return comparison_page(self.compared)


def compare(
    models: Mapping[str, Vehicle | TrainingSet],
    drives: Drive | Sequence[Drive],
    horizons: Sequence[float] = (0.05, 0.5, 2.0),
    predictor: str = DEFAULT_PREDICTOR,
) -> ComparisonResult:
    """Simulate models (vehicles and trained sets, by name) open-loop on the same drives; see `split compare`."""
    several = [drives] if isinstance(drives, Drive) else list(drives)
    read = []
    for name, one in models.items():
        learned = (one.vehicle, one, predictor) if isinstance(one, TrainingSet) else (one,)
        read.append(ComparedModel(name, *learned))
    return ComparisonResult(compare_models(read, several, horizons))


@dataclass(frozen=True)
class DiagnosisResult:
    """A diagnosis with what it was made from; the drives are needed for its charts."""

    diagnosis: Diagnosis
    vehicle: Vehicle
    real: tuple[Drive, ...]
    simulated: tuple[Drive, ...]

    @property
    def summary(self) -> str:
        """One paragraph a reader can act on."""
        return self.diagnosis.summary

    @cached_property
    def findings(self) -> Any:
        """A row a parameter of every finding, as a DataFrame."""
        rows = [
            {
                "term": one.term,
                "variant": one.variant,
                "parameter": name,
                "value": value.value,
                "low_95": value.interval_95[0],
                "high_95": value.interval_95[1],
                "unit": value.unit,
                "gap_explained": one.gap_explained,
                "alternatives": ", ".join(one.alternatives),
            }
            for one in self.diagnosis.findings
            for name, value in one.parameters.items()
        ]
        return _frame(rows)

    @cached_property
    def detectable(self) -> Any:
        """A row a parameter: the size from which on its term would have been named, as a DataFrame."""
        rows = [
            (one.term, name, value, unit)
            for one in self.diagnosis.detectable
            for name, (value, unit) in one.parameters.items()
        ]
        return _frame(rows, ("term", "parameter", "value", "unit"))

    @cached_property
    def improvement(self) -> Any:
        """Held-out errors before and after, a row a horizon, model and channel, as a DataFrame."""
        found = self.diagnosis.improvement
        return _frame(improvement_rows(found) if found else [], IMPROVEMENT_COLUMNS)

    @property
    def corrected_vehicle(self) -> Vehicle:
        """The vehicle with the findings that belong to the car."""
        return corrected_vehicle(self.diagnosis, self.vehicle)

    @cached_property
    def charts(self) -> Mapping[str, Chart]:
        """The charts of the report by name."""
        found = diagnosis_charts(self.diagnosis, self.vehicle, self.corrected_vehicle, self.real, self.simulated)
        return {chart.name: chart for chart in found}

    def page(self) -> str:
        """Return the report as HTML."""
        return report_page(self.diagnosis, tuple(self.charts.values()))


def diagnose(
    real: Drive | Sequence[Drive],
    vehicle: Vehicle,
    simulated: Drive | Sequence[Drive] = (),
    holdout: Drive | Sequence[Drive] = (),
) -> DiagnosisResult:
    """Say where simulation and reality differ and name what was left out; see `split diagnose`."""
    several = [(one,) if isinstance(one, Drive) else tuple(one) for one in (real, simulated, holdout)]
    groups, _ = with_inputs_alike(several)
    correct = RecordingCorrection(vehicle)
    measured, held = ([correct.sensors(drive) for drive in groups[k]] for k in (0, 2))
    diagnosis = diagnose_drives(measured, vehicle, groups[1], held)
    return DiagnosisResult(diagnosis, vehicle, tuple(groups[0]), tuple(groups[1]))


def charts(drive: Drive, vehicle: Vehicle | None = None) -> Mapping[str, Chart]:
    """Return the charts of a recording by name, beside the nominal model of a vehicle file where one is given."""
    return {chart.name: chart for chart in recording_charts(drive, vehicle)}
