"""The shared discrepancy's dictionary against altered vehicles, evaluated in two ways and mirrored."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy, tangents
from split_cli.diagnosis.recording.series import extended_model
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import EffectSpec, Vehicle
from tests.factories import road_car


def tire(vehicle: Vehicle, axle: str, **factors: float) -> dict:
    """Return the change of a vehicle whose tire's numbers are multiplied."""
    own = getattr(vehicle, f"{axle}_tire")
    return {f"{axle}_tire": replace(own, **{name: factor * getattr(own, name) for name, factor in factors.items()})}


def unit_of(car: Vehicle, term: str, parameter: str) -> float:
    return CATALOGUE[term].sizes(car).get(parameter, 1.0)


def altered(name: str, step: float) -> Vehicle:
    """Return the vehicle that a tangent's step makes, written without the terms."""
    car = road_car()
    size = step * unit_of(car, *name.split("."))
    match name:
        case "friction_scale.scale":
            # scale D sin(C atan(B alpha/scale))
            softer = {"B": 1.0 / (1.0 + step), "D": 1.0 + step}
            return replace(car, **tire(car, "front", **softer), **tire(car, "rear", **softer))
        case "tire_stiffness.front_scale":
            return replace(car, **tire(car, "front", B=1.0 + step))
        case "tire_stiffness.rear_scale":
            return replace(car, **tire(car, "rear", B=1.0 + step))
        case "aero_drag.drag":
            return replace(car, drag_coefficient=car.drag_coefficient + size)
        case "yaw_inertia.scale":
            return replace(car, yaw_inertia=(1.0 + step) * car.yaw_inertia)
        case "mass.scale":
            return replace(car, mass=(1.0 + step) * car.mass)
    raise AssertionError(name)


@pytest.mark.parametrize(
    "name",
    [
        "friction_scale.scale",
        "tire_stiffness.front_scale",
        "tire_stiffness.rear_scale",
        "aero_drag.drag",
        "yaw_inertia.scale",
        "mass.scale",
    ],
)
def test_a_tangent_is_what_altering_the_vehicle_does(name, discrepancy, nominal_series):
    term, parameter = name.split(".")
    (k,) = (k for k, entry in enumerate(tangents()) if (entry[0].id, *entry[1:3]) == (term, "", parameter))
    columns = discrepancy.columns(nominal_series)[:, :, k]
    plain = nominal_series.rates(extended_model(road_car()))
    expected = nominal_series.rates(extended_model(altered(name, tangents()[k][3]))) - plain
    # Two ways to write one number; the atan is taken in another order of rounding.
    np.testing.assert_allclose(columns, expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())
    assert np.abs(expected).max() > 0.01


def test_a_tangent_of_an_input_is_what_altering_the_input_does(discrepancy, nominal_series):
    names = [(entry[0].id, entry[2]) for entry in tangents()]
    columns = discrepancy.columns(nominal_series)
    model = extended_model(road_car())
    plain = nominal_series.rates(model)
    steered = replace(nominal_series, steer_angle=1.05 * nominal_series.steer_angle)
    np.testing.assert_allclose(
        columns[:, :, names.index(("steer_gain", "gain"))], steered.rates(model) - plain, rtol=1e-9, atol=1e-9
    )
    torque = nominal_series.torque
    braked = replace(nominal_series, torque=np.where(torque < 0.0, 1.1 * torque, torque))
    np.testing.assert_allclose(
        columns[:, :, names.index(("drive_gain", "brake_gain"))], braked.rates(model) - plain, rtol=1e-9, atol=1e-9
    )


def test_tangents_are_secants_that_tend_to_the_derivative(discrepancy, nominal_series):
    """Over its step, a smooth term's tangent differs from the central difference by its curvature alone."""
    columns, plain = discrepancy.columns(nominal_series), nominal_series.rates(extended_model(road_car()))
    for k, (kind, variant, parameter, step) in enumerate(tangents()):
        neutral = {key: kind.neutral[key] for key in kind.units}
        size = step * unit_of(road_car(), kind.id, parameter)

        def rates(value, kind=kind, neutral=neutral, parameter=parameter, variant=variant):
            term = kind({**neutral, parameter: value}, variant)
            return nominal_series.rates(extended_model(road_car(), (term,)))

        # Lags and lengths end at 0: there, forward; and where it is steep at first, only the far end is reported.
        if neutral[parameter] == 0.0 and kind.id in ("drive_lag", "steer_lag", "tire_relaxation"):
            np.testing.assert_allclose(columns[:, :, k], rates(size) - plain, rtol=1e-9, atol=1e-12)
            continue
        half = 1e-4 * size
        slope = (rates(neutral[parameter] + half) - rates(neutral[parameter] - half)) / (2e-4)
        away = np.linalg.norm(columns[:, :, k] - slope) / np.linalg.norm(slope)
        # The largest steps are a half of what the parameter may be.
        assert away < 0.35, (kind.id, away)


def test_rates_of_weights_are_the_columns_times_them(discrepancy, nominal_series):
    columns = discrepancy.columns(nominal_series)
    weights = np.random.default_rng(3).standard_normal(columns.shape[2])
    np.testing.assert_allclose(discrepancy.rates(nominal_series, weights), columns @ weights, rtol=1e-9, atol=1e-9)


def test_rates_of_weights_are_the_columns_times_them_beside_shared_terms(discrepancy, nominal_series):
    lags = CATALOGUE["steer_lag"]({"tau": 0.05}), CATALOGUE["tire_relaxation"]({"length": 0.4})
    late = replace(discrepancy, shared_terms=lags)
    columns = late.columns(nominal_series)
    assert columns.shape[2] == len(late.unlike_shared_terms())
    weights = np.random.default_rng(3).standard_normal(columns.shape[2])
    np.testing.assert_allclose(late.rates(nominal_series, weights), columns @ weights, rtol=1e-9, atol=1e-9)


def test_tangents_are_taken_beside_shared_terms_which_are_added_to_any_model(discrepancy, nominal_series):
    lag, heavy = CATALOGUE["steer_lag"]({"tau": 0.05}), CATALOGUE["yaw_inertia"]({"scale": 1.1})
    late = replace(discrepancy, shared_terms=(lag,))
    rates = {
        terms: nominal_series.rates(extended_model(road_car(), terms)) for terms in ((), (lag,), (heavy,), (heavy, lag))
    }
    k = [(entry[0].id, entry[2]) for entry in tangents()].index(("yaw_inertia", "scale"))
    column = late.columns(nominal_series)[:, :, k]
    np.testing.assert_allclose(column, rates[heavy, lag] - rates[(lag,)], rtol=1e-9, atol=1e-9)
    added = late.rates_with_shared_terms(nominal_series, np.zeros(len(late.unlike_shared_terms())), (heavy,))
    np.testing.assert_allclose(added, rates[heavy, lag] - rates[(heavy,)], rtol=1e-9, atol=1e-9)


def test_slips_of_before_change_no_lateral_force_of_the_functions(discrepancy, nominal_series):
    """With the rate of steering, slow parts of slips would hold how the yaw rate has just changed."""
    weights = np.random.default_rng(5).standard_normal(len(discrepancy.unlike_shared_terms()))
    weights[: len(tangents())] = 0.0
    before, row = nominal_series.predicted.copy(), 150
    before[:row, 1:] *= 1.2
    moved = discrepancy.rates(replace(nominal_series, predicted=before), weights)
    rates = discrepancy.rates(nominal_series, weights)
    assert not np.allclose(moved[:row, 1:], rates[:row, 1:])
    np.testing.assert_allclose(moved[row:, 1:], rates[row:, 1:], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("term", "parameters"),
    [
        ("drive_gain", {"drive_gain": 0.8, "brake_gain": 0.8}),
        ("steer_gain", {"gain": 0.9}),
        ("steer_lag", {"tau": 0.05}),
    ],
)
def test_actuators_of_the_vehicle_file_act_once(term, parameters, nominal_series):
    discrepancy = build_shared_discrepancy(road_car().with_effects(EffectSpec(term, parameters)), nominal_series)
    columns = discrepancy.columns(nominal_series)
    weights = np.random.default_rng(3).standard_normal(columns.shape[2])
    np.testing.assert_allclose(discrepancy.rates(nominal_series, weights), columns @ weights, rtol=1e-9, atol=1e-9)


def test_shared_discrepancy_answers_to_what_arrives_of_the_inputs(discrepancy, nominal_series):
    """Behind a gain on the wheel angle, the shared discrepancy is that of the angle that arrived."""
    weights = np.random.default_rng(4).standard_normal(discrepancy.columns(nominal_series).shape[2])
    gain = CATALOGUE["steer_gain"]({"gain": 0.8})
    steered = replace(nominal_series, steer_angle=0.8 * nominal_series.steer_angle)
    np.testing.assert_allclose(
        discrepancy.rates(nominal_series, weights, (gain,)), discrepancy.rates(steered, weights), rtol=1e-9, atol=1e-9
    )
    turned = CATALOGUE["sensor_lever_arm"]({"dx": 0.3})
    vx, vy, r = nominal_series.predicted.T
    moved = replace(nominal_series, predicted=np.stack([vx, vy - 0.3 * r, r], axis=1))
    np.testing.assert_allclose(
        discrepancy.rates(nominal_series, weights, (turned,)), discrepancy.rates(moved, weights), rtol=1e-9, atol=1e-9
    )


def test_what_is_common_is_the_same_in_the_mirror(discrepancy, nominal_series):
    """Left and right exchanged: v_x' as before, v_y' and r' of the other sign, entry by entry."""
    flip = np.array([1.0, -1.0, -1.0])
    mirrored = replace(
        nominal_series,
        measured=nominal_series.measured * flip,
        predicted=nominal_series.predicted * flip,
        steer_angle=-nominal_series.steer_angle,
        yaw=-nominal_series.yaw,
    )
    here, there = discrepancy.columns(nominal_series), discrepancy.columns(mirrored)
    np.testing.assert_allclose(there, here * flip[:, None], rtol=1e-9, atol=1e-9)
    assert np.all(np.abs(here).max(axis=(0, 1)) > 0.0)


def test_nothing_is_extrapolated(discrepancy, nominal_series):
    """Twice as fast and sideways as the simulation has ever been: smooth functions stay within their bounds."""
    wild = replace(nominal_series, predicted=nominal_series.predicted * np.array([2.0, 10.0, 10.0]))
    first = len(tangents())
    inside = np.abs(discrepancy.columns(nominal_series)[:, :, first:]).max()
    # Each scaled feature levels off at 2, and four of them are multiplied at most.
    assert np.abs(discrepancy.columns(wild)[:, :, first:]).max() < 2.0**4 * max(inside, 1.0)


def test_the_scales_are_those_of_the_simulation(nominal_series):
    one = build_shared_discrepancy(road_car(), nominal_series)
    slower = replace(nominal_series, torque=0.5 * nominal_series.torque)
    other = build_shared_discrepancy(road_car(), slower)
    assert other.width[2] == pytest.approx(0.5 * one.width[2])
    assert other.width[3] == one.width[3]
    assert one.center[0] == one.center[1] == 0.0
