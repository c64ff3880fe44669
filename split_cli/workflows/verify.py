"""Check a trained set or an export against itself: nothing but the file is needed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.learning.kernel import correlation
from split_cli.learning.training_set import TrainingSet, read_set

__all__ = ["Verification", "VerifiedItem", "verify", "verify_set"]

GAIN_TOLERANCE = 1e-9
"""Absolute, of gains between 0 and 1: LAPACK's inverse against the factors that learning keeps."""


@dataclass(frozen=True)
class VerifiedItem:
    """One thing that was checked.

    Attributes
    ----------
    check : str
    passed : bool or None
        None when it could not be checked here.
    detail : str
    """

    check: str
    passed: bool | None
    detail: str


@dataclass(frozen=True)
class Verification:
    """What checking a file or folder found.

    Attributes
    ----------
    path, kind : str
        Kind is ``trained set`` or ``export``.
    items : tuple of VerifiedItem
    """

    path: str
    kind: str
    items: tuple[VerifiedItem, ...]

    @property
    def passed(self) -> bool:
        """Whether nothing failed."""
        return all(item.passed is not False for item in self.items)


def verify(path: str | Path) -> Verification:
    """Check a ``.split`` file, or the folder of an export.

    Raises
    ------
    SplitError
        If it is neither, or cannot be read at all.
    """
    path = Path(path)
    if path.name == "manifest.json" and path.is_file():
        path = path.parent
    if path.is_dir():
        # An export's checks need CasADi, which takes a second to import and is not needed for sets.
        from split_cli.export.verify import verify_folder

        items = tuple(VerifiedItem(f.check, f.passed, f.detail) for f in verify_folder(path))
        return Verification(str(path), "export", items)
    if not path.exists():
        raise SplitError("no such file or folder", where=str(path))
    if path.suffix.lower() != ".split" and not _is_arrow(path):
        raise SplitError(
            "is neither a trained set nor the folder of an export",
            where=str(path),
            advice="`split info` tells what it is.",
        )
    return Verification(str(path), "trained set", verify_set(read_set(path)))


def _is_arrow(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(6) == b"ARROW1"
    except OSError as error:
        raise SplitError(f"cannot be read ({error.strerror})", where=str(path)) from error


def verify_set(training_set: TrainingSet) -> tuple[VerifiedItem, ...]:
    """Check that a set is what learning leaves behind: order, cells, capacity, gains, sources."""
    s = training_set
    counts = np.diff(s.offsets)
    finite = all(np.isfinite(getattr(s, name)).all() for name in ("z", "y", "gamma", "t"))
    items = [
        VerifiedItem("content", True, "the digest in the file is that of its content"),
        _item("finite", finite, "every number is finite", "there are numbers that are not finite"),
    ]
    ordered = bool((np.diff(s.cell_numbers) > 0).all() and (counts > 0).all())
    items.append(
        _item("order of cells", ordered, f"{s.cell_count} cells ascend, none empty", "cells are disordered")
    )
    fullest = int(counts.max(initial=0))
    text = f"the fullest cell holds {fullest} of {s.capacity} points"
    items.append(_item("capacity", fullest <= s.capacity, text, text))
    items.append(_cells(s))
    items.append(_gains(s))
    items.append(_sources(s))
    return tuple(items)


def _item(check: str, passed: bool, good: str, bad: str) -> VerifiedItem:
    return VerifiedItem(check, bool(passed), good if passed else bad)


def _cells(s: TrainingSet) -> VerifiedItem:
    index, has_cell = s.grid.index(s.z)
    stored = np.repeat(s.cell_numbers, np.diff(s.offsets))
    wrong = int((~has_cell | (s.grid.pack(index) != stored)).sum())
    return _item("points in their cells", wrong == 0, f"all {s.size} points", f"{wrong} of {s.size} are elsewhere")


def _gains(s: TrainingSet) -> VerifiedItem:
    """Compare stored gains with 1/[K^-1]_ii of every cell's points."""
    if s.size == 0:
        return VerifiedItem("gains", True, "there are no points")
    worst = 0.0
    for first, last in zip(s.offsets[:-1], s.offsets[1:], strict=True):
        points = s.z[first:last]
        try:
            inverse = np.linalg.inv(correlation(points, points, s.kernel.length_scales))
        except np.linalg.LinAlgError:
            worst = np.inf
            break
        error = np.abs(1.0 / np.diag(inverse) - s.gamma[first:last])
        worst = max(worst, float(np.where(np.isnan(error), np.inf, error).max()))
    text = f"stored gains are within {worst:.3g} of 1/[K^-1]_ii, {GAIN_TOLERANCE:g} is allowed"
    return _item("gains", worst <= GAIN_TOLERANCE, text, text)


def _sources(s: TrainingSet) -> VerifiedItem:
    named = bool(s.size == 0 or (s.source.min() >= 0 and s.source.max() < len(s.sources)))
    last = s.sources[-1] if s.sources else None
    counted = last is None or (last.points == s.size and last.cells == s.cell_count)
    good = f"{len(s.sources)} drives, their counts are those of the set"
    return _item("sources", named and counted, good, "points name unknown drives, or the counts differ")
