"""States whose labels say nothing of the car, since an input or they were made of the model itself."""

from split_cli.learning.training_set import TrainingSet
from split_cli.logs.drive_metadata import CIRCULAR, circular_in_all, circular_in_any


def unknown_to(trained: TrainingSet) -> tuple[str, ...]:
    """Return the states whose labels say nothing in every drive that a set learned, keys of `CIRCULAR`."""
    return circular_in_all(trained.sources)


def limits_of(trained: TrainingSet) -> tuple[str, ...]:
    """Return what a set cannot say of the states of `CIRCULAR`: nothing, or less where some drives do not know."""
    notes = [
        f"{CIRCULAR[state]} in every drive of training, so the set knows nothing of errors of {state}: its "
        f"variance of {state} says nothing of the car"
        for state in unknown_to(trained)
    ]
    for state in circular_in_any(trained.sources):
        names = [source.name for source in trained.sources if state in source.circular]
        if state not in unknown_to(trained):
            notes.append(
                f"the labels of {state} of {', '.join(names)} say nothing, since {CIRCULAR[state]}. They pull its "
                f"correction towards zero: leave these drives out if you need {state}"
            )
    return tuple(notes)
