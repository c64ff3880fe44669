"""A set on a drive with its running trust: at every row, the share that the driving before it supports."""

import numpy as np

from split_cli.learning.labels import Labels, inputs_along
from split_cli.learning.pieces import pieces
from split_cli.learning.running_trust import RunningTrust
from split_cli.prediction import Prediction, Predictor
from split_cli.prediction.trusted import TrustedPredictor, untrusted
from split_cli.scoring.evaluation import HeldOutSamples
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import Windows

#: Of central differences [m/s, m/s, rad/s]: truncation and rounding are both below 1e-6.
_APART = 1e-4


class FollowedPredictor(Predictor):
    """A predictor on one drive, trusted at each row as far as its held-out rows until then support.

    Parameters
    ----------
    predictor : Predictor
        Its set holds the stored trust, which the running one never exceeds.
    held : HeldOutSamples
        The drive as the model of the set labels it. Only its test samples count: on the others the set learned.
    tested : Labels
        These samples, as `labels_left` returns them for the predictor.
    """

    def __init__(self, predictor: Predictor, held: HeldOutSamples, tested: Labels) -> None:
        super().__init__(predictor.training_set)
        self.inner, self.name = untrusted(predictor), predictor.name
        self._known, self._shares = _shares_along(self.inner, held, tested)

    def shares(self, rows: np.ndarray) -> np.ndarray:
        """Return the running trust at rows of the drive, (N, 3); the stored one until its first interval ends."""
        last = np.searchsorted(self._known, rows, side="right") - 1
        found: np.ndarray = self._shares[last]
        return found

    def beginning(self, rows: np.ndarray) -> TrustedPredictor:
        """Return what answers queries of as many predictions as there are rows, each begun at its row."""
        return TrustedPredictor(self.inner, self.shares(rows))

    def knowledge(self, z: np.ndarray) -> np.ndarray:
        """Return how much the set knows at queries, shape (N,), which does not depend on what was driven."""
        return self.inner.knowledge(z)

    def predict(self, z: np.ndarray) -> Prediction:
        """Refuse: a query alone does not determine what was driven before it."""
        raise TypeError("a running trust needs the row of the drive: ask `beginning`")

    def jacobian(self, z: np.ndarray) -> np.ndarray:
        """Refuse, as `predict` does."""
        raise TypeError("a running trust needs the row of the drive: ask `beginning`")


def _transition(model: SingleTrack, windows: Windows, velocity: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Return the derivative of the nominal step by the velocities, shape (N, 3, 3), by central differences.

    Not exp(A h): while a slow car is steered, A itself changes within the interval, by a half and more.
    """
    columns = []
    for moved in _APART * np.eye(3):
        ends = [windows.predict(model, velocity + side * moved, jacobian) for side in (1.0, -1.0)]
        columns.append((ends[0] - ends[1]) / (2.0 * _APART))
    return np.stack(columns, axis=2)


def _shares_along(inner: Predictor, held: HeldOutSamples, labels: Labels) -> tuple[np.ndarray, np.ndarray]:
    """Return rows of the drive, ascending, and the shares that are known from each of them on, (N, 3)."""
    trust = RunningTrust(inner.training_set.trust.share, labels.horizon)
    known = labels.row + labels.window
    shares = np.tile(trust.share, (len(labels) + 1, 1))  # the last is for no row
    model, driven_to = SingleTrack(inner.training_set.vehicle), -1
    for span, piece in pieces(model, held.drive, labels.row, labels.window):
        rows = labels.row[span] - piece.first
        velocity = np.stack([piece.drive[name][rows] for name in ("vx", "vy", "r")], axis=1)
        z = held.z[labels.row[span]]
        windows = inputs_along(model, piece.drive, piece.recording).windows(rows, labels.window)
        if model.asks_knowledge:
            mean, share = inner.mean_and_knowledge(z)
            windows = windows.knowing(share)
        else:
            mean = inner.mean(z)
        jacobian = windows.jacobian(model, velocity)
        held_for = labels.horizon * windows.phi(model, velocity, jacobian, labels.horizon)
        transition = _transition(model, windows, velocity, jacobian)
        rate = labels.y[span][:, :, None]
        innovation = (labels.horizon * rate if labels.plain else held_for @ rate)[:, :, 0]
        response = held_for * mean[:, None, :]
        for k in range(len(rows)):
            row = int(labels.row[span][k])
            if row != driven_to:
                trust.interrupt()
            driven_to = row + labels.window
            shares[span.start + k] = trust.observe(transition[k], innovation[k], response[k])
    return known, shares
