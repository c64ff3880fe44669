"""What each channel of a drive is: measured, a command or derived; held or continuous; and too coarse to be learned."""

from collections.abc import Mapping, Sequence

import numpy as np

from split_cli.logs.assembling.derivation import Derived
from split_cli.logs.assembling.gather import Gathered
from split_cli.logs.assembling.noise import HELD
from split_cli.logs.assembling.quality import ChannelQuality
from split_cli.logs.assembling.synchronize import Channels
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate
from split_cli.logs.drive_metadata import is_derived
from split_cli.signals import CHANNELS

_NOISELESS = 3e-6
"""Deviation of the noise over the range of a channel [1], below which it has none: rounding to a thousandth leaves
1e-6, the most filtered sensor among our recordings 1e-5."""
_LABEL = 0.05
"""Over which a label is taken unless another time is given [s]."""
_SHARE_OF_MOTION = 0.5
"""Of the rms rate of change that rounding may add to a label [1]; judgement: beyond, a label is mostly rounding."""
_SHARE_OF_STEERING = 0.25
"""Of an input's standard deviation that its steps may have [1]; judgement: a slip angle is known no better."""
_SMOOTHED = 0.2
"""Over which a rate of change is taken to be motion [s], as in the checks."""
_BODY = {"vx": ("v_x", "m/s"), "vy": ("v_y", "m/s"), "r": ("r", "rad/s")}
_INPUTS = {"T": "N m", "delta": "rad"}


def kinds_of(
    gathered: Gathered,
    made: Sequence[tuple[str, Derived]],
    columns: Mapping[str, np.ndarray],
    before: DriveMetadata | None,
    noise: Mapping[str, NoiseEstimate],
) -> tuple[dict[str, str], list[str]]:
    """Return what each channel is; of a drive that is ingested again what it was, unless the map says more."""
    kinds: dict[str, str] = {}
    known = before.kinds if before is not None else {}
    warnings: list[str] = []
    for channel in columns:
        if channel in CHANNELS:
            entry = gathered.maps.get(channel)
            same = entry is not None and [s.names for s in entry.sources] == [(channel,)]
            old = known.get(channel) if same else None
            kinds[channel] = (entry.kind if entry else None) or old or "measured"
            if channel in _INPUTS and entry is not None and entry.kind is None and old is None:
                unstated = "the map says neither command nor measured"
                warnings.append(
                    f"{channel} was taken as measured ({unstated}){_like_a_command(channel, columns, noise)}"
                )
    for _, derived in made:
        for channel in derived.columns:
            kinds[channel] = f"derived: {derived.how}" if channel in CHANNELS else "derived"
        if derived.warning:
            warnings.append(derived.warning)
    return kinds, warnings


def _like_a_command(channel: str, columns: Mapping[str, np.ndarray], noise: Mapping[str, NoiseEstimate]) -> str:
    """Say that an input looks like a command, where it does and the motion of the car has the noise of sensors."""
    if not any(channel in noise and _has_noise(channel, columns, noise[channel]) for channel in _BODY):
        return ""
    estimate = noise.get(channel)
    if estimate is None or _has_noise(channel, columns, estimate) or estimate.reason not in ("", HELD):
        return ""
    how = "keeps its value between updates" if estimate.reason else "has no noise"
    return f"; it {how}, as a command does: if it is one, write `kind: command`"


def _has_noise(channel: str, columns: Mapping[str, np.ndarray], estimate: NoiseEstimate) -> bool:
    return estimate.sigma is not None and estimate.sigma > _NOISELESS * float(np.ptp(columns[channel]))


def between_of(
    channels: Channels, made: Sequence[tuple[str, Derived]], columns: Mapping[str, np.ndarray]
) -> dict[str, str]:
    """Return what each known channel does between samples: held as it was brought to the clock, or continuous.

    A sum is held where all its sources are; what was derived is continuous.
    """
    derived = {channel for _, one in made for channel in one.columns}
    return {
        name: "held" if name not in derived and set(channels.modes.get(name, ())) == {"held"} else "continuous"
        for name in columns
        if name in CHANNELS and name != "t"
    }


def unlike_a_sensor(
    drive: Drive, kinds: Mapping[str, str], noise: Mapping[str, NoiseEstimate], qualities: Sequence[ChannelQuality]
) -> list[str]:
    """Say which channels mislead what is learned of them: motion without any noise, and steps that are too coarse.

    A command is what was asked for, with the steps that it has.
    """
    said = []
    moved = [channel for channel in _BODY if not is_derived(kinds[channel]) and np.ptp(drive[channel]) > 0.0]
    known = [c for c in moved if noise[c].sigma is not None and not _has_noise(c, drive.columns, noise[c])]
    if known and known == moved:
        *most, last = (_BODY[channel][0] for channel in known)
        names = f"{', '.join(most)} and {last}" if most else last
        said.append(
            f"without any sensor noise: {names}, as a simulator writes them. `split diagnose` then takes the smallest "
            "model-form error for an effect (docs/diagnosis.md, Recordings without noise)"
        )
    steps = {q.channel: q.step for q in qualities if q.step is not None and kinds.get(q.channel) == "measured"}
    moving = np.abs(drive["vx"]) > 0.2 * float(np.quantile(np.abs(drive["vx"]), 0.95))
    for channel, step in steps.items():
        if channel in _BODY:
            name, unit = _BODY[channel]
            # Two values, each rounded: the deviation of their difference.
            on_label, motion = step / np.sqrt(6.0) / _LABEL, _rms_rate(drive, channel)
            if on_label > _SHARE_OF_MOTION * motion:
                said.append(
                    f"{name} is recorded in steps of {step:.3g} {unit}: this adds {on_label:.2g} {unit}^2 to a label "
                    f"over {_LABEL:g} s, while the motion has {motion:.2g}. Map a finer signal, or learn with a "
                    "longer --horizon"
                )
        elif channel in _INPUTS and moving.any() and step > _SHARE_OF_STEERING * float(np.std(drive[channel][moving])):
            share = step / float(np.std(drive[channel][moving]))
            said.append(
                f"{channel} is recorded in steps of {step:.3g} {_INPUTS[channel]}, {100.0 * share:.0f} % of its "
                "standard deviation: what is learned of it is as coarse. Map a finer signal if there is one"
            )
    return said


def _rms_rate(drive: Drive, channel: str) -> float:
    """Return the rms rate of change over `_SMOOTHED` of a channel, in its unit per second."""
    rows = max(round(_SMOOTHED / drive.period), 1)
    changes = [drive[channel][run][rows:] - drive[channel][run][:-rows] for run in drive.segments()]
    return float(np.sqrt(np.mean(np.concatenate(changes) ** 2))) / (rows * drive.period)
