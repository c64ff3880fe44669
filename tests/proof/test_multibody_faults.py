"""Faults put into the multi-body car: what each alters, and that it alters nothing else."""

from copy import deepcopy
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.proof.outcome import Statement
from split_cli.vehicle.effects import CATALOGUE
from split_cli.workflows.proving.prove_recording import injection_result
from tests.factories import make_drive
from tests.optional import needed
from tests.studies.multibody_car import MultiBody, load_car
from tests.studies.multibody_faults import MULTIBODY_FAULTS, multibody_faults

FAULTS = {fault.name: fault for fault in MULTIBODY_FAULTS}


def stub() -> MultiBody:
    """A car whose rates are its inputs and its mass."""
    tire = SimpleNamespace(p_dx1=1.1, p_dy1=1.0, p_ky1=-20.0)
    parameters = SimpleNamespace(m=1000.0, m_s=900.0, I_z=1500.0, a=1.2, b=1.5, tire=tire)
    return MultiBody(parameters, lambda x, u, p: [u[0], u[1], p.m] + 26 * [0.0], None, None, None)


def rates(car: MultiBody, acceleration: float, vx: float = 20.0) -> np.ndarray:
    state = [0.0] * 29
    state[3] = vx
    return np.array(car.derivative(state, [0.1, acceleration], car.parameters))


@pytest.mark.parametrize("fault", MULTIBODY_FAULTS, ids=lambda fault: fault.name)
def test_every_fault_is_a_term_with_its_parameters_or_has_none(fault):
    parameters = dict(fault.parameters(stub()))
    assert fault.in_catalogue == (bool(fault.term) or fault.name.startswith("none"))
    if fault.term:
        kind = CATALOGUE[fault.term]
        assert set(parameters) <= set(kind.units)
        assert all(value != kind.neutral.get(name) for name, value in parameters.items())
    else:
        assert not parameters


@pytest.mark.parametrize("fault", MULTIBODY_FAULTS, ids=lambda fault: fault.name)
def test_a_fault_leaves_the_sound_car_and_its_recording_alone(fault):
    car, drive = stub(), make_drive(3, 1, 4.0, 0.01)
    before, columns = deepcopy(car.parameters), {name: value.copy() for name, value in drive.columns.items()}
    altered, recorded = fault.alter(car), fault.record(drive)
    assert car.parameters == before
    assert all(np.array_equal(drive[name], value) for name, value in columns.items())
    touched = altered.parameters != before or altered.derivative is not car.derivative
    touched |= any(not np.array_equal(recorded[name], value) for name, value in columns.items())
    assert touched != fault.name.startswith("none")


def test_parameters_are_altered_as_they_say():
    p = stub().parameters
    heavy, grip, soft, slow, ahead = (
        FAULTS[name].alter(stub()).parameters
        for name in ("payload", "less grip", "softer tyres", "more yaw inertia", "mass ahead")
    )
    assert (heavy.m, heavy.m_s, heavy.I_z) == (1100.0, 1000.0, p.I_z)
    assert (grip.tire.p_dx1, grip.tire.p_dy1) == pytest.approx((0.99, 0.9)) and grip.tire.p_ky1 == p.tire.p_ky1
    assert soft.tire.p_ky1 == pytest.approx(0.88 * p.tire.p_ky1) and slow.I_z == pytest.approx(1800.0)
    assert (ahead.a, ahead.b) == pytest.approx((1.14, 1.56))


def test_forces_from_outside_and_what_arrives_of_the_torque():
    plain = rates(stub(), 2.0)
    drag = rates(FAULTS["drag"].alter(stub()), 2.0) - plain
    assert drag[3] * 1000.0 == pytest.approx(-dict(FAULTS["drag"].parameters(stub()))["drag"] * 400.0)
    bank = rates(FAULTS["bank"].alter(stub()), 2.0) - plain
    angle = dict(FAULTS["bank"].parameters(stub()))["angle"]
    # The left side lower pushes the car, and either axle, to the left.
    assert bank[[10, 15, 20]] == pytest.approx(-9.81 * np.sin(angle)) and bank[3] == 0.0
    weak = FAULTS["weak torque"].alter(stub())
    assert rates(weak, 2.0)[1] == pytest.approx(1.8) and rates(weak, -2.0)[1] == pytest.approx(-1.9)


@pytest.mark.parametrize(
    ("term", "known", "verdict", "unexplained", "outcome"),
    [
        ("", True, "match", False, "exact"),
        ("", True, "mismatch", True, "wrong"),
        ("", False, "match", False, "missed"),
        ("", False, "mismatch", True, "exact"),
        ("", False, "mismatch", False, "wrong"),
        ("mass", True, "match", False, "missed"),
    ],
)
def test_a_fault_without_a_name_is_right_only_if_something_is_said_to_have_none(
    term, known, verdict, unexplained, outcome
):
    said = Statement(verdict, (), unexplained)
    assert injection_result("car", "bent", term, (), said, "", in_catalogue=known).outcome == outcome


def test_a_wrong_name_lists_those_there_are():
    assert multibody_faults(["drag"]) == (FAULTS["drag"],) and multibody_faults() == MULTIBODY_FAULTS
    with pytest.raises(SplitError, match="no fault is called 'wings'") as caught:
        multibody_faults(["wings"])
    assert all(name in str(caught.value) + str(caught.value.advice) for name in FAULTS)


def test_the_foreign_car_feels_them():
    needed("vehiclemodels")
    car = load_car(2)
    p = car.parameters
    state = list(car.initial([0.0, 0.0, 0.0, 20.0, 0.0, 0.0, 0.0], p))
    still = np.array(car.derivative(list(state), [0.0, 0.0], p))
    pushed = FAULTS["resistance"].alter(car)
    assert np.array(pushed.derivative(list(state), [0.0, 0.0], p))[3] - still[3] == pytest.approx(-0.15)
    heavy = FAULTS["payload"].alter(car).parameters
    assert heavy.m == pytest.approx(1.1 * p.m) and heavy.m_s - p.m_s == pytest.approx(heavy.m - p.m)
