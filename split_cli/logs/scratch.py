"""Long columns kept outside memory: in nameless temporary files, mapped, and let go of when others are looked at.

A recording of hours has columns of a hundred megabytes each. Whoever goes through them one by one sets each aside
and works on with the array that it gets: pages come back when they are read.
"""

import contextlib
import math
import mmap
import tempfile
import weakref
from array import array
from collections.abc import Iterator
from typing import BinaryIO

import numpy as np

from split_cli.errors import LogError

LONG = 2**19
"""Values from which on a column is set aside [1]: 4 MB; shorter ones cost less in memory than in files."""
PIECE = 2**18
"""Values of a long column that are worked on at once [1]: 2 MB; judgement, it decides memory and no result."""
FORESEEN = 2**21
"""Values up to which a column whose length is foreseen may stay in memory [1]: 16 MB, six hours at 100 Hz."""
FORESEEN_BYTES = 2**27
"""What all such columns hold in memory together [bytes]: 128 MB, 1.5 million rows of 11 channels. Judgement: files
cost a plain table a sixth of its time, and ingest of a million rows stays at half a GB."""
HELD = 2**14
"""Samples of a signal that are held before they go to its columns [1]: 256 kB."""
_maps: weakref.WeakSet[mmap.mmap] = weakref.WeakSet()


def set_aside(values: np.ndarray) -> np.ndarray:
    """Return equal values outside memory where they are many, for reading only; and let go of all others.

    Where there is no room for them on the disk they stay where they are.

    Parameters
    ----------
    values : ndarray, shape (N,)
    """
    if values.size < LONG:
        return values
    let_go()
    if _is_aside(values):
        return values
    try:
        with tempfile.TemporaryFile() as file:
            for piece in in_pieces(len(values)):
                file.write(np.ascontiguousarray(values[piece]).data)
            return _mapped(file, values.dtype)
    except OSError:
        return values


def room(count: int) -> np.ndarray:
    """Return `count` numbers to be written, all NaN, shape (N,); many of them lie outside memory."""
    if count < LONG:
        return np.full(count, np.nan)
    try:
        with tempfile.TemporaryFile() as file:
            # Written, not left as a hole: a disk that is full later would kill whoever writes into the map.
            for first in range(0, count, PIECE):
                file.write(np.full(min(PIECE, count - first), np.nan).data)
            return _mapped(file, np.dtype(float), writable=True)
    except OSError:
        return np.full(count, np.nan)


def mapped_file(file: BinaryIO) -> mmap.mmap:
    """Return the content of a file for reading; what was read of it is let go of with the columns.

    Raises
    ------
    ValueError
        If it is empty.
    """
    mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
    _maps.add(mapped)
    return mapped


def in_pieces(count: int) -> Iterator[slice]:
    """Yield ranges of `PIECE` rows that cover `count`; what was set aside is let go of behind each."""
    for first in range(0, count, PIECE):
        yield slice(first, min(first + PIECE, count))
        let_go()


def selected(values: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the rows of a table where a mask is true, shape (M, D); many of them lie outside memory."""
    column = GrowingColumn()
    for piece in in_pieces(len(rows)):
        column.append(values[piece][rows[piece]].reshape(-1))
    return column.finished().reshape(-1, values.shape[1])


def equal(one: np.ndarray, other: np.ndarray) -> bool:
    """Whether two columns hold the same numbers; as `np.array_equal`, piece by piece."""
    if one is other:
        return True
    return len(one) == len(other) and all(np.array_equal(one[piece], other[piece]) for piece in in_pieces(len(one)))


def are_finite(values: np.ndarray) -> np.ndarray:
    """Return where a column is finite, shape (N,), and let go of it: of a long recording each column counts."""
    finite = np.isfinite(values)
    if len(values) >= LONG:
        let_go()
    return finite


def let_go() -> None:
    """Release the memory of every mapped file and column that was set aside; it comes back when it is read."""
    for mapped in list(_maps):
        with contextlib.suppress(OSError, ValueError, AttributeError):  # no such call on every system
            mapped.madvise(mmap.MADV_DONTNEED)


class GrowingColumn:
    """A column that is read piece by piece; a long one grows in a file.

    Parameters
    ----------
    dtype : type
        Of its values.
    expected : int
        How many values there will be [1], where it can be foreseen. Up to `FORESEEN` and `FORESEEN_BYTES` room for
        them is made in memory, at once: that spares the file and every further copy.
    """

    def __init__(self, dtype: type = float, expected: int = 0) -> None:
        self._values = np.empty(0, dtype)  # with room at the end, which takes no memory before it is written
        self._count = 0
        self._expected = expected
        self._longest = FORESEEN if expected else LONG
        self._file: BinaryIO | None = None

    def append(self, values: np.ndarray) -> None:
        """Add values at the end, shape (M,).

        Raises
        ------
        LogError
            If there is no room for it on the disk.
        """
        count = self._count + len(values)
        if self._file is None and count > len(self._values):
            self._grow(count)
        if self._file is not None:
            with full_disk_as_error():
                self._file.write(np.ascontiguousarray(values, dtype=self._values.dtype).data)
            return
        self._values[self._count : count] = values
        self._count = count

    def finished(self) -> np.ndarray:
        """Return all values, shape (N,); the column ends here."""
        if self._file is None:
            found = self._values[: self._count]
            return found if self._count >= LONG else found.copy()
        with full_disk_as_error(), self._file as file:
            return _mapped(file, self._values.dtype)

    def _grow(self, count: int) -> None:
        """Make room for so many values; where they are too many for memory, go on in a file."""
        room = max(count, self._expected, min(2 * len(self._values), self._longest))
        held = self._values[: self._count]
        more = room * held.itemsize - self._values.nbytes
        if room > LONG and (room > self._longest or _foreseen_bytes() + more > FORESEEN_BYTES):
            with full_disk_as_error():
                self._file = tempfile.TemporaryFile()  # noqa: SIM115 (grows from call to call)
                self._file.write(held.data)
            self._values = np.empty(0, held.dtype)
            return
        self._values = np.empty(room, held.dtype)
        self._values[: self._count] = held
        if room > LONG:
            _foreseen.append(weakref.ref(self._values))


_foreseen: list[weakref.ref[np.ndarray]] = []
"""Long columns in memory, for as long as anyone uses them."""


def _foreseen_bytes() -> int:
    """Return what they take, room included [bytes]."""
    alive = [(known, values.nbytes) for known in _foreseen if (values := known()) is not None]
    _foreseen[:] = [known for known, _ in alive]
    return sum(size for _, size in alive)


class GrowingSignal:
    """Times and values of one signal, sample by sample."""

    def __init__(self) -> None:
        # Arrays of doubles: a list of numbers takes four times their memory.
        self._held = array("d"), array("d")
        self._columns = GrowingColumn(), GrowingColumn()
        self.first = math.nan  # its first time

    def append(self, time: float, value: float) -> None:
        """Add one."""
        times, values = self._held
        times.append(time)
        values.append(value)
        if math.isnan(self.first):
            self.first = time
        if len(times) == HELD:
            self._hand_over()

    def finished(self) -> tuple[np.ndarray, np.ndarray]:
        """Return times and values, shapes (N,); the signal ends here."""
        self._hand_over()
        time, values = self._columns
        return time.finished(), values.finished()

    def _hand_over(self) -> None:
        for held, column in zip(self._held, self._columns, strict=True):
            column.append(np.array(held))
            del held[:]


@contextlib.contextmanager
def full_disk_as_error() -> Iterator[None]:
    """Turn what the system raises while a temporary file is written into an error with the way out."""
    try:
        yield
    except OSError as error:
        what = f"a long recording does not fit into the folder for temporary files ({error.strerror})"
        advice = "Make room there, or name another folder by the variable TMPDIR."
        raise LogError(what, where=tempfile.tempdir or "the folder for temporary files", advice=advice) from error


def _is_aside(values: np.ndarray) -> bool:
    base = values.base
    while isinstance(base, np.ndarray):
        base = base.base
    return isinstance(base, mmap.mmap) or (isinstance(base, memoryview) and isinstance(base.obj, mmap.mmap))


def _mapped(file: BinaryIO, dtype: np.dtype, *, writable: bool = False) -> np.ndarray:
    file.flush()
    mapped = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_WRITE if writable else mmap.ACCESS_READ)
    _maps.add(mapped)
    return np.frombuffer(mapped, dtype=dtype)
