"""Cases on disk: what is shown in one folder, what is sealed in another, and the seal that is printed first.

OUT/cases/0001/{real.parquet, sim.parquet, vehicle.yaml}    all that a diagnosis sees
OUT/sealed/0001.json, 0001.npz                              answer and held-out drive
OUT/seal.json                                               SHA-256 of every sealed file and of their list
OUT/results/0001/                                           what was identified
"""

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from split_cli import __version__
from split_cli.errors import SplitError
from split_cli.files import atomic_directory, atomic_path, atomic_write_text, sha256_of_file
from split_cli.logs.drive import write_drive
from split_cli.proof.cases import Answer, Case, ConcealedEffect
from split_cli.proof.truth import ExactDrive
from split_cli.vehicle.parameters import write_vehicle

_COLUMNS = ("t", "s", "yaw", "vx", "vy", "r", "T", "delta")


@dataclass(frozen=True)
class ShownCase:
    """What a diagnosis gets to see."""

    name: str
    real: Path
    sim: Path | None
    vehicle: Path


@dataclass(frozen=True)
class Seal:
    """The seal of a set of answers."""

    sha256: str  # of the list of files and their hashes; printed before anything is identified
    cases: int
    seed: int
    version: str  # of the program that wrote the cases


def case_name(number: int) -> str:
    """Return the neutral name of a case."""
    return f"{number + 1:04d}"


def write_case(case: Case, root: Path) -> None:
    """Write a case; the sealed part first, so that a case that is shown always has its answer."""
    name = case_name(case.answer.number)
    sealed = root / "sealed"
    sealed.mkdir(parents=True, exist_ok=True)
    atomic_write_text(sealed / f"{name}.json", json.dumps(asdict(case.answer), indent=1) + "\n")
    arrays = {"noise": case.noise}
    if case.heldout is not None:
        arrays |= {column: case.heldout.columns[column] for column in _COLUMNS}
        arrays["error"] = case.heldout.error
    with atomic_path(sealed / f"{name}.npz") as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **arrays)
    (root / "cases").mkdir(exist_ok=True)
    with atomic_directory(root / "cases" / name) as folder:
        write_drive(case.real, folder / "real.parquet")
        if case.sim is not None:
            write_drive(case.sim, folder / "sim.parquet")
        write_vehicle(case.vehicle, folder / "vehicle.yaml")


def shown_cases(root: Path) -> list[ShownCase]:
    """Return the cases of a folder, in order; only what may be seen is looked at.

    Raises
    ------
    SplitError
        If the folder holds no cases.
    """
    folders = sorted(path for path in (root / "cases").glob("[0-9]*") if path.is_dir())
    if not folders:
        raise SplitError("holds no cases", where=str(root), advice="Make some by `split prove generate`.")
    found = []
    for folder in folders:
        sim = folder / "sim.parquet"
        found.append(
            ShownCase(folder.name, folder / "real.parquet", sim if sim.exists() else None, folder / "vehicle.yaml")
        )
    return found


def write_seal(root: Path, seed: int) -> Seal:
    """Seal the answers: write the hash of each, and return the hash of the list."""
    files = sorted((root / "sealed").glob("*"))
    listed = {path.name: sha256_of_file(path) for path in files if path.suffix in (".json", ".npz")}
    seal = Seal(_digest(listed), sum(name.endswith(".json") for name in listed), seed, __version__)
    atomic_write_text(root / "seal.json", json.dumps({**asdict(seal), "files": listed}, indent=1) + "\n")
    return seal


def check_seal(root: Path) -> Seal:
    """Return the seal after comparing every sealed file with it.

    Raises
    ------
    SplitError
        If there is no seal, or an answer was changed, added or taken away since.
    """
    path = root / "seal.json"
    if not path.exists():
        advice = "`split prove generate` was not finished: run it again."
        raise SplitError("has no seal", where=str(root), advice=advice)
    content = json.loads(path.read_text())
    listed = content.pop("files")
    seal = Seal(**content)
    if _digest(listed) != seal.sha256:
        raise SplitError("the list of sealed files does not fit its hash", where=str(path))
    present = {p.name for p in (root / "sealed").glob("*") if p.suffix in (".json", ".npz")}
    for name in sorted(present ^ set(listed)):
        what = "was added after sealing" if name in present else "is gone"
        raise SplitError(what, where=str(root / "sealed" / name))
    for name, digest in listed.items():
        if sha256_of_file(root / "sealed" / name) != digest:
            raise SplitError("was changed after sealing", where=str(root / "sealed" / name))
    return seal


def _digest(listed: dict[str, str]) -> str:
    text = "".join(f"{digest}  {name}\n" for name, digest in sorted(listed.items()))
    return hashlib.sha256(text.encode()).hexdigest()


def read_answer(root: Path, name: str) -> Answer:
    """Return the answer of a case."""
    content = json.loads((root / "sealed" / f"{name}.json").read_text())
    effects = tuple(
        ConcealedEffect(**{**e, "scored": tuple(e["scored"]), "absorbed_by": tuple(e["absorbed_by"])})
        for e in content.pop("effects")
    )
    return Answer(effects=effects, **content)


def read_heldout(root: Path, name: str) -> tuple[ExactDrive | None, np.ndarray]:
    """Return a case's held-out drive (None for a null) and its sensors' noise, shape (3,)."""
    with np.load(root / "sealed" / f"{name}.npz") as arrays:
        noise = arrays["noise"]
        if "error" not in arrays:
            return None, noise
        columns = {column: arrays[column] for column in _COLUMNS}
        return ExactDrive(columns, arrays["error"]), noise
