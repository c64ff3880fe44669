"""Tables and descriptions that ended in an error of the program: each is read or refused in one line."""

import json
import re
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.feather
import pytest
import yaml

from split_cli.errors import LogError, MapError, VehicleError
from split_cli.logs.readers import open_recording
from split_cli.logs.readers.definitions import Definitions
from split_cli.logs.signal_map import read_map
from split_cli.vehicle.parameters import read_vehicle
from tests.conftest import ROOT

ROWS = "".join(f"{n / 10},{n}.5\n" for n in range(60))
CAR = yaml.safe_load((ROOT / "sample_logs" / "road_car.yaml").read_text())


def columns(path: Path) -> dict[str, np.ndarray]:
    recording = open_recording(path)
    names = [info.name for info in recording.channels() if info.type_name != "text"]
    return {name: signal.values for name, signal in recording.read(names[:9]).items()}


def test_a_header_of_more_than_128_kilobytes_is_read(tmp_path):
    names = [f"a_column_with_a_name_{number:05}" for number in range(6000)]
    text = ",".join(["t", *names]) + "\n" + "".join(f"{n / 10}{',2' * len(names)}\n" for n in range(20))
    assert len(text.splitlines()[0]) > 150_000
    (tmp_path / "a.csv").write_text(text)
    np.testing.assert_array_equal(columns(tmp_path / "a.csv")["t"], np.arange(20) / 10)
    (tmp_path / "a.csv").write_text(f"t,{'x' * 200_000}\n{ROWS}")
    assert [len(values) for values in columns(tmp_path / "a.csv").values()] == [60, 60]


@pytest.mark.parametrize("count", [20_001, 1_000_000])
def test_a_table_of_a_million_columns_is_refused(tmp_path, count):
    titles = ",".join(f"c{number}" for number in range(count))
    (tmp_path / "a.csv").write_text(titles + "\n" + ("1," * (count - 1) + "1\n") * 3)
    with pytest.raises(LogError, match="columns|no rows of numbers"):
        open_recording(tmp_path / "a.csv")


@pytest.mark.parametrize("end", [1, 2, 3, 5, 201, -1, -3])
def test_a_text_in_two_bytes_that_ends_within_a_character_is_refused(tmp_path, end):
    content = f"t,vx \U0001f697\n{ROWS}".encode("utf-16")
    (tmp_path / "a.csv").write_bytes(content[:end])
    with pytest.raises(LogError) as refused:
        columns(tmp_path / "a.csv")
    assert len(str(refused.value)) < 2000
    half = content.index("\U0001f697".encode("utf-16-le")) + 2
    (tmp_path / "a.csv").write_bytes(content[:half] + content[half + 2 :])
    with pytest.raises(LogError):
        columns(tmp_path / "a.csv")


@pytest.mark.parametrize("text", ['{"a":' * 100_000 + "1" + "}" * 100_000, f'[{{"t":{"9" * 5000}}}]'])
def test_json_without_a_bottom_and_numbers_without_an_end_are_refused(tmp_path, text):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(LogError, match="rows of numbers"):
        open_recording(tmp_path / "a.json")


@pytest.mark.parametrize(
    "text", ["module a { " * 3000 + "}; " * 3000, "struct A { " * 3000, "struct A { double x[" + "9" * 5000 + "]; };"]
)
def test_a_definition_in_idl_that_is_nested_or_sized_without_an_end_is_refused(text):
    with pytest.raises(LogError):
        Definitions().layout("a/A", "ros2idl", text.encode())


@pytest.mark.parametrize("moment", ["2023-02-31 10:00:00", "9999-99-99 99:99:99", "0000-00-00 24:61:61"])
def test_a_date_that_is_none_is_no_number(tmp_path, moment):
    (tmp_path / "a.csv").write_text("time,vx\n" + "".join(f"{moment}.{n:03},{n}\n" for n in range(60)))
    try:
        found = columns(tmp_path / "a.csv")
    except LogError:
        return
    assert not np.isfinite(found.get("time", np.array([np.nan]))).all()


def test_a_name_in_a_feather_file_that_is_no_text_is_refused(tmp_path):
    table = pa.table({"speedspeed": np.arange(100.0), "t": np.arange(100.0)})
    pyarrow.feather.write_feather(table, str(tmp_path / "a.feather"), compression="uncompressed")
    content = (tmp_path / "a.feather").read_bytes()
    (tmp_path / "a.feather").write_bytes(content.replace(b"speedspeed", b"speed\xff\xfe\x80ed"))
    with pytest.raises(LogError, match="damaged"):
        open_recording(tmp_path / "a.feather")


NUMBERS = [key for key, value in CAR.items() if not isinstance(value, str | list)]


@pytest.mark.parametrize("value", ["1e308", "-1e308", "1" + "0" * 400, ".inf", ".nan"])
@pytest.mark.parametrize("key", NUMBERS)
def test_no_value_of_a_vehicle_may_be_one_that_no_car_has(tmp_path, key, value):
    inner = CAR[key]
    forged = dict.fromkeys(inner, "VALUE") if isinstance(inner, dict) and "value" not in inner else "VALUE"
    text = yaml.safe_dump({**CAR, key: forged}).replace("VALUE", value)
    (tmp_path / "car.yaml").write_text(text)
    with pytest.raises(VehicleError, match=re.escape(str(tmp_path / "car.yaml"))):
        read_vehicle(tmp_path / "car.yaml")


@pytest.mark.parametrize(
    "content",
    [
        {"preset": 5},
        {"preset": [5, {}]},
        {"time": {"source": {"source": "t"}}},
        {"time": {"clock": {"source": {"source": "t"}}}},
        {"time": [["t"]]},
        {"channels": {"vx": {"source": {"source": {"source": "a"}}}}},
    ],
    ids=json.dumps,
)
def test_a_map_whose_entries_are_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "map.yaml").write_text(yaml.safe_dump({"channels": {"vx": {"source": "a"}}, **content}))
    with pytest.raises(MapError) as refused:
        read_map(str(tmp_path / "map.yaml"))
    assert "map.yaml" in str(refused.value) and "\n" not in str(refused.value)
