"""Minima of the cost over a delay: as many as a steering that swings at one frequency has, and one otherwise."""

from collections.abc import Callable

import numpy as np
import pytest

from split_cli.diagnosis.recording.witnesses import build_witnesses
from split_cli.diagnosis.search.delay_minima import other_minima
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.verdict.estimates import parameter_estimates
from tests.diagnosis.recordings import (
    bare_objective,
    candidates_of,
    driven,
    late,
    light_evidence,
    noisy,
    noisy_objective,
    prepared,
)

SWING = 0.25
"""Period of the steering [s]."""
LATE = 0.1
"""How late the steering answers [s]."""


def swinging(commands: np.ndarray, step: float) -> np.ndarray:
    """Command a steering that swings at one frequency instead, and return what becomes of it."""
    t = step * np.arange(commands.shape[1])
    commands[:] = 0.02 * np.sin(2.0 * np.pi * t / SWING)
    return np.broadcast_to(0.02 * np.sin(2.0 * np.pi * (t - LATE) / SWING), commands.shape)


def fitted(steer: Callable[[np.ndarray, float], np.ndarray], delay: float = LATE):
    objective = noisy_objective(driven(61, runs=4, steer=steer), 7)
    (one,) = candidates_of(objective, "steer_delay")
    return objective, fit_parts(objective, [Part(one, {"delay": delay})])


def test_a_swing_of_one_frequency_tells_a_delay_up_to_its_period():
    objective, fit = fitted(swinging, LATE + SWING)
    assert fit.parts[0].values["delay"] == pytest.approx(LATE + SWING, abs=0.01)
    found = other_minima(objective, fit, 0, "delay")
    assert found[0] == pytest.approx(LATE, abs=0.013)  # points are 13 ms apart
    (told,) = parameter_estimates(objective, fit)
    low, high = told["delay"].interval_95
    assert low <= LATE and high >= LATE + SWING


def one_swings(commands: np.ndarray, step: float) -> np.ndarray:
    swinging(commands[:1], step)
    return commands


def test_a_minimum_that_witnesses_refute_is_left_out():
    """The equations of motion hold where the car swings; yaw tells when the yaw rate was, all along."""
    drive = noisy(driven(61, runs=4, steer=one_swings), 7)
    drive.columns["r"] = late(drive["r"].reshape(4, -1), LATE, 0.01).ravel()
    series, found = prepared(drive), []
    for witnesses in ([], [one for one in build_witnesses(series) if one.kind == "yaw"]):
        objective = bare_objective(light_evidence(series), kinematics=witnesses)
        rows = 3 * len(objective.evidence[0].at)
        # One block, which drowns what yaw says.
        objective.weight[:rows] = np.where(objective.block[:rows] == 1, 30.0, 0.0)
        one = next(one for one in candidates_of(objective, "channel_delay") if one.variant == "r")
        found.append(other_minima(objective, fit_parts(objective, [Part(one, {"r": LATE})]), 0, "r"))
    assert found[0][0] == pytest.approx(LATE + SWING, abs=0.013)
    assert found[1] == []


def test_steering_of_many_frequencies_has_one_minimum():
    objective, fit = fitted(lambda commands, step: late(commands, LATE, step))
    assert other_minima(objective, fit, 0, "delay") == []
    (told,) = parameter_estimates(objective, fit)
    assert told["delay"].value == pytest.approx(LATE, abs=0.005)
    # Only delays have several minima.
    (one,) = candidates_of(objective, "yaw_inertia")
    assert other_minima(objective, fit_parts(objective, [Part(one, {"scale": 1.1})]), 0, "scale") == []
