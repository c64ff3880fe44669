"""Formats that a library of others reads in a process of its own: what comes over, and what does not harm us."""

import struct
import tempfile
import zlib

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import ReadNote
from split_cli.logs.readers.apart import open_apart
from split_cli.logs.readers.opening import open_recording
from split_cli.workflows.sources import find_sources
from tests.logs import libraries_apart
from tests.optional import needed


def opened(path, hand_over):
    return open_apart(path, hand_over, "numpy", "a file of numbers", "numbers")


@pytest.fixture
def log(tmp_path, monkeypatch):
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(scratch))
    path = tmp_path / "a.log"
    path.write_bytes(b"content")
    yield path
    assert list(scratch.iterdir()) == []


def test_columns_come_over_with_their_clocks_units_and_notes(log, capfd):
    recording = opened(log, libraries_apart.two_clocks)
    assert [(c.name, c.count, c.unit) for c in recording.channels()] == [
        ("Speed", 5, "km/h"),
        ("Gear", 5, None),
        ("Speed_2", 9, None),
        ("loose", 3, None),
    ]
    found = recording.read(["Speed", "Speed_2", "loose"])
    np.testing.assert_array_equal(found["Speed"].time, np.arange(5) / 10.0)
    np.testing.assert_array_equal(found["Speed_2"].values, np.arange(9.0))
    assert found["loose"].time is None and found["Speed"].unit == "km/h"
    assert recording.notes == [ReadNote("odd", "a.log", 7)] and capfd.readouterr().out == ""
    del recording, found


@pytest.mark.parametrize(
    ("hand_over", "said"),
    [
        (libraries_apart.failing, "is cut off or damaged"),
        (libraries_apart.dying, "ends the program that reads it"),
        (libraries_apart.greedy, "takes more memory than its size allows"),
        (libraries_apart.silent, "reading it did not end well"),
        (libraries_apart.wide, "more than 20,000 columns"),
        (libraries_apart.empty, "holds no channel with numbers"),
    ],
)
def test_what_a_library_does_to_its_process_is_one_error(log, hand_over, said):
    with pytest.raises(LogError, match=f"a.log: .*{said}") as caught:
        opened(log, hand_over)
    assert str(caught.value).isprintable()
    del caught


def test_a_missing_library_names_the_extra(log):
    with pytest.raises(LogError, match=r"a tale, which needs no_such_library. pip install 'split-cli\[tale\]'"):
        open_apart(log, libraries_apart.two_clocks, "no_such_library", "a tale", "tale")


def test_a_folder_is_searched_for_them(tmp_path):
    for name in ("a.xrk", "b.XRZ", "c.ulg", "d.tdms", "e.tdms_index"):
        (tmp_path / name).write_bytes(b"")
    assert [source.place for source in find_sources([tmp_path])] == ["a.xrk", "b.XRZ", "c.ulg", "d.tdms"]


@pytest.mark.parametrize(
    ("name", "content", "library", "extra"),
    [
        ("a.xrk", b"<hCNF\0\0\0\0\0\1>", "libxrk", "aim"),
        ("a.ulg", b"ULog\x01\x12\x35\x01" + bytes(8), "pyulog", "px4"),
        ("a.tdms", b"TDSm" + bytes(24), "nptdms", "tdms"),
    ],
)
def test_a_log_without_its_library_names_the_extra(name, content, library, extra, tmp_path, monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    (tmp_path / name).write_bytes(content)
    with pytest.raises(LogError, match=rf"needs {library}. pip install 'split-cli\[{extra}\]'"):
        open_recording(tmp_path / name)
    (tmp_path / name).write_bytes(bytes(5000))
    with pytest.raises(LogError, match="does not begin like one"):
        open_recording(tmp_path / name)


def motion(rate, seconds=60.0):
    t = np.arange(0.0, seconds, 1.0 / rate)
    speed, rate = 20.0 + 5.0 * np.sin(0.3 * t), 0.3 * np.sin(0.7 * t)
    return t, speed, rate


# -- AiM ---------------------------------------------------------------------------------------------------------------


def message(token, payload):
    """Return a message as AiM frames it: its name on both sides, its length before and its sum behind."""
    name = token.encode().ljust(4, b"\0")
    begin = b"<h" + name + struct.pack("<iB", len(payload), 1) + b">"
    return begin + payload + b"<" + name + struct.pack("<H", sum(payload) & 0xFFFF) + b">"


def aim_channel(index, name, unit, decoder, size):
    """Return the description of a channel: 112 bytes, of which a reader needs a few."""
    described = bytearray(112)
    struct.pack_into("<H10xB3xB3xB3x", described, 0, index, unit, 1, decoder)
    described[24:32], described[32:56] = (name.encode()[:end].ljust(end, b"\0") for end in (8, 24))
    struct.pack_into("<I4xB", described, 64, 20_000, size)
    return message("CHS", bytes(described))


def aim_log(seconds=60.0):
    """Return a recording with a speed at 10 Hz, and a yaw rate and an acceleration at 50 Hz."""
    channels = [("Speed", 16, 6, "<f4", 10), ("YawRate", 5, 6, "<f4", 50), ("LateralAcc", 3, 20, "<f2", 50)]
    described = b"".join(
        aim_channel(k, n, u, d, np.dtype(kind).itemsize) for k, (n, u, d, kind, _) in enumerate(channels)
    )
    t, v, r = motion(50, seconds)
    values = [3.6 * v, np.degrees(r), v * r / 9.80665]
    log = message("CNF", described)
    for row, time in enumerate(t):
        for k, (_, _, _, kind, rate) in enumerate(channels):
            if row % (50 // rate) == 0:
                stamp = struct.pack("<iH", 1000 + round(1000 * time), k)
                log += b"(S" + stamp + np.array(values[k][row], kind).tobytes() + b")"
    return log + message("RCR", b"driver\0")


@pytest.mark.parametrize("name", ["a.xrk", "a.xrz"])
def test_a_recording_of_aim_comes_back(tmp_path, name):
    needed("libxrk")
    (tmp_path / name).write_bytes(zlib.compress(aim_log()) if name.endswith("xrz") else aim_log())
    recording = open_recording(tmp_path / name)
    assert {c.name: c.unit for c in recording.channels()} == {"Speed": "km/h", "YawRate": "deg/s", "LateralAcc": "g"}
    found = recording.read(["Speed", "YawRate"])
    t, v, r = motion(50)
    # The logger's clock counts milliseconds, and its first sample is the start.
    np.testing.assert_allclose(found["Speed"].time, t[::5], atol=1e-9)
    np.testing.assert_allclose(found["Speed"].values, 3.6 * v[::5], rtol=1e-6)
    np.testing.assert_allclose(found["YawRate"].values, np.degrees(r), atol=2e-6)
    assert recording.notes == []
    draft = draft_map(recording)
    assert draft.of("vx").sources == ("Speed",) and draft.of("r").sources == ("YawRate",)


def test_damage_in_a_recording_of_aim_is_counted(tmp_path):
    needed("libxrk")
    whole = aim_log(5.0)
    damaged = bytearray(whole)
    damaged[-400:-390] = bytes(10)
    (tmp_path / "a.xrk").write_bytes(damaged)
    recording = open_recording(tmp_path / "a.xrk")
    (note,) = recording.notes
    assert note.what == "bytes that are no message of the logger, skipped" and 10 <= note.count <= 40
    (tmp_path / "a.xrk").write_bytes(whole[:300])
    with pytest.raises(LogError, match="a.xrk"):
        open_recording(tmp_path / "a.xrk")


# -- PX4 ---------------------------------------------------------------------------------------------------------------


def ulog(seconds=60.0):
    """Return a ULog with the velocity and attitude of a rover, and two accelerometers."""

    def part(kind, content):
        return struct.pack("<HB", len(content), ord(kind)) + content

    formats = {
        "vehicle_local_position": "uint64_t timestamp;float vx;float vy;bool xy_valid",
        "sensor_accel": "uint64_t timestamp;float[3] xyz",
    }
    log = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000) + part("B", bytes(40))
    log += b"".join(part("F", f"{name}:{fields};".encode()) for name, fields in formats.items())
    topics = [("vehicle_local_position", 0), ("sensor_accel", 0), ("sensor_accel", 1)]
    log += b"".join(part("A", struct.pack("<BH", number, k) + n.encode()) for k, (n, number) in enumerate(topics))
    t, v, r = motion(50, seconds)
    for row, time in enumerate(t):
        stamp = 5_000_000 + round(1e6 * time)
        log += part("D", struct.pack("<HQff?", 0, stamp, v[row], 0.0, True))
        for k in (1, 2):
            log += part("D", struct.pack("<HQ3f", k, stamp + 100 * k, 0.0, v[row] * r[row], -9.81))
    return log


def test_a_log_of_px4_comes_back(tmp_path):
    needed("pyulog")
    (tmp_path / "a.ulg").write_bytes(ulog(5.0))
    recording = open_recording(tmp_path / "a.ulg")
    names = [c.name for c in recording.channels()]
    assert sorted(names) == [
        *(f"sensor_accel.xyz[{axis}]" for axis in range(3)),
        *(f"sensor_accel_1.xyz[{axis}]" for axis in range(3)),
        *(f"vehicle_local_position.{field}" for field in ("vx", "vy", "xy_valid")),
    ]
    found = recording.read(["vehicle_local_position.vx", "sensor_accel_1.xyz[1]"])
    t, v, r = motion(50, 5.0)
    np.testing.assert_allclose(found["vehicle_local_position.vx"].time, 5.0 + t, atol=1e-6)
    np.testing.assert_allclose(found["vehicle_local_position.vx"].values, v, rtol=1e-6)
    np.testing.assert_allclose(found["sensor_accel_1.xyz[1]"].time, 5.0002 + t, atol=1e-6)
    np.testing.assert_allclose(found["sensor_accel_1.xyz[1]"].values, v * r, atol=1e-5)
    assert recording.notes == []
    damaged = bytearray(ulog(5.0))
    damaged[2000:2040] = bytes(40)
    (tmp_path / "c.ulg").write_bytes(damaged)
    assert [note.what for note in open_recording(tmp_path / "c.ulg").notes] == [
        "the log is damaged: what is no message was skipped"
    ]
    (tmp_path / "b.ulg").write_bytes(ulog(5.0)[:90])
    with pytest.raises(LogError, match="b.ulg"):
        open_recording(tmp_path / "b.ulg")


# -- TDMS --------------------------------------------------------------------------------------------------------------


def tdms(path, groups):
    """Write groups, name to channels, name to (properties, values)."""
    writer = needed("nptdms")
    objects = [
        writer.ChannelObject(group, name, values, properties=properties)
        for group, channels in groups.items()
        for name, (properties, values) in channels.items()
    ]
    with writer.TdmsWriter(str(path)) as file:
        file.write_segment(objects)


def test_waveforms_of_tdms_have_their_clocks_from_the_first_start(tmp_path):
    begin = np.datetime64("2026-11-29T10:00:00.000000")
    (t, v, _), (fine, _, r) = motion(10), motion(50)

    def wave(step, late, unit):
        start = begin + np.timedelta64(round(1e6 * late), "us")
        return {"wf_increment": step, "wf_start_offset": 0.0, "wf_start_time": start, "unit_string": unit}

    channels = {
        "GPS": {"Speed": (wave(0.1, 0.0, "km/h"), 3.6 * v)},
        "IMU": {"Yaw Rate": (wave(0.02, 0.25, "deg/s"), r)},
    }
    tdms(tmp_path / "a.tdms", channels)
    recording = open_recording(tmp_path / "a.tdms")
    assert [(c.name, c.unit) for c in recording.channels()] == [("Speed", "km/h"), ("Yaw Rate", "deg/s")]
    found = recording.read(["Speed", "Yaw Rate"])
    np.testing.assert_allclose(found["Speed"].time, t, atol=1e-9)
    np.testing.assert_allclose(found["Yaw Rate"].time, 0.25 + fine, atol=1e-9)
    np.testing.assert_array_equal(found["Yaw Rate"].values, r)


def test_groups_of_tdms_take_their_own_column_of_time(tmp_path):
    (t, v, _), (fine, _, r) = motion(10), motion(50)
    groups = {
        "GPS": {"Time": ({}, t), "Speed [m/s]": ({}, v), "Status": ({}, np.ones(len(t), "i4"))},
        "IMU": {"Time": ({}, fine), "Yaw Rate [rad/s]": ({}, r), "Status": ({}, np.zeros(len(fine), "i4"))},
        "Setup": {"Mass": ({}, np.array([255.0]))},
    }
    tdms(tmp_path / "a.tdms", groups)
    recording = open_recording(tmp_path / "a.tdms")
    names = {c.name: c.unit for c in recording.channels()}
    assert names["Speed"] == "m/s" and names["Yaw Rate"] == "rad/s" and {"GPS.Status", "IMU.Status"} <= names.keys()
    found = recording.read(["Speed", "Yaw Rate"])
    np.testing.assert_array_equal(found["Speed"].time, t)
    np.testing.assert_array_equal(found["Yaw Rate"].time, fine)


def test_of_tdms_without_clocks_the_longest_columns_are_a_table(tmp_path):
    t, v, _ = motion(10)
    channels = {"Time": ({}, t), "Speed [m/s]": ({}, v), "Status": ({}, np.ones(len(t), "i4"))}
    tdms(tmp_path / "b.tdms", {"Data": channels})
    alone = open_recording(tmp_path / "b.tdms")
    assert [c.name for c in alone.channels()] == ["Time", "Speed", "Status"]
    assert alone.read(["Speed"])["Speed"].time is None  # as the column of any table
    tdms(tmp_path / "c.tdms", {"A": {"x": ({}, t), "y": ({}, v)}, "B": {"z": ({}, v[:7])}})
    short = open_recording(tmp_path / "c.tdms")
    assert [c.name for c in short.channels()] == ["x", "y"]
    assert short.notes == [ReadNote("channels without a clock and of another length, left out", "c.tdms", 1)]
    whole = (tmp_path / "b.tdms").read_bytes()
    (tmp_path / "d.tdms").write_bytes(whole[:60])
    with pytest.raises(LogError, match="d.tdms"):
        open_recording(tmp_path / "d.tdms")
