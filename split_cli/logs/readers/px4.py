"""Logs of PX4 (ULog, .ulg), through pyulog (extra ``px4``)."""

from pathlib import Path

from split_cli.logs.raw import RawRecording, ReadNote
from split_cli.logs.readers.apart import ColumnApart, TableApart, open_apart, write_table

ULOG_MAGIC = b"ULog\x01\x12\x35"
_CLOCK = "timestamp"
_TICK = 1e-6
"""Of the log's clock [s]."""


def open_ulog(path: Path) -> RawRecording:
    """Open a log of PX4: ``topic.field``, each topic with its clock, in seconds since the autopilot started.

    Topics of the second and further sensors of a kind are numbered: ``sensor_accel_1.x``.

    Raises
    ------
    LogError
        If pyulog is not installed, or the file is damaged or holds no messages.
    """
    return open_apart(path, hand_over_ulog, "pyulog", "a log of PX4", "px4")


def hand_over_ulog(path: Path, folder: str) -> None:
    """Read a log and write its columns: what a process of its own does."""
    write_table(path, folder, _read)


def _read(path: Path) -> TableApart:
    from pyulog import ULog

    log = ULog(str(path), disable_str_exceptions=True)
    columns = []
    for topic in log.data_list:
        called = f"{topic.name}_{topic.multi_id}" if topic.multi_id else topic.name
        time = topic.data[_CLOCK] * _TICK
        for name, values in topic.data.items():
            # Lists of characters are texts.
            if name != _CLOCK and values.dtype.kind in "biuf":
                columns.append(ColumnApart(f"{called}.{name}", "", time, values))
    notes = []
    if log.file_corruption:
        notes.append(ReadNote("the log is damaged: what is no message was skipped", path.name))
    if log.dropouts:
        notes.append(ReadNote("times when the autopilot could not write", path.name, len(log.dropouts)))
    return TableApart(columns, notes)
