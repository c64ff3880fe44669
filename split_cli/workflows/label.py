"""Label a drive: what the nominal model gets wrong, sample by sample, into a file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.files import refuse_overwriting_inputs
from split_cli.learning.features import parse_features
from split_cli.learning.label_file import write_labels
from split_cli.learning.labels import DEFAULT_HORIZON, compute_labels
from split_cli.learning.region import Region, build_grid
from split_cli.logs.assembling.quality import stored_findings
from split_cli.logs.drive import Drive, read_drive, untold_inputs
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.recordings import RecordingCorrection

__all__ = ["LabelResult", "drive_notes", "label_drive"]


@dataclass(frozen=True)
class LabelResult:
    """What became of a drive's samples.

    Attributes
    ----------
    drive : str
    horizon : float
        Label interval [s], a whole number of samples.
    window : int
        Samples in it.
    samples, accepted : int
    rejected : tuple of (str, int)
        By reason, in the order of the tests.
    rms : tuple of float or None
        Root mean square of the accepted labels of v_x, v_y [m/s^2] and r [rad/s^2].
    notes : tuple of str
        What a reader should know of the labels.
    """

    drive: str
    horizon: float
    window: int
    samples: int
    accepted: int
    rejected: tuple[tuple[str, int], ...]
    rms: tuple[float, ...] | None
    notes: tuple[str, ...]


def label_drive(
    drive_path: str | Path,
    vehicle_path: str | Path,
    output: str | Path,
    *,
    features: str = "z2",
    horizon: float = DEFAULT_HORIZON,
    stride: int | None = None,
    plain: bool = False,
    held: Sequence[str] = (),
) -> LabelResult:
    """Compute the labels of a drive and write them as Parquet.

    Parameters
    ----------
    drive_path, vehicle_path, output : path
    features : str
        ``z2``, ``z1`` or a comma-separated list of names.
    horizon, stride, plain
        As for `compute_labels`.
    held : sequence of str
        Inputs that keep their value between samples, whatever the file says.
    """
    refuse_overwriting_inputs(output, (drive_path, vehicle_path))
    vehicle = read_vehicle(vehicle_path)
    correct = RecordingCorrection(vehicle)
    drive = correct(read_drive(drive_path, held))
    region = Region.of(vehicle)
    labels = compute_labels(
        drive, vehicle, parse_features(features), region, horizon=horizon, stride=stride, plain=plain
    )
    if labels.accepted.any():
        labels = labels.inside(build_grid(labels.features, vehicle, region, labels.z[labels.accepted]))
    write_labels(labels, output)
    accepted = labels.y[labels.accepted]
    return LabelResult(
        drive=drive.name,
        horizon=labels.horizon,
        window=labels.window,
        samples=len(labels),
        accepted=len(accepted),
        rejected=tuple(labels.counts().items()),
        rms=tuple(np.sqrt(np.mean(accepted**2, axis=0)).tolist()) if len(accepted) else None,
        notes=(*untold_inputs([drive]), *drive_notes(drive), *correct.notes),
    )


def drive_notes(drive: Drive) -> tuple[str, ...]:
    """Return what a reader of labels should know of a drive's channels, in words."""
    found = stored_findings(drive.metadata.quality)
    told = (f"{drive.name}: ingest found that {'; '.join(found)}",) if found else ()
    kind = str(drive.metadata.kinds.get("T", ""))
    if kind.startswith("derived") and ("a_x" in kind or "dv_x/dt" in kind):
        return (*told, f"{drive.name}: T is {kind}; the longitudinal label then says nothing")
    return told
