"""Recordings of a car that differs from its nominal model by known terms, as evidence."""

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis import engine
from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.case import DiagnosisCase, gather_case
from split_cli.diagnosis.innovations.evidence import Evidence, gather_evidence, rolling
from split_cli.diagnosis.innovations.linearisation import linearise
from split_cli.diagnosis.innovations.noise_memory import noise_model
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, build_objective
from split_cli.diagnosis.innovations.whitening import build_whitener
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.series import Series, build_series
from split_cli.diagnosis.search.candidates import Candidate, build_candidates
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import Selection, select_terms
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.logs.drive import Drive
from split_cli.logs.track_position import places_of
from split_cli.proof.sets import scripted_drive
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import make_drive, remembered, road_car

#: Standard deviation of a sample of v_x, v_y [m/s] and r [rad/s].
SIGMA = np.array([0.02, 0.02, 0.004])
#: Length of the lap that runs start anywhere on [m], and time from the start of one to that of the next [s].
LAP, STAMP = 400.0, 6.0
#: Variance inflation factor of tests of the search, p value below which a term has a name, five terms that may.
INFLATION, LEVEL = 1.5, 2.5e-4
NAMES = ("aero_drag", "rolling_resistance", "steer_gain", "yaw_inertia", "tire_stiffness")


def recorded(seed: int, terms: Sequence[Term] = (), *, segments: int = 20, seconds: float = 4.0) -> Evidence:
    """Return evidence of runs of some seconds at 100 Hz with white sensor noise, against the nominal car."""
    car = road_car()
    drive = make_drive(seed, segments=segments, seconds=seconds, period=0.01, vehicle=car, terms=terms)
    rng = np.random.default_rng(seed + 100)
    noisy = {
        name: drive[name] + rng.normal(0.0, level, len(drive))
        for name, level in zip(("vx", "vy", "r"), SIGMA, strict=True)
    }
    drive = Drive(drive.name, {**drive.columns, **noisy}, drive.segment, drive.period)
    s = np.concatenate([[0.0], np.cumsum(0.01 * drive["vx"][1:])])
    series = build_series(drive, "real", s)
    return gather_evidence(car, series, build_shared_discrepancy(car, series))


def noisy_series(car: Vehicle, terms: Sequence[Term], seed: int, role: str) -> Series:
    """Return a scripted drive of a car with terms at 100 Hz, commands held, with white sensor noise."""
    columns, rng = dict(scripted_drive(car, terms, seed, runs=8)), np.random.default_rng(seed)
    segment = columns.pop("segment")
    for name, sigma in zip(("vx", "vy", "r"), SIGMA, strict=True):
        columns[name] = columns[name] + rng.normal(0.0, sigma, len(segment))
    drive = Drive(f"{role}.parquet", columns, segment, 0.01).with_held(("T", "delta"))
    return build_series(drive, role, np.cumsum(0.01 * columns["vx"]))


def first_order(inputs: np.ndarray, tau: float, step: float) -> np.ndarray:
    """Return inputs (runs, K) behind a lag, steady at the start, to second order in the step."""
    kept, out = np.exp(-step / tau), inputs.copy()
    for k in range(inputs.shape[1] - 1):
        out[:, k + 1] = kept * out[:, k] + (1.0 - kept) * 0.5 * (inputs[:, k] + inputs[:, k + 1])
    return out


def late(inputs: np.ndarray, delay: float, step: float) -> np.ndarray:
    """Return inputs (runs, K) as they were `delay` before, the first value held."""
    t = step * np.arange(inputs.shape[1])
    return np.stack([np.interp(t - delay, t, row) for row in inputs])


@remembered
def driven(
    seed: int,
    terms: Sequence[Term] = (),
    *,
    runs: int = 16,
    seconds: float = 5.0,
    steer: Callable[[np.ndarray, float], np.ndarray] = lambda inputs, step: inputs,
    torque: Callable[[np.ndarray, float], np.ndarray] = lambda inputs, step: inputs,
    spaced: float = STAMP,
    name: str = "driven.parquet",
) -> Drive:
    """Return a noise-free drive of the nominal car with `terms`, with position, yaw and place, at 100 Hz.

    Runs start `spaced` seconds apart, anywhere on a lap of `LAP` metres; `steer` and `torque` say what becomes of
    commands (runs, K) on the clock of the integration, 2.5 ms, apart from the engine's own lags and delays.
    """
    model, rng, step = SingleTrack(road_car(), tuple(terms)), np.random.default_rng(seed), 2.5e-3
    knots = round(seconds / 0.2) + 1
    speed = rng.uniform(10.0, 26.0, runs)
    angle = rng.normal(0.0, 1.0, (runs, knots)) * np.minimum(0.06, 14.0 / speed**2)[:, None]
    moment = rng.uniform(-0.5, 0.6, (runs, knots)) * road_car().max_torque
    fine = np.linspace(0.0, knots - 1.0, round(seconds / step) + 1)
    commands = [np.array([np.interp(fine, np.arange(knots), row) for row in each]) for each in (moment, angle)]
    arrived = torque(commands[0], step), steer(commands[1], step)
    place = rng.uniform(0.0, LAP, runs)
    zero = np.zeros(runs)
    state = np.stack([zero, zero, rng.uniform(-3.0, 3.0, runs), speed, zero, zero], axis=1)
    states, places, memory = [state], [place], None
    for k in range(0, len(fine) - 1, 4):
        window = slice(k, k + 5)
        before = state
        state, memory = integrate_with_memory(
            model,
            state,
            arrived[0][:, window],
            arrived[1][:, window],
            step,
            situation=Situation(t=spaced * np.arange(runs) + k * step, s=places[-1], states=memory),
        )
        places.append(np.mod(places[-1] + 0.5 * 0.01 * (before[:, 3] + state[:, 3]), LAP))
        states.append(state)
    path = np.stack(states, axis=1)
    number = np.repeat(np.arange(runs), path.shape[1])
    columns = {
        "t": np.tile(0.01 * np.arange(path.shape[1]), runs) + spaced * number,
        **{channel: path[:, :, i].ravel() for i, channel in enumerate(("X", "Y", "yaw", "vx", "vy", "r"))},
        "T": commands[0][:, ::4].ravel(),
        "delta": commands[1][:, ::4].ravel(),
        "s": np.stack(places, axis=1).ravel(),
    }
    return Drive(name, columns, number.astype(np.int32), 0.01)


def noisy(drive: Drive, seed: int, *, share: float = 1.0, position: float = 0.0) -> Drive:
    """Return a drive with white sensor noise, `share` of `SIGMA`, and of `position` [m] in X and Y."""
    rng = np.random.default_rng(seed)
    levels = {**dict(zip(("vx", "vy", "r"), share * SIGMA, strict=True)), "X": position, "Y": position}
    columns = {name: drive[name] + rng.normal(0.0, level, len(drive)) for name, level in levels.items()}
    return replace(drive, columns={**drive.columns, **columns})


def prepared(drive: Drive, role: str = "real") -> Series:
    """Return the series of a drive made by `driven`; places are on its lap."""
    return build_series(drive, role, drive["s"], lap_length=LAP, place_reference="position")


def light_evidence(series: Series, disturbance: float = 1e-8) -> Evidence:
    """Return evidence of a known disturbance, without the shared discrepancy's columns: for many replicates."""
    car = road_car()
    linear = linearise(car, series)
    rows = 4
    group, at = np.full(len(series) - 1, -1, dtype=np.int64), []
    for begin, end in series.recording.segments:
        count = (end - 1 - begin) // rows
        group[begin : begin + rows * count] = len(at) + np.repeat(np.arange(count), rows)
        at += list(begin + rows // 2 + rows * np.arange(count))
    strength = disturbance * np.array([1.0, 1.0, car.mass / car.yaw_inertia])
    whitener = build_whitener(
        noise_model(linear), series.noise, strength, series.period, series.transitions_begin(), group
    )
    evidence = Evidence(
        car,
        series,
        linear,
        whitener,
        np.zeros((len(at), 3)),
        np.zeros((len(at), 3, 0)),
        np.array(at, dtype=np.int64),
        strength,
        np.ones(len(at)),
        rolling(series, car),
    )
    return replace(evidence, nominal_rows=evidence.rows(()))


def bare_objective(*evidence: Evidence, kinematics: Sequence[KinematicResiduals] = ()) -> MarginalLikelihood:
    """Return an objective on all rows, the nominal model being the simulation."""
    keep = [np.ones(len(one.at), dtype=bool) for one in evidence]
    discrepancy = build_shared_discrepancy(evidence[0].vehicle, evidence[0].series)
    return build_objective(evidence, None, discrepancy, keep, kinematics)


def noisy_objective(drive: Drive, seed: int, disturbance: float = 1e-8) -> MarginalLikelihood:
    """Return an objective of a noise-free drive with white sensor noise, of a known disturbance."""
    return bare_objective(light_evidence(prepared(noisy(drive, seed)), disturbance))


def case_of(reality: Drive, simulation: Drive) -> DiagnosisCase:
    """Return the case of one real drive against one simulated one."""
    places, _ = places_of([reality, simulation], road_car().wheelbase)
    roles = zip((reality, simulation), ("real", "sim"), places, strict=True)
    return gather_case(road_car(), [build_series(one, role, s) for one, role, (s, _) in roles])


def fitted_value(case: DiagnosisCase, term: str, variant: str = "", parameter: str = "scale") -> float:
    """Return a parameter of a term that is fitted alone, the simulation being a fixed baseline."""
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep, case.kinematics)
    every = build_candidates(case.vehicle, objective.evidence[0].series)
    (candidate,) = (one for one in every if (one.term, one.variant) == (term, variant))
    fit = fit_parts(objective.with_fixed_baseline(), (Part(candidate, dict(candidate.starts[0])),))
    return fit.parts[0].values[parameter]


def planted(**values: float) -> tuple[Term, ...]:
    """Return terms by their names, each with the value of its first parameter."""
    return tuple(CATALOGUE[name]({next(iter(CATALOGUE[name].units)): value}) for name, value in values.items())


def objective_with(*terms: Term, seed: int = 21, **commands) -> MarginalLikelihood:
    """Return an objective of a drive of the car with these terms, made by `driven`, with white sensor noise."""
    return noisy_objective(driven(seed, terms, **commands), 5)


def named(selection: Selection) -> set[str]:
    return {term.id for term in selection.terms}


def candidates_of(objective: MarginalLikelihood, *names: str) -> list[Candidate]:
    """Return the candidates of these terms in all variants that need no simulation."""
    every = build_candidates(objective.evidence[0].vehicle, objective.evidence[0].series)
    return [one for one in every if one.term in names and "simulation" not in one.needs]


def explorer(objective: MarginalLikelihood, *terms: str | Candidate) -> Explorer:
    return Explorer(objective, _as_candidates(objective, terms), INFLATION)


def selected(objective: MarginalLikelihood, *terms: str | Candidate) -> Selection:
    """Return what the search selects among terms: candidates, or names as for `candidates_of`."""
    return select_terms(objective, _as_candidates(objective, terms), INFLATION)


def _as_candidates(objective: MarginalLikelihood, terms: Sequence[str] | Sequence[Candidate]) -> tuple[Candidate, ...]:
    named = all(isinstance(one, str) for one in terms)
    return tuple(candidates_of(objective, *terms) if named else terms)


def verdict_of(*drives: object, policy: Policy = STANDARD) -> Diagnosis:
    """Return what is named, without held-out errors and detection limits, which take more than half of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "detection_limits", lambda *_: ())
        return engine.diagnose(*drives, policy=policy, improved=False)


def faulty(drive: Drive, *, angle: float = 0.0, dx: float = 0.0) -> Drive:
    """Return a drive whose velocity sensor is turned by `angle` and sits `dx` ahead, by the geometry alone."""
    vx, vy = drive["vx"], drive["vy"] + dx * drive["r"]
    turned = {"vx": np.cos(angle) * vx + np.sin(angle) * vy, "vy": np.cos(angle) * vy - np.sin(angle) * vx}
    return replace(drive, columns={**drive.columns, **turned})
