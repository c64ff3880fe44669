"""Lateral velocity of a car that records none: accelerations integrated, held where the car drives gently.

v_y' = a_y - v_x r drifts with whatever a_y reads too much: its bias, the road's bank, the body's roll. Where the
car hardly turns its rear axle rolls where it points, and v_y is known without it. A smoother weighs both.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.checking.kinematics import Kinematics
from split_cli.vehicle.parameters import Vehicle

TOLERANCE = 0.02
"""Of the direction of the velocity [rad], one standard deviation: the edge of a slip angle's cell. A sample
that is less sure would teach another cell."""
_MOST_CONTRADICTED = 0.1
"""Share of the moments of gentle driving that a_y may contradict [1]; chance does so in one of 16,000."""
_STEP = 0.1
"""Between two nodes of the smoother [s]: what it estimates is slow, what is fast is integrated at full rate."""
_GENTLE = 1.0 / 3.0
"""Of the tyres' grip, up to which the rear axle's slip is proportional to its lateral acceleration [1]."""
_DIRECTION = 2e-3
"""Standard deviation of the direction of travel on a straight [rad]: crossfall of 2.5 % tilts it by as much."""
_CURVED = 2e-3
"""How far a rear axle departs from proportional slip [rad/(m/s^2)]: a third of what it slips."""
TOGETHER = 2.0
"""Over which the two before, and so the derived v_y, keep one error [s]: the length of a turn."""
_SLIP = 6e-3, 4e-3
"""Slip of a rear axle for its lateral acceleration, mean and deviation [rad/(m/s^2)]: 1 to 6 degrees a g."""
_BIAS = 1.0
"""Of a_y when a drive begins [m/s^2]: a bias and a tilt of a tenth of g."""
_BIAS_WALK = 0.05
"""Its change over a second [m/s^2]; over 25 s it is the crossfall of a road, 2.5 % of g."""
_WALK = 0.05
"""What vibration and timing leave in the integral over a second [m/s]."""
_ROLL = 0.1
"""Share of v_x r that a_y and v_x r differ by [1]: gravity in a_y by 6 degrees of roll a g; scale of the gyro."""
_UNKNOWN = 0.2
"""Direction of the velocity when a segment begins [rad]."""
_FARTHEST = 4.0
"""Standard deviations beyond which a car that seems to drive gently is taken to slide [1]."""


@dataclass(frozen=True)
class LateralVelocity:
    """A lateral velocity from accelerations, and how sure it is."""

    # vy, std: (N,): at the CG [m/s], and its standard deviation.
    vy: np.ndarray
    std: np.ndarray
    # Least and greatest of what a_y read too much [m/s^2]: bias of the sensor and bank of the road.
    bias: tuple[float, float]
    gain: float  # of v_x r against a_y, less 1 [1]: roll of the body, scale of the gyro
    slip: float  # of the rear axle for its lateral acceleration [rad/(m/s^2)]
    gentle: float  # share of the time where the car drives gently [1]
    longest: float  # time between two such moments [s]
    # Share of these moments that a_y contradicts by more than four standard deviations [1]; they are not used.
    contradicted: float

    @property
    def belongs(self) -> bool:
        """Whether a_y belongs to v_x r as a car's does: few contradictions, a share that roll can make."""
        return self.contradicted <= _MOST_CONTRADICTED and abs(self.gain) <= 3.0 * _ROLL

    @property
    def doubt(self) -> str:
        """What a_y does that no car's does; of moments that are not used, the share says nothing."""
        if self.contradicted > _MOST_CONTRADICTED:
            return f"contradicts v_x r at {100.0 * self.contradicted:.0f} % of the moments of gentle driving"
        return f"fits {1.0 + self.gain:.2f} times v_x r, and no roll of a car's body makes that"

    def words(self) -> str:
        """Return what was estimated beside it."""
        low, high = self.bias
        return (
            f"a_y less {low:+.2f} to {high:+.2f} m/s^2, v_x r times {1.0 + self.gain:.3f}, rear slip "
            f"{1e3 * self.slip:.1f} mrad for 1 m/s^2, up to {self.longest:.0f} s without gentle driving"
        )


def lateral_velocity_from_accelerations(
    columns: Mapping[str, np.ndarray], period: float, segments: Sequence[slice], vehicle: Vehicle
) -> LateralVelocity | None:
    """Return v_y from v_x, r and a_y; None where the car never drives gently.

    Parameters
    ----------
    columns : mapping of str to ndarray
        ``vx`` [m/s], ``r`` [rad/s] and ``ay`` [m/s^2] at the CG, finite, shape (N,).
    period : float
        [s].
    vehicle : Vehicle
        Its place of the rear axle, and its grip, which says what is gentle. Its stiffness is not used.

    Notes
    -----
    v_y = c + e, c the integral of a_y - v_x r. The error e obeys e' = -b - g v_x r + noise, b the bias of a_y (a
    random walk, started anew in each segment), g a constant share. In gentle driving v_y = l_r r - |v_x| s a_r,
    a_r = v_x r - l_r r' the lateral acceleration of the rear axle and s its slip for it, a constant that is
    estimated too. A Rauch-Tung-Striebel smoother over nodes 0.1 s apart gives e and its variance. What follows
    r or v_x r in step stays hidden: 10 ms between the clocks of a_y and r, or an accelerometer away from where
    the map has it. Of the drive's ends, only one side is held.

    References
    ----------
    H. E. Rauch, F. Tung, C. T. Striebel, Maximum likelihood estimates of linear dynamic systems, AIAA Journal 3
    (1965); the kinematic observer of v_y is that of J. Farrelly, P. Wellstead, Estimation of vehicle lateral
    velocity, IEEE CCA (1996).
    """
    reckoned, turned = np.empty(len(columns["vx"])), np.empty(len(columns["vx"]))
    for run in segments:
        across = columns["vx"][run] * columns["r"][run]
        reckoned[run] = _integral(columns["ay"][run] - across, period)
        turned[run] = _integral(across, period)
    rows, fresh = _nodes(segments, max(1, round(_STEP / period)))
    gentle, rear = _gentle(columns, period, segments, vehicle)
    held = gentle[rows]
    if not held.any():
        return None
    speed = np.abs(columns["vx"][rows])
    observed = vehicle.cg_to_rear_axle * columns["r"][rows] - reckoned[rows]
    variance = np.maximum(speed, 0.1 * vehicle.minimum_speed) ** 2 * (_DIRECTION**2 + (_CURVED * rear[rows]) ** 2)
    step = np.diff(rows, prepend=rows[0]) * period
    unknown = (_UNKNOWN * np.maximum(speed, vehicle.minimum_speed)) ** 2
    mean, deviation, contradicted = _smoother(
        step,
        np.diff(turned[rows], prepend=0.0),
        fresh,
        unknown,
        held,
        observed,
        speed * rear[rows],
        variance * TOGETHER / np.maximum(step, _STEP),
    )
    vy, std = np.empty_like(reckoned), np.empty_like(reckoned)
    bounds = [*np.flatnonzero(fresh), len(rows)]
    for run, first, end in zip(segments, bounds[:-1], bounds[1:], strict=True):
        every = np.arange(run.start, run.stop)
        vy[run] = reckoned[run] + np.interp(every, rows[first:end], mean[first:end, 0])
        std[run] = np.interp(every, rows[first:end], deviation[first:end])
    bias = float(mean[:, 1].min()), float(mean[:, 1].max())
    longest = max(_longest(rows[first:end], held[first:end]) for first, end in zip(bounds, bounds[1:], strict=False))
    return LateralVelocity(
        vy, std, bias, float(mean[-1, 2]), float(mean[-1, 3]), float(np.mean(gentle)), longest * period, contradicted
    )


def _integral(values: np.ndarray, period: float) -> np.ndarray:
    """Return the integral from the first sample on by trapezoids, shape (N,)."""
    return np.concatenate([[0.0], np.cumsum(0.5 * (values[1:] + values[:-1]))]) * period


def _nodes(segments: Sequence[slice], stride: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the rows of the smoother's nodes, each segment's last among them, and which begin a segment."""
    rows = [np.unique(np.append(np.arange(s.start, s.stop, stride), s.stop - 1)) for s in segments]
    fresh = np.concatenate([np.arange(len(part)) == 0 for part in rows])
    return np.concatenate(rows), fresh


def _gentle(
    columns: Mapping[str, np.ndarray], period: float, segments: Sequence[slice], vehicle: Vehicle
) -> tuple[np.ndarray, np.ndarray]:
    """Return where the car drives gently, and the lateral acceleration of its rear axle [m/s^2], shapes (N,)."""
    k = Kinematics(columns, period, list(segments))
    across = k.signal("vx") * k.signal("r")
    swing = vehicle.cg_to_rear_axle * k.rate("r")
    limit = _GENTLE * vehicle.lateral_grip
    gentle = (np.abs(across) < limit) & (np.abs(swing) < limit)
    return gentle, np.where(gentle, across - swing, 0.0)


def _smoother(
    step: np.ndarray,
    turned: np.ndarray,
    fresh: np.ndarray,
    unknown: np.ndarray,
    held: np.ndarray,
    observed: np.ndarray,
    slipping: np.ndarray,
    variance: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, float]:
    """Return mean (K, 4) of e, b, g, s, the standard deviation (K,) of e, and what share is measured and unused.

    Parameters
    ----------
    step, turned : ndarray, shape (K,)
        Time [s] and integral of v_x r [m/s] since the node before.
    fresh : ndarray of bool, shape (K,)
        Where a segment begins.
    unknown : ndarray, shape (K,)
        Variance of e where one begins [m^2/s^2].
    held : ndarray of bool, shape (K,)
    observed, slipping, variance : ndarray, shape (K,)
        There e + slipping s = observed, with this variance.
    """
    count, unused = len(step), 0
    before, spread_before = np.empty((count, 4)), np.empty((count, 4, 4))
    after, spread_after = np.empty((count, 4)), np.empty((count, 4, 4))
    x, P = np.array([0.0, 0.0, 0.0, _SLIP[0]]), np.diag([0.0, 0.0, _ROLL**2, _SLIP[1] ** 2])
    for node in range(count):
        F = _transition(step[node], turned[node], fresh[node])
        x, P = F @ x, F @ P @ F.T
        if fresh[node]:
            P[0, 0], P[1, 1] = unknown[node], _BIAS**2
        else:
            h = step[node]
            P[0, 0] += _WALK**2 * h + _BIAS_WALK**2 * h**3 / 3.0
            P[0, 1] -= _BIAS_WALK**2 * h * h / 2.0
            P[1, 0] = P[0, 1]
            P[1, 1] += _BIAS_WALK**2 * h
        before[node], spread_before[node] = x, P
        if held[node]:
            H = np.array([1.0, 0.0, 0.0, slipping[node]])
            PH = P @ H
            innovation, width = observed[node] - H @ x, H @ PH + variance[node]
            if innovation**2 < _FARTHEST**2 * width:
                x, P = x + PH * (innovation / width), P - np.outer(PH, PH) / width
            else:
                unused += 1
        after[node], spread_after[node] = x, P
    deviation = np.empty(count)
    deviation[-1] = np.sqrt(P[0, 0])
    for node in range(count - 1, 0, -1):
        F = _transition(step[node], turned[node], fresh[node])
        gain = np.linalg.solve(spread_before[node], F @ spread_after[node - 1]).T
        x = after[node - 1] + gain @ (x - before[node])
        P = spread_after[node - 1] + gain @ (P - spread_before[node]) @ gain.T
        after[node - 1] = x
        deviation[node - 1] = np.sqrt(max(P[0, 0], 0.0))
    return after, deviation, unused / max(int(held.sum()), 1)


def _transition(step: float, turned: float, fresh: bool) -> np.ndarray:
    """Return how e, b, g, s go from one node to the next; e and b of a new segment begin anew."""
    F = np.eye(4)
    if fresh:
        F[0, 0] = F[1, 1] = 0.0
    else:
        F[0, 1], F[0, 2] = -step, -turned
    return F


def _longest(rows: np.ndarray, held: np.ndarray) -> float:
    """Return the most rows between two nodes where v_y is held, or between one and an end."""
    return float(np.max(np.diff(np.concatenate([rows[:1], rows[held], rows[-1:]]))))
