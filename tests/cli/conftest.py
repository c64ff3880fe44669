"""A folder with all that a command may be given."""

import shutil
from pathlib import Path

import pytest

from split_cli.workflows.simulate import SimulateSettings, simulate_log
from tests.cli.hostile import tool
from tests.factories import MissingForce, write_garage


@pytest.fixture(scope="session")
def depot(tmp_path_factory) -> Path:
    """A folder with a vehicle, two drives, a trained set, a table and a log with messages; nobody writes to it."""
    terms = [MissingForce({"front_lateral": 150.0})]
    folder = write_garage(tmp_path_factory.mktemp("depot"), segments=12, seconds=3.0, terms=terms)
    asked = ("train", folder / "d0.parquet", "--vehicle", folder / "car.yaml", "-o", folder / "a.split")
    assert tool(*asked, "--trust", "full")[0] == 0
    settings = SimulateSettings(track="small", duration=8.0, seed=1)
    simulate_log(settings, folder / "lap.csv")
    simulate_log(settings, folder / "lap.parquet")
    simulate_log(settings, folder / "lap.mcap")
    return folder


@pytest.fixture
def here(depot, tmp_path, monkeypatch) -> Path:
    """The working directory: a fresh copy of the depot, under a name that quoting has to survive."""
    folder = tmp_path / "my cars ü"
    shutil.copytree(depot, folder)
    monkeypatch.chdir(folder)
    return folder
