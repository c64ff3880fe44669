"""From recorded motion to samples of axle force against slip angle."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from split_cli.errors import VehicleError
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles

_BLOCK_SECONDS = 5.0  # of a block of time


@dataclass(frozen=True)
class MotionRun:
    """A stretch of a drive without a gap."""

    period: float  # sample period [s]
    # vx, vy, r: (N,): velocities at the CG [m/s], [m/s], [rad/s].
    vx: np.ndarray
    vy: np.ndarray
    r: np.ndarray
    # T, delta: (N,): total wheel torque [N m] and road-wheel angle [rad].
    T: np.ndarray
    delta: np.ndarray
    # (N,): measured lateral specific force [m/s^2] where it is to be used; None takes v_y' + v_x r.
    ay: np.ndarray | None = None
    silent: frozenset[str] = frozenset()  # of `calibrate.PARTS`: of which the drive says nothing


@dataclass(frozen=True)
class MotionSamples:
    """Smoothed motion, thinned to one sample in two smoothing widths, with blocks of time; every array `(M,)`."""

    # vx, vy, r: velocities at the CG [m/s], [m/s], [rad/s].
    vx: np.ndarray
    vy: np.ndarray
    r: np.ndarray
    # T, delta: torque [N m], road-wheel angle [rad].
    T: np.ndarray
    delta: np.ndarray
    # ax, ay: v_x' - v_y r and v_y' + v_x r (or the measured one) [m/s^2].
    ax: np.ndarray
    ay: np.ndarray
    yaw_acceleration: np.ndarray  # r' [rad/s^2]
    # slip_front, slip_rear: slip angles [rad].
    slip_front: np.ndarray
    slip_rear: np.ndarray
    # slip_noise_front, slip_noise_rear: standard deviation of what sensor noise leaves in them after smoothing
    # [rad].
    slip_noise_front: np.ndarray
    slip_noise_rear: np.ndarray
    yaw_acceleration_noise: np.ndarray  # the same of r' [rad/s^2]
    block: np.ndarray  # block of time; blocks are what is held out and resampled

    def __len__(self) -> int:
        return len(self.vx)

    def where(self, keep: np.ndarray) -> MotionSamples:
        """Return the samples for which `keep` is true."""
        return MotionSamples(**{field.name: getattr(self, field.name)[keep] for field in fields(self)})


def motion_samples(runs: Sequence[MotionRun], vehicle: Vehicle, *, smoothing: float | None = None) -> MotionSamples:
    """Smooth and differentiate recorded motion.

    Parameters
    ----------
    vehicle : Vehicle
        Gives the axles' distances.
    smoothing : float, optional
        Standard deviation of the Gaussian kernel [s]; by default 0.05 sqrt(wheelbase/2.7), since small cars
        respond faster, and at least 1.5 sample periods.

    Raises
    ------
    VehicleError
        If no run is longer than the kernel.

    Notes
    -----
    Every signal is convolved with one kernel g, and derivatives with g', so that both sides of an equation of
    motion are averaged over the same time and keep their balance (the weak form of the equation).
    """
    parts, blocks, next_block = [], [], 0
    natural = 0.05 * float(np.sqrt(vehicle.wheelbase / 2.7))
    for run in runs:
        width = max(natural, 1.5 * run.period) if smoothing is None else smoothing
        part = _smoothed(run, vehicle, width)
        if part is None:
            continue
        columns, step = part
        count = len(columns["vx"])
        blocks.append(next_block + (np.arange(count) * step / _BLOCK_SECONDS).astype(int))
        next_block = int(blocks[-1][-1]) + 1
        parts.append(columns)
    if not parts:
        what = "no stretch of the drives without a gap is long enough to take derivatives"
        raise VehicleError(what, advice="Record longer or smooth less.")
    columns = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return MotionSamples(**columns, block=np.concatenate(blocks))


def _smoothed(run: MotionRun, vehicle: Vehicle, smoothing: float) -> tuple[dict[str, np.ndarray], float] | None:
    half = max(1, int(np.ceil(min(4.0 * smoothing / run.period, len(run.vx)))))
    if len(run.vx) < 2 * half + 2:
        return None
    offsets = np.arange(-half, half + 1) * run.period
    kernel = np.exp(-0.5 * (offsets / smoothing) ** 2)
    kernel /= kernel.sum()
    # Normalised so that the slope of a straight line is exact; np.convolve flips the kernel.
    slope = offsets * kernel
    slope = -slope / (slope @ offsets)
    # Closer samples would tell next to nothing: their kernels overlap by more than a third.
    stride = max(1, round(2.0 * smoothing / run.period))

    def mean(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, kernel, mode="valid")[::stride]

    def rate(values: np.ndarray) -> np.ndarray:
        return np.convolve(values, slope, mode="valid")[::stride]

    vx, vy, r, delta = mean(run.vx), mean(run.vy), mean(run.r), mean(run.delta)
    slip_front, slip_rear = slip_angles(vx, vy, r, delta, vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle)
    gain = float(np.sqrt(kernel @ kernel))
    raw_vy, raw_r = (_noise_level(values, run.period) for values in (run.vy, run.r))
    noise_vy, noise_r = gain * raw_vy, gain * raw_r
    columns = {
        "vx": vx,
        "vy": vy,
        "r": r,
        "T": mean(run.T),
        "delta": delta,
        "ax": rate(run.vx) - mean(run.vy * run.r),
        "ay": rate(run.vy) + mean(run.vx * run.r) if run.ay is None else mean(run.ay),
        "yaw_acceleration": rate(run.r),
        "slip_front": slip_front,
        "slip_rear": slip_rear,
        "slip_noise_front": np.hypot(noise_vy, vehicle.cg_to_front_axle * noise_r) / np.abs(vx),
        "slip_noise_rear": np.hypot(noise_vy, vehicle.cg_to_rear_axle * noise_r) / np.abs(vx),
        "yaw_acceleration_noise": np.full_like(vx, raw_r * np.sqrt(slope @ slope)),
    }
    return columns, stride * run.period


def _noise_level(values: np.ndarray, period: float) -> float:
    """Return the standard deviation of a sample's noise, from third differences about 20 ms apart.

    White noise of deviation s gives third differences of deviation sqrt(20) s, motion below some 3 Hz next to
    nothing. Neighbouring samples are not used, since a drive's low-pass makes them alike.
    """
    lag = max(1, round(0.02 / period))
    third = values[3 * lag :] - 3.0 * values[2 * lag : -lag] + 3.0 * values[lag : -2 * lag] - values[: -3 * lag]
    return float(np.median(np.abs(third)) / 0.674489750196 / np.sqrt(20.0))


def axle_lateral_forces(samples: MotionSamples, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return the lateral tyre forces F_fy and F_ry [N] that the motion demands, each shape (M,).

    Notes
    -----
    Lateral and yaw balance of the nominal model solved for the forces: with P_f = F_fy cos delta + F_fx sin delta,
    P_f = (m a_y l_r + I_z r')/L and F_ry = (m a_y l_f - I_z r')/L; F_fx is the nominal one.
    """
    m, i_z = vehicle.mass, vehicle.yaw_inertia
    across_front = (m * samples.ay * vehicle.cg_to_rear_axle + i_z * samples.yaw_acceleration) / vehicle.wheelbase
    rear = (m * samples.ay * vehicle.cg_to_front_axle - i_z * samples.yaw_acceleration) / vehicle.wheelbase
    along_front = front_longitudinal_force(samples, vehicle)
    front = (across_front - along_front * np.sin(samples.delta)) / np.cos(samples.delta)
    return front, rear


def front_longitudinal_force(samples: MotionSamples, vehicle: Vehicle) -> np.ndarray:
    """Return the nominal F_fx = kappa T/r_e - C_fr [N], shape (M,)."""
    share = np.where(samples.T < 0.0, vehicle.brake_split_front, vehicle.drive_split_front)
    force: np.ndarray = share * samples.T / vehicle.wheel_radius - vehicle.rolling_resistance_front
    return force
