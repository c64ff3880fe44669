"""A trained set as CasADi functions: the committee in matrix form, and the model step built on it."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import casadi
import numpy as np
import scipy.sparse

from split_cli.errors import OUR_FAULT, ExportError
from split_cli.export.casadi_step import casadi_substeps, memory_step
from split_cli.export.check import ExportAnswer, Oracle, PredictionCheck, check_predictions
from split_cli.export.projection import ProjectionData
from split_cli.export.step_check import (
    StepOracle,
    Stepper,
    check_valid_states,
    compare_drives,
    compare_memory,
    compare_observer,
    compare_states,
)
from split_cli.export.symbolic import NominalGraph
from split_cli.export.tables import BcmTables, Constants, TableData
from split_cli.learning.trust import kept_share


@dataclass(frozen=True)
class CasadiFunctions:
    """What the CasADi target consists of."""

    predict: casadi.Function  # z (D) to mean (3), variance (3)
    # (x (n), u (2), h) to x_next (n), with p = [t, s] as fourth argument where a term needs them; n is 8 without
    # memory.
    step: casadi.Function | None
    # Of a model with memory: its start, its right-hand side and, where commands are late, what arrives.
    memory: tuple[casadi.Function, ...] = ()
    trust: tuple[casadi.Function, ...] = ()  # the step with a share of each correction, and the running trust
    valid: casadi.Function | None = None  # z to 1 where the valid region of training holds it, else 0
    valid_state: casadi.Function | None = None  # the same of (x, u), with the speed that training asks for


def predictor_function(constants: Constants, name: str) -> casadi.Function:
    """Return the predictor z -> (mean, variance) over its constants, which are in double."""
    if isinstance(constants, TableData):
        return spline_table(constants, name)
    if isinstance(constants, ProjectionData):
        return projection(constants, name)
    return committee_function(constants, name)


def correction_function(constants: Constants, clearest: int | None = None) -> casadi.Function:
    """Return what a step asks in one query: z -> the mean and, with `clearest`, how much the set knows.

    Parameters
    ----------
    clearest : int, optional
        The output whose variance counts (`Kernel.clearest`): the second answer is the share of the prior's that
        labels explain, from 0 to 1, whatever the trust.

    Notes
    -----
    The predictor is written out, not called, so that no variance is evaluated that nobody asked for.
    """
    process = predictor_function(replace(constants, trust=np.ones(3), doubt=np.zeros(3)), "process")
    z = casadi.MX.sym("z", constants.feature_count)
    mean, variance = process.call([z], True, False)
    # CasADi drops what is multiplied by zero, and with it the answer to a query that is not a number.
    answers = [casadi.DM(np.maximum(constants.trust, 1e-300)) * mean]
    if clearest is not None:
        left = variance[clearest] / float(constants.signal_variance[clearest])
        answers.append(casadi.fmax(1.0 - left, 0.0))
    return casadi.Function("correction", [z], answers)


def committee_function(tables: BcmTables, name: str) -> casadi.Function:
    """Return the committee z -> (mean, variance), robust or not, as a graph of a few dozen matrix operations.

    Parameters
    ----------
    tables : BcmTables
        In double.

    Notes
    -----
    An expanded (SX) graph would hold every point's exponential and every product, hundreds of thousands of
    nodes. Here the points are rows of dense constants, the cells' eigenvectors one sparse block-diagonal matrix
    and the sums over a cell sparse products, so graph, derivatives and generated C stay small. All cells are
    visited: a branch would cost the graph its smooth derivatives, and the exponential of far cells is zero.
    """
    counts = np.diff(tables.offsets)
    absolute = np.repeat(tables.reference, counts, axis=0) / tables.length_scales + tables.points
    z = casadi.MX.sym("z", tables.feature_count)
    correlations = _correlations(z, tables.length_scales, absolute)
    turned = casadi.mtimes(_block_diagonal(tables), correlations)
    gathered = _gather(counts)
    mean, variance = [], []
    for output in range(3):
        q = casadi.mtimes(_scaled(gathered, tables.gains[:, output]), turned**2)
        m = casadi.mtimes(_scaled(gathered, tables.weights[:, output]), turned)
        ratio = float(tables.noise_ratio[output])
        # A cell's one point, asked for exactly, leaves the least there is, rho/(n + rho). The bound is half of
        # that: where both sides of a maximum are equal its derivative is half of either, and Hessians are wrong.
        share = 1.0 / casadi.fmax(1.0 - q, casadi.DM(0.5 * ratio / (counts + ratio)))
        if tables.robust:
            share = 0.5 * casadi.log(share) * share
        precision = 1.0 + casadi.dot(q, share)
        # CasADi drops what is multiplied by zero, and with it the answer to a query that is not a number.
        learned, trust = casadi.dot(m, share) / precision, max(float(tables.trust[output]), 1e-300)
        mean.append(trust * learned)
        certain = _certain(tables, output)
        variance.append(certain / precision + float(tables.doubt[output]))
    outputs = [casadi.vertcat(*mean), casadi.vertcat(*variance)]
    return casadi.Function(name, [z], outputs, ["z"], ["mean", "variance"])


def spline_table(tables: TableData, name: str) -> casadi.Function:
    """Return the table z -> (mean, variance) as CasADi's own tensor-product B-spline.

    Parameters
    ----------
    tables : TableData
        In double.

    Notes
    -----
    CasADi's splines end at their last knot. The table's outer coefficients are 0, so that a query is clamped into
    the layer where the spline and two of its derivatives vanish, and no edge is seen.
    """
    sizes = tables.coefficients.shape[:3]
    z = casadi.MX.sym("z", 3)
    knots, place = [], []
    for axis, size in enumerate(sizes):
        # Node k carries the spline that spans the knots k - 2 to k + 2.
        knots.append((np.arange(size + 4) - 2.0).tolist())
        at = (z[axis] - float(tables.origin[axis])) / float(tables.spacing[axis])
        place.append(casadi.fmin(casadi.fmax(at, 1.0), float(size - 2)))
    flat = casadi.DM(np.ascontiguousarray(tables.coefficients.transpose(2, 1, 0, 3), dtype=float).ravel())
    value = casadi.bspline(casadi.vertcat(*place), flat, knots, [3, 3, 3], 6, {"lookup_mode": ["exact"] * 3})
    value = value * casadi.DM(tables.unit)
    # What is clamped forgets that it was not a number, which alone is neither above 0 nor below.
    known = casadi.sum1(casadi.logic_or(z >= 0.0, z <= 0.0)) > 2.5
    unknown = casadi.if_else(known, 0.0, np.nan)
    learned = value[:3] + unknown
    left = casadi.fmin(casadi.fmax(1.0 - value[3:], casadi.DM(tables.least)), 1.0)
    trust, certain = casadi.DM(tables.trust), casadi.DM([_certain(tables, output) for output in range(3)])
    variance = certain * left**2 + casadi.DM(tables.doubt) + unknown
    outputs = [trust * learned + unknown, variance]
    return casadi.Function(name, [z], outputs, ["z"], ["mean", "variance"])


def projection(constants: ProjectionData, name: str) -> casadi.Function:
    """Return the projected process z -> (mean, variance) as a dozen matrix operations."""
    z = casadi.MX.sym("z", constants.feature_count)
    absolute = constants.reference / constants.length_scales + constants.points
    c = _correlations(z, constants.length_scales, absolute)
    count = len(constants.points)
    rows, columns = np.tril_indices(count)
    t = casadi.mtimes(_triangle(constants.whitening, rows, columns).T, c)
    gain = casadi.fmax(1.0 - casadi.dot(t, t), 0.0)
    shown = casadi.fmin(gain, float(constants.gain_limit[0])) * (1.0 - gain)
    mean, variance = [], []
    for output in range(3):
        # CasADi drops what is multiplied by zero, and with it the answer to a query that is not a number.
        trust = max(float(constants.trust[output]), 1e-300)
        mean.append(trust * casadi.dot(casadi.DM(constants.weights[:, output]), c))
        left = casadi.dot(casadi.mtimes(_triangle(constants.spread[output], rows, columns).T, t), t)
        share = gain + left - float(constants.absent[output]) * shown
        certain = _certain(constants, output)
        variance.append(certain * share + float(constants.doubt[output]))
    outputs = [casadi.vertcat(*mean), casadi.vertcat(*variance)]
    return casadi.Function(name, [z], outputs, ["z"], ["mean", "variance"])


def _certain(constants: Constants, output: int) -> float:
    """Return what the share of the variance is multiplied by; never 0, which CasADi would drop with its query."""
    kept = kept_share(constants.trust, constants.doubt, constants.signal_variance)
    return max(float(kept[output]), 1e-300) * float(constants.signal_variance[output])


def _correlations(z: casadi.MX, length_scales: np.ndarray, points: np.ndarray) -> casadi.MX:
    """Return the correlations of a query with points in length scales, shape (P, 1)."""
    squared = casadi.MX(0.0)
    for feature, length in enumerate(length_scales):
        squared = squared + (z[feature] / float(length) - casadi.DM(points[:, feature])) ** 2
    return casadi.exp(-0.5 * squared)


def _triangle(values: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> casadi.DM:
    """Return a lower triangle stored row by row as a sparse matrix."""
    return _sparse(scipy.sparse.csc_matrix((values, (rows, columns))))


def _block_diagonal(tables: BcmTables) -> casadi.DM:
    """Return V^T of every cell on the diagonal, sparse (P, P)."""
    counts = np.diff(tables.offsets)
    squares = tables.square_offsets
    blocks = [
        tables.eigenvectors[squares[cell] : squares[cell + 1]].reshape(count, count).T
        for cell, count in enumerate(counts)
    ]
    return _sparse(scipy.sparse.block_diag(blocks, format="csc"))


def _gather(counts: np.ndarray) -> scipy.sparse.csc_matrix:
    """Return the matrix that sums over the points of each cell, sparse (C, P)."""
    points = int(counts.sum())
    rows = np.repeat(np.arange(len(counts)), counts)
    return scipy.sparse.csc_matrix((np.ones(points), rows, np.arange(points + 1)), (len(counts), points))


def _scaled(matrix: scipy.sparse.csc_matrix, columns: np.ndarray) -> casadi.DM:
    scaled = matrix.copy()
    scaled.data = np.ascontiguousarray(columns)
    return _sparse(scaled)


def _sparse(matrix: scipy.sparse.csc_matrix) -> casadi.DM:
    matrix = matrix.tocsc()
    matrix.sort_indices()
    rows, columns = matrix.shape
    pattern = casadi.Sparsity(rows, columns, matrix.indptr.tolist(), matrix.indices.tolist())
    return casadi.DM(pattern, matrix.data)


def model_step(
    correction: casadi.Function, graph: NominalGraph, name: str, plain: bool = False
) -> casadi.Function | None:
    """Return (x, u, h[, p]) -> x_next: linearised exact nominal step plus the residual; None without features.

    Parameters
    ----------
    correction : casadi.Function
        Whose first answer is the mean, as those of `correction_function` and of the predictor are. Where the graph
        asks, the second is how much the set knows.
    plain : bool
        Whether the set's labels are plain differences, so that h g itself is added.

    Notes
    -----
    The matrix exponential's action is a Taylor series of 18 terms over 8 equal substeps of the linear system,
    exact to rounding while the velocity Jacobian's norm times h is below about 8; no branch, so any number of
    derivatives is right.
    """
    return None if graph.features is None else memory_step(correction, graph, name, plain)


def casadi_answer(predict: casadi.Function) -> ExportAnswer:
    """Return a committee as something `check_predictions` can ask, derivatives included."""
    z = casadi.MX.sym("z", predict.size1_in(0))
    slopes = casadi.Function("slopes", [z], [casadi.densify(casadi.jacobian(predict(z)[0], z))])

    def answer(queries: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rows = [predict(query) for query in queries]
        mean, variance = (np.array([np.asarray(row[k]).ravel() for row in rows]) for k in (0, 1))
        return mean, variance

    return ExportAnswer(answer, lambda queries: np.array([np.asarray(slopes(query)) for query in queries]))


def check_casadi(
    functions: CasadiFunctions, oracle: Oracle, steps: StepOracle | None
) -> tuple[PredictionCheck, float | None]:
    """Compare value, Jacobian, Hessian and step with Python and with finite differences.

    Returns
    -------
    PredictionCheck
    float or None
        Largest relative error of the step.

    Raises
    ------
    ExportError
        See `check_predictions`, `check_hessian` and `step_check.compare_states`.
    """
    check = check_predictions(casadi_answer(functions.predict), oracle, "double", "CasADi")
    check_hessian(functions.predict, oracle)
    exported = functions.step
    if exported is None or steps is None:
        return check, None

    def step(asked: np.ndarray, function: casadi.Function = exported) -> np.ndarray:
        return np.array([_step_once(function, row) for row in asked])

    error = compare_states(step(steps.asked), steps.exact, steps, "double", "CasADi: the step")
    for trusted in functions.trust[:1]:
        wholly = step(steps.asked, trusted)
        error = max(error, compare_states(wholly, steps.exact, steps, "double", "CasADi: the step with all trust"))
    if functions.valid_state is not None:
        check_valid_states(valid_state_answer(functions.valid_state), steps, "double", "CasADi")
    if functions.trust:
        substeps = casadi_substeps(steps.model.graph)
        compare_observer(observer_answer(functions.trust[1]), steps, substeps, "double", "CasADi: the running trust")
    if steps.drives is not None:
        error = max(error, compare_drives(step, steps, "exact", "double", "CasADi: the step over a drive"))
        for function in functions.memory:
            compare_memory(function.name(), _memory_answer(function), steps, "double", "CasADi")
    _check_step_jacobian(exported, steps)
    return check, error


def _step_once(step: casadi.Function, asked: np.ndarray) -> np.ndarray:
    n = step.size1_in(0)
    given = {"x": asked[:n], "u": asked[n : n + 2], "h": asked[n + 2], "p": asked[n + 3 : n + 5]}
    given["tau"] = np.ones(3)
    return np.asarray(step(*(given[step.name_in(k)] for k in range(step.n_in())))).ravel()


def valid_state_answer(function: casadi.Function) -> Callable[[np.ndarray], np.ndarray]:
    """Return ``NAME_valid_state`` as something that rows of `StepOracle.asked` (N, n + 5) can ask."""
    n = function.size1_in(0)
    return lambda asked: np.array([float(function(row[:n], row[n : n + 2])) > 0.5 for row in asked])


def observer_answer(observe: casadi.Function) -> Stepper:
    """Return ``NAME_observe`` as something that the rows of `step_check.observed` can ask."""

    def answer(asked: np.ndarray) -> np.ndarray:
        n = observe.size1_in(0)
        parts = np.split(asked.T, np.cumsum([n, 2, 1, 2, n]))
        given = dict(zip(("x", "u", "h", "p", "x_end", "trust"), parts, strict=True))
        return np.asarray(observe.map(len(asked))(*(given[observe.name_in(k)] for k in range(observe.n_in())))).T

    return answer


def _memory_answer(function: casadi.Function) -> Stepper:
    """Return a function of (x, u, arrived, p), whichever of them it takes, as something that rows can ask."""

    def answer(asked: np.ndarray) -> np.ndarray:
        n = asked.shape[1] - 7
        x = asked[:, : function.size1_in(0)]
        given = {"u": asked[:, n : n + 2], "p": asked[:, n + 3 : n + 5], "arrived": asked[:, n + 5 :]}
        arguments = [x.T, *(given[function.name_in(k)].T for k in range(1, function.n_in()))]
        return np.asarray(function.map(len(asked))(*arguments)).T

    return answer


def _check_step_jacobian(step: casadi.Function, steps: StepOracle) -> None:
    """Compare the step's own Jacobian by (x, u) with central differences of fourth order of the step."""
    n = steps.size
    symbols = [casadi.MX.sym(step.name_in(k), step.size1_in(k)) for k in range(step.n_in())]
    jacobian = casadi.Function(
        "step_jacobian", symbols, [casadi.jacobian(step(*symbols), casadi.vertcat(symbols[0], symbols[1]))]
    )
    for asked in steps.asked[:5]:
        given = [asked[:n], asked[n : n + 2], asked[n + 2], asked[n + 3 : n + 5]]
        found = np.asarray(jacobian(*given[: step.n_in()]))
        for column in range(n + 2):
            move = np.zeros(n + 5)
            # Wide for torque, whose effect is small, and narrow for angles, on which slip depends.
            move[column] = 1e-5 * (1.0 + np.abs(steps.asked[:, column]).max())
            near = _step_once(step, asked + move) - _step_once(step, asked - move)
            far = _step_once(step, asked + 2 * move) - _step_once(step, asked - 2 * move)
            expected = (8.0 * near - far) / (12.0 * move[column])
            # Where the two differences disagree a kink lies between: a play's edge, a torque's change of sign.
            kink = np.abs(2.0 * near - far) > 1e-5 * (4.0 * move[column] + np.abs(far))
            error = np.abs(found[:, column] - expected) / (1.0 + np.abs(expected))
            worst = float(np.where(kink, 0.0, error).max())
            if not worst <= 1e-5:
                raise ExportError(
                    f"CasADi: the step's Jacobian is {worst:.3g} off finite differences in column {column}; "
                    "nothing was written",
                    advice=OUR_FAULT,
                )


def check_hessian(predict: casadi.Function, oracle: Oracle) -> float:
    """Compare second derivatives of the mean with central differences of CasADi's own Jacobian.

    Returns
    -------
    float
        Largest error, relative to sd/(l l' rho), the size a second derivative can reach.

    Raises
    ------
    ExportError
        If it exceeds 1e-6.
    """
    width = predict.size1_in(0)
    z = casadi.MX.sym("z", width)
    jacobian = casadi.densify(casadi.jacobian(predict(z)[0], z))
    first = casadi.Function("first", [z], [jacobian])
    second = casadi.Function("second", [z], [casadi.densify(casadi.jacobian(casadi.vec(jacobian), z))])
    kernel = oracle.reference.training_set.kernel
    ratio = float((kernel.noise_variance / kernel.signal_variance).min())
    steps = oracle.reference.hessian_step
    worst = 0.0
    for query in oracle.slope_z[:: max(1, len(oracle.slope_z) // 20)]:
        found = np.asarray(second(query)).reshape(width, 3, width)
        for feature, step in enumerate(steps):
            move = np.zeros(width)
            move[feature] = step
            near = np.asarray(first(query + move)) - np.asarray(first(query - move))
            far = np.asarray(first(query + 2 * move)) - np.asarray(first(query - 2 * move))
            expected = (8.0 * near - far) / (12.0 * step)
            size = (oracle.reference.deviation / ratio)[:, None] / kernel.length_scales / kernel.length_scales[feature]
            worst = max(worst, float((np.abs(found[:, :, feature].T - expected) / size).max()))
    if not worst <= 1e-6:
        what = f"CasADi: the Hessian is {worst:.3g} off finite differences; nothing was written"
        raise ExportError(what, advice=OUR_FAULT)
    return worst


def generate_c(functions: CasadiFunctions, name: str, folder: Path) -> tuple[Path, ...]:
    """Write CasADi's own C of the committee and, if there is one, of the step with its Jacobian by (u, x).

    The functions are ``NAME_mean_variance``, ``NAME_mean_variance_jacobian``, ``NAME_discrete`` and
    ``NAME_discrete_jacobian``; the last two take (x, u, h).
    """
    generator = casadi.CodeGenerator(f"{name}_casadi.c", {"with_header": True})
    z = casadi.MX.sym("z", functions.predict.size1_in(0))
    outputs = functions.predict(z)
    slopes = casadi.densify(casadi.jacobian(outputs[0], z))
    generator.add(casadi.Function(f"{name}_mean_variance", [z], list(outputs), ["z"], ["mean", "variance"]))
    generator.add(casadi.Function(f"{name}_mean_variance_jacobian", [z], [*outputs, slopes]))
    for region in (functions.valid, functions.valid_state):
        if region is not None:
            generator.add(region)
    if functions.step is not None:
        symbols = [
            casadi.MX.sym(functions.step.name_in(k), functions.step.size1_in(k)) for k in range(functions.step.n_in())
        ]
        following = functions.step(*symbols)
        by_inputs = casadi.densify(casadi.jacobian(following, casadi.vertcat(symbols[1], symbols[0])))
        generator.add(casadi.Function(f"{name}_discrete", symbols, [following]))
        # Transposed, as acados wants it: rows are u then x, columns the next state.
        generator.add(casadi.Function(f"{name}_discrete_jacobian", symbols, [following, by_inputs.T]))
    generator.generate(f"{folder}/")
    return folder / f"{name}_casadi.c", folder / f"{name}_casadi.h"
