"""The plant with its sensors, as a controller sees it: commands in, measurements out, at 100 Hz."""

from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.control.path import Path
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate
from split_cli.plant import _compiled
from split_cli.plant.cars import CarParameters
from split_cli.plant.dynamics import Surroundings, advance
from split_cli.plant.sensors import ChannelSpec, Reading, sensors_of
from split_cli.plant.simulation import initial_state
from split_cli.plant.tracks import Track

SAMPLE_PERIOD = 0.01
"""Sample period of the recorded drive, and of the command ramps [s]."""

_MEASURED = ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay")
_STATE = (_compiled.X, _compiled.Y, _compiled.YAW, _compiled.VX, _compiled.VY, _compiled.R)
#: Body width over track width [1]: a saloon of 1.54 m track is 1.77 m wide.
_BODY_OVER_TRACK = 1.15


def body_width(car: CarParameters) -> float:
    """Return the width of a car's body [m]: 1.15 times its wider track width."""
    return _BODY_OVER_TRACK * max(car.track_front, car.track_rear)


def body_ends(car: CarParameters) -> tuple[float, float]:
    """Return how far a car's bumpers are ahead of and behind its CG [m].

    Overhangs of 0.33 and 0.36 of the wheelbase, as of a saloon; no car of the plant has a body of its own.
    """
    return car.cg_to_front_axle + 0.33 * car.wheelbase, car.cg_to_rear_axle + 0.36 * car.wheelbase


def path_of(track: Track) -> Path:
    """Return a track of the plant as the reference path of a controller."""
    width = np.full(len(track.x), track.half_width)
    return Path(
        track.name, track.spacing, track.x, track.y, track.direction, track.curvature, width, width.copy(), True
    )


@dataclass
class World:
    """The simulated car on its road, driven by commands, with sensors of 100 Hz; its recording grows with time."""

    car: CarParameters
    path: Path  # the car starts on it
    speed: float  # at the start [m/s]
    start: float = 0.0  # arc length of the start [m]
    friction: float = 1.0  # of the road, against the tyres' own peak [1]
    seed: int | None = 0  # of the sensors' noise; None for exact sensors
    t: float = 0.0
    state: np.ndarray = field(init=False)
    rows: list[np.ndarray] = field(init=False, default_factory=list)
    truth: list[np.ndarray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        point = self.path.at(np.array([self.start]))
        x = initial_state(self.car, self.speed)
        x[_compiled.X], x[_compiled.Y], x[_compiled.YAW] = point.x[0], point.y[0], point.direction[0]
        x[_compiled.R] = self.speed * point.curvature[0]
        x[_compiled.STEER] = np.arctan(self.car.wheelbase * point.curvature[0])
        self.state = x
        self.torque, self.steer = 0.0, float(x[_compiled.STEER])
        self._rng = np.random.default_rng([0 if self.seed is None else self.seed, 4242])
        specs: dict[str, ChannelSpec] = {}
        for sensor in sensors_of(self.car.name):
            if sensor.name in ("state", "inertial"):
                for channel, spec in sensor.channels.items():
                    specs.setdefault(channel, spec)
        self.noise = np.array([0.0 if self.seed is None else specs[name].noise for name in _MEASURED])
        self.surroundings = Surroundings(friction=self.friction)
        self._record(np.zeros(2))

    def _record(self, specific_force: np.ndarray) -> None:
        exact = np.concatenate([self.state[list(_STATE)], specific_force])
        self.truth.append(np.concatenate([[self.t], exact, [self.torque, self.steer]]))
        seen = exact + self.noise * self._rng.standard_normal(len(exact))
        self.rows.append(np.concatenate([[self.t], seen, [self.torque, self.steer]]))

    @property
    def measured(self) -> np.ndarray:
        """[X, Y, yaw, v_x, v_y, r, T, delta] as last reported, shape (8,)."""
        row = self.rows[-1]
        return np.concatenate([row[1:7], row[9:11]])

    @property
    def exact(self) -> np.ndarray:
        """The same without noise."""
        row = self.truth[-1]
        return np.concatenate([row[1:7], row[9:11]])

    def drive(self, rates: np.ndarray, duration: float) -> None:
        """Advance the plant by `duration` [s] while T and delta change at `rates`, shape (2,) [N m/s], [rad/s]."""
        for _ in range(int(round(duration / SAMPLE_PERIOD))):
            torque = self.torque + 0.5 * rates[0] * SAMPLE_PERIOD
            steer = self.steer + 0.5 * rates[1] * SAMPLE_PERIOD
            # The ramp's middle: actuators lag by several times a sample, and see no more of it.
            self.state, outputs = advance(
                self.car, self.state, torque, steer, SAMPLE_PERIOD, surroundings=self.surroundings
            )
            self.torque += rates[0] * SAMPLE_PERIOD
            self.steer += rates[1] * SAMPLE_PERIOD
            self.t += SAMPLE_PERIOD
            self._record(outputs.specific_force)

    @property
    def period(self) -> float:
        """Of the recording [s]."""
        return SAMPLE_PERIOD

    def recording(self, first: int = 0, last: int | None = None, name: str = "race", *, exact: bool = False) -> Drive:
        """Return rows `first` to `last` as a drive; T and delta are commands, led in straight lines.

        With `exact` it is the motion itself, without what sensors add to it.
        """
        rows = np.array((self.truth if exact else self.rows)[first:last])
        columns = {"t": rows[:, 0]}
        columns |= {channel: rows[:, 1 + k] for k, channel in enumerate(_MEASURED)}
        columns |= {"T": rows[:, 9], "delta": rows[:, 10]}
        kinds = {channel: "measured" for channel in _MEASURED} | {"T": "command", "delta": "command"}
        noise = tuple(NoiseEstimate(c, float(s), float(s)) for c, s in zip(_MEASURED, self.noise, strict=True))
        origin = "simulated drive in closed loop, sensors on one clock; commands led in straight lines"
        return Drive(
            name,
            columns,
            np.zeros(len(rows), dtype=np.int32),
            SAMPLE_PERIOD,
            DriveMetadata(kinds=kinds, conversions=(origin,), noise=noise),
        )

    def readings(self, drive: Drive) -> tuple[Reading, ...]:
        """Return a drive as what its devices reported, one clock for all, for a log of messages."""
        found = []
        for sensor in sensors_of(self.car.name):
            if sensor.name in ("state", "inertial", "command"):
                channels = {name: spec for name, spec in sensor.channels.items() if name in drive}
                even = replace(sensor, rate=1.0 / SAMPLE_PERIOD, channels=channels)
                clock = drive["t"] - drive["t"][0]
                arrival = clock + sensor.latency
                found.append(Reading(even, clock, arrival, {name: drive[name] for name in channels}))
        return tuple(found)

    @property
    def spun(self) -> bool:
        """Whether the car moves more sideways than forward, or hardly at all."""
        vx, vy = self.state[_compiled.VX], self.state[_compiled.VY]
        return bool(abs(vy) > max(vx, 0.0) or not np.isfinite(self.state).all())
