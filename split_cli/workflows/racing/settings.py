"""Settings of a race."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path as FilePath

from split_cli.control.limits import Limits
from split_cli.control.mpcc import MpccSettings
from split_cli.control.policy import RACE_P_LONG, SHARE_LEARNED

__all__ = ["FITS", "LEARNERS", "LEARNING", "RaceSettings"]

LEARNERS = ("none", "iol", "split")

FITS = ("fit", "fit-lasting")

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
    predictor : str
        Evaluates the set; ``bcm`` and ``projected`` follow every update of a learner, others are built anew after
        each lap.
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
        Share of the peak that the nominal model may use [1]: in the run-up, in lap 0, and in all laps of the
        learner none without a start set. By default `nominal_share` of the vehicle file.
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
    features: str = "z2"
    predictor: str = "bcm"
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
