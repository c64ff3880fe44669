"""What a command leaves on the disk when it is killed before any of its steps there.

A killed process leaves what the system holds at that moment. So one run tells of every kill: before each step that
changes the disk (a file opened for writing, a rename, a removal, an exchange of folders) its folder is copied.
Used by `tests.studies.kill`; ``python -m tests.studies.snapshots COPIES -1 ARGUMENTS`` copies the working folder
into COPIES before each step of ``split ARGUMENTS``, and a number instead of -1 kills it before that step.
"""

import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

_STEPS = frozenset({"os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "os.symlink", "os.truncate"})
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
ROOT = Path(__file__).parents[2]
_KILLED = -signal.SIGKILL


def leftovers_of_kills(folder: Path, arguments: Sequence[str], copies: Path, step: int = -1) -> list[Path]:
    """Run a command in `folder` and return what a kill before each of its steps leaves, the whole run last.

    Parameters
    ----------
    folder : Path
        Changed by the command. Its folder ``tmp`` serves as the system's for temporary files.
    arguments : sequence of str
        Of ``split``.
    copies : Path
        New folder that takes the copies.
    step : int
        Instead of copying, kill the command before this step; the list then holds `folder` alone.

    Raises
    ------
    RuntimeError
        If the command fails, or is not killed where it should be.
    """
    copies.mkdir()
    (folder / "tmp").mkdir(exist_ok=True)
    command = [sys.executable, "-m", "tests.studies.snapshots", str(copies), str(step), *arguments]
    paths = os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))
    environment = {**os.environ, "PYTHONPATH": paths, "TMPDIR": str(folder / "tmp")}
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, check=False)
    if done.returncode != (0 if step < 0 else _KILLED):
        raise RuntimeError(f"split {' '.join(arguments)}: exit {done.returncode}, {done.stderr[-500:].decode()}")
    return [*sorted(copies.iterdir()), folder]


def _seen(folder: Path) -> tuple:
    """Return what tells two states of a folder apart without reading its files."""
    found = []
    for place, folders, files in os.walk(folder):
        for name in (*folders, *files):
            told = os.lstat(os.path.join(place, name))
            size = 0 if name in folders else told.st_size
            found.append((os.path.join(place, name), told.st_ino, size, 0 if name in folders else told.st_mtime_ns))
    return tuple(sorted(found))


def _watch(copies: Path, kill_before: int) -> None:
    """Copy the working folder before each step that changes it, or end there."""
    folder, busy, steps, last = Path.cwd(), False, 0, ()

    def is_step(event: str, given: tuple) -> bool:
        if event == "ctypes.dlsym":
            return given[1] == "renameat2"
        if event == "open":
            writes = isinstance(given[2], int) and given[2] & _WRITING
            return bool(writes) and isinstance(given[0], str) and Path(given[0]).absolute().is_relative_to(folder)
        if event not in _STEPS:
            return False
        path = os.fspath(given[0])
        return isinstance(path, str) and Path(path).absolute().is_relative_to(folder)

    def hook(event: str, given: tuple) -> None:
        nonlocal busy, steps, last
        if busy or not is_step(event, given):
            return
        busy = True
        try:
            seen = _seen(folder)
            if seen != last:
                last = seen
                if steps == kill_before:
                    os.kill(os.getpid(), signal.SIGKILL)
                if kill_before < 0:
                    shutil.copytree(folder, copies / f"{steps:04}", symlinks=True)
                steps += 1
        finally:
            busy = False

    sys.addaudithook(hook)


if __name__ == "__main__":
    from split_cli.cli.main import main

    _watch(Path(sys.argv[1]), int(sys.argv[2]))
    main(sys.argv[3:])
