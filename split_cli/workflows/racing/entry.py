"""What is refused before the first step: settings, tracks, sets that a controller cannot trust."""

from __future__ import annotations

from pathlib import Path as FilePath

import numpy as np

from split_cli.control.path import Path, read_centerline
from split_cli.errors import SetError, SplitError, nearest_names
from split_cli.learning.training_set import TrainingSet
from split_cli.plant.tracks import TRACK_NAMES, find_track
from split_cli.prediction import PREDICTORS
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.racing.closed_loop import path_of
from split_cli.workflows.racing.settings import LEARNERS, RaceSettings

__all__ = ["check_settings", "check_trusted", "find_path"]

LARGEST_LABEL = 30.0
"""Three times gravity [m/s^2]: no tyre force, and so no model of one, is wrong by more."""


def check_settings(settings: RaceSettings) -> None:
    """Refuse settings that no race can be driven with.

    Raises
    ------
    SplitError
        Naming the option and what it may be.
    """
    if settings.learner not in LEARNERS:
        raise SplitError(
            f"no learner is called {settings.learner!r}", where="--learner",
            advice=f"There are: {', '.join(LEARNERS)}.",
        )  # fmt: skip
    if settings.laps < 0:
        raise SplitError(f"a number of laps from 0 was expected, got {settings.laps}", where="--laps")
    for name, value in (("--max-speed", settings.max_speed), ("--grip", settings.grip)):
        if not 0.0 < value < 1e3:
            raise SplitError(f"must be positive, got {value:g}", where=name)
    if settings.predictor not in PREDICTORS:
        advice = nearest_names(settings.predictor, PREDICTORS)
        raise SplitError(f"no predictor {settings.predictor!r}", where="--predictor", advice=advice)
    if settings.learner == "iol" and settings.start_set is not None:
        raise SplitError(
            "the dictionary of iol begins empty", where="--start-set", advice="Use --learner none or split."
        )


def find_path(name: str) -> Path:
    """Return the track called `name`, or that of a centre-line CSV."""
    known = name in TRACK_NAMES
    if not known and (FilePath(name).suffix.lower() == ".csv" or FilePath(name).exists()):
        return read_centerline(name)
    return path_of(find_track(name))


def check_trusted(training_set: TrainingSet, vehicle: Vehicle, where: str | FilePath) -> None:
    """Refuse a set that a controller cannot trust.

    Raises
    ------
    SetError
        If it is of another vehicle, holds plain differences, or labels beyond what any model gets wrong.
    """
    if training_set.vehicle.digest() != vehicle.digest():
        raise SetError(
            f"was trained for another vehicle ({training_set.vehicle.name}) than {vehicle.name}", where=str(where),
            advice="Train a set for this vehicle, or name the vehicle file the set was trained with.",
        )  # fmt: skip
    if training_set.plain:
        raise SetError(
            "holds plain differences, which depend on the label interval", where=str(where),
            advice="Train it without --plain.",
        )  # fmt: skip
    huge = np.abs(training_set.y[:, :2]).max(initial=0.0)
    if not np.isfinite(training_set.y).all() or huge > LARGEST_LABEL:
        raise SetError(
            f"holds labels up to {huge:.3g} m/s^2: no car's model is wrong by more than three times gravity",
            where=str(where), advice="Check the recordings it was trained on with `split evaluate`.",
        )  # fmt: skip
