"""Columns outside memory hold the same numbers, give their memory back, and make the same drives to the byte."""

import errno
import io
import re
import tempfile
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from split_cli.errors import LogError
from split_cli.logs import scratch
from split_cli.logs.assembling.clean import RawSeries, clean_series, resumptions
from split_cli.logs.assembling.resample import Resampled, SampleClock
from split_cli.logs.assembling.standstills import standstills_of
from split_cli.logs.assembling.synchronize import Channels, judge_sources, without_absent, without_missing
from split_cli.logs.readers import mcap, messages, open_recording
from split_cli.logs.scratch import GrowingColumn, are_finite, equal, let_go, room, set_aside
from split_cli.workflows.ingesting.ingest import IngestSettings, ingest_logs
from tests.optional import needed
from tests.studies import long_logs

SAMPLES = Path(__file__).parents[2] / "sample_logs"


@pytest.fixture
def everything_is_long(monkeypatch):
    for name, value in (("LONG", 100), ("FORESEEN", 100), ("PIECE", 64)):
        monkeypatch.setattr(scratch, name, value)


def test_columns_come_back_as_they_went(everything_is_long):
    values = np.random.default_rng(0).normal(size=1000)
    values[::7] = np.nan
    aside, space, growing = set_aside(values), room(1000), GrowingColumn()
    assert aside is not values and not aside.flags.writeable and set_aside(aside) is aside
    assert np.isnan(space).all()
    space[:] = values
    for first in range(0, 1000, 90):
        growing.append(values[first : first + 90])
    stamps = GrowingColumn(np.uint64)
    stamps.append(np.array([2**63 + 1] * 150, dtype=np.uint64))
    let_go()
    for found in (aside, space, growing.finished()):
        np.testing.assert_array_equal(found, values)
    assert set(stamps.finished().tolist()) == {2**63 + 1}
    short = values[:99]
    assert set_aside(short) is short


def test_a_column_of_foreseen_length_stays_in_memory_while_all_of_them_fit(monkeypatch):
    for name, value in (("LONG", 100), ("FORESEEN", 400), ("FORESEEN_BYTES", 8 * 500)):
        monkeypatch.setattr(scratch, name, value)
    files = []
    monkeypatch.setattr(tempfile, "TemporaryFile", lambda make=tempfile.TemporaryFile: files.append(1) or make())

    def column(count: int, expected: int) -> np.ndarray:
        growing = GrowingColumn(expected=expected)
        for first in range(0, count, 30):
            growing.append(np.arange(float(first), min(first + 30, count)))
        found = growing.finished()
        np.testing.assert_array_equal(found, np.arange(float(count)))
        return found

    column(100, 0)
    first = column(300, 290)  # foreseen a little too short
    assert not files
    column(101, 0)  # not foreseen
    column(401, 401)  # too long
    column(150, 250)  # beside the first one more than all may hold
    assert len(files) == 3
    del first
    column(150, 250)
    assert len(files) == 3


def test_a_plain_table_of_a_log_of_an_hour_and_a_half_needs_no_file(tmp_path, monkeypatch):
    """Files took a sixth of the time in which it is read."""

    def none_needed(*given, **named):
        raise OSError(errno.ENOSPC, "No space left on device")

    rows = scratch.LONG + 20_000
    path = tmp_path / "plain.csv"
    values = np.arange(float(rows)).round(1)
    pd.DataFrame({"t": values, "vx": 0.5 * values}).to_csv(path, index=False)
    monkeypatch.setattr(tempfile, "TemporaryFile", none_needed)
    found = open_recording(path).read(["t", "vx"])
    np.testing.assert_array_equal(found["t"].values, values)
    np.testing.assert_array_equal(found["vx"].values, 0.5 * values)


def in_use(kind: str = "VmRSS") -> int:
    """Return the memory of this process [bytes]; of kind ``RssFile`` what is mapped from files."""
    return int(re.search(rf"{kind}:\s+(\d+)", Path("/proc/self/status").read_text())[1]) * 1024


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the memory in use from /proc")
def test_memory_is_given_back():
    aside = set_aside(np.arange(5e6))
    before = in_use()
    assert aside.sum() == 12499997500000.0
    read = in_use()
    let_go()
    assert read - before > 30e6 and read - in_use() > 30e6
    assert aside.sum() == 12499997500000.0


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="reads the memory in use from /proc")
def test_no_step_of_ingest_holds_the_columns_that_it_looked_at():
    """Ten million rows took 1.4 GB when one step looked at one column after the other and let go of none."""
    rows, count = scratch.LONG + 10_000, 8
    t = 0.01 * np.arange(rows)
    rng = np.random.default_rng(1)
    columns = {f"c{number}": set_aside(rng.normal(size=rows)) for number in range(count)}
    raw = {"T": tuple(RawSeries("T", name, set_aside(t.copy()), values) for name, values in columns.items())}
    parts = [clean_series(part) for part in raw["T"]]
    channels = Channels({"T": parts}, {"T": ["continuous"] * count}, {}, ("T",), 0.1)
    grid = SampleClock(0.0, 0.01, np.arange(rows), np.zeros(rows, dtype=np.int32))
    resampled = {("T", index): Resampled(part.values, 1.0, (1.0,), False) for index, part in enumerate(parts)}
    for step in (
        lambda: resumptions(raw, 0.1),
        lambda: standstills_of(channels),
        lambda: [equal(part.time, parts[0].time) for part in parts],
        lambda: judge_sources(channels, resampled),
        lambda: without_missing(grid, columns, list(columns)),
        lambda: without_absent(channels, columns, grid, ()),
    ):
        let_go()
        before = in_use("RssFile")
        step()
        assert in_use("RssFile") - before < 3 * 8 * rows


def test_columns_are_compared_and_looked_at_as_a_whole(everything_is_long):
    values = np.arange(200.0)
    other = values.copy()
    assert equal(values, values) and equal(set_aside(values), other) and not equal(values, values[:-1])
    other[199] = np.nan
    assert not equal(values, other)
    np.testing.assert_array_equal(are_finite(set_aside(other)), np.isfinite(other))


def test_without_room_on_the_disk_columns_stay_in_memory_or_it_is_said(everything_is_long, monkeypatch):
    def full(*given, **named):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(tempfile, "TemporaryFile", full)
    values = np.arange(200.0)
    assert set_aside(values) is values
    assert np.isnan(room(200)).all()
    with pytest.raises(LogError, match="does not fit into the folder for temporary files.*TMPDIR"):
        GrowingColumn().append(values)


def test_a_machine_without_a_folder_for_temporary_files(everything_is_long, monkeypatch):
    def nowhere(*given, **named):
        raise FileNotFoundError(errno.ENOENT, "No usable temporary directory found")

    monkeypatch.setattr(tempfile, "TemporaryFile", nowhere)
    monkeypatch.setattr(tempfile, "gettempdir", nowhere)
    monkeypatch.setattr(tempfile, "tempdir", None)
    values = np.arange(200.0)
    assert set_aside(values) is values
    with pytest.raises(LogError, match="No usable temporary directory found.*TMPDIR"):
        GrowingColumn().append(values)


@pytest.mark.parametrize("kind", ["mcap", "parquet", "csv", "csv with text in it", "csv out of order"])
def test_a_long_recording_makes_the_same_drive(tmp_path, monkeypatch, kind):
    """Also with spikes, missing values, a delay, a cut, a sensor off the CG and a derived channel."""
    given = {"vehicle_path": SAMPLES / "road_car.yaml"}
    if kind == "mcap":
        log = SAMPLES / "road_handling_moderate.mcap"
        given |= {"maps": ["split_sim"]}
        derive = ("acceleration-from-velocity",)
        settings = IngestSettings(delays={"vy": 0.013}, cuts=((20.0, 25.0),), derive=derive)
    else:
        rng = np.random.default_rng(3)
        t = np.arange(0.0, 40.0, 0.01) + rng.uniform(-2e-4, 2e-4, 4000)
        table = pd.DataFrame(
            {
                "t": t,
                "vx": 10 + np.sin(t),
                "vy": 0.1 * np.cos(t),
                "r": 0.1 * np.sin(2 * t),
                "T": np.round(t) * 10.0,
                "delta": 0.05 * np.sin(2 * t),
            }
        )
        table["vx"] += rng.normal(0, 0.01, 4000)
        table.loc[1000:1010, "r"] = np.nan
        table.loc[2000, "vx"] = 90.0
        if kind == "csv out of order":
            table = pd.concat([table[:500], table[501:502], table[500:501], table[502:]])
        log = tmp_path / f"log.{kind.partition(' ')[0]}"
        if kind == "parquet":
            table.to_parquet(log)
        else:
            table.to_csv(log, index=False)
        if kind == "csv with text in it":
            log.write_text(re.sub(r"(?m)^(20\.\d+),[^,]+", r"\1,broken", log.read_text()))
        (tmp_path / "map.yaml").write_text(
            "time: {source: t, unit: s}\nchannels:\n"
            + "".join(f"  {name}: {{source: {name}}}\n" for name in ("vx", "r", "T", "delta"))
            + "  vy: {source: vy, position: {x: 0.3, y: 0.1}}\n"
        )
        given |= {"maps": [tmp_path / "map.yaml"]}
        settings = IngestSettings(delays={"vx": 0.004})
    drives = []
    for name in ("short", "long"):
        if name == "long":
            monkeypatch.setattr(scratch, "LONG", 100)
            monkeypatch.setattr(scratch, "FORESEEN", 100)
            monkeypatch.setattr(scratch, "PIECE", 64)
        (result,) = ingest_logs([log], tmp_path / f"{name}.parquet", settings=settings, **given).results
        drives.append((tmp_path / f"{name}.parquet").read_bytes())
        assert result.rows > 1000
    assert drives[0] == drives[1]


@pytest.mark.parametrize("kind", ["ros2.mcap", "outside.mcap", "bag", "db3", "mat", "7.3.mat", "mf4", "blf", "log"])
def test_a_long_log_of_any_format_makes_the_same_drive(tmp_path, monkeypatch, kind):
    """Read a batch, a chunk, a variable or a frame at a time, and its columns outside memory, or all at once."""
    for module in {"mf4": ("asammdf",), "blf": ("can", "cantools"), "log": ("can", "cantools")}.get(kind, ()):
        needed(module)
    t = np.arange(0.0, 12.0, 0.01)
    driven = {
        "t": t,
        "vx": 10 + np.sin(t),
        "vy": 0.1 * np.cos(t),
        "r": 0.1 * np.sin(2 * t),
        "T": np.round(t) * 10.0,
        "delta": 0.05 * np.sin(2 * t),
    }
    log, form = tmp_path / f"log.{kind}", kind.replace("outside", "ros2")
    long_logs.write_log(form, log, long_logs.LoggedLap(driven), 2000)
    if kind == "outside.mcap":
        log.write_bytes(without_chunks(log.read_bytes()))
    given = long_logs.arguments_of(form, tmp_path)
    options = dict(zip(given[::2], map(Path, given[1::2]), strict=True))
    maps, databases = ([options[key]] if key in options else [] for key in ("--map", "--dbc"))
    drives = []
    for name in ("short", "long"):
        if name == "long":
            for module, bound, size in (
                (scratch, "LONG", 100),
                (scratch, "FORESEEN", 100),
                (scratch, "PIECE", 64),
                (messages, "_BATCH_BYTES", 5000),
                (messages, "_FLUSH_BYTES", 20_000),
                (mcap, "_PIECE", 10_000),
                (scratch, "HELD", 70),
            ):
                monkeypatch.setattr(module, bound, size)
        out = tmp_path / f"{name}.parquet"
        (result,) = ingest_logs(
            [log], out, maps=maps, vehicle_path=SAMPLES / "road_car.yaml", message_paths=databases
        ).results
        assert 1900 < result.rows < 2100
        drives.append(out.read_bytes())
    assert drives[0] == drives[1]


def without_chunks(content: bytes) -> bytes:
    """Return an MCAP file with its messages outside of chunks and without an index."""
    from mcap.reader import make_reader
    from mcap.writer import Writer

    stream = io.BytesIO()
    writer = Writer(stream, use_chunking=False, enable_data_crcs=True)
    writer.start()
    channels = {}
    for schema, channel, message in make_reader(io.BytesIO(content)).iter_messages():
        if channel.id not in channels:
            known = writer.register_schema(schema.name, schema.encoding, schema.data)
            channels[channel.id] = writer.register_channel(channel.topic, channel.message_encoding, known)
        writer.add_message(channels[channel.id], message.log_time, message.data, message.publish_time)
    writer.finish()
    return stream.getvalue()
