"""An independent simulator as reality: the 29-state multi-body car of commonroad-vehicle-models.

Its inputs are a steering rate and an acceleration that it turns into wheel torques, T = m R_w a; its brakes and
its drive have splits of their own. The simulation is a single track calibrated by gentle tests of the same car.
Source: Althoff and Wuersching, CommonRoad: Vehicle Models (2020), multi-body model after Allen et al.
"""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.assembling.noise import estimate_noise
from split_cli.logs.drive import Drive, DriveMetadata
from split_cli.plant.tracks import Track
from split_cli.vehicle.calibration.calibrate import CalibrationSettings, calibrate_vehicle
from split_cli.vehicle.calibration.samples import MotionRun
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import MagicFormula

_STEP = 2e-3
_KEEP = 5
_LOOK_AHEAD = 0.6
_MOST_TURNING = 12.0  # [m/s^2]
_NOISE = {"X": 0.01, "Y": 0.01, "yaw": 0.0012, "vx": 0.008, "vy": 0.008, "r": 0.0015, "ax": 0.03, "ay": 0.03}
MULTIBODY_STATE = SimpleNamespace(X=0, Y=1, delta=2, vx=3, yaw=4, r=5, vy=10, spins=slice(23, 27))
"""Where in the multi-body state these are; the rest are motions of body and axles. Spins are front, then rear."""
_AT = MULTIBODY_STATE


@dataclass(frozen=True)
class MultiBody:
    """The foreign car: its parameters, and the two functions that make it go."""

    parameters: SimpleNamespace
    derivative: object
    initial: object
    steering_limit: object
    acceleration_limit: object

    @property
    def mass(self) -> float:
        """Mass [kg]."""
        return float(self.parameters.m)


def load_car(number: int = 2) -> MultiBody:
    """Return a car of the package; 1 Ford Escort, 2 BMW 320i, 3 VW Vanagon.

    Raises
    ------
    SplitError
        If the package is not installed.
    """
    try:
        from vehiclemodels.init_mb import init_mb
        from vehiclemodels.utils.acceleration_constraints import acceleration_constraints
        from vehiclemodels.utils.steering_constraints import steering_constraints
        from vehiclemodels.vehicle_dynamics_mb import vehicle_dynamics_mb
        from vehiclemodels.vehicle_parameters import setup_vehicle_parameters
    except ImportError as error:
        advice = "pip install 'split-cli[test]'"
        raise SplitError("commonroad-vehicle-models is not installed", advice=advice) from error
    return MultiBody(
        _plain(setup_vehicle_parameters(vehicle_id=number)),
        vehicle_dynamics_mb,
        init_mb,
        steering_constraints,
        acceleration_constraints,
    )


def _plain(parameters) -> SimpleNamespace:
    """Return the package's configuration object as plain attributes, which are faster to read."""
    entries = parameters.items() if hasattr(parameters, "items") else vars(parameters).items()
    plain = {}
    for key, value in entries:
        plain[key] = value if isinstance(value, int | float | str | None) else _plain(value)
    return SimpleNamespace(**plain)


class _Driver:
    """Holds the line by the curvature ahead and the way back to it, and a speed by proportional acceleration."""

    def __init__(self, track: Track, speed: np.ndarray, wheelbase: float, rng: np.random.Generator) -> None:
        self.track, self.speed, self.wheelbase = track, speed, wheelbase
        self.s = 0.0
        self.grip = 8.5
        self.unrest = rng.standard_normal(4)

    def inputs(self, x: list[float], t: float) -> tuple[float, float]:
        """Return the wanted steer angle [rad] and acceleration [m/s^2]."""
        track = self.track
        count = len(track.x)
        near = (int(self.s / track.spacing) + np.arange(-10, 60)) % count
        at = near[np.argmin((track.x[near] - x[_AT.X]) ** 2 + (track.y[near] - x[_AT.Y]) ** 2)]
        self.s = at * track.spacing
        side = np.cos(track.direction[at]) * (x[_AT.Y] - track.y[at]) - np.sin(track.direction[at]) * (
            x[_AT.X] - track.x[at]
        )
        course = x[_AT.yaw] + np.arctan2(x[_AT.vy], x[_AT.vx]) - track.direction[at]
        course = (course + np.pi) % (2.0 * np.pi) - np.pi
        reach = max(_LOOK_AHEAD * x[_AT.vx], 4.0)
        ahead = (at + int(0.3 * reach / track.spacing)) % count
        curvature = track.curvature[ahead] - 2.0 * (np.sin(course) * reach + side) / reach**2
        understeer = 0.0005 * x[_AT.vx] ** 2 * curvature
        wanted = np.arctan(self.wheelbase * curvature) + understeer
        wanted += 0.3 * self.wheelbase / x[_AT.vx] * (x[_AT.vx] * curvature - x[_AT.r])
        wanted += 0.003 * np.sin(2.1 * t + self.unrest[0]) * np.sin(5.3 * t + self.unrest[1])
        there = (at + int(0.3 * x[_AT.vx] / track.spacing)) % count
        goal = self.speed[there] * (1.0 + 0.02 * np.sin(0.35 * t + self.unrest[2]))
        # What turning leaves of the grip; driven rear wheels and braked ones would spin the car otherwise.
        left = np.sqrt(max(0.03, 1.0 - (x[_AT.vx] * x[_AT.r] / self.grip) ** 2))
        return float(wanted), float(np.clip(1.6 * (goal - x[_AT.vx]), -0.8 * self.grip * left, 0.4 * self.grip * left))


def _run(car: MultiBody, inputs, speed: float, seconds: float, pose: tuple[float, float, float]):
    """Integrate with RK4 at 2 ms; inputs(x, t) gives steer angle and acceleration; returns samples at 100 Hz."""
    p = car.parameters
    x = np.array(car.initial([pose[0], pose[1], 0.0, speed, pose[2], 0.0, 0.0], p), dtype=float)
    rows = []
    rate = acceleration = 0.0

    def rates(x: np.ndarray) -> np.ndarray:
        with np.errstate(all="ignore"):  # a wheel in the air; the check for a lost car speaks
            return np.array(car.derivative(list(x), [rate, acceleration], p))

    for k in range(int(seconds / _STEP)):
        if _is_lost(x):
            raise SplitError(f"the multi-body car was lost at {k * _STEP:.1f} s", advice="Drive it less hard.")
        if k % _KEEP == 0:
            wanted, asked = inputs(x, k * _STEP)
            # The car's steering is a rate; it reaches the wanted angle in two samples unless its limit is met.
            rate = car.steering_limit(x[_AT.delta], (wanted - x[_AT.delta]) / (2 * _KEEP * _STEP), p.steering)
            acceleration = car.acceleration_limit(x[_AT.vx], asked, p.longitudinal)
        now = rates(x)
        if k % _KEEP == 0:
            ax, ay = now[_AT.vx] - x[_AT.vy] * x[_AT.r], now[_AT.vy] + x[_AT.vx] * x[_AT.r]
            rows.append(
                [
                    k * _STEP,
                    x[_AT.X],
                    x[_AT.Y],
                    x[_AT.yaw],
                    x[_AT.vx],
                    x[_AT.vy],
                    x[_AT.r],
                    car.mass * p.R_w * acceleration,
                    x[_AT.delta],
                    ax,
                    ay,
                ]
            )
        k2 = rates(x + 0.5 * _STEP * now)
        k3 = rates(x + 0.5 * _STEP * k2)
        k4 = rates(x + _STEP * k3)
        x = x + _STEP / 6.0 * (now + 2.0 * k2 + 2.0 * k3 + k4)
        # The package forbids wheels to turn backwards by altering the list it is given, which is a copy here.
        x[_AT.spins] = np.maximum(x[_AT.spins], 0.0)
    table = np.array(rows).T
    names = ("t", "X", "Y", "yaw", "vx", "vy", "r", "T", "delta", "ax", "ay")
    columns = dict(zip(names, table, strict=True))
    return columns


def _is_lost(x: np.ndarray) -> bool:
    """Return whether the car has stopped, slides sideways, turns faster than tyres can make it, or has tipped."""
    vx, vy, r = x[_AT.vx], x[_AT.vy], x[_AT.r]
    return not np.isfinite(x).all() or vx < 2.0 or abs(vy) > 0.6 * vx or abs(vx * r) > _MOST_TURNING


def _drive(columns: dict[str, np.ndarray], name: str, rng: np.random.Generator | None) -> Drive:
    noisy = columns
    if rng is not None:
        noisy = {c: v + _NOISE.get(c, 0.0) * rng.standard_normal(len(v)) for c, v in columns.items()}
    noise = tuple(estimate_noise(c, noisy[c], [(0, len(noisy["t"]))]) for c in _NOISE)
    kinds = {c: "measured" for c in _NOISE} | {"T": "command", "delta": "measured"}
    length = len(columns["t"])
    # The acceleration asked for is stepped every sample; the steer angle is a state of the car.
    between = {"T": "held", "delta": "continuous"}
    metadata = DriveMetadata(kinds=kinds, noise=noise, between=between)
    return Drive(name, noisy, np.zeros(length, dtype=np.int32), 0.01, metadata)


def hard_drive(
    car: MultiBody,
    track: Track,
    *,
    lateral: float,
    braking: float,
    seconds: float,
    seed: int,
    name: str = "real",
    noisy: bool = True,
) -> Drive:
    """Return a drive round a track with peaks of so many m/s^2 across and in braking, with sensor noise or not."""
    count = len(track.x)
    speed = np.minimum(np.sqrt(lateral / np.maximum(np.abs(track.curvature), 1e-4)), 32.0)
    for i in range(2 * count, 0, -1):
        here, before = i % count, (i - 1) % count
        speed[before] = min(speed[before], np.sqrt(speed[here] ** 2 + 2.0 * braking * track.spacing))
    rng = np.random.default_rng([seed, 5])
    driver = _Driver(track, speed, float(car.parameters.a + car.parameters.b), rng)
    pose = (float(track.x[0]), float(track.y[0]), float(track.direction[0]))
    columns = _run(car, driver.inputs, 0.8 * float(speed[0]), seconds, pose)
    return _drive(columns, name, rng if noisy else None)


def _turn(car: MultiBody, seed: int, side: float) -> Drive:
    """Return a turn at 20 m/s in which the steer angle grows up to 5 m/s^2; `side` is 1 to the left."""
    lateral, seconds, wheelbase = 5.0, 25.0, float(car.parameters.a + car.parameters.b)
    last = side * (wheelbase * lateral / 400.0 + 0.001 * lateral)

    def inputs(x: list[float], t: float) -> tuple[float, float]:
        return last * min(1.0, t / (0.85 * seconds)), 1.5 * (20.0 - x[_AT.vx])

    return _drive(_run(car, inputs, 20.0, seconds, (0.0, 0.0, 0.0)), "turn", np.random.default_rng([seed, 6]))


def gentle_drives(car: MultiBody, seed: int) -> list[Drive]:
    """Return gentle tests: turns to either side, a slalom, driving and braking straight ahead."""
    drives = [_turn(car, seed, 1.0), _turn(car, seed + 1, -1.0)]
    rng = np.random.default_rng([seed, 8])

    def slalom(x: list[float], t: float) -> tuple[float, float]:
        return 0.02 * np.sin(2.0 * np.pi * (0.2 + 0.04 * t) * t), 1.5 * (20.0 - x[_AT.vx])

    def pedals(x: list[float], t: float) -> tuple[float, float]:
        return 0.0, (1.5, 0.0, -2.0, 0.0, 2.5, -1.0)[int(t / 3.0) % 6]

    for inputs, speed, seconds in ((slalom, 20.0, 20.0), (pedals, 15.0, 30.0)):
        drives.append(_drive(_run(car, inputs, speed, seconds, (0.0, 0.0, 0.0)), "test", rng))
    return drives


def calibrated_vehicle(car: MultiBody, drives: list[Drive]) -> Vehicle:
    """Return the single track calibrated to gentle drives; geometry, masses and splits are the package's."""
    p = car.parameters
    wheelbase, inertia = float(p.a + p.b), float(p.I_z)
    load = car.mass * 9.81
    most = float(car.mass * p.R_w * p.longitudinal.a_max)
    start = Vehicle(
        name="multibody",
        mass=car.mass,
        yaw_inertia=inertia,
        cg_to_front_axle=float(p.a),
        cg_to_rear_axle=float(p.b),
        wheel_radius=float(p.R_w),
        drive_split_front=float(p.T_se),
        brake_split_front=float(p.T_sb),
        front_tire=MagicFormula(10.0, 1.4, float(load * p.b / wheelbase)),
        rear_tire=MagicFormula(10.0, 1.4, float(load * p.a / wheelbase)),
        max_torque=most,
        max_brake_torque=most,
        friction_coefficient=float(p.tire.p_dy1),
    )
    runs = [
        MotionRun(drive.period, *(drive[c] for c in ("vx", "vy", "r")), T=drive["T"], delta=drive["delta"])
        for drive in drives
    ]
    return calibrate_vehicle(runs, start, CalibrationSettings(draws=0)).vehicle
