"""Running trust: the share of each correction that the last seconds of driving support, found while driving."""

from collections.abc import Sequence

import numpy as np

#: Over how long errors add up before they fade [s]: the shortest rollout that `split evaluate` judges. One step
#: alone does not show what a small rate does to the velocities later.
SPAN = 0.5
#: Over how long evidence fades [s]: twenty spans, so that a share rests on about ten independent ones.
MEMORY = 10.0
#: Sweeps over the three outputs an interval [1]; each begins where the last interval's ended. Judgement.
SWEEPS = 3
#: Errors beyond this [m/s, rad/s] are no driving and end the evidence as a gap does; theory: exports take speeds up
#: to 150 m/s. The squares of a larger one would outweigh minutes of driving.
MOST_ERROR = 150.0
#: Sums of squares of errors up to this [m^2/s^2, rad^2/s^2] are rounding: nothing is judged relative to them. Theory:
#: the square of some 45 units of rounding (2.2e-16) at 1 m/s, 1 rad/s.
LEAST_SQUARES = 1e-28


class RunningTrust:
    """The share of each correction that recent driving supports, never above the stored trust.

    Parameters
    ----------
    most : sequence of float, shape (3,)
        The stored trust of v_x', v_y' and r' [1].
    interval : float
        Time h between two observations [s].
    span, memory : float
        Time constants of errors and of evidence [s].

    Attributes
    ----------
    share : ndarray, shape (3,)
        What the driving so far supports [1]; `most` before anything was observed.

    Notes
    -----
    The stored trust holds as long as no state's errors, as below, are larger with it than without any correction.
    Otherwise the share is found from the driving alone.

    An observer runs beside the car on the nominal model, pulled towards the measured velocities with the time
    constant `span`. Its error e, and the change D of it by each output's whole correction, follow

        e+ = (A e + w)/(1 + h/span),    D+ = (A D + h Phi diag(g))/(1 + h/span)

    with A the nominal step's derivative by the velocities, w = x(t + h) - f_h(x(t)) and g the correction. So e is
    an open-loop error over the last `span`, and e - D tau is what share tau leaves of it, to first order. The
    share is the least-squares one from 0 to `most`. Squares of each state count relative to those of its own e,
    and all are forgotten with the time constant `memory`. Coordinate descent follows it, a few sweeps an interval.

    What a share tau_j falls short of `most` must be proven: it is multiplied by the positive part of

        1 - (1 - tau_j/most_j) v_j/tau_j^2,    v_j = (2 span/memory) s^2/M_jj

    v_j is its variance: s^2 is the mean square that is left of the errors, relative as above, and M_jj the sum of
    squares of what it changes in them. Errors count as independent after two spans. So a share that driving bears
    out whole stays as it is, and one that noise alone may have made is 0 (after Breiman, Better subset regression
    using the nonnegative garrote, Technometrics 37(4), 1995).

    An interval costs the same time and memory whatever has been driven.
    """

    def __init__(self, most: Sequence[float], interval: float, span: float = SPAN, memory: float = MEMORY) -> None:
        self.most = np.array(most, dtype=float)
        self._kept = 1.0 / (1.0 + interval / span)
        self._remembered = np.exp(-interval / memory)
        self._alone = 2.0 * span / memory  # share of one independent error in all that is remembered
        self._driven = np.zeros((3, 4))  # D and e, a row a state
        self._products = np.zeros((3, 4, 4))  # sums of their products, a state each
        self.share = self.most.copy()

    @property
    def numbers(self) -> np.ndarray:
        """All that it keeps, shape (63,), in the order of the exports: share, errors, their products."""
        return np.concatenate([self.share, self._driven.ravel(), self._products.ravel()])

    @numbers.setter
    def numbers(self, numbers: np.ndarray) -> None:
        self.share, driven, products = np.split(np.array(numbers, dtype=float), [3, 15])
        self._driven, self._products = driven.reshape(3, 4), products.reshape(3, 4, 4)

    def interrupt(self) -> None:
        """Begin errors anew, as after a gap; the evidence and the share stay."""
        self._driven[:] = 0.0

    def observe(self, transition: np.ndarray, innovation: np.ndarray, response: np.ndarray) -> np.ndarray:
        """Take in one interval and return the share, shape (3,).

        Parameters
        ----------
        transition : ndarray, shape (3, 3)
            A: derivative of the nominal step by (v_x, v_y, r).
        innovation : ndarray, shape (3,)
            w: measured less predicted by the nominal step [m/s, m/s, rad/s].
        response : ndarray, shape (3, 3)
            h Phi diag(g): what each output's whole correction adds to each state within the interval.
        """
        added = np.column_stack([response, innovation])
        driven = self._kept * (transition @ self._driven + added)
        if not (np.abs(driven) <= MOST_ERROR).all():  # nor where one is not a number
            self.interrupt()
            return self.share
        self._driven = driven
        self._products *= self._remembered
        self._products += driven[:, :, None] * driven[:, None, :]
        errors = self._products[:, 3, 3]
        beside = self._products[:, 3, :3] * 2.0 - self._products[:, :3, :3] @ self.most
        if (beside @ self.most >= 0.0).all():
            self.share = self.most.copy()
            return self.share
        weight = np.divide(1.0, errors, out=np.zeros(3), where=errors > LEAST_SQUARES)
        normal = np.einsum("s,sij->ij", weight, self._products)
        share = self.share.copy()
        for j in (0, 1, 2) * SWEEPS:
            if normal[j, j] > 0.0:
                left = (normal[j, 3] - normal[j, :3] @ share) / normal[j, j]
                share[j] = min(max(share[j] + left, 0.0), self.most[j])
        self.share = self._proven(share, normal)
        return self.share

    def _proven(self, share: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """Return shares less what the errors that are left may have made of them."""
        left = max(normal[3, 3] + share @ (normal[:3, :3] @ share - 2.0 * normal[:3, 3]), 0.0) / 3.0
        gain = share**2 * normal.diagonal()[:3]
        missing = np.divide(self.most - share, self.most, out=np.zeros(3), where=self.most > 0.0)
        doubt = np.divide(missing * self._alone * left, gain, out=np.ones(3), where=gain > 0.0)
        proven: np.ndarray = share * np.maximum(1.0 - doubt, 0.0)
        return proven
