"""Bags: the planted drive comes back bit for bit from every storage; definitions from where they are."""

import shutil

import numpy as np
import pytest
import zstandard

import tests.logs.readers_support as support
from split_cli.errors import LogError
from split_cli.logs.readers import open_recording
from tests.logs.readers_support import FIELDS, check_planted

HUMBLE = "nav_msgs/msg/Odometry"


def humble_bag(path, planted):
    store = support.ros2_store()
    messages = [(log, payload) for _, log, _, payload in support.cdr_messages(store, planted)]
    return support.write_humble_db3(path, {"/odom": (HUMBLE, messages)})


@pytest.mark.parametrize("storage", ["SQLITE3", "MCAP"])
def test_rosbag2_folder(tmp_path, storage):
    planted = support.plant()
    recording = open_recording(support.write_rosbag2(tmp_path / "bag", planted, storage))
    check_planted(recording, planted, ("header", "log"))
    # The program that writes these bags leaves the checksums of MCAP out.
    assert ["without a checksum" in note.what for note in recording.notes] == [True] * (storage == "MCAP")
    # Its metadata file stands for the folder.
    check_planted(open_recording(tmp_path / "bag" / "metadata.yaml"), planted, ("header", "log"))


@pytest.mark.parametrize("compression", [None, "BZ2", "LZ4"])
def test_ros1_bag(tmp_path, compression):
    planted = support.plant()
    recording = open_recording(support.write_bag1(tmp_path / "drive.bag", planted, compression))
    assert recording.clocks == ("header", "log")
    check_planted(recording, planted, recording.clocks)


def test_a_bare_database_without_definitions_uses_the_common_ones(tmp_path):
    planted = support.plant()
    recording = open_recording(humble_bag(tmp_path / "rosbag2_0.db3", planted))
    assert recording.clocks == ("header", "log")
    check_planted(recording, planted, recording.clocks)


@pytest.mark.parametrize("listed", [True, False])
def test_a_split_recording_is_one(tmp_path, listed):
    planted = support.plant(count=240)
    folder = tmp_path / "bag"
    folder.mkdir()
    names = []
    # Ten parts and more: their order is by number, and 10 comes after 9.
    for part in range(12):
        rows = slice(part * 20, (part + 1) * 20)
        piece = support.Planted(planted.header[rows], planted.vx[rows], planted.vy[rows], planted.r[rows])
        names.append(humble_bag(folder / f"bag_{part}.db3", piece).name)
    if listed:
        lines = "".join(f"    - {name}\n" for name in names)
        (folder / "metadata.yaml").write_text(
            f"rosbag2_bagfile_information:\n  version: 4\n  storage_identifier: sqlite3\n"
            f"  relative_file_paths:\n{lines}"
        )
    recording = open_recording(folder)
    check_planted(recording, planted, ("header", "log"))
    assert {channel.count for channel in recording.channels()} == {240}
    assert bool(recording.notes) is not listed


def test_a_missing_part_is_said(tmp_path):
    folder = support.write_rosbag2(tmp_path / "bag", support.plant(), "SQLITE3")
    metadata = folder / "metadata.yaml"
    text = metadata.read_text()
    name = next(folder.glob("*.db3")).name
    metadata.write_text(text.replace(f"- {name}", f"- {name}\n  - lost_1.db3"))
    recording = open_recording(folder)
    assert any("lost_1.db3" in note.what for note in recording.notes)


def test_a_compressed_file_is_unpacked(tmp_path):
    planted = support.plant()
    folder = tmp_path / "bag"
    folder.mkdir()
    plain = humble_bag(tmp_path / "bag_0.db3", planted)
    (folder / "bag_0.db3.zstd").write_bytes(zstandard.ZstdCompressor().compress(plain.read_bytes()))
    check_planted(open_recording(folder), planted, ("header", "log"))


def test_messages_compressed_one_by_one(tmp_path):
    planted = support.plant(count=50)
    folder = tmp_path / "bag"
    folder.mkdir()
    pack = zstandard.ZstdCompressor().compress
    messages = [(log, pack(p)) for _, log, _, p in support.cdr_messages(support.ros2_store(), planted)]
    support.write_humble_db3(folder / "bag_0.db3", {"/odom": (HUMBLE, messages)})
    (folder / "metadata.yaml").write_text(
        "rosbag2_bagfile_information:\n  version: 4\n  compression_format: zstd\n  compression_mode: MESSAGE\n"
        "  relative_file_paths: [bag_0.db3]\n"
    )
    check_planted(open_recording(folder), planted, ("header", "log"))


def test_a_write_ahead_log_left_by_a_killed_recorder_is_read(tmp_path):
    import sqlite3

    planted = support.plant(count=40)
    path = humble_bag(tmp_path / "bag.db3", planted)
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA wal_autocheckpoint=0")
    extra = planted.log[-1] + 10_000_000
    database.execute(
        "INSERT INTO messages(topic_id, timestamp, data) SELECT 1, ?, data FROM messages LIMIT 1", (int(extra),)
    )
    database.commit()
    killed = tmp_path / "killed"
    killed.mkdir()
    for file in tmp_path.glob("bag.db3*"):
        shutil.copy(file, killed / file.name)
    database.close()
    values = open_recording(killed / "bag.db3").read([FIELDS["vx"]])[FIELDS["vx"]].values
    np.testing.assert_array_equal(values, [*planted.vx, planted.vx[0]])


def custom_bag(path, count=30):
    """Write a message type that only its own package knows."""
    store = support.ros2_store()
    kind = "raptor_dbw_msgs/msg/SteeringReport"
    angles = np.linspace(-3, 3, count, dtype=np.float32)
    messages = []
    for row in range(count):
        message = support.build(
            store, kind, steering_wheel_angle=angles[row], rolling_counter=row, enabled=row % 2 == 0
        )
        messages.append((support.EPOCH + row, bytes(store.serialize_cdr(message, kind))))
    return support.write_humble_db3(path, {"/steer": (kind, messages)}), angles


def test_unknown_types_take_definitions_from_a_folder(tmp_path):
    path, angles = custom_bag(tmp_path / "bag.db3")
    folder = tmp_path / "definitions" / "raptor_dbw_msgs" / "msg"
    folder.mkdir(parents=True)
    text = support.EXTRA_DEFINITIONS["raptor_dbw_msgs/msg/SteeringReport"]
    (folder / "SteeringReport.msg").write_text(text)
    name = "/steer/steering_wheel_angle"
    recording = open_recording(path, message_paths=[tmp_path / "definitions"])
    signals = recording.read([name, "/steer/enabled", "/steer/rolling_counter"])
    np.testing.assert_array_equal(signals[name].values, angles)
    np.testing.assert_array_equal(signals["/steer/enabled"].values, np.arange(30) % 2 == 0)
    np.testing.assert_array_equal(signals["/steer/rolling_counter"].values, np.arange(30))
    # The stamps were never set, which is said, and log time is used.
    assert any("zero" in note.what for note in recording.notes)
    np.testing.assert_allclose(signals[name].time, np.arange(30) * 1e-9, rtol=0, atol=1e-12)


def test_unknown_types_without_definitions_are_said(tmp_path):
    path, _ = custom_bag(tmp_path / "bag.db3")
    recording = open_recording(path)
    assert [channel.name for channel in recording.channels()] == ["/steer"]
    with pytest.raises(LogError, match="--msg-path"):
        recording.read(["/steer/steering_wheel_angle"])


def test_a_definition_of_another_version_is_refused(tmp_path):
    path, _ = custom_bag(tmp_path / "bag.db3")
    folder = tmp_path / "raptor_dbw_msgs" / "msg"
    folder.mkdir(parents=True)
    # An older version, without the last three fields: decoding by it would look fine.
    (folder / "SteeringReport.msg").write_text("std_msgs/Header header\nfloat32 steering_wheel_angle\n")
    recording = open_recording(path, message_paths=[tmp_path])
    with pytest.raises(LogError, match="none of the 30 messages"):
        recording.read(["/steer/steering_wheel_angle"])
