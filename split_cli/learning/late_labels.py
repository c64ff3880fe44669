"""Labels while a late torque is on its way: how much of them is no function of the features."""

from dataclasses import replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet

#: Labels that are looked at together [1]: 25 s of driving. Of 200, 500 and 2,000, errors on other drives differ by 1 %
#: and time goes with the square: docs/decisions/0032.
_TOGETHER = 500
_TORQUE = "torque_ratio"


def freed_of_late_torque(training_set: TrainingSet, labels: Labels) -> Labels:
    """Return labels less what a late torque may have got wrong of them, where training found a lag of the torque.

    Parameters
    ----------
    training_set : TrainingSet
        Whose kernel and lag count; its points do not, so labels of a drive do not depend on what was learned before.
    labels : Labels
        Of the set's vehicle. They come back as they are where the set found no lag, or has no torque in its features.

    Notes
    -----
    A label holds y = f(z) + g + noise. f is the process of the set, and g is independent from label to label with the
    variances of `unknown_variance`. The posterior mean of g is D A^-1 y, with A = K + N + D and D the variances of
    g, and y - D A^-1 y = (K + N) A^-1 y. The process with the noise N alone has of these labels the mean
    K (K + N)^-1 (K + N) A^-1 y = K A^-1 y: that of f beside g. Nothing that learns or predicts need know D.
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
    kernel, unknown = training_set.kernel, unknown_variance(training_set, labels, lag)
    freed = labels.y.copy()
    parts = -(-len(usable) // _TOGETHER)
    for rows in np.array_split(usable, parts):
        correlation = kernel.correlation(labels.z[rows], labels.z[rows])
        for output in range(freed.shape[1]):
            among = kernel.signal_variance[output] * correlation
            among[np.diag_indices(len(rows))] += kernel.noise_variance[output] + unknown[rows, output]
            # Not `solve`: the condition that it estimates takes as long as the factor. Transposed: no copy is made.
            factor = cho_factor(among.T, lower=True, overwrite_a=True, check_finite=False)
            freed[rows, output] -= unknown[rows, output] * cho_solve(factor, labels.y[rows, output], check_finite=False)
    return replace(labels, y=freed)


def unknown_variance(training_set: TrainingSet, labels: Labels, lag: float) -> np.ndarray:
    """Return the variance of what a late torque may have got wrong of labels, shape (N, 3), in squared label units.

    Parameters
    ----------
    lag : float
        Time constant tau of the torque [s].

    Notes
    -----
    v_x: a force over mass that changes at the rate j [m/s^3] is tau j short of its command. What a real torque's
    path differs from that lag (a limit of its rate, another shape) is taken to be of the same size, (tau j)^2.

    v_y and r: z holds the torque u that was asked for, and the tyres had another, tau du/dt away. So f is evaluated
    that far off, and errs by tau du/dt df/du. The slope df/du of a process with the squared exponential kernel has
    the variance S/l^2, with the signal variance S and the length scale l of u. McHutchon and Rasmussen, Gaussian
    process training with input noise (2011), take noise of an input to first order so.
    """
    column = training_set.features.names.index(_TORQUE)
    vehicle, kernel = training_set.vehicle, training_set.kernel
    force = labels.z[:, column] * vehicle.max_torque / (vehicle.mass * vehicle.wheel_radius)
    behind = lag * rate_along(labels, labels.z[:, column]) / kernel.length_scales[column]
    lateral = np.square(behind)[:, None] * kernel.signal_variance[1:]
    return np.column_stack([np.square(lag * rate_along(labels, force)), lateral])


def rate_along(labels: Labels, values: np.ndarray) -> np.ndarray:
    """Return the rate of change of what labels have at their starts, shape (N,), 0 for a lone label.

    Parameters
    ----------
    values : ndarray, shape (N,)
        At the starts of the labels, for example a force over mass [m/s^2], whose rate is then in m/s^3.

    Notes
    -----
    From a start to the next one, where that is at most an interval away; the last of a run has the rate before it.
    """
    rate = np.zeros(len(values))
    if len(values) < 2:
        return rate
    step = np.diff(labels.row)
    follows = (step > 0) & (step <= labels.window) & (np.diff(labels.segment) == 0)
    seconds = np.where(follows, step, 1) * labels.horizon / labels.window
    rate[:-1] = np.where(follows, np.diff(values) / seconds, 0.0)
    last = np.append(~follows, True)
    last[1:] &= follows
    last[0] = False
    rate[last] = rate[np.flatnonzero(last) - 1]
    return rate
