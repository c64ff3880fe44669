"""What a trained set and labels can hold: a forged or damaged file is refused before it is computed with."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from split_cli.learning.features import Z2
from split_cli.logs.drive_metadata import CIRCULAR
from split_cli.signals import CHANNELS

LARGEST_CELL = 200
"""Points a cell may keep [1]; theory: each cell has sums of 8 M^2 bytes, at 200 a gigabyte in 3,000 cells."""
LARGEST_DICTIONARY = 20_000
"""Points of the one dictionary of IOL [1]; theory: its inverse has 8 M^2 bytes, 3.2 GB."""
MOST_CELLS_OF_A_GRID = 2_000_000
"""Cells between a grid's bounds [1]; measured: enumerated, they take 122 bytes each; by default 8,100."""
LONGEST_HORIZON = 10.0
"""Label interval [s]; judgement: the paper's is 0.05 s, and over seconds a label is no rate."""
LARGEST_LABEL = 1e9
"""Of a label's magnitude [m/s^2], [rad/s^2]; theory: the limit of v_x, 1e5 m/s, over a tenth of a millisecond."""
LARGEST_OF_KERNEL = 1e3 * LARGEST_LABEL**2
"""Of a label variance or a length scale; theory: the fit takes at most a thousand times labels' mean square."""
LONGEST_TEXT = 4096
"""A name or digest in a header [characters]; that of the longest path of Linux."""
FOUND = ("faults", "remarks", "circular")
"""What ingest found, in labels and in a drive of a set, and states whose labels say nothing; absent where empty."""
_COUNTS = ("samples", "accepted", "insertions", "replacements", "points", "cells")


def check_header(described: Mapping[str, Any], features: Sequence[str], vehicle_digest: str) -> None:
    """Check every number of a set's header.

    Parameters
    ----------
    described : mapping
        As `training_set` writes it.
    vehicle_digest : str
        Of the vehicle in the header, computed.

    Raises
    ------
    ValueError
        Names the first field that no set can have.
    """
    _within("horizon [s]", described["horizon"], 0.0, LONGEST_HORIZON)
    one_dictionary = described.get("learner") == "iol"
    _whole("capacity", described["capacity"], 1, LARGEST_DICTIONARY if one_dictionary else LARGEST_CELL)
    threshold = _number("threshold", described["threshold"])
    if not 0.0 <= threshold <= 1.0:
        raise ValueError(f"threshold is {threshold:g}, a marginal gain lies between 0 and 1")
    if described["forgetting"] is not None:
        _within("forgetting [s]", described["forgetting"], 0.0, np.inf)
    for name, value in described["region"].items():
        _within(f"region.{name}", value, 0.0, 1e3)
    _check_grid(described["grid"], features)
    for name, length in (("length_scales", len(features)), ("signal_variance", 3), ("noise_variance", 3)):
        _numbers(f"kernel.{name}", described["kernel"][name], length, LARGEST_OF_KERNEL)
    _text("kernel.origin", described["kernel"].get("origin", ""))
    _check_trust(described.get("trust", {}))
    _check_plain(described["plain"])
    for name in ("points", "cells"):
        _whole(f"counts.{name}", described["counts"][name], 0, np.inf)
    for number, source in enumerate(described["sources"]):
        _check_source(f"of source {number}", source)
    _whole("found_effects", described.get("found_effects", 0), 0, len(described["vehicle"].get("effects") or ()))
    if described["vehicle_digest"] != vehicle_digest:
        raise ValueError("the digest of its vehicle is not that of the vehicle in it")


def check_labels_header(described: Mapping[str, Any]) -> None:
    """Check what a file of labels says of itself.

    Raises
    ------
    ValueError
        Names the first field that no labels can have.
    """
    _within("horizon [s]", described["horizon"], 0.0, LONGEST_HORIZON)
    _whole("window", described["window"], 1, np.inf)
    for name, value in described["region"].items():
        _within(f"region.{name}", value, 0.0, 1e3)
    for name in ("start_time", "duration"):
        _time(name, described[name])
    for name in ("drive", "sha256", "vehicle_digest"):
        _text(name, described[name])
    if not isinstance(described["features"], list) or not described["features"]:
        raise ValueError("features is no list of names")
    for name in described["features"]:
        _text("a feature", name)
    _check_found(described)
    _check_plain(described["plain"])


def _check_found(described: Mapping[str, Any]) -> None:
    for name in FOUND:
        clauses = described.get(name, [])
        if not isinstance(clauses, list):
            raise ValueError(f"{name} is no list of clauses")
        for clause in clauses:
            _text(f"a clause of {name}", clause)
    if not set(described.get("circular", [])) <= set(CIRCULAR):
        raise ValueError(f"circular names a state other than {', '.join(CIRCULAR)}")


def _check_trust(trust: Mapping[str, Any]) -> None:
    for name in ("share", "doubt"):
        if trust.get(name) is not None:
            _numbers(f"trust.{name}", trust[name], 3, LARGEST_OF_KERNEL)
    _whole("trust.blocks", trust.get("blocks", 0), 0, np.inf)


def _check_source(of: str, source: Mapping[str, Any]) -> None:
    for name in ("name", "sha256"):
        _text(f"{name} {of}", source[name])
    _check_found(source)
    for name in _COUNTS:
        _whole(f"{name} {of}", source[name], 0, np.inf)
    for reason, count in source["rejected"].items():
        _whole(f"rejected.{_text('a reason', reason)} {of}", count, 0, np.inf)
    if not source["insertions"] + source["replacements"] <= source["accepted"] <= source["samples"]:
        raise ValueError(f"updates outnumber accepted labels, or these the samples, in the counts {of}")
    for name, longest in (("horizon", LONGEST_HORIZON), ("duration", CHANNELS["t"].limit)):
        if not 0.0 <= _number(f"{name} {of}", source.get(name, 0.0)) < longest:
            raise ValueError(f"{name} {of} is {source[name]!r}, it must lie between 0 and {longest:g}")
    _time(f"start_time {of}", source.get("start_time", 0.0))


def _check_grid(grid: Mapping[str, Any], features: Sequence[str]) -> None:
    cells = 1.0
    for name in ("edges", "lower", "upper"):
        if len(grid[name]) != len(features):
            raise ValueError(f"grid.{name} has {len(grid[name])} values for {len(features)} features")
    for edge, lower, upper in zip(grid["edges"], grid["lower"], grid["upper"], strict=True):
        _within("an edge of the grid", edge, 0.0, np.inf)
        if tuple(features) == Z2.names and None in (lower, upper):
            raise ValueError("the grid of z2 is not bounded")
        if lower is not None and upper is not None:
            if not _number("grid.lower", lower) < _number("grid.upper", upper):
                raise ValueError(f"the grid's lower bound {lower!r} is not below its upper {upper!r}")
            cells *= (upper - lower) / edge
    if cells > MOST_CELLS_OF_A_GRID:
        raise ValueError(f"its grid has {cells:.3g} cells, more than {MOST_CELLS_OF_A_GRID:,}")


def check_points(
    described: Mapping[str, Any], lengths: Sequence[int], points: Mapping[str, np.ndarray], sources: int
) -> None:
    """Check the points of a set against its header.

    Parameters
    ----------
    described : mapping
        The header.
    lengths : sequence of int
        Points of each cell.
    points : mapping of str to ndarray
        ``z`` (P, D), ``y`` (P, 3), ``gamma``, ``t``, ``source`` (P,).
    sources : int
        How many drives the header names.

    Raises
    ------
    ValueError
        Names what no set can have.
    """
    fullest = max(lengths, default=0)
    if fullest > described["capacity"]:
        raise ValueError(f"a cell holds {fullest} points, its capacity is {described['capacity']}")
    for name, largest in (("z", np.inf), ("y", LARGEST_LABEL), ("gamma", np.inf), ("t", CHANNELS["t"].limit)):
        if not np.isfinite(points[name]).all():
            raise ValueError(f"{name} holds numbers that are not finite")
        if np.abs(points[name]).max(initial=0.0) > largest:
            raise ValueError(f"{name} holds {np.abs(points[name]).max():g}, beyond {largest:g} none is possible")
    if points["row"].min(initial=0) < 0:
        raise ValueError("points name rows below zero")
    if len(points["source"]) and not 0 <= points["source"].min() <= points["source"].max() < sources:
        raise ValueError(f"points name drives beyond the {sources} that it lists")
    counts = described["counts"]
    if (counts["points"], counts["cells"]) != (sum(lengths), len(lengths)):
        raise ValueError(
            f"it says {counts['points']} points in {counts['cells']} cells, and holds {sum(lengths)} in {len(lengths)}"
        )


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e300:
        raise ValueError(f"{name} is {value!r}, a finite number was expected")
    return float(value)


def _within(name: str, value: Any, above: float, below: float) -> None:
    if not above < _number(name, value) < below:
        raise ValueError(f"{name} is {value!r}, it must lie between {above:g} and {below:g}")


def _numbers(name: str, values: Any, length: int, largest: float = np.inf) -> None:
    if not isinstance(values, list) or len(values) != length:
        raise ValueError(f"{name} is no list of {length} numbers")
    for value in values:
        if abs(_number(name, value)) > largest:
            raise ValueError(f"{name} is {value:g}, beyond {largest:g} none is possible")


def _time(name: str, value: Any) -> None:
    limit = CHANNELS["t"].limit
    if abs(_number(name, value)) > limit:
        raise ValueError(f"{name} is {value:g} s, beyond {limit:g} s there is no time")


def _check_plain(value: Any) -> None:
    if not isinstance(value, bool):
        raise ValueError("plain is neither true nor false")


def _text(name: str, value: Any) -> str:
    if not isinstance(value, str) or len(value) > LONGEST_TEXT:
        raise ValueError(f"{name} is no text of at most {LONGEST_TEXT:,} characters")
    return value


def _whole(name: str, value: Any, least: int, most: float) -> None:
    if isinstance(value, bool) or not isinstance(value, int) or not least <= value <= most:
        raise ValueError(f"{name} is {value!r}, a whole number of at least {least} was expected")
