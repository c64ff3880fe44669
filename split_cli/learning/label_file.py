"""Labels as a file: Parquet, one row a window."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet

from split_cli.errors import DriveError
from split_cli.files import atomic_path, parse_json
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS
from split_cli.learning.labels import Labels, Reason
from split_cli.learning.region import Region
from split_cli.learning.set_limits import FOUND, LARGEST_LABEL, check_labels_header
from split_cli.signals import CHANNELS

LABELS_FORMAT = "split-labels/1"


def write_labels(labels: Labels, path: str | Path) -> None:
    """Write labels as Parquet, whole or not at all; equal labels give equal bytes.

    Columns are ``t, row, segment``, one a feature, ``y_vx, y_vy, y_r`` and ``reason``, empty where accepted.
    """
    columns = label_columns(labels)
    stored = {
        "format": LABELS_FORMAT,
        "drive": labels.drive,
        "sha256": labels.sha256,
        "vehicle_digest": labels.vehicle_digest,
        "features": list(labels.features.names),
        "region": asdict(labels.region),
        "horizon": labels.horizon,
        "window": labels.window,
        "plain": labels.plain,
        "start_time": labels.start_time,
        "duration": labels.duration,
        "samples": len(labels),
        **{name: list(found) for name in FOUND if (found := getattr(labels, name))},
    }
    metadata = {b"split": json.dumps(stored, sort_keys=True).encode()}
    with atomic_path(path) as temporary:
        table = pa.table(columns).replace_schema_metadata(metadata)
        pa.parquet.write_table(table, temporary, compression="zstd", write_page_checksum=True)


def label_columns(labels: Labels) -> dict[str, pa.Array]:
    """Return the columns of a file of labels, by name."""
    words = [reason.word for reason in Reason]
    return {
        "t": pa.array(labels.t),
        "row": pa.array(labels.row.astype(np.int64)),
        "segment": pa.array(labels.segment.astype(np.int32)),
        # A feature named t is that column already.
        **{name: pa.array(labels.z[:, i]) for i, name in enumerate(labels.features.names)},
        **{f"y_{output}": pa.array(labels.y[:, i]) for i, output in enumerate(OUTPUTS)},
        "reason": pa.DictionaryArray.from_arrays(pa.array(labels.reason.astype(np.int8)), pa.array(words)),
    }


def drive_of_labels(path: str | Path) -> str | None:
    """Return the SHA-256 of the drive that a label file is of; None of any other file."""
    if not Path(path).is_file():
        return None
    try:
        stored = parse_json((pa.parquet.read_schema(path).metadata or {})[b"split"])
        return str(stored["sha256"]) if str(stored["format"]).startswith("split-labels/") else None
    except (pa.ArrowException, OSError, KeyError, TypeError, ValueError):
        return None


def read_labels(path: str | Path) -> Labels:
    """Read labels that `write_labels` wrote.

    Raises
    ------
    DriveError
        If the file is missing, damaged, no label file of this version, or not whole: rows are lacking, are out of
        order, or are accepted without being finite.
    """
    where = str(path)
    advice = "Labels are the Parquet that `split label` writes."
    if not Path(path).is_file():
        raise DriveError("no such file", where=where, advice="Name a file that `split label` wrote.")
    try:
        table = pa.parquet.read_table(path, page_checksum_verification=True)
        stored = parse_json((table.schema.metadata or {})[b"split"])
        if stored["format"] != LABELS_FORMAT:
            what = f"is of format {stored['format']!r}, {LABELS_FORMAT!r} was expected"
            raise DriveError(what, where=where, advice=advice)
        check_labels_header(stored)
        labels = _labels_from_table(table, stored)
    except (AttributeError, pa.ArrowException, OSError, KeyError, TypeError, ValueError) as error:
        raise DriveError(f"cannot be read as labels ({error})", where=where, advice=advice) from error
    fault = _fault(labels, stored.get("samples", len(labels)))
    if fault:
        raise DriveError(f"is not whole: {fault}", where=where, advice="Write it again with `split label`.")
    return labels


def _fault(labels: Labels, samples: int) -> str:
    """Return what contradicts itself in labels that were read, in words; empty where nothing does."""
    if samples != len(labels):
        return f"{len(labels)} rows, {samples} were written"
    used = labels.accepted
    numbers = np.column_stack([labels.t / CHANNELS["t"].limit, labels.y / LARGEST_LABEL])
    usable = (np.abs(numbers) <= 1.0).all(axis=1) & np.isfinite(labels.z).all(axis=1)
    unfinished = used & ~usable
    if unfinished.any():
        row = int(np.argmax(unfinished))
        return f"row {row} is accepted, but its time, features or labels are not finite or too large"
    disorder = np.diff(labels.row, prepend=-1) <= 0
    return f"row {int(np.argmax(disorder))} is out of order" if disorder.any() else ""


def _labels_from_table(table: pa.Table, stored: Mapping[str, Any]) -> Labels:
    features = FeatureSet(tuple(stored["features"]))
    codes = {reason.word: int(reason) for reason in Reason}
    words = table["reason"].to_pylist()
    described = ("drive", "sha256", "vehicle_digest", "horizon", "window", "plain", "start_time", "duration")
    return Labels(
        **{name: stored[name] for name in described},
        faults=tuple(stored.get("faults", ())),
        remarks=tuple(stored.get("remarks", ())),
        circular=tuple(stored.get("circular", ())),
        features=features,
        region=Region(**stored["region"]),
        t=table["t"].to_numpy(),
        row=table["row"].to_numpy(),
        segment=table["segment"].to_numpy(),
        z=np.stack([table[name].to_numpy() for name in features.names], axis=1),
        y=np.stack([table[f"y_{output}"].to_numpy() for output in OUTPUTS], axis=1),
        reason=np.array([codes[word] for word in words], dtype=np.int8),
    )
