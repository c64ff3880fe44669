"""Natural experiments: what an engineer measures beside the diagnosis, and what the diagnosis says of it."""

import numpy as np
import pytest

from split_cli.vehicle.parameters import read_vehicle
from tests.foreign.natural import (
    DART_CAR,
    RUBBER,
    TAPE,
    at_equal_slips,
    dart_drive,
    kth_drive,
    run,
    saturated_acceleration,
)

pytestmark = pytest.mark.foreign


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    return tmp_path_factory.mktemp("natural")


def test_the_truth_by_force_at_saturation(datasets, work):
    """Nothing but v_x r of the pose on steady circles: 7.7 m/s^2 on rubber over 3.3 m/s^2 on tape."""
    limits = {name: saturated_acceleration(dart_drive(datasets, name, work)) for name in (RUBBER, TAPE)}
    assert limits[RUBBER] / limits[TAPE] == pytest.approx(2.3, abs=0.1)


def test_at_equal_slips_tape_lacks_less_than_at_the_peak(datasets, work):
    """Rubber's force still rises where tape's is at its limit: a whole curve has no ratio of 0.43."""
    real, simulated = (dart_drive(datasets, name, work) for name in (TAPE, RUBBER))
    vehicle = read_vehicle(DART_CAR)
    assert at_equal_slips(real, real, vehicle) == (1.0, 1.0)
    assert at_equal_slips(real, simulated, vehicle) == pytest.approx((0.48, 0.59), abs=0.02)


def test_tape_differs_from_a_model_of_the_car_on_rubber_by_its_grip(datasets, work):
    """Constant steering on purpose, torque from the throttle; at equal slips forces are 0.48 to 0.59 of it."""
    told = run("tape-nominal", datasets, work)
    low, high = told.findings[0].parameters["scale"].interval_95
    assert told.findings[0].term == "friction_scale" and low < 0.59 and high > 0.48


def test_halves_of_one_floor_have_no_name(datasets, work):
    told = run("tape-halves", datasets, work)
    assert not told.findings and told.verdict != "mismatch"


def test_the_can_yaw_rate_is_some_40_ms_later_than_the_imus(datasets, work):
    """The truth apart from the diagnosis: the shift at which the two yaw rates of one slalom agree best."""
    can, imu = (kth_drive(datasets, "038", work, *layers)["r"] for layers in ((), ("imu",)))
    misfit = [np.std(can[20 + k : len(can) - 20 + k] - imu[20 : len(imu) - 20]) for k in range(-10, 11)]
    assert (int(np.argmin(misfit)) - 10) * 10 == pytest.approx(40, abs=10)
