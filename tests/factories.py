"""Cars, drives and trained sets made in memory, for any test that needs one quickly."""

import json
import pickle
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import lru_cache, wraps
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pyarrow as pa

from split_cli.learning.cells import learn
from split_cli.learning.features import FeatureSet, parse_features
from split_cli.learning.kernel import OUTPUTS, Kernel
from split_cli.learning.labels import Labels
from split_cli.learning.region import Grid, Region, z2_grid
from split_cli.learning.training_set import TrainingSet, content_digest, write_set
from split_cli.logs.drive import Drive, write_drive
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.flow import Flow
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.parameters import Vehicle, write_vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.tire import MagicFormula


def road_car(**changes: object) -> Vehicle:
    """Return a car of 1.5 t, all numbers plausible."""
    values = {
        "name": "test car",
        "mass": 1500.0,
        "yaw_inertia": 2600.0,
        "cg_to_front_axle": 1.25,
        "cg_to_rear_axle": 1.45,
        "wheel_radius": 0.31,
        "drive_split_front": 0.4,
        "brake_split_front": 0.66,
        "front_tire": MagicFormula(11.0, 1.45, 7900.0),
        "rear_tire": MagicFormula(12.5, 1.45, 6800.0),
        "max_torque": 2500.0,
        "max_brake_torque": 4000.0,
        "rolling_resistance_front": 90.0,
        "rolling_resistance_rear": 80.0,
        "drag_coefficient": 0.42,
    }
    return Vehicle(**{**values, **changes})


def remembered(make: Callable[..., Drive]) -> Callable[..., Drive]:
    """Let a maker of drives make each once in a process, by what it is given; its callers get copies."""

    @lru_cache(maxsize=64)
    def made(given: bytes) -> Drive:
        values, named = pickle.loads(given)
        return make(*values, **named)

    @wraps(make)
    def maker(*values: object, **named: object) -> Drive:
        try:
            drive = made(pickle.dumps((values, named)))
        except (pickle.PicklingError, AttributeError):  # a function that has no name of its own
            return make(*values, **named)
        return replace(
            drive, columns={name: column.copy() for name, column in drive.columns.items()}, segment=drive.segment.copy()
        )

    return maker


class MissingForce(Term):
    """Forces the nominal model lacks, as a truth to be found: constant ones, and grip lost at the front."""

    id = "missing_force"
    units: ClassVar = {"front_lateral": "N", "front_grip_loss": "1"}

    def lateral(self, flow: Flow) -> None:
        """Alter the front axle's lateral force."""
        kept = 1.0 - self.parameters.get("front_grip_loss", 0.0)
        flow.front.lateral_force = kept * flow.front.lateral_force + self.parameters.get("front_lateral", 0.0)


@remembered
def make_drive(
    seed: int = 0,
    segments: int = 100,
    seconds: float = 4.0,
    period: float = 0.02,
    *,
    vehicle: Vehicle | None = None,
    terms: Sequence[Term] = (),
    name: str = "made.parquet",
    knot: float = 0.2,
) -> Drive:
    """Return a drive of `segments` runs of a single track with `terms` or the vehicle's, driven at random.

    Inputs are linear between knots `knot` seconds apart, so that the same motion can be recorded with any period
    that divides it. Integrated with steps of 2.5 ms: off by 1e-7 at most, where torque changes its sign.
    """
    vehicle = vehicle or road_car()
    model = SingleTrack(vehicle, tuple(terms) or None)
    rng = np.random.default_rng(seed)
    speed = rng.uniform(8.0, 28.0, segments)
    knots = round(seconds / knot) + 1
    steer = rng.normal(0.0, 0.6, (segments, knots)) * np.minimum(0.1, 8.0 * vehicle.wheelbase / speed**2)[:, None]
    torque = rng.uniform(-0.6, 0.7, (segments, knots)) * vehicle.max_torque
    fine = np.linspace(0.0, knots - 1.0, round(seconds / period) + 1)
    steer = np.array([np.interp(fine, np.arange(knots), row) for row in steer])
    torque = np.array([np.interp(fine, np.arange(knots), row) for row in torque])
    state = np.stack([speed, np.zeros(segments), np.zeros(segments)], axis=1)
    states, memory = [state], None
    for k in range(len(fine) - 1):
        window = slice(k, k + 2)
        state, memory = integrate_with_memory(
            model, state, torque[:, window], steer[:, window], period, round(period / 2.5e-3), Situation(states=memory)
        )
        states.append(state)
    velocity = np.stack(states, axis=1)
    number = np.repeat(np.arange(segments), len(fine))
    columns = {
        "t": np.tile(np.arange(len(fine)) * period, segments) + number * (seconds + 1.0),
        **{channel: velocity[:, :, i].ravel() for i, channel in enumerate(("vx", "vy", "r"))},
        "T": torque.ravel(),
        "delta": steer.ravel(),
    }
    return Drive(name, columns, number.astype(np.int32), period, sha256=f"{seed:064d}")


def one_run(columns: dict[str, np.ndarray], period: float, name: str = "drive", **about: Any) -> Drive:
    """Return a drive of one run, from t = 0 unless columns say so; v_y, r, T and delta are 0 if not given."""
    count = len(columns["vx"])
    still = {channel: np.zeros(count) for channel in ("vy", "r", "T", "delta")}
    whole = {"t": period * np.arange(count), **still, **columns}
    return Drive(name, whole, np.zeros(count, dtype=np.int32), period, **about)


def write_garage(folder: Path, drives: int = 2, **made: object) -> Path:
    """Write a car, a heavier one, and drives ``d0.parquet``, ... of the first, as `make_drive` makes them."""
    write_vehicle(road_car(), folder / "car.yaml")
    write_vehicle(road_car(mass=1600.0), folder / "other.yaml")
    for number in range(drives):
        write_drive(make_drive(number, name=f"d{number}.parquet", **made), folder / f"d{number}.parquet")
    return folder


def smooth_residual(z: np.ndarray) -> np.ndarray:
    """Return a smooth function of the features, shape (N, 3): about 0.5 in size, odd and even parts."""
    a, b, c = z[:, 0], z[:, 1], z[:, -1]
    return np.stack(
        [0.5 * np.sin(2.0 * c) - 8.0 * a * b, 0.6 * np.tanh(9.0 * a) - 2.0 * b + 0.1 * c, 4.0 * (a - b) * (1 + c)],
        axis=1,
    )


def valid_features(vehicle: Vehicle, region: Region, count: int, seed: int, spread: float = 0.5) -> np.ndarray:
    """Return random z2 features inside the valid region, shape (count, 3), denser near the origin."""
    rng = np.random.default_rng(seed)
    found = np.empty((0, 3))
    while len(found) < count:
        z = rng.normal(0.0, spread, (4 * count, 3)) * [region.alpha_max, region.alpha_max, 1.0]
        inside = region.inside_slip(z[:, 0], z[:, 1]) & region.inside_slip_difference(z[:, 0], z[:, 1])
        inside &= region.inside_ellipse(vehicle, z[:, 0], z[:, 1], z[:, 2] * vehicle.max_torque)
        inside &= (z[:, 2] <= 1.0) & (z[:, 2] >= -vehicle.max_brake_torque / vehicle.max_torque)
        found = np.concatenate([found, z[inside]])
    return found[:count]


def make_labels(
    z: np.ndarray,
    y: np.ndarray,
    vehicle: Vehicle | None = None,
    features: FeatureSet | str = "z2",
    *,
    name: str = "made.parquet",
    period: float = 0.05,
    reason: np.ndarray | None = None,
) -> Labels:
    """Return labels with given features and rates, one a window of one sample."""
    vehicle = vehicle or road_car()
    features = parse_features(features) if isinstance(features, str) else features
    count = len(z)
    return Labels(
        drive=name,
        sha256="0" * 64,
        vehicle_digest=vehicle.digest(),
        features=features,
        region=Region.of(vehicle),
        horizon=period,
        window=1,
        plain=False,
        start_time=0.0,
        duration=count * period,
        t=np.arange(count) * period,
        row=np.arange(count),
        segment=np.zeros(count, dtype=np.int32),
        z=np.ascontiguousarray(z, dtype=float),
        y=np.ascontiguousarray(y, dtype=float),
        reason=np.zeros(count, dtype=np.int8) if reason is None else reason,
    )


def make_training_set(
    seed: int = 0,
    points: int = 3000,
    features: str = "z2",
    *,
    residual: Callable[[np.ndarray], np.ndarray] = smooth_residual,
    noise: float = 0.02,
    length_scale_cells: float = 2.0,
    capacity: int = 10,
    vehicle: Vehicle | None = None,
) -> TrainingSet:
    """Return a set learned, by the real update, from `points` random samples of `residual`.

    The set is a little smaller than `points`: 3,000 random z2 samples leave 2,912 in 1,154 cells. `noise` is
    the standard deviation of the labels, and of the kernel's noise; the kernel's signal variance is the mean
    square of the labels.
    """
    vehicle = vehicle or road_car()
    region = Region.of(vehicle)
    rng = np.random.default_rng(seed)
    names = parse_features(features)
    if names.is_z2:
        z = valid_features(vehicle, region, points, seed)
        grid = z2_grid(vehicle, region)
    else:
        dimension = len(names.names)
        z = rng.normal(0.0, 0.3, (points, dimension))
        spread = np.quantile(z, 0.999, axis=0) - np.quantile(z, 0.001, axis=0)
        unbounded = (np.inf,) * dimension
        grid = Grid(tuple((spread / 18.0).tolist()), tuple(-np.array(unbounded)), unbounded)
    y = residual(z) + noise * rng.normal(size=(points, 3))
    kernel = Kernel(length_scale_cells * np.array(grid.edges), np.mean(y**2, axis=0), np.full(3, noise**2))
    return learn([make_labels(z, y, vehicle, names)], vehicle=vehicle, grid=grid, kernel=kernel, capacity=capacity)


def write_forged_set(training_set: TrainingSet, path: Path, change: Callable[[dict[str, Any]], None]) -> None:
    """Write a set whose header was changed before its digest was taken: right by its own account."""
    write_set(training_set, path)
    with pa.ipc.open_file(path.read_bytes()) as reader:
        described = json.loads(reader.schema.metadata[b"split"])
        described.pop("content_sha256")
        change(described)
        described["content_sha256"] = content_digest(described, training_set)
        schema = reader.schema.with_metadata({b"split": json.dumps(described).encode()})
        batches = [reader.get_batch_with_custom_metadata(number) for number in range(reader.num_record_batches)]
    with pa.ipc.new_file(str(path), schema) as writer:
        for batch, beside in batches:
            writer.write_batch(batch.replace_schema_metadata(schema.metadata), custom_metadata=beside)


def kernel_to_yaml(kernel: Kernel, features: FeatureSet) -> str:
    """Return a file of hyperparameters as `learning.kernel_file.read_kernel` reads it."""
    names = {"length_scales": features.names, "signal_variance": OUTPUTS, "noise_variance": OUTPUTS}
    return json.dumps({key: dict(zip(of, getattr(kernel, key).tolist(), strict=True)) for key, of in names.items()})
