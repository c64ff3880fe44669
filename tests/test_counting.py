"""Shares of statements, against a module whose statements are counted by hand."""

import runpy

import coverage
import pytest

from tests.counting import share_of


def test_what_two_workers_ran_is_added_up(tmp_path):
    """Five statements: one run takes the branch of 1, another that of 2, and none the last."""
    module, folder = tmp_path / "branches.py", tmp_path / "counts"
    module.write_text("if n == 1:\n    a = 1\nelif n == 2:\n    a = 2\nelse:\n    a = 3\n")
    folder.mkdir()
    for n, expected in ((1, 2), (2, 4)):
        own = coverage.Coverage(
            data_file=str(folder / "counted"), data_suffix=f"{n}", config_file=False, include=[str(module)]
        )
        with own.collect():
            runpy.run_path(str(module), {"n": n})
        own.save()
        share, floor = share_of(folder, config_file=False, include=[str(module)])
        assert share == pytest.approx(100.0 * expected / 5.0)
        assert floor == 0.0
