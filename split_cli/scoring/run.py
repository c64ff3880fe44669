"""Result of an evaluation together with the data behind it, for figures."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from split_cli.learning.labels import Labels
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import Prediction
from split_cli.scoring.evaluation import HeldOutSamples, ScoreTally
from split_cli.scoring.report import Evaluation
from split_cli.scoring.rollouts import RolloutSums

#: Rows of a drive that a page draws at most [1].
DRAWN_ROWS = 2**18


@dataclass(frozen=True)
class Trace:
    """Test samples of one drive with the predictions of one predictor."""

    name: str
    features: str
    held: HeldOutSamples
    tested: Labels  # in the order of the predictions
    prediction: Prediction
    noise_variance: np.ndarray  # (3,): of a label, which its band holds beside the latent variance

    def drawn(self) -> Trace:
        """Return the trace of at most `DRAWN_ROWS` rows about the middle one that tests."""
        held, length = self.held, len(self.held.drive)
        if length <= DRAWN_ROWS:
            return self
        middle = int(self.tested.row[len(self.tested) // 2])
        first = min(max(middle - DRAWN_ROWS // 2, 0), length - DRAWN_ROWS)
        last = first + DRAWN_ROWS
        rows, tested = slice(first, last), self.tested.between(first, last)
        begin = int(np.searchsorted(self.tested.row, first))
        mean, variance = (
            values[begin : begin + len(tested)] for values in (self.prediction.mean, self.prediction.variance)
        )
        split = held.split
        split = replace(split, train=split.train[rows], test=split.test[rows], block=split.block[rows])
        held = replace(
            held,
            drive=held.drive.stretch(first, last),
            split=split,
            labels=held.labels.between(first, last),
            z=held.z[rows],
        )
        return replace(self, held=held, tested=tested, prediction=Prediction(mean, variance))


@dataclass(frozen=True)
class EvaluationRun:
    """A report, and what figures are drawn from."""

    report: Evaluation
    sets: tuple[TrainingSet, ...]  # one a feature set
    held: tuple[tuple[HeldOutSamples, ...], ...]  # one a feature set, in each one a drive
    traces: tuple[Trace, ...]
    tallies: Mapping[tuple[str, str], ScoreTally]  # pooled, by name and features
    rollouts: Mapping[tuple[str, str], RolloutSums]  # pooled, by name and features
    failures: tuple[str, ...] = ()  # why drives were left out, where that was asked for
