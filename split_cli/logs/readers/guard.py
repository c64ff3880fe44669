"""Between a reader and the rest: what a damaged file makes a library raise, and what names do to a terminal."""

import os
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, TypeVar

from split_cli.errors import LogError, SplitError, printable
from split_cli.logs.raw import Clock, RawChannelInfo, RawRecording, RawSignal, ReadNote

_T = TypeVar("_T")


def guarded(path: Path, step: Callable[[], _T]) -> _T:
    """Run one step of reading; whatever a format's library raises becomes an error of the recording.

    These libraries were written for sound files: on damaged or hostile ones they raise anything from KeyError to
    RecursionError. None of that is known to be a fault of the file, so the type is reported with it.

    Raises
    ------
    LogError
    """
    try:
        return step()
    except SplitError:
        raise
    except OSError as error:
        reason = error.strerror or error
        raise LogError(f"cannot be read ({reason})", where=str(path), advice="Copy it again.") from error
    except MemoryError as error:
        raise LogError(
            "needs more memory than there is", where=path.name, advice="Cut the recording into pieces."
        ) from error
    except Exception as error:
        if os.environ.get("SPLIT_TRACEBACK"):
            raise
        reason = str(error).splitlines()[0][:160] if str(error) else "no reason given"
        what = f"is damaged, or not as its format demands ({type(error).__name__}: {reason})"
        advice = "Save or record it again; set SPLIT_TRACEBACK=1 to see where reading stopped."
        raise LogError(what, where=path.name, advice=advice) from error


def _printable(info: RawChannelInfo) -> RawChannelInfo:
    texts = {"name": info.name, "type_name": info.type_name, "unit": info.unit or ""}
    shown = {field: printable(text) for field, text in texts.items() if not text.isprintable()}
    return replace(info, **shown) if shown else info


class GuardedRecording:
    """A recording whose names can be printed and whose reader fails with `LogError` only; see `RawRecording`.

    Control characters in the names of topics and columns are shown, and addressed, by their codes.
    """

    def __init__(self, inner: RawRecording) -> None:
        self._inner = inner
        self._real: dict[str, str] = {}
        self.name = printable(inner.name)
        self.path, self.origin = inner.path, inner.origin
        # Which clocks there are stands in the definitions: to tell is reading.
        self.clocks = guarded(inner.path, lambda: inner.clocks)

    @property
    def notes(self) -> list[ReadNote]:
        """What reading had to leave out so far."""
        return self._inner.notes

    def __getattr__(self, name: str) -> Any:
        return getattr(self._inner, name)

    def channels(self) -> list[RawChannelInfo]:
        """Return every addressable channel; see `Recording.channels`."""
        found = guarded(self.path, self._inner.channels)
        self._real = {shown: info.name for info in found if (shown := printable(info.name)) != info.name}
        return [_printable(info) for info in found]

    def element_counts(self) -> dict[str, int]:
        """Return how many elements arrays have, by address, where not all are listed."""
        return guarded(self.path, getattr(self._inner, "element_counts", dict))

    def read(self, names: Sequence[str], clock: Clock | None = None) -> dict[str, RawSignal]:
        """Return the named signals; see `Recording.read`."""
        real = [self._real.get(name, name) for name in names]
        found = guarded(self.path, lambda: self._inner.read(real, clock))
        if real == list(names):
            return found
        return {shown: replace(found[name], name=shown) for shown, name in zip(names, real, strict=True)}
