"""Decoding of ROS payloads, held against mcap-ros2-support and rosbags, which decode message by message."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap_ros2._dynamic import generate_dynamic, serialize_dynamic
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import tests.logs.readers_support as support
from split_cli.errors import LogError
from split_cli.logs.readers.cdr_and_ros1 import SerializedDecoder
from split_cli.logs.readers.definitions import Definitions

INTEGERS = {"int8": 8, "uint8": 8, "int16": 16, "uint16": 16, "int32": 32, "uint32": 32, "int64": 64, "uint64": 64}
KINDS = [*INTEGERS, "float32", "float64", "bool", "string"]
INNER = "int8 first\nfloat64 second\nstring word\nuint16[3] triple\n"


def value_of(rng, kind):
    """Return a random value that float64 and the encoders represent exactly."""
    if kind == "bool":
        return bool(rng.integers(2))
    if kind == "string":
        return "x" * int(rng.integers(0, 6))
    if kind == "Inner":
        return {
            "first": int(rng.integers(-128, 128)),
            "second": float(rng.normal()),
            "word": value_of(rng, "string"),
            "triple": [int(v) for v in rng.integers(0, 65536, 3)],
        }
    if kind.startswith("float"):
        return float(np.float32(rng.normal()))
    bits = min(INTEGERS[kind], 53)
    low = 0 if kind.startswith("u") else -(2 ** (bits - 1))
    return int(rng.integers(low, low + 2**bits))


def flatten(value, prefix=""):
    """Yield address and number of every numeric value of a decoded message."""
    if isinstance(value, str):
        return
    if hasattr(value, "__slots__"):
        for name in value.__slots__:
            yield from flatten(getattr(value, name), f"{prefix}.{name}" if prefix else name)
    elif isinstance(value, (list, tuple, np.ndarray)) or hasattr(value, "typecode"):
        for index, item in enumerate(value):
            yield from flatten(item, f"{prefix}[{index}]")
    elif isinstance(value, bytes):
        for index, item in enumerate(value):
            yield f"{prefix}[{index}]", float(item)
    else:
        yield prefix, float(value)


fields = st.lists(
    st.tuples(st.sampled_from([*KINDS, "Inner"]), st.sampled_from(["", "[]", "[2]", "[<=4]"])), min_size=1, max_size=7
)


@settings(max_examples=120, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(fields=fields, seed=st.integers(0, 2**32 - 1))
def test_any_definition_decodes_as_the_reference_does(fields, seed):
    rng = np.random.default_rng(seed)
    text = "".join(f"{kind}{suffix} f{n}\n" for n, (kind, suffix) in enumerate(fields))
    text += f"{'=' * 80}\nMSG: test_msgs/Inner\n{INNER}"
    encode = serialize_dynamic("test_msgs/msg/Outer", text)["test_msgs/msg/Outer"]
    reference = generate_dynamic("test_msgs/msg/Outer", text)["test_msgs/msg/Outer"]
    decoder = SerializedDecoder(Definitions().layout("test_msgs/msg/Outer", "ros2msg", text.encode()), cdr=True)
    payloads, expected = [], []
    for _ in range(8):
        message = {}
        for n, (kind, suffix) in enumerate(fields):
            count = {"": 1, "[2]": 2}.get(suffix) or int(rng.integers(0, 5))
            values = [value_of(rng, kind) for _ in range(count)]
            message[f"f{n}"] = values if suffix else values[0]
        payloads.append(encode(message))
        expected.append(dict(flatten(reference(payloads[-1]))))
    paths = sorted({path for row in expected for path in row})
    assert all(decoder.has(path) for path in paths)
    # All at once, and one path at a time: then the walk stops early and guards fewer lengths.
    tables = [decoder.decode(payloads, paths).values]
    tables.append(np.hstack([decoder.decode(payloads, [p]).values for p in paths]) if paths else tables[0])
    wanted = np.array([[row.get(path, np.nan) for path in paths] for row in expected]).reshape(len(payloads), -1)
    for table in tables:
        np.testing.assert_array_equal(table, wanted)


@pytest.mark.parametrize("kind", ["nav_msgs/msg/Odometry", "sensor_msgs/msg/Imu", "sensor_msgs/msg/JointState"])
@pytest.mark.parametrize("how", ["little endian", "big endian", "ros1"])
def test_byte_orders_and_ros1_against_rosbags(kind, how):
    rng = np.random.default_rng(3)
    ros1 = how == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    text = store.generate_msgdef(kind, ros_version=1 if ros1 else 2)[0].encode()
    decoder = SerializedDecoder(Definitions().layout(kind, "ros1msg" if ros1 else "ros2msg", text), cdr=not ros1)
    payloads, expected = [], []
    for row in range(20):
        more = {"header__seq": row} if ros1 else {}
        if kind.endswith("JointState"):
            # Lists of changing length, behind strings of changing length.
            more["position"] = rng.normal(size=row % 3)
            more["name"] = ["wheel" * n for n in range(row % 4)]
        elif kind.endswith("Imu"):
            more["angular_velocity__z"] = rng.normal()
        else:
            more["twist__covariance"] = rng.normal(size=36)
        message = support.build(
            store, kind, **support.stamp_of(support.EPOCH + row), header__frame_id="f" * (row % 5), **more
        )
        if ros1:
            payloads.append(bytes(store.serialize_ros1(message, kind)))
        else:
            payloads.append(bytes(store.serialize_cdr(message, kind, little_endian=how == "little endian")))
        expected.append(message)
    paths = [path for path in decoder.paths() if not path.startswith("header")] + ["header.stamp.nanosec"]
    found = decoder.decode(payloads, paths)
    assert found.readable.all()
    np.testing.assert_array_equal(found.stamps, support.EPOCH + np.arange(20))
    for column, path in enumerate(paths):
        reached = [at(message, path) for message in expected]
        np.testing.assert_array_equal(found.values[:, column], reached, err_msg=path)


def at(message, path):
    """Return the value at an address; NaN behind the end of a list."""
    for step in path.split("."):
        name, _, index = step.partition("[")
        message = getattr(message, name)
        if index:
            position = int(index[:-1])
            message = message[position] if position < len(message) else np.nan
    return float(message)


def test_idl_definitions_decode_like_msg():
    idl = (
        "================================================================================\n"
        "IDL: test_msgs/msg/Pair\n"
        "module test_msgs {\n  module msg {\n    struct Pair {\n      builtin_interfaces::msg::Time stamp;\n"
        "      boolean on;\n      double value;\n      sequence<float> list;\n      float fixed[2];\n"
        "    };\n  };\n};\n"
        "================================================================================\n"
        "IDL: builtin_interfaces/msg/Time\n"
        "module builtin_interfaces {\n  module msg {\n    struct Time {\n      int32 sec;\n      uint32 nanosec;\n"
        "    };\n  };\n};\n"
    )
    text = "builtin_interfaces/Time stamp\nbool on\nfloat64 value\nfloat32[] list\nfloat32[2] fixed\n"
    store = get_typestore(Stores.ROS2_HUMBLE)
    store.register(get_types_from_msg(text, "test_msgs/msg/Pair"))
    numbers = np.array([1.5, 2.5], dtype=np.float32)
    message = support.build(
        store, "test_msgs/msg/Pair", stamp__sec=4, stamp__nanosec=5, on=True, value=0.1, list=numbers, fixed=-numbers
    )
    payload = bytes(store.serialize_cdr(message, "test_msgs/msg/Pair"))
    decoder = SerializedDecoder(Definitions().layout("test_msgs/msg/Pair", "ros2idl", idl.encode()), cdr=True)
    paths = ["on", "value", "list[1]", "list[7]", "fixed[0]"]
    found = decoder.decode([payload], paths)
    np.testing.assert_array_equal(found.values, [[1.0, 0.1, 2.5, np.nan, -1.5]])
    assert decoder.stamp == "stamp" and found.stamps[0] == 4_000_000_005


def test_cut_and_foreign_payloads_are_told_from_good_ones():
    store = support.ros2_store()
    planted = support.plant(count=30)
    good = [payload for *_, payload in support.cdr_messages(store, planted)]
    layout = Definitions().layout(*support.ros2_schema(store, "nav_msgs/msg/Odometry"))
    decoder = SerializedDecoder(layout, cdr=True)
    last = "twist.covariance[35]"
    bad = [b"", b"\0\1", good[3][:-1], good[3][:40], b"\xff" * len(good[3]), b"\0\3" + good[3][2:]]
    mixed = [good[0], *bad, good[1]]
    found = decoder.decode(mixed, [last])
    np.testing.assert_array_equal(found.readable, [True, *[False] * len(bad), True])
    np.testing.assert_array_equal(found.values[:, 0], [35.0, *[np.nan] * len(bad), 34.0])
    # The first bad one takes its equals with it, and none that differs.
    found = SerializedDecoder(layout, cdr=True).decode([*bad, good[0], *bad, good[1], *bad[::-1]], [last])
    assert np.flatnonzero(found.readable).tolist() == [len(bad), 2 * len(bad) + 1]


@pytest.mark.parametrize(
    ("text", "match"),
    [
        ("float64 x\nOther y\n", "test_msgs/msg/Other.*missing"),
        ("float64\n", "cannot be parsed"),
        ("\xff\xfe", "cannot be parsed"),
        (f"Outer again\n{'=' * 80}\nMSG: test_msgs/Outer\nOuter again\n", "contains itself"),
    ],
)
def test_bad_definitions_are_said(text, match):
    with pytest.raises(LogError, match=match):
        Definitions().layout("test_msgs/msg/Outer", "ros2msg", text.encode("latin-1"))


def test_a_given_definition_stands_in_for_one_that_cannot_be_parsed(tmp_path):
    folder = tmp_path / "test_msgs" / "msg"
    folder.mkdir(parents=True)
    (folder / "Outer.msg").write_text("float64 x\n")
    layout = Definitions([tmp_path]).layout("test_msgs/msg/Outer", "ros2msg", b"float64\n")
    payload = b"\0\1\0\0" + np.array([2.5]).tobytes()
    assert not layout.embedded
    np.testing.assert_array_equal(SerializedDecoder(layout, cdr=True).decode([payload], ["x"]).values, [[2.5]])
    (tmp_path / "empty").mkdir()
    with pytest.raises(LogError, match=r"no \.msg files"):
        Definitions([tmp_path / "empty"])
