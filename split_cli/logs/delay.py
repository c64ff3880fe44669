"""How late channels are against each other, from kinematic identities, with an error or a refusal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.logs.kinematics import Kinematics
from split_cli.vehicle.parameters import Vehicle

__all__ = ["DelayEstimate", "LagFit", "estimate_delays", "fit_lag"]

LONGEST_DELAY = 1.5
"""Searched on both sides [s]."""

LARGEST_ERROR = 0.05
"""An estimate less sure than this is refused [s], unless it is `_CLEAR` times its error and within twice this."""

_CLEAR = 4.0

_LEAST_DETERMINATION = 0.5
_COARSE_STEP = 0.025
_BLOCKS = 10
_MOST_ROWS = 8000
_WIDTH = 0.12
_COURSE_WIDTH = 0.5
_REFERENCE = "vx"


@dataclass(frozen=True)
class LagFit:
    """By how much one signal lags another.

    Attributes
    ----------
    lag, error : float
        Positive when the first is late [s]; standard error from blocks of time.
    determination : float
        Share of the first signal's variance that the second explains at that lag.
    refusal : str
        Why the lag is not to be used, else empty.
    """

    lag: float
    error: float
    determination: float
    refusal: str = ""


@dataclass(frozen=True)
class DelayEstimate:
    """How late a channel is against the reference.

    Attributes
    ----------
    channel : str
    delay : float
        What its times are moved earlier by [s]; 0 when refused, or when it does not differ from 0.
    error : float
        Standard error [s].
    reference : str
        Channel whose delay is 0 by definition.
    identities : tuple of str
        That it rests on.
    determination : float
        The least among them.
    refusal : str
        Why nothing is applied, else empty.
    """

    channel: str
    delay: float
    error: float
    reference: str
    identities: tuple[str, ...] = ()
    determination: float = 0.0
    refusal: str = ""

    @property
    def statement(self) -> str:
        """The estimate in words."""
        if self.refusal:
            return f"{self.channel}: not estimated, {self.refusal}"
        how = f"from {' and '.join(self.identities)}, R^2 {self.determination:.3f}"
        if self.delay == 0.0:
            return f"{self.channel}: no delay against {self.reference} (+- {self.error:.4f} s; {how})"
        late = "late" if self.delay > 0 else "early"
        return (
            f"{self.channel}: {abs(self.delay):.4f} +- {self.error:.4f} s {late} against {self.reference}, "
            f"moved ({how})"
        )

    def refined(self, later: DelayEstimate) -> DelayEstimate:
        """Return the sum of this and what a later pass still found."""
        if later.refusal:
            return self
        if self.refusal:
            return later
        return replace(later, delay=self.delay + later.delay)


@dataclass(frozen=True)
class _Edge:
    """An identity between the clocks of two groups: `late(t + lag)` is linear in `regressors(t)`."""

    name: str
    late: str
    early: str
    signal: Callable[[], np.ndarray]
    regressors: Callable[[], list[np.ndarray]]


@dataclass
class _Node:
    """Channels that share a clock, and what is known of their delay."""

    channels: list[str] = field(default_factory=list)


def estimate_delays(
    columns: Mapping[str, np.ndarray],
    period: float,
    segments: list[slice],
    vehicle: Vehicle | None,
    topics: Mapping[str, str],
    fixed: frozenset[str] = frozenset(),
    commands: frozenset[str] = frozenset(),
) -> tuple[DelayEstimate, ...]:
    """Estimate the delays of a drive's channels against v_x.

    Parameters
    ----------
    columns : mapping of str to ndarray
        On the drive's clock, SI.
    period : float
        [s].
    segments : list of slice
    vehicle : Vehicle, optional
        Needed for the steer angle, whose effect on yaw has dynamics of its own.
    topics : mapping of str to str
        Channels of one topic share its time stamps and so their delay.
    fixed : frozenset of str
        Channels whose delay the user gave.
    commands : frozenset of str
        Channels that are commands: what they lag is the actuator's doing and must stay in the drive.

    Notes
    -----
    Each identity gives the difference of two delays; all together are solved by weighted least squares. Channels
    that no chain of identities ties to v_x are estimated against yaw rate, taken to be on time then.
    """
    k = Kinematics(columns, period, segments, _WIDTH)
    groups = _groups(columns, topics)
    fits: list[tuple[_Edge, LagFit]] = []
    for edge in _identities(k, vehicle, Kinematics(columns, period, segments, _COURSE_WIDTH)):
        if groups[edge.late] != groups[edge.early]:
            fits.append((edge, fit_lag(edge.signal(), edge.regressors(), k.moving, period, segments)))
    return tuple(_solve(fits, groups, columns, fixed, commands, vehicle))


def _groups(columns: Mapping[str, np.ndarray], topics: Mapping[str, str]) -> dict[str, str]:
    """Return for each channel the name of its clock: its topic, and one for what one sensor always gives together."""
    together = {"Y": "X", "vy": "vx"}
    groups = {}
    for channel in columns:
        topic = topics.get(channel, channel)
        partner = together.get(channel)
        same_kind = not topic.startswith("/") and partner in columns
        groups[channel] = topics.get(partner, partner) if same_kind else topic
    return groups


def _identities(k: Kinematics, vehicle: Vehicle | None, wide: Kinematics) -> list[_Edge]:
    """Return the identities that the channels allow."""
    have = set(k.columns)
    edges: list[_Edge] = []

    def add(name: str, late: str, early: str, needs: set[str], signal, *regressors) -> None:
        if {late, early, *needs} <= have:
            edges.append(_Edge(name, late, early, signal, lambda: [make() for make in regressors]))

    c = k.columns
    turning = lambda: k.of("vx r", lambda: c["vx"] * c["r"])  # noqa: E731
    inertial_x = lambda: k.rate("vx") - k.of("vy r", lambda: c["vy"] * c["r"])  # noqa: E731
    add("dyaw/dt = r", "yaw", "r", set(), lambda: k.rate("yaw"), lambda: k.signal("r"))
    add("a_x = dv_x/dt - v_y r", "ax", "vx", {"vy", "r"}, lambda: k.signal("ax"), inertial_x)
    add(
        "a_y = v_x r + dv_y/dt",
        "ay",
        "r",
        {"vx", "vy"},
        lambda: k.signal("ay"),
        lambda: turning() + k.rate("vy"),
    )
    for wheel in [name for name in c if name.startswith("wheel_speed")]:
        add(f"{wheel} = v_x", wheel, "vx", set(), lambda w=wheel: k.rate(w), lambda: k.rate("vx"))
    add(
        "speed of X, Y = v_x",
        "X",
        "vx",
        {"Y"},
        lambda: wide.of("ground speed", lambda: _from_rates(k), 1),
        lambda: wide.rate("vx"),
    )
    add("turning of X, Y = r + dbeta/dt", "X", "r", {"Y", "vx", "vy"}, wide.course_rate, lambda: _turning(wide))
    if vehicle is not None:
        add("steer angle of the single track", "delta", "r", {"vx", "vy"}, lambda: k.signal("delta"),
            *_steer_regressors(k, vehicle))  # fmt: skip
    return edges


def _from_rates(k: Kinematics) -> np.ndarray:
    return k.ground_speed()


def _turning(k: Kinematics) -> np.ndarray:
    """Return the turning of the CG's path: yaw rate alone leads it or lags it by l/v_x, metres over speed."""
    c = k.columns
    sideslip = k.of("beta", lambda: np.where(k.moving, np.arctan2(c["vy"], c["vx"]), np.nan), 1)
    return k.signal("r") + sideslip


def _steer_regressors(k: Kinematics, car: Vehicle) -> tuple[Callable, Callable]:
    """Return what delta is linear in: the velocity direction at the front axle, and the front lateral force.

    delta = (v_y + l_f r)/v_x + F_fy/C_f with F_fy = (m l_r a_y + I_z r')/L: the car's own lag between steering and
    yawing is in the terms v_y and r', so that what remains is the delay of the recording.
    """
    c = k.columns

    def direction() -> np.ndarray:
        vx = np.where(k.moving, c["vx"], np.nan)
        return k.of("front", lambda: (c["vy"] + car.cg_to_front_axle * c["r"]) / vx)

    def force() -> np.ndarray:
        lateral = k.rate("vy") + k.of("vx r", lambda: c["vx"] * c["r"])
        return (car.mass * car.cg_to_rear_axle * lateral + car.yaw_inertia * k.rate("r")) / car.wheelbase

    return direction, force


def fit_lag(
    signal: np.ndarray,
    regressors: list[np.ndarray],
    mask: np.ndarray,
    period: float,
    segments: list[slice],
    longest: float = LONGEST_DELAY,
) -> LagFit:
    """Find the lag at which a signal is best explained linearly by others, to a fraction of a sample.

    Parameters
    ----------
    signal : ndarray, shape (N,)
        The one that may be late; NaN where unknown.
    regressors : list of ndarray, shape (N,)
    mask : ndarray of bool, shape (N,)
        Rows to use.
    period : float
        [s].
    segments : list of slice
    longest : float
        Lags searched on both sides [s].

    Notes
    -----
    The signal is shifted by its cubic spline; the residual variance is tabulated over lags for every tenth of the
    time left out, and the vertex of the parabola at its least value taken; the error is their jackknife spread.
    """
    rows, x, shifted = _prepare(signal, regressors, mask, period, segments, longest)
    if rows < 300:
        return LagFit(0.0, np.inf, 0.0, "too little driving in which it changes")
    coarse = np.arange(-longest, longest + 0.5 * _COARSE_STEP, _COARSE_STEP)
    costs = _costs(x, shifted, coarse)
    best = int(np.argmin(costs[0]))
    determination = 1.0 - float(costs[0, best])
    lag = float(coarse[best])
    if determination < _LEAST_DETERMINATION:
        return LagFit(lag, np.inf, determination, f"the identity explains only {max(determination, 0):.0%} of it")
    if best in (0, len(coarse) - 1):
        return LagFit(lag, np.inf, determination, f"the best lag is at the end of the search, {lag:+.2f} s")
    local = (costs[0, 1:-1] < costs[0, :-2]) & (costs[0, 1:-1] < costs[0, 2:])
    others = np.flatnonzero(local) + 1
    rivals = [j for j in others if abs(coarse[j] - lag) > 0.2 and costs[0, j] < 1.1 * costs[0, best]]
    if rivals:
        return LagFit(lag, np.inf, determination, f"{lag:+.2f} s and {coarse[rivals[0]]:+.2f} s fit equally well")
    fine = lag + np.linspace(-_COARSE_STEP, _COARSE_STEP, 9)
    vertices = _vertices(fine, _costs(x, shifted, fine))
    full, parts = vertices[0], vertices[1:]
    error = float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((parts - parts.mean()) ** 2)))
    refusal = "" if _sure(full, error) else f"the lag {full:+.3f} s is uncertain by {error:.3f} s"
    return LagFit(float(full), error, determination, refusal)


def _sure(delay: float, error: float) -> bool:
    return error <= LARGEST_ERROR or (error <= 2.0 * LARGEST_ERROR and abs(delay) >= _CLEAR * error)


def _prepare(signal, regressors, mask, period, segments, longest):
    """Return the row count, the regressors `(B, n, p)` by blocks of time, and a function lag -> signal `(B, n)`."""
    from scipy.interpolate import make_interp_spline

    usable = mask & np.isfinite(signal)
    for regressor in regressors:
        usable &= np.isfinite(regressor)
    margin = int(np.ceil((longest + _COARSE_STEP) / period)) + 1
    known = np.isfinite(signal)
    pieces, splines = [], []
    for run in segments:
        finite = np.flatnonzero(known[run])
        if len(finite) < 4 or len(finite) <= 2 * margin:
            continue
        inside = np.zeros(len(signal), dtype=bool)
        first, last = run.start + finite[0], run.start + finite[-1]
        inside[first + margin : last - margin + 1] = usable[first + margin : last - margin + 1]
        chosen = np.flatnonzero(inside)
        if len(chosen):
            # A spline across the few unknown samples inside keeps the clock; rows next to them are not used.
            splines.append(make_interp_spline((run.start + finite) * period, signal[run.start + finite], k=3))
            pieces.append(chosen)
    total = sum(len(piece) for piece in pieces)
    if total < 300:
        return 0, None, None
    stride = max(1, total // _MOST_ROWS)
    pieces = [piece[::stride] for piece in pieces]
    rows = np.concatenate(pieces)
    length = len(rows) // _BLOCKS
    rows = rows[: length * _BLOCKS]
    columns = [regressor[rows] - np.mean(regressor[rows]) for regressor in regressors]
    design = np.stack([_winsorised(column) for column in columns] + [np.ones(len(rows))], axis=1)
    limits = np.quantile(signal[rows], [0.002, 0.998])

    def shifted(lag: float) -> np.ndarray:
        values = np.concatenate(
            [spline(piece * period + lag) for spline, piece in zip(splines, pieces, strict=True)]
        )
        return np.clip(values[: length * _BLOCKS], *limits).reshape(_BLOCKS, length)

    return len(rows) * stride, design.reshape(_BLOCKS, length, -1), shifted


def _winsorised(values: np.ndarray) -> np.ndarray:
    return np.clip(values, *np.quantile(values, [0.002, 0.998]))


def _costs(design: np.ndarray, shifted: Callable, lags: np.ndarray) -> np.ndarray:
    """Return 1 - R^2, shape (1 + B, K): with all blocks, then with each one left out."""
    moments = np.einsum("bni,bnj->bij", design, design)
    count = design.shape[1]
    costs = np.empty((1 + _BLOCKS, len(lags)))
    for column, lag in enumerate(lags):
        y = shifted(lag)
        cross = np.einsum("bni,bn->bi", design, y)
        squares, sums = np.sum(y * y, axis=1), np.sum(y, axis=1)
        for row in range(1 + _BLOCKS):
            keep = np.arange(_BLOCKS) != row - 1
            gram, right = moments[keep].sum(axis=0), cross[keep].sum(axis=0)
            solution = np.linalg.lstsq(gram, right, rcond=1e-12)[0]
            total = squares[keep].sum() - sums[keep].sum() ** 2 / (count * keep.sum())
            costs[row, column] = (squares[keep].sum() - right @ solution) / max(total, 1e-300)
    return costs


def _vertices(lags: np.ndarray, costs: np.ndarray) -> np.ndarray:
    """Return for each row of costs the least point of its parabola over the lags."""
    centre = float(np.mean(lags))
    scale = float(lags[-1] - centre)
    coefficients = np.polyfit((lags - centre) / scale, costs.T, 2)
    curvature = np.maximum(coefficients[0], 1e-300)
    return centre + scale * np.clip(-0.5 * coefficients[1] / curvature, -2.0, 2.0)


def _solve(fits, groups, columns, fixed, commands, vehicle) -> list[DelayEstimate]:
    """Solve the differences for one delay a group, and put each channel's into words."""
    good = [(edge, fit) for edge, fit in fits if not fit.refusal]
    nodes = list(dict.fromkeys(groups.values()))
    component = _components(nodes, [(groups[e.late], groups[e.early]) for e, _ in good])
    anchors = [groups[c] for c in ("vx", "r") if c in groups]
    pinned = {groups[c] for c in fixed if c in groups}
    estimates: list[DelayEstimate] = []
    for members in component:
        reference = next((a for a in anchors if a in members), None)
        edges = [(e, f) for e, f in good if groups[e.late] in members]
        if reference is None or not edges:
            continue
        held = {reference, *pinned} & members
        free = sorted(members - held)
        delays, errors = _least_squares(edges, groups, free)
        name = next(c for c in ("vx", "r") if groups.get(c) == reference)
        for node in free:
            own = [(e, f) for e, f in edges if node in (groups[e.late], groups[e.early])]
            for channel in [c for c in columns if groups[c] == node]:
                estimates.append(_estimate(channel, delays[node], errors[node], name, own, channel in commands))
    estimates += _refused(fits, groups, {e.channel for e in estimates} | fixed, vehicle, columns)
    order = list(columns)
    return sorted(estimates, key=lambda e: order.index(e.channel))


def _components(nodes: list[str], links: list[tuple[str, str]]) -> list[set[str]]:
    parts = [{node} for node in nodes]
    for a, b in links:
        first = next(p for p in parts if a in p)
        second = next(p for p in parts if b in p)
        if first is not second:
            first |= second
            parts.remove(second)
    return parts


def _least_squares(edges, groups, free: list[str]) -> tuple[dict[str, float], dict[str, float]]:
    design = np.zeros((len(edges), len(free)))
    target, weight = np.empty(len(edges)), np.empty(len(edges))
    for row, (edge, fit) in enumerate(edges):
        for node, sign in ((groups[edge.late], 1.0), (groups[edge.early], -1.0)):
            if node in free:
                design[row, free.index(node)] += sign
        target[row], weight[row] = fit.lag, 1.0 / max(fit.error, 5e-4)
    if not free:
        return {}, {}
    covariance = np.linalg.pinv((design * weight[:, None] ** 2).T @ design)
    solution = covariance @ (design.T @ (weight**2 * target))
    # Identities that contradict each other tell that their errors are larger than the blocks show.
    spare = len(edges) - len(free)
    misfit = float(np.sum((weight * (target - design @ solution)) ** 2)) / spare if spare > 0 else 1.0
    errors = np.sqrt(np.diag(covariance) * max(1.0, misfit))
    return dict(zip(free, solution, strict=True)), dict(zip(free, errors, strict=True))


def _estimate(channel, delay, error, reference, own, is_command) -> DelayEstimate:
    identities = tuple(edge.name for edge, _ in own)
    determination = min(fit.determination for _, fit in own)
    refusal = ""
    if is_command:
        refusal = (
            f"it is a command: that the car follows it {delay:.3f} +- {error:.3f} s "
            f"{'earlier' if delay > 0 else 'later'} is the actuator's doing and stays in the drive"
        )
    elif not _sure(delay, error):
        refusal = f"the delay {delay:+.3f} s is uncertain by {error:.3f} s"
    # A reading two errors from nothing is nothing: moving it would only resample it.
    applied = 0.0 if refusal or abs(delay) < max(2.0 * error, 1e-3) else float(delay)
    return DelayEstimate(channel, applied, float(error), reference, identities, determination, refusal)


def _refused(fits, groups, done: set[str], vehicle, columns) -> list[DelayEstimate]:
    refused = []
    for channel in columns:
        if channel in done or channel in ("vx", "vy", "r", "Y") or groups[channel] in (groups.get("vx"),):
            continue
        tried = [(edge, fit) for edge, fit in fits if groups[channel] in (groups[edge.late],)]
        if tried:
            text = "; ".join(f"{edge.name}: {fit.refusal}" for edge, fit in tried if fit.refusal)
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal=text or "not tied to v_x"))
        elif channel == "delta" and vehicle is None:
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal="that takes the vehicle"))
        elif channel == "T":
            reason = "no identity ties it to the motion: what it lags is the drive train's doing"
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal=reason))
    return refused
