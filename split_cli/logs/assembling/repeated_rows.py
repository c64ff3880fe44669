"""Rows that a file holds twice: a block that was written again, as after a lost connection or a merge."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.assembling.conversion import RawSeries

_FEWEST = 3
"""Rows of a block [1]: fewer are late or doubled samples, which cleaning counts."""


def without_repeated_rows(
    series: Mapping[str, Sequence[RawSeries]], largest_step_back: float
) -> tuple[dict[str, list[RawSeries]], list[str]]:
    """Return the series without blocks that repeat earlier rows, and what was left out.

    A block begins where the clock goes back, by more than late samples do, to a time that it has shown. It lasts
    while time and values of every channel on this clock are those of the rows written then. It is left out if some
    channel changes in it, and the clock is beyond all earlier rows behind it, or the file ends. A lap whose time starts
    again has other values.
    """
    groups: dict[int, list[RawSeries]] = {}
    for parts in series.values():
        for part in parts:
            groups.setdefault(id(part.time), []).append(part)
    said, kept = [], {}
    for key, parts in groups.items():
        repeated = _repeated(parts[0].time, [part.values for part in parts], largest_step_back)
        if repeated is not None:
            kept[key] = time = parts[0].time[~repeated], ~repeated
            count = len(repeated) - len(time[0])
            said.append(f"{count} rows repeat earlier ones, with their time: left out")
    if not kept:
        return {channel: list(parts) for channel, parts in series.items()}, []
    new = {
        channel: [
            replace(part, time=kept[id(part.time)][0], values=part.values[kept[id(part.time)][1]])
            if id(part.time) in kept
            else part
            for part in parts
        ]
        for channel, parts in series.items()
    }
    return new, sorted(set(said))


def _repeated(time: np.ndarray, values: Sequence[np.ndarray], largest_step_back: float) -> np.ndarray | None:
    """Return which rows repeat earlier ones, shape (N,); None where no row does."""
    backward = np.flatnonzero(np.diff(time) < -largest_step_back) + 1
    repeated = None
    for start in backward.tolist():
        earlier = np.flatnonzero(time[:start] == time[start])
        for first in earlier[-1:].tolist():
            length = min(start - first, len(time) - start)
            block, before = slice(start, start + length), slice(first, first + length)
            same = time[block] == time[before]
            for channel in values:
                a, b = channel[block], channel[before]
                same &= (a == b) | (np.isnan(a) & np.isnan(b))
            length = length if same.all() else int(np.argmin(same))
            end = start + length
            moves = any(_changes(channel[start:end]) for channel in values)
            goes_on = end == len(time) or time[end] > np.nanmax(time[:start])
            if length >= _FEWEST and moves and goes_on:
                repeated = np.zeros(len(time), dtype=bool) if repeated is None else repeated
                repeated[start:end] = True
    return repeated


def _changes(values: np.ndarray) -> bool:
    finite = values[np.isfinite(values)]
    return len(finite) > 1 and bool(np.ptp(finite) > 0.0)
