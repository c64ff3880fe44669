"""Warnings that every export of a trained set carries: where its correction may do harm."""

from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive_metadata import ingest_found
from split_cli.scoring.circular import limits_of
from split_cli.scoring.evidence import WHOLE_DRIVES
from split_cli.scoring.found_lags import lag_notes


def reservations(training_set: TrainingSet) -> tuple[str, ...]:
    """Return where nothing that training saw speaks for a set's correction, a sentence or two each."""
    notes: list[str] = []
    trust = training_set.trust
    for source in training_set.sources:
        notes += ingest_found(source.name, source.remarks)
    if trust.origin in ("full", "given"):
        notes.append("the correction was not judged on held-out driving, and may do harm")
    elif trust.array.any():
        few = len(training_set.sources) < WHOLE_DRIVES
        driving = "other stretches of the same driving" if few else "drives like those of training"
        notes.append(
            f"trust and intervals hold for {driving} only. On another surface, at other speeds or with other "
            "tyres the correction may do harm. A running trust avoids most of it"
        )
    return (*notes, *limits_of(training_set), *lag_notes(training_set))
