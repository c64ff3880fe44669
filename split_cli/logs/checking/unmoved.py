"""Channels that never change, and a car that stands from end to end."""

import numpy as np

from split_cli.logs.checking.checks import Checks
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.signals import REQUIRED_CHANNELS

_STANDING = 0.3
"""Speed [m/s], and extent of the path [m], below which nothing has driven; that of receivers at rest is smaller."""


def unmoved(checks: Checks) -> list[ConsistencyFinding]:
    """Return that the car stands, or else the channels that are probably not measured since they hold one value."""
    if _stands(checks):
        fastest = float(np.nanmax(np.abs(checks.k.columns["vx"])))
        text = (
            f"the car stands from end to end: v_x is {fastest:.2g} m/s at most. Nothing can be judged or learned: "
            "take a log in which it drives."
        )
        return [ConsistencyFinding("standing", "vx", text)]
    found = []
    for channel in (*REQUIRED_CHANNELS, "ax", "ay", "yaw"):
        if channel in checks.k and channel not in checks.derived:
            values = checks.k.columns[channel]
            if np.nanmax(values) == np.nanmin(values):
                text = (
                    f"{channel} never changes ({values[0]:g}): it is probably not measured. "
                    "Map a signal that is, or derive it."
                )
                found.append(ConsistencyFinding("constant", channel, text, None))
    return found


def _stands(checks: Checks) -> bool:
    """Whether there is no speed worth the name, and no path."""
    if "vx" not in checks.k or "vx" in checks.derived:
        return False
    ground = [
        np.ptp(values[np.isfinite(values)]) for c in ("X", "Y") if c in checks.k for values in [checks.k.columns[c]]
    ]
    return bool(np.nanmax(np.abs(checks.k.columns["vx"])) < _STANDING and max(ground, default=0.0) < _STANDING)
