"""One small recording of the nominal car, prepared once, for every test of the engine's modules."""

import pytest

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, build_shared_discrepancy
from split_cli.diagnosis.innovations.evidence import Evidence, gather_evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.search.selection import Selection
from split_cli.logs.drive import Drive
from tests.diagnosis.recordings import (
    NAMES,
    bare_objective,
    driven,
    light_evidence,
    noisy,
    objective_with,
    planted,
    prepared,
    selected,
)
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
def nominal_objective(nominal_evidence) -> MarginalLikelihood:
    """Judges the nominal car as a reality that has nothing beyond its simulation."""
    return bare_objective(nominal_evidence)


@pytest.fixture(scope="session")
def discrepancy(nominal_series) -> SharedDiscrepancy:
    return build_shared_discrepancy(road_car(), nominal_series)


@pytest.fixture(scope="session")
def gathered(nominal_series, discrepancy) -> Evidence:
    """Evidence with the columns of the shared discrepancy, its disturbance found."""
    return gather_evidence(road_car(), nominal_series, discrepancy)


@pytest.fixture(scope="session")
def pair() -> MarginalLikelihood:
    """Judges a car of 12 % more yaw inertia and some drag, two terms that a simulation lacks."""
    return objective_with(*planted(yaw_inertia=1.12, aero_drag=0.5))


@pytest.fixture(scope="session")
def chosen_pair(pair) -> Selection:
    """What a search among five terms says of it."""
    return selected(pair, *NAMES)
