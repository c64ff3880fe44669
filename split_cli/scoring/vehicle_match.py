"""Whether a drive can belong to a vehicle (geometry, grip, mass), and how much of it lies near points of a set."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from split_cli.errors import VehicleError
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.vehicle.calibration.curve import rounded
from split_cli.vehicle.calibration.samples import MotionRun, axle_lateral_forces, motion_samples
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

#: Ratios beyond which no wrong value of one car explains it: a car of another size. A steering ratio left out or a
#: mass off by half stay inside; a 1:10 car against a road car is off by 8.
_ANOTHER_CAR = 2.5
#: Ratio of lateral forces beyond which tyres or road are others than the file says; load and camber make 20 %.
_ANOTHER_GRIP = 1.4
#: Ratio of an axle's recorded lateral force to its peak from which on the model slides where the car did not [1]. Noise
#: and smoothing make some per cent.
_OVERLOAD = 1.05
#: Least size of the correlation at which two signals are said to go together, or against each other [1]: half the
#: variance.
_TOGETHER = 0.7
#: Time over which changes of the torque are compared with those of the acceleration [s]: what torque does more slowly,
#: a hill balances. A driver who gives half of what a hill takes slows down by all of it. Of 96 simulated cruise
#: controls on hills, acceleration went against the torque by `_TOGETHER` in three, and its changes in none.
_ANSWER_SECONDS = 2.0
#: Time over which slopes of v_x and v_y are taken [s]: noise of v_x makes some tenths of m/s^2 of it.
_SLOPE_SECONDS = 0.2
_MOST_ROWS = 20_000
_FEWEST = 200
#: Scatter of what the torque gives [m/s^2] below which it is rounding, far below what any sensor resolves.
_ROUNDING = 1e-6


@dataclass(frozen=True)
class Belonging:
    """What a drive shows of a vehicle's numbers; None where the drive does not excite it."""

    # Recorded yaw rate over that of steady turning with the file's wheelbase and stiffnesses [1]; below 0 where it
    # turns against its steer angle.
    turning: float | None
    # Recorded lateral force over the nominal one where the tyres are loaded by more than half their peak [1].
    grip: float | None
    # Largest steady lateral acceleration (99.5 % quantile) over what both axles' peaks allow [1].
    peak: float | None
    # Recorded longitudinal force beyond the resistances of the file over that of the torque, both without their
    # means [1]; below 0 where it slows down by a torque that drives.
    traction: float | None

    def turned_signs(self) -> tuple[str, ...]:
        """Return which channels have the opposite sign, in words."""
        said = []
        if self.turning is not None and self.turning < 0.0:
            said.append(
                f"it turns {-self.turning:.2g} times as fast as this vehicle would, but to the other side than it "
                "steers: the sign of delta or of r is turned"
            )
        if self.traction is not None and self.traction < 0.0:
            said.append(
                f"it accelerates {-self.traction:.2g} times as much for its torque as this vehicle would, but to the "
                "other side: T is positive when braking"
            )
        return tuple(said)

    def contradictions(self) -> tuple[str, ...]:
        """Return what no recording of this vehicle can show, in words."""
        said = [*self.turned_signs()]
        if self.turning is not None and self.turning >= 0.0 and not 1.0 / _ANOTHER_CAR < self.turning < _ANOTHER_CAR:
            said.append(f"it turns {self.turning:.2g} times as fast for its steer angle as this vehicle would")
        if self.peak is not None and self.peak > _ANOTHER_CAR:
            said.append(f"its lateral acceleration is {self.peak:.2g} times what this vehicle's tyres can carry")
        if self.traction is not None and self.traction >= 0.0 and not 1.0 / _ANOTHER_CAR < self.traction < _ANOTHER_CAR:
            said.append(f"it accelerates {self.traction:.2g} times as much for its torque as this vehicle would")
        return tuple(said)

    def doubts(self) -> tuple[str, ...]:
        """Return what would take other tyres or another road, in words."""
        if self.peak is not None and _ANOTHER_GRIP < self.peak <= _ANOTHER_CAR:
            return (f"its lateral acceleration is {self.peak:.2g} times what this vehicle's tyres can carry",)
        if self.grip is not None and not 1.0 / _ANOTHER_GRIP < self.grip < _ANOTHER_GRIP:
            return (f"where its tyres work hard they carry {self.grip:.2g} times what the vehicle file says",)
        return ()


def belonging(drive: Drive, vehicle: Vehicle) -> Belonging:
    """Return what a drive shows of a vehicle's numbers, each as a ratio of recorded to expected.

    Notes
    -----
    Steady turning: r = v_x delta/(L + K v_x^2) with K = m (l_r/C_f - l_f/C_r)/L, at less than half the grip;
    lateral force: m (v_x r + dv_y/dt) over 0.2 s against that of the nominal tyres; longitudinal force: m dv_x/dt
    over 0.2 s and what the nominal model loses to rolling, drag and turned wheels, against T/r_e. Ratios are least
    squares through the origin. The means are taken off the longitudinal forces: at constant speed a torque shows
    resistances alone, of which a file without them says nothing. Those of another car's file are noise: of the ratio
    with them and the one without, that counts which goes better with the torque. The sign of T is turned where changes
    of dv_x/dt - v_y r over 2 s go against those of the torque; that a car slows down while it is driven is a hill.
    """
    model = SingleTrack(vehicle, ())
    step = max(1, round(_SLOPE_SECONDS / drive.period))
    rows = np.arange(0, max(len(drive) - step, 0), max(1, len(drive) // _MOST_ROWS))
    rows = rows[drive.segment[rows] == drive.segment[rows + step]]
    names = ("vx", "vy", "r", "T", "delta")
    vx, vy, r, torque, delta = (drive.at(name, rows) for name in names)
    moving = np.isfinite(vx + vy + r + torque + delta) & (vx > vehicle.minimum_speed)
    if moving.sum() < _FEWEST:
        return Belonging(None, None, None, None)
    rows, vx, vy, r, torque, delta = (values[moving] for values in (rows, vx, vy, r, torque, delta))
    car, carried = vehicle, vehicle.lateral_grip
    # A car that slides turns more than its path bends: v_x r alone was 1.5 times what its tyres carry.
    half = max(1, step // 2)
    sides = [np.clip(rows + k, 0, len(drive) - 1) for k in (-half, half)]
    same = (drive.segment[sides[0]] == drive.segment[rows]) & (sides[0] < sides[1])
    rising = np.diff([drive.at("vy", side) for side in sides], axis=0)[0]
    sliding = rising / (np.maximum(sides[1] - sides[0], 1) * drive.period)
    lateral = vx * r + np.where(same & np.isfinite(sliding), sliding, 0.0)
    gentle = np.abs(lateral) < 0.5 * carried
    expected = vx * delta / np.maximum(car.wheelbase + car.understeer_gradient * vx**2, 0.3 * car.wheelbase)
    flow = model.flow(vx, vy, r, torque, delta)
    front_force, rear_force = flow.front.lateral_force, flow.rear.lateral_force
    nominal = (front_force + rear_force) / car.mass
    loaded = np.abs(front_force) + np.abs(rear_force) > 0.5 * (car.front_tire.D + car.rear_tire.D)
    change = (drive.at("vx", rows + step) - vx) / (step * drive.period) - vy * r
    driven = torque / car.wheel_radius / car.mass
    kept = model.velocity_derivative(vx, vy, r, torque, delta)[0] - vy * r
    accounts = [(force - force.mean(), driven - driven.mean()) for force in (change + driven - kept, change)]
    peak = float(np.quantile(np.abs(lateral), 0.995)) / carried
    return Belonging(
        _ratio(r[gentle], expected[gentle], signed=True),
        # With effects in the file the plain tyres are not what it says.
        None if vehicle.effects else _ratio(lateral[loaded], nominal[loaded]),
        peak,
        _traction(drive, vehicle, accounts),
    )


def _traction(drive: Drive, vehicle: Vehicle, accounts: Sequence[tuple[np.ndarray, np.ndarray]]) -> float | None:
    """Return `Belonging.traction` of longitudinal accelerations and what the torque makes of them, [m/s^2] (N,) each.

    A torque from a pedal has a size that somebody assumed, so only its sign is judged.
    """
    if drive.metadata.torque_follows_motion or any(driven.std() < _ROUNDING for _, driven in accounts):
        return None
    levels = None if drive.metadata.is_derived("T") else _ratio(*max(accounts, key=lambda both: _correlation(*both)))
    if levels is not None:
        return levels
    changes = _ratio(*_changes(drive, vehicle), signed=True)
    return changes if changes is not None and changes < 0.0 else None


def _changes(drive: Drive, vehicle: Vehicle) -> tuple[np.ndarray, np.ndarray]:
    """Return changes of dv_x/dt - v_y r within a segment, and those that the torque makes, [m/s^2], shape (N,) each."""
    step, later = (max(1, round(seconds / drive.period)) for seconds in (_SLOPE_SECONDS, _ANSWER_SECONDS))
    rows = np.arange(0, max(len(drive) - step - later, 0), max(1, len(drive) // _MOST_ROWS))
    rows = rows[drive.segment[rows] == drive.segment[rows + step + later]]
    sides = []
    for at in (rows, rows + later):
        vx, vy, r, torque = (drive.at(name, at) for name in ("vx", "vy", "r", "T"))
        along = (drive.at("vx", at + step) - vx) / (step * drive.period) - vy * r
        slow = vx <= vehicle.minimum_speed
        sides.append([np.where(slow, np.nan, along), torque / vehicle.wheel_radius / vehicle.mass])
    recorded, driven = np.subtract(sides[1], sides[0])
    known = np.isfinite(recorded + driven)
    return recorded[known], driven[known]


def _ratio(recorded: np.ndarray, expected: np.ndarray, *, signed: bool = False) -> float | None:
    """Return the slope through the origin, None where the two hardly go together, or only `signed` against it."""
    if len(recorded) < _FEWEST or not np.isfinite(recorded).all():
        return None
    together = _correlation(recorded, expected)
    if max(together, -signed * together) < _TOGETHER:
        return None
    return float(recorded @ expected / (expected @ expected))


def _correlation(recorded: np.ndarray, expected: np.ndarray) -> float:
    """Return the cosine between two signals; 0 where one is zero throughout or not finite."""
    size = float(np.sqrt((recorded @ recorded) * (expected @ expected)))
    return float(recorded @ expected) / size if 0.0 < size < np.inf else 0.0


def overloaded_axles(drive: Drive, vehicle: Vehicle, shown: Belonging) -> tuple[str, ...]:
    """Return in words which axles carried more lateral force on a drive than the file's tyres can give.

    Parameters
    ----------
    shown : Belonging
        What the drive shows of the vehicle's numbers, see `belonging`.

    Notes
    -----
    Forces are those of the lateral and the yaw balance, smoothed; 99.5 % of them are smaller than the one that is
    taken. There the nominal model slides, and open loop it spins. Effects change what a file's tyres give, and a drive
    of another car is none of this one: nothing is said then.
    """
    if vehicle.effects or shown.contradictions():
        return ()
    runs = [
        MotionRun(
            drive.period,
            vx=drive["vx"][rows],
            vy=drive["vy"][rows],
            r=drive["r"][rows],
            T=drive["T"][rows],
            delta=drive["delta"][rows],
        )
        for rows in drive.segments()
    ]
    try:
        samples = motion_samples(runs, vehicle)
    except VehicleError:  # too short for a derivative
        return ()
    samples = samples.where(samples.vx >= vehicle.minimum_speed)
    if len(samples) < _FEWEST:
        return ()
    said = []
    for axle, tire, force in zip(
        ("front", "rear"), (vehicle.front_tire, vehicle.rear_tire), axle_lateral_forces(samples, vehicle), strict=True
    ):
        reached = float(np.nanquantile(np.abs(force), 0.995))
        if reached > _OVERLOAD * tire.D:
            said.append(
                f"its {axle} axle carried {rounded(reached)} N across, and D of {axle}_tire is {rounded(tire.D)} N: "
                "the nominal model slides there, and the car did not"
            )
    return tuple(said)


def near_points(training_set: TrainingSet, z: np.ndarray) -> np.ndarray:
    """Return which features `z`, shape (N, D), lie within a length scale of a point of the set, bool shape (N,).

    Notes
    -----
    Farther away the nearest point's correlation is below e^-1/2. Its square, the largest share of the variance
    that one point can explain, is below 0.37: the correction fades and the nominal model remains. Intervals are
    those of the residual's size in the training drives there. False where a feature is not finite.
    """
    near, finite = np.zeros(len(z), dtype=bool), np.isfinite(z).all(axis=1)
    if training_set.size and finite.any():
        tree = cKDTree(training_set.z / training_set.kernel.length_scales)
        distance = tree.query(z[finite] / training_set.kernel.length_scales, distance_upper_bound=1.0)[0]
        near[finite] = np.isfinite(distance)
    return near


def share_beyond(training_set: TrainingSet, z: np.ndarray) -> float:
    """Return the share of finite features `z`, shape (N, D), farther than a length scale from every point."""
    z = z[np.isfinite(z).all(axis=1)]
    return float(1.0 - near_points(training_set, z).mean()) if len(z) else 0.0
