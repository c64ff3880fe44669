"""Compressed files and zip archives: unpacked into a temporary folder, within bounds, and read from there."""

import bz2
import gzip
import lzma
import struct
import zipfile
import zlib
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, Protocol

import zstandard

from split_cli.errors import LogError, SplitError, reason_of
from split_cli.files import ScratchFolder
from split_cli.logs.budget import MOST_OF_A_FILE, most_bytes_of_file
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.scratch import full_disk_as_error

PACKED_SUFFIXES = (".gz", ".bz2", ".xz", ".zst", ".zstd")
"""What a compressed file's name ends in, behind the ending of what it holds."""
ZIP_MAGIC = b"PK\x03\x04"
_AT_ONCE = 1 << 20
"""Compressed bytes that are read, and bytes that are unpacked, at once [bytes]."""
_OF_ZSTD_AT_ONCE = 1 << 10
"""Compressed bytes that are handed over at once [bytes]; theory: 4 of them may stand for 128 kB, so for 32 MB."""
_MEMORY_OF_XZ = 256 << 20
"""What its decoder may take for itself [bytes]; theory: 65 MB at the strongest usual setting; a header may
ask for 4 GB."""
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2)
"""Of zip archives, whose decoders take little memory whatever the archive says."""
_ENCRYPTED = 0x1
_MOST_MEMBERS = 2000
"""Of an archive, that are unpacked [1]; judgement: a data set has as many files."""
_LARGEST_LIST = 4 << 20
"""Of the files in an archive, as it stores it [bytes]; judgement: 60,000 names, which take a second to read."""
_END_OF_LIST, _LONGEST_REMARK = b"PK\x05\x06", 1 << 16
_MOST_LISTED = 5
_DAMAGE = (zlib.error, lzma.LZMAError, zstandard.ZstdError, zipfile.BadZipFile, EOFError, OSError, ValueError)


class _Decompressor(Protocol):
    """What decoders of bzip2 and xz have in common."""

    eof: bool
    needs_input: bool
    unused_data: bytes

    def decompress(self, data: bytes, max_length: int = -1) -> bytes: ...


def is_packed(head: bytes) -> bool:
    """Tell a compressed file by its first bytes."""
    return _opener(head) is not None


def plain_name(name: str) -> str:
    """Return a file's name without the ending that says how it is compressed: ``lap.csv`` of ``lap.csv.gz``."""
    ending = next((ending for ending in PACKED_SUFFIXES if name.lower().endswith(ending)), "")
    return name[: len(name) - len(ending)] or name


def unpacked_file(path: Path, folder: Path) -> Path:
    """Return the content of a compressed file, written to a folder.

    Raises
    ------
    LogError
        If it is damaged, or unpacks beyond `most_bytes_of_file`.
    """
    with path.open("rb") as packed:
        open_parts = _opener(packed.read(8))
        packed.seek(0)
        if open_parts is None:
            raise LogError("is not compressed in a known way", where=path.name, advice="Unpack it first.")
        target = folder / plain_name(path.name)
        _write(open_parts(packed), target, most_bytes_of_file(path.stat().st_size), path.name)
    return target


def unzipped(path: Path, folder: Path, is_wanted: Callable[[str], bool]) -> list[Path]:
    """Return the files of a zip archive that are wanted by their names, written to a folder; all if it holds one.

    Raises
    ------
    LogError
        If it is damaged or encrypted, or unpacks beyond `most_bytes_of_file`.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            members = [member for member in archive.infolist() if _is_shown(member)]
            wanted = members if len(members) == 1 else [m for m in members if is_wanted(m.filename)]
            if len(wanted) > _MOST_MEMBERS:
                advice = "Unpack it, and name the folder."
                raise LogError(f"holds more than {_MOST_MEMBERS:,} files", where=path.name, advice=advice)
            left = most_bytes_of_file(path.stat().st_size)
            files: dict[Path, None] = {}
            for member in wanted:
                if member.flag_bits & _ENCRYPTED:
                    advice = "Unpack it with its password."
                    raise LogError("is encrypted", where=f"{path.name}/{member.filename}", advice=advice)
                if member.compress_type not in _METHODS:
                    advice = "Unpack it, and name the file."
                    what = "is compressed in a way that is not read"
                    raise LogError(what, where=f"{path.name}/{member.filename}", advice=advice)
                target = folder / PurePosixPath(member.filename)
                target.parent.mkdir(parents=True, exist_ok=True)
                with archive.open(member) as stream:
                    left -= _write(_parts(stream), target, left, path.name)
                files[target] = None
            return list(files)
    except SplitError:
        raise
    except (*_DAMAGE, NotImplementedError, RuntimeError) as error:
        raise _cannot_be_unpacked(error, path.name) from error


def refuse_long_list(path: Path) -> None:
    """Refuse a zip archive that lists more files than any recording has, before the list is read.

    Raises
    ------
    LogError
        If it does.
    """
    with path.open("rb") as stream:
        stream.seek(max(path.stat().st_size - _LONGEST_REMARK - 22, 0))
        end = stream.read()
    place = end.rfind(_END_OF_LIST)
    if 0 <= place <= len(end) - 22 and struct.unpack_from("<I", end, place + 12)[0] > _LARGEST_LIST:
        advice = "Unpack it, and name the recording."
        raise LogError("lists more files than any recording has", where=path.name, advice=advice)


def shown_members(path: Path) -> list[str]:
    """Return the names of the files in a zip archive; empty where it is damaged or lists too many."""
    try:
        refuse_long_list(path)
        with zipfile.ZipFile(path) as archive:
            return [member.filename for member in archive.infolist() if _is_shown(member)]
    except (SplitError, *_DAMAGE, NotImplementedError, RuntimeError):
        return []


def several_recordings(path: Path, names: Sequence[str]) -> LogError:
    """Return the error of an archive with several recordings, which lists them and says how to choose."""
    listed = ", ".join(names[:_MOST_LISTED]) + (f" and {len(names) - _MOST_LISTED} more" * (len(names) > _MOST_LISTED))
    advice = "Add --together if they are parts of one drive. Otherwise unpack it, and name one of them or the folder."
    return LogError(f"holds {len(names)} recordings: {listed}", where=path.name, advice=advice)


class UnpackedRecording:
    """A recording that is read from a temporary copy, and goes by the name of the file that the user gave.

    Parameters
    ----------
    path : Path
        The compressed file or archive.
    name : str
        Of the recording.
    scratch : ScratchFolder
        Holds the copy; it is removed with this object.
    """

    def __init__(self, inner: RawRecording, path: Path, name: str, scratch: ScratchFolder) -> None:
        self._inner = inner
        self._scratch = scratch
        self.path, self.name = path, name

    @property
    def notes(self) -> list[ReadNote]:
        """What reading had to leave out so far."""
        return self._inner.notes

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)


def by_its_own_name(error: SplitError, copy: Path, name: str) -> SplitError:
    """Return an error that names what the user gave in place of the temporary copy of it."""
    where = (error.where or "").replace(str(copy), name)
    where = name + where.removeprefix(copy.name) if where.startswith(copy.name) else where
    what, advice = (text.replace(str(copy), name) for text in (error.what, error.advice or ""))
    return type(error)(what, where=where or None, advice=advice or None)


def _is_shown(member: zipfile.ZipInfo) -> bool:
    """Tell a file that someone put there: no folder, nothing hidden or outside, no copy that macOS makes of names."""
    place = PurePosixPath(member.filename)
    odd = place.is_absolute() or any(part.startswith(".") or part == "__MACOSX" for part in place.parts)
    return not (member.is_dir() or odd or "\\" in member.filename or "\0" in member.filename)


def _opener(head: bytes) -> Callable[[BinaryIO], Iterator[bytes]] | None:
    if head.startswith(b"\x1f\x8b"):
        return lambda packed: _parts(gzip.GzipFile(fileobj=packed))
    if head.startswith(b"\x28\xb5\x2f\xfd"):
        return _frames_of_zstd
    if head.startswith(b"BZh"):
        return lambda packed: _by_decoder(packed, bz2.BZ2Decompressor)
    if head.startswith(b"\xfd7zXZ\0"):
        return lambda packed: _by_decoder(packed, lambda: lzma.LZMADecompressor(lzma.FORMAT_XZ, _MEMORY_OF_XZ))
    return None


def _parts(stream: Any) -> Iterator[bytes]:
    while part := stream.read(_AT_ONCE):
        yield part


def _by_decoder(packed: BinaryIO, make: Callable[[], _Decompressor]) -> Iterator[bytes]:
    """Yield what one stream behind the other unpacks into, piece by piece; zeros may stand between them."""
    data = packed.read(_AT_ONCE)
    while data := data.lstrip(b"\0") or packed.read(_AT_ONCE):
        decoder = make()
        while not decoder.eof:
            if decoder.needs_input and not data:
                data = packed.read(_AT_ONCE)
                if not data:
                    raise EOFError("it ends before its end is marked")
            yield decoder.decompress(data, _AT_ONCE)
            data = b""
        data = decoder.unused_data


def _frames_of_zstd(packed: BinaryIO) -> Iterator[bytes]:
    """Yield what one frame behind the other unpacks into. A stream reader would not say that the last one is cut."""
    data = packed.read(_OF_ZSTD_AT_ONCE)
    while data:
        decoder = zstandard.ZstdDecompressor().decompressobj()
        while not decoder.eof:
            if not data:
                raise EOFError("it ends before its end is marked")
            yield decoder.decompress(data)
            data = decoder.unused_data if decoder.eof else packed.read(_OF_ZSTD_AT_ONCE)
        data = data or packed.read(_OF_ZSTD_AT_ONCE)


def _write(parts: Iterator[bytes], target: Path, most: int, where: str) -> int:
    """Write what unpacks to a file, at most so many bytes; return how many."""
    size = 0
    with target.open("wb") as plain, full_disk_as_error():
        while True:
            try:
                part = next(parts, None)
            except _DAMAGE as error:
                raise _cannot_be_unpacked(error, where) from error
            if part is None:
                plain.flush()
                return size
            size += len(part)
            if size > most:
                what = f"unpacks into over {MOST_OF_A_FILE} times its size: no recording is like that"
                raise LogError(what, where=where, advice="Unpack it yourself if it is sound.")
            plain.write(part)


def _cannot_be_unpacked(error: BaseException, where: str) -> LogError:
    return LogError(f"cannot be unpacked ({reason_of(error)})", where=where, advice="Copy it again.")
