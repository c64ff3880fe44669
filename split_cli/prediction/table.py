"""The process `projected` as a table: a tricubic B-spline of mean and deviation, the same time at any size."""

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from split_cli.errors import SetError
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.factorization import queries
from split_cli.prediction.online_process import SLOPE_GAIN, ProcessState
from split_cli.prediction.predictor import Prediction, Predictor
from split_cli.prediction.projected import process_of
from split_cli.prediction.spline import Lattice, fit_spline, lattice_over, smooth_step

#: Largest error of the mean that the spacing may cause, in signal deviations. An error e beside a prediction
#: error E raises the root mean square by e^2/(2 E^2): 2 % at e = 0.2 E. Label noise of a tenth of the signal makes
#: E at least 0.1; this is a quarter of 0.02.
DEFAULT_BOUND = 5e-3
#: Largest error e of the deviation, as a share of the prior's. Beside label noise of n signal deviations the
#: interval of a label is wrong by a share of at most e/(2 n): 4 % at a quarter, which moves 95 % by 0.9 points.
DEVIATION_BOUND = 0.02
_FIRST_NODES = 2.0  # nodes a length scale to begin with
_MOST_NODES = 3_000_000
#: Length scales from the nearest point between which a node fades to the prior, which the process nearly is then.
#: No query of `_measure` meets the fade: it changes faster than the process and would ask for a finer spacing.
_NEAR, _FAR = 2.0, 3.0
_TRIED = 1000
_CHUNK = 2048  # nodes asked at once [1]; judgement: it decides memory and no result


@dataclass(frozen=True)
class TableError:
    """What the spline gives away, measured against the process it was filled from."""

    bound: float  # asked for: largest error of the mean, in signal deviations
    mean: float  # largest error of the mean found, in signal deviations
    deviation: float  # the same of the standard deviation
    queries: int  # places tried: random ones, each coordinate within half a length scale of a point

    @property
    def met(self) -> bool:
        """Whether the bounds hold on what was tried."""
        return self.mean <= self.bound and self.deviation <= DEVIATION_BOUND


class TablePredictor(Predictor):
    """Mean and deviation of `projected`, read from a spline; needs three features.

    Parameters
    ----------
    bound : float
        Error of the mean, in signal deviations, from which the spacing of the nodes is found; at least 1e-3, since
        coefficients are rounded to 16 bits.

    Attributes
    ----------
    spline : Spline
        Of mean (three outputs) and of 1 - deviation/prior deviation (three outputs).
    least : ndarray, shape (3,)
        Smallest deviation the table answers, as a share of the prior's: the smallest at any node, and at least
        what coefficients of 16 bits resolve.

    Notes
    -----
    Nodes lie `nodes a length scale` apart. The mean is a sum of squared exponentials, for which the interpolation
    error falls with the fourth power of the spacing: the spacing is refined by that law until the error measured
    at random places between the nodes stays below the bound. Far from any point mean and deviation return to the
    prior smoothly; the coefficients are 0 there, and need not be stored.
    """

    name: str = "table"

    def __init__(self, training_set: TrainingSet, bound: float = DEFAULT_BOUND) -> None:
        super().__init__(training_set)
        width = len(training_set.features.names)
        if width != 3:
            advice = "Use projected, or train with z2."
            raise SetError(f"a table needs three features, the set has {width}", advice=advice)
        if not 1e-3 <= bound < 1.0:
            raise ValueError(f"bound is {bound!r}, it must lie between 0.001 and 1")
        self.bound = bound
        self._build()

    @property
    def nbytes(self) -> int:
        """Memory of the coefficients [bytes]."""
        return self.spline.coefficients.nbytes

    def predict(self, z: np.ndarray) -> Prediction:
        """Return mean and latent variance at queries `z`, shape (N, 3)."""
        value = self.spline.value(queries(z, self.training_set))
        left = np.minimum(np.maximum(1.0 - value[:, 3:], self.least), 1.0)
        return Prediction(value[:, :3], self.training_set.kernel.signal_variance * left**2)

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Return the mean's Jacobian at queries `z`, shape (N, 3, 3); exact and continuous."""
        return self.spline.value_and_slope(queries(z, self.training_set))[1][:, :3]

    def _build(self) -> None:
        s, scales = self.training_set, self.training_set.kernel.length_scales
        if not s.size:
            lattice = Lattice(scales / _FIRST_NODES, np.zeros(3, dtype=np.int64), (1, 1, 1))
            self.error = TableError(self.bound, 0.0, 0.0, 0)
            self.spline, self.least = fit_spline(lattice, np.zeros((1, 6))).in_integers(), np.ones(3)
            return
        process = process_of(s, threshold=SLOPE_GAIN).known()
        lower, upper = s.z.min(axis=0) - _FAR * scales, s.z.max(axis=0) + _FAR * scales
        nodes = _FIRST_NODES
        while True:
            lattice = lattice_over(lower, upper, scales / nodes)
            values = self._values(process, lattice.nodes())
            self.spline = fit_spline(lattice, values).in_integers()
            self.least = np.maximum(1.0 - values[:, 3:].max(axis=0), self.spline.unit[3:])
            self.error = error = self._measure(process)
            # The fourth-order law, a twentieth on top since it is the largest of many errors that must fall.
            over = max(error.mean / self.bound, error.deviation / DEVIATION_BOUND)
            finer = nodes * min(1.6, 1.05 * over**0.25)
            if error.met or lattice.size * (finer / nodes) ** 3 > _MOST_NODES:
                return
            nodes = finer

    def _values(self, process: ProcessState, places: np.ndarray) -> np.ndarray:
        """Return mean and known share at the nodes, shape (N, 6), faded to the prior far from points."""
        s, scales = self.training_set, self.training_set.kernel.length_scales
        nearest, _ = cKDTree(s.z / scales).query(places / scales, distance_upper_bound=_FAR)
        fade = smooth_step((_FAR - nearest) / (_FAR - _NEAR))
        used = np.flatnonzero(fade > 0.0)
        values = np.zeros((len(places), 6))
        for some in np.array_split(used, len(used) // _CHUNK + 1):
            mean, left = process.mean_and_open_share(places[some] / scales)
            values[some] = fade[some, None] * np.column_stack([mean, 1.0 - np.sqrt(left)])
        return values

    def _measure(self, process: ProcessState) -> TableError:
        """Compare the spline with the process at random places near points."""
        s = self.training_set
        rng = np.random.default_rng(20240117)
        z = s.z[rng.integers(0, s.size, _TRIED)]
        z = z + rng.uniform(-0.5, 0.5, z.shape) * s.kernel.length_scales
        mean, left = process.mean_and_open_share(z / s.kernel.length_scales)
        found = self.spline.value(z)
        mean_error = np.abs(found[:, :3] - mean) / np.sqrt(s.kernel.signal_variance)
        deviation_error = np.abs(found[:, 3:] - (1.0 - np.sqrt(left)))
        return TableError(self.bound, float(mean_error.max()), float(deviation_error.max()), len(z))
