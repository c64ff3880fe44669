"""Jumps of the speed that no tyre drives or brakes: the car was moved, or its estimator failed there."""

import numpy as np

from split_cli.logs.checking.checks import Checks
from split_cli.logs.checking.plausible import NO_CAR_EXCEEDS
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import Vehicle

_SECONDS = 0.2
"""Over which a change of speed is measured [s]: noise and the steps of an encoder are small beside it."""
_BEYOND_GRIP = 2.0
"""Of what the vehicle file's tyres carry [1]: slopes, downforce and a file of too little grip stay within it."""
_SHOWN = 3


def in_jumps(drive: Drive, vehicle: Vehicle) -> np.ndarray:
    """Return rows in or beside jumps of v_x or v_y that twice what tyres carry cannot make, bool, shape (N,)."""
    rows, found = max(1, round(_SECONDS / drive.period)), np.zeros(len(drive), dtype=bool)
    most = _largest(vehicle)[0] * rows * drive.period
    for run in drive.segments():
        for name in ("vx", "vy"):
            v = drive[name][run]
            for first in np.flatnonzero(np.abs(v[rows:] - v[:-rows]) > most):
                found[run][first : first + rows + 1] = True
    return found


def _largest(car: Vehicle | None) -> tuple[float, str]:
    """Return the largest change of speed that is believed [m/s^2], and why, in words."""
    limit, against = NO_CAR_EXCEEDS["ax"][0], "no car does that"
    if car is not None:
        carried = _BEYOND_GRIP * car.lateral_grip
        if carried < limit:
            limit, against = carried, "twice what the tyres of the vehicle file carry"
    return limit, against


def speed_jumps(checks: Checks) -> list[ConsistencyFinding]:
    """Count where v_x changes faster than the tyres allow, and say where and by how much.

    With a vehicle file that is twice the sum of both D over the mass, else what no car reaches.
    """
    if not checks.usable("vx"):
        return []
    k, (limit, against) = checks.k, _largest(checks.vehicle)
    vx, t = k.columns["vx"], k.times()
    rows = max(1, round(_SECONDS / k.period))
    found: list[tuple[float, float, float]] = []  # time, speed before, speed behind
    for run in k.segments:
        v, at = vx[run], t[run]
        if len(v) <= rows:
            continue
        change = np.abs(v[rows:] - v[:-rows])
        beyond = np.flatnonzero(change > limit * rows * k.period)
        # A jump is beyond the limit in every window that it lies in.
        for jump in np.split(beyond, np.flatnonzero(np.diff(beyond) > rows) + 1):
            if len(jump):
                first = int(jump[np.argmax(change[jump])])
                found.append((float(at[first]), float(v[first]), float(v[first + rows])))
    if not found:
        return []
    shown = "; ".join(f"{a:.3g} to {b:.3g} m/s at t = {time:.1f} s" for time, a, b in found[:_SHOWN])
    more = f"; and {len(found) - _SHOWN} more" if len(found) > _SHOWN else ""
    text = (
        f"v_x jumps {len(found)} time{'s' * (len(found) > 1)}: by more than {limit:.3g} m/s^2 over "
        f"{rows * k.period:.2g} s, {against} ({shown}{more}). The car was put elsewhere, or its source failed. "
        "Leave these stretches out with `--cut A:B`, or map another source."
    )
    return [ConsistencyFinding("jump", "vx", text, float(len(found)), None)]
