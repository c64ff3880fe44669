"""The order of the exported step: a correction meets the tyres' forces that build up within a step."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.export.stepped_model import SteppedModel
from split_cli.export.symbolic import build_nominal
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import make_training_set, road_car

HELD = np.array([0.2, 0.4, 0.6])  # a correction that never changes [m/s^2], [m/s^2], [rad/s^2]


def driven(effects, h, seconds=0.8):
    """Return the velocities after steps of h through a turn, in Python, which C and CasADi are compared with."""
    trained = replace(make_training_set(seed=8, points=40), vehicle=road_car(effects=effects), horizon=h)
    graph = build_nominal(SingleTrack(trained.vehicle), trained.features, h)
    held = SimpleNamespace(predict=lambda z: SimpleNamespace(mean=np.tile(HELD, (len(z), 1))))
    model = SteppedModel(graph, trained, held)
    model.substeps = max(4, int(np.ceil(h / 0.002)))
    x = np.array([[0.0, 0.0, 0.0, 15.0, 0.05, 0.06, 200.0, 0.01]])
    settled = model.model.flow(*x[:, 3:8].T)
    x = np.column_stack([x, *(settled.values[name] + np.zeros(1) for name in model.memory.names)])
    for _ in range(round(seconds / h)):
        x = model.one_step(x, np.array([[100.0, 0.05]]), np.zeros((1, 2)))[1]
    return x[0, 3:6]


@pytest.mark.parametrize("effects", [(), (EffectSpec("tire_relaxation", {"length": 0.6}),)])
def test_a_held_correction_is_stepped_at_second_order(effects):
    """With the forces held still the order was 1 beside relaxation, and the error at 50 ms 80 times as large."""
    exact = driven(effects, 0.8 / 512)
    errors = [np.abs(driven(effects, h) - exact).max() for h in (0.05, 0.025, 0.0125)]
    assert errors[0] < 3e-4 and (np.log2(np.divide(errors[:-1], errors[1:])) > 1.7).all()
