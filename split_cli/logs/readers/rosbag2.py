"""Recordings of rosbag2: folders (SQLite or MCAP, split or not), bare ``.db3`` and compressed files."""

import re
import sqlite3
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import quote

import yaml
import zstandard

from split_cli.errors import LogError, NoRecordingError, SplitError
from split_cli.files import ScratchFolder, read_text, refuse_no_regular_file
from split_cli.logs.budget import most_bytes_out
from split_cli.logs.raw import ReadNote, note_once
from split_cli.logs.readers.mcap import McapContainer
from split_cli.logs.readers.messages import Container, MessageBatch, Stream, in_batches
from split_cli.logs.readers.unpacking import unpacked_file
from split_cli.yaml_file import parse_yaml

_LARGEST_METADATA = 16 << 20
"""Of metadata.yaml [bytes]; judgement: one file of a thousand parts and a thousand topics has 1 MB."""
_SMALL_FILE = 64 << 20
"""What a value of any file may have [bytes]; judgement, as for a chunk."""
_LARGEST_VALUE = 1_000_000_000  # SQLite's own [bytes]
FREE_STEPS, _STEPS_A_BYTE, _STEPS_AT_ONCE = 1_000_000, 4, 10_000
"""Steps of SQLite's machine that a query may take [1], and for a byte of the file; judgement: a message takes 12
steps and 20 bytes at least. A bound of work holds on a busy disk, too, where one of time refuses sound files."""
_STORAGE_SUFFIXES = (".mcap", ".db3", ".mcap.zstd", ".db3.zstd")


class SqliteContainer:
    """A rosbag2 database; see `Container`. It knows log times only.

    Raises
    ------
    LogError
        If it is no rosbag2 database, or no message in it can be read.
    """

    has_publish_times = False

    def __init__(self, path: Path) -> None:
        self.path = path
        self.notes: list[ReadNote] = []
        # A killed recorder leaves its last messages in the write-ahead log, which an immutable opening ignores.
        pending = path.with_name(path.name + "-wal").exists()
        uri = f"file:{quote(str(path.absolute()))}?mode=ro" + ("" if pending else "&immutable=1")
        try:
            self._database = sqlite3.connect(uri, uri=True)
            self._refuse_what_no_recorder_writes()
            self.streams = self._read_streams()
            # Rows with other times are left out, and counted, when they are read.
            query = "SELECT MIN(timestamp) FROM messages WHERE typeof(timestamp) = 'integer' AND timestamp >= 0"
            first = self._database.execute(query).fetchone()[0]
        except sqlite3.Error as error:
            what = f"is damaged, or no rosbag2 database ({error})"
            raise LogError(what, where=path.name, advice="Record it again.") from error
        if not isinstance(first, int):
            raise LogError("holds no message", where=path.name, advice="Record it again.")
        self.origin = first

    def _refuse_what_no_recorder_writes(self) -> None:
        """Demand tables with values of their own, since others may go on for ever, and bound work and sizes."""
        pending = self.path.with_name(self.path.name + "-wal")
        size = self.path.stat().st_size + (pending.stat().st_size if pending.exists() else 0)
        self._most_steps = FREE_STEPS + _STEPS_A_BYTE * size
        self._begin()
        self._database.set_progress_handler(self._goes_on_for_ever, _STEPS_AT_ONCE)
        # No message is larger than the file it lies in; one that is computed may be.
        self._database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, max(_SMALL_FILE, min(size, _LARGEST_VALUE)))
        names = ("messages", "topics", "message_definitions")
        query = f"SELECT name, type, sql FROM sqlite_master WHERE name IN {names}"
        for name, kind, made in self._database.execute(query).fetchall():
            computed = kind == "table" and any(row[6] for row in self._database.execute(f"PRAGMA table_xinfo({name})"))
            if kind != "table" or computed or re.match(r"\s*CREATE\s+VIRTUAL", str(made), re.IGNORECASE):
                what = "computed" if kind == "table" else f"a {kind}, not a table"
                advice = "Give a .db3 that `ros2 bag record` wrote."
                raise LogError(f"is no rosbag2 database ({name} is {what})", where=self.path.name, advice=advice)

    def _begin(self) -> None:
        self._steps = 0

    def _goes_on_for_ever(self) -> bool:
        self._steps += _STEPS_AT_ONCE
        return self._steps > self._most_steps

    def _read_streams(self) -> list[Stream]:
        def query(text: str) -> sqlite3.Cursor:
            self._begin()
            return self._database.execute(text)

        definitions: dict[str, tuple[str, bytes]] = {}
        if query("SELECT 1 FROM sqlite_master WHERE name = 'message_definitions'").fetchone():
            for type_name, encoding, text in query(
                "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
            ):
                definitions[str(type_name)] = (str(encoding), str(text).encode())
        counts = dict(query("SELECT topic_id, COUNT(*) FROM messages GROUP BY topic_id"))
        rows = query("SELECT id, name, type, serialization_format FROM topics ORDER BY id").fetchall()
        return [
            Stream(key, str(name), str(kind), str(encoding), *definitions.get(str(kind), ("", b"")), counts[key])
            for key, name, kind, encoding in rows
            if counts.get(key)
        ]

    def batches(self, keys: frozenset[int]) -> Iterator[MessageBatch]:
        """Yield the messages of the streams `keys`; see `Container.batches`."""
        chosen = ",".join(str(int(key)) for key in keys)
        try:
            self._begin()
            cursor = self._database.execute(
                f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({chosen})"
            )
            yield from in_batches(self._sound(cursor))
        except sqlite3.Error as error:
            note_once(self.notes, f"the database is damaged ({error}): read up to there", self.path.name)

    def _sound(self, rows: Iterable[tuple[Any, Any, Any]]) -> Iterator[tuple[int, int, int, bytes]]:
        """Yield stream, both times and payload of each message, and count the rows that hold none."""
        odd = 0
        try:
            for key, time, payload in rows:
                if isinstance(time, int) and time >= 0 and isinstance(payload, bytes):
                    yield key, time, time, payload
                else:
                    odd += 1
        finally:
            if odd:
                note_once(self.notes, "rows that hold no message, left out", self.path.name, odd)


class ConcatenatedContainer:
    """The files of a split recording, one after the other; see `Container`.

    Parameters
    ----------
    notes : list of ReadNote
        What was found before reading.
    packed : bool
        Whether every single message is compressed (zstd).
    temporary : ScratchFolder, optional
        Holds files that the parts read; it is removed with this container.
    """

    def __init__(
        self, parts: Sequence[Container], notes: list[ReadNote], packed: bool, temporary: ScratchFolder | None
    ) -> None:
        self._parts = parts
        self._packed = packed
        self._temporary = temporary
        self.origin = min(part.origin for part in parts)
        self.has_publish_times = all(part.has_publish_times for part in parts)
        self.notes = notes
        self.streams: list[Stream] = []
        self._keys: list[dict[int, int]] = []
        for part in parts:
            self._keys.append({stream.key: len(self.streams) + n for n, stream in enumerate(part.streams)})
            self.streams += [replace(stream, key=self._keys[-1][stream.key]) for stream in part.streams]
            self.notes += part.notes

    def batches(self, keys: frozenset[int]) -> Iterator[MessageBatch]:
        """Yield the messages of the streams `keys`; see `Container.batches`."""
        for part, own_keys in zip(self._parts, self._keys, strict=True):
            chosen = frozenset(own for own, key in own_keys.items() if key in keys)
            for batch in part.batches(chosen) if chosen else ():
                payloads = [_unpacked(payload) for payload in batch.payloads] if self._packed else batch.payloads
                yield replace(batch, key=own_keys[batch.key], payloads=payloads)
            for note in part.notes:
                note_once(self.notes, note.what, note.where, note.count)


def open_rosbag2_folder(path: Path) -> Container:
    """Open the files of a rosbag2 folder, in the order of its ``metadata.yaml`` or of their numbers.

    Raises
    ------
    LogError
        If there are none, or none of them can be read.
    """
    notes: list[ReadNote] = []
    files, packed = _listed_files(path, notes)
    return _opened(path, files, packed, notes)


def _opened(path: Path, files: Sequence[Path], packed: bool, notes: list[ReadNote]) -> Container:
    temporary: ScratchFolder | None = None
    parts: list[Container] = []
    problem: LogError | None = None
    for file in files:
        try:
            refuse_no_regular_file(file, LogError)
            if file.suffix == ".zstd":
                temporary = temporary or ScratchFolder()
                file = unpacked_file(file, temporary.path)
            parts.append(McapContainer(file) if file.suffix == ".mcap" else SqliteContainer(file))
        except LogError as error:
            problem = error
            note_once(notes, f"file left out: {error}", path.name)
    if not parts:
        advice = "Give the folder that holds metadata.yaml and the .db3 or .mcap, or name the file."
        raise problem or NoRecordingError("is a folder without a recording in it", where=str(path), advice=advice)
    return ConcatenatedContainer(parts, notes, packed, temporary)


def _listed_files(path: Path, notes: list[ReadNote]) -> tuple[list[Path], bool]:
    """Return the storage files of a folder, and whether their messages are compressed one by one."""
    metadata = path / "metadata.yaml"
    present = [file for file in path.iterdir() if file.name.endswith(_STORAGE_SUFFIXES)]
    present.sort(key=lambda file: [int(n) if n.isdigit() else n for n in re.split(r"(\d+)", file.name)])
    if not metadata.exists():
        if present:
            note_once(notes, "no metadata.yaml: files taken in the order of their numbers", path.name)
        return present, False
    try:
        described = parse_yaml(read_text(metadata, _LARGEST_METADATA))["rosbag2_bagfile_information"]
        # Each once: a list of a hundred thousand times one file would be opened as often.
        names = list(dict.fromkeys(Path(str(name)).name for name in described["relative_file_paths"]))
        mode = str(described.get("compression_mode") or "").lower()
    except (yaml.YAMLError, RecursionError, ValueError, KeyError, TypeError, AttributeError, SplitError) as error:
        note_once(notes, "metadata.yaml cannot be read: files taken in the order of their numbers", path.name)
        if not present:
            advice = "Put the .db3 or .mcap of the recording beside it."
            what = "cannot be read, and there is no storage file"
            raise LogError(what, where=str(metadata), advice=advice) from error
        return present, False
    missing = [name for name in names if not (path / name).exists()]
    if missing:
        note_once(notes, f"files of the recording that are missing: {', '.join(missing)}", path.name, len(missing))
    return [path / name for name in names if (path / name).exists()], mode == "message"


def _unpacked(payload: bytes) -> bytes:
    """Return a message decompressed; one that is damaged, empty, so that it counts as not fitting."""
    try:
        claimed = zstandard.frame_content_size(payload)
        if claimed > most_bytes_out(len(payload)):
            return b""
        return zstandard.ZstdDecompressor().decompress(payload, max_output_size=most_bytes_out(len(payload)))
    except (zstandard.ZstdError, MemoryError):
        return b""
