"""Every number that decides is in one place, says what it is and where it comes from, and decides."""

from __future__ import annotations

import ast
from dataclasses import FrozenInstanceError
from pathlib import Path

import pytest

from split_cli.diagnosis.policy import STANDARD, deciding_numbers

ROOT = Path(__file__).resolve().parents[2] / "split_cli" / "diagnosis"


@pytest.mark.parametrize(
    ("group", "one", "value"),
    [pytest.param(*entry, id=f"{entry[0]}-{entry[1].name}") for entry in deciding_numbers()],
)
def test_a_number_says_its_unit_its_meaning_and_its_origin(group, one, value):
    assert isinstance(value, int | float)
    assert one.metadata["unit"] and len(one.metadata["meaning"].split()) >= 4
    kind, colon, reason = one.metadata["origin"].partition(": ")
    assert kind in ("theory", "study", "judgement") and colon and reason


def test_a_policy_is_frozen_and_altered_by_name_only():
    with pytest.raises(FrozenInstanceError):
        STANDARD.comparison.level = 0.5
    with pytest.raises(TypeError):
        STANDARD.altered("comparison", levle=0.5)
    other = STANDARD.altered("comparison", level=0.5)
    assert (other.comparison.level, other.selection) == (0.5, STANDARD.selection)


def test_a_diagnosis_lists_every_number_once():
    names = [(group, one.name) for group, one, _ in deciding_numbers()]
    described = STANDARD.described()
    assert len(described) == len(names) and described["level"] == STANDARD.comparison.level
    assert described["selection_price"] == STANDARD.selection.price


def test_every_number_is_read_somewhere():
    """A field that no module of the diagnosis reads decides nothing."""
    sources = [path.read_text(encoding="utf-8") for path in ROOT.rglob("*.py") if path.name != "policy.py"]
    nodes = [node for source in sources for node in ast.walk(ast.parse(source))]
    read = {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    unread = [f"{group}.{one.name}" for group, one, _ in deciding_numbers() if one.name not in read]
    assert not unread
