"""The loop of a race: plant, controller and learner interval by interval, and what changes from lap to lap.

`Race._interval` is one control interval, `Race._drive` runs to the next crossing of the line, `Race.drive_lap` is one
lap with the choices after it: margin to the border, share of the peak force, and grip.
"""

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
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.racing.choice import advice_after_lap_0, choose_features, whether_learning_helped
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
from split_cli.workflows.racing.first_lap import header_with_kernel, header_without_kernel, make_learner, with_past_term
from split_cli.workflows.racing.margin import relative_model_error
from split_cli.workflows.racing.result import Lap, RaceResult
from split_cli.workflows.racing.settings import RaceSettings, predictor_for
from split_cli.workflows.racing.tally import Tally

RUN_UP_SHARE, LONGEST_RUN_UP = 0.3, 200.0
"""Length of the run-up before the line: share of a lap [1], and at most [m]. Lap 0 then starts at speed."""

MOTION_EVERY = 4
"""The label of the exact motion is computed in every fourth interval only: with terms one takes milliseconds."""

LEFT_BEHIND = 1.0
"""A lap ends when the whole width of the car is beyond the border by this distance [m]."""


@contextmanager
def garbage_collection_paused() -> Iterator[None]:
    """Collect garbage once, then none in the body: a full collection takes longer than several control intervals."""
    was = gc.isenabled()
    gc.collect()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()


class Race:
    """A race: the plant, its controller and its learner, with what was driven so far.

    Parameters
    ----------
    set_output : path or None
        File that the training set is written to after each lap; None writes none.
    say : callable
        Called with a line of text on progress.

    Attributes
    ----------
    laps, traces : list
        One entry a lap: its `Lap`, and the rows of `RaceResult.traces`.
    spans : dict of int to (int, int)
        For each lap, its first row of the world's recording and one past its last.
    grips : list of tuple of float
        Peak friction of front and rear axle [1], after each time it was learned.
    ended : str
        Why the race ended early, in words; empty while it goes on.
    undecided : bool
        Whether the choice of features is open, so that it is made again after the next lap.
    lines_begun : int
        Number of laps begun.
    crossing : float
        Time of the last crossing of the line [s].
    finish : float
        Progress along the centre line at which the current lap ends [m].
    deviation : float
        First distance to the border that plans keep beyond the least margin [m]; `Mpcc.deviation` is the current one.
    deviation_per_error : float
        That distance per relative error of the model (`_relative_error`) [m].
    header : TrainingSet
        Empty set with vehicle, features, grid and kernel of the learner.
    rates : ndarray, shape (2,)
        Rates of T [N m/s] and delta [rad/s] that are applied in the next interval.
    memory : ndarray
        States of the vehicle file's terms at the begin of the next interval, as the control model predicts them.

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
        check_features(with_past_term(vehicle, self.features)[0], self.features, settings.settings.step)
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
        self.written_set: str | None = None
        self.lines_begun, self.crossing, self.finish = 0, 0.0, 0.0
        self.deviation_per_error = self.deviation / FIRST_ERROR

    @property
    def begins_nominal(self) -> bool:
        """Whether the race starts without a trained set, so that the nominal model drives lap 0."""
        return self.start_set is None and self.exported is None

    def begin(self) -> None:
        """Put the car on the run-up to the first line, and find a first plan."""
        warm_up()
        s = self.settings
        speed = min(0.5 * s.max_speed, self._careful_speed(-np.linspace(0.0, -self.start, 200)))
        self.world = World(self.car, self.path, speed, self.start, s.grip, None if s.exact_sensors else s.seed)
        if self.start_set is None:
            modelled = self.vehicle if self.exported is None else self.exported.vehicle
            self.header = header_without_kernel(modelled, self.features, self.mpcc)
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
        """Return the speed [m/s] that takes half the grip in the tightest bend at arc lengths `s` [m].

        v^2 = 0.5 mu (2 D_min / m) / kappa_max, with D_min the smaller peak force of one axle.
        """
        bend = np.abs(self.path.at(s).curvature).max()
        tire = min(self.vehicle.front_tire.D, self.vehicle.rear_tire.D)
        return float(np.sqrt(0.5 * self.settings.grip * 2.0 * tire / self.vehicle.mass / max(bend, 1e-4)))

    def run(self) -> None:
        """Drive the run-up, lap 0 with the nominal model unless a set was given, and the other laps."""
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
        # From lap 1 on with the usual p_unknown and margin; p_ellipse goes on from that of lap 0.
        self.controller.limits = replace(self.mpcc.limits, p_ellipse=self.controller.limits.p_ellipse)
        self.controller.half_width = 0.5 * self.width + self.mpcc.margin
        self.controller.deviation = self.deviation

    def _choose_features(self) -> None:
        """Choose the features on all laps so far; where they change, learn these laps from the beginning."""
        laps = [self.world.recording(*span, name=f"lap {number}") for number, span in self.spans.items()]
        choice = choose_features(laps, self.header.vehicle, self.settings)
        chosen, number = parse_features(choice.features), self.laps[-1].number
        stays = number > 0 and chosen == self.header.features
        # An unchanged choice that is still open is not noted after each lap.
        if choice.reason and not (stays and choice.undecided):
            self.notes.append(choice.reason)
        self.undecided = choice.undecided
        if stays:
            return
        self.header, labels = header_with_kernel(self.header, laps, chosen, self.settings, self.notes)
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
        """Raise the share p_ellipse of the peak force that plans may use by one step, if the last lap was clean.

        The step is SHARE_STEP min(1, room / deviation): smaller where a narrow track leaves less room than the wanted
        deviation.
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
        """Estimate the friction of both axles from labels (`learned_grip`), if asked for, and use it."""
        if self.settings.learn_grip:
            self._take_grip(learned_grip(self.vehicle, self.header.features, z, y, self.settings.assumed_friction))
            self.grips.append(tuple(self.controller.grip.tolist()))
        else:
            self._take_grip(self.controller.grip)

    def _take_grip(self, grip: np.ndarray) -> None:
        """Set the friction of both axles [1], shape (2,): in the slip limits and in the residual's prior mean."""
        self.controller.grip = grip
        # An exported residual is complete: no prior mean is added to it.
        may_add = self.exported is None and self.mpcc.limits.guarded
        informed = may_add and tells_peaks(self.vehicle, self.header.features)
        self.learner.residual.rest_on(PeakShift(self.vehicle, self.header.features, grip) if informed else None)

    def drive_lap(self, number: int) -> None:
        """Drive one lap, learn from it, and choose margin, share of the peak and grip of the next."""
        controller = self.controller
        tally = Tally(number, len(self.world.rows) - 1, controller.limits.p_ellipse, self.path.length)
        self.learner.begin_lap(f"lap {number}", self.world.t)
        begin = self.crossing
        self.lines_begun += 1
        self.finish = self.lines_begun * self.path.length
        with garbage_collection_paused():
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
        self._adapt_margin_and_share(tally)
        self.model.residual = self.learner.residual
        if trained is not None and trained.size:
            self._learn_grip(trained.z, trained.y)
        self._keep(trained)

    def _adapt_margin_and_share(self, tally: Tally) -> None:
        """Set the deviation d, the distance to the border beyond the least margin, and p_ellipse of the next lap.

        Notes
        -----
        q+ = max(n/e, DEVIATION_KEPT q) and d = q+ e, with n [m] the most by which the car came nearer to the border
        than planned (`Tally.needed`), e [1] the model's relative error in the lap, and q [m] `deviation_per_error`.
        q falls slowly, since the next lap may err at another place. While the share of the peak rises, d does not
        fall, since e was found at a smaller share.
        """
        controller, before, share = self.controller, self.controller.deviation, self.controller.limits.p_ellipse
        error = self._relative_error(tally)
        self.deviation_per_error = max(tally.needed / error, DEVIATION_KEPT * self.deviation_per_error)
        controller.deviation = self.deviation_per_error * error
        self._raise_share()
        if controller.limits.p_ellipse > share:
            controller.deviation = max(controller.deviation, before)

    def _relative_error(self, tally: Tally) -> float:
        """Return `relative_model_error` of the last lap [1]; `FIRST_ERROR` where the margin does not follow it."""
        lap = self.laps[-1]
        if not self.settings.margin_by_error or isinstance(self.learner.residual, NoResidual) or self.ended:
            return FIRST_ERROR
        drive = self.world.recording(*self.spans[lap.number], name=f"lap {lap.number}")
        return relative_model_error(lap, drive, tally.labels, self.header.vehicle)

    def _keep(self, trained: TrainingSet | None) -> None:
        """Write the training set, if it holds points and a file was asked for."""
        if trained is not None and trained.size and self.set_output is not None:
            write_set(trained, self.set_output)
            self.written_set = str(self.set_output)

    def _drive(self, record: Tally | None) -> float | None:
        """Drive to the line at `finish`; return the time of crossing [s], or None, with `ended` set, if that failed."""
        world, h = self.world, self.mpcc.step
        s = self.path.project(*world.exact[:2], self.controller.plan.x[0, -2])
        careful = min(self.settings.max_speed, self._careful_speed(np.linspace(s, self.finish, 2000)))
        deadline = world.t + 10.0 + 3.0 * (self.finish - s) / careful
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
            if s >= self.finish:
                self.crossing = t_before + h * (self.finish - before) / (s - before)
                return self.crossing

    def _beyond(self, s: float) -> tuple[float, float, float]:
        """Return three lengths [m] at progress `s`: contour error, distance of a side of the car beyond the border
        (negative within the track), and the distance to the border that plans keep there.
        """
        controller, half = self.controller, 0.5 * self.width
        point = self.path.at(np.array([s]))
        x, y = self.world.exact[:2]
        contour = float(contour_and_lag(point, np.array([x]), np.array([y]))[0][0])
        kept = controller.half_width - half + min(controller.deviation, float(controller.room(point)[0]))
        return contour, float(max(contour - point.right[0], -contour - point.left[0]) + half), kept

    def _interval(self, record: Tally | None) -> StepInfo:
        """Drive the next interval while the one after it is planned, then learn from the new measurement.

        Without the computing delay (`RaceSettings.delay`) the plan made now is applied at once.
        """
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
            # The recording begins earlier, so that lags and delays of the vehicle file have settled at the interval.
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

    def _start_in_words(self) -> str:
        """Return the trained set or export that the race starts with; empty for the nominal model."""
        if self.exported is not None:
            return f"export {self.exported.name} ({self.exported.predictor})"
        if self.start_set is None:
            return ""
        name = FilePath(str(self.settings.start_set)).name
        return f"set {name} ({predictor_for(self.settings.predictor, self.start_set.features)})"

    def result(self, output: str | FilePath | None, others: Sequence[RaceResult] = ()) -> RaceResult:
        """Return the laps with a verdict in words, see `whether_learning_helped` for `others`."""
        known = any(advice_after_lap_0(other.laps, self.vehicle) for other in others)
        advice = "" if known else advice_after_lap_0(self.laps, self.vehicle)
        return RaceResult(
            track=self.path.name,
            car=self.car.name,
            vehicle=self.vehicle.name,
            learner=self.settings.learner,
            length=self.path.length,
            laps=tuple(self.laps),
            output=None if output is None else str(output),
            set_path=self.written_set,
            notes=(*self.notes, *filter(None, [advice])),
            traces=tuple(self.traces),
            path=self.path,
            grips=tuple(self.grips),
            verdict=whether_learning_helped(self.laps, self.settings, others),
            start=self._start_in_words(),
        )
