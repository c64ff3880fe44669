"""The response of a linear model over an interval, as a CasADi expression that stays short in C."""

import casadi

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
