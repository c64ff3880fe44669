"""The steer angle at which a car goes straight: steering off centre, told by symmetry and by no model of tyres.

A car is as strong to the left as to the right. Whatever its axles, tyres and inertias are, a mirrored turn takes
the mirrored steer angle, and going straight takes none. So model-form error of a symmetric car moves no straight.
"""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.parameters import Vehicle

_BLOCK_SECONDS = 2.0  # over which rows count as one; longer than transients
_FEWEST_BLOCKS = 6  # twice the parameters: fewer tell no error


def angle_of_straights(
    several: Sequence[Series], vehicle: Vehicle, rules: Screening = STANDARD.screening
) -> tuple[float, float] | None:
    """Return the recorded steer angle at which a car goes straight, and its standard error [rad].

    Returns
    -------
    tuple of float or None
        None where too little was driven gently, or where the angle does not follow the turns, as a held one.

    Notes
    -----
    In gentle turns delta = a + b r/v_x + c v_x r, with b the wheelbase and c the understeer gradient of a
    steady-state single track, all three by least squares: a is what no symmetric car has. Its error is the
    sandwich's, from scores block by block (Liang and Zeger, 1986).
    """
    grip = (vehicle.front_tire.D + vehicle.rear_tire.D) / vehicle.mass
    columns, angles, blocks = [], [], []
    for number, one in enumerate(several):
        v_x, _, r = one.smooth.T
        gentle = (v_x > vehicle.minimum_speed) & (np.abs(v_x * r) < rules.gentle_to * grip)
        v_x, r = v_x[gentle], r[gentle]
        columns.append(np.stack([np.ones_like(r), r / v_x, v_x * r], axis=1))
        angles.append(one.steer_angle[gentle])
        blocks.append(np.stack([np.full(len(r), number), one.t[gentle] // _BLOCK_SECONDS], axis=1))
    table, angle = np.concatenate(columns), np.concatenate(angles)
    if len(angle) < rules.fewest_rows:
        return None
    scale = np.sqrt(np.mean(table**2, axis=0)) + 1e-300
    table = table / scale
    weights, _, rank, _ = np.linalg.lstsq(table, angle, rcond=1e-6)
    block = np.unique(np.concatenate(blocks), axis=0, return_inverse=True)[1].ravel()
    if rank < 3 or block.max() + 1 < _FEWEST_BLOCKS:
        return None
    scores = np.zeros((block.max() + 1, 3))
    np.add.at(scores, block, table * (angle - table @ weights)[:, None])
    inverse = np.linalg.inv(table.T @ table)
    error = np.sqrt((inverse @ scores.T @ scores @ inverse)[0, 0])
    # A steer angle that is held tells of no straight, nor one that follows no turn of this wheelbase.
    followed = float(weights[1] / scale[1]) / vehicle.wheelbase
    if not 1.0 / rules.another_steering < followed < rules.another_steering:
        return None
    return float(weights[0] / scale[0]), float(error / scale[0])
