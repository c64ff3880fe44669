"""The structure of a MAT file of version 5, checked before SciPy reads it: its compiled reader trusts every tag.

Source: MathWorks, "MAT-File Format", sections on version 5. A type or class that does not exist makes SciPy follow
a null pointer, and the process dies without a word.
"""

from __future__ import annotations

import mmap
import zlib
from pathlib import Path

from split_cli.errors import LogError
from split_cli.logs.readers.budget import most_bytes_out

__all__ = ["check_mat5"]

_COMPRESSED, _MATRIX, _FLAGS = 15, 14, 6
_TYPES = frozenset({1, 2, 3, 4, 5, 6, 7, 9, 12, 13, 14, 16, 17, 18})
_CLASSES = range(1, 19)
_DEEPEST = 32
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
    with path.open("rb") as stream:
        if not stream.read(10).startswith(b"MATLAB 5.0"):
            return
        with mmap.mmap(stream.fileno(), 0, access=mmap.ACCESS_READ) as file:
            content = memoryview(file)
            try:
                _check_file(content)
            except _Damage as damage:
                raise LogError(
                    f"is cut off or damaged ({damage})",
                    where=path.name,
                    advice="Save it again, without compression.",
                ) from damage
            finally:
                content.release()


def _check_file(content: memoryview) -> None:
    if len(content) < _HEADER:
        raise _Damage("its header is cut off")
    order = "little" if bytes(content[126:128]) == b"IM" else "big"
    position = _HEADER
    while position + 8 <= len(content):
        kind = int.from_bytes(content[position : position + 4], order)
        stored = int.from_bytes(content[position + 4 : position + 8], order)
        begin = position + 8
        if begin + stored > len(content):
            raise _Damage(f"the variable at byte {position} ends after the file")
        inner = content[begin : begin + stored]
        try:
            if kind == _COMPRESSED:
                _check_elements(memoryview(_unpacked(inner)), order, 0)
            elif kind == _MATRIX:
                _check_matrix(inner, order, 0)
            else:
                raise _Damage(f"type {kind} where a variable was expected")
        except _Damage as damage:
            raise _Damage(f"variable at byte {position}: {damage}") from damage
        finally:
            inner.release()
        position = begin + stored


def _unpacked(packed: memoryview) -> bytes:
    limit = most_bytes_out(len(packed))
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


def _check_elements(content: memoryview, order: str, depth: int) -> None:
    """Check a row of elements, each padded to eight bytes; a small one holds its data in its tag."""
    position = 0
    while position + 8 <= len(content):
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
        if kind == _MATRIX:
            _check_matrix(content[begin : begin + size], order, depth + 1)
        position = position + 8 if word >> 16 else begin + (size + 7) // 8 * 8
    if position < len(content):
        raise _Damage("an element's tag is cut off")


def _check_matrix(content: memoryview, order: str, depth: int) -> None:
    """Check one array: its flags with its class, then the elements it is made of. An empty one has none."""
    if depth > _DEEPEST:
        raise _Damage(f"arrays inside arrays, over {_DEEPEST} deep")
    if len(content) == 0:
        return
    if len(content) < 16 or int.from_bytes(content[:4], order) != _FLAGS:
        raise _Damage("an array without flags")
    number = int.from_bytes(content[8:12], order) & 0xFF
    if number not in _CLASSES:
        raise _Damage(f"an array of class {number}, which does not exist")
    _check_elements(content, order, depth)
