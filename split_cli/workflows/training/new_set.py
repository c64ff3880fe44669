"""A new set before it learns: grid, kernel and trust, from the labels of its drives."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from split_cli.errors import SetError
from split_cli.learning.cells import DEFAULT_CAPACITY, DEFAULT_THRESHOLD, empty_set
from split_cli.learning.hyperparameters import (
    FEWEST_TO_FIT,
    KernelFit,
    default_kernel,
    fit_kernel,
    labels_to_fit,
    longest_scale,
    scatter_variance,
)
from split_cli.learning.iol import DEFAULT_DICTIONARY, LEARNER, empty_dictionary
from split_cli.learning.kernel import Kernel
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.region import Grid, build_grid
from split_cli.learning.set_limits import MOST_CELLS_OF_A_GRID
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import STATES, Trust
from split_cli.logs.drive_metadata import CIRCULAR, circular_in_all
from split_cli.logs.scratch import in_pieces, selected
from split_cli.scoring.evidence import MOST_ROWS, TrainingDrive, held_out_whole
from split_cli.scoring.found_lags import Prepared, decide, lag_notes
from split_cli.vehicle.parameters import Vehicle
from split_cli.workflows.training.labelled_drives import LabelledDrives
from split_cli.workflows.training.settings import TrainSettings


def create_set(drives: LabelledDrives, settings: TrainSettings) -> tuple[TrainingSet, KernelFit | None, LabelledDrives]:
    """Return an empty set: its grid from the first drive with valid samples, its kernel and trust as asked for.

    Where trust is found on held-out blocks, lags of torque and steering are, too: the set's vehicle then holds
    them beyond the vehicle file, if held-out blocks gain more with them and are harmed nowhere. The drives come
    back as they are labelled for the set's vehicle.

    Raises
    ------
    SetError
        If no sample is valid, the cell edge is not positive, or trust is to be found without a recording.
    """
    dictionary = settings.learner == LEARNER
    if settings.lag not in (None, "held-out", "none"):
        raise SetError(f"the lag {settings.lag!r} is unknown", advice="There are held-out and none.")
    # The rival's way is to believe all.
    asked = settings.trust or ("full" if dictionary else "held-out")
    if asked == "held-out":
        given, by_file = drives, _prepared(drives, settings)
        judged = len(by_file.drives)

        def relabelled(late: Vehicle) -> Prepared[tuple[KernelFit | None, LabelledDrives]]:
            # Only what trust is found on: a lag that is not kept shall not label the rest of an archive, or of a drive.
            return _prepared(given.labelled_for(late, judged), settings)

        chosen = decide(by_file, None if dictionary or settings.lag == "none" else relabelled, drives.progress)
        empty, (fit, drives) = chosen.empty, chosen.made
        parts_only = judged < len(given) or any(len(part.drive) >= MOST_ROWS for part in by_file.drives)
        if drives is not given and parts_only:
            drives = given.labelled_for(empty.vehicle)
            blank, fit = _blank(drives, settings)
            empty = replace(blank, trust=empty.trust, found_effects=empty.found_effects)
        unknown = circular_in_all([part.drive.metadata for part in chosen.drives])
        drives.note(*lag_notes(empty), *trust_notes(empty.trust, unknown))
        if chosen.needed is not None:
            seconds = sum(len(part.drive) * part.drive.period for part in chosen.drives)
            drives.note(
                f"the gain of the correction is within chance on {seconds:.0f} s of driving. At the same gain and "
                f"scatter {chosen.needed * seconds:.0f} s would show it: record more, and train on all of it"
            )
        whole = held_out_whole(chosen.drives) if empty.trust.origin == "held-out" else 0
        if whole:
            drives.note(f"each of {whole} drives was held out in turn: trust and intervals hold for another such drive")
        elif empty.trust.origin == "held-out":
            drives.note(
                "trust and intervals hold for other stretches of the same driving only; train on three drives or "
                "more to cover the difference between drives"
            )
    else:
        empty, fit = _blank(drives, settings)
        empty = replace(empty, trust=parse_trust(asked))
    if dictionary:
        empty = empty_dictionary(empty, DEFAULT_DICTIONARY if settings.capacity is None else settings.capacity)
    return empty, fit, drives


def _prepared(drives: LabelledDrives, settings: TrainSettings) -> Prepared[tuple[KernelFit | None, LabelledDrives]]:
    """Return an empty set with what its trust is found on, and the fit of its kernel with the drives."""
    blank, fit = _blank(drives, settings)
    return Prepared(blank, _recorded(drives), (fit, drives))


def _blank(drives: LabelledDrives, settings: TrainSettings) -> tuple[TrainingSet, KernelFit | None]:
    """Return an empty set with grid and kernel, everything believed."""
    how = drives.labelling
    first = _first_valid(drives)
    valid = first.accepted
    cell_edge = 1.0 if settings.cell_edge is None else settings.cell_edge
    if not 0.0 < cell_edge < np.inf:
        raise SetError(f"--cell-edge is {cell_edge:g}, it must be positive", advice="1 is the standard edge.")
    valid_z = None if how.features.is_z2 else selected(first.z, valid)
    grid = build_grid(how.features, how.vehicle, how.region, valid_z).coarser(cell_edge)
    if grid.size > MOST_CELLS_OF_A_GRID:
        raise SetError(
            f"--cell-edge {cell_edge:g} makes {grid.size:.3g} cells, more than {MOST_CELLS_OF_A_GRID:,}",
            advice="1 is the standard edge.",
        )
    kernel, fit = default_kernel(grid, selected(first.y, valid), scatter_variance(first)), None
    hyperparameters = settings.hyperparameters or "fit"
    if hyperparameters == "fit":
        fit = _fit(drives, grid, kernel)
        kernel = kernel if fit is None else fit.kernel
    elif hyperparameters != "default":
        kernel = read_kernel(hyperparameters, how.features)
    usual = settings.capacity is None or settings.learner == LEARNER
    blank = empty_set(
        how.vehicle,
        how.features,
        how.region,
        grid,
        kernel,
        horizon=how.horizon,
        plain=how.plain,
        capacity=DEFAULT_CAPACITY if usual else settings.capacity,
        threshold=DEFAULT_THRESHOLD if settings.threshold is None else settings.threshold,
        forgetting=settings.forgetting,
    )
    return blank, fit


def _recorded(drives: LabelledDrives) -> list[TrainingDrive]:
    bare = drives.without_recording()
    if bare:
        what = f"trust is estimated by predicting recordings, but of {', '.join(bare)} only labels were given"
        advice = "Give the drives too, or --trust full, or three shares such as --trust 0.5,0.8,1."
        raise SetError(what, advice=advice)
    parts, rows = [], 0
    for number in range(len(drives)):
        drive = drives.drive(number)
        rows += len(drive)
        if parts and rows > MOST_ROWS:
            drives.note(f"trust was found on the first {len(parts)} of {len(drives)} drives")
            break
        parts.append(TrainingDrive(drive, drives.labels(number, drive)).middle(MOST_ROWS))
        if len(drive) > MOST_ROWS:
            minutes = MOST_ROWS * drive.period / 60.0
            drives.note(f"trust was found on the middle {minutes:.3g} minutes of {drive.name}")
    return parts


def _fit(drives: LabelledDrives, grid: Grid, start: Kernel) -> KernelFit | None:
    """Fit to the valid labels of all drives; None, with a note, when they are too few."""
    features = drives.labelling.features
    # A bit a label: the places of all labels of an archive have no room.
    valid, counts = [], []
    for number in range(len(drives)):
        accepted = drives.labels(number).inside(grid).accepted
        valid.append(np.packbits(accepted))
        counts.append(int(np.count_nonzero(accepted)))
    total = sum(counts)
    if total < FEWEST_TO_FIT:
        drives.note("too few valid labels to fit hyperparameters to; the defaults are kept")
        return None
    drives.progress(f"fitting hyperparameters to {total} labels")
    # Only what the fit looks at: all labels of a long drive have no room.
    looked_at, before = labels_to_fit(total), np.cumsum([0, *counts])
    z, y, every = [], [], []
    for number, bits in enumerate(valid):
        low, high = np.searchsorted(looked_at, before[number : number + 2])
        some, labels = _places(bits, looked_at[low:high] - before[number]), drives.labels(number)
        z.append(labels.z[some])
        y.append(labels.y[some])
        every.append(labels.z[some if features.is_z2 else _places(bits, np.arange(counts[number]))])
    longest = longest_scale(features, grid, np.concatenate(every))
    fit = fit_kernel(np.concatenate(z), np.concatenate(y), grid, start, longest=longest)
    names = features.names
    scales = {f"length scale {i + 1}": f"length scale of {name}" for i, name in enumerate(names)}
    outputs = (("vx", "v_x"), ("vy", "v_y"), ("r", "r"))
    scales |= {f"{what} of {o}": f"{what} deviation of {name}" for what in ("signal", "noise") for o, name in outputs}
    # Of a state whose labels say nothing, `limits_of` says so.
    silent = set.intersection(*(set(drives.labels(number).circular) for number in range(len(drives))))
    bounds = [name for bound in fit.at_bound if (name := scales.get(bound, bound)).rpartition(" ")[2] not in silent]
    if bounds:
        them = "it" if len(bounds) == 1 else "them"
        drives.note(f"the {', '.join(bounds)} ended on a bound of the fit: the labels do not determine {them}")
    return fit


def _places(bits: np.ndarray, wanted: np.ndarray) -> np.ndarray:
    """Return the places of some of the ones in a row of bits, given by their numbers, which ascend."""
    places, before = [np.empty(0, dtype=np.int64)], 0
    for piece in in_pieces(len(bits)):
        ones = 8 * piece.start + np.flatnonzero(np.unpackbits(bits[piece]))
        low, high = np.searchsorted(wanted, (before, before + len(ones)))
        places.append(ones[wanted[low:high] - before])
        before += len(ones)
    return np.concatenate(places)


def _first_valid(drives: LabelledDrives) -> Labels:
    for number in range(len(drives)):
        labels = drives.labels(number)
        if labels.accepted.any():
            return labels
    counts = ", ".join(f"{count} {reason}" for reason, count in labels.counts().items()) or "no samples"
    advice = "Check units and signs with `split info`, and that the vehicle file is of this car."
    if 2 * labels.counts().get(Reason.SPEED.word, 0) > len(labels.reason):
        advice = (
            f"Most are slower than {labels.region.minimum_speed:.3g} m/s, where slip angles tell nothing of the tyres. "
            "Drive faster, or check unit and sign of v_x, which is positive ahead, and that the vehicle file is of "
            "this car."
        )
    raise SetError(f"no sample is inside the valid region (rejected: {counts})", where=labels.drive, advice=advice)


def parse_trust(text: str) -> Trust:
    """Return the trust that ``full`` or ``0.5,0.6,1`` stands for.

    Raises
    ------
    SetError
        If it is neither.
    """
    if text == "full":
        return Trust.full()
    try:
        return Trust(tuple(float(part) for part in text.split(",")), "given")
    except ValueError:
        advice = "Give held-out, full, or three numbers from 0 to 1 for v_x, v_y and r, such as 0.5,0.8,1."
        raise SetError(f"the trust {text!r} cannot be read", advice=advice) from None


def trust_notes(trust: Trust, unknown: Sequence[str] = ()) -> list[str]:
    """Return what the reader of a training must know of its trust.

    Parameters
    ----------
    unknown : sequence of str
        States of which no drive says anything, keys of `CIRCULAR`: what they lack is what a derivation got wrong, and
        is not applied.
    """
    if trust.origin == "unjudged":
        return [
            "the drives are too short to judge the correction on held-out blocks, so none of it is applied; "
            "record more driving, or pass --trust full"
        ]
    left_out = [
        state for state, share in zip(STATES, trust.share, strict=True) if share == 0.0 and state not in unknown
    ]
    notes = [f"no correction of {state} is applied: {CIRCULAR[state]}" for state in unknown]
    if not left_out:
        return notes
    return [
        *notes,
        f"no correction of {', '.join(left_out)} is applied: on held-out blocks it did not help beyond chance, or "
        "made some of the driving worse",
    ]
