"""Writing files whole or not at all, and naming their content. Imports only `errors`."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

from split_cli.errors import SplitError

__all__ = [
    "atomic_directory",
    "atomic_path",
    "atomic_write_bytes",
    "atomic_write_text",
    "refuse_overwriting_inputs",
    "refuse_what_cannot_be_written",
    "sha256_of_file",
]


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
    _refuse_what_is_no_file(target, shown)
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent)
        os.close(handle)
        temporary = Path(name)
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


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary folder beside `target`; its files replace those in `target` when all went well.

    A folder that did not exist appears by one rename, if there is anything to put into it. In one that did, files
    of other names stay; every new file is on the disk and its place checked before the first is moved, each by an
    atomic rename.

    Raises
    ------
    SplitError
        As for `atomic_path`.
    """
    shown = str(target)
    target = _real_target(target)
    if target.exists() and not target.is_dir():
        raise SplitError("is a file, a folder was to be written", where=shown)
    temporary: Path | None = None
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
        yield temporary
        produced = sorted(path for path in temporary.rglob("*") if path.is_file())
        for path in produced:
            _flush_to_disk(path)
            place = path.relative_to(temporary)
            _refuse_what_is_no_file(target / place, str(Path(shown) / place))
        if target.exists():
            for path in produced:
                destination = target / path.relative_to(temporary)
                destination.parent.mkdir(parents=True, exist_ok=True)
                os.replace(path, destination)
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


def refuse_overwriting_inputs(output: str | os.PathLike[str], inputs: Iterable[str | os.PathLike[str]]) -> None:
    """Refuse to write over a file that is being read: a recording that is replaced by its result is lost.

    Raises
    ------
    SplitError
        If `output` is one of the `inputs`, by whatever name or link.
    """
    real = os.path.realpath(output)
    for source in inputs:
        if os.path.realpath(source) == real:
            raise SplitError(
                "is an input too, it would be overwritten", where=str(output), advice="Name another output."
            )


def refuse_what_cannot_be_written(target: str | os.PathLike[str]) -> None:
    """Check a file's place before hours of work go into its content.

    Raises
    ------
    SplitError
        If the directory does not exist, or the target is a folder or a device.
    """
    _refuse_what_is_no_file(_real_target(target), str(target))


def _real_target(target: str | os.PathLike[str]) -> Path:
    real = Path(os.path.realpath(target))
    if not real.parent.is_dir():
        raise SplitError(
            "the folder to write into does not exist", where=str(target), advice=f"Create {Path(target).parent}."
        )
    return real


def _refuse_what_is_no_file(target: Path, shown: str) -> None:
    if target.is_dir():
        raise SplitError("is a folder, a file was to be written", where=shown)
    if target.exists() and not target.is_file():
        raise SplitError("is not a regular file, it would be replaced by one", where=shown)


def _concerns(error: OSError, *output: Path) -> bool:
    """Tell an error of this output from one about another file, such as an input that vanished."""
    if error.filename is None:
        return True
    return any(Path(str(error.filename)).is_relative_to(path) for path in output)


def _not_written(error: OSError, shown: str) -> SplitError:
    return SplitError(
        f"cannot be written ({error.strerror or error}); what was there before is unchanged", where=shown
    )


def atomic_write_bytes(target: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `target`, whole or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(target: str | os.PathLike[str], content: str) -> None:
    """Write `content` as UTF-8 with line feeds to `target`, whole or not at all."""
    atomic_write_bytes(target, content.encode("utf-8"))


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
            with path.open("rb") as stream:
                return hashlib.file_digest(stream, "sha256").hexdigest()
        digest = hashlib.sha256()
        for part in sorted(entry for entry in path.rglob("*") if entry.is_file()):
            digest.update(f"{part.relative_to(path).as_posix()}\0{sha256_of_file(part)}\n".encode())
        return digest.hexdigest()
    except OSError as error:
        raise SplitError(f"cannot be read ({error.strerror or error})", where=str(path)) from error


def _flush_to_disk(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
