"""Signal maps: what is written is what is read; what is wrong is named with the nearest right."""

import time
from pathlib import Path

import numpy as np
import pytest
import yaml

from split_cli.errors import MapError
from split_cli.logs.assembling.gather import fitting_presets, gather
from split_cli.logs.drafting.suggest import suggest_map
from split_cli.logs.presets import preset_abouts, preset_names
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.signal_map import map_from_mapping, read_map

N = 60
TIME = np.arange(N) * 0.01


class TopicRecording(TableRecording):
    """A recording with topics, made in memory; types by topic."""

    types: dict[str, str]

    def channels(self):
        from split_cli.logs.raw import RawChannelInfo

        return [
            RawChannelInfo(s.name, self.types.get(s.name.rsplit("/", 1)[0], "float64"), len(s.values), s.unit)
            for s in self.signals.values()
        ]


def table(units: dict[str, str | None] | None = None, **columns) -> TableRecording:
    signals = {n: RawSignal(n, None, np.asarray(v, float), (units or {}).get(n)) for n, v in columns.items()}
    return TableRecording("log.csv", Path("log.csv"), signals)


def topics(types: dict[str, str], **clock) -> TopicRecording:
    fields = {
        "nav_msgs/msg/Odometry": (
            "pose.pose.position.x",
            "pose.pose.position.y",
            "pose.pose.orientation.x",
            "pose.pose.orientation.y",
            "pose.pose.orientation.z",
            "pose.pose.orientation.w",
            "twist.twist.linear.x",
            "twist.twist.linear.y",
            "twist.twist.angular.z",
        ),
        "sensor_msgs/msg/NavSatFix": ("latitude", "longitude"),
    }
    signals = {}
    for topic, kind in types.items():
        for path in fields[kind]:
            value = 1.0 if path.endswith("orientation.w") else 0.0
            signals[f"{topic}/{path}"] = RawSignal(f"{topic}/{path}", TIME, np.full(N, value))
    recording = TopicRecording("log.mcap", Path("log.mcap"), signals, clocks=("header", "log"), **clock)
    recording.types = types
    return recording


def read(recording, channels: dict, **over):
    return gather(recording, map_from_mapping({"channels": channels, **over}))


def values(gathered, channel: str) -> np.ndarray:
    return sum(part.values for part in gathered.series[channel])


def test_scale_offset_and_unit_act_in_that_order():
    made = read(table(t=TIME, v=np.full(N, 10.0)), {"vx": {"source": "v", "scale": 2.0, "offset": 1.6, "unit": "km/h"}})
    assert values(made, "vx")[0] == pytest.approx((2.0 * 10.0 + 1.6) / 3.6)
    assert "vx: km/h to m/s" in made.conversions


def test_a_curve_bends_a_command_and_what_lies_beyond_it_is_missing():
    command = np.linspace(-1.2, 1.2, N)
    curve = [[-1.0, -0.42], [0.0, 0.0], [1.0, 0.38]]
    made = read(table(t=TIME, c=command), {"delta": {"source": "c", "curve": curve, "unit": "rad"}})
    bent = values(made, "delta")
    inside = np.abs(command) <= 1.0
    expected = np.where(command < 0.0, 0.42, 0.38) * command
    np.testing.assert_allclose(bent[inside], expected[inside], atol=1e-15)
    assert np.isnan(bent[np.abs(command) > 1.002]).all()
    (told,) = [text for text in made.conversions if "curve" in text]
    assert f"{np.count_nonzero(np.abs(command) > 1.002)} samples beyond its ends" in told


@pytest.mark.parametrize("curve", [[[0, 1]], [[0, 0], [0, 1]], [[1, 0], [0, 1]], "x", [[0, 0], [1]]])
def test_a_curve_that_is_none_is_refused(curve):
    with pytest.raises(MapError, match="curve"):
        read(table(t=TIME, c=TIME), {"delta": {"source": "c", "curve": curve, "unit": "rad"}})


def test_a_unit_comes_from_the_map_or_the_file_or_is_said_to_be_assumed():
    recording = table({"a": "km/h", "b": None}, t=TIME, a=np.full(N, 36.0), b=np.full(N, 10.0))
    assert values(read(recording, {"vx": "a"}), "vx")[0] == pytest.approx(10.0)
    assumed = read(recording, {"vx": "b"})
    assert values(assumed, "vx")[0] == 10.0 and "vx in m/s (neither file nor map says)" in assumed.assumed
    contradicted = read(recording, {"vx": {"source": "a", "unit": "m/s"}})
    assert values(contradicted, "vx")[0] == 36.0
    assert contradicted.contradictions == ("vx: the file says km/h, the map says m/s; the map was followed",)


def test_a_unit_of_another_quantity_is_refused():
    with pytest.raises(MapError, match="T is in N m, p is in bar"):
        read(table({"p": "bar"}, t=TIME, p=TIME), {"T": "p"})
    with pytest.raises(MapError, match="unknown unit 'furlong'"):
        read(table(t=TIME, p=TIME), {"vx": {"source": "p", "unit": "furlong"}})


def test_a_scale_may_be_a_quotient_as_the_draft_writes_it():
    recording = table(t=TIME, s=np.full(N, 30.0))
    steer = read(recording, {"delta": {"source": "s", "scale": "-1/15", "unit": "deg"}})
    np.testing.assert_allclose(values(steer, "delta"), np.radians(-2.0), rtol=1e-12)
    for wrong in ("1/RATIO", "1/0", "1/2/3", "1/"):
        with pytest.raises(MapError, match="quotient such as 1/15.3"):
            read(recording, {"delta": {"source": "s", "scale": wrong}})


def test_a_sum_adds_its_entries_each_with_its_own_scale():
    recording = table({"p": "bar"}, t=TIME, left=np.full(N, 100.0), right=np.full(N, 120.0), p=np.full(N, 3.0))
    made = read(recording, {"T": {"sum": ["left", "right", {"source": "p", "scale": -70.0, "unit": "N m"}]}})
    assert values(made, "T")[0] == pytest.approx(100 + 120 - 210)


def test_right_handed_frames_are_turned():
    columns = {"t": TIME, "n": np.full(N, 5.0), "e": np.full(N, 7.0), "psi": np.full(N, 0.3), "w": np.full(N, 0.2)}
    made = read(
        table(**columns), {"X": "n", "Y": "e", "yaw": "psi", "r": "w", "vy": "w", "vx": "w"}, frame="frd", world="ned"
    )
    assert (values(made, "X")[0], values(made, "Y")[0]) == (7.0, 5.0)
    assert values(made, "yaw")[0] == pytest.approx(np.pi / 2 - 0.3)
    assert (values(made, "r")[0], values(made, "vy")[0], values(made, "vx")[0]) == (-0.2, -0.2, 0.2)


def test_time_in_nanoseconds_since_1970_keeps_its_precision():
    nanoseconds = 1_700_000_000_000_000_000 + np.arange(N, dtype=np.int64) * 10_000_000
    recording = table({"stamp": "ns"}, stamp=nanoseconds, v=TIME)
    made = read(recording, {"vx": "v"}, time={"source": "stamp"})
    # float64 resolves 256 ns there.
    np.testing.assert_allclose(made.series["vx"][0].time, TIME, atol=3e-7)
    assert made.origin == pytest.approx(1.7e9)
    with pytest.raises(Exception, match="samples of 'stamp' are 1e\\+07 s apart.*unit: ns"):
        read(table(stamp=nanoseconds, v=TIME), {"vx": "v"}, time={"source": "stamp"})


def test_a_table_without_time_takes_a_period():
    made = read(table(v=TIME), {"vx": "v"}, time={"period": 0.008})
    np.testing.assert_allclose(made.series["vx"][0].time, 0.008 * np.arange(N))
    with pytest.raises(MapError, match="no column of time"):
        read(table(v=TIME), {"vx": "v"})


def test_a_missing_source_is_told_with_the_nearest_that_exist():
    with pytest.raises(MapError, match=r"no 'speed_x', mapped to vx \(also missing: yawrate\).*speedx"):
        read(table(t=TIME, speedx=TIME, yaw_rate=TIME), {"vx": "speed_x", "r": "yawrate"})


def test_optional_channels_are_skipped_and_said_but_not_where_needed():
    recording = table(t=TIME, v=TIME)
    made = read(recording, {"vx": "v", "ax": {"source": "a", "optional": True}})
    assert "ax" not in made.series and made.skipped == ("ax: the recording has no a",)
    with pytest.raises(MapError, match="no 'a'"):
        gather(recording, map_from_mapping({"channels": {"ax": {"source": "a", "optional": True}}}), needed=("ax",))


def test_a_message_type_stands_for_the_only_topic_of_that_type():
    made = gather(topics({"/car/odom": "nav_msgs/msg/Odometry"}), read_map("odometry"))
    assert set(made.series) == {"X", "Y", "yaw", "vx", "vy", "r"}
    assert made.series["vx"][0].source == "/car/odom/twist.twist.linear.x"
    two = topics({"/a": "nav_msgs/msg/Odometry", "/b": "nav_msgs/msg/Odometry"})
    with pytest.raises(MapError, match="2 topics are of type nav_msgs/Odometry: /a, /b.*--topic"):
        gather(two, read_map("odometry"))
    chosen = map_from_mapping({"preset": "odometry", "topics": {"nav_msgs/Odometry": "/b"}})
    assert gather(two, chosen).series["vx"][0].source == "/b/twist.twist.linear.x"


def test_a_satellite_fix_becomes_local_metres():
    recording = topics({"/gps": "sensor_msgs/msg/NavSatFix"})
    recording.signals["/gps/latitude"].values[:] = 35.0 + 1e-5 * np.arange(N)
    recording.signals["/gps/longitude"].values[:] = -118.0
    made = gather(recording, read_map("fix"))
    assert values(made, "Y")[10] == pytest.approx(11.09, abs=0.02)  # 1e-4 deg of a meridian of 6,356 km radius
    np.testing.assert_allclose(values(made, "X"), 0.0, atol=1e-6)
    assert [made.series[name][0].source for name in "XY"] == ["/gps/longitude", "/gps/latitude"]


def test_a_clock_that_is_not_there_is_refused():
    with pytest.raises(MapError, match="no publish clock.*header, log"):
        gather(topics({"/o": "nav_msgs/msg/Odometry"}), read_map("odometry"), clock="publish")


def test_unmapped_columns_of_a_table_ride_along_as_they_are():
    made = read(table({"temp": "degC"}, t=TIME, v=TIME, temp=np.full(N, 20.0)), {"vx": "v"})
    assert values(made, "temp")[0] == 20.0
    assert "temp" not in read(table(t=TIME, v=TIME, temp=TIME), {"vx": "v"}, extras="none").series


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ({"chanels": {}}, "unknown key 'chanels'.*channels"),
        ({"channels": {"vx": {"sorce": "v"}}}, "unknown key 'sorce'.*source"),
        ({"channels": {"vx": {"unit": "m/s"}}}, "source or sum"),
        ({"channels": {"vx": {"source": "v", "convert": "yaw_from_quaternions"}}}, "yaw_from_quaternion"),
        ({"channels": {"vx": {"source": "v", "kind": "commanded"}}}, "kind is 'commanded'.*command"),
        ({"channels": {"vx": {"source": "v", "delay": "late"}}}, "delay is 'late'"),
        ({"channels": {"vx": {"source": "v", "position": {"x": 1, "z": 2}}}}, "unknown key 'z'"),
        ({"frame": "rfu"}, "frame is 'rfu'"),
        ({"time": {"source": "t", "period": 0.1}}, "one of source, period and clock"),
        ({"time": {"period": -1.0}}, "must be positive"),
        ({"preset": "odometri"}, "no preset 'odometri'.*odometry"),
        ({"kinds": {"T": "command"}, "channels": {}}, "kinds names 'T'"),
    ],
)
def test_a_wrong_map_is_refused_with_the_nearest_right_word(content, words):
    with pytest.raises(MapError, match=words):
        map_from_mapping(content)


def test_presets_are_laid_under_and_overridden_channel_by_channel(tmp_path):
    path = tmp_path / "mine.yaml"
    path.write_text(
        yaml.safe_dump(
            {
                "preset": ["odometry", "ackermann"],
                "channels": {"vx": {"delay": 0.05}, "r": {"source": "/imu/wz"}, "X": None},
                "kinds": {"delta": "measured"},
            }
        )
    )
    made = read_map(path)
    assert made.channel("vx").sources[0].delay == 0.05
    assert made.channel("vx").sources[0].names == ("nav_msgs/Odometry:twist.twist.linear.x",)
    assert made.channel("r").sources[0].names == ("/imu/wz",) and made.channel("r").sources[0].unit is None
    assert made.channel("X") is None and made.channel("vy") is not None
    # Of two maps on the command line the later one wins.
    assert read_map(["odometry", "imu"]).channel("r").sources[0].names == ("sensor_msgs/Imu:angular_velocity.z",)


@pytest.mark.parametrize("name", preset_names())
def test_every_preset_can_be_read_and_says_what_it_is_for(name):
    assert read_map(name).channels
    assert len(preset_abouts()[name]) > 30


def test_a_file_that_is_no_map_is_refused(tmp_path):
    (tmp_path / "bad.yaml").write_text("channels: [unclosed")
    with pytest.raises(MapError, match="is not YAML"):
        read_map(tmp_path / "bad.yaml")
    (tmp_path / "twice.yaml").write_text("channels:\n  vx: a\n  vx: b\n")
    with pytest.raises(MapError, match="the key 'vx' stands twice, line 2"):
        read_map(tmp_path / "twice.yaml")
    with pytest.raises(MapError, match="no such map.*genesis_slow"):
        read_map("genesis_slo")


def test_a_draft_map_reads_what_it_was_drafted_from(tmp_path):
    units = {"Ground Speed": "km/h", "yaw_rate_dps": "deg/s", "v_lat": "m/s", "steer_angle": "deg", "torque": "Nm"}
    recording = table(units, **{name: (1 + k) * TIME for k, name in enumerate(("time", *units, "foo"))})
    text = suggest_map(recording)
    path = tmp_path / "draft.yaml"
    path.write_text(text)
    made = gather(recording, read_map(path))
    assert {"vx", "vy", "r", "T"} <= set(made.series) and "open: delta from steer_angle" in text
    assert made.series["vx"][0].source == "Ground Speed" and "Not used: foo" in text


def test_a_map_of_many_channels_is_no_work_squared():
    channels = {**{f"c{n}": f"c{n}" for n in range(20_000)}, "vx": "first"}
    found = map_from_mapping({"channels": channels})
    start = time.process_time()
    assert all(found.channel(name).sources[0].names == (source,) for name, source in channels.items())
    assert found.channel("none") is None
    assert time.process_time() - start < 1.0  # a search each time took 10 s


@pytest.mark.parametrize("name", preset_names())
def test_a_preset_fits_a_log_with_its_sources_and_no_log_without_one_that_it_needs(name):
    """A preset that lacks vx, r or delta, to be laid over another, fits no log."""
    preset = read_map(name)
    addresses, types = {}, {}
    if preset.time.source:
        addresses[preset.time.source] = False
    for entry in preset.channels:
        for source in entry.sources:
            for address in source.names:
                if not address.startswith("/") and ":" in address:
                    kind, _, field = address.partition(":")
                    topic = preset.topics.get(kind, f"/{kind.partition('/')[2]}")
                    address, types[topic] = f"{topic}/{field}", kind
                whole = [f"{address}.{axis}" for axis in "xyzw"] if "quaternion" in source.convert else [address]
                addresses |= dict.fromkeys(whole, entry.optional)

    def fits(names) -> bool:
        recording = TopicRecording("log", Path("log"), {n: RawSignal(n, TIME, TIME) for n in names})
        recording.types = types
        return name in fitting_presets(recording)

    whole = {"vx", "r", "delta"} <= {entry.channel for entry in preset.channels}
    assert fits(addresses) == whole
    assert not any(fits([n for n in addresses if n != missing]) for missing in addresses if not addresses[missing])
