"""Tables and figures of the closed-loop experiments, put between the markers of a page."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from split_cli.control.scenarios import build_scenario
from split_cli.errors import SplitError
from split_cli.files import atomic_path, atomic_write_text
from split_cli.plots.closed_loop import (
    ManeuverPicture,
    RacePicture,
    draw_best_laps,
    draw_lap_times,
    draw_learning,
    draw_maneuvers,
)
from split_cli.plots.style import save
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles
from split_cli.workflows.racing.experiments import PLAN

__all__ = ["fill_page", "tables"]


def fill_page(page: str | Path, results: dict[str, dict], vehicle: Vehicle) -> list[str]:
    """Write tables between ``<!-- table: NAME -->`` and ``<!-- end -->``, figures beside the page; return figures.

    A table none of whose experiments was kept stays as it is.

    Raises
    ------
    SplitError
        If the page is missing or asks for a table that is not there.
    """
    page = Path(page)
    if not page.is_file():
        raise SplitError("no such page", where=str(page), advice="Name the page with --page.")
    text, made = page.read_text(encoding="utf-8"), tables(results)
    known = {"maneuvers", "timing"}
    known |= {f"{kind}-{e.group}" for kind in ("laps", "gain", "errors") for e in PLAN.experiments}

    def put(found: re.Match) -> str:
        name = found.group(1)
        if name in known and name not in made:
            return found.group(0)
        if name not in made:
            raise SplitError(
                f"asks for the table {name!r}, which no experiment makes",
                where=str(page),
                advice="Remove the marks of that table from the page.",
            )
        return f"<!-- table: {name} -->\n{made[name]}\n<!-- end -->"

    text = re.sub(r"<!-- table: ([\w-]+) -->\n.*?<!-- end -->", put, text, flags=re.S)
    figures = _figures(results, vehicle, page.parent / "figures")
    atomic_write_text(page, text)
    return figures


def tables(results: dict[str, dict]) -> dict[str, str]:
    """Return the tables by name, as Markdown."""
    groups: dict[str, list[dict]] = {}
    for result in results.values():
        groups.setdefault(result["group"], []).append(result)
    made = {f"laps-{name}": _lap_table(group) for name, group in groups.items() if "laps" in group[0]["result"]}
    races = [result for result in results.values() if "laps" in result["result"]]
    made |= {
        f"gain-{name}": _gain_table(group, races) for name, group in groups.items() if "laps" in group[0]["result"]
    }
    made |= {
        f"errors-{name}": _error_table(group) for name, group in groups.items() if "laps" in group[0]["result"]
    }
    # A run at one speed only teaches what a sweep then drives with.
    sweeps = [result for result in results.values() if len(result["result"].get("runs", ())) > 1]
    made |= {"maneuvers": _sweep_table(sweeps)} if sweeps else {}
    made |= {"timing": _timing_table(races)} if races else {}
    return made


def _markdown(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _lap_table(group: list[dict]) -> str:
    header = [
        "model", "seed", "lap", "time s", "outside m", "margin m", "mean speed m/s", "max a_y g", "updates", "set",
        "cells", "error v_x, v_y, r", "of nominal", "failures",
    ]  # fmt: skip
    rows = []
    for race in group:
        for lap in race["result"]["laps"]:
            after, before = np.array(lap["error_after"]), np.array(lap["error_before"])
            share = " / ".join(f"{a / b:.2f}" if b else "-" for a, b in zip(after, before, strict=True))
            time = "not finished" if lap["time"] is None else f"{lap['time']:.2f}"
            rows.append([
                race["model"], str(race["settings"]["seed"]), str(lap["number"]), time,
                f"{lap['outside']:.2f}", f"{lap['margin']:.2f}",
                f"{lap['mean_speed']:.2f}", f"{lap['max_lateral']:.2f}", str(lap["updates"]), str(lap["size"]),
                str(lap["cells"]), ", ".join(f"{v:.3f}" for v in after), share, str(lap["failures"]),
            ])  # fmt: skip
    return _markdown(header, rows)


def _error_table(group: list[dict]) -> str:
    """Return what is left of the error of the exact motion in each race's last finished lap.

    The drop is told against the gentle nominal file on the last lap that ``split`` drove with the same seed, since
    errors grow with the pace of driving.
    """
    last = {}
    for race in group:
        finished = [lap for lap in race["result"]["laps"] if lap["time"] is not None]
        laps = [lap for lap in finished if any(lap.get("motion_before", ()))]
        if laps:
            last[race["model"], race["settings"]["seed"]] = laps[-1]
    rows = []
    for (model, seed), lap in last.items():
        before, after = np.array(lap["motion_before"]), np.array(lap["motion_after"])
        reference = last.get(("split", seed))
        drop = "-"
        if reference is not None:
            share = 1.0 - after / np.array(reference["motion_before"])
            drop = " / ".join(f"{100.0 * value:.0f}" for value in share)
        rows.append([model, str(seed), str(lap["number"]), ", ".join(f"{v:.3f}" for v in before),
                     ", ".join(f"{v:.3f}" for v in after), drop])  # fmt: skip
    header = ["model", "seed", "lap", "its vehicle file", "with what it learned", "less than the gentle file %"]
    return _markdown(header, rows)


def clean_times(race: dict) -> list[float]:
    """Return the times of the race's own finished laps that stayed on the track [s].

    Lap 0 of a learner is driven by the nominal model, so it is none of its own.
    """
    return [
        lap["time"]
        for lap in _own_laps(race)
        if lap["time"] is not None and lap["outside"] == 0.0
    ]  # fmt: skip


def _own_laps(race: dict) -> list[dict]:
    nominal = race["model"].startswith("nominal")
    return [lap for lap in race["result"]["laps"] if nominal or lap["number"] > 0]


def _gain_table(group: list[dict], races: list[dict]) -> str:
    """Return the clean laps of each race, best and median, against the nominal ones of the same group and seed.

    A group without nominal races is compared with those of the same road among all `races`.
    Laps scatter, and the best of many is better than the best of few: so the medians stand beside the best.
    """
    rows = []
    bases = [race for race in group if race["model"] == "nominal"]
    bases = bases or [race for race in group if race["model"].startswith("nominal")]
    bases = bases or [
        race for race in races if race["model"] == "nominal" and _road(race) == _road(group[0])
    ]  # fmt: skip
    nominal = {race["settings"]["seed"]: clean_times(race) for race in bases}
    for race in group:
        own, base = clean_times(race), nominal.get(race["settings"]["seed"])
        cells = []
        for pick in (np.min, np.median):
            cells.append(f"{pick(own):.2f}" if own else "none")
            cells.append(f"{100 * (1 - pick(own) / pick(base)):.1f}" if own and base else "-")
        rows.append(
            [race["model"], str(race["settings"]["seed"]), f"{len(own)} of {len(_own_laps(race))}", *cells]
        )
    header = ["model", "seed", "clean laps", "best clean lap s", "gain on nominal %", "median clean lap s",
              "gain on nominal %"]  # fmt: skip
    return _markdown(header, rows)


def _road(race: dict) -> tuple:
    return tuple(race["settings"][name] for name in ("car", "track", "grip", "max_speed"))


def _sweep_table(sweeps: list[dict]) -> str:
    """Return a row for each manoeuvre, road and model: the highest speed of every seed, cones of the first."""
    alike: dict[tuple, list[dict]] = {}
    for sweep in sweeps:
        result = sweep["result"]
        alike.setdefault((result["scenario"], result["grip"], sweep["model"]), []).append(result)
    rows = []
    for (scenario, grip, model), results in sorted(alike.items(), key=lambda pair: (pair[0][0], -pair[0][1])):
        highest = (result["highest_passed"] for result in results)
        best = " / ".join("none" if speed is None else f"{speed:g}" for speed in highest)
        told = ", ".join(f"{run['speed']:g}: {_ended(run)}" for run in results[0]["runs"])
        rows.append([scenario, f"{grip:g}", model, best, told])
    header = ["manoeuvre", "grip", "model", "highest speed passed m/s", "cones hit at each entry speed, seed 0"]
    return _markdown(header, rows)


def _ended(run: dict) -> str:
    return f"{run['hit']}{'*' if run['ended'] else ''}"


def _timing_table(races: list[dict]) -> str:
    rows = []
    for race in races:
        laps = race["result"]["laps"]
        cells = []
        for name in ("solver_ms", "step_ms", "update_ms"):
            middle, most, worst = (np.array([lap[name][k] for lap in laps]) for k in range(3))
            cells.append(f"{np.median(middle):.1f} / {most.max():.1f} / {worst.max():.1f}")
        rows.append([race["name"], *cells, str(sum(lap["failures"] for lap in laps))])
    return _markdown(["race", "HPIPM ms", "whole step ms", "label and update ms", "failures"], rows)


def _picture(race: dict, vehicle: Vehicle) -> RacePicture:
    laps = race["result"]["laps"]

    def column(name: str) -> np.ndarray:
        return np.array([lap[name] for lap in laps], dtype=float)

    time = np.array(
        [np.nan if lap["time"] is None or lap["outside"] > 0.0 else lap["time"] for lap in laps], dtype=float
    )
    shown = int(np.nanargmin(time)) if np.isfinite(time).any() else 0
    t = race["traces"][f"lap{laps[shown]['number']}"]
    alpha = slip_angles(t[:, 5], t[:, 6], t[:, 7], t[:, 9], vehicle.cg_to_front_axle, vehicle.cg_to_rear_axle)
    s = np.mod(t[:, 1] + 0.5, race["result"]["length"])
    order = np.argsort(s, kind="stable")
    best = np.stack([s, t[:, 2], t[:, 3], t[:, 5], t[:, 10], t[:, 11], *alpha], axis=1)[order]
    return RacePicture(
        column("number"), time, column("mean_speed"), column("updates"), column("size"), column("cells"),
        column("error_before"), column("error_after"), best,
    )  # fmt: skip


def _figures(results: dict[str, dict], vehicle: Vehicle, folder: Path) -> list[str]:
    made = []
    folder.mkdir(exist_ok=True)

    def keep(name: str, draw: Callable, *what) -> None:
        with atomic_path(folder / name) as temporary:
            save(draw(*what), temporary)
        made.append(name)

    for track in ("small", "handling"):
        races: dict[str, list[dict]] = {}
        for result in results.values():
            if result["group"] == track:
                races.setdefault(result["model"], []).append(result)
        if len(races) < 2:
            continue
        pictures = {name: [_picture(race, vehicle) for race in group] for name, group in races.items()}
        keep(f"closed-loop-{track}-laps.png", draw_lap_times, pictures)
        firsts = {name: group[0] for name, group in pictures.items()}
        keep(f"closed-loop-{track}-best.png", draw_best_laps, firsts)
        learned = {name: race for name, race in firsts.items() if not name.startswith("nominal")}
        keep(f"closed-loop-{track}-learning.png", draw_learning, learned)
    for road in ("dry", "wet"):
        pictures = _maneuver_pictures(results, road)
        if pictures:
            keep(f"closed-loop-maneuvers-{road}.png", draw_maneuvers, pictures)
    return made


def _maneuver_pictures(results: dict[str, dict], road: str) -> list[ManeuverPicture]:
    found = []
    for name in ("iso3888-1", "iso3888-2", "brake-avoid"):
        pair = {m: results.get(f"{name}-{road}-{m}-0") for m in ("nominal", "split")}
        if not all(pair.values()):
            continue
        speeds = [run["speed"] for run in pair["nominal"]["result"]["runs"]]
        # The slowest entry at which the two differ tells most; else the first.
        differ = [
            k
            for k in range(len(speeds))
            if pair["nominal"]["result"]["runs"][k]["hit"] != pair["split"]["result"]["runs"][k]["hit"]
        ]
        k = differ[0] if differ else 0
        scenario = build_scenario(name, pair["nominal"]["result"]["width"], speeds[k])
        runs = {
            model: (
                result["traces"][f"run{k}"][:, 1:3],
                np.array(result["result"]["runs"][k]["hit_at"]).reshape(-1, 2),
            )
            for model, result in pair.items()
        }
        line = np.stack([scenario.path.x, scenario.path.y], axis=1)
        title = f"{name} at {speeds[k]:g} m/s, {'dry' if road == 'dry' else 'grip 0.5'}"
        found.append(ManeuverPicture(title, line, scenario.cones, runs))
    return found
