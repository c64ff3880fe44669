"""Leaving out stretches of a recording by its time."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.errors import MapError
from split_cli.logs.assembling.clean import may_hold, written_on_change
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.scratch import set_aside


def first_sample(series: Mapping[str, Sequence[RawSeries]]) -> float:
    """Return the time of a recording's first sample [s]."""
    every = [part.time for parts in series.values() for part in parts]
    return min(float(np.nanmin(time)) for time in every if np.isfinite(time).any())


def trim(
    series: Mapping[str, Sequence[RawSeries]],
    start: float | None,
    end: float | None,
    cuts: Sequence[tuple[float, float]],
    gap: float,
) -> tuple[dict[str, tuple[RawSeries, ...]], tuple[str, ...]]:
    """Leave out what is before `start`, after `end` and inside `cuts`, of all channels alike.

    Parameters
    ----------
    series : mapping of str to sequence of RawSeries
    start, end : float or None
        From the recording's first sample [s].
    cuts : sequence of (float, float)
        Likewise [s].
    gap : float
        A cut must be longer than it, or the drive would be interpolated across [s].

    Returns
    -------
    series, left_out : dict of str to tuple of RawSeries, tuple of str
        What was left out, in words.

    Raises
    ------
    MapError
        If a span is empty, shorter than `gap`, or nothing is left.
    """
    spans = [(-np.inf, start)] if start is not None else []
    spans += [*cuts, *([(end, np.inf)] if end is not None else [])]
    if not spans:
        return {channel: tuple(parts) for channel, parts in series.items()}, ()
    if any(limit is not None and math.isnan(limit) for limit in (start, end)):
        raise MapError("--start and --end must be numbers", advice="Give seconds from the first sample.")
    if start is not None and end is not None and not start < end:
        what = f"the end {end:g} s is not after the start {start:g} s"
        raise MapError(what, advice="Give --start less than --end.")
    for first, last in cuts:
        if not last - first > gap:
            advice = "Widen the cut, or give a smaller --gap."
            raise MapError(f"the cut {first:g}:{last:g} is not longer than the gap of {gap:g} s", advice=advice)
    zero = first_sample(series)
    made: dict[str, tuple[RawSeries, ...]] = {}
    for channel, parts in series.items():
        kept = []
        for part in parts:
            time = part.time - part.delay - zero
            if may_hold(channel):
                part, time = _with_last_values(part, time, spans)
            keep = np.ones(len(time), dtype=bool)
            for first, last in spans:
                keep &= ~((time >= first) & (time < last))
            if not keep.any():
                what = f"nothing of {channel} is left after trimming; it is recorded from {_span(time)}"
                raise MapError(what, advice="Give other times with --start, --end or --cut.")
            kept.append(replace(part, time=set_aside(part.time[keep]), values=set_aside(part.values[keep])))
        made[channel] = tuple(kept)
    left_out = [
        f"before {last:g} s"
        if np.isinf(first)
        else f"after {first:g} s"
        if np.isinf(last)
        else f"from {first:g} to {last:g} s"
        for first, last in spans
    ]
    return made, (f"left out on request: {', '.join(left_out)}",)


def _with_last_values(
    part: RawSeries, time: np.ndarray, spans: Sequence[tuple[float, float]]
) -> tuple[RawSeries, np.ndarray]:
    """Return a series and its time (N,) [s]; the last sample in each span is moved to the span's end.

    So is one that is written only where it changes: what it changed to in a span holds on behind it.
    """
    known = np.flatnonzero(np.isfinite(time) & np.isfinite(part.values))
    if not written_on_change(time[known], part.values[known], part.command):
        return part, time
    moved = time.copy()
    for first, last in sorted(spans):
        sooner = known[moved[known] < last]
        inside = sooner[moved[sooner] >= first]
        before = sooner[moved[sooner] < first]
        if not len(inside) or np.isinf(last):
            continue
        latest = inside[np.argmax(moved[inside])]
        # A value that is as it was before the span holds on by itself.
        if not len(before) or part.values[before[np.argmax(moved[before])]] != part.values[latest]:
            moved[latest] = last
    return replace(part, time=part.time + (moved - time)), moved


def _span(time: np.ndarray) -> str:
    """Return the first and last time [s] as they are given to ``--start`` and ``--end``."""
    return f"{np.nanmin(time):.1f} to {np.nanmax(time):.1f} s" if np.isfinite(time).any() else "no time"
