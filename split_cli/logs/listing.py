"""The channels of a recording as a listing shows them: each array once, with how many elements it has."""

import itertools
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from split_cli.logs.raw import RawChannelInfo, RawRecording

_INDEX = re.compile(r"\[(\d+)\]")


@dataclass(frozen=True)
class ListedChannel:
    """One line of a listing."""

    name: str  # with the range of indices where it stands for several, ``/wheels/speed[0..3]``
    info: RawChannelInfo  # of the first that it stands for
    example: str = ""  # the last that a map may name; empty for one that is no array


def listed_channels(recording: RawRecording) -> list[ListedChannel]:
    """Return the lines of a listing, in the order of the channels.

    How many elements an array has is what the file defines, or what the first message of its topic has.
    """
    counts = getattr(recording, "element_counts", dict)
    lengths = counts()
    found: dict[tuple, list[RawChannelInfo]] = {}
    for info in recording.channels():
        found.setdefault((_INDEX.sub("[]", info.name), info.type_name, info.count, info.unit), []).append(info)
    return [line for group in found.values() for line in _lines(group, lengths)]


def with_all_elements(recording: RawRecording, names: Iterable[str]) -> list[str]:
    """Return names of channels; one that stands for an array whose length a message tells has the range of it."""
    counts = getattr(recording, "element_counts", dict)
    lengths = counts()

    def whole(name: str) -> str:
        pieces = name.split("[0]")
        shown = pieces[0]
        for end in range(1, len(pieces)):
            many = lengths.get("[0]".join(pieces[:end]), 1)
            shown += (f"[0..{many - 1}]" if many > 1 else "[0]") + pieces[end]
        return shown

    listed = set(names := list(names))
    # Of an array of a fixed length each element is listed by itself.
    return [name if name.replace("[0]", "[1]") in listed - {name} else whole(name) for name in names]


def _lines(group: Sequence[RawChannelInfo], lengths: dict[str, int]) -> list[ListedChannel]:
    """Return one line for channels that differ in their indices alone; a line each where these leave gaps."""
    indices = [tuple(map(int, _INDEX.findall(info.name))) for info in group]
    last = [max(places) for places in zip(*indices, strict=True)]
    if set(indices) != set(itertools.product(*(range(end + 1) for end in last))):
        return [ListedChannel(info.name, info) for info in group]
    pieces = _INDEX.split(group[0].name)[::2]
    shown = first = example = pieces[0]
    for end, piece in zip(last, pieces[1:], strict=True):
        many = lengths.get(first, end + 1)
        shown += ("[0]" if many == 1 else f"[0..{many - 1}]" if many else "[..]") + piece
        example += f"[{max(many - 1, 0)}]{piece}"
        first += f"[0]{piece}"
    return [ListedChannel(shown, group[0], example if shown != first else "")]
