"""Channels that were copied or computed from others: nothing that is compared with them is a check."""

from collections.abc import Mapping
from itertools import combinations

import numpy as np

from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.logs.drive import Drive
from split_cli.logs.drive_metadata import is_derived

_LEFT = 1e-4
"""Share of a channel's variation that a copy leaves [1]; the noise of any sensor leaves more."""
_LEFT_BY_FORMULA = 2e-3
"""The same of a product of channels, each brought to the clock by itself [1]."""
_LONGEST = 0.5
"""Time over which a yaw rate that was computed is searched for [s]: filters and buses of cars delay less."""
_MEASURED = ("vx", "r", "yaw", "X", "Y", "vy", "ax", "ay", "delta", "T")
"""Of two the later is reported; those that judge most others stand first."""


def copied_channels(drive: Drive, kinds: Mapping[str, str]) -> list[ConsistencyFinding]:
    """Return a finding for each channel that holds another's numbers, or what a formula makes of others.

    Parameters
    ----------
    kinds : mapping of str to str
        Derived channels are no copies: they say what they were made of.

    Notes
    -----
    A multiple is a copy too, in another unit. X and Y are left out together: on a straight road one is a multiple
    of the other.

    A drafted map is judged without this. It compares choices by how much they contradict, and one source in the
    place of two channels would win there if copies contradicted nobody.
    """
    found: list[ConsistencyFinding] = []
    reported: set[str] = set()
    columns = drive.columns
    measured = [c for c in _MEASURED if c in columns and not is_derived(kinds.get(c, ""))]
    for first, second in combinations(measured, 2):
        if second in reported or {first, second} == {"X", "Y"}:
            continue
        factor = _factor(columns[second], columns[first], _LEFT)
        if factor is not None:
            reported.add(second)
            times = "" if abs(factor - 1.0) < 1e-3 else f" times {factor:.4g}"
            text = (
                f"{second} holds the numbers of {first}{times}: one is a copy, or both have one source. "
                f"Map signals that measure them, or leave {second} out and derive it."
            )
            found.append(ConsistencyFinding("copied", second, text, factor))
    if {"r", "vx", "delta"} <= set(measured) and "r" not in reported:
        computed = columns["vx"] * np.tan(columns["delta"])
        factor, late = _factor(columns["r"], computed, _LEFT_BY_FORMULA), 0.0
        if factor is None:
            factor, late = _late_factor(columns["r"], computed, drive)
        if factor is not None and factor != 0.0:
            moved = f" of {late:.2f} s {'earlier' if late > 0.0 else 'later'}".replace("-", "") if late else ""
            sign = "-" if factor < 0.0 else ""
            text = (
                f"r is {sign}v_x tan(delta)/L{moved} with L = {1.0 / abs(factor):.4g} m, computed from the steer "
                "angle, not measured: it shows nothing of tyres. Map a gyro, or derive r from yaw: "
                "`--derive yaw-rate-from-yaw`."
            )
            found.append(ConsistencyFinding("copied", "r", text, factor))
    return found


def _late_factor(r: np.ndarray, computed: np.ndarray, drive: Drive) -> tuple[float | None, float]:
    """Return the factor with which a product of channels gives r at another time, and by how much r is late [s].

    Notes
    -----
    Rows are shifted by whole samples to where the two go together best. Three neighbouring rows then stand for a
    fraction of a sample: their weights add up to the factor, and their mean is the time. Rows whose neighbours
    belong to another segment are left out.
    """
    most = min(int(round(_LONGEST / drive.period)), len(r) // 4)
    begins = np.flatnonzero(np.diff(drive.segment, prepend=drive.segment[0] - 1))
    ends = np.append(begins[1:], len(r))
    inside = np.zeros(len(r), bool)
    for begin, end in zip(begins, ends, strict=True):
        inside[begin + most + 1 : end - most - 1] = True
    row = np.flatnonzero(inside & np.isfinite(r))
    if len(row) < 50:
        return None, 0.0
    y = r[row]

    def shifted(k: int) -> np.ndarray:
        return np.nan_to_num(computed[row - k])

    def goes_together(k: int) -> float:
        moved = shifted(k)  # one at a time: a hundred of them take a gigabyte of a long drive
        return abs(float(moved @ y)) / float(np.linalg.norm(moved) + 1e-12)

    if np.std(y) == 0.0 or not np.any(computed[row]):
        return None, 0.0
    best = max(range(-most, most + 1), key=goes_together)
    near = [best - 1, best, best + 1]
    design = np.stack([shifted(k) for k in near], axis=1)
    weights, *_ = np.linalg.lstsq(design, y)
    factor = float(weights.sum())
    if factor == 0.0 or float(np.std(y - design @ weights)) >= _LEFT_BY_FORMULA * float(np.std(y)):
        return None, 0.0
    return factor, float(weights @ near) / factor * drive.period


def _factor(y: np.ndarray, x: np.ndarray, left: float) -> float | None:
    """Return the factor with which x gives y but for the share `left` of its variation; None where none does."""
    use = np.isfinite(y) & np.isfinite(x)
    if np.count_nonzero(use) < 50:
        return None
    y, x = y[use], x[use]
    spread, square = float(np.std(y)), float(x @ x)
    if spread == 0.0 or square == 0.0 or np.std(x) == 0.0:
        return None
    factor = float(x @ y) / square
    return factor if float(np.std(y - factor * x)) < left * spread else None
