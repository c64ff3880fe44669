"""Pieces of HTML that several pages are made of; no element has a style or a handler of its own."""

import re
from collections.abc import Iterable, Sequence
from dataclasses import replace

from split_cli.plots.chart import Chart
from split_cli.workflows.report.words import escape, heading, prose


def section(name: str, title: str, body: str) -> str:
    """Return a section of the page under a heading; `title` and `body` are HTML already."""
    return f'<section id="{name}" aria-labelledby="{name}-title"><h2 id="{name}-title">{title}</h2>{body}</section>'


def verdict_section(kind: str, said: str, body: str, before: str = "") -> str:
    """Return the first section: `said` as the heading of the page, HTML below it and before it."""
    return (
        f'<section class="verdict {kind}" aria-labelledby="verdict">{before}'
        f'<h1 id="verdict">{heading(said)}</h1>{body}</section>'
    )


def facts_list(facts: Iterable[tuple[str, str, str]]) -> str:
    """Return facts (what, value, note) as a list, escaped here."""
    entries = "".join(
        f"<div><dt>{escape(what)}</dt><dd>{escape(value)}<small>{heading(note)}</small></dd></div>"
        for what, value, note in facts
    )
    return f'<dl class="facts">{entries}</dl>'


def items(texts: Iterable[str]) -> str:
    """Return texts as items of a list, escaped here; empty where there is none."""
    return "".join(f"<li>{prose(text)}</li>" for text in texts)


def notes_section(notes: Sequence[str], title: str) -> str:
    """Return the section of what a reader should know; empty where there is nothing."""
    ended = [text if text.endswith((".", ":", "!", "?")) else f"{text}." for text in notes]
    return section("notes", title, f'<ul class="advice">{items(ended)}</ul>') if notes else ""


def bar(share: float, *, kind: str = "") -> str:
    """Return a bar that fills a share [1] of its trough.

    A drawing, not a styled box: a strict content policy admits no style attribute.
    """
    width = min(max(share, 0.0), 1.0) * 100.0
    return (
        '<svg class="track" viewBox="0 0 100 9" preserveAspectRatio="none" aria-hidden="true">'
        f'<rect class="{kind}" width="{width:.1f}" height="9"/></svg>'
    )


def bar_row(label: str, share: float, value: str) -> str:
    """Return one bar of a bar chart; `label` is HTML already, `share` of the full width [1]."""
    return f'<div class="bar"><span>{label}</span>{bar(share)}<b>{value}</b></div>'


def table(heads: Sequence[str], rows: Iterable[str], kind: str = "") -> str:
    """Return a table that scrolls by itself where the page is narrow; heads and rows are HTML already."""
    columns = "".join(f"<th scope=col>{head}</th>" for head in heads)
    return (
        f'<div class="scroll" tabindex="0"><table class="{kind}"><thead><tr>{columns}</tr></thead>'
        f"<tbody>{''.join(rows)}</tbody></table></div>"
    )


def plain_table(heads: Sequence[str], rows: Sequence[Sequence[str]], name: str = "", best: Sequence = ()) -> str:
    """Return a table of texts, escaped here; the first column names, the others are numbers, or texts to the left.

    Parameters
    ----------
    rows : sequence of sequence of str
    name : str
        Of the table, for links and tests.
    best : sequence of (int, int)
        Row and column of cells to mark.
    """
    marked = set(best)
    kinds = ["number" if any(re.match(r"[-+−(]?\d", row[c]) for row in rows) else "words" for c in range(len(heads))]
    lines = []
    for k, row in enumerate(rows):
        cells = [f"<th scope=row>{escape(row[0])}</th>"] if row else []
        cells += [
            f'<td class="{kinds[c]}{" win" if (k, c) in marked else ""}">{escape(text)}</td>'
            for c, text in enumerate(row[1:], 1)
        ]
        lines.append(f"<tr>{''.join(cells)}</tr>")
    columns = "".join(
        f'<th scope=col class="{kinds[c] if c else ""}">{escape(head)}</th>' for c, head in enumerate(heads)
    )
    label = f' id="{name}"' if name else ""
    return (
        f'<div class="scroll" tabindex="0"><table class="plain"{label}><thead><tr>{columns}</tr></thead>'
        f"<tbody>{''.join(lines)}</tbody></table></div>"
    )


def figure(chart: Chart) -> str:
    """Return the place a chart is drawn in, with its title and what a reader must know."""
    note = f'<p class="note-line">{prose(chart.note)}</p>' if chart.note else ""
    return (
        f'<figure class="plot{" wide" if chart.wide else ""}" id="chart-{escape(chart.name)}">'
        f"<figcaption><b>{escape(chart.title)}</b></figcaption>"
        f'<div class="canvas"></div><div class="legend"></div>{note}</figure>'
    )


def charts_block(charts: Sequence[Chart], *, thirds: bool = False) -> str:
    """Return figures side by side; strips get a switch between time and distance."""
    if not charts:
        return ""
    choice = ""
    if any(chart.other_x for chart in charts):
        first, other = ("", " checked") if any(chart.other_first for chart in charts) else (" checked", "")
        choice = (
            '<form class="controls" id="along" aria-label="What strips are drawn over"><fieldset>'
            '<legend>Over</legend><span class="pick">'
            f'<label><input type="radio" name="along-x" value="t"{first}><span>time</span></label>'
            f'<label><input type="radio" name="along-x" value="s"{other}><span>distance</span></label>'
            "</span></fieldset></form>"
        )
    if not thirds:
        return f'{choice}<div class="figures">{"".join(map(figure, charts))}</div>'
    # A third of the page is too narrow for sentences.
    noted = [chart for chart in charts if chart.note]
    titles = [f"<b>{escape(chart.title)}:</b> " if len(noted) > 1 else "" for chart in noted]
    notes = [f'<p class="note-line wide">{t}{prose(c.note)}</p>' for t, c in zip(titles, noted, strict=True)]
    drawn = "".join(figure(replace(chart, note="")) for chart in charts)
    return f'{choice}<div class="figures thirds">{drawn}{"".join(notes)}</div>'
