"""A case: drives and a vehicle file that conceal an effect, and the answer that is sealed apart from them."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import lru_cache

import numpy as np

from split_cli.errors import SplitError
from split_cli.logs.drive import Drive
from split_cli.plant.cars import CARS
from split_cli.plant.drivers import DRIVER_STYLES
from split_cli.plant.simulation import Trajectory
from split_cli.proof.beyond_catalogue import beyond_catalogue
from split_cli.proof.cars import CarOfProof, bare, build_car, rich, varied_car
from split_cli.proof.concealed import Concealed, draw_effect
from split_cli.proof.plan import CasePlan
from split_cli.proof.recordings import START, record
from split_cli.proof.strange import draw_strange
from split_cli.proof.tracks import random_track
from split_cli.proof.truth import (
    ExactDrive,
    Unreachable,
    error_to_noise,
    exact_drive,
    fit_effective,
    removed_share,
    search_size,
)
from split_cli.proof.windows import errors_of_terms
from split_cli.proof.world import ProofWorld, Trip, drive, effect_error
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import Vehicle

LAP_LENGTH = {"road_car": 1050.0, "f1tenth_car": 55.0, "formula_car": 620.0}
"""Of the tracks of each of the plant's cars, before it is varied [m]."""
# Variants that no truth is said in: of waves, stretches, tracked frames, what follows late, lags of both cars, a
# height that acts in turns as well, and a lag of a trained set.
_NOT_CONCEALED = ("wave", "stretch", "frame", "late", "degressive late", "changed", "higher", "learned")
_CARS_OF_A_SEED = 12
_DRAWS = 24  # of surroundings and drivers, for the same terms
_SEARCH_SECONDS = 45.0
# What the true terms with their best parameters may leave of an effect: below the hard tier, or this share of it.
_LEFT = (0.12, 0.15)
# A bare nominal model whose own error without the effect is larger than this is not offered as the simulation.
_BARE_ENOUGH = 0.08


@dataclass(frozen=True)
class ConcealedEffect:
    """One concealed effect."""

    term: str
    size: float
    effect_to_noise: float
    # True values: physical where the term has such, else those that fit noise-free paired runs.
    parameters: dict[str, float] = field(default_factory=dict)
    scored: tuple[str, ...] = ()  # the parameters whose intervals are scored; stretches and wave lengths are not
    variant: str = ""  # with which the term fits best; empty for its default
    removed: float = 0.0  # share of the effect's own squared error that the term with these parameters removes [1]
    # beyond: of an effect outside the catalogue, the effect-to-noise ratio of what the two best terms leave of it.
    beyond: float = 0.0
    absorbed_by: tuple[str, ...] = ()  # those two terms


@dataclass(frozen=True)
class Answer:
    """What a case conceals."""

    number: int
    kind: str
    tier: str
    effects: tuple[ConcealedEffect, ...]
    # car, base: the plant's car, and ``bare`` or ``rich``.
    car: str
    base: str
    simulation: str  # ``plant`` (a drive without the effect is given) or ``nominal``
    base_effect_to_noise: float  # of what the nominal model gets wrong of the car without the effect
    total_effect_to_noise: float  # of all effects together
    removed: float  # share of the held-out gap that the true terms remove [1]; 0 where there are none
    # lap_length, lap_driven, s_origin: of the track's centreline and of the real drive's first lap [m], and where
    # on the track that drive begins [m]: places of an answer are on the centreline, those a diagnosis finds along
    # the drive.
    lap_length: float = 0.0
    lap_driven: float = 0.0
    s_origin: float = 0.0
    draws: int = 1  # how many drawings of surroundings and drivers it took until the case met its conditions


@dataclass(frozen=True)
class Case:
    """Everything of a case: what is shown, and what is sealed."""

    real: Drive
    sim: Drive | None
    vehicle: Vehicle
    answer: Answer
    heldout: ExactDrive | None  # a noise-free drive that no diagnosis sees, to score by; None for nulls
    noise: np.ndarray  # (3,)


@lru_cache(maxsize=32)
def _car(seed: int, number: int, base: str) -> CarOfProof:
    """Return one of a seed's cars; they are shared by its cases, since calibrating takes a while."""
    name = sorted(CARS)[number % 3]
    rng = np.random.default_rng([seed, 7, number])
    car = varied_car(name, rng)
    return build_car(bare(car) if base == "bare" else rich(car, rng), seed % 10_000 + number)


def build_case(plan: CasePlan) -> Case:
    """Build a case; the same plan gives the same case.

    Raises
    ------
    SplitError
        If twenty-four drawings of surroundings and drivers did not give one that can be driven at that
        effect-to-noise ratio, nor any for the terms to take instead.
    """
    choices = (plan.terms, *plan.instead)
    for attempt in range(_DRAWS * len(choices)):
        rng = plan.rng(2, attempt)
        try:
            terms = choices[attempt // _DRAWS]
            if plan.kind == "strange":
                terms = (terms[attempt // 2 % len(terms)],)
            case = _build(replace(plan, terms=terms), rng)
            return replace(case, answer=replace(case.answer, draws=attempt + 1))
        except Unreachable as error:
            reason = error
        except SplitError as error:
            # The driver lost the car: another draw drives otherwise.
            reason = error
    raise SplitError(f"case {plan.number} of seed {plan.seed} cannot be built: {reason}")


@dataclass(frozen=True)
class _CaseSetting:
    """Where and in what a case takes place: the calibrated car, its world without the effects, and three trips."""

    source: CarOfProof
    base: str
    simulation: str
    without: ProofWorld
    concealed: tuple[Concealed, ...]
    trips: tuple[Trip, Trip, Trip]
    base_effect_to_noise: float


def _setting(plan: CasePlan, rng: np.random.Generator) -> _CaseSetting:
    base = "bare" if rng.random() < 0.6 else "rich"
    simulation = "nominal" if base == "bare" and plan.kind != "null" and rng.random() < 0.6 else "plant"
    if "yaw_moment_differential" in plan.terms:
        # A bare car is too narrow for its wheels to hold it back.
        base, simulation = "rich", "plant"
    source = _car(plan.seed, int(rng.integers(_CARS_OF_A_SEED)), base)
    name = source.car.name
    length = LAP_LENGTH[name] * rng.uniform(0.8, 1.3)
    believed = replace(source.car, steer_rate=CARS[name].steer_rate, torque_rate=CARS[name].torque_rate)
    track = random_track(rng, length, length / 2400, 4.0 * source.car.wheelbase / 2.7)
    without = ProofWorld(source.car, track, believed)
    concealed = tuple(_draw(plan, term, rng, without) for term in plan.terms)
    for effect in concealed:
        without = effect.neutral(without)
    if without.car != source.car:
        # The car without the effect is another one now; its file must be its own.
        source = build_car(without.car, plan.seed % 10_000 + plan.number)
    seconds = 60.0 + 30.0 * rng.random() if name == "f1tenth_car" else 70.0 + 60.0 * rng.random()
    trips = (draw_trip(rng, seconds), draw_trip(rng, seconds), draw_trip(rng, seconds))
    base_effect_to_noise = _base_effect_to_noise(without, trips[0], source)
    if base_effect_to_noise > _BARE_ENOUGH:
        simulation = "plant"
    return _CaseSetting(source, base, simulation, without, concealed, trips, base_effect_to_noise)


def _build(plan: CasePlan, rng: np.random.Generator) -> Case:
    setting = _setting(plan, rng)
    source, without, trips = setting.source, setting.without, setting.trips
    effects, world = [], without
    for effect in setting.concealed:
        found = _sized(effect, without, trips[0], plan, rng, source)
        effects.append((effect, found))
        world = effect.apply(world, found[0])
    run = drive(world, trips[0])
    total = error_to_noise(effect_error(run, world, without), source.noise) if effects else 0.0
    if plan.kind == "single" and not plan.low <= total <= plan.high:
        wanted = f"{plan.low:g} to {plan.high:g}"
        raise Unreachable(f"effect-to-noise ratio {total:.3g} over the whole drive is not within {wanted}")
    real = record(run, source.alignment, "real", rng, world.sensor)
    sim = None
    if setting.simulation == "plant":
        lap = drive(without, trips[1], sample_period=1e-2)
        sim = record(lap, source.alignment, "sim", None, without.sensor)
    concealed, heldout, removed = _concealed(effects, world, without, trips, source, plan)
    if plan.kind in ("single", "pair", "hard-pair"):
        _require_named(heldout, removed, source)
    answer = Answer(
        number=plan.number,
        kind=plan.kind,
        tier=plan.tier,
        effects=concealed,
        car=source.car.name,
        base=setting.base,
        simulation=setting.simulation,
        base_effect_to_noise=setting.base_effect_to_noise,
        total_effect_to_noise=total,
        removed=removed,
        **_places(run),
    )
    return Case(real, sim, source.vehicle, answer, heldout, source.noise)


def _require_named(heldout: ExactDrive, removed: float, source: CarOfProof) -> None:
    """Refuse a case whose true terms leave much: it would conceal more than its name."""
    there = error_to_noise(heldout.error, source.noise)
    left = there * float(np.sqrt(max(1.0 - removed, 0.0)))
    if left > max(_LEFT[0], _LEFT[1] * there):
        raise Unreachable(f"the true terms leave an effect-to-noise ratio of {left:.3g} of {there:.3g}")


def _draw(plan: CasePlan, term: str, rng: np.random.Generator, world: ProofWorld) -> Concealed:
    return draw_strange(term, rng, world) if plan.kind == "strange" else draw_effect(term, rng, world)


def draw_trip(rng: np.random.Generator, seconds: float) -> Trip:
    """Return a trip of so many seconds by one of the plant's drivers at 55 to 80 % of the grip he knows."""
    style = DRIVER_STYLES[str(rng.choice(sorted(DRIVER_STYLES)))]
    return Trip(style, rng.uniform(0.55, 0.8), seconds, int(rng.integers(2**31)))


def _base_effect_to_noise(without: ProofWorld, trip: Trip, source: CarOfProof) -> float:
    run = drive(without, trip, duration=_SEARCH_SECONDS, sample_period=1e-2)
    nothing = np.zeros((0, 3))
    columns = exact_drive(run, source.alignment, without.sensor, nothing).columns
    return error_to_noise(errors_of_terms(columns, source.vehicle, ()), source.noise)


def _sized(
    effect: Concealed, without: ProofWorld, trip: Trip, plan: CasePlan, rng: np.random.Generator, source: CarOfProof
) -> tuple[float, float]:
    """Return the size of an effect with an effect-to-noise ratio drawn for the plan, and that ratio."""

    def measure(size: float) -> float:
        world = effect.apply(without, size)
        run = drive(world, trip, duration=min(_SEARCH_SECONDS, trip.duration))
        error = effect_error(run, world, without)
        if plan.kind == "strange":
            error, _ = _beyond(run, world, error, source)
        return error_to_noise(error, source.noise)

    span = np.log(plan.high / plan.low)
    target = plan.low * float(np.exp(span * rng.uniform(0.1, 0.9)))
    found = search_size(measure, effect.start, effect.most, target, tolerance=0.15)
    return float(found.size), found.effect_to_noise


def _beyond(run: Trajectory, world: ProofWorld, error: np.ndarray, source: CarOfProof):
    """Return what the two best terms of the catalogue leave of an error, and their names."""
    columns = exact_drive(run, source.alignment, world.sensor, error).columns
    return beyond_catalogue(error, columns, source.vehicle, run.lap_length, source.noise)


def _exact(world: ProofWorld, without: ProofWorld, trip: Trip, source: CarOfProof) -> ExactDrive:
    run = drive(world, trip)
    return exact_drive(run, source.alignment, world.sensor, effect_error(run, world, without))


def _concealed(
    effects, world, without, trips, source, plan
) -> tuple[tuple[ConcealedEffect, ...], ExactDrive | None, float]:
    """Return the effects for the answer, the held-out drive and what the true terms remove of its gap."""
    if not effects:
        return (), None, 0.0
    # Held out is another driver again, so that nothing fitted to the real drive is at home there.
    heldout = _exact(world, without, replace(trips[2], duration=60.0), source)
    if plan.kind == "strange":
        left, names = beyond_catalogue(heldout.error, heldout.columns, source.vehicle, world.track.length, source.noise)
        beyond = error_to_noise(left, source.noise)
        ((effect, (size, found)),) = effects
        total = error_to_noise(heldout.error, source.noise)
        return (ConcealedEffect(effect.term, size, total, beyond=beyond, absorbed_by=names),), heldout, 0.0
    concealed, terms = [], []
    for effect, (size, found) in effects:
        alone = heldout
        if len(effects) > 1:
            alone = _exact(effect.apply(without, size), without, replace(trips[2], duration=60.0), source)
        parameters, variant, removed = _parameters(effect, without, size, alone, source)
        unscored = {*effect.shape, *CATALOGUE[effect.term].constants}
        scored = tuple(name for name in parameters if name not in unscored)
        concealed.append(ConcealedEffect(effect.term, size, found, parameters, scored, variant, removed))
        terms.append(CATALOGUE[effect.term](parameters, variant))
    return tuple(concealed), heldout, removed_share(heldout, source.vehicle, terms, source.noise)


def _parameters(
    effect: Concealed, without: ProofWorld, size: float, exact: ExactDrive, source: CarOfProof
) -> tuple[dict[str, float], str, float]:
    """Return parameters, variant and removed share of the variant that says the effect best."""
    known = {name: float(value) for name, value in effect.known(without, size).items()}
    kind = CATALOGUE[effect.term]
    best: tuple[dict[str, float], str, float] | None = None
    for variant in variants_of_truth(effect, known):
        given = {**effect.shape, **known}
        parameters = fit_effective(exact, source.vehicle, effect.term, given, source.noise, variant)
        share = removed_share(exact, source.vehicle, [kind(parameters, variant)], source.noise)
        if best is None or share > best[2]:
            best = (parameters, variant, share)
    assert best is not None
    return best


def variants_of_truth(effect: Concealed, known: Mapping[str, float]) -> list[str]:
    """Return the variants of its term in which an effect may be said, some parameters of it known."""
    kind = CATALOGUE[effect.term]
    able = [v for v in kind.variants if set(known) <= set(kind.parameter_units(v)) and v not in _NOT_CONCEALED]
    return [effect.variant] if effect.variant else able


def _places(run: Trajectory) -> dict[str, float]:
    """Return how places along a recording of a run relate to those of the track."""
    path = run.states[:, :2]
    driven = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
    start = int(np.searchsorted(run.t, START))
    s_origin = float(run.s[start])
    end = np.interp(s_origin + run.lap_length, run.s, driven) if run.s[-1] > s_origin + run.lap_length else 0.0
    lap_driven = float(end - driven[start]) if end else run.lap_length
    return {"lap_length": run.lap_length, "lap_driven": lap_driven, "s_origin": s_origin}
