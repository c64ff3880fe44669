"""Where along the track a positional term acts."""

from __future__ import annotations

from typing import Any

from split_cli.vehicle.operations import Operations

__all__ = ["inside_stretch"]


def inside_stretch(ops: Operations, s: Any, s_start: float, s_end: float) -> Any:
    """Return 1.0 where s lies in [s_start, s_end), else 0.0; s_start > s_end wraps over the start of the lap.

    Parameters
    ----------
    ops : Operations
    s : array or symbol
        Track position [m].
    s_start, s_end : float
        [m]; numbers, not symbols, since their order decides between the two forms.
    """
    after = ops.where(s >= s_start, 1.0, 0.0)
    before = ops.where(s < s_end, 1.0, 0.0)
    if s_start <= s_end:
        return after * before
    return after + before - after * before
