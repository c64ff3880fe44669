"""Checking an export that already lies in a folder: hashes, then answers."""

import json
import os
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import ExportError, SplitError
from split_cli.export.c_check import run_selftest
from split_cli.export.casadi_function import casadi_answer, observer_answer
from split_cli.export.check import TOLERANCE, ExportAnswer, reference_of
from split_cli.export.compiler import find_compiler
from split_cli.export.documents import document_answer, other_than_set, read_json, read_npz, relearned_error
from split_cli.export.step_check import OBSERVER_TOLERANCE, STEP_TOLERANCE
from split_cli.export.targets import MANIFEST, MANIFEST_FORMAT
from split_cli.export.verified import VerifiedItem
from split_cli.files import ScratchFolder, parse_json, sha256_of_file
from split_cli.learning.training_set import TrainingSet
from split_cli.prediction import make_predictor

RELEARNED = 1e-6
"""Of means in signal deviations and variances in signal variances [1]: sums of thousands of labels are rounded
otherwise by other libraries."""

_READERS = {"npz": read_npz, "json": read_json}


def read_manifest(folder: Path) -> dict[str, Any]:
    """Return an export's manifest.

    Raises
    ------
    ExportError
        If there is none, or it is damaged or of another version.
    """
    path = folder / MANIFEST
    try:
        manifest = parse_json(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        advice = "Name a folder that `split export` wrote."
        raise ExportError("holds no export: manifest.json is missing", where=str(folder), advice=advice) from None
    except (OSError, ValueError) as error:
        raise ExportError(f"is damaged ({error})", where=str(path), advice="Export the set again.") from error
    if not isinstance(manifest, dict) or manifest.get("format") != MANIFEST_FORMAT:
        found = manifest.get("format") if isinstance(manifest, dict) else type(manifest).__name__
        what = f"is of format {found!r}, this version reads {MANIFEST_FORMAT!r}"
        raise ExportError(what, where=str(path), advice="Export the set again.")
    if not _is_sound(manifest):
        raise ExportError(
            "is damaged (it lacks keys or names files elsewhere)", where=str(path), advice="Export the set again."
        )
    return manifest


def _is_sound(manifest: dict[str, Any]) -> bool:
    name, targets, files = (manifest.get(key) for key in ("name", "targets", "files"))
    if not (isinstance(files, dict) and files and isinstance(targets, list) and targets) or "real" not in manifest:
        return False
    return all(isinstance(one, str) and one and Path(one).name == one for one in (name, *files, *targets))


@np.errstate(all="ignore")  # of forged numbers; what is not finite then is within no tolerance
def verify_folder(folder: str | Path) -> tuple[VerifiedItem, ...]:
    """Check the hash of every file of an export, then ask every target its stored check points.

    Returns
    -------
    tuple of Finding

    Raises
    ------
    ExportError
        If the folder holds no export.
    """
    folder = Path(folder)
    manifest = read_manifest(folder)
    findings = [_hash(folder / name, expected) for name, expected in sorted(manifest["files"].items())]
    others = sorted(path.name for path in folder.iterdir() if path.name not in (MANIFEST, *manifest["files"]))
    if others:
        shown = ", ".join(others[:5]) + (f" and {len(others) - 5} more" if len(others) > 5 else "")
        findings.append(VerifiedItem("other files", None, f"not of this export, perhaps of an older one: {shown}"))
    if any(finding.passed is False for finding in findings):
        # Answers of files that are not those written would prove nothing.
        return tuple(findings)
    checks: dict[str, Callable[[Path, str], VerifiedItem]] = {
        "c": _verify_c,
        "casadi": _verify_casadi,
        "ggv": _verify_ggv,
        **{target: partial(_verify_document, target) for target in _READERS},
    }
    for target in manifest["targets"]:
        try:
            findings.append(checks[target](folder, manifest["name"]))
        except (
            ExportError,
            LookupError,
            TypeError,
            ValueError,
            AttributeError,
            ArithmeticError,
            RuntimeError,
        ) as error:
            # Whatever forged points lead to in the target that is asked for them.
            findings.append(VerifiedItem(f"{target}: answers", False, str(error)[:400] or type(error).__name__))
    return tuple(findings)


def _hash(path: Path, expected: str) -> VerifiedItem:
    what = f"{path.name}: SHA-256"
    if not os.path.isfile(path):
        return VerifiedItem(what, False, "the file is missing")
    found = sha256_of_file(path)
    return VerifiedItem(what, found == expected, "as written" if found == expected else f"is {found}")


def _verify_c(folder: Path, name: str) -> VerifiedItem:
    compiler = find_compiler()
    if compiler is None:
        return VerifiedItem("c: self-test", None, "there is no C compiler here")
    with ScratchFolder() as scratch:
        for suffix in (".h", ".c", "_selftest.c"):
            (scratch / f"{name}{suffix}").write_bytes((folder / f"{name}{suffix}").read_bytes())
        said = run_selftest(compiler, scratch, name)
        return VerifiedItem("c: self-test", True, "; ".join(said.splitlines()))


def _verify_casadi(folder: Path, name: str) -> VerifiedItem:
    import casadi

    try:
        predict = casadi.Function.load(str(folder / f"{name}.casadi"))
    except RuntimeError as error:
        advice = "Export the set again on this machine."
        raise ExportError(f"cannot be loaded ({str(error).splitlines()[-1]})", advice=advice) from error
    asked = _ask(casadi_answer(predict), folder, name, "casadi")
    stored = json.loads((folder / f"{name}_check.json").read_text())
    passed, details = asked.passed, [asked.detail]
    for key, function, error_of, tolerance, where in (
        ("drives", "step", _drive, STEP_TOLERANCE, "on stored drives"),
        ("observed", "observe", _observe, OBSERVER_TOLERANCE, "of the running trust"),
    ):
        if passed and key in stored:
            worst = error_of(casadi.Function.load(str(folder / f"{name}_{function}.casadi")), stored[key])
            allowed = 10.0 * tolerance["double"]
            details.append(f"{worst:.3g} {where}, {allowed:g} is allowed")
            passed = worst <= allowed
    return VerifiedItem(asked.check, passed, "; ".join(details))


def _drive(step: Any, stored: dict[str, Any]) -> float:
    """Return the largest relative error of a step over the stored drives."""
    u, place_time, expected = (np.array(stored[key]) for key in ("u", "place_time", "x"))
    path = [expected[0]]
    for at, place in zip(u, place_time, strict=True):
        given = [path[-1].T, at.T, stored["h"], place.T][: step.n_in()]
        path.append(np.asarray(step.map(len(at))(*given)).T)
    return float((np.abs(np.stack(path) - expected) / (1.0 + np.abs(expected))).max())


def _observe(observe: Any, stored: dict[str, Any]) -> float:
    """Return the largest relative error of the running trust after the stored intervals."""
    expected = np.array(stored["trust"])
    found = observer_answer(observe)(np.array(stored["asked"]))
    return float((np.abs(found - expected) / (1.0 + np.abs(expected))).max())


def _verify_document(target: str, folder: Path, name: str) -> VerifiedItem:
    """Ask the stored check points; a projected process must be what its points teach, too."""
    document = _READERS[target](folder / f"{name}.{target}")
    asked = _ask(document_answer(document), folder, name, target)
    error = relearned_error(document, _check_points(folder, name)["z"]) if asked.passed else None
    if error is None:
        return asked
    detail = f"{asked.detail}; {error:.3g} from a process that learns its points again, {RELEARNED:g} is allowed"
    return VerifiedItem(asked.check, error <= RELEARNED, detail)


@np.errstate(all="ignore")
def verify_against_set(folder: Path, training_set: TrainingSet) -> tuple[VerifiedItem, ...]:
    """Compare an export with the set that it was made of: its points number by number, and its stored answers."""
    manifest = read_manifest(folder)
    name, items = manifest["name"], []
    for target in (one for one in _READERS if one in manifest["targets"]):
        others = other_than_set(_READERS[target](folder / f"{name}.{target}"), training_set)
        text = f"{', '.join(others)} differ from those of the set" if others else "those of the set, bit for bit"
        items.append(VerifiedItem(f"{target}: points", not others, text))

    def answers(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        predicted = reference.predict(z)
        return predicted.mean, predicted.variance

    try:
        reference = reference_of(make_predictor(manifest["predictor"], training_set))
        items.append(_ask(ExportAnswer(answers), folder, name, "set"))
    except (SplitError, LookupError, TypeError, ValueError, ArithmeticError) as error:
        items.append(VerifiedItem("set: answers", False, str(error)[:400] or type(error).__name__))
    return tuple(items)


def _verify_ggv(folder: Path, name: str) -> VerifiedItem:
    table = np.loadtxt(folder / f"{name}_ggv.csv", delimiter=",")
    rising = bool((np.diff(table[:, 0]) > 0).all() and (table[:, 1:] > 0).all())
    return VerifiedItem("ggv: limits", rising, f"{len(table)} speeds, ascending, every limit above 0")


def _check_points(folder: Path, name: str) -> dict[str, np.ndarray]:
    stored = json.loads((folder / f"{name}_check.json").read_text())
    return {key: np.array(values) for key, values in stored.items()}


def _ask(answer: ExportAnswer, folder: Path, name: str, target: str) -> VerifiedItem:
    """Ask the stored check points; another machine's mathematics library is allowed ten times the tolerance."""
    points = _check_points(folder, name)
    mean, variance = answer.predict(points["z"])
    scale = points["signal_variance"]
    errors = np.abs(mean - points["mean"]) / np.sqrt(scale), np.abs(variance - points["variance"]) / scale
    worst = float(np.max(errors))  # NaN, if one of them is
    # What rounding leaves of this set; a file that claims more than single precision loses is not believed.
    accuracy = float(points.get("accuracy", TOLERANCE["double"]))
    allowed = 10.0 * (accuracy if 0.0 < accuracy < TOLERANCE["float"] else TOLERANCE["double"])
    detail = f"largest error {worst:.3g} on {len(mean)} stored queries, {allowed:g} is allowed"
    return VerifiedItem(f"{target}: answers", bool(worst <= allowed), detail)
