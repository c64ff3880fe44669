"""NumPy arrays: archives (.npz), single arrays (.npy), and folders with a file for each array."""

import itertools
import zipfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from split_cli.errors import damaged
from split_cli.logs.budget import Unfolded, refuse_unpacked_size
from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.named_arrays import is_time, recording_of_vectors

_MAGIC = b"\x93NUMPY"
_MOST_FILES = 20_000
"""Of a folder, looked at [1]; judgement: ten minutes of a camera beside the arrays."""
_HEAD_BYTES = 4096
"""Of a text, from which its columns are counted; judgement: room for 20 lines."""
_MOST_BLANK = 0.01
"""Of the lines of a text, that may be no numbers [1]; judgement: a title and a remark."""
_NO_NUMBERS = "Save vectors of numbers by their names: np.savez('log.npz', t=t, vx=vx, r=r)."
_OBJECTS = "arrays of Python objects, left out: to read them would run what they hold"


def is_npz(path: Path, head: bytes) -> bool:
    """Whether a file is an archive of NumPy arrays: a zip archive with files in NumPy's format."""
    if not head.startswith(b"PK\x03\x04") or not zipfile.is_zipfile(path):
        return False
    with zipfile.ZipFile(path) as archive:
        return any(name.endswith(".npy") for name in archive.namelist())


def open_npz(path: Path) -> RawRecording:
    """Open an archive of NumPy arrays; fields of a structured array are addressed as ``name.field``.

    Raises
    ------
    LogError
        If it is damaged or holds no vector of numbers.
    """
    leaves: list[tuple[str, np.ndarray]] = []
    objects = 0
    unfolded = Unfolded(path.stat().st_size)
    try:
        with zipfile.ZipFile(path) as archive:
            for place, member in enumerate(archive.infolist()):
                if not member.filename.endswith(".npy"):
                    continue
                most = unfolded.most(place, member.compress_size)
                what = f"array {member.filename}"
                refuse_unpacked_size(member.file_size, member.compress_size, what, path.name, most)
                unfolded.add(place, member.file_size)
                with archive.open(member) as stream:
                    values = _array(stream, member.file_size, path.name)
                objects += values is None
                leaves += _leaves(member.filename.removesuffix(".npy"), values)
    except (zipfile.BadZipFile, OSError, EOFError, ValueError, NotImplementedError) as error:
        raise damaged(path, error, "Save it again.") from error
    return recording_of_vectors(path, leaves, _notes(path, objects), _NO_NUMBERS)


def open_npy(path: Path) -> RawRecording:
    """Open one NumPy array: the fields of a structured one, or the columns of a matrix as ``name[0]``.

    Raises
    ------
    LogError
        If it is damaged or holds no vector of numbers.
    """
    with path.open("rb") as stream:
        try:
            values = _array(stream, path.stat().st_size, path.name)
        except (OSError, EOFError, ValueError) as error:
            raise damaged(path, error, "Save it again.") from error
    leaves = _leaves("" if values is not None and values.dtype.names else path.stem, values)
    return recording_of_vectors(path, list(leaves), _notes(path, values is None), _NO_NUMBERS)


def is_array_folder(folder: Path) -> bool:
    """Whether a folder has a file for each array: arrays of NumPy, or two texts with one number a line."""
    files = _files(folder)
    texts = (f for f in files if f.suffix.lower() == ".txt" and f.parent == folder and _width(f) == 1)
    return any(map(_is_array, files)) or sum(1 for _ in itertools.islice(texts, 2)) == 2


def open_array_folder(folder: Path) -> RawRecording:
    """Open a folder with a file for each array, of NumPy or a text with one number a line.

    The path of a file in the folder is the name of its array: ``imu/yaw_rate.npy`` is ``imu.yaw_rate``, and its
    time stands beside it, for instance in ``imu/timestamps.txt``.

    Raises
    ------
    LogError
        If one is damaged, or none holds numbers.
    """
    files = sorted(_files(folder))
    held = Counter(file.parent for file in files)
    leaves: list[tuple[str, np.ndarray]] = []
    objects, unread = 0, 0
    for file in files:
        parts = list(file.relative_to(folder).with_suffix("").parts)
        if len(parts) > 1 and held[file.parent] == 2 and not is_time(parts[-1]):
            # The only signal of its folder is called like it.
            parts[-1] = "value"
        name = ".".join(parts).replace(" ", "_")
        if _is_array(file):
            with file.open("rb") as stream:
                try:
                    values = _array(stream, file.stat().st_size, file.name)
                except (OSError, EOFError, ValueError) as error:
                    raise damaged(file, error, "Save it again.") from error
            objects += values is None
            leaves += _leaves(name, values)
        elif file.suffix.lower() == ".txt" and (numbers := _numbers_of_text(file)) is not None:
            leaves.append((name, numbers))
        else:
            unread += 1
    notes = _notes(folder, objects)
    if unread:
        notes.append(ReadNote("files that are no arrays, left out", folder.name, unread))
    if len(files) == _MOST_FILES:
        notes.append(ReadNote(f"more than {_MOST_FILES} files: the others were not looked at", folder.name))
    return recording_of_vectors(folder, leaves, notes, _NO_NUMBERS)


def _files(folder: Path) -> list[Path]:
    return list(itertools.islice((f for f in folder.rglob("*") if f.is_file()), _MOST_FILES))


def _is_array(file: Path) -> bool:
    return file.suffix.lower() in (".npy", "") and _begins(file, len(_MAGIC)) == _MAGIC


def _begins(file: Path, count: int) -> bytes:
    try:
        with file.open("rb") as stream:
            return stream.read(count)
    except OSError:
        return b""


def _numbers_of_text(file: Path) -> np.ndarray | None:
    """Return the numbers of a text, parted by blanks, shape (N, K), NaN for other lines; None if it has none."""
    width = _width(file)
    if width == 0:
        return None
    lines = file.read_bytes().strip().split(b"\n")
    try:
        return np.array([line.split() for line in lines], dtype=np.float64)
    except ValueError:
        rows = [line.split() for line in lines]
    blank = [np.nan] * width
    values = np.array([[float(c) for c in row] if _are_numbers(row, width) else blank for row in rows])
    return values if np.mean(np.isnan(values[:, 0])) < _MOST_BLANK else None


def _width(file: Path) -> int:
    """Return how many numbers, parted by blanks, the first lines of a text have, but for one title; 0 for none."""
    rows = [line.split() for line in _begins(file, _HEAD_BYTES).split(b"\n")[1:-1][:20]]
    return len(rows[0]) if len(rows) > 1 and all(_are_numbers(row, len(rows[0])) for row in rows) else 0


def _are_numbers(cells: list[bytes], width: int) -> bool:
    try:
        return len([float(cell) for cell in cells]) == width
    except ValueError:
        return False


def _array(stream: BinaryIO, size: int, where: str) -> np.ndarray | None:
    """Return an array; None for one of Python objects, which is never loaded."""
    version = np.lib.format.read_magic(stream)
    if version not in ((1, 0), (2, 0)):
        raise ValueError(f"version {version[0]}.{version[1]} of the format is not known")
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, fortran, dtype = read(stream)
    if dtype.hasobject:
        return None
    count = int(np.prod(shape, dtype=object))
    if count * dtype.itemsize > size:
        raise ValueError(f"its head claims {count:,} values, more than are stored")
    flat = np.frombuffer(stream.read(count * dtype.itemsize), dtype=dtype)
    if len(flat) < count:
        raise EOFError("it ends early")
    return flat.reshape(shape, order="F" if fortran else "C")


def _leaves(name: str, values: np.ndarray | None) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the numeric arrays of a variable: vectors as columns, stamps of NumPy in s."""
    if values is None:
        return
    if values.dtype.names:
        for field in values.dtype.names:
            yield from _leaves(f"{name}.{field}" if name else field, values[field])
        return
    if values.dtype.kind == "M":
        since = values.astype("datetime64[ns]").astype(np.int64) * 1e-9
        values = np.where(np.isnat(values), np.nan, since)
    elif values.dtype.kind == "m":
        values = values / np.timedelta64(1, "s")
    if values.dtype.kind in "biuf" or (values.dtype.kind == "U" and values.size > 1):
        squeezed = values.squeeze() if values.ndim > 2 else values
        yield name, squeezed.reshape(-1, 1) if squeezed.ndim == 1 else squeezed


def _notes(path: Path, objects: int) -> list[ReadNote]:
    return [ReadNote(_OBJECTS, path.name, int(objects))] if objects else []
