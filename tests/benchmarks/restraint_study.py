"""The table of restraint in docs/results.md: ``python -m tests.benchmarks.restraint_study [--datasets FOLDER]``.

Every set is trained by `split train` on one part of what was recorded and judged by `split evaluate --set` on
another: the other drive of the same car, or the other half of the same one. Nothing is chosen on what is judged.
"""

from __future__ import annotations

import json
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.logs.drive import Drive, read_drive, write_drive
from tests.benchmarks.results_tables import CASES, ROOT, Case, split
from tests.foreign.natural import DART_CAR, KTH_CAR, RUBBER, TAPE, dart_drive, kth_drive

#: (Trained on, judged on) by the title in `results_tables.CASES`; one name twice stands for the halves of a drive.
AGGRESSIVE, MODERATE = "Road car, two laps at 85 % of the grip", "Road car, two laps at 70 % of the grip"
SMALL, TUM_RUN, TUM_TRAIN = (
    "Road car, one lap of the small course",
    "TUM double track, run",
    "TUM double track, train",
)
ACROSS = (
    (AGGRESSIVE, MODERATE),
    (MODERATE, AGGRESSIVE),
    (AGGRESSIVE, SMALL),
    (MODERATE, SMALL),
    (SMALL, MODERATE),
    (SMALL, AGGRESSIVE),
    (TUM_TRAIN, TUM_RUN),
    (TUM_RUN, TUM_TRAIN),
)
HALVES = ("1:10 car, three laps", "Hyundai Genesis, real, gentle", "Indy AV-21, real, banked oval")
#: DART's car on two floors and driven freely; KTH's Volvo in a slalom (038) and a step steer (040).
DART = ((RUBBER, TAPE), (TAPE, RUBBER), (RUBBER, "free_driving"), ("free_driving", "racetrack_lap_v_1"))
DART_HALVES = (RUBBER, TAPE, "free_driving")
KTH = (("038", "040"), ("040", "038"))
#: What is judged: the default predictor.
PREDICTOR = "rbcm"
STATES = ("v_x", "v_y", "r")


@dataclass(frozen=True)
class Pair:
    """Drive files: one trains, the other judges."""

    title: str
    trains: Path
    judges: Path
    vehicle: str


def main() -> None:
    """Print the tables as Markdown."""
    datasets = Path(sys.argv[sys.argv.index("--datasets") + 1]) if "--datasets" in sys.argv else None
    cases = {case.title: case for case in CASES if datasets or not case.foreign}
    print(HEADER)
    plain: list[dict] = []
    believed: list[dict] = []
    intervals = []
    with tempfile.TemporaryDirectory() as folder:
        for pair in pairs(cases, Path(folder), datasets):
            made = Path(folder) / "a.split"
            split("train", str(pair.trains), "--vehicle", pair.vehicle, "--any-vehicle", "-o", str(made))
            report = json.loads(  # fmt: skip
                split(
                    "evaluate",
                    str(pair.judges),
                    "--set",
                    str(made),
                    "--predictor",
                    PREDICTOR,
                    "--any-vehicle",
                    "--json",
                )
            )
            trust = trust_of(report["sets"][0])
            rows = {(c["name"], c["state"], c["horizon"]): c for c in report["comparisons"]}
            own = [c for c in report["comparisons"] if c["name"] == PREDICTOR]
            believed += own
            plain += [rows.get((f"{PREDICTOR}, all believed", c["state"], c["horizon"]), c) for c in own]
            for line in lines_of(pair, trust, rows):
                print(line, flush=True)
            intervals.append(
                (pair.title, next(s for s in report["scores"] if s["name"] == PREDICTOR and not s["drive"]))
            )
    print()
    for name, found in (("all believed", plain), ("with trust", believed)):
        found = [c for c in found if c["to_nominal"][1] is not None]  # fewer than four blocks judge nothing
        worse = [c for c in found if c["to_nominal"][1] > 1.0]
        better = [c for c in found if c["to_nominal"][2] < 1.0]
        largest = max((c["to_nominal"][0] for c in worse), default=float("nan"))
        ratio = float(np.exp(np.mean(np.log([c["to_nominal"][0] for c in found]))))
        print(
            f"- {name}: of {len(found)} states and horizons {len(worse)} are worse than the nominal model beyond "
            f"chance (at most {largest:.2f} times its error), {len(better)} better; geometric mean of the ratios "
            f"{ratio:.2f}."
        )
    print("\n| judged on another part | in 50 % | in 95 % |\n|---|---|---|")
    for title, score in intervals:
        shares = ("/".join(f"{100 * s:.0f}" for s in score[f"coverage_{level}"]) for level in (50, 95))
        print(f"| {title} | " + " | ".join(shares) + " |")


HEADER = """| trained on → judged on | trust v_x, v_y, r | state | one step | 0.5 s | 1 s | 2 s | over persistence at 1 s | all believed at 1 s |
|---|---|---|---|---|---|---|---|---|"""  # noqa: E501


def pairs(cases: dict[str, Case], folder: Path, datasets: Path | None) -> Iterator[Pair]:
    """Yield the pairs whose recordings are at hand, ingested."""
    made: dict[str, tuple[Path, str]] = {}

    def drive(title: str) -> tuple[Path, str]:
        if title not in made:
            case = cases[title]
            base = datasets if case.foreign else ROOT / "sample_logs"
            vehicle = case.vehicle if case.foreign else str(base / case.vehicle)
            path = folder / f"{len(made)}.parquet"
            split("ingest", str(base / case.log), "--vehicle", vehicle, *case.ingest, "-o", str(path))
            made[title] = path, vehicle
        return made[title]

    for first, second in ACROSS:
        if first in cases and second in cases:
            (trains, vehicle), (judges, _) = drive(first), drive(second)
            yield Pair(f"{first} → {second}", trains, judges, vehicle)
    for title in HALVES:
        if title in cases:
            path, vehicle = drive(title)
            yield from halves_of(title, path, vehicle, folder)
    if datasets:
        yield from natural_pairs(datasets, folder)


def halves_of(title: str, path: Path, vehicle: str, folder: Path) -> Iterator[Pair]:
    """Yield the pair of a drive's halves, both ways."""
    whole = read_drive(path)
    halves = []
    for number in range(2):
        rows = np.arange(len(whole)) * 2 // len(whole) == number
        halves.append(folder / f"{path.stem}_{number}.parquet")
        write_drive(whole.select(rows), halves[-1])
    yield Pair(f"{title}: first half → second", halves[0], halves[1], vehicle)
    yield Pair(f"{title}: second half → first", halves[1], halves[0], vehicle)


def natural_pairs(datasets: Path, folder: Path) -> Iterator[Pair]:
    """Yield the pairs of the recordings whose drives `tests.foreign.natural` prepares."""
    work = folder / "natural"
    work.mkdir(exist_ok=True)
    files: dict[str, Path] = {}

    def written(name: str, drive: Drive) -> Path:
        if name not in files:
            files[name] = folder / f"{name}.parquet"
            write_drive(replace(drive, name=files[name].name), files[name])
        return files[name]

    def dart(name: str) -> Path:
        return written(f"dart_{name}", dart_drive(datasets, name, work))

    def kth(run: str, yaw_rate: str) -> Path:
        return written(f"kth_{run}_{yaw_rate}", kth_drive(datasets, run, work, yaw_rate=yaw_rate))

    for first, second in DART:
        yield Pair(f"DART, {first} → {second}", dart(first), dart(second), str(DART_CAR))
    for name in DART_HALVES:
        yield from halves_of(f"DART, {name}", dart(name), str(DART_CAR), folder)
    for yaw_rate in ("can", "imu"):
        for first, second in KTH:
            parts = kth(first, yaw_rate), kth(second, yaw_rate)
            yield Pair(f"KTH, {first} → {second}, yaw rate {yaw_rate}", *parts, str(KTH_CAR))


def trust_of(facts: dict) -> str:
    """Return 1, 0.8, 0.65; lag 54 ms: the trust of a set, and what it found beyond the vehicle file."""
    lags = [f"; lag {1e3 * effect['parameters']['tau']:.0f} ms" for effect in facts["found"]]
    return ", ".join(f"{share:.2g}" for share in facts["trust"]["share"]) + "".join(lags)


def lines_of(pair: Pair, trust: str, rows: dict) -> list[str]:
    """Return a row a state: corrected over nominal with 95 % intervals, worse beyond chance in bold."""
    lines = []
    for number, state in enumerate(STATES):
        cells = [
            pair.title if not number else "",
            trust if not number else "",
            state,
        ]
        for horizon in (0.0, 0.5, 1.0, 2.0):
            found = rows.get((PREDICTOR, state, horizon))
            cells.append(ratio_of(found["to_nominal"]) if found else "")
        found = rows.get((PREDICTOR, state, 1.0))
        cells.append(ratio_of(found["to_held"]) if found else "")
        found = rows.get((f"{PREDICTOR}, all believed", state, 1.0), found)
        cells.append(ratio_of(found["to_nominal"]) if found else "")
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def ratio_of(values: list[float | None]) -> str:
    """Return 0.85 (0.80 to 0.91), in bold when the interval lies above 1."""
    ratio, low, high = values
    if low is None:
        return f"{ratio:.2f}"
    text = f"{ratio:.2f} ({low:.2f}–{high:.2f})"
    return f"**{text}**" if low > 1.0 else text


if __name__ == "__main__":
    main()
