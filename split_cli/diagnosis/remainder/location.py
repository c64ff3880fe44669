"""Location of the gap: its forces, the variables it depends on, its region, place and time."""

from collections.abc import Iterable, Sequence

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import features
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.policy import STANDARD, Reporting
from split_cli.diagnosis.statement.result import GapSeries, Location, Place
from split_cli.vehicle.effects import Term

_AVERAGE_SECONDS = 0.2  # over which gap forces are averaged [s]; judgement: short against a turn, long against noise
_ALIKE = 5  # successive rows of 0.04 s that overlap, since each is an average over 0.2 s [1]
_STEPS = (8, 16, 40)  # bins of a step function that are tried [1]; judgement
_FOLDS = 5  # parts of the blocks of time, each judged by the others [1]
FORCES = ("longitudinal", "front_lateral", "rear_lateral")


def gap_forces(evidence: Evidence, terms: Sequence[Term], discrepancy_rates: np.ndarray) -> np.ndarray:
    """Return the gap as longitudinal, front and rear lateral force [N], shape (N, 3), averaged over about 0.2 s.

    Notes
    -----
    The rates that model, terms and shared discrepancy leave, times the inverse of the force matrix (SPLIT paper, the
    invariant matrix).
    """
    series = evidence.series
    left = evidence.rates_left(terms, discrepancy_rates)
    left = np.concatenate([left, left[-1:]])
    width = max(1, int(round(_AVERAGE_SECONDS / series.period)))
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), left]), axis=0)
    # Windows at the ends are as long as all others: shorter ones would be noisier.
    low = np.clip(np.arange(len(left)) - width // 2, 0, max(len(left) - width, 0))
    high = np.minimum(low + width, len(left))
    mean = (total[high] - total[low]) / (high - low)[:, None]
    return mean @ np.linalg.inv(evidence.vehicle.force_matrix()).T


def gap_series(evidence: Evidence, compared: np.ndarray, forces: np.ndarray, remainder: np.ndarray) -> GapSeries:
    """Return the gap along a recording at the rows of its evidence.

    Parameters
    ----------
    compared : ndarray of bool, shape (G,)
    forces, remainder : ndarray, shape (N, 3)
        Gap forces, and what the findings leave of them [N].
    """
    series, at = evidence.series, evidence.at
    nowhere = np.full(len(at), np.nan)
    position = (series.drive["X"][at], series.drive["Y"][at]) if "X" in series.drive else (nowhere, nowhere)
    point = features(series, evidence.vehicle)[at]
    return GapSeries(
        series.name, series.drive["t"][at], series.s[at], at, *position, point, compared, forces[at], remainder[at]
    )


def variables(evidence: Evidence) -> dict[str, np.ndarray]:
    """Return the variables that a gap may depend on, shape (N,) each, in SI units."""
    series = evidence.series
    z = features(series, evidence.vehicle)
    vx, vy, r = series.smooth.T
    rates = np.gradient(series.smooth, series.period, axis=0)
    return {
        "v_x": vx,
        "v_y": vy,
        "r": r,
        "T": series.torque,
        "delta": series.steer_angle,
        "alpha_f": z[:, 0],
        "alpha_r": z[:, 1],
        "a_x": rates[:, 0] - vy * r,
        "a_y": rates[:, 1] + vx * r,
        "steer_rate": np.gradient(series.steer_angle, series.period),
        "t": series.drive["t"],
        "s": series.s,
    }


def locate(
    evidence: Sequence[Evidence],
    before: Sequence[np.ndarray],
    after: Sequence[np.ndarray],
    keep: Sequence[np.ndarray],
    rules: Reporting = STANDARD.reporting,
) -> Location:
    """Return where the gap is: shares of forces, dependence on variables, region, place and time.

    Parameters
    ----------
    before, after : sequence of ndarray, shape (N, 3)
        Gap forces of each recording [N], and what the findings leave of them.
    keep : sequence of ndarray of bool, shape (G,)
        Rows that are compared.
    """
    rows = [one.at[mask] for one, mask in zip(evidence, keep, strict=True)]

    def compared(columns: Iterable[np.ndarray]) -> np.ndarray:
        return np.concatenate([column[at] for column, at in zip(columns, rows, strict=True)])

    gap = compared(before)
    block = np.concatenate([_blocks(one, at, k) for k, (one, at) in enumerate(zip(evidence, rows, strict=True))])
    variance = [force_noise(one, at) for one, at in zip(evidence, rows, strict=True)]
    noise = np.average(variance, axis=0, weights=[len(at) for at in rows])
    # The estimated disturbance may contain a gap without a pattern. The noise is at most what the findings leave.
    left = compared(after)
    mean_square = np.mean(gap**2, axis=0)
    noise = np.maximum(np.minimum(noise, np.mean(left**2, axis=0)), 1e-9 * mean_square + 1e-18)
    table = [variables(one) for one in evidence]
    values = {name: compared(columns[name] for columns in table) for name in table[0]}
    excess = np.maximum(mean_square - noise, 1e-6 * mean_square + 1e-12)
    shares = excess / excess.sum()
    scores = {name: dependence(x, gap, noise, block) for name, x in values.items()}
    ranked = tuple(sorted(scores.items(), key=lambda pair: -pair[1]))
    size = np.sum(gap**2 / noise - 1.0, axis=1)
    size += max(_least_above(len(size)) - float(np.mean(size)), 0.0)
    region = {}
    for name, score in ranked[:3]:
        if score > rules.least_dependence and name not in ("t", "s"):
            low, high, of_gap, of_samples = _interval(values[name], size)
            if of_samples < rules.everywhere and of_gap > of_samples:
                region[name] = (low, high)
    # A gap that follows from the driving occurs wherever the car is driven so. A place or time must explain more.
    driven = max(score for name, score in ranked if name not in ("t", "s"))

    def is_believed(name: str, share: tuple[float, float] | None) -> bool:
        return share is not None and (scores[name] > driven + rules.clearly_more or _concentrated(share, rules))

    place, s_share = _place(evidence, values["s"], size, rules)
    if not is_believed("s", s_share):
        place = s_share = None
    when, t_share = _local(_interval(values["t"], size), rules)
    if not is_believed("t", t_share):
        when = t_share = None
    if s_share and t_share and s_share[0] - s_share[1] > t_share[0] - t_share[1] + rules.clearly_more:
        when = None  # that time is one of several passes of the place
    share = s_share or t_share or (1.0, 1.0)
    return Location(dict(zip(FORCES, shares.tolist(), strict=True)), ranked, region, place, when, *share)


def force_noise(evidence: Evidence, at: np.ndarray) -> np.ndarray:
    """Return the variance of gap forces [N^2], shape (3,), by sensor noise and unmodelled disturbances.

    Notes
    -----
    Over W transitions of period p the mean of the rates that are left has the noise P^-1 (n_W - n_0)/(W p) less the
    mean of A n, with n the noise of a sample, A the velocity Jacobian and P of `Linearisation.to_motion`. So the two
    ends have the factors (P^-1/(W p) -+ A/(2 W)), and the samples between A/W. Disturbances of variance q per second
    add q/(W p). The mean over the rows `at` is returned.
    """
    period = evidence.series.period
    width = max(1, int(round(_AVERAGE_SECONDS / period)))
    A = evidence.linear.jacobian[at] / width
    P = evidence.linear.to_motion
    inverse = np.eye(3)[None] if P is None else np.linalg.inv(P[np.minimum(at, len(P) - 1)])
    end = inverse / (width * period)
    to_force = np.linalg.inv(evidence.vehicle.force_matrix())
    gains = ((1.0, to_force @ (end - 0.5 * A)), (1.0, to_force @ (end + 0.5 * A)), (width - 1.0, to_force @ A))
    squared = sum(times * np.mean(gain**2, axis=0) for times, gain in gains)
    shaken = np.mean((to_force @ inverse) ** 2, axis=0)
    return squared @ evidence.series.noise**2 + shaken @ evidence.disturbance / (width * period)


def dependence(x: np.ndarray, gap: np.ndarray, noise: np.ndarray, block: np.ndarray) -> float:
    """Return the share of a gap's variance above noise that a step function of one variable explains.

    Parameters
    ----------
    x : ndarray, shape (G,)
        The variable.
    gap : ndarray, shape (G, 3)
        Gap forces [N]; channels are weighed by their noise.
    noise : ndarray, shape (3,)
        Variance of the gap forces that is noise [N^2].
    block : ndarray of int, shape (G,)
        Block of time of each row.

    Returns
    -------
    float
        Between 0 and 1; 0 for a constant gap.

    Notes
    -----
    Cross-validation: means over bins of equal counts are learned on four fifths of the blocks of time and judged on the
    others, with 8, 16 or 40 bins, whichever explains most. The known sampling error of the means is added back. So a
    weak gap that depends on x alone is not reported to depend on x in part.
    """
    scaled = gap / np.sqrt(noise)
    fold = np.unique(block, return_inverse=True)[1] % _FOLDS
    gained = max(_gained(x, scaled, fold, steps) for steps in _STEPS)
    above = float(np.sum(np.var(scaled, axis=0) - 1.0))
    return float(np.clip(gained / max(above, _least_above(len(x))), 0.0, 1.0))


def _gained(x: np.ndarray, scaled: np.ndarray, fold: np.ndarray, steps: int) -> float:
    """Return the mean reduction of a held-out row's squared gap by a step function, in units of noise variance."""
    gained, judged_rows = 0.0, 0
    for k in range(_FOLDS):
        learned = fold != k
        # Rows that overlap with learned ones are left out.
        judged = ~np.convolve(learned, np.ones(2 * _ALIKE - 1), "same").astype(bool)
        if not (judged.any() and learned.any()):
            continue
        edges = np.unique(np.quantile(x[learned], np.linspace(0.0, 1.0, steps + 1)[1:-1]))
        bins = np.searchsorted(edges, x, side="right")
        mean, error = _bin_means(scaled, bins, learned, len(edges) + 1)
        level, at = scaled[learned].mean(axis=0), bins[judged]
        left = (scaled[judged] - mean[at]) ** 2 - error[at]
        gained += float(np.sum((scaled[judged] - level) ** 2 - left))
        judged_rows += int(judged.sum())
    return gained / max(judged_rows, 1)


def _least_above(rows: int) -> float:
    """Return two standard errors of the estimate of a variance in units of noise: the least variance that counts."""
    return 2.0 * float(np.sqrt(2.0 * len(FORCES) * _ALIKE / rows))


def _bin_means(scaled: np.ndarray, bins: np.ndarray, learned: np.ndarray, count: int):
    """Return the means of bins (B, 3) over learned rows and their variances; a bin without rows has the mean of all.

    Successive rows overlap, which increases the variance of a mean.
    """
    rows = np.bincount(bins[learned], minlength=count)[:, None]

    def mean_of(values: np.ndarray) -> np.ndarray:
        sums = np.stack([np.bincount(bins[learned], column, minlength=count) for column in values.T], axis=1)
        return np.where(rows > 0, sums / np.maximum(rows, 1), values.mean(axis=0))

    mean = mean_of(scaled[learned])
    within = mean_of((scaled - mean[bins])[learned] ** 2)
    alike = rows.astype(float)
    for lag in range(1, _ALIKE):
        pairs = (bins[lag:] == bins[:-lag]) & learned[lag:] & learned[:-lag]
        alike += 2.0 * (1.0 - lag / _ALIKE) * np.bincount(bins[lag:][pairs], minlength=count)[:, None]
    share = np.minimum(alike / np.maximum(rows, 1) ** 2, 0.999)
    return mean, within * share / (1.0 - share)


def _blocks(evidence: Evidence, at: np.ndarray, number: int) -> np.ndarray:
    """Return the number of each row's block of time, (G,); each bin of time has several of the short blocks."""
    t = evidence.series.t
    seconds = float(np.clip(t[-1] / (5.0 * _STEPS[1]), 3.0 * _AVERAGE_SECONDS, 2.0))
    return 1_000_000 * number + (t[at] // seconds).astype(np.int64)


def _interval(x: np.ndarray, size: np.ndarray) -> tuple[float, float, float, float]:
    """Return the interval of x with the largest excess over the mean, then its shares of the gap and of the samples."""
    order = np.argsort(x, kind="stable")
    surplus = np.cumsum(size[order] - np.mean(size))
    low = np.minimum.accumulate(np.concatenate([[0.0], surplus]))
    end = int(np.argmax(surplus - low[:-1]))
    begin = int(np.argmin(np.concatenate([[0.0], surplus])[: end + 1]))
    share = min(float(size[order][begin : end + 1].sum() / size.sum()), 1.0)
    return float(x[order][begin]), float(x[order][end]), share, (end + 1 - begin) / len(x)


def _local(found: tuple[float, float, float, float], rules: Reporting):
    """Return an interval and its two shares; two None if the gap is not much larger there than elsewhere."""
    low, high, gap, samples = found
    if gap > rules.local_ratio * samples and gap > rules.local_gap:
        return (low, high), (gap, samples)
    return None, None


def _concentrated(share: tuple[float, float], rules: Reporting) -> bool:
    """Return whether most of the gap lies in a small part of the samples."""
    gap, ratio = rules.concentrated
    return share[0] > gap and share[0] > ratio * share[1]


def _place(evidence: Sequence[Evidence], s: np.ndarray, size: np.ndarray, rules: Reporting):
    series = evidence[0].series
    found, lap = _interval(s, size), series.lap_length
    if lap:
        # A stretch may cross the start of the lap: it is whole if the lap is cut half a lap later.
        turned = _interval(np.mod(s + 0.5 * lap, lap), size)
        if turned[2] - turned[3] > found[2] - found[3]:
            found = (*np.mod(np.array(turned[:2]) - 0.5 * lap, lap).tolist(), *turned[2:])
    interval, share = _local(found, rules)
    if interval is None:
        return None, None
    length = interval[1] - interval[0]
    middle = interval[0] + 0.5 * (np.mod(length, lap) if lap else length)
    x = y = None
    if "X" in series.drive:
        away = series.s - (np.mod(middle, lap) if lap else middle)
        nearest = int(np.argmin(np.abs(away)))
        x, y = float(series.drive["X"][nearest]), float(series.drive["Y"][nearest])
    return Place(*interval, lap, series.place_reference, x, y), share
