"""Notes of an evaluation: facts of each drive, and reasons why a score is not to be believed."""

from collections.abc import Iterable, Sequence

import numpy as np

from split_cli.learning.shared_rows import shared_sources
from split_cli.learning.training_set import SetSource, TrainingSet
from split_cli.logs.drive import Drive, DriveMetadata, unstated_inputs
from split_cli.logs.drive_metadata import CIRCULAR, circular_in_any
from split_cli.prediction import PREDICTORS
from split_cli.scoring.circular import limits_of, unknown_to
from split_cli.scoring.evaluation import HeldOutSamples, pooled_noise_floor
from split_cli.scoring.evidence import MOST_ROWS
from split_cli.scoring.late_inputs import late_inputs
from split_cli.scoring.noise import fast_motion
from split_cli.scoring.report import DriveFacts, EvaluationSettings
from split_cli.scoring.run import DRAWN_ROWS
from split_cli.scoring.vehicle_match import Belonging, overloaded_axles, share_beyond
from split_cli.scoring.verdict import Comparison
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.label import drive_notes


def same_interval(held: HeldOutSamples, first: HeldOutSamples) -> bool:
    """Tell whether a drive's label interval is the first drive's, so that rollouts of both have the same steps."""
    return abs(held.labels.horizon - first.labels.horizon) < 1e-9


def derived_states(drives: Iterable[DriveMetadata]) -> dict[str, str]:
    """Return the states whose error says nothing, since an input or they were made of the model itself, and why."""
    return {
        state: f"{CIRCULAR[state]}, so errors and intervals of {state} say nothing of the car. Verdicts leave {state} "
        "out; norm and skill contain it"
        for state in circular_in_any(drives)
    }


def notes_on_states(drives: Sequence[Drive], trained: TrainingSet | None) -> tuple[str, ...]:
    """Return which states these drives, or those that a set learned, say nothing of."""
    learned = () if trained is None else limits_of(trained)
    return (*derived_states(drive.metadata for drive in drives).values(), *learned)


def silent_states(drives: Sequence[Drive], trained: TrainingSet | None) -> tuple[str, ...]:
    """Return the states whose intervals are not judged: these drives, or all that a set learned, say nothing."""
    learned = () if trained is None else unknown_to(trained)
    return (*derived_states(drive.metadata for drive in drives), *learned)


def with_measured_error(comparisons: Sequence[Comparison], drives: Sequence[Drive]) -> list[Comparison]:
    """Return the comparisons of states that are measured independently of the model, see `derived_states`."""
    derived = derived_states(drive.metadata for drive in drives)
    return [c for c in comparisons if c.state not in derived]


def sources_not_judged(trained: TrainingSet | None, drives: Sequence[Drive]) -> list[SetSource]:
    """Return the drives of a set whose own notes are not said with those that are judged."""
    judged = {drive.sha256 for drive in drives}
    return [source for source in trained.sources if source.sha256 not in judged] if trained else []


def drive_facts(held: HeldOutSamples, model: SingleTrack, trained: TrainingSet | None, shown: Belonging) -> DriveFacts:
    """Return what is said of a drive: its samples, its noise floor, and what makes its scores doubtful."""
    drive, tested = held.drive, held.labels.take(held.tested)
    in_sample = bool(trained and drive.sha256 and any(s.sha256 == drive.sha256 for s in trained.sources))
    notes = list(drive_notes(drive))
    floor = pooled_noise_floor(model, [held])
    fast = fast_motion(tested, floor)
    notes += [f"{drive.name}: {fast}"] if fast else []
    notes += late_inputs(drive, tested, model.vehicle, trained.found if trained else ())
    notes += [f"{drive.name}: {said}" for said in overloaded_axles(drive, model.vehicle, shown)]
    notes += [] if trained is None else _outside(drive.name, share_beyond(trained, tested.z))
    return DriveFacts(
        name=drive.name,
        sha256=drive.sha256,
        duration=held.labels.duration,
        labels=len(held.labels),
        tested=len(tested),
        tested_valid=int(tested.accepted.sum()),
        in_sample=in_sample,
        held_out=held.split.intervals,
        noise_floor=floor,
        notes=tuple(notes),
    )


def _outside(name: str, share: float) -> list[str]:
    """Return what to know of a drive beyond the data of the set; most of it outside is a warning."""
    if round(100.0 * share) == 0:
        return []
    warning = "WARNING: outside the training data: " if share > 0.5 else ""
    return [
        f"{warning}{100.0 * share:.0f} % of the test samples of {name} lie farther than a length scale from every "
        "point of the set; there the correction fades to zero, and the nominal model remains"
    ]


def notes_of(
    facts: Sequence[DriveFacts], drives: Sequence[HeldOutSamples], settings: EvaluationSettings, rollouts: Sequence
) -> list[str]:
    """Return the notes of an evaluation, those of its drives among them."""
    notes = [*unstated_inputs([held.drive for held in drives]), *(note for fact in facts for note in fact.notes)]
    for fact in facts:
        if 2 * fact.tested_valid < fact.tested:
            notes.append(
                f"{fact.tested_valid} of {fact.tested} test samples of {fact.name} are inside the valid region, "
                "in which alone the nominal model is corrected"
            )
        if fact.in_sample:
            notes.append(in_sample("the set", fact.name))
    if settings.protocol == "paper":
        notes.append("IN SAMPLE: the paper's protocol trains on the very lap it scores")
    if settings.protocol == "held-out" and any(PREDICTORS[n][1] == "FitcPredictor" for n in settings.predictors):
        notes.append("fitc used the recorded future as pseudo-inputs; a controller does not know it")
    for held in drives:
        if rollouts and not same_interval(held, drives[0]):
            steps = f"{held.labels.horizon:g} s, not {drives[0].labels.horizon:g} s as of {drives[0].drive.name}"
            notes.append(f"no rollouts of {held.drive.name}: its label interval is {steps}")
    if settings.protocol == "held-out" and settings.rollout and not rollouts:
        notes.append(f"no rollouts: no stretch of test data lasts {max(settings.rollout):g} s without a gap")
    return notes


def in_sample(model: str, drive: str) -> str:
    """Return the note on a drive that a model was trained on."""
    return f"IN SAMPLE: {model} was trained on {drive}; its scores say nothing of other drives"


def overlap_notes(
    model: str, trained: TrainingSet, drive: Drive, z: np.ndarray, its_own: int | None = None
) -> list[str]:
    """Return a note for each training drive of a set that shares rows with the drive that is scored.

    Parameters
    ----------
    model : str
        Name of the set in notes.
    z : ndarray, shape (N, D)
        Features of all rows of the drive.
    its_own : int, optional
        Index of the drive among those that the set was trained on, if only held-out blocks of it are scored.
    """
    if any(source.sha256 == drive.sha256 for source in trained.sources) and its_own is None:
        return []  # `in_sample` says it
    return [
        f"NOT UNSEEN: {model} was trained on {trained.sources[n].name}, and {100.0 * share:.0f} % of the points "
        f"that it keeps of that drive are rows of {drive.name} too. One is a copy of the other, or a part of the "
        "same recording; scores of these rows say nothing of other drives"
        for n, share in shared_sources(trained, z, drive["t"]).items()
        if n != its_own
    ]


def notes_on_own_sets(sets: Sequence[tuple[str, TrainingSet]]) -> list[str]:
    """Return a note for each set that was trained for this evaluation alone, with its trust."""
    return [
        f"the set of {name} was trained for this evaluation, on the training blocks alone; its "
        f"trust is {trained.trust.words()}. `split train` takes the whole drive and may find another"
        for name, trained in sets
    ]


def notes_on_parts(drives: Sequence[HeldOutSamples], finds_trust: bool) -> list[str]:
    """Return notes on long drives of which only a part was used: for the trust, if it is found here, and for charts."""
    bounds = [("trust was found on at most", MOST_ROWS)] if finds_trust else []
    bounds.append(("the page draws", DRAWN_ROWS))
    return [
        f"{what} {rows * held.drive.period / 60.0:.3g} minutes of {held.drive.name}"
        for held in drives
        for what, rows in bounds
        if len(held.drive) > rows
    ]
