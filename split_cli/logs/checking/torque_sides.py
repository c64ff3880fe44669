"""Whether T is right both driving and braking: without the brakes, or of one axle, it is not."""

import numpy as np

from split_cli.logs.checking.checks import TORQUE_TOLERANCE, Checks
from split_cli.logs.checking.kinematics import fit_linear, has_dependent_columns
from split_cli.logs.checking.relations import ConsistencyFinding

_SURE = 3.0
"""Standard errors by which a share is beyond the tolerance, and the two shares differ [1]; judgement."""
_LEAST_ROWS = 100
"""Samples of driving, and of braking, that a share is measured on [1]; judgement."""


def torque_sides(checks: Checks, has_factor: bool = False) -> list[ConsistencyFinding]:
    """Compare T with what the motion takes, apart where that drives and where it brakes.

    T = s_d max(D, 0) + s_b min(D, 0) + c with D the torque that dv_x/dt and drag take; c holds rolling resistance.
    With `has_factor` one factor was found that puts T right as a whole. The shares then have to differ by more
    than the tolerance, too.
    """
    needed = checks.torque_needed()
    if needed is None:
        return []
    torque, use = checks.k.signal("T"), checks.k.moving & np.isfinite(needed)
    use &= np.isfinite(torque)
    torque, needed = torque[use], needed[use]
    design = np.stack([np.maximum(needed, 0.0), np.minimum(needed, 0.0), np.ones(len(needed))], axis=1)
    rows = min(np.count_nonzero(needed > 0.0), np.count_nonzero(needed < 0.0))
    if rows < _LEAST_ROWS or has_dependent_columns(design):
        return []
    shares, errors = (values[:2] for values in fit_linear(design, torque))
    within = np.exp(TORQUE_TOLERANCE)
    beyond = (shares + _SURE * errors < 1.0 / within) | (shares - _SURE * errors > within)
    one_will_do = has_factor and shares.min() * within > shares.max()
    if not beyond.any() or one_will_do or abs(shares[0] - shares[1]) < _SURE * np.hypot(*errors):
        return []
    driving, braking = (f"{s:.2f} +- {max(e, 0.01):.2f}" for s, e in zip(shares, errors, strict=True))
    text = (
        f"T is {driving} times the torque that dv_x/dt takes where the car is driven, and {braking} times where "
        "it is braked. The brakes or the other axle are missing from it, or counted twice. Correct its `sum:` in "
        "the map, or leave T out and pass `--derive torque-from-acceleration`."
    )
    worst = int(np.argmax(beyond))
    return [ConsistencyFinding("scale", "T", text, float(shares[worst]), float(errors[worst]))]
