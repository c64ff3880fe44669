"""Drag and rolling resistance from the longitudinal balance."""

from dataclasses import dataclass

import numpy as np

from split_cli.errors import VehicleError
from split_cli.vehicle.calibration.curve import HeldOutError
from split_cli.vehicle.calibration.least_squares import LeastSquaresFit, solve
from split_cli.vehicle.calibration.samples import MotionSamples, front_longitudinal_force
from split_cli.vehicle.parameters import Vehicle

_FOLDS = 5
_MINIMUM_BLOCKS = 6


@dataclass(frozen=True)
class Resistance:
    """What drives say about the force against straight travel."""

    drag: float  # C_w [N/(m/s)^2]
    rolling: float  # C_fr + C_rr [N]
    determined: tuple[str, ...]  # which of ``drag``, ``rolling`` the data settle
    # drag_error, rolling_error: half widths of the 95 % intervals of a fit of both.
    drag_error: float
    rolling_error: float
    # Force that arrives per T/r_e: estimate and half width of its 95 % interval; 1 in the nominal model.
    torque_gain: tuple[float, float]
    # speed, force, half_width: (G,): the resistance C_fr + C_rr + C_w v_x^2 over the speeds covered [m/s], [N],
    # and its 95 % half width [N].
    speed: np.ndarray
    force: np.ndarray
    half_width: np.ndarray
    held_out: HeldOutError  # of the longitudinal force
    samples: int
    blocks: int
    remarks: tuple[str, ...]


def fit_resistance(
    samples: MotionSamples,
    lateral_force_front: np.ndarray,
    vehicle: Vehicle,
    *,
    fit_drag: bool = True,
    fit_rolling: bool = True,
) -> Resistance:
    """Fit C_w and C_fr + C_rr.

    Parameters
    ----------
    samples : MotionSamples
        M samples.
    lateral_force_front : ndarray, shape (M,)
        F_fy [N], measured or modelled.
    vehicle : Vehicle
        Start; what the data do not settle is kept from it.
    fit_drag, fit_rolling : bool
        What may change.

    Raises
    ------
    VehicleError
        If there are too few blocks of time.

    Notes
    -----
    Longitudinal balance of the nominal model: T/r_e - m a_x - F_fy sin delta - F_fx (1 - cos delta)
    = C_fr + C_rr + C_w v_x^2. Drag is settled when the half width of its interval is below half of it; a constant
    road grade is the same as rolling resistance. What is no better than the start on held-out blocks is not taken:
    wind, hills or a torque that arrives in part then make more than what the fit changes.
    """
    blocks = len(np.unique(samples.block))
    if blocks < _MINIMUM_BLOCKS:
        advice = f"At least {_MINIMUM_BLOCKS} are needed."
        raise VehicleError(f"{blocks} blocks of time are too few for drag and rolling resistance", advice=advice)
    drive = samples.T / vehicle.wheel_radius
    front = front_longitudinal_force(samples, vehicle)
    turning = lateral_force_front * np.sin(samples.delta) + front * (1.0 - np.cos(samples.delta))
    against = drive - vehicle.mass * samples.ax - turning
    design = np.column_stack([np.ones(len(samples)), samples.vx**2])
    start = np.array([vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear, vehicle.drag_coefficient])
    both = _fit(design, against, start, [0, 1])
    covariance = both.covariance(samples.block)
    errors = 1.96 * np.sqrt(np.diag(covariance))
    wanted = [index for index, asked in ((0, fit_rolling), (1, fit_drag)) if asked]
    remarks: list[str] = []
    if 1 in wanted and not errors[1] < 0.5 * both.parameters[1]:
        wanted.remove(1)
        remarks.append(
            f"drag is not identified ({both.parameters[1]:.3g} +- {errors[1]:.2g} N/(m/s)^2 at "
            f"{samples.vx.min():.3g} to {samples.vx.max():.3g} m/s): {start[1]:.3g} is kept"
        )
    held_out = _held_out(design, against, start, wanted, samples.block)
    if wanted and held_out.calibrated >= held_out.start:
        named = " and ".join(("rolling resistance", "drag")[index] for index in sorted(wanted, reverse=True))
        remarks.append(
            f"{named} kept as in the start file: on held-out blocks the error is {held_out.start:.4g} N with it, and "
            f"{held_out.calibrated:.4g} N with the fit"
        )
        wanted = []
    final = _fit(design, against, start, wanted) if wanted else both
    rolling, drag = (final.parameters if wanted else start).tolist()
    gain, gain_error = _torque_gain(design, against, drive, samples.block, both.parameters)
    remarks += _doubts(gain, gain_error, rolling if 0 in wanted else None)
    speed = np.linspace(samples.vx.min(), samples.vx.max(), 101)
    rows = np.column_stack([np.ones_like(speed), speed**2])
    return Resistance(
        drag=drag,
        rolling=rolling,
        determined=tuple(name for index, name in ((1, "drag"), (0, "rolling")) if index in wanted),
        drag_error=float(errors[1]),
        rolling_error=float(errors[0]),
        torque_gain=(gain, gain_error),
        speed=speed,
        force=rows @ np.array([rolling, drag]),
        half_width=1.96 * np.sqrt(np.einsum("gi,ij,gj->g", rows, covariance, rows)),
        held_out=held_out,
        samples=len(samples),
        blocks=blocks,
        remarks=tuple(remarks),
    )


def _fit(design: np.ndarray, target: np.ndarray, start: np.ndarray, free: list[int]) -> LeastSquaresFit:
    def residual(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return design @ p - target, design

    bounds = np.zeros_like(start), np.full_like(start, np.inf)
    return solve(residual, start, *bounds, free=np.array(free))


def _torque_gain(
    design: np.ndarray, against: np.ndarray, drive: np.ndarray, block: np.ndarray, start: np.ndarray
) -> tuple[float, float]:
    """Return what share of T/r_e arrives, and the half width of its 95 % interval, as a check of the others."""
    extended = np.column_stack([design, -drive])
    begin = np.append(start, 0.0)

    def residual(p: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return extended @ p - against, extended

    fit = solve(residual, begin, np.full(3, -np.inf), np.full(3, np.inf))
    return 1.0 + float(fit.parameters[2]), 1.96 * float(np.sqrt(fit.covariance(block)[2, 2]))


def _held_out(
    design: np.ndarray, target: np.ndarray, start: np.ndarray, wanted: list[int], block: np.ndarray
) -> HeldOutError:
    _, index = np.unique(block, return_inverse=True)
    squares = np.zeros(len(target))
    for fold in range(_FOLDS):
        out = index % _FOLDS == fold
        p = _fit(design[~out], target[~out], start, wanted).parameters if wanted else start
        squares[out] = (design[out] @ p - target[out]) ** 2
    return HeldOutError(
        calibrated=float(np.sqrt(squares.mean())),
        start=float(np.sqrt(np.mean((design @ start - target) ** 2))),
        signal=float(np.sqrt(np.mean(target**2))),
    )


def _doubts(gain: float, gain_error: float, rolling: float | None) -> list[str]:
    """Return what speaks against the torque, and against a rolling resistance [N] that was fitted."""
    found = []
    if abs(gain - 1.0) > max(gain_error, 0.02):
        found.append(
            f"the force is {gain:.3f} +- {gain_error:.3f} times T/r_e: check the wheel radius, the torque map, "
            "and the inertia of turning wheels, which the nominal model leaves out"
        )
    if rolling is not None and rolling <= 0.0:
        found.append(
            "the fitted rolling resistance is 0, its lower bound: check for a grade, the mass and the torque map"
        )
    return found
