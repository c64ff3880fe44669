"""Channels that were copied or computed from others: nothing that is compared with them is a check."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from split_cli.logs.checking.checks import Checks
from split_cli.logs.checking.explanations import ConsistencyFinding

__all__ = ["copied_channels"]

_LEFT = 1e-4
"""Share of a channel's variation that a copy leaves [1]; the noise of any sensor leaves more."""
_LEFT_BY_FORMULA = 2e-3
"""The same of a product of channels, each brought to the clock by itself [1]."""
_MEASURED = ("vx", "r", "yaw", "X", "Y", "vy", "ax", "ay", "delta", "T")
"""Of two the later is told; those that judge most others stand first."""


def copied_channels(checks: Checks) -> list[ConsistencyFinding]:
    """Return a finding for each channel that holds another's numbers, or what a formula makes of others.

    A multiple is a copy too, in another unit. X and Y are left out together: on a straight road one is a multiple
    of the other.
    """
    found: list[ConsistencyFinding] = []
    told: set[str] = set()
    for first, second in combinations([c for c in _MEASURED if checks.usable(c)], 2):
        if second in told or {first, second} == {"X", "Y"}:
            continue
        factor = _factor(checks.k.columns[second], checks.k.columns[first], _LEFT)
        if factor is not None:
            told.add(second)
            times = "" if abs(factor - 1.0) < 1e-3 else f" times {factor:.4g}"
            text = (
                f"{second} holds the numbers of {first}{times}: one is a copy, or both have one source. "
                f"Map signals that measure them, or leave {second} out and derive it."
            )
            found.append(ConsistencyFinding("copied", second, text, factor))
    if checks.usable("r", "vx", "delta") and "r" not in told:
        k = checks.k
        factor = _factor(k.columns["r"], k.columns["vx"] * np.tan(k.columns["delta"]), _LEFT_BY_FORMULA)
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
