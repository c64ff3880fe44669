"""Decisions between and after laps: which features to learn, and in words whether learning helped."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from split_cli.control.learner import FOLLOWING
from split_cli.control.policy import SHARE_NOMINAL
from split_cli.errors import SplitError
from split_cli.learning.cells import DEFAULT_CAPACITY, DEFAULT_THRESHOLD
from split_cli.logs.drive import Drive
from split_cli.prediction import DEFAULT_PREDICTOR
from split_cli.scoring.selection import SelectionSettings
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.racing.result import Lap, RaceResult
from split_cli.workflows.racing.settings import AUTO, RaceSettings
from split_cli.workflows.training.select import select

GENTLER = 0.8
"""Of the share of the peak in a lap that the car did not follow, what is advised for the next [1]: speeds in bends
go with its root, and are a tenth lower."""


class FeatureChoice(NamedTuple):
    """What a race learns from now on."""

    features: str
    reason: str  # in a sentence; empty where there was nothing to choose
    undecided: bool  # whether another candidate is within one standard error of the best: more laps may tell


def choose_features(laps: Sequence[Drive], vehicle: Vehicle, settings: RaceSettings) -> FeatureChoice:
    """Return the candidate that predicts held-out blocks of the laps best.

    Parameters
    ----------
    laps : sequence of Drive
        All that were driven, lap 0 first. The same tenths of every lap are held out together.
    vehicle : Vehicle
        With the terms that the candidates need.

    Notes
    -----
    The choice is that of `split evaluate --select`: of the candidates that are behind the best by no more than
    one standard error over blocks, the one of fewest points. One candidate is taken without a test.
    """
    candidates = settings.candidates
    if len(candidates) == 1:
        return FeatureChoice(candidates[0], "", False)
    asked = SelectionSettings(
        features=candidates,
        capacities=(DEFAULT_CAPACITY,),
        thresholds=(DEFAULT_THRESHOLD,),
        cell_edges=(1.0,),
        predictor=settings.predictor if settings.predictor in FOLLOWING else DEFAULT_PREDICTOR,
    )
    driven = "lap 0" if len(laps) == 1 else f"laps 0 to {len(laps) - 1}"
    try:
        found = select(laps, vehicle, asked).candidates
    except SplitError as error:
        reason = f"{driven} cannot choose the features, {candidates[0]} is learned: {error}"
        return FeatureChoice(candidates[0], reason, True)
    chosen = next(one for one in found if one.chosen)
    left = " and ".join(
        f"{100 * one.error:.0f} % with {one.features}"
        for one in sorted(found, key=lambda one: candidates.index(one.features))
    )
    reason = (
        f"the inputs of the correction are {chosen.features} (`--features`). On parts of {driven} that were not "
        f"learned, its error is {left} of the nominal model's"
    )
    undecided = sum(one.behind <= one.behind_error for one in found) > 1
    if undecided:
        reason += ". They differ by less than one standard error, and the next lap decides again"
    return FeatureChoice(chosen.features, reason, undecided)


def whether_learning_helped(laps: Sequence[Lap], settings: RaceSettings, others: Sequence[RaceResult] = ()) -> str:
    """Return in words whether clean laps with the learned model were faster than those of the nominal one.

    Parameters
    ----------
    laps : sequence of Lap
        All that were driven, lap 0 first.
    others : sequence of RaceResult
        Driven with the same settings. The first without a learner is the rival; its pace rises as that of a
        learner does. Without it there is only lap 0, which the nominal model drives carefully.

    Returns
    -------
    str
        Empty where nobody learned, or no lap followed lap 0.
    """
    own = [lap for lap in laps if lap.number > 0]
    if settings.learner == "none" or not own or laps[0].number != 0 or laps[0].time is None:
        return ""
    nominal = [other.laps for other in others if other.learner == "none" and other.laps[0].number == 0]
    rivals = [lap for lap in nominal[0] if lap.clean] if nominal else []
    rival = min(rivals, key=_duration, default=laps[0])
    called = "lap 0 with the nominal model" if rival is laps[0] else "the nominal controller's in as many laps"
    best = min((lap for lap in own if lap.clean), key=_duration, default=None)
    took = f"{called} {rival.time:.2f} s" + ("" if rival.clean else f", {rival.outside:.2f} m outside the track")
    if best is not None and not rival.clean:
        learned = f"The best clean lap with what was learned took {best.time:.2f} s."
        return f"{learned} Without it no lap was clean: {took}."
    if best is not None and _duration(best) < _duration(rival):
        sentence = (
            f"The best clean lap with what was learned took {best.time:.2f} s, "
            f"{100 * (1 - _duration(best) / _duration(rival)):.1f} % less than {called} "
            f"({rival.time:.2f} s)."
        )
        if rival is laps[0]:
            there, then = (f"{lap.share:.2f} of the peak force and {lap.margin:.2f} m" for lap in (rival, best))
            sentence += (
                f" There the plan was held to {there} from the border by choice, and to {then} in the best lap. "
                "So this is not the gain of learning alone"
            )
            # Where a nominal controller drove and no lap of it was clean, there is no other rival.
            sentence += "." if nominal else f", which `--learner none --learner {settings.learner}` shows."
        return sentence
    slower = "no lap with it was clean" if best is None else f"the best clean lap with it took {best.time:.2f} s"
    return f"Learning did not help: {slower}, {took}.{_what_to_do(own[-1], settings, rival.clean)}"


def advice_after_lap_0(laps: Sequence[Lap], vehicle: Vehicle) -> str:
    """Return advice if the nominal model, without terms, did not keep the car on the track in lap 0; else empty.

    Notes
    -----
    A vehicle file without terms has no lag of steering or torque. Times of motion scale with the root of length
    (Froude) and actuator lags do not, so that lags matter more in a small car. A gentler lap lets `split diagnose`
    identify them; of a lap that ends in a spin, the spin itself lies in the held-out time.
    """
    if not laps or laps[0].number != 0 or laps[0].clean or vehicle.effects:
        return ""
    first = laps[0]
    what = f"{first.outside:.2f} m outside the track" if first.time is not None else "not finished"
    share = GENTLER * first.share
    return (
        f"lap 0 was {what}, and the file of {vehicle.name} has no lags: drive a gentler one (-o lap0.parquet "
        f"--laps 0 --learner none --p-ellipse-lap0 {share:.2g}), let `split diagnose --real lap0.parquet` name "
        "what the file lacks, and race with its corrected file"
    )


def _what_to_do(last: Lap, settings: RaceSettings, nominal_is_clean: bool) -> str:
    """Return the errors of the last lap, and what to do where learning did not help."""
    errors = ""
    shares = [after / before for after, before in zip(last.error_after, last.error_before, strict=True) if before]
    if shares:
        left = ", ".join(f"{100 * share:.0f} %" for share in shares)
        errors = f" In lap {last.number} the one-step errors of v_x, v_y and r were {left} of the nominal model's."
    if settings.features != AUTO:
        return f"{errors} Leave out --features and --predictor: the race then chooses both on held-out parts of laps."
    if not nominal_is_clean:
        return errors  # what lap 0 asks for says the rest
    return (
        f"{errors} Drive with `--learner none`, or keep a lap at more of the peak (`-o lap0.parquet --laps 0 "
        f"--learner none --p-ellipse-lap0 {SHARE_NOMINAL}`) and let `split diagnose --real lap0.parquet` name "
        "what the vehicle file lacks."
    )


def _duration(lap: Lap) -> float:
    return np.inf if lap.time is None else lap.time
