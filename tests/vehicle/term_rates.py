"""Rates of a car with terms at independent states, and the plain axles written out again, to test terms with."""

import numpy as np

from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import road_car

CAR = road_car(max_brake_torque=6500.0, cg_height=0.55)
A, B = CAR.cg_to_front_axle, CAR.cg_to_rear_axle
G = 9.80665


def driving(count: int = 400, seed: int = 1) -> dict[str, np.ndarray]:
    """Independent states and inputs over a wide region, with place, yaw and time."""
    rng = np.random.default_rng(seed)
    return {
        "vx": rng.uniform(6.0, 45.0, count),
        "vy": rng.uniform(-2.0, 2.0, count),
        "r": rng.uniform(-0.8, 0.8, count),
        "T": rng.uniform(-5000.0, 2500.0, count),
        "delta": rng.uniform(-0.12, 0.12, count),
        "yaw": rng.uniform(-3.0, 3.0, count),
        "t": rng.uniform(0.0, 100.0, count),
        "s": rng.uniform(0.0, 400.0, count),
    }


def rates(at: dict[str, np.ndarray], *terms, car: Vehicle = CAR) -> np.ndarray:
    return np.stack(SingleTrack(car, terms).velocity_derivative(**at))


def term(name: str, variant: str = "", **parameters: float):
    return CATALOGUE[name](parameters, variant)


def forces(at: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """The plain axles, written out independently of the package."""
    alpha_f = at["delta"] - np.arctan((at["vy"] + A * at["r"]) / at["vx"])
    alpha_r = -np.arctan((at["vy"] - B * at["r"]) / at["vx"])
    kappa = np.where(at["T"] < 0, 0.66, 0.4)
    return {
        "alpha_f": alpha_f,
        "alpha_r": alpha_r,
        "fxf": kappa * at["T"] / 0.31 - 90.0,
        "fxr": (1 - kappa) * at["T"] / 0.31 - 80.0,
        "fyf": 7900.0 * np.sin(1.45 * np.arctan(11.0 * alpha_f)),
        "fyr": 6800.0 * np.sin(1.45 * np.arctan(12.5 * alpha_r)),
    }
