"""Logs of MoTeC: files written here from the published layout come back; damaged and hostile ones are refused.

The writer below follows what is known of the format, field by field, and shares nothing with the reader.
"""

import struct

import numpy as np
import pytest

from split_cli.cli.main import main
from split_cli.errors import LogError
from split_cli.logs.assembling.gather import fitting_presets, gather
from split_cli.logs.drafting.suggest import draft_map
from split_cli.logs.readers.joint import JointRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import read_map
from split_cli.workflows.sources import find_sources

FIRST, ENTRY = 0x3448, 124
"""Where the chain of channels begins in files of a logger, and how long a description is [bytes]."""
KINDS = {"<i2": (3, 2), "<i4": (5, 4), "<f2": (7, 2), "<f4": (7, 4), "<f8": (8, 8)}


def head(channels, first=FIRST, data=0):
    """Return a head: mark, places, the device, and how many channels there are."""
    content = struct.pack("<I4xII20xI24x", 0x40, first, data, 0x6E2)
    content += struct.pack("<HHHI8sHHI4x", 0, 0x4240, 0xF, 12007, b"ADL", 420, 0x80, channels)
    return content.ljust(0x5E, b"\0") + b"23/11/2005".ljust(32, b"\0") + b"09:53:00".ljust(32, b"\0")


def written(path, channels, short_names=True):
    """Write channels, name to (unit, rate, raw samples, (shift, multiplier, scale, decimals)); return the content."""
    names = list(channels)
    place = FIRST + ENTRY * len(names)
    chain, samples = b"", b""
    for k, name in enumerate(names):
        unit, rate, raw, scaling = channels[name]
        kind, size = KINDS[raw.dtype.newbyteorder("<").str if raw.dtype.str[0] != "<" else raw.dtype.str]
        before = FIRST + ENTRY * (k - 1) if k else 0
        behind = FIRST + ENTRY * (k + 1) if k + 1 < len(names) else 0
        entry = struct.pack("<4I", before, behind, place + len(samples), len(raw))
        entry += struct.pack("<4H4h", 0x2EE1 + k, kind, size, rate, *scaling)
        entry += name.encode().ljust(32, b"\0")[:32]
        entry += (name.encode()[:7].ljust(8, b"\0") if short_names else b"") + unit.encode().ljust(12, b"\0")
        chain += entry.ljust(ENTRY, b"\0")
        samples += raw.tobytes()
    content = head(len(names), data=place).ljust(FIRST, b"\0") + chain + samples
    path.write_bytes(content)
    return content


def lap(seconds=60.0):
    """Return channels of a lap: wholes and floats of several sizes and rates."""

    def at(rate):
        return np.arange(0.0, seconds, 1.0 / rate)

    def v(t):
        return 20.0 + 5.0 * np.sin(0.3 * t)

    def r(t):
        return 0.3 * np.sin(0.7 * t)

    plain = (0, 1, 1, 0)
    return {
        "Ground Speed": ("km/h", 20, np.round(36.0 * v(at(20))).astype("<i2"), (0, 1, 1, 1)),
        "Gyro Yaw Velocity": ("deg/s", 50, np.round(np.degrees(r(at(50))) / 0.036).astype("<i2"), (0, 36, 10, 2)),
        "G Force Lat": ("G", 50, (v(at(50)) * r(at(50)) / 9.80665).astype("<f4"), plain),
        "Steered Angle": ("deg", 100, np.round(1e4 * r(at(100))).astype("<i4"), (0, 1, 1, 3)),
        "GPS Latitude": ("deg", 5, np.linspace(45.0, 45.01, len(at(5))), plain),
        "Baro Pres": ("kPa", 1, np.full(len(at(1)), 101.5).astype("<f2"), plain),
    }


def changed(content, *fields):
    """Return the content with fields (place, format, value) overwritten."""
    other = bytearray(content)
    for place, kind, value in fields:
        struct.pack_into(kind, other, place, value)
    return bytes(other)


def notes_of(recording):
    return {note.what: note.count for note in recording.notes}


def entry(number, offset=0):
    return FIRST + ENTRY * number + offset


def test_what_was_written_comes_back_each_channel_at_its_own_rate(tmp_path):
    made = lap()
    written(tmp_path / "a.ld", made)
    recording = open_recording(tmp_path / "a.ld")
    assert [(c.name, c.count) for c in recording.channels()] == [(name, len(c[2])) for name, c in made.items()]
    assert [c.unit for c in recording.channels()] == ["km/h", "deg/s", "g", "deg", "deg", "kPa"]
    found = recording.read(list(made))
    for name, (_, rate, raw, (shift, multiplier, scale, decimals)) in made.items():
        expected = (raw.astype(float) / scale / 10.0**decimals + shift) * multiplier
        # One rounding of a product against two of a quotient.
        np.testing.assert_allclose(found[name].values, expected, rtol=4e-16)
        np.testing.assert_array_equal(found[name].time, np.arange(len(raw)) / rate)
    assert recording.notes == []


def test_the_draft_of_a_log_finds_speed_yaw_rate_and_acceleration(tmp_path):
    written(tmp_path / "a.ld", lap())
    draft = draft_map(open_recording(tmp_path / "a.ld"))
    assert draft.of("vx").sources == ("Ground Speed",) and draft.of("r").sources == ("Gyro Yaw Velocity",)
    assert draft.of("r").status in ("judged", "unsided") and draft.of("ay").sources == ("G Force Lat",)


@pytest.mark.parametrize(
    ("raw", "scaling", "expected"),
    [
        (1141, (0, 6, 10, -1), 6846.0),  # revolutions as a logger of 2005 stores them
        (112, (0, 36, 10, 1), 40.32),  # degrees a second of the same
        (199, (0, 1, 1, 1), 19.9),
        (50, (-40, 2, 5, 0), -60.0),
    ],
)
def test_a_sample_is_scaled_shifted_and_multiplied_in_this_order(raw, scaling, expected, tmp_path):
    written(tmp_path / "a.ld", {"x": ("", 10, np.array([raw, raw], "<i2"), scaling)})
    values = open_recording(tmp_path / "a.ld").read(["x"])["x"].values
    np.testing.assert_allclose(values, expected, rtol=1e-15)


def test_units_are_found_where_a_file_has_no_short_names(tmp_path):
    made = lap()
    written(tmp_path / "a.ld", made, short_names=False)
    assert [c.unit for c in open_recording(tmp_path / "a.ld").channels()] == ["km/h", "deg/s", "g", "deg", "deg", "kPa"]


def test_names_that_occur_twice_are_numbered(tmp_path):
    long = "Suspension Position Front Left Filtered"
    content = written(
        tmp_path / "a.ld", {f"{long} {k}": ("mm", 10, np.full(9, k, "<i2"), (0, 1, 1, 0)) for k in (1, 2)}
    )
    recording = open_recording(tmp_path / "a.ld")
    first, second = (c.name for c in recording.channels())
    assert second == f"{first}_2" and recording.read([second])[second].values[0] == 2.0 and content
    assert notes_of(recording) == {"names of channels that occur again, numbered": 1}


def test_a_log_and_a_table_make_one_recording(tmp_path):
    """Each channel of a log has its own times: it needs no column of time to be joined."""
    written(tmp_path / "a.ld", lap())
    (tmp_path / "b.csv").write_text("time [s],vy [m/s]\n" + "".join(f"{0.1 * k:.1f},{0.01 * k}\n" for k in range(600)))
    joined = JointRecording([open_recording(tmp_path / name) for name in ("a.ld", "b.csv")])
    found = joined.read(["Ground Speed", "vy"])
    assert found["Ground Speed"].time[-1] == 59.95 and found["vy"].time[-1] == pytest.approx(59.9)


def test_the_preset_for_exports_takes_the_log_itself(tmp_path):
    """Its map names the column of time that an export has."""
    made = lap()
    written(tmp_path / "a.ld", made)
    recording = open_recording(tmp_path / "a.ld")
    assert fitting_presets(recording) == ("motec",)
    (speed,) = gather(recording, read_map(["motec"])).series["vx"]
    np.testing.assert_allclose(speed.values, made["Ground Speed"][2] / 36.0, rtol=1e-12)
    np.testing.assert_allclose(speed.time, np.arange(1200) / 20.0, atol=1e-9)


def test_a_listing_says_that_each_channel_has_its_clock(tmp_path, capsys):
    """It said that the time is a column, which nobody finds."""
    written(tmp_path / "a.ld", lap(2.0))
    for command in (["info", str(tmp_path / "a.ld")], ["ingest", str(tmp_path / "a.ld"), "--list"]):
        with pytest.raises(SystemExit, match="0"):
            main(command)
        assert "each channel has its own" in capsys.readouterr().out


def test_a_folder_is_searched_for_logs(tmp_path):
    written(tmp_path / "a.LD", lap(2.0))
    assert [source.place for source in find_sources([tmp_path])] == ["a.LD"]


@pytest.mark.parametrize(
    ("fields", "lost"),
    [
        ([(entry(2, 4), "<I", FIRST)], {"the chain of channels is broken: those behind are missing": 3}),
        ([(entry(2, 4), "<I", entry(2))], {"the chain of channels is broken: those behind are missing": 3}),
        ([(entry(2, 4), "<I", 2**32 - 1)], {"the chain of channels is broken: those behind are missing": 3}),
        ([(entry(0, 18), "<H", 9)], {"channels with samples of an unknown kind, left out": 1}),
        ([(entry(0, 20), "<H", 3)], {"channels with samples of an unknown kind, left out": 1}),
        ([(entry(0, 22), "<H", 0)], {"channels without a name, a rate or a scale, left out": 1}),
        ([(entry(0, 28), "<h", 0)], {"channels without a name, a rate or a scale, left out": 1}),
        ([(entry(0, 30), "<h", -999)], {"channels without a name, a rate or a scale, left out": 1}),
        ([(entry(0, 12), "<I", 0)], {"channels without samples, left out": 1}),
        ([(entry(5, 12), "<I", 2**32 - 1)], {"samples missing at the end of the file": 2**32 - 61}),
        ([(entry(5, 8), "<I", 2**32 - 1)], {"samples missing at the end of the file": 60}),
        ([(entry(0, 12), "<I", 1300)], {"samples that lie within those of another channel, left out": 100}),
    ],
)
def test_what_is_damaged_is_left_out_and_counted(fields, lost, tmp_path):
    made = lap()
    whole = written(tmp_path / "a.ld", made)
    sound = open_recording(tmp_path / "a.ld").read(list(made))
    (tmp_path / "b.ld").write_bytes(changed(whole, *fields))
    recording = open_recording(tmp_path / "b.ld")
    assert notes_of(recording) == lost
    for name, signal in recording.read([c.name for c in recording.channels()]).items():
        np.testing.assert_array_equal(signal.values, sound[name].values)


def test_a_cut_log_keeps_what_is_there(tmp_path):
    whole = written(tmp_path / "a.ld", lap())
    (tmp_path / "b.ld").write_bytes(whole[:-1000])
    recording = open_recording(tmp_path / "b.ld")
    # 60 samples of 2 bytes, then the last 110 of 8 bytes.
    assert notes_of(recording) == {"samples missing at the end of the file": 170}
    assert [c.name for c in recording.channels()][-1] == "GPS Latitude"
    for length in (0x59, 0x5A, FIRST, FIRST + 50, FIRST + 6 * ENTRY):
        (tmp_path / "c.ld").write_bytes(whole[:length])
        with pytest.raises(LogError):
            open_recording(tmp_path / "c.ld")


def test_channels_that_share_their_samples_do_not_multiply_them(tmp_path):
    """Twenty thousand channels over one stretch would unfold a file of 2 MB into 40 GB."""
    made = {f"c{k}": ("", 10, np.array([k], "<i2"), (0, 1, 1, 0)) for k in range(5000)}
    content = written(tmp_path / "a.ld", made)
    last = len(content) - 2
    fields = [(entry(k, 8), "<I", FIRST) for k in range(5000)]
    fields += [(entry(k, 12), "<I", (last - FIRST) // 2) for k in range(5000)]
    (tmp_path / "b.ld").write_bytes(changed(content, *fields))
    recording = open_recording(tmp_path / "b.ld")
    assert sum(c.count for c in recording.channels()) * 2 <= len(content)
    assert list(notes_of(recording)) == ["samples that lie within those of another channel, left out"]


def test_more_channels_than_any_log_has_are_refused(tmp_path):
    """A chain without end in a file of zeros: every description points 1 byte further."""
    content = bytearray(head(1).ljust(FIRST + 30_000, b"\0"))
    for k in range(0, 30_000 - ENTRY, 8):
        struct.pack_into("<I", content, FIRST + k + 4, FIRST + k + 8)
    (tmp_path / "b.ld").write_bytes(content)
    with pytest.raises(LogError, match="holds no channel with samples"):
        open_recording(tmp_path / "b.ld")
    many = {f"c{k}": ("", 10, np.array([k], "<i2"), (0, 1, 1, 0)) for k in range(20_001)}
    written(tmp_path / "c.ld", many)
    with pytest.raises(LogError, match="more than 20,000 columns"):
        open_recording(tmp_path / "c.ld")


def test_another_binary_file_of_this_name_is_refused_in_one_line(tmp_path):
    (tmp_path / "a.ld").write_bytes(b"\x7fELF" + bytes(4000))
    with pytest.raises(LogError, match="is named like a MoTeC log but does not begin like one"):
        open_recording(tmp_path / "a.ld")
    (tmp_path / "a.bin").write_bytes(b"\x40" + bytes(4000))
    with pytest.raises(LogError, match="is of no known format"):
        open_recording(tmp_path / "a.bin")
