"""The quadratic programme of a controller: stages of states, inputs and softened rows, solved by HPIPM.

The first state is known, so it is no variable: variables are u_0, then (x_k, u_k, s_k) of stages 1 to N - 1, then
x_N. States and inputs are differences from the trajectory about which the model was linearised. Every softened row
has one signed slack s with the cost w s^2: lower <= C x + s <= upper.
"""

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import casadi
import numpy as np

from split_cli.control.policy import ATTEMPTS, FEASIBLE, FREE


@dataclass(frozen=True)
class QPData:
    """Numbers of one quadratic programme, with N stages, n states, m inputs, g softened rows."""

    A: np.ndarray  # (N, n, n): x_{k+1} = A_k x_k + B_k u_k + c_k; A_0 is not used, since x_0 = 0
    B: np.ndarray  # (N, n, m)
    c: np.ndarray  # (N, n)
    Q: np.ndarray  # (N, n, n): the cost of x_1 to x_N is x^T Q x/2 + q^T x; symmetric and not negative
    q: np.ndarray  # (N, n)
    R: np.ndarray  # (N, m): the cost of u_0 to u_{N-1} is sum R u^2/2 + r u; positive
    r: np.ndarray  # (N, m)
    C: np.ndarray  # (N - 1, g, n): softened rows of x_1 to x_{N-1}
    # row_lower, row_upper: (N - 1, g)
    row_lower: np.ndarray
    row_upper: np.ndarray
    slack_weight: np.ndarray  # (g,): w of the cost w s^2; positive
    # x_lower, x_upper: (N, n): of x_1 to x_N.
    x_lower: np.ndarray
    x_upper: np.ndarray
    # u_lower, u_upper: (N, m)
    u_lower: np.ndarray
    u_upper: np.ndarray


@dataclass(frozen=True)
class QPSolution:
    """What the solver found."""

    x: np.ndarray  # (N, n): x_1 to x_N
    u: np.ndarray  # (N, m)
    slack: np.ndarray  # (N - 1, g)
    solved: bool  # whether the answer is finite and satisfies dynamics, rows and bounds
    seconds: float  # of the solver alone [s]


class _Bound:
    """A solver with a buffer for every argument and result: an unbound one would be written to at random."""

    def __init__(self, solver: casadi.Function, h: np.ndarray, a: np.ndarray) -> None:
        arguments = {solver.name_in(k): np.zeros(solver.nnz_in(k)) for k in range(solver.n_in())}
        results = {solver.name_out(k): np.zeros(solver.nnz_out(k)) for k in range(solver.n_out())}
        arguments["h"], arguments["a"] = h, a
        self.g, self.lba, self.uba, self.lbx, self.ubx = (arguments[name] for name in ("g", "lba", "uba", "lbx", "ubx"))
        self.x = results["x"]
        self._arguments, self._results = list(arguments.values()), list(results.values())
        self._buffer, self._evaluate = solver.buffer()

    def run(self) -> bool:
        """Evaluate; every run needs its buffers named anew, since the solver moves their pointers on."""
        for k, values in enumerate(self._arguments):
            self._buffer.set_arg(k, memoryview(values))
        for k, values in enumerate(self._results):
            self._buffer.set_res(k, memoryview(values))
        self.x[:] = np.nan
        if not all(np.isfinite(values).all() for values in self._arguments):
            return False
        try:
            self._evaluate()
        except RuntimeError:  # a lower bound above its upper one
            return False
        return self._buffer.ret() == 0


class StageQP:
    """A quadratic programme of fixed size, solved again and again by HPIPM through `casadi.conic`.

    Parameters
    ----------
    horizon : int
        N.
    states, inputs, rows : int
        n, m, g.
    attempts : sequence of mapping
        Settings of HPIPM, tried one after the other until an answer is accepted.

    Notes
    -----
    An answer is accepted by what it is, not by what the solver says of itself: it must satisfy the equations to
    1e-5 of the scaled variables. HPIPM's mode ``speed_abs`` comes first, which steps to the next iterate by its
    absolute value; `ATTEMPTS` tells what that saves and costs. Where its answer is not accepted, mode ``robust``
    solves the same programme.
    """

    def __init__(
        self, horizon: int, states: int, inputs: int, rows: int, attempts: Sequence[Mapping] = ATTEMPTS
    ) -> None:
        self.horizon, self.states, self.inputs, self.rows = horizon, states, inputs, rows
        self._layout()
        self._pattern_of_programme()
        self._solvers = [_Bound(self._build_solver(one), self._h, self._a) for one in attempts]

    def _layout(self) -> None:
        """Number the variables and rows of the whole programme."""
        N, n, m, g = self.horizon, self.states, self.inputs, self.rows
        stage = n + m + g
        begin = m + stage * np.arange(N)
        self.x_at = begin[:, None] + np.arange(n)
        u_begin = np.concatenate([[0], begin[:-1] + n])
        self.u_at = u_begin[:, None] + np.arange(m)
        self.s_at = begin[:-1, None] + n + m + np.arange(g)
        self.size = m + stage * (N - 1) + n
        row_begin = (n + g) * np.arange(N) - np.where(np.arange(N) > 0, g, 0)
        self.gap_at = row_begin[:, None] + np.arange(n)
        self.row_at = row_begin[1:, None] + n + np.arange(g)
        self.row_count = int(self.gap_at[-1, -1]) + 1 + (g if N > 1 else 0)

    def _pattern(self, pairs: list[tuple[np.ndarray, np.ndarray]], shape: tuple[int, int]):
        """Return a sparsity of (row, column) index arrays and, for each, where its entries are stored."""
        flat = [np.ravel(column) * shape[0] + np.ravel(row) for row, column in pairs]
        keys = np.unique(np.concatenate(flat))
        rows, columns = keys % shape[0], keys // shape[0]
        counts = np.concatenate([[0], np.cumsum(np.bincount(columns, minlength=shape[1]))])
        sparsity = casadi.Sparsity(*shape, counts.tolist(), rows.tolist())
        places = [np.searchsorted(keys, f).reshape(row.shape) for f, (row, _) in zip(flat, pairs, strict=True)]
        return sparsity, places

    def _pattern_of_programme(self) -> None:
        x, u, s, gap, row = self.x_at, self.u_at, self.s_at, self.gap_at, self.row_at
        pairs_h = [np.broadcast_arrays(x[:, :, None], x[:, None, :]), (u, u), (s, s)]
        h, (self._Q, self._R, self._S) = self._pattern(pairs_h, (self.size, self.size))
        pairs_a = [
            np.broadcast_arrays(gap[1:, :, None], x[:-1, None, :]),
            np.broadcast_arrays(gap[:, :, None], u[:, None, :]),
            (gap, x),
            np.broadcast_arrays(row[:, :, None], x[:-1, None, :]),
            (row, s),
        ]
        a, (self._A, self._B, minus, self._C, plus) = self._pattern(pairs_a, (self.row_count, self.size))
        self._h, self._a = np.zeros(h.nnz()), np.zeros(a.nnz())
        self._a[minus], self._a[plus] = -1.0, 1.0
        self._sparsity = {"h": h, "a": a}

    def _build_solver(self, settings: Mapping) -> casadi.Function:
        N, n, m, g = self.horizon, self.states, self.inputs, self.rows
        options = {
            "N": N,
            "nx": [0] + [n] * N,
            "nu": [m] + [m + g] * (N - 1) + [0],
            "ng": [0] + [g] * (N - 1) + [0],
            "inf": FREE,
            "error_on_fail": False,
            "print_time": False,
            "hpipm": dict(settings),
        }
        return casadi.conic("programme", "hpipm", self._sparsity, options)

    def solve(self, data: QPData) -> QPSolution:
        """Solve one programme; a failure is an answer with ``solved`` false, not an exception."""
        first, *others = self._solvers
        self._fill(first, data)
        start = time.thread_time()
        solution = self._answer(first, data)
        for other in others:
            if solution.solved:
                break
            self._fill(other, data)
            solution = self._answer(other, data)
        return replace(solution, seconds=time.thread_time() - start)

    def _answer(self, programme: _Bound, data: QPData) -> QPSolution:
        ran, v = programme.run(), programme.x
        x, u, slack = v[self.x_at], v[self.u_at], v[self.s_at]
        return QPSolution(x, u, slack, ran and self._satisfies(data, v, x, u, slack), 0.0)

    def _fill(self, p: _Bound, d: QPData) -> None:
        self._h[self._Q], self._h[self._R], self._h[self._S] = d.Q, d.R, 2.0 * d.slack_weight
        self._a[self._A], self._a[self._B], self._a[self._C] = d.A[1:], d.B, d.C
        p.g[self.x_at], p.g[self.u_at] = d.q, d.r
        p.lba[self.gap_at] = p.uba[self.gap_at] = -d.c
        p.lba[self.row_at] = np.clip(d.row_lower, -FREE, FREE)
        p.uba[self.row_at] = np.clip(d.row_upper, -FREE, FREE)
        p.lbx[self.x_at], p.ubx[self.x_at] = (np.clip(v, -FREE, FREE) for v in (d.x_lower, d.x_upper))
        p.lbx[self.u_at], p.ubx[self.u_at] = (np.clip(v, -FREE, FREE) for v in (d.u_lower, d.u_upper))
        p.lbx[self.s_at], p.ubx[self.s_at] = -FREE, FREE

    def _satisfies(self, d: QPData, whole: np.ndarray, x: np.ndarray, u: np.ndarray, slack: np.ndarray) -> bool:
        if not np.isfinite(whole).all():
            return False
        before = np.concatenate([np.zeros((1, self.states)), x[:-1]])
        gap = np.einsum("kij,kj->ki", d.A, before) + np.einsum("kij,kj->ki", d.B, u) + d.c - x
        rows = np.einsum("kij,kj->ki", d.C, x[:-1]) + slack
        beyond = max(
            np.abs(gap).max(initial=0.0),
            (d.row_lower - rows).max(initial=0.0),
            (rows - d.row_upper).max(initial=0.0),
            (d.x_lower - x).max(initial=0.0),
            (x - d.x_upper).max(initial=0.0),
            (d.u_lower - u).max(initial=0.0),
            (u - d.u_upper).max(initial=0.0),
        )
        return bool(beyond < FEASIBLE * max(1.0, float(np.abs(whole).max())))
