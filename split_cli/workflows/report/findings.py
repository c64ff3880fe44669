"""The report's section on what was left out: findings, what else was tried, and what remains."""

from split_cli.diagnosis.statement.result import Diagnosis, Finding, ParameterEstimate, RemainderTest, RivalSummary
from split_cli.diagnosis.statement.sentences import gap_left, scatter
from split_cli.workflows.report.headline import finding_headline
from split_cli.workflows.report.markup import bar, bar_row, items, section, table
from split_cli.workflows.report.words import chance, escape, number, parameter, percent, prose, term_title, typeset

_RIVALS = (
    "χ² is the increase of the cost with the term in place of the chosen one. Beside it stands that increase over its "
    "standard error, from the scatter between blocks of time. The placebo is the best term that these data exclude. If "
    "it does nearly as well as the chosen term, believe neither."
)


def what_section(diagnosis: Diagnosis) -> str:
    """Return the section: one card a finding, one for the remainder, and the steps of the selection."""
    cards = "".join(_finding(k, finding) for k, finding in enumerate(diagnosis.findings, 1))
    if any(finding.runners_up for finding in diagnosis.findings):
        cards = f"<p>Each card lists other terms in the place of the chosen one. {_RIVALS}</p>{cards}"
    if not diagnosis.findings:
        cards = '<p class="lead">No effect of the catalogue was identified.</p>'
    remainder = ""
    if diagnosis.remainder is not None:
        remainder = _remainder(diagnosis.remainder, diagnosis, _level(diagnosis))
    steps = items(diagnosis.history)
    history = (
        f"<details><summary>Steps of the model selection</summary><p>A term <em>saves</em> the amount by which it "
        f"lowers the cost, χ².</p><ol>{steps}</ol></details>"
        if steps
        else ""
    )
    return section("what", "What the simulation lacks", f"{cards}{remainder}{history}")


def leads_section(diagnosis: Diagnosis) -> str:
    """Return the section on explanations that are no findings; empty where there is none."""
    if not diagnosis.leads:
        return ""
    leads = items(one.sentence for one in diagnosis.leads)
    return section("leads", "Leads: explanations that are no findings", f"<ul>{leads}</ul>")


def _finding(order: int, finding: Finding) -> str:
    name = finding.term + (f"/{finding.variant}" if finding.variant else "")
    kind = (
        "Part of the car; it is in the corrected vehicle file."
        if finding.exported
        else "A fault of the measurement, not of the car; it stays out of the vehicle file."
    )
    rows = [_parameter(name, estimate) for name, estimate in finding.parameters.items()]
    explained = bar_row(
        "Share of the gap that this effect explains", finding.gap_explained, percent(finding.gap_explained)
    )
    return (
        f'<article class="card" id="finding-{order}" aria-labelledby="finding-{order}-title">'
        f'<h3 id="finding-{order}-title">{escape(finding_headline(finding))} <code>{escape(name)}</code></h3>'
        f"<p>{prose(typeset(finding.sentence))}</p>"
        f'<div class="columns"><div>{table(("Parameter", "Value", "95 % interval", "Unit"), rows)}</div>'
        f'<div><div class="bars">{explained}</div>'
        f"<p>{number(finding.effect_to_noise, 2)} times sensor noise in a prediction over 0.05 s. "
        f"{kind}</p></div></div>"
        f"{_alternatives(finding)}{_rivals(finding)}</article>"
    )


def _parameter(name: str, estimate: ParameterEstimate) -> str:
    low, high = estimate.interval_95
    value, low, high = (parameter(v, high - low) for v in (estimate.value, low, high))
    unit = "none" if estimate.unit == "1" else escape(estimate.unit)
    return f"<tr><th scope=row>{escape(name)}</th><td>{value}</td><td>{low} to {high}</td><td>{unit}</td></tr>"


def _alternatives(finding: Finding) -> str:
    if not finding.alternatives:
        return ""
    names = "".join(f'<span class="chip same">{escape(term_title(name))}</span>' for name in finding.alternatives)
    hints = items(finding.separated_by)
    apart = f"<p>What would distinguish them:</p><ul>{hints}</ul>" if hints else ""
    return f'<div class="note"><p>These data do not distinguish it from: {names}</p>{apart}</div>'


def _rivals(finding: Finding) -> str:
    best: dict[str, RivalSummary] = {}
    for rival in sorted(finding.runners_up, key=lambda one: one.excess):
        best.setdefault(rival.term, rival)
    if not best:
        return ""
    own = escape(term_title(finding.term, finding.variant))
    rows = [f'<tr class="own"><th scope=row>{own}</th><td></td><td>0</td><td></td><td>chosen</td></tr>']
    most = max(max(rival.excess, 0.0) for rival in best.values())
    rows += [_rival(finding, rival, most) for rival in best.values()]
    heads = ("Term", "Cost above the chosen term", "χ²", "χ² / standard error", "")
    return f"<h4>Other terms in its place</h4>{table(heads, rows, 'rivals')}"


def _rival(finding: Finding, rival: RivalSummary, most: float) -> str:
    placebo = finding.placebo
    same = finding.is_as_good(rival)
    is_placebo = placebo is not None and (rival.term, rival.variant) == (placebo.term, placebo.variant)
    worse = "worse in this form" if rival.term in finding.alternatives else "worse"
    mark = "as good" if same else "placebo: best excluded term" if is_placebo else worse
    shown = bar(max(rival.excess, 0.0) / max(most, 1e-9), kind="same" if same else "")
    return (
        f"<tr><th scope=row>{escape(term_title(rival.term, rival.variant))}</th><td>{shown}</td>"
        f"<td>{number(rival.excess)}</td><td>{number(rival.z, 2)}</td><td>{mark}</td></tr>"
    )


def _remainder(remainder: RemainderTest, diagnosis: Diagnosis, level: float) -> str:
    unexplained = diagnosis.unexplained
    how_much = gap_left(diagnosis.findings, remainder)
    title = "The residual has structure" if unexplained else "Residual"
    rest = scatter(remainder, diagnosis.findings)
    others = f" Another {percent(rest)} has neither name nor structure, and is not in these figures." if rest else ""
    state = "has structure and no name" if rest else "is unexplained"
    words = (
        f"{how_much[:1].upper()}{how_much[1:]} {state}, {number(remainder.effect_to_noise, 2)} times "
        f"sensor noise in a prediction over 0.05 s. Probability that noise alone leaves as much: "
        f"{chance(remainder.p_value)}. Below {level:g} it counts as unexplained.{others}"
    )
    total = sum(max(saved, 0.0) for _, saved in remainder.by_group)
    bars = "".join(
        bar_row(escape(name), saved / total, percent(saved / total)) for name, saved in remainder.by_group if total
    )
    groups = ""
    if bars and unexplained:  # of noise the shares say nothing
        groups = f'<h4>What a flexible fit of the residual depends on</h4><div class="bars">{bars}</div>'
    lead = (
        f"<h4>A candidate formula</h4><p><code>{escape(typeset(remainder.formula))}</code></p>"
        if remainder.formula
        else ""
    )
    return (
        f'<article class="card{" open" if unexplained else ""}" id="remainder"><h3>{title}</h3><p>{words}</p>'
        f"{groups}{lead}</article>"
    )


def _level(diagnosis: Diagnosis) -> float:
    """Return the level of the test, as the settings say it."""
    level = diagnosis.settings.get("level", 0.001)
    return float(level) if isinstance(level, int | float) and 0.0 < level < 1.0 else 0.001
