"""Settings of a race."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath

from split_cli.control.limits import Limits
from split_cli.control.mpcc import MpccSettings
from split_cli.control.policy import RACE_P_LONG, SHARE_LEARNED
from split_cli.learning.features import FeatureSet

__all__ = ["AUTO", "CANDIDATES", "FITS", "LEARNERS", "LEARNING", "RaceSettings", "predictor_for"]

LEARNERS = ("none", "iol", "split")

FITS = ("fit", "fit-lasting")

AUTO = "auto"

CANDIDATES = ("z2", "z2,feature_lag")
"""What features a race tries on held-out blocks of lap 0: those of the paper, and the recent past beside them."""

LEARNING = MpccSettings(limits=Limits(p_long=RACE_P_LONG, p_ellipse=SHARE_LEARNED, guarded=True))
"""How a race is driven: one setting for all tracks and models, but for the share of the peak (`first_share`)."""


@dataclass(frozen=True)
class RaceSettings:
    """What to drive.

    Attributes
    ----------
    track : str
        Name of a track, or a centre-line CSV.
    car : str
        The car of the plant.
    laps : int
        After lap 0, which the nominal model drives.
    learner : str
        none, iol or split.
    start_set : path or None
        What is known before, a set or the folder of its export; lap 0 is left out then.
    max_speed : float
        [m/s]
    max_torque : float or None
        Cap of the driving torque [N m]; by default what the vehicle file says.
    grip : float
        Friction of the road against the tyres' own peak [1].
    seed : int
        Of the sensors' noise.
    exact_sensors : bool
    delay : bool
        Whether a command takes effect one interval after the measurement it follows from.
    features : str
        Inputs of the correction; ``auto`` chooses one of `CANDIDATES` after lap 0.
    predictor : str
        Evaluates the set; ``bcm`` and ``projected`` follow every update of a learner, others are built anew after
        each lap. ``auto`` is ``bcm`` for three features, ``projected`` for more.
    hyperparameters : str
        ``fit`` (to lap 0), ``fit-lasting`` (the same with errors that last from label to label, see
        `fit_kernel`), ``default``, or a kernel's YAML.
    width : float or None
        Of the car's body [m].
    printed_iol : bool
        Count updates of the dictionary as costly as the papers print them; see `IolLearner`.
    margin : float or None
        Kept from the car's side to the border [m]; by default `MARGIN`, in proportion to the car's wheelbase.
    deviation : float or None
        By how much more than the margin the borders are moved in until a lap has shown how far plan and drive part
        [m]; by default `FIRST_DEVIATION`, in proportion to the car's wheelbase. After each lap it is what the lap
        needed, and no less than a share of what it was.
    tightening : float
        Standard deviations by which the borders are moved in [1].
    settings : MpccSettings
        Its margin and its largest speed are those named above.
    first_share : float or None
        Share of the peak that run-up and lap 0 may use with the nominal model [1]; by default `first_share` of the
        vehicle file. Each clean lap lets the next one use `SHARE_STEP` more: up to `nominal_share` without a
        learner, and up to the share of `settings` with one.
    assumed_friction : float
        What the slip limits take for the road's grip before anything is learned [1].
    learn_grip : bool
        Whether a learner moves the slip limits to the peaks that its labels tell; see `learned_grip`.
    """

    track: str = "small"
    car: str = "road_car"
    laps: int = 3
    learner: str = "split"
    start_set: str | FilePath | None = None
    max_speed: float = 30.0
    max_torque: float | None = None
    grip: float = 1.0
    seed: int = 0
    exact_sensors: bool = False
    delay: bool = True
    features: str = AUTO
    predictor: str = AUTO
    hyperparameters: str = "fit"
    width: float | None = None
    printed_iol: bool = True
    margin: float | None = None
    deviation: float | None = None
    tightening: float = 0.0
    settings: MpccSettings = LEARNING
    first_share: float | None = None
    assumed_friction: float = 1.0
    learn_grip: bool = True

    @property
    def candidates(self) -> tuple[str, ...]:
        """Feature sets among which lap 0 chooses; the last one has the most features."""
        if self.features != AUTO:
            return (self.features,)
        # A kernel's file belongs to one set of features, and a table has three.
        free = self.learner != "none" and self.hyperparameters in (*FITS, "default") and self.predictor != "table"
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
