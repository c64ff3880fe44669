"""ASCII exports of Pi Toolbox (Cosworth): one block for all channels, or a block for each with its own clock."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from split_cli.errors import LogError
from split_cli.logs.raw import RawRecording, RawSignal, ReadNote, TableRecording, column_name_and_unit
from split_cli.signals import find_unit

__all__ = ["is_pi_toolbox", "open_pi_toolbox"]

_BLOCK = "{channelblock}"


def is_pi_toolbox(head: bytes) -> bool:
    """Tell an export by its first word."""
    return head.removeprefix(b"\xef\xbb\xbf").startswith(b"PiToolbox")


def open_pi_toolbox(path: Path) -> RawRecording:
    """Open an export. The first column of a block is its time; a name that occurs twice is numbered.

    Raises
    ------
    LogError
        If no block holds a row of numbers.
    """
    raw = path.read_bytes()
    try:
        text = raw.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = raw.decode("cp1252", errors="replace")
    notes: list[ReadNote] = []
    signals: dict[str, RawSignal] = {}
    blocks = _blocks(text.splitlines())
    for titles, rows in blocks:
        values, bad = _values(rows, len(titles))
        if bad:
            notes.append(ReadNote("rows with too few or too many cells, or no numbers, left out", path.name, bad))
        if not len(values):
            continue
        clock, unit = column_name_and_unit(titles[0])
        known = find_unit(unit or "s")
        time = values[:, 0] * (known.factor if known is not None and known.si == "s" else 1.0)
        if len(blocks) == 1:
            signals[clock] = RawSignal(clock, None, time, "s")
        for place, title in enumerate(titles[1:], 1):
            name, unit = column_name_and_unit(title)
            name = name or f"column{place + 1}"
            unique = next(n for n in (name, *(f"{name}_{k}" for k in range(2, 10_000))) if n not in signals)
            known = find_unit(unit) if unit else None
            signals[unique] = RawSignal(
                unique, None if len(blocks) == 1 else time, values[:, place], known.symbol if known else unit
            )
    if not signals:
        raise LogError("holds no rows of numbers", where=path.name, advice="Export the outing again.")
    return TableRecording(path.name, path, signals, notes=notes)


def _blocks(lines: list[str]) -> list[tuple[list[str], list[str]]]:
    """Return titles and rows of every block."""
    found: list[tuple[list[str], list[str]]] = []
    inside = False
    for line in lines:
        if line.startswith("{"):
            inside = line.strip().lower() == _BLOCK
            if inside:
                found.append(([], []))
        elif inside and line.strip():
            titles, rows = found[-1]
            if titles:
                rows.append(line)
            else:
                titles += [title.strip() for title in line.rstrip("\r\n").split("\t")]
    return [(titles, rows) for titles, rows in found if len(titles) > 1]


def _values(rows: list[str], width: int) -> tuple[np.ndarray, int]:
    """Return the values, shape (N, width), and how many rows are none; an empty cell is missing."""
    good, bad = [], 0
    for row in rows:
        cells = row.replace(",", ".").split("\t")[:width]
        try:
            # Python takes 1_5 for 15; no logger writes that.
            numbers = [float(cell) if cell.strip() else np.nan for cell in cells] if "_" not in row else []
        except ValueError:
            numbers = []
        if len(numbers) == width and np.isfinite(numbers[0]):
            good.append(numbers)
        else:
            bad += 1
    return np.array(good, dtype=float).reshape(len(good), width), bad
