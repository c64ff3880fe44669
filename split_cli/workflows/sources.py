"""Where inputs are: files, folders, globs and addresses of other file systems (s3://, memory://, ...)."""

import contextlib
import glob
import hashlib
import os
import re
import shutil
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath, PurePosixPath
from typing import Any

from split_cli.errors import SplitError, reason_of
from split_cli.files import ScratchFolder, sha256_of_file
from split_cli.logs.readers.numpy_arrays import is_array_folder
from split_cli.logs.readers.opening import LOG_SUFFIXES, has_ending, is_log

DRIVE_SUFFIXES = (".parquet", ".pq", ".csv")
_COPY_BYTES = 1 << 22


@dataclass(frozen=True)
class SourceFile:
    """One input, wherever it is."""

    address: str  # path, or ``protocol://...``
    place: str  # its name below the folder that was asked for, with ``/``: ``lap.mcap``, ``monday/lap.mcap``

    @property
    def name(self) -> str:
        """File or folder name."""
        return PurePosixPath(self.place).name

    def in_its_folder(self, error: SplitError) -> SplitError:
        """Return an error with the file's place below the folder that was asked for: a thousand logs share names."""
        where = error.where or ""
        if not where.startswith(self.name) or self.place == self.name:
            return error
        return type(error)(error.what, where=self.place + where.removeprefix(self.name), advice=error.advice)

    def fingerprint(self) -> str:
        """Return what changes when the content does.

        The SHA-256 of a local file; of a remote one, what its file system tells (size, time, entity tag), so that
        nothing is downloaded to find out that nothing changed.
        """
        if not is_remote(self.address):
            return sha256_of_file(self.address)
        system, path = _system(self.address)
        with _in_one_line(self.address):
            info = system.info(path)
        known = {key.lower(): str(info[key]) for key in sorted(info) if key.lower() in _IDENTITY}
        if "etag" in known:  # times are finer in a listing than by the file itself
            known = {key: known[key] for key in ("etag", "size")}
        return "remote:" + hashlib.sha256(repr(known).encode()).hexdigest()

    @contextlib.contextmanager
    def local(self) -> Iterator[Path]:
        """Give a local path to the content; a remote file is copied for as long as the body runs."""
        if not is_remote(self.address):
            # Drives, sets and manifests name what they are made of, in UTF-8.
            if any("\ud800" <= letter <= "\udfff" for letter in self.address):
                raise SplitError("its name is no text in UTF-8", where=self.address, advice="Rename it.")
            yield Path(self.address)
            return
        system, path = _system(self.address)
        with ScratchFolder() as folder:
            target = folder / self.name
            with _in_one_line(self.address), system.open(path, "rb") as remote, target.open("wb") as copy:
                shutil.copyfileobj(remote, copy, _COPY_BYTES)
            try:
                yield target
            except SplitError as error:  # the copy is gone when its error is read
                texts = (error.what, error.where or "", error.advice or "")
                what, where, advice = (text.replace(str(target), self.address) for text in texts)
                raise type(error)(what, where=where or None, advice=advice or None) from error


_IDENTITY = {
    "size",
    "etag",
    "mtime",
    "lastmodified",
    "last_modified",
    "modified",
    "created",
    "generation",
    "version_id",
}


def is_remote(address: str | Path) -> bool:
    """Tell whether an address names another file system; ``file://`` does not count."""
    return bool(re.match(r"^[a-z][a-z0-9+.-]+:/", typed_address(address)))


def typed_address(address: str | Path) -> str:
    """Return an address as it was typed, or the path that a file:// one names.

    A Path has made one slash of two: s3:/bucket/lap.mcap.
    """
    path = re.sub(r"^file:/+", "/", str(address))
    return re.sub(r"^([a-z][a-z0-9+.-]+):/(?=[^/])", r"\1://", path)


def _system(address: str) -> tuple[Any, str]:
    try:
        import fsspec
    except ImportError as error:
        advice = "Install it with `pip install 'split-cli[cluster]'`."
        raise SplitError("needs the package fsspec", where=address, advice=advice) from error
    with _in_one_line(address):
        return fsspec.core.url_to_fs(typed_address(address))


@contextlib.contextmanager
def _in_one_line(address: str) -> Iterator[None]:
    """Turn what a file system raises into one line that names the address."""
    try:
        yield
    except SplitError:
        raise
    except FileNotFoundError as error:
        raise SplitError("does not exist", where=typed_address(address)) from error
    except Exception as error:  # each file system has errors of its own: credentials, network, permission
        reason = reason_of(error)
        raise SplitError(f"cannot be read ({reason})", where=typed_address(address)) from error


def find_sources(
    addresses: Sequence[str | Path],
    suffixes: Sequence[str] = LOG_SUFFIXES,
    *,
    what: str = "recording",
    outside: str | Path | None = None,
) -> list[SourceFile]:
    """Return the files that addresses stand for, each once, in the order given and then of their names.

    Parameters
    ----------
    addresses : sequence of path-like or str
        A file; a folder, for all files of known kinds in and below it; a glob such as ``logs/**/*.mcap``; or the
        address of any of these on a file system that fsspec knows. A rosbag2 folder is one recording.
    suffixes : sequence of str
        Kinds looked for in folders.
    what : str
        What such a file is called in errors.
    outside : path-like, optional
        A folder below the given ones whose files are left out: what an earlier run wrote there is no input.

    Raises
    ------
    SplitError
        If an address stands for nothing.
    """
    found: dict[str, SourceFile] = {}
    for address in addresses:
        text = typed_address(address)
        sources = _remote(text, suffixes) if is_remote(text) else _local(text, suffixes)
        if not sources:
            kinds = ", ".join(suffixes)
            glob_advice = " In a glob, [ begins a choice of letters: write [[] for the letter." if "[" in text else ""
            advice = f"Give a file or folder with {kinds}.{glob_advice}"
            raise SplitError(f"holds no {what}", where=text, advice=advice)
        for source in sources:
            if outside is not None and _is_below(source.address, outside) and not _is_below(text, outside):
                continue
            found.setdefault(_entry(source.address), source)
    return list(found.values())


@contextlib.contextmanager
def local_drives(addresses: Sequence[str | Path], failed: list[SplitError] | None = None) -> Iterator[list[Path]]:
    """Give paths to the drives that addresses stand for; remote ones are copied for as long as the body runs.

    Parameters
    ----------
    failed : list of SplitError, optional
        As for `enter_all`.

    Raises
    ------
    SplitError
        If an address stands for no drive.
    """
    with contextlib.ExitStack() as stack:
        yield enter_all(find_sources(addresses, DRIVE_SUFFIXES, what="drive"), stack, failed)


def enter_all(
    sources: Sequence[SourceFile], stack: contextlib.ExitStack, failed: list[SplitError] | None = None
) -> list[Path]:
    """Return local paths to sources, which stay for as long as the stack is open.

    Parameters
    ----------
    failed : list of SplitError, optional
        Takes the errors of sources that cannot be copied, which are left out; without it the first is raised. It is
        raised too if no source is left.
    """
    paths = []
    for source in sources:
        try:
            paths.append(stack.enter_context(source.local()))
        except SplitError as error:
            if failed is None:
                raise
            failed.append(error)
    if failed and not paths:
        raise failed[0]
    return paths


def _entry(address: str) -> str:
    """Return one name for every way to write the path of a file; a link is a name of its own."""
    folder, name = os.path.split(address)
    return address if is_remote(address) else os.path.join(os.path.realpath(folder), name)


def _is_below(address: str, folder: str | Path) -> bool:
    """Tell whether an address is a local file or folder below another folder, or that folder."""
    path = Path(os.path.realpath(address))
    return not is_remote(address) and path.is_relative_to(os.path.realpath(folder))


def skipped_files(addresses: Sequence[str | Path], outside: str | Path | None = None) -> dict[str, int]:
    """Return by file ending how many files in folders among `addresses` are no logs, so that `find_sources` skips them.

    Files below the folder `outside` are not counted.
    """
    counts: Counter[str] = Counter()
    for address in addresses:
        text = typed_address(address)
        if is_remote(text):
            system, path = _system(text)
            with _in_one_line(text):
                below = system.find(path) if not glob.has_magic(path) and system.isdir(path) else []
            others = [name for name in below if not _is_taken(name, LOG_SUFFIXES)]
            places = [PurePosixPath(name.removeprefix(path).lstrip("/")) for name in others]
        else:
            folder = Path(text)
            below = [p for p in _files_below(folder) if outside is None or not _is_below(str(p), outside)]
            places = [p.relative_to(folder) for p in below if not is_log(p, LOG_SUFFIXES)]
        counts.update(place.suffix.lower() or "no ending" for place in places if not _hidden(place))
    return dict(counts.most_common())


def _files_below(folder: Path) -> Iterator[Path]:
    if folder.is_dir() and not _is_closed(folder) and not _is_bag(folder):
        for entry in folder.iterdir():
            if not entry.is_dir():
                yield entry
            elif not entry.is_symlink():
                yield from _files_below(entry)


def _local(text: str, suffixes: Sequence[str]) -> list[SourceFile]:
    path = Path(text)
    if path.is_dir() and not _is_bag(path):
        return _in_folder(path, path, suffixes)
    if not path.exists() and glob.has_magic(str(path)):
        base = _folder_before_wildcards(path)
        hits = sorted(base.glob(_pattern_below(path, base))) if base.is_dir() else []
        found: list[SourceFile] = []  # a broken link, too: it is reported
        for hit in (hit for hit in hits if not _hidden(hit.relative_to(base))):
            if not hit.is_dir() or _is_closed(hit) or _is_bag(hit):
                found.append(SourceFile(str(hit), _place(hit, base)))
            elif not (hit.is_symlink() and "**" in path.parts):
                found += _in_folder(hit, base, suffixes)
        return found
    return [SourceFile(str(path), path.name or str(path))]


def _pattern_below(path: Path, base: Path) -> str:
    """Return the part of a glob below a folder, as `Path.glob` takes it.

    That follows no link for ``**``: two links of a folder to itself are as many paths as 2 to the 40th.
    """
    parts = path.parts[len(base.parts) :]
    parts = tuple(part if part == "**" else re.sub(r"\*{2,}", "*", part) for part in parts)
    return "/".join((*parts, "*") if parts[-1] == "**" else parts)


def _folder_before_wildcards(path: Path) -> Path:
    """Return the longest leading folder of a glob that exists or has no wildcard; names may hold a ``[``."""
    return next(folder for folder in (*path.parents, Path()) if folder.is_dir() or not glob.has_magic(str(folder)))


def _in_folder(folder: Path, base: Path, suffixes: Sequence[str]) -> list[SourceFile]:
    found: list[SourceFile] = []
    for entry in sorted(folder.iterdir()):
        if entry.name.startswith("."):
            continue
        if entry.is_dir():
            if _is_closed(entry) or _is_bag(entry):
                found.append(SourceFile(str(entry), _place(entry, base)))
            elif not entry.is_symlink():
                found += _in_folder(entry, base, suffixes)
        elif is_log(entry, suffixes):
            found.append(SourceFile(str(entry), _place(entry, base)))
    return found


def _place(path: Path, base: Path) -> str:
    return path.relative_to(base).as_posix() if path.is_relative_to(base) else path.name


def _hidden(path: PurePath) -> bool:
    return any(part.startswith(".") for part in path.parts)


def _is_closed(folder: Path) -> bool:
    """Tell a folder that may not be read: one recording that cannot be read, for whoever goes on without it."""
    return not os.access(folder, os.R_OK | os.X_OK)


def _is_bag(path: Path) -> bool:
    """Tell a folder that is one recording: a rosbag2 folder, or one with a file for each array.

    A rosbag2 folder has metadata, or its recordings are the numbered parts of one database.
    """
    if not path.is_dir() or (path / "metadata.yaml").is_file():
        return path.is_dir()
    shown = (entry for entry in path.iterdir() if not entry.name.startswith("."))
    logs = [entry for entry in shown if is_log(entry, LOG_SUFFIXES)]
    parts = {re.sub(r"(_\d+)?\.db3(\.zstd)?$", "", log.name.lower()) for log in logs}
    if any(log.suffix.lower() != ".txt" for log in logs):
        return len(parts) == 1 and all(log.name.lower().endswith((".db3", ".db3.zstd")) for log in logs)
    return is_array_folder(path)


def _is_taken(name: str, suffixes: Sequence[str]) -> bool:
    """Tell a file of another file system by its name; what an archive holds would have to be looked at."""
    return has_ending(name, suffixes) and not name.lower().endswith(".zip")


def _remote(text: str, suffixes: Sequence[str]) -> list[SourceFile]:
    system, path = _system(text)
    with _in_one_line(text):
        if glob.has_magic(path):
            kinds = {hit: about["type"] for hit, about in system.glob(path, detail=True).items()}
            base = re.split(r"[*?\[]", path, maxsplit=1)[0].rpartition("/")[0]
        else:
            kinds = {path: "directory" if system.isdir(path) else "file"}
            base = path if kinds[path] == "directory" else path.rpartition("/")[0]
        hits = {hit for hit, kind in kinds.items() if kind != "directory"}
        folders = set(kinds) - hits
        hits |= {f for one in folders for f in system.find(one) if _is_taken(f, suffixes)}
    sources = []
    for hit in sorted(hits):
        place = hit.removeprefix(base).lstrip("/")
        if not _hidden(PurePosixPath(place)):
            sources.append(SourceFile(system.unstrip_protocol(hit), place or PurePosixPath(hit).name))
    return sources
