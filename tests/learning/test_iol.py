"""The dictionary of the online rival against the printed way, and its sets as files."""

from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SetError
from split_cli.learning.cells import empty_set, extend
from split_cli.learning.iol import Dictionary, empty_dictionary, extend_dictionary
from split_cli.learning.kernel import Kernel, correlation
from split_cli.learning.training_set import read_set, write_set
from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.verifying.verify import verify
from tests.factories import make_drive, make_labels, make_training_set, road_car, smooth_residual, valid_features
from tests.printed_learner import PrintedLearner


@pytest.mark.parametrize(("capacity", "forgetting"), [(25, None), (25, 30.0), (1, None), (150, None), (60, 8.0)])
def test_keeps_the_points_of_the_printed_way_over_one_cell(capacity, forgetting):
    """With the whole space as one cell the printed update is the rival's: one dictionary, all points judged."""
    rng = np.random.default_rng(capacity)
    z = np.cumsum(rng.normal(0.0, 0.3, (250, 3)), axis=0) % 4.0
    scales, threshold = np.array([0.8, 1.0, 1.3]), 1e-2
    kernel = Kernel(scales, np.ones(3), np.full(3, 0.01))
    printed = PrintedLearner(scales, capacity, threshold, forgetting)
    dictionary = Dictionary(kernel, capacity, threshold, forgetting)
    for sample, features in enumerate(z):
        now = 0.05 * sample
        printed.offer(sample, 0, features, now)
        dictionary.offer(features, np.full(3, float(sample)), now)
    kept = printed.cells[0]
    order, expected = np.argsort(dictionary.y[:, 0]), np.argsort(kept.samples)
    assert dictionary.y[order, 0].tolist() == np.array(kept.samples)[expected].tolist()
    np.testing.assert_allclose(dictionary.gains[order], np.array(kept.gamma)[expected], atol=1e-7)
    if capacity == 25:
        assert printed.updates > 2 * capacity


def test_rounding_does_not_pile_up_over_many_exchanges():
    rng = np.random.default_rng(3)
    kernel = Kernel(np.full(2, 1.0), np.ones(3), np.full(3, 0.01))
    dictionary = Dictionary(kernel, 40, 1e-3, forgetting=20.0)
    for k in range(1500):
        dictionary.offer(rng.normal(0.0, 2.0, 2), np.zeros(3), float(k))
    dense = np.linalg.inv(correlation(dictionary.z, dictionary.z, kernel.length_scales) + 1e-10 * np.eye(40))
    np.testing.assert_allclose(dictionary.gains, 1.0 / np.diag(dense), rtol=1e-6)


def rival(capacity: int = 80):
    start = make_training_set(0, 50)
    fresh = empty_set(start.vehicle, start.features, start.region, start.grid, start.kernel, horizon=start.horizon)
    return empty_dictionary(fresh, capacity)


def drives(count: int = 3):
    car = road_car()
    region = make_training_set(0, 50).region
    for number in range(count):
        z = valid_features(car, region, 250, seed=number)
        yield make_labels(z, smooth_residual(z), car, name=f"d{number}")


def test_appending_equals_one_run_bit_for_bit_and_a_file_reads_back(tmp_path):
    once = extend_dictionary(rival(), drives())
    first, *rest = drives()
    middle = extend_dictionary(rival(), [first])
    write_set(middle, tmp_path / "middle.split")
    twice = extend_dictionary(read_set(tmp_path / "middle.split"), rest)
    write_set(once, tmp_path / "one.split")
    write_set(twice, tmp_path / "two.split")
    assert (tmp_path / "one.split").read_bytes() == (tmp_path / "two.split").read_bytes()
    assert once.size == 80 and once.sources[-1].replacements > 5
    assert verify(tmp_path / "one.split").passed
    counted = sum(source.insertions for source in once.sources)
    assert counted == once.size


def test_one_learner_does_not_go_on_with_the_other_ones_set():
    with pytest.raises(SetError, match="iol"):
        extend(rival(), drives())
    with pytest.raises(SetError, match="split"):
        extend_dictionary(replace(rival(), learner="split"), drives())


def test_the_command_trains_appends_and_refuses(tmp_path):
    car = road_car()
    write_vehicle(car, tmp_path / "car.yaml")
    for number in range(2):
        write_drive(make_drive(number, segments=20, seconds=3.0, vehicle=car), tmp_path / f"d{number}.parquet")

    def run(*arguments):
        return CliRunner().invoke(group, [str(part) for part in arguments])

    set_path, car_path = tmp_path / "rival.split", tmp_path / "car.yaml"
    made = ("--learner", "iol", "--capacity", 50, "--hyperparameters", "default")
    assert run("train", tmp_path / "d0.parquet", "--vehicle", car_path, *made, "-o", set_path).exit_code == 0
    assert run("train", tmp_path / "d1.parquet", "--vehicle", car_path, "--append", "-o", set_path).exit_code == 0
    trained = read_set(set_path)
    assert trained.learner == "iol" and trained.size == 50 and len(trained.sources) == 2
    told = run(
        "train", tmp_path / "d1.parquet", "--vehicle", car_path, "--append", "--learner", "split", "-o", set_path
    )
    assert told.exit_code != 0


def test_a_large_dictionary_is_read_again_and_cells_as_large_are_refused(tmp_path):
    """What training allows, reading allows: a cell keeps 200 points at most, the one dictionary 20,000."""
    for capacity, made in ((200, replace(rival(), learner="split", capacity=200)), (2000, rival(2000))):
        write_set(made, tmp_path / "a.split")
        assert read_set(tmp_path / "a.split").capacity == capacity
    write_set(replace(rival(), learner="split", capacity=201), tmp_path / "b.split")
    with pytest.raises(SetError, match="capacity is 201"):
        read_set(tmp_path / "b.split")
