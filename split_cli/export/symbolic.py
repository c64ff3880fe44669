"""The vehicle's right-hand side as a CasADi graph: every named term is exported as it was learned with."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from split_cli.errors import ExportError
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.single_track import SingleTrack

__all__ = ["STATES", "CasadiOperations", "NominalGraph", "build_nominal", "derivatives"]

STATES = ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta")


class CasadiOperations:
    """`split_cli.vehicle.operations.Operations` on CasADi symbols (SX or MX)."""

    sin = staticmethod(casadi.sin)
    cos = staticmethod(casadi.cos)
    atan = staticmethod(casadi.atan)
    atan2 = staticmethod(casadi.atan2)
    tanh = staticmethod(casadi.tanh)
    exp = staticmethod(casadi.exp)
    sqrt = staticmethod(casadi.sqrt)
    minimum = staticmethod(casadi.fmin)
    maximum = staticmethod(casadi.fmax)
    where = staticmethod(casadi.if_else)


CASADI = CasadiOperations()


@dataclass(frozen=True)
class NominalGraph:
    """Loop-free functions of the nominal model.

    Attributes
    ----------
    rates : casadi.Function
        (yaw, v_x, v_y, r, T, delta; t, s) to (v_x', v_y', r') and their Jacobian, shape (3, 6), exact.
    features : casadi.Function or None
        (x, u) to z, shape (D,), and its Jacobian, shape (D, 10); None when a feature is a measured channel that
        no state or input determines.
    foreign_features : tuple of str
        Those channels.
    needs_place_and_time : bool
        Whether a term reads the time t or the track position s.
    """

    rates: casadi.Function
    features: casadi.Function | None
    foreign_features: tuple[str, ...]
    needs_place_and_time: bool


def derivatives(model: SingleTrack, yaw: Any, velocity: Any, T: Any, delta: Any, t: Any, s: Any) -> Any:
    """Return the symbolic (v_x', v_y', r') of a model, shape (3,)."""
    rates = model.velocity_derivative(
        velocity[0], velocity[1], velocity[2], T, delta, yaw=yaw, t=t, s=s, ops=CASADI
    )
    return casadi.vertcat(*rates)


def build_nominal(model: SingleTrack, features: FeatureSet) -> NominalGraph:
    """Trace a vehicle's model, its named terms included, into CasADi functions.

    Raises
    ------
    ExportError
        If a term cannot be expressed in the shared operations, or has states of its own.
    """
    arguments = casadi.SX.sym("a", 6)
    place_time = casadi.SX.sym("p", 2)
    for term in model.terms:
        if getattr(term, "states", ()):
            raise ExportError(
                f"the term {term.id} has states of its own, which an exported step does not carry",
                where=f"vehicle {model.vehicle.name}, effects",
                advice="Remove the term from the vehicle file and train the set without it.",
            )
    yaw, velocity, T, delta = arguments[0], arguments[1:4], arguments[4], arguments[5]
    try:
        rates = derivatives(model, yaw, velocity, T, delta, place_time[0], place_time[1])
        flow = model.flow(
            *(arguments[i] for i in range(1, 6)), yaw=yaw, t=place_time[0], s=place_time[1], ops=CASADI
        )
    except (TypeError, NotImplementedError, RuntimeError, AttributeError) as error:
        raise ExportError(
            f"a term cannot be traced symbolically ({type(error).__name__}: {str(error).splitlines()[0]})",
            where=f"vehicle {model.vehicle.name}, effects: {', '.join(term.id for term in model.terms)}",
            advice="A term may use only the shared operations of split_cli.vehicle.operations.",
        ) from error
    jacobian = casadi.densify(casadi.jacobian(rates, arguments))
    options = {"cse": True}
    traced = casadi.Function("rates", [arguments, place_time], [casadi.densify(rates), jacobian], options)
    _require_same(model, traced)
    needs = casadi.which_depends(rates, place_time, 1, False)
    x, u = casadi.SX.sym("x", 8), casadi.SX.sym("u", 2)
    known = _feature_expressions(model, flow, arguments, x, u)
    foreign = tuple(name for name in features.names if name not in known)
    feature_function = None
    if not foreign:
        z = casadi.substitute(casadi.vertcat(*(known[name] for name in features.names)), arguments, x[2:8])
        feature_function = _feature_function(z, x, u, place_time)
    return NominalGraph(traced, feature_function, foreign, any(needs))


def _require_same(model: SingleTrack, traced: casadi.Function) -> None:
    """Compare the traced rates with NumPy's: a term may branch on numbers in a way that leaves no trace."""
    rng = np.random.default_rng(5)
    car, count = model.vehicle, 64
    speed = car.minimum_speed * rng.uniform(1.0, 10.0, count)
    asked = np.stack(
        [
            rng.uniform(-3.0, 3.0, count),
            speed,
            speed * rng.uniform(-0.1, 0.1, count),
            speed / car.wheelbase * rng.uniform(-0.1, 0.1, count),
            rng.uniform(-car.max_brake_torque, car.max_torque, count),
            rng.uniform(-0.2, 0.2, count),
        ]
    )
    t, s = rng.uniform(0.0, 100.0, count), rng.uniform(0.0, 1000.0, count)
    expected = np.stack(np.broadcast_arrays(*model.velocity_derivative(*asked[1:], yaw=asked[0], t=t, s=s)))
    found = np.asarray(traced.map(count)(asked, np.stack([t, s]))[0])
    # Rounding of the same operations; a sum of forces of 1e4 N keeps 1e-12 of an acceleration.
    if not np.allclose(found, expected, rtol=1e-9, atol=1e-9):
        raise ExportError(
            "the traced model is not the one that Python evaluates",
            where=f"vehicle {car.name}, effects: {', '.join(term.id for term in model.terms)}",
            advice="A term may use only the shared operations of split_cli.vehicle.operations.",
        )


def _feature_expressions(
    model: SingleTrack, flow: Any, a: casadi.SX, x: casadi.SX, u: casadi.SX
) -> dict[str, casadi.SX]:
    """Return what `FeatureSet.compute` computes from a drive, here from state and input."""
    return {
        "alpha_f": flow.front.slip_angle,
        "alpha_r": flow.rear.slip_angle,
        "torque_ratio": a[4] / model.vehicle.max_torque,
        "speed": casadi.sqrt(a[1] * a[1] + a[2] * a[2]),
        "steer_rate": u[1],
        **{name: x[index] for index, name in enumerate(STATES)},
    }


def _feature_function(z: casadi.SX, x: casadi.SX, u: casadi.SX, place_time: casadi.SX) -> casadi.Function:
    if casadi.depends_on(z, place_time):
        raise ExportError("a feature depends on time or place through a term, which exported features do not take")
    z = casadi.densify(z)
    jacobian = casadi.densify(casadi.jacobian(z, casadi.vertcat(x, u)))
    return casadi.Function("features", [x, u], [z, jacobian], {"cse": True})
