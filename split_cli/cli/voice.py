"""How much is said on stderr, and progress: a bar, a count and the time that remains."""

from __future__ import annotations

import io
import re
import sys
import time
from typing import TextIO

import click

__all__ = ["Loud", "Quiet", "StepBar"]

_WIDTH = 20
_COUNT = re.compile(r"\[(\d+)/(\d+)\] *")
#: What of our own lines is news of a run that went well.
_NEWS = ("note:", "report in", "figures in", "not drawn:")


class Quiet(io.TextIOBase):
    """A stderr that lets through what is wrong and nothing else; no terminal, so that no progress is drawn."""

    def __init__(self, stream: TextIO) -> None:
        self._stream, self._line = stream, ""

    def write(self, text: str) -> int:
        self._line += text
        while "\n" in self._line:
            line, self._line = self._line.split("\n", 1)
            said = line.removeprefix("split: ")
            if said != line and not said.startswith(_NEWS) or line.startswith(("Usage:", "Error:", "Try ")):
                self._stream.write(f"{line}\n")
        return len(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return False


class Loud(io.TextIOBase):
    """A stderr that is told every step, though nobody may watch it: for logs of long runs."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        return self._stream.write(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return True


class StepBar:
    """Progress of steps on stderr: one line that is drawn anew, where someone watches.

    Parameters
    ----------
    total : int, optional
        Steps there will be; a text that begins with ``[3/7]`` says so itself.
    """

    def __init__(self, total: int = 0) -> None:
        self._total, self._done, self._begin = total, 0, time.monotonic()
        self._watched = sys.stderr.isatty()
        self._in_place = self._watched and not isinstance(sys.stderr, Loud)

    def __call__(self, text: str) -> None:
        """Tell that a step begins."""
        counted = _COUNT.match(text)
        if counted:
            self._done, self._total, text = int(counted[1]) - 1, int(counted[2]), text[counted.end() :]
        if self._watched:
            line = self.line(text, time.monotonic() - self._begin)
            click.echo(f"\r\x1b[K{line}" if self._in_place else line, err=True, nl=not self._in_place)
        self._done += 1

    def line(self, text: str, elapsed: float) -> str:
        """Return what is shown after `elapsed` seconds, as step `text` begins."""
        done, total = self._done, max(self._total, self._done + 1)
        if not self._total:
            return f"{elapsed:5.0f} s  {text}"
        filled = round(_WIDTH * done / total)
        left = f", about {_span(elapsed / done * (total - done))} left" if done else ""
        return f"{'█' * filled}{'░' * (_WIDTH - filled)} {done + 1}/{total}  {_span(elapsed)}{left}  {text}"

    def close(self) -> None:
        """Take the line away."""
        if self._in_place:
            click.echo("\r\x1b[K", err=True, nl=False)


def _span(seconds: float) -> str:
    """Return a duration as one says it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
