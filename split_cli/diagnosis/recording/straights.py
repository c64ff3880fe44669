"""The steer angle on straights: steering off centre, found by symmetry and without a tyre model.

A symmetric car needs the mirrored steer angle for a mirrored turn, and none to drive straight, whatever its axles,
tyres and inertias are. So the model-form error of a symmetric car does not change the steer angle on straights. A
banked road does: the tyres hold the car as in a turn of that lateral acceleration.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.measured import measures
from split_cli.diagnosis.recording.series import Series
from split_cli.vehicle.effects.instruments import CROSSFALL
from split_cli.vehicle.parameters import Vehicle

_BLOCK_SECONDS = 2.0  # length of blocks of time for the standard error; longer than transients
_FEWEST_BLOCKS = 6  # twice the parameters: fewer give no standard error


@dataclass(frozen=True)
class Straight:
    """Steer angle at which a car drives straight, from its recordings."""

    angle: float  # recorded steer angle [rad]
    error: float  # its standard error [rad]
    gradient: float  # understeer gradient K: steer angle per lateral acceleration [rad s^2/m]
    lean: float  # largest lateral specific force that the bank of the road may cause, to either side [m/s^2]

    @property
    def by_road(self) -> float:
        """Largest steer angle that the bank of the road may require [rad]."""
        return abs(self.gradient) * self.lean


def angle_of_straights(
    several: Sequence[Series], vehicle: Vehicle, rules: Screening = STANDARD.screening
) -> Straight | None:
    """Return the recorded steer angle at which a car goes straight.

    Returns
    -------
    Straight or None
        None with too little gentle driving, or where the steer angle does not follow the turns, as a held one.

    Notes
    -----
    In gentle turns delta = a + b r/v_x + c v_x r, by least squares. Of a steady-state single track b is the wheelbase
    and c the understeer gradient; a is zero for a symmetric car. Its standard error is the sandwich estimate over
    blocks of time (Liang and Zeger, 1986). A road with the bank phi requires c g sin(phi) more (Rajamani, 2012,
    equation 2.31, for the steady-state single track). An accelerometer measures that as the mean of a_y - v_x r.
    Without one a usual crossfall is allowed for.
    """
    grip = vehicle.lateral_grip
    columns, angles, blocks, felt = [], [], [], []
    for number, one in enumerate(several):
        v_x, _, r = one.smooth.T
        gentle = (v_x > vehicle.minimum_speed) & (np.abs(v_x * r) < rules.gentle_to * grip)
        v_x, r = v_x[gentle], r[gentle]
        if measures(one.drive, "ay"):
            felt.append(one.accelerations(())["ay"][gentle] - v_x * r)
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
    # A held steer angle says nothing of straights, nor does one that does not follow turns of this wheelbase.
    followed = float(weights[1] / scale[1]) / vehicle.wheelbase
    if not 1.0 / rules.another_steering < followed < rules.another_steering:
        return None
    angle, _, gradient = (weights / scale).tolist()
    lean = abs(float(np.mean(np.concatenate(felt)))) if len(felt) == len(several) else CROSSFALL
    return Straight(angle, float(error / scale[0]), gradient, lean)
