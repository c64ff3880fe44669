"""The notebook of the documentation runs as it is printed, and its numbers are what the data were made with."""

import ast
import json
import re
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest

from split_cli.api import DiagnosisResult, EvaluationResult
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.scoring.report import IntervalShares, RolloutScore, SizeScore
from split_cli.vehicle.parameters import Vehicle
from tests.diagnosis.test_report import mismatch
from tests.factories import road_car

ROOT = Path(__file__).resolve().parents[1]
NOTEBOOK = json.loads((ROOT / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def ran() -> tuple[dict, list]:
    """Run every cell in turn, as Jupyter does; return the names and what each cell shows."""
    names: dict = {}
    shown = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(ROOT)
        for cell in NOTEBOOK["cells"]:
            if cell["cell_type"] != "code":
                continue
            tree = ast.parse("".join(cell["source"]))
            last = tree.body.pop() if isinstance(tree.body[-1], ast.Expr) else None
            exec(compile(tree, "cell", "exec"), names)
            if last is not None:
                shown.append(eval(compile(ast.Expression(last.value), "cell", "eval"), names))
    return names, shown


def test_every_cell_runs_and_stores_no_output():
    assert all(cell.get("outputs", []) == [] for cell in NOTEBOOK["cells"])


def test_the_concealed_brakes_are_found(ran):
    names, _ = ran
    row = names["result"].findings.set_index("parameter").loc["brake_gain"]
    # 15 % were concealed (sample_logs/README.md).
    assert row.low_95 - 0.01 < 0.85 < row.high_95 + 0.01
    # The double track turns some of it into wheel slip and spin; driving torque was left alone.
    assert row.value == pytest.approx(0.85, abs=0.025)
    findings = names["result"].findings.set_index("parameter")
    assert findings.loc["drive_gain", "value"] == pytest.approx(1.0, abs=0.015) and len(findings) == 2
    assert isinstance(names["result"].corrected_vehicle, Vehicle)
    assert "Brakes" in names["result"].page()


def test_the_readme_quotes_the_summary_of_the_pair(ran):
    """Its figures are the program's: every part of the quotation, between the omissions, is in what it prints."""
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    quoted = " ".join(line[2:] for line in readme.splitlines() if line.startswith("> "))
    said = ran[0]["result"].summary
    parts = [part.strip() for part in quoted.split("[...]")]
    # The words are the same; a number may move by 5 %, as the last digit of an interval does with the libraries.
    number = re.compile(r"\d+(?:\.\d+)?")
    masked = number.sub("#", said)
    assert len(parts) > 1
    for part in parts:
        at = masked.find(number.sub("#", part))
        assert at >= 0, f"{part!r} is not in:\n{said}"
        before = len(number.findall(said)) - masked[at:].count("#")
        wanted = [float(value) for value in number.findall(part)]
        told = [float(value) for value in number.findall(said)[before : before + len(wanted)]]
        assert told == pytest.approx(wanted, rel=0.05), said


def test_tables_and_figures_are_what_a_notebook_knows(ran):
    names, shown = ran
    assert any(isinstance(one, matplotlib.figure.Figure) for one in shown)
    table = names["table"]
    assert len(table) > 500 and set(table.columns) >= {"t", "y_vx", "y_vy", "y_r", "reason"}
    low, high = names["found"].interval
    assert low < names["found"].gradient < high


def test_every_table_of_a_result_is_a_frame():
    told = DiagnosisResult(mismatch(), road_car(), (), ())
    assert list(told.improvement.columns[:3]) == ["horizon_s", "stage", "channel"]
    before = told.improvement[told.improvement.stage == "before"]
    for one in told.diagnosis.improvement.rollouts:
        assert tuple(before[before.horizon_s == one.horizon].rmse) == one.before
    assert len(told.detectable) == sum(len(one.parameters) for one in told.diagnosis.detectable)
    nothing = DiagnosisResult(Diagnosis("undecided", None, 0.0), road_car(), (), ())
    assert len(nothing.improvement) == len(nothing.detectable) == 0 and "unit" in nothing.detectable
    score = RolloutScore("nominal", "", 0.5, 40, 1, np.array([0.1, 0.2, 0.3]), 0.05)
    shares = IntervalShares(
        "bcm", "z2", False, 30, 0.1, *(level * np.array([1.0, 0.9, 0.8]) for level in (0.5, 0.9, 1))
    )
    size = SizeScore(8, SimpleNamespace(features="z1", points=7, rmse=np.array([0.1, 0.2, 0.3, 0.4])))
    report = SimpleNamespace(rollouts=(score,), intervals=(shares,), sizes=(size,))
    result = EvaluationResult(SimpleNamespace(report=report))
    (row,) = result.rollouts.itertuples()
    assert (row.model, row.starts, row.rmse_vy, row.distance, row.diverged) == ("nominal", 40, 0.2, 0.05, 1)
    (row,) = result.intervals.itertuples()
    assert (row.near, row.samples, row.in50_vx, row.in95_r) == (False, 30, 0.5, 0.8)
    (row,) = result.sizes.itertuples()
    assert (row.features, row.points, row.rmse_vx, row.rmse_norm) == ("z1", 7, 0.1, 0.4)


def test_the_calibrated_file_is_no_worse_than_its_start(ran):
    scores = ran[0]["compared"].scores
    last = scores[(scores.horizon == 1.0) & (scores.state == "r")].set_index("model")
    assert last.loc["calibrated", "rmse"] < last.loc["start", "rmse"]
