"""Finding out how a delimited text file is written, from its first lines."""

import csv
import io
import itertools
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from split_cli.errors import LogError, NoTableError
from split_cli.logs.readers.code_pages import MARKS, encoding_of, utf_16_without_mark
from split_cli.logs.readers.coordinates import titles_of_parts
from split_cli.logs.readers.rows_above import (
    LABELS_OF_NAMES,
    RULED,
    below_a_list,
    is_scaling,
    listed_names,
    listed_scaling,
    scaling_rows,
    titles_a_list,
)
from split_cli.signals import find_unit, split_name_and_unit

KNOWN_FORMATS = (
    "Known are MCAP, rosbag2, ROS 1 bag, CSV, Excel, JSON lines, YAML, VBO, Pi Toolbox, Parquet, Feather, MAT, HDF5, "
    "NetCDF, NumPy, SQLite, iRacing, MoTeC, CarMaker, AiM, TDMS, ULog, MF4, and with --dbc BLF, ASC, TRC and candump."
)
EMPTY_CELLS = ("", "nan", "NaN", "NAN", "NA", "N/A", "n/a", "#N/A", "null", "NULL", "None", "-", "--")
"""What loggers write where they measured nothing."""
_EMPTY = frozenset(EMPTY_CELLS)
LONGEST_LINE = 4 << 20
"""[bytes]; judgement: a row of a thousand numbers has 12 kB. What goes on is a line of its own."""
_SAMPLE_BYTES = 1 << 18
_SEPARATORS = (",", ";", "\t", "|")
_BLANKS = " "
_CHECKED_ROWS = 200
_CONFIRMING_ROWS = 3
_CUT_SHARE = 0.2
"""Of rows that are shorter than their titles, from which on a writer cut them off [1]: of damaged ones there are fewer,
and their cells may stand in other columns. Judgement."""
_TITLED_LINES = 60
"""In which a row of titles of several lines is looked for [1]: 30 columns of two lines each, or more; judgement."""
_ROWS_BELOW = 20
_FEWEST_GROUPS = 2
"""Of several columns each, that make a row of groups [1]: one is the name of a table, or of its driver."""
_NUMBER = re.compile(r"^[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")
_NUMBER_WITH_COMMA = re.compile(r"^[+-]?(\d+(,\d*)?|,\d+)([eE][+-]?\d+)?$")
_PLAIN = {".": _NUMBER, ",": _NUMBER_WITH_COMMA}
_QUANTITY = re.compile(r"([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)(?:\s+([^\W\d][^\s,;]{0,9}|°/s)|\s*([%°]))")
"""A number with its unit behind it in one cell, as dashboards write it: 12.3 km/h, 45 %."""
_OPEN_QUOTE = re.compile(r'(?:^(?:[^"]*"[^"]*")*[^"]*[,;\t]|^)"[^"]*$')
"""A quote that begins a cell and is not closed; the inches of a rim are none."""
_NUMBER_IN_FRONT = re.compile(r'\s*"?[+-]?\d')
_LABELLED_CELL = re.compile(r"([A-Za-z]{2,12}): ?(.*)")
"""What a cell above the values holds, said in each of them: Unit: m/s (Simulation Data Inspector)."""
_GROUPED = {
    ".": re.compile(r"^[+-]?\d{1,3}([,' \u00a0\u202f])\d{3}(\1\d{3})*\.\d+$"),
    ",": re.compile(r"^[+-]?\d{1,3}([.' \u00a0\u202f])\d{3}(\1\d{3})*,\d+$"),
}
"""Numbers with a mark between thousands, by the decimal mark: 1.234,5 and 1'234.5."""
_TYPE = re.compile(r"[fiu]\d{1,2}|(u?int|float)(8|16|32|64)?|double|single|real", re.IGNORECASE)
"""Of a column's values, in a row under the titles, as ETAS writes it (f8)."""
_WORD = re.compile(r"[^\W\d]")
_UNIT_LIKE = re.compile(r"^[\[(]?[#A-Za-z°µ%/*^·.'\-\d² ]{0,12}[\])]?$")
_PATTERN_OF_A_TIME = re.compile(r"(?=.*([hHms]{1,2}|[YyJ]{2,4}))[hHmsfSDdTtMYyJ0#.,:/\- ]{5,}")
"""What a spreadsheet writes as the unit of a clock or a date: hh:mm:ss,000 and TT.MM.JJJJ."""


@dataclass(frozen=True)
class Dialect:
    """How the rows of values are written."""

    # separator, decimal: one character each; a separator that is a blank stands for any run of blanks.
    separator: str
    decimal: str
    encoding: str
    offset: int  # byte at which the first row of values begins
    # Whether each line stands in quotes as one cell, as a spreadsheet saves a file that it did not split.
    quoted_whole: bool = False
    end: int | None = None  # byte at which the rows end, if not with the file
    filled_to: int = 0  # cells that shorter rows are filled up to, where the writer cut empty ones off


@dataclass(frozen=True)
class Sniffed:
    """What stands before the values."""

    dialect: Dialect
    header: list[str]  # a title a column
    units: list[str] | None  # a unit a column, where there is a row of them
    rows: list[list[str]]  # the first rows of values
    unnamed: bool  # whether there is no header and the titles were made up
    titles: int = 0  # then the most titles that stand in a row before the values, and do not fit them in number
    # Where each column comes from, if a further row under the titles tells it (RaceChrono: ``100: gps``).
    devices: list[str] | None = None
    groups: list[str] | None = None  # what a row above the titles calls each column and those beside it
    # What makes whole numbers quantities, where rows above the values say it: number * factor + offset.
    factors: list[str] | None = None
    offsets: list[str] | None = None


def sniff(path: Path) -> Sniffed:
    """Find separator, decimal mark, encoding, header, units and the first row of values.

    The values begin at the first row from which on several rows hold numbers in most of their cells; the
    header is the row of titles, as wide as they are, before it; rows of units and of devices may stand between.

    Raises
    ------
    LogError
        If no such row exists.
    """
    with path.open("rb") as stream:
        sample = stream.read(_SAMPLE_BYTES)
        whole = len(sample) < _SAMPLE_BYTES
    # A character that the sample's end cuts in two is none of an encoding.
    lines_of_it = sample if whole else sample[: sample.rfind(b"\n") + 1] or sample
    unmarked = utf_16_without_mark(sample) or encoding_of(lines_of_it)
    mark, encoding = next(((m, e) for m, e in MARKS if sample.startswith(m)), (b"", unmarked))
    text = sample[len(mark) :].decode(encoding, errors="replace")
    lines = io.StringIO(text, newline="").readlines()
    if not whole and len(lines) > 1:
        lines.pop()
    if "\ufffd" in text[:1000] or sum(ch < " " and ch not in "\t\r\n\f" for ch in text[:1000]) > 5:
        raise LogError("is neither a known log nor text", where=path.name, advice=KNOWN_FORMATS)
    lines = _joined_titles(lines)
    quoted = _is_quoted_whole(lines)
    plain = [unwrapped(line) for line in lines] if quoted else lines
    for separator, decimal in _candidates(plain):
        rows = [split_line(line, separator) for line in plain]
        full = _width_of_cut_rows(below_a_list(rows), separator, decimal)
        rows = [_filled_up(row, full) if full and _holds_values(row, decimal) else row for row in rows]
        first = _first_values(rows, decimal)
        if first is not None:
            offset = len(mark) + sum(len(line.encode(encoding)) for line in lines[:first])
            return _described(rows, first, Dialect(separator, decimal, encoding, offset, quoted, None, full))
    what = "is no table of numbers: no rows of numbers were found in its beginning"
    advice = "Values are expected in columns, separated by comma, semicolon, tab or blanks."
    raise NoTableError(what, where=path.name, advice=advice)


def _joined_titles(lines: list[str]) -> list[str]:
    """Return lines with those of one row put together whose quoted titles go over several lines, as in spreadsheets.

    Rows of values come after them: there a quote that is never closed would take the rows behind it.
    """
    made: list[str] = []
    for number, line in enumerate(lines[:_TITLED_LINES]):
        if made and _OPEN_QUOTE.search(made[-1].replace('""', "")) and not _NUMBER_IN_FRONT.match(line):
            made[-1] += line
        else:
            made.append(line)
        if number and _NUMBER_IN_FRONT.match(line):
            return made + lines[number + 1 :]
    return made + lines[_TITLED_LINES:]


def unwrapped(line: str) -> str:
    """Return what stands in the quotes around a whole line; a line without them as it is."""
    text = line.rstrip("\r\n").rstrip(",;")
    if len(text) > 1 and text.startswith('"') and text.endswith('"'):
        return text[1:-1].replace('""', '"') + "\n"
    return line


def _is_quoted_whole(lines: list[str]) -> bool:
    """Whether nine of ten lines are one quoted cell that holds separators itself."""
    filled = [line.rstrip("\r\n").rstrip(",;") for line in lines if line.strip(" \r\n,;")]
    whole = [
        line
        for line in filled
        if line.startswith('"')
        and line.endswith('"')
        and any(separator in line for separator in _SEPARATORS)
        and all(len(split_line(line, separator)) == 1 for separator in _SEPARATORS)
    ]
    return len(filled) > 2 and 10 * len(whole) >= 9 * len(filled)


def _candidates(lines: list[str]) -> list[tuple[str, str]]:
    """Return separators with decimal marks, the most plausible first, judged by the last lines of the sample."""
    tail = [line for line in lines if line.strip()][-_CHECKED_ROWS:]
    scored = []
    for separator in (*_SEPARATORS, _BLANKS):
        # A decimal comma between commas can be recognised only where cells stand in quotes.
        quoted = any('"' in line for line in tail)
        for decimal in (".",) if separator == "," and not quoted else (".", ","):
            rows = [split_line(line, separator) for line in tail]
            widths = Counter(map(len, rows))
            width = max(widths, key=lambda w: (widths[w], w), default=0)
            cells = [cell for row in rows if len(row) == width for cell in row]
            numbers = sum(_is_number(cell, decimal) for cell in cells)
            # Weighed by their share: 0,1;2,5 holds two numbers between commas as well, and a remnant.
            weight = numbers * numbers / max(len(cells), 1)
            # Blanks stand inside dates and beside other separators: they part columns where nothing else does.
            settled = separator == _BLANKS and any(entry[0] and entry[1] > 0.0 for entry in scored)
            scored.append((width > 1 and not settled, weight, (separator, decimal)))
    # A column of integers reads the same with either mark; the point, listed first, then wins.
    scored.sort(key=lambda entry: entry[:2], reverse=True)
    return [entry[2] for entry in scored]


_COMMENT_MARK = re.compile(r"^[#%]+[ \t]*(?=[\w\"(\[])")
"""Before a row of titles or units, as NumPy, gnuplot and CarMaker write it; a column called # stays."""


def split_line(line: str, separator: str) -> list[str]:
    """Return the cells of a line; a mark of a comment before them is taken off."""
    if separator != _BLANKS:
        line = _COMMENT_MARK.sub("", line)
        try:
            return next(csv.reader([line.rstrip("\r\n")], delimiter=separator), [])
        except csv.Error:  # a cell of over 128 kB, of which quotes are not looked for
            return line.rstrip("\r\n").split(separator)
    cells = line.split()
    # NumPy and gnuplot mark the line of titles.
    return cells[1:] if cells and cells[0] in ("#", "%") else cells


def _is_number(cell: str, decimal: str) -> bool:
    return _is_bare(cell, decimal) or quantity_of(cell, decimal) is not None


def _is_bare(cell: str, decimal: str) -> bool:
    """Tell whether a cell is a number without a unit."""
    return _PLAIN[decimal].match(plain_sign(cell.strip())) is not None or is_grouped(cell, decimal)


_MINUS = re.compile("^[\u2212\u2012\u2013\ufe63\uff0d](?=[\\d.,])|(?<=[eE])[\u2212\u2012\u2013]")
_BEHIND_OR_AROUND = re.compile(r"\((\d[\d.,]*)\)|(\d[\d.,]*)-")


def plain_sign(cell: str) -> str:
    """Return a number with a minus in front, where a dash, a minus behind or brackets around, as in books, say it."""
    if cell.isascii() and cell[-1:] not in (")", "-"):
        return cell
    found = _BEHIND_OR_AROUND.fullmatch(cell)
    return f"-{found[1] or found[2]}" if found else _MINUS.sub("-", cell)


def quantity_of(cell: str, decimal: str) -> tuple[float, str] | None:
    """Return value and SI unit of a cell that holds a number with a known unit; None of any other.

    A letter of the half of the globe is no newton.
    """
    found = _QUANTITY.fullmatch(cell.strip())
    unit = find_unit(found[2] or found[3]) if found and found[2] not in ("N", "E", "S", "W") else None
    if found is None or unit is None:
        return None
    try:
        number = float(found[1].replace(decimal, "."))
    except ValueError:
        return None
    return number * unit.factor + unit.offset, unit.si


def is_grouped(cell: str, decimal: str) -> bool:
    """Tell whether a cell is a number with marks between its thousands, as spreadsheets write it."""
    return _GROUPED[decimal].match(cell.strip()) is not None


def _holds_values(row: Sequence[str], decimal: str) -> bool:
    # Where nothing was measured a cell is no text; one that says nan stands for a number.
    filled = [cell for cell in map(str.strip, row) if cell not in _EMPTY or cell.lower() == "nan"]
    # The sample of a file has ten thousand cells, nearly all of them plain numbers.
    others = [cell for cell in filled if _PLAIN[decimal].match(cell) is None]
    numbers = len(filled) - len(others)
    numbers += sum(_is_number(cell, decimal) or cell.lower() in ("nan", "inf", "-inf") for cell in others)
    return numbers > 0 and 2 * numbers >= len(filled)


def _first_values(rows: list[list[str]], decimal: str) -> int | None:
    """Return the first row of values: as wide as, and followed by, further rows of values."""
    widths = Counter(len(row) for row in rows if _holds_values(row, decimal))
    if not widths:
        return None
    width = max(widths, key=lambda w: (widths[w], w))
    for index, row in enumerate(rows):
        if len(row) != width or not _holds_values(row, decimal) or _numbers_the_columns(row, rows[index + 1 :]):
            continue
        if is_scaling(row, decimal):
            continue
        filled = (rows[at] for at in range(index + 1, len(rows)) if any(rows[at]))
        following = list(itertools.islice(filled, _CONFIRMING_ROWS))
        good = sum(len(later) == width and _holds_values(later, decimal) for later in following)
        if _counts_steps(row, following, decimal):
            continue
        if 2 * good >= len(following) and not _words_among_numbers(row, rows[index + 1 :], decimal):
            return index
    return None


def _counts_steps(row: list[str], following: list[list[str]], decimal: str) -> bool:
    """Whether cells hold numbers with units where the rows below hold numbers alone: the steps that these count."""
    steps = [n for n, cell in enumerate(row) if quantity_of(cell, decimal) is not None]
    bare = [n for n in steps if all(n < len(later) and _is_bare(later[n], decimal) for later in following)]
    return bool(following) and len(bare) > 0 and 2 * len(bare) >= len(steps)


def _width_of_cut_rows(rows: Sequence[Sequence[str]], separator: str, decimal: str) -> int:
    """Return how many cells a whole row has, where a writer cut the empty ones at its end off; 0 where none did.

    The rows begin as long as the titles above them, and none is longer.
    """
    first = next((n for n, row in enumerate(rows) if _holds_values(row, decimal)), 0)
    width = len(rows[first]) if rows else 0
    lengths = [len(row) for row in rows[first:] if _holds_values(row, decimal)]
    short = sum(length < width for length in lengths)
    titled = any(len(row) == width and _is_title_row(row, width) for row in rows[max(first - 5, 0) : first])
    if separator == _BLANKS or short < _CUT_SHARE * len(lengths) or not short or max(lengths) > width or not titled:
        return 0
    return width


def _words_among_numbers(row: list[str], later: list[list[str]], decimal: str) -> bool:
    """Whether a row holds a word where all rows below it hold numbers: it names a session, beside its number.

    A row of titles stands between; a word right above the numbers is a value that was not measured.
    """
    following = [r for r in later if any(cell.strip() for cell in r)][:1]
    if following and len(following[0]) == len(row) and _holds_values(following[0], decimal):
        return False
    below = [r for r in later[:_ROWS_BELOW] if len(r) == len(row) and _holds_values(r, decimal)]
    if len(below) < _CONFIRMING_ROWS:
        return False
    for place, cell in enumerate(row):
        word = cell.strip()
        if word in EMPTY_CELLS or _is_number(word, decimal) or word.lower() in ("nan", "inf", "-inf"):
            continue
        if all(_is_number(r[place], decimal) for r in below):
            return True
    return False


def _numbers_the_columns(row: list[str], following: list[list[str]]) -> bool:
    """Whether a row is 1, 2, 3, ... before an empty one, as AiM writes it under the units."""
    filled = [cell.strip() for cell in row if cell.strip()]
    counted = filled == [str(number) for number in range(1, len(filled) + 1)]
    return counted and bool(following) and not any(cell.strip() for cell in following[0])


def _described(rows: list[list[str]], first: int, dialect: Dialect) -> Sniffed:
    width = len(rows[first])
    values = [row for row in rows[first : first + _CHECKED_ROWS] if len(row) == width]
    above = [_parted_by_commas(row, width) for row in rows[:first] if any(cell.strip() for cell in row)]
    above = [_rejoined(row, width) for row in reversed(above[-5:]) if not _numbers_the_columns(row, [[]])]
    above = [row for row in above if not all(RULED.fullmatch(cell.strip()) for cell in row if cell.strip())]
    above = [row for row in map(_without_labels, above) if row and not is_scaling(row, dialect.decimal)]
    above = [row for row in above if not titles_a_list(row)]
    above = titles_of_parts(above, width)
    titles = [n for n, row in enumerate(above) if _is_title_row(row, width) and not _holds_values(row, dialect.decimal)]
    listed = listed_names(rows[:first], width) if not titles else []
    if listed:
        return Sniffed(dialect, listed, None, values, False)
    if not titles:
        worded = [row for row in rows[:first] if sum(_WORD.search(cell) is not None for cell in row) > 1]
        most = max(map(len, worded), default=0)
        return Sniffed(dialect, [f"column{n + 1}" for n in range(width)], None, values, True, most)
    labelled = [n for n in titles if above[n][0].strip().lower() in LABELS_OF_NAMES]
    chosen = labelled[0] if len(labelled) == 1 and len(titles) > 1 else _row_of_names(above, titles, width)
    below = [_filled_up(row, width) for row in above[:chosen]]
    units = next((row for row in below if _is_unit_row(row, width)), None)
    devices = next((row for row in below if row is not units and _is_title_row(row, width)), None)
    units = units or _units_of_labview(rows[:first], width)
    groups = _groups(above[chosen + 1], width) if chosen + 1 < len(above) else None
    scaling = scaling_rows(rows[:first], width, dialect.decimal)
    named = [split_name_and_unit(title)[0] for title in _filled_up(above[chosen], width)]
    if scaling[0] is None and (said := listed_scaling(rows[:first], named, dialect.decimal)) is not None:
        scaling, units = [said[0], said[1]], units or said[2]
    return Sniffed(dialect, _filled_up(above[chosen], width), units, values, False, 0, devices, groups, *scaling)


def _without_labels(row: list[str]) -> list[str]:
    """Return a row whose cells all say that they are units without that word; empty where they say anything else."""
    found = [_LABELLED_CELL.fullmatch(cell.strip()) for cell in row if cell.strip()]
    words = {match[1].lower() if match else "" for match in found}
    if len(found) < 2 or len(words) > 1 or "" in words:
        return row
    return [cell.partition(":")[2].strip() for cell in row] if words <= {"unit", "units"} else []


def _parted_by_commas(row: list[str], width: int) -> list[str]:
    """Return a row of titles that commas part, above values that blanks or tabs part; any other as it is."""
    if len(row) == width:
        return row
    titles = [title.strip() for title in " ".join(row).strip().rstrip(",").split(",")]
    return titles if len(titles) == width > 1 else row


def _filled_up(row: list[str], width: int) -> list[str]:
    return (row + [""] * width)[:width]


def _row_of_names(above: list[list[str]], titles: list[int], width: int) -> int:
    """Return which of the rows of titles above the values, the nearest first, names the columns.

    The names stand next to the values and their units; a row of devices below the units repeats itself more.
    """
    differ = [len({cell.strip() for cell in row} - {""}) for row in above]
    # A row that says the same of every column names none of them, where another row does.
    titles = [n for n in titles if differ[n] > 1] or titles
    named = [n for n in titles if not _is_unit_row(above[n], width)] or titles
    chosen = named[0]
    for n in named[1:]:
        if differ[n] > differ[chosen] and any(_is_unit_row(row, width) for row in above[chosen:n]):
            chosen = n
    return chosen


def _groups(row: list[str], width: int) -> list[str] | None:
    """Return the group of each column, from a row that names several columns at once at the first of them.

    Spreadsheets write a name, and empty cells up to the next; other programs write it again in each column. Two
    groups of several columns make such a row.
    """
    named = [n for n, cell in enumerate(row[:width]) if cell.strip() and (n == 0 or cell.strip() != row[n - 1].strip())]
    sizes = [end - begin for begin, end in itertools.pairwise([*named, width])]
    if abs(len(row) - width) > 1 or sum(size > 1 for size in sizes) < _FEWEST_GROUPS:
        return None
    if not all(_WORD.search(row[n]) for n in named):
        return None
    groups = [""] * width
    for begin, size in zip(named, sizes, strict=True):
        groups[begin : begin + size] = [row[begin].strip()] * size
    return groups


def _units_of_labview(rows: list[list[str]], width: int) -> list[str] | None:
    """Return the units that LabVIEW writes above the titles, behind a word of its own; the time is in seconds."""
    row = next((row for row in rows if row and row[0].strip() == "Y_Unit_Label"), None)
    return None if row is None else _filled_up(["s", *row[1:]], width)


def _rejoined(row: list[str], width: int) -> list[str]:
    """Return a row of titles with those put together again that hold separators in brackets; else as it is."""
    if len(row) <= width + 1:
        return row
    made: list[str] = []
    for cell in row:
        if made and made[-1].count("[") > made[-1].count("]"):
            made[-1] += "," + cell
        else:
            made.append(cell)
    return made if abs(len(made) - width) <= 1 else row


def _is_title_row(row: Sequence[str], width: int) -> bool:
    titles = [cell.strip() for cell in row if cell.strip()]
    # One column more or less: exports disagree on a separator at the end of the line. A row of types names none.
    alike = all(_TYPE.fullmatch(title) for title in titles)
    return abs(len(row) - width) <= 1 and len(titles) >= max(1, width // 2) and not alike


def _is_unit_row(row: list[str], width: int) -> bool:
    cells = [cell.strip() for cell in row]
    filled = [cell for cell in cells if cell and not _PATTERN_OF_A_TIME.fullmatch(cell)]
    if abs(len(row) - width) > 1 or not filled or not all(_UNIT_LIKE.match(cell) for cell in filled):
        return False
    # AiM writes # where a channel has no unit; a sign is never a channel's name.
    known = sum(find_unit(cell) is not None or cell[0] in "[(" or not _WORD.search(cell) for cell in filled)
    return 2 * known >= len(filled)
