"""A plant's car with its road, wind and instruments: everything an effect may change."""

from dataclasses import dataclass, replace

import numpy as np

from split_cli.plant.cars import CarParameters
from split_cli.plant.drivers import DriverStyle
from split_cli.plant.faults import SOUND, Faults
from split_cli.plant.replay import predict_windows, recorded_motion
from split_cli.plant.road import Road
from split_cli.plant.simulation import Trajectory, drive_laps
from split_cli.plant.tracks import Track
from split_cli.proof.recordings import SensorFault, exact_motion
from split_cli.proof.windows import FIRST, HORIZON

SAMPLE = 2e-3


@dataclass(frozen=True)
class ProofWorld:
    """A car, the car its driver believes to sit in, its faults, its sensors, the track and what surrounds it."""

    car: CarParameters
    track: Track
    believed: CarParameters
    road: Road = Road()
    faults: Faults = SOUND
    sensor: SensorFault = SensorFault()


@dataclass(frozen=True)
class Trip:
    """Who drives, how hard, how long [s], and the seed of his unrest."""

    style: DriverStyle
    aggressiveness: float
    duration: float
    seed: int


def drive(world: ProofWorld, trip: Trip, *, duration: float | None = None, sample_period: float = SAMPLE) -> Trajectory:
    """Drive a trip.

    Raises
    ------
    SplitError
        If the car left the track or spun.
    """
    return drive_laps(
        world.car,
        world.track,
        trip.style,
        aggressiveness=trip.aggressiveness,
        duration=duration or trip.duration,
        seed=trip.seed,
        road=world.road,
        faults=world.faults,
        believed=world.believed,
        sample_period=sample_period,
    )


def effect_error(run: Trajectory, world: ProofWorld, without: ProofWorld) -> np.ndarray:
    """Return what the world without the effect gets wrong over 0.05 s along a run of the world with it.

    Returns
    -------
    ndarray, shape (K, 3)
        Recorded minus predicted v_x, v_y, r at the ends of the windows from `windows.FIRST` on, both as the
        sensors report them, without noise.
    """
    seen = recorded_motion(run).copy()
    if world.sensor != without.sensor:
        seen[:, 3:6] = exact_motion(run, world.sensor, run.t)[:, 3:6]
    predicted = predict_windows(run, without.car, without.road, motion=seen, horizon=HORIZON)
    window = int(round(HORIZON / SAMPLE))
    error = seen[window::window, 3:6][: len(predicted)] - predicted
    return error[int(round(FIRST / HORIZON)) :]


def road_of(track: Track, road: Road, **tables: np.ndarray) -> Road:
    """Return a road with tables along the lap, shape (P,) over s = 0 to the lap's length, closed."""
    count = len(next(iter(tables.values())))
    flat = {
        name: np.full(count, float(getattr(road, name)[0])) if len(getattr(road, name)) == 1 else getattr(road, name)
        for name in ("friction", "grade", "bank")
    }
    return replace(road, spacing=track.length / count, closed=True, **{**flat, **tables})
