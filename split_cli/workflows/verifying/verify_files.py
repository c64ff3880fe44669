"""Checks of drives, labels, vehicles, maps, hyperparameters, diagnoses and folders of drives."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import parse_json, sha256_of_file
from split_cli.learning.features import FeatureSet
from split_cli.learning.kernel import OUTPUTS
from split_cli.learning.kernel_file import read_kernel
from split_cli.learning.label_file import read_labels
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.logs.signal_map import read_map
from split_cli.signals import CHANNELS
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.ingesting.ingest_manifest import IngestManifest
from split_cli.workflows.verifying.verification import VerifiedItem, item
from split_cli.yaml_file import read_yaml_mapping

__all__ = [
    "is_diagnosis",
    "verify_diagnosis",
    "verify_drive",
    "verify_drives_folder",
    "verify_parquet",
    "verify_yaml",
]

_VERDICTS = ("match", "mismatch", "undecided")


def verify_parquet(path: Path) -> tuple[str, tuple[VerifiedItem, ...]]:
    """Check a drive or labels; return what it is, and what was checked.

    Raises
    ------
    SplitError
        If it is neither, or damaged: the pages of our Parquet files carry checksums.
    """
    import pyarrow as pa
    import pyarrow.parquet

    try:
        names = set(pa.parquet.read_schema(path).names)
    except (pa.ArrowException, OSError) as error:
        raise SplitError(f"is not a whole Parquet file ({str(error).splitlines()[0]})", where=str(path)) from error
    if {"y_vx", "y_vy", "y_r", "reason"} <= names:
        return "labels", _labels(path)
    return "drive", verify_drive(read_drive(path), path)


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
        int(np.count_nonzero(np.abs(np.diff(drive["t"][run]) / drive.period - 1.0) > 1e-6))
        for run in drive.segments()
    )
    good = f"{len(drive)} rows {drive.period:g} s apart in {len(drive.segments())} segments"
    items.append(item("clock", uneven == 0, good, f"{uneven} steps in segments differ from {drive.period:g} s"))
    spoiled = [n.channel for n in drive.metadata.noise if n.sigma is not None and not 0.0 <= n.sigma < np.inf]
    items.append(item("noise", not spoiled, "stored deviations are numbers of 0 and above", ", ".join(spoiled)))
    items += _sources(path, ((s.name, s.sha256) for s in drive.metadata.sources))
    findings = check_consistency(drive, None, drive.metadata.kinds).findings
    wrong = [f.text for f in findings if f.check in ("scale", "sign", "swapped", "range")]
    items.append(item("physical consistency", not wrong, "the channels fit together", "; ".join(wrong)[:400]))
    return tuple(items)


def _labels(path: Path) -> tuple[VerifiedItem, ...]:
    labels = read_labels(path)
    accepted = labels.y[labels.accepted]
    finite = bool(np.isfinite(accepted).all() and np.isfinite(labels.z[labels.accepted]).all())
    rows_rise = bool((np.diff(labels.row) > 0).all())
    found = _sources(path, [(labels.drive, labels.sha256)])
    return (
        VerifiedItem("pages", True, "every page with a checksum has it right"),
        item("accepted labels", finite, f"{len(accepted)} of {len(labels)}, all finite", "some are not finite"),
        item("rows", rows_rise, "rows of the drive ascend", "rows of the drive do not ascend"),
        *found,
    )


def _sources(path: Path, sources: Iterable[tuple[str, str]]) -> list[VerifiedItem]:
    """Compare sources that lie beside a file with the digests it holds; others cannot be checked here."""
    items = []
    for name, digest in sources:
        beside = path.parent / Path(name).name
        check = f"source {name}"
        if not digest:
            items.append(VerifiedItem(check, None, "its digest was not stored"))
        elif not beside.is_file() or beside == path:
            items.append(VerifiedItem(check, None, f"not here; its SHA-256 was {digest[:12]}"))
        else:
            same = sha256_of_file(beside) == digest
            items.append(item(check, same, "the file beside it is the one", "the file beside it is another one"))
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
    car = read_vehicle(path)
    told = f"{car.name}: every value within what vehicles have, physics {car.digest()[:12]}"
    return "vehicle", (VerifiedItem("values", True, told),)


def is_diagnosis(folder: Path) -> bool:
    """Tell the folder of a diagnosis by its main file."""
    return (folder / "diagnosis.json").is_file()


def verify_diagnosis(folder: Path) -> tuple[VerifiedItem, ...]:
    """Check a diagnosis: its document, the report against it, the vehicles and the gap beside it.

    Raises
    ------
    SplitError
        If the document is no JSON of this version.
    """
    path = folder / "diagnosis.json"
    try:
        told = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SplitError(f"is no JSON ({error})", where=str(path)) from error
    if not isinstance(told, dict) or told.get("schema") != "split-diagnosis/1":
        raise SplitError("is no diagnosis of this version", where=str(path))
    items = [_checked("document", lambda: _document(told))]
    items += _sources(path, [(i["name"], i["sha256"]) for i in told.get("inputs", ()) if isinstance(i, dict)])
    report = folder / "report.html"
    if report.is_file():
        items.append(_checked("report against document", lambda: _report(report.read_text("utf-8"), told)))
    else:
        items.append(VerifiedItem("report against document", False, "report.html is missing"))
    for name in ("vehicle_corrected.yaml", "vehicle_rejected.yaml"):
        if (folder / name).is_file():
            items.append(_checked(name, lambda name=name: f"reads as {read_vehicle(folder / name).name}"))
    if (folder / "gap.parquet").is_file():
        items.append(_checked("gap.parquet", lambda: _gap(folder / "gap.parquet")))
    return tuple(items)


def _document(told: dict[str, Any]) -> str:
    if told.get("verdict") not in _VERDICTS:
        raise SplitError(f"its verdict is {told.get('verdict')!r}")
    findings = told["findings"]
    if findings and told["verdict"] != "mismatch":
        raise SplitError(f"{len(findings)} findings beside the verdict {told['verdict']}")
    for finding in findings:
        for name, estimate in finding["parameters"].items():
            low, high = estimate["interval_95"]
            if not low <= estimate["value"] <= high:
                raise SplitError(f"{finding['term']}.{name} lies outside its own interval")
    return f"{told['verdict']}, {len(findings)} findings, every value within its interval"


def _report(page: str, told: dict[str, Any]) -> str:
    """Return what of the document the page shows."""
    wanted = [*(f["term"] for f in told["findings"]), *(i["sha256"] for i in told["inputs"])]
    absent = [text for text in wanted if text not in page]
    if absent:
        raise SplitError(f"the page does not show {', '.join(absent[:3])}: it is of another diagnosis")
    return f"shows all {len(told['findings'])} findings and the digests of {len(told['inputs'])} inputs"


def _gap(path: Path) -> str:
    import pyarrow as pa
    import pyarrow.parquet

    try:
        table = pa.parquet.read_table(path, page_checksum_verification=True)
    except (pa.ArrowException, OSError) as error:
        raise SplitError(str(error).splitlines()[0]) from error
    return f"{table.num_rows} rows, every page with a checksum has it right"


def _checked(check: str, run: Callable[[], str]) -> VerifiedItem:
    try:
        return VerifiedItem(check, True, run())
    except (SplitError, KeyError, TypeError, ValueError, OSError) as error:
        return VerifiedItem(check, False, str(error) or type(error).__name__)


def verify_drives_folder(folder: Path) -> tuple[VerifiedItem, ...]:
    """Check a folder of drives: each against its manifest, where there is one, and against itself."""
    items = []
    manifest = IngestManifest.of(folder)
    for place, entry in sorted(manifest.entries.items()):
        drive = folder / entry["drive"]
        is_same = drive.is_file() and sha256_of_file(drive) == entry["sha256"]
        bad = "is missing" if not drive.is_file() else "is not the drive that was written"
        items.append(item(f"{entry['drive']} of {place}", is_same, "as written", bad))
    drives = sorted(p for p in folder.rglob("*.parquet") if p.is_file())
    if not drives and not items:
        raise SplitError(
            "holds neither an export, nor a diagnosis, nor drives",
            where=str(folder),
            advice="Name a file, or the folder that `split export`, `diagnose` or `ingest` wrote.",
        )
    for drive in drives:
        name = str(drive.relative_to(folder))
        try:
            failed = [i for i in verify_parquet(drive)[1] if i.passed is False]
        except SplitError as error:
            items.append(VerifiedItem(name, False, str(error)))
            continue
        bad = "; ".join(f"{i.check}: {i.detail}" for i in failed)
        items.append(item(name, not failed, "pages, ranges, clock and physics", bad))
    return tuple(items)
