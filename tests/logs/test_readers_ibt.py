"""Telemetry of iRacing: files of its layout, written here field by field, come back; damaged ones are refused."""

import struct

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.opening import open_recording

RATE = 60
TYPES = {np.dtype("?"): 1, np.dtype("i4"): 2, np.dtype("f4"): 4, np.dtype("f8"): 5}


def variable(name, kind, offset, count, unit, as_time=False):
    return struct.pack("<iii?3x32s64s32s", TYPES[np.dtype(kind)], offset, count, as_time, name, b"words", unit)


def write(path, columns, promised=None):
    """Write columns, name to (unit, array (N,) or (N, K), whether K are samples), as records behind their list."""
    first = next(iter(columns.values()))[1]
    table = np.dtype([(n, v.dtype, v.shape[1:]) for n, (_, v, _) in columns.items()])
    rows = np.zeros(len(first), dtype=table)
    listed = b""
    for name, (unit, values, as_time) in columns.items():
        rows[name] = values
        count = values.shape[1] if values.ndim > 1 else 1
        listed += variable(name.encode(), values.dtype, table.fields[name][1], count, unit.encode(), as_time)
    info = b"---\nWeekendInfo:\n"
    place, data = 144, 144 + len(listed) + len(info)
    head = struct.pack(
        "<10i2x2x4x", 2, 1, RATE, 0, len(info), 144 + len(listed), len(columns), place, 1, table.itemsize
    ) + struct.pack("<ii8x", 0, data)
    disk = struct.pack("<qddii", 1_700_000_000, 0.0, 1.0, 1, len(rows) if promised is None else promised)
    path.write_bytes(head.ljust(112, b"\0") + disk + listed + info + rows.tobytes())


def columns(seconds=30.0):
    t = 900.0 + np.arange(0.0, seconds, 1 / RATE)
    v, r = 40.0 + 5.0 * np.sin(0.3 * t), 0.2 * np.sin(0.9 * t)
    fine = (t[:, None] - np.arange(6)[::-1] / (6 * RATE)).astype("f8")
    return {
        "SessionTime": ("s", t, False),
        "Speed": ("m/s", v.astype("f4"), False),
        "Throttle": ("%", (0.5 + 0.5 * np.sin(t)).astype("f4"), False),
        "OnPitRoad": ("", np.zeros(len(t), dtype="?"), False),
        "CarIdxLapDistPct": ("%", np.zeros((len(t), 64), dtype="f4"), False),
        "LatAccel": ("m/s^2", (v * r).astype("f4"), False),
        "YawRate_ST": ("rad/s", (0.2 * np.sin(0.9 * fine)).astype("f4"), True),
    }


def test_what_was_written_comes_back_with_units_and_fine_samples_on_their_time(tmp_path):
    made = columns()
    write(tmp_path / "a.ibt", made)
    recording = open_recording(tmp_path / "a.ibt")
    units = {info.name: info.unit for info in recording.channels()}
    # Shares from 0 to 1 are called % there.
    assert units["Throttle"] == "1" and units["Speed"] == "m/s" and "CarIdxLapDistPct" not in units
    found = recording.read(["SessionTime", "Speed", "YawRate_ST"])
    np.testing.assert_array_equal(found["Speed"].values, made["Speed"][1])
    np.testing.assert_array_equal(found["Speed"].time, made["SessionTime"][1])
    np.testing.assert_allclose(found["YawRate_ST"].values, 0.2 * np.sin(0.9 * found["YawRate_ST"].time), atol=1e-5)
    draft = draft_map(recording)
    assert draft.of("r").sources == ("YawRate_ST",) and draft.of("r").status in ("judged", "unsided")


def test_a_cut_file_keeps_whole_records_and_counts_the_others(tmp_path):
    write(tmp_path / "a.ibt", columns())
    whole = (tmp_path / "a.ibt").read_bytes()
    (tmp_path / "b.ibt").write_bytes(whole[:-1000])
    recording = open_recording(tmp_path / "b.ibt")
    assert [note.count for note in recording.notes if "missing" in note.what][0] >= 3
    for length in (0, 100, 150, 200, 144 + 7 * 144 + 20):
        (tmp_path / "c.ibt").write_bytes(whole[:length])
        with pytest.raises(LogError):
            open_recording(tmp_path / "c.ibt")


def test_a_list_of_variables_that_leads_outside_is_refused(tmp_path):
    write(tmp_path / "a.ibt", columns(2.0))
    whole = bytearray((tmp_path / "a.ibt").read_bytes())
    for at, value in ((144 + 4, 10**6), (144 + 8, 10**6), (144, 99), (36, 0), (24, 10**9), (28, 10**9), (52, -5)):
        bad = bytearray(whole)
        bad[at : at + 4] = struct.pack("<i", value)
        (tmp_path / "b.ibt").write_bytes(bad)
        with pytest.raises(LogError):
            open_recording(tmp_path / "b.ibt")
