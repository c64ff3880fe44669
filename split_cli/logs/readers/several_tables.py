"""Tables inside one file, each with its clock: sheets of a workbook, lists of a JSON document."""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, seconds_a_tick, time_column
from split_cli.logs.readers.joint import rising_in_seconds

_FEWEST_ROWS = 20
"""Of a table that is a log [1]; judgement: a sheet about the car has fewer."""


def joined_tables(path: Path, tables: Mapping[str, RawRecording]) -> RawRecording | None:
    """Return the channels of tables that each have a column of time; None unless two or more have one.

    A name that occurs in two tables is addressed as ``table.name``. Tables without a time are left out, and named.
    """
    read: dict[str, tuple[np.ndarray, list[RawSignal]]] = {}
    notes: list[ReadNote] = []
    for name, table in tables.items():
        infos = [info for info in table.channels() if info.type_name != "text"]
        clock = time_column(infos) or rising_in_seconds(table, infos)
        if clock is None:
            continue
        signals = table.read([info.name for info in infos])
        ticks = signals[clock.name].values
        time = ticks * seconds_a_tick(ticks, clock.unit)
        if np.count_nonzero(np.isfinite(time)) >= _FEWEST_ROWS:
            own = [s for s in signals.values() if s.name != clock.name and np.isfinite(s.values).any()]
            read[name] = time, own
            notes += table.notes
    if len(read) < 2:
        return None
    left = [name for name in tables if name not in read]
    if left:
        notes.append(
            ReadNote(f"tables without a column of time, left out: {', '.join(left[:3])}", path.name, len(left))
        )
    counts = Counter(signal.name for _, own in read.values() for signal in own)
    joined = {}
    for table, (time, own) in read.items():
        for signal in own:
            name = signal.name if counts[signal.name] == 1 else f"{table}.{signal.name}"
            joined[name] = RawSignal(name, time, signal.values, signal.unit)
    return TableRecording(path.name, path, joined, notes=notes)
