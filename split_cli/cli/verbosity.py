"""Verbosity of stderr (--quiet, --verbose) and progress bars with the time that remains."""

from __future__ import annotations

import io
import re
import sys
import threading
import time
from collections.abc import Callable, Iterable, Mapping
from typing import BinaryIO, TextIO

import click

from split_cli.errors import printable

_WIDTH = 20
#: Between lines that tell how far a long run is where no terminal shows it, as in a pipe or the log of a job [s];
#: judgement: a run of seconds leaves no line, and nobody takes a run of minutes for a dead one.
SILENCE = 20.0
_COUNT = re.compile(r"\[(\d+)/(\d+)\] *")
#: What of our own lines is news of a run that went well.
_NEWS = ("note:", "report in", "figures in", "not drawn:")


#: Takes the line of progress away: the one thing of ours that is no text.
_WIPE = "\r\x1b[K"
_TEXT = re.compile(r"[^\n\t]+")


class Shown(io.TextIOBase):
    """A stream whose text a terminal only shows: names of files, topics and vehicles are others' text."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def write(self, text: str) -> int:
        wipe = _WIPE if text.startswith(_WIPE) else ""
        self._stream.write(wipe + _TEXT.sub(lambda found: printable(found[0]), text[len(wipe) :]))
        return len(text)

    def flush(self) -> None:
        self._stream.flush()

    def isatty(self) -> bool:
        return self._stream.isatty()

    def fileno(self) -> int:
        return self._stream.fileno()

    @property
    def buffer(self) -> BinaryIO:
        """What bytes are written to that are no text, as the answers to a shell's completion."""
        return self._stream.buffer

    @property
    def encoding(self) -> str:  # type: ignore[override]
        return self._stream.encoding

    @property
    def errors(self) -> str | None:  # type: ignore[override]
        return self._stream.errors


def show_only() -> None:
    """Let stdout and stderr pass text and no control of the terminal from now on."""
    for name in ("stdout", "stderr"):
        stream = getattr(sys, name)
        if not isinstance(stream, Shown):
            setattr(sys, name, Shown(stream))


class Quiet(Shown):
    """A stderr that lets through what is wrong and nothing else; no terminal, so that no progress is drawn."""

    _line = ""

    def write(self, text: str) -> int:
        self._line += text
        while "\n" in self._line:
            line, self._line = self._line.split("\n", 1)
            said = line.removeprefix("split: ")
            if said != line and not said.startswith(_NEWS) or line.startswith(("Usage:", "Error:", "Try ")):
                self._stream.write(f"{line}\n")
        return len(text)

    def isatty(self) -> bool:
        return False


class Loud(Shown):
    """A stderr on which every step is printed, though nobody may watch it: for logs of long runs."""

    def isatty(self) -> bool:
        return True


def print_notes(notes: Iterable[str]) -> None:
    """Print a line on stderr for each note. Of a warning it is a line that --quiet lets through."""
    for text in notes:
        click.echo(note_line(text), err=True)


def note_line(text: str) -> str:
    """Return the line of a note, or of a warning, whose text begins with that word."""
    return f"split: {text}" if text.startswith("WARNING") else f"note: {text}"


def is_watched() -> bool:
    """Return whether someone watches stderr, who is shown every step."""
    return sys.stderr.isatty()


class StepBar:
    """Progress of steps on stderr: a bar, a count and the time that remains.

    On a terminal it is one line, drawn anew each second and with every step; for ``--verbose`` a line a step.
    In a pipe or a file it is a line every 20 s, so that a run of seconds leaves none.

    Parameters
    ----------
    total : int, optional
        Steps there will be; a text that begins with ``[3/7]`` says so itself.
    shares : mapping of str to float, optional
        Text of a step to the share of the whole time at which it begins [1], where steps take unequal times.
    clock : callable
        Gives the time [s].
    """

    def __init__(
        self, total: int = 0, shares: Mapping[str, float] | None = None, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._total, self._done, self._now, self._begin = total, 0, clock, clock()
        self._shares, self._share, self.text = shares or {}, 0.0, ""
        self._watched = is_watched()
        self._in_place = self._watched and not isinstance(sys.stderr, Loud)
        self._drawn, self._counted_from = (0, 0), (0.0, 0.0)  # the step and the steps that are shown
        self._reached = (0.0, 0.0)  # the last share that differed from the one before, and when [s]
        self._over = threading.Event()
        self._drawing = threading.Lock()
        self._clock: threading.Thread | None = None

    def __enter__(self) -> StepBar:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def __call__(self, text: str) -> None:
        """Tell that a step begins."""
        counted = _COUNT.match(text)
        if counted:
            self._recount(int(counted[1]) - 1, int(counted[2]))
            text = text[counted.end() :]
        self._share = max(self._share, self._shares.get(text, 0.0))
        self.text = text
        self._draw()
        self._done += 1

    def count(self, done: int, total: int) -> None:
        """Tell how many of `total` are done."""
        self._recount(done, total)
        self._draw(begun=False)

    def note(self, text: str) -> None:
        """Print a note that stays, above the bar."""
        self.say(note_line(text))

    def say(self, text: str) -> None:
        """Print a line that stays, above the bar."""
        with self._drawing:
            self._wipe()
            click.echo(text, err=True)

    def _line(self) -> str:
        """Return what is shown now."""
        text, elapsed, (step, total) = self.text, self._now() - self._begin, self._drawn
        share, reached = self._reached
        spent, gone = self._counted_from
        if not total or not (self._total or self._shares):
            return f"{elapsed:5.0f} s  {text}"
        filled = round(_WIDTH * share)
        # As foreseen when the last step ended: one that takes longer than that foresees nothing.
        whole = (reached - spent) / (share - gone) if share > gone else 0.0
        foreseen = whole * (1.0 - share) - (elapsed - reached)
        left = f", about {_span(foreseen)} left" if foreseen > 0.0 and share < 1.0 else ""
        count = "" if self._shares else f" {step}/{total}"
        return f"{'█' * filled}{'░' * (_WIDTH - filled)}{count}  {_span(elapsed)}{left}  {text}"

    def close(self) -> None:
        """Take the line away."""
        self._over.set()
        with self._drawing:
            self._wipe()

    def _recount(self, done: int, total: int) -> None:
        """Take a count; one that begins anew says nothing of the time before it."""
        if done == 0 and (total != self._total or self._done > 1):
            self._counted_from = (self._now() - self._begin, 0.0)
        self._done, self._total = done, total

    def _draw(self, begun: bool = True) -> None:
        with self._drawing:
            step = self._done + begun
            total = max(self._total, step)
            self._drawn = (step, total)
            share = self._share if self._shares else self._done / total if total else 0.0
            if share != self._reached[0]:
                self._reached = (share, self._now() - self._begin)
            if self._watched:
                self._show()
        if self._clock is None and not self._over.is_set():
            self._clock = threading.Thread(target=self._tick, daemon=True)
            self._clock.start()

    def _show(self) -> None:
        click.echo(f"{_WIPE}{self._line()}" if self._in_place else self._line(), err=True, nl=not self._in_place)

    def _tick(self) -> None:
        """Show the time anew, between steps as well."""
        while not self._over.wait(1.0 if self._in_place else SILENCE):
            with self._drawing:
                if not self._over.is_set():
                    self._show()

    def _wipe(self) -> None:
        if self._in_place:
            click.echo(_WIPE, err=True, nl=False)


def _span(seconds: float) -> str:
    """Return a duration as one says it."""
    if seconds < 90.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 5400.0 else f"{seconds / 3600.0:.1f} h"
