"""Explained columns, options from a file, how much is said, progress, the manual page, completion."""

import ast
import io
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from split_cli.cli.columns import COLUMNS, meaning
from split_cli.cli.diagnose import BEGINS_ALONE
from split_cli.cli.digits import known_to, pair_known, plausible, three_digits
from split_cli.cli.main import COMMANDS, group
from split_cli.cli.manual import manual_page
from split_cli.cli.settings import default_options
from split_cli.cli.verbosity import Quiet, StepBar, print_notes
from split_cli.errors import SplitError

ROOT = Path(__file__).resolve().parents[2]


def run(*words: str):
    return CliRunner().invoke(group, list(words))


def printed_columns() -> set[tuple[str, str]]:
    """Return (command, column) of every header that a command's source gives to `print_table`."""
    found = set()

    def texts(node: ast.AST, name: str) -> None:
        if isinstance(node, ast.List | ast.Tuple):
            for element in node.elts:
                if isinstance(element, ast.Constant) and isinstance(element.value, str):
                    found.add((name, element.value))
                elif isinstance(element, ast.Starred):
                    texts(element.value, name)
        elif isinstance(node, ast.IfExp):
            texts(node.body, name)
            texts(node.orelse, name)

    for path in (ROOT / "split_cli" / "cli").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            target = getattr(getattr(node, "targets", [getattr(node, "target", None)])[0], "id", "")
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith("print_table"):
                texts(node.args[0], path.stem)
            elif isinstance(node, ast.Assign | ast.AugAssign) and target in ("header", "heads"):
                texts(node.value, path.stem)
    return found


class TestExplain:
    def test_every_printed_column_is_explained(self):
        columns = printed_columns()
        assert len(columns) > 80
        missing = sorted((name, column) for name, column in columns if column and meaning(name, column) is None)
        assert not missing

    def test_every_explained_table_is_a_command(self):
        assert set(COLUMNS) - {"any"} <= set(COMMANDS)

    def test_a_command_and_a_column(self):
        assert "1 - MSE/MSE of velocities held" in run("explain", "skill").stdout
        told = run("explain", "train").stdout
        assert "set size" in told and "alpha_max" in told
        wrong = run("explain", "skil")
        assert wrong.exit_code == 2 and "skill" in wrong.output

    def test_a_legend_stands_below_the_table_it_explains(self, tmp_path):
        file = tmp_path / "lap.csv"
        rows = "\n".join(f"{0.01 * k:.2f},{20 + 0.001 * k},0,0,0,0" for k in range(200))
        file.write_text(f"t,vx,vy,r,T,delta\n{rows}\n")
        plain = run("ingest", str(file), "--list")
        told = run("ingest", str(file), "--list", "--legend")
        assert told.exit_code == 0 and told.stdout.startswith(plain.stdout)
        assert "channel: name in the recording" in told.stdout.removeprefix(plain.stdout)


class TestSettings:
    def read(self, tmp_path, *contents: str) -> dict:
        files = []
        for k, content in enumerate(contents):
            files.append(tmp_path / f"{k}.yaml")
            files[-1].write_text(content)
        return default_options(group, click.Context(group), files)

    def test_later_files_win_option_by_option(self, tmp_path):
        found = self.read(
            tmp_path, "evaluate: {predictor: bcm, blocks: 7}", "all: {vehicle: car.yaml}\nevaluate: {blocks: 9}"
        )
        assert found["evaluate"] == {"predictors": "bcm", "blocks": 9, "vehicle_path": "car.yaml"}
        assert found["train"] == {"vehicle_path": "car.yaml"}
        assert "vehicle_path" not in found.get("verify", {})

    def test_lists_become_what_the_option_takes(self, tmp_path):
        found = self.read(tmp_path, "ingest: {map: split_sim}\ncompare: {horizon: [0.05, 1], on: a.parquet}")
        compare = {"horizons": "0.05,1", "drives": ["a.parquet"]}
        assert found == {"ingest": {"maps": ["split_sim"]}, "compare": compare}

    @pytest.mark.parametrize(
        ("content", "said"),
        [
            ("evalute: {}", "evaluate"),
            ("train: {predictr: x}", "train has no option"),
            ("train: 3", "no options"),
            ("all: {vehicel: a.yaml}", "no command has an option 'vehicel'. Did you mean vehicle"),
            ("- a", "keys"),
            ("train: {horizon: ~}", "horizon is None"),
            ("train: {horizon: {a: 1}}", "a value or a list"),
            ("ingest: {map: [[a]]}", "a value or a list"),
        ],
    )
    def test_what_is_wrong_is_named(self, tmp_path, content, said):
        with pytest.raises(SplitError, match=said):
            self.read(tmp_path, content)

    def test_the_command_line_wins_over_the_folder_and_the_folder_is_named(self, tmp_path, monkeypatch):
        monkeypatch.chdir(tmp_path)
        (tmp_path / "split.yaml").write_text("explain: {json: true}\n")
        told = run("explain", "skill")
        assert told.stdout.startswith("[") and "options of split.yaml" in told.stderr
        (tmp_path / "other.yaml").write_text("explain: {json: false}\n")
        assert run("--config", "other.yaml", "explain", "skill").stdout.startswith("split evaluate")
        assert run("explain", "skill", "--json", "--config", "x").exit_code == 2


class TestVerbosity:
    def test_quiet_lets_through_what_is_wrong(self):
        stream = io.StringIO()
        quiet = Quiet(stream)
        news = ("note: a\n", "split: note: b\n", "\r\x1b[K 3/7", "\n", "split: report in x\n")
        for text in (*news[:3], "\n", "split: gate: shut", "\n", *news[4:]):
            quiet.write(text)
        assert stream.getvalue() == "split: gate: shut\n" and not quiet.isatty()

    def test_a_warning_among_notes_is_heard_though_the_rest_is_quiet(self, monkeypatch):
        stream = io.StringIO()
        monkeypatch.setattr(sys, "stderr", Quiet(stream))
        print_notes(["trained on one drive", "WARNING: v_y is worse", "lag found"])
        assert stream.getvalue() == "split: WARNING: v_y is worse\n"

    def test_they_stand_anywhere_and_exclude_each_other(self):
        assert run("explain", "skill", "--quiet").exit_code == 0
        assert run("--verbose", "explain", "skill", "--quiet").exit_code == 2

    @pytest.fixture
    def drawn(self, monkeypatch, capsys):
        """Return what a bar on a terminal shows last, each thing done at its time [s]."""
        monkeypatch.setattr("split_cli.cli.verbosity.is_watched", lambda: True)

        def last_line(done: list[tuple[float, tuple]], **settings) -> str:
            now = [0.0]
            bar = StepBar(clock=lambda: now[0], **settings)
            for now[0], told in done:
                (bar if isinstance(told[0], str) else bar.count)(*told)
            shown = capsys.readouterr().err.split("\r")[-1]
            bar.close()
            return shown

        return last_line

    def test_the_time_that_is_left_is_that_of_steps_as_long_as_those_done(self, drawn):
        steps = [(0.0, ("a",)), (10.0, ("b",)), (20.0, ("rollouts",))]
        assert drawn(steps, total=8) == "█████" + "░" * 15 + " 3/8  20 s, about 60 s left  rollouts"
        assert "about 10 min left" in drawn([*steps, (30.0, ("c",)), (600.0, ("x",))], total=8)
        # Without a number of steps there is nothing to promise.
        assert drawn([(3.2, ("reading",))]) == "    3 s  reading"

    def test_a_count_that_begins_late_says_nothing_of_the_time_before(self, drawn):
        # A quarter in 20 s, after 100 s of something else.
        shown = drawn([(0.0, ("cases",)), (100.0, (0, 4)), (120.0, (1, 4))])
        assert shown == "█████" + "░" * 15 + " 1/4  2 min, about 60 s left  cases"

    def test_a_diagnosis_against_the_nominal_model_foresees_the_long_search(self, drawn):
        """Eight seconds were said to be left of two minutes, and then nothing."""
        steps = [(0.0, ("smoothing",)), (0.4, ("whitening",)), (1.0, ("comparing",)), (1.5, ("naming",))]
        assert drawn(steps, shares=BEGINS_ALONE).endswith("about 2 min left  naming")

    def test_steps_of_unequal_length_are_weighed(self, drawn):
        shares = {"reading": 0.0, "fitting": 0.25, "writing": 0.9}
        shown = drawn([(0.0, ("reading",)), (10.0, ("fitting",))], shares=shares)
        assert shown == "█████" + "░" * 15 + "  10 s, about 30 s left  fitting"
        # A long step had made what is left grow with every line: 20 s, 2 min left; 600 s, 57 min left.
        for now, left in ((25.0, ", about 15 s left"), (600.0, "")):
            shown = drawn([(0.0, ("reading",)), (10.0, ("fitting",)), (now, ("fitting",))], shares=shares)
            assert shown.endswith(f"{left}  fitting") and ("left" in shown) == bool(left)

    def test_the_time_goes_on_between_steps_and_notes_stand_above(self, monkeypatch, capsys):
        monkeypatch.setattr("split_cli.cli.verbosity.is_watched", lambda: True)
        with StepBar(2) as bar:
            bar("slow")
            time.sleep(1.3)
            bar.note("heard")
        told = capsys.readouterr().err
        assert told.count("1/2") >= 2 and "\rnote: heard\n" in told and told.endswith("\r")

    def test_a_pipe_is_told_of_a_long_run_now_and_then_and_of_a_short_one_nothing(self, monkeypatch, capsys):
        with StepBar(2) as bar:
            bar("fast")
        assert capsys.readouterr().err == ""
        monkeypatch.setattr("split_cli.cli.verbosity.SILENCE", 0.2)
        for stream, heard in ((sys.stderr, True), (Quiet(sys.stderr), False)):
            monkeypatch.setattr(sys, "stderr", stream)
            with StepBar(2) as bar:
                bar("slow")
                time.sleep(0.7)
            told = capsys.readouterr().err.splitlines()
            assert bool(told) is heard and all(re.search(r" 1/2  [01] s  slow$", line) for line in told)

    def test_a_text_that_counts_is_believed(self, drawn):
        shown = drawn([(0.0, ("[3/7] lap.mcap",)), (6.0, ("next",))])
        assert shown == "█" * 9 + "░" * 11 + " 4/7  6 s, about 8 s left  next"


def test_numbers_are_printed_with_digits_that_can_be_known():
    told = [plausible(v) for v in (12345.678, 0.0123456, 3.0, 123456789.0, 1e-7, 2.5e12)]
    assert told == ["12346", "0.01235", "3", "123456789", "1e-07", "2.5e+12"]
    measured = {(0.85493, 0.0102): "0.855", (0.85493, 0.04): "0.85", (1573.4, 31.0): "1570", (0.5, 0.0): "0.5"}
    measured |= {(0.23456, 0.0996): "0.23", (0.23456, 0.094): "0.23", (1.2345, 0.0249): "1.234"}
    measured |= {(-0.00012, 0.003): "0.000", (101.482, 14.0): "101", (12.3456, float("inf")): "12.35"}
    assert {pair: known_to(*pair).text for pair in measured} == measured
    assert [one.text for one in pair_known(0.855, 0.0102)] == ["0.855", "0.010"]
    numbers = {0.38823: "0.388", 0.98: "0.980", 3.5: "3.50", 2183.0: "2180", 0.0: "0", 999.6: "1000"}
    assert {value: three_digits(value).text for value in numbers} == numbers


def test_the_manual_page_holds_every_command_and_option():
    page = manual_page()
    for name in COMMANDS:
        assert f".SS split {name}" in page
    assert page.startswith(".TH SPLIT 1") and not re.search(r"(?m)^'(?!\\)", page)
    assert "\\-\\-exit\\-code" in page


def test_completion_knows_the_commands():
    """What the shell's function asks is answered by click; the docs say how it is switched on."""
    words = {"_SPLIT_COMPLETE": "bash_complete", "COMP_WORDS": "split ev", "COMP_CWORD": "1"}
    code = "from split_cli.cli.main import main; main()"
    done = subprocess.run(
        [sys.executable, "-c", code], env={**os.environ, **words}, capture_output=True, text=True, timeout=60
    )
    assert done.stdout.split() == ["plain,evaluate"]
    assert "_SPLIT_COMPLETE=bash_source" in (ROOT / "docs" / "everyday.md").read_text(encoding="utf-8")


def test_the_image_installs_what_the_project_declares_and_gives_up_root():
    """No registry is asked here: each step is read. COPY names files that exist; the last user is no root."""
    lines = (ROOT / "Dockerfile").read_text(encoding="utf-8").replace("\\\n", " ").splitlines()
    steps = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    assert {word for word, _ in steps} <= {"FROM", "WORKDIR", "COPY", "RUN", "ENV", "USER", "ENTRYPOINT", "CMD"}
    for word, rest in steps:
        if word == "COPY" and "--from" not in rest:
            assert all((ROOT / source).exists() for source in rest.split()[:-1]), rest
    user = [rest for word, rest in steps if word == "USER"]
    assert user == ["10001"]
    extras = re.search(r"\.\[([\w,]+)\]", " ".join(rest for _, rest in steps)).group(1).split(",")
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert all(re.search(rf"(?m)^{extra} = ", text) for extra in extras)
