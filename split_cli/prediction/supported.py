"""A set whose labels count as far as those of their cell support a correction."""

from dataclasses import replace

import numpy as np

from split_cli.learning.training_set import TrainingSet
from split_cli.prediction.projected import process_of


def cell_shares(training_set: TrainingSet) -> np.ndarray:
    """Return the share of the correction that each cell's labels support, from 0 to 1, shape (C, 3).

    Notes
    -----
    With m and v the posterior mean and variance of the process at the points of a cell, the share is the positive
    part of 1 - sum(v)/sum(m^2): a correction within one standard deviation of none counts as none (the positive
    part of the estimator of James and Stein, 1961). The process rests on all labels, those of other cells as well.
    Were the nominal model right, m would come of label noise alone, and its variance is at most v: with K the
    prior's covariance, N the noise's and A = K + N, it is K A^-1 N A^-1 K, and v is K A^-1 N. A cell that driving
    only passes through has few labels. They hold what goes with passing, and m is small beside its deviation.
    """
    mean, variance = process_of(training_set).along(training_set.z)[:2]
    power, doubt = (np.add.reduceat(part, training_set.offsets[:-1]) for part in (np.square(mean), variance))
    share: np.ndarray = 1.0 - np.divide(doubt, power, out=np.ones_like(power), where=power > doubt)
    return share


def supported(training_set: TrainingSet) -> TrainingSet:
    """Return the set with the labels of each cell times its `cell_shares`, and the sums over all labels likewise.

    Every predictor is linear in the labels, so means and their derivatives follow; variances stay. The trust that
    remains is a share of each output alone.
    """
    plain = replace(training_set, trust=replace(training_set.trust, by_cell=False))
    if not training_set.size:
        return plain
    share = np.repeat(cell_shares(training_set), np.diff(training_set.offsets), axis=0)
    absorbed = None if training_set.absorbed is None else share * training_set.absorbed
    return replace(plain, y=share * training_set.y, absorbed=absorbed)


def believed(training_set: TrainingSet) -> TrainingSet:
    """Return the set that predictors and exports are made of: `supported` where its trust says so."""
    return supported(training_set) if training_set.trust.by_cell else training_set
