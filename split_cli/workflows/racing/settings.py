"""Settings of a race."""

from dataclasses import dataclass
from pathlib import Path as FilePath

from split_cli.control.limits import Limits
from split_cli.control.mpcc import MpccSettings
from split_cli.control.policy import RACE_P_LONG, SHARE_LEARNED
from split_cli.learning.features import FeatureSet

LEARNERS = ("none", "iol", "split")

AUTO = "auto"

CANDIDATES = ("z2", "z2,feature_lag")
"""What features a race tries on held-out blocks of lap 0: those of the paper, and the recent past beside them."""

LEARNING = MpccSettings(limits=Limits(p_long=RACE_P_LONG, p_ellipse=SHARE_LEARNED, guarded=True))
"""How a race is driven: one setting for all tracks and models, but for the share of the peak (`first_share`)."""


@dataclass(frozen=True)
class RaceSettings:
    """What to drive."""

    track: str = "small"  # name of a track, or a centre-line CSV
    car: str = "road_car"  # the car of the plant
    laps: int = 3  # after lap 0, which the nominal model drives
    learner: str = "split"  # none, iol or split
    # What is known before, a set or the folder of its export; lap 0 is left out then.
    start_set: str | FilePath | None = None
    max_speed: float = 30.0  # [m/s]
    max_torque: float | None = None  # cap of the driving torque [N m]; by default what the vehicle file says
    grip: float = 1.0  # friction of the road against the tyres' own peak [1]
    seed: int = 0  # of the sensors' noise
    exact_sensors: bool = False
    delay: bool = True  # whether a command takes effect one interval after the measurement it follows from
    features: str = AUTO  # inputs of the correction; ``auto`` chooses one of `CANDIDATES` after lap 0
    # Evaluates the set; ``bcm`` and ``projected`` follow every update of a learner, others are built anew after
    # each lap. ``auto`` is ``bcm`` for three features, ``projected`` for more.
    predictor: str = AUTO
    hyperparameters: str = "fit"  # ``fit`` (to lap 0), ``default``, or a kernel's YAML
    width: float | None = None  # of the car's body [m]
    # Count updates of the dictionary as costly as the papers print them; see `IolLearner`.
    printed_iol: bool = True
    # Kept from the car's side to the border [m]; by default `MARGIN`, in proportion to the car's wheelbase.
    margin: float | None = None
    # By how much more than the margin the borders are moved in until a lap has shown how far plan and drive part
    # [m]; by default `FIRST_DEVIATION`, in proportion to the car's wheelbase. After each lap it is what the lap
    # needed, and no less than a share of what it was.
    deviation: float | None = None
    # Whether a deviation that no lap needed falls with the learned model's error, too, and not by a fifth alone.
    margin_by_error: bool = True
    tightening: float = 0.0  # standard deviations by which the borders are moved in [1]
    settings: MpccSettings = LEARNING  # its margin and its largest speed are those named above
    # Share of the peak that run-up and lap 0 may use with the nominal model [1]; by default `first_share` of the
    # vehicle file. Each clean lap lets the next one use `SHARE_STEP` more: up to `nominal_share` without a
    # learner, and up to the share of `settings` with one.
    first_share: float | None = None
    assumed_friction: float = 1.0  # what the slip limits take for the road's grip before anything is learned [1]
    # Whether a learner moves the slip limits to the peaks that its labels tell; see `learned_grip`.
    learn_grip: bool = True

    @property
    def candidates(self) -> tuple[str, ...]:
        """Feature sets among which lap 0 chooses; the last one has the most features."""
        if self.features != AUTO:
            return (self.features,)
        # A kernel's file belongs to one set of features, and a table has three.
        free = self.learner != "none" and self.hyperparameters in ("fit", "default") and self.predictor != "table"
        return CANDIDATES if free else CANDIDATES[:1]


def predictor_for(asked: str, features: FeatureSet) -> str:
    """Return the name of what evaluates a set over `features`: the one asked for, or what ``auto`` stands for.

    Notes
    -----
    A committee's cells take each other for independent; the more features, the fewer points a cell has and the
    more that costs (docs/decisions/0034).
    """
    if asked != AUTO:
        return asked
    return "bcm" if len(features.names) <= 3 else "projected"
