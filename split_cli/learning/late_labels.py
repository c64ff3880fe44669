"""Labels of v_x while a late torque is on its way: how much of them is no function of the features."""

from dataclasses import replace

import numpy as np
from scipy.linalg import solve

from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet

#: Labels that are looked at together [1]: 25 s of driving. Of 200, 500 and 2,000, errors on other drives differ by 1 %
#: and time goes with the square: docs/decisions/0032.
_TOGETHER = 500
_TORQUE = "torque_ratio"


def freed_of_late_torque(training_set: TrainingSet, labels: Labels) -> Labels:
    """Return labels less what the torque's lag may have got wrong of v_x, where training found a lag.

    Parameters
    ----------
    training_set : TrainingSet
        Whose kernel and lag count; its points do not, so labels of a drive do not depend on what was learned before.
    labels : Labels
        Of the set's vehicle. They come back as they are where the set found no lag, or has no torque in its features.

    Notes
    -----
    With the lag tau of a force F/m, a force that changes at the rate j [m/s^3] is tau j short of its command. What
    a real torque's path differs from that lag (a limit of its rate, another shape) is of the same kind and, taken
    carefully, of the same size: a label holds y = f(z) + g + noise with g of variance (tau j)^2. f is the process
    of the set, g independent from label to label. The posterior mean of g is D A^-1 y, with A = K + N + D and D
    the variances of g, and y - D A^-1 y = (K + N) A^-1 y. The process with the noise N alone has of these labels
    the mean K (K + N)^-1 (K + N) A^-1 y = K A^-1 y: that of f beside g. Nothing that learns or predicts need know D.
    """
    lag = next((effect.parameters["tau"] for effect in training_set.found if effect.term == "drive_lag"), None)
    if (
        lag is None
        or _TORQUE not in training_set.features.names
        or labels.features.names != training_set.features.names
    ):
        return labels
    usable = np.flatnonzero(labels.accepted & np.isfinite(labels.y).all(axis=1))
    if not len(usable):
        return labels
    column = training_set.features.names.index(_TORQUE)
    vehicle, kernel = training_set.vehicle, training_set.kernel
    force = labels.z[:, column] * vehicle.max_torque / (vehicle.mass * vehicle.wheel_radius)
    unknown = np.square(lag * force_rate(labels, force))
    freed = labels.y.copy()
    parts = -(-len(usable) // _TOGETHER)
    for rows in np.array_split(usable, parts):
        among = kernel.signal_variance[0] * kernel.correlation(labels.z[rows], labels.z[rows])
        among[np.diag_indices(len(rows))] += kernel.noise_variance[0] + unknown[rows]
        freed[rows, 0] -= unknown[rows] * solve(among, labels.y[rows, 0], assume_a="pos")
    return replace(labels, y=freed)


def force_rate(labels: Labels, force: np.ndarray) -> np.ndarray:
    """Return the rate of change of a force over mass [m/s^3] along labels, shape (N,), 0 for a lone label.

    Parameters
    ----------
    force : ndarray, shape (N,)
        At the starts of the labels [m/s^2].

    Notes
    -----
    From a start to the next one, where that is at most an interval away; the last of a run has the rate before it.
    """
    rate = np.zeros(len(force))
    if len(force) < 2:
        return rate
    step = np.diff(labels.row)
    follows = (step > 0) & (step <= labels.window) & (np.diff(labels.segment) == 0)
    seconds = np.where(follows, step, 1) * labels.horizon / labels.window
    rate[:-1] = np.where(follows, np.diff(force) / seconds, 0.0)
    last = np.append(~follows, True)
    last[1:] &= follows
    last[0] = False
    rate[last] = rate[np.flatnonzero(last) - 1]
    return rate
