"""What is kept of an explanation is what is worked out anew: results by key, velocities, flows and motion."""

import pickle

import numpy as np
import pytest

from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.innovations.evidence import motion
from split_cli.diagnosis.recording.series import extended_model
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.effects.recording import over_samples
from tests.diagnosis.recordings import driven, noisy_objective


def test_what_was_asked_for_longest_ago_is_forgotten_first():
    made, recent = [], RecentResults(2)

    def square(x: int) -> int:
        made.append(x)
        return x * x

    assert [recent(x, lambda x=x: square(x)) for x in (1, 2, 1, 3, 1, 2)] == [1, 4, 1, 9, 1, 4]
    assert made == [1, 2, 3, 2] and len(recent) == 2  # the 3 made the 2 be forgotten, not the 1
    there = pickle.loads(pickle.dumps(recent))
    assert there.most == 2 and not len(there)


@pytest.fixture(scope="module")
def objective():
    return noisy_objective(driven(41, []), 3)


def test_defects_beside_sensors_are_those_of_a_model_evaluated_alone(objective):
    """The slow reference takes nothing from an evaluation before; sums in another order differ by rounding."""
    one = objective.evidence[0]
    series, model_terms = one.series, [CATALOGUE["tire_stiffness"]({"front_scale": 0.9, "rear_scale": 1.1})]
    for k in range(6):
        sensors = [
            CATALOGUE["yaw_rate_bias"]({"r": 0.002 * (k % 3)}),
            CATALOGUE["velocity_bias"]({"angle": 0.004, "drift": 1e-4 * (k % 2)}),
            CATALOGUE["acceleration_bias"]({"ax": 0.1 * k, "ay": 0.0}),
        ]
        steering = [CATALOGUE["steer_gain"]({"gain": 1.0 + 0.01 * k})]
        terms = [*model_terms, *steering, *sensors]
        measured, smooth = series.measured, series.predicted
        for term in sensors:
            measured, smooth = (_without(term, series, velocity) for velocity in (measured, smooth))
        model = extended_model(one.vehicle, terms)
        rates = model.velocity_derivative(
            *over_samples(smooth, series.recording).T,
            series.torque,
            series.steer_angle,
            yaw=series.yaw,
            t=series.t,
            s=series.s,
            recording=series.recording,
        )
        inside = series.inside()[:, None]
        expected = motion(series, one.linear, measured, smooth) - inside * series.period * np.stack(rates, 1)[:-1]
        np.testing.assert_allclose(one.defects(terms), expected, rtol=0.0, atol=1e-13)


def _without(term, series, velocity: np.ndarray) -> np.ndarray:
    columns = dict(zip(("vx", "vy", "r"), velocity.T, strict=True)) | {"t": series.t}
    good = term.correct(columns, Recording(series.period, series.recording.segments))
    return np.stack([good[name] for name in ("vx", "vy", "r")], axis=1)


def test_an_accelerometer_leaves_velocities_and_their_flow_alone(objective):
    series = objective.evidence[0].series
    assert series.corrected([CATALOGUE["acceleration_bias"]({"ax": 0.1, "ay": 0.2})])[0] is series.measured
    turned = [CATALOGUE["yaw_rate_bias"]({"r": 0.01})]
    bias = CATALOGUE["acceleration_bias"]({"ax": 0.1, "ay": 0.2})
    assert series.corrected([*turned, bias])[1] is series.corrected(turned)[1]


def test_the_direction_of_a_velocity_is_that_of_the_recording_at_hand():
    term = CATALOGUE["velocity_bias"]({"angle": 0.1, "drift": 0.01})
    for t in (np.arange(5.0), np.arange(7.0), np.arange(5.0)):
        columns = {"vx": np.ones(len(t)), "vy": np.zeros(len(t)), "t": t}
        turned = term.corrupt(columns, Recording.single(1.0, len(t)))
        np.testing.assert_array_equal(turned["vy"], np.sin(term.angle(t)))
