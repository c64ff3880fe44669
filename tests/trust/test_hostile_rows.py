"""Rows, blocks and titles made to take all memory or to go on for ever: JSON, Pi Toolbox, names of columns."""

import json
import random
import time

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from split_cli.errors import LogError, SplitError
from split_cli.logs.budget import LONGEST_NAME, MOST_FIELDS
from split_cli.logs.drive import open_drive, read_drive
from split_cli.logs.raw import UniqueNames
from split_cli.logs.readers import json_document
from split_cli.logs.readers.clock_of_day import seconds_of_day
from split_cli.logs.readers.definitions import Definitions
from split_cli.logs.readers.frames_csv import frames_of
from split_cli.logs.readers.guard import GuardedRecording
from split_cli.logs.readers.json_document import JsonDocument
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.readers.protobuf_and_json import JsonDecoder


def any_value(rng: random.Random, depth: int = 0):
    kind = rng.randrange(8 if depth < 3 else 5)
    if kind < 5:
        return [rng.random() * 1e5, rng.randrange(-9999, 9999), 'a,"},[\\ü', None, True][kind]
    count = rng.randrange(4)
    if kind == 5:
        return [any_value(rng, depth + 1) for _ in range(count)]
    return {f"k{n}": any_value(rng, depth + 1) for n in range(count)}


def test_a_clock_of_the_day_that_is_no_number_stays_none_and_nothing_is_printed():
    np.testing.assert_equal(seconds_of_day(np.array([120000.0, np.inf, np.nan])), [43200.0, np.nan, np.nan])


@pytest.mark.parametrize("piece", [1, 2, 7, 100, 10_000])
def test_a_document_in_pieces_holds_what_it_holds_as_a_whole(tmp_path, monkeypatch, piece):
    """The oracle is json.loads; cuts fall within numbers, texts and marks."""
    monkeypatch.setattr(json_document, "PIECE", piece)
    rng = random.Random(piece)
    path = tmp_path / "a.json"
    for _ in range(25):
        lists = {f"k{n}": [any_value(rng) for _ in range(rng.randrange(30))] for n in range(3)}
        written = rng.choice([lists, lists["k0"], {"name": "a", **lists, "end": {"x": [1]}}])
        path.write_text(json.dumps(written, ensure_ascii=rng.random() < 0.5, indent=rng.choice([None, 1])))
        found = {key: list(elements) for key, elements in JsonDocument(path).lists()}
        assert found == ({"": written} if isinstance(written, list) else lists)


def test_a_list_whose_rows_share_no_field_is_refused_while_it_is_listed(tmp_path):
    """Columns were filled before they were counted: 60,000 rows of 13 bytes took 4 GB and 34 s."""
    path = tmp_path / "a.json"
    path.write_text("[" + ",".join(f'{{"k{n}":1}}' for n in range(MOST_FIELDS + 100)) + "]")
    with pytest.raises(LogError, match="more than 20,000 columns"):
        open_recording(path)


@pytest.mark.parametrize("end", ["", ',{"t":', ',{"t":1]', "," + "[" * 100_000, ',{"t":' + "9" * 5000 + "}]"])
def test_a_document_that_is_cut_off_is_read_up_to_there(tmp_path, end):
    path = tmp_path / "a.json"
    path.write_text('{"car":"A7","rows":[' + ",".join(f'{{"t":{n},"vx":2}}' for n in range(100)) + end)
    recording = open_recording(path)
    assert list(recording.read(["t"])["t"].values) == list(range(100))
    assert [note.what for note in recording.notes] == ["the document is cut off or damaged: read up to there"]


def test_rows_that_lack_nearly_all_fields_are_refused_where_all_are_asked_for(tmp_path):
    """A line of 19,000 fields and a megabyte of empty objects took 3 GB."""
    path = tmp_path / "a.jsonl"
    first = ",".join(f'"k{n}":{n}' for n in range(19_000))
    path.write_text("{" + first + "}\n" + "{}\n" * 1200)
    recording = open_recording(path)
    names = [info.name for info in recording.channels()]
    with pytest.raises(LogError, match="lacks nearly all fields"):
        recording.read(names)
    read = recording.read(names[7:9])["k8"].values
    assert read[0] == 8.0 and np.isnan(read[1:]).all() and len(read) == 1201


def test_a_name_of_a_megabyte_is_not_repeated_for_each_number_under_it(tmp_path):
    """Sixty-four lists of 64 numbers under such a name took 4 GB, in a row as in a message."""
    row = json.dumps({"k" * 10**6: [[1] * 64] * 64, "vx": 1.5})
    (tmp_path / "a.jsonl").write_text(f"{row}\n{row}\n")
    assert [info.name for info in open_recording(tmp_path / "a.jsonl").channels()] == ["vx"]
    assert JsonDecoder(b"", row.encode(), 0).paths() == ["vx"]
    with pytest.raises(LogError, match="a name of 501 characters"):
        Definitions().layout("a/A", "ros2msg", b"float64 " + b"k" * (LONGEST_NAME + 1))


def test_names_that_are_alike_are_numbered_in_the_order_of_the_file():
    unique = UniqueNames()
    assert [unique.of(n) for n in ["a", "a_2", "a", "b", "a", "a_2"]] == ["a", "a_2", "a_3", "b", "a_4", "a_2_2"]
    assert unique.renamed == 3


def test_numbering_names_takes_no_square_of_their_number():
    """Each of 40,000 columns of one name was compared with all before it: 100 s."""
    began = time.process_time()
    unique = UniqueNames()
    assert len({unique.of("a") for _ in range(200_000)}) == 200_000
    assert time.process_time() - began < 5.0


def test_an_export_of_pi_toolbox_has_no_more_columns_than_a_message_may_have(tmp_path):
    titles = "\t".join(["t", *["a"] * (MOST_FIELDS + 1)])
    (tmp_path / "o.txt").write_text(f"PiToolbox\n{{ChannelBlock}}\n{titles}\n")
    with pytest.raises(LogError, match="more than 20,000 columns"):
        open_recording(tmp_path / "o.txt")
    rows = "".join(f"{k}\t1\t2\t3\n" for k in range(30))
    (tmp_path / "o.txt").write_text(f"PiToolbox\n{{ChannelBlock}}\nt\ta\ta\ta\n{rows}")
    assert [info.name for info in open_recording(tmp_path / "o.txt").channels()] == ["t", "a", "a_2", "a_3"]


def test_a_cell_without_an_end_costs_its_row_and_no_other(tmp_path):
    """A quote that is never closed took all frames with it."""
    sound = "0.5,0x101,0,0x0102030405060708\n"
    path = tmp_path / "frames.csv"
    path.write_text(f'time,addr,bus,data\n{sound}1.5,0x101,0,"{"00" * 70_000}\n{sound}')
    frames = list(frames_of(path))
    assert frames[0] == frames[-1] and frames[0].data == bytes(range(1, 9)) and None in frames


def test_a_time_stamp_of_thousands_of_digits_is_none():
    """It ended in an internal error: an integer too large for a double, while the clocks were listed."""
    decoder = JsonDecoder(b"", b'{"x":1.5,"timestamp":' + b"9" * 4000 + b"}", 10**18)
    assert decoder.stamp is None
    columns = decoder.decode([b'{"x":2.5}', b'{"x":' + b"9" * 4000 + b"}"], ["x"])
    assert columns.values[0] == 2.5 and columns.readable.tolist() == [True, False]


def test_whatever_a_reader_raises_while_clocks_are_listed_becomes_an_error_of_the_recording(tmp_path):
    class Damaged:
        name, path, origin = "a", tmp_path / "a", 0.0

        @property
        def clocks(self):
            raise OverflowError("too large")

    with pytest.raises(LogError, match="not as its format demands"):
        GuardedRecording(Damaged())


@pytest.mark.parametrize(
    ("row", "expected"), [('10,"20', np.nan), ('10,"a\nb c"', np.nan), ('10,"7"', 7.0)], ids=["open", "lines", "sound"]
)
def test_a_quote_that_is_never_closed_takes_no_rows_behind_it(tmp_path, row, expected):
    """Up to a megabyte of rows went without a word; a cell of two lines stays a cell."""
    rows = [f"{k},{k / 2}" for k in range(400)]
    rows[300] = row.replace("10", "300", 1)
    (tmp_path / "log.csv").write_text("t,v\n" + "\n".join(rows) + "\n")
    recording = open_recording(tmp_path / "log.csv")
    signals = recording.read(["t", "v"])
    values = np.arange(400) / 2
    values[300] = expected
    np.testing.assert_array_equal(signals["t"].values, np.arange(400))
    np.testing.assert_array_equal(signals["v"].values, values)
    assert sum(note.count for note in recording.notes) == np.isnan(expected)


def test_a_quote_that_is_never_closed_costs_one_named_value(tmp_path):
    """9,320 of 10,000 rows were lost, and one was counted: that of the titles, which is none."""
    rows = [f"{0.01 * k:.2f},{name},{k}\n" for k in range(5000) for name in ("vx", "r")]
    table = tmp_path / "named.csv"
    table.write_text("timestamp,signal,value\n" + "".join(rows))
    recording = open_recording(table)
    assert [len(signal.values) for signal in recording.read(["vx", "r"]).values()] == [5000, 5000]
    assert not recording.notes
    rows[50] = '0.25,"vx,25\n'
    table.write_text("timestamp,signal,value\n" + "".join(rows))
    recording = open_recording(table)
    assert [len(signal.values) for signal in recording.read(["vx", "r"]).values()] == [4999, 5000]
    assert [note.count for note in recording.notes] == [1]


def test_damaged_rows_of_pi_toolbox_are_counted_and_cost_no_others(tmp_path):
    head, block = "PiToolbox\r\n", "{ChannelBlock}\r\nTime\tv[m/s]\r\n"
    sound = "0\t1,5\t\r\n1\t2,5\t\r\n"  # a tabulator ends each row
    rows = f'{sound}\r\n2\r\n3\t"4\t\r\n4\t5.5\t\r\nnan\t1\t\r\n'
    other = f"{block}2\t3\t4\t5\r\n6\r\n"
    text = f"{head}{other}{block.replace('v[', 'w[')}{rows}{{End}}\r\n9"
    (tmp_path / "o.txt").write_bytes(text.encode())
    recording = open_recording(tmp_path / "o.txt")
    w = recording.read(["w"])["w"]
    np.testing.assert_array_equal(w.time, [0.0, 1.0, 3.0, 4.0])
    np.testing.assert_array_equal(w.values, [1.5, 2.5, np.nan, 5.5])
    lost = {note.what.split(",")[0]: note.count for note in recording.notes}
    assert lost == {"rows with too few or too many cells": 3, "cells that are no numbers": 1, "rows without a time": 1}


@pytest.mark.parametrize("damage", [b"\xff", b"\xff,\xff,\xff", b"\xd8\x00"])
@pytest.mark.parametrize("title", ["v [m/s]", "速度"])
def test_a_byte_of_no_encoding_far_behind_the_beginning_costs_its_row(tmp_path, capfd, title, damage):
    """The whole log was refused; and a library printed a traceback of its own where the row had too many cells."""
    rows = [f"{k},{k / 2:.1f}" for k in range(30_000)]
    encoding = "gb18030" if not title.isascii() else "utf-8"
    content = bytearray(f"t,{title}\n".encode(encoding) + "\n".join(rows).encode())
    at = content.index(b"\n29000,") + len("\n29000,")
    content[at : at + len(damage)] = damage
    (tmp_path / "log.csv").write_bytes(content)
    recording = open_recording(tmp_path / "log.csv")
    time_of = recording.read([info.name for info in recording.channels()])["t"].values
    np.testing.assert_array_equal(time_of, [k for k in range(30_000) if k != 29_000 or b"," not in damage])
    assert [note.count for note in recording.notes] == [1] and capfd.readouterr().err == ""


def test_a_drive_has_no_more_columns_than_a_log_may_have(tmp_path):
    """100,000 columns of three rows, 17 MB, took 1.5 GB; the time grew with the square of their number."""
    names = ["t", *(f"c{k}" for k in range(MOST_FIELDS + 1))]
    for count, said in ((2000, "the drive lacks vx"), (MOST_FIELDS + 1, "more than 20,000 columns")):
        wide = pa.Table.from_arrays([pa.array([0.0, 0.01, 0.02])] * count, names=names[:count])
        pq.write_table(wide, tmp_path / "d.parquet", use_dictionary=False, write_statistics=False)
        began = time.process_time()
        for opened in (read_drive, open_drive):
            with pytest.raises(SplitError, match=said):
                opened(tmp_path / "d.parquet")
        assert time.process_time() - began < 5.0
