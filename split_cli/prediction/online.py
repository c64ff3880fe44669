"""The committee kept up to date while the set grows: an update decomposes its own cell and no other."""

from collections.abc import Callable

import numpy as np

from split_cli.learning.online import OnlineSet
from split_cli.prediction._online_numba import committee, decompose


class OnlineCommittee:
    """Tresp's committee over the cells of an `OnlineSet`.

    Parameters
    ----------
    neglect : float
        Cells farther than the distance at which a kernel entry is `neglect` are skipped. 1e-6 of a label is far
        below its noise; `BcmPredictor` bounds the sum rigorously, at several times the cost.

    Notes
    -----
    SPLIT paper, the BCM prediction, in the form of `BcmPredictor`, whose answers it gives to within `neglect`. The
    paper reuses the cells' matrices as well.
    """

    count: np.ndarray
    points: np.ndarray
    turned: np.ndarray
    gains: np.ndarray
    vectors: np.ndarray
    lower: np.ndarray
    upper: np.ndarray

    def __init__(self, online: OnlineSet, neglect: float = 1e-6) -> None:
        self.online = online
        header = online.header
        self.kernel = header.kernel
        self.width, self.capacity = len(header.features.names), header.capacity
        self.scales = np.ascontiguousarray(self.kernel.length_scales, dtype=float)
        self.ratio = np.ascontiguousarray(self.kernel.noise_variance / self.kernel.signal_variance)
        self.reach = -2.0 * float(np.log(neglect))
        self.cells = 0
        self.beyond: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None
        self._allocate(256)
        self.update(tuple(range(online.cell_count)))

    def _allocate(self, room: int) -> None:
        M, D = self.capacity, self.width
        shapes: dict[str, tuple[int, ...]] = {
            "count": (),
            "points": (M, D),
            "turned": (M, 3),
            "gains": (M, 3),
            "vectors": (M, M),
            "lower": (D,),
            "upper": (D,),
        }
        for name, shape in shapes.items():
            kind = np.int64 if name == "count" else float
            grown = np.zeros((room, *shape), dtype=kind)
            if self.cells:
                grown[: self.cells] = getattr(self, name)[: self.cells]
            setattr(self, name, grown)

    def rest_on(self, beyond: Callable[[np.ndarray, np.ndarray], np.ndarray] | None) -> None:
        """Predict `beyond`(z, y), shape (n, 3), instead of the labels y: what they say beyond a prior mean."""
        self.beyond = beyond
        self.update(tuple(range(self.cells)))

    def update(self, positions: tuple[int, ...]) -> None:
        """Decompose the cells at `positions` anew."""
        if not positions:
            return
        needed = max(positions) + 1
        if needed > len(self.count):
            self._allocate(max(needed, 2 * len(self.count)))
        self.cells = max(self.cells, needed)
        for position in positions:
            z, y = self.online.cell(position)
            if self.beyond is not None:
                y = np.ascontiguousarray(self.beyond(z, y))
            self.count[position] = len(z)
            decompose(
                position,
                z,
                y,
                self.scales,
                self.ratio,
                self.points,
                self.turned,
                self.gains,
                self.vectors,
                self.lower,
                self.upper,
            )

    def along(self, z: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return mean (N, 3), latent variance (N, 3) and the mean's Jacobian (N, 3, D) at `z`, shape (N, D)."""
        scales = self.kernel.length_scales
        mean, spread, slope = committee(
            np.ascontiguousarray((z / scales).T),
            self.count,
            self.cells,
            self.points,
            self.turned,
            self.gains,
            self.vectors,
            self.lower,
            self.upper,
            self.ratio,
            self.reach,
        )
        return mean.T, spread.T * self.kernel.signal_variance, slope.transpose(2, 0, 1) / scales
