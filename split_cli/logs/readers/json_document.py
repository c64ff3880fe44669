"""A JSON document that is parsed as it is read: a list of any length takes the memory of a few of its elements."""

import gc
import io
import itertools
import json
import math
import re
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import Any

LONGEST_ELEMENT = 4 << 20
"""Of one row, or of one element of a list [bytes]; judgement: a row of a thousand numbers has 30 kB."""
PIECE = 1 << 20
_LONG_OBJECT = 1 << 16
"""From which on an object of a list is walked through [bytes]: a row of a thousand numbers has 30 kB."""
_BLANKS = re.compile(r"[ \t\r\n]*")
_ENDINGS = {"{": "},", "[": "],"}
_MOST_FAILURES = 8
"""To cut between elements [1]; where objects hold others, each costs as much as reading them one by one."""
_DECODER = json.JSONDecoder()


def parsed(text: bytes | str) -> Any:
    """Return what a text stands for; None of what is no JSON, is nested too deep or has endless numbers."""
    try:
        return json.loads(text.removeprefix(b"\xef\xbb\xbf") if isinstance(text, bytes) else text)
    except (ValueError, RecursionError):
        return None


def plain_number(value: Any) -> float:
    """Return a number, true and false as 1 and 0; NaN for anything else, and from 1e300 on."""
    return float(value) if isinstance(value, bool | int | float) and abs(value) < 1e300 else math.nan


def _parsed_at_once(text: str) -> Any:
    """Return what a long text stands for; meanwhile no garbage is looked for: a parser makes no cycles."""
    looked = gc.isenabled()
    gc.disable()
    try:
        return parsed(text)
    finally:
        if looked:
            gc.enable()


class JsonDocument:
    """The lists of a document that is a list, or an object that holds lists; parsed from the front to the end."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._text, self._at, self._unsplit, self._failed = "", 0, True, 0

    def lists(self) -> Iterator[tuple[str, Iterator[Any]]]:
        """Yield the key of each list (none of a document that is one) and its elements; see `items`."""
        for place, item in self.items(1):
            if isinstance(item, Iterator):
                yield "".join(place), item

    def items(self, deepest: int) -> Iterator[tuple[tuple[str, ...], Any]]:
        """Yield the keys that lead to each list, with its elements, and to what is no list, with its value.

        Objects inside others are walked through, `deepest` of them one in another, and so is a list of objects
        that are too long to be rows. Elements are to be taken before the next item.

        Raises
        ------
        ValueError
            Where the document stops to be JSON, or an element or value is longer than `LONGEST_ELEMENT`.
        RecursionError
            Where it is nested too deep.
        """
        with self._path.open("rb") as raw:
            self._stream = io.TextIOWrapper(raw, "utf-8-sig", errors="surrogatepass")
            self._text, self._at, self._failed = "", 0, 0
            yield from self._items((), deepest)

    def _items(self, place: tuple[str, ...], deepest: int) -> Iterator[tuple[tuple[str, ...], Any]]:
        begins = self._next()
        if begins == "[" and len(place) < deepest and self._holds_long_objects():
            yield from self._items_of_list(place, deepest)
            return
        if begins == "[":
            elements = self._elements()
            yield place, elements
            deque(elements, maxlen=0)  # what the caller did not want
            return
        if begins != "{" or len(place) >= deepest:
            yield place, self._value()
            return
        self._at += 1
        while self._next() == '"':
            key = str(self._value())
            self._take(":")
            yield from self._items((*place, key), deepest)
            if self._next() != ",":
                break
            self._at += 1
        if self._next() == "}":
            self._at += 1

    def _items_of_list(self, place: tuple[str, ...], deepest: int) -> Iterator[tuple[tuple[str, ...], Any]]:
        """Walk through the elements of a list, as ``[0]``, ``[1]`` among the keys."""
        self._at += 1
        for index in itertools.count():
            yield from self._items((*place, f"[{index}]"), deepest)
            if self._next() != ",":
                break
            self._at += 1
        self._take("]")

    def _holds_long_objects(self) -> bool:
        """Whether the list that begins here has a first element that is an object too long to be a row."""
        while len(self._text) - self._at < _LONG_OBJECT and self._read_on():
            pass
        begin = _BLANKS.match(self._text, self._at + 1).end()  # type: ignore[union-attr]
        if self._text[begin : begin + 1] != "{":
            return False
        try:
            _DECODER.raw_decode(self._text[: begin + _LONG_OBJECT], begin)
        except (ValueError, RecursionError):
            return len(self._text) - begin > _LONG_OBJECT
        return False

    def _elements(self) -> Iterator[Any]:
        self._at += 1
        if self._next() == "]":
            self._at += 1
            return
        while True:
            for batch in self._elements_at_once():
                yield from batch
            yield self._value()
            if self._next() != ",":
                self._take("]")
                return
            self._at += 1

    def _elements_at_once(self) -> Iterator[list[Any]]:
        """Yield what stands here up to the last comma that was read, where that ends an element.

        One by one they take up to ten times as long. What is cut at a comma within an element is no JSON.
        """
        while self._unsplit and self._failed < _MOST_FAILURES:
            self._unsplit = False
            ending = _ENDINGS.get(self._next(), ",")
            last = self._text.rfind(ending, self._at) + len(ending) - 1
            batch = _parsed_at_once(f"[{self._text[self._at : last]}]") if last > self._at else None
            if not batch:
                self._failed += 1
                return
            self._at = last + 1
            self._next()
            yield batch

    def _next(self) -> str:
        """Return the next character that is no blank, nothing at the end."""
        while True:
            self._at = _BLANKS.match(self._text, self._at).end()  # type: ignore[union-attr]
            if self._at < len(self._text):
                return self._text[self._at]
            if not self._read_on():
                return ""

    def _take(self, expected: str) -> None:
        if self._next() != expected:
            raise ValueError(f"{expected} expected")
        self._at += 1

    def _value(self) -> Any:
        self._next()
        while True:
            try:
                value, end = _DECODER.raw_decode(self._text, self._at)
            except ValueError:
                if len(self._text) - self._at > LONGEST_ELEMENT or not self._read_on():
                    raise
                continue
            # A number may go on in what was not read yet: 1 in 1.5 and in 1e+5.
            if end + len("e+") < len(self._text) or not self._read_on():
                self._at = end
                return value

    def _read_on(self) -> bool:
        part = self._stream.read(PIECE)
        if not part:
            return False
        self._text, self._at, self._unsplit = self._text[self._at :] + part, 0, True
        return True
