"""What an evaluation reports, as dataclasses that print as JSON with these names as keys."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from split_cli.learning.kernel import Kernel
from split_cli.learning.trust import Trust
from split_cli.prediction import DEFAULT_PREDICTOR
from split_cli.scoring.evaluation import Score
from split_cli.scoring.noise import NoiseFloor
from split_cli.scoring.verdict import Comparison
from split_cli.vehicle.parameters import EffectSpec

__all__ = [
    "EVALUATION_FORMAT",
    "DriveFacts",
    "Evaluation",
    "EvaluationSettings",
    "IntervalShares",
    "RolloutScore",
    "SetFacts",
    "SizeScore",
]

EVALUATION_FORMAT = "split-evaluation/1"


@dataclass(frozen=True)
class EvaluationSettings:
    """What was asked for; the defaults are the same for every car and recording.

    Attributes
    ----------
    protocol : {"held-out", "paper"}
        Held-out blocks of time, or the SPLIT paper's in-sample comparison on one lap.
    sizes : tuple of int
        Sizes of the feature comparison; 0 is all training samples.
    guard : float
        [s]
    rollout : tuple of float
        Horizons of the multi-step predictions [s].
    horizon : float
        Label interval h [s].
    trust : {"held-out", "full"}
        How far sets trained here are believed; a set of a file brings its own trust.
    any_vehicle : bool
        Score drives that contradict the vehicle all the same, with a warning.
    held : tuple of str
        Inputs that keep their value between samples, whatever the files say.
    """

    protocol: str = "held-out"
    predictors: tuple[str, ...] = ("bcm", DEFAULT_PREDICTOR)
    features: tuple[str, ...] = ("z2",)
    sizes: tuple[int, ...] = ()
    blocks: int = 10
    holdout: float = 0.3
    guard: float = 1.0
    rollout: tuple[float, ...] = (0.5, 1.0, 2.0)
    horizon: float = 0.05
    trust: str = "held-out"
    any_vehicle: bool = False
    held: tuple[str, ...] = ()


@dataclass(frozen=True)
class DriveFacts:
    """One drive of an evaluation.

    Attributes
    ----------
    duration : float
        [s]
    labels, tested, tested_valid : int
        Labels, test samples, and those inside the valid region.
    in_sample : bool
        Whether the set was trained on this very file.
    held_out : tuple of (float, float)
        Time intervals that test [s].
    noise_floor : NoiseFloor
        Of the labels, over the test samples.
    """

    name: str
    sha256: str
    duration: float
    labels: int
    tested: int
    tested_valid: int
    in_sample: bool
    held_out: tuple[tuple[float, float], ...]
    noise_floor: NoiseFloor
    notes: tuple[str, ...]


@dataclass(frozen=True)
class SetFacts:
    """A trained set that was scored: its features, points, cells, kernel, trust, and effects found in training."""

    features: str
    points: int
    cells: int
    kernel: Kernel
    trust: Trust
    found: tuple[EffectSpec, ...] = ()


@dataclass(frozen=True)
class SizeScore:
    """A dense process on the most informative samples of a feature set.

    Attributes
    ----------
    size : int
        Asked for; 0 is all. The true size is ``score.points``.
    """

    size: int
    score: Score


@dataclass(frozen=True)
class RolloutScore:
    """Multi-step prediction at one horizon, pooled over drives.

    Attributes
    ----------
    horizon : float
        [s]
    starts, diverged : int
        Start points, and those left out since some model left the finite numbers.
    rmse : ndarray, shape (3,)
        v_x, v_y [m/s], r [rad/s].
    distance : float
        Position [m]; NaN without a recorded position.
    """

    name: str
    features: str
    horizon: float
    starts: int
    diverged: int
    rmse: np.ndarray
    distance: float


@dataclass(frozen=True)
class IntervalShares:
    """What the intervals of one predictor held, near the points of its set or beyond, pooled over drives.

    Attributes
    ----------
    name, features : str
        Of the predictor.
    near : bool
        Whether these samples lie within a length scale of a point (`belonging.near_points`).
    share : float
        Of all test samples [1].
    coverage_50, coverage_90, coverage_95 : ndarray, shape (3,)
        Observed share of labels inside the central intervals, of v_x, v_y and r [1].
    """

    name: str
    features: str
    near: bool
    samples: int
    share: float
    coverage_50: np.ndarray
    coverage_90: np.ndarray
    coverage_95: np.ndarray


@dataclass(frozen=True)
class Evaluation:
    """The result of `split evaluate`.

    Attributes
    ----------
    scores : tuple of Score
        Pooled over drives first, then drive by drive when there are several.
    noise_floor : NoiseFloor
        Pooled over drives.
    comparisons : tuple of Comparison
        Corrected beside nominal and persistence, by state and horizon, with intervals.
    verdicts : tuple of str
        One sentence a predictor and feature set.
    intervals : tuple of IntervalShares
        What the intervals of each predictor held near the points of its set and beyond.
    notes : tuple of str
        What the reader must know: recorded future used, in-sample scores, what could not be computed.
    """

    settings: EvaluationSettings
    vehicle: str
    drives: tuple[DriveFacts, ...]
    sets: tuple[SetFacts, ...]
    scores: tuple[Score, ...]
    noise_floor: NoiseFloor
    rollouts: tuple[RolloutScore, ...]
    sizes: tuple[SizeScore, ...]
    comparisons: tuple[Comparison, ...]
    verdicts: tuple[str, ...]
    intervals: tuple[IntervalShares, ...]
    notes: tuple[str, ...]
    format: str = EVALUATION_FORMAT
