"""The step of a model, with memory or without, its start and its right-hand side, as CasADi functions."""

from functools import cache

import casadi
import numpy as np

from split_cli.export.memory import Memory, nothing_kept, present
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.running_trust import MEMORY, SPAN, SWEEPS

#: Numbers of state: 3 shares, then D and e (3 x 4), then sums of their products (3 x 4 x 4), row by row.
TRUST_SIZE = 63


@cache
def observation() -> casadi.Function:
    """Return (transition (3, 3), innovation (3), response (3, 3), h, trust (63)) -> trust.

    `learning.running_trust.RunningTrust.observe` in scalars. Shares are of what the export answers, which has the
    stored trust in it; so the most is 1.
    """
    SX = casadi.SX.sym
    transition, innovation, response, h = SX("A", 3, 3), SX("w", 3), SX("R", 3, 3), SX("h")
    trust = SX("trust", TRUST_SIZE)
    before = casadi.reshape(trust[3:15], 4, 3).T
    added = casadi.horzcat(response, innovation)
    driven = (casadi.mtimes(transition, before) + added) / (1.0 + h / SPAN)
    products = []
    for state in range(3):
        row = driven[state, :].T
        products.append(
            casadi.exp(-h / MEMORY) * trust[15 + 16 * state : 31 + 16 * state] + casadi.vec(row @ row.T)
        )
    normal = casadi.SX.zeros(4, 4)
    for own in products:
        weight = casadi.if_else(own[15] > 0.0, 1.0 / own[15], 0.0)
        normal += weight * casadi.reshape(own, 4, 4)
    share = [trust[k] for k in range(3)]
    for j in (0, 1, 2) * SWEEPS:
        error = normal[j, 3] - sum(normal[j, i] * share[i] for i in range(3))
        better = share[j] + casadi.if_else(normal[j, j] > 0.0, error / normal[j, j], 0.0)
        share[j] = casadi.fmin(casadi.fmax(better, 0.0), 1.0)
    column = casadi.vertcat(*share)
    left = normal[3, 3] + casadi.dot(column, casadi.mtimes(normal[:3, :3], column) - 2.0 * normal[:3, 3])
    left = casadi.fmax(left, 0.0) / 3.0
    for j in range(3):
        gain = share[j] ** 2 * normal[j, j]
        doubt = casadi.if_else(gain > 0.0, (1.0 - share[j]) * (2.0 * SPAN / MEMORY) * left / gain, 1.0)
        share[j] *= casadi.fmax(1.0 - doubt, 0.0)
    following = casadi.vertcat(*share, casadi.vec(driven.T), *products)
    kept = casadi.vertcat(trust[:3], casadi.SX.zeros(12), trust[15:])
    # What is no finite number is not below this.
    finite = casadi.sum1(casadi.vec(casadi.fabs(driven)) <= 1e300) > 11.5
    chosen = [casadi.if_else(finite, following[k], kept[k]) for k in range(TRUST_SIZE)]
    given = [transition, innovation, response, h, trust]
    return casadi.Function("running_trust", given, [casadi.vertcat(*chosen)], {"cse": True})


_SUBSTEPS, _TAYLOR_TERMS = 8, 18


def linear_response(A: casadi.MX, f: casadi.MX, h: casadi.MX, substeps: int = _SUBSTEPS) -> casadi.MX:
    """Return y(h) of y' = A y + f from y(0) = 0.

    Every substep calls one function, and every term of its series another. Written out, the derivatives of the
    series are tens of thousands of lines of C, and compilers take minutes.
    """
    size = f.shape[0]
    matrix, vector, scale = casadi.SX.sym("A", A.sparsity()), casadi.SX.sym("v", size), casadi.SX.sym("scale")
    following = casadi.Function(f"term_{size}", [matrix, vector, scale], [casadi.mtimes(matrix, vector) * scale])
    block, force = casadi.MX.sym("A", A.sparsity()), casadi.MX.sym("f", size)
    start, dt = casadi.MX.sym("y", size), casadi.MX.sym("dt")
    term = following(block, start, dt) + force * dt
    end = start + term
    for k in range(2, _TAYLOR_TERMS + 1):
        term = following(block, term, dt / k)
        end = end + term
    substep = casadi.Function(f"substep_{size}", [start, block, force, dt], [end])
    y = casadi.MX.zeros(size)
    for _ in range(substeps):
        y = substep(y, A, f, h / substeps)
    return y


def memory_step(predict: casadi.Function, graph: NominalGraph, name: str, plain: bool) -> casadi.Function:
    """Return (x, u, h[, p]) -> x_next over states of terms and past commands.

    Parameters are those of `casadi_function.model_step`.
    """
    given = _arguments(graph)
    return _function(graph, name, given, _stepped(graph, given, predict, plain), "x_next")


def trust_functions(
    predict: casadi.Function, graph: NominalGraph, name: str, plain: bool
) -> tuple[casadi.Function, ...]:
    """Return ``NAME_step_trusted`` and ``NAME_observe``; nothing where there is no step.

    ``step_trusted`` is (x, u, h, tau[, p]) -> x_next, with the share tau (3) of each correction. ``observe`` is
    (x, u, h, x_end, trust[, p]) -> trust: the running trust after an interval from x that was measured to end in
    x_end. Parameters are those of `casadi_function.model_step`.

    Notes
    -----
    Errors are judged by a nominal step of Runge-Kutta, in which plays are drawn to their edge as in the right-hand
    side. What an output's whole correction adds is the derivative of `step_trusted` by tau, in which it is linear.
    """
    if graph.features is None:
        return ()
    given, tau = _arguments(graph), casadi.MX.sym("tau", 3)
    x, h, trust = given["x"], given["h"], casadi.MX.sym("trust", TRUST_SIZE)
    shared = _stepped(graph, given, predict, plain, tau)
    taking = {"x": x, "u": given["u"], "h": h, "tau": tau, "p": given["p"]}
    step = _function(graph, f"{name}_step_trusted", taking, shared, "x_next")
    velocity, x_end = casadi.MX.sym("v", 3), casadi.MX.sym("x_end", x.shape[0])
    nominal = _integrated(graph, {**given, "x": casadi.vertcat(x[:3], velocity, x[6:])})
    transition = casadi.jtimes(nominal, velocity, casadi.DM.eye(3))
    nominal, transition = casadi.substitute([nominal, transition], [velocity], [x[3:6]])
    response = casadi.jtimes(shared[3:6], tau, casadi.DM.eye(3))
    (response,) = casadi.substitute([response], [tau], [casadi.MX.zeros(3)])
    after = observation()(transition, x_end[3:6] - nominal, response, h, trust)
    taking = {"x": x, "u": given["u"], "h": h, "x_end": x_end, "trust": trust, "p": given["p"]}
    return step, _function(graph, f"{name}_observe", taking, after, "trust_next")


def _arguments(graph: NominalGraph) -> dict[str, casadi.MX]:
    memory = graph.memory or nothing_kept(1.0)  # a step of any length, since no past command is spaced by it
    sizes = {"x": memory.whole, "u": 2, "h": 1, "p": 2}
    return {label: casadi.MX.sym(label, size) for label, size in sizes.items()}


def _begun(graph: NominalGraph, given: dict[str, casadi.MX]) -> tuple[Memory, casadi.MX, casadi.MX, casadi.MX]:
    """Return the memory, what acts as a step begins, the rates of arriving commands and plays, and [t, s]."""
    memory = graph.memory or nothing_kept(1.0)
    x, u, h, p = (given[label] for label in ("x", "u", "h", "p"))
    place_time = p if graph.needs_place_and_time else casadi.MX.zeros(2)
    first, last = _arrivals(memory, x, u, h)
    acting = casadi.vertcat(x[:6], first, x[8 : memory.continuous])
    moving = [(last[c] - first[c]) / h if memory.lengths[c] else u[c] for c in (0, 1)]
    if memory.plays:
        ended = casadi.vertcat(acting[2:6], last, acting[8:])
        dragged = present(graph.jumps)(ended, place_time)[0]
        moving += [(dragged[k] - acting[8 + play]) / h for k, play in enumerate(memory.plays)]
    return memory, acting, casadi.vertcat(*moving), place_time


def casadi_substeps(graph: NominalGraph) -> int:
    """Return into how many parts a step is divided, the nominal one of ``NAME_observe`` too."""
    return 8 if graph.memory is None else max(8, int(np.ceil(graph.stiffness * graph.memory.step)))


def _whether_fits(memory: Memory, h: casadi.MX) -> casadi.MX:
    """Return 0, or not-a-number where past commands lie in other intervals than h."""
    if not memory.line:
        return casadi.MX(0.0)
    return casadi.if_else(casadi.fabs(h - memory.step) <= 1e-3 * memory.step, 0.0, np.nan)


def _integrated(graph: NominalGraph, given: dict[str, casadi.MX]) -> casadi.MX:
    """Return the velocities after a nominal step of Runge-Kutta."""
    memory, acting, moving, place_time = _begun(graph, given)
    y, m, dt = casadi.MX.sym("y", acting.shape[0] + 2), casadi.MX.sym("m", moving.shape[0]), casadi.MX.sym("dt")
    model = _whole_model(graph, memory, drawn=True)

    def rates(at: casadi.MX) -> casadi.MX:
        return casadi.vertcat(model(at[:-2], m, at[-2:])[0], 1.0, at[3])

    slope = total = rates(y)
    for node, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        slope = rates(y + node * dt * slope)
        total += weight * slope
    substep = casadi.Function("runge_kutta", [y, m, dt], [y + dt / 6.0 * total])
    ended, count = casadi.vertcat(acting, place_time), casadi_substeps(graph)
    for _ in range(count):
        ended = substep(ended, moving, given["h"] / count)
    return ended[3:6] + _whether_fits(memory, given["h"])


def _stepped(
    graph: NominalGraph,
    given: dict[str, casadi.MX],
    predict: casadi.Function,
    plain: bool,
    tau: casadi.MX | None = None,
) -> casadi.MX:
    """Return the state after a step, with a share tau of each correction where one is given.

    Notes
    -----
    The commands that arrive take the place of those given: both ends of a step are known from the past commands,
    and in between they move evenly. Plays move as evenly to where the end drags them.
    Where there are delays, any interval but that of the past commands gives not-a-number.
    """
    memory, acting, moving, place_time = _begun(graph, given)
    x, u, h = given["x"], given["u"], given["h"]
    f, A = _whole_model(graph, memory)(acting, moving, place_time)
    state = x if graph.memory is None else casadi.vertcat(acting, x[6:8])
    residual = predict(present(graph.features)(state, u)[0])[0]
    residual = residual if tau is None else tau * residual
    substeps = casadi_substeps(graph)
    change = h * residual if plain else linear_response(A[3:6, 3:6], residual, h, substeps)
    after = acting + linear_response(A, f, h, substeps)
    line, begin = [], memory.continuous
    for c, length in enumerate(memory.lengths):
        if length:
            line += [x[6 + c], x[begin : begin + length - 1]]
        begin += length
    following = casadi.vertcat(after[:3], after[3:6] + change, x[6:8] + h * u, after[8:], *line)
    return following + _whether_fits(memory, h) if memory.line else following


def memory_functions(predict: casadi.Function, graph: NominalGraph, name: str) -> tuple[casadi.Function, ...]:
    """Return ``NAME_start``, ``NAME_rates`` and, with delays, ``NAME_arrived``; nothing without memory.

    ``start`` fills what follows the first eight states, steady; ``rates`` is x' of the first 8 + S, the
    residual's mean included, with what arrives as an argument where commands are late.
    """
    memory = graph.memory
    if memory is None or graph.features is None:
        return ()
    x, u, p = casadi.MX.sym("x", 8), casadi.MX.sym("u", 2), casadi.MX.sym("p", 2)
    place_time = p if graph.needs_place_and_time else casadi.DM.zeros(2)
    settled = present(graph.start)(x[2:8], place_time) if memory.states else casadi.DM.zeros(0)
    held = [casadi.repmat(x[6 + c], length, 1) for c, length in enumerate(memory.lengths) if length]
    started = casadi.vertcat(x, settled, *held)
    functions = [_function(graph, f"{name}_start", {"x": x, "p": p}, started, "x_start")]
    x, arrived = casadi.MX.sym("x", memory.continuous), casadi.MX.sym("arrived", 2)
    given = {"x": x, "u": u, "arrived": arrived, "p": p} if memory.line else {"x": x, "u": u, "p": p}
    acting = casadi.vertcat(x[:6], arrived if memory.line else x[6:8], x[8:])
    rates = graph.rates(acting[2:], place_time)[0]
    residual = predict(graph.features(casadi.vertcat(acting, x[6:8]), u)[0])[0]
    sine, cosine = casadi.sin(x[2]), casadi.cos(x[2])
    pose = casadi.vertcat(x[3] * cosine - x[4] * sine, x[3] * sine + x[4] * cosine, x[5])
    whole = casadi.vertcat(pose, rates[:3] + residual, u, rates[3:])
    functions.append(_function(graph, f"{name}_rates", given, whole, "rates"))
    if memory.line:
        x = casadi.MX.sym("x", memory.whole)
        now = _arrivals(memory, x, casadi.MX.zeros(2), casadi.MX(0.0))[0]
        functions.append(casadi.Function(f"{name}_arrived", [x], [now], ["x"], ["arrived"]))
    return tuple(functions)


def _function(
    graph: NominalGraph, name: str, given: dict[str, casadi.MX], result: casadi.MX, label: str
) -> casadi.Function:
    """Return a function that takes p only where time or place matter."""
    taken = {key: value for key, value in given.items() if key != "p" or graph.needs_place_and_time}
    return casadi.Function(name, list(taken.values()), [casadi.densify(result)], list(taken), [label])


def _arrivals(memory: Memory, x: casadi.MX, u: casadi.MX, h: casadi.MX) -> tuple[casadi.MX, casadi.MX]:
    """Return what arrives at a step's start and at its end, [T, delta]."""
    first, last, begin = [], [], memory.continuous
    for c, length in enumerate(memory.lengths):
        weights = casadi.DM(memory.weights(c))
        past = x[begin : begin + length]
        begin += length
        first.append(casadi.dot(weights, casadi.vertcat(x[6 + c], past)))
        later = casadi.vertcat(x[6 + c] + h * u[c], x[6 + c], past)[: length + 1]
        last.append(casadi.dot(weights, later))
    return casadi.vertcat(*first), casadi.vertcat(*last)


def _whole_model(graph: NominalGraph, memory: Memory, drawn: bool = False) -> casadi.Function:
    """Return (what acts, rates of arriving commands and plays, p) -> f and its Jacobian A, sparse.

    Plays move at the rates given or, `drawn`, to their edge as in the right-hand side.
    """
    size, plays = memory.continuous, memory.plays
    x, p = casadi.SX.sym("x", size), casadi.SX.sym("p", 2)
    moving = casadi.SX.sym("m", 2 + len(plays))
    rates, jacobian = graph.rates(x[2:], p)
    sine, cosine = casadi.sin(x[2]), casadi.cos(x[2])
    east, north = x[3] * cosine - x[4] * sine, x[3] * sine + x[4] * cosine
    f, A = casadi.SX(size, 1), casadi.SX(size, size)
    f[:3] = casadi.vertcat(east, north, x[5])
    f[3:6], f[6:8] = rates[:3], moving[:2]
    A[0, 2:5] = casadi.horzcat(-north, cosine, -sine)
    A[1, 2:5] = casadi.horzcat(east, sine, cosine)
    A[2, 5] = 1
    A[3:6, 2:] = jacobian[:3, :]
    for k in range(memory.states):
        if k in plays and not drawn:
            f[8 + k] = moving[2 + plays.index(k)]
        else:
            f[8 + k], A[8 + k, 2:] = rates[3 + k], jacobian[3 + k, :]
    return casadi.Function("whole_model", [x, moving, p], [casadi.densify(f), A], {"cse": True})
