"""Figures of a diagnosis show its numbers, and their folder holds nothing of an earlier one."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from matplotlib.image import imread

from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.plots.diagnosis import diagnosis_figures, draw_help, draw_what, draw_where, gap_map
from split_cli.workflows.diagnose import FIGURES, write_diagnosis
from tests.diagnosis.test_report import MATCH, gap_along_a_circle, mismatch
from tests.factories import road_car


@pytest.fixture(scope="module")
def diagnosis() -> Diagnosis:
    return mismatch()


def test_the_map_holds_means_of_compared_rows():
    gap = gap_along_a_circle()
    first, second, means = gap_map([gap], 1, (0, 2))
    # One cell by hand: the rows between its borders; not the last one, which is closed.
    a, b = np.unravel_index(np.nanargmax(means[:-1, :-1]), means[:-1, :-1].shape)
    x, y = gap.operating_point[:, 0], gap.operating_point[:, 2]
    inside = (x >= first[a]) & (x < first[a + 1]) & (y >= second[b]) & (y < second[b + 1]) & gap.compared
    assert inside.sum() >= 3
    assert means[a, b] == pytest.approx(gap.forces[inside, 1].mean())
    # Not compared rows (the last tenth) count for nothing.
    *_, without = gap_map([replace(gap, forces=np.where(gap.compared[:, None], gap.forces, 1e9))], 1, (0, 2))
    np.testing.assert_array_equal(means, without)


def test_where_shows_the_strongest_force_over_time_and_place(diagnosis):
    figure = draw_where(diagnosis)
    assert "80 % of the gap is in front lateral force" in figure.get_suptitle()
    _, track, strip, _ = figure.axes
    gap = diagnosis.gaps[0]
    before = next(line for line in strip.get_lines() if line.get_label() == "gap")
    shown = np.asarray(before.get_ydata(), dtype=float)
    np.testing.assert_array_equal(shown[np.isfinite(shown)], gap.forces[gap.compared, 1])
    # The hole of 4 s breaks the line.
    assert len(shown) == len(gap.t) + 1
    marked = track.get_lines()[0].get_xydata()
    s = np.degrees(np.arctan2(marked[:, 1], marked[:, 0])) % 360.0 / 360.0 * 188.5
    # The stretch goes from s = 150 m across the start to 20 m.
    assert np.all((s >= 149.0) | (s <= 21.0)) and (s > 150.0).any() and (s < 20.0).any()


def test_what_ranks_the_chosen_term_before_its_rivals(diagnosis):
    figure = draw_what(diagnosis)
    rivals, rest = figure.axes
    assert [text.get_text() for text in rivals.get_yticklabels()] == [
        "steer gain (chosen)",
        "mass (as good)",
        "wind (placebo)",
    ]
    (points,) = [one for one in rivals.collections if one.get_offsets().shape == (3, 2) and one.get_sizes().size]
    np.testing.assert_allclose(points.get_offsets()[:, 0], [0.0, 4.0, 900.0])
    assert "gain 0.951 (95 %: 0.931 to 0.971)" in rivals.get_title(loc="left")
    assert [bar.get_width() for bar in rest.patches] == [60.0, 20.0]
    assert "20 % of the gap unexplained" in figure.get_suptitle()


def test_help_shows_every_stage_and_the_floor(diagnosis):
    figure = draw_help(diagnosis.improvement)
    assert "60 % (40 to 70 %)" in figure.get_suptitle()
    step, growth = figure.axes[0], figure.axes[3]
    dots = [line.get_xdata()[0] for line in step.get_lines() if line.get_marker() == "o"]
    stages = ("before", "physics", "split_only", "after")
    assert dots == [getattr(diagnosis.improvement, stage)[0] for stage in stages]
    last = diagnosis.improvement.rollouts[-1]
    ends = [line.get_ydata()[-1] for line in growth.get_lines() if len(line.get_ydata()) == 3]
    expected = [getattr(last, stage)[0] for stage in (*stages, "persistence")]
    np.testing.assert_allclose([end for end in ends if end in expected], expected)
    alone = draw_help(replace(diagnosis.improvement, rollouts=()))
    assert len(alone.axes) == 3


def test_nothing_is_drawn_of_a_match():
    assert list(diagnosis_figures(MATCH)) == []


def test_a_folder_holds_the_figures_of_its_diagnosis_and_no_older_ones(diagnosis, tmp_path):
    car = road_car()
    write_diagnosis(diagnosis, car, tmp_path / "out")
    figures = tmp_path / "out" / "figures"
    assert {path.name for path in figures.iterdir()} == FIGURES
    for name in ("where", "what", "help"):
        assert imread(figures / f"{name}.png").shape[1] == 1200
    with (figures / "help.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    (one,) = [row for row in rows if (row["horizon_s"], row["stage"], row["channel"]) == ("2.0", "physics", "v_y")]
    assert (one["rmse"], one["low_95"], one["unit"]) == ("0.2", str(0.8 * 0.2), "m/s")
    assert len(rows) == 3 * (6 + 3 * 6)
    said = json.loads((tmp_path / "out" / "diagnosis.json").read_text(encoding="utf-8"))
    removed = said["improvement"]["confidence"]["improvable_removed"]
    assert removed["physics"] == {"share": 0.6, "interval_95": [0.4, 0.7]} and removed["split_only"] is None
    (figures / "mine.png").write_bytes(b"kept")
    write_diagnosis(MATCH, car, tmp_path / "out")
    assert {path.name for path in figures.iterdir()} == {"mine.png"}
    # Nothing of the car was found: a file would be the vehicle as given.
    assert not (tmp_path / "out" / "vehicle_corrected.yaml").exists()
