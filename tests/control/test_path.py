"""Contour and lag errors by hand on a circle, and tracks on which nobody can drive."""

import numpy as np
import pytest

from split_cli.control.centerline import read_centerline
from split_cli.control.path import check_path, contour_and_lag, resampled
from split_cli.errors import SplitError

RADIUS = 30.0


def circle(half_width: float = 4.0, count: int = 60):
    angle = np.arange(count) * 2 * np.pi / count
    points = RADIUS * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    width = np.full(count, half_width)
    return resampled("circle", points, width, width, closed=True)


def test_a_circle_has_its_length_curvature_and_direction():
    path = circle()
    assert path.length == pytest.approx(2 * np.pi * RADIUS, rel=1e-5)
    assert path.curvature == pytest.approx(np.full(len(path.x), 1 / RADIUS), rel=2e-3)
    s = np.array([0.0, path.length / 4, 1.25 * path.length, -0.75 * path.length])
    point = path.at(s)
    assert point.direction == pytest.approx(np.pi / 2 + s / RADIUS, abs=1e-4)
    assert point.x == pytest.approx([RADIUS, 0, 0, 0], abs=2e-3)


def test_contour_and_lag_by_hand():
    path = circle()
    # A car 2 m inside the circle (left of the line, which turns left), 0.1 rad ahead of its reference.
    angle, ahead, radius = 1.0, 0.1, RADIUS - 2.0
    point = path.at(np.array([RADIUS * angle]))
    x, y = radius * np.cos(angle + ahead), radius * np.sin(angle + ahead)
    contour, lag = contour_and_lag(point, np.array([x]), np.array([y]))
    assert contour[0] == pytest.approx(radius * np.cos(ahead) - RADIUS, abs=2e-3)
    assert lag[0] == pytest.approx(-radius * np.sin(ahead), abs=2e-3)


def test_slopes_along_the_line_are_those_of_differences():
    path = circle()
    x, y = np.array([RADIUS - 1.5]), np.array([0.7])
    s = np.array([0.2])
    contour, lag = contour_and_lag(path.at(s), x, y)
    ahead, behind = (contour_and_lag(path.at(s + d), x, y) for d in (0.5, -0.5))
    assert (ahead[0] - behind[0])[0] == pytest.approx(-lag[0] / RADIUS, abs=1e-3)
    assert (ahead[1] - behind[1])[0] == pytest.approx(1 + contour[0] / RADIUS, abs=1e-3)


def test_projection_leaves_no_lag():
    path = circle()
    s = path.project(RADIUS * np.cos(0.5) * 0.95, RADIUS * np.sin(0.5) * 0.95, near=12.0)
    assert s == pytest.approx(0.5 * RADIUS, abs=1e-3)


def test_a_centre_line_file_is_read_with_its_widths_in_their_order(tmp_path):
    angle = np.arange(40) * 2 * np.pi / 40
    rows = [f"{50 * np.cos(a):.4f},{50 * np.sin(a):.4f},3.0,5.0" for a in angle]
    file = tmp_path / "ring.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(rows))
    path = read_centerline(file)
    assert (path.right[0], path.left[0]) == (pytest.approx(3.0), pytest.approx(5.0))
    assert path.length == pytest.approx(2 * np.pi * 50, rel=1e-3)
    check_path(path, 1.8)


def test_a_third_party_centre_line_follows_its_header(tmp_path):
    """Semicolons, another order, a column more, points at unequal distances, the first one again at the end."""
    angle = np.sort(np.random.default_rng(4).uniform(0.0, 2 * np.pi, 90))
    angle = np.append(angle, angle[0])
    rows = [f"{k}; {50 * np.cos(a):.4f}; 5.0; 3.0; {50 * np.sin(a):.4f}" for k, a in enumerate(angle)]
    file = tmp_path / "ring.csv"
    file.write_text("# made by hand\n# number; x_m; w_tr_left_m; w_tr_right_m; y_m\n" + "\n".join(rows))
    path = read_centerline(file)
    assert (path.right[0], path.left[0]) == (pytest.approx(3.0), pytest.approx(5.0))
    assert path.length == pytest.approx(2 * np.pi * 50, rel=1e-3)
    assert np.abs(np.hypot(path.x, path.y) - 50.0).max() < 0.1
    file.write_text(file.read_text().replace("w_tr_left_m", "width"))
    with pytest.raises(SplitError, match="no column w_tr_left_m"):
        read_centerline(file)


@pytest.mark.parametrize(
    "written",
    [
        lambda row: row.replace(",", " "),
        lambda row: row.replace(",", "\t"),
        lambda row: row.replace(",", ";").replace(".", ","),
        lambda row: ",".join(f'"{part}"' for part in row.split(",")),
    ],
    ids=["blanks", "tabs", "decimal commas", "quotes"],
)
def test_a_centre_line_is_the_same_however_its_numbers_are_set_apart(tmp_path, written):
    files = [tmp_path / name for name in ("ring.csv", "other.csv")]
    header = "# x_m,y_m,w_tr_right_m,w_tr_left_m\n"
    for file, rows in zip(files, (RING, [written(row) for row in RING]), strict=True):
        file.write_text(header + "\n".join(rows))
    one, other = (read_centerline(file) for file in files)
    for name in ("x", "y", "left", "right", "curvature"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


RING = [f"{50 * np.cos(a):.3f},{50 * np.sin(a):.3f},3,5" for a in np.arange(120) * np.pi / 60]


@pytest.mark.parametrize(
    ("rows", "says"),
    [
        ([*RING[:5], "900,900,3,5", *RING[5:]], "gap of .* after row 6"),
        (RING[:60], "between its last point and its first"),
        ([*RING[:5], RING[4], *RING[5:]], "row 6 and the next"),
        (["1,2,3"] * 9, "row 2"),
        (["1,2,3,x"], "row 2"),
        (["1,1,2,2"], "8 or"),
        ([f"{i},0,-1,2" for i in range(9)], "width"),
        ([f"{5e6 * np.cos(a)},{5e6 * np.sin(a)},3,5" for a in np.arange(120) * np.pi / 60], "m long"),
        (["#" * 17_000_000], "larger than 16 MB"),
        ([f"{0.05 * np.cos(a)},{0.05 * np.sin(a)},3,5" for a in np.arange(120) * np.pi / 60], "not in kilometres"),
        (RING[:60] + RING[50:], "turns back on itself at row 61"),
        (RING + RING[:4], "ends beyond its first point"),
    ],
)
def test_a_centre_line_file_that_is_none_says_where(tmp_path, rows, says):
    file = tmp_path / "bad.csv"
    file.write_text("# x_m,y_m,w_tr_right_m,w_tr_left_m\n" + "\n".join(rows))
    with pytest.raises(SplitError, match=says):
        read_centerline(file)


def test_a_track_that_is_too_narrow_too_tight_or_crosses_itself_is_refused():
    with pytest.raises(SplitError, match=r"1\.60 m wide"):
        check_path(circle(0.8), 1.8)
    with pytest.raises(SplitError, match="inner border"):
        check_path(circle(31.0), 1.8)
    t = np.arange(200) * 2 * np.pi / 200
    eight = np.stack([80 * np.sin(t), 80 * np.sin(t) * np.cos(t)], axis=1)
    width = np.full(200, 4.0)
    with pytest.raises(SplitError, match="crosses itself"):
        check_path(resampled("eight", eight, width, width, closed=True), 1.8)
