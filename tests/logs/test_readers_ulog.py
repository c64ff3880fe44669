"""PX4's ULog: logs of its layout, written here message by message, come back; damaged ones lose only that."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping
from tests.logs.planted import PlantedDrive

SYNC = bytes((0x2F, 0x73, 0x13, 0x20, 0x25, 0x0C, 0xBB, 0x12))
FORMATS = {
    "esc_report": "float rpm;uint8_t state;uint8_t[3] _padding0",
    "esc_status": "uint64_t timestamp;esc_report[2] esc;char[4] label;bool armed;uint8_t[3] _padding0",
    "vehicle_angular_velocity": "uint64_t timestamp;float[3] xyz",
    "vehicle_attitude": "uint64_t timestamp;float[4] q",
    "vehicle_local_position": "uint64_t timestamp;float x;float y;float z;float vx;float vy;float vz",
    "estimator_innovations": "uint64_t timestamp;float heading;float yawspeed",
    "sensor_combined": "uint64_t timestamp;float[3] accelerometer_m_s2",
}
ESC = struct.Struct("<QfB3xfB3x4s?")  # without what pads its end


def message(kind, content):
    return struct.pack("<HB", len(content), ord(kind)) + content


def head(formats=FORMATS, appended=()):
    flags = bytes(8) + bytes([bool(appended)]) + bytes(7) + struct.pack("<3Q", *[*appended, 0, 0, 0][:3])
    texts = [message("F", f"{name}:{fields};".encode()) for name, fields in formats.items()]
    return b"ULog\x01\x12\x35\x01" + bytes(8) + message("B", flags) + b"".join(texts)


def subscribe(number, name, instance=0):
    return message("A", struct.pack("<BH", instance, number) + name.encode())


def logged(number, content):
    return message("D", struct.pack("<H", number) + content)


def escs(count=50, number=4):
    t = 5_000_000 + 10_000 * np.arange(count)
    rows = [ESC.pack(int(s), 0.5 * k, k % 7, 2.0 * k, k % 5, b"left", k % 2) for k, s in enumerate(t)]
    return t, [logged(number, row) for row in rows]


def test_nested_messages_arrays_and_second_instances_come_back(tmp_path):
    t, rows = escs()
    _, second = escs(number=9)
    log = head() + subscribe(4, "esc_status") + subscribe(9, "esc_status", 1) + message("O", b"\x05\x00")
    (tmp_path / "a.ulg").write_bytes(log + b"".join(rows + second[:20]))
    recording = open_recording(tmp_path / "a.ulg")
    names = [info.name for info in recording.channels()]
    assert names == [
        f"/esc_status{which}/{field}"
        for which in ("", "_1")
        for field in ("esc[0].rpm", "esc[0].state", "esc[1].rpm", "esc[1].state", "armed")
    ]
    assert [(note.what, note.count) for note in recording.notes] == [("dropouts that the log states", 1)]
    found = recording.read(names)
    np.testing.assert_allclose(found["/esc_status/esc[1].rpm"].time + recording.origin, t * 1e-6, atol=1e-9)
    np.testing.assert_array_equal(found["/esc_status/esc[1].rpm"].values, 2.0 * np.arange(50))
    np.testing.assert_array_equal(found["/esc_status/esc[1].state"].values, np.arange(50) % 5)
    np.testing.assert_array_equal(found["/esc_status_1/armed"].values, np.arange(20) % 2)


def test_appended_messages_are_read_behind_one_that_the_power_cut_short(tmp_path):
    _, rows = escs()
    begin = head() + subscribe(4, "esc_status")
    place = len(begin) + sum(map(len, rows[:30])) + 11
    begin = head(appended=(place,)) + subscribe(4, "esc_status")
    (tmp_path / "a.ulg").write_bytes(begin + b"".join(rows[:30]) + rows[30][:11] + b"".join(rows[40:]))
    recording = open_recording(tmp_path / "a.ulg")
    values = recording.read(["/esc_status/esc[0].rpm"])["/esc_status/esc[0].rpm"].values
    np.testing.assert_array_equal(values, 0.5 * np.r_[0:30, 40:50])


def test_reading_goes_on_behind_a_damaged_stretch_at_the_next_mark(tmp_path):
    _, rows = escs()
    log = head() + subscribe(4, "esc_status") + b"".join(rows[:10])
    (tmp_path / "a.ulg").write_bytes(log + b"\xff" * 300 + message("S", SYNC) + b"".join(rows[20:]))
    recording = open_recording(tmp_path / "a.ulg")
    (note,) = recording.notes
    assert note.what.startswith("messages that are damaged") and note.count == 1
    values = recording.read(["/esc_status/esc[0].rpm"])["/esc_status/esc[0].rpm"].values
    np.testing.assert_array_equal(values, 0.5 * np.r_[0:10, 20:50])
    whole = log + b"".join(rows)
    for length in range(0, len(whole), 97):
        (tmp_path / "b.ulg").write_bytes(whole[:length])
        try:
            kept = open_recording(tmp_path / "b.ulg").read(["/esc_status/armed"])["/esc_status/armed"].values
        except LogError:
            continue
        np.testing.assert_array_equal(kept, np.arange(len(kept)) % 2)


@pytest.mark.parametrize(
    "formats",
    [
        {"a": "uint64_t timestamp;b[9999] x", "b": "c[9999] x", "c": "float[9999] x"},  # 10^12 numbers
        {"a": "uint64_t timestamp;b[9999] x", "b": "c[9999] x", "c": ""},  # as many of nothing
        {"a": "uint64_t timestamp;a x"},  # holds itself
        {"a": "uint64_t timestamp;unheard x"},
        {"a": "float x"},  # no time
        {"a": "uint64_t timestamp;float[] x"},
    ],
)
def test_definitions_that_cannot_be_are_refused_before_memory_is_taken(tmp_path, formats):
    log = head(formats) + subscribe(1, "a") + logged(1, bytes(64)) * 3
    (tmp_path / "a.ulg").write_bytes(log)
    with pytest.raises(LogError):
        open_recording(tmp_path / "a.ulg")
    # Beside a sound topic it is left out, and counted.
    _, rows = escs()
    log = head(FORMATS | formats) + subscribe(1, "a") + subscribe(4, "esc_status") + logged(1, bytes(64)) * 3
    (tmp_path / "a.ulg").write_bytes(log + b"".join(rows))
    recording = open_recording(tmp_path / "a.ulg")
    assert {info.name.split("/")[1] for info in recording.channels()} == {"esc_status"}
    assert [note.count for note in recording.notes] == [1, 3]


def test_what_an_estimator_finds_wrong_is_no_measured_yaw(tmp_path):
    # Seen in a public log: the ratio of a test of the heading was drafted as yaw, and nothing denied it.
    t = 10_000 * np.arange(3000)
    yaw = 0.5 * np.sin(0.4e-6 * t)
    log = head() + subscribe(1, "estimator_innovations") + subscribe(2, "vehicle_attitude")
    for s, psi in zip(t, yaw, strict=True):
        log += logged(1, struct.pack("<Q2f", int(s), 0.01 * np.sin(9 * s), 0.1))
        log += logged(2, struct.pack("<Q4f", int(s), np.cos(psi / 2), 0.0, 0.0, np.sin(psi / 2)))
    (tmp_path / "a.ulg").write_bytes(log)
    draft = draft_map(open_recording(tmp_path / "a.ulg"))
    assert not any("innovation" in source for entry in draft.suggestions for source in entry.sources)


def test_a_rover_whose_axes_are_forward_right_down_has_no_sides_that_are_called_judged(tmp_path):
    """Mirrored as a whole it agrees with itself; slashes in its addresses had passed for conventions of ROS."""
    planted = PlantedDrive(seconds=60.0, yaw=2.0)
    t = np.arange(0.0, 60.0, 0.04)
    c = {name: planted.at(name, t) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ax", "ay")}
    over_ground = np.exp(1j * c["yaw"]) * (c["vx"] + 1j * c["vy"])  # east, north
    half = 0.5 * (0.5 * np.pi - c["yaw"])
    topics = ("vehicle_local_position", "vehicle_attitude", "vehicle_angular_velocity", "sensor_combined")
    log = [head(), *(subscribe(*pair) for pair in enumerate(topics))]
    for k, s in enumerate((1e6 * t).astype(int)):
        north = (c["Y"][k], c["X"][k], 0.0, over_ground[k].imag, over_ground[k].real, 0.0)
        log += [
            logged(0, struct.pack("<Q6f", s, *north)),
            logged(1, struct.pack("<Q4f", s, np.cos(half[k]), 0.0, 0.0, np.sin(half[k]))),
            logged(2, struct.pack("<Q3f", s, 0.0, 0.0, -c["r"][k])),
            logged(3, struct.pack("<Q3f", s, c["ax"][k], -c["ay"][k], -9.81 + 0.1 * np.sin(7.0 * t[k]))),
        ]
    (tmp_path / "a.ulg").write_bytes(b"".join(log))
    recording = open_recording(tmp_path / "a.ulg")
    draft = draft_map(recording)
    assert {draft.of(name).status for name in ("X", "Y", "r", "ay")} == {"unsided"}
    assert "set `frame: frd`, and `world: ned`" in draft.by_gravity and not draft.left
    assert draft.of("vx").status == "open" and "axes of the world" in draft.of("vx").reason
    # As the advice says, the planted motion comes back.
    channels = {
        n: {"source": draft.of(n).sources[0], "unit": draft.of(n).unit} for n in ("X", "Y", "r", "ax", "ay")
    }
    quaternion = [f"/vehicle_attitude/q[{k}]" for k in (1, 2, 3, 0)]
    channels["yaw"] = {"source": quaternion, "convert": "yaw_from_quaternion"}
    channels["delta"] = {"source": "delta", "unit": "rad", "frame": "flu"}
    signals = recording.read([info.name for info in recording.channels()])
    signals["delta"] = RawSignal("delta", t, planted.at("delta", t), "rad")
    content = map_from_mapping({"frame": "frd", "world": "ned", "channels": channels}, where="map")
    settings = IngestSettings(derive=("velocity-from-pose", "torque-from-acceleration"))
    whole = TableRecording("a.ulg", tmp_path / "a.ulg", signals)
    columns = assemble_drive(whole, content, planted.vehicle, settings).drive.columns
    # Positions are stored to 4 mm; velocities are differences over some tenths of a second.
    for name, tolerance in (("r", 1e-3), ("ay", 2e-2), ("vx", 2e-2), ("vy", 3e-2)):
        away = columns[name] - planted.at(name, columns["t"])
        np.testing.assert_allclose(away[20:-20], 0.0, atol=tolerance, err_msg=name)
    turned = np.exp(1j * (columns["yaw"] - planted.at("yaw", columns["t"])))
    np.testing.assert_allclose(np.angle(turned), 0.0, atol=1e-3)
