"""Delimited text: plain CSV, and logger exports with preambles, unit rows and decimal commas."""

import io
import re
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from split_cli.errors import LogError, reason_of
from split_cli.logs.budget import refuse_many_columns
from split_cli.logs.raw import (
    LazyTableRecording,
    RawChannelInfo,
    RawRecording,
    RawSignal,
    ReadNote,
    UniqueNames,
    Words,
    note_once,
    split_stamps,
)
from split_cli.logs.readers.cells import number_of, seconds_of, with_halves
from split_cli.logs.readers.clock_of_day import counted_clock, falls_within_seconds, packed_clock, spread_over_seconds
from split_cli.logs.readers.column_clocks import clocks_of_columns, with_clock
from split_cli.logs.readers.coordinates import columns_in_cells, in_degrees, of_both, of_cells, parts_of_angles
from split_cli.logs.readers.dialect import (
    EMPTY_CELLS,
    Dialect,
    Sniffed,
    is_grouped,
    quantity_of,
    sniff,
    split_line,
    unwrapped,
)
from split_cli.logs.readers.on_change import held_on_change
from split_cli.logs.readers.scaling import by_factor
from split_cli.logs.scratch import GrowingColumn
from split_cli.signals import split_name_and_unit, symbol_of

#: What is parsed at once [bytes]; with 4 MB a plain file takes a tenth more processor time. A row must fit into
#: it, so a wide table gets as much for each column: the widest that is read has 4 MB.
_BLOCK_BYTES, _BLOCK_BYTES_A_COLUMN = 1 << 20, 200
TABLE_BYTES = 1 << 24
"""What threads parse together [bytes]; judgement: blocks for all of them, and little of a long text in memory."""
#: What is looked through at once [bytes]: it stays in the processor's cache.
_LOOKED_AT_BYTES = 1 << 18


FIRST_UNTITLED = "column1"
"""What the first column is called where others have titles and it has none."""
_CALLED_CLOCK = re.compile(r"time|clock|utc|stamp|zeit|heure|hora", re.IGNORECASE)
_CALLED_COORDINATE = re.compile(r"lat|lon|lng|breite|l(ä|ae)nge", re.IGNORECASE)
_Columns = tuple[dict[int, np.ndarray], Counter[int], int]
"""Values by position, cells of each that are no numbers, and rows that were left out."""


def open_delimited(path: Path) -> RawRecording:
    """Open delimited text; separator, encoding, decimal mark, header and units are found from its beginning.

    Cells that are no numbers read as NaN, rows with another number of cells than the header are left out, and
    both are counted in the notes. A column that is mostly text is listed, with the type ``text``, but not read.

    Raises
    ------
    LogError
        If it is not a table of numbers.
    """
    sniffed = sniff(path)
    refuse_many_columns(len(sniffed.header), path.name)
    notes: list[ReadNote] = []
    columns = _columns(sniffed, path, notes)
    width = len(sniffed.header)
    angles = parts_of_angles(sniffed.header)
    behind = {place for places in angles.values() for place in places}
    columns = {
        name: (place, "deg" if place in angles else u) for name, (place, u) in columns.items() if place not in behind
    }
    both = columns_in_cells({name: index for name, (index, _) in columns.items()}, sniffed.rows)
    groups = sniffed.groups or [""] * width
    infos = [
        RawChannelInfo(name, "text" if _is_text(sniffed, index) else "column", None, unit, groups[index])
        for name, (index, unit) in columns.items()
    ]

    units = {name: "deg" if part.startswith("both") else None for name, (_, part) in both.items()}
    infos += [RawChannelInfo(name, "column", None, unit) for name, unit in units.items()]

    def numbers(name: str) -> np.ndarray:
        index = columns[name][0]
        return read_columns(path, sniffed.dialect, width, {index: name}, [])[index]

    if sniffed.dialect.filled_to:
        note_once(notes, "empty cells at the ends of rows are cut off: rows filled up", path.name)
    halves, parted = _halves(sniffed), split_stamps(infos)
    clocks, origin = clocks_of_columns(infos, numbers)
    if clocks:
        count = len({id(time) for time in clocks.values()})
        note_once(notes, "columns of time, each the clock of the columns behind it", path.name, count)

    def load(names: Sequence[str]) -> dict[str, RawSignal]:
        for info in infos:
            if info.type_name == "text" and info.name in names:
                advice = "Map a column of numbers; `split ingest LOG --list` tells which are text."
                raise LogError(f"column {info.name!r} holds text, not numbers", where=path.name, advice=advice)
        chosen = {name: columns[name] for name in names if name not in both}
        titles = {index: name for name, (index, _) in chosen.items()}
        titles |= {place: f"{titles[index]}, part" for index in angles if index in titles for place in angles[index]}
        values = read_columns(path, sniffed.dialect, width, titles or {0: ""}, notes)
        if not len(next(iter(values.values()))):
            raise LogError("holds no rows", where=path.name, advice="Export it again.")
        for name, (index, unit) in chosen.items():
            clock = packed_clock(values[index]) if unit is None and _CALLED_CLOCK.search(name) else None
            what = "column of hours, minutes and seconds in one number, read as seconds since midnight"
            if clock is None and _CALLED_CLOCK.search(name) and falls_within_seconds(values[index]):
                clock = counted_clock(_cells_of(path, sniffed.dialect, width, index))
                what = "column of seconds with a count behind the point, without leading zeros: 12.5 is 12.005 s"
            finest = _is_finest_clock(sniffed, index) and not parted
            if clock is None and finest and unit in (None, "s"):
                clock = spread_over_seconds(values[index])
                what = "clock of whole seconds: the rows of each are spread evenly over it"
            if clock is not None and len(clock) == len(values[index]):
                note_once(notes, what, f"{path.name}, column {name}")
                values[index] = clock
            held = held_on_change(values[index])
            if held is not None:
                note_once(notes, "cells written on change alone: the value is held", f"{path.name}, column {name}")
                values[index] = held
            scaled = by_factor(values[index], sniffed, index)
            if scaled is not None:
                note_once(notes, "whole numbers times the factor above them, plus its offset", f"{path.name}, {name}")
                values[index] = scaled
            if index in angles:
                note_once(notes, "coordinate in columns of degrees, minutes and seconds", f"{path.name}, column {name}")
                values[index] = in_degrees(values[index], *(values[place] for place in angles[index]))
            if index in halves:
                letters = _cells_of(path, sniffed.dialect, width, halves[index])
                values[index] = with_halves(values[index], letters)
                what = "coordinate with the half of the globe in the column behind it, read as degrees"
                note_once(notes, what, f"{path.name}, column {name}")
        found = {name: RawSignal(name, None, values[index], unit) for name, (index, unit) in chosen.items()}
        for name in (name for name in names if name in both):
            index, part = both[name]
            cells = _cells_of(path, sniffed.dialect, width, index)
            is_place = part.startswith("both")
            values[index] = of_both(cells, int(part[-1])) if is_place else of_cells(cells, part)
            found[name] = RawSignal(name, None, values[index], "deg" if is_place else None)
            note_once(notes, "several numbers in each cell", f"{path.name}, column {sniffed.header[index]}")
        found = {name: found[name] for name in names}
        return {name: with_clock(signal, clocks.get(name)) for name, signal in found.items()}

    def texts(name: str) -> tuple[np.ndarray, list[str]]:
        return _words(path, sniffed.dialect, width, columns[name][0])

    return LazyTableRecording(path.name, path, infos, load, origin, notes=notes, texts=texts)


def _cells_of(path: Path, dialect: Dialect, width: int, index: int) -> list[str]:
    """Return a column as it is written; rows of another number of cells are left out."""
    with path.open("rb") as stream:
        stream.seek(dialect.offset)
        text = stream.read(-1 if dialect.end is None else dialect.end - dialect.offset)
    rows = (split_line(line, dialect.separator) for line in text.decode(dialect.encoding, "replace").splitlines())
    filled = (row + [""] * (dialect.filled_to - len(row)) for row in rows if row)
    return [row[index] for row in filled if len(row) == width]


def _columns(sniffed: Sniffed, path: Path, notes: list[ReadNote]) -> dict[str, tuple[int, str | None]]:
    """Return position and unit of every named column."""
    columns: dict[str, tuple[int, str | None]] = {}
    unique = UniqueNames()
    messages = _messages_of_fields(sniffed)
    repeated = {title for title, count in Counter(sniffed.header).items() if count > 1}
    for index, title in enumerate(sniffed.header):
        name, unit = split_name_and_unit(title)
        if title in repeated and name and sniffed.devices:
            # "100: gps" under one speed and "calc" under another tell them apart.
            device = re.sub(r"[^A-Za-z ]", "", sniffed.devices[index]).strip()
            name = f"{name} {device}".strip()
        elif name and sniffed.groups and sniffed.groups[index] and (title in repeated or name in ("w", "W")):
            # The real part of a quaternion is alone in its group, its axes are in that of the position too.
            name = f"{sniffed.groups[index]}.{name}"
        elif title in messages:
            name = f"{messages[title][index]}.{name}"
        stated = sniffed.units[index].strip().strip("[]()") if sniffed.units else ""
        if stated:
            unit = symbol_of(stated)
        elif unit is None and _is_clock(sniffed, index):
            unit = "s"
        unit = _unit_in_cells(sniffed, index) or unit
        if not name and index == 0 and any(sniffed.header) and not _is_text(sniffed, index):
            # The index of a table, which programs write without a title: row numbers, or the time.
            name = FIRST_UNTITLED
            note_once(notes, f"a first column without a title, called {name}", path.name)
        if not name:
            continue
        columns[unique.of(name)] = (index, unit)
    if unique.renamed:
        note_once(notes, "column names that occur twice, numbered", path.name, unique.renamed)
    if sniffed.unnamed:
        beside = f" ({sniffed.titles} titles stand before {len(sniffed.header)} columns of values)"
        remark = beside if sniffed.titles else ""
        note_once(notes, f"no header row{remark}: columns are called column1, column2, ...", path.name)
    return columns


def _messages_of_fields(sniffed: Sniffed) -> dict[str, dict[int, str]]:
    """Return the message of each column whose title several messages share, by title and position.

    Converters of messages give a message inside another one a column of its own, without values, and its fields
    follow under their bare names: ``acc_body,x,y,z,rate_body,x,y,z``.
    """
    found: dict[str, dict[int, str]] = {}
    message = ""
    for index, title in enumerate(sniffed.header):
        if title and all(row[index].strip() in EMPTY_CELLS for row in sniffed.rows if index < len(row)):
            message = title
        elif title and message:
            found.setdefault(title, {})[index] = message
    count = Counter(sniffed.header)
    return {t: places for t, places in found.items() if len(set(places.values())) > 1 and len(places) == count[t]}


def _is_text(sniffed: Sniffed, index: int) -> bool:
    cells = [row[index].strip() for row in sniffed.rows if index < len(row)]
    cells = [cell for cell in cells if cell not in EMPTY_CELLS]
    # An infinite value is a number that cleaning counts and drops; what is no number at all is NaN here.
    numeric = sum(not np.isnan(number_of(cell, sniffed.dialect.decimal)) for cell in cells)
    return bool(cells) and 2 * numeric < len(cells)


def _halves(sniffed: Sniffed) -> dict[int, int]:
    """Return latitude and longitude with the columns behind them that say north or south, and east or west.

    Empty where it is not both: a gear may be N, and a mode of driving E or S.
    """
    found = {}
    for index in range(1, len(sniffed.header)):
        letters = {row[index].strip() for row in sniffed.rows if index < len(row)} - {""}
        half = next((half for half in ("NS", "EW") if letters and letters <= set(half)), "")
        if half and _CALLED_COORDINATE.search(sniffed.header[index - 1]) and not _is_text(sniffed, index - 1):
            found[half] = (index - 1, index)
    return dict(found.values()) if len(found) == 2 else {}


def _is_clock(sniffed: Sniffed, index: int) -> bool:
    """Whether every cell is a time in words, such as ``14:05:07,12``, which is read as seconds."""
    cells = [row[index].strip() for row in sniffed.rows if index < len(row) and row[index].strip() not in EMPTY_CELLS]
    return bool(cells) and all(":" in cell and np.isfinite(seconds_of(cell)) for cell in cells)


def _is_finest_clock(sniffed: Sniffed, index: int) -> bool:
    """Whether a column is called a clock, and no other one that is so called changes from row to row more often."""
    called = [n for n, title in enumerate(sniffed.header) if _CALLED_CLOCK.search(title)]
    changes = {n: len({row[n] for row in sniffed.rows if n < len(row)}) for n in called}
    return index in changes and changes[index] == max(changes.values())


def _unit_in_cells(sniffed: Sniffed, index: int) -> str | None:
    """Return the SI unit of a column whose cells state their own, in which they are read; None of any other."""
    cells = [row[index].strip() for row in sniffed.rows if index < len(row) and row[index].strip() not in EMPTY_CELLS]
    found = {quantity[1] if quantity else "" for quantity in (quantity_of(c, sniffed.dialect.decimal) for c in cells)}
    return found.pop() or None if len(found) == 1 else None


def read_columns(
    path: Path, dialect: Dialect, width: int, titles: dict[int, str], notes: list[ReadNote]
) -> dict[int, np.ndarray]:
    """Return the columns at the positions `titles` as numbers, shapes (N,).

    Rows of another number of cells than `width`, and cells that are no numbers, are counted in the notes.

    Raises
    ------
    LogError
        If the rows cannot be told apart.
    """
    import pyarrow as pa

    def read(quote: str | bool) -> _Columns:
        try:
            return _read_blocks(path, dialect, width, list(titles), pa.float64(), quote)
        except pa.ArrowInvalid:
            # Some cell is no number: read as text, then cell by cell where the quick conversion fails.
            return _read_blocks(path, dialect, width, list(titles), pa.string(), quote)

    dialect, closed = _looked_through(path, dialect)
    # A quote that is never closed takes the rows behind it; without quotes, a cell of several lines does.
    quotes = ('"',) if closed else ('"', False)
    try:
        values, bad, ragged = max(map(read, quotes), key=lambda columns: len(next(iter(columns[0].values()))))
    except pa.ArrowException as error:
        raise _unreadable(path, error) from error
    if ragged:
        note_once(notes, "rows with too few or too many cells, left out", path.name, ragged)
    for index, title in titles.items():
        if bad[index]:
            what = "cells that are no numbers, read as missing"
            note_once(notes, what, f"{path.name}, column {title}", bad[index])
    return values


def _looked_through(path: Path, dialect: Dialect) -> tuple[Dialect, bool]:
    """Return how the rows are written, and whether every quote is closed on its line.

    Rows that are not of the encoding that the beginning has are read byte by byte.
    """
    closed = True
    with path.open("rb") as stream:
        stream.seek(dialect.offset)
        left = (dialect.end or path.stat().st_size) - dialect.offset
        while left > 0 and (piece := stream.read(min(left, _LOOKED_AT_BYTES))):
            # A third of the time of `isascii`, and a piece without both needs no closer look.
            if b'"' in piece or np.frombuffer(piece, np.int8).min() < 0:
                piece += stream.readline(_BLOCK_BYTES)  # a line and a character are judged whole
                if any(line.count(b'"') % 2 for line in piece.splitlines()):
                    closed = False
                if not piece.isascii() and dialect.encoding in ("utf-8", "gb18030"):
                    try:
                        piece.decode(dialect.encoding)
                    except UnicodeDecodeError:
                        dialect = replace(dialect, encoding="latin-1")
            left -= len(piece)
    return dialect, closed


def _read_blocks(
    path: Path, dialect: Dialect, width: int, indices: list[int], kind: Any, quote: str | bool
) -> _Columns:
    """Return columns as numbers, cells of each that are none, and rows that were left out; block by block."""
    import pyarrow as pa

    ragged: list[bool] = []

    def skip(row: Any) -> str:
        # Blank lines between unit row and values, and at the end, are layout and no loss.
        ragged.append(bool((row.text or "").strip()))
        return "skip"

    options = _options(dialect, width, indices, kind, quote, skip)
    columns: dict[int, GrowingColumn] = {}
    bad: Counter[int] = Counter()
    for share, blocks in _blocks(path, dialect, options):
        # Rows like the first ones fill the file: room for all and a twentieth more spares copies.
        rows = sum(block.num_rows for block in blocks)
        columns = columns or {index: GrowingColumn(expected=int(1.05 * rows / share)) for index in indices}
        for block in blocks:
            for index, cells in zip(indices, block.columns, strict=True):
                if kind == pa.string():
                    numbers, none = _numbers(cells, dialect.decimal)
                    bad[index] += none
                else:
                    numbers = cells.to_numpy(zero_copy_only=False)  # a missing cell becomes NaN
                columns[index].append(numbers)
    pa.default_memory_pool().release_unused()
    values = {index: columns[index].finished() if columns else np.empty(0) for index in indices}
    return values, bad, sum(ragged)


def _words(path: Path, dialect: Dialect, width: int, index: int) -> tuple[np.ndarray, list[str]]:
    """Return a column of text as numbers and the texts that they stand for, the rows as `_read_blocks` keeps them."""
    import pyarrow as pa

    dialect, closed = _looked_through(path, dialect)
    options = _options(dialect, width, [index], pa.string(), '"' if closed else False, lambda row: "skip")
    words = Words()
    for _, blocks in _blocks(path, dialect, options):
        for block in blocks:
            encoded = block.columns[0].fill_null("").dictionary_encode()
            words.append(encoded.dictionary.to_pylist(), encoded.indices.to_numpy(zero_copy_only=False))
    return words.finished()


def _options(
    dialect: Dialect, width: int, indices: list[int], kind: Any, quote: str | bool, skip: Callable[[Any], str]
) -> dict[str, Any]:
    """Return how Arrow reads the columns at `indices` as `kind`; `skip` is called with rows of another width."""
    from pyarrow import csv as arrow_csv

    names = [str(index) for index in range(width)]
    return {
        "read_options": arrow_csv.ReadOptions(
            column_names=names, encoding=dialect.encoding, block_size=max(_BLOCK_BYTES, _BLOCK_BYTES_A_COLUMN * width)
        ),
        "parse_options": arrow_csv.ParseOptions(
            delimiter="\t" if dialect.separator == " " else dialect.separator,
            invalid_row_handler=skip,
            newlines_in_values=False,
            quote_char=quote,
        ),
        "convert_options": arrow_csv.ConvertOptions(
            column_types=dict.fromkeys(names, kind),
            include_columns=[str(index) for index in indices],
            null_values=list(EMPTY_CELLS),
            strings_can_be_null=True,
            decimal_point=dialect.decimal,
            check_utf8=False,
        ),
    }


def _blocks(path: Path, dialect: Dialect, options: dict[str, Any]) -> Iterator[tuple[float, list[Any]]]:
    """Yield batches of some rows each, and the share of the file that they are, at least where it is a plain one.

    Where there are several processors, threads parse the rows of one table together, while the one before is used.
    """
    import pyarrow as pa
    from pyarrow import csv as arrow_csv

    # Arrow's own file: what Python reads for another thread to parse stays in memory until the end.
    with pa.OSFile(str(path)) as stream:
        end = stream.size() if dialect.end is None else dialect.end
        size = end - dialect.offset
        rewritten = dialect.quoted_whole or dialect.separator == " " or dialect.filled_to > 0
        if rewritten or dialect.encoding.startswith("utf-16") or pa.cpu_count() == 1:
            rows = _rewritten(stream.get_stream(dialect.offset, size), dialect)
            share = min(options["read_options"].block_size / size, 1.0) if size else 1.0
            for block in arrow_csv.open_csv(rows, **options):
                yield share, [block]
            return
        parts = list(_parts(path, dialect.offset, end))

        def parsed(first: int, last: int) -> Any:
            return arrow_csv.read_csv(stream.get_stream(first, last - first), **options)

        with ThreadPoolExecutor(1) as ahead:
            coming = [ahead.submit(parsed, *part) for part in parts[:1]]
            for place, (first, last) in enumerate(parts):
                table = coming.pop().result()
                coming += [ahead.submit(parsed, *part) for part in parts[place + 1 : place + 2]]
                yield (last - first) / size, table.to_batches()
                del table


def _parts(path: Path, first: int, end: int) -> Iterator[tuple[int, int]]:
    """Yield the bytes [first, last) of parts of a text that hold whole lines."""
    with path.open("rb") as lines:
        while first < end:
            lines.seek(min(first + TABLE_BYTES, end))
            lines.readline()
            last = min(lines.tell(), end)
            yield first, last
            first = last


def _rewritten(stream: Any, dialect: Dialect) -> Any:
    """Return the rest of a file without quotes around whole lines, with one tab for each run of blanks, rows filled."""
    if not dialect.quoted_whole and dialect.separator != " " and not dialect.filled_to:
        return stream
    text = stream.read().decode(dialect.encoding, errors="replace")
    if dialect.quoted_whole:
        text = "".join(unwrapped(line) for line in text.splitlines(keepends=True))
    if dialect.separator == " ":
        # A pattern for blanks at the end of a line takes the square of a long run of them.
        text = "\n".join("\t".join(line.split()) for line in text.splitlines()) + "\n"
    if dialect.filled_to:
        text = "\n".join(_with_separators(line, dialect) for line in text.splitlines()) + "\n"
    return io.BytesIO(text.encode(dialect.encoding))


def _with_separators(line: str, dialect: Dialect) -> str:
    """Return a line with the separators of the empty cells that were cut off at its end."""
    cells = line.count(dialect.separator) if '"' not in line else len(split_line(line, dialect.separator)) - 1
    return line + dialect.separator * (dialect.filled_to - 1 - cells) if line.strip() else line


def _numbers(texts: Any, decimal: str) -> tuple[np.ndarray, int]:
    """Return texts as numbers, and how many are none."""
    import pyarrow as pa
    import pyarrow.compute as pc

    text = pc.utf8_trim_whitespace(texts)
    try:
        plain = text if decimal == "." else pc.replace_substring(text, decimal, ".")
        return pc.fill_null(pc.cast(plain, pa.float64()), float("nan")).to_numpy(zero_copy_only=False), 0
    except pa.ArrowInvalid:
        cells = text.to_pylist()
        if any(cell is not None and is_grouped(cell, decimal) for cell in cells):
            # Then a mark between three digits parts thousands in the cells without a decimal too.
            other = {",": ".", ".": ","}[decimal]
            whole = re.compile(rf"[+-]?\d{{1,3}}([{other}' \u00a0\u202f]\d{{3}})+")
            cells = [cell and (re.sub(r"[^\d+-]", "", cell) if whole.fullmatch(cell) else cell) for cell in cells]
        values = np.array([np.nan if cell is None else number_of(cell, decimal) for cell in cells])
        missing = np.flatnonzero(np.isnan(values))
        return values, sum(cells[row] is not None and cells[row] not in EMPTY_CELLS for row in missing)


def _unreadable(path: Path, error: Exception) -> LogError:
    reason = reason_of(error)
    if "straddl" in reason:
        reason = f"a row is longer than {_BLOCK_BYTES / 1e6:.0f} MB"
    advice = "Export it again, one row a line, the same separator throughout."
    return LogError(f"cannot be read as delimited text ({reason})", where=path.name, advice=advice)
