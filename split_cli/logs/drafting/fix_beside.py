"""A satellite fix beside recorded X and Y: where they run along it they are east and north."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.trial import Trial, TrialCandidate

_LEAST_EXTENT = 20.0
"""Root mean square distance of a path from its middle, from which on it is compared [m]; some times the error of a
single receiver, 2 to 5 m."""
_CLOSE = 0.1
"""What X, Y may differ from the fix by, as a share of their extent, and the angle between both [1], [rad];
judgement: a pose of its own drifts by some per cent, and a turned frame is no east."""
_CLEARER = 3.0
"""How many times as far the mirrored fix must be [1]; on a straight road both are as near."""


def along_the_fix(
    chosen: dict[str, Suggestion],
    usable: Mapping[str, Sequence[TrialCandidate]],
    trial: Trial,
    guess: Callable[[TrialCandidate], Suggestion],
) -> dict[str, Suggestion]:
    """Mark X and Y as east and north where latitude and longitude beside them run along them.

    Only then left and right are known: a recording whose X, Y and yaw are mirrored agrees with itself.
    """
    fix = {c: next((one for one in usable.get(c, ()) if one.convert == f"local_{c.lower()}"), None) for c in "XY"}
    if not {"X", "Y"} <= set(chosen) or chosen["X"].convert or chosen["Y"].convert:
        return chosen
    columns = [trial.column(chosen[c]) for c in "XY"]
    columns += [trial.column(guess(one)) for one in fix.values() if one is not None]
    known = [column - column.mean() for column in columns if column is not None and len(column)]
    if len(known) < 4 or not _same_path(known[0] + 1j * known[1], known[2] + 1j * known[3]):
        return chosen
    return {**chosen, **{c: replace(chosen[c], along_the_fix=True) for c in "XY"}}


def _same_path(path: np.ndarray, fix: np.ndarray) -> bool:
    """Tell whether a path, complex (N,), is the fix in another unit of length, neither turned nor mirrored."""
    own, theirs = (float(np.sqrt(np.mean(np.abs(one) ** 2))) for one in (path, fix))
    if not (theirs > _LEAST_EXTENT and own > 0.0):
        return False
    slope = np.vdot(fix, path) / np.vdot(fix, fix)
    mirrored = np.vdot(fix.conj(), path) / np.vdot(fix, fix)
    off, off_mirrored = (
        float(np.sqrt(np.mean(np.abs(path - one) ** 2))) / own for one in (slope * fix, mirrored * fix.conj())
    )
    return off < _CLOSE and abs(float(np.angle(slope))) < _CLOSE and off_mirrored > _CLEARER * off
