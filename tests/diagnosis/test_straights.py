"""Straights tell steering off centre: planted offsets are recovered, and no symmetric physics looks like one."""

from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.recording.straights import angle_of_straights
from split_cli.diagnosis.search.fitting import Part
from split_cli.diagnosis.verdict.findings import _confirmed_by_straights
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import bare_objective, candidates_of, driven, light_evidence, noisy, prepared
from tests.factories import road_car

OFFSET = 0.01


@pytest.fixture(scope="module")
def series() -> Series:
    """Softer front tyres and a heavier car are symmetric, so that they move no straight."""
    terms = [
        CATALOGUE["steer_offset"]({"offset": OFFSET}),
        CATALOGUE["tire_stiffness"]({"front_scale": 0.7, "rear_scale": 1.0}),
        CATALOGUE["mass"]({"scale": 1.2}),
    ]
    return prepared(noisy(driven(41, terms, runs=8, seconds=8.0, spaced=9.0), 541))


def test_an_offset_is_the_angle_of_straights_whatever_else_the_car_lacks(series):
    """Transients and the curvature of tyres leave a tenth of it."""
    angle, error = angle_of_straights([series], road_car())
    assert error < 1e-3 and angle == pytest.approx(-OFFSET, abs=3.0 * error + 0.1 * OFFSET)


def test_a_mirrored_drive_has_the_mirrored_angle(series):
    mirrored = SimpleNamespace(
        smooth=series.smooth * [1.0, -1.0, -1.0], t=series.t, steer_angle=-series.steer_angle
    )
    angle, error = angle_of_straights([series], road_car())
    assert angle_of_straights([mirrored], road_car()) == pytest.approx((-angle, error), rel=1e-6)


def test_a_held_angle_tells_of_no_straight(series):
    held = SimpleNamespace(smooth=series.smooth, t=series.t, steer_angle=np.full(len(series), 0.1))
    assert angle_of_straights([held], road_car()) is None


def test_straights_confirm_the_offset_that_they_have_and_no_other(series):
    objective = bare_objective(light_evidence(series))
    (one,) = candidates_of(objective, "steer_offset")

    def confirmed(offset: float) -> set[str]:
        chosen = SimpleNamespace(parts=(Part(one, {"offset": offset}),))
        return _confirmed_by_straights(objective, SimpleNamespace(chosen=chosen))

    assert confirmed(1.1 * OFFSET) == {"steer_offset"}
    assert not confirmed(-OFFSET) and not confirmed(3.0 * OFFSET)
