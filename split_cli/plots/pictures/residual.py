"""Whether what is left is noise, and whether intervals hold what they promise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.plots.chart import Band, Chart, ChartLine
from split_cli.scoring.evaluation import ScoreTally, predictor_names
from split_cli.scoring.handling.whiteness import autocorrelation

__all__ = ["coverage_charts", "whiteness_chart"]

_STATES = ("v_x", "v_y", "r")
_LAGS = 20


def whiteness_chart(residuals: Sequence[tuple[str, str, Labels, np.ndarray]]) -> tuple[Chart, ...]:
    """Return the autocorrelation of one-step residuals, a chart a state.

    Parameters
    ----------
    residuals : sequence of (name, role, labels, values)
        Values of shape (rows of the labels, 3); labels that do not follow each other by their window break a run.
    """
    charts = []
    for state, symbol in enumerate(_STATES):
        series, band = [], 0.0
        for name, role, labels, values in residuals:
            finite = np.isfinite(values).all(axis=1)
            if finite.sum() < 4 * _LAGS:
                continue
            kept = labels.take(finite)
            apart = (np.diff(kept.row) != kept.window) | (np.diff(kept.segment) != 0)
            run = np.concatenate([[0], np.cumsum(apart)])
            found, half = autocorrelation(values[finite, state], run, _LAGS)
            lags = kept.horizon * np.arange(1, _LAGS + 1)
            series.append(ChartLine(name, lags, found[1:], role))
            band = max(band, half)
        if series:
            note = (
                "Autocorrelation of the one-step error. Inside the band one error says nothing of the next: it is "
                "white noise. Outside it the model leaves out something that lasts. Sensor noise gives up to −0.5 "
                "at the first lag, where neighbouring steps share a measurement."
            )
            bands = (Band(-band, band, "99 % of white noise"),)
            name, title = f"white-{symbol.replace('_', '')}", f"Residual of {symbol}"
            texts = (name, title, "lag [s]", "autocorrelation")
            charts.append(Chart(*texts, tuple(series), "" if state else note, bands, group="white"))
    return tuple(charts)


def coverage_charts(tallies: Mapping[tuple[str, str], ScoreTally]) -> tuple[Chart, ...]:
    """Return promised against observed coverage, a chart a state, each naming its own coverage at 95 %."""
    scored = {key: tally for key, tally in tallies.items() if tally.probability is not None}
    names = predictor_names(scored)
    roles = ("learned", "simulated", "corrected", "nominal", "other")
    charts = []
    for state, symbol in enumerate(_STATES if scored else ()):
        series = [ChartLine("as promised", np.array([0.0, 100.0]), np.array([0.0, 100.0]), "measured")]
        inside = []
        for k, (key, tally) in enumerate(scored.items()):
            promised, observed = tally.probability.reliability_curve
            name = names[key]
            series.append(ChartLine(name, 100 * promised, 100 * observed[:, state], roles[k % len(roles)]))
            inside.append(f"{name} {100 * tally.probability.coverage[1, state]:.0f} %")
        charts.append(Chart(f"coverage-{symbol.replace('_', '')}", f"Coverage of {symbol}", "promised [%]",
                            "labels inside [%]", tuple(series),
                            f"Inside the 95 % interval: {', '.join(inside)}.", equal=True))  # fmt: skip
    return tuple(charts)
