"""Sums over all labels of a cell, those that it did not keep as well: how a set's file holds them."""

import base64
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import pyarrow as pa

SUMS = ("information", "absorbed")
"""Of a `TrainingSet`, and beside the columns of each cell's batch: little-endian doubles, in base64."""


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
