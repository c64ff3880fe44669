"""The report of an evaluation: does the correction help, where, and what the car does with and without it."""

from collections.abc import Iterable, Sequence

import numpy as np

from split_cli.plots.chart import Chart, ChartLine
from split_cli.plots.charts import (
    Subject,
    coverage_charts,
    drive_charts,
    growth_chart,
    handling_charts,
    label_charts,
    tire_charts,
    track_chart,
    whiteness_chart,
)
from split_cli.plots.charts.tires import LearnedForces
from split_cli.prediction import make_predictor
from split_cli.scoring.application import Correction
from split_cli.scoring.evaluation import NOMINAL, VELOCITY_PERSISTENCE, predictor_names
from split_cli.scoring.report import IntervalShares
from split_cli.scoring.run import EvaluationRun, Trace
from split_cli.scoring.verdict import VISIBLE, Comparison, does_harm, nominal_runs_away, runs_away
from split_cli.vehicle.single_track import SingleTrack
from split_cli.workflows.drive_charts import gathered
from split_cli.workflows.evaluation_notes import derived_states
from split_cli.workflows.report.chart_sections import chart_sections
from split_cli.workflows.report.markup import (
    charts_block,
    facts_list,
    notes_section,
    plain_table,
    section,
    verdict_section,
)
from split_cli.workflows.report.shell import page
from split_cli.workflows.report.words import escape, number, percent

_STATES = {"v_x": ("Longitudinal velocity", "v_x"), "v_y": ("Lateral velocity", "v_y"), "r": ("Yaw rate", "r")}
_WARNING = "WARNING: "
#: Least span of an axis of ratios [1]: a change too small to be reported is a fortieth of it, no wider than a dot.
_LEAST_SPAN = 40.0 * VISIBLE
_RATIOS = (
    "Error divided by that of the nominal model: left of the line at 1 it is smaller. Bars are 95 % "
    "intervals; where too little time was held out for one, a ratio has none and says little."
)
_MODELS = {NOMINAL: "nominal model", VELOCITY_PERSISTENCE: "persistence: velocities held"}
_PREDICTORS = (
    "<p>Predictors such as bcm and projected evaluate the same trained set in different ways; docs/prediction.md "
    "compares them. <em>Full trust</em> applies the whole correction; the others apply the share named above.</p>"
)


def evaluation_page(run: EvaluationRun, charts: Sequence[Chart] | None = None) -> str:
    """Return the report of an evaluation as one HTML document that loads nothing, by default with all charts."""
    report = run.report
    charts = evaluation_charts(run) if charts is None else charts
    names = ", ".join(drive.name for drive in report.drives)
    of_motion = derived_states(trace.held.drive.metadata for trace in run.traces)
    believed = [c for c in report.comparisons if c.name in report.settings.predictors and c.state not in of_motion]
    notes = [n for n in report.notes if not n.startswith(_WARNING) and n not in of_motion.values()]
    body = (
        f"{_verdict(run, believed, of_motion.values())}{_errors(charts)}"
        f"{''.join(chart_sections(charts))}{_tables(run)}"
        f"{notes_section([_sentence(note) for note in notes], 'Notes')}"
    )
    return page("evaluate", f"{names} with {report.vehicle}", f"{_headline(believed)[1]} {names}", body, charts)


def evaluation_charts(run: EvaluationRun) -> tuple[Chart, ...]:
    """Return the charts of the drive with the most test samples, of the first predictor."""
    if not run.traces:
        return ()
    trace = _shown(run).drawn()
    vehicle = run.sets[0].vehicle
    drive = trace.held.drive
    part = drive if trace.held.split.test.all() else drive.select(trace.held.split.test)
    subjects = [Subject("measured", "measured", part), Subject("nominal model", "simulated", part, vehicle)]
    own = next((one for one in run.sets if _same(one.features.names, trace)), run.sets[0])
    predictor = make_predictor(trace.name.split(",")[0], own)
    if not predictor.needs_context:
        z = own.features.compute(SingleTrack(vehicle), part)
        correction = Correction(own.features, z, predictor.mean, predictor.mean_and_knowledge)
        subjects.append(Subject(f"with {trace.name}", "learned", part, vehicle, correction))
    learned = LearnedForces(trace.name, trace.tested.row, trace.prediction)
    residuals = [
        ("nominal model", "simulated", trace.tested, trace.tested.y),
        (f"with {trace.name}", "learned", trace.tested, trace.tested.y - trace.prediction.mean),
    ]
    return gathered(
        [
            lambda: _ratio_charts(run.report.comparisons, run.report.settings.predictors),
            lambda: drive_charts(subjects, vehicle),
            lambda: tire_charts(drive, vehicle, None, learned),
            lambda: handling_charts(subjects, vehicle),
            lambda: [track_chart([("measured", "measured", drive)])],
            lambda: label_charts(trace),
            lambda: whiteness_chart(residuals),
            lambda: growth_chart([*zip(run.report.settings.features, run.sets, strict=True)]),
            lambda: coverage_charts(run.tallies, run.report.settings.predictors),
        ]
    )


def _shown(run: EvaluationRun) -> Trace:
    first = run.traces[0]
    same = [trace for trace in run.traces if (trace.name, trace.features) == (first.name, first.features)]
    return max(same, key=lambda trace: len(trace.tested))


def _same(names: Sequence[str], trace: Trace) -> bool:
    return tuple(names) == tuple(trace.held.labels.features.names)


def _headline(comparisons: Sequence[Comparison]) -> tuple[str, str]:
    """Return the verdict of the first predictor, as its colour and in plain words, what changes most first."""
    if not comparisons:
        return "undecided", "No predictor was scored on held-out time."
    name = comparisons[0].name
    judged = [c for c in comparisons if c.name == name and np.isfinite(c.to_nominal).all()]
    worse = sorted({c.state for c in judged if does_harm(c)}, key=list(_STATES).index)
    if worse:
        return "mismatch", f"The learned correction makes {_in_words(worse)} worse."
    away = runs_away(judged)
    if away:
        whose = (
            "The model runs away, with the correction and without" if nominal_runs_away(away) else "The model runs away"
        )
        worst = max(away, key=lambda c: c.to_held[0])
        errs = f"{_in_words([worst.state])} errs"
        return "mismatch", f"{whose}: {errs} {worst.to_held[0]:.2g} times as much as velocities held."
    better = {c.state: c for c in judged if c.is_better}
    if not judged:
        return "undecided", "Too little held-out time to tell whether the correction helps."
    if not better:
        changed = "hardly anything" if any(c.is_worse for c in judged) else "nothing significantly"
        return "undecided", f"The learned correction changes {changed}."
    longest = [min((c for c in judged if c.state == s), key=lambda c: c.to_nominal[0]) for s in better]
    best = min(longest, key=lambda c: c.to_nominal[0])
    less = round(100.0 * (1.0 - best.to_nominal[0]))
    others = [s for s in better if s != best.state]
    more = f", and smaller in {_in_words(others)}" if others else ""
    return "match", f"The correction helps: errors up to {less} % smaller in {_in_words([best.state])}{more}."


def _in_words(states: Iterable[str]) -> str:
    """Return states as a headline names them, the symbol of charts and tables behind the words."""
    return " and ".join(f"{_STATES[state][0].lower()} {_STATES[state][1]}" for state in states)


def _verdict(run: EvaluationRun, comparisons: Sequence[Comparison], left_out: Iterable[str]) -> str:
    report = run.report
    # The headline and its colour are those of the first predictor; the others stand below.
    kind, headline = _headline(comparisons)
    harm = kind == "mismatch"
    lines = "".join(f"<p>{escape(line)}.</p>" for line in report.verdicts)
    valid = sum(drive.tested_valid for drive in report.drives)
    tested = sum(drive.tested for drive in report.drives)
    trust = " / ".join(f"{100 * v:.0f}" for v in run.sets[0].trust.share) + "\u00a0%"
    facts = [
        *([("Predictor", comparisons[0].name, "the headline is its verdict")] if comparisons else []),
        ("Test samples", f"{tested:,}", f"{percent(valid / max(tested, 1))} of them in the valid region"),
        ("Points of the set", f"{run.sets[0].size:,}", f"training samples kept, in {run.sets[0].cell_count} cells"),
        ("Trust", trust, "share of the correction of v_x, v_y, r that is applied"),
    ]
    warned = [*left_out, *(note.split(_WARNING, 1)[1] for note in report.notes if note.startswith(_WARNING))]
    # Notes on a correction that does harm come first; others, such as on its intervals, behind the figures.
    style = ' class="lead"' if harm else ""
    but = "".join(f"<p{style}>Note: {escape(text)}.</p>" for text in warned)
    more = f"<details><summary>Every predictor, state by state</summary>{lines}</details>"
    said = f"{but}{facts_list(facts)}" if harm else f"{facts_list(facts)}{but}"
    return verdict_section(kind, headline, f"{said}{more}")


def _ratio_charts(comparisons: Sequence[Comparison], predictors: Sequence[str]) -> list[Chart]:
    """Return a chart a state: error over the nominal error by horizon, with 95 % intervals."""
    charts = []
    names = predictor_names([(c.name, c.features) for c in comparisons])
    roles = ("learned", "corrected", "nominal", "other", "simulated")
    for state, (title, symbol) in _STATES.items():
        own = [c for c in comparisons if c.state == state and c.name in predictors]
        when = list(dict.fromkeys(c.when for c in own))
        series = []
        for k, key in enumerate(dict.fromkeys((c.name, c.features) for c in own)):
            mine = [c for c in own if (c.name, c.features) == key]
            ratio, low, high = (np.array([c.to_nominal[i] for c in mine]) for i in range(3))
            rows = np.array([when.index(c.when) for c in mine])
            series.append(ChartLine(names[key], ratio, rows, roles[k % 5], "points", low, high))
        if series:
            note = "" if charts else _RATIOS
            charts.append(
                Chart(
                    f"ratio-{symbol.replace('_', '')}",
                    f"{title} {symbol}",
                    "ratio of errors",
                    "",
                    tuple(series),
                    note,
                    rows=tuple(when),
                    reference=1.0,
                    least_span=_LEAST_SPAN,
                )
            )
    return charts


def _errors(charts: Sequence[Chart]) -> str:
    mine = [chart for chart in charts if chart.name.startswith("ratio-")]
    return section("ratios", "Does it help, by horizon?", _PREDICTORS + charts_block(mine, thirds=True)) if mine else ""


def _tables(run: EvaluationRun) -> str:
    pooled = [score for score in run.report.scores if not score.drive]
    names = predictor_names([(score.name, score.features) for score in pooled])
    rows = [
        (
            _MODELS.get(score.name, names[score.name, score.features]),
            *(number(float(value)) for value in score.rmse),
            number(float(score.skill_velocity_held[3])),
        )
        for score in pooled
    ]
    floor = run.report.noise_floor
    if floor.rms is not None:
        rows.append(("noise floor", *(number(float(v)) for v in floor.rms), number(floor.norm), ""))
    heads = ("Rms error of one step", "v_x [m/s²]", "v_y [m/s²]", "r [rad/s²]", "norm", "skill")
    words = (
        "<p>Errors are those of the label, the rate that the nominal model lacks. The norm is the root of "
        "the sum of their squares. Skill is 1 − MSE over the MSE of persistence: 1 is perfect, 0 no better.</p>"
    )
    scores = words + plain_table(heads, rows, "table-scores")
    return section("scores", "Scores", scores) + _intervals(run.report.intervals)


def _intervals(shares: Sequence[IntervalShares]) -> str:
    """Return the shares that intervals held near the points of the set and beyond."""
    if not shares:
        return ""
    names = predictor_names([(s.name, s.features) for s in shares])
    rows = [
        (
            names[s.name, s.features],
            "within" if s.near else "beyond",
            percent(s.share),
            *(percent(float(value)) for value in s.coverage_95),
        )
        for s in shares
    ]
    words = (
        "<p>Shares of labels inside 95 % intervals, within a length scale of the set's points and beyond. Beyond "
        "the points an interval only carries the size that the residual had in the training drives.</p>"
    )
    heads = ("Predictor", "Test samples", "Share", "v_x", "v_y", "r")
    return section("intervals", "Intervals near the points and beyond", words + plain_table(heads, rows))


def _sentence(note: str) -> str:
    """Return a note of the command line as a sentence; one that begins with a file's name keeps its spelling."""
    first = note[:1] if "." in note.partition(" ")[0] else note[:1].upper()
    return f"{first}{note[1:].rstrip('.')}."
