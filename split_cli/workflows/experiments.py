"""The paper's closed-loop experiments: a plan of races and manoeuvres, each run once and kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.control.limits import Limits
from split_cli.control.mpcc import MpccSettings
from split_cli.errors import SplitError, nearest_names
from split_cli.files import atomic_path, atomic_write_text
from split_cli.workflows.maneuver import ManeuverSettings, run_maneuvers
from split_cli.workflows.race import run_race
from split_cli.workflows.racing.settings import RaceSettings

__all__ = ["PLAN", "Experiment", "ExperimentPlan", "run_experiments", "stored"]


@dataclass(frozen=True)
class Experiment:
    """One race, or one sweep of a manoeuvre.

    Attributes
    ----------
    name : str
        Of its files.
    group : str
        Table it belongs to.
    model : str
        How tables call the model: nominal, iol, split, ...
    settings : RaceSettings or ManeuverSettings
        A start set is named by the experiment that wrote it.
    vehicle : str
        Of `ExperimentPlan.vehicles`.
    """

    name: str
    group: str
    model: str
    settings: RaceSettings | ManeuverSettings
    vehicle: str = "gentle"


@dataclass(frozen=True)
class ExperimentPlan:
    """What is run, in order.

    Attributes
    ----------
    experiments : tuple of Experiment
    """

    experiments: tuple[Experiment, ...]

    def chosen(self, only: tuple[str, ...]) -> tuple[Experiment, ...]:
        """Return the experiments whose name begins with one of `only`; all when it is empty.

        Raises
        ------
        SplitError
            If a beginning fits none.
        """
        for text in only:
            if not any(e.name.startswith(text) for e in self.experiments):
                advice = nearest_names(text, [e.name for e in self.experiments])
                raise SplitError(f"no experiment begins with {text!r}", where="--only", advice=advice)
        return tuple(e for e in self.experiments if not only or e.name.startswith(only))


# Found by one search for all learners, `docs/experiments.md`, Tuning: seed 100, which no table uses.
TUNED = {
    "nominal": MpccSettings(limits=Limits(p_long=1.2, p_ellipse=0.85), margin=0.5),
    "split": MpccSettings(limits=Limits(p_long=1.2, p_ellipse=0.95), margin=0.3),
}
_SEEDS = (0, 1, 2)


def _race(group: str, model: str, learner: str, seed: int, vehicle: str = "gentle", **options) -> Experiment:
    # On the long course every controller takes the nominal one's settings: see the page.
    own = "nominal" if learner == "none" or group == "handling" else "split"
    tuned = _careful(TUNED[own], options.get("grip", 1.0))
    settings = RaceSettings(learner=learner, seed=seed, max_torque=1000.0, settings=tuned, **options)
    return Experiment(f"{group}-{model.replace(' ', '-')}-{seed}", group, model, settings, vehicle)


def _careful(settings: MpccSettings, grip: float) -> MpccSettings:
    """Return settings whose ellipse is scaled by the road's grip: every controller is told of the rain."""
    limits = settings.limits
    return replace(settings, limits=replace(limits, p_ellipse=round(grip * limits.p_ellipse, 3)))


def _races() -> list[Experiment]:
    models = (("nominal", "none"), ("iol", "iol"), ("split", "split"))
    found = []
    for model, learner in models:
        for seed in _SEEDS:
            laps = 2 if learner == "none" else 4
            found.append(_race("small", model, learner, seed, track="small", max_speed=22.0, laps=laps))
    for model, learner in models:
        laps = {"none": 1, "iol": 3, "split": 3}[learner]
        found.append(_race("handling", model, learner, 0, track="handling", laps=laps))
    for model, learner in (("nominal", "none"), ("split", "split")):
        laps = 1 if learner == "none" else 3
        found.append(
            _race("worn", model, learner, 0, track="small", max_speed=22.0, laps=laps, grip=0.85)
        )
        found.append(
            _race("limit", f"{model} limit", learner, 0, "limit", track="small", max_speed=22.0, laps=laps)
        )
        found.append(
            _race("physics", f"{model} physics", learner, 0, "physics", track="small", max_speed=22.0, laps=laps)
        )
    # Where the rest comes from: v_x as a fourth feature, and no Jacobian of what is not known.
    found.append(
        _race("feature", "split vx", "split", 0, track="small", max_speed=22.0, laps=4,
              features="alpha_f,alpha_r,torque_ratio,vx")
    )  # fmt: skip
    return found


_SWEEPS = {
    ("iso3888-1", 1.0): (14, 18, 19, 20, 21, 22, 23, 24, 25, 26),
    ("iso3888-1", 0.5): (12, 8, 10, 11, 11.5, 12.5, 13, 13.5, 14),
    ("iso3888-2", 1.0): (10, 11, 11.5, 12, 12.5, 13, 13.5, 14),
    ("iso3888-2", 0.5): (6, 7, 7.5, 8, 8.5, 9, 9.5, 10),
    ("brake-avoid", 1.0): (14, 14.5, 15, 15.5, 16, 17),
    ("brake-avoid", 0.5): (7, 8, 9, 9.5, 10, 10.5, 11),
}
"""Entry speeds of each manoeuvre on each grip [m/s]; the first is where sets are learned."""


def _maneuvers() -> list[Experiment]:
    found = []
    for (scenario, grip), speeds in _SWEEPS.items():
        road = "dry" if grip == 1.0 else "wet"
        basic = ManeuverSettings(scenario=scenario, grip=grip, speeds=tuple(map(float, speeds)))
        group = f"{scenario}-{road}"
        found.append(Experiment(f"{group}-nominal", group, "nominal", basic))
        # Part 1 with what one nominal run on the same road taught; the others with the race's first lap, unseen.
        origin = f"{group}-nominal" if scenario == "iso3888-1" else f"lap1-{road}"
        found.append(Experiment(f"{group}-split", group, "split", replace(basic, start_set=origin)))
    for road, grip in (("dry", 1.0), ("wet", 0.5)):
        speed = 22.0 if road == "dry" else 12.0
        first = TUNED["split"] if road == "dry" else replace(TUNED["split"], limits=Limits(1.2, 0.4))
        settings = RaceSettings(
            learner="split", laps=1, max_speed=speed, max_torque=1000.0, grip=grip, seed=0, settings=first
        )
        found.insert(0, Experiment(f"lap1-{road}", "lap1", "split", settings))
    return found


PLAN = ExperimentPlan((*_races(), *_maneuvers()))


def run_experiments(
    folder: str | Path,
    vehicles: dict[str, str | Path],
    *,
    only: tuple[str, ...] = (),
    progress: Callable[[str], None] | None = None,
) -> list[str]:
    """Run what is not there yet; return the names of what was run.

    Parameters
    ----------
    folder : path
        Results are kept here, a JSON and an npz with the traces of each experiment; one that exists is not run
        again.
    vehicles : mapping of str to path
        Vehicle files: ``gentle``, ``limit``, ``physics``; experiments of a vehicle that is not given are left out.
    only : tuple of str
        Beginnings of names.
    """
    say = progress or (lambda text: None)
    folder = Path(folder)
    folder.mkdir(parents=True, exist_ok=True)
    ran = []
    for experiment in PLAN.chosen(only):
        if (folder / f"{experiment.name}.json").exists() or experiment.vehicle not in vehicles:
            continue
        say(experiment.name)
        _run(experiment, folder, vehicles[experiment.vehicle])
        ran.append(experiment.name)
    return ran


def _run(experiment: Experiment, folder: Path, vehicle: str | Path) -> None:
    settings, trained = experiment.settings, folder / f"{experiment.name}.split"
    traces: dict[str, np.ndarray] = {}
    if isinstance(settings, RaceSettings):
        keeps = settings.learner != "none"
        result = run_race(settings, vehicle, set_output=trained if keeps else None)
        traces |= {f"lap{lap.number}": trace for lap, trace in zip(result.laps, result.traces, strict=True)}
        told = asdict(result.summary())
    else:
        if settings.start_set is not None:
            origin = folder / f"{settings.start_set}.split"
            if not origin.exists():
                raise SplitError(f"needs the set of {settings.start_set}, not run yet", where=str(origin))
            settings = replace(settings, start_set=origin)
        learns = experiment.model == "nominal" and settings.scenario == "iso3888-1"
        result = run_maneuvers(settings, vehicle, set_output=trained if learns else None)
        traces |= {f"run{k}": run.trace for k, run in enumerate(result.runs)}
        told = asdict(result.summary())
    told = {"name": experiment.name, "group": experiment.group, "model": experiment.model, "result": told}
    told["settings"] = asdict(experiment.settings)
    with atomic_path(folder / f"{experiment.name}.npz") as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, **traces)
    atomic_write_text(folder / f"{experiment.name}.json", json.dumps(told, default=_plain, indent=1) + "\n")


def _plain(value):
    return value.tolist() if hasattr(value, "tolist") else str(value)


def stored(folder: str | Path) -> dict[str, dict]:
    """Return what was kept of each experiment, by name in the plan's order; ``traces`` opens its arrays."""
    found = {}
    for experiment in PLAN.experiments:
        file = Path(folder) / f"{experiment.name}.json"
        if file.exists():
            found[experiment.name] = json.loads(file.read_text(encoding="utf-8"))
            found[experiment.name]["traces"] = dict(np.load(file.with_suffix(".npz")))
    return found
