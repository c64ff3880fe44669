"""Models side by side: known errors, honest ties, a gate, and what the command writes."""

import csv
import json
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SplitError
from split_cli.logs.drive import write_drive
from split_cli.plots.charts import track_chart
from split_cli.scoring.comparison import RunErrors, rank, worse_than
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.compare import ComparedModel, ModelComparison, compare_models
from split_cli.workflows.report.comparison import comparison_headline, comparison_page
from tests.factories import make_drive, road_car

CAR = road_car()
WRONG = replace(CAR, name="wrong", mass=1.15 * CAR.mass)


def runs(errors: dict[str, np.ndarray], block: np.ndarray | None = None) -> RunErrors:
    count = len(next(iter(errors.values())))
    measured = np.stack([np.linspace(-1.0, 1.0, count)] * 3, axis=1)
    block = np.arange(count) // 10 if block is None else block
    return RunErrors(1.0, errors, np.full((count, 3), 2.0), measured, block)


class TestScores:
    def test_are_what_their_definitions_say(self):
        found = rank([runs({"a": np.full((100, 3), 0.5), "b": np.full((100, 3), 1.0)})])
        a, b = (score.states[0] for score in found)
        assert (a.rmse, a.skill, a.is_best) == (pytest.approx(0.5), pytest.approx(1.0 - 0.25 / 4.0), True)
        # ||e|| / ||y - mean(y)|| by NumPy, for the fit.
        y = np.linspace(-1.0, 1.0, 100)
        share = np.linalg.norm(np.full(100, 0.5)) / np.linalg.norm(y - y.mean())
        assert a.fit == pytest.approx(100.0 * (1.0 - share))
        assert b.to_best == pytest.approx((2.0, 2.0, 2.0)) and not b.as_good
        assert found[0].total == pytest.approx(0.25)

    def test_a_stretch_that_is_hard_for_all_moves_no_ratio(self):
        """Errors of 1 to 9 by block, the second model's 1.1 times: the intervals are wide, the ratio has none."""
        scale = np.repeat(np.arange(1.0, 10.0), 10)[:, None] * np.ones(3)
        a, b = (score.states[1] for score in rank([runs({"a": scale, "b": 1.1 * scale})]))
        assert a.interval[1] / a.interval[0] > 1.3 and b.to_best == pytest.approx((1.1, 1.1, 1.1))

    def test_noise_is_no_difference(self):
        """The best of two is chosen after the fact: of three states one in ten draws of noise would seem worse."""
        rng = np.random.default_rng(1)
        one = runs({name: rng.normal(size=(400, 3)) for name in ("a", "b")})
        found = rank([one])
        assert all(state.as_good for score in found for state in score.states)
        assert worse_than(found, [one], "a") == ()

    def test_three_blocks_claim_nothing(self):
        one = runs({"a": np.ones((30, 3)), "b": np.full((30, 3), 2.0)})
        found = rank([one])
        assert np.isnan(found[1].states[0].to_best[1]) and worse_than(found, [one], "b") == ()
        assert all(state.as_good for score in found for state in score.states)
        compared = ModelComparison(("a", "b"), ("lap",), 30, 0, found, (), (), ())
        assert comparison_headline(compared) == "a has the smallest error after 1 s; the difference is not significant."


@pytest.fixture(scope="module")
def drive():
    return make_drive(5, 30, 4.0, vehicle=CAR, name="lap.parquet")


class TestModels:
    def test_the_car_that_drove_is_best_and_near_perfect(self, drive):
        models = [ComparedModel("wrong", WRONG), ComparedModel("right", CAR)]
        compared = compare_models(models, [drive], (0.05, 1.0))
        by = {(score.name, score.horizon): score for score in compared.scores}
        right, wrong = by["right", 1.0], by["wrong", 1.0]
        assert right.is_best and all(one.is_best and one.fit > 99.0 for one in right.states)
        assert not any(one.as_good for one in wrong.states)
        assert any("v_y after 1 s" in text for text in compared.worse)

    def test_drives_are_pooled_by_their_squares(self, drive):
        models = [ComparedModel("wrong", WRONG), ComparedModel("right", CAR)]
        other = replace(make_drive(6, 30, 4.0, vehicle=CAR), name="other.parquet")
        compared = compare_models(models, [drive, other], (0.5,))
        parts = [dict(compared.by_drive)[name][0].states[0].rmse for name in ("lap.parquet", "other.parquet")]
        alone = [compare_models(models, [one], (0.5,)) for one in (drive, other)]
        weights = np.array([one.starts for one in alone])
        assert parts == [one.scores[0].states[0].rmse for one in alone]
        pooled = np.sqrt(np.sum(weights * np.square(parts)) / weights.sum())
        assert compared.scores[0].states[0].rmse == pytest.approx(pooled)

    def test_a_drive_given_twice_counts_once_and_is_told(self, drive):
        """Its blocks were counted twice, so that intervals were too narrow by a third."""
        models = [ComparedModel("wrong", WRONG), ComparedModel("right", CAR)]
        once = compare_models(models, [drive], (0.5,))
        copy = replace(drive, name="copy.parquet", columns=dict(drive.columns))
        named = [replace(one, sha256="same") for one in (drive, drive, copy)]
        twice = compare_models(models, named, (0.5,))
        assert (twice.starts, twice.scores, twice.drives) == (once.starts, once.scores, once.drives)
        assert twice.notes[0] == "lap.parquet was given twice: it counts once"
        assert twice.notes[1] == "copy.parquet is a copy of lap.parquet: it counts once"

    def test_the_headline_says_by_how_much_the_best_is_ahead(self, drive):
        """Significant is not large: 0.8 % less error was headed like 80 %."""
        compared = compare_models([ComparedModel("wrong", WRONG), ComparedModel("right", CAR)], [drive], (0.5,))
        right, wrong = (next(s for s in compared.scores if s.name == name) for name in ("right", "wrong"))
        near = [replace(right, total=0.992), replace(wrong, total=1.0)]
        assert "with 0.8 % less error than wrong" in comparison_headline(replace(compared, scores=tuple(near)))
        far = [replace(right, total=0.2), replace(wrong, total=1.0)]
        assert "with 80 % less error than wrong" in comparison_headline(replace(compared, scores=tuple(far)))

    def test_a_model_that_learned_the_drive_is_not_simply_best(self, drive):
        known = replace(drive, sha256="known")
        compared = compare_models([ComparedModel("wrong", WRONG), ComparedModel("right", CAR)], [known], (0.5,))
        assert "trained on" not in comparison_headline(compared)
        learned = replace(compared, in_sample=("right",))
        assert comparison_headline(learned).endswith(", but was trained on what it is compared on.")
        page = comparison_page(replace(learned, notes=("IN SAMPLE: right was trained on lap.parquet",)))
        assert page.index("IN SAMPLE") < page.index('id="scores"')

    def test_two_of_one_name_and_a_horizon_too_long_are_refused(self, drive):
        with pytest.raises(SplitError, match="two models are called 'a'"):
            compare_models([ComparedModel("a", CAR), ComparedModel("a", WRONG)], [drive])
        with pytest.raises(SplitError, match="no stretch without a gap is longer than 60 s"):
            compare_models([ComparedModel("a", CAR)], [drive], (60.0,))


@pytest.fixture(scope="module")
def folder(drive, tmp_path_factory):
    folder = tmp_path_factory.mktemp("compared")
    write_drive(drive, folder / "lap.parquet")
    write_vehicle(CAR, folder / "right.yaml")
    write_vehicle(WRONG, folder / "wrong.yaml")
    return folder


def compare(folder, *words: str):
    arguments = ["compare", *words, "--on", str(folder / "lap.parquet"), "--horizon", "0.05,1"]
    return CliRunner().invoke(group, arguments)


def test_a_path_is_drawn_without_a_heading(drive):
    placed = replace(drive, columns={**drive.columns, "X": drive["t"], "Y": 2.0 * drive["t"]})
    assert "yaw" not in placed.columns and track_chart([("measured", "measured", placed)]) is not None


class TestTheCommand:
    def test_writes_a_page_and_a_table_that_say_the_same(self, folder):
        old, new = f"old={folder / 'wrong.yaml'}", f"new={folder / 'right.yaml'}"
        told = compare(folder, old, new, "-o", str(folder / "out"), "--json")
        assert told.exit_code == 0, told.output
        said = json.loads(told.stdout)
        with (folder / "out" / "compare.csv").open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
        first = said["scores"][0]["states"][0]
        assert float(rows[0]["rmse"]) == pytest.approx(first["rmse"]) and rows[0]["model"] == "old"
        page = (folder / "out" / "report.html").read_text(encoding="utf-8")
        assert "new is best after 1 s, with" in page and "significantly in" in page
        # The pictures of every report: motion, tyres, handling, accelerations, whiteness.
        for chart in ("strip-vy", "tire-front", "force-x", "understeer", "gg", "white-r"):
            assert f'"name":"{chart}"' in page, chart

    def test_a_name_is_no_formula_and_no_script(self, folder):
        named = [f"@SUM(A1)<script>={folder / 'wrong.yaml'}", str(folder / "right.yaml")]
        assert compare(folder, *named, "-o", str(folder / "named")).exit_code == 0
        with (folder / "named" / "compare.csv").open(encoding="utf-8") as file:
            assert {row["model"] for row in csv.DictReader(file)} == {"'@SUM(A1)<script>", "right.yaml"}
        page = (folder / "named" / "report.html").read_text(encoding="utf-8")
        assert "@SUM(A1)&lt;script&gt;" in page and page.count("<script") == 2

    def test_the_gate_is_shut_by_a_worse_model_only(self, folder):
        wrong, right = str(folder / "wrong.yaml"), str(folder / "right.yaml")
        assert compare(folder, wrong, right, "--exit-code").exit_code == 3
        assert compare(folder, right, wrong, "--exit-code").exit_code == 0
        assert compare(folder, right, "--most", "v_y=0.5").exit_code == 0
        shut = compare(folder, right, "--most", "v_y=1e-9")
        assert shut.exit_code == 3 and "v_y of right.yaml after 1 s" in shut.output

    def test_a_wrong_limit_is_wrong_usage(self, folder):
        assert compare(folder, str(folder / "right.yaml"), "--most", "speed=3").exit_code == 2
