"""The laps themselves: plant, controller and learner side by side, one control interval after the other."""

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np

from split_cli.control.exported import ExportedResidual
from split_cli.control.grip import PeakShift, learned_grip, tells_peaks
from split_cli.control.learner import Learner, NoLearner
from split_cli.control.limits import first_share, nominal_share
from split_cli.control.model import ControlModel, check_features
from split_cli.control.mpcc import Mpcc
from split_cli.control.path import check_path, contour_and_lag
from split_cli.control.policy import (
    DEVIATION_KEPT,
    FIRST_DEVIATION,
    FIRST_ERROR,
    MARGIN,
    MAX_STEER,
    SHARE_STEP,
    SIZE,
    TORQUE_RATE,
)
from split_cli.control.receding_horizon import Actuators, ControllerLost, StepInfo
from split_cli.control.residual import NoResidual
from split_cli.errors import SplitError
from split_cli.learning.cells import warm_up
from split_cli.learning.features import parse_features
from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet, read_set, write_set
from split_cli.logs.drive import write_drive
from split_cli.plant.cars import find_car
from split_cli.plant.recording import write_mcap
from split_cli.scoring.noise import noise_floor
from split_cli.signals import STANDARD_GRAVITY
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.racing.choice import choose_features, what_lap_0_asks, whether_learning_helped
from split_cli.workflows.racing.closed_loop import World, body_width
from split_cli.workflows.racing.entry import (
    check_car,
    check_exported,
    check_predictor,
    check_same_features,
    check_settings,
    check_start,
    check_torque,
    check_trusted,
    find_path,
)
from split_cli.workflows.racing.first_lap import blank_header, make_learner, remembering, studied_header
from split_cli.workflows.racing.result import Lap, RaceResult
from split_cli.workflows.racing.settings import RaceSettings
from split_cli.workflows.racing.tally import Tally

RUN_UP_SHARE, LONGEST_RUN_UP = 0.3, 200.0
"""Of a lap [1] and at most [m]: the way before the line, so that lap 0 starts flying as others do."""

MOTION_EVERY = 4
"""Of the intervals, the error of the exact motion is computed in every fourth [1]: a label of a vehicle with terms
takes milliseconds, and a lap has hundreds of intervals."""

LEFT_BEHIND = 1.0
"""A car whose whole width and this much more [m] is beyond the border has left the track, and its lap ends."""


@contextmanager
def uncollected() -> Iterator[None]:
    """Collect garbage now and none within: a full collection holds up a step by several intervals."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


def acceleration_error(error: np.ndarray, noise: np.ndarray, count: int, vehicle: Vehicle) -> float:
    """Return what a model gets wrong of the motion sideways, as one acceleration [m/s^2].

    Parameters
    ----------
    error : ndarray, shape (3,)
        Root mean squares of what predictions leave of the labels [m/s^2], [m/s^2], [rad/s^2].
    noise : ndarray, shape (3,)
        Deviation of the labels' noise, which no model can predict, in the same units.
    count : int
        Number of labels.

    Notes
    -----
    Yaw counts by the radius of gyration, as it does in the kinetic energy: the square is that of v_y plus
    I_z/m times that of r. Neither is below its standard error, noise^2 sqrt(2/count): no label tells less.
    """
    noise = np.square(noise)
    squares = np.maximum(np.square(error) - noise, noise * np.sqrt(2.0 / max(count, 1)))
    return float(np.sqrt(squares[1] + vehicle.yaw_inertia / vehicle.mass * squares[2]))


class Race:
    """The state of a race between its laps.

    Parameters
    ----------
    set_output : path or None
        Where the set goes after each lap.
    say : callable
        Takes words on progress.

    Raises
    ------
    SplitError
        If settings, track or set cannot be driven with.
    """

    def __init__(
        self, settings: RaceSettings, vehicle: Vehicle, set_output: str | FilePath | None, say: Callable[[str], None]
    ) -> None:
        self.settings, self.vehicle, self.set_output, self.say = settings, vehicle, set_output, say
        check_settings(settings)
        self.car = find_car(settings.car)
        check_car(vehicle, self.car)
        self.features = parse_features(settings.candidates[-1])
        check_features(remembering(vehicle, self.features)[0], self.features, settings.settings.step)
        self.width = settings.width or body_width(self.car)
        self.path = find_path(settings.track)
        check_path(self.path, self.width)
        self.start = -min(RUN_UP_SHARE * self.path.length, LONGEST_RUN_UP)
        size = self.car.wheelbase / SIZE
        margin = MARGIN * size if settings.margin is None else settings.margin
        self.deviation = FIRST_DEVIATION * size if settings.deviation is None else settings.deviation
        check_start(self.path, self.start, self.width, margin)
        self.mpcc = replace(settings.settings, max_speed=settings.max_speed, margin=margin)
        torque = min(settings.max_torque or vehicle.max_torque, vehicle.max_torque)
        check_torque(vehicle, torque)
        # No plan asks for what the actuators of the car cannot give.
        self.actuators = Actuators(
            torque,
            vehicle.max_brake_torque,
            max_steer=min(MAX_STEER, self.car.max_steer_angle),
            torque_rate=min(TORQUE_RATE, self.car.torque_rate),
        )
        self.start_set: TrainingSet | None = None
        self.exported: ExportedResidual | None = None
        if settings.start_set is not None and FilePath(settings.start_set).is_dir():
            self.exported = ExportedResidual(FilePath(settings.start_set), vehicle)
            check_exported(self.exported, settings)
            check_same_features(settings.features, self.exported.features, settings.start_set)
        elif settings.start_set is not None:
            self.start_set = read_set(settings.start_set)
            check_trusted(self.start_set, vehicle, settings.start_set)
            check_predictor(settings.predictor, self.start_set.features)
            check_same_features(settings.features, self.start_set.features, settings.start_set)
        self.notes: list[str] = []
        if settings.max_torque is not None and settings.max_torque > vehicle.max_torque:
            self.notes.append(
                f"--max-torque is {settings.max_torque:g} N m; the {vehicle.max_torque:g} N m of the vehicle file "
                "are the limit"
            )
        self.laps: list[Lap] = []
        self.traces: list[np.ndarray] = []
        self.spans: dict[int, tuple[int, int]] = {}
        self.grips: list[tuple[float, ...]] = []
        self.ended, self.undecided = "", False
        self.kept: str | None = None
        self.lines, self.crossing, self.until = 0, 0.0, 0.0
        self.per_error = self.deviation / FIRST_ERROR  # needed beside the least margin, over `_error` [m]

    @property
    def begins_nominal(self) -> bool:
        """Whether nothing is known before, so that the nominal model drives lap 0."""
        return self.start_set is None and self.exported is None

    def begin(self) -> None:
        """Put the car on the run-up to the first line, and find a first plan."""
        warm_up()
        s = self.settings
        speed = min(0.5 * s.max_speed, self._careful_speed(-np.linspace(0.0, -self.start, 200)))
        self.world = World(self.car, self.path, speed, self.start, s.grip, None if s.exact_sensors else s.seed)
        if self.start_set is None:
            self.header = blank_header(self.vehicle, self.features, self.mpcc)
            self.learner: Learner = NoLearner(self.header, self.exported)
        else:
            self.header = self.start_set
            self.learner = make_learner(s, self.start_set)
        self.model = ControlModel(self.header.vehicle, self.learner.residual, self.mpcc.step)
        if self.model.not_compiled:
            self.notes.append(f"the model's functions are interpreted, not compiled: {self.model.not_compiled}")
        first = self.mpcc
        if self.begins_nominal:
            share = first_share(self.vehicle) if s.first_share is None else s.first_share
            first = replace(first, limits=replace(first.limits, p_ellipse=share, p_unknown=None))
        self.controller = Mpcc(self.model, self.path, self.actuators, first, self.width, s.tightening)
        self.controller.deviation = self.deviation
        self._take_grip(np.full(2, s.assumed_friction))
        self.controller.begin(self.model.steady_states(self.world.measured), self.start)
        if self.start_set is not None:
            self._learn_grip(self.start_set.z, self.start_set.y)
        elif self.exported is not None and s.learn_grip:
            self._take_grip(self.exported.grip(self.vehicle, first.limits.alpha_max))
        self.rates = self.controller.plan.u[0, :2].copy()
        self.memory = self.model.steady_states(self.world.measured)[8:]

    def _careful_speed(self, s: np.ndarray) -> float:
        """Return a speed at which the tightest bend at places `s` [m] takes half the grip [m/s]."""
        bend = np.abs(self.path.at(s).curvature).max()
        tire = min(self.vehicle.front_tire.D, self.vehicle.rear_tire.D)
        return float(np.sqrt(0.5 * self.settings.grip * 2.0 * tire / self.vehicle.mass / max(bend, 1e-4)))

    def run(self) -> None:
        """Drive the run-up, lap 0 where nothing is known, and the laps."""
        s = self.settings
        if self._drive(record=None) is None:
            bend = 1.0 / np.abs(self.path.curvature).max()
            lock = self.vehicle.wheelbase / np.tan(self.actuators.max_steer)
            asks = "The nominal model asks" if self.begins_nominal else f"What {s.start_set} learned asks"
            share = "--p-ellipse-lap0" if self.begins_nominal else "--p-ellipse"
            advice = (
                f"{asks} for more than the road gives: lower {share} or --max-speed, or tell the grip by "
                "--assumed-friction."
            )
            if bend < lock:
                advice = f"Full lock gives a radius of {lock:.1f} m, and the tightest bend has {bend:.1f} m."
            what = f"the car did not reach the line of the first lap: {self.ended}"
            raise SplitError(what, where=self.path.name, advice=advice)
        if self.begins_nominal:
            self.say("lap 0, nominal")
            self.drive_lap(0)
            if s.learner != "none" and not self.ended:
                self._start_learning()
        for number in range(1, s.laps + 1):
            if self.ended:
                break
            self.say(f"lap {number}")
            self.drive_lap(number)
            if self.undecided and number < s.laps and not self.ended:
                self._choose_features()

    def _start_learning(self) -> None:
        """Choose the features on lap 0, learn it, and drive with what was learned from now on."""
        self._choose_features()
        # Its own p_unknown returns, and the share goes on from that of lap 0.
        self.controller.limits = replace(self.mpcc.limits, p_ellipse=self.controller.limits.p_ellipse)
        self.controller.half_width = 0.5 * self.width + self.mpcc.margin
        self.controller.deviation = self.deviation

    def _choose_features(self) -> None:
        """Choose the features on all laps so far; where they change, learn these laps from the beginning."""
        laps = [self.world.recording(*span, name=f"lap {number}") for number, span in self.spans.items()]
        choice = choose_features(laps, self.header.vehicle, self.settings)
        chosen, number = parse_features(choice.features), self.laps[-1].number
        stays = number > 0 and chosen == self.header.features
        # A race need not hear after each lap that nothing has changed.
        if choice.reason and not (stays and choice.undecided):
            self.notes.append(choice.reason)
        self.undecided = choice.undecided
        if stays:
            return
        self.header, labels = studied_header(self.header, laps, chosen, self.settings, self.notes)
        self.learner = make_learner(self.settings, self.header)
        for lap, part in zip(laps, labels, strict=True):
            self.learner.begin_lap(lap.name, float(lap["t"][0]))
            updates = self.learner.watch(part)
            trained = self.learner.end_lap(float(lap["t"][-1] - lap["t"][0]))
        self.laps[-1] = replace(self.laps[-1], updates=updates, size=self.learner.size, cells=self.learner.cells)
        self._keep(trained)
        del self.grips[number:]
        driven = Labels.joined(labels)
        self._learn_grip(driven.z[driven.accepted], driven.y[driven.accepted])
        self.model = ControlModel(self.header.vehicle, self.learner.residual, self.mpcc.step)
        self.controller.model = self.model

    def _raise_share(self) -> None:
        """Let the next lap use more of the peak, by one step at most, where the last one was clean.

        A narrow track leaves no room for the whole margin; then the step is as much smaller as the margin is.
        """
        controller, most = self.controller, self.mpcc.limits.p_ellipse
        limits = controller.limits
        if self.begins_nominal and self.settings.learner == "none":
            most = max(nominal_share(self.vehicle), limits.p_ellipse)
        step = 0.0
        if self.laps[-1].clean:
            room = float(controller.room(self.path.at(np.arange(len(self.path.x)) * self.path.spacing)).min())
            step = SHARE_STEP * min(1.0, room / controller.deviation if controller.deviation else 1.0)
        controller.limits = replace(limits, p_ellipse=min(limits.p_ellipse + step, most))

    def _learn_grip(self, z: np.ndarray, y: np.ndarray) -> None:
        """Move the tyres' peaks to where labels tell them."""
        if self.settings.learn_grip:
            self._take_grip(learned_grip(self.vehicle, self.header.features, z, y, self.settings.assumed_friction))
            self.grips.append(tuple(self.controller.grip.tolist()))
        else:
            self._take_grip(self.controller.grip)

    def _take_grip(self, grip: np.ndarray) -> None:
        """Give the peaks to the slip limits, and to the residual as its prior mean."""
        self.controller.grip = grip
        # What was exported is the whole residual, nothing is added to it.
        may_add = self.exported is None and self.mpcc.limits.guarded
        informed = may_add and tells_peaks(self.vehicle, self.header.features)
        self.learner.residual.rest_on(PeakShift(self.vehicle, self.header.features, grip) if informed else None)

    def drive_lap(self, number: int) -> None:
        """Drive one lap, and keep what it taught."""
        controller = self.controller
        tally = Tally(number, len(self.world.rows) - 1, controller.limits.p_ellipse, self.path.length)
        self.learner.begin_lap(f"lap {number}", self.world.t)
        begin = self.crossing
        self.lines += 1
        self.until = self.lines * self.path.length
        with uncollected():
            finished = self._drive(tally)
        world = self.world
        duration = world.rows[-1][0] - world.rows[tally.first][0]
        trained = self.learner.end_lap(duration)
        time = None if finished is None else finished - begin
        truth = np.array(world.truth[tally.first :])
        self.laps.append(tally.lap(time, truth, self.learner.size, self.learner.cells, self.ended))
        self.traces.append(np.array(tally.trace))
        outside = self.laps[-1].outside
        self.say(f"lap {number}: " + (f"{time:.2f} s, {outside:.2f} m outside" if time else self.ended))
        self.spans[number] = (tally.first, len(world.rows))
        self._follow_lap(tally)
        self.model.residual = self.learner.residual
        if trained is not None and trained.size:
            self._learn_grip(trained.z, trained.y)
        self._keep(trained)

    def _follow_lap(self, tally: Tally) -> None:
        """Choose by how much more than the least margin the next lap's plan keeps to the border, and its share.

        The car came nearer to the border than planned by what was `tally.needed` [m], and errors of position go with
        those of the model. The next lap may err elsewhere: of what an error has needed, `DEVIATION_KEPT` stays. An
        error at one share of the peak says little of a larger one: while the share rises, the margin does not fall.
        """
        controller, kept, share = self.controller, self.controller.deviation, self.controller.limits.p_ellipse
        error = self._error(tally)
        self.per_error = max(tally.needed / error, DEVIATION_KEPT * self.per_error)
        controller.deviation = self.per_error * error
        self._raise_share()
        if controller.limits.p_ellipse > share:
            controller.deviation = max(controller.deviation, kept)

    def _error(self, tally: Tally) -> float:
        """Return the learned model's error in the last lap, over the largest lateral acceleration [1].

        What an error of acceleration adds up to goes with the square of the time, and the time with the root of a
        length over the acceleration that is driven. At most `FIRST_ERROR`, which stands for a model that has
        learned nothing, and where the error is not asked or the noise not known.
        """
        lap, header = self.laps[-1], self.header
        if not self.settings.margin_by_error or isinstance(self.learner.residual, NoResidual) or self.ended:
            return FIRST_ERROR
        drive = self.world.recording(*self.spans[lap.number], name=f"lap {lap.number}")
        noise = noise_floor(SingleTrack(header.vehicle), drive, tally.labels).rms
        if noise is None:
            return FIRST_ERROR
        error = acceleration_error(np.array(lap.error_after), noise, lap.accepted, header.vehicle)
        return min(error / (lap.max_lateral * STANDARD_GRAVITY), FIRST_ERROR)

    def _keep(self, trained: TrainingSet | None) -> None:
        """Write what was learned, if anything was."""
        if trained is not None and trained.size and self.set_output is not None:
            write_set(trained, self.set_output)
            self.kept = str(self.set_output)

    def _drive(self, record: Tally | None) -> float | None:
        """Drive until the progress reaches `until`; return the time of crossing [s], None when the lap ended."""
        world, h = self.world, self.mpcc.step
        s = self.path.project(*world.exact[:2], self.controller.plan.x[0, -2])
        careful = min(self.settings.max_speed, self._careful_speed(np.linspace(s, self.until, 2000)))
        deadline = world.t + 10.0 + 3.0 * (self.until - s) / careful
        while True:
            before, t_before = s, world.t
            try:
                info = self._interval(record)
            except ControllerLost as error:
                self.ended = f"{error} at {s % self.path.length:.0f} m"
                return None
            s = self.path.project(*world.exact[:2], before + world.exact[3] * h, reach=8.0)
            contour, beyond, kept = self._beyond(s)
            if record is not None:
                row = (world.t, s, *world.exact, *world.truth[-1][7:9], contour)
                record.add(row, beyond, kept, info)
            if world.spun:
                self.ended = f"the car spun at {s % self.path.length:.0f} m"
            elif beyond > self.width + LEFT_BEHIND:
                self.ended = f"the car left the track at {s % self.path.length:.0f} m"
            elif world.t > deadline:
                self.ended = "the lap took too long"
            if self.ended:
                return None
            if s >= self.until:
                self.crossing = t_before + h * (self.until - before) / (s - before)
                return self.crossing

    def _beyond(self, s: float) -> tuple[float, float, float]:
        """Return the contour error, how far a side of the car is beyond the border, negative within, and what
        plans keep there [m].
        """
        controller, half = self.controller, 0.5 * self.width
        point = self.path.at(np.array([s]))
        x, y = self.world.exact[:2]
        contour = float(contour_and_lag(point, np.array([x]), np.array([y]))[0][0])
        kept = controller.half_width - half + min(controller.deviation, float(controller.room(point)[0]))
        return contour, float(max(contour - point.right[0], -contour - point.left[0]) + half), kept

    def _interval(self, record: Tally | None) -> StepInfo:
        """Plan the interval after the next one while the car drives the next, then learn what came of it."""
        world, h = self.world, self.mpcc.step
        now = np.concatenate([world.measured, self.memory])
        ahead = self.model.linearize(now[None], self.rates[None]).following[0]
        if self.settings.delay:
            following, info = self.controller.step(ahead)
            applied = self.rates
        else:
            following, info = self.controller.step(now)
            applied = following
            ahead = self.model.linearize(now[None], applied[None]).following[0]
        self.memory = ahead[8:]
        first = len(world.rows) - 1
        world.drive(applied, h)
        self.rates = following
        if record is not None:
            # Lags and delays of the vehicle file settle over what was driven before the interval.
            begin = first - self.learner.run_up_rows(first - record.first, world.period)
            name = f"lap {record.number}"
            due = len(record.learned) % MOTION_EVERY == 0
            exact = world.recording(begin, name=name, exact=True) if due else None
            record.learned.append(self.learner.learn(world.recording(begin, name=name), begin - record.first, exact))
        return info

    def write(self, output: FilePath) -> None:
        """Write the laps as one drive, the run-up left out: Parquet, or MCAP as a logger would."""
        if not self.laps:
            return
        first, last = self.spans[self.laps[0].number][0], self.spans[self.laps[-1].number][1]
        drive = self.world.recording(first, last, output.name)
        if output.suffix.lower() == ".mcap":
            write_mcap(self.world.readings(drive), output)
        else:
            write_drive(drive, output)

    def result(self, output: str | FilePath | None, others: Sequence[RaceResult] = ()) -> RaceResult:
        """Return what was driven, compared with `others` as `whether_learning_helped` does."""
        known = any(what_lap_0_asks(other.laps, self.vehicle) for other in others)
        advice = "" if known else what_lap_0_asks(self.laps, self.vehicle)
        return RaceResult(
            track=self.path.name,
            car=self.car.name,
            vehicle=self.vehicle.name,
            learner=self.settings.learner,
            length=self.path.length,
            laps=tuple(self.laps),
            output=None if output is None else str(output),
            set_path=self.kept,
            notes=(*self.notes, *filter(None, [advice])),
            traces=tuple(self.traces),
            path=self.path,
            grips=tuple(self.grips),
            verdict=whether_learning_helped(self.laps, self.settings, others),
        )
