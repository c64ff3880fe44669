"""A calibration in its order: tyres, yaw inertia and torque splits, resistances; and the vehicle that results."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from split_cli.errors import VehicleError, nearest_names
from split_cli.vehicle.calibration.curve import ForceCurve, fit_force_curve
from split_cli.vehicle.calibration.resistance import Resistance, fit_resistance
from split_cli.vehicle.calibration.samples import MotionRun, MotionSamples, axle_lateral_forces, motion_samples
from split_cli.vehicle.calibration.turning import (
    IntervalEstimate,
    estimate_splits,
    estimate_yaw_inertia,
    with_estimates,
)
from split_cli.vehicle.parameters import LEFT_OPEN, Vehicle
from split_cli.vehicle.tire import MagicFormula, lateral_force

_OPEN_SLOPE = 0.25
PARTS = ("tires", "drag", "rolling", "splits", "inertia")
#: The two groups of them: what acts across the car, and along it.
ACROSS, ALONG = ("tires", "splits", "inertia"), ("drag", "rolling")
_WORDS = {
    "tires": "tyres",
    "splits": "torque splits",
    "inertia": "yaw inertia",
    "drag": "drag",
    "rolling": "rolling resistance",
}


@dataclass(frozen=True)
class CalibrationSettings:
    """What is fitted and which samples count."""

    parts: tuple[str, ...] = ("tires", "drag", "rolling")  # of `PARTS`
    alpha_max: float = 0.18  # samples of larger slip angles are left out, and curves compared up to it [rad]
    # For the tyres, samples beyond it are left out: braking and driving take lateral grip and move load, which the
    # nominal model does not know [m/s^2].
    max_longitudinal_acceleration: float = 2.0
    max_lateral_acceleration: float = 2.0  # for the resistances, samples beyond it are left out [m/s^2]
    smoothing: float | None = None  # standard deviation of the kernel [s]; None as `motion_samples` has it
    # Whether constant offsets of the slip angles are fitted; if not, those that are beyond chance are all the same.
    offsets: bool = False
    # draws, seed: how often blocks of time are resampled, and the seed.
    draws: int = 200
    seed: int = 0

    def __post_init__(self) -> None:
        if not self.parts:
            raise VehicleError("nothing to fit was named", advice=f"There are: {', '.join(sorted(PARTS))}.")
        for part in self.parts:
            if part not in PARTS:
                raise VehicleError(f"cannot fit {part!r}", advice=nearest_names(part, PARTS))


@dataclass(frozen=True)
class Calibration:
    """A calibrated vehicle and what is known of it."""

    vehicle: Vehicle  # calibrated values are marked so, the rest as it was
    curves: tuple[ForceCurve, ...]  # front and rear; empty when tyres were not fitted
    resistance: Resistance | None
    estimates: tuple[IntervalEstimate, ...]  # yaw inertia and splits, where asked for
    # samples, blocks: smoothed samples above the minimum speed, and blocks of time.
    samples: int
    blocks: int
    # slip_front, force_front, slip_rear, force_rear: the samples behind the curves [rad], [N], for figures.
    slip_front: np.ndarray
    force_front: np.ndarray
    slip_rear: np.ndarray
    force_rear: np.ndarray
    notes: tuple[str, ...] = ()  # what was left out, in sentences

    @property
    def remarks(self) -> tuple[str, ...]:
        """All that the reader must know, in sentences."""
        found = [*self.notes, *(remark for curve in self.curves for remark in (*curve.remarks, *curve.slip_remarks))]
        found += self.resistance.remarks if self.resistance else ()
        for estimate in self.estimates:
            if not estimate.settled:
                found.append(f"{estimate.name} is not identified by these drives: the start value is kept")
        return tuple(found)


def calibrate_vehicle(
    runs: Sequence[MotionRun], start: Vehicle, settings: CalibrationSettings | None = None
) -> Calibration:
    """Fit a vehicle's parameters to recorded motion.

    Parameters
    ----------
    runs : sequence of MotionRun
        Stretches without a gap.
    start : Vehicle
        Gives mass, geometry and inertia, and what the data do not settle.

    Raises
    ------
    VehicleError
        If too little of the drives can be used for any group.

    Notes
    -----
    There are two groups: what acts across the car (tyres, splits, inertia), and drag with rolling resistance. Each is
    fitted to the runs that say something of it. A group that cannot be fitted, or that held-out blocks do not support,
    stays as in the start with a remark, and the other one is taken all the same.
    """
    settings = settings or CalibrationSettings()
    samples = _samples(runs, start, settings)

    def samples_of(parts: Sequence[str]) -> MotionSamples:
        telling = [run for run in runs if not run.silent & set(parts)]
        return samples if len(telling) == len(runs) else _samples(telling, start, settings)

    across, along = ([part for part in group if part in settings.parts] for group in (ACROSS, ALONG))
    vehicle, resistance = start, None
    curves: tuple[ForceCurve, ...] = ()
    estimates: tuple[IntervalEstimate, ...] = ()
    gentle, failed = _gentle(samples, settings), []
    try:
        if across:
            turning = samples_of(across)
            gentle = _gentle(turning, settings)
            curves, estimates, vehicle = _fit_across(turning, start, settings)
    except VehicleError as error:
        failed.append((across, error))
    try:
        if along:
            resistance, vehicle = _fit_resistance(samples_of(along), vehicle, settings)
    except VehicleError as error:
        failed.append((along, error))
    if len(failed) == bool(across) + bool(along):
        raise failed[0][1]
    front, rear = axle_lateral_forces(gentle, vehicle)
    return Calibration(
        vehicle=_rounded(_marked(vehicle, curves, resistance, estimates, open_tires="tires" in across and not curves)),
        curves=curves,
        resistance=resistance,
        estimates=estimates,
        samples=len(samples),
        blocks=len(np.unique(samples.block)),
        slip_front=gentle.slip_front,
        force_front=front,
        slip_rear=gentle.slip_rear,
        force_rear=rear,
        notes=tuple(_stays(parts, error) for parts, error in failed),
    )


def _samples(runs: Sequence[MotionRun], start: Vehicle, settings: CalibrationSettings) -> MotionSamples:
    """Return the samples of runs above the minimum speed."""
    samples = motion_samples(runs, start, smoothing=settings.smoothing)
    samples = samples.where(samples.vx >= start.minimum_speed)
    if not len(samples):
        what = f"the drives never reach {start.minimum_speed:.2g} m/s, the minimum speed"
        raise VehicleError(what, advice="Add faster drives. It follows from the wheelbase.")
    return samples


def _stays(parts: Sequence[str], error: VehicleError) -> str:
    """Return in words what stays as in the start, and why."""
    *first, last = (_WORDS[part] for part in parts)
    named = f"{', '.join(first)} and {last}" if first else last
    return f"not fitted, and as in the start file: {named}, since {error.what}"


def _fit_across(
    samples: MotionSamples, start: Vehicle, settings: CalibrationSettings
) -> tuple[tuple[ForceCurve, ...], tuple[IntervalEstimate, ...], Vehicle]:
    """Return curves, splits and yaw inertia as they are asked for, and the vehicle with them."""
    vehicle, gentle = start, _gentle(samples, settings)
    curves: tuple[ForceCurve, ...] = ()
    estimates: tuple[IntervalEstimate, ...] = ()
    # What turning shows changes the forces that the curves are fitted to, and the other way round: three rounds.
    asked = [part for part in ("splits", "inertia") if part in settings.parts]
    rounds = 3 if asked else 1
    for last in [False] * (rounds - 1) + [True]:
        if "tires" in settings.parts:
            curves = _fit_curves(samples, vehicle, start, settings, draws=settings.draws if last else 0)
            vehicle = replace(vehicle, front_tire=curves[0].tire, rear_tire=curves[1].tire)
        estimates = ()
        if "splits" in asked:
            estimates += estimate_splits(samples, vehicle)
        if "inertia" in asked:
            estimates += (estimate_yaw_inertia(gentle, vehicle),)
        vehicle = with_estimates(vehicle, estimates)
    return curves, estimates, vehicle


def _gentle(samples: MotionSamples, settings: CalibrationSettings) -> MotionSamples:
    keep = np.abs(samples.ax) <= settings.max_longitudinal_acceleration
    keep &= np.maximum(np.abs(samples.slip_front), np.abs(samples.slip_rear)) <= settings.alpha_max
    return samples.where(keep)


def _fit_curves(
    samples: MotionSamples, vehicle: Vehicle, start: Vehicle, settings: CalibrationSettings, draws: int
) -> tuple[ForceCurve, ...]:
    gentle = _gentle(samples, settings)
    axles = (
        ("front", gentle.slip_front, gentle.slip_noise_front, vehicle.static_load_front),
        ("rear", gentle.slip_rear, gentle.slip_noise_rear, vehicle.static_load_rear),
    )
    forces, everywhere = axle_lateral_forces(gentle, vehicle), axle_lateral_forces(samples, vehicle)
    curves, follows = [], []
    for (axle, slip, noise, load), force, force_anywhere in zip(axles, forces, everywhere, strict=True):
        fit = partial(
            fit_force_curve,
            axle,
            slip,
            force,
            gentle.block,
            getattr(start, f"{axle}_tire"),
            given_peak=_given_peak(start, axle, load),
            static_load=load,
            largest_force=float(np.quantile(np.abs(force_anywhere), 0.995)),
            slip_noise=noise,
            alpha_max=settings.alpha_max,
            draws=draws,
            seed=settings.seed,
        )
        curve = fit(fit_offset=settings.offsets)
        if curve.slip_remarks and not settings.offsets:
            # An offset bends the curve. It is no property of the tyre, so the fit is not left to bear it.
            curve = fit(fit_offset=True)
        along = float(np.corrcoef(slip, force)[0, 1])
        curves.append(curve)
        follows.append(along)
    return _kept_where_open(tuple(curves), tuple(follows), start)


def _kept_where_open(
    curves: tuple[ForceCurve, ...], follows: tuple[float, ...], start: Vehicle
) -> tuple[ForceCurve, ...]:
    """Return the start's tyres on both axles when the drives leave a slope open: half a balance is none.

    `follows` is the correlation of force and slip angle at each axle; no tyre has a negative one.
    """
    reasons = []
    for curve, correlation in zip(curves, follows, strict=True):
        slope, low, high = curve.cornering_stiffness
        if 0.5 * (high - low) > _OPEN_SLOPE * slope:
            spread = f"known to +- {50.0 * (high - low) / slope:.0f} %" if curve.slope_is_known else "open"
            why = ""
            if correlation <= 0.0:
                why = (
                    f" (the force does not grow with the slip angle, correlation {correlation:.2f}: check the "
                    "place of v_y, the place of the CG, and the signs of v_y, r and delta)"
                )
            reasons.append(f"the {curve.axle} slope is {spread}{why}")
        elif curve.held_out.calibrated >= curve.held_out.signal or (
            # Tyres that cannot give what the axle gave are no better, whatever their error.
            curve.held_out.calibrated >= curve.held_out.start
            and curve.peak[0] <= getattr(start, f"{curve.axle}_tire").D
        ):
            reasons.append(
                f"on held-out blocks the {curve.axle} curve is no better than the start file's, or than no force"
            )
    if not reasons:
        return curves
    why = f"the start's tyres are kept on both axles: {' and '.join(reasons)}"
    kept = []
    for curve in curves:
        tire = getattr(start, f"{curve.axle}_tire")
        force = lateral_force(tire.B, tire.C, tire.D, curve.slip_angle)
        kept.append(replace(curve, tire=tire, force=force, determined=(), remarks=()))
    # The reason belongs to both, and is said once. What was said of coefficients is of a fit that is not taken.
    return (replace(kept[0], remarks=(why,)), *kept[1:])


def _given_peak(start: Vehicle, axle: str, load: float) -> float:
    """Return the peak to take when the data leave it open: published, else friction times static load."""
    tire = start.front_tire if axle == "front" else start.rear_tire
    if start.friction_coefficient is None or start.origins.get(f"{axle}_tire.D") == "published":
        return tire.D
    return float(f"{start.friction_coefficient * load:.6g}")


def _fit_resistance(
    samples: MotionSamples, vehicle: Vehicle, settings: CalibrationSettings
) -> tuple[Resistance, Vehicle]:
    straight = samples.where(np.abs(samples.ay) <= settings.max_lateral_acceleration)
    front, _ = axle_lateral_forces(straight, vehicle)
    resistance = fit_resistance(
        straight, front, vehicle, fit_drag="drag" in settings.parts, fit_rolling="rolling" in settings.parts
    )
    before = vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear
    # Only the sum is seen; it is shared as before, or as the load where there was none.
    share = vehicle.rolling_resistance_front / before if before > 0 else vehicle.cg_to_rear_axle / vehicle.wheelbase
    return resistance, replace(
        vehicle,
        drag_coefficient=resistance.drag,
        rolling_resistance_front=share * resistance.rolling,
        rolling_resistance_rear=(1.0 - share) * resistance.rolling,
    )


def _rounded(vehicle: Vehicle) -> Vehicle:
    """Round what was calibrated to six digits, far finer than it is known, so that files can be read."""

    def short(key: str, value: float) -> float:
        return float(f"{value:.6g}") if vehicle.origins.get(key) == "calibrated" else value

    changed: dict[str, Any] = {}
    for key in ("front_tire", "rear_tire"):
        tire = getattr(vehicle, key)
        changed[key] = MagicFormula(**{name: short(f"{key}.{name}", getattr(tire, name)) for name in ("B", "C", "D")})
    changed |= {key: short(key, getattr(vehicle, key)) for key in vehicle.origins if "." not in key}
    return replace(vehicle, **changed)


def _marked(
    vehicle: Vehicle,
    curves: tuple[ForceCurve, ...],
    resistance: Resistance | None,
    estimates: tuple[IntervalEstimate, ...],
    *,
    open_tires: bool = False,
) -> Vehicle:
    """Mark what was calibrated, and what was given in its place, with a note of how well it is known.

    With `open_tires` tyres were asked for, and could not be fitted.
    """
    origins, notes = dict(vehicle.origins), dict(vehicle.notes)
    if open_tires:
        notes |= {f"{axle}_tire.B": LEFT_OPEN for axle in ("front", "rear")}

    def mark(key: str, origin: str, note: str = "") -> None:
        origins[key] = origin
        notes.pop(key, None)
        if note:
            notes[key] = note

    for curve in curves:
        if not curve.determined:
            notes[f"{curve.axle}_tire.B"] = LEFT_OPEN
            continue
        for name in ("B", "C", "D"):
            key = f"{curve.axle}_tire.{name}"
            if name in curve.determined:
                mark(key, "calibrated")
            elif origins.get(key) != "published":
                mark(key, "assumed", "the drives leave it open")
        notes[f"{curve.axle}_tire.B"] = (
            f"equally good curves differ by {curve.deviation_covered:.3g} N up to {curve.covered:.3f} rad"
        )
    if resistance is not None:
        if "drag" in resistance.determined:
            mark("drag_coefficient", "calibrated", f"+- {resistance.drag_error:.2g}")
        if "rolling" in resistance.determined:
            note = f"the sum is known to +- {resistance.rolling_error:.2g} N, its share is not"
            mark("rolling_resistance_front", "calibrated", note)
            mark("rolling_resistance_rear", "calibrated", note)
    for estimate in estimates:
        if estimate.settled:
            mark(estimate.name, "calibrated", f"+- {estimate.error:.2g}")
    return replace(vehicle, origins=origins, notes=notes)
