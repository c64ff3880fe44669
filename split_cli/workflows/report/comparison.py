"""The report of a comparison: which model is best, by how much, and how sure that is."""

from collections.abc import Sequence

import numpy as np

from split_cli.plots.chart import Chart, ChartLine
from split_cli.scoring.comparison import STATES, UNITS, ModelScore
from split_cli.workflows.compare import ModelComparison
from split_cli.workflows.report.chart_sections import chart_sections
from split_cli.workflows.report.markup import (
    charts_block,
    facts_list,
    items,
    notes_section,
    plain_table,
    section,
    verdict_section,
)
from split_cli.workflows.report.payload import digest_entry
from split_cli.workflows.report.shell import page
from split_cli.workflows.report.words import escape, number

_NAMES = {"v_x": "longitudinal velocity", "v_y": "lateral velocity", "r": "yaw rate"}


def comparison_page(compared: ModelComparison, drive_charts: Sequence[Chart] = (), table: str = "") -> str:
    """Return the report of a comparison as one HTML document that loads nothing.

    Parameters
    ----------
    table : str
        Content of the file that has the same numbers; the page names its digest.
    """
    charts = (*comparison_charts(compared), *drive_charts)
    last = _at(compared.scores, _longest(compared))
    drives = "drive" if len(compared.drives) == 1 else "drives"
    facts = [
        ("Models", str(len(compared.models)), "side by side, on the same starts"),
        ("Simulations", f"{compared.starts:,}", f"open loop, on {len(compared.drives)} {drives}"),
        ("Left out", f"{compared.diverged:,}", "simulations in which a model diverged"),
    ]
    alarms = items(compared.worse)
    if alarms:
        summary = f"<summary>{len(compared.worse)} states and horizons</summary>"
        alarms = f"<details>{summary}<ul>{alarms}</ul></details>"
    kind = "mismatch" if compared.worse else "match"
    said = comparison_headline(compared)
    title = f"Errors after {last[0].horizon:g} s of open-loop simulation"
    body = (
        verdict_section(kind, said, facts_list([*facts, *_first_judged(compared)]))
        + section("errors", title, charts_block(charts[:3], thirds=True))
        + (section("gate", f"Where {escape(compared.models[0])}, named first, is worse", alarms) if alarms else "")
        + notes_section(compared.notes, "What to know")
        + _tables(compared)
        + "".join(chart_sections(drive_charts))
    )
    return page(
        "compare", ", ".join(compared.drives), f"{said} {', '.join(compared.models)}", body, charts, digest_entry(table)
    )


def _first_judged(compared: ModelComparison) -> list[tuple[str, str, str]]:
    """Return whether the first model, which a gate in CI judges, is worse than another; it sets the colour."""
    if len(compared.models) < 2:
        return []
    name = compared.models[0]
    judged = sum(len(score.states) for score in compared.scores if score.name != name)
    return [
        (
            f"{name} worse in",
            f"{len(compared.worse)} of {judged}",
            "errors, states and horizons, than another model beyond chance",
        )
    ]


def comparison_headline(compared: ModelComparison) -> str:
    """Return which model is best at the longest horizon, and whether the others can be distinguished from it."""
    horizon = _longest(compared)
    last = _at(compared.scores, horizon)
    best = next(score for score in last if score.is_best)
    if len(last) == 1:
        return f"{best.name}: {100 * best.total:.0f} % of the error of velocities held after {horizon:g} s."
    others = [score for score in last if score is not best]
    sure = [
        one.state
        for k, one in enumerate(best.states)
        if one.is_best and not any(other.states[k].as_good for other in others)
    ]
    learned = ", but was trained on what it is compared on" if best.name in compared.in_sample else ""
    if not sure:
        return f"{best.name} has the smallest error after {horizon:g} s; the difference is not significant{learned}."
    lead = _lead(best, others)
    return f"{best.name} is best after {horizon:g} s, with {lead}, significantly in {_listed(sure)}{learned}."


def _lead(best: ModelScore, others: Sequence[ModelScore]) -> str:
    """Return by how much the error of the best is below that of the next, a mean over the three states."""
    following = min(others, key=lambda score: score.total)
    less = 100.0 * (1.0 - best.total / following.total)
    share = f"{less:.0f} %" if less >= 10.0 else f"{less:.1f} %"
    return f"{share} less error than {following.name}"


def _listed(names: Sequence[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def comparison_charts(compared: ModelComparison) -> tuple[Chart, ...]:
    """Return a chart of bars with intervals a state, at the longest horizon, the best marked."""
    last = _at(compared.scores, _longest(compared))
    charts = []
    for k, (state, unit) in enumerate(zip(STATES, UNITS, strict=True)):
        own = [score.states[k] for score in last]
        low, high = (np.array([one.interval[i] for one in own]) for i in (0, 1))
        series = ChartLine(
            "rms error",
            np.array([one.rmse for one in own]),
            np.arange(len(own)),
            "learned",
            "bars",
            low,
            high,
            emphasis=tuple(one.is_best for one in own),
        )
        note = "" if k else "Whiskers: 95 % intervals over blocks of time; ratios in the table have narrower ones."
        texts = f"compare-{state.replace('_', '')}", f"{_NAMES[state].capitalize()} {state}", f"rms error [{unit}]"
        charts.append(Chart(*texts, "", (series,), note, rows=tuple(score.name for score in last)))
    return tuple(charts)


def _longest(compared: ModelComparison) -> float:
    return max(score.horizon for score in compared.scores)


def _at(scores: Sequence[ModelScore], horizon: float) -> list[ModelScore]:
    return [score for score in scores if score.horizon == horizon]


def _tables(compared: ModelComparison) -> str:
    parts = [_table(compared.scores, "table-scores")]
    for k, (name, scores) in enumerate(compared.by_drive):
        parts.append(f"<h3>{escape(name)}</h3>{_table(scores, f'table-drive-{k}')}")
    words = (
        "<p>Fit is 100 (1 − ‖error‖/‖measured − mean‖). Skill is 1 − MSE over the MSE of persistence, which holds "
        "the velocities as they are. <em>To the best</em> is the error over that of the best model, with its 95 % "
        "interval. If the interval contains 1, the difference is not significant.</p>"
    )
    return section("scores", "All errors", words + "".join(parts))


def _table(scores: Sequence[ModelScore], name: str) -> str:
    heads = ["Model", "After [s]"]
    for state, unit in zip(STATES, UNITS, strict=True):
        heads += [f"{state} [{unit}]", "fit %", "skill", "to the best"]
    rows, best = [], []
    for k, score in enumerate(scores):
        cells = [score.name, f"{score.horizon:g}"]
        for one in score.states:
            if one.is_best:
                best.append((k, len(cells)))
            ratio, low, high = one.to_best
            # Near 1 a third digit tells an interval from its ends.
            digits = 3 if ratio < 1.1 else 2
            interval = f"{low:.{digits}f} to {high:.{digits}f}" if low == low else "interval unknown: too short a drive"
            relation = "best" if one.is_best else f"{ratio:.{digits}f} ({interval})"
            cells += [number(one.rmse), f"{one.fit:.1f}", f"{one.skill:.3f}", relation]
        rows.append(cells)
    return plain_table(heads, rows, name, best)
