"""Checks before a race: settings, tracks and sets that are refused."""

from collections.abc import Iterable, Mapping
from pathlib import Path as FilePath

import numpy as np

from split_cli.control.centerline import read_centerline
from split_cli.control.exported import ExportedResidual
from split_cli.control.path import Path
from split_cli.control.policy import SLOWEST
from split_cli.errors import SetError, SplitError, nearest_names
from split_cli.learning.features import FeatureSet, parse_features
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.training_set import TrainingSet
from split_cli.plant.cars import CarParameters
from split_cli.plant.simulation import MOST_LAPS
from split_cli.plant.tracks import TRACK_NAMES, find_track
from split_cli.prediction import PREDICTORS
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.other_vehicle import trained_for_another
from split_cli.workflows.racing.closed_loop import path_of
from split_cli.workflows.racing.settings import AUTO, LEARNERS, RaceSettings

LARGEST_LABEL = 30.0
"""Three times gravity [m/s^2]: no tyre force, and so no model of one, is wrong by more."""

LARGEST_LIKENESS = 1.5
"""Between the wheelbase of the vehicle file and that of the plant's car [1]: a file that is more wrong than that
describes another car."""


def check_settings(settings: RaceSettings) -> None:
    """Refuse settings that no race can be driven with.

    Raises
    ------
    SplitError
        Naming the option and what it may be.
    """
    if settings.learner not in LEARNERS:
        advice = f"There are: {', '.join(LEARNERS)}."
        raise SplitError(f"no learner is called {settings.learner!r}", where="--learner", advice=advice)
    if not 0 <= settings.laps <= MOST_LAPS:
        what = f"is {settings.laps:g}, a number of laps from 0 to {MOST_LAPS} was expected"
        raise SplitError(what, where="--laps")
    _check_numbers(settings)
    features = parse_features(settings.candidates[-1])
    if settings.hyperparameters not in ("fit", "default"):
        read_kernel(settings.hyperparameters, features)
    check_predictor(settings.predictor, features if settings.learner == "split" else None)
    if settings.start_set is not None:
        _check_begins_with_a_set(settings)


def _check_begins_with_a_set(settings: RaceSettings) -> None:
    """Refuse what a race that begins with a set has no use for."""
    if settings.learner == "iol":
        raise SplitError(
            "the learner iol begins without points, so it cannot start from a set",
            where="--start-set",
            advice="Use --learner none or split.",
        )
    if settings.laps == 0:
        raise SplitError(
            "is 0, and lap 0 is left out where a set is known: nothing would be driven",
            where="--laps",
            advice="Ask for one lap or more, or leave out --start-set.",
        )
    if settings.hyperparameters != "fit":
        raise SplitError(
            f"is {settings.hyperparameters}, and the start set keeps the kernel that it was trained with",
            where="--hyperparameters",
            advice="Leave it out, or train the set with this kernel.",
        )


def check_same_features(asked: str, known: FeatureSet, where: str | FilePath) -> None:
    """Refuse features that differ from those of the set that a race begins with.

    Raises
    ------
    SplitError
        Naming both.
    """
    if asked != AUTO and parse_features(asked).names != known.names:
        raise SplitError(
            f"asks for {asked}, and {where} corrects by {', '.join(known.names)}",
            where="--features",
            advice="Leave it out, or train a set over these features.",
        )


def check_predictor(name: str, features: FeatureSet | None) -> None:
    """Refuse a predictor that does not exist, or cannot evaluate a set of `features`; None where there is no set.

    Raises
    ------
    SplitError
        Naming what may be used.
    """
    if name not in (AUTO, *PREDICTORS):
        raise SplitError(f"no predictor {name!r}", where="--predictor", advice=nearest_names(name, PREDICTORS))
    if name == "table" and features is not None and len(features.names) != 3:
        what = f"a table needs three features, there are {len(features.names)}: {', '.join(features.names)}"
        raise SplitError(what, where="--predictor", advice="Use --predictor projected.")


def _check_numbers(settings: RaceSettings) -> None:
    limits = settings.settings.limits
    positive = {
        "--max-speed": settings.max_speed,
        "--grip": settings.grip,
        "--assumed-friction": settings.assumed_friction,
        "--max-torque": settings.max_torque,
        "--width": settings.width,
        "--p-long": limits.p_long,
    }
    check_numbers(positive.items(), {}, {}, 0)
    if settings.max_speed <= SLOWEST:
        what = f"is {settings.max_speed:g} m/s, where the controller's model is not valid; more than {SLOWEST:g} m/s "
        raise SplitError(f"{what}was expected", where="--max-speed")
    shares = {
        "--p-ellipse": limits.p_ellipse,
        "--p-ellipse-lap0": settings.first_share,
        "--p-unknown": limits.p_unknown,
    }
    from_zero = {"--tightening": settings.tightening, "deviation": settings.deviation, "--margin": settings.margin}
    check_numbers((), shares, from_zero, settings.seed)


def check_numbers(
    positive: Iterable[tuple[str, float | None]],
    shares: Mapping[str, float | None],
    from_zero: Mapping[str, float | None],
    seed: int,
) -> None:
    """Refuse numbers out of their range, naming the option; what is None was not asked for.

    Raises
    ------
    SplitError
    """
    for name, value in positive:
        if value is not None and not 0.0 < value < 1e6:
            raise SplitError(f"is {value:g}, a positive number below 1e6 was expected", where=name)
    for name, value in shares.items():
        if value is not None and not 0.0 < value < 1.0:
            raise SplitError(f"is {value:g}, a share of the peak force between 0 and 1 was expected", where=name)
    for name, value in from_zero.items():
        if value is not None and not 0.0 <= value < 1e3:
            raise SplitError(f"is {value:g}, 0 or more was expected", where=name)
    if seed < 0:
        raise SplitError(f"is {seed}, a whole number from 0 was expected", where="--seed")


def check_car(vehicle: Vehicle, car: CarParameters) -> None:
    """Refuse a vehicle file that describes another car than the plant's.

    Raises
    ------
    SplitError
        If the wheelbases differ by more than `LARGEST_LIKENESS`.
    """
    ratio = vehicle.wheelbase / car.wheelbase
    if not 1.0 / LARGEST_LIKENESS <= ratio <= LARGEST_LIKENESS:
        raise SplitError(
            f"{car.name} has a wheelbase of {car.wheelbase:.2f} m, the vehicle file {vehicle.name} says "
            f"{vehicle.wheelbase:.2f} m",
            where="--car",
            advice="Give --car the simulated car of this vehicle file: road_car, f1tenth_car or formula_car.",
        )


def check_torque(vehicle: Vehicle, most: float) -> None:
    """Refuse a largest driving torque [N m] that does not overcome the rolling resistance.

    Raises
    ------
    SplitError
        Saying what the resistance takes.
    """
    needed = (vehicle.rolling_resistance_front + vehicle.rolling_resistance_rear) * vehicle.wheel_radius
    if most <= needed:
        what = f"is {most:g} N m, and rolling resistance alone takes {needed:.0f} N m"
        raise SplitError(what, where="--max-torque", advice="Raise it, so that the car can keep its speed.")


def check_start(path: Path, start: float, width: float, margin: float) -> None:
    """Refuse a track that leaves no room for car and margin, and a start at which the car is not on the track.

    Parameters
    ----------
    start : float
        Arc length, on the centre line [m].
    width, margin : float
        Of the car, and kept from its side to the border [m].

    Raises
    ------
    SplitError
        Saying where, and how much there is.
    """
    room = path.left + path.right - width
    tightest = int(np.argmin(room))
    if room[tightest] <= 2.0 * margin:
        raise SplitError(
            f"leaves {room[tightest]:.2f} m beside the car at {tightest * path.spacing:.0f} m, less than twice "
            f"the margin of {margin:g} m",
            where=path.name,
            advice="Lower --margin, or widen the track.",
        )
    here = path.at(np.array([start]))
    nearest = float(min(here.left[0], here.right[0]))
    if nearest < 0.5 * width:
        raise SplitError(
            f"the border is {nearest:.2f} m from the centre line at the start ({start % path.length:.0f} m), "
            f"where half the car is {0.5 * width:.2f} m wide",
            where=path.name,
            advice="Move the centre line to the middle of the track there, or let the file begin elsewhere.",
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
        If it is of another vehicle, holds plain differences, labels beyond what any model gets wrong, or a
        correction that is not to be applied to any output.
    """
    if training_set.nominal_vehicle.digest() != vehicle.digest():
        advice = "Train a set for this vehicle, or name the vehicle file the set was trained with."
        raise SetError(trained_for_another(training_set.nominal_vehicle, vehicle), where=str(where), advice=advice)
    if training_set.plain:
        raise SetError(
            "holds plain differences, which depend on the label interval",
            where=str(where),
            advice="Train it without --plain-labels.",
        )
    huge = np.abs(training_set.y[:, :2]).max(initial=0.0)
    if not np.isfinite(training_set.y).all() or huge > LARGEST_LABEL:
        raise SetError(
            f"holds labels up to {huge:.3g} m/s^2: no car's model is wrong by more than three times gravity",
            where=str(where),
            advice="Check the recordings it was trained on with `split evaluate`.",
        )
    if not any(training_set.trust.share):
        reason = (
            "its drives were too short to judge it"
            if training_set.trust.origin == "unjudged"
            else ("it helped no output on held-out driving")
        )
        raise SetError(
            f"holds a correction that is not to be trusted: {reason}. The nominal model alone would drive",
            where=str(where),
            advice="Train on longer or harder drives, or leave out --start-set.",
        )


def check_exported(exported: ExportedResidual, settings: RaceSettings) -> None:
    """Refuse an export that a race cannot be driven with.

    Raises
    ------
    SplitError
        If a learner is asked for, or the export has other features than z2.
    """
    if settings.learner != "none":
        what = f"is an export, from which the learner {settings.learner} cannot go on"
        raise SplitError(what, where=str(settings.start_set), advice="Use --learner none, or name the set itself.")
    if not exported.features.is_z2:
        what = f"has the features {', '.join(exported.features.names)}, and a race drives with exports of z2 alone"
        advice = "Name the set itself, or use `split maneuver`."
        raise SplitError(what, where=str(settings.start_set), advice=advice)
