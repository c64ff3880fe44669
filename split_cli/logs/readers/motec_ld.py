"""MoTeC logs (.ld): a head, a chain of descriptions of channels, and the samples of each at a rate of its own."""

import struct
from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote, UniqueNames
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.scratch import mapped_file, set_aside
from split_cli.signals import find_unit, symbol_of

_MARK = b"\x40\0\0\0\0\0\0\0"
_CHAIN, _PROMISED = 0x08, 0x56
"""Where the head says at which byte the first channel is described, and how many channels there are [bytes]."""
_HEAD = 0x5A
_CHANNEL = struct.Struct("<4I4H4h32s8s12s")
"""Place of the description before and behind, place and count of the samples; a number, kind and size of a sample,
rate [Hz]; shift, multiplier, scale, decimals; name, short name, unit. Some 30 to 40 bytes follow that say no more."""
_NAMES = 0x20  # where the name of a channel begins in its description
_SHORT = slice(_NAMES + 32, _NAMES + 44)
"""Where the unit stands in files without short names: 32 bytes of a name, then 12 of the unit."""
_TYPES = {
    **{(kind, size): f"<i{size}" for kind in (0, 3, 5) for size in (2, 4)},
    **{(7, size): f"<f{size}" for size in (2, 4, 8)},
    (8, 8): "<f8",
}
_MOST_DECIMALS = 20
"""Either way [1]; judgement: four are usual."""


@dataclass(frozen=True)
class _LdChannel:
    """Where the samples of a channel lie, and what makes quantities of them."""

    name: str
    unit: str
    place: int
    count: int
    dtype: np.dtype
    rate: int  # [Hz]
    shift: int
    multiplier: int
    scale: int
    decimals: int

    @property
    def end(self) -> int:
        """First byte behind its samples."""
        return self.place + self.count * self.dtype.itemsize

    def quantities(self, content: memoryview) -> np.ndarray:
        """Return the samples in their unit, shape (N,): (raw/scale 10^-decimals + shift) multiplier."""
        with np.errstate(invalid="ignore"):  # a float that signals that it is none
            raw = np.frombuffer(content, self.dtype, self.count, self.place).astype(np.float64)
        return (raw * (10.0**-self.decimals / self.scale) + self.shift) * self.multiplier


def is_motec_ld(path: Path, head: bytes) -> bool:
    """Whether a file is a log of MoTeC: its mark, and a place within it where the channels are described."""
    if len(head) < _HEAD or not head.startswith(_MARK):
        return False
    (first,) = struct.unpack_from("<I", head, _CHAIN)
    return path.suffix.lower() == ".ld" or _HEAD <= first <= path.stat().st_size - _CHANNEL.size


def open_motec_ld(path: Path) -> RawRecording:
    """Open a log of MoTeC. Each channel has its own clock, from the start of the log, which they all share.

    The layout is known by what others found out about it. A channel whose samples are of an unknown kind is left out
    and counted, as are samples beyond the end of the file or within those of the next channel.

    Raises
    ------
    LogError
        If no channel with samples can be found.
    """
    with path.open("rb") as stream:
        content = memoryview(mapped_file(stream))
    notes: list[ReadNote] = []
    channels = _with_samples(_described(content, notes, path.name), len(content), notes, path.name)
    if not channels:
        raise LogError("holds no channel with samples", where=path.name, advice="Copy it from the logger again.")
    known = {channel.name: channel for channel in channels}

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        clocks: dict[tuple[int, int], np.ndarray] = {}
        made = {}
        for name in names:
            channel = known[name]
            key = channel.rate, channel.count
            if key not in clocks:
                clocks[key] = set_aside(np.arange(channel.count) / channel.rate)
            made[name] = RawSignal(name, clocks[key], set_aside(channel.quantities(content)), channel.unit or None)
        return made

    infos = [RawChannelInfo(c.name, "column", c.count, symbol_of(c.unit)) for c in channels]
    return LazyTableRecording(path.name, path, infos, load, notes=notes, own_clocks=True)


def _described(content: memoryview, notes: list[ReadNote], where: str) -> list[_LdChannel]:
    """Follow the chain of descriptions; where it is broken, what was found up to there counts."""
    (place,), (promised,) = struct.unpack_from("<I", content, _CHAIN), struct.unpack_from("<I", content, _PROMISED)
    descriptions: dict[int, bytes] = {}
    while place and place not in descriptions and place <= len(content) - _CHANNEL.size:
        descriptions[place] = bytes(content[place : place + _CHANNEL.size])
        refuse_many_columns(len(descriptions), where)
        (place,) = struct.unpack_from("<I", content, place + 4)
    if place:
        missing = max(promised - len(descriptions), 1) if promised <= 0xFFFF else 1
        notes.append(ReadNote("the chain of channels is broken: those behind are missing", where, missing))
    lost: Counter[str] = Counter()
    channels = []
    unit_of = _unit_in_place_of_short_name if _lacks_short_names(descriptions.values()) else _unit
    unique = UniqueNames()
    for described in descriptions.values():
        _, _, first, count, _, kind, size, rate, shift, multiplier, scale, decimals, *texts = _CHANNEL.unpack(described)
        name = _text(texts[0])
        dtype = _TYPES.get((kind, size))
        if count == 0:
            lost["channels without samples, left out"] += 1
        elif dtype is None:
            lost["channels with samples of an unknown kind, left out"] += 1
        elif rate == 0 or scale == 0 or multiplier == 0 or abs(decimals) > _MOST_DECIMALS or not name:
            lost["channels without a name, a rate or a scale, left out"] += 1
        else:
            scaling = (shift, multiplier, scale, decimals)
            channels.append(
                _LdChannel(unique.of(name), unit_of(described), first, count, np.dtype(dtype), rate, *scaling)
            )
    notes += [ReadNote(what, where, number) for what, number in lost.items()]
    if unique.renamed:
        notes.append(ReadNote("names of channels that occur again, numbered", where, unique.renamed))
    return channels


def _with_samples(channels: Sequence[_LdChannel], size: int, notes: list[ReadNote], where: str) -> list[_LdChannel]:
    """Return the channels, each with the samples that lie in the file and before those of the next one.

    So none takes the samples of another, and all together are no more than the file.
    """
    ordered = sorted(channels, key=lambda channel: channel.place)
    bounds = [*(channel.place for channel in ordered), size][1:]
    whole: dict[str, _LdChannel] = {}
    missing = shared = 0
    for channel, bound in zip(ordered, bounds, strict=True):
        kept = max(min(bound, size) - channel.place, 0) // channel.dtype.itemsize
        if kept < channel.count:
            beyond = max(channel.end - max(size, channel.place), 0) // channel.dtype.itemsize
            missing += beyond
            shared += channel.count - kept - beyond
        if kept:
            whole[channel.name] = replace(channel, count=min(kept, channel.count))
    if missing:
        notes.append(ReadNote("samples missing at the end of the file", where, missing))
    if shared:
        notes.append(ReadNote("samples that lie within those of another channel, left out", where, shared))
    return [whole[channel.name] for channel in channels if channel.name in whole]


def _lacks_short_names(descriptions: Collection[bytes]) -> bool:
    """Whether units stand where other files have the short names: more of the texts there are units."""
    here = sum(find_unit(_unit_in_place_of_short_name(d)) is not None for d in descriptions)
    return here > sum(find_unit(_unit(d)) is not None for d in descriptions)


def _unit(described: bytes) -> str:
    return _text(_CHANNEL.unpack(described)[-1])


def _unit_in_place_of_short_name(described: bytes) -> str:
    return _text(described[_SHORT])


def _text(field: bytes) -> str:
    return decoded(field.split(b"\0", 1)[0]).strip()
