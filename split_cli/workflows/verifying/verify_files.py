"""Checks of drives, labels, vehicles, maps, hyperparameters and pages."""

import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError, reason_of
from split_cli.files import parse_json, sha256_of_file
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.label_file import read_labels
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.logs.signal_map import read_map
from split_cli.signals import CHANNELS
from split_cli.vehicle.effects import build_terms
from split_cli.vehicle.parameters import physics_as_written, read_vehicle
from split_cli.workflows.verifying.relabelled import labels_against_drive
from split_cli.workflows.verifying.verification import VerifiedItem, item
from split_cli.yaml_file import read_yaml_mapping


def verify_parquet(path: Path) -> tuple[str, tuple[VerifiedItem, ...]]:
    """Check a drive, labels or the gap of a diagnosis; return what it is, and what was checked.

    Raises
    ------
    SplitError
        If it is none of them, or damaged: the pages of our Parquet files carry checksums.
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        names = set(pa.parquet.read_schema(path).names)
    except (pa.ArrowException, OSError, ValueError) as error:
        raise SplitError(f"is not a whole Parquet file ({reason_of(error)})", where=str(path)) from error
    if {"drive", "y_vx", "y_vy", "y_r"} <= names:
        text, _ = read_gap(path)
        return "gap of a diagnosis", (VerifiedItem("pages", True, text),)
    if {"y_vx", "y_vy", "y_r", "reason"} <= names:
        return "labels", _labels(path)
    return "drive", verify_drive(read_drive(path), path)


def read_gap(path: Path) -> tuple[str, set[str]]:
    """Return what was checked of the gap of a diagnosis, and the names of its drives.

    Raises
    ------
    SplitError
        If it is damaged.
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        table = pa.parquet.read_table(path, page_checksum_verification=True)
        drives = set(table["drive"].unique().to_pylist())
    except (pa.ArrowException, OSError, ValueError) as error:
        raise SplitError(reason_of(error), where=str(path)) from error
    return f"{table.num_rows} rows, every page with a checksum has it right", drives


def verify_drive(drive: Drive, path: Path) -> tuple[VerifiedItem, ...]:
    """Check ranges, clock, what is stored of noise and origin, and whether the channels fit together."""
    items = [VerifiedItem("pages", True, "every page with a checksum has it right")]
    beyond = [
        f"{name} reaches {np.nanmax(np.abs(values)):.3g} {CHANNELS[name].unit}"
        for name, values in drive.columns.items()
        if name in CHANNELS and np.nanmax(np.abs(values)) > CHANNELS[name].limit
    ]
    missing = [name for name in ("t", "vx", "vy", "r", "T", "delta") if not np.isfinite(drive[name]).all()]
    fault = "; ".join([*beyond, *(f"{name} has samples that are not finite" for name in missing)])
    items.append(item("ranges", not fault, "every channel within what a sensor can mean", fault))
    # A millionth of a period: times are products of a row number, to rounding.
    uneven = sum(
        int(np.count_nonzero(np.abs(np.diff(drive["t"][run]) / drive.period - 1.0) > 1e-6)) for run in drive.segments()
    )
    good = f"{len(drive)} rows {drive.period:g} s apart in {len(drive.segments())} segments"
    items.append(item("clock", uneven == 0, good, f"{uneven} steps in segments differ from {drive.period:g} s"))
    spoiled = [n.channel for n in drive.metadata.noise if n.sigma is not None and not 0.0 <= n.sigma < np.inf]
    items.append(item("noise", not spoiled, "stored deviations are numbers of 0 and above", ", ".join(spoiled)))
    items += compare_sources([path.parent], ((s.name, s.sha256) for s in drive.metadata.sources), path)
    findings = check_consistency(drive, None, drive.metadata.kinds).findings
    wrong = [f.text for f in findings if f.check in ("scale", "sign", "hand", "swapped", "range", "clock")]
    items.append(item("physical consistency", not wrong, "the channels fit together", "; ".join(wrong)[:400]))
    return tuple(items)


def _labels(path: Path) -> tuple[VerifiedItem, ...]:
    labels = read_labels(path)
    accepted = labels.y[labels.accepted]
    finite = bool(np.isfinite(accepted).all() and np.isfinite(labels.z[labels.accepted]).all())
    rows_rise = bool((np.diff(labels.row) > 0).all())
    found = compare_sources([path.parent], [(labels.drive, labels.sha256)], path)
    return (
        VerifiedItem("pages", True, "every page with a checksum has it right"),
        item("accepted labels", finite, f"{len(accepted)} of {len(labels)}, all finite", "some are not finite"),
        item("rows", rows_rise, "rows of the drive ascend", "rows of the drive do not ascend"),
        *found,
        *labels_against_drive(labels, path),
    )


def compare_sources(
    folders: Iterable[Path], sources: Iterable[tuple[str, str]], but: Path | None = None
) -> list[VerifiedItem]:
    """Compare sources that lie in a folder with the digests that are stored; others cannot be checked here.

    Parameters
    ----------
    sources : iterable of (str, str)
        Name and SHA-256.
    but : Path, optional
        The file that names them, which may have the name of its own source.
    """
    items, folders, sources = [], list(folders), list(sources)
    for name, digest in sources:
        beside = [folder / Path(name).name for folder in folders]
        beside = [path for path in beside if os.path.isfile(path) and path != but]
        check = f"source {name}"
        if not digest:
            items.append(VerifiedItem(check, None, "its digest was not stored"))
        elif not beside:
            items.append(VerifiedItem(check, None, f"not here; its SHA-256 was {digest[:12]}"))
        else:
            found = {sha256_of_file(path) for path in beside}
            # A recording and its simulation may have one name, in two folders.
            namesakes = {other for path, other in sources if Path(path).name == Path(name).name}
            if digest not in found and found <= namesakes:
                items.append(VerifiedItem(check, None, "not here; the file beside it is another source of this name"))
                continue
            items.append(
                item(check, digest in found, "the file beside it is the one", "the file beside it is another one")
            )
    return items or [VerifiedItem("sources", None, "none is named")]


def verify_yaml(path: Path) -> tuple[str, tuple[VerifiedItem, ...]]:
    """Check a vehicle, a signal map or hyperparameters by reading it as the commands do."""
    content = read_yaml_mapping(path, SplitError)
    if "length_scales" in content:
        scales = content["length_scales"]
        names = tuple(map(str, scales)) if isinstance(scales, dict) else ()
        read_kernel(path, FeatureSet(names))
        good = f"positive, for {', '.join(names)} and {', '.join(OUTPUTS)}"
        return "hyperparameters", (VerifiedItem("values", True, good),)
    if "channels" in content or "preset" in content:
        found = read_map(path)
        return "signal map", (VerifiedItem("entries", True, f"{len(found.channels)} channels, every key known"),)
    return "vehicle", _vehicle(path)


def _vehicle(path: Path) -> tuple[VerifiedItem, ...]:
    car = read_vehicle(path)
    text = f"{car.name}: every value within what vehicles have, physics {car.digest()[:12]}"
    written = physics_as_written(path.read_text(encoding="utf-8"))
    items = [VerifiedItem("values", True, text)]
    if car.effects:
        items.append(VerifiedItem("effects", True, f"{len(build_terms(car))} terms of the catalogue, complete"))
    if written is not None:
        same = written == car.digest()
        items.append(item("as written", same, "no value was changed since", "values were changed since, by hand"))
    return tuple(items)


def verify_page(path: Path) -> tuple[VerifiedItem, ...]:
    """Check that a page is whole and that the numbers its charts are drawn from can be read.

    Raises
    ------
    SplitError
        If it is none of ours.
    """
    text = path.read_text(encoding="utf-8", errors="replace")
    numbers = re.search(r'id="numbers">(.*?)</script>', text, flags=re.DOTALL)
    if numbers is None:
        raise SplitError("is no page that this program writes", where=str(path))
    try:
        readable = isinstance(parse_json(numbers[1]), dict)
    except ValueError:
        readable = False
    whole = readable and text.rstrip().endswith("</html>")
    return (item("page", whole, "whole, and its numbers can be read", "it is cut off or damaged"),)
