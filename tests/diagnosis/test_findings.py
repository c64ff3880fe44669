"""What may be called a finding: an effect whose interval leaves out that there is none."""

import pytest

from split_cli.diagnosis.statement.result import Finding, ParameterEstimate
from split_cli.diagnosis.verdict.findings import is_apart_from_none


def finding(term: str, **intervals: tuple[float, float]) -> Finding:
    parameters = {
        name: ParameterEstimate(0.5 * sum(interval), 0.25 * (interval[1] - interval[0]), "1", interval)
        for name, interval in intervals.items()
    }
    return Finding(term, "", parameters, 0.5, (), "", 1.0)


@pytest.mark.parametrize(
    ("term", "intervals", "expected"),
    [
        ("sensor_misalignment", {"angle": (-0.0034, 0.0003)}, False),  # turned either way, or not at all
        ("sensor_misalignment", {"angle": (-0.0034, -0.0003)}, True),
        ("mass", {"scale": (0.97, 1.04)}, False),  # neutral is a scale of one
        ("mass", {"scale": (1.01, 1.04)}, True),
        # One half of a gain may be as it should be, if the other is not.
        ("drive_gain", {"drive_gain": (0.995, 1.005), "brake_gain": (0.84, 0.86)}, True),
        ("drive_gain", {"drive_gain": (0.995, 1.005), "brake_gain": (0.95, 1.02)}, False),
    ],
)
def test_a_finding_leaves_out_that_there_is_no_effect(term, intervals, expected):
    assert is_apart_from_none(finding(term, **intervals)) is expected
