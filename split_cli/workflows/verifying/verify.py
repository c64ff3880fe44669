"""Check one file or folder that this program wrote against itself: nothing else is needed."""

import os
from pathlib import Path

import numpy as np

from split_cli.errors import SplitError
from split_cli.files import refuse_no_regular_file, sha256_of_file
from split_cli.learning.training_set import TrainingSet, read_set
from split_cli.workflows.ingesting.ingest_manifest import MANIFEST_NAME
from split_cli.workflows.verifying.relabelled import set_against_drives
from split_cli.workflows.verifying.verification import Verification, VerifiedItem, item
from split_cli.workflows.verifying.verify_files import verify_page, verify_parquet, verify_yaml
from split_cli.workflows.verifying.verify_folders import (
    in_one_line,
    verify_diagnosis,
    verify_drives_folder,
    verify_pages_folder,
)

__all__ = ["Verification", "VerifiedItem", "verify", "verify_set"]

_OF_A_FOLDER = ("manifest.json", "diagnosis.json", MANIFEST_NAME)
"""Files that stand for the folder they lie in."""


def verify(path: str | Path) -> Verification:
    """Check any file of ours, or the folder of an export, diagnosis, evaluation, comparison or of drives.

    Raises
    ------
    SplitError
        If it is none of them, or cannot be read at all.
    """
    path = Path(path)
    refuse_no_regular_file(path)
    if path.name in _OF_A_FOLDER and path.is_file():
        path = path.parent
    if path.is_dir():
        return _folder(path)
    if not path.exists():
        raise SplitError("no such file or folder", where=str(path))
    if path.suffix.lower() == ".split" or _is_arrow(path):
        trained = read_set(path, kernel_numbers=np.inf)
        return Verification(str(path), "trained set", (*verify_set(trained), *set_against_drives(trained, path)))
    if path.suffix.lower() in (".parquet", ".pq"):
        return Verification(str(path), *verify_parquet(path))
    if path.suffix.lower() in (".yaml", ".yml"):
        return Verification(str(path), *verify_yaml(path))
    if path.suffix.lower() in (".html", ".htm"):
        return Verification(str(path), "page", verify_page(path))
    if (path.parent / "manifest.json").is_file():
        advice = f"Its folder is checked as a whole: `split verify {path.parent}`."
        raise SplitError("is checked with the export that it lies in", where=str(path), advice=advice)
    what = "is no file that this program writes"
    raise SplitError(what, where=str(path), advice="`split info` tells what it is.")


def _folder(path: Path) -> Verification:
    if not _is_one_output(path):
        return _several(path)
    if (path / "diagnosis.json").is_file():
        return Verification(str(path), "diagnosis", verify_diagnosis(path))
    if not (path / "manifest.json").is_file():
        return Verification(str(path), *verify_pages_folder(path))
    # An export's checks need CasADi, which takes a second to import and is not needed for sets.
    from split_cli.export.verify import verify_folder

    items = verify_folder(path)
    whole = all(one.passed is not False for one in items)
    return Verification(str(path), "export", (*items, *_set_of_export(path, whole)))


def _is_one_output(folder: Path) -> bool:
    return any((folder / name).is_file() for name in ("diagnosis.json", "manifest.json", "report.html"))


def _several(folder: Path) -> Verification:
    """Check a folder of drives, and what else of ours lies in or below it."""
    below = [p for p in sorted(folder.rglob("*")) if p.is_dir() and _is_one_output(p)]
    inner = [p for p in below if not any(other in p.parents for other in below)]
    items = []
    for path in inner:
        name = str(path.relative_to(folder))
        if (path / "manifest.json").is_file():
            detail = f"an export, whose C would be compiled and run: `split verify {path}`"
            items.append(VerifiedItem(name, None, detail))
        else:
            items.append(in_one_line(name, lambda path=path: _folder(path)))
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".split", ".html") and path.is_file() and not any(p in path.parents for p in inner):
            items.append(in_one_line(str(path.relative_to(folder)), lambda path=path: verify(path)))
    drives = verify_drives_folder(folder, inner, alone=not items)
    return Verification(str(folder), "several outputs" if items else "drives", (*drives, *items))


def _set_of_export(folder: Path, whole: bool) -> tuple[VerifiedItem, ...]:
    """Compare an export with the set that lies in or beside it, by its digest and number by number.

    Empty where none does; numbers are compared only where the export is `whole`.
    """
    from split_cli.export.verify import read_manifest, verify_against_set

    exported = read_manifest(folder).get("set")
    name, digest = (str(exported.get("name", "")), exported.get("sha256")) if isinstance(exported, dict) else ("", None)
    beside = [p / Path(name).name for p in (folder, folder.parent) if os.path.isfile(p / Path(name).name)]
    if not name or not digest or not beside:
        return ()
    same = [path for path in beside if sha256_of_file(path) == digest]
    good = f"{name} beside it is the one that was exported"
    compared = item("trained set", bool(same), good, f"{name} beside it is another one: export it again")
    return (compared, *(verify_against_set(folder, read_set(same[0])) if same and whole else ()))


def _is_arrow(path: Path) -> bool:
    try:
        with path.open("rb") as stream:
            return stream.read(6) == b"ARROW1"
    except OSError as error:
        raise SplitError(f"cannot be read ({error.strerror})", where=str(path)) from error


def verify_set(training_set: TrainingSet) -> tuple[VerifiedItem, ...]:
    """Say what `read_set` has found in a set that it did not refuse, and check what the set says of its drives."""
    s = training_set
    fullest = int(np.diff(s.offsets).max(initial=0))
    read = {
        "content": "the digest in the file is that of its content",
        "cells": f"{s.cell_count} cells ascend, the fullest holds {fullest} of {s.capacity} points",
        "points": f"all {s.size} points are finite and in their cells",
        "gains": "all are 1/[K^-1]_ii of the points of their cell",
    }
    return (*(VerifiedItem(check, True, found) for check, found in read.items()), _sources(s))


def _sources(s: TrainingSet) -> VerifiedItem:
    last = s.sources[-1] if s.sources else None
    counted = last is None or (last.points == s.size and last.cells == s.cell_count)
    good = f"{len(s.sources)} drives, their counts are those of the set"
    return item("sources", counted, good, "the counts of its drives are not those of the set")
