"""The step of the exported C at any finite argument: fuzzed, at standstill, backwards, and beyond any car."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.export.c_check import build_driver
from split_cli.export.symbolic import build_nominal, guarded_speed
from split_cli.vehicle.single_track import SingleTrack
from tests.export.effect_cases import CASES
from tests.export.export_support import source_of
from tests.factories import make_training_set, road_car


def fuzz(count: int, width: int, real: str, seed: int = 1) -> np.ndarray:
    """Return arguments of every size: zeros, largest numbers, and a car's with some of them spoiled."""
    rng = np.random.default_rng(seed)
    limits = np.finfo(np.float32 if real == "float" else np.float64)
    sizes = rng.uniform(np.log10(float(limits.tiny)), np.log10(float(limits.max)) - 1e-9, (count, width))
    wild = rng.choice([-1.0, 1.0], (count, width)) * 10.0**sizes
    wild[rng.random((count, width)) < 0.1] = 0.0
    wild[rng.random((count, width)) < 0.05] = float(limits.max)
    wild[rng.random((count, width)) < 0.05] = -float(limits.max)
    usual = np.array([3.0, -4.0, 0.5, 8.0, 0.2, 0.1, 300.0, 0.05, 50.0, 0.2, 0.05, 1.0, 2.0])[:width]
    mixed = np.where(rng.random((count, width)) < 0.25, wild, usual * rng.uniform(-2.0, 2.0, (count, width)))
    slow = np.tile(usual, (count, 1))
    slow[:, 3] = rng.choice([0.0, 1e-300, 1e-9, 0.01, -0.01, 0.3, -5.0], count)
    if real == "float":
        slow[:, 3][np.abs(slow[:, 3]) < 1e-30] = 0.0
    return np.concatenate([wild, mixed, slow])


@pytest.mark.parametrize("real", ["double", "float"])
def test_the_step_is_finite_for_every_finite_argument(small_set, compiler, tmp_path, real):
    driver = build_driver(source_of(small_set, real), tmp_path, compiler, ("-O1",))
    asked = fuzz(3000, 13, real)
    for what, width in ((1, 8), (2, 8)):
        answers = driver.answers(what, asked, width)
        assert np.isfinite(answers).all(), asked[~np.isfinite(answers).all(axis=1)][:3]


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("case", ["grip_fade", "load_transfer late"])
def test_steps_and_starts_with_found_effects_are_finite(case, real, compiler, tmp_path):
    """A fade at a time before the first sample grew beyond all numbers, and a load was that of any speed."""
    trained = replace(make_training_set(seed=8, points=40), vehicle=road_car(effects=CASES[case]))
    source = source_of(trained, real)
    size = source.memory.whole if source.memory else 8
    asked = fuzz(1000, 13, real, seed=7)
    asked = np.column_stack([asked[:, :8], asked[:, : size - 8], asked[:, 8:13]])
    driver = build_driver(source, tmp_path, compiler, ("-O0",))
    for what in (1, 2, *((6,) if source.memory else ())):
        answers = driver.answers(what, asked, size)
        sound = np.isfinite(answers[:, 8 if what == 6 else 0 :]).all(axis=1)
        assert sound.all(), asked[~sound][:3]


def test_at_standstill_the_step_is_small_and_smooth(small_set, compiler, tmp_path):
    """Without the guard 0.01 m/s gave not-a-number; velocities must change as a car's, and evenly with speed."""
    driver = build_driver(source_of(small_set), tmp_path, compiler, ("-O1",))
    speed = np.linspace(-1.0, 8.0, 901)
    asked = np.tile([0.0, 0.0, 0.1, 0.0, 0.0, 0.0, 100.0, 0.05, 0.0, 0.0, 0.02, 0.0, 0.0], (len(speed), 1))
    asked[:, 3] = speed
    after = driver.answers(1, asked, 8)
    change = (after - asked[:, :8])[:, 3:6]
    assert (np.abs(change) < 0.02 * np.array([20.0, 20.0, 40.0])).all()
    # A centimetre per second of speed moves the answer by little: no jump, no pole.
    assert (np.abs(np.diff(change, axis=0)) < 0.01).all()


def test_the_guard_leaves_speeds_of_training_alone_and_is_smooth():
    import casadi

    v = casadi.SX.sym("v")
    guard = guarded_speed(v, 2.0)
    slope = casadi.gradient(guard, v)
    both = casadi.Function("g", [v], [guard, slope])
    speeds = np.linspace(-3.0, 5.0, 8001)
    value, first = (np.asarray(part).ravel() for part in both.map(len(speeds))(speeds[None]))
    assert np.array_equal(value[speeds >= 2.0], speeds[speeds >= 2.0])
    assert np.allclose(value[speeds <= 0.0], 1.0, atol=1e-15) and (np.diff(value) >= -1e-15).all()
    # Once a speed's derivative is bounded by 3/2 of a step over `low`, slope and curvature have no jumps.
    assert np.abs(np.diff(first)).max() < 1.6 / 2.0 * 1e-3 * 1.01


def test_the_python_model_is_untouched_above_the_guard(small_set):
    model = SingleTrack(small_set.vehicle)
    graph = build_nominal(model, small_set.features)
    assert graph.low_speed == 0.5 * small_set.vehicle.minimum_speed
    acting = np.array([0.0, graph.low_speed * 1.0001, 0.1, 0.05, 200.0, 0.03])
    found = np.asarray(graph.rates(acting, [0.0, 0.0])[0]).ravel()
    expected = model.velocity_derivative(*acting[1:])
    np.testing.assert_allclose(found, np.ravel(expected), rtol=1e-12)
