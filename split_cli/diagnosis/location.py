"""Where the gap is: in which force, depending on what, in which region, place and time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.common import features
from split_cli.diagnosis.evidence import Evidence, defects
from split_cli.diagnosis.result import GapSeries, Location, Place
from split_cli.diagnosis.series import extended_model
from split_cli.vehicle.effects import Term

__all__ = ["gap_forces", "gap_series", "locate"]

_AVERAGE_SECONDS = 0.2
_BINS = 12
FORCES = ("longitudinal", "front_lateral", "rear_lateral")


def gap_forces(evidence: Evidence, terms: Sequence[Term], common_rates: np.ndarray) -> np.ndarray:
    """Return the gap as forces [N], shape (N, 3), averaged over about 0.2 s.

    Notes
    -----
    Rates left by model, terms and common physics, through the inverse of the invariant force matrix.
    """
    series = evidence.series
    measured, smooth = series.corrected(terms)
    rates = series.rates(extended_model(evidence.vehicle, terms), smooth) + common_rates
    left = defects(series, rates, evidence.jacobian, measured, smooth) / series.period
    left = np.concatenate([left, left[-1:]])
    width = max(1, int(round(_AVERAGE_SECONDS / series.period)))
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), left]), axis=0)
    low = np.clip(np.arange(len(left)) - width // 2, 0, None)
    high = np.clip(low + width, None, len(left))
    mean = (total[high] - total[low]) / (high - low)[:, None]
    return mean @ np.linalg.inv(evidence.vehicle.force_matrix()).T


def gap_series(evidence: Evidence, compared: np.ndarray, forces: np.ndarray, remainder: np.ndarray) -> GapSeries:
    """Return the gap along a recording, thinned to the rows of the evidence, of which some are compared."""
    series, at = evidence.series, evidence.at
    nowhere = np.full(len(at), np.nan)
    position = (series.drive["X"][at], series.drive["Y"][at]) if "X" in series.drive else (nowhere, nowhere)
    point = features(series, evidence.vehicle)[at]
    return GapSeries(
        series.name, series.drive["t"][at], series.s[at], at, *position, point, compared, forces[at], remainder[at]
    )  # fmt: skip


def variables(evidence: Evidence) -> dict[str, np.ndarray]:
    """Return the variables a gap may depend on, at every sample."""
    series = evidence.series
    z = features(series, evidence.vehicle)
    vx, vy, r = series.smooth.T
    rates = np.gradient(series.smooth, series.period, axis=0)
    return {
        "v_x": vx, "v_y": vy, "r": r, "T": series.torque, "delta": series.steer_angle,
        "alpha_f": z[:, 0], "alpha_r": z[:, 1], "a_x": rates[:, 0] - vy * r, "a_y": rates[:, 1] + vx * r,
        "steer_rate": np.gradient(series.steer_angle, series.period), "t": series.drive["t"], "s": series.s,
    }  # fmt: skip


def locate(
    evidence: Sequence[Evidence],
    before: Sequence[np.ndarray],
    keep: Sequence[np.ndarray],
    noise: np.ndarray,
) -> Location:
    """Describe the gap.

    Parameters
    ----------
    evidence : sequence of Evidence
    before : sequence of ndarray, shape (N, 3)
        Gap forces of each recording [N].
    keep : sequence of ndarray of bool, shape (G,)
        Rows that are compared.
    noise : ndarray, shape (3,)
        Variance of the gap forces that sensor noise makes [N^2].
    """
    rows = [one.at[mask] for one, mask in zip(evidence, keep, strict=True)]
    gap = np.concatenate([force[at] for force, at in zip(before, rows, strict=True)])
    names = list(variables(evidence[0]))
    table = [variables(one) for one in evidence]
    values = {
        name: np.concatenate([columns[name][at] for columns, at in zip(table, rows, strict=True)])
        for name in names
    }
    excess = np.maximum(np.mean(gap**2, axis=0) - noise, 1e-6 * np.mean(gap**2, axis=0) + 1e-12)
    shares = excess / excess.sum()
    scores = sorted(((name, _dependence(values[name], gap, excess)) for name in names), key=lambda pair: -pair[1])
    size = np.sum(gap**2 / np.maximum(noise, 1e-12), axis=1)
    region = {}
    for name, score in scores[:3]:
        if score > 0.05 and name not in ("t", "s"):
            region[name] = _interval(values[name], size)[:2]
    place, s_share = _place(evidence, values["s"], size)
    when, t_share = _interval_if_local(values["t"], size)
    share = s_share or t_share or (1.0, 1.0)
    return Location(dict(zip(FORCES, shares.tolist(), strict=True)), tuple(scores), region, place, when, *share)


def _dependence(x: np.ndarray, gap: np.ndarray, excess: np.ndarray) -> float:
    """Return the share of the gap a step function of one variable explains, less what it would of noise."""
    edges = np.unique(np.quantile(x, np.linspace(0.0, 1.0, _BINS + 1)[1:-1]))
    bins = np.searchsorted(edges, x)
    count = np.maximum(np.bincount(bins, minlength=len(edges) + 1), 1)
    total = 0.0
    for channel in range(3):
        mean = np.bincount(bins, gap[:, channel], minlength=len(edges) + 1) / count
        explained = np.sum(count * mean**2) / len(x)
        # Averages over 0.2 s leave about five rows that say the same.
        chance = 5.0 * len(count) * np.var(gap[:, channel]) / len(x)
        total += max(explained - chance, 0.0) / excess[channel] / 3.0
    return float(np.clip(total, 0.0, 1.0))


def _interval(x: np.ndarray, size: np.ndarray) -> tuple[float, float, float, float]:
    """Return the interval of x with the most excess over the mean, its share of the gap and of the samples."""
    order = np.argsort(x, kind="stable")
    surplus = np.cumsum(size[order] - np.mean(size))
    low = np.minimum.accumulate(np.concatenate([[0.0], surplus]))
    end = int(np.argmax(surplus - low[:-1]))
    begin = int(np.argmin(np.concatenate([[0.0], surplus])[: end + 1]))
    share = float(size[order][begin : end + 1].sum() / size.sum())
    return float(x[order][begin]), float(x[order][end]), share, (end + 1 - begin) / len(x)


def _interval_if_local(x: np.ndarray, size: np.ndarray):
    low, high, gap, samples = _interval(x, size)
    if gap > 2.0 * samples and samples < 0.4 and gap > 0.3:
        return (low, high), (gap, samples)
    return None, None


def _place(evidence: Sequence[Evidence], s: np.ndarray, size: np.ndarray):
    interval, share = _interval_if_local(s, size)
    if interval is None:
        return None, None
    series = evidence[0].series
    middle = 0.5 * (interval[0] + interval[1])
    x = y = None
    if "X" in series.drive:
        nearest = int(np.argmin(np.abs(series.s - middle)))
        x, y = float(series.drive["X"][nearest]), float(series.drive["Y"][nearest])
    return Place(*interval, series.lap_length, series.place_reference, x, y), share
