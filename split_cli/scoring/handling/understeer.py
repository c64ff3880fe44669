"""The understeer gradient and the steering ratio that a recording shows, transients included."""

from dataclasses import dataclass

import numpy as np

from split_cli.logs.drive import Drive
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles

#: From rad/(m/s^2) to degrees a g, as handling engineers quote it.
DEG_PER_G = float(np.degrees(STANDARD_GRAVITY))
_LINEAR = 4.0  # [m/s^2]: ISO 4138 reads the gradient below 0.4 g, where tyres of road cars are linear
_OF_GRIP = 0.4  # the same as a share of what the tyres give, for cars with less grip
_MOST_BRAKING = 0.5  # of that limit: longitudinal force takes lateral stiffness
_LINEAR_SLIP = 0.15  # [rad]: beyond it no tyre is linear, whatever grip the vehicle file claims; judgement
_LEAST_SECONDS = 1.0
_FEWEST = 12
_LEAST_SPREAD = 0.1  # of that limit: rms of a_y below which a slope over it is noise
_BLOCK = 2.0  # [s]
_WINDOW = 0.4  # [s]: passes what a driver steers, up to some 2 Hz
_DRAWS = 300
_HALF = 1.959964


@dataclass(frozen=True)
class Understeer:
    """Understeer gradient and steering ratio of a recording.

    Attributes
    ----------
    gradient : float
        K [rad/(m/s^2)]; positive is understeer.
    interval : (float, float)
        95 %, bootstrap over blocks of 2 s.
    offset : float
        alpha_f - alpha_r on a straight [rad]: steering or side slip that is off.
    ratio : float
        Wheel angle recorded over the wheel angle that the yaw rate needs [1]; 1 for a right steering ratio.
    ratio_interval : (float, float)
        95 %; wide where the drive has one speed only, since ratio and gradient are then the same.
    lateral, slip_difference : ndarray, shape (N,)
        a_y [m/s^2], and alpha_f - alpha_r less the part that yaw acceleration makes [rad]: a steady car's.
    limit : float
        Largest a_y used [m/s^2].
    """

    gradient: float
    interval: tuple[float, float]
    offset: float
    ratio: float
    ratio_interval: tuple[float, float]
    lateral: np.ndarray
    slip_difference: np.ndarray
    limit: float


def understeer_of(drive: Drive, vehicle: Vehicle) -> Understeer | None:
    """Return the understeer gradient that a drive shows, None where it holds too little gentle cornering.

    None as well where an end of the interval would need more slip in gentle cornering than any tyre is linear in.
    The car then slides at what the vehicle file's grip calls gentle, or the drive leaves the slope open.

    Parameters
    ----------
    vehicle : Vehicle
        Only its geometry and, for the limit of the linear range, its grip are used.

    Notes
    -----
    With linear tyres, F_yf = (m a_y l_r + I_z r')/L and F_yr = (m a_y l_f - I_z r')/L, so
    alpha_f - alpha_r = K a_y + K_r r' holds in transients as well, with K as in `Vehicle.understeer_gradient` and
    K_r = I_z/L (1/C_f + 1/C_r). Both are found by least squares with an offset, K_r as a nuisance. A wrong v_y
    drops out of the difference to first order. The ratio comes from delta = c + q L r/v_x + K a_y + K_r r': over
    several speeds q and K part, since a_y = v_x r.
    """
    grip = vehicle.lateral_grip
    limit = min(_LINEAR, _OF_GRIP * grip)
    vx, vy, r, delta = (drive[name] for name in ("vx", "vy", "r", "delta"))
    with np.errstate(divide="ignore", invalid="ignore"):
        front, rear = slip_angles(vx, vy, r, delta, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle)
        kinematic = vehicle.wheelbase * r / vx
    # One filter for all: a relation that holds for signals holds for signals filtered alike.
    smooth = _Smooth(drive)
    a_y = smooth.rate(drive["vy"]) + smooth(drive["vx"] * drive["r"])
    along = smooth.rate(drive["vx"]) - smooth(drive["vy"] * drive["r"])
    yaw_rate_change = smooth.rate(drive["r"])
    front, rear, kinematic, steer_angle = (smooth(one) for one in (front, rear, kinematic, drive["delta"]))
    used = (np.abs(a_y) <= limit) & (np.abs(along) <= _MOST_BRAKING * limit)
    used &= (drive["vx"] > vehicle.minimum_speed) & np.isfinite(front - rear + a_y + yaw_rate_change + kinematic)
    fewest = max(_FEWEST, _LEAST_SECONDS / drive.period)
    if used.sum() < fewest or np.sqrt(np.mean(a_y[used] ** 2)) < _LEAST_SPREAD * limit:
        return None
    a_y, change, kinematic = a_y[used], yaw_rate_change[used], kinematic[used]
    difference = (front - rear)[used]
    block = np.floor(drive["t"][used] / _BLOCK)
    ones = np.ones(len(a_y))
    slope, interval = _regress(np.stack([a_y, ones, change], axis=1), difference, block)
    if max(map(abs, interval)) * limit > _LINEAR_SLIP:
        return None
    steer, ratios = _regress(np.stack([kinematic, a_y, ones, change], axis=1), steer_angle[used], block)
    steady = difference - slope[2] * change
    return Understeer(float(slope[0]), interval, float(slope[1]), float(steer[0]), ratios, a_y, steady, float(limit))


class _Smooth:
    """A Hann window of 0.4 s over each segment; NaN where it reaches over an end."""

    def __init__(self, drive: Drive) -> None:
        half = max(1, round(0.5 * _WINDOW / drive.period))
        window = np.hanning(2 * half + 3)[1:-1]
        self._drive, self._window, self._half = drive, window / window.sum(), half

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Return a smooth channel, shape (N,)."""
        out = np.full(len(values), np.nan)
        for run in self._drive.segments():
            if run.stop - run.start > 2 * self._half:
                inside = slice(run.start + self._half, run.stop - self._half)
                out[inside] = np.convolve(values[run], self._window, mode="valid")
        return out

    def rate(self, values: np.ndarray) -> np.ndarray:
        """Return the smooth rate of change of a channel, shape (N,): central differences of the smooth one."""
        smooth = self(values)
        out = np.full(len(values), np.nan)
        out[1:-1] = (smooth[2:] - smooth[:-2]) / (2.0 * self._drive.period)
        return out


def _regress(columns: np.ndarray, target: np.ndarray, block: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Return coefficients, and the 95 % interval of the first from a bootstrap over blocks of time."""
    _, number = np.unique(block, return_inverse=True)
    blocks, width = number.max() + 1, columns.shape[1]
    scale = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
    scaled = columns / scale
    gram = np.stack(
        [np.bincount(number, scaled[:, i] * scaled[:, j], blocks) for i in range(width) for j in range(width)], axis=1
    )
    right = np.stack([np.bincount(number, scaled[:, i] * target, blocks) for i in range(width)], axis=1)
    rng = np.random.default_rng(20240501)
    drawn = rng.multinomial(blocks, np.full(blocks, 1.0 / blocks), _DRAWS).astype(float)

    def solve(weights: np.ndarray) -> np.ndarray:
        matrix = (weights @ gram).reshape(width, width)
        solution: np.ndarray = np.linalg.lstsq(matrix, weights @ right, rcond=1e-10)[0] / scale
        return solution

    best = solve(np.ones(blocks))
    spread = float(np.std([solve(weights)[0] for weights in drawn])) * np.sqrt(blocks / max(blocks - 1, 1))
    return best, (float(best[0] - _HALF * spread), float(best[0] + _HALF * spread))
