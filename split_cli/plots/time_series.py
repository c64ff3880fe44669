"""What the nominal model gets wrong over time, with the prediction and its band where it was tested."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from split_cli.plots.style import (
    HELD_OUT,
    LABEL_UNITS,
    PALETTE,
    STATES,
    legend_below,
    model_name,
    new_figure,
    quiet,
)
from split_cli.scoring.run import EvaluationRun, Trace

_CLOSE_UP = 12.0
_TWO_SIDED_95 = 1.959964


def draw_error_over_time(run: EvaluationRun) -> Figure:
    """Draw labels and the first predictor on the drive with the most test samples, whole and one stretch close up.

    A label is the error of the nominal model, so that model predicts the line at 0.
    """
    first = run.traces[0]
    same = [trace for trace in run.traces if (trace.name, trace.features) == (first.name, first.features)]
    trace = max(same, key=lambda candidate: len(candidate.tested))
    figure = new_figure(8.4)
    axes = figure.subplots(3, 2, sharex="col", sharey="row", width_ratios=(1.7, 1.0))
    close_up = _liveliest(trace)
    for state in range(3):
        _draw(axes[state, 0], trace, state, whole=True)
        _draw(axes[state, 1], trace, state, whole=False)
        axes[state, 1].set_xlim(*close_up)
        axes[state, 0].set_ylabel(f"label of {STATES[state]} [{LABEL_UNITS[state]}]")
        axes[state, 0].set_title(_finding(trace, state), fontsize="medium", loc="left")
    axes[0, 1].set_title("close-up of a tested stretch", fontsize="medium", loc="left")
    axes[0, 0].set_xlim(float(trace.held.drive["t"][0]), float(trace.held.drive["t"][-1]))
    for axis in axes[2]:
        axis.set_xlabel("time [s]")
    legend_below(figure, axes[0, 1])
    name = model_name((trace.name, trace.features))
    figure.suptitle(f"{trace.held.drive.name}: error of the nominal model (label) and its prediction by {name}")
    return figure


def _draw(axis: Axes, trace: Trace, state: int, whole: bool) -> None:
    labels = trace.held.labels
    quiet(axis)
    if not trace.held.split.test.all():
        for number, (begin, end) in enumerate(trace.held.split.intervals):
            # A name that begins with an underscore stays out of the legend: one block stands for all.
            axis.axvspan(begin, end, color=HELD_OUT, linewidth=0, label="_" * bool(number) + "held-out block")
    axis.axhline(0.0, color="black", linewidth=1.0, label="nominal model")
    if whole:
        axis.plot(labels.t, labels.y[:, state], ".", color="0.55", markersize=2.0, rasterized=True, label="label")
    else:
        axis.plot(labels.t, labels.y[:, state], ".-", color="0.4", markersize=4.0, linewidth=0.5, label="label")
    t, mean, half = _with_breaks(trace, state)
    axis.fill_between(
        t, mean - half, mean + half, color=PALETTE[0], alpha=0.25, linewidth=0, label="95 % interval of a label"
    )
    name = model_name((trace.name, trace.features))
    axis.plot(t, mean, color=PALETTE[0], linewidth=0.9 if whole else 1.8, label=name)
    axis.set_ylim(*_limits(np.concatenate([labels.y[:, state], mean])))


def _with_breaks(trace: Trace, state: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return time, mean and half width of the interval, with NaN between stretches so that no line spans a gap."""
    tested = trace.tested
    variance = trace.prediction.variance[:, state] + trace.noise_variance[state]
    at = _stretch_starts(trace)[1:]
    columns = (tested.t, trace.prediction.mean[:, state], _TWO_SIDED_95 * np.sqrt(variance))
    return tuple(np.insert(column, at, np.nan) for column in columns)


def _stretch_starts(trace: Trace) -> np.ndarray:
    """Return the index of each test sample that does not follow the one before it, the first included."""
    tested = trace.tested
    apart = (np.diff(tested.row) > 2 * tested.window) | (np.diff(tested.segment) != 0)
    return np.concatenate([[0], np.flatnonzero(apart) + 1])


def _limits(values: np.ndarray) -> tuple[float, float]:
    """Return limits without the farthest 0.5 % at each end, so that one jolt does not flatten the rest."""
    low, high = np.nanquantile(values, [0.005, 0.995])
    margin = 0.35 * max(high - low, 1e-9)
    return float(low - margin), float(high + margin)


def _liveliest(trace: Trace) -> tuple[float, float]:
    """Return the tested window of up to 12 s without a break in which labels are largest, in each state's size."""
    t, y = trace.tested.t, trace.tested.y
    energy = np.square(y / np.maximum(np.sqrt(np.mean(np.square(y), axis=0)), 1e-12)).sum(axis=1)
    total = np.concatenate([[0.0], np.cumsum(energy)])
    ends = np.append(_stretch_starts(trace)[1:], len(t))
    last = np.minimum(
        np.searchsorted(t, t + _CLOSE_UP, side="right"),
        ends[np.searchsorted(ends, np.arange(len(t)), side="right")],
    )
    begin = int(np.argmax(total[last] - total[:-1]))
    return float(t[begin]), float(t[last[begin] - 1])


def _finding(trace: Trace, state: int) -> str:
    label = trace.tested.y[:, state]
    before = np.sqrt(np.mean(label**2))
    after = np.sqrt(np.mean((label - trace.prediction.mean[:, state]) ** 2))
    word = "down" if after < before else "up"
    share = abs(1.0 - after / before) if before > 0 else 0.0
    return (
        f"{STATES[state]}: rms error {before:.3g} → {after:.3g} {LABEL_UNITS[state]} ({word} {100 * share:.0f} %)"
    )
