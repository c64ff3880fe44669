"""Settings chosen on held-out blocks: errors are those of sets trained by hand, the rule is the one stated."""

import json

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import write_drive
from split_cli.prediction import make_predictor
from split_cli.scoring.selection import SelectionSettings, SetCandidate, choose, relative_error
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.training.select import _fold, _parts, learn, select
from tests.factories import MissingForce, make_drive, road_car


def candidate(points: float) -> SetCandidate:
    return SetCandidate("z2", 10, 1e-3, 1.0, 0.0, 0.0, 0.0, np.zeros(3), points, 1.0, 1.0)


def test_the_cheapest_within_one_standard_error_is_chosen_and_the_front_has_no_dominated_candidate():
    """Blocks differ by far more than candidates do: only differences on the same blocks tell them apart."""
    block = np.array([0.1, 0.4, 0.2, 0.3])
    wobble = np.array([0.01, -0.01, 0.01, -0.01])  # standard error of the sum of four: 0.01 sqrt(4/3) 2 = 0.0231
    found = [
        (candidate(1000), block),  # the best
        (candidate(100), block + 0.0025 + wobble),  # behind by 0.01: within chance
        (candidate(50), block + 0.02 + wobble),  # behind by 0.08: not
        (candidate(200), block + 0.05),  # more points and more error than the one of 100
    ]
    judged = choose(found)
    assert [one.points for one in judged] == [50, 100, 200, 1000]
    assert [one.chosen for one in judged] == [False, True, False, False]
    assert [one.on_front for one in judged] == [True, True, False, True]
    assert judged[1].behind == pytest.approx(0.01) and judged[1].behind_error == pytest.approx(0.0231, abs=1e-4)
    assert judged[3].error == pytest.approx(1.0)


def test_every_state_counts_alike_whatever_its_unit():
    rng = np.random.default_rng(0)
    nominal, errors, block = rng.normal(size=(90, 3)), rng.normal(size=(90, 3)), np.arange(90) // 30
    parts, rmse = relative_error(errors, nominal, block)
    direct = np.mean(np.square(errors).sum(axis=0) / np.square(nominal).sum(axis=0))
    assert parts.sum() == pytest.approx(direct) and parts.shape == (3,)
    np.testing.assert_allclose(rmse, np.sqrt(np.square(errors).mean(axis=0)))
    unit = np.array([1.0, 100.0, 0.01])
    np.testing.assert_allclose(relative_error(errors * unit, nominal * unit, block)[0], parts)


@pytest.fixture(scope="module")
def drive():
    return make_drive(0, segments=20, terms=[MissingForce({"front_lateral": 600.0})])


def test_a_candidate_has_the_error_of_sets_trained_by_hand(drive):
    car, settings = road_car(), SelectionSettings(capacities=(4,), thresholds=(0.01,), cell_edges=(2.0,))
    (one,) = select([drive], car, settings).candidates
    parts = _parts([drive], car, "z2", settings)
    squares, count, sizes = np.zeros(3), 0, []
    for fold in range(3):
        labels, grid, kernel = _fold(parts, fold, car, 2.0)
        assert grid.edges == pytest.approx((0.04, 0.04, 0.2))
        learned = learn(labels, vehicle=car, grid=grid, kernel=kernel, capacity=4, threshold=0.01)
        held_out = parts[0].labels.within(parts[0].block % 10 % 3 == fold)
        assert not set(held_out.row) & set(learned.row)
        held_out = held_out.take(np.isfinite(held_out.y).all(axis=1))
        mean = make_predictor("projected", learned).predict(held_out.z).mean
        squares, count = squares + np.square(held_out.y - mean).sum(axis=0), count + len(held_out)
        sizes.append(learned.size)
    np.testing.assert_allclose(one.rmse, np.sqrt(squares / count), rtol=1e-9)
    assert one.points == pytest.approx(np.mean(sizes))


def test_the_command_tells_the_front_and_train_takes_what_was_chosen(drive, tmp_path):
    write_drive(drive, tmp_path / "drive.parquet")
    write_vehicle(road_car(), tmp_path / "car.yaml")
    base = ["evaluate", str(tmp_path / "drive.parquet"), "--vehicle", str(tmp_path / "car.yaml"), "--select"]
    few = ["--capacities", "4,8", "--thresholds", "0.01", "--cell-edges", "2"]
    done = CliRunner().invoke(group, [*base, *few, "--json", "-o", str(tmp_path / "figures")])
    assert done.exit_code == 0, done.output
    told = json.loads(done.stdout)
    chosen = [one for one in told["candidates"] if one["chosen"]]
    assert len(chosen) == 1 and chosen[0]["error"] < 1.0  # better than the nominal model, which lacks a force
    assert (tmp_path / "figures" / "selection.png").stat().st_size > 10_000
    text = CliRunner().invoke(group, [*base, *few])
    assert "CHOSEN" in text.stdout and "--cell-edge 2" in text.stdout
    arguments = ["--capacity", str(chosen[0]["capacity"]), "--threshold", "0.01", "--cell-edge", "2"]
    out = ["-o", str(tmp_path / "a.split"), "--trust", "full", "--hyperparameters", "default"]
    trained = CliRunner().invoke(group, ["train", *base[1:4], *arguments, *out])
    assert trained.exit_code == 0, trained.output
    assert read_set(tmp_path / "a.split").grid.edges == pytest.approx((0.04, 0.04, 0.2))
    refused = CliRunner().invoke(group, [*base[:2], "--select"])
    assert refused.exit_code == 2 and "--vehicle" in refused.output
