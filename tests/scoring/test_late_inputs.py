"""Late inputs are told from labels: by their size, and not where the inputs are right."""

import re
from dataclasses import replace

import numpy as np
import pytest

from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.scoring.late_inputs import late_inputs
from split_cli.vehicle.parameters import EffectSpec
from tests.factories import MissingForce, make_drive, road_car


@pytest.fixture(scope="module")
def drive():
    return make_drive(11, segments=40, terms=[MissingForce({"front_lateral": 200.0})])


def told(drive):
    return late_inputs(drive, compute_labels(drive, road_car(), Z2), road_car())


def test_right_inputs_are_not_doubted(drive):
    assert told(drive) == ()


@pytest.mark.parametrize(("channel", "state", "term"), [("T", "v_x", "drive_lag"), ("delta", "r", "steer_lag")])
def test_a_late_input_is_told_with_its_delay_and_the_command_that_settles_it(drive, channel, state, term):
    """The recording has the command two samples before the car obeys it."""
    early = drive.columns[channel].copy()
    for run in drive.segments():
        early[run] = np.append(early[run][2:], np.repeat(early[run][-1], 2))
    said = told(replace(drive, columns={**drive.columns, channel: early}))
    (line,) = [text for text in said if f"labels of {state} follow" in text]
    delay = float(re.search(r"arrive ([0-9.]+) s late", line)[1])
    # Inputs are lines between knots 0.2 s apart, so that the rate of before and after a kink mix: a quarter.
    assert delay == pytest.approx(2 * drive.period, rel=0.25)
    assert line.startswith("made.parquet: ") and "split diagnose --real" in line and line.endswith(term)
    # A set that models this lag leaves nothing to settle.
    late = replace(drive, columns={**drive.columns, channel: early})
    labels = compute_labels(late, road_car(), Z2)
    assert line not in late_inputs(late, labels, road_car(), (EffectSpec(term, {"tau": delay}),))
