"""Compilation with types kept, and where compiled code is kept between runs, in a read-only container as well.

Imports numba when asked to compile, and nothing else.
"""

import os
import stat
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping
from types import FrameType
from typing import Any, TypeVar

Function = TypeVar("Function", bound=Callable[..., Any])

_VARIABLE, _FIGURES = "NUMBA_CACHE_DIR", "MPLCONFIGDIR"


def compiled(**options: Any) -> Callable[[Function], Function]:
    """Return `numba.njit` with options, the type of what it decorates kept: numba says nothing of types."""
    from numba import njit

    decorator: Callable[[Function], Function] = njit(**options)
    return decorator


def send_again(number: int) -> None:
    """Send this process a signal once more, a moment later."""
    threading.Timer(0.01, os.kill, (os.getpid(), number)).start()


def postponed_by_compiled_code(number: int, frame: FrameType | None) -> bool:
    """Send a signal once more where compiled code that returns arrays has called what runs in a frame.

    Numba then restores the arrays' type and does not look whether that failed: an exception raised there, as by a
    signal that came while the code ran, would end the process in a segmentation fault.
    """
    while frame is not None and frame.f_code.co_name != "_numba_unpickle":
        frame = frame.f_back
    if frame is not None:
        send_again(number)
    return frame is not None


def provide_cache(package: str, environment: Mapping[str, str] | None = None) -> str | None:
    """Choose a folder for numba's compiled code where its two usual ones cannot be written.

    Numba keeps compiled code beside the source, else in the user's cache folder; where neither can be written,
    as in a read-only container, it fails at import. Then a private folder below the temporary one is taken.
    Matplotlib keeps its list of fonts in the home folder, and warns at each start where it cannot; it gets a part
    of the same private folder.

    Parameters
    ----------
    package : str
        Folder of this package's source.
    environment : mapping of str to str, optional
        Instead of the process's.

    Returns
    -------
    str or None
        What to tell the user, when another folder than usual had to be taken.
    """
    environment = os.environ if environment is None else environment
    _place_fonts(environment)
    usual = (os.path.join(package, "__pycache__"), _user_cache(environment))
    if environment.get(_VARIABLE) or any(map(_can_hold_folders, usual)):
        return None
    folder = cache_folder()
    if folder is None:
        return (
            f"no folder can be written for compiled code; set {_VARIABLE} to one that can, or commands that "
            "compute will fail"
        )
    os.environ[_VARIABLE] = folder
    return f"compiled code is kept in {folder}: neither the installation nor the home folder can be written"


def _place_fonts(environment: Mapping[str, str]) -> None:
    """Give matplotlib a private folder for its list of fonts where the user's own cannot be written."""
    home = os.path.expanduser("~")
    usual = environment.get("XDG_CONFIG_HOME") or os.path.join(home, ".config"), _user_cache(environment)
    if environment.get(_FIGURES) or all(map(_can_hold_folders, usual)):
        return
    folder = cache_folder()
    if folder is not None:
        os.environ[_FIGURES] = os.path.join(folder, "matplotlib")
        os.makedirs(os.environ[_FIGURES], mode=0o700, exist_ok=True)


def cache_folder() -> str | None:
    """Return a folder below the temporary one that belongs to this user alone, or None.

    Compiled code is executed, so a folder that another user owns or may write to is never taken.
    """
    try:
        folder = os.path.join(tempfile.gettempdir(), f"split-compiled-{os.getuid()}")
        os.makedirs(folder, mode=0o700, exist_ok=True)
        found = os.lstat(folder)
        private = stat.S_ISDIR(found.st_mode) and found.st_uid == os.getuid() and not found.st_mode & 0o077
        return folder if private else tempfile.mkdtemp(prefix="split-compiled-")
    except (OSError, AttributeError):
        return None


def _user_cache(environment: Mapping[str, str]) -> str:
    if sys.platform == "darwin":
        return os.path.join(os.path.expanduser("~"), "Library", "Caches")
    if sys.platform == "win32":
        return environment.get("LOCALAPPDATA", os.path.expanduser("~"))
    return environment.get("XDG_CACHE_HOME") or os.path.join(os.path.expanduser("~"), ".cache")


def _can_hold_folders(path: str) -> bool:
    """Tell whether folders can be made in `path`, or in the nearest folder above it that exists."""
    while not os.path.isdir(path):
        above = os.path.dirname(path)
        if above == path:
            return False
        path = above
    return os.access(path, os.W_OK | os.X_OK)
