"""Where along the track a positional term acts."""

from typing import Any

from split_cli.vehicle.effects.search import Range
from split_cli.vehicle.effects.wording import Estimates, number
from split_cli.vehicle.operations import Operations

__all__ = ["PLACE_COMPLEXITY", "inside_stretch", "place_ranges", "stretch_in_words"]

PLACE_COMPLEXITY = 6.0  # parameters that a size with a place or a wavelength, searched all along, is worth


def inside_stretch(ops: Operations, s: Any, s_start: float, s_end: float) -> Any:
    """Return 1.0 where s lies in [s_start, s_end), else 0.0; s_start > s_end wraps over the start of the lap.

    Parameters
    ----------
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


def place_ranges(reach: float) -> dict[str, Range]:
    """Return where a stretch may start and end on a way of `reach` [m]."""
    limits = Range(0.0, reach, 0.002 * reach)
    return {"s_start": limits, "s_end": limits}


def stretch_in_words(p: Estimates) -> str:
    """Return from where to where a stretch goes."""
    return f"between s = {number(p['s_start'].value)} and {number(p['s_end'].value)} m"
