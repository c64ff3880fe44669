"""Rows of several topics or sensors in one list of objects: each gets its own columns, and a common stamp."""

import re
from collections.abc import Iterable, Iterator, Sequence
from typing import Any

_TOPICS = ("topic", "channel", "type", "msg_type", "message_type", "stream", "sensor", "source")
"""Keys that say which sensor or topic a row is of, as `mcap cat --json` writes them."""
_OF_TIME = re.compile(r"(?i)t|ts|(.*_)?(time|timestamp|stamp)(_.*)?|seconds_elapsed|elapsed\w*|epoch\w*|date(time)?")
"""Keys beside those of a topic that tell when a row was written."""


def key_of_topics(rows: Sequence[dict[str, Any]]) -> str:
    """Return the key that says of which topic a row is, where rows of several topics need columns of their own.

    They do where rows hold objects, and where two topics have a key in common, as the x of two sensors is.
    """
    for key in _TOPICS:
        topics = [row.get(key) for row in rows]
        words = {topic for topic in topics if isinstance(topic, str)}
        if not 1 < len(words) < len(rows) or not all(isinstance(topic, str) for topic in topics):
            continue
        nested = any(isinstance(value, dict) for row in rows for value in row.values())
        if nested or _have_keys_in_common(rows, key):
            return key
    return ""


def _have_keys_in_common(rows: Sequence[dict[str, Any]], key: str) -> bool:
    """Whether rows of different topics have different keys, and one of them in common beside those of time."""
    keys: dict[str, set[str]] = {}
    for row in rows:
        own = {name for name in row if name != key and not _OF_TIME.fullmatch(name)}
        keys.setdefault(row[key], set()).update(own)
    every, common = set.union(*keys.values()), set.intersection(*keys.values())
    shared = any(sum(name in own for own in keys.values()) > 1 for name in every)
    return shared and (common != every or bool(every & set("xyz")))


def rows_by_topic(rows: Iterable[dict[str, Any]], key: str) -> Iterator[dict[str, Any]]:
    """Yield rows with what they hold under the name of their topic: two sensors may send alike messages.

    The stamp of a message's header is that of its row, under the same name for all topics.
    """
    stamped: dict[str, Any] = {}
    for row in rows:
        topic = re.sub(r"[/.]+", ".", str(row.get(key) or "")).strip(".")
        inside = {name: value for name, value in row.items() if isinstance(value, dict)}
        if not topic:
            yield row
            continue
        if not inside:
            timed = {name: value for name, value in row.items() if _OF_TIME.fullmatch(name)}
            yield {**timed, topic: {n: v for n, v in row.items() if n not in timed and n != key}}
            continue
        plain = {name: value for name, value in row.items() if name not in inside}
        content = next(iter(inside.values())) if len(inside) == 1 else inside
        header = content.get("header")
        stamp = header.get("stamp") if isinstance(header, dict) else None
        if isinstance(stamp, dict) and not any(_OF_TIME.fullmatch(name) for name in plain):
            stamped = {"stamp": stamp}
        # A message without a header was sent about when the one before it was.
        yield {**stamped, **plain, topic: content}
