"""Logs say what the sensors said, to readers that are not ours; the bundled ones can be made again."""

import re
import shlex
from collections import defaultdict
from pathlib import Path

import numpy as np
import pyarrow.parquet
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from split_cli.cli.simulate import command
from split_cli.logs.drive import read_drive
from split_cli.plant.cars import F1TENTH_CAR
from split_cli.plant.drivers import DRIVER_STYLES
from split_cli.plant.recording import EPOCH, write_csv, write_mcap, write_parquet
from split_cli.plant.ros_messages import TOPICS, definition
from split_cli.plant.sensors import measure, sensors_of
from split_cli.plant.simulation import drive_laps
from split_cli.plant.tracks import find_track
from split_cli.signals import convert_to_si, split_name_and_unit

SAMPLES = Path(__file__).resolve().parents[2] / "sample_logs"
COMMANDS = re.findall(r"`split (simulate [^`]*)`", (SAMPLES / "README.md").read_text(encoding="utf-8"))
COMMANDS = [text for text in COMMANDS if " -o " in text]


@pytest.fixture(scope="module")
def run():
    return drive_laps(F1TENTH_CAR, find_track("f1tenth"), DRIVER_STYLES["brisk"], laps=0.5, seed=1)


@pytest.fixture(scope="module")
def readings(run):
    return measure(run, sensors_of("f1tenth_car"), 2)


@pytest.fixture(scope="module")
def log(readings, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    write_mcap(readings, path)
    return path


def messages(path):
    """Return (topic, log time, publish time, payload) of every message in the order of the file."""
    with path.open("rb") as stream:
        return [
            (channel.topic, message.log_time, message.publish_time, message.data)
            for _, channel, message in make_reader(stream).iter_messages(log_time_order=False)
        ]


def decoded(path):
    """Return topic -> messages, decoded by the mcap project's own decoder."""
    found = defaultdict(list)
    with path.open("rb") as stream:
        for _, channel, _, message in make_reader(stream, decoder_factories=[DecoderFactory()]).iter_decoded_messages():
            found[channel.topic].append(message)
    return found


def test_every_report_arrives_with_its_stamp_and_values(log, readings):
    found = decoded(log)
    by_name = {reading.sensor.name: reading for reading in readings}
    assert {topic.name: len(found[topic.name]) for topic in TOPICS} == {
        topic.name: len(by_name[topic.sensor].stamp) for topic in TOPICS
    }
    state = by_name["state"].values
    odometry = found["/odometry"]
    stamps = [m.header.stamp.sec - EPOCH + 1e-9 * m.header.stamp.nanosec for m in odometry]
    # Clocks resolve a microsecond.
    np.testing.assert_allclose(stamps, by_name["state"].stamp, atol=0.6e-6)
    np.testing.assert_array_equal([m.twist.twist.linear.y for m in odometry], state["vy"])
    np.testing.assert_array_equal([m.twist.twist.angular.z for m in odometry], state["r"])
    turn = [m.pose.pose.orientation for m in odometry]
    yaw = np.unwrap([2 * np.arctan2(q.z, q.w) for q in turn])
    np.testing.assert_allclose(np.exp(1j * yaw), np.exp(1j * state["yaw"]), atol=1e-12)
    command_values = by_name["command"].values
    np.testing.assert_allclose(  # the standard message holds the angle in single precision
        [m.drive.steering_angle for m in found["/command/drive"]], command_values["delta"], atol=3e-8
    )
    np.testing.assert_array_equal([m.torque for m in found["/command/wheel_torque"]], command_values["T"])
    np.testing.assert_array_equal([m.velocity[2] for m in found["/wheels"]], by_name["wheels"].values["wheel_speed_rl"])


def test_a_second_decoder_reads_the_same_numbers(log, readings):
    store = get_typestore(Stores.EMPTY)
    for type_name in {topic.type_name for topic in TOPICS}:
        store.register(get_types_from_msg(definition(type_name), type_name))
    types = {topic.name: topic.type_name for topic in TOPICS}
    inertial = next(reading for reading in readings if reading.sensor.name == "inertial")
    ay = [
        store.deserialize_cdr(payload, types[topic]).linear_acceleration.y
        for topic, _, _, payload in messages(log)
        if topic == "/imu"
    ]
    np.testing.assert_array_equal(ay, inertial.values["ay"])


def test_the_standard_definitions_are_those_of_ros():
    store = get_typestore(Stores.ROS2_HUMBLE)
    checked = 0
    for type_name in {topic.type_name for topic in TOPICS}:
        for name, (_, fields) in get_types_from_msg(definition(type_name), type_name).items():
            if name in store.fielddefs:
                # Names and types decide the bytes; default values, also in a field, do not.
                expected = [(field, kind) for field, kind in store.fielddefs[name][1]]
                assert [(field, kind) for field, kind in fields] == expected, name
                checked += 1
    assert checked >= 12


def test_header_publish_and_log_times_differ_as_on_a_real_logger(log):
    behind = defaultdict(list)
    order = [log_time for _, log_time, _, _ in messages(log)]
    assert order == sorted(order)
    with log.open("rb") as stream:
        reader = make_reader(stream, decoder_factories=[DecoderFactory()])
        for _, channel, message, content in reader.iter_decoded_messages():
            stamp = content.header.stamp.sec * 10**9 + content.header.stamp.nanosec
            assert stamp <= message.publish_time <= message.log_time
            behind[channel.topic].append((message.log_time - stamp) * 1e-9)
    for topic in TOPICS:
        assert np.std(behind[topic.name]) > 1e-4  # the transport is not a constant shift
    assert np.median(behind["/gnss/fix"]) > np.median(behind["/imu"]) + 0.02


def test_the_fix_lies_where_the_car_is(log, run):
    # Independent of the writer's formula: earth-centred coordinates, then their differences along east and north.
    fixes = decoded(log)["/gnss/fix"]
    a, f = 6378137.0, 1 / 298.257223563

    def centred(latitude, longitude, height):
        e2 = f * (2 - f)
        normal = a / np.sqrt(1 - e2 * np.sin(latitude) ** 2)
        return np.array(
            [
                (normal + height) * np.cos(latitude) * np.cos(longitude),
                (normal + height) * np.cos(latitude) * np.sin(longitude),
                (normal * (1 - e2) + height) * np.sin(latitude),
            ]
        )

    lat0, lon0 = np.radians(52.0), np.radians(10.0)
    east = np.array([-np.sin(lon0), np.cos(lon0), 0.0])
    north = np.array([-np.sin(lat0) * np.cos(lon0), -np.sin(lat0) * np.sin(lon0), np.cos(lat0)])
    places = np.array([centred(np.radians(m.latitude), np.radians(m.longitude), m.altitude) for m in fixes])
    away = places - centred(lat0, lon0, 80.0)
    stamps = np.array([m.header.stamp.sec - EPOCH + 1e-9 * m.header.stamp.nanosec for m in fixes])
    for axis, channel in ((east, "X"), (north, "Y")):
        error = away @ axis - np.interp(stamps, run.t, run.channel(channel))
        # The receiver's noise is 0.02 m; four standard errors about it, and no systematic part.
        assert np.std(error) == pytest.approx(0.02, rel=4 / np.sqrt(2 * len(error)))
        assert abs(np.mean(error)) < 4 * 0.02 / np.sqrt(len(error))


def test_tables_hold_the_readings_in_the_units_their_headers_say(run, tmp_path):
    readings = measure(run, sensors_of("f1tenth_car"), 2, one_clock=100.0)
    write_csv(readings, tmp_path / "si.csv")
    write_csv(readings, tmp_path / "workshop.csv", workshop_units=True)
    write_parquet(readings, tmp_path / "log.parquet")
    exact = pyarrow.parquet.read_table(tmp_path / "log.parquet")
    state = readings[0].values
    np.testing.assert_array_equal(exact["vy"].to_numpy(), state["vy"])
    for name in ("si.csv", "workshop.csv"):
        header = (tmp_path / name).read_text().splitlines()[0].split(",")
        rows = np.loadtxt(tmp_path / name, delimiter=",", skiprows=1)
        for column, title in enumerate(header):
            channel, unit = split_name_and_unit(title)
            values = convert_to_si(rows[:, column], unit)
            true = exact[channel].to_numpy()
            # Written with five digits of the span.
            assert np.abs(values - true).max() <= 1e-5 * max(np.ptp(true), 1e-3)
    assert "vx(km/h)" in (tmp_path / "workshop.csv").read_text().splitlines()[0]


def numbers(payload_messages):
    """Return every float of decoded messages in order, shape (N,)."""
    found = []

    def collect(value):
        if isinstance(value, float):
            found.append(value)
        elif isinstance(value, list | tuple):
            for entry in value:
                collect(entry)
        elif hasattr(value, "__slots__"):
            for name in value.__slots__:
                collect(getattr(value, name))

    for message in payload_messages:
        collect(message)
    return np.array(found)


@pytest.mark.parametrize("text", COMMANDS, ids=lambda text: text.split()[-1])
def test_the_bundled_logs_come_out_again_from_their_commands(text, tmp_path):
    arguments = shlex.split(text)[1:]
    name = arguments[-1]
    arguments[-1] = str(tmp_path / name)
    command.main(args=arguments, standalone_mode=False)
    made, kept = tmp_path / name, SAMPLES / name
    if made.read_bytes() == kept.read_bytes():
        return
    # Other versions of the libraries may compress differently, other mathematical libraries round the last bit of
    # a sine differently. A closed loop keeps such differences below 1e-9, and the sensors' rounding hides them but
    # for values on a rounding border: those are off by a whole step, and are rare.
    if name.endswith(".mcap"):
        assert [(t, a, b) for t, a, b, _ in messages(made)] == [(t, a, b) for t, a, b, _ in messages(kept)]
        new, old = decoded(made), decoded(kept)
        pairs = [(numbers(new[topic]), numbers(old[topic])) for topic in old]
    elif name.endswith(".csv"):
        pairs = [tuple(np.loadtxt(path, delimiter=",", skiprows=1).ravel() for path in (made, kept))]
    else:
        new, old = read_drive(made), read_drive(kept)
        assert set(new.columns) == set(old.columns)
        pairs = [(new[channel], old[channel]) for channel in old.columns]
    for ours, theirs in pairs:
        assert ours.shape == theirs.shape
        off = np.abs(ours - theirs) > 1e-9 * np.maximum(1.0, np.abs(theirs))
        assert np.mean(off) < 1e-4


def test_every_bundled_log_has_its_command_and_they_are_small():
    made = {shlex.split(text)[-1] for text in COMMANDS}
    there = {path.name for path in SAMPLES.iterdir() if path.suffix in (".mcap", ".csv", ".parquet")}
    assert made == there
    assert sum((SAMPLES / name).stat().st_size for name in there) < 8e6
