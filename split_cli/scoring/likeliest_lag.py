"""First-order lag of an input, found together with the correction that would stand in for it.

The labels alone may not show it: in hard bends what the tyres' curve gets wrong goes with ddelta/dt as well, and is
the larger part. So each time constant is judged by what it leaves to the correction to explain.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import minimize_scalar

from split_cli.learning.hyperparameters import FEWEST_TO_FIT, MOST_TO_FIT, likelihood_blocks, negative_log_likelihood
from split_cli.learning.labels import nominal_errors
from split_cli.learning.training_set import TrainingSet
from split_cli.scoring.evidence import TrainingDrive
from split_cli.scoring.late_inputs import CLEAR
from split_cli.scoring.torque_lag import lagging, may_show_a_lag
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.vehicle.single_track import SingleTrack

#: Time constants that are tried first [s]: from a quarter of a label's usual interval to the slowest actuator of a
#: road car, as in `late_inputs`, each twice the one before.
_TRIED = 0.0125 * 2.0 ** np.arange(6)
_ACCURACY = 5e-4  # [s]; judgement: what a front wheel turns in this time is within the noise of any sensor


def likeliest_lag(drives: Sequence[TrainingDrive], empty: TrainingSet, channel: str) -> Vehicle | None:
    """Return the vehicle with the lag of an input that explains the labels best, or None where none does clearly.

    Parameters
    ----------
    drives : sequence of TrainingDrive
        With labels of the set's vehicle.
    empty : TrainingSet
        Whose vehicle, grid and kernel count.
    channel : str
        The input: ``T`` or ``delta``.

    Returns
    -------
    Vehicle or None
        With ``drive_lag``, of the force along the car, or ``steer_lag``, which acts as far as a set knows, as its last
        effect. None where the input is no
        command, the file has an effect that delays it, or no lag is four standard errors from none.

    Notes
    -----
    With the time constant tau the model leaves the labels y(tau) at the features z(tau). With a lag of the steering
    their slip angle is that of the wheel that has turned. tau maximises the likelihood of y(tau) as a Gaussian
    process over z(tau) with the set's kernel: of what is left, a function of the features costs little, and what is
    none costs as noise does. All three outputs count, in the blocks of neighbouring cells that `fit_kernel` takes.
    Whether the lag is used is decided on held-out blocks, against the file without it.
    """
    if not drives or not may_show_a_lag(drives, empty.vehicle, channel):
        return None
    inside = [part.labels.inside(empty.grid) for part in drives]
    parts = [labels.take(labels.accepted) for labels in inside]
    count = sum(len(labels) for labels in parts)
    if count < FEWEST_TO_FIT:
        return None
    stride = -(-count // MOST_TO_FIT)
    parts = [labels.take(slice(None, None, stride)) for labels in parts]
    rows = [labels.row for labels in parts]
    z = np.concatenate([labels.z for labels in parts])
    blocks = likelihood_blocks(z, empty.grid)

    def cost(tau: float) -> float:
        model = SingleTrack(_LAGGING[channel](empty.vehicle, tau) if tau else empty.vehicle)
        z, y = [], []
        for part, these in zip(drives, rows, strict=True):
            how = part.labels
            y.append(nominal_errors(model, part.drive, these, how.window, plain=how.plain))
            z.append(empty.features.compute(model, part.drive)[these])
        return negative_log_likelihood(np.concatenate(z), np.concatenate(y), empty.kernel, blocks)

    tried = np.array([cost(tau) for tau in _TRIED])
    start = _TRIED[int(np.argmin(tried))]
    best = minimize_scalar(cost, bounds=(0.5 * start, 2.0 * start), method="bounded", options={"xatol": _ACCURACY})
    # Twice the gain of the log likelihood is the square of standard errors where it is quadratic (Wilks).
    clear = 2.0 * (cost(0.0) - best.fun) > CLEAR**2
    return _LAGGING[channel](empty.vehicle, round(float(best.x), 4)) if clear else None


def with_steer_lag(vehicle: Vehicle, tau: float) -> Vehicle:
    """Return a vehicle whose steer angle follows its command with the time constant `tau` [s], where a set knows."""
    return vehicle.with_effects(EffectSpec("steer_lag", {"tau": tau}, "learned"))


#: A vehicle whose input follows its command with a time constant [s], by channel.
_LAGGING = {"T": lagging, "delta": with_steer_lag}
