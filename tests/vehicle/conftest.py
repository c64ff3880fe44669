"""Cars that the tests of this folder share: textbook sizes, nobody's product."""

import pytest

from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import MagicFormula
from tests import factories

ROAD_CAR = factories.road_car(name="test road car", max_brake_torque=6500.0, cg_height=0.55, friction_coefficient=1.0)

SMALL_CAR = Vehicle(
    name="test small car",
    mass=3.5,
    yaw_inertia=0.05,
    cg_to_front_axle=0.16,
    cg_to_rear_axle=0.17,
    wheel_radius=0.05,
    drive_split_front=0.5,
    brake_split_front=0.5,
    front_tire=MagicFormula(8.0, 1.4, 15.0),
    rear_tire=MagicFormula(9.0, 1.4, 15.5),
    max_torque=1.2,
    max_brake_torque=1.2,
    rolling_resistance_front=0.3,
    rolling_resistance_rear=0.3,
    drag_coefficient=0.01,
)

BOTH = (ROAD_CAR, SMALL_CAR)


@pytest.fixture(scope="session")
def road_car() -> Vehicle:
    return ROAD_CAR


@pytest.fixture(params=BOTH, ids=["road", "small"])
def car(request) -> Vehicle:
    return request.param
