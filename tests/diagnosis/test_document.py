"""`diagnosis.json` against the schema's own content."""

import json

import pytest
from jsonschema import Draft202012Validator

from split_cli.diagnosis.statement.document import diagnosis_to_text, read_schema
from split_cli.diagnosis.statement.improvement import Improvement
from split_cli.diagnosis.statement.result import (
    Detectable,
    Diagnosis,
    Finding,
    InputFile,
    Location,
    ParameterEstimate,
    Place,
)

ROW = (0.1, 0.2, 0.3)
FULL = Diagnosis(
    "mismatch",
    0.001,
    0.9,
    ("brake gain: there is no braking; brake hard once",),
    Location(
        {"longitudinal": 0.2, "front_lateral": 0.5, "rear_lateral": 0.3},
        (("a_y", 0.4), ("T", 0.2)),
        {"a_y": (3.0, 7.0)},
        Place(10.0, 40.0, None, "position", None, None),
        (3.0, 9.0),
        0.8,
        0.2,
    ),
    (
        Finding(
            "steer_gain",
            "",
            {"gain": ParameterEstimate(0.95, None, "1", (0.94, 0.96))},
            0.7,
            ("tire_stiffness", "cg_shift+yaw_inertia"),
            "In reality the wheels turn less.",
            0.4,
        ),
    ),
    True,
    None,
    Improvement(ROW, ROW, ROW, ROW, ROW, None, {"before": [[0.1, 0.2]] * 3}),
    (InputFile("lap.parquet", "ab" * 32, "real"),),
    {"level": 0.01},
    detectable=(Detectable("drive_lag", {"tau": (0.004, "s")}), Detectable("wind", {})),
)
ADDED = {"corrected_vehicle", "detectable", "leads"}  # to the contract, which leaves room for more


@pytest.mark.parametrize(
    "diagnosis", [FULL, Diagnosis("match", 0.5, 1.0), Diagnosis("undecided", None, 0.0, ("too short",))]
)
def test_every_verdict_is_valid(diagnosis):
    Draft202012Validator.check_schema(read_schema())
    Draft202012Validator(read_schema()).validate(json.loads(diagnosis_to_text(diagnosis)))


def test_the_shipped_schema_is_strict_about_what_readers_rely_on():
    """Dropping any required key, or a wrong enumeration, must be caught by the schema we ship."""
    schema = Draft202012Validator(read_schema())
    content = json.loads(diagnosis_to_text(FULL))
    assert set(content) == set(read_schema()["required"]) | {"schema"} | ADDED
    for key in set(content) - ADDED:
        assert list(schema.iter_errors({k: v for k, v in content.items() if k != key}))
    assert list(schema.iter_errors({**content, "verdict": "different"}))


def test_what_would_have_been_named_is_told_with_units():
    content = json.loads(diagnosis_to_text(FULL))
    assert content["detectable"] == [
        {"term": "drive_lag", "parameters": {"tau": {"value": 0.004, "unit": "s"}}},
        {"term": "wind", "parameters": {}},
    ]
    assert not json.loads(diagnosis_to_text(Diagnosis("undecided", None, 0.0, ("too short",))))["detectable"]
