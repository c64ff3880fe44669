"""The same commands with other kernels of linear algebra and more threads: how far their answers differ.

Example: ``python -m tests.studies.kernels --only diagnose``. OpenBLAS, which the wheels of NumPy and SciPy bring,
chooses its kernels by the processor; ``OPENBLAS_CORETYPE`` makes it take those of another one, which add and
multiply in another order. Prints, for each variant and command, the largest relative difference of any number from
the plain run with one thread; exits with 1 if a name or a verdict differs, or a number by more than is promised.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
from pathlib import Path

from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from tests.factories import MissingForce, make_drive, road_car
from tests.reference import compare_files

VARIANTS = {
    "one thread": {},
    "two threads": {"OMP_NUM_THREADS": "2", "OPENBLAS_NUM_THREADS": "2", "NUMBA_NUM_THREADS": "2"},
    "Prescott (SSE3)": {"OPENBLAS_CORETYPE": "Prescott"},
    "Nehalem (SSE4.2)": {"OPENBLAS_CORETYPE": "Nehalem"},
    "Sandybridge (AVX)": {"OPENBLAS_CORETYPE": "Sandybridge"},
    "Haswell (AVX2)": {"OPENBLAS_CORETYPE": "Haswell"},
}
PREDICTORS = "bcm,rbcm,full,projected"
COMMANDS = {
    "train": (("train", "d0.parquet", "--vehicle", "car.yaml", "-o", "OUT/a.split"), "a.split", 1e-9),
    "evaluate": (
        ("evaluate", "d0.parquet", "--vehicle", "car.yaml", "--predictor", PREDICTORS, "--json"),
        "evaluate.json",
        1e-6,
    ),
    "diagnose": (
        ("diagnose", "--real", "d0.parquet", "--vehicle", "car.yaml", "--out", "OUT/diagnosis"),
        "diagnosis/diagnosis.json",
        1e-3,
    ),
}
"""Arguments, the file that is compared, and the relative difference that is promised."""
# Times of computing; and what a search tells of its way, which ends at the same answer.
_NOT_ANSWERS = ("time_per_query", "seconds", "duration")


def run(folder: Path, name: str, out: Path, environment: dict[str, str]) -> Path:
    """Run one command in another process; return the file with its answer."""
    arguments, answer, _ = COMMANDS[name]
    one = {key: "1" for key in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS")}
    out.mkdir(parents=True, exist_ok=True)
    command = [sys.executable, "-m", "split_cli", *(text.replace("OUT", str(out)) for text in arguments)]
    done = subprocess.run(
        command, cwd=folder, env={**os.environ, **one, **environment}, capture_output=True, text=True, check=False
    )
    # 3 tells a mismatch.
    if done.returncode not in (0, 3):
        raise RuntimeError(f"split {' '.join(command[3:])}: exit {done.returncode}, {done.stderr[-800:]}")
    if "--json" in arguments:
        (out / answer).write_text(done.stdout, encoding="utf-8")
    return out / answer


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", default="", help="commands whose name holds this")
    parser.add_argument("--variant", default="", help="variants whose name holds one of these, with commas between")
    given = parser.parse_args()
    failed = False
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place)
        car, terms = road_car(), [MissingForce({"front_grip_loss": 0.2})]
        write_vehicle(car, folder / "car.yaml")
        write_drive(make_drive(0, segments=2, seconds=30.0, vehicle=car, terms=terms), folder / "d0.parquet")
        print(f"{'command':10} {'variant':18} {'numbers that differ':>20} {'largest, relative':>18} {'promised':>9}")
        for name in (one for one in COMMANDS if given.only in one):
            plain = run(folder, name, folder / "plain", {})
            if '"verdict": "undecided"' in plain.read_bytes().decode("utf-8", errors="replace"):
                raise RuntimeError("the diagnosis is undecided: nothing would be compared")
            for variant, environment in VARIANTS.items():
                if not any(word in variant for word in given.variant.split(",")):
                    continue
                found = compare_files(plain, run(folder, name, folder / variant, environment))
                found = [(at, by) for at, by in found if not any(word in at for word in _NOT_ANSWERS)]
                worst, promised = max((by for _, by in found), default=0.0), COMMANDS[name][2]
                print(f"{name:10} {variant:18} {len(found):20} {worst:18.2g} {promised:9.0e}", flush=True)
                for at, by in sorted(found, key=lambda one: -one[1])[:5]:
                    if by > promised or math.isinf(by):
                        print(f"  {at} by {by:.3g}", file=sys.stderr)
                failed |= worst > promised
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
