"""Lines of InfluxDB: ``imu,car=7 ax=0.1,ay=0.2 1718000000000000000``, a measurement with its fields and its time."""

import re
from collections.abc import Iterator
from pathlib import Path

from split_cli.errors import LogError
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, unit_of_time
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.readers.dialect import LONGEST_LINE
from split_cli.logs.scratch import GrowingSignal
from split_cli.signals import find_unit, split_name_and_unit

_LINE = re.compile(
    r"(?P<of>(?:[^,\s\\=]|\\.)+)(?P<tags>(?:,[^,\s=]+=[^,\s]+)*) (?P<fields>[^\s=,]+=\S.*?) (?P<time>\d{9,19})\s*"
)
_FIELD = re.compile(r"(?P<name>(?:[^,=\\]|\\.)+)=(?P<value>\"[^\"]*\"|[^,]+)(?:,|$)")
_NUMBER = re.compile(r"([+-]?\d+(?:\.\d*)?(?:[eE][+-]?\d+)?)[iu]?")
_SHARE, _FEWEST = 0.9, 3


def is_line_protocol(head: bytes) -> bool:
    """Tell the form by the first bytes of a file."""
    if b"\0" in head:
        return False
    lines = [line for line in decoded(head).splitlines()[:-1] if line.strip() and not line.startswith("#")]
    known = sum(bool(_LINE.fullmatch(line)) for line in lines)
    return known >= max(_FEWEST, _SHARE * len(lines))


def open_line_protocol(path: Path) -> RawRecording:
    """Open lines of InfluxDB: a channel ``measurement.field`` for each number, with its clock.

    Tags that differ within a measurement stand in front of it, since they tell two sensors or cars apart.

    Raises
    ------
    LogError
        If no field is a number.
    """
    found: dict[tuple[str, str, str], GrowingSignal] = {}
    others = 0
    for line in _lines(path):
        match = _LINE.fullmatch(line)
        if match is None:
            others += not line.startswith("#")
            continue
        for field in _FIELD.finditer(match["fields"]):
            number = _NUMBER.fullmatch(field["value"])
            if number is None:
                continue
            key = (match["of"], match["tags"], field["name"])
            if key not in found:
                refuse_many_columns(len(found) + 1, path.name)
                found[key] = GrowingSignal()
            found[key].append(float(match["time"]), float(number[1]))
    if not found:
        raise LogError("holds no field that is a number", where=path.name, advice="Export it again.")
    signals = {}
    for (of, tags, name), signal in found.items():
        time, values = signal.finished()
        several = len({t for o, t, _ in found if o == of}) > 1
        address = f"{_tag_values(tags)}.{of}.{name}" if several else f"{of}.{name}"
        unit = find_unit(unit_of_time(time))
        factor = unit.factor if unit is not None else 1e-9
        signals[address] = RawSignal(address, time * factor, values, split_name_and_unit(name)[1])
    notes = [ReadNote("lines of another form, left out", path.name, others)] if others else []
    return TableRecording(path.name, path, signals, notes=notes)


def _tag_values(tags: str) -> str:
    return "_".join(tag.partition("=")[2] for tag in tags.strip(",").split(","))


def _lines(path: Path) -> Iterator[str]:
    with path.open("rb") as stream:
        while raw := stream.readline(LONGEST_LINE):
            if not raw.isspace():
                yield decoded(raw).rstrip("\r\n")
