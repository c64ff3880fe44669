"""The running trust in a correction, as CasADi functions: how it is judged, and the step that takes its shares."""

from functools import cache

import casadi

from split_cli.export.casadi_step import (
    casadi_substeps,
    named_function,
    step_arguments,
    step_begun,
    stepped,
    whether_interval_fits,
    whole_model,
)
from split_cli.export.symbolic import NominalGraph
from split_cli.learning.running_trust import LEAST_SQUARES, MEMORY, MOST_ERROR, SPAN, SWEEPS

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
        products.append(casadi.exp(-h / MEMORY) * trust[15 + 16 * state : 31 + 16 * state] + casadi.vec(row @ row.T))
    normal, harms = casadi.SX.zeros(4, 4), casadi.SX(0.0)
    for own in products:
        beside = casadi.reshape(own, 4, 4)[:3, :]
        gained = 2.0 * casadi.sum1(beside[:, 3]) - casadi.sum1(casadi.vec(beside[:, :3]))
        harms = casadi.if_else(gained >= 0.0, harms, 1.0)
        weight = casadi.if_else(own[15] > LEAST_SQUARES, 1.0 / own[15], 0.0)
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
        share[j] = casadi.if_else(harms > 0.5, share[j] * casadi.fmax(1.0 - doubt, 0.0), 1.0)
    following = casadi.vertcat(*share, casadi.vec(driven.T), *products)
    kept = casadi.vertcat(trust[:3], casadi.SX.zeros(12), trust[15:])
    # What is not a number is not below this.
    sound = casadi.sum1(casadi.vec(casadi.fabs(driven)) <= MOST_ERROR) > 11.5
    sound = casadi.logic_and(sound, casadi.logic_and(h > 0.0, h <= 1.0))
    chosen = [casadi.if_else(sound, following[k], kept[k]) for k in range(TRUST_SIZE)]
    given = [transition, innovation, response, h, trust]
    return casadi.Function("running_trust", given, [casadi.vertcat(*chosen)], {"cse": True})


def trust_functions(
    correction: casadi.Function, graph: NominalGraph, name: str, plain: bool
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
    given, tau = step_arguments(graph), casadi.MX.sym("tau", 3)
    x, h, trust = given["x"], given["h"], casadi.MX.sym("trust", TRUST_SIZE)
    shared = stepped(graph, given, correction, plain, tau)
    taking = {"x": x, "u": given["u"], "h": h, "tau": tau, "p": given["p"]}
    step = named_function(graph, f"{name}_step_trusted", taking, shared, "x_next")
    velocity, x_end = casadi.MX.sym("v", 3), casadi.MX.sym("x_end", x.shape[0])
    nominal = _nominal_step(graph, {**given, "x": casadi.vertcat(x[:3], velocity, x[6:])}, correction)
    transition = casadi.jtimes(nominal, velocity, casadi.DM.eye(3))
    nominal, transition = casadi.substitute([nominal, transition], [velocity], [x[3:6]])
    response = casadi.jtimes(shared[3:6], tau, casadi.DM.eye(3))
    (response,) = casadi.substitute([response], [tau], [casadi.MX.zeros(3)])
    after = observation()(transition, x_end[3:6] - nominal, response, h, trust)
    taking = {"x": x, "u": given["u"], "h": h, "x_end": x_end, "trust": trust, "p": given["p"]}
    return step, named_function(graph, f"{name}_observe", taking, after, "trust_next")


def _nominal_step(graph: NominalGraph, given: dict[str, casadi.MX], correction: casadi.Function) -> casadi.MX:
    """Return the velocities after a nominal step of Runge-Kutta."""
    memory, acting, moving, situation, _ = step_begun(graph, given, correction, written_out=True)
    size, beside = acting.shape[0], situation.shape[0]
    y, m, dt = casadi.MX.sym("y", size + beside), casadi.MX.sym("m", moving.shape[0]), casadi.MX.sym("dt")
    model = whole_model(graph, memory, drawn=True)

    def rates(at: casadi.MX) -> casadi.MX:
        # Time and place go on; what the set knows is that of the step's start.
        return casadi.vertcat(model(at[:size], m, at[size:])[0], 1.0, at[3], casadi.MX.zeros(beside - 2))

    slope = total = rates(y)
    for node, weight in ((0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        slope = rates(y + node * dt * slope)
        total += weight * slope
    substep = casadi.Function("runge_kutta", [y, m, dt], [y + dt / 6.0 * total])
    ended, count = casadi.vertcat(acting, situation), casadi_substeps(graph)
    for _ in range(count):
        ended = substep(ended, moving, given["h"] / count)
    return ended[3:6] + whether_interval_fits(memory, given["h"])
