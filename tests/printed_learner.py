"""The paper's update of a cell as printed: one inversion a point, M an update. The slow reference of others."""

from dataclasses import dataclass, field

import numpy as np

from split_cli.learning.kernel import correlation


@dataclass
class PrintedCell:
    """Points of one cell in slot order: their sample numbers, features and marginal gains."""

    samples: list[int] = field(default_factory=list)
    z: list[np.ndarray] = field(default_factory=list)
    gamma: list[float] = field(default_factory=list)
    clock: list[float] = field(default_factory=list)


class PrintedLearner:
    """Learn samples one by one, as the SPLIT paper prints it.

    Parameters
    ----------
    length_scales : ndarray, shape (D,)
    forgetting : float, optional
        Time constant [s] of weighing gains down with age; the paper has none.
    """

    def __init__(
        self, length_scales: np.ndarray, capacity: int, threshold: float, forgetting: float | None = None
    ) -> None:
        self.length_scales = np.asarray(length_scales, dtype=float)
        self.capacity, self.threshold, self.forgetting = capacity, threshold, forgetting
        self.cells: dict[int, PrintedCell] = {}
        self.updates = 0

    def offer(self, sample: int, cell_number: int, z: np.ndarray, clock: float = 0.0) -> None:
        """Offer one sample, features `z` (D,), to its cell."""
        cell = self.cells.setdefault(cell_number, PrintedCell())
        gain = self._gain(z, cell.z)
        weighted = [gamma * self._weight(clock - then) for gamma, then in zip(cell.gamma, cell.clock, strict=True)]
        room = len(cell.z) < self.capacity
        if room and gain > self.threshold:
            slot = len(cell.z)
        elif weighted and (not room or self.forgetting) and gain > min(weighted):
            slot = weighted.index(min(weighted))
        else:
            return
        there = slice(slot, slot + 1)
        cell.samples[there], cell.z[there], cell.clock[there] = [sample], [z], [clock]
        cell.gamma = [self._gain(cell.z[i], cell.z[:i] + cell.z[i + 1 :]) for i in range(len(cell.z))]
        self.updates += 1

    def _gain(self, z: np.ndarray, others: list[np.ndarray]) -> float:
        """Return gamma = k(z, z) - k^T K^-1 k: SPLIT paper, the independence measurement."""
        if not others:
            return 1.0
        points = np.array(others)
        k = correlation(points, z[None], self.length_scales)[:, 0]
        return float(1.0 - k @ np.linalg.inv(correlation(points, points, self.length_scales)) @ k)

    def _weight(self, age: float) -> float:
        return 1.0 if self.forgetting is None else float(np.exp(-0.5 * (age / self.forgetting) ** 2))
