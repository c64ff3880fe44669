"""The projected process as numbers to export: points, weights and triangles, without what it learned them from."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.prediction.online_process import open_share
from split_cli.prediction.projected import ProjectedPredictor

#: The arrays of `ProjectionData` that documents hold beside the set's.
PROJECTION_ARRAYS = ("reference", "points", "weights", "whitening", "spread", "absent", "gain_limit")


@dataclass(frozen=True)
class ProjectionData:
    """Constants of the projected process on U points; a query takes the same time everywhere.

    Notes
    -----
    With c the correlations of a query with the points, t = L^T c and gain = 1 - t.t: mean = c.w, and the variance
    is S0 (gain + t.S t - absent min(gain, limit) (1 - gain)), see `OnlineProcess`. Its matrices Q and T give
    S = L^-1 (Q + T) L^-T. In this form nothing cancels: t is at most 1 long and S lies between 0 and 1, where
    c.Q c takes a difference of large numbers.
    """

    real: str  # {"double", "float"} Precision the numbers are rounded to (they are stored as float64 all the same)
    length_scales: np.ndarray  # (D,)
    signal_variance: np.ndarray  # (3,): S0
    trust: np.ndarray  # (3,): tau, the share of the correction that is applied
    doubt: np.ndarray  # (3,): w, the variance of what is not trusted
    reference: np.ndarray  # (D,): the middle of the points, in feature units; exactly representable in `real`
    points: np.ndarray  # (U, D): relative to the reference, divided by the length scales
    weights: np.ndarray  # (U, 3)
    # (U (U + 1)/2,): lower triangle of L, row by row, L L^T the inverse of the points' correlations.
    whitening: np.ndarray
    # (3, U (U + 1)/2): lower triangle of S, what data have left open along the points, with twice its entries off
    # the diagonal.
    spread: np.ndarray
    absent: np.ndarray  # (3,): share of what points do not span that no label shows
    gain_limit: np.ndarray  # (1,): gain from which a label's place became a point

    @property
    def feature_count(self) -> int:
        """D."""
        return len(self.length_scales)

    def digest(self) -> str:
        """Return the SHA-256 of every number."""
        names = ("length_scales", "signal_variance", "trust", "doubt", *PROJECTION_ARRAYS)
        return digest_of(self.real, (getattr(self, name) for name in names))


def digest_of(what: str, arrays: Iterable[np.ndarray]) -> str:
    """Return the SHA-256 of arrays, number by number, after a word that tells what they are."""
    digest = hashlib.sha256(what.encode())
    for array in arrays:
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()


def projection_data(predictor: ProjectedPredictor, real: str = "double") -> ProjectionData:
    """Return the constants of the predictor `projected`, rounded to `real`."""
    precision = np.float32 if real == "float" else np.float64
    kernel, trust = predictor.training_set.kernel, predictor.training_set.trust
    known = predictor.process.known()
    places = known.points * kernel.length_scales
    reference = (0.5 * (places.min(axis=0) + places.max(axis=0))).astype(precision).astype(float)
    lower, spread = known.whitened
    rows, columns = np.tril_indices(len(lower))
    reals = {
        "length_scales": kernel.length_scales,
        "signal_variance": kernel.signal_variance,
        "trust": trust.array,
        "doubt": trust.doubts(kernel.signal_variance),
        "reference": reference,
        "points": known.points - reference / kernel.length_scales,
        "weights": known.weights.T,
        "whitening": lower[rows, columns],
        "spread": spread[:, rows, columns] * np.where(rows == columns, 1.0, 2.0),
        "absent": known.absent,
        "gain_limit": np.array([known.threshold]),
    }
    rounded = {name: np.asarray(value).astype(precision).astype(float) for name, value in reals.items()}
    return ProjectionData(real=real, **rounded)


def answer_of(a: Mapping[str, np.ndarray], z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return mean and latent variance of `ProjectionData` at `z`, shape (N, 3) each, before any trust.

    Parameters
    ----------
    a : mapping of str to ndarray
        `PROJECTION_ARRAYS`, the length scales and the signal variance.
    z : ndarray, shape (N, D)
    """
    count = len(a["points"])
    rows, columns = np.tril_indices(count)
    lower, left = np.zeros((count, count)), np.zeros((3, count, count))
    lower[rows, columns], left[:, rows, columns] = a["whitening"], a["spread"]
    # An infinite distance is a correlation of zero; a query of 1e300 has one.
    with np.errstate(over="ignore", under="ignore"):
        scaled = (z - a["reference"]) / a["length_scales"]
        away = np.zeros((len(z), count))
        for feature in range(z.shape[1]):
            away += (scaled[:, feature, None] - a["points"][:, feature]) ** 2
        c = np.exp(-0.5 * away)
    return c @ a["weights"], a["signal_variance"] * open_share(c, lower, left, a["absent"], a["gain_limit"])
