"""Comparison of an export with Python on random and border queries; an export that fails is not written."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from split_cli.errors import OUR_FAULT, ExportError
from split_cli.export.reference import CommitteeReference, ProcessReference, Reference, SplineReference
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import Predictor
from split_cli.prediction.projected import ProjectedPredictor
from split_cli.prediction.table import TablePredictor
from split_cli.prediction.trusted import untrusted

TOLERANCE = {"double": 1e-12, "float": 1e-5}
"""Largest error of the mean in signal deviations, and of the variance in signal variances."""

JACOBIAN_TOLERANCE = {"double": 1e-7, "float": 1e-3}
"""Largest error of the Jacobian in units of sd/(l sqrt(rho)), where finite differences reach about 1e-9."""

JACOBIAN_QUERIES = 200


@dataclass(frozen=True)
class ExportAnswer:
    """An exported predictor under test."""

    # z, shape (N, D), to mean and variance, shape (N, 3) each.
    predict: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    # z to the mean's Jacobian, shape (N, 3, D); None for formats that only carry numbers.
    jacobian: Callable[[np.ndarray], np.ndarray] | None = None


@dataclass(frozen=True)
class PredictionCheck:
    """What the comparison found."""

    queries: int
    tolerance: float
    mean_error: float  # largest, in signal deviations
    variance_error: float  # largest, in signal variances
    jacobian_error: float | None  # largest against finite differences, in sd/(l sqrt(rho))


@dataclass(frozen=True)
class Oracle:
    """Queries and what Python answers."""

    z: np.ndarray  # (N, D)
    # mean, variance: (N, 3)
    mean: np.ndarray
    variance: np.ndarray
    slope_z: np.ndarray  # (M, D): queries at which Jacobians are compared
    slopes: np.ndarray  # (M, 3, D)
    # Largest difference of the predictor from the reference, in signal deviations and variances.
    predictor_error: float
    reference: Reference


def check_queries(training_set: TrainingSet, count: int) -> np.ndarray:
    """Return `count` queries, random and on borders, shape (count, D).

    A third uniform over a box half as large again as the set's; the rest in equal parts close to points,
    exactly on points, on cell borders and next to them by one rounding, on the borders of the valid region, and
    far outside, up to 1e300.
    """
    rng = np.random.default_rng(20240117)
    z = np.asarray(training_set.z, dtype=float)
    edges = np.array(training_set.grid.edges)
    low, high = z.min(axis=0), z.max(axis=0)
    middle, half = 0.5 * (low + high), 0.75 * (high - low) + edges
    part = max(1, count // 7)

    def uniform(number: int) -> np.ndarray:
        drawn: np.ndarray = middle + half * rng.uniform(-1.0, 1.0, (number, z.shape[1]))
        return drawn

    def some_points(number: int) -> np.ndarray:
        return z[rng.integers(0, len(z), number)]

    close = some_points(part) + rng.normal(0.0, 0.3, (part, z.shape[1])) * edges
    border = np.round(some_points(part) / edges) * edges
    toward = rng.integers(-1, 2, border.shape)
    border = np.where(toward == 0, border, np.nextafter(border, np.where(toward < 0, -np.inf, np.inf)))
    lower = np.where(np.isfinite(training_set.grid.lower), training_set.grid.lower, low)
    upper = np.where(np.isfinite(training_set.grid.upper), training_set.grid.upper, high)
    limit = some_points(part)
    chosen = rng.integers(0, z.shape[1], part)
    limit[np.arange(part), chosen] = np.where(rng.random(part) < 0.5, lower[chosen], upper[chosen])
    far = uniform(part)
    far[np.arange(part), rng.integers(0, z.shape[1], part)] *= 10.0 ** rng.uniform(0.0, 4.0, part)
    huge = min(part, 16)
    far[:huge] = rng.choice([-1.0, 1.0], (huge, z.shape[1])) * 10.0 ** np.linspace(5.0, 300.0, huge)[:, None]
    sets = [some_points(part), close, border, limit, far]
    sets.append(uniform(max(0, count - sum(map(len, sets)))))
    return np.concatenate(sets)[:count]


def reference_of(predictor: Predictor) -> Reference:
    """Return what evaluates a predictor otherwise than its export does."""
    inner = untrusted(predictor)
    if isinstance(inner, TablePredictor):
        return SplineReference(inner)
    if isinstance(inner, ProjectedPredictor):
        return ProcessReference(inner)
    return CommitteeReference(inner.training_set, robust=inner.name == "rbcm")


def make_oracle(predictor: Predictor, count: int, real: str = "double") -> Oracle:
    """Answer the queries in Python, and make sure that the predictor gives the same answers.

    Queries are rounded to `real` first, since that is what the export will be asked.

    Raises
    ------
    ExportError
        If the predictor and the reference disagree by more than the tolerance in double.
    """
    z = check_queries(predictor.training_set, count)
    if real == "float":
        with np.errstate(over="ignore"):
            z = z.astype(np.float32).astype(float)
    reference = reference_of(predictor)
    expected = reference.predict(z)
    finite = np.isfinite(z).all(axis=1) & (np.abs(z) < 1e100).all(axis=1)
    answered = predictor.predict(z[finite])
    kernel = predictor.training_set.kernel
    error = max(
        float(np.max(np.abs(answered.mean - expected.mean[finite]) / reference.deviation, initial=0.0)),
        float(np.max(np.abs(answered.variance - expected.variance[finite]) / kernel.signal_variance, initial=0.0)),
    )
    if not error <= reference.rounding:
        raise ExportError(
            f"the predictor {predictor.name} is {error:.3g} off its reference, {reference.rounding:g} is allowed",
            advice="The noise variance may be too small for points this close; `split verify` the set.",
        )
    rng = np.random.default_rng(7)
    # Far away, a step of a fraction of a length scale is lost in the rounding of z.
    moderate = np.flatnonzero((np.abs(z) < 1e3 * np.abs(predictor.training_set.z).max(axis=0) + 1.0).all(axis=1))
    chosen = np.sort(rng.choice(moderate, min(JACOBIAN_QUERIES, len(moderate)), replace=False))
    slopes = reference.jacobian_by_differences(z[chosen])
    return Oracle(z, expected.mean, expected.variance, z[chosen], slopes, error, reference)


def check_predictions(answer: ExportAnswer, oracle: Oracle, real: str, what: str) -> PredictionCheck:
    """Compare an exported predictor with Python.

    Parameters
    ----------
    real : {"double", "float"}
    what : str
        Named in the error.

    Raises
    ------
    ExportError
        If any answer is further off than the tolerance, or queries that are not finite are not answered as
        documented.
    """
    tolerance = oracle.reference.accuracy if real == "double" else TOLERANCE[real]
    mean, variance = answer.predict(oracle.z)
    deviation = oracle.reference.deviation
    mean_error = _worst(mean, oracle.mean, deviation, oracle.z, tolerance, real, f"{what}: mean")
    variance_error = _worst(variance, oracle.variance, deviation**2, oracle.z, tolerance, real, f"{what}: variance")
    jacobian_error = None
    if answer.jacobian is not None:
        slopes = answer.jacobian(oracle.slope_z)
        scale = oracle.reference.jacobian_scale()
        jacobian_error = _worst(
            slopes, oracle.slopes, scale, oracle.slope_z, JACOBIAN_TOLERANCE[real], real, f"{what}: Jacobian"
        )
    _check_not_finite(answer, oracle, what)
    return PredictionCheck(len(oracle.z), tolerance, mean_error, variance_error, jacobian_error)


_ADVICE = {
    "double": "The compiler, its flags or the tables are at fault.",
    "float": "Single precision cannot hold this set (long length scales, little noise); export it in double.",
}


def _worst(
    found: np.ndarray, expected: np.ndarray, scale: np.ndarray, z: np.ndarray, tolerance: float, real: str, what: str
) -> float:
    """Return the largest scaled error; raise when it, or anything that is not a number, exceeds the tolerance."""
    error = np.abs(found - expected) / scale
    error = np.where(np.isnan(error), np.inf, error).reshape(len(z), -1).max(axis=1)
    worst = int(np.argmax(error))
    if not error[worst] <= tolerance:
        query = ", ".join(f"{value:.6g}" for value in z[worst])
        raise ExportError(
            f"{what} is {error[worst]:.3g} off Python where {tolerance:g} is allowed, at z = [{query}] "
            f"({int((error > tolerance).sum())} of {len(z)} queries fail); nothing was written",
            advice=_ADVICE[real],
        )
    return float(error[worst])


def _check_not_finite(answer: ExportAnswer, oracle: Oracle, what: str) -> None:
    """Not-a-number gives not-a-number, infinity the prior."""
    width = oracle.z.shape[1]
    typical = oracle.reference.training_set.z[:1]
    spoiled = np.repeat(typical, 3 * width, axis=0)
    for feature in range(width):
        spoiled[3 * feature : 3 * feature + 3, feature] = (np.nan, np.inf, -np.inf)
    mean, variance = answer.predict(spoiled)
    trust, signal = oracle.reference.training_set.trust, oracle.reference.training_set.kernel.signal_variance
    prior = trust.apply(np.zeros(3), signal, signal)[1]
    is_nan = np.isnan(spoiled).any(axis=1)
    good = np.isnan(mean[is_nan]).all() and np.isnan(variance[is_nan]).all()
    good &= (mean[~is_nan] == 0.0).all() and np.allclose(variance[~is_nan], prior, rtol=1e-6, atol=0.0)
    if not good:
        raise ExportError(
            f"{what}: queries that are not finite get other answers than documented; nothing was written",
            advice=OUR_FAULT,
        )
