"""Cells and the valid region: indices by hand, borders, counts, and grids of other features."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from split_cli.errors import DriveError
from split_cli.learning.features import Z1, Z2, FeatureSet, parse_features
from split_cli.learning.region import Grid, Region, build_grid, valid_cell_count, valid_cells, z2_grid
from tests.factories import road_car, valid_features

CAR = road_car()
REGION = Region.of(CAR)
GRID = z2_grid(CAR, REGION)


def test_index_is_half_open_and_the_last_cell_closed():
    z = np.array(
        [
            [0.0, -0.02, 0.05],
            [np.nextafter(0.02, 0), np.nextafter(-0.02, -1), -0.05],
            [0.18, -0.18, 1.0],
            [0.18, -0.18, -1.6],
        ]
    )
    index, valid = GRID.index(z)
    assert valid.all()
    assert index.tolist() == [[0, -1, 0], [0, -2, -1], [8, -9, 9], [8, -9, -16]]
    outside = np.array([[0.1800001, 0, 0], [0, -0.1800001, 0], [0, 0, 1.0001], [0, 0, -1.61], [np.nan, 0, 0]])
    assert not GRID.index(outside)[1].any()


@given(st.lists(st.integers(-(2**19), 2**19 - 1), min_size=3, max_size=3))
def test_cell_numbers_are_one_to_one(index):
    packed = GRID.pack(np.array([index], dtype=np.int64))
    assert GRID.unpack(packed).tolist() == [index]


def test_cell_numbers_order_like_indices():
    index = np.array([[-2, 5, 3], [-1, -7, 9], [-1, -7, 10], [0, 0, 0]])
    assert (np.diff(GRID.pack(index)) > 0).all()


@given(st.integers(0, 10_000))
def test_a_point_lies_within_half_an_edge_of_its_centre(seed):
    z = valid_features(CAR, REGION, 20, seed)
    index, valid = GRID.index(z)
    assert valid.all()
    offset = np.abs(z - GRID.centers(GRID.pack(index))) / np.array(GRID.edges)
    assert offset.max() <= 0.5 + 1e-9


def test_valid_cells_against_a_count_by_hand():
    """Every centre tested one by one with the formulas as printed."""
    count = 0
    for i in range(-9, 9):
        for j in range(-9, 9):
            for k in range(-16, 10):
                alpha_f, alpha_r, torque = 0.02 * (i + 0.5), 0.02 * (j + 0.5), 250.0 * (k + 0.5)
                share = CAR.drive_split_front if torque >= 0 else CAR.brake_split_front
                force_f = share * torque / CAR.wheel_radius - CAR.rolling_resistance_front
                force_r = (1 - share) * torque / CAR.wheel_radius - CAR.rolling_resistance_rear
                good = abs(alpha_f - alpha_r) <= 0.10 and max(abs(alpha_f), abs(alpha_r)) <= 0.18
                for tire, alpha, force in ((CAR.front_tire, alpha_f, force_f), (CAR.rear_tire, alpha_r, force_r)):
                    lateral = tire.D * np.sin(tire.C * np.arctan(tire.B * alpha))
                    good &= (0.9 * force) ** 2 + lateral**2 <= (0.95 * tire.D) ** 2
                count += bool(good)
    assert valid_cell_count(CAR, REGION, GRID) == count
    # The contract expects 1,000 to 1,400 for a road car; this one brakes with 1.6 times its driving torque.
    assert 900 < count < 1500


def test_valid_cells_are_ascending_and_need_the_z2_grid():
    cells = valid_cells(CAR, REGION, GRID)
    assert (np.diff(cells) > 0).all()
    with pytest.raises(ValueError, match="z2"):
        valid_cells(CAR, REGION, Grid((1.0,), (-np.inf,), (np.inf,)))


def test_minimum_speed_scales_with_the_root_of_the_wheelbase():
    assert Region.of(road_car(cg_to_front_axle=1.35, cg_to_rear_axle=1.35)).minimum_speed == pytest.approx(5.0)
    small = Region.of(road_car(cg_to_front_axle=0.16, cg_to_rear_axle=0.17))
    assert small.minimum_speed == pytest.approx(5.0 * np.sqrt(0.33 / 2.7))


def test_a_feature_outside_z2_gets_the_edge_of_the_contract():
    rng = np.random.default_rng(0)
    z = rng.uniform(0.0, 1.0, (20_000, 5)) * [18.0, 3.6, 1.8, 1.0, 0.36]
    grid = build_grid(Z1, CAR, REGION, z)
    spread = np.quantile(z, 0.999, axis=0) - np.quantile(z, 0.001, axis=0)
    np.testing.assert_allclose(np.delete(grid.edges, 3), np.delete(spread / 18.0, 3))
    assert grid.edges[3] == 0.1  # torque_ratio is a feature of z2 and keeps its edge and bounds
    assert (grid.lower[3], grid.upper[3]) == (-1.6, 1.0)
    assert np.isinf(np.delete(grid.lower, 3)).all()
    assert build_grid(Z2, CAR, REGION) == GRID


def test_a_constant_feature_is_refused_by_name():
    with pytest.raises(DriveError, match="the feature vx does not vary, it is 12"):
        build_grid(Z1, CAR, REGION, np.full((100, 5), 12.0))


def test_feature_lists():
    assert parse_features("Z2") == Z2
    assert parse_features("alpha_f, speed").names == ("alpha_f", "speed")
    assert not FeatureSet(("alpha_f", "alpha_r")).is_z2
    for wrong in ("", "a,a"):
        with pytest.raises(DriveError, match="twice|no name"):
            parse_features(wrong)
