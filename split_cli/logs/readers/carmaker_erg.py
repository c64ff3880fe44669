"""Results of CarMaker (.erg): records of all quantities, which a text beside them (.erg.info) lists."""

import re
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.files import open_to_read
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote, UniqueNames
from split_cli.logs.readers.code_pages import decoded
from split_cli.logs.scratch import set_aside
from split_cli.signals import symbol_of

ERG_MAGIC = b"CM-ERG\0\0"
INFO_SUFFIX = ".info"
_HEAD = struct.Struct("<8sBBHI")
"""Mark, version, whether the byte order is big-endian, size of a record [bytes], nothing."""
_LARGEST_INFO = 64 << 20
"""Of the text beside the records [bytes]; judgement: pictures of the animation stand in it, too."""
_TYPES = {
    **{"Float": "f4", "Double": "f8", "LongLong": "i8", "ULongLong": "u8", "Long": "i4", "ULong": "u4"},
    **{"Int": "i4", "UInt": "u4", "Short": "i2", "UShort": "u2", "Char": "i1", "UChar": "u1"},
}
_FILLING = re.compile(r"(\d{1,4}) Bytes")
"""The type of bytes that hold nothing."""


def open_erg(path: Path) -> RawRecording:
    """Open a result of CarMaker: every quantity with its unit, over the quantity ``Time``.

    Raises
    ------
    LogError
        If the list of quantities is missing or of other records, or there are none.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD.size)
    if len(head) < _HEAD.size:
        raise LogError("is cut off within its head", where=path.name, advice="Copy it again.")
    _, _, big, size, _ = _HEAD.unpack(head)
    fields, properties = _listed(path)
    order = ">" if big else "<"
    formats, offsets, names, place = [], [], [], 0
    unique = UniqueNames()
    for name, kind in fields:
        filling = _FILLING.fullmatch(kind)
        if kind not in _TYPES and filling is None:
            what = f"quantity {name!r} is of an unknown type, {kind!r}"
            raise LogError(what, where=path.name + INFO_SUFFIX, advice="Export the result as CSV or MAT.")
        if filling is None:
            names.append(unique.of(name))
            formats.append(order + _TYPES[kind])
            offsets.append(place)
        place += int(filling[1]) if filling else np.dtype(_TYPES[kind]).itemsize
    if place != size or not names:
        what = f"lists records of {place} bytes, but {path.name} has records of {size}"
        raise LogError(what, where=path.name + INFO_SUFFIX, advice="Put both files of one result side by side.")
    rows, rest = divmod(path.stat().st_size - _HEAD.size, size)
    if rows < 1:
        raise LogError("holds no records", where=path.name, advice="Simulate it again.")
    notes = [ReadNote("bytes of a record that is cut off at the end", path.name, rest)] if rest else []
    table = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    records = np.memmap(path, table, "r", _HEAD.size, (rows,))
    units = {name: symbol_of(properties.get((name, "Unit"), "")) for name in names}

    def load(wanted: Sequence[str]) -> dict[str, RawSignal]:
        made = {}
        for name in wanted:
            factor, offset = (_number(properties.get((name, key)), usual) for key, usual in _SCALING)
            with np.errstate(invalid="ignore"):
                values = records[name].astype(np.float64)
            values = values if (factor, offset) == (1.0, 0.0) else values * factor + offset
            made[name] = RawSignal(name, None, set_aside(values), units[name])
        return made

    infos = [RawChannelInfo(name, "column", rows, units[name]) for name in names]
    return LazyTableRecording(path.name, path, infos, load, notes=notes)


_SCALING = (("Factor", 1.0), ("Offset", 0.0))


def _listed(path: Path) -> tuple[list[tuple[str, str]], dict[tuple[str, str], str]]:
    """Return name and type of each quantity in the order of a record, and what else is said of them."""
    beside = path.with_name(path.name + INFO_SUFFIX)
    if not beside.is_file():
        what = f"lacks its list of quantities, {beside.name}"
        raise LogError(what, where=path.name, advice="Copy it from the same folder, or export the result as CSV.")
    with open_to_read(beside, LogError) as stream:
        content = stream.read(_LARGEST_INFO + 1)
    if len(content) > _LARGEST_INFO:
        what = f"is larger than {_LARGEST_INFO >> 20} MB"
        raise LogError(what, where=beside.name, advice="Export the result as CSV or MAT.")
    numbered: dict[int, dict[str, str]] = {}
    properties: dict[tuple[str, str], str] = {}
    for line in content.splitlines():
        if not line.lstrip(_AROUND).startswith((b"File.At.", b"Quantity.")):
            continue
        key, _, value = (text.strip(_AROUND.decode()) for text in decoded(line[:_LONGEST_LINE]).partition("="))
        of, _, what = key.rpartition(".")
        if of.startswith("Quantity.") and what in ("Unit", "Factor", "Offset"):
            properties[of.removeprefix("Quantity."), what] = value
        elif (number := of.removeprefix("File.At.")).isascii() and number.isdigit() and len(number) < _DIGITS:
            numbered.setdefault(int(number), {})[what] = value
        refuse_many_columns(max(len(numbered), len(properties) // _SAID_OF_ONE), beside.name)
    return [(f.get("Name", ""), f.get("Type", "")) for _, f in sorted(numbered.items())], properties


_LONGEST_LINE = 2000  # that is looked at [bytes]; judgement
_AROUND = b' \t"'
_DIGITS = 9
_SAID_OF_ONE = 3  # unit, factor and offset


def _number(text: str | None, usual: float) -> float:
    try:
        number = float(text) if text else usual
    except ValueError:
        return usual
    return number if np.isfinite(number) else usual
