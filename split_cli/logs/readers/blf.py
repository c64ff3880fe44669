"""The blocks of a BLF file, looked at before python-can unfolds them, whatever they become."""

import struct
import zlib
from pathlib import Path

from split_cli.logs.budget import refuse_unpacked_size

_OBJECT = struct.Struct("<4sHHLL")
_CONTAINER, _CONTAINER_HEAD, _DEFLATED = 10, 16, b"\x02\0"
_PIECE = 1 << 20


def is_cut_blf(path: Path) -> bool:
    """Tell whether a BLF file ends inside one of its blocks, which python-can passes over.

    Raises
    ------
    LogError
        If a block unfolds into more than any recording does.
    """
    with path.open("rb") as stream:
        head = stream.read(8)
        if not head.startswith(b"LOGG") or len(head) < 8:
            return False
        stream.seek(int.from_bytes(head[4:], "little"))
        while True:
            head = stream.read(_OBJECT.size)
            if len(head) < _OBJECT.size:
                return bool(head)
            signature, _, _, size, kind = _OBJECT.unpack(head)
            if signature != b"LOBJ":
                return False  # python-can tells of it
            content = stream.read(max(size - _OBJECT.size, 0))
            if len(content) + _OBJECT.size < size:
                return True
            stream.read(size % 4)
            if kind == _CONTAINER and content[:2] == _DEFLATED:
                _refuse_bomb(content[_CONTAINER_HEAD:], path)


def _refuse_bomb(packed: bytes, path: Path) -> None:
    """Unpack piece by piece and keep nothing: what stands in the header of a block need not be true."""
    unpacking, size, rest = zlib.decompressobj(), 0, packed
    while rest and not unpacking.eof:
        try:
            size += len(unpacking.decompress(rest, _PIECE))
        except zlib.error:
            return  # python-can tells of it
        refuse_unpacked_size(size, len(packed), "a block", path.name)
        rest = unpacking.unconsumed_tail
