"""Jumps of a channel that no car makes: it was moved, or its sensor failed there."""

from collections.abc import Sequence

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


def jumps(checks: Checks) -> list[ConsistencyFinding]:
    """Count where v_x changes faster than the tyres allow, or X, Y faster than any car drives, and say where.

    With a vehicle file the tyres allow twice the sum of both D over the mass, else what no car reaches.
    """
    found, k = [], checks.k
    rows = max(1, round(_SECONDS / k.period))
    if checks.usable("vx"):
        limit, against = _largest(checks.vehicle)
        vx = k.columns["vx"]
        places = _places(checks, np.abs(_change(vx, rows)), limit, rows)
        shown = [f"{vx[at]:.3g} to {vx[at + rows]:.3g} m/s at t = {k.times()[at]:.1f} s" for at in places]
        what = f"by more than {limit:.3g} m/s^2 over {rows * k.period:.2g} s, {against}"
        found += _jump("vx", "v_x jumps", what, shown)
    if checks.usable("X", "Y"):
        limit = NO_CAR_EXCEEDS["vx"][0]
        way = np.hypot(*(_change(k.columns[c], rows) for c in "XY"))
        places = _places(checks, way, limit, rows)
        shown = [f"{way[at]:.3g} m at t = {k.times()[at]:.1f} s" for at in places]
        found += _jump("X", "X, Y jump", f"faster than {limit:g} m/s over {rows * k.period:.2g} s", shown)
    return found


def _change(values: np.ndarray, rows: int) -> np.ndarray:
    return values[rows:] - values[: len(values) - rows]


def _places(checks: Checks, change: np.ndarray, limit: float, rows: int) -> list[int]:
    """Return the first row of each change over `rows` that is larger than `limit` a second."""
    places = []
    for run in checks.k.segments:
        inside = change[run.start : max(run.stop - rows, run.start)]
        beyond = np.flatnonzero(inside > limit * rows * checks.k.period)
        # A jump is beyond the limit in every window that it lies in.
        for jump in np.split(beyond, np.flatnonzero(np.diff(beyond) > rows) + 1):
            places += [run.start + int(jump[np.argmax(inside[jump])])] if len(jump) else []
    return places


def _jump(channel: str, who: str, what: str, places: Sequence[str]) -> list[ConsistencyFinding]:
    cause = "The car was put elsewhere, or its source"
    return [source_failed("jump", channel, who, what, places, cause)] if places else []


def source_failed(
    check: str, channel: str, who: str, what: str, places: Sequence[str], cause: str
) -> ConsistencyFinding:
    """Return that a source failed in some places, with the first of them and the remedy.

    Parameters
    ----------
    who, what : str
        Which channel does what it cannot, and by which sign that is seen.
    places : sequence of str
        In words, at least one.
    cause : str
        What failed, as the beginning of a sentence.
    """
    shown = "; ".join([*places[:_SHOWN], *([f"and {len(places) - _SHOWN} more"] if len(places) > _SHOWN else [])])
    text = (
        f"{who} {len(places)} time{'s' * (len(places) > 1)}: {what} ({shown}). {cause} failed. Leave these stretches "
        "out with `--cut A:B`, or map another source."
    )
    return ConsistencyFinding(check, channel, text, float(len(places)))
