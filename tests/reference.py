"""Outputs of the program before and after a change: store them with one state of the code, compare with another.

    python -m tests.reference store FOLDER --code CLONE_AT_THE_OLD_COMMIT
    python -m tests.reference compare FOLDER

A reference holds the inputs that were made (generated cases) and the outputs of every step. `compare` runs the
same steps on the same inputs with the code at hand. It says of each file whether it is the same to the bit, to
1e-9, or different, and where. What a refactoring may change is left out: versions, times, digests of what is
compared itself, and `settings`, of which those that both sides list have to agree.
"""

import argparse
import json
import math
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.ipc
import pyarrow.parquet

ROOT = Path(__file__).resolve().parent.parent
TOLERANCE = 1e-9
SETS = ("samples", "foreign", "development")
# Seconds, memory and the version say nothing about the answer; pages and figures repeat `diagnosis.json`.
PASSED_OVER = {"seconds", "peak_memory_mb", "version", "created", "split_version"}
DIGEST = re.compile(r"\b[0-9a-f]{64}\b")
NUMBER = re.compile(r"[-+]?\d+\.\d*(?:[eE][-+]?\d+)?|[-+]?\d+[eE][-+]?\d+")
COMPARED = {".json", ".parquet", ".split", ".yaml", ".npz", ".c", ".h", ".csv"}
SEED = 5


def steps_of(chosen: Sequence[str], cases: int) -> Iterator[list[str]]:
    """Yield commands with {samples}, {datasets} and {out} in the place of folders."""
    if "samples" in chosen:
        for log, car, signal_map in (
            ("road_handling_moderate.mcap", "road_car", "split_sim"),
            ("road_small_workshop.csv", "road_car", "split_sim_table"),
            ("f1tenth_laps.mcap", "f1tenth_car", "split_sim"),
        ):
            drive, vehicle = "{out}/" + Path(log).stem + ".parquet", "{samples}/" + f"{car}.yaml"
            trained = drive.replace(".parquet", ".split")
            yield ["ingest", "{samples}/" + log, "--vehicle", vehicle, "--map", signal_map, "-o", drive]
            yield ["train", drive, "--vehicle", vehicle, "-o", trained]
            targets = [option for target in ("c", "npz", "json") for option in ("--target", target)]
            yield ["export", trained, *targets, "-o", drive.replace(".parquet", "_export")]
        pair = ["--real", "{samples}/road_pair_real.parquet", "--sim", "{samples}/road_pair_sim.parquet"]
        yield ["diagnose", *pair, "--vehicle", "{samples}/road_car.yaml", "--out", "{out}/pair"]
    if "foreign" in chosen:
        for name in ("data_to_run", "data_to_train_12"):
            log = "{datasets}/tum_sim/" + f"{name}.csv"
            yield ["ingest", log, "--vehicle", "tum_sim", "--map", "tum_sim", "-o", "{out}/" + f"{name}.parquet"]
        pair = ["--real", "{out}/data_to_run.parquet", "--sim", "{out}/data_to_train_12.parquet"]
        yield ["diagnose", *pair, "--vehicle", "tum_sim", "--out", "{out}/tum"]
        yield [
            "ingest",
            "{datasets}/genesis_slow/cpg_slow_lap.mat",
            "--vehicle",
            "genesis",
            "--map",
            "genesis_slow",
            "--derive",
            "torque-from-acceleration",
            "-o",
            "{out}/genesis.parquet",
        ]
        yield ["diagnose", "--real", "{out}/genesis.parquet", "--vehicle", "genesis", "--out", "{out}/genesis"]
    if "development" in chosen:
        yield ["prove", "generate", "{out}/proof", "--seed", str(SEED), "--cases", str(cases)]
        yield ["prove", "identify", "{out}/proof"]


def run(steps: Iterator[list[str]], folder: Path, code: Path, samples: Path, datasets: Path) -> None:
    """Run commands of the code in a folder, one thread each, into another folder."""
    folders = {"samples": samples, "datasets": datasets, "out": folder}
    environment = {**os.environ, "PYTHONPATH": str(code), "OMP_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1"}
    for step in steps:
        arguments = [part.format(**folders) for part in step]
        done = subprocess.run(
            [sys.executable, "-m", "split_cli", *arguments],
            env=environment,
            cwd=code,
            capture_output=True,
            text=True,
            check=False,
        )
        print(f"split {' '.join(step)}: {done.returncode}", flush=True)
        if done.returncode:
            print(done.stderr.strip(), flush=True)


def differences(old: Any, new: Any, where: str = "") -> Iterator[tuple[str, float]]:
    """Yield places where two trees of a JSON document differ, and by how much relatively; infinity for kinds."""
    if isinstance(old, dict) and isinstance(new, dict):
        if where.endswith("/settings"):
            old = {key: value for key, value in old.items() if key in new}
            new = {key: new[key] for key in old}
        for key in old.keys() | new.keys():
            if key in PASSED_OVER:
                continue
            if key in old and key in new:
                yield from differences(old[key], new[key], f"{where}/{key}")
            else:
                yield f"{where}/{key}", math.inf
    elif isinstance(old, list) and isinstance(new, list) and len(old) == len(new):
        for k, (a, b) in enumerate(zip(old, new, strict=True)):
            yield from differences(a, b, f"{where}/{k}")
    elif is_number(old) and is_number(new):
        if old != new and not (math.isnan(old) and math.isnan(new)):
            yield where, abs(old - new) / max(abs(old), abs(new), 1e-300)
    elif old != new and not (is_digest(old) and is_digest(new)):
        yield where, math.inf


def is_digest(value: Any) -> bool:
    """Return whether a value is a SHA-256; what it is of is compared itself."""
    return isinstance(value, str) and DIGEST.fullmatch(value) is not None


def text_differences(old: str, new: str) -> list[tuple[str, float]]:
    """Return where two texts differ in words, digests left out, or by how much in their numbers."""
    words = [NUMBER.sub("#", DIGEST.sub("#", text)) for text in (old, new)]
    if words[0] != words[1]:
        return [("text", math.inf)]
    pairs = zip(*(map(float, NUMBER.findall(DIGEST.sub("#", text))) for text in (old, new)), strict=True)
    return [("numbers", max((abs(a - b) / max(abs(a), abs(b)) for a, b in pairs if a != b), default=0.0))]


def set_differences(old: Path, new: Path) -> list[tuple[str, float]]:
    """Return where two trained sets differ: columns and what the file tells beside them."""
    tables = [pyarrow.ipc.open_file(path.read_bytes()).read_all() for path in (old, new)]
    told = [json.loads(table.schema.metadata[b"split"]) for table in tables]
    if tables[0].column_names != tables[1].column_names:
        return [("columns", math.inf)]
    columns = ((name, *(table[name].to_numpy() for table in tables)) for name in tables[0].column_names)
    return [*differences(*told), *((name, size) for name, a, b in columns if (size := array_difference(a, b)))]


def is_number(value: Any) -> bool:
    """Return whether a value is a number and no truth value."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def array_difference(old: np.ndarray, new: np.ndarray) -> float:
    """Return the largest difference of two arrays over the largest size in the first."""
    if old.shape != new.shape or old.dtype.kind != new.dtype.kind:
        return math.inf
    if old.dtype.kind not in "fiub":
        if old.dtype.kind == "U" and old.ndim == 0:
            return text_differences(str(old), str(new))[0][1]
        return 0.0 if np.array_equal(old, new) else math.inf
    a, b = old.astype(float), new.astype(float)
    if not np.array_equal(np.isnan(a), np.isnan(b)):
        return math.inf
    away = np.nan_to_num(np.abs(a - b))
    return float(away.max(initial=0.0) / max(np.nanmax(np.abs(a), initial=0.0), 1e-300))


def compare_files(old: Path, new: Path) -> list[tuple[str, float]]:
    """Return where two files of one name differ; nothing where they are the same in what is compared."""
    if old.read_bytes() == new.read_bytes():
        return []
    if old.suffix == ".json":
        return list(differences(json.loads(old.read_text()), json.loads(new.read_text())))
    if old.suffix == ".split":
        return set_differences(old, new)
    if old.suffix in (".c", ".h", ".yaml", ".csv"):
        return text_differences(old.read_text(), new.read_text())
    if old.suffix == ".parquet":
        before, after = (pyarrow.parquet.read_table(path).to_pandas() for path in (old, new))
        if list(before.columns) != list(after.columns):
            return [("columns", math.inf)]
        pairs = [(name, array_difference(before[name].to_numpy(), after[name].to_numpy())) for name in before]
        return [pair for pair in pairs if pair[1]]
    if old.suffix == ".npz":
        with np.load(old) as before, np.load(new) as after:
            if set(before.files) != set(after.files):
                return [("arrays", math.inf)]
            pairs = [(name, array_difference(before[name], after[name])) for name in before.files]
        return [pair for pair in pairs if pair[1]]
    return [("bytes", math.inf)]


def compare(folder: Path, new: Path) -> int:
    """Print what differs; return how many files differ by more than the tolerance."""
    counts = {"the same to the bit": 0, f"the same to {TOLERANCE:g}": 0, "different": 0}
    for old in sorted(path for path in folder.rglob("*") if path.suffix in COMPARED and path.is_file()):
        name = old.relative_to(folder)
        if "cases" in name.parts or "sealed" in name.parts or name.name == "reference.json":
            continue
        if not (new / name).is_file():
            counts["different"] += 1
            print(f"{name}: missing")
            continue
        found = compare_files(old, new / name)
        worst = max((size for _, size in found), default=0.0)
        key = list(counts)[0 if not found else 1 if worst <= TOLERANCE else 2]
        counts[key] += 1
        if worst > TOLERANCE:
            print(f"{name}: " + "; ".join(f"{at} by {size:.2g}" for at, size in found[:8]))
    print(", ".join(f"{count} {key}" for key, count in counts.items()))
    return counts["different"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line."""
    parser = argparse.ArgumentParser(prog="python -m tests.reference", description=__doc__.split("\n\n")[0])
    parser.add_argument("action", choices=("store", "compare"))
    parser.add_argument("folder", type=Path)
    parser.add_argument("--sets", nargs="+", choices=SETS, default=["samples", "development"])
    parser.add_argument("--cases", type=int, default=40, help="development cases of split prove")
    parser.add_argument("--code", type=Path, default=ROOT, help="clone of the project whose outputs are taken")
    parser.add_argument("--datasets", type=Path, default=os.environ.get("SPLIT_DATASETS"))
    parser.add_argument("--keep", type=Path, help="folder for the new outputs; else they are thrown away")
    asked = parser.parse_args(arguments)
    if "foreign" in asked.sets and asked.datasets is None and asked.action == "store":
        parser.error("--sets foreign needs --datasets, the folder of the foreign recordings, or SPLIT_DATASETS")
    samples = ROOT / "sample_logs"
    if asked.action == "store":
        asked.folder.mkdir(parents=True)
        note = {"sets": asked.sets, "cases": asked.cases, "datasets": asked.datasets and str(asked.datasets)}
        (asked.folder / "reference.json").write_text(json.dumps(note))
        run(steps_of(asked.sets, asked.cases), asked.folder, asked.code.resolve(), samples, asked.datasets)
        return 0
    note = json.loads((asked.folder / "reference.json").read_text())
    with tempfile.TemporaryDirectory() as scratch:
        new = asked.keep or Path(scratch) / "new"
        new.mkdir(parents=True, exist_ok=True)
        if (asked.folder / "proof").is_dir():
            shutil.copytree(
                asked.folder / "proof", new / "proof", ignore=shutil.ignore_patterns("results"), dirs_exist_ok=True
            )
        steps = steps_of(note["sets"], note["cases"])
        run(steps, new, asked.code.resolve(), samples, Path(note["datasets"] or "."))
        return 1 if compare(asked.folder, new) else 0


if __name__ == "__main__":
    sys.exit(main())
