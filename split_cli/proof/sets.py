"""Several effects at once in a car that otherwise obeys its nominal equations: what a joint search can reach.

The plant differs from any nominal model in more than its effects. Here nothing else differs, so what is not found
is lost in the search, and not in the physics that a single track lacks. The driver is a script: steps of torque
and steer angle that the car keeps, run by run.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.assembling.noise import estimate_noise
from split_cli.logs.drive import Drive, DriveMetadata
from split_cli.proof.cases import Answer, Case, ConcealedEffect
from split_cli.proof.nominal_terms import NOMINAL_TERMS
from split_cli.proof.plan import CasePlan
from split_cli.proof.recordings import RATE
from split_cli.proof.truth import error_to_noise
from split_cli.proof.windows import errors_of_terms
from split_cli.vehicle.effects import CATALOGUE, Recording, Term
from split_cli.vehicle.effects.recording import play_response
from split_cli.vehicle.effects.search import Course
from split_cli.vehicle.integration import Situation, integrate_with_memory
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import MagicFormula, Vehicle, read_vehicle
from split_cli.vehicle.single_track import SingleTrack

_STEP = 2.5e-3  # [s], of the integration
_HELD = 0.02  # [s], of the commands
_KNOT = 0.2  # [s], between set points of the script
_RUNS, _SECONDS = 9, 10.0
_SIGMA = np.array([0.02, 0.02, 0.004])  # of v_x, v_y [m/s] and r [rad/s] for a full-size car
_CARS = ("av21", "genesis", "tum_sim")
_REACHED = 1.25  # by how much an effect may miss the bounds of its effect-to-noise ratio
_DRAWS = 8  # of car and script, until the car does not spin
_MOST_SIDEWAYS = 0.6  # lateral over longitudinal velocity; a car beyond it spins
_ROUNDS = 4  # of the search for an effect's size

_DELAYS = ("drive_delay", "steer_delay", "sensor_delay")
_ON_COMMANDS = (*_DELAYS, "steer_gain", "steer_backlash")


def build_nominal_set(plan: CasePlan) -> Case:
    """Return a case whose car is its nominal model with the plan's terms, their sizes drawn for the plan.

    Raises
    ------
    SplitError
        If none of eight drawings of car and script leaves the car on its wheels.
    """
    for attempt in range(_DRAWS):
        rng = plan.rng(11, attempt) if attempt else plan.rng(11)
        try:
            case = _drawn(plan, rng)
            return replace(case, answer=replace(case.answer, draws=attempt + 1))
        except SplitError as error:
            # Together the effects made the car spin, which none of them does alone.
            reason = error
    raise SplitError(f"case {plan.number} of seed {plan.seed} cannot be built: {reason}")


def _drawn(plan: CasePlan, rng: np.random.Generator) -> Case:
    vehicle = _varied(rng)
    sizes = {term: _sized(vehicle, term, plan, rng) for term in plan.terms}
    terms = [built for built, _ in sizes.values()]
    noise = _SIGMA * np.sqrt(vehicle.wheelbase / 2.7) * np.array([1.0, 1.0, 2.7 / vehicle.wheelbase])
    seed = int(rng.integers(2**31))
    real = _recorded(scripted_drive(vehicle, terms, seed), "real", noise, rng)
    sim = None
    if rng.random() < 0.5:
        sim = _recorded(scripted_drive(vehicle, (), seed + 1), "sim", 0.0 * noise, rng)
    effects = tuple(
        ConcealedEffect(term.id, found, found, dict(term.parameters), tuple(term.parameters), term.variant, 1.0)
        for term, found in sizes.values()
    )
    answer = Answer(
        number=plan.number,
        kind=plan.kind,
        tier=plan.tier,
        effects=effects,
        car=vehicle.name,
        base="nominal",
        simulation="nominal" if sim is None else "same equations",
        base_effect_to_noise=0.0,
        total_effect_to_noise=float(np.sqrt(sum(one.effect_to_noise**2 for one in effects))),
        removed=1.0,
    )
    return Case(real, sim, vehicle, answer, None, noise)


def scripted_drive(
    vehicle: Vehicle, terms: Sequence[Term], seed: int, *, runs: int = _RUNS, seconds: float = _SECONDS
) -> Mapping[str, np.ndarray]:
    """Return noise-free columns of runs with steps of torque and steer angle, at 100 Hz, a segment a run.

    Parameters
    ----------
    terms : sequence of Term
        Physics of the car, and faults of its sensors.
    seconds : float
        Of each run [s].
    """
    rng = np.random.default_rng(seed)
    pace = np.sqrt(vehicle.wheelbase / 2.7)
    knots, count = round(seconds / _KNOT) + 1, round(seconds / _STEP)
    speed = pace * rng.uniform(12.0, 26.0, runs)
    most_turn = 0.55 * (vehicle.front_tire.D + vehicle.rear_tire.D) / vehicle.mass
    largest = np.minimum(0.12, most_turn * vehicle.wheelbase / speed**2)
    angle = rng.normal(0.0, 0.5, (runs, knots)) * largest[:, None]
    most = min(0.6 * vehicle.max_torque, 4.0 * vehicle.mass * vehicle.wheel_radius)
    torque = rng.uniform(-0.9, 1.0, (runs, knots)) * most
    at = np.arange(count + 1) * _STEP
    kept = np.floor(at / _HELD + 1e-6) * _HELD
    commands = [np.array([np.interp(kept / _KNOT, np.arange(knots), row) for row in each]) for each in (torque, angle)]
    arrived = [_arrived(row, terms, channel) for row, channel in zip(commands, ("T", "delta"), strict=True)]
    model = SingleTrack(vehicle, [one for one in terms if one.exported and one.id not in _ON_COMMANDS])
    zero = np.zeros(runs)
    every = round(1.0 / RATE / _STEP)
    state = np.stack([zero, zero, rng.uniform(-3.0, 3.0, runs), speed, zero, zero], axis=1)
    substeps = 2 if pace > 0.6 else 6
    path = np.stack(_integrated(model, state, arrived, every, substeps), axis=1)
    if not np.isfinite(path).all() or np.any(np.abs(path[:, :, 4]) > _MOST_SIDEWAYS * np.abs(path[:, :, 3])):
        raise SplitError("the scripted car spins")
    length = path.shape[1]
    number = np.repeat(np.arange(runs), length)
    columns = {
        "t": np.tile(np.arange(length) / RATE, runs) + (seconds + 1.0) * number,
        **{name: path[:, :, i].ravel() for i, name in enumerate(("X", "Y", "yaw", "vx", "vy", "r"))},
        "T": commands[0][:, ::every].ravel(),
        "delta": commands[1][:, ::every].ravel(),
    }
    clock = Recording(1.0 / RATE, tuple((k * length, (k + 1) * length) for k in range(runs)))
    for term in terms:
        if not term.exported and term.id not in _DELAYS:
            columns = term.corrupt(columns, clock)
    return {**columns, "segment": number.astype(np.int32)}


def _integrated(model: SingleTrack, state: np.ndarray, arrived, every: int, substeps: int) -> list[np.ndarray]:
    """Return states at every `every`-th step, the terms' own memory carried on."""
    states, memory = [state], None
    for k in range(0, arrived[0].shape[1] - 1, every):
        window = slice(k, k + every + 1)
        state, memory = integrate_with_memory(
            model,
            state,
            arrived[0][:, window],
            arrived[1][:, window],
            _STEP,
            substeps,
            Situation(t=k * _STEP, states=memory),
            held=("T", "delta"),
        )
        states.append(state)
    return states


def _arrived(commands: np.ndarray, terms: Sequence[Term], channel: str) -> np.ndarray:
    """Return commands (R, K) on the integration's clock behind delays, steering gain and play among `terms`.

    Each is exact there; as differential equations a delay has none, and a play closes with a lag of its own.
    """
    by_id = {term.id: term.parameters for term in terms}
    delay = sum(getattr(term, "input_delays", {}).get(channel, 0.0) for term in terms)
    at = np.arange(commands.shape[1]) - int(round(delay / _STEP))
    out = commands[:, np.clip(at, 0, None)]
    if channel == "T":
        return out
    out = out * by_id.get("steer_gain", {}).get("gain", 1.0)
    if "steer_backlash" in by_id:
        clock = Recording.single(_STEP, out.shape[1])
        out = np.array([play_response(row, by_id["steer_backlash"]["width"], clock) for row in out])
    return out


def _varied(rng: np.random.Generator) -> Vehicle:
    car = read_vehicle(library_path(str(rng.choice(_CARS))))

    def tire(one: MagicFormula) -> MagicFormula:
        B, D = np.exp(rng.normal(0.0, 0.1, 2))
        return MagicFormula(one.B * float(B), one.C, one.D * float(D))

    mass, inertia = (float(x) for x in np.exp(rng.normal(0.0, 0.1, 2)))
    return replace(
        car,
        name="car",
        effects=(),
        mass=car.mass * mass,
        yaw_inertia=car.yaw_inertia * mass * inertia,
        front_tire=tire(car.front_tire),
        rear_tire=tire(car.rear_tire),
    )


def _sized(vehicle: Vehicle, term: str, plan: CasePlan, rng: np.random.Generator) -> tuple[Term, float]:
    """Return a term whose effect-to-noise ratio, alone, is drawn for the plan, and that effect-to-noise ratio."""
    directions, both = NOMINAL_TERMS[term]
    sign = float(rng.choice((-1.0, 1.0))) if both else 1.0
    kind, seed = CATALOGUE[term], int(rng.integers(2**31))
    target = plan.low * float(np.exp(np.log(plan.high / plan.low) * rng.uniform(0.1, 0.9)))
    size, best = 1.0, None
    for _ in range(_ROUNDS):
        parameters = {name: kind.neutral[name] + sign * size * step for name, step in directions.items()}
        if term in _DELAYS:
            parameters = {name: round(value / _STEP) * _STEP for name, value in parameters.items()}
        built = kind(parameters, kind.variants[0])
        found = _effect_to_noise(vehicle, built, seed)
        if best is None or abs(np.log(found / target)) < abs(np.log(best[1] / target)):
            best = built, found
        if abs(np.log(found / target)) < 0.1:
            break
        size *= float(np.clip(target / found, 0.2, 5.0))
    if not plan.low / _REACHED <= best[1] <= plan.high * _REACHED:
        # Grip that a script does not use up may be any multiple of itself: another sign, car or script shows it.
        raise SplitError(f"{term} cannot be made {plan.low:g} to {plan.high:g} times the noise")
    if not _is_possible(vehicle, best[0]):
        raise SplitError(f"no real car has {term} of {dict(best[0].parameters)}")
    return best


def _is_possible(vehicle: Vehicle, term: Term) -> bool:
    """Return whether a term's values lie within what a real car of that size can have."""
    kind = type(term)
    search = kind.search(vehicle, Course(_RUNS * _SECONDS, 1.0), term.variant)
    ranges = search.times(kind.sizes(vehicle)).ranges if search is not None else {}
    return all(limit.lower <= term.parameters[name] <= limit.upper for name, limit in ranges.items())


def _effect_to_noise(vehicle: Vehicle, term: Term, seed: int) -> float:
    noise = _SIGMA * np.sqrt(vehicle.wheelbase / 2.7) * np.array([1.0, 1.0, 2.7 / vehicle.wheelbase])
    columns = scripted_drive(vehicle, [term], seed, runs=8, seconds=4.0)
    columns = {**columns, "s": np.zeros(len(columns["t"]))}
    runs = [{name: values[columns["segment"] == k] for name, values in columns.items()} for k in range(8)]
    errors = [errors_of_terms(run, vehicle, (), held=("T", "delta")) for run in runs]
    return error_to_noise(np.concatenate(errors), noise)


def _recorded(columns: Mapping[str, np.ndarray], name: str, noise: np.ndarray, rng: np.random.Generator) -> Drive:
    segment = columns["segment"]
    noisy = {key: values for key, values in columns.items() if key != "segment"}
    for channel, sigma in zip(("vx", "vy", "r"), noise, strict=True):
        noisy[channel] = noisy[channel] + sigma * rng.standard_normal(len(segment))
    ends = np.flatnonzero(np.diff(segment, append=segment[-1] + 1)) + 1
    runs = [*zip([0, *ends[:-1]], ends, strict=True)]
    spans = [(int(a), int(b)) for a, b in runs]
    estimates = tuple(estimate_noise(one, noisy[one], spans) for one in ("vx", "vy", "r"))
    kinds = {"T": "command", "delta": "command", **dict.fromkeys(("X", "Y", "yaw", "vx", "vy", "r"), "measured")}
    between = {"T": "held", "delta": "held"}
    return Drive(name, noisy, segment, 1.0 / RATE, DriveMetadata(kinds=kinds, noise=estimates, between=between))
