"""Compare laws of a differential's moment with the moment in the project's simulated cars.

Example: ``python -m tests.studies.differential``. Each line is a car, the torque of its rear coupling over the
difference of wheel speeds, and how much of its grip the driver uses. A figure is the rms error of a law over the rms
moment, the law's parameters fitted to that moment. *Constant* is the law of ``slip`` with the stiffness of tyres that
do not slip across, with the load's part that a power of 3/4 gives.
"""

import argparse
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from scipy.optimize import least_squares

from split_cli.plant.cars import F1TENTH_CAR, FORMULA_CAR, ROAD_CAR, CarParameters
from split_cli.plant.drivers import find_driver
from split_cli.plant.simulation import Trajectory, drive_laps
from split_cli.plant.tracks import find_track
from split_cli.proof.cars import build_car
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.effects.search import cg_height
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack

_RUNS = (
    (ROAD_CAR, "handling", 300.0, 0.5),
    (ROAD_CAR, "handling", 300.0, 0.9),
    (ROAD_CAR, "handling", 60.0, 0.9),
    (FORMULA_CAR, "small", 30.0, 0.6),
    (FORMULA_CAR, "small", 30.0, 0.95),
    (F1TENTH_CAR, "f1tenth", 0.003, 0.6),
    (F1TENTH_CAR, "f1tenth", 0.003, 0.9),
)
_TERM = CATALOGUE["yaw_moment_differential"]
Law = Callable[[np.ndarray], np.ndarray]


def true_moment(run: Trajectory) -> np.ndarray:
    """Return the moment of the rear axle's coupling on the car [N m], shape (N,)."""
    car = run.car
    ahead = run.channel("wheel_speed_rr") - run.channel("wheel_speed_rl")
    return -car.track_rear / car.wheel_radius * car.differential_locking_rear * ahead


def laws(run: Trajectory, vehicle: Vehicle, damping: float) -> dict[str, tuple[Law, np.ndarray]]:
    """Return by name the moment [N m] as a function of parameters, and where their fit begins.

    Parameters are the logarithms of two ratios: damping over that of wheels that do not slip, slip stiffness over 0.1.
    """
    names = {"vx": "vx", "vy": "vy", "r": "r", "T": "T_actual", "delta": "delta_actual"}
    at = {name: run.channel(channel) for name, channel in names.items()} | {"yaw": 0.0, "t": 0.0, "s": 0.0}
    plain = SingleTrack(vehicle).flow(**at)

    def of_term(variant: str, parameters: Mapping[str, float]) -> np.ndarray:
        return SingleTrack(vehicle, [_TERM(parameters, variant)]).flow(**at).moment

    def constant(x: np.ndarray) -> np.ndarray:
        car = plain.vehicle
        limit = 0.1 * car.wheelbase**2 * sum(one.cornering_stiffness for one in coupled)
        side = (plain.front.lateral_force + plain.rear.lateral_force) / (car.mass * STANDARD_GRAVITY)
        spun = at["vx"] * force * 0.75 * cg_height(car) * side / limit
        return -(at["r"] - spun) / (np.exp(-x[0]) / damping + at["vx"] / limit)

    in_front = vehicle.drive_split_front > 0.0
    coupled = (vehicle.front_tire, vehicle.rear_tire) if in_front else (vehicle.rear_tire,)
    force = plain.rear.longitudinal_force + (plain.front.longitudinal_force if in_front else 0.0)

    def slip(variant: str) -> Law:
        return lambda x: of_term(
            variant,
            {"yaw_damping": damping * np.exp(x[0]), "slip_stiffness": 0.1 * np.exp(x[1]) if len(x) > 1 else 0.1},
        )

    return {
        "damping": (lambda x: of_term("", {"yaw_damping": damping * np.exp(x[0])}), np.zeros(1)),
        "driven": (lambda x: of_term("driven", {"yaw_damping": damping * np.exp(x[0])}), np.zeros(1)),
        "constant": (constant, np.zeros(1)),
        "slip, 0.1": (slip("slip"), np.zeros(1)),
        "slip": (slip("slip"), np.zeros(2)),
        "rear slip": (slip("rear slip"), np.zeros(2)),
    }


def errors(car: CarParameters, vehicle: Vehicle, track: str, share: float) -> dict[str, tuple[float, float, float]]:
    """Return by law its relative error, and the damping and slip stiffness over their expected values [1]."""
    run = drive_laps(car, find_track(track), find_driver("racer"), aggressiveness=share, sample_period=0.01)
    moment = true_moment(run)
    size = float(np.sqrt(np.mean(moment**2)))
    damping = car.differential_locking_rear * (car.track_rear / car.wheel_radius) ** 2
    # Scales of 0.03 to 0.4 over 0.1, and of a coupling between a hundredth and a locked axle.
    low, high = np.array([-4.6, np.log(0.3)]), np.array([9.2, np.log(4.0)])
    out = {}
    for name, (law, start) in laws(run, vehicle, damping).items():
        bounds = low[: len(start)], high[: len(start)]
        fit = least_squares(lambda x, law=law: (law(x) - moment) / size, start, bounds=bounds)
        factors = [*np.exp(fit.x), 1.0][:2]
        out[name] = float(np.sqrt(np.mean(fit.fun**2))), *factors
    return out


def main() -> None:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    header = False
    for plain, track, locking, share in _RUNS:
        car = replace(plain, differential_locking_rear=locking)
        found = errors(car, build_car(plain, 0).vehicle, track, share)
        if not header:
            print(f"| car, coupling [N m s/rad], share of grip | {' | '.join(found)} |\n|{'---|' * (1 + len(found))}")
            header = True
        cells = (f"{error:.3f} ({damping:.2f}, {stiffness:.2f})" for error, damping, stiffness in found.values())
        print(f"| {plain.name}, {locking:g}, {share:g} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
