"""The flexible fit: ridge regression of residuals on many smooth functions, to test whether they are noise.

The functions are those of `flexible`. The test decides whether simulation and reality differ at all, and whether named
terms leave a remainder. `minimum_effect_p` is also the test of a single term.
"""

import warnings
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise, products_of, products_over_noise
from split_cli.diagnosis.innovations.evidence import integrated
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.remainder.flexible import FlexiblePiece

_RIDGE_SHARE = 2e-3  # ridge penalty over the number of entries, for columns of unit mean square [1]


@dataclass(frozen=True)
class FlexibleFit:
    """Result of a flexible fit to whitened residuals."""

    saved: float  # reduction of the cost [chi squared]
    freedom: float  # effective number of parameters
    # Largest effect-to-noise ratio over the channels [1].
    effect_to_noise: float
    p_value: float  # of the hypothesis that the effect does not exceed the allowance
    group_saved: tuple[tuple[str, float], ...]  # reduction of the cost by each group of functions alone


@dataclass(frozen=True)
class Structure:
    """The flexible fit, set up on the rows of an objective: whitened columns and their factored normal matrix."""

    objective: MarginalLikelihood
    # (R, c) each, Q columns in all: whitened, by `MarginalLikelihood.whiten` as well.
    blocks: tuple[np.ndarray, ...]
    # (3, Q, Q) for each recording: matrices of the quadratic forms that give the squared effect-to-noise ratios in v_x,
    # v_y and r from the weights [1].
    sizes: tuple[np.ndarray, ...]
    groups: tuple[str, ...]  # group of each column
    factor: np.ndarray  # (Q, Q): upper Cholesky factor of the normal matrix with the ridge
    floor: float = 0.0  # reduction of the cost that is no difference, from the halves of the simulation [chi squared]

    def score(self, residuals: np.ndarray) -> np.ndarray:
        """Return the products of the columns with whitened residuals (R,), shape (Q,)."""
        return np.concatenate([some.T @ residuals for some in self.blocks])

    def weights(self, score: np.ndarray) -> np.ndarray:
        """Return the fitted weights for a score, shape (Q,)."""
        return np.linalg.solve(self.factor, np.linalg.solve(self.factor.T, score))

    def left(self, residuals: np.ndarray) -> np.ndarray:
        """Return whitened residuals (R,) less their flexible fit, shape (R,)."""
        weights, left = self.weights(self.score(residuals)), residuals
        for some, own in zip(self.blocks, _split_like(weights, self.blocks), strict=True):
            left = left - some @ own
        return left

    def fit(self, residuals: np.ndarray, variance_inflation: float) -> FlexibleFit:
        """Fit whitened residuals, shape (R,), whose chi squared autocorrelation widens by `variance_inflation`."""
        score = self.score(residuals)
        weights = self.weights(score)
        saved = float(score @ weights)
        inverse = np.linalg.inv(self.factor)
        freedom = float(len(score) - _RIDGE_SHARE * len(residuals) * np.sum(inverse**2))
        size = max(float(np.sqrt(np.maximum(products @ weights @ weights, 0.0).max())) for products in self.sizes)
        # The part of the size that is fitted noise is removed.
        size *= np.sqrt(max(1.0 - variance_inflation * freedom / max(saved, 1e-9), 0.0))
        return self.judged(FlexibleFit(saved, freedom, float(size), 1.0, self._by_group(score)), variance_inflation)

    def judged(self, fit: FlexibleFit, variance_inflation: float) -> FlexibleFit:
        """Return a fit of these columns with the p value of what is allowed here."""
        allowance, floor = self.objective.policy.allowances.unnamed, self.allowed(fit.freedom)
        p = minimum_effect_p(fit.saved, fit.freedom, fit.effect_to_noise, variance_inflation, floor, allowance)
        return replace(fit, p_value=p)

    def allowed(self, freedom: float) -> float:
        """Return the reduction of the cost that model-form error of the shared discrepancy may cause [chi squared]."""
        if self.objective.posterior is None:
            return 0.0
        policy = self.objective.policy
        form_error = policy.self_test.unnamed_margin * freedom
        form_error += policy.allowances.structure_floor * self.objective.shared_cost
        return max(form_error, self.floor)

    def unnamed_share(self, left: FlexibleFit, named: float, variance_inflation: float) -> float:
        """Return the unexplained share of the gap [1].

        Parameters
        ----------
        left : FlexibleFit
            Of the residuals of an explanation.
        named : float
            Reduction of the cost by the explanation.
        """
        unnamed = max(left.saved - variance_inflation * left.freedom - self.allowed(left.freedom), 0.0)
        return unnamed / max(unnamed + named, 1e-9)

    def _by_group(self, score: np.ndarray) -> tuple[tuple[str, float], ...]:
        out = []
        normal = self.factor.T @ self.factor
        for group in dict.fromkeys(self.groups):
            chosen = np.array([name == group for name in self.groups])
            part = score[chosen]
            out.append((group, float(part @ np.linalg.solve(normal[np.ix_(chosen, chosen)], part))))
        return tuple(sorted(out, key=lambda pair: -pair[1]))


def build_structure(
    objective: MarginalLikelihood, pieces: Sequence[Iterable[FlexiblePiece]], floor: float = 0.0
) -> Structure:
    """Return the flexible fit on an objective's rows, from the functions' rows of every recording.

    Parameters
    ----------
    pieces : sequence of iterable of FlexiblePiece
        Of each recording, the same functions in the same order. They are consumed one at a time to save memory.
    floor : float
        Reduction of the cost that is no difference [chi squared].
    """
    blocks, windows, groups = [], [[] for _ in objective.evidence], []
    for several in zip(*pieces, strict=True):
        some = objective.whiten(objective.stack([one.whitened for one in several]))
        # The ridge keeps sums of nearly collinear columns small. They contain mostly noise of the predicted states, and
        # would look like structure if they fitted it.
        scale = np.sqrt(np.mean(some**2, axis=0)) + 1e-12
        scale = np.where(scale > 1e-9, scale, np.inf)
        blocks.append(some / scale)
        for own, one, mask in zip(windows, several, objective.keep, strict=True):
            own.append(one.windows[mask] / scale)
        groups += [several[0].group] * len(scale)
    penalty = _RIDGE_SHARE * len(objective.weight)
    factor = np.linalg.cholesky(products_of(blocks) + penalty * np.eye(len(groups))).T
    sizes = tuple(products_over_noise(one.series, own) for one, own in zip(objective.evidence, windows, strict=True))
    return Structure(objective, tuple(blocks), sizes, tuple(groups), factor, floor)


def _split_like(values: np.ndarray, blocks: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Return values (Q,) split into parts, one for each block of columns."""
    return np.split(values, np.cumsum([some.shape[1] for some in blocks])[:-1])


def _discrepancy_to_noise(objective: MarginalLikelihood) -> np.ndarray:
    """Return the effect-to-noise ratios of the shared discrepancy in v_x, v_y, r on compared rows, (3,) [1]."""
    if objective.posterior is None:
        return np.zeros(3)
    if "discrepancy to noise" not in objective.memo:
        weights, sizes = objective.posterior.weights, []
        for one, mask in zip(objective.evidence, objective.keep, strict=True):
            shared = objective.discrepancy.rates_with_shared_terms(one.series, weights)
            sizes.append(effects_to_noise(one.series, integrated(one.series, shared, one.linear), one.at[mask]))
        objective.memo["discrepancy to noise"] = np.max(sizes, axis=0)
    return objective.memo["discrepancy to noise"]


def term_allowances(objective: MarginalLikelihood) -> np.ndarray:
    """Return the effect-to-noise ratios in v_x, v_y and r below which a term is not named, shape (3,) [1]."""
    allowances = objective.policy.allowances
    if objective.posterior is None:
        return np.full(3, allowances.unnamed)
    return np.maximum(allowances.term, allowances.discrepancy_share * _discrepancy_to_noise(objective))


def minimum_effect_p(
    saved: float,
    freedom: float,
    size: float,
    variance_inflation: float,
    floor: float = 0.0,
    allowance: float = STANDARD.allowances.term,
) -> float:
    """Return the p value of a saving, if the true effect is as large as the allowance.

    Parameters
    ----------
    saved : float
        Reduction of the cost [chi squared].
    freedom : float
        Effective number of parameters.
    size : float
        Effect-to-noise ratio of the fitted effect.
    floor : float
        Saving that is allowed whatever the size [chi squared].
    allowance : float
        Effect-to-noise ratio that is allowed.

    Notes
    -----
    A test against a minimum effect (Murphy and Myors, 1999): under the null the saved cost over the variance
    inflation is non-central chi squared with the saving that an effect of the allowed size would bring.
    """
    from scipy.stats import ncx2

    if saved <= 0.0 or size <= 0.0:
        return 1.0
    ratio = saved / variance_inflation
    allowed = max(ratio - freedom, 0.0) * min(allowance / size, 1.0) ** 2
    noncentrality = max(allowed, floor / variance_inflation)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", RuntimeWarning)  # the series has not converged: see below
            chance = ncx2.sf(ratio, max(freedom, 1.0), noncentrality)
    except OverflowError:
        chance = np.nan
    if not np.isfinite(chance):  # in the far tails the series overflows
        chance = 1.0 if ratio < freedom + noncentrality else 0.0
    return float(np.clip(chance, 0.0, 1.0))
