"""Compiled loops along a recording, against NumPy's functions and the plain form of the single track."""

from itertools import product

import numpy as np
import pytest

from split_cli.vehicle.compiled_operations import COMPILED
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.operations import NUMPY
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import road_car

LAST_DIGITS = 4.0 * np.finfo(float).eps
SIZES = np.concatenate([[0.0, 1e-300, np.sqrt(2.0) - 1.0, 1.0, np.sqrt(2.0) + 1.0], np.geomspace(1e-12, 1e12, 4001)])
EVERYWHERE = np.concatenate([SIZES, -SIZES])


@pytest.mark.parametrize("c", [0.0, 0.7, 1.3, 1.65, 2.0])
def test_a_curve_is_the_sine_of_a_multiple_of_an_angle(c):
    got, known = (ops.sine_of_multiple_of_atan(c, EVERYWHERE) for ops in (COMPILED, NUMPY))
    assert np.abs(got - known).max() < LAST_DIGITS
    np.testing.assert_allclose(got[np.abs(known) > 1e-3], known[np.abs(known) > 1e-3], rtol=1e-12)
    np.testing.assert_array_equal(np.signbit(got), np.signbit(known))


def test_angles_sines_and_cosines_are_numpys_to_the_last_digits():
    x = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 10_001)
    np.testing.assert_allclose(COMPILED.sin(x), np.sin(x), rtol=LAST_DIGITS)
    np.testing.assert_allclose(COMPILED.cos(x), np.cos(x), rtol=0.0, atol=LAST_DIGITS)
    ahead = np.geomspace(1e-6, 100.0, EVERYWHERE.size)
    np.testing.assert_allclose(COMPILED.atan2(EVERYWHERE, ahead), np.arctan2(EVERYWHERE, ahead), rtol=LAST_DIGITS)


def test_what_the_loops_do_not_hold_for_is_numpys():
    turns, backwards = np.linspace(-9.0, 9.0, 101), np.linspace(-2.0, 2.0, 101)
    assert np.array_equal(COMPILED.sin(turns), np.sin(turns)) and np.array_equal(COMPILED.cos(turns), np.cos(turns))
    assert np.array_equal(COMPILED.atan2(turns, backwards), np.arctan2(turns, backwards))
    assert np.array_equal(COMPILED.sine_of_multiple_of_atan(2.5, turns), np.sin(2.5 * np.arctan(turns)))
    for ops, name in product((COMPILED,), ("sin", "cos")):
        assert getattr(ops, name)(0.3) == getattr(np, name)(0.3)
    some = np.array([0.2, np.nan, np.inf])
    for got, known in (
        (COMPILED.sin(some[:2]), np.sin(some[:2])),
        (COMPILED.atan2(some, np.ones(3)), np.arctan2(some, np.ones(3))),
        (COMPILED.sine_of_multiple_of_atan(1.4, some), np.sin(1.4 * np.arctan(some))),
    ):
        np.testing.assert_allclose(got, known, rtol=LAST_DIGITS)


@pytest.mark.parametrize("term", [None, *sorted(CATALOGUE)])
def test_a_car_moves_as_by_numpy(term):
    """Every term, its parameters away from none; along a drive that turns and brakes."""
    random, size = np.random.default_rng(5), 400
    kind = CATALOGUE.get(term)
    terms = () if kind is None else (kind({**{n: 1.0 for n in kind.units}, **_acting(kind)}),)
    vx = np.abs(random.normal(12.0, 5.0, size)) + 0.5
    vy, r, delta = random.normal(0.0, [[0.5], [0.3], [0.05]], (3, size))
    T = random.normal(0.0, 800.0, size)
    model = SingleTrack(road_car(), terms)
    by_numpy, compiled = (
        np.array(model.velocity_derivative(vx, vy, r, T, delta, t=0.01 * np.arange(size), ops=ops))
        for ops in (NUMPY, COMPILED)
    )
    np.testing.assert_allclose(compiled, by_numpy, rtol=1e-12, atol=1e-11)


def _acting(kind) -> dict[str, float]:
    return {name: 1.1 * value + 0.02 for name, value in kind.neutral.items() if value is not None}


def test_weighted_changes_are_those_of_each_flow():
    """Sums of forces where nothing else changes, and balances where the body does."""
    random, size = np.random.default_rng(6), 300
    vx = np.abs(random.normal(12.0, 5.0, size)) + 0.5
    vy, r, delta = random.normal(0.0, [[0.5], [0.3], [0.05]], (3, size))
    T = random.normal(0.0, 800.0, size)
    car = road_car()
    planted = [CATALOGUE["mass"]({"scale": 1.1}), CATALOGUE["friction_scale"]({"scale": 0.9})]

    def sums(ops) -> np.ndarray:
        bare = SingleTrack(car, ()).flow(vx, vy, r, T, delta, ops=ops)
        flows = [SingleTrack(car, (term,)).flow(vx, vy, r, T, delta, ops=ops, bare=bare) for term in planted]
        return np.array(SingleTrack.weighted_changes(bare, [(0.7, flows[0]), (-1.3, flows[1])]))

    nominal = np.array(SingleTrack(car, ()).velocity_derivative(vx, vy, r, T, delta))
    each = [np.array(SingleTrack(car, (term,)).velocity_derivative(vx, vy, r, T, delta)) - nominal for term in planted]
    for ops in (NUMPY, COMPILED):
        np.testing.assert_allclose(sums(ops), 0.7 * each[0] - 1.3 * each[1], rtol=1e-9, atol=1e-9)
