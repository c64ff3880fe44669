"""What an evaluation reports, as dataclasses that print as JSON with these names as keys."""

from dataclasses import dataclass

import numpy as np

from split_cli.errors import SplitError
from split_cli.learning.kernel import Kernel
from split_cli.learning.trust import Trust
from split_cli.prediction import DEFAULT_PREDICTOR, refuse_unknown
from split_cli.scoring.evaluation import Score
from split_cli.scoring.noise import NoiseFloor
from split_cli.scoring.verdict import Comparison
from split_cli.vehicle.parameters import EffectSpec

EVALUATION_FORMAT = "split-evaluation/1"


@dataclass(frozen=True)
class EvaluationSettings:
    """What was asked for; the defaults are the same for every car and recording."""

    # {"held-out", "paper"} Held-out blocks of time, or the SPLIT paper's in-sample comparison on one lap.
    protocol: str = "held-out"
    predictors: tuple[str, ...] = ("bcm", DEFAULT_PREDICTOR)
    features: tuple[str, ...] = ("z2",)
    sizes: tuple[int, ...] = ()  # sizes of the feature comparison; 0 is all training samples
    blocks: int = 10
    holdout: float = 0.3
    guard: float = 1.0  # [s]
    rollout: tuple[float, ...] = (0.5, 1.0, 2.0)  # horizons of the multi-step predictions [s]
    horizon: float = 0.05  # label interval h [s]
    # {"held-out", "full"} How far sets trained here are believed; a set of a file brings its own trust.
    trust: str = "held-out"
    any_vehicle: bool = False  # score drives that contradict the vehicle all the same, with a warning
    held: tuple[str, ...] = ()  # inputs that keep their value between samples, whatever the files say

    def check(self, *, with_set: bool) -> None:
        """Refuse what cannot be asked for, or not beside a trained set.

        Raises
        ------
        SplitError
            If a setting is unknown, empty or not positive, or trains sets of its own `with_set`.
        """
        if not self.features or not self.predictors:
            advice = "Leave out --features or --predictor for the default."
            raise SplitError("no feature set or no predictor was named", advice=advice)
        if any(size < 0 for size in self.sizes) or not all(0 < time < np.inf for time in self.rollout):
            raise SplitError(f"--sizes {self.sizes} or --rollout {self.rollout} holds a number that is not positive")
        for name in self.predictors:
            refuse_unknown(name)
        if self.protocol not in ("held-out", "paper"):
            raise SplitError(f"no protocol {self.protocol!r}", advice="There are held-out and paper.")
        if self.protocol == "paper" and with_set:
            what = "the paper's protocol trains on the lap that it scores, and --set gives a trained set"
            raise SplitError(what, advice="Leave --set out.")
        if self.sizes and with_set:
            what = "--sizes trains sets of its own, and --set gives one"
            raise SplitError(what, advice="Leave --set or --sizes out.")


@dataclass(frozen=True)
class DriveFacts:
    """One drive of an evaluation."""

    name: str
    sha256: str
    duration: float  # [s]
    # labels, tested, tested_valid: labels, test samples, and those inside the valid region.
    labels: int
    tested: int
    tested_valid: int
    in_sample: bool  # whether the set was trained on this very file
    held_out: tuple[tuple[float, float], ...]  # time intervals that test [s]
    noise_floor: NoiseFloor  # of the labels, over the test samples
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
    """A dense process on the most informative samples of a feature set."""

    # Asked for; 0 is all. The true size is ``score.points``.
    size: int
    score: Score


@dataclass(frozen=True)
class RolloutScore:
    """Multi-step prediction at one horizon, pooled over drives."""

    name: str
    features: str
    horizon: float  # [s]
    # starts, diverged: start points, and those left out since some model left the finite numbers.
    starts: int
    diverged: int
    rmse: np.ndarray  # (3,): v_x, v_y [m/s], r [rad/s]
    distance: float  # position [m]; NaN without a recorded position


@dataclass(frozen=True)
class IntervalShares:
    """What the intervals of one predictor held, near the points of its set or beyond, pooled over drives."""

    # name, features: of the predictor.
    name: str
    features: str
    near: bool  # whether these samples lie within a length scale of a point (`vehicle_match.near_points`)
    samples: int
    share: float  # of all test samples [1]
    # coverage_50, coverage_90, coverage_95: (3,): observed share of labels inside the central intervals, of v_x,
    # v_y and r [1].
    coverage_50: np.ndarray
    coverage_90: np.ndarray
    coverage_95: np.ndarray


@dataclass(frozen=True)
class Evaluation:
    """The result of `split evaluate`."""

    settings: EvaluationSettings
    vehicle: str
    drives: tuple[DriveFacts, ...]
    sets: tuple[SetFacts, ...]
    scores: tuple[Score, ...]  # pooled over drives first, then drive by drive when there are several
    noise_floor: NoiseFloor  # pooled over drives
    rollouts: tuple[RolloutScore, ...]
    sizes: tuple[SizeScore, ...]
    # Corrected beside nominal and persistence, by state and horizon, with intervals.
    comparisons: tuple[Comparison, ...]
    verdicts: tuple[str, ...]  # one sentence a predictor and feature set
    # What the intervals of each predictor held near the points of its set and beyond.
    intervals: tuple[IntervalShares, ...]
    # What the reader must know: recorded future used, in-sample scores, what could not be computed.
    notes: tuple[str, ...]
    format: str = EVALUATION_FORMAT
