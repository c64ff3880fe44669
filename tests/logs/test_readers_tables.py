"""Tables: the planted drive comes back from text, Parquet, Arrow, MAT and MDF, with its units."""

import datetime
import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow
import pytest

import tests.logs.readers_support as support
from split_cli.errors import LogError
from split_cli.logs.readers import delimited, open_recording
from tests.optional import needed

COUNT = 400


@pytest.fixture(scope="module")
def planted():
    return support.plant(count=COUNT)


def table_of(planted):
    """Return the planted columns; the times relative, so that text of 17 digits holds them exactly."""
    return {"t": (planted.header - planted.header[0]) * 1e-9, "vx": planted.vx, "vy": planted.vy, "r": planted.r}


UNITS = {"t": "s", "vx": "m/s", "vy": "m/s", "r": "rad/s"}


def text_of(planted, separator=",", decimal=".", quote="", newline="\n"):
    columns = table_of(planted).values()
    rows = zip(
        *[[quote + repr(float(v)).replace(".", decimal) + quote for v in column] for column in columns], strict=True
    )
    return newline.join(separator.join(row) for row in rows) + newline


MOTEC = (
    '"Format","MoTeC CSV File",,,"Workbook",""\n"Venue","Somewhere",,,"Worksheet",""\n'
    '"Sample Rate","100.000","Hz",,"Duration","4.000"\n"Beacon Markers","81.2 164.7"\n\n\n'
    '"t","vx","vy","r"\n"s","m/s","m/s","rad/s"\n\n\n'
)
AIM = (
    '"Format","AiM CSV File"\n"Session","Somewhere"\n"Date","Saturday, 4 May"\n"Sample Rate","100"\n'
    '"Segment Times","1:20.1","1:21.5"\n\n"t","vx","vy","r"\n"s","m/s","m/s","rad/s"\n\n'
)
LAYOUTS = {
    "units in the header": lambda p: "t(s),vx(m/s),vy [m/s],r(rad/s)\n" + text_of(p),
    "hash before the header": lambda p: "# t(s),vx(m/s),vy(m/s),r(rad/s)\n" + text_of(p),
    "comments before the header": lambda p: "# recorded by hand, twice\n# t(s),vx(m/s),vy(m/s),r(rad/s)\n" + text_of(p),
    "semicolon and decimal comma": lambda p: "t;vx;vy;r\ns;m/s;m/s;rad/s\n" + text_of(p, ";", ","),
    "tab": lambda p: "t\tvx\tvy\tr\n[s]\t[m/s]\t[m/s]\t[rad/s]\n" + text_of(p, "\t"),
    "tab and decimal comma": lambda p: "t\tvx\tvy\tr\n[s]\t[m/s]\t[m/s]\t[rad/s]\n" + text_of(p, "\t", ","),
    "byte order mark": lambda p: "\ufefft(s),vx(m/s),vy(m/s),r(rad/s)\n" + text_of(p),
    "Windows line ends": lambda p: "t(s),vx(m/s),vy(m/s),r(rad/s)\r\n" + text_of(p, newline="\r\n"),
    "MoTeC export": lambda p: MOTEC + text_of(p, quote='"'),
    "AiM export": lambda p: AIM + text_of(p, quote='"'),
    "separator at every line's end": lambda p: "t(s),vx(m/s),vy(m/s),r(rad/s),\n" + text_of(p).replace("\n", ",\n"),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_text_layouts(tmp_path, planted, layout):
    path = tmp_path / "drive.csv"
    path.write_bytes(LAYOUTS[layout](planted).encode())
    recording = open_recording(path)
    assert {channel.name: channel.unit for channel in recording.channels()} == UNITS
    signals = recording.read(list(UNITS))
    for name, expected in table_of(planted).items():
        np.testing.assert_array_equal(signals[name].values, expected)
        assert signals[name].unit == UNITS[name]
    assert recording.notes == []


@pytest.mark.parametrize("ending", ["1,2,3,4\n", "1,2,3,4", "1,2\n\n\n", "1,2,three,4\n5,6,7,8\n"])
@pytest.mark.parametrize("part", [7, 1000, 1 << 24])
def test_threads_read_what_one_stream_reads(tmp_path, planted, monkeypatch, ending, part):
    """Wherever a long text is parted between threads: also a part of blank lines, and a last line without its end."""
    path = tmp_path / "drive.csv"
    path.write_text("t(s),vx(m/s),vy(m/s),r(rad/s)\n" + text_of(planted) + ending)
    monkeypatch.setattr(delimited, "TABLE_BYTES", part)
    found = []
    for processors in (1, 2):
        monkeypatch.setattr(pyarrow, "cpu_count", lambda count=processors: count)
        recording = open_recording(path)
        found.append((recording.read(list(UNITS)), recording.notes))
    (one, notes), (other, same) = found
    assert notes == same and len(one["t"].values) == COUNT + ending.count(",4") + ending.count(",8")
    for name in UNITS:
        np.testing.assert_array_equal(one[name].values, other[name].values)


@pytest.mark.parametrize("encoding", ["latin-1", "utf-8", "utf-16"])
def test_encodings(tmp_path, planted, encoding):
    path = tmp_path / "drive.csv"
    path.write_bytes(("Größe(s),vx(m/s),vy(m/s),Winkel(°/s)\n" + text_of(planted)).encode(encoding))
    recording = open_recording(path)
    assert [(c.name, c.unit) for c in recording.channels()][::3] == [("Größe", "s"), ("Winkel", "deg/s")]
    np.testing.assert_array_equal(recording.read(["Winkel"])["Winkel"].values, planted.r)


def test_suffix_units_and_preamble_of_mixed_width(tmp_path):
    lines = ["Logger 4", "Car;17", "", "time_ms;vx_kmh;steer_deg;note", *[f"{n};{n}.5;-{n};ok" for n in range(50)]]
    (tmp_path / "a.txt").write_text("\n".join(lines))
    recording = open_recording(tmp_path / "a.txt")
    listed = {c.name: (c.type_name, c.unit) for c in recording.channels()}
    assert listed == {
        "time_ms": ("column", "ms"),
        "vx_kmh": ("column", "km/h"),
        "steer_deg": ("column", "deg"),
        "note": ("text", None),
    }
    np.testing.assert_array_equal(recording.read(["vx_kmh"])["vx_kmh"].values, np.arange(50) + 0.5)
    with pytest.raises(LogError, match="'note' holds text"):
        recording.read(["note"])


@pytest.mark.parametrize("cells", [("inf", "-inf"), ("Infinity", "1e999"), ("inf", "nan")])
def test_a_column_of_infinite_values_holds_numbers(tmp_path, cells):
    """It was said to hold text."""
    (tmp_path / "a.csv").write_text("t,vx\n" + "".join(f"{n}.5,{cells[n % 2]}\n" for n in range(50)))
    recording = open_recording(tmp_path / "a.csv")
    assert {info.name: info.type_name for info in recording.channels()} == {"t": "column", "vx": "column"}
    assert not np.isfinite(recording.read(["vx"])["vx"].values).any()


def test_two_columns_with_decimal_commas(tmp_path):
    # Splitting at the commas gives two numbers a row as well.
    (tmp_path / "a.csv").write_text("a;b\n" + "".join(f"{n},5;{n},25\n" for n in range(20)))
    signals = open_recording(tmp_path / "a.csv").read(["a", "b"])
    np.testing.assert_array_equal(signals["a"].values, np.arange(20) + 0.5)
    np.testing.assert_array_equal(signals["b"].values, np.arange(20) + 0.25)


def test_no_header_numbers_the_columns_and_says_so(tmp_path, planted):
    (tmp_path / "a.csv").write_text(text_of(planted))
    recording = open_recording(tmp_path / "a.csv")
    np.testing.assert_array_equal(recording.read(["column2"])["column2"].values, planted.vx)
    assert "no header" in recording.notes[0].what


def test_bad_cells_are_missing_and_counted(tmp_path):
    rows = [f"{n},{n * 0.1},{n}" for n in range(100)]
    rows[20], rows[21], rows[22], rows[23] = "20,oops,20", "21,,21", "22,#DIV/0!,22", "23,nan,23"
    rows[40], rows[50] = "40,4.0", "50,5.0,50,extra"
    (tmp_path / "a.csv").write_text("t,a,b\n" + "\n".join(rows) + "\n99.5,9.")
    recording = open_recording(tmp_path / "a.csv")
    for _ in range(2):
        signals = recording.read(["t", "a"])
    expected = np.delete(np.arange(100), [40, 50])
    np.testing.assert_array_equal(signals["t"].values, expected)
    values = expected * 0.1
    values[20:24] = np.nan
    np.testing.assert_array_equal(signals["a"].values, values)
    # An empty cell and a written nan are missing; only words are bad. Three rows are too short or too long.
    counts = {note.what.split(",")[0]: note.count for note in recording.notes}
    assert counts == {"cells that are no numbers": 2, "rows with too few or too many cells": 3}


def test_times_of_day_and_switches_become_numbers(tmp_path):
    start = datetime.datetime(2024, 5, 4, 10, 0, 0, 250_000, tzinfo=datetime.UTC)
    moments = [start + datetime.timedelta(milliseconds=10 * n) for n in range(30)]
    rows = [f"{moment.isoformat()},{n},{n / 7!r},{'true' if n % 3 else 'False'}" for n, moment in enumerate(moments)]
    (tmp_path / "a.csv").write_text("time,n,x,on\n" + "\n".join(rows))
    signals = open_recording(tmp_path / "a.csv").read(["time", "on", "n"])
    expected = start.timestamp() + 0.01 * np.arange(30)
    # A double near 1.7e9 s resolves 0.24 us.
    np.testing.assert_allclose(signals["time"].values, expected, rtol=0, atol=5e-7)
    np.testing.assert_array_equal(signals["on"].values, np.arange(30) % 3 > 0)


def test_columns_of_the_same_name_are_numbered(tmp_path):
    (tmp_path / "a.csv").write_text("v,v,v\n" + "".join(f"{n},{n + 1},{n + 2}\n" for n in range(9)))
    recording = open_recording(tmp_path / "a.csv")
    assert [channel.name for channel in recording.channels()] == ["v", "v_2", "v_3"]
    np.testing.assert_array_equal(recording.read(["v_3"])["v_3"].values, np.arange(9) + 2)
    assert recording.notes[0].count == 2


def test_names_that_repeat_are_told_apart_by_the_devices_under_them(tmp_path):
    """As RaceChrono writes: names, units and devices in three rows, the names not the last of them."""
    path = tmp_path / "session.csv"
    preamble = 'This file is created using RaceChrono Pro\nFormat,3\nSession title,"Lake"\nNote,\n\n'
    header = "timestamp,lap_number,speed,latitude,speed\nunix time,,m/s,deg,m/s\n,,100: gps,100: gps,calc\n"
    rows = "".join(f"{1767150797 + 0.04 * k:.2f},8,{30 + k},31.07,{31 + k}\n" for k in range(40))
    path.write_text(preamble + header + rows)
    recording = open_recording(path)
    names = {info.name: info.unit for info in recording.channels()}
    assert list(names) == ["timestamp", "lap_number", "speed gps", "latitude", "speed calc"]
    assert names["speed calc"] == "m/s" and names["latitude"] == "deg"
    read = recording.read(["speed gps", "speed calc"])
    assert np.array_equal(read["speed calc"].values - read["speed gps"].values, np.ones(40))


def test_text_in_the_middle_of_a_large_file_is_found(tmp_path):
    # Past the first block of the parser, which is where a guess of the type from the beginning breaks.
    count = 300_000
    lines = [f"{n},{n * 0.5!r}" for n in range(count)]
    lines[250_000] = "250000,sensor lost"
    (tmp_path / "a.csv").write_text("t,a\n" + "\n".join(lines))
    recording = open_recording(tmp_path / "a.csv")
    values = recording.read(["a"])["a"].values
    assert len(values) == count and np.flatnonzero(np.isnan(values)).tolist() == [250_000]
    assert recording.notes[0].count == 1


@pytest.mark.parametrize("kind", ["parquet", "feather"])
def test_arrow_formats(tmp_path, planted, kind):
    frame = pd.DataFrame(table_of(planted)).rename(columns={"vx": "vx(m/s)"})
    frame["stamp"] = pd.to_datetime(planted.header)
    frame["on"] = np.arange(COUNT) % 2 == 0
    frame["gear"] = pd.array([None if n == 3 else n for n in range(COUNT)], dtype="Int16")
    frame["note"] = "text"
    frame["twist.linear.x"] = planted.vy
    frame["x[0]"], frame["x[1]"] = planted.r, -planted.r
    path = tmp_path / f"drive.{kind}"
    getattr(frame, f"to_{kind}")(path)
    recording = open_recording(path)
    assert {c.name: c.unit for c in recording.channels()}["vx"] == "m/s"
    signals = recording.read(["vx", "stamp", "on", "gear"])
    np.testing.assert_array_equal(signals["vx"].values, planted.vx)
    np.testing.assert_allclose(signals["stamp"].values, planted.header * 1e-9, rtol=0, atol=5e-7)
    np.testing.assert_array_equal(signals["on"].values, np.arange(COUNT) % 2 == 0)
    np.testing.assert_array_equal(signals["gear"].values, [np.nan if n == 3 else n for n in range(COUNT)])
    signals = recording.read(["twist.linear.x", "x[0]", "x[1]"])
    np.testing.assert_array_equal(signals["twist.linear.x"].values, planted.vy)
    np.testing.assert_array_equal(signals["x[1]"].values, -planted.r)
    with pytest.raises(LogError, match="not numbers"):
        recording.read(["note"])
    with pytest.raises(LogError, match="Did you mean vx"):
        recording.read(["vxx"])


@pytest.mark.parametrize("version", ["4", "5", "7.3"])
def test_mat_versions(tmp_path, planted, version):
    table = table_of(planted)
    path = tmp_path / "drive.mat"
    if version == "7.3":
        write_hdf5(path, {"log": {"car": table}, "xyz": np.stack([planted.vx, planted.vy, planted.r], axis=1)})
    elif version == "4":
        from scipy.io import savemat

        savemat(path, table, format="4")
    else:
        from scipy.io import savemat

        content = {"log": {"car": table}, "xyz": np.stack([planted.vx, planted.vy, planted.r], axis=1)}
        savemat(path, {**content, "mode": "fast", "rate": 100.0})
    recording = open_recording(path)
    prefix = "" if version == "4" else "log.car."
    signals = recording.read([prefix + name for name in table])
    for name, expected in table.items():
        np.testing.assert_array_equal(signals[prefix + name].values, expected)
    if version != "4":
        np.testing.assert_array_equal(recording.read(["xyz[2]"])["xyz[2]"].values, planted.r)
        assert not {"mode", "rate"} & {channel.name for channel in recording.channels()}


def write_hdf5(path, content):
    """Write as MATLAB 7.3 does: a block of 512 bytes before the HDF5 file, and arrays transposed."""
    import h5py

    def write(group, values):
        for name, value in values.items():
            if isinstance(value, dict):
                write(group.create_group(name), value)
            else:
                array = np.atleast_2d(np.asarray(value)) if np.ndim(value) < 2 else np.asarray(value).T
                group.create_dataset(name, data=array).attrs["MATLAB_class"] = np.bytes_("double")

    with h5py.File(path, "w", userblock_size=512) as file:
        write(file, content)
    with path.open("r+b") as stream:
        stream.write(b"MATLAB 7.3 MAT-file, Platform: PCWIN64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("version", ["5", "7.3"])
def test_simulink_structures_keep_their_own_clocks(tmp_path, planted, version):
    table = table_of(planted)
    signals = {"values": planted.vx.reshape(-1, 1), "dimensions": 1.0}
    content = {
        "speed": {"time": table["t"].reshape(-1, 1), "signals": signals},
        "rate": {"Time": table["t"][::2].reshape(-1, 1), "Data": planted.r[::2].reshape(-1, 1)},
    }
    path = tmp_path / "sim.mat"
    if version == "7.3":
        write_hdf5(path, content)
    else:
        from scipy.io import savemat

        savemat(path, content)
    read = open_recording(path).read(["speed.signals.values", "rate.Data"])
    np.testing.assert_array_equal(read["speed.signals.values"].time, table["t"])
    np.testing.assert_array_equal(read["speed.signals.values"].values, planted.vx)
    np.testing.assert_array_equal(read["rate.Data"].time, table["t"][::2])


@pytest.mark.parametrize(("version", "suffix"), [("4.10", "mf4"), ("4.11", "dat"), ("3.30", "mdf")])
def test_mdf_channels_have_their_own_clocks(tmp_path, planted, version, suffix):
    asammdf = needed("asammdf")
    table = table_of(planted)
    t, path = table["t"], tmp_path / f"drive.{suffix}"
    signal = asammdf.Signal
    with asammdf.MDF(version=version) as file:
        file.append([signal(planted.vx, t, name="vx", unit="m/s"), signal(planted.r, t, name="r", unit="deg/sec")])
        file.append(
            [signal(planted.vy[::4], t[::4], name="vy", unit="km/h"), signal(-planted.vx[::4], t[::4], name="vx")]
        )
        # The writer insists on suffixes of its own.
        file.save(tmp_path / "saved", overwrite=True).rename(path)
    recording = open_recording(path)
    listed = {channel.name: (channel.unit, channel.count) for channel in recording.channels()}
    slow = len(t[::4])
    assert listed == {
        "group0.vx": ("m/s", COUNT),
        "r": ("deg/s", COUNT),
        "vy": ("km/h", slow),
        "group1.vx": (None, slow),
    }
    read = recording.read(list(listed))
    np.testing.assert_array_equal(read["group0.vx"].values, planted.vx)
    np.testing.assert_array_equal(read["group1.vx"].values, -planted.vx[::4])
    np.testing.assert_array_equal(read["vy"].time, t[::4])
    np.testing.assert_array_equal(read["r"].time, t)


def test_without_asammdf_the_extra_is_named(tmp_path):
    (tmp_path / "a.mf4").write_bytes(b"MDF     4.10    " + bytes(200))
    code = (
        "import sys; sys.modules['asammdf'] = None\n"
        "from split_cli.errors import LogError\nfrom split_cli.logs.readers import open_recording\n"
        "try:\n    open_recording(sys.argv[1])\nexcept LogError as error:\n    print(error)\n"
    )
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "a.mf4"], capture_output=True, text=True, check=True)
    assert "split-cli[mf4]" in done.stdout


@pytest.mark.parametrize(
    ("first", "second"),
    [
        ("14-Mar-2026 23:59:59.500", "15-Mar-2026 00:00:00.000"),
        ("3 March 2026 08:00:00.25", "3 March 2026 08:00:00.75"),
        ("11:59:59.500 AM", "12:00:00.000 PM"),
        ("03/14/2026 11:59:59.75 pm", "03/15/2026 12:00:00.25 am"),
    ],
)
def test_months_by_name_and_halves_of_the_day_are_read(tmp_path, first, second):
    (tmp_path / "lap.csv").write_text(f"time,vx\n{first},1.0\n{second},2.0\n")
    read = open_recording(tmp_path / "lap.csv").read(["time"])["time"]
    assert np.diff(read.values) == pytest.approx(0.5, abs=1e-6)


def test_runs_of_blanks_part_columns_only_where_nothing_else_does(tmp_path):
    (tmp_path / "aligned.txt").write_text(
        "   t     vx    vy\n" + "".join(f"  {0.01 * i:5.2f}  {i:4d}  -0.5\n" for i in range(20))
    )
    aligned = open_recording(tmp_path / "aligned.txt").read(["t", "vx", "vy"])
    assert aligned["vx"].values == pytest.approx(np.arange(20.0)) and aligned["t"].values[-1] == pytest.approx(0.19)
    # A run of a million blanks is no work.
    (tmp_path / "long.txt").write_text(
        "t vx\n" + "".join(f"{i} {' ' * 1_000_000 if i == 9 else ''}{i}\n" for i in range(20))
    )
    assert open_recording(tmp_path / "long.txt").read(["vx"])["vx"].values == pytest.approx(np.arange(20.0))
    (tmp_path / "dated.csv").write_text("time,vx\n" + "".join(f"2026-03-14 10:00:{i:02d},{i}\n" for i in range(20)))
    assert [info.name for info in open_recording(tmp_path / "dated.csv").channels()] == ["time", "vx"]
