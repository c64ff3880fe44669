"""Sums over all labels of a cell, those that it did not keep as well: how a set's file holds them."""

import base64
from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np
import pyarrow as pa

from split_cli.learning.kernel import Kernel
from split_cli.learning.set_limits import LARGEST_LABEL

SUMS = ("information", "absorbed")
"""Of a `TrainingSet`, and beside the columns of each cell's batch: little-endian doubles, in base64."""
#: Error of a sum of squares over its largest direction that is no forgery [1]. Judgement: a cell hands over thousands
#: of points, and each may leave some units of the last digit, 2e-16.
_ROUNDING = 1e-9


def sums_by_cell(
    information: np.ndarray | None, absorbed: np.ndarray | None, offsets: np.ndarray
) -> list[dict[bytes, bytes]]:
    """Return what the batch of each cell carries beside its columns; nothing where the set absorbs no label.

    Parameters
    ----------
    information, absorbed, offsets : ndarray
        As of a `TrainingSet`.
    """
    if information is None or absorbed is None:
        return []
    ends = np.concatenate([[0], np.cumsum(np.square(np.diff(offsets)))]).tolist()
    parts = zip(
        (information[first:last] for first, last in pairwise(ends)),
        (absorbed[first:last] for first, last in pairwise(offsets.tolist())),
        strict=True,
    )
    return [
        {name.encode(): base64.b64encode(one.astype("<f8").tobytes()) for name, one in zip(SUMS, cell, strict=True)}
        for cell in parts
    ]


def read_sums(reader: pa.ipc.RecordBatchFileReader, lengths: Sequence[int]) -> dict[str, np.ndarray]:
    """Return `information` and `absorbed` from a file whose batches are cells of `lengths` points each.

    Raises
    ------
    ValueError
        Where a batch lacks them, or they are not of its size.
    """
    found: dict[str, list[np.ndarray]] = {"information": [np.zeros(0)], "absorbed": [np.zeros((0, 3))]}
    for index, n in enumerate(lengths):
        beside = reader.get_batch_with_custom_metadata(index).custom_metadata
        if beside is None or any(name.encode() not in beside for name in SUMS):
            raise ValueError("a batch lacks its sums over labels")
        for name, shape in zip(SUMS, ((n * n,), (n, 3)), strict=True):
            content = base64.b64decode(beside[name.encode()], validate=True)
            found[name].append(np.frombuffer(content, dtype="<f8").reshape(shape))
    return {name: np.concatenate(parts) for name, parts in found.items()}


def check_sums(kernel: Kernel, points: Mapping[str, np.ndarray], offsets: np.ndarray, accepted: int) -> None:
    """Refuse sums that no labels have; nothing is checked where there are none.

    Parameters
    ----------
    points : mapping of str to ndarray
        ``z``, ``y`` and `SUMS`, these and `offsets` as of a `TrainingSet`.
    accepted : int
        Labels that all drives of the set say were inside the valid region.

    Raises
    ------
    ValueError
        Says what does not hold.

    Notes
    -----
    A kept point's own label has a one in e and nothing else, whatever is projected later. So what the other labels
    add, R = A - 1 to the sums of squares and b = B - y to those of e y, are sums as well: R is symmetric, and no
    direction of it is negative. A label at z has e.K e = k.K^-1 k <= 1, and projecting it on other points only
    takes from that: the traces of K R add up to at most the number N of other labels. Along a unit vector u that
    R takes to lambda u, (u.b)^2 <= lambda N y^2 by Cauchy and Schwarz, with the largest y that a label may have.
    """
    if SUMS[0] not in points:
        return
    z, y, information, absorbed = (points[name] for name in ("z", "y", *SUMS))
    if not (np.isfinite(information).all() and np.isfinite(absorbed).all()):
        raise ValueError("its sums over labels hold numbers that are not finite")
    others = accepted - len(z)
    if others < 0:
        raise ValueError(f"it holds {len(z)} points of {accepted} labels that were accepted")
    counts, behind, wrong = np.diff(offsets), 0.0, 0
    begins = np.cumsum(counts**2) - counts**2
    with np.errstate(over="ignore", invalid="ignore"):  # forged: what is not finite then is wrong
        for n in np.unique(counts).tolist():
            rows = offsets[:-1][counts == n, None] + np.arange(n)
            rest = information[begins[counts == n, None] + np.arange(n * n)].reshape(-1, n, n) - np.eye(n)
            values, vectors = np.linalg.eigh(rest)
            rounding = _ROUNDING * (rest.any(axis=(1, 2)) + np.abs(values).max(axis=1))[:, None]
            along = vectors.transpose(0, 2, 1) @ (absorbed[rows] - y[rows])
            most = LARGEST_LABEL * np.sqrt((np.maximum(values, 0.0) + rounding) * others)
            whole = (rest == rest.transpose(0, 2, 1)).all(axis=(1, 2)) & (values >= -rounding).all(axis=1)
            wrong += int((~(whole & (np.abs(along) <= most[:, :, None]).all(axis=(1, 2)))).sum())
            # Of e.K e, rounding in K leaves as much as of the gains, see `wrong_gains`.
            behind += float((kernel.correlation(z[rows], z[rows]) * rest).sum())
            behind -= 4 * n * float(np.finfo(float).eps * np.abs(values).sum())
    if wrong:
        raise ValueError(f"the sums over labels of {wrong} of {len(counts)} cells are not those of any labels")
    if behind > others * (1.0 + _ROUNDING):
        raise ValueError(f"its sums are over {behind:.6g} labels beside its points, it says {others} were accepted")
