"""Vehicles written as other projects' parameters and read again by the converters."""

import numpy as np
import pytest
import yaml
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import VehicleError
from split_cli.vehicle.converters import convert_parameters
from split_cli.vehicle.parameter_export import foreign_parameters
from split_cli.vehicle.parameters import EffectSpec, write_vehicle
from split_cli.vehicle.tire import lateral_force
from tests.factories import road_car

ALPHA = np.linspace(-0.18, 0.18, 361)


def again(tmp_path, written):
    path = tmp_path / "params.yaml"
    path.write_text(yaml.safe_dump(written.content))
    return convert_parameters([path])


@pytest.mark.parametrize(
    ("kind", "read_as"), [("f1tenth", "F1TENTH"), ("forzaeth", "ForzaETH"), ("commonroad", "CommonRoad")]
)
def test_mass_geometry_and_stiffness_come_back(tmp_path, kind, read_as):
    car = road_car()
    written = foreign_parameters(car, kind)
    found = again(tmp_path, written)
    assert found.kind == read_as
    for name in ("mass", "yaw_inertia", "cg_to_front_axle", "cg_to_rear_axle"):
        assert getattr(found.vehicle, name) == pytest.approx(getattr(car, name), rel=1e-12)
    if kind != "commonroad":  # which has one tyre for both axles
        for axle in ("front_tire", "rear_tire"):
            old, new = getattr(car, axle), getattr(found.vehicle, axle)
            assert pytest.approx(old.B * old.C * old.D, rel=1e-6) == new.B * new.C * new.D


def test_effects_are_told_as_lost_since_no_format_has_a_place_for_them():
    late = road_car().with_effects(EffectSpec("drive_lag", {"tau": 0.05}))
    assert "effects: drive_lag" in foreign_parameters(late, "forzaeth").lost


def test_forzaeth_is_exact_and_the_others_tell_their_deviation(tmp_path):
    car = road_car()
    found = again(tmp_path, foreign_parameters(car, "forzaeth")).vehicle
    for old, new in ((car.front_tire, found.front_tire), (car.rear_tire, found.rear_tire)):
        np.testing.assert_allclose(
            lateral_force(new.B, new.C, new.D, ALPHA), lateral_force(old.B, old.C, old.D, ALPHA), rtol=1e-9
        )
    assert max(foreign_parameters(car, "forzaeth").deviations) < 1e-9 * car.front_tire.D
    linear = foreign_parameters(car, "f1tenth")
    t = car.front_tire
    expected = abs(t.B * t.C * t.D * 0.18 - float(lateral_force(t.B, t.C, t.D, np.array([0.18]))[0]))
    assert linear.deviations[0] == pytest.approx(expected, rel=1e-9)
    shared = foreign_parameters(car, "commonroad")
    read = again(tmp_path, shared).vehicle.rear_tire
    t = car.rear_tire
    error = np.abs(lateral_force(read.B, read.C, read.D, ALPHA) - lateral_force(t.B, t.C, t.D, ALPHA)).max()
    assert error == pytest.approx(shared.deviations[1], rel=1e-6)


def test_an_unknown_format_names_the_nearest():
    with pytest.raises(VehicleError, match="forzaeth"):
        foreign_parameters(road_car(), "forzaethz")


def test_the_command_writes_what_the_library_says(tmp_path):
    car = road_car()
    write_vehicle(car, tmp_path / "car.yaml")
    given = ["calibrate", "--convert", str(tmp_path / "car.yaml"), "-o", str(tmp_path / "params.yaml")]
    done = CliRunner().invoke(group, [*given, "--to", "forzaeth"])
    assert done.exit_code == 0, done.output
    assert "not in this format" in done.output
    assert yaml.safe_load((tmp_path / "params.yaml").read_text()) == foreign_parameters(car, "forzaeth").content
    assert CliRunner().invoke(group, [*given[:1], *given[2:], "--to", "forzaeth"]).exit_code == 2
