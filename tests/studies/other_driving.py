"""Does a correction do harm when the car is driven otherwise, has more mass, other tyres or less grip?

    python -m tests.studies.other_driving FOLDER --seed S
    python -m tests.studies.other_driving FOLDER --seed S --cars f1tenth --judge circle,step

Each car is simulated in six drives, with the seeds S to S + 5: laps of 90 s on a dry road, laps with 0.6 of the grip,
with 1.25 times the mass and with softer tyres, gentle laps, and a sine sweep. A set is trained by `split train` on
the dry laps and judged by `split evaluate --set` on each of the others; one of low grip is judged on the dry laps. More
tests of steady driving are judged with ``--judge``: a step steer (seed S + 6) and a circle (S + 7). Drives, sets and
judgements stay in FOLDER, and a run that was ended goes on where it was. Seeds below 1,000 are for development. Reports
take others, each once.
"""

import argparse
from collections.abc import Iterator
from pathlib import Path

from tests.benchmarks.results_tables import ROOT, split
from tests.studies.harm import HEADER, Pair, judgement, lines_of, summary

#: Course of each car's laps.
TRACKS = {"road": "small", "f1tenth": "f1tenth"}
LOW_GRIP = ("--effect", "friction_scale:scale=0.6")
MORE_MASS = ("--effect", "mass:scale=1.25")
SOFT_TYRES = ("--effect", "tire_stiffness:front_scale=0.8,rear_scale=0.8")
#: Driver, share of the grip and effect of laps. A drive's seed is the first one plus its place here and in
#: `MANOEUVRES`.
LAPS: dict[str, tuple[str, float, tuple[str, ...]]] = {
    "dry": ("racer", 0.7, ()),
    "low grip": ("racer", 0.4, LOW_GRIP),
    "more mass": ("racer", 0.6, MORE_MASS),
    "soft tyres": ("racer", 0.6, SOFT_TYRES),
    "gentle": ("smooth", 0.35, ()),
}
MANOEUVRES = {"sweep": "sine_sweep", "step": "step_steer", "circle": "constant_radius"}
DURATION = 90.0  # of laps [s]
#: Judged with the set of dry laps; one set of low grip is judged on the dry laps beside.
JUDGED = ("low grip", "more mass", "soft tyres", "gentle", "sweep")
PREDICTOR = "projected"


def main() -> None:
    """Print a row a state of every pair as Markdown, then counts with the stored and the running trust."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="Keeps drives, sets and judgements.")
    parser.add_argument("--seed", type=int, required=True, help="First seed of each car's drives.")
    parser.add_argument("--cars", nargs="+", choices=TRACKS, default=list(TRACKS))
    parser.add_argument(
        "--judge",
        default=",".join((*JUDGED, "dry")),
        help=f"Drives, separated by commas, of {', '.join((*LAPS, *MANOEUVRES))}; dry stands for low grip → dry.",
    )
    given = parser.parse_args()
    judged = given.judge.split(",")
    if unknown := set(judged) - {*LAPS, *MANOEUVRES}:
        parser.error(f"no drive {', '.join(sorted(unknown))}")
    folder = given.folder.absolute()  # commands run in the project's folder
    folder.mkdir(parents=True, exist_ok=True)
    print(HEADER)
    reports = []
    for car in given.cars:
        for pair in pairs_of(car, judged, folder, given.seed):
            reports.append(judgement(pair, PREDICTOR, folder))
            print("\n".join(lines_of(pair.title, reports[-1], PREDICTOR)), flush=True)
    print()
    print("\n".join(summary(reports, PREDICTOR)))


def pairs_of(car: str, judged: list[str], folder: Path, first_seed: int) -> Iterator[Pair]:
    """Yield the pairs of one car, simulated and ingested."""
    vehicle = ROOT / "sample_logs" / f"{car}_car.yaml"

    def drive(name: str) -> Path:
        path = folder / f"{car}_{name.replace(' ', '_')}_{first_seed}.parquet"
        if not path.exists():
            seed = first_seed + [*LAPS, *MANOEUVRES].index(name)
            log = path.with_suffix(".mcap")
            split("simulate", "--car", f"{car}_car", *driven(car, name), "--seed", str(seed), "-o", str(log))
            split("ingest", str(log), "--vehicle", str(vehicle), "--map", "split_sim", "-o", str(path))
            log.unlink()
        return path

    for judge in judged:
        train = "low grip" if judge == "dry" else "dry"
        yield Pair(f"{car}: {train} → {judge}", drive(train), drive(judge), str(vehicle))


def driven(car: str, name: str) -> list[str]:
    """Return the options of `split simulate` for a drive."""
    if name in MANOEUVRES:
        return ["--maneuver", MANOEUVRES[name]]
    driver, grip, effect = LAPS[name]
    laps = ["--track", TRACKS[car], "--driver", driver, "--aggressiveness", str(grip), "--duration", str(DURATION)]
    return [*laps, *effect]


if __name__ == "__main__":
    main()
