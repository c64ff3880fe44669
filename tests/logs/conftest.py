"""The drives that files of third-party loggers hold."""

import pytest

from tests.logs.planted import PlantedDrive


@pytest.fixture(scope="session")
def planted() -> PlantedDrive:
    """A minute towards north-west, so that a bearing of 0 to 360 degrees exceeds 180."""
    return PlantedDrive(seconds=60.0, yaw=2.0)


@pytest.fixture(scope="module")
def car() -> PlantedDrive:
    """Forty seconds, of which tables in the styles of other programs are written."""
    return PlantedDrive(seconds=40.0)
