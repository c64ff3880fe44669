"""The notebook of the documentation runs as it is printed, and its numbers are what the data were made with."""

from __future__ import annotations

import ast
import json
from pathlib import Path

import matplotlib
import pytest

from split_cli.vehicle.parameters import Vehicle

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
    row = names["told"].findings.set_index("parameter").loc["brake_gain"]
    # 15 % were concealed (sample_logs/README.md).
    assert row.low_95 - 0.01 < 0.85 < row.high_95 + 0.01
    assert isinstance(names["told"].corrected_vehicle, Vehicle)
    assert "Brakes" in names["told"].page()


def test_tables_and_figures_are_what_a_notebook_knows(ran):
    names, shown = ran
    assert any(isinstance(one, matplotlib.figure.Figure) for one in shown)
    table = names["table"]
    assert len(table) > 500 and set(table.columns) >= {"t", "y_vx", "y_vy", "y_r", "reason"}
    low, high = names["found"].interval
    assert low < names["found"].gradient < high


def test_the_calibrated_file_is_no_worse_than_its_start(ran):
    scores = ran[0]["compared"].scores
    last = scores[(scores.horizon == 1.0) & (scores.state == "r")].set_index("model")
    assert last.loc["calibrated", "rmse"] < last.loc["start", "rmse"]
