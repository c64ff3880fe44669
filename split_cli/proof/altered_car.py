"""A recording as a car with another mass, grip, stiffness or centre of gravity would have made it.

Nobody can drive the recorded drive again with another car. What can be computed is how its motion would have
differed: by as much as two nominal models differ, one of the vehicle file and one of the file with the alteration.
The forces that the nominal model lacks stay as they were at every moment of time, and move the altered body.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.ndimage import uniform_filter1d

from split_cli.errors import SplitError
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import MagicFormula
from split_cli.vehicle.windows import substep_count

#: Speed over the vehicle's minimum speed below which a car moves as recorded: it hardly slips there [1].
_CREEP = 0.2
#: Side slip, or yaw rate times wheelbase over speed, beyond what was recorded from which on a car has spun [1].
_SPUN = 1.0
#: Time over which the yaw rate's change is taken [s].
_SLOPE = 0.06
#: Share of the variance of either axle's lateral force that the nominal model has to explain [1].
_EXPLAINED = 0.75
#: Over how long these forces are averaged: in shorter moments a slope of velocities is mostly noise [s].
_LASTING = 0.3


def _tires(vehicle: Vehicle, change: Callable[[MagicFormula], MagicFormula]) -> Vehicle:
    return replace(vehicle, front_tire=change(vehicle.front_tire), rear_tire=change(vehicle.rear_tire))


ALTERATIONS: dict[str, Callable[[Vehicle, float], Vehicle]] = {
    "mass": lambda car, scale: replace(car, mass=scale * car.mass),
    "friction_scale": lambda car, scale: _tires(car, lambda one: replace(one, D=scale * one.D, B=one.B / scale)),
    "tire_stiffness": lambda car, scale: _tires(car, lambda one: replace(one, B=scale * one.B)),
    "cg_shift": lambda car, dx: replace(
        car, cg_to_front_axle=car.cg_to_front_axle - dx, cg_to_rear_axle=car.cg_to_rear_axle + dx
    ),
}
"""By the term that names each: a vehicle file, and how many times its mass, its tyres' peaks (with their cornering
stiffness as it was), their stiffness (with their peaks as they were) [1], or how far ahead its CG lies [m]."""


def altered_vehicle(vehicle: Vehicle, term: str, value: float) -> Vehicle:
    """Return a vehicle file with one alteration and without effects.

    Parameters
    ----------
    term : str
        Of `ALTERATIONS`.
    value : float
        [1], or [m] for ``cg_shift``.
    """
    return ALTERATIONS[term](replace(vehicle, effects=()), value)


def driven_by(drive: Drive, vehicle: Vehicle, altered: Vehicle) -> Drive:
    """Return a drive as an altered car would have made it with the same steering, at the same speeds.

    Parameters
    ----------
    vehicle : Vehicle
        Of the car that was recorded; effects are left out.

    Raises
    ------
    SplitError
        If the altered car would have spun, so that the recorded steering says nothing of how it is driven. If the
        file explains less than three quarters of an axle's lateral force: then its response to any change is not
        the car's.

    Notes
    -----
    With x = (v_x, v_y, r) as recorded, f and g the single tracks of both files and u the inputs, the differences
    d of v_y and r follow d' = g(x + d, u') - f(x, u) + (G F^-1 - I)(x' - f(x, u)) from 0 at the begin of each
    segment, by RK4 with as many substeps as the altered car's eigenvalues ask for. F and G are the matrices of
    forces to rates of both: the labels x' - f are of forces, which move the altered body. So a sensor's bias,
    which is a force to the nominal model and none to the car, does not turn it. The torque in u' is the one that
    keeps v_x' as it was; it is written into the drive unless T was derived from the motion. Yaw angle, position
    and accelerations change by what d moves. Below a fifth of the vehicle's minimum speed d is 0.
    """
    car, other = SingleTrack(vehicle, ()), SingleTrack(altered, ())
    slowest = _CREEP * vehicle.minimum_speed
    front, rear = _explained(drive, car)
    if not min(front, rear) >= _EXPLAINED:
        raise SplitError(
            f"the file explains {100.0 * max(front, 0.0):.0f} % of the variation of the front axle's lateral "
            f"force and {100.0 * max(rear, 0.0):.0f} % of the rear's; to tell how another car would move takes "
            f"{100.0 * _EXPLAINED:.0f} %",
            where=drive.name,
            advice="Calibrate it first (split calibrate).",
        )
    changed = np.zeros((len(drive), 2))
    rate = np.zeros((len(drive), 2))
    torque = np.array(drive["T"], dtype=float)
    for rows in drive.segments():
        changed[rows], rate[rows], torque[rows] = _follow(car, other, _Path.of(drive, rows), slowest)
    moving = drive["vx"] > slowest
    speed, length = np.maximum(drive["vx"], slowest), vehicle.wheelbase
    recorded = np.stack([drive["vy"], drive["r"]], axis=1)
    # The recorded car may itself have spun where the altered one does not.
    gone = (np.abs(recorded + changed) - np.abs(recorded)) * [1.0, length] > _SPUN * speed[:, None]
    if not np.isfinite(changed).all() or gone[moving].any():
        first = int(np.argmax(moving & (gone | ~np.isfinite(changed)).any(axis=1)))
        what = "the altered car would have spun with the recorded steering"
        advice = "Take a smaller alteration, or a drive further from the limit."
        raise SplitError(what, where=f"{drive.name}, t = {drive['t'][first]:.1f} s", advice=advice)
    columns = dict(drive.columns)
    vx, vy, r = (np.asarray(drive[name], dtype=float) for name in ("vx", "vy", "r"))
    columns |= {"vy": vy + changed[:, 0], "r": r + changed[:, 1]}
    if not drive.metadata.torque_follows_motion:
        columns["T"] = torque
    if "ax" in columns:
        columns["ax"] = columns["ax"] - (columns["vy"] * columns["r"] - vy * r)
    if "ay" in columns:
        columns["ay"] = columns["ay"] + rate[:, 0] + vx * changed[:, 1]
    if "yaw" in columns:
        columns |= _moved_path(drive, columns)
    return replace(drive, columns=columns, sha256="")


def moved_reference(drive: Drive, dx: float) -> Drive:
    """Return a drive whose velocity and accelerations were measured `dx` [m] further forward than its map says.

    Notes
    -----
    Of a rigid body: v_y + dx r, a_y + dx r', a_x - dx r^2. So measures an inertial unit with its own velocity
    whose place in the car was entered wrongly, beside a position of another sensor.
    """
    r = np.asarray(drive["r"], dtype=float)
    columns = {**drive.columns, "vy": drive["vy"] + dx * r}
    if "ax" in columns:
        columns["ax"] = columns["ax"] - dx * r * r
    if "ay" in columns:
        columns["ay"] = np.array(columns["ay"], dtype=float)
        for rows in drive.segments():
            columns["ay"][rows] += dx * _slope(r[rows], drive.period)
    return replace(drive, columns=columns, sha256="")


def _slope(values: np.ndarray, period: float) -> np.ndarray:
    """Return the change of samples (N, ...) over `_SLOPE` around each, by time; at the ends over what there is."""
    width = max(1, round(_SLOPE / period / 2.0))
    rows = np.arange(len(values))
    before, after = np.maximum(rows - width, 0), np.minimum(rows + width, len(values) - 1)
    return ((values[after] - values[before]).T / (np.maximum(after - before, 1) * period)).T


def _explained(drive: Drive, car: SingleTrack) -> tuple[float, float]:
    """Return the shares [1] of the variance of the front and the rear lateral force that a model explains."""
    width = max(1, round(_LASTING / drive.period))
    lacking, whole = [], []
    for rows in drive.segments():
        path = _Path.of(drive, rows)
        moving = path.velocity[:, 0] > car.vehicle.minimum_speed
        slope, model = _slope(path.velocity, drive.period), path.rates(car)
        turning = np.cross([0.0, 0.0, 1.0], path.velocity * [1.0, 1.0, 0.0]) * path.velocity[:, 2:]
        for found, one in ((lacking, slope - model), (whole, slope + turning)):
            found.append(uniform_filter1d(one, width, axis=0)[moving])
    forces = np.linalg.inv(car.vehicle.force_matrix()).T
    left, all_of_it = (np.var(np.concatenate(one) @ forces, axis=0)[1:] for one in (lacking, whole))
    front, rear = 1.0 - left / np.maximum(all_of_it, 1e-300)
    return float(front), float(rear)


@dataclass(frozen=True)
class _Path:
    """One segment of a drive: v_x, v_y, r, shape (N, 3); T and delta, shape (N, 2); which of these are held."""

    period: float
    velocity: np.ndarray
    inputs: np.ndarray
    held: tuple[bool, bool]

    @classmethod
    def of(cls, drive: Drive, rows: slice) -> _Path:
        velocity = np.stack([drive[name][rows] for name in ("vx", "vy", "r")], axis=1).astype(float)
        inputs = np.stack([drive[name][rows] for name in ("T", "delta")], axis=1).astype(float)
        held = tuple(drive.metadata.between.get(name) == "held" for name in ("T", "delta"))
        return cls(drive.period, velocity, inputs, held)

    def rates(self, model: SingleTrack) -> np.ndarray:
        """Return v_x', v_y' and r' of a model at every sample, shape (N, 3)."""
        return np.stack(model.velocity_derivative(*self.velocity.T, *self.inputs.T), axis=1)

    def between(self, k: int, share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return velocity (M, 3) and inputs (M, 2) at shares of the sample that begins at row k."""
        grown = share[:, None]
        inputs = self.inputs[k] + grown * (self.inputs[k + 1] - self.inputs[k]) * ~np.array(self.held)
        return self.velocity[k] + grown * (self.velocity[k + 1] - self.velocity[k]), inputs


def _follow(
    car: SingleTrack, other: SingleTrack, path: _Path, slowest: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the differences of v_y and r and their rates, shape (N, 2) each, and the torque, shape (N,)."""
    count = len(path.velocity)
    inputs, velocity = path.inputs, path.velocity
    changed, rate, torque = np.zeros((count, 2)), np.zeros((count, 2)), inputs[:, 0].copy()
    moved = _moved_forces(car, other, path, slowest)
    substeps = _substeps(other, path, slowest)
    span = _THRUST * other.vehicle.max_torque
    for k in range(count):
        if velocity[k, 0] <= slowest:
            continue
        known = np.array(car.velocity_derivative(*velocity[k], *inputs[k])) - moved[k]
        # Thrust is linear in the torque on either side of zero.
        for _ in range(2):
            here, there = (
                other.velocity_derivative(velocity[k, 0], *(velocity[k, 1:] + changed[k]), one, inputs[k, 1])
                for one in (torque[k], torque[k] + span)
            )
            torque[k] += span * (known[0] - here[0]) / (there[0] - here[0])
        rate[k] = np.array(here[1:]) - known[1:]
        if k + 1 < count and velocity[k + 1, 0] > slowest:
            more = torque[k] - inputs[k, 0]
            changed[k + 1] = _step(car, other, path, k, int(substeps[k]), changed[k], more, moved[k : k + 2, 1:])
            if not np.abs(changed[k + 1, 0]) < 10.0 * _SPUN * velocity[k, 0]:
                changed[k + 1 :] = np.nan
                break
    return changed, rate, torque


_THRUST = 1e-3  # step of the torque over the largest [1]


def _moved_forces(car: SingleTrack, other: SingleTrack, path: _Path, slowest: float) -> np.ndarray:
    """Return the rates that the forces which `car` lacks add to those of an altered body, shape (N, 3)."""
    labels = (_slope(path.velocity, path.period) - path.rates(car)) * (path.velocity[:, :1] > slowest)
    matrices = (one.vehicle.force_matrix() for one in (car, other))
    return labels @ (np.linalg.solve(*(one.T for one in matrices)) - np.eye(3))


def _substeps(model: SingleTrack, path: _Path, slowest: float) -> np.ndarray:
    fastest = np.maximum(path.velocity[:, 0], slowest)
    jacobian = model.velocity_jacobian(fastest, *path.velocity[:, 1:].T, *path.inputs.T)
    return substep_count(jacobian, path.period, model.vehicle.wheelbase)


def _step(
    car: SingleTrack,
    other: SingleTrack,
    path: _Path,
    k: int,
    parts: int,
    begin: np.ndarray,
    more_torque: float,
    moved: np.ndarray,
) -> np.ndarray:
    """Return the differences of v_y and r one sample later, by classical RK4.

    `moved` are the last columns of `_moved_forces` at both ends of the sample, shape (2, 2).
    """
    share = np.linspace(0.0, 1.0, 2 * parts + 1)
    velocity, inputs = path.between(k, share)
    known = np.stack(car.velocity_derivative(*velocity.T, *inputs.T), axis=1)[:, 1:]
    known -= moved[0] + share[:, None] * (moved[1] - moved[0])
    h = path.period / parts

    def slope(at: int, d: np.ndarray) -> np.ndarray:
        vx, vy, r = velocity[at]
        T, delta = inputs[at]
        rates = other.velocity_derivative(vx, vy + d[0], r + d[1], T + more_torque, delta)
        return np.array(rates[1:]) - known[at]

    d = begin
    for part in range(parts):
        a = slope(2 * part, d)
        b = slope(2 * part + 1, d + 0.5 * h * a)
        c = slope(2 * part + 1, d + 0.5 * h * b)
        d = d + h / 6.0 * (a + 2.0 * b + 2.0 * c + slope(2 * part + 2, d + h * c))
    return d


def _moved_path(drive: Drive, columns: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return yaw angle and position, where they are recorded, with what v_y and r have changed."""
    found = {"yaw": np.array(drive["yaw"], dtype=float)}
    if drive.has_position:
        found |= {name: np.array(drive[name], dtype=float) for name in ("X", "Y")}
    turned = np.zeros(2)
    begin = np.zeros(3)
    for rows in drive.segments():

        def grown(rates: np.ndarray) -> np.ndarray:
            return cumulative_trapezoid(rates, dx=drive.period, axis=0, initial=0.0)

        yaw = np.asarray(drive["yaw"][rows], dtype=float)
        turned = begin[2] + grown(columns["r"][rows] - drive["r"][rows])
        found["yaw"][rows] = yaw + turned
        if drive.has_position:
            vx = drive["vx"][rows]
            before = _over_ground(vx, drive["vy"][rows], yaw)
            moved = begin[:2] + grown(_over_ground(vx, columns["vy"][rows], yaw + turned) - before)
            found["X"][rows] += moved[:, 0]
            found["Y"][rows] += moved[:, 1]
            begin[:2] = moved[-1]
        begin[2] = turned[-1]
    return found


def _over_ground(vx: np.ndarray, vy: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    return np.stack([vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw)], axis=1)
