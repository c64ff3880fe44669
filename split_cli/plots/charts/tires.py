"""Axle force against slip angle, and longitudinal force against torque: measured, nominal, corrected, learned."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive
from split_cli.plots.chart import Chart, ChartLine, thinned
from split_cli.prediction import Prediction
from split_cli.scoring.handling.axles import AxleForces, axle_forces, binned, force_deviation, forces_of_rates
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force

_MOST_DOTS = 1500
_BINS = 28
_FEWEST = 20
_TWO_SIDED_95 = 1.959964
_DOTS = (
    "Each dot is the force that the measured motion needs at a moment. Where dots lie beside a line, that model has "
    "too much or too little force there."
)
_ON_THE_CURVE = (
    "No yaw rate was recorded. The rear axle lies on its nominal curve since its slip was derived from it; an error of "
    "this curve shows at the front axle."
)


@dataclass(frozen=True)
class LearnedForces:
    """A learned residual at the labels of the nominal model it was learned on."""

    name: str
    rows: np.ndarray  # (K,): rows of the drive that it was asked at
    prediction: Prediction  # of K queries


def tire_charts(
    drive: Drive, vehicle: Vehicle, corrected: tuple[Drive, Vehicle] | None = None, learned: LearnedForces | None = None
) -> tuple[Chart, ...]:
    """Return the force charts of both axles and of the longitudinal direction.

    Parameters
    ----------
    vehicle : Vehicle
        The nominal model.
    corrected : (Drive, Vehicle), optional
        The vehicle with the identified effects, and the drive with the faults of its sensors taken off.
    learned : LearnedForces, optional
        On top of the corrected vehicle where there is one, else of the nominal one.

    Notes
    -----
    Lines other than the nominal curves are means over bins of what a model gives at the recorded moments. Effects
    that are no tyre's (mass, wind) show as the axle force they look like.
    """
    forces = axle_forces(drive, vehicle)
    if len(forces.slip) < _FEWEST:
        return ()
    with_found = None if corrected is None else forces.measured - _left(forces, *corrected, vehicle)
    charts = []
    of_tires = drive.metadata.sideslip_is_of_tires
    for name, title, x_title, y_title, x, column in _places(forces):
        width = max(float(np.ptp(np.quantile(x, [0.002, 0.998]))) / _BINS, 1e-9)
        cloud = _cloud(x, forces.measured[:, column], "derived" if of_tires and column > 0 else "measured")
        series = [cloud, _nominal(vehicle, column, x)]
        if with_found is not None:
            centre, mean, _ = binned(x, with_found[:, column], width)
            series.append(ChartLine("with the identified effects", centre, mean, "corrected"))
        if learned is not None:
            base = forces.nominal if with_found is None else with_found
            series.append(_learned(learned, forces, base, vehicle, x, column, width, with_found is not None))
        note = _DOTS if column == 1 else _ON_THE_CURVE if of_tires and column == 2 else ""
        charts.append(Chart(name, title, x_title, y_title, tuple(series), note))
    return tuple(charts)


def tire_charts_of_files(drive: Drive, cars: Sequence[tuple[str, str, Vehicle]]) -> tuple[Chart, ...]:
    """Return the same charts with the curves of several vehicle files (name, role, vehicle), at the first one's slip.

    Two models on one file, as a trained set and its nominal model, have one curve.
    """
    forces = axle_forces(drive, cars[0][2])
    if len(forces.slip) < _FEWEST:
        return ()
    one_each = {_curves(car): (name, role, car) for name, role, car in reversed(cars)}
    note = (
        f"{_DOTS} Measured forces and slip angles are by the mass and geometry of {cars[0][0]}; curves are the files' "
        "own, without what a set has learned."
    )
    return tuple(
        Chart(
            name,
            title,
            x_title,
            y_title,
            (
                _cloud(x, forces.measured[:, column]),
                *(_nominal(car, column, x, own, role) for own, role, car in reversed(one_each.values())),
            ),
            note if column == 1 else "",
        )
        for name, title, x_title, y_title, x, column in _places(forces)
    )


def _places(forces: AxleForces) -> tuple[tuple[str, str, str, str, np.ndarray, int], ...]:
    """Return name, titles and x of the three charts, with the column of their forces."""
    return (
        ("tire-front", "Front axle", "front slip angle [rad]", "lateral force [N]", forces.slip[:, 0], 1),
        ("tire-rear", "Rear axle", "rear slip angle [rad]", "lateral force [N]", forces.slip[:, 1], 2),
        ("force-x", "Drive and brakes", "torque at the wheels [N m]", "longitudinal force [N]", forces.torque, 0),
    )


def _cloud(x: np.ndarray, force: np.ndarray, name: str = "measured") -> ChartLine:
    part = thinned(len(x), _MOST_DOTS)
    return ChartLine(name, x[part], force[part], "measured", "points")


def _nominal(
    vehicle: Vehicle, column: int, x: np.ndarray, name: str = "nominal model", role: str = "simulated"
) -> ChartLine:
    low, high = (float(v) for v in np.quantile(x, [0.001, 0.999]))
    across = np.linspace(low, high, 121)
    if column == 0:
        friction = vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear
        y = across / vehicle.wheel_radius - friction
    else:
        tire = vehicle.front_tire if column == 1 else vehicle.rear_tire
        y = lateral_force(tire.B, tire.C, tire.D, across)
    return ChartLine(name, across, y, role)


def _curves(car: Vehicle) -> tuple[object, ...]:
    """Return what `_nominal` draws a car's lines from."""
    return car.front_tire, car.rear_tire, car.rolling_resistance_front, car.rolling_resistance_rear, car.wheel_radius


def _left(forces: AxleForces, drive: Drive, corrected: Vehicle, nominal: Vehicle) -> np.ndarray:
    """Return what the corrected vehicle still leaves at the same moments, as forces [N]; NaN where it has none."""
    labels = compute_labels(drive, corrected, Z2, horizon=forces.labels.horizon)
    left = np.full_like(forces.measured, np.nan)
    _, mine, theirs = np.intersect1d(forces.labels.row, labels.row, return_indices=True)
    left[mine] = forces_of_rates(nominal, labels.y[theirs])
    return np.where(np.isfinite(left), left, 0.0)


def _learned(
    learned: LearnedForces,
    forces: AxleForces,
    base: np.ndarray,
    vehicle: Vehicle,
    x: np.ndarray,
    column: int,
    width: float,
    found: bool,
) -> ChartLine:
    _, mine, theirs = np.intersect1d(forces.labels.row, learned.rows, return_indices=True)
    mean = base[mine, column] + forces_of_rates(vehicle, learned.prediction.mean)[theirs, column]
    deviation = force_deviation(vehicle, learned.prediction)[theirs, column]
    centre, middle, _ = binned(x[mine], mean, width)
    _, half, _ = binned(x[mine], _TWO_SIDED_95 * deviation, width)
    name = f"{'corrected vehicle' if found else 'nominal model'} and {learned.name}"
    return ChartLine(name, centre, middle, "learned", low=middle - half, high=middle + half)
