"""How trust and doubt change mean and variance of a trained set's predictions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from split_cli.learning.kernel import OUTPUTS

#: What the outputs of a set correct, in their order.
STATES = ("v_x", "v_y", "r")
ORIGINS = ("full", "given", "held-out", "unjudged")


def kept_share(share: np.ndarray, doubt: np.ndarray, signal_variance: np.ndarray) -> np.ndarray:
    """Return the share a of the process's variance that counts beside the doubt, shape of `share`; see `Trust`."""
    kept: np.ndarray = np.maximum(np.square(share), 1.0 - doubt / signal_variance)
    return kept


def supported_variance(share: np.ndarray, doubt: np.ndarray, signal_variance: np.ndarray) -> np.ndarray:
    """Return the believed variance up to which labels support an interval, shape (3,).

    Parameters
    ----------
    share, doubt, signal_variance : ndarray, shape (3,)
        As of `kept_share`.

    Notes
    -----
    a (1 - 1/e) S0 + w: data then explain at least the share 1/e of the prior's variance, as a single exact label
    at the distance of a length scale does. Beyond, an interval is mostly the size that the residual had in the
    training drives, and no label says whether it still has it. Where a is 0 the variance is w everywhere and says
    nothing of the data.
    """
    open_share = 1.0 - np.exp(-1.0)
    supported: np.ndarray = kept_share(share, doubt, signal_variance) * open_share * signal_variance + doubt
    return supported


@dataclass(frozen=True)
class Trust:
    """The share of the learned correction that is applied, an output each.

    Notes
    -----
    With m and v the mean and the latent variance of the process, what is believed is tau m, with the variance
    a v + w. The doubt w is what held-out driving shows to be missing, different driving included. It was measured
    where there are data; beyond them the prior's variance S0 must return, however little the mean is trusted. So a
    is 1 - w/S0, and at least tau^2, the share of the variance that the mean believed has. Where w was not measured
    it is (1 - tau^2) S0, and a is tau^2: the residual is then taken as tau times the learned one plus
    sqrt(1 - tau^2) times another draw from the prior.
    """

    # Of v_x', v_y' and r'; 1 applies the whole correction, 0 leaves the nominal model as it is.
    share: tuple[float, float, float]
    # {"full", "given", "held-out", "unjudged"} ``held-out``: found on held-out blocks of the training drives.
    # ``unjudged``: the drives are too short for that, and no correction is applied.
    origin: str = "full"
    blocks: int = 0  # held-out blocks of time that the share was found on
    # Variance of what remains wrong beyond the process's own and the label noise, measured on held-out blocks
    # [m^2/s^4, m^2/s^4, rad^2/s^4]; None where it was not measured.
    doubt: tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        share = tuple(float(value) for value in self.share)
        if len(share) != len(OUTPUTS) or not all(0.0 <= value <= 1.0 for value in share):
            raise ValueError(f"trust is {self.share}, three numbers from 0 to 1 were expected")
        if self.origin not in ORIGINS:
            raise ValueError(f"the origin of trust is {self.origin!r}, one of {', '.join(ORIGINS)} was expected")
        object.__setattr__(self, "share", share)
        if self.doubt is not None:
            doubt = tuple(float(value) for value in self.doubt)
            if len(doubt) != len(OUTPUTS) or not all(0.0 <= value < np.inf for value in doubt):
                raise ValueError(f"the doubt is {self.doubt}, three variances were expected")
            object.__setattr__(self, "doubt", doubt)

    @classmethod
    def full(cls) -> Trust:
        """Return the trust of the plain method: every correction is applied whole."""
        return cls((1.0, 1.0, 1.0))

    @property
    def array(self) -> np.ndarray:
        """The shares, shape (3,)."""
        return np.array(self.share)

    @property
    def is_full(self) -> bool:
        """Whether every output is trusted fully, so that nothing changes."""
        return self.share == (1.0, 1.0, 1.0) and not any(self.doubt or ())

    def apply(
        self, mean: np.ndarray, variance: np.ndarray, signal_variance: np.ndarray, share: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean and the latent variance that are believed.

        Parameters
        ----------
        mean, variance : ndarray, shape (N, 3)
            Of the process.
        signal_variance : ndarray, shape (3,)
            S0, the prior's.
        share : ndarray, shape (N, 3), optional
            Applied in place of the stored share, with the doubt as it is stored.
        """
        doubts, tau = self.doubts(signal_variance), self.array if share is None else share
        return tau * mean, kept_share(tau, doubts, signal_variance) * variance + doubts

    def doubts(self, signal_variance: np.ndarray) -> np.ndarray:
        """Return the variance w of each output, shape (3,), given the prior's."""
        return np.array(self.doubt) if self.doubt is not None else (1.0 - self.array**2) * signal_variance

    def words(self) -> str:
        """Return the trust for a reader, for example ``v_x 0.52, v_y 0.60, r 1 (found on 20 held-out blocks)``."""
        shares = ", ".join(f"{name} {value:.2g}" for name, value in zip(("v_x", "v_y", "r"), self.share, strict=True))
        how = {
            "full": "the plain method, not judged on held-out driving",
            "given": "as given",
            "held-out": f"found on {self.blocks} held-out blocks of time",
            "unjudged": "the drives are too short to judge it on held-out blocks, so none is applied",
        }
        return f"{shares} ({how[self.origin]})"
