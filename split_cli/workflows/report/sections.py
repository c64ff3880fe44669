"""The report's sections as HTML: verdict, where, what, does it help, what was not judged, and what was read."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from split_cli.diagnosis.result import Diagnosis, Finding, Improvement, Location, RemainderTest, RivalSummary
from split_cli.workflows.report.words import (
    CHANNELS,
    FORCE_IDS,
    FORCES,
    chance,
    escape,
    number,
    parameter,
    percent,
    quantity,
    term_title,
    variable,
)

__all__ = ["all_sections", "headline", "improvable_removed"]

_HEADLINES = {
    "match": ("=", "Simulation and reality agree."),
    "mismatch": ("≠", "Simulation and reality differ."),
    "undecided": ("?", "It cannot be decided."),
}
_STAGES = (
    ("before", "Simulation as it is"),
    ("physics", "With the named physics"),
    ("split_only", "With SPLIT only"),
    ("after", "With physics and SPLIT"),
    ("persistence", "Persistence"),
)


def headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in one plain sentence."""
    return _HEADLINES[diagnosis.verdict][1]


def all_sections(diagnosis: Diagnosis) -> str:
    """Return the body of the page; a verdict without a gap has no sections about one."""
    parts = [_verdict(diagnosis)]
    if diagnosis.verdict == "undecided":
        parts.append(_not_judged(diagnosis))
    if any(len(gap.t) for gap in diagnosis.gaps):
        parts.append(_where(diagnosis))
    if diagnosis.verdict == "mismatch":
        parts.append(_what(diagnosis))
    if diagnosis.improvement is not None:
        parts.append(_help(diagnosis, diagnosis.improvement))
    if diagnosis.verdict != "undecided":
        parts.append(_not_judged(diagnosis))
    parts.append(_provenance(diagnosis))
    return "\n".join(parts)


def improvable_removed(before: Sequence[float], other: Sequence[float], floor: Sequence[float]) -> float:
    """Return the share of squared error above the noise floor that is gone, channels weighed by their noise.

    NaN when the squared error before is, on average, within 2 % of the floor's: noise over noise is no share.
    """
    weights = [1.0 / f**2 if f > 0.0 else 0.0 for f in floor]
    removable = sum(w * max(b * b - f * f, 0.0) for w, b, f in zip(weights, before, floor, strict=True))
    removed = sum(
        w * (b * b - max(o, f) ** 2) for w, b, o, f in zip(weights, before, other, floor, strict=True) if b > f
    )
    return removed / removable if removable > 0.02 * len(floor) else math.nan


def _verdict(diagnosis: Diagnosis) -> str:
    sign, sentence = _HEADLINES[diagnosis.verdict]
    named = [f'<a class="chip" href="#finding-{k}">{escape(term_title(f.term))}</a>'
             for k, f in enumerate(diagnosis.findings, 1)]  # fmt: skip
    if diagnosis.unexplained:
        words = "and something without a name" if named else "nothing in the catalogue explains it"
        named.append(f'<a class="chip open" href="#remainder">{words}</a>')
    chips = f'<p class="chips"><span>What was left out:</span> {" ".join(named)}</p>' if named else ""
    text = diagnosis.summary.removeprefix(sentence).strip()
    text = text.removeprefix("It cannot be decided whether simulation and reality differ:").strip()
    facts = "".join(
        f"<div><dt>{escape(what)}</dt><dd>{escape(value)}<small>{escape(note)}</small></dd></div>"
        for what, value, note in _facts(diagnosis)
    )
    return (
        f'<section class="verdict {diagnosis.verdict}" aria-labelledby="verdict">'
        f'<span class="sign" aria-hidden="true">{sign}</span>'
        f'<h1 id="verdict">{sentence}</h1>{chips}'
        f'<p class="lead">{escape(text)}</p>'
        f'<dl class="facts">{facts}</dl></section>'
    )


def _facts(diagnosis: Diagnosis) -> Iterable[tuple[str, str, str]]:
    if diagnosis.verdict == "undecided":
        yield "Compared", percent(diagnosis.compared_share), "of the real drive lies where the simulation has been"
        return
    yield "By chance", chance(diagnosis.p_value), "if nothing but noise and an allowance set them apart"
    yield "Compared", percent(diagnosis.compared_share), "of the real drive lies where the simulation has been"
    if diagnosis.findings:
        largest = max(diagnosis.findings, key=lambda finding: finding.severity)
        yield "Size", f"{number(largest.severity, 2)} ×", f"sensor noise in 0.05 s ({term_title(largest.term)})"
    help_ = diagnosis.improvement
    if help_ is not None and help_.noise_floor is not None and diagnosis.findings:
        share = improvable_removed(help_.before, help_.physics, help_.noise_floor)
        if math.isfinite(share):
            yield "Removed", percent(share), "of the held-out squared error above the noise floor, by the physics"
        else:
            yield "Removed", "–", "held-out one-step errors were at the noise floor already"
    if diagnosis.remainder is not None:
        yield "Without a name", percent(diagnosis.remainder.share), "of the gap"


def _where(diagnosis: Diagnosis) -> str:
    mismatch = diagnosis.verdict == "mismatch"
    title = "Where" if mismatch else "Where they were compared"
    intro = _location_words(diagnosis.location) if diagnosis.location is not None else (
        '<p>Colour tells how often both have been at an operating point; outlined cells were only driven in reality '
        "and could not be compared. Agreement is claimed for coloured cells only.</p>"
    )  # fmt: skip
    figures = [_figure("map", "Over operating points", "Drag to zoom, double-click to reset.")]
    figures.append(_figure("track", "Along the track", "Hover to see the same moment in every chart."))
    if mismatch:
        figures.append(
            _figure("strip", "Over the drive", "A zoom here restricts the other two charts.", wide=True)
        )
    bar = '<form class="controls" id="controls" aria-label="What the charts show"></form>'
    return (
        f'<section id="where" aria-labelledby="where-title"><h2 id="where-title">{title}</h2>{intro}'
        f'{bar}<div class="figures">{"".join(figures)}</div>'
        "<noscript><p>The charts of this section need scripts, which are part of this file.</p></noscript></section>"
    )


def _figure(name: str, title: str, hint: str, *, wide: bool = False) -> str:
    return (
        f'<figure class="plot{" wide" if wide else ""}" id="plot-{name}">'
        f'<figcaption><b>{title}</b> <span class="hint">{hint}</span></figcaption>'
        f'<div class="canvas"></div><div class="legend"></div></figure>'
    )


def _location_words(location: Location) -> str:
    bars = "".join(
        _bar_row(FORCES[name], location.forces[name], percent(location.forces[name]), f"force-{k}")
        for k, name in enumerate(FORCE_IDS)
    )
    scores = [(name, score) for name, score in location.depends_on if score > 0.005][:6]
    depends = "".join(
        _bar_row(f"{variable(name)[0]} <i>{escape(name)}</i>", score, percent(score)) for name, score in scores
    ) or "<p>No single variable explains any of it.</p>"  # fmt: skip
    facts = []
    for name, (low, high) in location.region.items():
        words, unit = variable(name)
        facts.append(f"{words} between {quantity(low, unit)} and {quantity(high, unit)}")
    if location.place is not None:
        place = location.place
        lap = f" of a {number(place.lap_length)} m lap" if place.lap_length else ""
        how = "" if place.reference == "position" else ", by dead reckoning"
        facts.append(f"s = {number(place.s_start)} to {number(place.s_end)} m{lap}{how}")
    if location.time is not None:
        facts.append(f"t = {number(location.time[0])} to {number(location.time[1])} s")
    region = f"<p>Larger than elsewhere at {escape('; '.join(facts))}.</p>" if facts else ""
    if (location.place or location.time) and location.share_of_samples < 1.0:
        region += (
            f"<p>{percent(location.share_of_gap)} of the gap lies there, "
            f"in {percent(location.share_of_samples)} of the samples.</p>"
        )
    return (
        f'<div class="columns"><div><h3>In which force</h3><div class="bars">{bars}</div></div>'
        f'<div><h3>What it goes with</h3><div class="bars">{depends}</div></div></div>{region}'
    )


def _bar_row(label: str, share: float, value: str, extra: str = "") -> str:
    """Return one bar of a bar chart; `label` is HTML already."""
    width = min(max(share, 0.0), 1.0) * 100.0
    return (
        f'<div class="bar {extra}"><span>{label}</span>'
        f'<span class="track"><span style="width:{width:.1f}%"></span></span><b>{value}</b></div>'
    )


def _what(diagnosis: Diagnosis) -> str:
    cards = "".join(_finding(k, finding) for k, finding in enumerate(diagnosis.findings, 1))
    if not diagnosis.findings:
        cards = '<p class="lead">No term of the catalogue earned its place.</p>'
    remainder = "" if diagnosis.remainder is None else _remainder(diagnosis.remainder, diagnosis.unexplained)
    steps = "".join(f"<li>{escape(step)}</li>" for step in diagnosis.history)
    history = f"<details><summary>Steps of the selection</summary><ol>{steps}</ol></details>" if steps else ""
    return (
        f'<section id="what" aria-labelledby="what-title"><h2 id="what-title">What was left out</h2>'
        f"{cards}{remainder}{history}</section>"
    )


def _finding(order: int, finding: Finding) -> str:
    rows = "".join(
        f"<tr><th scope=row>{escape(name)}</th><td>{parameter(p.value, p.interval_95[1] - p.interval_95[0])}</td>"
        f"<td>{parameter(p.interval_95[0], p.interval_95[1] - p.interval_95[0])} to "
        f"{parameter(p.interval_95[1], p.interval_95[1] - p.interval_95[0])}</td>"
        f"<td>{'' if p.unit == '1' else escape(p.unit)}</td></tr>"
        for name, p in finding.parameters.items()
    )
    kind = (
        "Part of the car; it is in <code>vehicle_corrected.yaml</code>."
        if finding.exported
        else "A fault of the measurement, not of the car; it stays out of the vehicle file."
    )
    return (
        f'<article class="card" id="finding-{order}" aria-labelledby="finding-{order}-title">'
        f'<h3 id="finding-{order}-title">{escape(term_title(finding.term))} '
        f"<code>{escape(finding.term)}{escape('/' + finding.variant) if finding.variant else ''}</code></h3>"
        f"<p>{escape(finding.sentence)}</p>"
        f'<div class="columns"><div><div class="scroll"><table><thead><tr><th scope=col>Parameter<th scope=col>Value'
        f"<th scope=col>95 % interval<th scope=col>Unit</tr></thead><tbody>{rows}</tbody></table></div></div>"
        f'<div><div class="bars">{_bar_row("of the gap, when taken out last", finding.gap_explained, percent(finding.gap_explained))}</div>'
        f"<p>{number(finding.severity, 2)} times sensor noise in a prediction over 0.05 s. {kind}</p></div></div>"
        f"{_alternatives(finding)}{_rivals(finding)}</article>"
    )


def _alternatives(finding: Finding) -> str:
    if not finding.alternatives:
        return ""
    names = "".join(f'<span class="chip same">{escape(term_title(name))}</span>' for name in finding.alternatives)
    hints = "".join(f"<li>{escape(hint[:1].upper() + hint[1:])}</li>" for hint in finding.separated_by)
    apart = f"<p>What would tell them apart:</p><ul>{hints}</ul>" if hints else (
        "<p>No manoeuvre is known to tell them apart from motion alone; measure one of them directly.</p>"
    )  # fmt: skip
    return f'<div class="note"><p>On this data as good, or the same: {names}</p>{apart}</div>'


def _rivals(finding: Finding) -> str:
    best: dict[tuple[str, str], RivalSummary] = {}
    for rival in sorted(finding.runners_up, key=lambda one: one.excess):
        best.setdefault((rival.term, rival.variant), rival)
    if not best:
        return ""
    placebo = finding.placebo
    longest = max(math.log10(10.0 + max(rival.excess, 0.0)) for rival in best.values())
    own = f"{escape(term_title(finding.term, finding.variant))}"
    rows = [
        f'<tr class="own"><th scope=row>{own}</th><td class="long"></td><td>0</td><td></td><td>chosen</td></tr>'
    ]
    for rival in best.values():
        same = rival.term in finding.alternatives
        is_placebo = placebo is not None and (rival.term, rival.variant) == (placebo.term, placebo.variant)
        mark = "as good here" if same else "placebo: best wrong term" if is_placebo else "worse"
        width = 100.0 * (math.log10(10.0 + max(rival.excess, 0.0)) - 1.0) / max(longest - 1.0, 1e-9)
        rows.append(
            f"<tr><th scope=row>{escape(term_title(rival.term, rival.variant))}</th>"
            f'<td class="long"><span class="track"><span class="{"same" if same else ""}" style="width:{width:.1f}%">'
            f"</span></span></td><td>{number(rival.excess)}</td><td>{number(rival.z, 2)}</td><td>{mark}</td></tr>"
        )
    return (
        '<h4>In its place</h4><div class="scroll"><table class="rivals"><thead><tr><th scope=col>Term'
        '<th scope=col class="long">Left over beyond the chosen one <i>(log scale)</i><th scope=col>χ²'
        f"<th scope=col>std errors<th scope=col></tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _remainder(remainder: RemainderTest, unexplained: bool) -> str:
    title = "What remains has structure" if unexplained else "What remains"
    words = (
        f"{percent(remainder.share)} of the gap has no name: {number(remainder.severity, 2)} times sensor noise in a "
        f"prediction over 0.05 s, {chance(remainder.p_value)} for noise alone."
    )
    most = max((saved for _, saved in remainder.by_group), default=0.0)
    bars = "".join(
        _bar_row(escape(name), saved / most, number(saved)) for name, saved in remainder.by_group if most
    )
    groups = (
        f'<h4>What a flexible fit would still find, by kind [χ²]</h4><div class="bars">{bars}</div>'
        if bars
        else ""
    )
    lead = f"<h4>A lead</h4><p><code>{escape(remainder.formula)}</code></p>" if remainder.formula else ""
    return (
        f'<article class="card {"open" if unexplained else ""}" id="remainder"><h3>{title}</h3><p>{words}</p>'
        f"{groups}{lead}</article>"
    )


def _help(diagnosis: Diagnosis, improvement: Improvement) -> str:
    share = diagnosis.settings.get("holdout_share")
    drives = [one.name for one in diagnosis.inputs if one.role == "holdout"]
    where = f"on {', '.join(drives)}" if drives else (
        f"on the last {percent(float(share))} of the real drives" if isinstance(share, float) else "on held-out time"
    )  # fmt: skip
    blocks = improvement.confidence.get("blocks")
    how = f" Intervals: 95 %, bootstrap over {blocks} blocks." if blocks else ""
    rollouts = (
        '<h3>Over longer horizons</h3><div class="figures thirds" id="rollouts"></div>'
        if improvement.rollouts
        else ""
    )
    return (
        '<section id="help" aria-labelledby="help-title"><h2 id="help-title">Does it help</h2>'
        f"<p>One-step errors {escape(where)}, which no fit has seen.{escape(how)} Grey: the error that sensor noise "
        'alone makes.</p><div class="figures thirds" id="errors"></div>'
        f"{_error_table(improvement)}{rollouts}</section>"
    )


def _error_table(improvement: Improvement) -> str:
    floor = improvement.noise_floor
    rows = []
    for key, words in _STAGES:
        values = getattr(improvement, key)
        intervals = improvement.confidence.get(key) or [None] * 3
        cells = "".join(_error_cell(v, interval) for v, interval in zip(values, intervals, strict=True))
        removed = improvable_removed(improvement.before, values, floor) if floor is not None else math.nan
        shown = "" if key in ("before", "persistence") else percent(removed)
        rows.append(f"<tr><th scope=row>{words}</th>{cells}<td>{shown}</td></tr>")
    if floor is not None:
        cells = "".join(f"<td>{number(v)}</td>" for v in floor)
        rows.append(f'<tr class="floor"><th scope=row>Noise floor</th>{cells}<td></td></tr>')
    heads = "".join(f"<th scope=col><i>{symbol}</i> [{unit}]" for symbol, _, unit in CHANNELS)
    return (
        f'<div class="scroll"><table class="errors"><thead><tr><th scope=col>Rms error{heads}'
        f"<th scope=col>Improvable error removed</tr></thead><tbody>{''.join(rows)}</tbody></table></div>"
    )


def _error_cell(value: float, interval: Sequence[float] | None) -> str:
    if interval is None:
        return f"<td>{number(value)}</td>"
    return f"<td>{number(value)} <small>{number(interval[0])} to {number(interval[1])}</small></td>"


def _not_judged(diagnosis: Diagnosis) -> str:
    if not diagnosis.not_judged:
        return ""
    items = "".join(f"<li>{_advice(note)}</li>" for note in diagnosis.not_judged)
    title = "Why, and what would allow it" if diagnosis.verdict == "undecided" else "What could not be judged"
    return (
        f'<section id="not-judged" aria-labelledby="not-judged-title"><h2 id="not-judged-title">{title}</h2>'
        f'<ul class="advice">{items}</ul></section>'
    )


def _advice(note: str) -> str:
    """Return "what: why; manoeuvre" with its parts set apart, any other sentence as it is."""
    what, colon, rest = note.partition(": ")
    why, semicolon, manoeuvre = rest.rpartition("; ")
    if not (colon and semicolon):
        return escape(note)
    first = escape(what[:1].upper() + what[1:])
    return f"<b>{first}</b><span>{escape(why)}</span><em>{escape(manoeuvre[:1].upper() + manoeuvre[1:])}</em>"


def _provenance(diagnosis: Diagnosis) -> str:
    rows = "".join(
        f"<tr><td>{escape(one.role)}</td><th scope=row>{escape(one.name)}</th>"
        f"<td><code>{escape(one.sha256)}</code></td></tr>"
        for one in diagnosis.inputs
    )
    settings = "".join(
        f"<div><dt>{escape(name.replace('_', ' '))}</dt><dd>{escape(value)}</dd></div>"
        for name, value in diagnosis.settings.items()
    )
    files = " · ".join(
        f'<a href="{name}">{name}</a>' for name in ("diagnosis.json", "vehicle_corrected.yaml", "gap.parquet")
    )
    return (
        '<section id="read" aria-labelledby="read-title"><h2 id="read-title">What was read</h2>'
        f'<div class="scroll"><table><thead><tr><th scope=col>Role<th scope=col>File<th scope=col>SHA-256</tr></thead>'
        f"<tbody>{rows}</tbody></table></div><details><summary>Settings</summary>"
        f'<dl class="settings">{settings}</dl></details><p>Beside this page: {files}</p></section>'
    )
