"""One small recording of the nominal car, prepared once, for every test of the engine's modules."""

from __future__ import annotations

import pytest

from split_cli.diagnosis.baseline.common import CommonPhysics, build_common_physics
from split_cli.diagnosis.innovations.evidence import Evidence, gather_evidence
from split_cli.diagnosis.innovations.judge import Judge
from split_cli.diagnosis.recording.series import Series
from split_cli.logs.drive import Drive
from tests.diagnosis.recordings import bare_judge, driven, light_evidence, noisy, prepared
from tests.factories import road_car


@pytest.fixture(scope="session")
def nominal_drive() -> Drive:
    """Eighty seconds of the nominal car, without noise."""
    return driven(1)


@pytest.fixture(scope="session")
def nominal_series(nominal_drive) -> Series:
    """The same, with sensor noise."""
    return prepared(noisy(nominal_drive, 1))


@pytest.fixture(scope="session")
def nominal_evidence(nominal_series) -> Evidence:
    return light_evidence(nominal_series)


@pytest.fixture(scope="session")
def nominal_judge(nominal_evidence) -> Judge:
    """Judges the nominal car as a reality that has nothing beyond its simulation."""
    return bare_judge(nominal_evidence)


@pytest.fixture(scope="session")
def common(nominal_series) -> CommonPhysics:
    return build_common_physics(road_car(), nominal_series)


@pytest.fixture(scope="session")
def gathered(nominal_series, common) -> Evidence:
    """Evidence with the columns of common physics, its disturbance found."""
    return gather_evidence(road_car(), nominal_series, common)
