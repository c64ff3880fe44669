"""The exported running trust: the same as Python's, and it finds a planted share, with and without memory."""

from __future__ import annotations

import ctypes
from dataclasses import replace

import numpy as np
import pytest

from split_cli.export.c99 import c_source
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

CASES = {"plain": (), "lag": (EffectSpec("drive_lag", {"tau": 0.05}),)}
SUBSTEPS = 4


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
    car.call("step_trusted", x, u, STEP, SUBSTEPS, trust, after)
    return after


def test_it_is_pythons_and_finds_a_planted_share(exported):
    planted = np.array([0.6, 0.3, 0.8])
    x, commands, t, s = manoeuvre(steps=120)
    x, trust, python = exported.start(x, t[0], s[0]), np.zeros(63), RunningTrust(np.ones(3), STEP)
    for k in range(120):
        u = np.ascontiguousarray((commands[k + 1] - commands[k]) / STEP)
        after = stepped(exported, x, u, planted)
        exported.call("observe", x, u, STEP, SUBSTEPS, after, trust)
        nominal = stepped(exported, x, u, np.zeros(3))[3:6]
        response = np.stack([stepped(exported, x, u, one)[3:6] - nominal for one in np.eye(3)], axis=1)
        transition = np.empty((3, 3))
        for j in range(3):
            moved = 1e-4 * np.eye(exported.size)[3 + j]
            ends = [stepped(exported, x + side * moved, u, np.zeros(3))[3:6] for side in (1.0, -1.0)]
            transition[:, j] = (ends[0] - ends[1]) / 2e-4
        share = python.observe(transition, after[3:6] - nominal, response)
        np.testing.assert_allclose(trust[:3], share, atol=1e-6)
        x = after
    np.testing.assert_allclose(trust[:3], planted, atol=0.02)
    np.testing.assert_allclose(stepped(exported, x, u, np.ones(3)), _plain(exported, x, u), rtol=1e-14)


def test_what_is_not_finite_begins_the_errors_anew(exported):
    x, commands, t, s = manoeuvre()
    x, u, trust = exported.start(x, t[0], s[0]), np.zeros(2), np.arange(63.0) / 100.0
    share, products = trust[:3].copy(), trust[15:].copy()
    exported.call("observe", x, u, STEP, SUBSTEPS, np.full(exported.size, np.nan), trust)
    np.testing.assert_array_equal(trust[:3], share)
    np.testing.assert_array_equal(trust[15:], products)
    assert not trust[3:15].any()


def _plain(car: Exported, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    after = np.empty(car.size)
    car.call("step_rk4", x, u, STEP, SUBSTEPS, after)
    return after
