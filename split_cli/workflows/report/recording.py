"""The report of an ingest: what is wrong with a recording, what was done to it, and what it shows."""

from collections.abc import Mapping, Sequence
from typing import Any

from split_cli.logs.drive import Drive
from split_cli.plots.chart import Chart
from split_cli.signals import CHANNELS
from split_cli.workflows.report.chart_sections import chart_sections
from split_cli.workflows.report.markup import facts_list, items, plain_table, section, verdict_section
from split_cli.workflows.report.shell import page
from split_cli.workflows.report.words import number, prose


def recording_page(drive: Drive, found: Mapping[str, Any], charts: Sequence[Chart]) -> str:
    """Return the report of one recording as one HTML document that loads nothing.

    Parameters
    ----------
    found : mapping
        Its quality report, as the drive stores it.
    """
    words = _findings(found)
    checked = found.get("consistency") or {}
    held, open_ = len(checked.get("relations") or ()), len(checked.get("unjudged") or ())
    fits = "The channels fit together." if held else "The channels could not be checked against each other."
    headline = words[0] if words else fits
    kind = "mismatch" if words else "match" if held else "undecided"
    known = drive.metadata
    assumed = [f"{text[0].upper()}{text[1:]}." for text in known.faults if text not in known.contradictions]
    more = "".join(f"<p>{prose(text)}</p>" for text in (*words[1:], *assumed))
    seconds = len(drive) * drive.period
    facts = [
        ("Length", f"{number(seconds)} s", f"{len(drive):,} rows at {drive.rate:g} Hz"),
        ("Segments", f"{len(drive.segments())}", "without a gap"),
        ("Checks", f"{held} of {held + open_}", "relations between channels were judged"),
        ("Channels", f"{len(drive.columns) - 1}", _named(drive)),
    ]
    body = (
        f"{verdict_section(kind, _short(headline), f'{_rest(headline)}{more}{facts_list(facts)}')}"
        f"{''.join(chart_sections(charts))}{_open(found)}{_channels(found)}{_done(drive)}"
    )
    source = ", ".join(one.name for one in drive.metadata.sources) or drive.name
    return page("ingest", source, f"{_short(headline)} {source}", body, charts)


def _named(drive: Drive) -> str:
    """Return the channels that commands know, and how many columns are kept as recorded beside them."""
    known = [name for name in drive.columns if name in CHANNELS and name != "t"]
    others = len(drive.columns) - 1 - len(known)
    return ", ".join([*known, f"and {others} kept as recorded"] if others else known)


def _findings(found: Mapping[str, Any]) -> list[str]:
    """Return what the consistency checks found, in words."""
    checked = found.get("consistency") or {}
    findings = [str(one["text"]) for one in checked.get("findings") or () if one.get("text")]
    return findings + [str(text) for text in found.get("contradictions") or ()]


def _short(text: str) -> str:
    """Return the first clause of a finding, for a headline."""
    heads = [text.partition(end)[0] for end in (". ", "; ", ": ", " (") if end in text]
    heads = [head for head in heads if 12 <= len(head) <= 110]
    if heads:
        return f"{min(heads, key=len)}."
    return text if len(text) <= 110 else "The channels do not fit together."


def _rest(text: str) -> str:
    """Return what a finding says below its headline: what follows a whole sentence, all of a part of one."""
    head = _short(text).rstrip(".")
    rest = text.removeprefix(f"{head}. ")
    return "" if rest.rstrip(".") == head else f'<p class="lead">{prose(rest)}</p>'


def _channels(found: Mapping[str, Any]) -> str:
    rows = []
    for one in found.get("channels") or ():
        drops = "; ".join(f"{drop['count']} {drop['reason']}" for drop in one.get("drops") or ())
        rows.append(
            (
                str(one.get("channel", "")),
                str(one.get("source", "")),
                number(float(one.get("rate") or 0.0)),
                str(one.get("gaps", "")),
                str(one.get("spikes", "")),
                number(float(one.get("low") or 0.0)),
                number(float(one.get("high") or 0.0)),
                drops or "none",
            )
        )
    if not rows:
        return ""
    heads = ("Channel", "Source", "Rate [Hz]", "Gaps", "Spikes", "Lowest [SI]", "Highest [SI]", "Dropped")
    return section("channels", "Channels", plain_table(heads, rows, "table-channels"))


def _open(found: Mapping[str, Any]) -> str:
    """Return what the checks could not judge, and what was assumed; nothing where there is neither."""
    checked = found.get("consistency") or {}
    points = [f"Not judged: {one['check']}: {one['reason']}." for one in checked.get("unjudged") or ()]
    points += [f"Assumed: {text}." for text in found.get("assumed") or ()]
    points += [f"{str(text).rstrip('.')}." for text in found.get("warnings") or ()]
    return section("open", "Not judged and assumed", f"<ul>{items(points)}</ul>") if points else ""


def _done(drive: Drive) -> str:
    steps = (*drive.metadata.conversions, *drive.metadata.reported_kinds)
    return section("done", "What was converted, measured and derived", f"<ul>{items(steps)}</ul>") if steps else ""
