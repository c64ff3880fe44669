"""Driving that was learned before, whatever its file is called and whatever rate it was brought to."""

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.scratch import in_pieces, selected

_LEAST_SHARE = 0.01
"""Share of a source's points that are rows of a drive, from which on they have rows in common [1]; judgement:
coarse signals of two drives agree in a few rows by chance."""
_SAME_TIME = 1e-3
"""Times that are one [s]; judgement: above the rounding of stamps, below the samples of a drive (0.01 s)."""
_PARTS = 10
"""Equal parts of a drive, each of which shares rows with another drive that holds it all [1]; judgement."""
_MOST_ROWS = 2**18
"""Rows of earlier drives that are remembered [1]: 5 MB; judgement."""


def shared_sources(trained: TrainingSet, z: np.ndarray, t: np.ndarray) -> dict[int, float]:
    """Return which drives of a set share rows with a drive, and how many of their points are rows of it.

    Parameters
    ----------
    z : ndarray, shape (N, D)
        Features of rows of the drive, by the set's vehicle.
    t : ndarray, shape (N,)
        Times of these rows, ascending [s].

    Returns
    -------
    dict of int to float
        For an index of `TrainingSet.sources`, the share of its points that are found [1].

    Notes
    -----
    Equal are rows whose features are equal in single precision: interpolation to another rate leaves the rows at
    common moments equal but for its rounding. Rounded signals are equal by chance, too. So a row counts only if
    the one found before or behind it is as much earlier or later in both: a copy, a cut or a longer recording of
    the same driving shifts all rows alike. A recording that was filtered is not found.
    """
    keys = _keys(trained.z)
    order = np.argsort(keys, kind="stable")
    known, _ = _alike(keys[order], trained.t[order], trained.source[order], z, t)
    shared = np.zeros(len(keys), dtype=bool)
    shared[order[known]] = True
    points = np.bincount(trained.source, minlength=len(trained.sources))
    share = np.bincount(trained.source[shared], minlength=len(points)) / np.maximum(points, 1)
    return {int(n): float(share[n]) for n in np.flatnonzero(share >= _LEAST_SHARE)}


class EarlierDrives:
    """Accepted rows of the drives of one training: tells a drive that an earlier one holds as a whole.

    Of many rows every second one is forgotten, again and again, by what it is and not by where it stands: the same
    rows of two drives stay.
    """

    def __init__(self) -> None:
        self._names: list[str] = []
        self._keys, self._t = np.empty(0, dtype=np.uint64), np.empty(0)
        self._source = np.empty(0, dtype=np.int32)
        self._kept = np.uint64(0)  # bits of a key that are zero in each row that is kept

    def holding(self, labels: Labels) -> str | None:
        """Return the name of an earlier drive with rows of each part of this one, or None, and remember this.

        Rows that are not learned do not count: at rest they are all alike. A part without others asks for none.
        """
        z, t = selected(labels.z, labels.accepted), labels.t[labels.accepted]
        known, rows = _alike(self._keys, self._t, self._source, z, t)
        part = np.clip((t - labels.start_time) * (_PARTS / max(labels.duration, 1e-9)), 0, _PARTS - 1).astype(int)
        met = np.zeros((len(self._names), _PARTS), dtype=bool)
        met[self._source[known], part[rows]] = True
        whole = np.flatnonzero(met[:, np.unique(part)].all(axis=1))
        if len(part) and len(whole):
            return self._names[int(whole[0])]
        self._remember(z, t)
        self._names.append(labels.drive)
        return None

    def _remember(self, z: np.ndarray, t: np.ndarray) -> None:
        for piece in in_pieces(len(z)):
            keys = _keys(z[piece])
            source = np.full(len(keys), len(self._names), dtype=np.int32)
            parts = (self._keys, keys), (self._t, t[piece]), (self._source, source)
            keys, times, source = (np.concatenate(part) for part in parts)
            while np.count_nonzero(kept := keys & self._kept == 0) > _MOST_ROWS:
                self._kept = self._kept << np.uint64(1) | np.uint64(1)
            order = np.flatnonzero(kept)[np.argsort(keys[kept], kind="stable")]
            self._keys, self._t, self._source = keys[order], times[order], source[order]


def _alike(
    keys: np.ndarray, t: np.ndarray, source: np.ndarray, z: np.ndarray, own_t: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return places among known rows, whose keys ascend, and rows of a drive: pairs that are one and the same."""
    places, rows = [np.empty(0, dtype=np.int64)], [np.empty(0, dtype=np.int64)]
    for piece in in_pieces(len(z) if len(keys) else 0):
        own = _keys(z[piece])
        at = np.minimum(np.searchsorted(keys, own), len(keys) - 1)
        hit = np.flatnonzero(keys[at] == own)
        places.append(at[hit])
        rows.append(piece.start + hit)
    place, row = np.concatenate(places), np.concatenate(rows)
    same = (np.diff(source[place]) == 0) & (np.abs(np.diff(own_t[row] - t[place])) < _SAME_TIME)
    sure = np.append(same, False) | np.insert(same, 0, False)
    return place[sure[: len(place)]], row[sure[: len(row)]]


def _keys(z: np.ndarray) -> np.ndarray:
    """Return a number for each row of features, the same for the same single-precision bits, shape (N,)."""
    with np.errstate(over="ignore", invalid="ignore"):
        bits = (np.ascontiguousarray(z, dtype=np.float32) + np.float32(0.0)).view(np.uint32).astype(np.uint64)
    key = np.zeros(len(z), dtype=np.uint64)
    for column in bits.T:
        key = (key ^ column) * np.uint64(0x9E3779B97F4A7C15)
        key ^= key >> np.uint64(29)
    return key
