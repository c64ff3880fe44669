"""A model car's bag with every channel, in the message types of its drivers; one map for several logs."""

import numpy as np
import yaml
from click.testing import CliRunner
from rosbags.rosbag1 import Writer as Bag1
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import tests.logs.readers_support as support
from split_cli.cli.main import group
from split_cli.logs.drafting.suggest import draft_map, render_draft
from split_cli.logs.readers import open_recording
from split_cli.workflows.ingesting.init import init_project
from tests.logs.planted import PlantedDrive, write_table


def topics(store, car: PlantedDrive, ros1: bool) -> dict:
    """An estimator's odometry, the motor controller's, an inertial unit, the VESC's state, and the command.

    The motor controller's odometry has v_y = 0 and computes its yaw rate from the steer angle. The estimator's is
    of the rear axle, as `base_link` is.
    """
    rng = np.random.default_rng(3)
    rear, length = car.vehicle.cg_to_rear_axle, car.vehicle.wheelbase
    found: dict[str, tuple[str, list]] = {
        "/ego/odom": ("nav_msgs/msg/Odometry", []),
        "/odom": ("nav_msgs/msg/Odometry", []),
        "/imu/data": ("sensor_msgs/msg/Imu", []),
        "/sensors/core": ("vesc_msgs/msg/VescStateStamped", []),
        "/drive": ("ackermann_msgs/msg/AckermannDriveStamped", []),
        "/plan": ("nav_msgs/msg/Path", []),
    }

    def add(topic: str, t: float, **fields) -> None:
        kind = found[topic][0]
        stamp = support.EPOCH + int(t * 1e9)
        header = {**support.stamp_of(stamp), **({"header__seq": len(found[topic][1])} if ros1 else {})}
        found[topic][1].append((stamp + 5_000_000, support.build(store, kind, **header, **fields)))

    pose, twist = "pose__pose__", "twist__twist__"
    for t in np.arange(0.0, 30.0, 0.05):
        c = {name: float(car.at(name, np.array([t]))[0]) for name in ("X", "Y", "yaw", "vx", "vy", "r", "ay", "delta")}
        turned = {f"{pose}orientation__z": np.sin(c["yaw"] / 2), f"{pose}orientation__w": np.cos(c["yaw"] / 2)}
        add(
            "/ego/odom",
            t,
            **turned,
            **{
                f"{pose}position__x": c["X"] - rear * np.cos(c["yaw"]),
                f"{pose}position__y": c["Y"] - rear * np.sin(c["yaw"]),
                f"{twist}linear__x": c["vx"],
                f"{twist}linear__y": c["vy"] - rear * c["r"],
                f"{twist}angular__z": c["r"],
            },
        )
        add("/odom", t, **{f"{twist}linear__x": c["vx"], f"{twist}angular__z": c["vx"] * np.tan(c["delta"]) / length})
        add(
            "/imu/data",
            t,
            angular_velocity__z=c["r"] + 0.002 * rng.normal(),
            linear_acceleration__z=9.81,
            linear_acceleration__y=c["ay"] + 0.05 * rng.normal(),
        )
        add("/sensors/core", t, state__current_motor=10.0 * np.sin(t), state__speed=4614.0 * c["vx"])
        add("/drive", t, drive__steering_angle=c["delta"], drive__speed=c["vx"])
        if len(found["/plan"][1]) < t:
            add("/plan", t)
    return found


def written(path, car: PlantedDrive, ros: int) -> None:
    """A ROS 1 bag, or a database of ROS 2 Humble, which holds no definitions."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    for name, text in support.EXTRA_DEFINITIONS.items():
        store.register(get_types_from_msg(text, name))
    made = topics(store, car, ros == 1)
    if ros == 1:
        with Bag1(path) as bag:
            for topic, (kind, messages) in made.items():
                connection = bag.add_connection(topic, kind, typestore=store)
                for time, message in messages:
                    bag.write(connection, time, store.serialize_ros1(message, kind))
        return
    support.write_humble_db3(
        path,
        {
            topic: (kind, [(time, bytes(store.serialize_cdr(message, kind))) for time, message in messages])
            for topic, (kind, messages) in made.items()
        },
    )


def test_a_bag_with_every_channel_gives_each_from_what_measures_it(car, tmp_path):
    written(tmp_path / "car.bag", car, 1)
    listed = CliRunner().invoke(group, ["ingest", str(tmp_path / "car.bag"), "--list"]).stdout
    assert listed.count("covariance") == listed.count("covariance[0..") == 7  # two of an odometry, three of an IMU
    draft = draft_map(open_recording(tmp_path / "car.bag"))
    from_topic = {s.channel: s.sources[0].rpartition("/")[0] for s in draft.suggestions if s.status == "judged"}
    assert {c: from_topic[c] for c in ("X", "Y", "vy", "delta")} == {
        "X": "/ego/odom",
        "Y": "/ego/odom",
        "vy": "/ego/odom",
        "delta": "/drive",
    }
    assert from_topic["r"] in ("/imu/data", "/ego/odom") and from_topic["ay"] == "/imu/data"
    # The preset of such cars takes /odom, whose v_y never changes.
    assert "f1tenth" not in draft.presets


def test_types_that_a_bag_does_not_define_are_the_first_thing_to_mend(car, tmp_path):
    """The steer angle is there, and its definition is not: nobody has to record it anew."""
    written(tmp_path / "car.db3", car, 2)
    steps = init_project([tmp_path / "car.db3"], tmp_path / "car").next_steps
    assert steps[0].startswith("The log does not define vesc_msgs/msg/VescStateStamped, ackermann_msgs/msg/Ack")
    assert "--msg-path" in steps[0] and steps[1] == "Nothing that can be read gives delta."
    for name, text in support.EXTRA_DEFINITIONS.items():
        place = tmp_path / "types" / f"{name}.msg"
        place.parent.mkdir(parents=True, exist_ok=True)
        place.write_text(text)
    defined = draft_map(open_recording(tmp_path / "car.db3", message_paths=[tmp_path / "types"]))
    assert defined.undefined == () and defined.of("delta").status == "judged"


def test_a_planned_path_is_no_position_and_what_never_changes_shares_a_line(tmp_path):
    store = get_typestore(Stores.ROS2_HUMBLE)
    pose = support.build(store, "geometry_msgs/msg/PoseStamped", pose__position__x=1.0)
    made: dict = {
        "/plan": ("nav_msgs/msg/Path", []),
        "/a/twist": ("geometry_msgs/msg/TwistStamped", []),
        "/b/twist": ("geometry_msgs/msg/TwistStamped", []),
    }
    for row in range(60):
        time = support.EPOCH + row * 20_000_000
        stamp = support.stamp_of(time)
        made["/plan"][1].append((time, support.build(store, made["/plan"][0], **stamp, poses=[pose])))
        for topic in ("/a/twist", "/b/twist"):
            made[topic][1].append((time, support.build(store, made[topic][0], **stamp)))
    support.write_humble_db3(
        tmp_path / "stands.db3",
        {
            topic: (kind, [(time, bytes(store.serialize_cdr(message, kind))) for time, message in messages])
            for topic, (kind, messages) in made.items()
        },
    )
    draft = draft_map(open_recording(tmp_path / "stands.db3"))
    assert draft.of("X") is None
    text = render_draft(draft, "stands")
    assert "# open: vx from /a/twist/twist.linear.x, /b/twist/twist.linear.x: never change" in text


def table(path, car: PlantedDrive, channels: dict[str, str], still: bool = False, factor: float = 1.0) -> None:
    """Write columns of the planted drive; `still` stands, `factor` multiplies the yaw rate."""
    t = np.arange(0.0, 40.0, 0.02)
    columns = {"t": t} | {title: car.at(c, t) * (0.0 if still else 1.0) for title, c in channels.items()}
    columns["yaw_rate"] = columns["yaw_rate"] * factor
    write_table(path, columns)


NAMES = {"speed": "vx", "yaw_rate": "r", "ay": "ay", "yaw": "yaw", "steer": "delta"}


def test_one_map_for_several_logs_is_that_of_the_log_which_judges_most(car, tmp_path):
    """In the first log the car stands: by itself it judges nothing, and names decide."""
    first, second = tmp_path / "pits.csv", tmp_path / "lap.csv"
    table(first, car, NAMES, still=True)
    table(second, car, NAMES)
    alone = init_project([second], tmp_path / "one").draft
    made = init_project([first, second], tmp_path / "two")
    assert {s.channel for s in made.draft.suggestions if s.status != "open"} == {
        s.channel for s in alone.suggestions if s.status != "open"
    }
    assert made.differences == ()
    channels = yaml.safe_load((tmp_path / "two" / "map.yaml").read_text())["channels"]
    assert channels["r"]["source"] == "yaw_rate" and made.next_steps[-1].endswith("-o pits_drives")


def test_several_logs_that_differ_are_told_apart(car, tmp_path):
    """The yaw rate counts degrees in one log and radians in the other; a third has no yaw rate."""
    for name, factor in (("a", 1.0), ("b", 180.0 / np.pi)):
        table(tmp_path / f"{name}.csv", car, NAMES, factor=factor)
    (tmp_path / "c.csv").write_text((tmp_path / "a.csv").read_text().replace("yaw_rate", "gears", 1))
    made = init_project([tmp_path / f"{n}.csv" for n in "abc"], tmp_path / "car")
    assert made.draft.of("r").status == "assumed"
    steps = " ".join(made.next_steps)
    assert "Logs differ on r" in steps and "in deg/s" in steps
    assert "c.csv does not hold r (yaw_rate)" in steps and "begin anew: split init" in steps
