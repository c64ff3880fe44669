"""An evaluation with what its report was made of, for figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import Prediction
from split_cli.scoring.evaluation import HeldOutSamples, ScoreTally
from split_cli.scoring.report import Evaluation
from split_cli.scoring.rollouts import RolloutSums

__all__ = ["EvaluationRun", "Trace"]


@dataclass(frozen=True)
class Trace:
    """Test samples of one drive with the predictions of one predictor.

    Attributes
    ----------
    name, features : str
    held : HeldOutSamples
    tested : Labels
        In the order of the predictions.
    prediction : Prediction
    noise_variance : ndarray, shape (3,)
        Of a label, which its band holds beside the latent variance.
    """

    name: str
    features: str
    held: HeldOutSamples
    tested: Labels
    prediction: Prediction
    noise_variance: np.ndarray


@dataclass(frozen=True)
class EvaluationRun:
    """A report, and what figures are drawn from.

    Attributes
    ----------
    report : Evaluation
    sets : tuple of TrainingSet
        One a feature set.
    held : tuple of tuple of HeldOutSamples
        One a feature set, in each one a drive.
    traces : tuple of Trace
    tallies : mapping of (str, str) to ScoreTally
        Pooled, by name and features.
    rollouts : mapping of (str, str) to RolloutSums
        Pooled, by name and features.
    """

    report: Evaluation
    sets: tuple[TrainingSet, ...]
    held: tuple[tuple[HeldOutSamples, ...], ...]
    traces: tuple[Trace, ...]
    tallies: Mapping[tuple[str, str], ScoreTally]
    rollouts: Mapping[tuple[str, str], RolloutSums]
