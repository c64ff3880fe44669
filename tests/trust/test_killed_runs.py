"""A run killed between any two of its steps on the disk leaves the old or the new output, and the next one works.

The long form, with every command, is `python -m tests.studies.kill --steps`.
"""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path

import pytest

from split_cli.cli.main import main
from tests.studies.kill import CASES, prepare, try_steps
from tests.studies.snapshots import leftovers_of_kills

EXPORT, APPEND = (next(case for case in CASES if case.name == name) for name in ("export", "append"))


@pytest.fixture(scope="module")
def ready(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("kill") / "ready"
    folder.mkdir()
    # An export is checked after each step; what that takes grows with the cube of its points.
    prepare(folder, (EXPORT.name, APPEND.name), in_this_process, segments=6, logs=False)
    return folder


def in_this_process(folder: Path, arguments: Sequence[str]) -> int:
    """Run a command in a folder and return its exit code."""
    with pytest.MonkeyPatch.context() as patch, pytest.raises(SystemExit) as ended:
        patch.chdir(folder)
        main(list(arguments))
    return int(ended.value.code or 0)


@pytest.mark.parametrize("case", [EXPORT, APPEND], ids=lambda case: case.name)
def test_a_kill_before_any_step_leaves_the_old_or_the_new_output(case, ready, tmp_path):
    outcome = try_steps(case, ready, tmp_path, in_this_process)
    assert not outcome.broken
    assert outcome.old >= 2 and outcome.new >= 1 and outcome.old + outcome.new == outcome.kills


def test_a_copy_before_a_step_is_what_a_real_kill_leaves(ready, tmp_path):
    shutil.copytree(ready, tmp_path / "copied")
    copies = leftovers_of_kills(tmp_path / "copied", EXPORT.arguments, tmp_path / "copies")
    swapped = next(n for n, folder in enumerate(copies) if EXPORT.state(folder) == EXPORT.state(copies[-1]))
    for step in (swapped - 1, swapped):
        folder = tmp_path / f"killed{step}"
        shutil.copytree(ready, folder)
        leftovers_of_kills(folder, EXPORT.arguments, tmp_path / f"none{step}", step)
        assert EXPORT.state(folder) == EXPORT.state(copies[step])
        assert _names(folder) == _names(copies[step])


def _names(folder: Path) -> list[str]:
    """Return what lies in a folder and what unfinished folders hold, without the random part of their names."""
    return sorted(
        os.path.relpath(path, folder).split(".")[-1] + str(path.stat().st_size if path.is_file() else "")
        for path in folder.rglob("*")
    )
