"""Measurement files of vehicle buses (ASAM MDF 3 and 4, MF4), through asammdf (extra ``mf4``)."""

import io
import logging
import re
import weakref
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, redirect_stdout, suppress
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError, damaged
from split_cli.files import ScratchFolder, refuse_no_regular_file
from split_cli.logs.raw import LazyTableRecording, RawChannelInfo, RawRecording, RawSignal, ReadNote, note_once
from split_cli.logs.readers.probe import probe
from split_cli.logs.scratch import set_aside
from split_cli.signals import symbol_of

_TEXT_3, _TEXT_4 = range(7, 9), range(6, 15)
"""Data types of MDF 3 and 4 that are no numbers: texts, bytes, and dates of CANopen."""
_BUS_EVENT = re.compile(r"(CAN|LIN|FLX|ETH|MOST|K_LINE)_\w*(Frame|Error|Event|Symbol|PDU)\b")


def list_samples(path: Path) -> None:
    """Read every channel of an MDF file and keep nothing: what `probe` does in a process of its own."""
    from asammdf import MDF

    with _without_prints():
        file = MDF(path, raise_on_multiple_occurrences=False)
        for group, index in _places(file).values():
            try:
                file.get(group=group, index=index)
            except MemoryError:
                raise
            except Exception:  # told when the channel is read; here it only must not end the process
                continue


def open_mf4(path: Path, databases: Sequence[Path] = ()) -> RawRecording:
    """Open an MDF file. Every channel has the clock of its group, from the start of the measurement.

    A name that occurs in several groups is addressed as ``group.name``, with the group's name or number. Frames
    of a CAN bus are decoded with `databases`.

    Raises
    ------
    LogError
        If asammdf is not installed, the file is damaged or empty, or holds nothing but frames and no database is
        given.
    """
    try:
        import asammdf  # noqa: F401
    except ImportError as error:
        what = "is an MDF file, which needs asammdf"
        raise LogError(what, where=path.name, advice="pip install 'split-cli[mf4]'") from error
    for database in databases:
        refuse_no_regular_file(database, LogError)
        if not database.is_file():
            advice = "Give the DBC file of the bus that was recorded."
            raise LogError("no such CAN database", where=str(database), advice=advice)
    probe(path, list_samples)
    # asammdf copies a file that its logger did not close, and never removes the copy of a damaged one.
    with ExitStack() as open_files:
        copies = open_files.enter_context(ScratchFolder())
        recording = _open_within(path, databases, str(copies), open_files)
        weakref.finalize(recording, open_files.pop_all().close)
        return recording


def _open_within(path: Path, databases: Sequence[Path], copies: str, open_files: ExitStack) -> LazyTableRecording:
    """Open an MDF file with its temporary files in a folder; `open_files` closes what was opened."""
    from asammdf import MDF

    try:
        with _without_prints():
            file = MDF(path, raise_on_multiple_occurrences=False, temporary_folder=copies)
            open_files.callback(file.close)
            if databases:
                file = file.extract_bus_logging({"CAN": [(str(database), 0) for database in databases]})
                open_files.callback(file.close)
            places = _places(file)
    except Exception as error:  # asammdf passes on whatever damaged blocks lead to
        _mark_closed(error)
        raise damaged(path, error, "Record it again.") from error
    if not places:
        what = "holds no frame of a message that the database defines" if databases else "holds no channel"
        raise LogError(what, where=path.name, advice="Is it the file, and the DBC, of this drive?")
    # By the bus-logging standard frames and events of a bus are groups of these names.
    frames = [n for n in places if _BUS_EVENT.match(n)]
    if any(n.startswith("CAN_") for n in frames) and not databases and 2 * len(frames) >= len(places):
        advice = "Give it with --dbc FILE.dbc."
        raise LogError("holds CAN frames: what they mean stands in a DBC file", where=path.name, advice=advice)
    infos = []
    for name, (group, index) in places.items():
        rows, unit = file.groups[group].channel_group.cycles_nr, file.get_channel_unit(group=group, index=index)
        kind = "text" if _is_text(file, group, index) else "mdf"
        infos.append(RawChannelInfo(name, kind, int(rows), symbol_of(unit)))
    if not any(info.count for info in infos):
        raise LogError("holds no samples", where=path.name, advice="Export it again.")
    notes: list[ReadNote] = []
    units = {info.name: info.unit for info in infos}

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        clocks: dict[int, np.ndarray] = {}
        with _without_prints():
            return {name: _signal(file, path, name, places[name], units[name], notes, clocks) for name in names}

    return LazyTableRecording(path.name, path, infos, load, notes=notes, own_clocks=True)


def _signal(
    file: Any,
    path: Path,
    name: str,
    place: tuple[int, int],
    unit: str | None,
    notes: list[ReadNote],
    clocks: dict[int, np.ndarray],
) -> RawSignal:
    """Return a channel; those of one group share the clock that `clocks` holds for it."""
    group, index = place
    try:
        found = file.get(group=group, index=index, ignore_invalidation_bits=True)
        values = found.samples
        if values.dtype.kind not in "biuf":
            # A conversion to text hides the number that was recorded.
            values = file.get(group=group, index=index, raw=True, ignore_invalidation_bits=True).samples
            what = "values with names, read as the numbers behind them"
            note_once(notes, what, f"{path.name}, {name}", len(values))
    except Exception as error:  # see open_mf4
        raise damaged(path, error, "Record it again.") from error
    if values.dtype.kind not in "biuf" or values.ndim != 1:
        advice = "Map another channel; `split ingest LOG --list` shows all."
        raise LogError(f"channel {name!r} holds no numbers", where=path.name, advice=advice)
    values = np.array(values, dtype=np.float64)
    if found.invalidation_bits is not None:
        invalid = np.asarray(found.invalidation_bits, dtype=bool)
        values[invalid] = np.nan
        if invalid.any():
            note_once(notes, "samples marked invalid, read as missing", f"{path.name}, {name}", int(invalid.sum()))
    if group not in clocks:
        clocks[group] = set_aside(np.array(found.timestamps, dtype=np.float64))
    return RawSignal(name, clocks[group], set_aside(values), unit)


def _places(file: Any) -> dict[str, tuple[int, int]]:
    """Return group and index of every channel that is not a clock."""
    channels = []
    for number, group in enumerate(file.groups):
        master = file.masters_db.get(number)
        label = (getattr(group.channel_group, "acq_name", None) or f"group{number}").strip()
        for index, channel in enumerate(group.channels):
            whole_array = bool(getattr(group, "channel_dependencies", None) and group.channel_dependencies[index])
            if index != master and channel.name and not whole_array:  # its elements are channels too
                channels.append((channel.name, label, number, index))
    names = Counter(name for name, *_ in channels)
    places: dict[str, tuple[int, int]] = {}
    for name, label, number, index in channels:
        address = name if names[name] == 1 else f"{label}.{name}"
        places[address if address not in places else f"group{number}.{name}"] = (number, index)
    return places


def _is_text(file: Any, group: int, index: int) -> bool:
    """Whether a channel is recorded as text or as bytes; a number with names for its values is none."""
    kinds = _TEXT_4 if file.version >= "4" else _TEXT_3
    return file.groups[group].channels[index].data_type in kinds


@contextmanager
def _without_prints() -> Iterator[None]:
    """Keep what asammdf prints about damaged blocks off standard output, which belongs to results."""
    logger = logging.getLogger("asammdf")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with redirect_stdout(io.StringIO()):
            yield
    finally:
        logger.setLevel(level)


def _mark_closed(error: Exception) -> None:
    """Close the half-opened file in `error`; it would print a traceback of its own when it is collected."""
    frame = error.__traceback__
    while frame is not None:
        half_open = frame.tb_frame.f_locals.get("self")
        if hasattr(half_open, "_closed"):
            half_open._closed = True
            with suppress(AttributeError, OSError):
                half_open._tempfile.close()
        frame = frame.tb_next
