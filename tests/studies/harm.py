"""Does a learned correction do harm on a drive it was not learned from? Every state and horizon, with intervals.

    python -m tests.studies.harm                                         # bundled samples
    python -m tests.studies.harm --datasets DATASETS --parts recordings,fresh,natural,dirt --work FOLDER

Every set is trained by `split train` on one part of what was recorded and judged by `split evaluate --set` on
another: another drive of the same car, or the other half of the same one. Nothing is chosen on what is judged. States
of which the judged drive says nothing, such as v_x where T was derived from the motion, have empty entries.
*Fresh* drives are simulated for this study. With ``--work``, drives, sets and judgements stay in that folder, and
a run that was ended goes on where it was. docs/records/harm_of_pairs.md holds the table of every pair.
"""

import argparse
import json
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from statistics import NormalDist

import numpy as np

from split_cli.logs.drive import Drive, read_drive, write_drive
from tests.benchmarks.results_tables import CASES, ROOT, TabledDrive, split
from tests.foreign.natural import (
    AUTORALLY_CAR,
    DART_CAR,
    KTH_CAR,
    RUBBER,
    SLIPPERY,
    TAPE,
    autorally_drive,
    dart_drive,
    kth_drive,
)

PARTS = ("recordings", "fresh", "natural", "dirt")
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
SHORT = {
    AGGRESSIVE: "road 85 %",
    MODERATE: "road 70 %",
    SMALL: "road, small course",
    TUM_RUN: "TUM, run",
    TUM_TRAIN: "TUM, train",
    HALVES[0]: "1:10 car",
    HALVES[1]: "Genesis",
    HALVES[2]: "AV-21",
}
#: Laps of the road car simulated for this study: track, share of the grip, seed after the first.
FIRST_SEED = 41
FRESH_TRAIN = (("small", 0.7, 0), ("small", 0.5, 6), ("oval", 0.8, 1), ("handling", 0.55, 2))
FRESH_JUDGE = (("handling", 0.85, 3), ("handling", 0.5, 4), ("small", 0.85, 5))
#: DART's car on two floors and driven freely; KTH's Volvo in a slalom (038) and a step steer (040).
DART = ((RUBBER, TAPE), (TAPE, RUBBER), (RUBBER, "free_driving"), ("free_driving", "racetrack_lap_v_1"))
#: A third floor, whose pose is of 20 Hz.
DART_SLIPPERY = ((RUBBER, SLIPPERY), (TAPE, SLIPPERY), ("free_driving", SLIPPERY), (SLIPPERY, RUBBER), (SLIPPERY, TAPE))
DART_HALVES = (RUBBER, TAPE, "free_driving")
KTH = (("038", "040"), ("040", "038"))
#: Two runs of the 1:5 car on dirt.
AUTORALLY = ((5, 6), (6, 5))
STATES, HORIZONS = ("v_x", "v_y", "r"), (0.0, 0.5, 1.0, 2.0)
TITLES = {0.0: "one step", 0.5: "0.5 s", 1.0: "1 s", 2.0: "2 s"}


@dataclass(frozen=True)
class Pair:
    """Drive files: one trains, the other judges."""

    title: str
    trains: Path
    judges: Path
    vehicle: str


def main() -> None:
    """Print the tables as Markdown."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--parts", default="recordings", help=f"Of {', '.join(PARTS)}, separated by commas.")
    parser.add_argument("--datasets", type=Path, help="Folder with the recordings of others.")
    parser.add_argument("--work", type=Path, help="Folder that keeps drives, sets and judgements.")
    parser.add_argument("--first-seed", type=int, default=FIRST_SEED, help="Of the seven laps of part fresh.")
    parser.add_argument("--predictors", default="projected,rbcm", help="Rows show the first; trust is found with rbcm.")
    parser.add_argument("--features", default="z2", help="Of the sets, as `split train` takes them.")
    given = parser.parse_args()
    parts, predictors = given.parts.split(","), given.predictors.split(",")
    if unknown := set(parts) - set(PARTS):
        parser.error(f"no part {', '.join(unknown)}")
    if {"natural", "dirt"} & set(parts) and given.datasets is None:
        parser.error("parts natural and dirt need --datasets")
    with tempfile.TemporaryDirectory() as scratch:
        folder = given.work or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        print(HEADER)
        reports = []
        for pair in pairs(parts, folder, given.datasets, given.first_seed):
            reports.append((pair.title, judgement(pair, given.predictors, folder, given.features)))
            print("\n".join(lines_of(*reports[-1], predictors[0])), flush=True)
    print()
    for predictor in predictors:
        print("\n".join(summary([report for _, report in reports], predictor)))
    print(
        "\n| judged on another part | in 50 % | in 95 % | samples near the points | in 95 % there | beyond |\n"
        "|---|---|---|---|---|---|"
    )
    for title, report in reports:
        score = next(s for s in report["scores"] if s["name"] == predictors[0] and not s["drive"])
        near, beyond = (
            next((s for s in report["intervals"] if s["name"] == predictors[0] and s["near"] == inside), None)
            for inside in (True, False)
        )
        cells = [shares_of(score["coverage_50"]), shares_of(score["coverage_95"])]
        cells.append(f"{100 * near['share']:.0f} %" if near else "0 %")
        cells += [shares_of(part["coverage_95"]) if part else "" for part in (near, beyond)]
        print(f"| {title} | " + " | ".join(cells) + " |")


def shares_of(values: list[float]) -> str:
    """Return 95/93/75: shares of v_x, v_y and r in per cent."""
    return "/".join(f"{100 * value:.0f}" for value in values)


HEADER = """| trained on → judged on | trust v_x, v_y, r | state | one step | 0.5 s | 1 s | 2 s | worse | over persistence at 1 s | full trust at 1 s |
|---|---|---|---|---|---|---|---|---|---|"""  # noqa: E501


def judgement(pair: Pair, predictors: str, folder: Path, features: str = "z2") -> dict:
    """Train and judge one pair, or return what the folder holds of it already."""
    made = folder / f"{pair.trains.stem}{'' if features == 'z2' else f'_{features}'}.split"
    if not made.exists():
        asked = ("--vehicle", pair.vehicle, "--any-vehicle", "--features", features)
        split("train", str(pair.trains), *asked, "-o", str(made))
    found = folder / f"{made.stem}_{pair.judges.stem}_{predictors}.json"
    if not found.exists():
        told = split(
            "evaluate", str(pair.judges), "--set", str(made), "--predictor", predictors, "--any-vehicle", "--json"
        )
        found.write_text(told, encoding="utf-8")
    report = json.loads(found.read_text(encoding="utf-8"))
    # As verdicts do: with a torque that was derived from the motion the nominal model repeats the recorded v_x.
    silent = read_drive(pair.judges).metadata.circular
    report["comparisons"] = [row for row in report["comparisons"] if row["state"] not in silent]
    return report


def pairs(parts: list[str], folder: Path, datasets: Path | None, first_seed: int) -> Iterator[Pair]:
    """Yield the pairs whose recordings are at hand, ingested."""
    if "recordings" in parts:
        yield from recorded_pairs({c.title: c for c in CASES if datasets or not c.foreign}, folder, datasets)
    if "fresh" in parts:
        yield from fresh_pairs(folder, first_seed)
    if "natural" in parts:
        yield from natural_pairs(datasets, folder)
    if "dirt" in parts:
        yield from dirt_pairs(datasets, folder)


def recorded_pairs(cases: dict[str, TabledDrive], folder: Path, datasets: Path | None) -> Iterator[Pair]:
    """Yield the pairs of drives of one car, and of halves of one drive."""

    def drive(title: str) -> tuple[Path, str]:
        case = cases[title]
        base = datasets if case.foreign else ROOT / "sample_logs"
        vehicle = case.vehicle if case.foreign else str(base / case.vehicle)
        path = folder / f"recorded{[c.title for c in CASES].index(title)}.parquet"
        if not path.exists():
            split("ingest", str(base / case.log), "--vehicle", vehicle, *case.ingest, "-o", str(path))
        return path, vehicle

    for first, second in ACROSS:
        if first in cases and second in cases:
            (trains, vehicle), (judges, _) = drive(first), drive(second)
            yield Pair(f"{SHORT[first]} → {SHORT[second]}", trains, judges, vehicle)
    for title in HALVES:
        if title in cases:
            path, vehicle = drive(title)
            yield from halves_of(SHORT[title], path, vehicle, folder)


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


def fresh_pairs(folder: Path, first_seed: int) -> Iterator[Pair]:
    """Yield the pairs of laps simulated for this study, with seven seeds from the first."""
    vehicle = str(ROOT / "sample_logs" / "road_car.yaml")

    def drive(track: str, grip: float, number: int) -> tuple[str, Path]:
        seed = first_seed + number
        path = folder / f"fresh{seed}.parquet"
        if not path.exists():
            log = path.with_suffix(".mcap")
            split(
                "simulate",
                "--track",
                track,
                "--driver",
                "racer",
                "--aggressiveness",
                str(grip),
                "--seed",
                str(seed),
                "--laps",
                "1",
                "-o",
                str(log),
            )
            split("ingest", str(log), "--vehicle", vehicle, "--map", "split_sim", "-o", str(path))
        return f"{track} {100 * grip:.0f} %", path

    for first in FRESH_TRAIN:
        for second in FRESH_JUDGE:
            (from_title, trains), (to_title, judges) = drive(*first), drive(*second)
            yield Pair(f"fresh {from_title} → {to_title}", trains, judges, vehicle)


def dirt_pairs(datasets: Path, folder: Path) -> Iterator[Pair]:
    """Yield the pairs of the 1:5 car on dirt, and of the 1:10 car on a slippery floor."""
    work = folder / "natural"
    work.mkdir(exist_ok=True)
    runs = {number: folder / f"autorally_{number}.parquet" for number in (5, 6)}
    for number, path in runs.items():
        if not path.exists():
            write_drive(replace(autorally_drive(datasets, number, work), name=path.name), path)
    for first, second in AUTORALLY:
        yield Pair(f"AutoRally, {first} → {second}", runs[first], runs[second], str(AUTORALLY_CAR))
    for number, path in runs.items():
        yield from halves_of(f"AutoRally, {number}", path, str(AUTORALLY_CAR), folder)
    floors = {name: folder / f"dart_{name}.parquet" for name in dict.fromkeys(sum(DART_SLIPPERY, ()))}
    for name, path in floors.items():
        if not path.exists():
            write_drive(replace(dart_drive(datasets, name, work), name=path.name), path)
    for first, second in DART_SLIPPERY:
        yield Pair(f"DART, {first} → {second}", floors[first], floors[second], str(DART_CAR))


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
        return written(
            f"kth_{run}_{yaw_rate}", kth_drive(datasets, run, work, *(() if yaw_rate == "can" else (yaw_rate,)))
        )

    for first, second in DART:
        yield Pair(f"DART, {first} → {second}", dart(first), dart(second), str(DART_CAR))
    for name in DART_HALVES:
        yield from halves_of(f"DART, {name}", dart(name), str(DART_CAR), folder)
    for yaw_rate in ("can", "imu"):
        for first, second in KTH:
            parts = kth(first, yaw_rate), kth(second, yaw_rate)
            yield Pair(f"KTH, {first} → {second}, yaw rate {yaw_rate}", *parts, str(KTH_CAR))


def trust_of(facts: dict) -> str:
    """Return 1, 0.8, 0.65; lag 54 ms; steering 30 ms: trust of a set, and what it found beyond the vehicle file."""
    words = {"drive_lag": "lag", "steer_lag": "steering"}
    lags = [f"; {words[effect['term']]} {1e3 * effect['parameters']['tau']:.0f} ms" for effect in facts["found"]]
    return ", ".join(f"{share:.2g}" for share in facts["trust"]["share"]) + "".join(lags)


def lines_of(title: str, report: dict, predictor: str) -> list[str]:
    """Return a row a state: corrected over nominal with 95 % intervals, and where that is worse beyond chance."""
    rows = {(c["name"], c["state"], c["horizon"]): c for c in report["comparisons"]}
    trust = trust_of(report["sets"][0])
    lines = []
    for number, state in enumerate(STATES):
        found = {horizon: rows.get((predictor, state, horizon)) for horizon in HORIZONS}
        worse = [TITLES[horizon] for horizon, row in found.items() if row and is_worse(row)]
        whole = rows.get((f"{predictor}, full trust", state, 1.0), found[1.0])
        cells = [
            "" if number else title,
            "" if number else trust,
            state,
            *(ratio_of(row["to_nominal"]) if row else "" for row in found.values()),
            ", ".join(worse) or "no",
            ratio_of(found[1.0]["to_held"]) if found[1.0] else "",
            ratio_of(whole["to_nominal"]) if whole else "",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return lines


def is_worse(row: dict) -> bool:
    """Whether the whole interval lies above the nominal error."""
    low = row["to_nominal"][1]
    return low is not None and low > 1.0


def worse_at_once(rows: list[dict]) -> list[dict]:
    """Return the rows that are worse when the intervals hold 95 % for all rows at once (Bonferroni).

    The lower end of an interval lies as many times further from the ratio, on a logarithmic scale, as a normal
    quantile does.
    """
    wider = NormalDist().inv_cdf(1.0 - 0.025 / max(len(rows), 1)) / NormalDist().inv_cdf(0.975)
    return [
        row for row in rows if (1.0 - wider) * np.log(row["to_nominal"][0]) + wider * np.log(row["to_nominal"][1]) > 0.0
    ]


def ratio_of(values: list[float | None]) -> str:
    """Return 0.85 (0.80 to 0.91), in bold when the interval lies above 1."""
    ratio, low, high = values
    if low is None:
        return f"{ratio:.2f}"
    text = f"{ratio:.2f} ({low:.2f}–{high:.2f})"
    return f"**{text}**" if low > 1.0 else text


def summary(reports: list[dict], predictor: str) -> list[str]:
    """Return a line for all of the correction, as stored trust and as running trust apply it, and for warnings."""
    told = []
    for name in (f"{predictor}, full trust", predictor, f"{predictor}, running trust"):
        found = []
        for report in reports:
            rows = {(c["name"], c["state"], c["horizon"]): c for c in report["comparisons"]}
            keys = [key for key in rows if key[0] == predictor]
            # Where nothing is trusted, or all of it, there is no row of its own.
            found += [rows.get((name, *key[1:]), rows[key]) for key in keys]
        found = [row for row in found if row["to_nominal"][1] is not None]  # fewer than four blocks judge nothing
        worse = [row for row in found if is_worse(row)]
        better = sum(row["to_nominal"][2] < 1.0 for row in found)
        largest = f"at most {max(row['to_nominal'][0] for row in worse):.3f} times its error" if worse else "none"
        mean = float(np.exp(np.mean(np.log([row["to_nominal"][0] for row in found]))))
        told.append(
            f"- {name}: of {len(found)} states and horizons {len(worse)} are worse than the nominal model beyond "
            f"chance ({largest}), {better} better; geometric mean of the ratios "
            f"{mean:.3f}. Were the {len(found) - better} that are not better without any effect, "
            f"{0.025 * (len(found) - better):.1f} would count as worse. With intervals that hold for all at once "
            f"{len(worse_at_once(found))} do."
        )
    unwarned = [
        (row["state"], row["horizon"])
        for report in reports
        for row in report["comparisons"]
        if row["name"] == predictor
        and is_worse(row)
        and not any(f"{row['state']} of the corrected" in text for text in report["notes"])
    ]
    told.append(f"- {predictor}: worse than nominal without a warning by `split evaluate`: {len(unwarned)}.")
    return told


if __name__ == "__main__":
    main()
