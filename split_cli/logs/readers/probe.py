"""A first reading in a process of its own, for formats whose compiled reader can end the process it runs in."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from split_cli.errors import LogError
from split_cli.files import ScratchFolder

__all__ = ["probe"]

_LEAST_MEMORY = 2 << 30
"""Address space of the probe [bytes]; judgement: its imports take 1 GB of addresses, a file of 100 MB another."""
_MEMORY_A_BYTE = 20
"""More addresses for each byte of the file [1]; judgement: samples of 16 bits become two doubles, some copied."""
_LONGEST_SECONDS = 60.0
_SECONDS_A_MEGABYTE = 2.0
_ADVICE = "Save it again with the logger's own tool."
_CODE = """
import importlib, pathlib, resource, sys
most = int(sys.argv[2])
resource.setrlimit(resource.RLIMIT_AS, (most, most))
getattr(importlib.import_module(sys.argv[3]), sys.argv[4])(pathlib.Path(sys.argv[1]))
"""


def probe(path: Path, read: Callable[[Path], object]) -> None:
    """Read a file once in another process, with bounds on its memory and time, and throw away what it gave.

    A damaged file can make compiled code follow a wrong pointer or take all memory; then only the probe dies. What
    is merely wrong with a file is left for the reader to tell.

    Parameters
    ----------
    path : Path
    read : callable
        A function of a module.

    Raises
    ------
    LogError
        If the probe died, ran out of memory or did not end.
    """
    size = path.stat().st_size
    package = str(Path(__file__).resolve().parents[3])
    paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    command = [sys.executable, "-c", _CODE, str(path.resolve()), str(_LEAST_MEMORY + _MEMORY_A_BYTE * size)]
    command += [read.__module__, read.__name__]
    try:
        # asammdf unfolds into files in the temporary folder: a probe that is killed leaves none behind.
        with ScratchFolder() as scratch:
            own = {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(scratch)}
            done = subprocess.run(
                command,
                capture_output=True,
                timeout=_LONGEST_SECONDS + _SECONDS_A_MEGABYTE * size / 1e6,
                env={**os.environ, **own},
                check=False,
            )
    except subprocess.TimeoutExpired as error:
        raise LogError("is damaged: reading it does not end", where=path.name, advice=_ADVICE) from error
    if done.returncode < 0 or b"MemoryError" in done.stderr:
        died = done.returncode < 0
        what = "ends the program that reads it" if died else "takes more memory than its size allows"
        raise LogError(f"is damaged: it {what}", where=path.name, advice=_ADVICE)
