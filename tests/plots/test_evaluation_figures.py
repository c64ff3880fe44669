"""Figures show what was computed: plotted numbers are read back and compared."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from split_cli.errors import SplitError
from split_cli.files import DIGESTS
from split_cli.learning.region import valid_cell_count
from split_cli.plots.charts.learned import growth_chart, kept_over_time, label_charts
from split_cli.plots.evaluation import draw_figures, write_figures
from split_cli.plots.feature_space import coverage_maps, draw_coverage, draw_labels, label_maps
from split_cli.plots.sizes import draw_sizes
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.run import EvaluationRun
from split_cli.workflows.evaluate import evaluate
from tests.factories import MissingForce, make_drive, make_training_set, road_car

CAR = road_car()
TERM = MissingForce({"front_grip_loss": 0.15, "front_lateral": 100.0})


@pytest.fixture(scope="module")
def run() -> EvaluationRun:
    """Two drives of different lengths, two feature sets, two predictors."""
    drives = [
        make_drive(seed, segments=segments, seconds=4.0, vehicle=CAR, terms=[TERM], name=f"d{seed}.parquet")
        for seed, segments in ((0, 12), (1, 18))
    ]
    settings = EvaluationSettings(
        predictors=("bcm", "full"), features=("z2", "z1"), sizes=(20, 40), rollout=(0.4,), trust="full"
    )
    return evaluate(drives, CAR, settings)


def line(axis, label: str):
    """Return x and y of the line with this legend."""
    found = next(entry for entry in axis.get_lines() if entry.get_label() == label)
    return tuple(np.asarray(values, dtype=float) for values in found.get_data())


def finite(values: np.ndarray) -> np.ndarray:
    return values[np.isfinite(values)]


def test_labels_and_prediction_are_shown_with_the_band_and_no_line_spans_a_gap(run):
    trace = run.traces[0]
    at = np.flatnonzero(np.diff(trace.tested.t) > 2.5 * trace.tested.window * trace.held.drive.period) + 1
    assert len(at) >= len(trace.held.split.intervals) - 1
    for state, chart in enumerate(label_charts(trace)):
        labels, predicted = chart.series
        np.testing.assert_array_equal(labels.y, trace.tested.y[:, state])
        np.testing.assert_array_equal(finite(predicted.y), trace.prediction.mean[:, state])
        half = 1.959964 * np.sqrt(trace.prediction.variance[:, state] + trace.noise_variance[state])
        np.testing.assert_allclose(finite(predicted.high - predicted.y), half)
        np.testing.assert_allclose(finite(predicted.y - predicted.low), half)
        assert np.isnan(predicted.y[at + np.arange(len(at))]).all()


def test_coverage_counts_are_the_sets(run):
    for trained in (run.sets[0], make_training_set(points=2000)):
        held, valid = coverage_maps(trained)
        assert sum(part.values.sum() for part in held) == trained.size
        assert sum(part.values.sum() for part in valid) == valid_cell_count(
            trained.vehicle, trained.region, trained.grid
        )
        # One cell by hand: all points of the set with these slip angles, in the slice's torque ratios.
        edges, first = np.array(trained.grid.edges), trained.grid.first
        for part in held:
            at = np.unravel_index(np.argmax(part.values), part.values.shape)
            low = (first[:2] + at) * edges[:2]
            inside = ((trained.z[:, :2] >= low - 1e-12) & (trained.z[:, :2] < low + edges[:2] - 1e-12)).all(axis=1)
            inside &= (trained.z[:, 2] >= part.low - 1e-9) & (trained.z[:, 2] < part.high - 1e-9)
            assert part.values[at] == inside.sum()
    figure = draw_coverage(run.sets[0])
    held, _ = coverage_maps(run.sets[0])
    for axis, part in zip(figure.axes, held, strict=False):
        shown = np.ma.filled(axis.collections[-1].get_array(), 0.0).reshape(part.values.shape[::-1]).T
        np.testing.assert_array_equal(np.nan_to_num(shown), part.values)
    assert f"{run.sets[0].size} points" in figure.get_suptitle()


def test_label_maps_are_means_of_cells_and_the_learned_mean(run):
    trained, drives = run.sets[0], run.held[0]
    labels, learned = label_maps(trained, drives, 1)
    z = np.concatenate([part.labels.z[part.labels.accepted] for part in drives])
    y = np.concatenate([part.labels.y[part.labels.accepted, 1] for part in drives])
    cell = np.floor(z / trained.grid.edges).astype(int) - trained.grid.first.astype(int)
    for part in labels:
        mine = (z[:, 2] >= part.low - 1e-9) & (z[:, 2] < part.high - 1e-9)
        for at in ((9, 9), (10, 9), (12, 11)):
            here = mine & (cell[:, 0] == at[0]) & (cell[:, 1] == at[1])
            expected = y[here].mean() if here.any() else np.nan
            assert part.values[at] == pytest.approx(expected, nan_ok=True)
    # Where both are known they agree to the label's spread inside a cell and slice: the map is of the same thing.
    both = [np.isfinite(a.values) & np.isfinite(b.values) for a, b in zip(labels, learned, strict=True)]
    pairs = [(a.values[m], b.values[m]) for a, b, m in zip(labels, learned, both, strict=True)]
    above, below = np.concatenate(pairs, axis=1)
    assert len(above) > 50
    assert np.corrcoef(above, below)[0, 1] > 0.9
    assert (
        draw_labels(trained, drives, 1).axes[0].collections[0].get_array().count()
        == np.isfinite(labels[0].values).sum()
    )


def test_growth_is_that_of_the_sources(run):
    met, count = kept_over_time(run.sets[0])
    first = run.sets[0].sources[0]
    assert count[-1] == run.sets[0].size
    assert (met < first.duration - 1e-9).sum() == (run.sets[0].source == 0).sum()
    (chart,) = growth_chart([("z2", run.sets[0])])
    np.testing.assert_array_equal(chart.series[0].x, met)


def test_sizes_are_the_reports(run):
    sizes = draw_sizes(run)
    for features in ("z2", "z1"):
        mine = [entry.score for entry in run.report.sizes if entry.score.features == features]
        for panel, which in ((0, 3), (1, 0), (2, 1), (3, 2)):
            x, y = line(sizes.axes[panel], features)
            np.testing.assert_array_equal(x, [entry.points for entry in mine])
            np.testing.assert_array_equal(y, [entry.rmse[which] for entry in mine])


def test_figures_are_written_together_wide_enough_and_not_over_a_file(run, tmp_path):
    drawn = write_figures(run, tmp_path / "figures")
    assert not drawn.left_out
    there = {path.name for path in (tmp_path / "figures").iterdir()}
    assert there == {*drawn.written, DIGESTS}
    for name in drawn.written:
        image = imread(tmp_path / "figures" / name)
        assert image.shape[1] == 1200
        assert image[..., :3].std() > 0.01  # not blank
    (tmp_path / "occupied").write_text("mine")
    with pytest.raises(SplitError, match="is a file"):
        write_figures(run, tmp_path / "occupied")
    assert Path(tmp_path / "occupied").read_text() == "mine"


def test_what_cannot_be_drawn_is_left_out_with_a_reason(run):
    report = replace(run.report, sizes=(), settings=replace(run.report.settings, features=("z1",)))
    bare = EvaluationRun(report, run.sets[1:], run.held[1:], (), {}, {})
    figures, left_out = draw_figures(bare)
    assert set(figures) == set()
    told = dict(entry.split(": ", 1) for entry in left_out)
    assert "z2 only" in told["coverage.png"]
    assert "z2 only" in told["error-map-r.png"]
