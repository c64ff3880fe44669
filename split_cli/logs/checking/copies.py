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
_MEASURED = ("vx", "r", "yaw", "X", "Y", "vy", "ax", "ay", "delta", "T")
"""Of two the later is told; those that judge most others stand first."""


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
        factor = _factor(columns["r"], columns["vx"] * np.tan(columns["delta"]), _LEFT_BY_FORMULA)
        if factor is not None and factor != 0.0:
            text = (
                f"r is v_x tan(delta)/{1.0 / factor:.4g} m, computed from the steer angle, not measured: it "
                "shows nothing of tyres. Map a gyro, or derive r from yaw: `--derive yaw-rate-from-yaw`."
            )
            found.append(ConsistencyFinding("copied", "r", text, factor))
    return found


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
