"""What was learned: the error of the nominal model beside its prediction over time, and how the set grew."""

from collections.abc import Sequence

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.plots.chart import Chart, ChartLine, thinned
from split_cli.scoring.run import Trace

_STATES = (("v_x", "m/s²"), ("v_y", "m/s²"), ("r", "rad/s²"))
_TWO_SIDED_95 = 1.959964
_LABEL = (
    "A label is what the nominal model gets wrong: that model predicts 0. The closer the line follows the dots, the "
    "more of this error is learned."
)
_GROWTH = "Where the line is flat, driving brought little that the set had not met before."
_ROLES = ("learned", "corrected", "nominal", "other")


def label_charts(trace: Trace) -> tuple[Chart, ...]:
    """Return the labels of a drive's test samples and their prediction with its 95 % interval, a chart a state."""
    tested = trace.tested
    shown = thinned(len(tested))
    apart = (np.diff(tested.row) > 2 * tested.window) | (np.diff(tested.segment) != 0)
    stretch = np.concatenate([[0], np.cumsum(apart)])[shown]
    breaks = np.flatnonzero(np.diff(stretch)) + 1  # no line spans a gap
    charts = []
    for state, (symbol, unit) in enumerate(_STATES):
        mean = trace.prediction.mean[shown, state]
        half = _TWO_SIDED_95 * np.sqrt(trace.prediction.variance[shown, state] + trace.noise_variance[state])
        t, middle, low, high = (
            np.insert(column, breaks, np.nan) for column in (tested.t[shown], mean, mean - half, mean + half)
        )
        series = (
            ChartLine("label", tested.t[shown], tested.y[shown, state], "measured", "points"),
            ChartLine(f"{trace.name}, 95 % interval of a label", t, middle, "learned", low=low, high=high),
        )
        note = "" if state else _LABEL
        name = f"label-{symbol.replace('_', '')}"
        texts = f"Label of {symbol}", "time [s]", f"label of {symbol} [{unit}]"
        charts.append(Chart(name, *texts, series, note, wide=True, group="labels"))
    return tuple(charts)


def kept_over_time(trained: TrainingSet) -> tuple[np.ndarray, np.ndarray]:
    """Return driving time at which each point kept was met [s], ascending, and the number met by then.

    Drives follow one another as they were learned. Points replaced since are not in it.
    """
    before = np.concatenate([[0.0], np.cumsum([source.duration for source in trained.sources])])
    begin = np.array([source.start_time for source in trained.sources])
    met = np.sort(before[trained.source] + trained.t - begin[trained.source])
    return met, np.arange(1, len(met) + 1)


def growth_chart(sets: Sequence[tuple[str, TrainingSet]]) -> tuple[Chart, ...]:
    """Return the points that sets keep over the driving time at which each was met; sets are named."""
    series = []
    for k, (name, trained) in enumerate(sets):
        met, count = kept_over_time(trained)
        shown = thinned(len(met))
        series.append(ChartLine(name, met[shown], count[shown], _ROLES[k % len(_ROLES)]))
    texts = "growth", "Points of the set, by when they were met", "driving time [s]", "points"
    return (Chart(*texts, tuple(series), _GROWTH),)
