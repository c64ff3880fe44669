"""Test for inputs that arrive late: correlation of the labels with the rate of an input."""

from collections.abc import Sequence

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.vehicle.single_track import SingleTrack

#: Correlation from which a label is said to go with an input's rate [1]; judgement: a tenth of its variance.
_LEAST_CORRELATION = 0.3
#: Standard errors, over blocks of time, that the delay must be from zero [1]; theory: by chance 1 of 30,000.
CLEAR = 4.0
_BLOCKS = 12
_FEWEST = 200
_CHUNK = 2**16  # labels looked at at once
#: Delays that are worth a word [s]: a quarter of a label's interval, and the slowest actuator of a road car.
_RANGE = (0.012, 0.5)
_INPUTS = (("T", 0, "v_x", "dT/dt", "torque", "drive_lag"), ("delta", 2, "r", "ddelta/dt", "steering", "steer_lag"))


def late_inputs(drive: Drive, labels: Labels, vehicle: Vehicle, found: Sequence[EffectSpec] = ()) -> tuple[str, ...]:
    """Return what the labels say of late inputs, in words; empty where they say nothing beyond chance.

    Parameters
    ----------
    labels : Labels
        Of that drive.
    found : sequence of EffectSpec, optional
        What a trained set models beyond the vehicle file: nothing is left to settle there.

    Notes
    -----
    An input u that arrives tau late lacks about tau du/dt, and the label is -tau (df/du) du/dt, with df/du of the
    nominal model. tau is the least-squares slope, its error the jackknife's over blocks of time. A lag and a delay
    look alike to first order, and so does a late time stamp: the diagnosis tells them apart.
    """
    notes = []
    for name, output, label, rate, what, term in _INPUTS:
        if any(effect.term == term for effect in found):
            continue
        late = _late(_missing(drive, labels, vehicle, name, output), labels.y[labels.accepted, output])
        if late is not None:
            delay, error, correlation = late
            notes.append(
                f"{drive.name}: labels of {label} follow {rate} (correlation {-correlation:.2f}): the {what} "
                f"seems to arrive {delay:.3f} s late (+- {error:.1g}). Features of one moment show no delay. "
                f"`split diagnose --real` of this drive measures it, as {term}"
            )
    return tuple(notes)


def torque_delay(drives: Sequence[Drive], labels: Sequence[Labels], vehicle: Vehicle) -> float | None:
    """Return by how much the torque of all drives together arrives late [s]; None where that is not clear."""
    missing = [_missing(drive, part, vehicle, "T", 0) for drive, part in zip(drives, labels, strict=True)]
    y = [part.y[part.accepted, 0] for part in labels]
    found = _late(np.concatenate(missing), np.concatenate(y)) if y else None
    return None if found is None else found[0]


def _missing(drive: Drive, labels: Labels, vehicle: Vehicle, name: str, output: int) -> np.ndarray:
    """Return what an accepted label lacks for every second that an input is late, shape (N,)."""
    accepted = labels.row[labels.accepted]
    missing = np.empty(len(accepted))
    model = SingleTrack(vehicle, ())
    for begin in range(0, len(accepted), _CHUNK):  # a long drive has no room for its columns
        first = accepted[begin : begin + _CHUNK]
        low, high = int(first[0]), int(first[-1]) + labels.window + 1
        columns = {channel: drive.part(channel, low, high) for channel in ("vx", "vy", "r", "T", "delta")}
        at = {channel: values[first - low] for channel, values in columns.items()}
        rate = (columns[name][first - low + labels.window] - at[name]) / labels.horizon
        missing[begin : begin + _CHUNK] = rate * -_slope(model, at, name, output)
    return missing


def _late(missing: np.ndarray, y: np.ndarray) -> tuple[float, float, float] | None:
    """Return delay and error [s] and the correlation behind them [1]; None where they are not beyond chance."""
    if len(y) < _FEWEST or not np.any(missing):
        return None
    correlation = float(np.corrcoef(missing, y)[0, 1])
    delay, error = _fit(missing, y)
    sure = correlation > _LEAST_CORRELATION and delay > CLEAR * error
    return (delay, error, correlation) if sure and _RANGE[0] < delay < _RANGE[1] else None


def _slope(model: SingleTrack, at: dict[str, np.ndarray], name: str, output: int) -> np.ndarray:
    """Return the derivative of an output's rate by an input, shape (N,), by central differences."""
    step = 1e-4 if name == "delta" else 1e-4 * model.vehicle.max_torque
    ends = [model.velocity_derivative(**{**at, name: at[name] + change})[output] for change in (step, -step)]
    slope: np.ndarray = (ends[0] - ends[1]) / (2.0 * step)
    return slope


def _fit(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return the slope of y over x through their means, and its jackknife error over blocks of time."""
    block = np.arange(len(x)) * _BLOCKS // len(x)

    def slope(keep: np.ndarray) -> float:
        a, b = x[keep] - x[keep].mean(), y[keep] - y[keep].mean()
        size = float(a @ a)
        return float(a @ b) / size if size > 0.0 else 0.0

    parts = np.array([slope(block != number) for number in range(_BLOCKS)])
    spread = (_BLOCKS - 1) / _BLOCKS * np.square(parts - parts.mean()).sum()
    return slope(np.ones(len(x), dtype=bool)), float(np.sqrt(spread))
