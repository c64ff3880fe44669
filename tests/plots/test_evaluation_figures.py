"""Figures show what was computed: plotted numbers are read back and compared."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from split_cli.errors import SplitError
from split_cli.files import DIGESTS
from split_cli.learning.region import valid_cell_count
from split_cli.plots.evaluation import draw_figures, write_figures
from split_cli.plots.feature_space import coverage_maps, draw_coverage, draw_labels, label_maps
from split_cli.plots.growth import draw_growth, kept_over_time
from split_cli.plots.sizes import draw_sizes
from split_cli.plots.time_series import draw_error_over_time
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


def test_error_over_time_shows_labels_prediction_and_band_of_the_longest_drive(run):
    figure = draw_error_over_time(run)
    trace = max((t for t in run.traces if (t.name, t.features) == ("bcm", "z2")), key=lambda t: len(t.tested))
    assert trace.held.drive.name == "d1.parquet"
    for state in range(3):
        axis = figure.axes[2 * state]
        t, y = line(axis, "label")
        np.testing.assert_array_equal(y, trace.held.labels.y[:, state])
        np.testing.assert_array_equal(t, trace.held.labels.t)
        np.testing.assert_array_equal(line(axis, "nominal model")[1], 0.0)
        np.testing.assert_array_equal(finite(line(axis, "bcm on z2")[1]), trace.prediction.mean[:, state])
        (band,) = (part for part in axis.collections if part.get_label() == "95 % interval of a label")
        edge = np.concatenate([path.vertices[:, 1] for path in band.get_paths()])
        half = 1.959964 * np.sqrt(trace.prediction.variance[:, state] + trace.noise_variance[state])
        assert edge.max() == pytest.approx((trace.prediction.mean[:, state] + half).max())
        assert edge.min() == pytest.approx((trace.prediction.mean[:, state] - half).min())
        # The title's numbers are those of the report.
        by_drive = {s.name: s for s in run.report.scores if s.drive == "d1.parquet" and s.features in ("", "z2")}
        for name in ("nominal", "bcm"):
            assert f"{by_drive[name].rmse[state]:.3g}" in axis.get_title(loc="left")
    shaded = [
        patch.get_extents().transformed(figure.axes[0].transData.inverted()) for patch in figure.axes[0].patches
    ]
    intervals = [(box.x0, box.x1) for box in shaded]
    np.testing.assert_allclose(intervals, trace.held.split.intervals)


def test_no_line_spans_a_gap_between_tested_stretches(run):
    trace = run.traces[0]
    t, mean = line(draw_error_over_time(replace(run, traces=(trace,))).axes[0], "bcm on z2")
    joined = np.isfinite(mean[:-1]) & np.isfinite(mean[1:])
    step = trace.tested.window * trace.held.drive.period
    assert np.diff(t)[joined].max() < 2.5 * step
    assert np.isnan(mean).sum() >= len(trace.held.split.intervals) - 1


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
    figure = draw_growth(run)
    for trained, dots, squares in zip(
        run.sets, figure.axes[0].get_lines()[::2], figure.axes[0].get_lines()[1::2], strict=True
    ):
        assert list(dots.get_ydata()) == [source.points for source in trained.sources]
        assert list(squares.get_ydata()) == [source.cells for source in trained.sources]
        assert dots.get_ydata()[-1] == trained.size
    heights = [bar.get_height() for bar in figure.axes[1].patches]
    expected = [
        value
        for trained in run.sets
        for value in ([s.insertions for s in trained.sources] + [s.replacements for s in trained.sources])
    ]
    assert heights == expected
    met, count = kept_over_time(run.sets[0])
    first = run.sets[0].sources[0]
    assert count[-1] == run.sets[0].size
    assert (met < first.duration - 1e-9).sum() == (run.sets[0].source == 0).sum()


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
    assert set(figures) == {"growth.png"}
    told = dict(entry.split(": ", 1) for entry in left_out)
    assert "z2 only" in told["coverage.png"]
    assert "z2 only" in told["labels_r.png"]
    assert "error_over_time.png" in told
