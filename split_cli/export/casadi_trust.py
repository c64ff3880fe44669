"""What the running trust makes of one interval, as a CasADi function."""

from functools import cache

import casadi

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
