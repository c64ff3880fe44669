"""Manoeuvres between cones in closed loop, with the nominal model or with a trained set."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path as FilePath

import numpy as np

from split_cli.control.exported import ExportedResidual
from split_cli.control.grip import PeakShift, learned_grip, tells_peaks
from split_cli.control.learner import learning_region
from split_cli.control.limits import Limits, nominal_share
from split_cli.control.model import ControlModel, check_features
from split_cli.control.mpc import Mpc, MpcSettings, SpeedController
from split_cli.control.path import contour_and_lag
from split_cli.control.policy import MODEL_CAR, P_LONG, SHARE_LEARNED, SIZE
from split_cli.control.receding_horizon import Actuators, ControllerLost
from split_cli.control.residual import NoResidual, PredictorResidual, Residual
from split_cli.control.scenarios import CONE_RADIUS, Scenario, build_scenario, cones_hit
from split_cli.errors import SplitError
from split_cli.files import refuse_overwriting_inputs, refuse_what_cannot_be_written
from split_cli.learning.cells import learn
from split_cli.learning.features import FeatureSet, parse_features
from split_cli.learning.hyperparameters import FEWEST_TO_FIT, default_kernel, fit_kernel, scatter_variance
from split_cli.learning.labels import Reason, compute_labels
from split_cli.learning.region import build_grid
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs.drive import write_drive
from split_cli.plant.cars import CarParameters, find_car
from split_cli.plant.recording import write_mcap
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.racing.closed_loop import World, body_ends, body_width
from split_cli.workflows.racing.entry import check_car, check_numbers, check_predictor, check_torque, check_trusted
from split_cli.workflows.racing.first_lap import with_past_term
from split_cli.workflows.racing.settings import AUTO, predictor_for


@dataclass(frozen=True)
class ManeuverSettings:
    """What to drive."""

    scenario: str = "iso3888-1"
    car: str = "road_car"
    # A trained set, or the folder of its export; the nominal model alone without one.
    start_set: str | FilePath | None = None
    predictor: str = AUTO  # evaluates the set; ``auto`` as of a race
    speeds: tuple[float, ...] = ()  # entry speeds [m/s]; the scenario's own when empty
    grip: float = 1.0  # friction of the road [1]
    seed: int = 0
    # exact_sensors, delay: as of a race.
    exact_sensors: bool = False
    delay: bool = True
    width: float | None = None  # of the car's body [m]
    scale: float | None = None  # of the course [1]; by default 1, for model cars the share of a full-size wheelbase
    max_torque: float | None = None  # [N m]
    # Of the controller's limits [1]; below that of races, since a whole manoeuvre brakes while it turns.
    p_long: float = P_LONG
    # Share of the peak [1]; by default what races use with the nominal model, or with what was learned.
    p_ellipse: float | None = None
    guarded: bool = True  # as of `Limits`; the peaks are those that the set's labels tell
    features: str = "z2"  # of a set that the first run trains

    def limits(self, vehicle: Vehicle) -> Limits:
        """Return the limits of the controller that drives with a vehicle file, and with the start set if any."""
        share = self.p_ellipse
        if share is None:
            share = nominal_share(vehicle) if self.start_set is None else SHARE_LEARNED
        return Limits(p_long=self.p_long, p_ellipse=share, guarded=self.guarded)


@dataclass(frozen=True)
class ManeuverRun:
    """One entry speed."""

    speed: float  # asked for [m/s]
    # entered, left: speed at the first cone and at the end [m/s].
    entered: float
    left: float
    # cones, hit: how many there are, and how many the car touched.
    cones: int
    hit: int
    deviation: float  # largest distance of the CG from the line within the manoeuvre [m]
    max_lateral: float  # [m/s^2]
    solver_ms: tuple[float, ...]  # median, 99 % and worst of HPIPM [ms]
    failures: int  # programmes without a solution
    ended: str  # why the manoeuvre was not finished; empty when it was
    trace: np.ndarray  # a row a sample: t, X, Y, yaw, v_x, v_y, r, a_x, a_y, T, delta
    hit_at: np.ndarray  # (hit, 2): cones that were touched [m]

    @property
    def passed(self) -> bool:
        """Whether it was finished without a cone."""
        return not self.ended and self.hit == 0


@dataclass(frozen=True)
class ManeuverResult:
    """All entry speeds."""

    scenario: str
    car: str
    vehicle: str
    model: str
    grip: float
    width: float  # [m]
    scale: float  # of the course [1]
    runs: tuple[ManeuverRun, ...]
    highest_passed: float | None  # highest speed up to which every run passed [m/s]
    output: str | None = None
    set_path: str | None = None

    def summary(self) -> ManeuverResult:
        """Return the result without its traces."""
        nothing = np.empty(0)
        return replace(self, runs=tuple(replace(run, trace=nothing) for run in self.runs))


def run_maneuvers(
    settings: ManeuverSettings,
    vehicle_path: str | FilePath,
    *,
    output: str | FilePath | None = None,
    set_output: str | FilePath | None = None,
    progress: Callable[[str], None] | None = None,
) -> ManeuverResult:
    """Drive a manoeuvre at each entry speed; write the first drive, and a set learned from it.

    Raises
    ------
    SplitError
        If an input is at fault or the start is infeasible.
    """
    say = progress or (lambda text: None)
    for path in (output, set_output):
        if path is not None:
            refuse_overwriting_inputs((vehicle_path, settings.start_set or vehicle_path), path)
            refuse_what_cannot_be_written(path)
    _check(settings)
    vehicle, car = read_vehicle(vehicle_path), find_car(settings.car)
    check_car(vehicle, car)
    driven, residual, model, grip = _residual(settings, vehicle)
    width = settings.width or body_width(car)
    scale = course_scale(car) if settings.scale is None else settings.scale
    scenarios = [build_scenario(settings.scenario, width, v, scale) for v in settings.speeds or (None,)]
    if scale != 1.0:
        say(f"course: for full-size cars, scaled by {scale:.3g} for a wheelbase of {car.wheelbase:.3g} m")
    features = parse_features(settings.features)
    check_features(with_past_term(vehicle, features)[0], features, scenarios[0].step)
    runs, worlds = [], []
    for scenario in scenarios:
        say(f"{scenario.name} at {scenario.entry_speed:g} m/s")
        run = _Run(settings, scenario, driven, car, residual, grip, width)
        runs.append(run.drive())
        worlds.append(run.world)
    if output is not None:
        _write(worlds[0], FilePath(output))
    if set_output is not None:
        _learn(worlds[0], vehicle, features, scenarios[0].step, set_output)
    return ManeuverResult(
        scenario=settings.scenario,
        car=car.name,
        vehicle=vehicle.name,
        model=model,
        grip=settings.grip,
        width=width,
        scale=scale,
        runs=tuple(runs),
        highest_passed=_highest(runs),
        output=None if output is None else str(output),
        set_path=None if set_output is None else str(set_output),
    )


def course_scale(car: CarParameters) -> float:
    """Return the scale of a course for a car [1]: below 1 for model cars alone; standards tell the others'."""
    return car.wheelbase / SIZE if car.wheelbase < MODEL_CAR else 1.0


def scaled_controller(settings: MpcSettings, scale: float) -> MpcSettings:
    """Return settings that drive a course of `scale` [1] as the given ones drive the full one.

    Notes
    -----
    With lengths times s and times times sqrt(s), each term of the cost keeps its value: a weight of a squared
    length is divided by s^2, of a speed by s. That of a squared rate of an angle or of a share of the torque is
    multiplied by s.
    """
    w = settings.weights
    places = {"contour": w.contour, "lag": w.lag, "track": w.track}
    rates = {"torque_rate": w.torque_rate, "steer_rate": w.steer_rate}
    scaled = {name: value / scale**2 for name, value in places.items()}
    weights = replace(w, **scaled, **{name: value * scale for name, value in rates.items()})
    return replace(
        settings,
        weights=weights,
        speed=settings.speed / scale,
        yaw_rate=settings.yaw_rate * scale,
        margin=settings.margin * scale,
    )


def _check(settings: ManeuverSettings) -> None:
    positive = [("--grip", settings.grip), ("--p-long", settings.p_long)]
    positive += [("--speed", speed) for speed in settings.speeds]
    positive += [("--max-torque", settings.max_torque), ("--width", settings.width), ("--scale", settings.scale)]
    check_numbers(positive, {"--p-ellipse": settings.p_ellipse}, {}, settings.seed)


def _highest(runs: Sequence[ManeuverRun]) -> float | None:
    """Return the highest speed below the first that failed."""
    best = None
    for run in sorted(runs, key=lambda run: run.speed):
        if not run.passed:
            break
        best = run.speed
    return best


def _residual(settings: ManeuverSettings, vehicle: Vehicle) -> tuple[Vehicle, Residual, str, np.ndarray]:
    """Return what the controller's model is made of.

    That is the vehicle with what its set found beyond the file, the residual, what it is called, and the tyres'
    peaks that its labels tell, shape (2,).
    """
    if settings.start_set is None:
        return vehicle, NoResidual(), "nominal", np.ones(2)
    if FilePath(settings.start_set).is_dir():
        exported = ExportedResidual(FilePath(settings.start_set), vehicle)
        grip = exported.grip(vehicle, settings.limits(vehicle).alpha_max) if settings.guarded else np.ones(2)
        return exported.vehicle, exported, f"export {exported.name} ({exported.predictor})", grip
    training_set = read_set(settings.start_set)
    check_trusted(training_set, vehicle, settings.start_set)
    check_predictor(settings.predictor, training_set.features)
    predictor = predictor_for(settings.predictor, training_set.features)
    residual = PredictorResidual(training_set, predictor)
    grip = np.ones(2)
    if settings.guarded and tells_peaks(vehicle, training_set.features):
        grip = learned_grip(vehicle, training_set.features, training_set.z, training_set.y)
        residual.rest_on(PeakShift(vehicle, training_set.features, grip))
    return training_set.vehicle, residual, f"set ({predictor})", grip


def _write(world: World, output: FilePath) -> None:
    drive = world.recording(name=output.name)
    if output.suffix.lower() == ".mcap":
        write_mcap(world.readings(drive), output)
    else:
        write_drive(drive, output)


def _learn(world: World, vehicle: Vehicle, features: FeatureSet, step: float, output: str | FilePath) -> None:
    """Learn one run into a new set, its kernel fitted to the same run.

    Notes
    -----
    A run in which an axle lets go is learned up to there. Between two slides slip angles pass through zero at
    rates that no driving has, tyres follow late, and features of one moment take that for a force.
    """
    vehicle, added = with_past_term(vehicle, features)
    limits = Limits()
    region = learning_region(vehicle, limits.alpha_max, limits.dalpha_max, limits.p_long)
    labels = compute_labels(world.recording(name="maneuver"), vehicle, features, region, horizon=step)
    slides = np.flatnonzero(labels.reason == int(Reason.SLIP))
    labels = labels.take(slice(0, int(slides[0]) if len(slides) else None))
    good = labels.accepted
    if not good.any():
        what = "the run gave no valid label, so no set can be trained on it"
        raise SplitError(what, where=str(output), advice="Lower --speed, so that the run lasts longer.")
    grid = build_grid(features, vehicle, region, labels.z[good])
    kernel = default_kernel(grid, labels.y[good], scatter_variance(labels))
    if np.count_nonzero(good) >= FEWEST_TO_FIT:
        kernel = fit_kernel(labels.z[good], labels.y[good], grid, kernel).kernel
    trained = learn([labels], vehicle=vehicle, grid=grid, kernel=kernel)
    write_set(replace(trained, found_effects=added), output)


class _Run:
    """One manoeuvre at one speed."""

    def __init__(
        self,
        settings: ManeuverSettings,
        scenario: Scenario,
        vehicle: Vehicle,
        car: CarParameters,
        residual: Residual,
        grip: np.ndarray,
        width: float,
    ) -> None:
        self.settings, self.scenario, self.car, self.width = settings, scenario, car, width
        self.world = World(
            car,
            scenario.path,
            scenario.entry_speed,
            0.0,
            settings.grip,
            None if settings.exact_sensors else settings.seed,
        )
        self.model = ControlModel(vehicle, residual, scenario.step)
        torque = min(settings.max_torque or vehicle.max_torque, vehicle.max_torque)
        check_torque(vehicle, torque)
        self.actuators = Actuators(torque, vehicle.max_brake_torque, steer_rate=car.steer_rate)
        mpc = MpcSettings(
            horizon=scenario.horizon,
            step=scenario.step,
            steering_alone=scenario.steering_alone,
            limits=settings.limits(vehicle),
        )
        mpc = scaled_controller(mpc, scenario.scale)
        self.controller = Mpc(self.model, scenario.path, self.actuators, mpc, width, scenario.speed)
        self.controller.grip = grip
        self.speed = SpeedController(scenario.entry_speed, vehicle.mass, vehicle.wheel_radius).scaled(scenario.scale)

    def drive(self) -> ManeuverRun:
        """Drive to the end, or to where it is lost."""
        world, h, controller = self.world, self.scenario.step, self.controller
        memory = self.model.steady_states(world.measured)[8:]
        controller.begin(np.concatenate([world.measured, memory]), 0.0)
        rates, infos, ended = controller.plan.u[0, :2].copy(), [], ""
        deadline = 3.0 * self.scenario.finish / self.scenario.exit_speed + 5.0
        while world.exact[0] < self.scenario.path.x[0] + self.scenario.finish:
            now = np.concatenate([world.measured, memory])
            if self.scenario.steering_alone:
                torque = self.speed.torque(now[3], h, self.actuators)
                most = self.actuators.torque_rate
                rates[0] = np.clip((torque - now[6]) / h, -most, most)
            ahead = self.model.linearize(now[None], rates[None]).following[0] if self.settings.delay else now
            try:
                following, info = controller.step(ahead)
            except ControllerLost as error:
                ended = str(error)
                break
            infos.append(info)
            applied = rates if self.settings.delay else np.array([rates[0], following[1]])
            if self.model.memory:
                memory = self.model.linearize(now[None], applied[None]).following[0][8:]
            world.drive(applied, h)
            rates = following
            if world.spun:
                ended = "the car spun"
                break
            if world.t > deadline:
                ended = "the manoeuvre took too long"
                break
        return self._result(infos, ended)

    def _result(self, infos: list, ended: str) -> ManeuverRun:
        truth, scenario = np.array(self.world.truth), self.scenario
        x, y, yaw = truth[:, 1], truth[:, 2], truth[:, 3]
        front, rear = body_ends(self.car)
        hit = cones_hit(scenario.cones, x, y, yaw, front, rear, self.width, CONE_RADIUS * scenario.scale)
        inside = (x >= 0.0) & (x <= scenario.lanes[-1].end)
        s, contour = 0.0, []
        for xi, yi in zip(x[inside], y[inside], strict=True):
            s = scenario.path.project(xi, yi, s or scenario.path.nearest(xi, yi))
            contour.append(contour_and_lag(scenario.path.at(np.array([s])), np.array([xi]), np.array([yi]))[0][0])
        entered = truth[np.argmax(x >= 0.0), 4] if (x >= 0.0).any() else float("nan")
        seconds = [info.solver_seconds for info in infos] or [0.0]
        return ManeuverRun(
            speed=scenario.entry_speed,
            entered=float(entered),
            left=float(truth[-1, 4]),
            cones=len(scenario.cones),
            hit=int(hit.sum()),
            deviation=float(np.abs(contour).max(initial=0.0)),
            max_lateral=float(np.abs(truth[:, 8]).max()),
            solver_ms=tuple((1e3 * np.quantile(seconds, [0.5, 0.99, 1.0])).tolist()),
            failures=sum(not info.solved for info in infos),
            ended=ended,
            trace=truth,
            hit_at=scenario.cones[hit],
        )
