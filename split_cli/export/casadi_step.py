"""The step of a model, with memory or without, its start and its right-hand side, as CasADi functions."""

import casadi
import numpy as np

from split_cli.export.casadi_response import linear_response
from split_cli.export.memory import Memory, nothing_kept, present
from split_cli.export.symbolic import NominalGraph


def memory_step(correction: casadi.Function, graph: NominalGraph, name: str, plain: bool) -> casadi.Function:
    """Return (x, u, h[, p]) -> x_next over states of terms and past commands.

    Parameters are those of `casadi_function.model_step`.
    """
    given = step_arguments(graph)
    return named_function(graph, name, given, stepped(graph, given, correction, plain), "x_next")


def step_arguments(graph: NominalGraph) -> dict[str, casadi.MX]:
    """Return the symbols of a step: state x, inputs u, interval h, and p = [t, s]."""
    memory = graph.memory or nothing_kept(1.0)  # a step of any length, since no past command is spaced by it
    sizes = {"x": memory.whole, "u": 2, "h": 1, "p": 2}
    return {label: casadi.MX.sym(label, size) for label, size in sizes.items()}


def step_begun(
    graph: NominalGraph, given: dict[str, casadi.MX], correction: casadi.Function, written_out: bool = False
) -> tuple[Memory, casadi.MX, casadi.MX, casadi.MX, casadi.MX]:
    """Return what a step begins with.

    Parameters
    ----------
    correction : casadi.Function
        As `casadi_function.model_step` takes it.
    written_out : bool
        Whether it stands in the graph in place of a call. Then an answer that is not used costs nothing, and what
        is differentiated is not saved with every function that calls it.

    Returns
    -------
    tuple
        The memory, what acts, the rates of arriving commands and plays, the situation and the mean. The situation
        is [t, s], and how much the set knows where a term asks.
    """
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
    state = x if graph.memory is None else casadi.vertcat(acting, x[6:8])
    answers = correction.call([present(graph.features)(state, u)[0]], written_out, False)
    return memory, acting, casadi.vertcat(*moving), _situation(graph, place_time, answers), answers[0]


def _situation(graph: NominalGraph, place_time: casadi.MX, answers: list[casadi.MX]) -> casadi.MX:
    """Return [t, s], and how much the set knows where a term asks."""
    return casadi.vertcat(place_time, answers[1]) if graph.asks_knowledge else place_time


def casadi_substeps(graph: NominalGraph) -> int:
    """Return into how many parts a step is divided, the nominal one of ``NAME_observe`` too."""
    return 8 if graph.memory is None else max(8, int(np.ceil(graph.stiffness * graph.memory.step)))


def whether_interval_fits(memory: Memory, h: casadi.MX) -> casadi.MX:
    """Return 0, or not-a-number where past commands lie in other intervals than h."""
    if not memory.line:
        return casadi.MX(0.0)
    return casadi.if_else(casadi.fabs(h - memory.step) <= 1e-3 * memory.step, 0.0, np.nan)


def stepped(
    graph: NominalGraph,
    given: dict[str, casadi.MX],
    correction: casadi.Function,
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
    memory, acting, moving, situation, residual = step_begun(graph, given, correction)
    x, u, h = given["x"], given["u"], given["h"]
    f, A = whole_model(graph, memory)(acting, moving, situation)
    residual = residual if tau is None else tau * residual
    substeps = casadi_substeps(graph)
    after = acting + linear_response(A, f, h, substeps)
    last = memory.continuous if graph.feeds_back else 6
    pushed = casadi.vertcat(residual, casadi.MX.zeros(last - 6))
    change = h * pushed if plain else linear_response(A[3:last, 3:last], pushed, h, substeps)
    remembered = after[8:] + change[5:] if graph.feeds_back else after[8:]
    line, begin = [], memory.continuous
    for c, length in enumerate(memory.lengths):
        if length:
            line += [x[6 + c], x[begin : begin + length - 1]]
        begin += length
    following = casadi.vertcat(after[:3], after[3:6] + change[:3], x[6:8] + h * u, remembered, *line)
    return following + whether_interval_fits(memory, h) if memory.line else following


def features_of(graph: NominalGraph, x: casadi.MX, u: casadi.MX) -> casadi.MX:
    """Return the features z of a whole state x and an input u, of what arrives where commands are late."""
    memory = graph.memory
    if memory is None:
        return present(graph.features)(x, u)[0]
    first, _ = _arrivals(memory, x, u, casadi.MX(0.0))
    return present(graph.features)(casadi.vertcat(x[:6], first, x[8 : memory.continuous], x[6:8]), u)[0]


def memory_functions(correction: casadi.Function, graph: NominalGraph, name: str) -> tuple[casadi.Function, ...]:
    """Return ``NAME_start``, ``NAME_rates`` and, with delays, ``NAME_arrived``; nothing without memory.

    ``start`` fills what follows the first eight states, steady; ``rates`` is x' of the first 8 + S, the
    residual's mean included, with what arrives as an argument where commands are late.
    """
    memory = graph.memory
    if memory is None or graph.features is None:
        return ()
    x, u, p = casadi.MX.sym("x", 8), casadi.MX.sym("u", 2), casadi.MX.sym("p", 2)
    place_time = p if graph.needs_place_and_time else casadi.MX.zeros(2)
    settled = present(graph.start)(x[2:8], place_time) if memory.states else casadi.DM.zeros(0)
    held = [casadi.repmat(x[6 + c], length, 1) for c, length in enumerate(memory.lengths) if length]
    started = casadi.vertcat(x, settled, *held)
    functions = [named_function(graph, f"{name}_start", {"x": x, "p": p}, started, "x_start")]
    x, arrived = casadi.MX.sym("x", memory.continuous), casadi.MX.sym("arrived", 2)
    given = {"x": x, "u": u, "arrived": arrived, "p": p} if memory.line else {"x": x, "u": u, "p": p}
    acting = casadi.vertcat(x[:6], arrived if memory.line else x[6:8], x[8:])
    state = casadi.vertcat(acting, x[6:8])
    answers = correction.call([graph.features(state, u)[0]])
    rates = graph.rates(acting[2:], _situation(graph, place_time, answers))[0]
    sine, cosine = casadi.sin(x[2]), casadi.cos(x[2])
    pose = casadi.vertcat(x[3] * cosine - x[4] * sine, x[3] * sine + x[4] * cosine, x[5])
    whole = casadi.vertcat(pose, rates[:3] + answers[0], u, rates[3:])
    functions.append(named_function(graph, f"{name}_rates", given, whole, "rates"))
    if memory.line:
        x = casadi.MX.sym("x", memory.whole)
        now = _arrivals(memory, x, casadi.MX.zeros(2), casadi.MX(0.0))[0]
        functions.append(casadi.Function(f"{name}_arrived", [x], [now], ["x"], ["arrived"]))
    return tuple(functions)


def named_function(
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


def whole_model(graph: NominalGraph, memory: Memory, drawn: bool = False) -> casadi.Function:
    """Return (what acts, rates of arriving commands and plays, situation) -> f and its Jacobian A, sparse.

    Plays move at the rates given or, `drawn`, to their edge as in the right-hand side.
    """
    size, plays = memory.continuous, memory.plays
    x, p = casadi.SX.sym("x", size), casadi.SX.sym("p", graph.rates.size1_in(1))
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
