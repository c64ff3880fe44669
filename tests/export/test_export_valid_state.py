"""Which states are valid: the features' region and the speed that training took, alike in C, CasADi and Python."""

import ctypes
from dataclasses import replace

import casadi
import numpy as np
import pytest

from split_cli.export.c_check import build_driver
from split_cli.export.symbolic import build_nominal
from split_cli.export.validity import is_valid_state, valid_function, valid_state_function
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.export.effect_cases import STEP, build_library, silent_set
from tests.export.export_support import source_of, take_cells
from tests.factories import road_car

LATE = (EffectSpec("steer_delay", {"delay": 0.08}), EffectSpec("drive_lag", {"tau": 0.1}))


def states_of(trained, count=400):
    """Return states (N, 8) and inputs (N, 2) from a standstill to fast, straight on and in bends."""
    rng, slowest = np.random.default_rng(4), trained.region.minimum_speed
    speed = np.concatenate([[0.0, -1.0, 0.5 * slowest, slowest], rng.uniform(0.0, 4.0 * slowest, count)])
    x = np.zeros((len(speed), 8))
    x[:, 3] = speed
    x[4:, 4] = 0.02 * speed[4:] * rng.uniform(-1.0, 1.0, count)
    x[4:, 7] = rng.uniform(-0.2, 0.2, count)
    x[4:, 6] = rng.uniform(-1.0, 1.0, count) * trained.vehicle.max_torque
    return x, np.zeros((len(x), 2))


@pytest.mark.parametrize("real", ["double", "float"])
def test_a_standstill_is_valid_by_its_features_and_not_as_a_state(small_set, compiler, tmp_path, real):
    trained = take_cells(small_set, 8)
    x, u = states_of(trained)
    asked = np.column_stack([x, u, np.full((len(x), 3), 0.05)])
    driver = build_driver(source_of(trained, real), tmp_path, compiler, ("-O0",))
    z = driver.answers(4, asked, 3)
    # Straight on with no torque the features are those of any speed.
    assert driver.answers(11, z[:1], 1)[0, 0] == 1.0
    found = driver.answers(13, asked, 1)[:, 0] == 1.0
    assert not found[:4].any() and 0.1 < found.mean() < 0.9
    expected = is_valid_state(trained, z.astype(float), x[:, 3].astype(driver.dtype).astype(float))
    assert (found == expected).mean() > 0.99  # a border to the last bit may fall on either side
    assert found[x[:, 3] > trained.region.minimum_speed].any() and not found[x[:, 3] <= 4.9].any()
    spoiled = np.repeat(asked[found][:1], 4, axis=0)
    spoiled[np.arange(4), [3, 4, 6, 7]] = np.nan
    assert not driver.answers(13, spoiled, 1).any()


def test_c_and_casadi_agree_where_commands_come_late(compiler, tmp_path):
    """The delayed command makes the slip angle, the one of now the torque ratio."""
    exported = build_library(compiler, tmp_path, {"late": LATE})["late"]
    trained = replace(silent_set(), vehicle=road_car(effects=LATE))
    graph = build_nominal(SingleTrack(trained.vehicle), trained.features, STEP)
    function = valid_state_function(trained, graph, valid_function(trained))
    x, u = states_of(trained, 200)
    rng = np.random.default_rng(6)
    whole = np.array([exported.start(one, 0.0, 0.0) for one in x])
    whole[:, -2:] += rng.uniform(-0.1, 0.1, (len(x), 2))
    in_c = [
        exported.library[f"{exported.name}_valid_state"](
            one.ctypes.data_as(ctypes.c_void_p), v.ctypes.data_as(ctypes.c_void_p)
        )
        for one, v in zip(whole, u, strict=True)
    ]
    symbolic = [int(function(one, v)) for one, v in zip(whole, u, strict=True)]
    assert in_c == symbolic and not any(in_c[:4]) and 0.1 < np.mean(in_c) < 0.9
    assert isinstance(function, casadi.Function) and function.size1_in(0) == whole.shape[1]
