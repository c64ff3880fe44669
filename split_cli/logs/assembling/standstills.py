"""Sources that keep one value while the car drives: a sensor that failed, or a bus that repeats its last message."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.logs.assembling.clean import CleanSeries
from split_cli.logs.assembling.noise import estimate_noise
from split_cli.logs.assembling.synchronize import Channels
from split_cli.logs.checking.jumps import source_failed
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.logs.drive import Drive
from split_cli.logs.scratch import let_go
from split_cli.signals import CHANNELS

_REPEATED = 0.05
"""Share of samples that repeat the one before, below which a source changes with every sample [1]: its noise is far
above its resolution, or it is simulated. Judgement."""
_FEWEST, _SECONDS = 4, 0.2
"""Repeats in a row that make a standstill [1], which chance makes in six of a million at `_REPEATED`; and how long
they last [s], below which what is interpolated is hardly wrong: judgement."""
_FEW_STEPS = 2.5
"""Of its resolution, in which a channel that goes straight comes to a value and leaves it [1]; judgement."""
_OF_THE_BODY = ("vy", "r", "ay")
"""Never constant while the car turns. Others may be, without noise: a speed that is held, a steady steer angle."""
_INPUTS = ("T", "delta")


@dataclass(frozen=True)
class Standstill:
    """A stretch over which a source kept its value."""

    channel: str
    source: str
    start: float  # on the recording's clock [s]
    end: float  # [s]
    value: float  # SI


def standstills_of(channels: Channels) -> list[Standstill]:
    """Return where sources that are interpolated keep one value that cannot be measured."""
    found: list[Standstill] = []
    for channel, parts in channels.clean.items():
        for part, mode in zip(parts, channels.modes[channel], strict=True):
            if mode != "held":
                found += standstills(part)
                let_go()  # of a long recording each column counts
    return found


def standstills(part: CleanSeries) -> list[Standstill]:
    """Return where a source keeps one value that cannot be measured.

    A source with noise never does. One of the car's body without any may go straight, where it is 0, or within its
    resolution: then it comes and goes in its smallest steps. An input at the end of its range is at its limit.
    """
    if part.channel not in CHANNELS:
        return []
    steps = np.abs(np.diff(part.values))
    edges = np.flatnonzero(np.diff(steps == 0.0, prepend=False, append=False)).reshape(-1, 2)
    runs = [(a, b) for a, b in edges if b - a >= _FEWEST and part.time[b] - part.time[a] >= _SECONDS]
    others = np.ones(len(steps), dtype=bool)
    for a, b in runs:
        others[a:b] = False
    if not runs or not others.any() or np.mean(steps[others] == 0.0) > _REPEATED:
        return []
    begins, ends = [0, *(b for _, b in runs)], [*(a for a, _ in runs), len(steps)]
    pieces = [part.values[a : b + 1] for a, b in zip(begins, ends, strict=True)]
    at = np.cumsum([0, *map(len, pieces)]).tolist()
    noise = estimate_noise(part.channel, np.concatenate(pieces), list(zip(at, at[1:], strict=False))).sigma
    if not noise and part.channel not in _OF_THE_BODY:
        return []
    # What a channel comes and goes in where it turns round by itself: few steps of its resolution, and without noise
    # its smallest changes; no repeat, by the share of these.
    gentle = _FEW_STEPS * float(steps[steps > 0.0].min())
    gentle = gentle if noise else max(gentle, float(np.quantile(steps[others], 2.0 * _REPEATED)))
    limits = (part.values.min(), part.values.max()) if part.channel in _INPUTS else ()
    return [
        Standstill(part.channel, part.source, float(part.time[a]), float(part.time[b]), float(part.values[a]))
        for a, b in runs
        if part.values[a] != 0.0
        and part.values[a] not in limits
        and (max(steps[a - 1], steps[b]) > gentle if a > 0 and b < len(steps) else noise)
    ]


def stopped(found: Sequence[Standstill], drive: Drive, origin: float) -> list[ConsistencyFinding]:
    """Report the standstills of each channel during which the car drives.

    Parameters
    ----------
    found : sequence of Standstill
    drive : Drive
    origin : float
        Time of the recording's clock at which `drive` begins [s].
    """
    t, speed = drive["t"], np.abs(drive["vx"])
    fast = 0.2 * float(np.quantile(speed, 0.95))
    places_of: dict[tuple[str, str], list[str]] = {}
    for one in found:
        start, end = one.start - origin, one.end - origin
        inside = (t >= start) & (t <= end)
        if inside.any() and np.median(speed[inside]) > fast:
            shown = f"{one.value:.3g} from t = {start:.1f} to {end:.1f} s"
            places_of.setdefault((one.channel, one.source), []).append(shown)
    return [
        source_failed(
            "stopped",
            channel,
            f"{channel} stands still",
            f"{source} keeps one value while the car drives",
            places,
            "Its sensor or bus",
        )
        for (channel, source), places in places_of.items()
    ]
