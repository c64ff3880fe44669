"""The shared discrepancy at another body: forces that stay, and an inertia that is found beside them."""

from dataclasses import replace

import numpy as np
import pytest

import split_cli.diagnosis.baseline.discrepancy as discrepancy_module
from split_cli.diagnosis.baseline.body import at_another_body, moved_axles
from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy, tangents
from split_cli.diagnosis.baseline.tires import AxleBalance
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import EffectSpec
from tests.diagnosis.recordings import case_of, driven, fitted_value, prepared
from tests.diagnosis.test_self_test import drive, recorded
from tests.factories import road_car

FORCES = np.random.default_rng(5).standard_normal((40, 3)) * 1000.0
SCALE, TURN, AHEAD = 1.2, 1.3, 0.08
BODIES = ("yaw_inertia", "mass")


def term(name: str, variant: str = "", **values: float) -> Term:
    return CATALOGUE[name](values, variant)


def rates_of(vehicle, forces: np.ndarray) -> np.ndarray:
    """Return the rates of longitudinal, front and rear lateral forces, (N, 3), by the vehicle's own matrix."""
    return forces @ vehicle.force_matrix().T


def test_forces_stay_and_the_body_changes():
    car = road_car()
    other = replace(car, mass=SCALE * car.mass, yaw_inertia=TURN * car.yaw_inertia)
    terms = (term("mass", scale=SCALE), term("yaw_inertia", scale=TURN))
    found = at_another_body(rates_of(car, FORCES), car, terms)
    np.testing.assert_allclose(found, rates_of(other, FORCES), rtol=1e-12, atol=1e-12)
    # Effects of the vehicle's own file are there already.
    filed = car.with_effects(EffectSpec("yaw_inertia", {"scale": TURN}))
    twice = at_another_body(rates_of(car, FORCES), filed, (term("yaw_inertia", scale=SCALE),))
    np.testing.assert_allclose(twice[:, 2], rates_of(car, FORCES)[:, 2] / SCALE, rtol=1e-12, atol=1e-12)


def test_variants_move_the_body_alike():
    rates = rates_of(road_car(), FORCES)
    plain, *others = (
        at_another_body(rates, road_car(), (term("mass", variant, scale=SCALE),))
        for variant in CATALOGUE["mass"].variants
    )
    for other in others:
        np.testing.assert_array_equal(other, plain)


@pytest.mark.parametrize("variant", CATALOGUE["cg_shift"].variants)
def test_forces_are_those_of_the_slips_where_the_axles_really_are(variant):
    """One motion, told at two points AHEAD apart: tyres slip alike, so their forces differ by their loads alone."""
    car, series = road_car(), prepared(driven(3, runs=1))
    discrepancy = build_shared_discrepancy(car, series)
    weights = np.random.default_rng(3).standard_normal(discrepancy.columns(series).shape[2])
    weights[: len(tangents())] = 0.0  # tangents hold the drag, too, which feels the velocity
    ahead = series.predicted + AHEAD * series.predicted[:, 2:] * [0.0, 1.0, 0.0]
    shift = term("cg_shift", variant, dx=AHEAD)
    there = moved_axles(car, [shift])
    moving = replace(series, predicted=ahead)
    found = discrepancy.rates(moving, weights, (shift,))
    similar = discrepancy.similarity(moving, (shift,))
    assert set(similar.peak) == ({1, 2} if variant else set())
    own, _ = discrepancy.rates_of_own_car(series, weights, (), similar.slip)
    forces, moved = (
        AxleBalance(vehicle, series.steer_angle).of_rates(rates) for rates, vehicle in ((own, car), (found, there))
    )
    for axle, peak in similar.peak.items():
        forces[:, axle] *= peak
    np.testing.assert_allclose(moved, forces, rtol=1e-6, atol=1e-6 * np.abs(forces).max())
    stays = discrepancy.at_another_car(discrepancy.rates(moving, weights), series, (shift,))
    assert np.abs(stays - found).max() > 0.01 * np.abs(found).max()


def test_what_alters_no_body_leaves_the_rates_alone():
    rates = rates_of(road_car(), FORCES)
    terms = (term("steer_gain", gain=0.9), term("friction_scale", scale=0.8), term("sensor_delay", delay=0.01))
    assert at_another_body(rates, road_car(), terms) is rates


def test_an_inertia_is_found_beside_much_that_the_nominal_lacks(monkeypatch):
    """Tyres that are a third of the nominal's off make moments that only the shared discrepancy knows."""
    lacking = (term("tire_stiffness", front_scale=1.5, rear_scale=0.75),)
    simulation = drive(1, lacking)
    reality = recorded(drive(2, (*lacking, term("yaw_inertia", scale=1.2))), 2)
    case = case_of(reality, simulation)
    assert fitted_value(case, "yaw_inertia") == pytest.approx(1.2, abs=0.02)
    monkeypatch.setattr(discrepancy_module, "at_another_body", lambda rates, vehicle, terms: rates)
    assert abs(fitted_value(case, "yaw_inertia") - 1.2) > 0.02


@pytest.mark.parametrize("gyration", [0.35, 0.6, 1.0, 1.25])
def test_a_body_stays_one_that_a_car_can_have(gyration):
    """The radius of gyration squared is at most 1.3 l_f l_r, whatever a file says, which may be wrong by 15 %."""
    plain = road_car()
    arms = plain.cg_to_front_axle * plain.cg_to_rear_axle
    car = replace(plain, yaw_inertia=gyration * plain.mass * arms)
    series = prepared(driven(3, runs=1))
    ranges = {one.term: one.ranges["scale"] for one in build_candidates(car, series) if one.term in BODIES}
    inertia, mass = (ranges[name] for name in BODIES)
    assert inertia.upper == pytest.approx(max(min(1.3 / gyration, 2.5), 1.15))
    assert inertia.lower == pytest.approx(max(0.2 / gyration, 0.4))
    assert mass.lower == pytest.approx(max(0.55, min(gyration / 1.3, 1.0 / 1.15)))
    assert mass.lower < 1.0 < inertia.upper and inertia.lower < 1.0 < mass.upper
