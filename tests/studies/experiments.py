"""The paper's closed-loop experiments: a plan of races and manoeuvres, each run once and kept.

    python -m tests.studies.experiments --vehicle road_car.yaml --only small -o results/
    python -m tests.studies.experiments --vehicle road_car.yaml -o results/ \
        --page docs/experiments.md docs/records/races.md

The folder keeps the result of every race and manoeuvre; what is there is not run again. The whole plan takes some
hours on one core. ``--page`` writes its tables between the marks of pages, and figures beside the first.
"""

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.files import atomic_path, atomic_write_text, json_ready
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.maneuver import ManeuverSettings, run_maneuvers
from split_cli.workflows.racing.race import run_race
from split_cli.workflows.racing.settings import RaceSettings


@dataclass(frozen=True)
class Experiment:
    """One race, or one sweep of a manoeuvre."""

    name: str  # of its files
    group: str  # table it belongs to
    model: str  # how tables call the model: nominal, iol, split, ..
    settings: RaceSettings | ManeuverSettings  # a start set is named by the experiment that wrote it
    vehicle: str = "gentle"  # of the vehicle files that `run_experiments` is given


_CAREFUL = 0.75
_SEEDS = (0, 1, 2)
_TRACKS = {"small": {"track": "small", "max_speed": 22.0}, "handling": {"track": "handling", "max_speed": 30.0}}
_SMALL = _TRACKS["small"]
# Tyres that nobody knows on a road of lower grip ask for more care: the nominal model begins at less of its peak.
_WET = {"grip": 0.5, "assumed_friction": 0.5, "first_share": _CAREFUL, **_SMALL}


def _race(
    group: str, learner: str, seed: int = 0, vehicle: str = "gentle", model: str | None = None, **options
) -> Experiment:
    """Return a race with the one setting of all."""
    if model is None:
        model = "nominal" if learner == "none" else learner
        model += "" if vehicle == "gentle" else f" {vehicle}"
    settings = RaceSettings(learner=learner, seed=seed, max_torque=1000.0, **options)
    return Experiment(f"{group}-{model.replace(' ', '-')}-{seed}", group, model, settings, vehicle)


def _races() -> list[Experiment]:
    """Return ten laps of every learner on both tracks, and three with the named physics."""
    found = []
    for seed in _SEEDS:
        for group, track in _TRACKS.items():
            found += [_race(group, learner, seed, laps=10, **track) for learner in ("none", "split", "iol")]
    for seed in _SEEDS:
        for group, track in _TRACKS.items():
            found += [_race(group, learner, seed, "physics", laps=3, **track) for learner in ("none", "split")]
    return found + _rivals_and_roads()


def _rivals_and_roads() -> list[Experiment]:
    found = []
    for seed in _SEEDS:
        found += [_race("limit", learner, seed, "limit", laps=3, **_SMALL) for learner in ("none", "split")]
    for learner in ("none", "split"):
        found += [_race("wet", learner, seed, laps=10, **_WET) for seed in _SEEDS]
    for seed in _SEEDS:
        for learner, laps in (("none", 1), ("split", 2)):
            car = {"car": "formula_car", "model": "nominal" if learner == "none" else learner}
            found.append(_race("formula", learner, seed, "formula", laps=laps, **car, **_SMALL))
    return found


_SWEEPS = {
    ("iso3888-1", 1.0): (14, 18, 19, 20, 21, 22, 23, 24, 25, 26, 27),
    ("iso3888-1", 0.5): (12, 12.5, 13, 13.5, 14, 15, 16, 17, 18),
    ("iso3888-2", 1.0): (10, 11, 11.5, 12, 12.5, 13, 13.5, 14, 15),
    ("iso3888-2", 0.5): (6, 7, 7.5, 8, 8.5, 9, 9.5, 10),
    ("brake-avoid", 1.0): (14, 14.5, 15, 15.5, 16, 17),
    ("brake-avoid", 0.5): (10, 11, 11.5, 12, 12.5, 13, 14),
}
"""Entry speeds of each manoeuvre on each grip [m/s]; the first is where sets are learned."""


def _maneuvers() -> list[Experiment]:
    found = [
        _race("lap1", "split", 0, model="split dry", laps=1, **_SMALL),
        _race("lap1", "split", 0, model="split wet", laps=1, **_WET),
        _race("lap1", "split", 0, "physics", model="split dry physics", laps=1, **_SMALL),
    ]
    for seed in _SEEDS:
        for (scenario, grip), speeds in _SWEEPS.items():
            road = "dry" if grip == 1.0 else "wet"
            basic = ManeuverSettings(scenario=scenario, grip=grip, seed=seed, speeds=tuple(map(float, speeds)))
            for vehicle in ("gentle", "physics") if seed == 0 else ("gentle",):
                found += _sweeps(f"{scenario}-{road}", basic, vehicle)
    return found


def _sweeps(group: str, basic: ManeuverSettings, vehicle: str) -> list[Experiment]:
    """Return the sweep of the nominal model, and that of a set where one was learned with the vehicle file."""
    words, end = ("", "") if vehicle == "gentle" else (" physics", "-physics")
    nominal = Experiment(f"{group}-nominal{end}-{basic.seed}", group, f"nominal{words}", basic, vehicle)
    road = group.rpartition("-")[2]
    if road == "wet" and vehicle == "physics":
        return [nominal]  # what was found on a dry road says nothing of a wet one, and no set was learned there
    # Part 1 with what a nominal run on the same road taught; the others, unseen, with a race's first lap.
    origin = nominal.name if basic.scenario == "iso3888-1" else f"lap1-split-{road}{end}-0"
    learned = replace(basic, start_set=origin)
    return [nominal, Experiment(f"{group}-split{end}-{basic.seed}", group, f"split{words}", learned, vehicle)]


PLAN = (*_races(), *_maneuvers())


def run_experiments(folder: Path, vehicles: dict[str, Path], only: str = "") -> list[str]:
    """Run what is not there yet; return the names of what was run.

    Parameters
    ----------
    folder : path
        Results are kept here, a JSON and an npz with the traces of each experiment.
    vehicles : mapping of str to path
        Vehicle files: ``gentle``, ``limit``, ``physics``, ``formula``; experiments of one that is not given are
        left out.
    only : str
        How the names begin.
    """
    folder.mkdir(parents=True, exist_ok=True)
    ran = []
    for experiment in PLAN:
        due = experiment.name.startswith(only) and experiment.vehicle in vehicles
        if due and not (folder / f"{experiment.name}.json").exists():
            print(experiment.name, flush=True)
            _run(experiment, folder, vehicles[experiment.vehicle])
            ran.append(experiment.name)
    return ran


def _run(experiment: Experiment, folder: Path, vehicle: Path) -> None:
    settings, trained = experiment.settings, folder / f"{experiment.name}.split"
    traces: dict[str, np.ndarray] = {}
    if isinstance(settings, RaceSettings):
        keeps = settings.learner != "none"
        result = run_race(settings, vehicle, set_output=trained if keeps else None, progress=print)
        traces |= {f"lap{lap.number}": trace for lap, trace in zip(result.laps, result.traces, strict=True)}
        record = result.summary()
    else:
        if settings.start_set is not None:
            settings = replace(settings, start_set=folder / f"{settings.start_set}.split")
        learns = experiment.model.startswith("nominal") and settings.scenario == "iso3888-1"
        result = run_maneuvers(settings, vehicle, set_output=trained if learns else None)
        traces |= {f"run{k}": run.trace for k, run in enumerate(result.runs)}
        record = result.summary()
    record = {"name": experiment.name, "group": experiment.group, "model": experiment.model, "result": record}
    record = json_ready(record | {"settings": experiment.settings})
    with atomic_path(folder / f"{experiment.name}.npz") as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **traces)
    atomic_write_text(folder / f"{experiment.name}.json", json.dumps(record, indent=1, allow_nan=False) + "\n")


def stored(folder: Path) -> dict[str, dict]:
    """Return what was kept of each experiment, by name in the plan's order; ``traces`` opens its arrays."""
    found = {}
    for experiment in PLAN:
        file = folder / f"{experiment.name}.json"
        if file.exists():
            found[experiment.name] = json.loads(file.read_text(encoding="utf-8"))
            found[experiment.name]["traces"] = dict(np.load(file.with_suffix(".npz")))
    return found


def main() -> None:
    """Run from the command line."""
    from tests.studies.experiments_page import fill_pages

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    for name, what in (("", "gentle tests"), ("limit-", "tests near the limit"), ("physics-", "`split diagnose`")):
        parser.add_argument(f"--{name}vehicle", type=Path, required=not name, help=f"vehicle file from {what}")
    parser.add_argument("--formula-vehicle", type=Path, help="vehicle file of the formula car")
    parser.add_argument("--only", default="", help="how the names of the experiments begin")
    parser.add_argument("--page", type=Path, nargs="+", help="pages whose tables are written anew")
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder of the results")
    given = parser.parse_args()
    files = {name: getattr(given, f"{name}_vehicle") for name in ("limit", "physics", "formula")}
    vehicles = {name: path for name, path in {"gentle": given.vehicle, **files}.items() if path is not None}
    print(f"run: {', '.join(run_experiments(given.output, vehicles, given.only)) or 'nothing new'}")
    if given.page is not None:
        figures, left_out = fill_pages(given.page, stored(given.output), read_vehicle(given.vehicle))
        print(f"written: {', '.join([*map(str, given.page), *figures])}; on no page: {', '.join(left_out) or 'none'}")


if __name__ == "__main__":
    main()
