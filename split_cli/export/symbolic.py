"""The vehicle's right-hand side as a CasADi graph: every named term is exported as it was learned with."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import casadi
import numpy as np

from split_cli.errors import ExportError, reason_of
from split_cli.export.memory import Memory, exported_model, memory_of
from split_cli.learning.features import FeatureSet
from split_cli.learning.labels import DEFAULT_HORIZON
from split_cli.vehicle.single_track import SingleTrack

STATES = ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta")


#: The single track divides by the speed; exports leave it as it is above this share of the speed that training
#: begins at (`Region.minimum_speed`), so that nothing learned or verified is touched.
LOW_SPEED_SHARE = 0.5


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

    @staticmethod
    def sine_of_multiple_of_atan(c: Any, a: Any) -> Any:
        """Return sin(c atan(a))."""
        return casadi.sin(c * casadi.atan(a))


CASADI = CasadiOperations()


@dataclass(frozen=True)
class NominalGraph:
    """Loop-free functions of the nominal model.

    With S states of terms, the acting variables a are (yaw, v_x, v_y, r, T, delta, states), T and delta as they
    arrive where there are delays.
    """

    # (a; t, s) to (v_x', v_y', r', states') and their Jacobian, shape (3 + S, 6 + S), exact. Where a term asks how
    # much the set knows, the second argument is (t, s, knowledge).
    rates: casadi.Function
    # Without memory (x, u), with memory (w, u), w = (X, Y, a, T, delta) with the commands of this moment last, to
    # z, shape (D,), and its Jacobian; None when a feature is a measured channel that no state or input determines.
    features: casadi.Function | None
    foreign_features: tuple[str, ...]  # those channels
    needs_place_and_time: bool  # whether a term reads the time t or the track position s
    asks_knowledge: bool = False  # whether a term acts only as far as the set knows, see `SingleTrack.asks_knowledge`
    memory: Memory | None = None  # states beyond the first eight
    # (first six of a; t, s) to the steady states of the terms, shape (S,); None without states.
    start: casadi.Function | None = None
    # (a; t, s) to where the plays are dragged, and the Jacobian, shape (P, 6 + S); None without plays.
    jumps: casadi.Function | None = None
    # Size of each of the terms' states that balances the Jacobian, for bounds on series.
    units: tuple[float, ...] = ()
    stiffness: float = 0.0  # norm of the balanced Jacobian, the largest of many states [1/s]; 0 without memory
    # Whether a velocity moves the terms' states, so that a correction does, too, within a step.
    feeds_back: bool = False
    low_speed: float = 0.0  # v_x below which the model is evaluated at `guarded_speed` [m/s]


@dataclass(frozen=True)
class _Trace:
    """A model evaluated on symbols: acting variables, (t, s), knowledge, rates, flow, guarded v_x."""

    acting: casadi.SX
    place_time: casadi.SX
    knowledge: casadi.SX
    rates: casadi.SX
    flow: Any
    speed: casadi.SX


def build_nominal(model: SingleTrack, features: FeatureSet, step: float = DEFAULT_HORIZON) -> NominalGraph:
    """Trace a vehicle's model, its named terms included, into CasADi functions; sensor terms are left out.

    Parameters
    ----------
    step : float
        Of the discrete step that delays are kept for [s].

    Raises
    ------
    ExportError
        If a term cannot be expressed in the shared operations, or its memory cannot be kept.
    """
    model = exported_model(model)
    low_speed = LOW_SPEED_SHARE * model.vehicle.minimum_speed
    trace = _trace(model, low_speed)
    acting, place_time, rates = trace.acting, trace.place_time, trace.rates
    jacobian = casadi.densify(casadi.jacobian(rates, acting))
    options, asks = {"cse": True}, model.asks_knowledge
    situation = casadi.vertcat(place_time, trace.knowledge) if asks else place_time
    traced = casadi.Function("rates", [acting, situation], [casadi.densify(rates), jacobian], options)
    plays = tuple(k for k, name in enumerate(model.state_names) if name in trace.flow.pulled)
    memory = memory_of(model, plays, step)
    start, jumps = _start(model, trace), _jumps(model, trace, plays)
    sample = _Sample(model)
    _require_same(model, traced, start, jumps, sample)
    units, stiffness = _balance(traced, sample) if memory else ((), 0.0)
    needs = any(casadi.which_depends(rates, place_time, 1, False))
    known = _features(model, features, trace, memory)
    feeds_back = model.memory_feeds_back
    return NominalGraph(traced, *known, needs, asks, memory, start, jumps, units, stiffness, feeds_back, low_speed)


def guarded_speed(speed: casadi.SX, low: float) -> casadi.SX:
    """Return the speed that the exported model is evaluated at: v_x above `low`, at least half of it below.

    With s = v_x/low clipped to [0, 1] it is max(v_x, low) + low (s^3 - s^4/2 - 1/2): twice continuously
    differentiable, v_x itself at and above `low`, low/2 at and below a standstill.
    """
    share = casadi.fmin(casadi.fmax(speed / low, 0.0), 1.0)
    return casadi.fmax(speed, low) + low * (share**3 - 0.5 * share**4 - 0.5)


def _trace(model: SingleTrack, low_speed: float) -> _Trace:
    names = model.state_names
    a, place_time = casadi.SX.sym("a", 6 + len(names)), casadi.SX.sym("p", 2)
    knowledge = casadi.SX.sym("k") if model.asks_knowledge else casadi.SX(1.0)
    states = {name: a[6 + k] for k, name in enumerate(names)} if names else None
    where = f"vehicle {model.vehicle.name}, effects: {', '.join(term.id for term in model.terms)}"
    speed = guarded_speed(a[1], low_speed)
    try:
        situation: dict[str, Any] = {"yaw": a[0], "t": place_time[0], "s": place_time[1], "ops": CASADI}
        inner = [speed, *(a[i] for i in range(2, 6))]
        whole = flow = model.flow(*inner, **situation, states=states)
        if model.asks_knowledge:
            flow = model.flow(*inner, **situation, states=states, knowledge=knowledge)
        rates = casadi.vertcat(*model.balance(flow))
    except (TypeError, NotImplementedError, RuntimeError, AttributeError) as error:
        what = f"a term cannot be traced symbolically ({type(error).__name__}: {reason_of(error)})"
        advice = "A term may use only the shared operations of split_cli.vehicle.operations."
        raise ExportError(what, where=where, advice=advice) from error
    silent = sorted(set(names) - set(flow.rates))
    if silent:
        what = f"the state {silent[0]} is declared, but no term says how it changes"
        raise ExportError(what, where=where, advice="States go through Term.first_order or Term.play.")
    rates = casadi.vertcat(rates, *(flow.rates[name] for name in names))
    # Features and where states settle are those of labels, which have the whole of what depends on knowledge.
    return _Trace(a, place_time, knowledge, rates, whole, speed)


def _start(model: SingleTrack, trace: _Trace) -> casadi.Function | None:
    """Return where the terms' states settle: the flow without states given is steady."""
    if not model.state_names:
        return None
    a, p = trace.acting[:6], trace.place_time
    inner = [trace.speed, *(a[i] for i in range(2, 6))]
    settled = model.flow(*inner, yaw=a[0], t=p[0], s=p[1], ops=CASADI).values
    states = casadi.vertcat(*(settled[name] for name in model.state_names))
    return casadi.Function("start", [a, p], [casadi.densify(states)], {"cse": True})


def _jumps(model: SingleTrack, trace: _Trace, plays: tuple[int, ...]) -> casadi.Function | None:
    """Return where commands drag the plays at once."""
    if not plays:
        return None
    pulled = casadi.vertcat(*(trace.flow.pulled[model.state_names[k]] for k in plays))
    jacobian = casadi.jacobian(pulled, trace.acting)
    allowed = {4, 5, *(6 + k for k in plays)}
    if set(jacobian.sparsity().get_col()) - allowed or casadi.depends_on(pulled, trace.place_time):
        what = "a play follows something else than a command"
        advice = "A step knows only its commands ahead."
        raise ExportError(what, where=f"vehicle {model.vehicle.name}, effects", advice=advice)
    outputs = [casadi.densify(pulled), casadi.densify(jacobian)]
    return casadi.Function("jumps", [trace.acting, trace.place_time], outputs, {"cse": True})


class _Sample:
    """Situations in which a trace is compared with NumPy: acting variables (6 + S, N), t and s (2, N)."""

    def __init__(self, model: SingleTrack, count: int = 64) -> None:
        rng = np.random.default_rng(5)
        car = model.vehicle
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
        knowledge = rng.uniform(0.0, 1.0, count) if model.asks_knowledge else np.ones(count)
        self.place_time = np.stack([t, s])
        self.known = np.stack([t, s, knowledge])[: 3 if model.asks_knowledge else 2]
        self.steady = model.flow(*asked[1:], yaw=asked[0], t=t, s=s).values
        # Every state on its way, some by much: lags, and plays on either side and inside.
        steady = [self.steady[name] * rng.uniform(0.5, 1.5, count) for name in model.state_names]
        self.acting = np.stack([*asked, *steady])

    @property
    def situation(self) -> dict[str, Any]:
        """Yaw, t, s and knowledge as the model takes them."""
        knowledge = self.known[2] if len(self.known) == 3 else 1.0
        return {"yaw": self.acting[0], "t": self.place_time[0], "s": self.place_time[1], "knowledge": knowledge}


def _require_same(
    model: SingleTrack,
    traced: casadi.Function,
    start: casadi.Function | None,
    jumps: casadi.Function | None,
    sample: _Sample,
) -> None:
    """Compare the traced model with NumPy's: a term may branch on numbers in a way that leaves no trace."""
    asked, names = sample.acting, model.state_names
    states = dict(zip(names, asked[6:], strict=True)) or None
    flow = model.flow(*asked[1:6], states=states, **sample.situation)
    count = asked.shape[1]

    def stack(values: Iterable[Any]) -> np.ndarray:
        return np.stack([np.broadcast_to(value, count) for value in values])

    rates = stack([*model.balance(flow), *(flow.rates[name] for name in names)])
    pairs = [(traced, asked, sample.known, rates)]
    if start is not None:
        pairs.append((start, asked[:6], sample.place_time, stack(sample.steady[name] for name in names)))
    if jumps is not None:
        pulled = stack(flow.pulled[name] for name in names if name in flow.pulled)
        pairs.append((jumps, asked, sample.place_time, pulled))
    for function, given, situation, expected in pairs:
        found = function.map(count)(given, situation)
        found = np.asarray(found[0] if isinstance(found, tuple | list) else found)
        # Rounding of the same operations; a sum of forces of 1e4 N keeps 1e-12 of an acceleration.
        if not np.allclose(found, expected, rtol=1e-9, atol=1e-9):
            raise ExportError(
                f"the traced model is not the one that Python evaluates ({function.name()})",
                where=f"vehicle {model.vehicle.name}, effects: {', '.join(term.id for term in model.terms)}",
                advice="A term may use only the shared operations of split_cli.vehicle.operations.",
            )


def _balance(traced: casadi.Function, sample: _Sample) -> tuple[tuple[float, ...], float]:
    """Return a size for each of the terms' states, and the norm of the Jacobian in these units.

    Forces of 1e4 N beside speeds of 1 m/s make row sums say nothing of how fast the whole reacts. A state's size
    is chosen so that what it does to the others and what they do to it weigh the same; powers of two.
    """
    count, states = sample.acting.shape[1], len(sample.acting) - 6
    size = 3 + states
    jacobian = np.asarray(traced.map(count)(sample.acting, sample.known)[1]).reshape(size, count, 6 + states)
    columns = [1, 2, 3, *range(6, 6 + states)]
    A = np.abs(jacobian).max(axis=1)[:, columns]
    off = A - np.diag(A.diagonal())
    unit = np.ones(size)
    for _ in range(4):
        for k in range(3, size):
            scaled = off * unit / unit[:, None]
            row, column = scaled[k].sum(), scaled[:, k].sum()
            # What acts one way only may be made as small as one likes.
            ratio = np.sqrt(row / column) if row and column else (row or 1.0 / (column or 1.0))
            unit[k] *= 2.0 ** np.round(np.log2(ratio))
    return tuple(unit[3:].tolist()), float((A * unit / unit[:, None]).sum(axis=1).max())


def _features(
    model: SingleTrack, features: FeatureSet, trace: _Trace, memory: Memory | None
) -> tuple[casadi.Function | None, tuple[str, ...]]:
    """Return the function of the features and the names of those it cannot hold."""
    a, u = trace.acting, casadi.SX.sym("u", 2)
    if memory is None:
        x = casadi.SX.sym("x", 8)
        known, given = _feature_expressions(model, trace.flow, a, x, u), x
    else:
        place, command = casadi.SX.sym("X", 2), casadi.SX.sym("c", 2)
        x = casadi.vertcat(place, a[:4], command)
        known, given = _feature_expressions(model, trace.flow, a, x, u), casadi.vertcat(place, a, command)
    foreign = tuple(name for name in features.names if name not in known)
    if foreign:
        return None, foreign
    z = casadi.vertcat(*(known[name] for name in features.names))
    if memory is None:
        z = casadi.substitute(z, a, x[2:8])
    return _feature_function(z, given, u, trace.place_time), ()


def _feature_expressions(
    model: SingleTrack, flow: Any, a: casadi.SX, x: casadi.SX, u: casadi.SX
) -> dict[str, casadi.SX]:
    """Return what `FeatureSet.compute` computes from a drive, here from state and input."""
    return {
        "alpha_f": flow.front.slip_angle,
        "alpha_r": flow.rear.slip_angle,
        "torque_ratio": x[6] / model.vehicle.max_torque,
        "speed": casadi.sqrt(a[1] * a[1] + a[2] * a[2]),
        "steer_rate": u[1],
        **{name: x[index] for index, name in enumerate(STATES)},
        **{name: a[6 + index] for index, name in enumerate(model.state_names)},
    }


def _feature_function(z: casadi.SX, x: casadi.SX, u: casadi.SX, place_time: casadi.SX) -> casadi.Function:
    if casadi.depends_on(z, place_time):
        what = "a feature depends on time or place through a term, which exported features do not take"
        raise ExportError(what, advice="Train with z2, or without that term.")
    z = casadi.densify(z)
    jacobian = casadi.densify(casadi.jacobian(z, casadi.vertcat(x, u)))
    return casadi.Function("features", [x, u], [z, jacobian], {"cse": True})
