"""Whether what is left is noise: a flexible fit over operating point, its mirror images, memory, time and place.

It needs no name for what it finds. The same test decides whether simulation and reality differ at all, and whether
named terms left something behind.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from split_cli.diagnosis.common import CommonPhysics, features
from split_cli.diagnosis.evidence import Evidence, integrated
from split_cli.diagnosis.judge import Judge
from split_cli.diagnosis.series import Series
from split_cli.vehicle.effects import Term
from split_cli.vehicle.effects.recording import first_order_response
from split_cli.vehicle.parameters import Vehicle

__all__ = [
    "FlexibleFit",
    "Structure",
    "build_structure",
    "common_severities",
    "minimum_effect_p",
    "severities",
    "severities_of",
    "severity",
    "term_allowances",
]

_HORIZON = 0.05
_HARMONICS = 8
_KNOTS = 9
_RIDGE_SHARE = 2e-3
# Differences smaller than these shares of the one-step noise are not called differences: below them, what any
# nominal model misses in one way of driving and not in another counts as common. A bare nominal model misses more
# than a simulation that brings its physics along, and what has no name has to be larger than what has.
ALLOWANCE = 0.05
BARE_ALLOWANCE = 0.09
NAMELESS_ALLOWANCE = 0.10
# What a dictionary misses of common physics is larger where there is more of it, in the channel where it is.
COMMON_SHARE = 0.03
# And smaller than these shares of what common physics explains: no dictionary fits it exactly. A flexible fit
# finds more of what is left than a single term can, by so much a parameter.
STRUCTURE_FLOOR = 1e-4
TERM_FLOOR = 1e-5
MISFIT_A_PARAMETER = 1.8


@dataclass(frozen=True)
class FlexibleFit:
    """What a flexible fit makes of entries.

    Attributes
    ----------
    saved : float
        Cost it saves.
    freedom : float
        Effective number of parameters.
    severity : float
        Root mean square of its 0.05 s prediction error over that of sensor noise, in the worst channel.
    p_value : float
        Of the hypothesis that the difference does not exceed the allowance.
    group_saved : tuple of (str, float)
        What each group of functions saves alone.
    """

    saved: float
    freedom: float
    severity: float
    p_value: float
    group_saved: tuple[tuple[str, float], ...]


@dataclass(frozen=True)
class Structure:
    """Whitened columns of the flexible fit on a judge's rows.

    Attributes
    ----------
    judge : Judge
    columns : ndarray, shape (R, Q)
        Whitened, the common physics' part that is still free taken out.
    defects : tuple of ndarray, shape (N - 1, 3, Q)
        What each function adds to each recording's transitions.
    groups : tuple of str
        Group of each column.
    """

    judge: Judge
    columns: np.ndarray
    defects: tuple[np.ndarray, ...]
    groups: tuple[str, ...]
    factor: np.ndarray

    def fit(self, entries: np.ndarray, inflation: float) -> FlexibleFit:
        """Fit whitened entries, shape (R,)."""
        score = self.columns.T @ entries
        weights = np.linalg.solve(self.factor, np.linalg.solve(self.factor.T, score))
        saved = float(score @ weights)
        inverse = np.linalg.inv(self.factor)
        freedom = float(len(score) - _RIDGE_SHARE * len(entries) * np.sum(inverse**2))
        size = max(
            severity(one.series, part @ weights, one.at[mask])
            for one, part, mask in zip(self.judge.evidence, self.defects, self.judge.keep, strict=True)
        )
        # The size is overestimated by what the fit makes of noise.
        size *= np.sqrt(max(1.0 - inflation * freedom / max(saved, 1e-9), 0.0))
        floor = self.allowed(freedom)
        p = minimum_effect_p(saved, freedom, size, inflation, floor, NAMELESS_ALLOWANCE)
        return FlexibleFit(saved, freedom, float(size), p, self._by_group(score))

    def allowed(self, freedom: float) -> float:
        """Return the saving that a dictionary's misfit may bring with so many parameters."""
        if self.judge.knowledge is None:
            return 0.0
        misfit = MISFIT_A_PARAMETER * freedom + STRUCTURE_FLOOR * self.judge.shared_cost
        return max(misfit, self.judge.nameless_floor)

    def _by_group(self, score: np.ndarray) -> tuple[tuple[str, float], ...]:
        out = []
        normal = self.factor.T @ self.factor
        for group in dict.fromkeys(self.groups):
            chosen = np.array([name == group for name in self.groups])
            part = score[chosen]
            out.append((group, float(part @ np.linalg.solve(normal[np.ix_(chosen, chosen)], part))))
        return tuple(sorted(out, key=lambda pair: -pair[1]))


def build_structure(judge: Judge, common: CommonPhysics) -> Structure:
    """Whiten the flexible columns of every real recording."""
    parts, raw, groups = [], [], ()
    for one in judge.evidence:
        columns, groups = _columns(one, common)
        raw.append(integrated(one.series, columns))
        parts.append(one.whitener(raw[-1]))
    columns = judge.whiten(judge.stack(parts))
    scale = np.sqrt(np.mean(columns**2, axis=0)) + 1e-12
    # A ridge: sums of nearly collinear columns hold little beside the noise of the smoothed states, which is also
    # in the entries and would look like structure.
    scale = np.where(scale > 1e-9, scale, np.inf)
    columns = columns / scale
    penalty = _RIDGE_SHARE * len(columns)
    factor = np.linalg.cholesky(columns.T @ columns + penalty * np.eye(columns.shape[1])).T
    return Structure(judge, columns, tuple(part / scale for part in raw), groups, factor)


def severity(series: Series, defect: np.ndarray, rows: np.ndarray | None = None) -> float:
    """Return the severity of defects in the channel where it is largest; see `severities`."""
    return float(severities(series, defect, rows).max())


def severities(series: Series, defect: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
    """Return the rms of defects (N - 1, 3) summed over 0.05 s over that of sensor noise, of v_x, v_y and r.

    Only windows about the samples `rows` count, where they are given: what a function does elsewhere is not known.
    """
    window = max(1, int(round(_HORIZON / series.period)))
    total = np.cumsum(np.concatenate([np.zeros((1, 3)), defect]), axis=0)
    over = total[window:] - total[:-window]
    if rows is not None:
        over = over[np.clip(rows - window // 2, 0, len(over) - 1)]
    if not len(over):
        return np.zeros(3)
    return np.sqrt(np.mean(over**2, axis=0)) / (np.sqrt(2.0) * series.told_noise)


def severities_of(
    evidence: Evidence, rows: np.ndarray, terms: tuple[Term, ...], without: tuple[Term, ...] = ()
) -> np.ndarray:
    """Return the severities of terms about the samples `rows`, against the model with `without` alone."""
    return severities(evidence.series, evidence.left(terms) - evidence.left(without), rows)


def common_severities(judge: Judge) -> np.ndarray:
    """Return the severities of the common physics on the compared rows, of v_x, v_y and r, shape (3,)."""
    if judge.knowledge is None:
        return np.zeros(3)
    if "common severities" not in judge.memo:
        sizes = [
            severities(
                one.series,
                integrated(one.series, judge.common.rates(one.series, judge.knowledge.weights)),
                one.at[mask],
            )
            for one, mask in zip(judge.evidence, judge.keep, strict=True)
        ]
        judge.memo["common severities"] = np.max(sizes, axis=0)
    return judge.memo["common severities"]


def term_allowances(judge: Judge) -> np.ndarray:
    """Return the severities in v_x, v_y and r below which a term is not named, shape (3,)."""
    if judge.knowledge is None:
        return np.full(3, BARE_ALLOWANCE)
    return np.maximum(ALLOWANCE, COMMON_SHARE * common_severities(judge))


def minimum_effect_p(
    saved: float, freedom: float, size: float, inflation: float, floor: float = 0.0, allowance: float = ALLOWANCE
) -> float:
    """Return the probability of saving this much when the true effect is just the allowance.

    Parameters
    ----------
    saved : float
        Cost saved.
    freedom : float
        Parameters that saved it.
    size : float
        Severity of the fitted effect.
    inflation : float
    floor : float
        Saving that is allowed whatever the size.
    allowance : float
        Severity that is allowed.

    Notes
    -----
    A test against a minimum effect (Murphy and Myors, 1999): under the null the saved cost over the inflation is
    non-central chi squared with the saving that an effect of the allowed size would bring.
    """
    from scipy.stats import ncx2

    if saved <= 0.0 or size <= 0.0:
        return 1.0
    ratio = saved / inflation
    allowed = max(ratio - freedom, 0.0) * min(allowance / size, 1.0) ** 2
    return float(np.clip(ncx2.sf(ratio, max(freedom, 1.0), max(allowed, floor / inflation)), 0.0, 1.0))


def _columns(one: Evidence, common: CommonPhysics) -> tuple[np.ndarray, tuple[str, ...]]:
    series, vehicle = one.series, one.vehicle
    shared = common.columns(series)
    columns, groups = [shared], ["operating point"] * shared.shape[2]
    for name, block in (
        ("left against right", _asymmetric(series, vehicle)),
        ("memory", _memory(series, vehicle)),
        ("time", _time(series, vehicle)),
        ("place", _place(series, vehicle)),
    ):
        columns.append(block)
        groups += [name] * block.shape[2]
    return np.concatenate(columns, axis=2), tuple(groups)


def _forces(vehicle: Vehicle) -> np.ndarray:
    """Rates by 3 % of an axle's peak as longitudinal, front and rear lateral force, in columns, shape (3, 3)."""
    return vehicle.force_matrix() * 0.03 * 0.5 * (vehicle.front_tire.D + vehicle.rear_tire.D)


def _scaled(series: Series, vehicle: Vehicle) -> np.ndarray:
    z = features(series, vehicle)
    return z / np.maximum(np.quantile(np.abs(z), 0.99, axis=0), 1e-9)


def _spread(functions: dict[int, list[np.ndarray]], vehicle: Vehicle) -> np.ndarray:
    """Give functions by force channel (0 to 2) their directions, shape (N, 3, Q)."""
    direction = _forces(vehicle)
    out = [f[:, None] * direction[:, channel] for channel, fs in functions.items() for f in fs]
    return np.stack(out, axis=2)


def _asymmetric(series: Series, vehicle: Vehicle) -> np.ndarray:
    a, b, c, v = np.clip(_scaled(series, vehicle), -1.5, 1.5).T
    odd, even = [], []
    for i, j, k, m in product(range(4), range(4), range(3), range(3)):
        if i + j + k + m <= 3:
            (odd if (i + j) % 2 else even).append(a**i * b**j * c**k * v**m)
    even += [np.abs(a), np.abs(b), np.maximum(c, 0.0), np.maximum(-c, 0.0) * np.abs(b)]
    odd += [a * np.maximum(c, 0.0), a * np.maximum(-c, 0.0)]
    return _spread({0: odd, 1: even, 2: even}, vehicle)


def _memory(series: Series, vehicle: Vehicle) -> np.ndarray:
    a, b, c, v = _scaled(series, vehicle).T
    delta = series.steer_angle / max(float(np.quantile(np.abs(series.steer_angle), 0.99)), 1e-6)
    clock = series.recording
    along, front, rear = [], [], []
    for tau in (0.02, 0.06, 0.2, 0.7):
        late_delta = first_order_response(delta, 1.0 / tau, clock) - delta
        late_torque = first_order_response(c, 1.0 / tau, clock) - c
        along.append(late_torque)
        front.append(late_delta)
        rear.append(first_order_response(b, 1.0 / tau, clock) - b)
    for tau in (2.0, 6.0, 20.0):
        work = first_order_response(np.abs(c) * v, 1.0 / tau, clock)
        brake = first_order_response(np.maximum(-c, 0.0) * v, 1.0 / tau, clock)
        slide = first_order_response(a * a + b * b, 1.0 / tau, clock)
        along += [work * c, brake * np.minimum(c, 0.0), brake]
        front += [slide * a, work * a]
        rear += [slide * b, work * b]
    braked = first_order_response(np.maximum(-c, 0.0), 1.0, clock)
    along += [braked, np.gradient(c), np.gradient(delta) * delta]
    front += [braked, np.gradient(delta), np.tanh(np.gradient(delta) / (np.std(np.gradient(delta)) + 1e-12))]
    rear += [braked, np.gradient(b)]
    return _spread({0: along, 1: front, 2: rear}, vehicle)


def _time(series: Series, vehicle: Vehicle) -> np.ndarray:
    a, b, c, _ = _scaled(series, vehicle).T
    position = series.t / max(series.t[-1], 1e-9) * (_KNOTS - 1)
    hats = [np.maximum(0.0, 1.0 - np.abs(position - k)) for k in range(_KNOTS)]
    up, down = np.maximum(c, 0.0), np.minimum(c, 0.0)
    return _spread(
        {
            0: [h * f for h in hats for f in (1.0, up, down)],
            1: [h * f for h in hats for f in (1.0, a)],
            2: [h * f for h in hats for f in (1.0, b)],
        },
        vehicle,
    )


def _place(series: Series, vehicle: Vehicle) -> np.ndarray:
    a, b, _, _ = _scaled(series, vehicle).T
    angle = 2.0 * np.pi * series.s / (series.lap_length or max(float(series.s.max()), 1.0))
    waves = [f(k * angle) for k in range(1, _HARMONICS + 1) for f in (np.sin, np.cos)]
    few = waves[: 2 * (_HARMONICS // 2)]
    return _spread({0: waves, 1: waves + [w * a for w in few], 2: waves + [w * b for w in few]}, vehicle)
