"""Numbers that stand where nothing was measured: the largest that a few bits hold, or nines."""

from dataclasses import replace

import numpy as np

from split_cli.logs.raw import RawSignal

_LARGEST = frozenset(
    {2**bits - 1 for bits in (8, 10, 11, 12, 13, 14, 15, 16, 31, 32)}
    | {2**16 - 2, 2**15, 2**31}
    | {10**digits - 1 for digits in range(3, 10)}
)
"""What counters of so many bits end with, the error mark of SAE J1939 and the lowest signed numbers; nines [1]."""
_STEPS = tuple(10.0**tens * 2.0**halves for tens in range(5) for halves in range(5))
"""By which a number is divided that a bus sends whole: tenths, halves and both [1]."""
_FEWEST_MARKS, _FEWEST_OTHERS = 2, 20
"""Samples of a mark, and different other values beside it [1]; judgement: one sample may be a spike, and a switch
takes few values."""


def without_marks(signal: RawSignal) -> tuple[RawSignal, str]:
    """Return a signal as recorded without the marks of missing values, and what to say of them; empty of none.

    A mark is the highest or the lowest value, occurs again exactly, is such a number in whole steps, and is
    farther from all others than these are from each other.
    """
    values, said = signal.values, []
    for end in (np.fmax, np.fmin):
        # The end alone is looked at of most signals: without copies of a long one.
        mark = float(end.reduce(values)) if values.dtype.kind in "fiu" and len(values) > _FEWEST_OTHERS else np.nan
        if not _is_such(mark):
            continue
        finite = values[np.isfinite(values)]
        others = finite[finite != mark]
        if len(finite) - len(others) < _FEWEST_MARKS or len(others) < len(finite) / 2:
            continue
        far = float(np.min(np.abs(others - mark))) > float(np.ptp(others))
        if far and len(np.unique(others)) >= _FEWEST_OTHERS:
            said.append(f"{len(finite) - len(others)} samples of {mark:g}")
            values = np.where(values == mark, np.nan, values)
    if not said:
        return signal, ""
    return replace(signal, values=values), f"{signal.name}: {' and '.join(said)} are a mark of missing values, left out"


def _is_such(value: float) -> bool:
    """Whether a number is one of `_LARGEST` in steps of a usual size."""
    if not abs(value) <= max(_LARGEST):  # nor is NaN
        return False
    whole = (abs(value) * steps for steps in _STEPS)
    return any(abs(count - round(count)) < 1e-6 * count and round(count) in _LARGEST for count in whole)
