"""The drift model in the places of the multi-body state: the same motion as by the package's own state."""

import math

import numpy as np
import pytest

from tests.optional import needed
from tests.studies.drift_car import load_drift_car
from tests.studies.multibody_car import MULTIBODY_STATE as AT

std = needed("vehiclemodels.vehicle_dynamics_std")


def stepped(derivative, x: np.ndarray, inputs, parameters, step: float) -> np.ndarray:
    """Return the state one Runge-Kutta step later."""

    def rates(state: np.ndarray) -> np.ndarray:
        return np.array(derivative(list(state), list(inputs), parameters))

    k1 = rates(x)
    k2 = rates(x + 0.5 * step * k1)
    k3 = rates(x + 0.5 * step * k2)
    k4 = rates(x + step * k3)
    return x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)


@pytest.mark.parametrize("number", [1, 2])
@pytest.mark.parametrize("inputs", [(0.05, 1.5), (-0.08, -4.0)])
def test_it_moves_as_by_the_package_s_own_state(number, inputs):
    car = load_drift_car(number)
    p = car.parameters
    ours = np.array(car.initial([3.0, -2.0, 0.01, 18.0, 0.4, 0.0, 0.0], p))
    theirs = np.array([3.0, -2.0, 0.01, 18.0, 0.4, 0.0, 0.0, 18.0 / p.R_w, 18.0 / p.R_w])
    for _ in range(500):
        ours = stepped(car.derivative, ours, inputs, p, 2e-3)
        theirs = stepped(std.vehicle_dynamics_std, theirs, inputs, p, 2e-3)
    speed, slip = theirs[3], theirs[6]
    assert abs(slip) > 1e-4 and abs(theirs[5]) > 0.05
    expected = [*theirs[:3], speed * math.cos(slip), theirs[4], theirs[5], speed * math.sin(slip)]
    got = ours[[AT.X, AT.Y, AT.delta, AT.vx, AT.yaw, AT.r, AT.vy]]
    np.testing.assert_allclose(got, expected, rtol=1e-7, atol=1e-8)
    np.testing.assert_allclose(ours[[AT.spins.start, AT.spins.start + 2]], theirs[7:], rtol=1e-7)
