"""The plant's own car against the bare one: its pieces are all that differs; what is small is not asked for."""

from dataclasses import fields, replace

import numpy as np
import pytest

from split_cli.plant.cars import CARS
from split_cli.proof.cars import bare
from split_cli.proof.cases import Answer, ConcealedEffect
from split_cli.proof.outcome import Named, Statement
from split_cli.proof.scoring import score_case, score_of_cases
from split_cli.proof.whole_car import PIECES, without_piece

UNNAMED = {"side_area"}  # acts in wind only, and there is none


@pytest.mark.parametrize("name", sorted(CARS))
def test_without_all_pieces_a_car_is_bare(name):
    car, plain = CARS[name], bare(CARS[name])
    for piece in {(one.fields, one.tire_fields): one for one in PIECES}.values():  # an axle's has two names
        car = without_piece(car, piece)
    left = {one.name for one in fields(car) if getattr(car, one.name) != getattr(plain, one.name)}
    assert left <= UNNAMED


def test_a_piece_alone_changes_nothing_else():
    car = CARS["road_car"]
    (downforce,) = (piece for piece in PIECES if piece.term == "aero_downforce")
    other = without_piece(car, downforce)
    back = {name: getattr(car, name) for name in downforce.fields}
    assert other != car and replace(other, **back) == car


def test_what_is_small_may_be_named_and_is_not_asked_for():
    sizes = {"load_transfer": 4.0, "combined_slip": 0.1, "drive_lag": 0.9, "friction_scale": 0.0}
    effects = tuple(ConcealedEffect(term, 1.0, size, {}, (), "", 1.0) for term, size in sizes.items())
    answer = Answer(1, "whole-car", "", effects, "road_car", "own", "nominal", 0.0, 3.0, 1.0)

    def scored(*terms: str) -> tuple[str, dict[str, float]]:
        said = Statement("mismatch", tuple(Named(term) for term in terms))
        score = score_case("1", answer, said, None, np.ones(3), None)
        told = score_of_cases([score]).targets
        return score.outcome, {what.split(":")[1][:9]: rate.share for what, _, rate, _ in told if "whole" in what}

    assert scored("load_transfer", "drive_lag", "combined_slip") == ("exact", {" physics ": 1.0, " names of": 0.0})
    assert scored("load_transfer", "friction_scale") == ("wrong", {" physics ": 0.5, " names of": 0.0})
    assert scored("load_transfer", "drive_lag", "mass") == ("wrong", {" physics ": 1.0, " names of": 1.0 / 3.0})
