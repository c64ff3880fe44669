"""The shared discrepancy on other tyres: lateral forces that grow with the peak, and a grip found beside them."""

import numpy as np
import pytest

import split_cli.diagnosis.baseline.discrepancy as discrepancy_module
from split_cli.diagnosis.baseline.body import with_cg_ahead
from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.baseline.tires import AxleBalance, at_other_tires, at_scaled_slips, similarity, tire_ratios
from split_cli.diagnosis.recording.series import Series, extended_model
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle
from split_cli.vehicle.tire import lateral_force
from tests.diagnosis.recordings import case_of, driven, fitted_value, prepared
from tests.diagnosis.test_self_test import drive, recorded
from tests.factories import road_car

GRIP = 0.6
#: What the nominal lacks: tyres of another stiffness, and a force that no tyre makes.
LACKING = (("tire_stiffness", {"front_scale": 1.6, "rear_scale": 1.6}), ("aero_drag", {"drag": 0.8}))


def term(name: str, variant: str = "", **values: float) -> Term:
    return CATALOGUE[name](values, variant)


def axles_of(vehicle: Vehicle, series: Series) -> AxleBalance:
    return AxleBalance(vehicle, series.steer_angle)


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

    found, truth = at_other_tires(lacks(), axles_of(car, series), tire_ratios(series, car, (grip,))), lacks(grip)
    assert np.std(lacks()[:, 1]) > 0.1  # there is something to scale
    np.testing.assert_allclose(found[:, 1:], truth[:, 1:], atol=0.03 * np.std(truth[:, 1:], axis=0).max())


def test_forces_of_steered_wheels_are_those_that_a_model_adds():
    """What other tyres add to the rates of a model are the forces that they add to its wheels, at any steer angle."""
    car, series = road_car(), prepared(driven(3, runs=1))
    plain, stiffer = (extended_model(car, terms) for terms in ((), lacking()[:1]))
    axles = axles_of(car, series)
    rates = series.rates(stiffer) - series.rates(plain)
    after, before = (series.flow(model) for model in (stiffer, plain))
    added = [getattr(after, axle).lateral_force - getattr(before, axle).lateral_force for axle in ("front", "rear")]
    found = axles.of_rates(rates)
    assert np.abs(series.steer_angle).max() > 0.03
    np.testing.assert_allclose(found, np.stack([0.0 * added[0], *added], axis=1), atol=1e-6)
    np.testing.assert_allclose(axles.to_rates(found), rates, atol=1e-12)


def test_each_axle_has_its_own_peak_and_the_force_along_the_car_stays():
    car, series = road_car(), prepared(driven(3, runs=1))
    forces = np.random.default_rng(5).standard_normal((len(series), 3)) * 1000.0
    axles, load = axles_of(car, series), term("aero_downforce", front=0.0, rear=2.0)
    found = axles.of_rates(at_other_tires(axles.to_rates(forces), axles, tire_ratios(series, car, (load,))))
    ratio = series.flow(extended_model(car, (load,))).rear.D / car.rear_tire.D
    assert np.all(ratio > 1.0)
    np.testing.assert_allclose(found, forces * np.stack([np.ones(len(series)), np.ones(len(series)), ratio], axis=1))


def test_a_lower_peak_changes_nothing_at_small_slip_and_all_at_the_limit():
    car, series = road_car(), prepared(driven(3, runs=1))
    axles, weaker = axles_of(car, series), (term("friction_scale", scale=GRIP),)
    rates = axles.to_rates(np.ones((len(series), 3)))
    ratio = axles.of_rates(at_other_tires(rates, axles, tire_ratios(series, car, weaker)))
    flow = series.flow(extended_model(car))
    for k, axle, tire in ((1, flow.front, car.front_tire), (2, flow.rear, car.rear_tire)):
        used = np.abs(tire.B * axle.slip_angle)
        assert np.all((ratio[:, k] > GRIP - 0.05) & (ratio[:, k] <= 1.0 + 1e-12))
        np.testing.assert_allclose(ratio[used < 0.02, k], 1.0, atol=2e-3)
        assert np.corrcoef(used, ratio[:, k])[0, 1] < -0.9
    np.testing.assert_allclose(ratio[:, 0], 1.0)


@pytest.mark.parametrize(
    ("name", "values"),
    [("friction_scale", {"scale": 0.8}), ("tire_stiffness", {"front_scale": 0.85, "rear_scale": 1.2})],
)
def test_a_curve_of_the_same_shape_is_the_old_one_at_scaled_slips(name, values):
    """With F'(alpha) = peak F(slip alpha), what the nominal model lacks of a car is scaled by the same factors."""
    car, series = road_car(), prepared(driven(3, runs=1))
    changed = term(name, **values)
    similar = similarity(series, car, (changed,))
    before, after = (series.flow(extended_model(car, terms)) for terms in ((), (changed,)))
    for k, tire, old, new in (
        (1, car.front_tire, before.front, after.front),
        (2, car.rear_tire, before.rear, after.rear),
    ):
        scaled = lateral_force(tire.B, tire.C, tire.D, similar.slip[k] * old.slip_angle)
        np.testing.assert_allclose(new.lateral_force, similar.peak[k] * scaled, rtol=1e-9)


def test_rates_at_scaled_slips_are_interpolated_to_some_thousandths():
    car, series = road_car(), prepared(driven(3, runs=1))
    discrepancy = build_shared_discrepancy(car, series)
    weights = np.random.default_rng(3).standard_normal(discrepancy.columns(series).shape[2])

    def rates_at(scale: float) -> np.ndarray:
        return discrepancy.rates_of_own_car(series, weights, (), {1: scale, 2: scale})[0]

    # One factor all along, and one that is another at each moment, as with load that moves.
    for scale in (0.87, 1.0 + 0.2 * np.sin(series.t)):
        found = at_scaled_slips(rates_at, {1: scale, 2: scale}, axles_of(car, series))
        exact = discrepancy.rates_of_own_car(series, weights, (), {1: scale, 2: scale})[0]
        np.testing.assert_allclose(found[:, 1:], exact[:, 1:], atol=4e-3 * np.abs(exact[:, 1:]).max())


def test_what_alters_no_tyre_leaves_the_rates_alone():
    car, series = road_car(), prepared(driven(3, runs=1))
    rates = np.ones((len(series), 3))
    others = (term("steer_gain", gain=0.9), term("yaw_inertia", scale=1.2), term("mass", scale=1.2))
    assert at_other_tires(rates, axles_of(car, series), tire_ratios(series, car, others)) is rates


def test_a_heavier_car_whose_tyres_follow_the_load_turns_as_before():
    """All forces across and the inertia grow with the mass: only the rate along the car falls."""
    car, series = road_car(), prepared(driven(3, runs=1))
    rates = np.random.default_rng(6).standard_normal((len(series), 3))
    heavier = (term("mass", "loaded", scale=1.2), term("yaw_inertia", scale=1.2))
    found = build_shared_discrepancy(car, series).at_another_car(rates, series, heavier)
    np.testing.assert_allclose(found[:, 1:], rates[:, 1:], rtol=1e-12)
    # Steered front tyres push back, too, and their forces have grown.
    straight = np.abs(series.steer_angle) < 1e-3
    np.testing.assert_allclose(found[straight, 0], rates[straight, 0] / 1.2, atol=1e-3)


def test_a_shifted_cg_loads_the_tyres_once():
    """With tyres in proportion to the load, the front axle's force grows as its arm shrinks, and the moment stays."""
    car, series = road_car(), prepared(driven(3, runs=1))
    forces = np.random.default_rng(7).standard_normal((len(series), 3)) * 1000.0
    axles, shift = axles_of(with_cg_ahead(car, 0.1), series), (term("cg_shift", "loaded", dx=0.1),)
    peaks = similarity(series, car, shift).peak
    found = build_shared_discrepancy(car, series).at_another_car(axles.to_rates(forces), series, shift, peaks)
    ratios = np.array([1.0, 1.0 + 0.1 / car.cg_to_rear_axle, 1.0 - 0.1 / car.cg_to_front_axle])
    np.testing.assert_allclose(axles.of_rates(found), forces * ratios, rtol=1e-9, atol=1e-6)


def test_a_mass_is_found_beside_much_that_the_nominal_lacks():
    """The tyres follow the load, and so does the force of which only the shared discrepancy knows."""
    simulation = drive(1, lacking())
    reality = recorded(drive(2, (*lacking(), term("mass", "loaded", scale=1.2))), 2)
    assert fitted_value(case_of(reality, simulation), "mass", "loaded") == pytest.approx(1.2, abs=0.01)


@pytest.mark.parametrize(
    ("simulated", "real", "asked", "value", "tolerance"),
    [
        ((), {"length": 0.5}, ("tire_relaxation", "", "length"), 0.5, 0.01),
        ({"length": 0.3}, {"length": 0.5}, ("tire_relaxation", "changed", "length"), 0.2, 0.02),
        ((), {"strength": 1.0}, ("combined_slip", "", "strength"), 1.0, 0.1),
        ((), {"scale": 0.8}, ("friction_scale", "", "scale"), 0.8, 0.02),
    ],
)
def test_late_shared_or_weaker_grip_acts_on_all_of_a_force(simulated, real, asked, value, tolerance):
    """Two fifths of the lateral force are the shared discrepancy's, which is as late as the tyres, and as weak.

    With that part as it is in the simulation the values are 0.67 m, 0.28 m, 1.5 and 0.68.
    """
    here, there = ((*lacking(), *(term(asked[0], **values) for values in (one,) if one)) for one in (simulated, real))
    case = case_of(recorded(drive(2, there), 2), drive(1, here))
    assert fitted_value(case, *asked) == pytest.approx(value, abs=tolerance)


def test_a_grip_is_found_beside_much_that_the_nominal_lacks(monkeypatch):
    """Stiffer tyres make forces that only the shared discrepancy knows."""
    simulation = drive(1, lacking())
    reality = recorded(drive(2, (*lacking(), term("friction_scale", "curve", scale=GRIP))), 2)
    case, term_and_variant = case_of(reality, simulation), ("friction_scale", "curve")
    assert fitted_value(case, *term_and_variant) == pytest.approx(GRIP, abs=0.02)
    monkeypatch.setattr(discrepancy_module, "at_other_tires", lambda rates, *others: rates)
    assert abs(fitted_value(case, *term_and_variant) - GRIP) > 0.03
