"""Writing files and folders whole or not at all, one writer at a time, and naming content. Imports `errors`."""

import contextlib
import ctypes
import hashlib
import json
import os
import shutil
import stat
import sys
import tempfile
import weakref
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, is_dataclass
from io import BufferedReader
from pathlib import Path
from typing import Any

from split_cli.errors import SplitError

DIGESTS = "SHA256SUMS"
"""File of a folder that lists the digests of the others, as `sha256sum --check` reads it."""


@contextlib.contextmanager
def atomic_path(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `target`; rename it onto `target` when the body ends well.

    A body that raises, or a process that dies, leaves the old file as it was. The rename is atomic
    because the temporary file lives in the same directory. A symbolic link is followed, not replaced.

    Raises
    ------
    SplitError
        If the directory does not exist or cannot be written, the target is a folder or a device, or the disk
        is full.
    """
    shown = str(target)
    target = _real_target(target)
    temporary: Path | None = None
    claim: int | None = None
    try:
        _refuse_what_is_no_file(target, shown)
        _sweep(target)
        claim, temporary = _claimed_file(target)
        yield temporary
        _flush_to_disk(temporary)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
        temporary = None
    except OSError as error:
        if temporary is None or _concerns(error, temporary, target):
            raise _not_written(error, shown) from error
        raise
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)
        if claim is not None:
            os.close(claim)


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike[str], without: Iterable[str] = ()) -> Iterator[Path]:
    """Give a temporary folder beside `target` that takes the place of `target` when all went well.

    A reader, or whoever looks after a crash, finds all new files or all old ones. In a folder that exists, files
    of other names stay: they are linked into the new one before the two change places in one step of the system.
    Where that step does not exist (another system than Linux, a mount point, the folder one stands in), the files
    are moved one by one, each atomically.

    Parameters
    ----------
    without : iterable of str
        Files that an earlier run may have written, relative to `target`: those that this one does not write go.

    Raises
    ------
    SplitError
        As for `atomic_path`.
    """
    shown = str(target)
    target = _real_target(target)
    temporary: Path | None = None
    claim: int | None = None
    try:
        _refuse_what_is_no_folder(target, shown)
        _sweep(target)
        temporary, claim = _claimed_folder(target)
        yield temporary
        produced = sorted(path for path in temporary.rglob("*") if path.is_file())
        for path in produced:
            _flush_to_disk(path)
            place = path.relative_to(temporary)
            _refuse_what_is_no_file(target / place, str(Path(shown) / place))
        if target.exists():
            gone = {Path(name) for name in without} - {path.relative_to(temporary) for path in produced}
            if produced and not _swapped(temporary, target, produced, gone):
                _move_one_by_one(temporary, target, produced, gone)
        elif produced:
            os.chmod(temporary, 0o777 & ~_umask())
            os.replace(temporary, target)
    except OSError as error:
        if temporary is None or _concerns(error, temporary, target):
            raise _not_written(error, shown) from error
        raise
    finally:
        if temporary is not None:
            shutil.rmtree(temporary, ignore_errors=True)
        if claim is not None:
            os.close(claim)


_UNFINISHED = ".part"
_LONGEST_NAME = 200  # to which an unfinished file's own letters are added [bytes]: file systems allow 255
_AT_WORKING_FOLDER, _EXCHANGE = -100, 2  # AT_FDCWD and RENAME_EXCHANGE of renameat2(2)


def _swapped(temporary: Path, target: Path, produced: list[Path], gone: set[Path]) -> bool:
    """Exchange two folders in one step; False, with nothing changed, where that cannot be done."""
    if _stands_in(target) or os.path.ismount(target) or not sys.platform.startswith("linux"):
        return False
    try:
        _link_the_rest(target, temporary, gone | {path.relative_to(temporary) for path in produced})
        shutil.copymode(target, temporary)
        exchange = ctypes.CDLL(None, use_errno=True).renameat2
    except (OSError, AttributeError):
        return False
    here, flags = _AT_WORKING_FOLDER, ctypes.c_uint(_EXCHANGE)
    return bool(exchange(here, os.fsencode(temporary), here, os.fsencode(target), flags) == 0)


def _stands_in(folder: Path) -> bool:
    """Tell whether the working folder is this one or below it: exchanged, it would be the old one."""
    try:
        return Path.cwd().is_relative_to(folder)
    except OSError:
        return True


def _link_the_rest(old: Path, new: Path, but: set[Path]) -> None:
    """Give the new folder all that the old one holds but some files; links and special files included."""
    for folder, folders, files in os.walk(old):
        place = Path(folder).relative_to(old)
        for name in folders:
            if (Path(folder) / name).is_symlink():
                files.append(name)
            else:
                (new / place / name).mkdir(exist_ok=True)
                shutil.copymode(Path(folder) / name, new / place / name)
        for name in files:
            if place / name not in but:
                os.link(Path(folder) / name, new / place / name, follow_symlinks=False)


def _move_one_by_one(temporary: Path, target: Path, produced: list[Path], gone: set[Path]) -> None:
    for path in produced:
        destination = target / path.relative_to(temporary)
        destination.parent.mkdir(parents=True, exist_ok=True)
        os.replace(path, destination)
    for name in gone:
        (target / name).unlink(missing_ok=True)


class ScratchFolder:
    """A folder for what a run keeps outside memory and nobody else reads; it goes with this object.

    What killed runs left is removed by the next one that makes such a folder in the same place.

    Parameters
    ----------
    within : path-like, optional
        Where to make it; by default in the system's folder for temporary files.
    """

    def __init__(self, within: str | os.PathLike[str] | None = None) -> None:
        name = Path(within or tempfile.gettempdir()) / "split-scratch"
        _sweep(name)
        self.path, claim = _claimed_folder(name)
        self._remove = weakref.finalize(self, _remove_claimed, self.path, claim)

    def __enter__(self) -> Path:
        return self.path

    def __exit__(self, *raised: object) -> None:
        self._remove()


def _remove_claimed(folder: Path, claim: int) -> None:
    shutil.rmtree(folder, ignore_errors=True)
    os.close(claim)


@contextlib.contextmanager
def exclusive_access(target: str | os.PathLike[str]) -> Iterator[None]:
    """Keep every other run that asks for the same file waiting until the body ends.

    For a file that is read, changed and written again: two runs at once would lose what one of them added. The
    lock is on the file itself and goes with the process, however that ends. What does not exist is not locked.

    Raises
    ------
    SplitError
        If the file cannot be read.
    """
    target = Path(os.path.realpath(target))
    claim: int | None = None
    try:
        while claim is None and target.is_file():
            claim = os.open(target, os.O_RDONLY)
            _lock(claim, wait=True)
            # Whoever held it has replaced the file: then the lock is on what is no longer there.
            if not target.exists() or not os.path.samestat(os.fstat(claim), target.stat()):
                os.close(claim)
                claim = None
        yield
    except OSError as error:
        if error.filename is not None and str(error.filename) == str(target):
            raise SplitError(f"cannot be read ({error.strerror or error})", where=str(target)) from error
        raise
    finally:
        if claim is not None:
            os.close(claim)


def _lock(handle: int, *, wait: bool = False) -> bool:
    """Lock an open file or folder for this process; False where another holds it or there are no locks."""
    try:
        import fcntl

        fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
        return True
    except (ImportError, OSError):
        return False


def _claimed_file(target: Path) -> tuple[int, Path]:
    """Make an unfinished file beside `target`, locked, so that no other run takes it for a leftover."""
    while True:
        handle, name = tempfile.mkstemp(_UNFINISHED, _begin_of_unfinished(target), target.parent)
        _lock(handle, wait=True)
        if os.path.exists(name):  # a sweep may have come between the two; it was waited for
            return handle, Path(name)
        os.close(handle)


def _claimed_folder(target: Path) -> tuple[Path, int]:
    """Make an unfinished folder beside `target`, locked; see `_claimed_file`."""
    while True:
        name = tempfile.mkdtemp(_UNFINISHED, _begin_of_unfinished(target), target.parent)
        with contextlib.suppress(FileNotFoundError):
            handle = os.open(name, os.O_RDONLY)
            _lock(handle, wait=True)
            if os.path.exists(name):
                return Path(name), handle
            os.close(handle)


def _begin_of_unfinished(target: Path) -> str:
    """Return what the names of a target's unfinished files begin with: its own name, or a digest of a long one."""
    name = os.fsencode(target.name)
    return f".{target.name if len(name) <= _LONGEST_NAME else hashlib.sha256(name).hexdigest()}."


def _sweep(target: Path) -> None:
    """Remove what killed runs left beside `target`: unfinished files that no living process holds locked."""
    begin = _begin_of_unfinished(target)
    with contextlib.suppress(OSError):
        for entry in list(os.scandir(target.parent)):
            if entry.name.startswith(begin) and entry.name.endswith(_UNFINISHED):
                _remove_if_abandoned(Path(entry.path))


def _remove_if_abandoned(path: Path) -> None:
    with contextlib.suppress(OSError):
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0))
        try:
            if not _lock(handle):
                return
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        finally:
            os.close(handle)


_NO_FILES = {stat.S_IFIFO: "a pipe", stat.S_IFSOCK: "a socket", stat.S_IFCHR: "a device", stat.S_IFBLK: "a device"}


def refuse_no_regular_file(path: str | os.PathLike[str], error: type[SplitError] = SplitError) -> None:
    """Refuse what is read without an end or waits for a writer: pipes, sockets, devices.

    Raises
    ------
    SplitError
        Of the given type.
    """
    with contextlib.suppress(OSError):
        mode = os.stat(path).st_mode
        kind = _NO_FILES.get(stat.S_IFMT(mode))
        if kind:
            raise error(f"is {kind}, a file was expected", where=str(path), advice="Save what it delivers first.")


def open_to_read(path: str | os.PathLike[str], error: type[SplitError] = SplitError) -> BufferedReader:
    """Open a regular file for reading bytes; see `refuse_no_regular_file`."""
    refuse_no_regular_file(path, error)
    return open(path, "rb")


def read_text(path: str | os.PathLike[str], most_bytes: int, error: type[SplitError] = SplitError) -> str:
    """Return a text file's content, of a size that such a file can have.

    Raises
    ------
    SplitError
        If it is no regular file, or larger than `most_bytes`.
    OSError, UnicodeDecodeError
        As reading does.
    """
    with open_to_read(path, error) as stream:
        content = stream.read(most_bytes + 1)
    if len(content) > most_bytes:
        raise error(f"is larger than {most_bytes >> 20} MB, a text file of settings was expected", where=str(path))
    return content.decode("utf-8").replace("\r\n", "\n")


def parse_json(text: str | bytes) -> Any:
    """Return the content of JSON text.

    Raises
    ------
    ValueError
        If it is no JSON, or nested too deeply.
    """
    try:
        return json.loads(text)
    except RecursionError as error:
        raise ValueError("nested too deeply") from error


def json_ready(value: Any) -> Any:
    """Return a value as JSON has it: dataclasses as objects, arrays as lists, what is not finite as null."""
    if is_dataclass(value) and not isinstance(value, type):
        return json_ready(asdict(value))
    if isinstance(value, Mapping):
        return {str(key): json_ready(entry) for key, entry in value.items()}
    if hasattr(value, "tolist"):
        return json_ready(value.tolist())
    if isinstance(value, str | bool | int) or value is None:
        return value
    if isinstance(value, float):
        return value if abs(value) < float("inf") else None
    return [json_ready(entry) for entry in value] if isinstance(value, Iterable) else str(value)


def typed_path(path: str | os.PathLike[str]) -> str:
    """Return a path as one types it: what begins with a hyphen would be taken for an option."""
    return os.path.join(os.curdir, path) if str(path).startswith("-") else str(path)


def refuse_overwriting_inputs(inputs: Iterable[str | os.PathLike[str]], *outputs: str | os.PathLike[str]) -> None:
    """Refuse to write over a file that is being read, by whatever name or link: it would be lost."""
    real = {os.path.realpath(source) for source in inputs}
    for target in outputs:
        if os.path.realpath(target) in real:
            advice = "Name another output."
            raise SplitError("is an input too, it would be overwritten", where=str(target), advice=advice)


def refuse_what_cannot_be_written(target: str | os.PathLike[str]) -> None:
    """Check a file's place before hours of work go into its content.

    Raises
    ------
    SplitError
        If the directory does not exist or cannot be written, or the target is a folder or a device.
    """
    _refuse_what_is_no_file(_real_target(target), str(target))
    refuse_place_without_access(target)


def refuse_what_cannot_be_a_folder(target: str | os.PathLike[str]) -> None:
    """Check a folder's place before hours of work go into its files.

    Raises
    ------
    SplitError
        If what holds the folder does not exist or cannot be written, or the target is a file.
    """
    _refuse_what_is_no_folder(_real_target(target), str(target))
    refuse_place_without_access(target)


def refuse_place_without_access(target: str | os.PathLike[str]) -> None:
    """Refuse, before any work, a file or folder whose folder exists and cannot be written into."""
    real = Path(os.path.realpath(target))
    place = real if real.is_dir() else real.parent
    if place.is_dir() and not os.access(place, os.W_OK | os.X_OK):
        what = f"cannot be written: no permission to write into {place}, or it is read-only"
        raise SplitError(what, where=str(target), advice="Nothing was computed. Name another place.")


def _real_target(target: str | os.PathLike[str]) -> Path:
    real = Path(os.path.realpath(target))
    if not real.parent.is_dir():
        above = Path(target).parent
        what, advice = "does not exist", f"Create {above}."
        if real.parent.exists():
            what, advice = "is a file", f"Name a folder in place of {above}."
        raise SplitError(f"the folder to write into {what}", where=str(target), advice=advice)
    return real


def _refuse_what_is_no_file(target: Path, shown: str) -> None:
    if target.is_dir():
        raise SplitError("is a folder, a file was to be written", where=shown, advice="Name a file in it.")
    if target.exists() and not target.is_file():
        raise SplitError("is not a regular file, it would be replaced by one", where=shown)
    if target.exists() and not target.stat().st_mode & 0o222:
        # A rename asks nobody: only this keeps what its owner protected.
        advice = "Name another file, or allow writing with `chmod u+w`."
        raise SplitError("is write-protected", where=shown, advice=advice)


def _refuse_what_is_no_folder(target: Path, shown: str) -> None:
    if target.exists() and not target.is_dir():
        raise SplitError("is a file, a folder was to be written", where=shown, advice="Name a folder.")


def _concerns(error: OSError, *output: Path) -> bool:
    """Tell an error of this output from one about another file, such as an input that vanished."""
    if error.filename is None:
        return True
    return any(Path(str(error.filename)).is_relative_to(path) for path in output)


def _not_written(error: OSError, shown: str) -> SplitError:
    return SplitError(f"cannot be written ({error.strerror or error}); what was there before is unchanged", where=shown)


def atomic_write_bytes(target: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `target`, whole or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(target: str | os.PathLike[str], content: str) -> None:
    """Write `content` as UTF-8 with line feeds to `target`, whole or not at all."""
    atomic_write_bytes(target, content.encode("utf-8"))


def write_digests(folder: Path) -> None:
    """Write the digest of every file of a folder beside them: a mixture of two runs can then be seen."""
    files = sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*") if path.is_file())
    lines = [f"{sha256_of_file(folder / name)}  {name}\n" for name in files if name != DIGESTS]
    (folder / DIGESTS).write_text("".join(lines), encoding="utf-8")


def sha256_of_file(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file's content, as 64 hexadecimal digits.

    For a folder, of its files' names and digests in name order.

    Raises
    ------
    SplitError
        If the file cannot be read.
    """
    path = Path(path)
    try:
        if not path.is_dir():
            with open_to_read(path) as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        os.scandir(path).close()  # what it may not list it would take for nothing
        digest = hashlib.sha256()
        for part in sorted(entry for entry in path.rglob("*") if entry.is_file()):
            digest.update(f"{part.relative_to(path).as_posix()}\0{sha256_of_file(part)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise SplitError(f"cannot be read ({error.strerror or error})", where=str(path)) from error


def _flush_to_disk(path: Path) -> None:
    refuse_no_regular_file(path)
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
