"""Writing files whole or not at all, and naming their content. Imports only `errors`."""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path

from split_cli.errors import SplitError

__all__ = ["atomic_directory", "atomic_path", "atomic_write_bytes", "atomic_write_text", "sha256_of_file"]


@contextlib.contextmanager
def atomic_path(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `target`; rename it onto `target` when the body ends well.

    A body that raises, or a process that dies, leaves the old file as it was. The rename is atomic
    because the temporary file lives in the same directory.

    Raises
    ------
    SplitError
        If the directory does not exist or cannot be written, or the disk is full.
    """
    target = Path(target)
    parent = target.parent if str(target.parent) else Path(".")
    if not parent.is_dir():
        raise SplitError("the folder to write into does not exist", where=str(target), advice=f"Create {parent}.")
    if target.is_dir():
        raise SplitError("is a folder, a file was to be written", where=str(target))
    temporary: Path | None = None
    try:
        handle, name = tempfile.mkstemp(prefix=f".{target.name}.", suffix=".part", dir=parent)
        os.close(handle)
        temporary = Path(name)
        yield temporary
        _flush_to_disk(temporary)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, target)
        temporary = None
    except OSError as error:
        # Errors of the operating system about *other* files (an input that vanished) pass through.
        if error.filename is None or temporary is None or Path(str(error.filename)) == temporary:
            raise SplitError(
                f"cannot be written ({error.strerror or error}); what was there before is unchanged",
                where=str(target),
            ) from error
        raise
    finally:
        if temporary is not None:
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def atomic_directory(target: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary folder beside `target`; its files replace those in `target` when all went well.

    Files of other names already in `target` stay. Every file is moved by an atomic rename.
    """
    target = Path(target)
    if target.exists() and not target.is_dir():
        raise SplitError("is a file, a folder was to be written", where=str(target))
    if not target.parent.is_dir():
        raise SplitError(
            "the folder to write into does not exist", where=str(target), advice=f"Create {target.parent}."
        )
    try:
        temporary = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".part", dir=target.parent))
    except OSError as error:
        raise SplitError(f"cannot be written ({error.strerror or error})", where=str(target)) from error
    try:
        yield temporary
        for path in sorted(temporary.rglob("*")):
            if path.is_file():
                _flush_to_disk(path)
                destination = target / path.relative_to(temporary)
                destination.parent.mkdir(parents=True, exist_ok=True)
                os.replace(path, destination)
    except OSError as error:
        raise SplitError(
            f"cannot be written ({error.strerror or error})", where=str(target), advice="Is the disk full?"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def atomic_write_bytes(target: str | os.PathLike[str], content: bytes) -> None:
    """Write `content` to `target`, whole or not at all."""
    with atomic_path(target) as temporary:
        temporary.write_bytes(content)


def atomic_write_text(target: str | os.PathLike[str], content: str) -> None:
    """Write `content` as UTF-8 with line feeds to `target`, whole or not at all."""
    atomic_write_bytes(target, content.encode("utf-8"))


def sha256_of_file(path: str | os.PathLike[str]) -> str:
    """Return the SHA-256 of a file's content, as 64 hexadecimal digits; a folder's files in name order."""
    path = Path(path)
    digest = hashlib.sha256()
    parts = sorted(p for p in path.rglob("*") if p.is_file()) if path.is_dir() else [path]
    for part in parts:
        if path.is_dir():
            digest.update(str(part.relative_to(path)).encode())
        with part.open("rb") as stream:
            while block := stream.read(1 << 20):
                digest.update(block)
    return digest.hexdigest()


def _flush_to_disk(path: Path) -> None:
    with path.open("rb") as stream:
        os.fsync(stream.fileno())


def _umask() -> int:
    current = os.umask(0)
    os.umask(current)
    return current
