"""The structure of a MAT file of version 5, checked before SciPy reads it: its compiled reader trusts every tag.

Source: MathWorks, "MAT-File Format", sections on version 5. A type or class that does not exist makes SciPy follow
a null pointer, and the process dies without a word.
"""

import mmap
import zlib
from collections.abc import Iterator
from pathlib import Path

from split_cli.errors import LogError
from split_cli.logs.budget import Unfolded

_COMPRESSED, _MATRIX, _FLAGS, _INT32, _BYTES = 15, 14, 6, 5, (1, 2)
_TYPES = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18})
_CLASSES = range(1, 19)
_CELL, _OBJECT, _SPARSE, _RECORDS = 1, 3, 5, (2, 3)
_OPAQUE = (16, 17, 18)
"""Handles of functions and objects of MATLAB, whose parts nobody has described."""
_LONGEST_NAME = 4096
"""Of a field [bytes]; judgement: MATLAB allows 63 letters."""
_DEEPEST = 32
_MOST_ELEMENTS = 200_000
"""Of one cell array or structure [1], each an object; judgement: a log of 10,000 signals has 100,000."""
_HEADER = 128


class _Damage(Exception):
    """An element that cannot be; the text says how."""


def check_mat5(path: Path) -> None:
    """Check types, sizes and nesting of all elements of a file, and that none unfolds beyond its budget.

    Files of another version are left to their reader.

    Raises
    ------
    LogError
        Names what is wrong, and at which byte.
    """
    from scipy.io.matlab import MatReadError, matfile_version

    with path.open("rb") as stream:
        try:
            # By its bytes, as the reader after this tells it; the text before them says nothing.
            version, _ = matfile_version(stream)
        except (MatReadError, ValueError):
            return
        if version != 1:
            return
        # Closed with the last view of it: an error's own frames still hold some.
        content = memoryview(mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ))
        try:
            _check_file(content)
        except _Damage as damage:
            advice = "Save it again, without compression."
            raise LogError(f"is cut off or damaged ({damage})", where=path.name, advice=advice) from damage


def _check_file(content: memoryview) -> None:
    if len(content) < _HEADER:
        raise _Damage("its header is cut off")
    order = "little" if bytes(content[126:128]) == b"IM" else "big"
    position = _HEADER
    unfolded = Unfolded(len(content))
    while position + 8 <= len(content):
        kind = int.from_bytes(content[position : position + 4], order)
        stored = int.from_bytes(content[position + 4 : position + 8], order)
        begin = position + 8
        if begin + stored > len(content):
            raise _Damage(f"the variable at byte {position} ends after the file")
        inner = content[begin : begin + stored]
        try:
            if kind == _COMPRESSED:
                plain = _unpacked(inner, unfolded.most(position, stored))
                unfolded.add(position, len(plain))
                _check_variable(memoryview(plain), order)
            elif kind == _MATRIX:
                _check_matrix(inner, order, 0)
            else:
                raise _Damage(f"type {kind} where a variable was expected")
        except _Damage as damage:
            raise _Damage(f"variable at byte {position}: {damage}") from damage
        position = begin + stored


def _unpacked(packed: memoryview, limit: int) -> bytes:
    engine = zlib.decompressobj()
    try:
        plain = engine.decompress(packed, limit + 1)
    except zlib.error as error:
        raise _Damage(f"it cannot be decompressed: {error}") from error
    if len(plain) > limit:
        raise _Damage(f"{len(packed):,} bytes become more than {limit >> 20} MB")
    if not engine.eof:
        raise _Damage("its compressed part is cut off")
    return plain


def _elements(content: memoryview, order: str) -> Iterator[tuple[int, memoryview]]:
    """Yield type and data of elements in a row, padded to eight bytes; a small one has its data in its tag."""
    position = count = 0
    while position + 8 <= len(content):
        count += 1
        if count > _MOST_ELEMENTS:
            raise _Damage(f"an array of more than {_MOST_ELEMENTS:,} parts")
        word = int.from_bytes(content[position : position + 4], order)
        kind, size, begin = word, int.from_bytes(content[position + 4 : position + 8], order), position + 8
        if word >> 16:
            kind, size, begin = word & 0xFFFF, word >> 16, position + 4
            if size > 4:
                raise _Damage(f"a small element of {size} bytes")
        if kind not in _TYPES:
            raise _Damage(f"an element of type {kind}, which does not exist")
        if begin + size > len(content):
            raise _Damage(f"an element of {size:,} bytes where {len(content) - begin:,} are left")
        yield kind, content[begin : begin + size]
        position = position + 8 if word >> 16 else begin + (size + 7) // 8 * 8
    if position < len(content):
        raise _Damage("an element's tag is cut off")


def _check_variable(content: memoryview, order: str) -> None:
    """Check what was compressed: one array."""
    kinds = list(_elements(content, order))
    if [kind for kind, _ in kinds] != [_MATRIX]:
        raise _Damage("something else than one array was compressed")
    _check_matrix(kinds[0][1], order, 0)


def _check_matrix(content: memoryview, order: str, depth: int) -> None:
    """Check one array: its flags and class, then that it has the parts these need; an empty one has none."""
    if depth > _DEEPEST:
        raise _Damage(f"arrays inside arrays, over {_DEEPEST} deep")
    if len(content) == 0:
        return
    parts = list(_elements(content, order))
    if len(content) < 16 or parts[0][0] != _FLAGS or len(parts[0][1]) < 8:
        raise _Damage("an array without flags")
    flags = int.from_bytes(parts[0][1][:4], order)
    number = flags & 0xFF
    if number not in _CLASSES:
        raise _Damage(f"an array of class {number}, which does not exist")
    for kind, data in parts:
        if kind == _MATRIX:
            _check_matrix(data, order, depth + 1)
    if number in _OPAQUE:
        return
    kinds = [kind for kind, _ in parts[1:]]
    if len(kinds) < 2 or kinds[0] != _INT32 or kinds[1] not in _BYTES or len(parts[1][1]) % 4:
        raise _Damage("an array without dimensions and name")
    size = _product(parts[1][1], order)
    rest = parts[3:]
    if number in _RECORDS:
        rest, size = _record(rest, number, size, order)
    if number in (*_RECORDS, _CELL):
        if len(rest) != size:
            raise _Damage(f"an array of {len(rest)} elements where its dimensions need {size:,}")
        wanted = [_MATRIX] * size
    else:
        count = 1 + (flags >> 11 & 1) + (2 if number == _SPARSE else 0)
        wanted = [kind for kind, _ in rest if kind != _MATRIX][:count]
        if len(wanted) != count:
            raise _Damage(f"an array of {len(wanted)} parts where its class and flags need {count}")
    if [kind for kind, _ in rest] != wanted:
        raise _Damage(f"an array of class {number} that is made of something else")


def _record(
    rest: list[tuple[int, memoryview]], number: int, size: int, order: str
) -> tuple[list[tuple[int, memoryview]], int]:
    """Return the fields of a structure or an object after its names, and how many there must be."""
    names = rest[1:] if number == _OBJECT else rest
    if len(names) < 2 or names[0][0] != _INT32 or len(names[0][1]) != 4 or names[1][0] not in _BYTES:
        raise _Damage("a structure without names")
    length, known = int.from_bytes(names[0][1], order), len(names[1][1])
    if not 0 < length <= _LONGEST_NAME or known % length:
        raise _Damage(f"names of {length} bytes in {known}")
    return names[2:], size * (known // length)


def _product(dimensions: memoryview, order: str) -> int:
    """Return how many elements an array has."""
    size = 1
    for at in range(0, len(dimensions), 4):
        size *= int.from_bytes(dimensions[at : at + 4], order, signed=True)
        if not 0 <= size < 1 << 40:
            raise _Damage("dimensions that no array has")
    return size
