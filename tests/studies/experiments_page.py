"""Tables and figures of the closed-loop experiments, put between the markers of pages."""

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from split_cli.control.scenarios import build_scenario
from split_cli.files import atomic_path, atomic_write_text
from split_cli.plots.style import save
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.single_track import slip_angles
from tests.studies.experiments_figures import (
    ManeuverPicture,
    RacePicture,
    draw_best_laps,
    draw_lap_times,
    draw_learning,
    draw_maneuvers,
)

_TABLE = re.compile(r"<!-- table: ([\w-]+) -->\n.*?<!-- end -->", re.S)


def fill_pages(pages: list[Path], results: dict[str, dict], vehicle: Vehicle) -> tuple[list[str], list[str]]:
    """Write tables between ``<!-- table: NAME -->`` and ``<!-- end -->``, and figures beside the first page.

    A table none of whose experiments was kept stays as it is.

    Returns
    -------
    figures, left_out : list of str
        Files that were drawn, and tables that no page asks for.
    """
    made = tables(results)

    def put(found: re.Match) -> str:
        name = found.group(1)
        return f"<!-- table: {name} -->\n{made[name]}\n<!-- end -->" if name in made else found.group(0)

    texts = [_TABLE.sub(put, page.read_text(encoding="utf-8")) for page in pages]
    figures = _figures(results, vehicle, pages[0].parent / "figures")
    for page, text in zip(pages, texts, strict=True):
        atomic_write_text(page, text)
    return figures, [name for name in made if f"<!-- table: {name} -->" not in "".join(texts)]


def tables(results: dict[str, dict]) -> dict[str, str]:
    """Return the tables by name, as Markdown."""
    groups: dict[str, list[dict]] = {}
    for result in results.values():
        groups.setdefault(result["group"], []).append(result)
    races = [result for result in results.values() if "laps" in result["result"]]
    made = {}
    for name, group in groups.items():
        if "laps" in group[0]["result"]:
            made[f"times-{name}"] = _times_table(group)
            made[f"race-{name}"] = _race_table(group)
    # A run at one speed only teaches what a sweep then drives with.
    sweeps = [result for result in results.values() if len(result["result"].get("runs", ())) > 1]
    made |= {"maneuvers": _sweep_table(sweeps)} if sweeps else {}
    made |= {"timing": _timing_table(races)} if races else {}
    return made


def _markdown(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _by_model(races: list[dict]) -> dict[str, dict[int, dict]]:
    """Return the races of each model, by seed."""
    found: dict[str, dict[int, dict]] = {}
    for race in races:
        found.setdefault(race["model"], {})[race["settings"]["seed"]] = race
    return found


def _times_table(group: list[dict]) -> str:
    """Return a row for each lap, a column for each model, and in it the times of its seeds in order."""
    models = _by_model(group)
    rows = []
    for number in sorted({lap["number"] for race in group for lap in race["result"]["laps"]}):
        times = []
        for races in models.values():
            found = [lap for race in races.values() for lap in race["result"]["laps"] if lap["number"] == number]
            times.append(" / ".join(map(_time, found)) or "-")
        rows.append([str(number), *times])
    return _markdown(["lap", *models], rows)


def _time(lap: dict) -> str:
    if lap["time"] is None:
        return "not finished"
    return f"{lap['time']:.2f}" + (f" ({lap['outside']:.2f})" if lap["outside"] > 0.0 else "")


def _motion(race: dict) -> dict | None:
    """Return the last finished lap in which errors of the exact motion were computed."""
    laps = [lap for lap in race["result"]["laps"] if lap["time"] is not None and any(lap.get("motion_before", ()))]
    return laps[-1] if laps else None


def _falls(race: dict, reference: dict | None) -> list[str]:
    """Return by how many percent the errors are below those of the gentle file on the lap that ``split`` drove.

    Errors grow with the pace, so all models are compared with the file's errors on one drive.
    """
    own, given = _motion(race), None if reference is None else _motion(reference)
    if own is None or given is None:
        return ["-"] * 3
    return [f"{100.0 * (1.0 - a / b):.0f}" for a, b in zip(own["motion_after"], given["motion_before"], strict=True)]


def clean_times(race: dict) -> list[float]:
    """Return the times of the race's own finished laps that stayed on the track [s].

    Lap 0 of a learner is driven by the nominal model, so it is none of its own.
    """
    return [lap["time"] for lap in _own_laps(race) if lap["time"] is not None and lap["outside"] == 0.0]


def _own_laps(race: dict) -> list[dict]:
    nominal = race["model"].startswith("nominal")
    return [lap for lap in race["result"]["laps"] if nominal or lap["number"] > 0]


def _race_table(group: list[dict]) -> str:
    """Return a row for each model: clean laps, best and median, what was learned, errors; seeds in order.

    Gains are on the nominal races of the same group and seed. Laps scatter, and the best of many is better than
    the best of few: so medians stand beside them.
    """
    bases = [race for race in group if race["model"] == "nominal"]
    bases = bases or [race for race in group if race["model"].startswith("nominal")]
    nominal = {race["settings"]["seed"]: clean_times(race) for race in bases}
    models = _by_model(group)
    rows = []
    for model, seeds in models.items():
        columns = []
        for seed, race in seeds.items():
            own, base, laps = clean_times(race), nominal.get(seed), race["result"]["laps"]
            cells = [f"{len(own)} of {len(_own_laps(race))}"]
            for pick in (np.min, np.median):
                cells.append(f"{pick(own):.2f}" if own else "none")
                cells.append(f"{100 * (1 - pick(own) / pick(base)):.1f}" if own and base else "-")
            cells.append(f"{max(lap['max_lateral'] for lap in laps):.2f}")
            cells += [str(laps[-1]["size"] or "-"), str(laps[-1]["cells"] or "-")]
            columns.append([*cells, *_falls(race, models.get("split", {}).get(seed))])
        joined = [" / ".join(cells) for cells in zip(*columns, strict=True)]
        rows.append([model, *("-" if set(cell) <= set("- /") else cell for cell in joined)])
    header = [
        "model",
        "clean laps",
        "best clean s",
        "gain %",
        "median clean s",
        "gain %",
        "max a_y g",
        "points",
        "cells",
        "v_x falls by %",
        "v_y",
        "r",
    ]
    return _markdown(header, rows)


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
        hits = ", ".join(f"{run['speed']:g}: {run['hit']}{'*' if run['ended'] else ''}" for run in results[0]["runs"])
        rows.append([scenario, f"{grip:g}", model, best, hits])
    header = ["manoeuvre", "grip", "model", "highest speed passed m/s", "cones hit at each entry speed, seed 0"]
    return _markdown(header, rows)


def _timing_table(races: list[dict]) -> str:
    """Return a row for each model: the largest median of a race, the largest 99 % and worst value of any lap."""
    models: dict[str, list[dict]] = {}
    for race in races:
        models.setdefault(race["model"], []).append(race)
    rows = []
    for model, alike in models.items():
        cells = []
        for name in ("solver_ms", "step_ms", "update_ms"):
            values = [np.array([lap[name] for lap in race["result"]["laps"]]) for race in alike]
            middle, most, worst = (
                max(pick(v[:, k]) for v in values) for k, pick in enumerate((np.median, np.max, np.max))
            )
            cells.append(f"{middle:.1f} / {most:.1f} / {worst:.1f}")
        failures = sum(lap["failures"] for race in alike for lap in race["result"]["laps"])
        rows.append([model, str(len(alike)), *cells, str(failures)])
    return _markdown(["model", "races", "HPIPM ms", "whole step ms", "label and update ms", "failures"], rows)


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
        column("number"),
        time,
        column("mean_speed"),
        column("updates"),
        column("size"),
        column("cells"),
        column("motion_before"),
        column("motion_after"),
        best,
    )


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
            model: (result["traces"][f"run{k}"][:, 1:3], np.array(result["result"]["runs"][k]["hit_at"]).reshape(-1, 2))
            for model, result in pair.items()
        }
        line = np.stack([scenario.path.x, scenario.path.y], axis=1)
        title = f"{name} at {speeds[k]:g} m/s, {'dry' if road == 'dry' else 'grip 0.5'}"
        found.append(ManeuverPicture(title, line, scenario.cones, runs))
    return found
