"""What several export tests make: the C of a set, and smaller sets."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from split_cli.export.c99 import CSource, c_source
from split_cli.export.provenance import provenance_of
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.single_track import SingleTrack


def source_of(training_set: TrainingSet, real: str = "double", name: str = "car") -> CSource:
    """Return the exported C of a set."""
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    tables = build_tables(training_set, real)
    return c_source(tables, graph, provenance_of(training_set, "bcm"), name, training_set.plain)


def take_cells(training_set: TrainingSet, cells: int, points: int | None = None) -> TrainingSet:
    """Return a set of the first `cells` cells, with at most `points` points in each."""
    rows, offsets = [], [0]
    for cell in range(cells):
        first, last = training_set.offsets[cell : cell + 2]
        kept = np.arange(first, last)[:points]
        rows.append(kept)
        offsets.append(offsets[-1] + len(kept))
    chosen = np.concatenate(rows) if rows else np.empty(0, dtype=np.int64)
    arrays = {name: getattr(training_set, name)[chosen] for name in ("z", "y", "gamma", "t", "source", "row")}
    return replace(
        training_set,
        cell_numbers=training_set.cell_numbers[:cells],
        offsets=np.array(offsets, dtype=np.int64),
        **arrays,
    )
