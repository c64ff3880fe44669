"""Laps of a track in closed loop: a contouring controller that learns while it drives the plant."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np

from split_cli.control.iol_learner import IolLearner
from split_cli.control.learner import Learner, NoLearner, SplitLearner, learning_region
from split_cli.control.model import ControlModel
from split_cli.control.mpcc import Mpcc, MpccSettings
from split_cli.control.path import Path, check_path, contour_and_lag, read_centerline
from split_cli.control.receding import Actuators, ControllerLost, StepInfo
from split_cli.errors import SetError, SplitError, nearest_names
from split_cli.files import refuse_overwriting_inputs, refuse_what_cannot_be_written
from split_cli.learning.cells import empty_set, warm_up
from split_cli.learning.features import parse_features
from split_cli.learning.hyperparameters import FEWEST_TO_FIT, default_kernel, fit_kernel, scatter_variance
from split_cli.learning.kernel import Kernel
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.labels import compute_labels
from split_cli.learning.region import build_grid
from split_cli.learning.training_set import TrainingSet, read_set, write_set
from split_cli.logs.drive import Drive, write_drive
from split_cli.plant.cars import find_car
from split_cli.plant.recording import write_mcap
from split_cli.plant.tracks import TRACK_NAMES, find_track
from split_cli.prediction import PREDICTORS, Predictor, make_predictor
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.closed_loop import World, body_width, path_of

__all__ = ["Lap", "RaceResult", "RaceSettings", "check_trusted", "run_race"]

LEARNERS = ("none", "iol", "split")
_GRAVITY = 9.80665


@dataclass(frozen=True)
class RaceSettings:
    """What to drive.

    Attributes
    ----------
    track : str
        Name of a track, or a centre-line CSV.
    car : str
        The car of the plant.
    laps : int
        After lap 0, which the nominal model drives.
    learner : str
        none, iol or split.
    start_set : path or None
        What is known before; lap 0 is left out then.
    max_speed : float
        [m/s]
    max_torque : float or None
        Cap of the driving torque [N m]; by default what the vehicle file says.
    grip : float
        Friction of the road against the tyres' own peak [1].
    seed : int
        Of the sensors' noise.
    exact_sensors : bool
    delay : bool
        Whether a command takes effect one interval after the measurement it follows from.
    features : str
    predictor : str
        Evaluates the set; ``bcm`` follows every update of a learner, others are built anew after each lap.
    hyperparameters : str
        ``fit`` (to lap 0), ``default``, or a kernel's YAML.
    width : float or None
        Of the car's body [m].
    printed_iol : bool
        Count updates of the dictionary as costly as the papers print them; see `IolLearner`.
    tightening : float
        Standard deviations by which the borders are moved in [1].
    settings : MpccSettings
    """

    track: str = "small"
    car: str = "road_car"
    laps: int = 3
    learner: str = "split"
    start_set: str | FilePath | None = None
    max_speed: float = 30.0
    max_torque: float | None = None
    grip: float = 1.0
    seed: int = 0
    exact_sensors: bool = False
    delay: bool = True
    features: str = "z2"
    predictor: str = "bcm"
    hyperparameters: str = "fit"
    width: float | None = None
    printed_iol: bool = True
    tightening: float = 0.0
    settings: MpccSettings = MpccSettings()


@dataclass(frozen=True)
class Lap:
    """One lap.

    Attributes
    ----------
    number : int
        0 for the nominal lap.
    time : float or None
        [s]; None when it was not finished.
    mean_speed, max_lateral : float
        [m/s]; greatest lateral acceleration [g].
    updates, size, cells : int
        Insertions and replacements; points and non-empty cells at its end.
    error_before, error_after : tuple of float
        Root mean square of the labels, and of what the residual left of them when they came in: v_x, v_y
        [m/s^2], r [rad/s^2].
    samples, accepted : int
        Control intervals, and those whose label lay in the learned region.
    solver_ms, step_ms : tuple of float
        Median, 99 % and worst of HPIPM, and of the whole step with model and residual [ms].
    update_ms : tuple of float
        The same of label and update [ms].
    failures : int
        Programmes without a solution.
    outside : float
        Farthest that a side of the car was beyond the border [m]; 0 for a clean lap.
    ended : str
        Why the lap was not finished; empty when it was.
    """

    number: int
    time: float | None
    mean_speed: float
    max_lateral: float
    updates: int
    size: int
    cells: int
    error_before: tuple[float, ...]
    error_after: tuple[float, ...]
    samples: int
    accepted: int
    solver_ms: tuple[float, ...]
    step_ms: tuple[float, ...]
    update_ms: tuple[float, ...]
    failures: int
    outside: float
    ended: str = ""

    @property
    def clean(self) -> bool:
        """Whether the lap was finished without leaving the track."""
        return self.time is not None and self.outside == 0.0


@dataclass(frozen=True)
class RaceResult:
    """What was driven.

    Attributes
    ----------
    track, car, vehicle, learner : str
    length : float
        Of a lap [m].
    laps : tuple of Lap
    output : str or None
        The drive.
    set_path : str or None
    notes : tuple of str
    path : Path
        The track.
    traces : tuple of ndarray
        Of each lap, a row an interval: t, s, X, Y, yaw, v_x, v_y, r, T, delta, a_x, a_y, contour error.
    """

    track: str
    car: str
    vehicle: str
    learner: str
    length: float
    laps: tuple[Lap, ...]
    output: str | None
    set_path: str | None
    notes: tuple[str, ...]
    traces: tuple[np.ndarray, ...] = ()
    path: Path | None = None

    def summary(self) -> RaceResult:
        """Return the result without its traces and its track."""
        return replace(self, traces=(), path=None)


def run_race(
    settings: RaceSettings,
    vehicle_path: str | FilePath,
    *,
    output: str | FilePath | None = None,
    set_output: str | FilePath | None = None,
    progress: Callable[[str], None] | None = None,
) -> RaceResult:
    """Drive the laps; write the drive, and the set after each lap.

    Raises
    ------
    SplitError
        If an input is at fault or the start is infeasible; nothing is driven then.
    """
    for path in (output, set_output):
        if path is not None:
            refuse_overwriting_inputs(path, (vehicle_path, settings.start_set or vehicle_path))
            refuse_what_cannot_be_written(path)
    race = _Race(settings, read_vehicle(vehicle_path), set_output, progress or (lambda text: None))
    race.begin()
    race.run()
    if output is not None:
        race.write(FilePath(output))
    return race.result(output)


class _Race:
    """The state of a race between its laps."""

    def __init__(self, settings: RaceSettings, vehicle: Vehicle, set_output, say: Callable[[str], None]) -> None:
        self.settings, self.vehicle, self.set_output, self.say = settings, vehicle, set_output, say
        if settings.learner not in LEARNERS:
            raise SplitError(
                f"no learner is called {settings.learner!r}", where="--learner",
                advice=f"There are: {', '.join(LEARNERS)}.",
            )  # fmt: skip
        if settings.laps < 0:
            raise SplitError(f"a number of laps from 0 was expected, got {settings.laps}", where="--laps")
        for name, value in (("--max-speed", settings.max_speed), ("--grip", settings.grip)):
            if not 0.0 < value < 1e3:
                raise SplitError(f"must be positive, got {value:g}", where=name)
        self.car = find_car(settings.car)
        self.width = settings.width or body_width(self.car)
        self.path = _track(settings.track)
        check_path(self.path, self.width)
        self.mpcc = replace(settings.settings, max_speed=settings.max_speed)
        torque = settings.max_torque or vehicle.max_torque
        self.actuators = Actuators(min(torque, vehicle.max_torque), vehicle.max_brake_torque)
        if settings.predictor not in PREDICTORS:
            advice = nearest_names(settings.predictor, PREDICTORS)
            raise SplitError(f"no predictor {settings.predictor!r}", where="--predictor", advice=advice)
        if settings.learner == "iol" and settings.start_set is not None:
            raise SplitError(
                "the dictionary of iol begins empty", where="--start-set", advice="Use --learner none or split."
            )
        self.start_set = None
        if settings.start_set is not None:
            self.start_set = read_set(settings.start_set)
            check_trusted(self.start_set, vehicle, settings.start_set)
        self.notes: list[str] = []
        self.laps: list[Lap] = []
        self.traces: list[np.ndarray] = []
        self.ended = ""

    def begin(self) -> None:
        """Put the car on the run-up to the first line, and find a first plan."""
        warm_up()
        s = self.settings
        speed = min(0.5 * s.max_speed, self._speed_at_start())
        # A run-up of a third of a lap, so that lap 0 starts flying as the others do.
        self.start = -min(0.3 * self.path.length, 200.0)
        self.world = World(
            self.car, self.path, speed, self.start, s.grip, None if s.exact_sensors else s.seed
        )  # fmt: skip
        self.header = self._header(None)
        self.learner: Learner = NoLearner(self.header)
        if self.start_set is not None:
            self.learner = self._learner(self.start_set)
        self.model = ControlModel(self.vehicle, self.learner.residual, self.mpcc.step)
        self.controller = Mpcc(self.model, self.path, self.actuators, self.mpcc, self.width, s.tightening)
        self.controller.begin(self.model.steady_states(self.world.measured), self.start)
        self.rates = self.controller.plan.u[0, :2].copy()
        self.memory = self.model.steady_states(self.world.measured)[8:]

    def _speed_at_start(self) -> float:
        """Return a speed at which the run-up's tightest bend takes half the grip [m/s]."""
        s = -np.linspace(0.0, min(0.3 * self.path.length, 200.0), 200)
        bend = np.abs(self.path.at(s).curvature).max()
        tire = min(self.vehicle.front_tire.D, self.vehicle.rear_tire.D)
        return float(np.sqrt(0.5 * self.settings.grip * 2.0 * tire / self.vehicle.mass / max(bend, 1e-4)))

    def _header(self, kernel: Kernel | None) -> TrainingSet:
        """Return an empty set for this vehicle; without a kernel, one that is only asked for its labels."""
        s, limits = self.settings, self.mpcc.limits
        if self.start_set is not None:
            return self.start_set
        features = parse_features(s.features)
        region = learning_region(self.vehicle, limits.alpha_max, limits.dalpha_max, limits.p_long)
        if kernel is None:
            grid = build_grid(parse_features("z2"), self.vehicle, region)
            kernel = Kernel(np.array(grid.edges), np.ones(3), np.ones(3))
            features = parse_features("z2")
        else:
            grid = self.grid
        return empty_set(self.vehicle, features, region, grid, kernel, horizon=self.mpcc.step)

    def _learner(self, training_set: TrainingSet) -> Learner:
        name = self.settings.predictor

        def evaluate(known: TrainingSet) -> Predictor:
            return make_predictor(name, known)

        if self.settings.learner == "none":
            return NoLearner(training_set, evaluate(training_set))
        if self.settings.learner == "split":
            return SplitLearner(training_set, None if name == "bcm" else evaluate)
        return IolLearner(training_set, printed=self.settings.printed_iol)

    def run(self) -> None:
        """Drive the run-up, lap 0 where nothing is known, and the laps."""
        s = self.settings
        first = 0 if self.start_set is None else 1
        self.until = 0.0
        if self._drive(record=None) is None:
            raise SplitError(
                f"the run-up to the line was not finished: {self.ended}", where=self.path.name,
                advice="Lower --p-ellipse or --max-speed: the nominal model asks for more than the road gives.",
            )  # fmt: skip
        if first == 0:
            self.say("lap 0, nominal")
            self._lap(0)
            if s.learner != "none" and not self.ended:
                self._start_learning()
        for number in range(1, s.laps + 1):
            if self.ended:
                break
            self.say(f"lap {number}")
            self._lap(number)

    def _start_learning(self) -> None:
        """Fit the kernel to lap 0 and begin with an empty set."""
        lap = self._recording(self.laps[-1])
        features = parse_features(self.settings.features)
        region = self.header.region
        labels = compute_labels(lap, self.vehicle, features, region, horizon=self.mpcc.step)
        good = labels.accepted
        self.grid = build_grid(features, self.vehicle, region, labels.z[good])
        kernel = self._kernel(labels, good)
        self.learner = self._learner(self._header(kernel))
        self.model = ControlModel(self.vehicle, self.learner.residual, self.mpcc.step)
        self.controller.model = self.model

    def _kernel(self, labels, good: np.ndarray) -> Kernel:
        asked = self.settings.hyperparameters
        start = default_kernel(self.grid, labels.y[good], scatter_variance(labels))
        if asked == "default":
            return start
        if asked != "fit":
            return read_kernel(asked, parse_features(self.settings.features))
        if np.count_nonzero(good) < FEWEST_TO_FIT:
            self.notes.append(f"lap 0 has {np.count_nonzero(good)} valid labels, too few to fit a kernel: default")
            return start
        return fit_kernel(labels.z[good], labels.y[good], self.grid, start).kernel

    def _lap(self, number: int) -> None:
        tally = _Tally(number, len(self.world.rows) - 1)
        self.learner.begin_lap(f"lap {number}", self.world.t)
        begin = self.crossing
        self.until = (self._line + 1) * self.path.length
        self._line += 1
        finished = self._drive(tally)
        duration = self.world.rows[-1][0] - self.world.rows[tally.first][0]
        trained = self.learner.end_lap(duration)
        self.laps.append(tally.lap(self, None if finished is None else finished - begin))
        self.traces.append(np.array(tally.trace))
        self._spans[number] = (tally.first, len(self.world.rows))
        self.model.residual = self.learner.residual
        if trained is not None and self.set_output is not None:
            write_set(trained, self.set_output)

    _line = 0
    crossing = 0.0

    @property
    def _spans(self) -> dict[int, tuple[int, int]]:
        return self.__dict__.setdefault("_rows_of_laps", {})

    def _recording(self, lap: Lap) -> Drive:
        return self.world.recording(*self._spans[lap.number], name=f"lap {lap.number}")

    def _drive(self, record: _Tally | None) -> float | None:
        """Drive until the progress reaches `until`; return the time of crossing [s], None when the lap ended."""
        world, h = self.world, self.mpcc.step
        s = self.path.project(*world.exact[:2], self.controller.plan.x[0, -2])
        deadline = world.t + 10.0 + 8.0 * (self.until - s) / self.settings.max_speed
        while True:
            before, t_before = s, world.t
            try:
                info = self._interval(record)
            except ControllerLost as error:
                self.ended = str(error)
                return None
            s = self.path.project(*world.exact[:2], before + world.exact[3] * h, reach=8.0)
            off = self._outside(s)
            if record is not None:
                record.add(self, s, off, info)
            if world.spun:
                self.ended = f"the car spun at {s % self.path.length:.0f} m"
            elif off > self.width + 1.0:
                self.ended = f"the car left the track at {s % self.path.length:.0f} m"
            elif world.t > deadline:
                self.ended = "the lap took too long"
            if self.ended:
                return None
            if s >= self.until:
                self.crossing = t_before + h * (self.until - before) / (s - before)
                return self.crossing

    def _outside(self, s: float) -> float:
        """Return how far a side of the car is beyond the border [m], not below 0."""
        point = self.path.at(np.array([s]))
        x, y = self.world.exact[:2]
        contour = contour_and_lag(point, np.array([x]), np.array([y]))[0][0]
        self.contour = float(contour)
        return float(max(contour - point.right[0], -contour - point.left[0], -0.5 * self.width) + 0.5 * self.width)

    def _interval(self, record: _Tally | None) -> StepInfo:
        """Plan the interval after the next one while the car drives the next, then learn what came of it."""
        world, h = self.world, self.mpcc.step
        now = np.concatenate([world.measured, self.memory])
        if self.settings.delay:
            ahead = self.model.linearize(now[None], self.rates[None]).following[0]
            following, info = self.controller.step(ahead)
            applied = self.rates
        else:
            following, info = self.controller.step(now)
            applied = following
        if self.model.memory:
            self.memory = self.model.linearize(now[None], applied[None]).following[0][8:]
        first = len(world.rows) - 1
        world.drive(applied, h)
        self.rates = following
        if record is not None:
            interval = world.recording(first, name=f"lap {record.number}")
            record.learned.append(self.learner.learn(interval, first - record.first))
        return info

    def write(self, output: FilePath) -> None:
        """Write the laps as one drive, the run-up left out: Parquet, or MCAP as a logger would."""
        if not self.laps:
            return
        first, last = self._spans[self.laps[0].number][0], self._spans[self.laps[-1].number][1]
        drive = self.world.recording(first, last, output.name)
        if output.suffix.lower() == ".mcap":
            write_mcap(self.world.readings(drive), output)
        else:
            write_drive(drive, output)

    def result(self, output) -> RaceResult:
        """Return what was driven."""
        return RaceResult(
            track=self.path.name, car=self.car.name, vehicle=self.vehicle.name, learner=self.settings.learner,
            length=self.path.length, laps=tuple(self.laps), output=None if output is None else str(output),
            set_path=None if self.set_output is None else str(self.set_output), notes=tuple(self.notes),
            traces=tuple(self.traces), path=self.path,
        )  # fmt: skip


class _Tally:
    """What adds up over a lap."""

    def __init__(self, number: int, first: int) -> None:
        self.number, self.first = number, first
        self.infos: list[StepInfo] = []
        self.learned = []
        self.trace = []
        self.outside = 0.0

    def add(self, race: _Race, s: float, off: float, info: StepInfo) -> None:
        world = race.world
        self.infos.append(info)
        self.outside = max(self.outside, off)
        self.trace.append((world.t, s, *world.exact, *world.truth[-1][7:9], race.contour))

    def lap(self, race: _Race, time: float | None) -> Lap:
        rows = np.array(race.world.truth[self.first :])
        pairs = [(entry.label, entry.predicted) for entry in self.learned if entry.label is not None]
        y = np.array([label for label, _ in pairs]).reshape(-1, 3)
        left = y - np.array([predicted for _, predicted in pairs]).reshape(-1, 3)
        return Lap(
            number=self.number, time=time, mean_speed=float(np.hypot(rows[:, 4], rows[:, 5]).mean()),
            max_lateral=float(np.abs(rows[:, 8]).max()) / _GRAVITY,
            updates=sum(entry.updates for entry in self.learned), size=race.learner.size, cells=race.learner.cells,
            error_before=_rms(y), error_after=_rms(left), samples=len(self.learned), accepted=len(pairs),
            solver_ms=_times([info.solver_seconds for info in self.infos]),
            step_ms=_times([info.total_seconds for info in self.infos]),
            update_ms=_times([entry.seconds for entry in self.learned]),
            failures=sum(not info.solved for info in self.infos), outside=self.outside, ended=race.ended,
        )  # fmt: skip


def _rms(values: np.ndarray) -> tuple[float, ...]:
    return tuple(np.sqrt(np.mean(np.square(values), axis=0)).tolist()) if len(values) else (0.0, 0.0, 0.0)


def _times(seconds: list[float]) -> tuple[float, ...]:
    return tuple((1e3 * np.quantile(seconds, [0.5, 0.99, 1.0])).tolist()) if seconds else (0.0, 0.0, 0.0)


def _track(name: str) -> Path:
    if name in TRACK_NAMES:
        return path_of(find_track(name))
    if FilePath(name).suffix.lower() == ".csv" or FilePath(name).exists():
        return read_centerline(name)
    return path_of(find_track(name))


def check_trusted(training_set: TrainingSet, vehicle: Vehicle, where: str | FilePath) -> None:
    """Refuse a set that a controller cannot trust.

    Raises
    ------
    SetError
        If it is of another vehicle, holds plain differences, or labels beyond what any model gets wrong.
    """
    if training_set.vehicle.digest() != vehicle.digest():
        raise SetError(
            f"was trained for another vehicle ({training_set.vehicle.name}) than {vehicle.name}", where=str(where),
            advice="Train a set for this vehicle, or name the vehicle file the set was trained with.",
        )  # fmt: skip
    if training_set.plain:
        raise SetError(
            "holds plain differences, which depend on the label interval", where=str(where),
            advice="Train it without --plain.",
        )  # fmt: skip
    bad = ~np.isfinite(training_set.y).all(axis=1)
    limit = 30.0
    huge = np.abs(training_set.y[:, :2]).max(initial=0.0)
    if bad.any() or huge > limit:
        raise SetError(
            f"holds labels up to {huge:.3g} m/s^2: no car's model is wrong by more than three times gravity",
            where=str(where), advice="Check the recordings it was trained on with `split evaluate`.",
        )  # fmt: skip
