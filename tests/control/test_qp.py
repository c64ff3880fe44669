"""The programme of a controller against a dense solver, and what it says of an answer that is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import LinearConstraint, minimize

from split_cli.control.policy import ATTEMPTS
from split_cli.control.qp import QPData, StageQP


def programme(seed: int, N: int = 4, n: int = 3, m: int = 2, g: int = 2) -> QPData:
    rng = np.random.default_rng(seed)
    root = rng.standard_normal((N, n, n))
    return QPData(
        A=np.eye(n) + 0.3 * rng.standard_normal((N, n, n)),
        B=rng.standard_normal((N, n, m)),
        c=0.5 * rng.standard_normal((N, n)),
        Q=root @ root.transpose(0, 2, 1) + 0.1 * np.eye(n),
        q=rng.standard_normal((N, n)),
        R=rng.uniform(0.5, 2.0, (N, m)),
        r=rng.standard_normal((N, m)),
        C=rng.standard_normal((N - 1, g, n)),
        row_lower=np.full((N - 1, g), -0.1),
        row_upper=np.full((N - 1, g), 0.1),
        slack_weight=np.array([30.0, 3.0]),
        x_lower=np.full((N, n), -2.0),
        x_upper=np.full((N, n), 2.0),
        u_lower=np.full((N, m), -0.5),
        u_upper=np.full((N, m), 0.5),
    )


def dense(data: QPData, at: StageQP) -> tuple[np.ndarray, ...]:
    """Return H, g, A, lower and upper of rows, gaps first, and of variables, written out from what `QPData` says."""
    N, n, g = data.C.shape[0] + 1, data.A.shape[1], data.C.shape[1]
    H, gradient = np.zeros((at.size, at.size)), np.zeros(at.size)
    gaps, rows = np.zeros((N, n, at.size)), np.zeros((N - 1, g, at.size))
    low, high = np.full(at.size, -1e3), np.full(at.size, 1e3)
    for k in range(N):
        x, u = at.x_at[k], at.u_at[k]
        H[np.ix_(x, x)], H[u, u], gradient[x], gradient[u] = data.Q[k], data.R[k], data.q[k], data.r[k]
        low[x], high[x], low[u], high[u] = data.x_lower[k], data.x_upper[k], data.u_lower[k], data.u_upper[k]
        gaps[k][:, x], gaps[k][:, u] = -np.eye(n), data.B[k]
        if k:
            before, slack = at.x_at[k - 1], at.s_at[k - 1]
            gaps[k][:, before], rows[k - 1][:, before], rows[k - 1][:, slack] = data.A[k], data.C[k - 1], np.eye(g)
            H[slack, slack] = 2.0 * data.slack_weight
    A = np.concatenate([gaps.reshape(-1, at.size), rows.reshape(-1, at.size)])
    ends = ([-data.c.ravel(), bound.ravel()] for bound in (data.row_lower, data.row_upper))
    return H, gradient, A, *map(np.concatenate, ends), low, high


@pytest.mark.parametrize("seed", range(4))
def test_the_answer_is_that_of_a_dense_solver(seed):
    data = programme(seed)
    solver = StageQP(4, 3, 2, 2)
    found = solver.solve(data)
    H, g, A, lba, uba, low, high = dense(data, solver)
    reference = minimize(
        lambda w: 0.5 * w @ H @ w + g @ w,
        np.zeros(len(g)),
        jac=lambda w: H @ w + g,
        hess=lambda w: H,
        method="trust-constr",
        constraints=[LinearConstraint(A, lba, uba)],
        bounds=list(zip(low, high, strict=True)),
        options={"gtol": 1e-9, "xtol": 1e-12, "maxiter": 3000},
    ).x
    assert found.solved
    # Bounds act in these programmes, or the comparison would be one of linear systems.
    assert np.abs(found.u).max() == pytest.approx(0.5, abs=1e-5)
    # The interior point method ends within 1e-6 of the optimum, the reference within about 1e-5 of it.
    for ours, places in ((found.x, solver.x_at), (found.u, solver.u_at), (found.slack, solver.s_at)):
        assert ours == pytest.approx(reference[places], abs=2e-4)


def test_without_bounds_the_answer_solves_the_normal_equations():
    data = programme(7)
    wide = {
        name: np.full_like(getattr(data, name), sign * 1e3)
        for name, sign in (
            ("x_lower", -1),
            ("x_upper", 1),
            ("u_lower", -1),
            ("u_upper", 1),
            ("row_lower", -1),
            ("row_upper", 1),
        )
    }
    data = replace(data, **wide)
    solver = StageQP(4, 3, 2, 2)
    found = solver.solve(data)
    H, g, A, lba, *_ = dense(data, solver)
    G, gaps = A[: data.c.size], lba[: data.c.size]
    exact = np.linalg.solve(np.block([[H, G.T], [G, np.zeros((len(G), len(G)))]]), np.concatenate([-g, gaps]))
    assert found.solved
    assert found.x == pytest.approx(exact[solver.x_at], abs=1e-5)
    assert found.u == pytest.approx(exact[solver.u_at], abs=1e-5)
    assert np.abs(found.slack).max() < 1e-5


def test_a_second_programme_is_answered_anew():
    solver = StageQP(4, 3, 2, 2)
    first, second = programme(1), programme(2)
    solver.solve(first)
    alone = StageQP(4, 3, 2, 2).solve(second)
    assert solver.solve(second).x == pytest.approx(alone.x, abs=1e-8)


def test_bounds_that_no_input_reaches_are_a_failure_and_the_next_programme_is_solved():
    data = programme(3)
    solver = StageQP(4, 3, 2, 2)
    # x_1 = B u + c with |u| <= 0.5 cannot be near 1e3.
    beyond = replace(data, x_lower=np.full((4, 3), 999.0), x_upper=np.full((4, 3), 1000.0))
    assert not solver.solve(beyond).solved
    assert solver.solve(data).solved
    broken = replace(data, c=np.full((4, 3), np.nan))
    assert not solver.solve(broken).solved
    assert solver.solve(data).solved


@pytest.mark.parametrize("seed", range(3))
def test_the_fast_mode_answers_as_the_safe_one(seed):
    data = programme(seed, N=12)
    fast, safe = (StageQP(12, 3, 2, 2, attempts=[one]).solve(data) for one in ATTEMPTS)
    # Both end an interior point method at complementarities of about 1e-5 of variables of size 1.
    assert fast.solved and safe.solved and fast.u == pytest.approx(safe.u, abs=1e-4)


def test_the_safe_mode_answers_where_the_fast_one_does_not():
    """Without any iteration there is no answer."""
    data, (fast, safe) = programme(5), ATTEMPTS
    none = {**fast, "iter_max": 0}
    assert not StageQP(4, 3, 2, 2, attempts=[none]).solve(data).solved
    found, expected = StageQP(4, 3, 2, 2, attempts=[none, safe]).solve(data), StageQP(4, 3, 2, 2).solve(data)
    assert found.solved and found.u == pytest.approx(expected.u, abs=1e-4)
