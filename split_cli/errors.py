"""The one family of errors a user may see. Imports nothing."""

from collections.abc import Iterable
from difflib import get_close_matches
from pathlib import Path
from typing import Any

__all__ = [
    "OUR_FAULT",
    "ClockError",
    "DriveError",
    "ExportError",
    "LogError",
    "MapError",
    "NumericalRepairWarning",
    "SetError",
    "SplitError",
    "VehicleError",
    "damaged",
    "nearest_names",
    "printable",
    "reason_of",
    "spreadsheet_text",
]


#: Characters of an error at most [1], and of its end that stay; judgement: a screen.
_MOST_CHARACTERS, _KEPT_END = 2000, 400


def shortened(text: str) -> str:
    """Return text without its middle where a name in it fills more than a screen."""
    if len(text) <= _MOST_CHARACTERS:
        return text
    gap = " [...] "
    return f"{text[: _MOST_CHARACTERS - _KEPT_END - len(gap)]}{gap}{text[-_KEPT_END:]}"


#: Advice where a check of the program's own work fails.
OUR_FAULT = "This is a fault of the program: please report it, with the vehicle file and the set."


class SplitError(Exception):
    """Something in the input is at fault; the text says what, where and what to do.

    The command line prints it as one line on stderr and leaves with exit code 1.

    Parameters
    ----------
    what : str
        What is wrong, with the offending value.
    where : str, optional
        File, topic, column, row or key.
    advice : str, optional
        What the reader can do about it.
    """

    def __init__(self, what: str, *, where: str | None = None, advice: str | None = None) -> None:
        self.what = what
        self.where = where
        self.advice = advice
        text = f"{where}: {what}" if where else what
        if advice:
            text = f"{text.rstrip('.')}. {advice}"
        # One line on stderr, whatever a library's message or a file's name brought along.
        super().__init__(shortened(printable(" ".join(text.split("\n")))))

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild from the parts: worker processes send errors back pickled."""
        return _rebuild, (type(self), self.what, self.where, self.advice)


def _rebuild(kind: type[SplitError], what: str, where: str | None, advice: str | None) -> SplitError:
    return kind(what, where=where, advice=advice)


class LogError(SplitError):
    """A recording cannot be read or holds nothing usable."""


class NoTableError(LogError):
    """A text holds no rows of numbers."""


class NoRecordingError(LogError):
    """A folder holds no recording that is read as a whole."""


class ClockError(LogError):
    """The time of a recording is in another unit than it is taken in."""

    unit = ""
    """The unit that it is probably in; empty where it travelled between processes."""


class MapError(SplitError):
    """A signal map is malformed or names channels the recording does not have."""


class DriveError(SplitError):
    """A canonical drive is malformed or lacks what a step needs."""


class VehicleError(SplitError):
    """A vehicle file is malformed, incomplete or physically impossible."""


class SetError(SplitError):
    """A trained set is malformed, of another version, or of another vehicle."""


class ExportError(SplitError):
    """An export failed or its self-check against Python did."""


class NumericalRepairWarning(UserWarning):
    """A bounded numerical repair (jitter) was needed; said each time."""


def printable(text: str) -> str:
    """Return text that a terminal only shows: control characters, separators and directions as their codes.

    Examples
    --------
    >>> printable("lap\x1b[31m")
    'lap\\x1b[31m'
    """
    if text.isprintable():
        return text
    unfit = [c for c in set(text) if not c.isprintable()]
    return text.translate({ord(c): f"\\x{ord(c):02x}" if ord(c) < 256 else f"\\u{ord(c):04x}" for c in unfit})


def reason_of(error: BaseException) -> str:
    """Return the first line of what a library's error says, 160 characters at most; its kind if it has none."""
    return next(iter(str(error).splitlines()), "")[:160] or type(error).__name__


def damaged(path: Path, error: BaseException, advice: str) -> LogError:
    """Return the error of a recording that a format's library cannot read to its end."""
    return LogError(f"is cut off or damaged ({reason_of(error)})", where=path.name, advice=advice)


def spreadsheet_text(text: str) -> str:
    """Return a name for a CSV file, such that a spreadsheet takes it for text and not for a formula.

    Examples
    --------
    >>> spreadsheet_text("=1+1")
    "'=1+1"
    """
    text = printable(text)
    return f"'{text}" if text[:1] in ("=", "+", "-", "@") else text


def nearest_names(name: str, known: Iterable[str]) -> str:
    """Return ``Did you mean a, b?`` with at most three known names nearest to `name`, or else what there is.

    Parameters
    ----------
    name : str
        What the user wrote.
    known : iterable of str
        What exists.
    """
    known = sorted(set(known))
    close = get_close_matches(name, known, cutoff=0.4)
    if not close:
        lowered = {candidate.lower(): candidate for candidate in known}
        close = [lowered[hit] for hit in get_close_matches(name.lower(), list(lowered), cutoff=0.4)]
    if close:
        return f"Did you mean {', '.join(close)}?"
    if not known:
        return "There are none."
    shown = ", ".join(known[:12])
    more = f" and {len(known) - 12} more" if len(known) > 12 else ""
    return f"There are: {shown}{more}."
