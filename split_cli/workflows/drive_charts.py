"""The charts of a report, from the objects of a command; a note names each chart that cannot be drawn."""

from collections.abc import Callable, Iterable, Sequence

import numpy as np

from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.errors import SplitError
from split_cli.learning.features import Z2
from split_cli.learning.hyperparameters import FEWEST_TO_FIT
from split_cli.learning.in_memory import train_in_memory
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive
from split_cli.plots.chart import Chart, thinned
from split_cli.plots.charts import Subject, drive_charts, handling_charts, tire_charts, track_chart, whiteness_chart
from split_cli.plots.charts.tires import LearnedForces
from split_cli.prediction import DEFAULT_PREDICTOR, make_predictor
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.workflows.recordings import RecordingCorrection

#: A picture needs no more labels than this to show what is learned.
_MOST_LEARNED = 1500
_FOUND = "with the identified effects"
_SHARED = (
    " These are errors of the nominal model alone. They also hold what the simulation has beyond that model, so "
    "they may show structure where nothing of the gap is unexplained."
)


def recording_charts(drive: Drive, vehicle: Vehicle | None) -> tuple[Chart, ...]:
    """Return the charts of one recording beside its nominal model, where there is one."""
    subjects = [Subject("measured", "measured", drive)]
    if vehicle is not None:
        subjects.append(Subject("nominal model", "simulated", drive, vehicle))
    makers: list[Callable[[], Iterable[Chart | None]]] = [
        lambda: drive_charts(subjects, vehicle),
        lambda: [track_chart([("measured", "measured", drive)])],
    ]
    if vehicle is not None:
        makers += [
            lambda: tire_charts(drive, vehicle),
            lambda: handling_charts(subjects, vehicle),
            lambda: _whiteness([("nominal model", "simulated", drive, vehicle)]),
        ]
    return gathered(makers)


def diagnosis_charts(
    diagnosis: Diagnosis, vehicle: Vehicle, found: Vehicle, drives: Sequence[Drive], simulated: Sequence[Drive] = ()
) -> tuple[Chart, ...]:
    """Return the charts of the longest real drive beside its simulation and the corrected vehicle, `found`."""
    if not drives:
        return ()
    drive = max(drives, key=len)
    nominal_drive = RecordingCorrection(vehicle)(drive)
    # Faults of sensors are no part of the car's file.
    sensors = [
        EffectSpec(f.term, {name: p.value for name, p in f.parameters.items()}, f.variant)
        for f in diagnosis.findings
        if not f.exported
    ]
    found = found.with_effects(*sensors)
    subjects = [Subject("measured", "measured", drive)]
    if simulated:
        twin = max(simulated, key=len)
        subjects.append(Subject("simulation given", "nominal", twin))
    subjects.append(Subject("nominal model", "simulated", nominal_drive, vehicle))
    corrected = None
    residuals = [("nominal model", "simulated", nominal_drive, vehicle)]
    if diagnosis.findings:
        corrected = RecordingCorrection(found)(drive), found
        subjects.append(Subject(_FOUND, "corrected", *corrected))
        residuals.append((_FOUND, "corrected", *corrected))
    learned = _learned(*(corrected or (nominal_drive, vehicle)))
    paths = [("measured", "measured", drive)] + [("simulation given", "nominal", one) for one in simulated[:1]]
    return gathered(
        [
            lambda: drive_charts(subjects, vehicle),
            lambda: tire_charts(nominal_drive, vehicle, corrected, learned()),
            lambda: handling_charts(subjects, vehicle),
            lambda: [track_chart(paths)],
            lambda: _whiteness(residuals, _SHARED if simulated else ""),
        ]
    )


def _learned(drive: Drive, vehicle: Vehicle) -> Callable[[], LearnedForces | None]:
    """Return what learns the rest that a vehicle leaves on a drive, for a picture; None where it is too little."""

    def learn() -> LearnedForces | None:
        labels = compute_labels(drive, vehicle, Z2)
        labels = labels.take(labels.accepted)
        if len(labels) < FEWEST_TO_FIT:
            return None
        labels = labels.take(thinned(len(labels), _MOST_LEARNED))
        trained = train_in_memory([labels], vehicle)
        return LearnedForces("SPLIT", labels.row, make_predictor(DEFAULT_PREDICTOR, trained).predict(labels.z))

    return learn


def _whiteness(parts: Sequence[tuple[str, str, Drive, Vehicle]], more: str = "") -> tuple[Chart, ...]:
    found = []
    for name, role, drive, vehicle in parts:
        labels = compute_labels(drive, vehicle, Z2)
        found.append((name, role, labels, labels.y))
    return whiteness_chart(found, more)


def gathered(makers: Sequence[Callable[[], Iterable[Chart | None]]]) -> tuple[Chart, ...]:
    """Return the charts of all makers; one that the recording cannot give is left out, the others are drawn."""
    charts: list[Chart] = []
    for maker in makers:
        try:
            with np.errstate(all="ignore"):
                charts += [chart for chart in maker() if chart is not None]
        except SplitError:
            continue
    return tuple(charts)
