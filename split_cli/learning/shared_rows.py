"""Rows of a drive that a set has learned before, whatever the files are called."""

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.logs.scratch import PIECE

_LEAST_SHARE = 0.01
"""Share of a source's points that are rows of a drive, from which on they have rows in common [1]; judgement:
coarse signals of two drives agree in a few rows by chance."""


def shared_sources(trained: TrainingSet, z: np.ndarray, row: np.ndarray | None = None) -> dict[int, float]:
    """Return which drives of a set share rows with a drive, and how many of their points are rows of it.

    Parameters
    ----------
    z : ndarray, shape (N, D)
        Features of rows of the drive, by the set's vehicle.
    row : ndarray of int, shape (N,), optional
        Which rows these are; all from the first on if None.

    Returns
    -------
    dict of int to float
        For an index of `TrainingSet.sources`, the share of its points that are found [1].

    Notes
    -----
    Equal are rows whose features are equal to the bit. Rounded signals do that by chance, too. So a point counts
    only if the source's point before or behind it is found as many rows away: a copy, a cut or a longer recording
    of the same driving shifts all rows alike. A recording that was brought to another rate is not found.
    """
    known = _keys(trained.z)
    wanted = np.unique(known)
    keys, rows = [], []
    for first in range(0, len(z), PIECE):
        own = _keys(z[first : first + PIECE])
        hit = np.flatnonzero(np.isin(own, wanted))
        keys.append(own[hit])
        rows.append(first + hit)
    if not sum(map(len, rows)):
        return {}
    met, where = np.unique(np.concatenate(keys), return_index=True)
    place = np.concatenate(rows)[where]
    place = place if row is None else row[place]
    at = np.minimum(np.searchsorted(met, known), len(met) - 1)
    found, shift = met[at] == known, trained.row - place[at]
    order = np.lexsort((trained.row, trained.source))
    one, two = order[:-1], order[1:]
    alike = found[one] & found[two] & (shift[one] == shift[two])
    alike &= trained.source[one] == trained.source[two]
    shared = np.zeros(len(known), dtype=bool)
    shared[one[alike]] = shared[two[alike]] = True
    points = np.bincount(trained.source, minlength=len(trained.sources))
    share = np.bincount(trained.source[shared], minlength=len(points)) / np.maximum(points, 1)
    return {int(n): float(share[n]) for n in np.flatnonzero(share >= _LEAST_SHARE)}


def _keys(z: np.ndarray) -> np.ndarray:
    """Return a number for each row of features, the same for the same bits, shape (N,)."""
    bits = np.ascontiguousarray(z, dtype=float).view(np.uint64)
    key = np.zeros(len(z), dtype=np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key
