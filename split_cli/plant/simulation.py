"""A run of the plant: a driver or a script at the wheel, the exact states as result."""

from collections import namedtuple
from dataclasses import dataclass, field

import numpy as np

from split_cli.errors import SplitError
from split_cli.plant import _compiled, _loops_numba
from split_cli.plant._numbers import as_numbers
from split_cli.plant.cars import CarParameters
from split_cli.plant.drivers import (
    DriverStyle,
    SpeedProfile,
    driver_plan,
    driver_tables,
    grip_of,
    speed_profile,
    varied,
)
from split_cli.plant.faults import SOUND, Faults
from split_cli.plant.road import Road
from split_cli.plant.tracks import Track

STEP = 1e-3
CONTROL_PERIOD = 0.02
MOST_LAPS = 200  # of one run, which is kept in memory [1]

_PathTables = namedtuple("_PathTables", "spacing length turn x y direction curvature speed acceleration")
_ScriptTables = namedtuple("_ScriptTables", "torque steer speed acceleration")
_StopTables = namedtuple("_StopTables", "distance speed off_track")

_ENDINGS = {
    _loops_numba.LEFT_TRACK: "the car left the track",
    _loops_numba.SPUN: "the car spun",
    _loops_numba.NOT_FINITE: "the integration diverged",
    _loops_numba.OUT_OF_TIME: "the laps were not finished in time",
}


@dataclass(frozen=True)
class Script:
    """Commands over time, one entry a control period; NaN leaves the choice to the driver, inf holds the last."""

    torque: np.ndarray  # (K,): wheel torque [N m]
    steer: np.ndarray  # (K,): road-wheel angle [rad]
    # (K,): speed to follow where the torque is left to the driver [m/s]; NaN for the driver's own profile.
    speed: np.ndarray


@dataclass(frozen=True)
class Trajectory:
    """What really happened, free of noise, at an even clock."""

    car: CarParameters
    t: np.ndarray  # (N,): [s]
    states: np.ndarray  # (N, 24): see `dynamics`
    outputs: np.ndarray  # (N, 21): see `dynamics`
    s: np.ndarray  # (N,): distance along the track, or travelled where there is none [m]; not reset at a lap's end
    # command_t, torque_command, steer_command: (K,): instants [s] and commands held from then on [N m], [rad].
    command_t: np.ndarray
    torque_command: np.ndarray
    steer_command: np.ndarray
    lap_length: float = 0.0  # 0 without a track [m]
    ended_early: bool = False  # whether the car fell below its crawling speed before the script was over

    def channel(self, name: str) -> np.ndarray:
        """Return a channel of the drive, or another quantity of the plant, at `t`; shape (N,).

        Parameters
        ----------
        name : str
            A drive's channel (``T`` and ``delta`` are the commands), ``T_actual``, ``delta_actual``, ``s``,
            ``wheel_speed_fl`` ... ``wheel_speed_rr`` [rad/s], ``load_fl`` ... ``load_rr`` [N].
        """
        return _channel(self, name)


_STATE_CHANNELS = {
    "X": _compiled.X,
    "Y": _compiled.Y,
    "yaw": _compiled.YAW,
    "vx": _compiled.VX,
    "vy": _compiled.VY,
    "r": _compiled.R,
    "T_actual": _compiled.TORQUE,
}
_CORNERS = ("fl", "fr", "rl", "rr")


def _channel(run: Trajectory, name: str) -> np.ndarray:
    if name in _STATE_CHANNELS:
        return run.states[:, _STATE_CHANNELS[name]]
    if name in ("t", "s"):
        return getattr(run, name)
    if name in ("ax", "ay"):
        return run.outputs[:, _compiled.OUT_AX if name == "ax" else _compiled.OUT_AY]
    if name == "delta_actual":
        return run.states[:, _compiled.STEER] + run.car.steer_offset
    if name in ("T", "delta"):
        return commands_at(run, name, run.t)
    quantity, _, corner = name.rpartition("_")
    if corner in _CORNERS and quantity in ("wheel_speed", "load"):
        wheel = _CORNERS.index(corner)
        return run.states[:, _compiled.WHEEL + wheel] if quantity == "wheel_speed" else run.outputs[:, 2 + wheel]
    raise KeyError(name)


def commands_at(run: Trajectory, name: str, at: np.ndarray) -> np.ndarray:
    """Return the command ``T`` [N m] or ``delta`` [rad] at times `at` [s], held or led in straight lines."""
    values = run.torque_command if name == "T" else run.steer_command
    if run.car.command_ramp:
        before = run.states[0, _compiled.TORQUE if name == "T" else _compiled.STEER]
        clock = np.concatenate([[0.0], run.command_t + CONTROL_PERIOD])
        return np.interp(at, clock, np.concatenate([[before], values]))
    held = np.clip(np.searchsorted(run.command_t, at + 1e-9, side="right") - 1, 0, None)
    return values[held]


def initial_state(car: CarParameters, speed: float, track: Track | None = None) -> np.ndarray:
    """Return the state, shape (24,), of a car that rolls at `speed` [m/s] from a track's start or along X.

    On a bend the car starts with the yaw rate and steer angle of the bend, its tyres not yet loaded.
    """
    x = np.zeros(_compiled.STATE_SIZE)
    x[_compiled.VX] = speed
    x[_compiled.WHEEL : _compiled.WHEEL + 4] = speed / car.wheel_radius
    if track is not None:
        x[_compiled.X], x[_compiled.Y], x[_compiled.YAW] = track.x[0], track.y[0], track.direction[0]
        x[_compiled.R] = speed * track.curvature[0]
        x[_compiled.STEER] = np.arctan(car.wheelbase * track.curvature[0])
    return x


def drive_laps(
    car: CarParameters,
    track: Track,
    style: DriverStyle,
    *,
    aggressiveness: float = 0.6,
    laps: float = 1.0,
    duration: float | None = None,
    seed: int = 0,
    road: Road | None = None,
    faults: Faults = SOUND,
    believed: CarParameters | None = None,
    sample_period: float = 2e-3,
) -> Trajectory:
    """Drive a number of laps with a flying start on the first straight.

    Parameters
    ----------
    aggressiveness : float
        Share of the car's grip the driver uses, above 0 to 1 [1].
    duration : float, optional
        Drive for so long instead of a number of laps [s].
    seed : int
        Of the person and of the unrest; the same seed gives the same drive.
    road : Road, optional
        Surroundings the driver does not know of; level and dry by default.
    faults : Faults
        What is wrong with the car and the driver does not know of.
    believed : CarParameters, optional
        The car the driver thinks to sit in, from which he knows its grip; by default the car itself.

    Raises
    ------
    SplitError
        If a setting makes no sense, or the car left the track or spun.
    """
    if not 0.0 < aggressiveness <= 1.0:
        raise SplitError(f"aggressiveness must lie above 0 and not above 1, got {aggressiveness:g}")
    if not 0.0 < laps <= MOST_LAPS:
        raise SplitError(f"laps must lie above 0 and not above {MOST_LAPS}, got {laps:g}")
    if duration is not None and not 0.1 <= duration <= 7200.0:
        raise SplitError(f"the duration must lie between 0.1 s and 7200 s, got {duration:g} s")
    person = varied(style, seed)
    believed = believed or car
    grip = grip_of(believed)
    profile = speed_profile(believed, track, person, aggressiveness, grip)
    if profile.speed.min() < 1.2 * car.crawl_speed:
        what = f"{car.name} would crawl round {track.name} at {profile.speed.min():.2g} m/s"
        raise SplitError(what, advice="Choose a larger track or more aggressiveness.")
    if duration is None:
        distance = laps * track.length
        steps = int(np.ceil((1.3 * distance * np.mean(1.0 / profile.speed) + 5.0) / CONTROL_PERIOD))
    else:
        distance = duration * profile.speed.max()
        steps = int(round(duration / CONTROL_PERIOD))
    free = np.full(steps, np.nan)
    return _simulate(
        _Course(
            car,
            initial_state(car, float(profile.speed[0]), track),
            Script(free, free, free),
            person,
            seed,
            track=track,
            profile=profile,
            road=road or Road(),
            faults=faults,
            believed=believed,
            distance=distance,
            sample_period=sample_period,
            may_time_out=duration is not None,
        )
    )


def drive_script(
    car: CarParameters,
    script: Script,
    style: DriverStyle,
    *,
    speed: float,
    track: Track | None = None,
    seed: int = 0,
    road: Road | None = None,
    faults: Faults = SOUND,
    sample_period: float = 2e-3,
) -> Trajectory:
    """Carry out a script from straight running (or from a track's start) at `speed` [m/s].

    Raises
    ------
    SplitError
        If the car left the track or spun.
    """
    profile = None
    if track is not None:
        profile = SpeedProfile(np.full(len(track.x), speed), np.zeros(len(track.x)))
    calm = DriverStyle(style.name, preview_time=style.preview_time, line_wander=0, pace_wander=0)
    return _simulate(
        _Course(
            car,
            initial_state(car, speed, track),
            script,
            calm,
            seed,
            track=track,
            profile=profile,
            road=road or Road(),
            faults=faults,
            sample_period=sample_period,
        )
    )


@dataclass(frozen=True)
class _Course:
    """What is driven: a car from a start, by a script where it says so and else by a driver."""

    car: CarParameters
    start: np.ndarray  # state, shape (STATE_SIZE,)
    script: Script
    style: DriverStyle
    seed: int
    track: Track | None = None
    profile: SpeedProfile | None = None  # along the track
    road: Road = field(default_factory=Road)
    faults: Faults = SOUND
    believed: CarParameters | None = None  # the car that the driver thinks to sit in; the car itself by default
    distance: float = np.inf  # after which the drive ends [m]
    sample_period: float = 2e-3  # [s]
    may_time_out: bool = False

    def tables(self) -> _PathTables:
        """Return the line and the speeds along it, as compiled code takes them."""
        if self.track is None or self.profile is None:
            return _PathTables(1.0, 0.0, 0.0, *([np.zeros(1)] * 6))
        line = self.track
        return _PathTables(
            line.spacing,
            line.length,
            line.turn,
            line.x,
            line.y,
            line.direction,
            line.curvature,
            self.profile.speed,
            self.profile.acceleration,
        )

    def stop(self) -> _StopTables:
        """Return what ends the drive. On a test circle the steer may be held on purpose; only laps have edges."""
        edge = 2.0 * self.track.half_width if self.track and np.isfinite(self.distance) else np.inf
        return _StopTables(float(min(self.distance, 1e300)), self.car.crawl_speed, float(min(edge, 1e300)))


def _simulate(course: _Course) -> Trajectory:
    car, script, track = course.car, course.script, course.track
    keep = int(round(course.sample_period / STEP))
    substeps = int(round(CONTROL_PERIOD / STEP))
    if keep < 1 or substeps % keep:
        raise SplitError(f"sample period {course.sample_period:g} s does not divide {CONTROL_PERIOD:g} s")
    steps = len(script.torque)
    believed = course.believed or car
    reach = course.distance
    if not np.isfinite(reach):
        reach = steps * CONTROL_PERIOD * 2.0 * float(course.start[_compiled.VX])
    half_width = track.half_width if track else 0.0
    plan = driver_plan(car, course.style, half_width, reach, steps, CONTROL_PERIOD, course.seed)
    slope = np.gradient(script.speed, CONTROL_PERIOD) if steps > 1 else np.zeros(steps)
    tables = _ScriptTables(script.torque, script.steer, script.speed, np.where(np.isnan(slope), 0.0, slope))
    times, states, outputs, places, torques, steers, reason = _loops_numba.run(
        course.start,
        0.0,
        as_numbers(car),
        as_numbers(course.faults),
        course.road.tables(),
        course.tables(),
        plan,
        tables,
        driver_tables(believed, course.style, grip_of(believed)),
        CONTROL_PERIOD,
        STEP,
        substeps,
        keep,
        course.stop(),
    )
    if reason in _ENDINGS and not (course.may_time_out and reason == _loops_numba.OUT_OF_TIME):
        at = f"at {times[-1]:.1f} s, s = {places[-1]:.0f} m" if len(times) else "at once"
        raise SplitError(f"{_ENDINGS[reason]} {at}", where=car.name, advice="Use less aggressiveness.")
    return Trajectory(
        car=car,
        t=times,
        states=states,
        outputs=outputs,
        s=places,
        command_t=np.arange(len(torques)) * CONTROL_PERIOD,
        torque_command=torques,
        steer_command=steers,
        lap_length=track.length if track else 0.0,
        ended_early=reason == _loops_numba.TOO_SLOW,
    )
