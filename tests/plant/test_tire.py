"""The tyre against closed forms, finite differences and the friction ellipse."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.plant.cars import CARS, F1TENTH_CAR, ROAD_CAR
from split_cli.plant.tire import tire_force

TIRES = [car.rear_tire for car in CARS.values()]


def test_published_tyre_at_its_nominal_load_by_hand():
    # Pacejka's 205/60 R15 at F_z0: every df_z term vanishes, so the lateral formula is five numbers.
    tire = ROAD_CAR.rear_tire
    peak = 0.990 * 4000.0
    slope = 14.95 * 4000.0 * np.sin(2.0 * np.arctan(1.0 / 2.130))
    b = slope / (1.193 * peak) * 0.06
    by_hand = peak * np.sin(1.193 * np.arctan(b + 1.003 * (b - np.arctan(b))))
    # The same double operations in another order: a few units in the last place.
    assert tire_force(tire, 0.0, 0.06, 4000.0)[1] == pytest.approx(by_hand, rel=1e-12)


@pytest.mark.parametrize("tire", TIRES)
@pytest.mark.parametrize("share", [0.4, 1.0, 1.7])
def test_slopes_at_zero_slip_are_the_stated_stiffnesses(tire, share):
    load = share * tire.nominal_load
    df = share - 1.0
    step = 1e-5
    cornering = tire_force(tire, 0.0, step, load)[1] / step
    traction = tire_force(tire, step, 0.0, load)[0] / step
    # F is odd, so the secant over [0, h] is off by O(h^2), far below 1e-6.
    assert cornering == pytest.approx(
        tire.p_ky1 * tire.nominal_load * np.sin(2 * np.arctan(share / tire.p_ky2)), rel=1e-6
    )
    assert traction == pytest.approx(load * (tire.p_kx1 + tire.p_kx2 * df) * np.exp(tire.p_kx3 * df), rel=1e-6)


def test_friction_scales_the_peak_and_leaves_the_slope():
    tire, load = ROAD_CAR.rear_tire, 4000.0
    angles = np.linspace(0.0, 0.6, 601)
    dry, wet = (tire_force(tire, 0.0, angles, load, mu)[1] for mu in (1.0, 0.6))
    # Both maxima lie inside the grid; a parabola's top is missed by a grid of 1 mrad by less than 1e-4.
    assert wet.max() / dry.max() == pytest.approx(0.6, rel=1e-4)
    assert wet[1] / dry[1] == pytest.approx(1.0, abs=2e-3)  # at 1 mrad curvature is of second order


def test_more_load_gives_less_friction():
    angles = np.linspace(0.0, 0.4, 401)
    for tire in TIRES:
        light, heavy = (
            tire_force(tire, 0.0, angles, s * tire.nominal_load)[1].max() / (s * tire.nominal_load) for s in (0.5, 1.5)
        )
        assert heavy < light
        # mu(F_z) is a straight line: its fall over one nominal load is -p_dy2, exactly.
        assert light - heavy == pytest.approx(-tire.p_dy2, abs=1e-4)


@pytest.mark.parametrize("tire", TIRES)
def test_mirrored_slip_gives_mirrored_force(tire):
    kappa, alpha = np.meshgrid(np.linspace(-0.3, 0.3, 13), np.linspace(-0.3, 0.3, 13))
    fx, fy = tire_force(tire, kappa, alpha, tire.nominal_load)
    mirrored_fx, mirrored_fy = tire_force(tire, kappa, -alpha, tire.nominal_load)
    np.testing.assert_array_equal(mirrored_fx, fx)
    np.testing.assert_array_equal(mirrored_fy, -fy)


@pytest.mark.parametrize("tire", TIRES)
def test_combined_force_fills_the_friction_ellipse_and_hardly_leaves_it(tire):
    load = tire.nominal_load
    kappa, alpha = np.meshgrid(np.linspace(0.0, 0.4, 161), np.linspace(0.0, 0.5, 201))
    fx, fy = tire_force(tire, kappa, alpha, load)
    usage = np.hypot(
        fx / tire_force(tire, kappa[0], 0.0, load)[0].max(), fy / tire_force(tire, 0.0, alpha[:, 0], load)[1].max()
    )
    # Weighting functions are no ellipse: measured tyres leave it by up to 15 % at the shoulder (Pacejka, fig. 3.18
    # shows as much), and along every direction the best combined slip comes near it.
    assert usage.max() < 1.15
    direction = np.arctan2(fy / (tire.p_dy1 * load), fx / (tire.p_dx1 * load))
    for low in np.linspace(0.0, 1.4, 15):
        inside = (direction >= low) & (direction < low + 0.12)
        assert usage[inside].max() > 0.80


def test_lateral_force_falls_as_the_wheel_brakes_and_not_without_combined_slip():
    tire = ROAD_CAR.rear_tire
    slips = np.linspace(0.0, -0.3, 31)
    force = tire_force(tire, slips, 0.05, 4000.0)[1]
    assert np.all(np.diff(force) < 0)
    assert force[-1] < 0.5 * force[0]
    apart = tire_force(replace(tire, combined_slip=0.0), slips, 0.05, 4000.0)[1]
    np.testing.assert_array_equal(apart, apart[0])


def test_a_wheel_in_the_air_gives_nothing():
    assert tire_force(F1TENTH_CAR.front_tire, 0.1, 0.1, 0.0) == (0.0, 0.0)
