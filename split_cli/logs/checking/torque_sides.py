"""Whether T is right both driving and braking: without the brakes, or of one axle, it is not."""

import numpy as np

from split_cli.logs.checking.checks import TORQUE_TOLERANCE, Checks
from split_cli.logs.checking.kinematics import fit_linear, has_dependent_columns
from split_cli.logs.checking.relations import ConsistencyFinding

_SURE = 3.0
"""Standard errors by which a share is beyond the tolerance, and the two shares differ [1]; judgement."""
_UNEVEN = 0.2
"""Share of the larger by which the two shares differ where that is told [1]: a wrong mass or wheel radius changes both
alike. Sound recordings show 0.16 at most (simulated cars of this project and of TUM); judgement."""
_DERIVE = "`--derive torque-from-acceleration`"
_LEAST_ROWS = 100
"""Samples of driving, and of braking, that a share is measured on [1]; judgement."""


def torque_sides(checks: Checks, has_factor: bool = False) -> list[ConsistencyFinding]:
    """Compare T with what the motion takes, apart where that drives and where it brakes.

    T = s_d max(D, 0) + s_b min(D, 0) + c + d v_x^2 with D the torque that dv_x/dt and drag take; c and d hold what
    the vehicle file lacks of rolling resistance and drag. With `has_factor` one factor was found that puts T right
    as a whole. The shares then have to differ by more than the tolerance, too. Uneven shares within the tolerance
    are told as well: they may be the car's.
    """
    needed = checks.torque_needed()
    if needed is None:
        return []
    torque, use = checks.k.signal("T"), checks.k.moving & np.isfinite(needed)
    use &= np.isfinite(torque)
    torque, needed = torque[use], needed[use]
    speed = checks.k.signal("vx")[use]
    design = np.stack([np.maximum(needed, 0.0), np.minimum(needed, 0.0), np.ones(len(needed)), speed**2], axis=1)
    rows = min(np.count_nonzero(needed > 0.0), np.count_nonzero(needed < 0.0))
    if rows < _LEAST_ROWS or has_dependent_columns(design):
        return []
    shares, errors = (values[:2] for values in fit_linear(design, torque))
    within = np.exp(TORQUE_TOLERANCE)
    beyond = (shares + _SURE * errors < 1.0 / within) | (shares - _SURE * errors > within)
    one_will_do = has_factor and shares.min() * within > shares.max()
    uneven = abs(shares[0] - shares[1]) - _SURE * np.hypot(*errors) > _UNEVEN * np.abs(shares).max()
    if not uneven or one_will_do:
        return []
    driving, braking = (f"{s:.2f} +- {max(e, 0.01):.2f}" for s, e in zip(shares, errors, strict=True))
    text = (
        f"T is {driving} times the torque that dv_x/dt takes where the car is driven, and {braking} times where "
        "it is braked. The brakes or the other axle are missing from it, or counted twice"
    )
    if beyond.any():
        check, text = "scale", f"{text}. Correct its `sum:` in the map, or leave T out and pass {_DERIVE}."
    else:
        check, text = "uneven", f"{text}, or the car drives or brakes otherwise than T says. Look at its `sum:`."
    worst = int(np.argmax(np.abs(np.log(np.maximum(shares, 1e-3)))))
    return [ConsistencyFinding(check, "T", text, float(shares[worst]), float(errors[worst]))]
