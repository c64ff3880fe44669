"""The plant's own car, with all its physics at once, against the nominal model of a car that has none of it.

What is there is known from the parameters: each piece of physics is taken away alone, and what that changes in
0.05 s is its effect-to-noise ratio. No single term names load that moves sideways, or tyres that depend on it.
Both change what an axle's tyres do: grip or stiffness of an axle is right for them, and none is asked for.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.errors import SplitError
from split_cli.plant.cars import CARS, CarParameters
from split_cli.proof.cars import bare, build_car, varied_car
from split_cli.proof.cases import LAP_LENGTH, Answer, Case, ConcealedEffect, draw_trip
from split_cli.proof.plan import CasePlan
from split_cli.proof.recordings import record
from split_cli.proof.tracks import random_track
from split_cli.proof.truth import error_to_noise
from split_cli.proof.world import ProofWorld, drive, effect_error

_DRAWS = 6


@dataclass(frozen=True)
class Piece:
    """One piece of a car's physics."""

    term: str  # id of the term that names it
    # fields, tire_fields: parameters of the car and of its tyres that a bare car has otherwise.
    fields: tuple[str, ...] = ()
    tire_fields: tuple[str, ...] = ()
    # car -> physical values of the term's parameters; those that are effective are not given.
    known: Callable[[CarParameters], Mapping[str, float]] = lambda car: {}
    # Whether the term has to be named where the piece is large; else it is right, but not asked for.
    asked: bool = True


_AXLES = (
    "cg_height",
    "roll_center_front",
    "roll_center_rear",
    "track_front",
    "track_rear",
    "ackermann_fraction",
    "toe_front",
    "toe_rear",
)
_WHEELS = ("wheel_inertia_front", "wheel_inertia_rear")
_CURVES = ("p_dy1", "p_dy2", "p_ey1", "p_ey2", "p_ky1", "p_ky2")
PIECES = (
    Piece("combined_slip", tire_fields=("combined_slip",)),
    Piece("load_transfer", ("pitch_transfer",), known=lambda car: {"cg_height": car.cg_height}),
    Piece("tire_relaxation", tire_fields=("relaxation_lateral",)),
    Piece("aero_downforce", ("downforce_area_front", "downforce_area_rear")),
    Piece("steer_lag", ("steer_lag", "steer_rate"), known=lambda car: {"tau": car.steer_lag}),
    Piece("drive_lag", ("drive_lag", "torque_rate"), known=lambda car: {"tau": car.drive_lag}),
    Piece("yaw_moment_differential", ("differential_locking_front", "differential_locking_rear")),
    Piece("rotating_mass", _WHEELS, known=lambda car: {"mass": car.effective_mass - car.mass}),
    Piece("tire_stiffness", _AXLES, _CURVES, asked=False),
    Piece("friction_scale", _AXLES, _CURVES, asked=False),
    Piece("drive_gain", _WHEELS, asked=False),
)


def without_piece(car: CarParameters, piece: Piece) -> CarParameters:
    """Return a car in which one piece of physics is as in the bare one."""
    plain = bare(car)

    def tire(own, other):
        return replace(own, **{name: getattr(other, name) for name in piece.tire_fields})

    return replace(
        car,
        **{name: getattr(plain, name) for name in piece.fields},
        front_tire=tire(car.front_tire, plain.front_tire),
        rear_tire=tire(car.rear_tire, plain.rear_tire),
    )


def build_whole_car(plan: CasePlan) -> Case:
    """Return a case whose real car is the plant's own, varied, and whose vehicle file is that of the bare car.

    Raises
    ------
    SplitError
        If six drawings of track and driver lose the car.
    """
    for attempt in range(_DRAWS):
        try:
            return _drawn(plan, plan.rng(13, attempt), attempt + 1)
        except SplitError as error:
            reason = error
    raise SplitError(f"case {plan.number} of seed {plan.seed} cannot be built: {reason}")


def _drawn(plan: CasePlan, rng: np.random.Generator, draws: int) -> Case:
    name = sorted(CARS)[plan.number % len(CARS)]
    car = varied_car(name, rng)
    source = build_car(bare(car), plan.seed % 10_000 + plan.number)
    length = LAP_LENGTH[name] * rng.uniform(0.8, 1.3)
    track = random_track(rng, length, length / 2400, 4.0 * car.wheelbase / 2.7)
    world = ProofWorld(car, track, car)
    trip = draw_trip(rng, 80.0)
    run = drive(world, trip)

    def size(other: CarParameters) -> float:
        return error_to_noise(effect_error(run, world, replace(world, car=other)), source.noise)

    effects = []
    for piece in PIECES:
        found = size(without_piece(car, piece)) if piece.asked else 0.0
        known = dict(piece.known(car))
        effects.append(ConcealedEffect(piece.term, 1.0, found, known, tuple(known), "", 1.0))
    answer = Answer(
        number=plan.number,
        kind=plan.kind,
        tier="",
        effects=tuple(effects),
        car=name,
        base="own",
        simulation="nominal",
        base_effect_to_noise=0.0,
        total_effect_to_noise=size(bare(car)),
        removed=1.0,
        draws=draws,
    )
    real = record(run, source.alignment, "real", rng, world.sensor)
    return Case(real, None, source.vehicle, answer, None, source.noise)
