"""The training set and the learner of a race: before lap 0 without a kernel, after it with grid and kernel fitted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.control.iol_learner import IolLearner
from split_cli.control.learner import Learner, NoLearner, SplitLearner, learning_region
from split_cli.control.mpcc import MpccSettings
from split_cli.control.policy import PAST
from split_cli.control.residual import PredictorResidual
from split_cli.learning.cells import empty_set
from split_cli.learning.features import Z2, FeatureSet
from split_cli.learning.hyperparameters import FEWEST_TO_FIT, default_kernel, fit_kernel, scatter_variance
from split_cli.learning.kernel import Kernel
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.labels import Labels, compute_labels
from split_cli.learning.region import Grid, build_grid
from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive import Drive
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from split_cli.workflows.racing.settings import RaceSettings, predictor_for

PAST_TERM = EffectSpec("feature_lag", {"tau": PAST})
"""The term whose states are the recent past of z2; no force depends on it."""


def with_past_term(vehicle: Vehicle, features: FeatureSet) -> tuple[Vehicle, int]:
    """Return the vehicle, with `PAST_TERM` added if `features` name its states, and how many terms were added.

    `TrainingSet.found_effects` holds that number: terms beyond the vehicle file.
    """
    asked = any(name.startswith(f"{PAST_TERM.term}.") for name in features.names)
    if asked and all(effect.term != PAST_TERM.term for effect in vehicle.effects):
        return vehicle.with_effects(PAST_TERM), 1
    return vehicle, 0


def header_without_kernel(vehicle: Vehicle, features: FeatureSet, mpcc: MpccSettings) -> TrainingSet:
    """Return an empty set over z2 for lap 0: it defines labels only, its kernel is a placeholder.

    `features` are those that will be learned; the vehicle gets the term whose states they name.
    """
    vehicle, added = with_past_term(vehicle, features)
    limits = mpcc.limits
    region = learning_region(vehicle, limits.alpha_max, limits.dalpha_max, limits.p_long)
    grid = build_grid(Z2, vehicle, region)
    kernel = Kernel(np.array(grid.edges), np.ones(3), np.ones(3))
    return replace(empty_set(vehicle, Z2, region, grid, kernel, horizon=mpcc.step), found_effects=added)


def header_with_kernel(
    blank: TrainingSet, laps: Sequence[Drive], features: FeatureSet, settings: RaceSettings, notes: list[str]
) -> tuple[TrainingSet, list[Labels]]:
    """Return an empty set over `features` with grid and kernel from the labels of `laps`, and these labels.

    The kernel is fitted, the default one or read from a file, as `settings` say. Notes are appended to `notes`.
    """
    labels = [compute_labels(lap, blank.vehicle, features, blank.region, horizon=blank.horizon) for lap in laps]
    driven = Labels.joined(labels)
    grid = build_grid(features, blank.vehicle, blank.region, driven.z[driven.accepted])
    kernel = _kernel(driven, grid, settings, notes)
    header = empty_set(blank.vehicle, features, blank.region, grid, kernel, horizon=blank.horizon)
    return replace(header, found_effects=blank.found_effects), labels


def _kernel(labels: Labels, grid: Grid, settings: RaceSettings, notes: list[str]) -> Kernel:
    good, asked = labels.accepted, settings.hyperparameters
    start = default_kernel(grid, labels.y[good], scatter_variance(labels))
    if asked == "default":
        return start
    if asked != "fit":
        return read_kernel(asked, labels.features)
    if np.count_nonzero(good) < FEWEST_TO_FIT:
        notes.append(
            f"lap 0 has {np.count_nonzero(good)} valid labels, too few to fit a kernel; the default kernel is used"
        )
        return start
    return fit_kernel(labels.z[good], labels.y[good], grid, start).kernel


def make_learner(settings: RaceSettings, training_set: TrainingSet) -> Learner:
    """Return the learner that the settings name, with `training_set` as its first set."""
    predictor = predictor_for(settings.predictor, training_set.features)
    if settings.learner == "none":
        return NoLearner(training_set, PredictorResidual(training_set, predictor))
    if settings.learner == "split":
        return SplitLearner(training_set, predictor)
    return IolLearner(training_set, printed=settings.printed_iol)
