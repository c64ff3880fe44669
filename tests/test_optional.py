"""A module that a test needs and that is missing: a skip at home, a failure where all should be installed."""

import json
import re
from pathlib import Path

import pytest

from tests.optional import COMPLETE, needed

ABSENT = "a_module_that_nobody_has"


def test_a_module_that_is_there_is_returned():
    assert needed("json") is json


@pytest.mark.parametrize(("complete", "outcome"), [("", pytest.skip.Exception), ("1", pytest.fail.Exception)])
def test_a_module_that_is_missing_fails_only_where_all_should_be_there(monkeypatch, complete, outcome):
    monkeypatch.setenv(COMPLETE, complete)
    with pytest.raises(outcome, match=ABSENT):
        needed(ABSENT)


def test_no_test_skips_in_another_way():
    """Pytest's own skip of a missing module would stay silent in CI; `fcntl` belongs to the system."""
    asked = {
        (path.name, name)
        for path in Path(__file__).parent.rglob("test_*.py")
        for name in re.findall(r"importorskip\(\"(\w+)", path.read_text(encoding="utf-8"))
    }
    assert asked == {("test_files.py", "fcntl")}
