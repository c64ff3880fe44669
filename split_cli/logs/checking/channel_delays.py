"""How late channels are against each other, from kinematic identities, with an error or a refusal."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.logs.checking.best_lag import LagFit, fit_lag, is_sure
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.vehicle.parameters import Vehicle

_WIDTH = 0.12
_COURSE_WIDTH = 0.5
_REFERENCE = "vx"
_GENTLE = 0.4
"""Share of the vehicle file's grip up to which tyres are taken as linear [1]; judgement."""


@dataclass(frozen=True)
class DelayEstimate:
    """How late a channel is against the reference."""

    channel: str
    delay: float  # as estimated, positive when late [s]; 0 when refused
    error: float  # standard error [s]
    reference: str  # channel whose delay is 0 by definition
    identities: tuple[str, ...] = ()  # that it rests on
    determination: float = 0.0  # the least among them
    refusal: str = ""  # why nothing is applied, else empty

    @property
    def applied(self) -> float:
        """What the channel's times are moved earlier by [s]: nothing where the delay could as well be 0."""
        return 0.0 if self.refusal or abs(self.delay) < max(2.0 * self.error, 1e-3) else self.delay

    @property
    def statement(self) -> str:
        """The estimate in words."""
        if self.refusal:
            return f"{self.channel}: not estimated, {self.refusal}"
        how = f"from {' and '.join(self.identities)}, R^2 {self.determination:.3f}"
        if self.applied == 0.0:
            return f"{self.channel}: no delay against {self.reference} ({self.delay:+.4f} +- {self.error:.4f} s; {how})"
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
    """An identity between the clocks of two groups: `late(t + lag)` is linear in `regressors(t)`.

    `doubts` are regressors that may or may not belong to it; what they change of the lag counts as its error.
    """

    name: str
    late: str
    early: str
    signal: Callable[[], np.ndarray]
    regressors: Callable[[], list[np.ndarray]]
    doubts: Callable[[], list[np.ndarray]] = list
    rows: np.ndarray | bool = True  # (N,), where it holds


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
            # What lags a command is never moved: of that more rows tell a little, of a sensor they could mislead.
            rows = True if edge.late in commands else edge.rows
            fits.append((edge, _fit(edge, k.moving & rows, period, segments)))
    return tuple(_solve(fits, groups, columns, fixed, commands, vehicle))


def _fit(edge: _Edge, mask: np.ndarray, period: float, segments: list[slice]) -> LagFit:
    signal, regressors, doubts = edge.signal(), edge.regressors(), edge.doubts()
    fit = fit_lag(signal, regressors, mask, period, segments)
    if not doubts or fit.refusal:
        return fit
    other = fit_lag(signal, [*regressors, *doubts], mask, period, segments)
    error = float(np.hypot(max(fit.error, other.error), other.lag - fit.lag))
    refusal = "" if is_sure(other.lag, error) else f"wheel slip could make a lag of {fit.lag:+.3f} s too"
    return replace(other, error=error, refusal=refusal)


def _groups(columns: Mapping[str, np.ndarray], topics: Mapping[str, str]) -> dict[str, str]:
    """Return for each channel the name of its clock: its topic, and one for what one sensor gives together."""
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

    def add(name: str, late: str, early: str, needs: set[str], signal, *regressors, doubts=(), rows=True) -> None:
        if {late, early, *needs} <= have:
            made = _Edge(
                name, late, early, signal, lambda: [f() for f in regressors], lambda: [f() for f in doubts], rows
            )
            edges.append(made)

    c = k.columns
    forced = lambda: c["vx"] * np.nan_to_num(k.rate("vx"))  # noqa: E731
    inertial_x = lambda: k.rate("vx") - k.of("vy r", lambda: c["vy"] * c["r"])  # noqa: E731
    add("dyaw/dt = r", "yaw", "r", set(), lambda: k.rate("yaw"), lambda: k.signal("r"))
    add("a_x = dv_x/dt - v_y r", "ax", "vx", {"vy", "r"}, lambda: k.signal("ax"), inertial_x)
    across = lambda: k.turning() + k.rate("vy")  # noqa: E731
    add("a_y = v_x r + dv_y/dt", "ay", "r", {"vx", "vy"}, lambda: k.signal("ay"), across)
    for wheel in [name for name in c if name.startswith("wheel_speed")]:
        # A driven wheel slips by its force: v_x (1 + k a_x) looks like v_x a little earlier.
        slip = [lambda: k.of("vx ax", forced, 1)] if _is_driven(wheel, vehicle) else []
        turn = [lambda: k.rate("r")] if "r" in c else []
        add(f"{wheel} = v_x", wheel, "vx", set(), lambda w=wheel: k.rate(w), lambda: k.rate("vx"), *turn, doubts=slip)
    add(
        "speed of X, Y = v_x",
        "X",
        "vx",
        {"Y"},
        lambda: wide.of("ground speed", k.ground_speed, 1),
        lambda: wide.rate("vx"),
    )
    for name, late, turn in (("r", "r", wide.signal), ("dyaw/dt", "yaw", wide.rate)):
        add(
            f"turning of X, Y = {name} + dbeta/dt",
            "X",
            late,
            {"Y", "vx", "vy"},
            wide.course_rate,
            lambda late=late, turn=turn: turn(late) + _sideslip_rate(wide),
        )
    if vehicle is not None and {"vx", "r"} <= have:
        add(
            "steer angle of the single track",
            "delta",
            "r",
            {"vx", "vy"},
            lambda: k.signal("delta"),
            *_steer_regressors(k, vehicle),
            rows=linear_tire_rows(c, vehicle),
        )
    return edges


def linear_tire_rows(columns: Mapping[str, np.ndarray], vehicle: Vehicle) -> np.ndarray:
    """Return where the lateral acceleration v_x r leaves tyres linear, bool (N,)."""
    return np.abs(columns["vx"] * columns["r"]) < _GENTLE * vehicle.lateral_grip


def _is_driven(wheel: str, vehicle: Vehicle | None) -> bool:
    """Whether a wheel may carry driving torque; a wheel of no known axle may."""
    if vehicle is None or wheel[-2:] not in ("fl", "fr", "rl", "rr"):
        return True
    share = vehicle.drive_split_front if wheel[-2] == "f" else 1.0 - vehicle.drive_split_front
    return share > 0.0


def _sideslip_rate(k: Kinematics) -> np.ndarray:
    """Return the rate of the sideslip angle: without it the path leads yaw or lags it by metres over speed."""
    c = k.columns
    return k.of("beta", lambda: np.where(k.moving, np.arctan2(c["vy"], c["vx"]), np.nan), 1)


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
        lateral = k.rate("vy") + k.turning()
        return (car.mass * car.cg_to_rear_axle * lateral + car.yaw_inertia * k.rate("r")) / car.wheelbase

    return direction, force


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
    # Identities that contradict each other tell that their errors are larger than the blocks show. What no other
    # identity is compared with contradicts none, and keeps its error.
    spare = len(edges) - len(free)
    if spare > 0:
        reduced = float(np.sum((weight * (target - design @ solution)) ** 2)) / spare
        own = np.einsum("ij,jk,ik->i", design, covariance, design) * weight**2
        weight = np.where(own < 1.0 - 1e-6, weight / np.sqrt(max(1.0, reduced)), weight)
        covariance = np.linalg.pinv((design * weight[:, None] ** 2).T @ design)
    errors = np.sqrt(np.diag(covariance))
    return dict(zip(free, solution, strict=True)), dict(zip(free, errors, strict=True))


def _estimate(channel, delay, error, reference, own, is_command) -> DelayEstimate:
    identities = tuple(edge.name for edge, _ in own)
    determination = min(fit.determination for _, fit in own)
    refusal = ""
    if is_command:
        refusal = (
            f"it is a command: that the car {'precedes' if delay > 0 else 'follows'} it by {abs(delay):.3f} "
            f"+- {error:.3f} s is the actuator's doing and stays in the drive"
        )
    elif not is_sure(delay, error):
        refusal = f"the delay {delay:+.3f} s is uncertain by {error:.3f} s"
    found = 0.0 if refusal else float(delay)
    return DelayEstimate(channel, found, float(error), reference, identities, determination, refusal)


def _refused(fits, groups, done: set[str], vehicle, columns) -> list[DelayEstimate]:
    refused = []
    for channel in columns:
        if channel in done or channel in ("vx", "vy", "r", "Y") or groups[channel] in (groups.get("vx"),):
            continue
        tried = [(edge, fit) for edge, fit in fits if groups[channel] in (groups[edge.late],)]
        if tried:
            text = "; ".join(f"{edge.name}: {fit.refusal}" for edge, fit in tried if fit.refusal)
            found = next((fit.beyond for _, fit in tried if fit.beyond is not None), None)
            if found is not None:
                text += f". If the recording shows it too, pass --delay {channel}={found:.2f}"
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal=text or "not tied to v_x"))
        elif channel == "delta" and vehicle is None:
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal="that takes the vehicle"))
        elif channel == "T":
            reason = "no identity ties it to the motion: what it lags is the drive train's doing"
            refused.append(DelayEstimate(channel, 0.0, np.inf, _REFERENCE, refusal=reason))
    return refused
