"""Processing of a long drive piece by piece in bounded memory, with results that do not depend on the pieces."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from split_cli.learning.features import FeatureSet, recording_of
from split_cli.logs.drive import Drive
from split_cli.logs.scratch import in_pieces
from split_cli.vehicle.effects.recording import Handover, Recording
from split_cli.vehicle.single_track import SingleTrack

#: Rows that are worked through at once [1]: a long drive then takes no more memory than what comes out.
PIECE_ROWS = 2**18


@dataclass(frozen=True)
class DrivePiece:
    """Rows of a drive from `first` on, with the recording that holds what came before."""

    drive: Drive
    first: int
    recording: Recording | None


def pieces(model: SingleTrack, drive: Drive, starts: np.ndarray, window: int) -> Iterator[tuple[slice, DrivePiece]]:
    """Yield a drive in pieces of `PIECE_ROWS`, each with the range of `starts` whose windows lie in it.

    Parameters
    ----------
    model : SingleTrack
        What its terms remember is handed on: the flow along each piece has to be followed before the next one.
    starts : ndarray of int, shape (N,)
        Rows, ascending.
    window : int
        Samples that are needed behind a start.

    Notes
    -----
    With delays among the terms the drive is one piece.
    """
    if any(np.any(np.diff(starts[rows.start : rows.stop + 1]) < 0) for rows in in_pieces(len(starts))):
        raise ValueError("windows of a drive in pieces have to ascend")
    delayed = any(getattr(term, "input_delays", None) for term in model.terms)
    length = len(drive) if delayed else PIECE_ROWS
    entering: dict[str, float] = {}
    for begin in range(0, len(drive), length):
        begins, ends = np.searchsorted(starts, (begin, begin + length))
        if begins == ends and not model.state_names:
            continue
        # A row before, and one behind the last window: slopes and means over samples reach that far.
        first, last = max(begin - 1, 0), min(begin + length + window + 2, len(drive))
        part = drive.stretch(first, last)
        recording = None
        if model.state_names and length < len(drive):
            memory = Handover(min(begin + length, len(drive)) - 1 - first, entering)
            recording, entering = replace(recording_of(part), memory=memory), memory.leaving
        yield slice(int(begins), int(ends)), DrivePiece(part, first, recording)


def features_along(model: SingleTrack, drive: Drive, features: FeatureSet) -> np.ndarray:
    """Return the features of every sample of a drive, shape (N, D), as `FeatureSet.compute` gives them."""
    z = np.empty((len(drive), len(features.names)))
    for rows, piece in pieces(model, drive, np.arange(len(drive)), 0):
        own = features.compute(model, piece.drive, piece.recording)
        z[rows] = own[rows.start - piece.first : rows.stop - piece.first]
    return z
