"""The vehicle file: what is written is read back, and what cannot be is told."""

import math
from dataclasses import fields, replace

import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from split_cli.errors import VehicleError
from split_cli.vehicle.library import library_names
from split_cli.vehicle.parameters import EffectSpec, Vehicle, read_vehicle, vehicle_from_mapping, write_vehicle
from split_cli.vehicle.tire import MagicFormula
from split_cli.yaml_file import parse_yaml

TEXT = """
name: written by hand
mass: {value: 1500.0, source: published, note: the makers brochure}
yaw_inertia: 2.6e3
cg_to_front_axle: 1.25
cg_to_rear_axle: 1.45
wheel_radius: 0.31
drive_split_front: 0.4
front_tire: {B: {value: 11, source: calibrated}, C: 1.45, D: 7900.0}
rear_tire: {B: 12.5, C: 1.45, D: 6800.0}
max_torque: 2500.0
effects:
  - {term: aero_drag, parameters: {drag: 0.08}}
"""


def by_hand(**changes):
    content = yaml.safe_load(TEXT)
    content.update(changes)
    return {key: value for key, value in content.items() if value is not ...}


def test_a_file_written_by_hand(tmp_path):
    path = tmp_path / "car.yaml"
    path.write_text(TEXT)
    car = read_vehicle(path)
    assert car.name == "written by hand"
    assert car.mass == 1500.0
    # 2.6e3 without a sign in its exponent is text to YAML 1.1, and a number to everyone else.
    assert car.yaw_inertia == 2600.0
    assert car.origins == {"mass": "published", "front_tire.B": "calibrated"}
    assert car.notes == {"mass": "the makers brochure"}
    assert car.brake_split_front == car.drive_split_front == 0.4
    assert car.max_brake_torque == car.max_torque == 2500.0
    assert (car.drag_coefficient, car.cg_height) == (0.0, None)
    assert car.effects == (EffectSpec("aero_drag", {"drag": 0.08}),)


POSITIVE = st.floats(0.05, 5.0)  # what some vehicle has, for every key alike
SHARE = st.floats(0.0, 1.0)
TIRE = st.builds(MagicFormula, B=POSITIVE, C=st.floats(0.1, 1.99), D=POSITIVE)
ORIGINS = st.dictionaries(
    st.sampled_from(["mass", "wheel_radius", "rear_tire.D"]), st.sampled_from(["published", "assumed", "calibrated"])
)
VEHICLES = st.builds(
    Vehicle,
    name=st.text(alphabet=st.characters(categories=["L", "N", "P", "Zs"]), min_size=1, max_size=20),
    mass=st.floats(0.05, 1e5),
    yaw_inertia=POSITIVE,
    cg_to_front_axle=POSITIVE,
    cg_to_rear_axle=POSITIVE,
    wheel_radius=POSITIVE,
    drive_split_front=SHARE,
    brake_split_front=SHARE,
    front_tire=TIRE,
    rear_tire=TIRE,
    max_torque=POSITIVE,
    max_brake_torque=POSITIVE,
    rolling_resistance_front=st.floats(0.0, 1e4),
    rolling_resistance_rear=st.floats(0.0, 1e4),
    drag_coefficient=st.floats(0.0, 10.0),
    cg_height=st.none() | POSITIVE,
    friction_coefficient=st.none() | POSITIVE,
    effects=st.lists(
        st.builds(
            EffectSpec,
            st.just("aero_drag"),
            st.dictionaries(st.sampled_from(["drag"]), st.floats(-10, 10)),
            st.sampled_from(["", "quadratic"]),
        ),
        max_size=2,
    ).map(tuple),
    origins=ORIGINS,
    notes=st.dictionaries(st.sampled_from(["mass", "front_tire.B"]), st.text("abc: {}#'", min_size=1, max_size=12)),
)


@settings(max_examples=60, deadline=None)
@given(VEHICLES)
def test_write_and_read_give_an_equal_vehicle(tmp_path_factory, vehicle):
    # Equal to the last bit: YAML writes the shortest digits that give the same double.
    path = tmp_path_factory.mktemp("vehicle") / "car.yaml"
    write_vehicle(vehicle, path, comment="made by a test\nin two lines")
    back = read_vehicle(path)
    assert back == vehicle
    assert back.digest() == vehicle.digest()
    assert path.read_text().startswith("# made by a test\n# in two lines\n")


def test_the_digest_sees_every_physical_value_and_no_wording():
    car = vehicle_from_mapping(by_hand())
    assert replace(car, name="x", origins={}, notes={}).digest() == car.digest()
    seen = {car.digest()}
    for field in fields(car):
        value = getattr(car, field.name)
        if isinstance(value, float):
            seen.add(replace(car, **{field.name: value + 0.015625}).digest())
    seen.add(replace(car, front_tire=MagicFormula(11.0, 1.45, 7901.0)).digest())
    seen.add(replace(car, effects=()).digest())
    seen.add(replace(car, cg_height=0.5).digest())
    numbers = sum(isinstance(getattr(car, field.name), float) for field in fields(car))
    assert len(seen) == 1 + numbers + 3


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"masss": 1500.0}, "unknown key 'masss'.*mass"),
        ({"Mass": 1500.0}, "unknown key 'Mass'.*mass"),
        ({"wheelbase": 2.7}, "unknown key 'wheelbase'"),
        ({"mass": ...}, "lacks mass"),
        ({"front_tire": ...}, "lacks front_tire"),
        ({"mass": -1.0}, "mass is -1, it must be positive"),
        ({"mass": 0}, "mass is 0, it must be positive"),
        ({"mass": math.nan}, "mass is nan, a finite number"),
        ({"mass": math.inf}, "mass is inf, a finite number"),
        ({"mass": True}, "mass is True, a finite number"),
        ({"mass": "heavy"}, "mass is 'heavy', a finite number"),
        ({"mass": [1500.0]}, r"mass is \[1500.0\], a finite number"),
        ({"mass": {"value": 1500.0, "source": "publisehd"}}, "source 'publisehd'.*published"),
        ({"mass": {"value": 1500.0, "origin": "published"}}, "mass must be a number or"),
        ({"drive_split_front": 40}, "drive_split_front is 40, it must lie in 0 to 1"),
        ({"brake_split_front": -0.1}, "must lie in 0 to 1"),
        ({"drag_coefficient": -0.1}, "must not be negative"),
        ({"front_tire": {"B": 11.0, "C": 1.45}}, "front_tire lacks D"),
        ({"front_tire": {"B": 11.0, "C": 2.1, "D": 1.0}}, "change sign"),
        ({"front_tire": {"B": -11.0, "C": 1.4, "D": 1.0}}, "must be positive"),
        ({"front_tire": {"B": 11.0, "C": 1.4, "D": 1.0, "E": 0.1}}, "unknown key 'E'.*--convert"),
        ({"front_tire": 7}, "lacks front_tire"),
        ({"effects": {"term": "aero_drag"}}, "must be a list"),
        ({"effects": [{"trem": "aero_drag"}]}, "was expected"),
        ({"effects": [{"term": "aero_drag", "parameters": [1]}]}, "parameters is"),
        ({"effects": [{"term": "aero_drag", "parameters": {"drag": "much"}}]}, "effects.aero_drag.drag is 'much'"),
    ],
)
def test_what_cannot_be_is_told_with_its_place(changes, message):
    with pytest.raises(VehicleError, match=message) as caught:
        vehicle_from_mapping(by_hand(**changes), where="car.yaml")
    assert str(caught.value).startswith("car.yaml: ")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "holds no keys"),
        ("- 1\n- 2\n", "holds no keys"),
        ("mass: {value: 1\n", "is not YAML .*line"),
        ("mass: 1500\nmass: 1600\n", "'mass' stands twice"),
        ("mass: !!python/object/apply:os.system [echo]\n", "is not YAML"),
        ("\x00", "is not YAML"),
    ],
)
def test_a_file_that_is_no_vehicle(tmp_path, text, message):
    path = tmp_path / "car.yaml"
    path.write_text(text)
    with pytest.raises(VehicleError, match=message):
        read_vehicle(path)


def test_unreadable_files_are_told(tmp_path):
    with pytest.raises(VehicleError, match="no such file"):
        read_vehicle(tmp_path / "none.yaml")
    with pytest.raises(VehicleError, match="cannot be read"):
        read_vehicle(tmp_path)
    (tmp_path / "latin.yaml").write_bytes(b"name: caf\xe9\n")
    with pytest.raises(VehicleError, match="no text in UTF-8"):
        read_vehicle(tmp_path / "latin.yaml")


def test_a_folder_of_the_name_of_a_library_car_is_not_taken_for_it(tmp_path, monkeypatch):
    name = library_names()[0]
    monkeypatch.chdir(tmp_path)
    library = read_vehicle(name)
    (tmp_path / name).mkdir()
    assert read_vehicle(name) == library
    # A file of that name is; a folder of another name is told.
    (tmp_path / name).rmdir()
    (tmp_path / name).write_text(TEXT)
    assert read_vehicle(name).name == "written by hand"
    (tmp_path / "nobody").mkdir()
    with pytest.raises(VehicleError, match="cannot be read"):
        read_vehicle("nobody")


def test_static_loads_balance_weight_and_moment():
    car = vehicle_from_mapping(by_hand())
    assert car.static_load_front + car.static_load_rear == pytest.approx(1500.0 * 9.80665, rel=1e-14)
    moment = car.static_load_front * car.cg_to_front_axle - car.static_load_rear * car.cg_to_rear_axle
    assert moment == pytest.approx(0.0, abs=1e-9)


def test_minimum_speed_is_the_papers_for_its_car():
    # 5 m/s for a wheelbase of 2.7 m, and slower with the root for smaller cars.
    car = vehicle_from_mapping(by_hand())
    assert car.minimum_speed == pytest.approx(5.0, rel=1e-14)
    assert replace(car, cg_to_front_axle=0.16, cg_to_rear_axle=0.17).minimum_speed == pytest.approx(1.748, abs=1e-3)


@pytest.mark.parametrize(
    ("written", "meant"), [("01500", 1500.0), ("1.5e3", 1500.0), ("15e2", 1500.0), ("1500.", 1500.0), ("0x5DC", 1500.0)]
)
def test_a_number_is_what_people_mean_by_it(written, meant):
    """YAML 1.1 takes 01500 for the octal 832, and 25:00 for 1500."""
    assert float(parse_yaml(f"mass: {written}")["mass"]) == meant
    assert parse_yaml("mass: 25:00")["mass"] == "25:00"
