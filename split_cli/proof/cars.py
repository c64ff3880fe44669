"""The cars of the proof: varied about the plant's, bare or rich in physics, each with its vehicle file."""

from dataclasses import dataclass, fields, replace

import numpy as np

from split_cli.plant.cars import CARS, CarParameters
from split_cli.plant.maneuvers import CALIBRATION_TESTS, build_maneuver, run_maneuver
from split_cli.plant.sensors import sensors_of
from split_cli.plant.tire import TireParameters, tire_force
from split_cli.proof.recordings import Alignment, alignment_of, command_channels
from split_cli.proof.windows import errors_of_terms
from split_cli.vehicle.calibration.calibrate import CalibrationSettings, calibrate_vehicle
from split_cli.vehicle.calibration.samples import MotionRun
from split_cli.vehicle.effects.actuators import SteerDelay
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import MagicFormula

# A shorter relaxation would outrun the plant's integration step at top speed [m].
_SHORT_RELAXATION = {"road_car": 0.027, "f1tenth_car": 0.004, "formula_car": 0.018}
# Of the nominal load, where the cornering stiffness would stop growing: far away.
_LINEAR_IN_LOAD = 40.0


@dataclass(frozen=True)
class CarOfProof:
    """A car without the effect, and the vehicle file calibrated to it."""

    car: CarParameters
    vehicle: Vehicle
    alignment: Alignment  # how the logger's clock of the commands was aligned
    noise: np.ndarray  # (3,): sensor noise of v_x, v_y, r [m/s], [m/s], [rad/s]


def varied_car(name: str, rng: np.random.Generator) -> CarParameters:
    """Return a car about the plant's of that name: mass, inertia, CG, tyres and splits differ by some per cent."""
    car = CARS[name]
    size = np.exp(rng.normal(0.0, 0.06, 6))
    shift = rng.uniform(-0.03, 0.03) * car.wheelbase
    return replace(
        car,
        mass=car.mass * size[0],
        yaw_inertia=car.yaw_inertia * size[0] * size[1],
        cg_to_front_axle=car.cg_to_front_axle - shift,
        cg_to_rear_axle=car.cg_to_rear_axle + shift,
        drag_area=car.drag_area * size[2],
        front_tire=_varied_tire(car.front_tire, size[3], size[5]),
        rear_tire=_varied_tire(car.rear_tire, size[4], size[5]),
        brake_split_front=float(np.clip(car.brake_split_front + rng.uniform(-0.05, 0.05), 0.0, 1.0)),
        command_ramp=1.0,
    )


def _varied_tire(tire: TireParameters, stiffness: float, peak: float) -> TireParameters:
    return replace(tire, p_ky1=tire.p_ky1 * stiffness, p_dy1=tire.p_dy1 * peak, p_dx1=tire.p_dx1 * peak)


def bare(car: CarParameters) -> CarParameters:
    """Return the car with all that the nominal model leaves out taken away, as far as a double track lets one.

    No combined slip, load transfer, lift, toe or Ackermann; narrow tracks, light wheels, prompt actuators, short
    relaxation, and a tyre whose steady curve has the nominal's form and grows in proportion to load. What remains
    is stated by an answer's `base_effect_to_noise`.
    """

    def tire(source: TireParameters, load: float) -> TireParameters:
        change = load / source.nominal_load - 1.0
        slope = source.p_ky1 * np.sin(2.0 * np.arctan(load / (source.p_ky2 * source.nominal_load)))
        linear = 2.0 * np.arctan(load / (_LINEAR_IN_LOAD * source.nominal_load))
        return replace(
            source,
            combined_slip=0.0,
            relaxation_lateral=_SHORT_RELAXATION[car.name],
            p_dy1=source.p_dy1 + source.p_dy2 * change,
            p_dy2=0.0,
            p_ey1=0.0,
            p_ey2=0.0,
            p_ky1=slope / np.sin(linear),
            p_ky2=_LINEAR_IN_LOAD,
        )

    return replace(
        car,
        pitch_transfer=0.0,
        cg_height=1e-3 * car.cg_height,
        roll_center_front=0.0,
        roll_center_rear=0.0,
        track_front=0.2 * car.track_front,
        track_rear=0.2 * car.track_rear,
        ackermann_fraction=0.0,
        toe_front=0.0,
        toe_rear=0.0,
        side_area=0.0,
        downforce_area_front=0.0,
        downforce_area_rear=0.0,
        wheel_inertia_front=0.05 * car.wheel_inertia_front,
        wheel_inertia_rear=0.05 * car.wheel_inertia_rear,
        differential_locking_front=0.0,
        differential_locking_rear=0.0,
        steer_lag=6e-4,
        steer_rate=30.0,
        drive_lag=6e-4,
        torque_rate=1e4 * car.max_torque,
        front_tire=tire(car.front_tire, 0.5 * car.static_load_front),
        rear_tire=tire(car.rear_tire, 0.5 * car.static_load_rear),
    )


def rich(car: CarParameters, rng: np.random.Generator) -> CarParameters:
    """Return the car between bare and the plant's own: physics that the nominal model lacks, in a random measure.

    Simulation and real car have it in common. The tyres depend on load as the plant's do.
    """
    measure = rng.uniform(0.1, 0.6)
    plain = bare(car)

    def between(source, target):
        changes = {}
        for field in fields(source):
            start, end = getattr(source, field.name), getattr(target, field.name)
            if isinstance(start, float) and start != end:
                changes[field.name] = start + measure * (end - start)
        return changes

    def tire(source: TireParameters, target: TireParameters) -> TireParameters:
        kept = {name: getattr(target, name) for name in ("p_ky1", "p_ky2", "p_dy1", "p_dy2")}
        return replace(source, **{**between(source, target), **kept})

    return replace(
        plain,
        **{
            **between(plain, car),
            "steer_lag": rng.uniform(6e-4, 5e-3),
            "steer_rate": 30.0,
            "drive_lag": rng.uniform(6e-4, 0.01),
            "torque_rate": 1e4 * car.max_torque,
            "front_tire": tire(plain.front_tire, car.front_tire),
            "rear_tire": tire(plain.rear_tire, car.rear_tire),
        },
    )


def build_car(car: CarParameters, seed: int) -> CarOfProof:
    """Calibrate a vehicle file to a car by its gentle tests, circles up to nine tenths of its grip.

    Mass, geometry, inertia, splits and the tyres' peaks (a tyre's data sheet) are given; the tyres' shape and
    slope, drag and rolling resistance are calibrated from noisy recordings; then all of them, with peaks, inertia,
    rolling radius and the commands' clock, are polished by prediction errors on the exact tests, since without the
    effect a bare car's file must be right.
    """
    rng = np.random.default_rng([seed, 31])
    channels = sensors_of(car.name)[0].channels
    noise = np.array([channels[name].noise for name in ("vx", "vy", "r")])
    alignment = alignment_of(car)
    motions, runs = [], []
    for number, name in enumerate(CALIBRATION_TESTS):
        test = build_maneuver(name, car, 0.9 if "radius" in name else 0.35)
        run = run_maneuver(car, test, seed=seed + number, sample_period=1e-2)
        motion = np.stack([run.channel(c) for c in ("vx", "vy", "r")])
        torque, steer = command_channels(run, run.t, alignment)
        noisy = motion + noise[:, None] * rng.standard_normal(motion.shape)
        motions.append(MotionRun(1e-2, *noisy, T=torque, delta=steer))
        runs.append(_columns(motion, torque, steer))
    settings = CalibrationSettings(draws=0, max_longitudinal_acceleration=20.0)
    vehicle = calibrate_vehicle(motions, _starting_vehicle(car), settings).vehicle
    return CarOfProof(car, *_polished(vehicle, alignment, runs, noise), noise)


def _columns(motion: np.ndarray, torque: np.ndarray, steer: np.ndarray) -> dict[str, np.ndarray]:
    nothing = np.zeros(len(torque))
    names = ("vx", "vy", "r", "T", "delta", "t", "s", "yaw")
    return dict(zip(names, (*motion, torque, steer, nothing, nothing, nothing), strict=True))


def _polished(
    vehicle: Vehicle, alignment: Alignment, runs: list[dict[str, np.ndarray]], noise: np.ndarray
) -> tuple[Vehicle, Alignment]:
    """Return the vehicle and alignment with the least squared 0.05 s prediction error over the tests."""
    from scipy.optimize import least_squares

    def changed(factors: np.ndarray) -> Vehicle:
        values = factors.tolist()
        front, rear = vehicle.front_tire, vehicle.rear_tire
        return replace(
            vehicle,
            front_tire=MagicFormula(front.B * values[0], front.C * values[1], front.D * values[2]),
            rear_tire=MagicFormula(rear.B * values[3], rear.C * values[4], rear.D * values[5]),
            wheel_radius=vehicle.wheel_radius * values[6],
            yaw_inertia=vehicle.yaw_inertia * values[7],
        )

    def residuals(values: np.ndarray) -> np.ndarray:
        delay = [SteerDelay({"delay": 1e-3 * (values[8] - 1.0)})]
        return np.concatenate([(errors_of_terms(run, changed(values), delay) / noise).ravel() for run in runs])

    # A curve with C of 2 or more would change its sign at large slip; the rest may move by a half.
    most = np.full(9, 1.5)
    most[[1, 4]] = 1.95 / np.array([vehicle.front_tire.C, vehicle.rear_tire.C])
    most[8] = 11.0
    least = np.where(np.arange(9) == 8, -9.0, 0.5)
    start = np.minimum(np.ones(9), 0.99 * most)
    values = least_squares(residuals, start, bounds=(least, most), diff_step=1e-4, max_nfev=8).x
    return changed(values), Alignment(alignment.torque, alignment.steer + 1e-3 * float(values[8] - 1.0))


def _starting_vehicle(car: CarParameters) -> Vehicle:
    def published(tire: TireParameters, load: float) -> MagicFormula:
        angles = np.linspace(0.0, 0.6, 301)
        return MagicFormula(10.0, 1.3, float(2.0 * tire_force(tire, 0.0, angles, load / 2.0)[1].max()))

    given = (
        "mass",
        "yaw_inertia",
        "cg_to_front_axle",
        "cg_to_rear_axle",
        "wheel_radius",
        "max_torque",
        "max_brake_torque",
        "drive_split_front",
        "brake_split_front",
    )
    return Vehicle(
        name="car",
        **{name: float(getattr(car, name)) for name in given},
        front_tire=published(car.front_tire, car.static_load_front),
        rear_tire=published(car.rear_tire, car.static_load_rear),
        rolling_resistance_front=float(1e-3 * car.static_load_front),
        rolling_resistance_rear=float(1e-3 * car.static_load_rear),
        drag_coefficient=float(0.5 * car.air_density * car.drag_area),
        origins={"front_tire.D": "published", "rear_tire.D": "published"},
    )
