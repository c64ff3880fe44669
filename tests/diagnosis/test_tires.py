"""The shared discrepancy on other tyres: lateral forces that grow with the peak, and a grip found beside them."""

import numpy as np
import pytest

import split_cli.diagnosis.baseline.discrepancy as discrepancy_module
from split_cli.diagnosis.baseline.tires import at_other_tires
from split_cli.diagnosis.recording.series import extended_model
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import case_of, driven, fitted_scale, prepared
from tests.diagnosis.test_self_test import drive, recorded
from tests.factories import road_car

GRIP = 0.6
#: What the nominal lacks: tyres of another stiffness, and a force that no tyre makes.
LACKING = (("tire_stiffness", {"front_scale": 1.6, "rear_scale": 1.6}), ("aero_drag", {"drag": 0.8}))


def term(name: str, variant: str = "", **values: float) -> Term:
    return CATALOGUE[name](values, variant)


def lacking() -> tuple[Term, ...]:
    return tuple(term(name, **values) for name, values in LACKING)


def test_what_the_nominal_lacks_of_a_scaled_curve_is_scaled_with_it():
    """Truth is a car with other tyres on GRIP of the road; at the same slips it lacks GRIP of the lateral force.

    Steering is small: the cosine and sine of its angle, which turn lateral forces into drag, are left out.
    """
    car, series = road_car(), prepared(driven(3, runs=2))
    grip = term("friction_scale", "curve", scale=GRIP)

    def lacks(*terms: Term) -> np.ndarray:
        return series.rates(extended_model(car, (*lacking(), *terms))) - series.rates(extended_model(car, terms))

    found, truth = at_other_tires(lacks(), series, car, (grip,)), lacks(grip)
    assert np.std(lacks()[:, 1]) > 0.1  # there is something to scale
    np.testing.assert_allclose(found[:, 1:], truth[:, 1:], atol=0.03 * np.std(truth[:, 1:], axis=0).max())


def test_each_axle_has_its_own_peak_and_the_force_along_the_car_stays():
    car, series = road_car(), prepared(driven(3, runs=1))
    forces = np.random.default_rng(5).standard_normal((len(series), 3)) * 1000.0
    rates = forces @ car.force_matrix().T
    load = term("aero_downforce", front=0.0, rear=2.0)
    found = at_other_tires(rates, series, car, (load,)) @ np.linalg.inv(car.force_matrix()).T
    ratio = series.flow(extended_model(car, (load,))).rear.D / car.rear_tire.D
    assert np.all(ratio > 1.0)
    np.testing.assert_allclose(found, forces * np.stack([np.ones(len(series)), np.ones(len(series)), ratio], axis=1))


def test_a_lower_peak_changes_nothing_at_small_slip_and_all_at_the_limit():
    car, series = road_car(), prepared(driven(3, runs=1))
    rates = np.ones((len(series), 3)) @ car.force_matrix().T
    peak = at_other_tires(rates, series, car, (term("friction_scale", scale=GRIP),))
    ratio = peak @ np.linalg.inv(car.force_matrix()).T
    flow = series.flow(extended_model(car))
    for k, axle, tire in ((1, flow.front, car.front_tire), (2, flow.rear, car.rear_tire)):
        used = np.abs(tire.B * axle.slip_angle)
        assert np.all((ratio[:, k] > GRIP - 0.05) & (ratio[:, k] <= 1.0 + 1e-12))
        np.testing.assert_allclose(ratio[used < 0.02, k], 1.0, atol=2e-3)
        assert np.corrcoef(used, ratio[:, k])[0, 1] < -0.9
    np.testing.assert_allclose(ratio[:, 0], 1.0)


def test_what_alters_no_tyre_leaves_the_rates_alone():
    car, series = road_car(), prepared(driven(3, runs=1))
    rates = np.ones((len(series), 3))
    others = (term("steer_gain", gain=0.9), term("yaw_inertia", scale=1.2), term("mass", "loaded", scale=1.2))
    assert at_other_tires(rates, series, car, others) is rates


def test_a_grip_is_found_beside_much_that_the_nominal_lacks(monkeypatch):
    """Stiffer tyres make forces that only the shared discrepancy knows."""
    simulation = drive(1, lacking())
    reality = recorded(drive(2, (*lacking(), term("friction_scale", "curve", scale=GRIP))), 2)
    case, term_and_variant = case_of(reality, simulation), ("friction_scale", "curve")
    assert fitted_scale(case, *term_and_variant) == pytest.approx(GRIP, abs=0.02)
    monkeypatch.setattr(discrepancy_module, "at_other_tires", lambda rates, *others: rates)
    assert abs(fitted_scale(case, *term_and_variant) - GRIP) > 0.03
