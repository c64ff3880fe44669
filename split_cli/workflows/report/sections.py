"""The report's sections as HTML: verdict, does it help, what was not judged, where, and what was read."""

from collections.abc import Iterable, Sequence

from split_cli.diagnosis.statement.document import vehicle_name
from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import Detectable, Diagnosis, Location
from split_cli.diagnosis.statement.sentences import (
    not_accepted,
    scatter,
    unexplained_part,
    where_compared,
    with_nameless_effects,
)
from split_cli.plots.chart import Chart
from split_cli.workflows.report.chart_sections import chart_sections
from split_cli.workflows.report.findings import leads_section, what_section
from split_cli.workflows.report.headline import finding_headline, findings_headline
from split_cli.workflows.report.markup import bar_row, facts_list, section, table, verdict_section
from split_cli.workflows.report.words import (
    CHANNELS,
    FORCE_IDS,
    FORCES,
    chance,
    escape,
    number,
    percent,
    prose,
    quantity,
    span,
    term_title,
    typeset,
    variable,
)

_HEADLINES = {
    "match": ("=", "Simulation and reality agree."),
    "mismatch": ("≠", "Simulation and reality differ."),
    "undecided": ("?", "It cannot be decided."),
}
_GAP = (
    "The gap is the force on the real car minus that in the simulation at the same operating point (slip angles, "
    "torque and speed). In the charts of it, red is more force in reality, blue less."
)
_OVER_THE_DRIVE = "A zoom here restricts the maps above."
_RESIDUAL = "Where the residual stays near 0, the identified effects explain the gap."
_SETTINGS = (
    "The numbers that decide are the same for every recording. diagnosis.json lists them; "
    "split_cli/diagnosis/policy.py gives the unit, meaning and origin of each."
)
_AT_THE_TOP = 9
"""Sentences that a first screen holds beside the headline [1]; judgement: those of one or two findings. More stand
below the findings: they were two screens, of which the headline and its findings say the first half."""
_STAGES = (
    ("before", "Simulation as it is"),
    ("physics", "With the identified effects"),
    ("split_only", "With SPLIT only"),
    ("after", "With effects and SPLIT"),
    ("persistence", "Persistence"),
)


def diagnosis_headline(diagnosis: Diagnosis) -> str:
    """Return the verdict in plain words: what was found by its part of the car, else whether they differ."""
    left = unexplained_part(diagnosis.findings, diagnosis.remainder) if diagnosis.unexplained else ""
    found = findings_headline(diagnosis.findings, left) if diagnosis.findings else ""
    return found or _HEADLINES[diagnosis.verdict][1]


def all_sections(diagnosis: Diagnosis, charts: Sequence[Chart] = ()) -> str:
    """Return the body of the page: what is said first, then what it is seen in.

    Findings, the errors without them, and what was not found come before the charts. A verdict without a gap has no
    sections about one.
    """
    decided = diagnosis.verdict != "undecided"
    parts = [_verdict(diagnosis)]
    if diagnosis.verdict == "mismatch":
        parts.append(what_section(diagnosis))
    if len(_lead(diagnosis)) > _AT_THE_TOP:
        parts.append(section("sentences", "What was found, in sentences", _in_sentences(diagnosis)))
    if diagnosis.improvement is not None:
        parts.append(_help(diagnosis, diagnosis.improvement))
    if decided:
        parts.append(leads_section(diagnosis))
    parts.append(_not_judged(diagnosis))
    if decided:
        parts.append(_would_show(diagnosis))
    if any(len(gap.t) for gap in diagnosis.gaps):
        parts.append(_where(diagnosis))
    if decided:
        parts += chart_sections(charts)
    parts.append(_provenance(diagnosis))
    return "\n".join(parts)


def _verdict(diagnosis: Diagnosis) -> str:
    sign, sentence = _HEADLINES[diagnosis.verdict]
    kicker = f'<p class="kicker">{sentence}</p>' if diagnosis.findings else ""
    lead = _in_sentences(diagnosis) if len(_lead(diagnosis)) <= _AT_THE_TOP else ""
    body = f"{_chips(diagnosis)}{_doubt(diagnosis)}{lead}{facts_list(_facts(diagnosis))}"
    before = f'<span class="sign" aria-hidden="true">{sign}</span>{kicker}'
    return verdict_section(diagnosis.verdict, diagnosis_headline(diagnosis), body, before)


def _in_sentences(diagnosis: Diagnosis) -> str:
    sentences = [escape(typeset(sentence)) for sentence in _lead(diagnosis)]
    if len(sentences) == 1:
        return f'<p class="lead">{sentences[0]}</p>'
    return f'<ul class="lead"><li>{"</li><li>".join(sentences)}</li></ul>'


def _chips(diagnosis: Diagnosis) -> str:
    chips = [
        f'<a class="chip" href="#finding-{k}">{escape(finding_headline(finding))}</a>'
        for k, finding in enumerate(diagnosis.findings, 1)
    ]
    if diagnosis.unexplained:
        left = unexplained_part(diagnosis.findings, diagnosis.remainder)
        words = f"and {left}" if chips else "no effect of the catalogue explains it"
        chips.append(f'<a class="chip open" href="#remainder">{words}</a>')
    if diagnosis.findings and len(chips) < 2:  # the headline says the same
        return ""
    return f'<p class="chips"><span>Findings:</span> {" ".join(chips)}</p>' if chips else ""


def _doubt(diagnosis: Diagnosis) -> str:
    """Return what speaks against the names of the headline, before all that speaks for them."""
    doubt = diagnosis.doubt
    return f'<p class="lead"><strong>{escape(doubt)}</strong></p>' if doubt else ""


def _lead(diagnosis: Diagnosis) -> Sequence[str]:
    """Return the sentences without what the headline says already."""
    if diagnosis.verdict == "match":
        subjects = [note.partition(": ")[0] for note in diagnosis.not_judged if note not in diagnosis.summary]
        # A match says nothing of what these drives cannot show.
        besides = f" Not judged: {'; '.join(subjects)}." if subjects else ""
        return [f"Within noise, {where_compared(diagnosis.compared_share)}.{besides}"]
    if diagnosis.verdict == "undecided" and diagnosis.not_judged:
        return ["Nothing is claimed about this pair of recordings."]
    return [one for one in diagnosis.sentences if one != _HEADLINES[diagnosis.verdict][1]]


def _facts(diagnosis: Diagnosis) -> Iterable[tuple[str, str, str]]:
    if diagnosis.p_value is not None:
        yield "p value", chance(diagnosis.p_value), "of so large a gap if simulation and reality were the same"
    simulated = any(one.role == "sim" for one in diagnosis.inputs)
    where = "at operating points that the simulation has too" if simulated else "with the nominal model"
    yield "Compared", percent(diagnosis.compared_share), f"of the real drive, {where}"
    if diagnosis.findings:
        largest = max(diagnosis.findings, key=lambda finding: finding.effect_to_noise)
        of_one = f" ({finding_headline(largest)})" if len(diagnosis.findings) > 1 else ""
        note = f"sensor noise over 0.05 s{of_one}"
        yield "Effect size", f"{number(largest.effect_to_noise, 2)} ×", note
    if diagnosis.improvement is not None and diagnosis.improvement.shows_gap and diagnosis.findings:
        yield from _facts_of_help(diagnosis.improvement)
    if diagnosis.remainder is not None:
        rest = scatter(diagnosis.remainder, diagnosis.findings)
        share = percent(diagnosis.remainder.share) if diagnosis.findings else "all"
        more = f", with structure; {percent(rest)} more has none" if rest else ""
        yield "Unexplained", share, f"of the gap{more}"


def _facts_of_help(shown: Improvement) -> Iterable[tuple[str, str, str]]:
    removed = shown.removed.get("physics")
    if removed is not None:
        note = "of held-out squared error above the noise floor, by the identified effects"
        yield "Error removed", percent(removed[0]), f"{note} ({span(removed)})"
    if shown.rollouts:
        last = shown.rollouts[-1]
        k = last.most_changed("physics")
        before, after = last.before[k], max(last.physics[k], 1e-12)
        ratio = f"÷ {number(before / after, 2)}" if after <= before else f"× {number(after / before, 2)}"
        unit = CHANNELS[k][2].replace("/s²", "/s")
        note = f"error of {CHANNELS[k][0]} after {last.horizon:g} s: {number(before, 2)} → {number(after, 2)} {unit}"
        yield "Open-loop error", ratio, note


def _where(diagnosis: Diagnosis) -> str:
    mismatch = diagnosis.verdict == "mismatch"
    intro = (
        f"<p>{_GAP}</p>{_location_words(diagnosis.location)}"
        if diagnosis.location is not None
        else "<p>Colour shows how many samples both drives have at an operating point. Outlined cells occur in "
        "reality only and could not be compared. The verdict holds for coloured cells.</p>"
    )
    hint = "Negative torque is braking; it may exceed the largest drive torque."
    figures = [_figure("map", "Over operating points", hint)]
    figures.append(_figure("track", "Along the track", "Pointing at a place marks its time in every chart."))
    if mismatch:
        hint = f"{_RESIDUAL} {_OVER_THE_DRIVE}" if diagnosis.findings else _OVER_THE_DRIVE
        figures.append(_figure("strip", "Over the drive", hint, wide=True))
    return section(
        "where",
        "Where" if mismatch else "Where they were compared",
        f'{intro}<form class="controls" id="controls" aria-label="What the charts show"></form>'
        f'<div class="figures">{"".join(figures)}</div>',
    )


def _figure(name: str, title: str, hint: str, *, wide: bool = False) -> str:
    return (
        f'<figure class="plot{" wide" if wide else ""}" id="plot-{name}">'
        f'<figcaption><b>{title}</b> <span class="hint">{hint}</span></figcaption>'
        f'<div class="canvas"></div><div class="legend"></div></figure>'
    )


def _location_words(location: Location) -> str:
    forces = "".join(bar_row(FORCES[name], location.forces[name], percent(location.forces[name])) for name in FORCE_IDS)
    scores = [(name, score) for name, score in location.depends_on if score > 0.005][:6]
    depends = "".join(
        bar_row(f"{escape(variable(name)[0])} <i>{escape(name)}</i>", score, percent(score)) for name, score in scores
    )
    region = _region_words(location)
    return (
        f'<div class="columns"><div><h3>Share of each force in the gap</h3><div class="bars">{forces}</div></div>'
        "<div><h3>Variables that explain the gap</h3>"
        f'<div class="bars">{depends or "<p>No single variable explains any of it.</p>"}</div></div></div>{region}'
    )


def _region_words(location: Location) -> str:
    stretches = []
    for name, (low, high) in location.region.items():
        words, unit = variable(name)
        stretches.append(f"{words} {number(low)} to {quantity(high, unit)}")
    if location.place is not None:
        place = location.place
        lap = f" of a {number(place.lap_length)} m lap" if place.lap_length else ""
        how = "" if place.reference == "position" else ", by dead reckoning"
        stretches.append(f"track position {number(place.s_start)} to {number(place.s_end)} m{lap}{how}")
    if location.time is not None:
        stretches.append(f"time {number(location.time[0])} to {number(location.time[1])} s")
    words = f"<p>The gap is largest at {prose('; '.join(stretches))}.</p>" if stretches else ""
    if location.place is not None or location.time is not None:
        there = "on that stretch" if location.place is not None else "in that time"
        words += (
            f"<p>{percent(location.share_of_gap)} of the gap lies {there}, "
            f"in {percent(location.share_of_samples)} of the samples.</p>"
        )
    return words


def _help(diagnosis: Diagnosis, improvement: Improvement) -> str:
    share = diagnosis.settings.get("holdout_share")
    drives = [one.name for one in diagnosis.inputs if one.role == "holdout"]
    if drives:
        where = f"on {', '.join(drives)}"
    elif isinstance(share, float):
        where = f"on the last {percent(share)} of the real drives"
    else:
        where = "on held-out data"
    blocks = improvement.confidence.get("blocks")
    how = f" Intervals: 95 %, bootstrap over {blocks} blocks of time." if blocks else ""
    stages = [one for one in _STAGES if diagnosis.findings or one[0] not in ("physics", "after")]
    if not improvement.shows_gap:
        how += " These data show too little of the gap to judge. Give a drive that shows it with --holdout."
    below = [
        symbol
        for k, (symbol, _, _) in enumerate(CHANNELS)
        if improvement.noise_floor is not None and improvement.before[k] < improvement.noise_floor[k]
    ]
    if below:
        how += (
            f" The error of {' and '.join(below)} is below the noise floor from the start, so nothing is left to "
            "improve. The floor is estimated from the whole recording, and this part is quieter."
        )
    tables = _error_table(improvement, stages), _rollouts(improvement, stages), _corrected(diagnosis)
    return section(
        "help",
        "Prediction error on held-out data",
        f"<p>One-step errors {escape(where)}, which the fit did not use.{escape(how)} Further left is "
        f'better. Grey: noise floor.</p><div class="figures thirds" id="errors"></div>{"".join(tables)}',
    )


def _corrected(diagnosis: Diagnosis) -> str:
    """Return the corrected vehicle beside the one given: every state after one step and after 2 s."""
    corrected = diagnosis.corrected_vehicle
    if corrected is None:
        return ""
    rows = []
    for one in corrected.states:
        values = (one.nominal, one.corrected, one.persistence, one.noise_floor)
        change = "worse" if one.is_worse else "better" if one.is_better else "no significant change"
        cells = "".join(f"<td>{number(value)}</td>" for value in values)
        rows.append(
            f"<tr><th scope=row><i>{one.channel}</i> after {one.horizon:g} s [{one.unit}]</th>{cells}"
            f"<td>{change}</td></tr>"
        )
    said = "" if corrected.accepted else f"<p><strong>{escape(not_accepted(corrected))}</strong></p>"
    if corrected.further:
        said = f"<p>{escape(' '.join(with_nameless_effects(corrected)))}</p>"
    heads = ["Rms error", "Given file", "Corrected file", "Persistence", "Noise floor", "Change"]
    return (
        "<h3>The corrected vehicle</h3><p>Errors of the nominal model alone, without corrections learned from a "
        "simulation. Sensor faults that were found are corrected for both.</p>"
        f"{said}{table(heads, rows, 'errors')}"
    )


def _error_table(improvement: Improvement, stages: Sequence[tuple[str, str]]) -> str:
    rows = []
    for stage, words in stages:
        removed = improvement.removed.get(stage)
        shown = "" if removed is None else f"{percent(removed[0])} <small>{span(removed)}</small>"
        rows.append(_error_row(words, stage, improvement, f"<td>{shown}</td>"))
    if improvement.noise_floor is not None:
        rows.append(_floor_row(improvement.noise_floor, "<td></td>"))
    heads = [f"<i>{symbol}</i> [{unit}]" for symbol, _, unit in CHANNELS]
    return table(["Rms error of one step", *heads, "Removed above noise floor"], rows, "errors")


def _rollouts(improvement: Improvement, stages: Sequence[tuple[str, str]]) -> str:
    """Return the section on longer horizons: charts, and a table for the longest."""
    if not improvement.rollouts:
        return "<p>The held-out data are too short for a longer horizon.</p>"
    last = improvement.rollouts[-1]
    rows = [_error_row(words, stage, last) for stage, words in stages]
    rows.append(_floor_row(last.noise_floor))
    units = [unit.replace("/s²", "/s") for _, _, unit in CHANNELS]
    heads = [f"<i>{symbol}</i> [{unit}]" for (symbol, _, _), unit in zip(CHANNELS, units, strict=True)]
    blocks = last.confidence.get("blocks", 0)
    return (
        "<h3>Over longer horizons</h3>"
        f"<p>Open-loop simulation with the recorded inputs, from {last.starts} starts in {blocks} blocks of "
        "held-out data. The lower a line, the better the prediction.</p>"
        '<div class="figures thirds" id="rollouts"></div><div class="legend" id="rollout-legend"></div>'
        f"{table([f'Rms error after {last.horizon:g} s', *heads], rows, 'errors')}"
    )


def _error_row(words: str, stage: str, errors: Improvement | HorizonErrors, more: str = "") -> str:
    intervals = errors.confidence.get(stage) or [None] * 3
    cells = "".join(_error_cell(v, i) for v, i in zip(getattr(errors, stage), intervals, strict=True))
    return f"<tr><th scope=row>{words}</th>{cells}{more}</tr>"


def _floor_row(floor: Sequence[float], more: str = "") -> str:
    cells = "".join(f"<td>{number(v)}</td>" for v in floor)
    return f'<tr class="floor"><th scope=row>Noise floor</th>{cells}{more}</tr>'


def _error_cell(value: float, interval: Sequence[float] | None) -> str:
    if interval is None:
        return f"<td>{number(value)}</td>"
    return f"<td>{number(value)} <small>{number(interval[0])} to {number(interval[1])}</small></td>"


def _not_judged(diagnosis: Diagnosis) -> str:
    if not diagnosis.not_judged:
        return ""
    undecided = diagnosis.verdict == "undecided"
    items = "".join(f"<li>{escape(note) if undecided else _advice(note)}</li>" for note in diagnosis.not_judged)
    title = "Why, and what to record" if undecided else "What could not be judged"
    return section("not-judged", title, f'<ul class="advice">{items}</ul>')


def _would_show(diagnosis: Diagnosis) -> str:
    """Return the section on what a silence is worth; folded where there is no silence."""
    if not diagnosis.detectable:
        return ""
    rows = [
        f"<tr><th scope=row>{escape(term_title(one.term))}</th><td>{_size(one)}</td></tr>"
        for one in diagnosis.detectable
    ]
    words = (
        f"<p>Each effect{', beside those that are identified,' * bool(diagnosis.findings)} would have been identified "
        "from about this size on. A gain or scale of 1 is no effect: 0.99 stands for a deviation of 1 %. Sizes of "
        "several parameters are each for one parameter alone. A smaller effect stays unnoticed or unexplained, or a "
        "similar effect is identified instead.</p>"
    )
    if diagnosis.verdict == "undecided":
        words += (
            "<p>It is undecided whether these drives differ already. The sizes hold only if they do not; what "
            "differs may hide an effect of more than this size.</p>"
        )
    unfolded = " open" if diagnosis.verdict == "match" else ""
    listed = table(("Other effect" if diagnosis.findings else "Effect", "Detectable from"), rows)
    body = f"<details{unfolded}><summary>Effect by effect</summary>{listed}</details>"
    return section("would-show", "Smallest detectable effects", words + body)


def _size(one: Detectable) -> str:
    sizes = [f"{escape(name.replace('_', ' '))} {quantity(*size)}" for name, size in one.parameters.items()]
    return ", ".join(sizes) or "at no size of a real car"


def _advice(note: str) -> str:
    """Return "what: why; manoeuvre" with its parts set apart, any other sentence as it is."""
    what, colon, rest = note.partition(": ")
    why, semicolon, manoeuvre = rest.rpartition("; ")
    if not (colon and semicolon):
        return escape(note)
    what, why, manoeuvre = (part[:1].upper() + part[1:] for part in (what, why, manoeuvre))
    return f"<b>{escape(what)}</b><span>{escape(why)}.</span><em>{escape(manoeuvre)}.</em>"


def _provenance(diagnosis: Diagnosis) -> str:
    rows = [
        f"<tr><td>{escape(one.role)}</td><th scope=row>{escape(one.name)}</th>"
        f"<td><code>{escape(one.sha256)}</code></td></tr>"
        for one in diagnosis.inputs
    ]
    names = [name for name in ("diagnosis.json", vehicle_name(diagnosis), "gap.parquet") if name]
    names += ["figures/help.csv"] if diagnosis.improvement else []
    links = " · ".join(f'<a href="{name}">{name}</a>' for name in names)
    return section(
        "read",
        "Inputs",
        f"{table(('Role', 'File', 'SHA-256'), rows)}<p>{_SETTINGS}</p><p>Beside this page: {links}</p>",
    )
