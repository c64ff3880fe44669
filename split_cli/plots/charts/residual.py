"""Whether what is left is noise, and whether intervals hold what they promise."""

from collections.abc import Mapping, Sequence

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.plots.chart import Band, Chart, ChartLine
from split_cli.scoring.evaluation import NOMINAL, ScoreTally, predictor_names
from split_cli.scoring.handling.whiteness import autocorrelation

_STATES = ("v_x", "v_y", "r")
_LAGS = 20
_NARROW = " Below the diagonal intervals are too narrow, above it too wide."


def whiteness_chart(residuals: Sequence[tuple[str, str, Labels, np.ndarray]], more: str = "") -> tuple[Chart, ...]:
    """Return the autocorrelation of one-step residuals, a chart a state.

    Parameters
    ----------
    residuals : sequence of (name, role, labels, values)
        Values of shape (rows of the labels, 3); labels that do not follow each other by their window break a run.
    more : str
        A further sentence for the note of the first chart.
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
                "Autocorrelation of the one-step error. Inside the band the error is white noise; outside it the "
                "model lacks something that lasts. Sensor noise alone gives up to −0.5 at the first lag, since "
                f"neighbouring steps share a measurement.{more}"
            )
            bands = (Band(-band, band, "99 % band of white noise"),)
            name, title = f"white-{symbol.replace('_', '')}", f"Residual of {symbol}"
            texts = (name, title, "lag [s]", "autocorrelation")
            charts.append(Chart(*texts, tuple(series), "" if state else note, bands, group="white"))
    return tuple(charts)


def coverage_charts(tallies: Mapping[tuple[str, str], ScoreTally], predictors: Sequence[str] = ()) -> tuple[Chart, ...]:
    """Return promised against observed coverage, a chart a state, each naming its own coverage at 95 %.

    Parameters
    ----------
    predictors : sequence of str
        Those to draw beside the nominal model; all where none is named.
    """
    wanted = {NOMINAL, *predictors}
    scored = {
        key: tally
        for key, tally in tallies.items()
        if tally.probability is not None and (not predictors or key[0] in wanted)
    }
    names = predictor_names(scored)
    roles = ("learned", "corrected", "nominal", "other")
    others = sorted(scored.items(), key=lambda one: one[0][0] == NOMINAL)  # colours as on the page
    charts = []
    for state, symbol in enumerate(_STATES if scored else ()):
        series = [ChartLine("as promised", np.array([0.0, 100.0]), np.array([0.0, 100.0]), "measured")]
        inside = []
        for k, (key, tally) in enumerate(others):
            promised, observed = tally.probability.reliability_curve
            name, role = ("nominal model", "simulated") if key[0] == NOMINAL else (names[key], roles[k % len(roles)])
            series.append(ChartLine(name, 100 * promised, 100 * observed[:, state], role))
            inside.append(f"{name} {100 * tally.probability.coverage[1, state]:.0f} %")
        charts.append(
            Chart(
                f"coverage-{symbol.replace('_', '')}",
                f"Coverage of {symbol}",
                "promised [%]",
                "labels inside [%]",
                tuple(series),
                f"Inside the 95 % interval: {', '.join(inside)}.{'' if state else _NARROW}",
                equal=True,
            )
        )
    return tuple(charts)
