"""The running trust in C and CasADi: the same as Python's; it finds a planted share, with memory or without."""

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from split_cli.export.c99 import c_source
from split_cli.export.casadi_function import committee_function, model_step
from split_cli.export.casadi_step import casadi_substeps
from split_cli.export.casadi_trust import TRUST_SIZE, trust_functions
from split_cli.export.compiler import STRICT_FLAGS
from split_cli.export.provenance import provenance_of
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.validity import valid_function
from split_cli.learning.running_trust import RunningTrust
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.export.effect_cases import STEP, Exported, manoeuvre
from tests.factories import make_training_set, road_car

CASES = {
    "plain": (),
    "memory": (EffectSpec("drive_lag", {"tau": 0.05}), EffectSpec("steer_delay", {"delay": 0.08})),
    "play": (EffectSpec("steer_backlash", {"width": 0.01}),),
}


@pytest.fixture(scope="module", params=CASES)
def exported(request, compiler, tmp_path_factory) -> Exported:
    folder = tmp_path_factory.mktemp("trust")
    training_set = replace(make_training_set(seed=8, points=40), vehicle=road_car(effects=CASES[request.param]))
    model = SingleTrack(training_set.vehicle)
    graph = build_nominal(model, training_set.features, STEP)
    provenance = provenance_of(training_set, "bcm")
    source = c_source(build_tables(training_set), graph, provenance, "car", valid_function(training_set))
    (folder / "car.h").write_text(source.header)
    (folder / "car.c").write_text(source.source)
    compiler.build([folder / "car.c"], folder / "car.so", [*STRICT_FLAGS, "-O0", "-shared", "-fPIC"])
    return Exported(model, graph, training_set, "car", ctypes.CDLL(str(folder / "car.so")))


def stepped(car: Exported, x: np.ndarray, u: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Return the state after an interval with this share of each correction."""
    after, trust = np.empty(car.size), np.concatenate([share, np.zeros(60)])
    car.call("step_trusted", x, u, STEP, casadi_substeps(car.graph), trust, after)
    return after


def test_c_and_casadi_have_the_trust_of_python_and_find_a_planted_share(exported):
    predict = committee_function(build_tables(exported.training_set), "car")
    trusted, observe = trust_functions(predict, exported.graph, "car", plain=False)
    in_casadi = np.concatenate([np.ones(3), np.zeros(TRUST_SIZE - 3)])
    planted = np.array([0.2, 0.3, 0.8])  # all of the correction makes v_x worse than none of it
    x, commands, t, s = manoeuvre(steps=120)
    substeps = casadi_substeps(exported.graph)  # as CasADi's observer takes, so that both differ by rounding alone
    x, trust, python = exported.start(x, t[0], s[0]), in_casadi.copy(), RunningTrust(np.ones(3), STEP)
    for k in range(120):
        u = np.ascontiguousarray((commands[k + 1] - commands[k]) / STEP)
        after = stepped(exported, x, u, planted)
        exported.call("observe", x, u, STEP, substeps, after, trust)
        nominal = stepped(exported, x, u, np.zeros(3))[3:6]
        response = np.stack([stepped(exported, x, u, one)[3:6] - nominal for one in np.eye(3)], axis=1)
        transition = np.empty((3, 3))
        for j in range(3):
            moved = 1e-4 * np.eye(exported.size)[3 + j]
            ends = [stepped(exported, x + side * moved, u, np.zeros(3))[3:6] for side in (1.0, -1.0)]
            transition[:, j] = (ends[0] - ends[1]) / 2e-4
        share = python.observe(transition, after[3:6] - nominal, response)
        np.testing.assert_allclose(trust[:3], share, atol=1e-6)
        in_casadi = np.asarray(observe(x, u, STEP, after, in_casadi)).ravel()
        np.testing.assert_allclose(in_casadi[:3], share, atol=1e-6)
        x = after
    np.testing.assert_allclose(trust[:3], planted, atol=0.02)
    np.testing.assert_allclose(stepped(exported, x, u, np.ones(3)), _plain(exported, x, u), rtol=1e-14)
    step, whole = model_step(predict, exported.graph, "car_step"), np.ones(3)
    np.testing.assert_allclose(np.asarray(trusted(x, u, STEP, whole)), np.asarray(step(x, u, STEP)), rtol=1e-14)
    # Linear in the share: at the whole share it is the plain one, and at half each the mean of none and all.
    none, half, whole = (_linearised(exported, x, u, k * np.ones(3)) for k in (0.0, 0.5, 1.0))
    np.testing.assert_allclose(half, 0.5 * (none + whole), rtol=1e-12, atol=1e-14)
    np.testing.assert_array_equal(whole, _linearised(exported, x, u, None))
    only_first = _linearised(exported, x, u, np.eye(3)[0])
    others = [_linearised(exported, x, u, one) - none for one in np.eye(3)[1:]]
    np.testing.assert_allclose(only_first + sum(others), whole, rtol=1e-12, atol=1e-12)
    assert np.abs(whole - none).max() > 1e-3


def test_what_is_not_finite_begins_the_errors_anew(exported):
    x, commands, t, s = manoeuvre()
    x, u, trust = exported.start(x, t[0], s[0]), np.zeros(2), np.arange(63.0) / 100.0
    share, products = trust[:3].copy(), trust[15:].copy()
    exported.call("observe", x, u, STEP, casadi_substeps(exported.graph), np.full(exported.size, np.nan), trust)
    np.testing.assert_array_equal(trust[:3], share)
    np.testing.assert_array_equal(trust[15:], products)
    assert not trust[3:15].any()
    predict = committee_function(build_tables(exported.training_set), "car")
    _, observe = trust_functions(predict, exported.graph, "car", plain=False)
    given = np.arange(63.0) / 100.0
    np.testing.assert_array_equal(np.asarray(observe(x, u, STEP, np.full(exported.size, np.nan), given)).ravel(), trust)


@pytest.mark.parametrize("wild", [1e4, -1e30, 1e100, 1e300])
def test_a_measurement_that_no_car_makes_is_a_gap(exported, wild):
    """One finite speed of 1e200 m/s made the trust not-a-number for good, and one of 1e12 held for minutes."""
    predict = committee_function(build_tables(exported.training_set), "car")
    _, observe = trust_functions(predict, exported.graph, "car", plain=False)
    x, _, t, s = manoeuvre()
    x, u, given = exported.start(x, t[0], s[0]), np.zeros(2), np.arange(63.0) / 100.0
    expected = np.concatenate([given[:3], np.zeros(12), given[15:]])
    for state in (3, 4, 5):
        measured = x.copy()
        measured[state] = wild
        trust = given.copy()
        exported.call("observe", x, u, STEP, casadi_substeps(exported.graph), measured, trust)
        np.testing.assert_array_equal(trust, expected)
        np.testing.assert_array_equal(np.asarray(observe(x, u, STEP, measured, given)).ravel(), expected)
    python = RunningTrust(np.ones(3), STEP)
    python.numbers = given
    python.observe(np.eye(3), np.array([0.0, wild, 0.0]), np.zeros((3, 3)))
    np.testing.assert_array_equal(python.numbers, expected)


@pytest.mark.parametrize("h", [0.0, -0.05, -0.5, 1e-300, 2.0, 1e300])
def test_an_interval_that_no_step_takes_is_a_gap(exported, h):
    x, _, t, s = manoeuvre()
    x, u, given = exported.start(x, t[0], s[0]), np.zeros(2), np.arange(63.0) / 100.0
    trust = given.copy()
    exported.call("observe", x, u, h, casadi_substeps(exported.graph), x, trust)
    assert np.isfinite(trust).all() and ((trust[:3] >= 0.0) & (trust[:3] <= 1.0)).all()
    if h != 1e-300 or exported.memory is not None and exported.memory.line:
        np.testing.assert_array_equal(trust, np.concatenate([given[:3], np.zeros(12), given[15:]]))


def _plain(car: Exported, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    after = np.empty(car.size)
    car.call("step_rk4", x, u, STEP, casadi_substeps(car.graph), after)
    return after


def _linearised(car: Exported, x: np.ndarray, u: np.ndarray, share: np.ndarray | None) -> np.ndarray:
    """Return [A, B] with a share of each correction, None for what `linearise` gives."""
    A, B = np.empty((car.size, car.size)), np.empty((car.size, 2))
    if share is None:
        car.call("linearise", x, u, STEP, A, B)
    else:
        car.call("linearise_trusted", x, u, STEP, np.concatenate([share, np.zeros(60)]), A, B)
    return np.column_stack([A, B])
