"""Logs of CAN frames (BLF, ASC, candump, TRC, tables, MF4 bus logging), decoded with a DBC (extra ``can``)."""

import logging
import re
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from split_cli.errors import LogError, damaged, reason_of
from split_cli.files import refuse_no_regular_file
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote
from split_cli.logs.readers.blf import is_cut_blf
from split_cli.logs.readers.frames_csv import frames_of, is_table_of_frames
from split_cli.logs.readers.frames_text import frames_in_lines, is_text_of_frames
from split_cli.logs.readers.probe import probe
from split_cli.logs.scratch import GrowingSignal, set_aside

DATABASE_SUFFIXES = (".dbc", ".kcd", ".sym", ".arxml")
_LONGEST_TEXT = 1000
"""Of what a database quotes [characters]; the longest names have 128."""
_CANDUMP = re.compile(rb"^\s*\(\d+\.\d+\)\s+\w+\s+[0-9A-Fa-f]{3,8}#", re.MULTILINE)
_ASC = re.compile(rb"^date .*\r?\n\s*base\s+(hex|dec)", re.MULTILINE)

_RELATIVE = re.compile(rb"^\s*base\s+(hex|dec)\s+timestamps\s+relative", re.MULTILINE)


def is_can_log(path: Path, head: bytes) -> bool:
    """Tell a log of CAN frames by its first bytes."""
    return _is_of_python_can(head) or is_table_of_frames(head) or is_text_of_frames(head)


def _is_of_python_can(head: bytes) -> bool:
    """Tell the forms that python-can reads."""
    return head.startswith((b"LOGG", b";$FILEVERSION")) or bool(_ASC.search(head)) or bool(_CANDUMP.match(head))


def load_database(path: Path) -> Any:
    """Return what cantools makes of one file; a message of a billion bytes would take it 8 GB."""
    import cantools

    kind = path.suffix.lower()
    if kind not in (".dbc", ".sym"):
        return cantools.database.load_file(str(path), strict=False)
    text = path.read_text(encoding="cp1252", errors="replace")
    return cantools.database.load_string(_with_short_texts(text), kind[1:], strict=False)


def _with_short_texts(text: str) -> str:
    """Return a database with no quoted text beyond `_LONGEST_TEXT`, for which cantools takes 250 times its length.

    Such are comments. A quotation mark within a text stands behind a backslash.
    """
    kept, begin = [], 0
    while (start := text.find('"', begin)) >= 0:
        end = text.find('"', start + 1)
        while end >= 0 and text[end - 1] == "\\":
            end = text.find('"', end + 1)
        end = len(text) if end < 0 else end
        kept.append(text[begin : min(end, start + 1 + _LONGEST_TEXT)].removesuffix("\\"))
        kept.append(text[end : end + 1])
        begin = end + 1
    return "".join([*kept, text[begin:]])


def read_databases(paths: Sequence[Path]) -> Any:
    """Read DBC files (or KCD, SYM, ARXML) into one cantools database.

    Raises
    ------
    LogError
        If cantools is not installed or a file cannot be read.
    """
    try:
        import cantools
    except ImportError as error:
        raise LogError("needs cantools", where=str(paths[0]), advice="pip install 'split-cli[can]'") from error
    database = cantools.database.Database(strict=False)
    for path in paths:
        try:
            refuse_no_regular_file(path, LogError)
            probe(path, load_database)
            database.messages.extend(load_database(path).messages)
        except LogError:
            raise
        except Exception as error:  # cantools has an error for each grammar
            advice = "Give a DBC, ARXML, KCD or SYM file, as the car's maker or a CAN tool saves it."
            what = f"cannot be read as a CAN database ({reason_of(error)})"
            raise LogError(what, where=str(path), advice=advice) from error
    database.refresh()
    return database


def open_can(path: Path, databases: Sequence[Path]) -> RawRecording:
    """Open a log of CAN frames; its signals are addressed as ``/Message/Signal`` and carry the database's units.

    Frames of ids that no database defines, and frames that do not fit their definition, are counted in the notes.

    Raises
    ------
    LogError
        If no database is given, python-can or cantools is not installed, or no frame can be decoded.
    """
    if not databases:
        advice = "Give it with --dbc FILE.dbc; it comes from the car's maker or from opendbc."
        raise LogError("holds CAN frames: what they mean stands in a DBC file", where=path.name, advice=advice)
    try:
        import can  # noqa: F401
    except ImportError as error:
        raise LogError("is a CAN log", where=path.name, advice="pip install 'split-cli[can]'") from error
    database = read_databases(databases)
    decoded, notes, ids, unfit = _decode(path, {message.frame_id: message for message in database.messages})
    if not decoded and unfit:
        known = ", ".join(name for name, _ in unfit.most_common(5))
        what = f"none of {sum(unfit.values())} frames fits its definition ({known})"
        raise LogError(what, where=path.name, advice="Is it the DBC of this car, and of this year's software?")
    if not decoded:
        seen = ", ".join(f"0x{i:X}" for i, _ in ids.most_common(5)) or "none"
        advice = f"Frames have the ids {seen}. Is it the DBC of this car and this bus?"
        raise LogError("no frame is of a message that the database defines", where=path.name, advice=advice)
    return _recording(path, database, decoded, notes)


def _decode(
    path: Path, by_id: Mapping[int, Any]
) -> tuple[dict[str, GrowingSignal], list[ReadNote], Counter[int], Counter[str]]:
    """Return signals, what was lost, and how many frames have ids of no message or do not fit their message."""
    decoded: dict[str, GrowingSignal] = {}
    unknown: Counter[int] = Counter()
    unfit: Counter[str] = Counter()
    lost = int(is_cut_blf(path))
    try:
        with _unread_lines() as unread, _frames(path) as reader:
            for frame in reader:
                if frame is None:
                    lost += 1
                elif frame.is_error_frame or frame.is_remote_frame:
                    continue
                elif frame.arbitration_id not in by_id:
                    unknown[frame.arbitration_id] += 1
                else:
                    _add(decoded, unfit, by_id[frame.arbitration_id], frame)
    except LogError:
        raise
    except Exception as error:  # python-can passes on what damaged blocks lead to
        if not decoded:
            raise damaged(path, error, "Record it again.") from error
        unfit["(the file is cut off or damaged here)"] += 1
    lost += unread.count
    notes = [
        ReadNote("frames that do not fit their definition", f"{path.name}, {name}", count)
        for name, count in unfit.items()
    ]
    if lost:
        notes.append(ReadNote("lines or blocks that are cut off or damaged", path.name, lost))
    if unknown:
        notes.append(ReadNote("frames of ids that no database defines", path.name, sum(unknown.values())))
    return decoded, notes, unknown, unfit


def _add(decoded: dict[str, GrowingSignal], unfit: Counter[str], message: Any, frame: Any) -> None:
    """Decode one frame into the signals, or count it as one that does not fit."""
    try:
        values = message.decode(bytes(frame.data), decode_choices=False, allow_truncated=True)
    except Exception:  # cantools: too short, a multiplexer without that value
        unfit[message.name] += 1
        return
    for signal, value in values.items():
        if isinstance(value, int | float):
            name = f"/{message.name}/{signal}"
            samples = decoded.get(name)
            if samples is None:
                samples = decoded[name] = GrowingSignal()
            samples.append(frame.timestamp, float(value))


@contextmanager
def _frames(path: Path) -> Iterator[Iterable[Any]]:
    """Open the frames of a log, by python-can where it knows the form."""
    import can

    with path.open("rb") as stream:
        head = stream.read(4096)
    if is_table_of_frames(head):
        yield frames_of(path)
        return
    if not _is_of_python_can(head) and is_text_of_frames(head):
        yield frames_in_lines(path)
        return
    with can.LogReader(str(path)) as reader:
        yield _since_the_first(reader) if _RELATIVE.search(head) else reader


def _since_the_first(frames: Iterable[Any]) -> Iterator[Any]:
    """Yield frames whose times count from the frame before with the sum of them."""
    time = 0.0
    for frame in frames:
        time += frame.timestamp
        frame.timestamp = time
        yield frame


class _Unread(logging.Handler):
    """What python-can says of lines that it passes over; it would print them as they stand in the file."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.count = 0

    def emit(self, record: logging.LogRecord) -> None:
        """Count one."""
        self.count += 1


@contextmanager
def _unread_lines() -> Iterator[_Unread]:
    logger, unread = logging.getLogger("can"), _Unread()
    propagates = logger.propagate
    logger.addHandler(unread)
    logger.propagate = False
    try:
        yield unread
    finally:
        logger.propagate = propagates
        logger.removeHandler(unread)


def _recording(path: Path, database: Any, decoded: dict[str, GrowingSignal], notes: list[ReadNote]) -> RawRecording:
    units = {f"/{m.name}/{s.name}": s.unit for m in database.messages for s in m.signals}
    origin = min(samples.first for samples in decoded.values())
    signals = {}
    for name, samples in decoded.items():
        time, values = samples.finished()
        signals[name] = RawSignal(name, set_aside(time - origin), values, units.get(name) or None)
    infos = [RawChannelInfo(name, "can", len(s.values), s.unit) for name, s in signals.items()]

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        return {name: signals[name] for name in names}

    return LazyTableRecording(path.name, path, infos, load, origin, ("log",), notes)
