"""The quality report of a drive: what was recorded, what was dropped and why, what does not fit together."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from split_cli.files import json_ready
from split_cli.logs.assembling.clean import CleanSeries, Drop
from split_cli.logs.assembling.noise import resolution
from split_cli.logs.checking.channel_delays import DelayEstimate
from split_cli.logs.checking.consistency import Consistency
from split_cli.logs.map_entries import EXTRA_UNITS
from split_cli.signals import CHANNELS

_KNOWN = {*CHANNELS, *EXTRA_UNITS}
_MOST_ROWS = 12
"""Of the table, for columns that no command knows: CarSim writes 700, and what follows would be out of sight."""
_SHOWN = 6
UNSTATED = " (neither file nor map says)"
"""How an assumption ends that is made for want of a unit."""
EARLIER = " (when it was first ingested)"
"""What follows an assumption that a drive brings with it."""


@dataclass(frozen=True)
class ChannelQuality:
    """One source of a channel."""

    channel: str
    source: str
    samples: int  # usable
    rate: float  # from the median distance of two samples [Hz]
    # Half the spread between the 1 % and 99 % quantile of that distance, as a share of the median [1].
    jitter: float
    gaps: int  # steps longer than the gap
    longest_gap: float  # [s]
    spikes: int
    # low, high: range in SI.
    low: float
    high: float
    resampling: str  # ``held``, ``interpolated`` or ``low-passed``
    drops: tuple[Drop, ...] = ()
    step: float | None = None  # in which it is recorded, in SI; None where its steps have no common unit


@dataclass(frozen=True)
class QualityReport:
    """All that ingest found out."""

    channels: tuple[ChannelQuality, ...]
    segments: int
    duration: float  # of the drive, gaps left out [s]
    recorded: float  # from the first to the last sample of the slowest required channel [s]
    origin: float  # time of the recording at which t is 0 [s]
    clock: str  # in words
    consistency: Consistency
    delays: tuple[DelayEstimate, ...] = ()  # estimated, whether applied or refused
    assumed: tuple[str, ...] = ()
    contradictions: tuple[str, ...] = ()
    skipped: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    unverified: str = ""  # why a bit that flipped in the source would go unnoticed; empty where checksums tell

    def to_mapping(self) -> dict[str, Any]:
        """Return the report as plain values for JSON; what is not finite becomes null."""
        plain = asdict(self)
        for relation in plain["consistency"]["relations"]:
            # A function of the search for explanations, no result.
            del relation["corrected"]
        return json_ready(plain)


def source_quality(clean: CleanSeries, gap: float, resampling: str) -> ChannelQuality:
    """Summarise one cleaned source; `gap` [s] as for resampling."""
    step = np.diff(clean.time)
    spread = float(np.subtract(*np.quantile(step, [0.99, 0.01])))
    longer = step > gap * (1.0 + 1e-6)
    return ChannelQuality(
        channel=clean.channel,
        source=clean.source,
        samples=len(clean.time),
        rate=1.0 / clean.period,
        jitter=0.5 * spread / clean.period,
        gaps=int(np.count_nonzero(longer)),
        longest_gap=float(step[longer].max()) if longer.any() else 0.0,
        spikes=clean.spikes,
        low=float(np.min(clean.values)),
        high=float(np.max(clean.values)),
        resampling=resampling,
        drops=clean.drops,
        step=resolution(clean.values) if clean.channel in CHANNELS else None,
    )


def render_quality(report: QualityReport) -> str:
    """Return the report as text for a terminal."""
    # Rows stand for a period each, the last one too.
    share = min(report.duration / report.recorded, 1.0) if report.recorded > 0 else 1.0
    wide = max(18, *(len(c.channel) + 2 for c in report.channels), 0)
    lines = [
        f"{report.duration:.1f} s in {report.segments} segment(s), {100.0 * share:.1f} % of what was recorded; "
        f"time: {report.clock}",
        *_verdict(report.consistency),
        f"{'channel':<{wide}}{'source':<34}{'rate/Hz':>8}{'jitter':>8}{'gaps':>6}{'min':>12}{'max':>12}"
        "  unit      resampling",
    ]
    as_recorded = [c for c in report.channels if c.channel == c.source and c.channel not in _KNOWN]
    beyond = as_recorded[_MOST_ROWS:]
    for c in report.channels if not beyond else [c for c in report.channels if c not in beyond]:
        source = c.source if len(c.source) <= 33 else "..." + c.source[-30:]
        lines.append(
            f"{c.channel:<{wide}}{source:<34}{c.rate:>8.1f}{100.0 * c.jitter:>6.1f} %"
            f"{c.gaps:>6d}{c.low:>12.4g}{c.high:>12.4g}"
            f"  {_unit(c.channel):<8}  {c.resampling}"
        )
    if beyond:
        lines.append(f"and {len(beyond)} further columns, kept as recorded: {_few([c.source for c in beyond])}")
    unknown = [c.channel for c in report.channels if c.channel != c.source and c.channel not in _KNOWN]
    skipped = ", ".join(text.split(":")[0] for text in report.skipped)
    dropped: dict[str, list[str]] = {}
    for drop in dict.fromkeys(d for c in report.channels for d in c.drops):
        dropped.setdefault(f"{drop.count} {drop.reason}", []).append(drop.source)
    for title, entries in (
        ("dropped or moved", [f"{what} in {_few(sources)}" for what, sources in dropped.items()]),
        ("assumed", _assumed(report.assumed)),
        ("file and map disagree", report.contradictions),
        ("no channel of this program, kept and not used", [_few(unknown)] if unknown else []),
        ("not in this recording", [f"{skipped}, which the map calls optional"] if skipped else []),
        ("delays", [estimate.statement for estimate in report.delays]),
        ("could not be judged", _unjudged(report.consistency)),
        ("note", [*report.warnings, *([report.unverified] if report.unverified else [])]),
    ):
        if entries:
            lines.append(f"{title}:")
            lines.extend(f"  {entry}" for entry in entries)
    return "\n".join(lines)


_MUCH_STEERING = 1.25  # of the steady steer angle [1], from which on a reader asks why that fits; judgement
_WORTH_TELLING = 0.03
"""Of the logarithm of a ratio that should be 1, from which on it is shown [1]; judgement."""


def _verdict(found: Consistency) -> list[str]:
    """Return what the checks came to, faults first."""
    if found.findings:
        return ["does not fit together:", *(f"  {finding.text}" for finding in found.findings)]
    if not found.relations:
        return ["the channels could not be checked against each other"] if found.unjudged else []
    held = f"{len(found.relations)} relations hold" if len(found.relations) > 1 else "1 relation holds"
    # A scale within the tolerance is no finding, and the reader may know better what his sensors are worth.
    off = [r for r in found.relations if abs(np.log(r.slope.slope)) > _WORTH_TELLING]
    held += f" ({', '.join(f'{r.name} {r.slope.slope:.2f}' for r in off)})" if off else ""
    if any(r.leaf == "delta" and r.slope.slope > _MUCH_STEERING for r in off):
        held += ". Understeer asks for more steer angle; so does a steering that turns less than delta says"
        return [f"the channels fit together: {held}. {len(found.unjudged)} could not be judged"]
    return [f"the channels fit together: {held}, {len(found.unjudged)} could not be judged"]


def _unjudged(found: Consistency) -> list[str]:
    """Return the checks that failed to judge; those with one reason share a line."""
    reasons: dict[str, list[str]] = {}
    for one in found.unjudged:
        reasons.setdefault(one.reason, []).append(one.check)
    return [f"{'; '.join(checks)}: {reason}" for reason, checks in reasons.items()]


def _unit(channel: str) -> str:
    """Return the unit of a channel's range; empty where the column is kept as it was recorded."""
    known = CHANNELS.get(channel)
    return known.unit if known is not None else EXTRA_UNITS.get(channel, "")


def _few(names: Sequence[str]) -> str:
    """Return the first names, and how many more there are."""
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(names[:_SHOWN]) + more


def _assumed(texts: Sequence[str]) -> list[str]:
    """Put the channels whose unit nobody says into one line, and those of an earlier ingest into another."""
    lines, rest = [], list(texts)
    for tail in (UNSTATED, f"{UNSTATED}{EARLIER}"):
        units = [text.removesuffix(tail) for text in rest if text.endswith(tail)]
        rest = [text for text in rest if not text.endswith(tail)]
        lines += [", ".join(units) + tail] if units else []
    return [*rest, *lines]
