"""Smoothed signals and their derivatives on a drive's clock, for the checks and the delay estimate."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.scratch import set_aside

_BLOCKS = 10
_MOST_SAMPLES = 50_000
_WIDER = 2.5
"""Times the usual smoothing, that is tried against the noise of a position [1]; judgement."""

SETTLING = 1.0
"""After the last change of an input, in which the car still follows it [s]; judgement: a road car takes half of it."""


@dataclass(frozen=True)
class Slope:
    """How one signal follows another."""

    # slope, error: of y over x, signed ratio of their deviations, and its standard error from blocks of time.
    slope: float
    error: float
    correlation: float
    count: int  # samples used


class Kinematics:
    """The channels of a drive, smoothed alike, with time derivatives; NaN near the ends of segments.

    Parameters
    ----------
    columns : mapping of str to ndarray
        Drive columns, SI.
    period : float
        [s].
    width : float
        Standard deviation of the Gaussian that smooths every signal [s]. All signals of a relation get the same,
        so that it holds among smoothed signals as it does among true ones.
    """

    WIDTH = 0.2
    """The usual width [s]: short beside a turn of the wheel, long beside the step of a fix at 10 Hz."""

    def __init__(
        self, columns: Mapping[str, np.ndarray], period: float, segments: list[slice], width: float = WIDTH
    ) -> None:
        self.columns = columns
        self.period = period
        self.segments = segments
        self.width = max(width, 1.5 * period)
        self._known: dict[tuple[str, int], np.ndarray] = {}
        self.count = len(next(iter(columns.values())))
        speed = np.abs(columns["vx"]) if "vx" in columns else np.zeros(self.count)
        fast = float(np.nanquantile(speed, 0.95)) if self.count else 0.0
        self.moving = speed > max(0.2 * fast, 0.2)

    def __contains__(self, channel: str) -> bool:
        return channel in self.columns

    def times(self) -> np.ndarray:
        """Return the time of every row [s], shape (N,): as recorded, else counted from 0."""
        return self.columns["t"] if "t" in self.columns else np.arange(self.count) * self.period

    def signal(self, channel: str) -> np.ndarray:
        """Return the smoothed channel, shape (N,)."""
        return self._filtered(channel, self.columns[channel], 0)

    def rate(self, channel: str) -> np.ndarray:
        """Return the derivative of the smoothed channel, shape (N,)."""
        return self._filtered(channel, self.columns[channel], 1)

    def of(self, name: str, values: Callable[[], np.ndarray], order: int = 0) -> np.ndarray:
        """Return a smoothed expression (or its derivative) of raw columns, remembered by `name`."""
        key = (name, order)
        return self._known[key] if key in self._known else self._filtered(name, values(), order)

    def turning(self) -> np.ndarray:
        """Return v_x r, what turning takes across the car [m/s^2], shape (N,)."""
        return self.of("vx r", lambda: self.columns["vx"] * self.columns["r"])

    def ground_speed(self) -> np.ndarray:
        """Return the speed of X, Y over ground [m/s], shape (N,).

        Notes
        -----
        Smoothing draws a circle of X, Y in by exp(-(course rate x width)^2/2), which is given back: at a steady
        speed, a speed that falls in every corner would pass for a scale.
        """
        turned = np.nan_to_num(self.course_rate() * self.width)
        return np.hypot(self.rate("X"), self.rate("Y")) * np.exp(0.5 * np.minimum(turned**2, 1.0))

    def course_rate(self) -> np.ndarray:
        """Return the rate of the direction of travel of X, Y [rad/s], shape (N,); NaN where nearly at rest."""
        dX, dY = self.rate("X"), self.rate("Y")
        ddX = self._filtered("X", self.columns["X"], 2)
        ddY = self._filtered("Y", self.columns["Y"], 2)
        squared = dX * dX + dY * dY
        fast = np.nanquantile(squared, 0.95) if np.isfinite(squared).any() else 0.0
        return np.where(squared > 0.04 * fast, _turning(dX, dY, ddX, ddY), np.nan)

    def course_rates(self) -> list[np.ndarray]:
        """Return the same, and where yaw is known less what `travel_from_yaw` takes off, which a wrong yaw spoils."""
        plain = self.course_rate()
        if not self._knows_yaw():
            return [plain]
        (x, y), (dx, dy) = self._along_yaw(0), self._along_yaw(1)
        off = _turning(x, y, dx, dy) - self.rate("yaw")
        known = np.isfinite(plain) & np.isfinite(off)  # at rest no direction is known, and its rate is any
        # It is less than the turning itself, but of a yaw in a wrong unit.
        return [plain, plain - off] if known.any() and np.std(off[known]) < np.std(plain[known]) else [plain]

    def _knows_yaw(self) -> bool:
        return "yaw" in self.columns and "vx" in self.columns

    def _along_yaw(self, order: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the smoothed velocity [m/s] in X, Y of a car that travels along its yaw, or its derivative."""
        speed, yaw = np.abs(self.columns["vx"]), self.columns["yaw"]
        ahead = self.of("speed along yaw in X", lambda: speed * np.cos(yaw), order)
        return ahead, self.of("speed along yaw in Y", lambda: speed * np.sin(yaw), order)

    def sideslip(self) -> np.ndarray:
        """Return v_y/v_x [1], shape (N,); NaN where nearly at rest."""
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(self.moving, self.signal("vy") / self.signal("vx"), np.nan)

    def travel_from_yaw(self) -> np.ndarray:
        """Return the angle from yaw to the travel of X, Y [rad], not wrapped, shape (N,); NaN nearly at rest.

        Notes
        -----
        Smoothing weighs directions of travel by speed, and yaw alike at all speeds. Where speed and direction change
        together, travel is ahead of yaw by about width^2 (v_x'/v_x) r. A car that travels along its yaw shows the
        same, and that is taken off: of a model car it is as large as its sideslip.
        """
        yaw = self.signal("yaw")
        angle = np.arctan2(self.rate("Y"), self.rate("X")) - yaw
        if self._knows_yaw():
            x, y = self._along_yaw(0)
            angle = angle - np.angle(np.exp(1j * (np.arctan2(y, x) - yaw)))
        return np.where(self.moving, angle, np.nan)

    def path_across(self) -> np.ndarray:
        """Return the same, its mean taken off and wrapped [rad], shape (N,)."""
        return around_mean(self.travel_from_yaw())[1]

    def _filtered(self, name: str, values: np.ndarray, order: int) -> np.ndarray:
        key = (name, order)
        if key not in self._known:
            from scipy.ndimage import gaussian_filter1d

            sigma = self.width / self.period
            margin = int(np.ceil(3.0 * sigma))
            result = np.full(len(values), np.nan)
            for run in self.segments:
                part = values[run]
                if len(part) <= 2 * margin + 2:
                    continue
                missing = ~np.isfinite(part)
                filled = np.where(missing, 0.0, part)
                smooth = gaussian_filter1d(filled, sigma, truncate=4.0)
                # Differences of the smoothed signal, not a differentiated kernel: one that is cut off does not sum
                # to zero, and reads a position far from the origin as motion.
                for _ in range(order):
                    smooth = np.gradient(smooth, self.period)
                if missing.any():
                    smooth[np.convolve(missing, np.ones(2 * margin + 1), "same") > 0] = np.nan
                smooth[:margin] = np.nan
                smooth[-margin:] = np.nan
                result[run] = smooth
            result.flags.writeable = False  # as what is set aside is
            self._known[key] = set_aside(result)
        return self._known[key]


def _turning(x: np.ndarray, y: np.ndarray, dx: np.ndarray, dy: np.ndarray) -> np.ndarray:
    """Return the rate of the direction of (x, y) [rad/s], whose derivative is (dx, dy)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        return (x * dy - y * dx) / (x * x + y * y)


def beside_path(k: Kinematics, channel: str, order: int) -> tuple[np.ndarray, np.ndarray]:
    """Return a channel, or its rate, and the turning of X, Y, smoothed so that they go together best.

    A second derivative makes much of the noise of a position, which counts as turning: of a particle filter's, r
    was 0.84 times it over 0.2 s, and 0.97 times over 0.5 s.

    Parameters
    ----------
    order : int
        0 for the channel, 1 for its rate.
    """
    options = []
    for smoothed in (k, Kinematics(k.columns, k.period, k.segments, _WIDER * k.width)):
        own = smoothed.rate(channel) if order else smoothed.signal(channel)
        for turning in smoothed.course_rates():
            slope = fit_slope(own, turning, k.moving)
            options.append((-1.0 if slope is None else abs(slope.correlation), (own, turning)))
    return max(options, key=lambda option: option[0])[1]


def around_mean(angle: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the mean direction of angles [rad], 0 where none is finite, and each angle from there, wrapped."""
    known = angle[np.isfinite(angle)]
    centre = float(np.angle(np.mean(np.exp(1j * known)))) if len(known) else 0.0
    return centre, np.angle(np.exp(1j * (angle - centre)))


def fit_slope(y: np.ndarray, x: np.ndarray, mask: np.ndarray, *, zeroed: bool = False) -> Slope | None:
    """Fit y = slope x + offset where both are noisy; None when there are fewer than 50 samples or x stands still.

    Two speeds are 0 together, `zeroed`: then the offset is 0, and a steady speed tells the scale as well.

    Notes
    -----
    The slope is the ratio of the deviations with the correlation's sign, which noise in either signal biases by
    no more than 1/correlation. Samples further than six robust deviations off are left out.
    """
    use = mask & np.isfinite(y) & np.isfinite(x)
    if np.count_nonzero(use) < 50:
        return None
    # The signals are smoothed over many rows: more samples than this tell nothing more.
    stride = max(1, np.count_nonzero(use) // _MOST_SAMPLES)
    y, x = y[use][::stride], x[use][::stride]
    bounds = [np.quantile(values, [0.005, 0.995]) for values in (y, x)]
    if np.std(x) <= 1e-12 * (1.0 + np.max(np.abs(x))) or np.std(y) <= 1e-12 * (1.0 + np.max(np.abs(y))):
        return None
    for attempt in range(2):
        # The first line is drawn through clipped samples: a few wild ones must not lay the band that judges them.
        tame_y, tame_x = [np.clip(v, *b) for v, b in zip((y, x), bounds, strict=True)] if attempt == 0 else (y, x)
        slope, _ = _line(tame_y, tame_x, zeroed)
        offset = 0.0 if zeroed else float(np.median(tame_y - slope * tame_x))
        residual = y - slope * x - offset
        near = np.abs(residual) <= max(6.0 * robust_spread(residual), 1e-12)
        if np.count_nonzero(near) < 50 or np.std(x[near]) == 0.0 or np.std(y[near]) == 0.0:
            break
        y, x = y[near], x[near]
    slope, correlation = _line(y, x, zeroed)
    return Slope(slope, _error_of_slope(y, x, zeroed), correlation, len(y))


def _line(y: np.ndarray, x: np.ndarray, zeroed: bool) -> tuple[float, float]:
    """Return the slope of y over x as `fit_slope` takes it, and their correlation."""
    dx, dy = x - x.mean(), y - y.mean()
    sx, sy = float(np.sqrt(np.mean(dx * dx))), float(np.sqrt(np.mean(dy * dy)))
    correlation = float(np.mean(dx * dy)) / (sx * sy) if sx > 0 and sy > 0 else 0.0
    if zeroed:
        sx, sy = float(np.sqrt(np.mean(x * x))), float(np.sqrt(np.mean(y * y)))
    return float(np.copysign(sy / sx, correlation)) if sx > 0 else 0.0, correlation


def _error_of_slope(y: np.ndarray, x: np.ndarray, zeroed: bool) -> float:
    """Return the standard error of the slope, as `block_interval` of `_line` does, from sums over the blocks."""
    dx, dy = x - x.mean(), y - y.mean()
    begins = [block[0] for block in np.array_split(np.arange(len(y)), _BLOCKS)]
    products = (np.ones(len(y)), dx, dy, dx * dx, dy * dy, dx * dy, x * x, y * y)
    sums = np.add.reduceat(np.stack(products), begins, axis=1)
    count, *kept = sums.sum(axis=1, keepdims=True) - sums
    sx, sy, xx, yy, xy, whole_x, whole_y = (part / count for part in kept)
    along, across = (whole_x, whole_y) if zeroed else (xx - sx * sx, yy - sy * sy)
    ratio = np.divide(across, along, out=np.zeros_like(along), where=along > 0.0)
    slopes = np.copysign(np.sqrt(np.maximum(ratio, 0.0)), xy - sx * sy)
    return float(np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum((slopes - slopes.mean()) ** 2)))


def block_interval(estimate: Callable[[np.ndarray], np.ndarray], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Return an estimate over all rows and its standard error, leaving out a tenth of the time at a time.

    Blocks, since neighbouring samples say the same thing: errors that took samples as independent would be many
    times too small.
    """
    rows = np.arange(count)
    full = np.asarray(estimate(rows))
    left_out = np.stack([estimate(np.delete(rows, block)) for block in np.array_split(rows, _BLOCKS)])
    spread = left_out - left_out.mean(axis=0)
    return full, np.sqrt((_BLOCKS - 1) / _BLOCKS * np.sum(spread**2, axis=0))


def fit_linear(design: np.ndarray, y: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the least-squares coefficients of y (N,) over a design (N, P), and their errors as `block_interval`.

    Each block of rows is reduced once to the triangle R of its QR decomposition, which keeps norms of residuals.
    """
    blocks = [slice(rows[0], rows[-1] + 1) for rows in np.array_split(np.arange(len(y)), _BLOCKS) if len(rows)]
    triangles = [np.linalg.qr(np.column_stack([design[rows], y[rows]]), mode="r") for rows in blocks]

    def estimate(kept: np.ndarray) -> np.ndarray:
        rows = np.concatenate([triangles[block] for block in kept])
        return np.linalg.lstsq(rows[:, :-1], rows[:, -1], rcond=None)[0]

    return block_interval(estimate, len(triangles))


def has_dependent_columns(design: np.ndarray) -> bool:
    """Tell a design (N, P) whose columns, whatever their units, do not determine P coefficients."""
    scaled = design / np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    return bool(np.linalg.matrix_rank(scaled) < design.shape[1])


def robust_spread(values: np.ndarray) -> float:
    """Return the deviation of a normal law that has the median absolute deviation of finite values, shape (N,)."""
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def scaled_parts(
    y: np.ndarray, parts: Sequence[np.ndarray], factors: Callable[[float, float], tuple[float, ...]], mask: np.ndarray
) -> Callable[[float, float], float]:
    """Return the ratio of y to the sum of `parts` as a function of the factors in v_x and r that are corrected.

    The ratio of deviations with the correlation's sign, as `fit_slope` measures it, from the covariance of y and
    the parts: each part scales by its own power of v_x and r.
    """
    use = mask & np.isfinite(y) & np.all([np.isfinite(part) for part in parts], axis=0)
    if np.count_nonzero(use) < 50:
        return lambda vx, r: float("nan")
    rows = np.stack([y[use], *(part[use] for part in parts)])
    rows = np.clip(rows, *(np.quantile(rows, q, axis=1, keepdims=True) for q in (0.005, 0.995)))
    covariance = np.cov(rows)

    def ratio(vx: float, r: float) -> float:
        weights = np.array(factors(vx, r))
        variance = float(weights @ covariance[1:, 1:] @ weights)
        if variance <= 0.0:
            return float("nan")
        return float(np.copysign(np.sqrt(covariance[0, 0] / variance), covariance[0, 1:] @ weights))

    return ratio


def still_runs(values: np.ndarray, segments: Sequence[slice], period: float) -> list[slice]:
    """Return the stretches of at least twice the settling time over which values (N,) are exactly one."""
    same = np.zeros(len(values), dtype=bool)
    for run in segments:
        # A filter of a constant leaves rounding.
        same[run][1:] = np.abs(np.diff(values[run])) <= 1e-12 * np.abs(values[run][1:])
    edges = np.flatnonzero(np.diff(same, prepend=False, append=False)).reshape(-1, 2)
    return [slice(a - 1, b) for a, b in edges.tolist() if (b - a) * period >= 2.0 * SETTLING]


def median_of(values: np.ndarray) -> tuple[float, float]:
    """Return the median of finite values, and its standard error from blocks of time."""
    values = values[np.isfinite(values)]
    median, error = block_interval(lambda rows: np.array([np.median(values[rows])]), len(values))
    return float(median[0]), float(error[0])
