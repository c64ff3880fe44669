"""Put the page of a race together: one HTML document with its style, its script and its numbers inside."""

from collections.abc import Sequence
from importlib.resources import files
from string import Template
from typing import Any

import numpy as np

from split_cli.control.path import Path
from split_cli.plots.chart import Chart, ChartLine, thinned
from split_cli.plots.palette import DASHED, ROLES
from split_cli.workflows.racing.result import Lap, RaceResult
from split_cli.workflows.report.markup import charts_block, notes_section, plain_table
from split_cli.workflows.report.shell import page
from split_cli.workflows.report.words import escape, heading, prose

_BORDER_POINTS = 600
_ALONG = {
    "speed": ("Speed", "v [m/s]", 5, 1.0),
    "lateral": ("Lateral acceleration", "a_y [m/s²]", 11, 1.0),
    "torque": ("Wheel torque (negative: braking)", "T [N m]", 8, 1.0),
    "steer": ("Steer angle of the wheels", "delta [deg]", 9, 180.0 / np.pi),
}
"""Charts along the lap: title, axis, column of a trace, factor."""


def race_page(races: Sequence[RaceResult], path: Path) -> str:
    """Return a page of one race or of several on one track.

    Parameters
    ----------
    races : sequence of RaceResult
        With their traces.
    path : Path
        The track.

    Notes
    -----
    Names are escaped wherever they stand, and a content security policy admits only the page's own script.
    """
    learners = ", ".join(dict.fromkeys(_called(race) for race in races))
    charts = race_charts(races)
    package = files("split_cli.workflows.racing")
    body = Template(package.joinpath("race.html").read_text("utf-8")).substitute(
        kind="match" if any(lap.clean for race in races for lap in race.laps) else "mismatch",
        headline=heading(_headline(races)),
        caution=_caution(races),
        table=_table(races),
        timing=_timing(races),
        notes=_notes(races),
        strips=charts_block([chart for chart in charts if chart.wide]),
        plane=charts_block([chart for chart in charts if not chart.wide]),
    )
    script = package.joinpath("race.js").read_text("utf-8")
    title = f"{path.name}: laps with {learners}"
    return page("race", _about(races[0]), title, body, charts, _numbers(races, path), [script])


def race_charts(races: Sequence[RaceResult]) -> list[Chart]:
    """Return what an engineer compares along the lap and over time, and the accelerations, a series a lap.

    Of several learners the best clean lap of each is shown at first; of one, its first lap and its best. Gaps are
    to the first of these, at the same place.
    """
    laps, first, roles = _laps(races), _first(races), _roles(races)
    gap = ""
    if laps:
        name, _, trace = laps[min(first)]
        gap = f"Time gap to {name} (negative: ahead)"
        part = thinned(len(trace))
        places, passed = np.maximum.accumulate(trace[part, 1] - trace[0, 1]), trace[part, 0] - trace[0, 0]
    series: dict[str, list[ChartLine]] = {name: [] for name in ("gap", *_ALONG, "gg")}
    for k, (name, _, trace) in enumerate(laps):
        role, shown = roles[k], k in first
        part = thinned(len(trace))
        t, s = trace[part, 0] - trace[0, 0], trace[part, 1] - trace[0, 1]
        behind = np.where(s <= places[-1], t - np.interp(s, places, passed), np.nan)
        series["gap"].append(ChartLine(name, t, behind, role, along=s, shown=shown))
        for key, (_, _, column, factor) in _ALONG.items():
            series[key].append(ChartLine(name, t, factor * trace[part, column], role, along=s, shown=shown))
        series["gg"].append(ChartLine(name, trace[part, 11], trace[part, 10], role, "points", shown=shown))
    along = {
        "x": "time [s]",
        "other_x": "distance along the centre line [m]",
        "other_first": True,
        "wide": True,
        "group": "strips",
    }
    plane = "a_y, left positive [m/s²]", "a_x [m/s²]"
    return [
        Chart("gap", gap, y="gap [s]", series=tuple(series["gap"]), **along),
        *(Chart(key, title, y=y, series=tuple(series[key]), **along) for key, (title, y, _, _) in _ALONG.items()),
        Chart("gg", "Accelerations (GG)", *plane, tuple(series["gg"]), equal=True),
    ]


def _called(race: RaceResult) -> str:
    return (race.start or "nominal") if race.learner == "none" else race.learner


def _names(races: Sequence[RaceResult]) -> list[tuple[str, Lap]]:
    """Return every lap with what the page calls it."""
    several = len(races) > 1
    return [
        (f"{_called(race)}, lap {lap.number}" if several else f"lap {lap.number}", lap)
        for race in races
        for lap in race.laps
    ]


def _laps(races: Sequence[RaceResult]) -> list[tuple[str, Lap, np.ndarray]]:
    """Return the laps that can be drawn: one that was lost in its first interval has no trace."""
    traces = [trace for race in races for trace in race.traces]
    named = zip(_names(races), traces, strict=True)
    return [(name, lap, trace) for (name, lap), trace in named if len(trace)]


def _first(races: Sequence[RaceResult]) -> set[int]:
    """Return which of `_laps` are shown before anything is chosen."""
    begin, found = 0, set()
    for race in races:
        laps = _laps([race])
        clean = [k for k, (_, lap, _) in enumerate(laps) if lap.clean]
        if laps:
            found.add(begin + (min(clean, key=lambda k: laps[k][1].time) if clean else len(laps) - 1))
        begin += len(laps)
    return found if len(races) > 1 else found | {0}


def _roles(races: Sequence[RaceResult]) -> list[str]:
    """Return the colour of each of `_laps`: those that are shown at first have colours of their own."""
    first, count = _first(races), len(_laps(races))
    order = [*sorted(first), *(k for k in range(count) if k not in first)]
    return [ROLES[order.index(k) % len(ROLES)] for k in range(count)]


def _headline(races: Sequence[RaceResult]) -> str:
    clean = [(lap.time, name) for name, lap, _ in _laps(races) if lap.clean]
    if not clean:
        outside = [lap.outside for race in races for lap in race.laps if not lap.ended and lap.outside > 0.0]
        least = f" The best one left it by {max(min(outside), 0.01):.2f} m." if outside else ""
        return f"No lap was finished within the track.{least}"
    # Lap 0 is nominal in every race, but it is driven carefully: only a race without a learner is a rival.
    nominal = [
        lap.time
        for race in races
        if race.learner == "none" and race.laps[0].number == 0
        for lap in race.laps
        if lap.clean
    ]
    best, name = min(clean)
    if not nominal or best >= min(nominal):
        return f"The best clean lap took {best:.2f} s ({name})."
    gain = 100.0 * (1.0 - best / min(nominal))
    return f"The best clean lap took {best:.2f} s ({name}), {gain:.1f} % less than the best nominal one."


def _caution(races: Sequence[RaceResult]) -> str:
    """Return whether learning helped, and a warning where learners drove one lap each."""
    learning = [race for race in races if race.learner != "none"]
    verdicts = "".join(f"<p>{escape(_called(race))}: {prose(race.verdict)}</p>" for race in races if race.verdict)
    if len(learning) < 2 or max(lap.number for race in learning for lap in race.laps) > 1:
        return verdicts
    return verdicts + (
        "<p>Each learner drove one lap with what lap 0 had taught. One lap of learning is not a comparison of the "
        "learners: laps scatter by tenths of a second, and learning goes on. Compare them over ten laps "
        "(<code>--laps 10</code>) and several seeds.</p>"
    )


def _notes(races: Sequence[RaceResult]) -> str:
    """Return what races noted, once for all of which it was said."""
    said: dict[str, list[str]] = {}
    for race in races:
        for text in race.notes:
            said.setdefault(text, []).append(_called(race))
    return notes_section([f"{', '.join(dict.fromkeys(names))}: {text}" for text, names in said.items()], "Notes")


def _about(race: RaceResult) -> str:
    begins = f" and {race.start}" if race.start else ""
    return f"{race.track}, {race.length:.0f} m a lap, {race.car} with the vehicle file {race.vehicle}{begins}"


def _table(races: Sequence[RaceResult]) -> str:
    header = (
        "lap",
        "time [s]",
        "mean speed [m/s]",
        "largest a_y [g]",
        "updates",
        "points",
        "cells",
        "error v_x",
        "error v_y",
        "error r",
        "outside [m]",
    )
    rows = []
    for name, lap in _names(races):
        time = f"{lap.time:.2f}" if lap.time is not None else f"not finished: {lap.ended}"
        errors = [f"{a:.3f} / {b:.3f}" for a, b in zip(lap.error_after, lap.error_before, strict=True)]
        speeds = f"{lap.mean_speed:.2f}", f"{lap.max_lateral:.2f}"
        at = "" if lap.outside_at is None else f" at {lap.outside_at:.0f} m"
        learned = [str(n) if lap.size else "–" for n in (lap.updates, lap.size)]
        learned.append(str(lap.cells) if lap.cells else "–")
        rows.append((name, time, *speeds, *learned, *errors, f"{lap.outside:.2f}{at}"))
    return plain_table(header, rows, "table-laps")


def _timing(races: Sequence[RaceResult]) -> str:
    header = ("lap", "solver HPIPM [ms]", "whole step [ms]", "label and update [ms]", "solver failures")
    rows = []
    for name, lap in _names(races):
        times = [" / ".join(f"{v:.1f}" for v in t) for t in (lap.solver_ms, lap.step_ms, lap.update_ms)]
        rows.append((name, *times, str(lap.failures)))
    return plain_table(header, rows, "table-timing")


def _numbers(races: Sequence[RaceResult], path: Path) -> dict[str, Any]:
    """Return what the script reads: borders, and of each lap its looks, t, s, X, Y, yaw, speed, a_x, a_y."""
    every = max(1, len(path.x) // _BORDER_POINTS)
    sine, cosine = np.sin(path.direction), np.cos(path.direction)
    left = np.stack([path.x - path.left * sine, path.y + path.left * cosine], axis=1)[::every]
    right = np.stack([path.x + path.right * sine, path.y - path.right * cosine], axis=1)[::every]
    laps, first, roles = [], _first(races), _roles(races)
    for k, (name, lap, trace) in enumerate(_laps(races)):
        s = trace[:, 1] - np.floor((trace[0, 1] + 0.5 * path.length * 0.01) / path.length) * path.length
        laps.append(
            {
                "name": name,
                "time": lap.time,
                "outside": round(lap.outside, 2),
                "shown": k in first,
                "role": roles[k],
                "dash": DASHED.get(roles[k], ""),
                "t": _rounded(trace[:, 0] - trace[0, 0], 2),
                "s": _rounded(s, 1),
                "x": _rounded(trace[:, 2], 2),
                "y": _rounded(trace[:, 3], 2),
                "yaw": _rounded(trace[:, 4], 3),
                "v": _rounded(trace[:, 5], 2),
                "ax": _rounded(trace[:, 10], 2),
                "ay": _rounded(trace[:, 11], 2),
            }
        )
    return {"left": _rounded(left, 2), "right": _rounded(right, 2), "length": path.length, "laps": laps}


def _rounded(values: np.ndarray, digits: int) -> list:
    return np.round(values, digits).tolist()
