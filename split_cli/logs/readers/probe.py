"""A first reading in a process of its own, for formats whose compiled reader can end the process it runs in."""

import math
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

from split_cli.errors import LogError
from split_cli.files import ScratchFolder

_LEAST_MEMORY = 768 << 20
"""Memory of the probe [bytes]; judgement: its imports take 200 MB."""
_MEMORY_A_BYTE = 20
"""More memory for each byte of the file [1]; judgement: samples of 16 bits become two doubles, some copied."""
_LONGEST_SECONDS = 10
_SECONDS_A_MEGABYTE = 2.0
"""Of processor time [s]; judgement: imports take 1 to 3 s, a megabyte of a CAN database 1 s."""
_CLOCK_SECONDS = 6.0
"""On the clock for each second of processor time [1]: other programs may be running."""
_WITHOUT_MEMORY = (b"MemoryError", b"SystemError")
_ADVICE = "Save it again with the logger's own tool."
_CODE = """
import importlib, pathlib, resource, sys
for limit, most in ((resource.RLIMIT_DATA, int(sys.argv[2])), (resource.RLIMIT_CPU, int(sys.argv[3]))):
    resource.setrlimit(limit, (most, most))
getattr(importlib.import_module(sys.argv[4]), sys.argv[5])(pathlib.Path(sys.argv[1]), *sys.argv[6:])
"""


def probe(path: Path, read: Callable[..., object], *more: str) -> None:
    """Read a file once in another process, with bounds on its memory and time, and throw away what it gave.

    A damaged file can make compiled code follow a wrong pointer or take all memory; then only the probe dies. What
    is merely wrong with a file is left for the reader to tell.

    Parameters
    ----------
    read : callable
        A function of a module.
    *more : str
        What it is given behind the path.

    Raises
    ------
    LogError
        If the probe died, ran out of memory or did not end.
    """
    size = path.stat().st_size
    package = str(Path(__file__).resolve().parents[3])
    paths = os.pathsep.join(filter(None, (package, os.environ.get("PYTHONPATH"))))
    seconds = math.ceil(_LONGEST_SECONDS + _SECONDS_A_MEGABYTE * size / 1e6)
    limits = [str(_LEAST_MEMORY + _MEMORY_A_BYTE * size), str(seconds)]
    command = [sys.executable, "-c", _CODE, str(path.absolute()), *limits, read.__module__, read.__name__, *more]
    try:
        # asammdf unfolds into files in the temporary folder: a probe that is killed leaves none behind.
        with ScratchFolder() as scratch:
            own = {"PYTHONPATH": paths, "OPENBLAS_NUM_THREADS": "1", "TMPDIR": str(scratch)}
            done = subprocess.run(
                command, capture_output=True, timeout=_CLOCK_SECONDS * seconds, env={**os.environ, **own}, check=False
            )
    except subprocess.TimeoutExpired as error:  # it used less processor time than it may
        what = f"was not read within {error.timeout:.0f} s: the processor is busy, or the disk is slow"
        raise LogError(what, where=path.name, advice="Try again when less runs beside it.") from error
    if -done.returncode in (signal.SIGXCPU, signal.SIGKILL):  # at the limit of processor time, soft and hard
        raise LogError("is damaged: reading it does not end", where=path.name, advice=_ADVICE)
    if done.returncode < 0 or any(name in done.stderr for name in _WITHOUT_MEMORY):
        died = done.returncode < 0
        what = "ends the program that reads it" if died else "takes more memory than its size allows"
        raise LogError(f"is damaged: it {what}", where=path.name, advice=_ADVICE)
