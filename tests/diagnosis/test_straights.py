"""Straights tell steering off centre: planted offsets are recovered, and no symmetric physics looks like one."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.recording.straights import angle_of_straights
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.off_centre import confirmed_by_straights, with_offset_of_straights
from split_cli.diagnosis.search.selection import Selection, nothing
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import INFLATION, bare_objective, candidates_of, driven, light_evidence, noisy, prepared
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
    told = angle_of_straights([series], road_car())
    assert told.error < 1e-3 and told.angle == pytest.approx(-OFFSET, abs=3.0 * told.error + 0.1 * OFFSET)


def test_a_mirrored_drive_has_the_mirrored_angle(series):
    mirrored = replace(series, smooth=series.smooth * [1.0, -1.0, -1.0], steer_angle=-series.steer_angle)
    one, other = (angle_of_straights([each], road_car()) for each in (series, mirrored))
    assert (other.angle, other.error) == pytest.approx((-one.angle, one.error), rel=1e-6)


def test_a_held_angle_tells_of_no_straight(series):
    held = replace(series, steer_angle=np.full(len(series), 0.1))
    assert angle_of_straights([held], road_car()) is None


def test_straights_confirm_the_offset_that_they_have_and_no_other(series):
    objective = bare_objective(light_evidence(series))
    (one,) = candidates_of(objective, "steer_offset")

    def confirmed(offset: float) -> set[str]:
        return confirmed_by_straights(objective, SimpleNamespace(parts=(Part(one, {"offset": offset}),)))

    assert confirmed(1.1 * OFFSET) == {"steer_offset"}
    assert not confirmed(-OFFSET) and not confirmed(3.0 * OFFSET)


def test_an_offset_that_a_search_passed_over_is_added_where_straights_show_it(series):
    """A lean of the road had taken its place; a search that ends without either gets it, too."""
    objective = bare_objective(light_evidence(series))
    candidates = candidates_of(objective, "steer_offset", "road_bank")
    for parts in ((), (Part(candidates[1], {"angle": 0.02}),)):
        chosen = fit_parts(objective, parts)
        passed_over = Selection(
            nothing(objective),
            chosen,
            (nothing(objective),) * len(parts),
            ((),) * len(parts),
            ((),) * len(parts),
            (True,) * len(parts),
        )
        found = with_offset_of_straights(objective, passed_over, candidates, INFLATION)
        assert found.terms[-1].id == "steer_offset" and len(found.without) == len(found.named) == len(parts) + 1
        assert found.chosen.parts[-1].values["offset"] == pytest.approx(OFFSET, rel=0.3)
        assert with_offset_of_straights(objective, found, candidates, INFLATION) is found


def test_no_offset_is_added_to_a_car_that_goes_straight():
    """Its terms are symmetric, so that straights show chance alone."""
    softer = CATALOGUE["tire_stiffness"]({"front_scale": 0.7, "rear_scale": 1.0})
    objective = bare_objective(light_evidence(prepared(noisy(driven(45, [softer], seconds=16.0), 545))))
    candidates = candidates_of(objective, "steer_offset")
    empty = nothing(objective)
    assert (
        with_offset_of_straights(objective, Selection(empty, empty, (), (), (), ()), candidates, INFLATION).named == ()
    )


LEAN = 0.1
"""Bank of a road [rad], left side higher: the gravity of a tenth of g."""


def test_an_angle_that_a_leaning_road_takes_confirms_no_offset():
    """By an accelerometer the road is felt; without one, a crossfall is all that is allowed for."""
    softer = CATALOGUE["tire_stiffness"]({"front_scale": 0.6, "rear_scale": 1.0})
    leaning = CATALOGUE["road_bank"]({"angle": LEAN})
    drive = driven(43, [softer, leaning], runs=8, seconds=8.0, spaced=9.0)
    level = drive["vx"] * drive["r"]
    along = np.gradient(drive["vy"], drive.period)
    felt = {**drive.columns, "ay": level + along + 9.80665 * np.sin(LEAN)}
    series = prepared(noisy(replace(drive, columns=felt), 543))
    told = angle_of_straights([series], road_car())
    assert told.lean == pytest.approx(9.80665 * np.sin(LEAN), rel=0.1)
    # What straights seem to tell is what the road takes; transients leave the gradient too small.
    assert 0.5 * abs(told.angle) < told.by_road < 1.1 * abs(told.angle)
    objective = bare_objective(light_evidence(series))
    (one,) = candidates_of(objective, "steer_offset")
    chosen = SimpleNamespace(parts=(Part(one, {"offset": -told.angle}),))
    assert not confirmed_by_straights(objective, chosen)
    assert angle_of_straights([prepared(noisy(drive, 543))], road_car()).lean == pytest.approx(0.245, abs=0.001)
