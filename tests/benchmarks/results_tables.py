"""The tables behind docs/results.md: ``python -m tests.benchmarks.results_tables [--datasets FOLDER]``, minutes.

Every case runs the commands that are printed above its table, with the same settings.
"""

import json
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class TabledDrive:
    """One recording: how it is ingested, and with which vehicle it is judged."""

    title: str
    log: str
    vehicle: str
    ingest: tuple[str, ...]
    foreign: bool = False


_MESSAGES = ("--map", "split_sim")
_FROM_ACCELERATION = ("--derive", "torque-from-acceleration")

CASES = (
    TabledDrive("Road car, two laps at 70 % of the grip", "road_handling_moderate.mcap", "road_car.yaml", _MESSAGES),
    TabledDrive("Road car, two laps at 85 % of the grip", "road_handling_aggressive.mcap", "road_car.yaml", _MESSAGES),
    TabledDrive(
        "Road car, one lap of the small course",
        "road_small_workshop.csv",
        "road_car.yaml",
        ("--map", "split_sim_table"),
    ),
    TabledDrive("1:10 car, three laps", "f1tenth_laps.mcap", "f1tenth_car.yaml", _MESSAGES),
    TabledDrive(
        "Hyundai Genesis, real, gentle",
        "genesis_slow/cpg_slow_lap.mat",
        "genesis",
        ("--map", "genesis_slow", *_FROM_ACCELERATION),
        True,
    ),
    TabledDrive(
        "Indy AV-21, real, banked oval",
        "av21_lvms/LVMS_23_01_04_B.csv",
        "av21",
        ("--map", "av21_lvms", "--estimate-delays", *_FROM_ACCELERATION),
        True,
    ),
    TabledDrive("TUM double track, run", "tum_sim/data_to_run.csv", "tum_sim", ("--map", "tum_sim"), True),
    TabledDrive("TUM double track, train", "tum_sim/data_to_train_12.csv", "tum_sim", ("--map", "tum_sim"), True),
)


def main() -> None:
    """Print the tables as Markdown."""
    datasets = Path(sys.argv[sys.argv.index("--datasets") + 1]) if "--datasets" in sys.argv else None
    with tempfile.TemporaryDirectory() as folder:
        for case in CASES:
            if not case.foreign or datasets:
                print(section(case, Path(folder), datasets), flush=True)


def section(case: TabledDrive, folder: Path, datasets: Path | None) -> str:
    """Run one case and return its section."""
    base = datasets if case.foreign else ROOT / "sample_logs"
    shown = "DATASETS" if case.foreign else "sample_logs"
    vehicle = case.vehicle if case.foreign else str(base / case.vehicle)
    vehicle_shown = case.vehicle if case.foreign else f"sample_logs/{case.vehicle}"
    drive = folder / "drive.parquet"
    split("ingest", str(base / case.log), "--vehicle", vehicle, *case.ingest, "-o", str(drive))
    options = ("--features", "z2,z1", "--predictor", "bcm,full,fitc")
    held = json.loads(split("evaluate", str(drive), "--vehicle", vehicle, *options, "--json"))
    in_sample = ("--features", "z2,z1", "--protocol", "paper")
    paper = json.loads(split("evaluate", str(drive), "--vehicle", vehicle, *in_sample, "--json"))
    lines = [
        f"### {case.title}",
        "",
        f"    split ingest {shown}/{case.log} --vehicle {vehicle_shown} {' '.join(case.ingest)} -o drive.parquet",
        f"    split evaluate drive.parquet --vehicle {vehicle_shown} {' '.join(options)}",
        f"    split evaluate drive.parquet --vehicle {vehicle_shown} --features z2,z1 --protocol paper",
        "",
        f"{held['drives'][0]['tested']} held-out labels.",
        "",
        *score_table(held),
        "",
        *size_table(held, paper),
        "",
        *rollout_table(held),
        "",
    ]
    return "\n".join(lines)


def split(*arguments: str) -> str:
    """Run the command line and return its stdout."""
    finished = subprocess.run([sys.executable, "-m", "split_cli", *arguments], capture_output=True, text=True, cwd=ROOT)
    if finished.returncode:
        raise SystemExit(f"split {' '.join(arguments)}: {finished.stderr}")
    return finished.stdout


def score_table(report: dict) -> list[str]:
    """Errors, likelihood and coverage of every predictor."""
    lines = [
        "| model | z | points | norm | v_x | v_y | r | skill | NLPD | in 95 % | us a query |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for s in report["scores"]:
        likelihood = number(sum(s["nlpd"])) if s["nlpd"] else ""
        coverage = "/".join(f"{100 * c:.0f}" for c in s["coverage_95"]) if s["coverage_95"] else ""
        time = f"{1e6 * s['time_per_query']:.0f}" if s["time_per_query"] else ""
        v_x, v_y, r, norm = s["rmse"]
        cells = [
            s["name"],
            s["features"],
            s["points"] or "",
            *map(number, (norm, v_x, v_y, r)),
            f"{s['skill_velocity_held'][3]:.3f}",
            likelihood,
            coverage,
            time,
        ]
        lines.append("| " + " | ".join(map(str, cells)) + " |")
    floor = report["noise_floor"]
    if floor and floor["rms"]:
        norm = sum(v * v for v in floor["rms"]) ** 0.5
        lines.append("| noise floor | | | " + " | ".join(map(number, (norm, *floor["rms"]))) + " | | | | |")
    if floor and floor["reason"]:
        lines += ["", f"Noise floor: {floor['reason'].split(': ', 1)[-1]}."]
    return lines


def size_table(held: dict, paper: dict) -> list[str]:
    """z1 against z2 at equal sizes, held out and by the paper's protocol."""
    chosen = {(s["size"], s["score"]["features"]): s["score"] for s in held["sizes"]}
    sizes = list(dict.fromkeys(s["size"] for s in held["sizes"]))
    lines = ["| most informative samples | z2, norm | z1, norm | smaller |", "|---|---|---|---|"]
    for size in sizes:
        z2, z1 = (chosen[size, name] for name in ("z2", "z1"))
        lines.append(row_of_two(f"{size or 'all'} ({z2['points']}, {z1['points']})", z2, z1))
    for s in paper["sizes"][:1]:
        both = {p["score"]["features"]: p["score"] for p in paper["sizes"] if p["size"] == s["size"]}
        lines.append(row_of_two(f"{s['size']}, in sample (the paper's protocol)", both["z2"], both["z1"]))
    return lines


def row_of_two(label: str, z2: dict, z1: dict) -> str:
    """One comparison; closer than one per cent is called equal."""
    a, b = z2["rmse"][3], z1["rmse"][3]
    smaller = "equal" if abs(a - b) < 0.01 * max(a, b) else "z2" if a < b else "z1"
    return f"| {label} | {number(a)} | {number(b)} | {smaller} |"


def rollout_table(report: dict) -> list[str]:
    """Multi-step errors of the nominal model, velocities held, and the committee."""
    if not report["rollouts"]:
        return ["No rollouts: no held-out stretch is long enough."]
    lines = ["| after | model | v_x | v_y | r | position |", "|---|---|---|---|---|---|"]
    for r in report["rollouts"]:
        if r["features"] in ("", "z2") and r["name"] in ("nominal", "velocity held", "bcm"):
            place = number(r["distance"]) if r.get("distance") is not None else ""
            lines.append(f"| {r['horizon']:g} s | {r['name']} | {' | '.join(map(number, r['rmse'][:3]))} | {place} |")
    return lines


def number(value: float | None) -> str:
    """Three significant digits."""
    return "" if value is None or value != value else f"{value:.3g}"


if __name__ == "__main__":
    main()
