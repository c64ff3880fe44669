"""Checks of folders that this program wrote: a diagnosis, an evaluation, a comparison, drives."""

import csv
import math
import os
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from split_cli.errors import SplitError
from split_cli.files import DIGESTS, parse_json, sha256_of_file
from split_cli.logs.drive import metadata_of_drive
from split_cli.vehicle.effects import build_terms
from split_cli.vehicle.parameters import physics_as_written, read_vehicle
from split_cli.workflows.ingesting.ingest_manifest import IngestManifest
from split_cli.workflows.report.payload import shown_digest
from split_cli.workflows.verifying.verification import Verification, VerifiedItem, item
from split_cli.workflows.verifying.verify_files import compare_sources, read_gap, verify_page, verify_parquet

_VERDICTS = ("match", "mismatch", "undecided")
_TABLE = "compare.csv"


def verify_diagnosis(folder: Path) -> tuple[VerifiedItem, ...]:
    """Check a diagnosis: its document, the report against it, the vehicles and the gap beside it.

    Raises
    ------
    SplitError
        If the document is no JSON of this version.
    """
    path = folder / "diagnosis.json"
    try:
        document = parse_json(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise SplitError(f"is no JSON ({error})", where=str(path)) from error
    if not isinstance(document, dict) or document.get("schema") != "split-diagnosis/1":
        raise SplitError("is no diagnosis of this version", where=str(path))
    items = [*_digests(folder), _checked("document", lambda: _document(document))]
    inputs = document.get("inputs")
    inputs = [i for i in inputs if isinstance(i, dict)] if isinstance(inputs, list) else []
    named = [(str(i.get("name")), str(i.get("sha256"))) for i in inputs]
    items += compare_sources((folder, folder.absolute().parent), named)
    report = folder / "report.html"
    if report.is_file():
        items.append(_checked("report against document", lambda: _report(folder, document)))
    else:
        items.append(VerifiedItem("report against document", False, "report.html is missing"))
    for name in ("vehicle_corrected.yaml", "vehicle_rejected.yaml"):
        if (folder / name).is_file():
            items.append(_checked(name, lambda name=name: _effects(folder / name, document)))
    if (folder / "gap.parquet").is_file():
        items.append(_checked("gap.parquet", lambda: _gap(folder / "gap.parquet", document)))
    return tuple(items)


def _document(document: dict[str, Any]) -> str:
    if document.get("verdict") not in _VERDICTS:
        raise SplitError(f"its verdict is {document.get('verdict')!r}")
    findings = document["findings"]
    if findings and document["verdict"] != "mismatch":
        raise SplitError(f"{len(findings)} findings beside the verdict {document['verdict']}")
    for finding in findings:
        for name, estimate in finding["parameters"].items():
            low, high = estimate["interval_95"]
            if not low <= estimate["value"] <= high:
                raise SplitError(f"{finding['term']}.{name} lies outside its own interval")
    return f"{document['verdict']}, {len(findings)} findings, every value within its interval"


def _report(folder: Path, document: dict[str, Any]) -> str:
    """Return what of the document the page shows."""
    page = (folder / "report.html").read_text("utf-8")
    wanted = [*(f["term"] for f in document["findings"]), *(i["sha256"] for i in document["inputs"])]
    absent = [text for text in wanted if text not in page]
    if absent:
        raise SplitError(f"the page does not show {', '.join(absent[:3])}: it is of another diagnosis")
    _require_shown(folder, "diagnosis.json")
    return f"shows all {len(document['findings'])} findings and the digests of {len(document['inputs'])} inputs"


def _require_shown(folder: Path, name: str) -> None:
    """Refuse a page that shows the numbers of another file; one of an earlier version does not say of which."""
    shown = shown_digest((folder / "report.html").read_text("utf-8"))
    if shown is not None and shown != sha256_of_file(folder / name):
        raise SplitError(f"the page shows the numbers of another {name}")


def _effects(path: Path, document: dict[str, Any]) -> str:
    """Return what the vehicle of a diagnosis has of its findings; faults of sensors are none of the car's."""
    car = read_vehicle(path)
    written = physics_as_written(path.read_text(encoding="utf-8"))
    if written is not None and written != car.digest():
        raise SplitError("its values were changed since it was written")
    build_terms(car)  # refuses what no term is, or lacks
    named, alone = 0, (document.get("corrected_vehicle") or {}).get("values", {})
    for finding in document["findings"]:
        found = {name: p["value"] for name, p in finding["parameters"].items()}
        values = alone.get(finding["term"], found)
        same_term = [dict(effect.parameters) for effect in car.effects if effect.term == finding["term"]]
        if same_term and values not in same_term:
            raise SplitError(f"its {finding['term']} has other values than the document")
        named += bool(same_term)
    return f"reads as {car.name}, with the values of {named} findings"


def _gap(path: Path, document: dict[str, Any]) -> str:
    text, drives = read_gap(path)
    strange = drives - {one["name"] for one in document["inputs"]}
    if strange:
        raise SplitError(f"is of {', '.join(sorted(strange))}, which the document does not name")
    return text


def _checked(check: str, run: Callable[[], str]) -> VerifiedItem:
    try:
        return VerifiedItem(check, True, run())
    except (SplitError, LookupError, TypeError, ValueError, AttributeError, ArithmeticError, OSError) as error:
        # Whatever a forged document leads to in the check that reads it.
        return VerifiedItem(check, False, str(error)[:400] or type(error).__name__)


def _digests(folder: Path) -> list[VerifiedItem]:
    """Compare the files of a folder with the digests that were written beside them."""
    listed = folder / DIGESTS
    if not listed.is_file():
        return [VerifiedItem("digests", None, f"{DIGESTS} is missing, as in folders of earlier versions")]
    items = []
    for line in listed.read_text(encoding="utf-8", errors="replace").splitlines():
        digest, _, name = line.partition("  ")
        path = folder / name
        if len(digest) != 64 or not name or not path.absolute().is_relative_to(folder.absolute()) or ".." in name:
            items.append(VerifiedItem("digests", False, f"{DIGESTS} is damaged"))
        elif not os.path.isfile(path):
            items.append(VerifiedItem(name, False, "is missing"))
        else:
            items.append(item(name, sha256_of_file(path) == digest, "as written", "is not the file that was written"))
    return items


def verify_pages_folder(folder: Path) -> tuple[str, tuple[VerifiedItem, ...]]:
    """Check the folder of an evaluation or of a comparison; return what it is, and what was checked."""
    items = [*_digests(folder), *verify_page(folder / "report.html")]
    if (folder / _TABLE).is_file():
        items.append(_checked(f"report against {_TABLE}", lambda: _compared(folder)))
        return "comparison", tuple(items)
    return "evaluation", tuple(items)


def _compared(folder: Path) -> str:
    with (folder / _TABLE).open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    for row in rows:
        low, value, high = float(row["low_95"]), float(row["rmse"]), float(row["high_95"])
        # Of too few blocks of time no interval is known.
        known = not (math.isnan(low) and math.isnan(high))
        if not (0.0 <= low <= value <= high if known else value >= 0.0):
            raise SplitError(f"{row['model']}, {row['state']}: {value} lies outside its interval")
    _require_shown(folder, _TABLE)
    return f"{len(rows)} errors, each within its interval; the page shows them"


def in_one_line(name: str, check: Callable[[], Verification]) -> VerifiedItem:
    """Return the checks of one file or folder among several as a single one."""
    try:
        found = check()
    except SplitError as error:
        return VerifiedItem(name, False, str(error))
    failed = [f"{i.check}: {i.detail}" for i in found.items if i.passed is False]
    return item(name, not failed, f"{found.kind}, as `split verify` of it alone", "; ".join(failed))


def verify_drives_folder(folder: Path, inner: Sequence[Path] = (), *, alone: bool = True) -> list[VerifiedItem]:
    """Check a folder of drives: each against its manifest, where there is one, and against itself.

    Parameters
    ----------
    inner : sequence of Path
        Folders in it that are checked as a whole.
    alone : bool
        Whether nothing else was found in the folder.

    Raises
    ------
    SplitError
        If the folder holds nothing of ours.
    """
    items = []
    manifest = IngestManifest.of(folder)
    for place, entry in sorted(manifest.entries.items()):
        drive = folder / entry["drive"]
        bad = "is not the drive that was written"
        if not drive.is_file():
            bad = "is missing"
        elif sha256_of_file(drive) == entry["sha256"]:
            bad = "" if _is_made_of(drive, entry["source"]) else "was made of another source than is entered"
        items.append(item(f"{entry['drive']} of {place}", not bad, "as written", bad))
    drives = [p for p in sorted(folder.rglob("*.parquet")) if p.is_file() and not {*inner} & {*p.parents}]
    if alone and not drives and not items:
        advice = "Name a file, or the folder that `split export`, `diagnose` or `ingest` wrote."
        raise SplitError("holds neither an export, nor a diagnosis, nor drives", where=str(folder), advice=advice)
    for path in drives:
        name = str(path.relative_to(folder))
        items.append(in_one_line(name, lambda path=path: Verification(str(path), *verify_parquet(path))))
    return items


def _is_made_of(drive: Path, source: str) -> bool:
    """Tell whether a drive names the source that a manifest has for it; that of a remote one is no digest."""
    metadata = metadata_of_drive(drive)
    digests = [s.sha256 for s in metadata.sources if s.sha256] if metadata is not None else []
    return len(digests) != 1 or len(source) != 64 or digests == [source]
