"""Charts as pictures show the numbers of the page, and their folder holds none of an earlier report."""

import csv
import json
from dataclasses import replace

import numpy as np
from matplotlib.image import imread

from split_cli.logs.drive import Drive
from split_cli.plots.chart import Band, Chart, ChartLine
from split_cli.plots.draw import CHARTS, draw_chart
from split_cli.plots.palette import LIGHT
from split_cli.workflows.diagnose import write_diagnosis
from tests.diagnosis.test_report import MATCH, mismatch
from tests.factories import make_drive, road_car

X = np.linspace(0.0, 1.0, 5)


def test_lines_have_their_numbers_colours_and_intervals():
    line = ChartLine("car", X, X**2, "corrected", low=X**2 - 0.1, high=X**2 + 0.1, along=10.0 * X)
    hidden = replace(line, name="hidden", shown=False)
    chart = Chart("a", "title", "t [s]", "y", (line, hidden), bands=(Band(-1.0, 1.0, "noise"),), other_x="s [m]")
    for other_x, x in ((False, X), (True, 10.0 * X)):
        (axes,) = draw_chart(chart, other_x=other_x).axes
        (drawn,) = axes.get_lines()
        np.testing.assert_array_equal(drawn.get_xydata(), np.stack([x, X**2], axis=1))
        assert drawn.get_color() == LIGHT["corrected"] and axes.get_xlabel() == ("s [m]" if other_x else "t [s]")
        (interval,) = axes.collections
        ends = interval.get_paths()[0].vertices[:, 1]
        assert (ends.min(), ends.max()) == (-0.1, 1.1)


def test_rows_are_named_from_the_top_with_their_intervals():
    bars = ChartLine("error", np.array([2.0, 3.0]), np.array([0, 1]), "learned", "bars", X[:2] + 1.5, X[:2] + 3.0)
    (axes,) = draw_chart(Chart("b", "", "rms", "", (bars,), rows=("first", "second"), reference=1.0)).axes
    assert [text.get_text() for text in axes.get_yticklabels()] == ["first", "second"] and axes.yaxis_inverted()
    assert [bar.get_width() for bar in axes.patches] == [2.0, 3.0]
    low, high = (np.array([part[k, 0] for part in axes.collections[0].get_segments()]) for k in (0, 1))
    np.testing.assert_allclose([low, high], [X[:2] + 1.5, X[:2] + 3.0])


def test_an_axis_spans_at_least_what_can_be_seen():
    """A change of 3e-5 is no wider than a dot, and one of 0.5 keeps its frame."""
    for change in (3e-5, 0.5):
        points = ChartLine("ours", np.array([1.0, 1.0 + change]), np.array([0, 1]), "learned", "points")
        chart = Chart("b", "", "ratio", "", (points,), rows=("first", "second"), reference=1.0)
        free = draw_chart(chart).axes[0].get_xlim()
        low, high = draw_chart(replace(chart, least_span=0.02)).axes[0].get_xlim()
        np.testing.assert_allclose(high - low, max(0.02, free[1] - free[0]))
        np.testing.assert_allclose(low + high, sum(free))


def test_a_folder_holds_the_charts_of_its_diagnosis_and_no_older_ones(tmp_path):
    car, diagnosis = road_car(), mismatch()
    drive: Drive = replace(make_drive(3, 3, 4.0, vehicle=car), name=diagnosis.gaps[0].drive)
    write_diagnosis(diagnosis, car, tmp_path / "out", [drive])
    figures = tmp_path / "out" / "figures"
    names = {path.name for path in figures.iterdir()}
    assert {"strip-vx.png", "gg.png", "tire-front.png", "help.csv"} <= names
    assert names <= {"help.csv", *(f"{name}.png" for name in CHARTS)}
    assert imread(figures / "strip-vx.png")[..., :3].std() > 0.01  # not blank
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
