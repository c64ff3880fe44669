"""Commands that take drives take a folder, a glob and an address of them, and give what the files give."""

import json

import fsspec
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.errors import SplitError
from tests.factories import write_garage


@pytest.fixture(scope="module")
def garage(tmp_path_factory):
    folder = write_garage(tmp_path_factory.mktemp("garage"), segments=8, seconds=3.0)
    (folder / "drives").mkdir()
    for name in ("d0.parquet", "d1.parquet"):
        (folder / name).rename(folder / "drives" / name)
    fsspec.filesystem("memory").put(str(folder / "drives"), "/garage", recursive=True)
    return folder


def ways(folder) -> list[list[str]]:
    """Return the two drives by their names, as a folder, a glob and an address."""
    names = [str(folder / "drives" / name) for name in ("d0.parquet", "d1.parquet")]
    return [names, [str(folder / "drives")], [str(folder / "drives" / "*.parquet")], ["memory://garage"]]


def run(*words: object) -> str:
    done = CliRunner().invoke(group, [str(word) for word in words])
    assert done.exit_code == 0, (done.output, done.exception)
    return done.stdout


def test_a_comparison(garage):
    found = []
    for drives in ways(garage):
        asked = [word for drive in drives for word in ("--on", drive)]
        found.append(json.loads(run("compare", garage / "car.yaml", *asked, "--horizon", "0.5", "--json")))
    assert len(found[0]["drives"]) == 2
    assert all(one == found[0] for one in found)


def test_a_calibration(garage, tmp_path):
    cars = []
    for drives in ways(garage):
        out = tmp_path / "fitted.yaml"
        run("calibrate", *drives, "--vehicle", garage / "car.yaml", "--fit", "drag", "--max-ay", "9", "-o", out)
        cars.append(out.read_bytes())
    assert len(set(cars)) == 1


def test_a_diagnosis_is_given_the_same_drives_in_the_same_order(garage, tmp_path, monkeypatch):
    given = []

    def noted(real, vehicle_path, output, *, simulated, holdout, **files):
        roles = (real, simulated, holdout)
        given.append([[(path.name, path.read_bytes()) for path in paths] for paths in roles])
        raise SplitError("enough")

    monkeypatch.setattr("split_cli.workflows.diagnose.diagnose_files", noted)
    for drives in ways(garage):
        asked = [word for drive in drives for word in ("--real", drive, "--holdout", drive)]
        words = ["diagnose", *asked, "--vehicle", str(garage / "car.yaml"), "--out", str(tmp_path / "out")]
        assert str(CliRunner().invoke(group, words).exception).startswith("enough")
    assert [len(paths) for paths in given[0]] == [2, 0, 2]
    assert all(one == given[0] for one in given)


@pytest.mark.parametrize("command", ["train", "evaluate"])
def test_a_remote_drive_that_cannot_be_copied_is_left_out_and_named(garage, tmp_path, monkeypatch, command):
    """It ended the run, though --keep-going leaves out a drive that cannot be read."""
    system = fsspec.filesystem("memory")
    opened = type(system).open

    def lost(self, path, *given, **more):
        if path.endswith("d0.parquet"):
            raise OSError("connection lost")
        return opened(self, path, *given, **more)

    monkeypatch.setattr(type(system), "open", lost)
    made = tmp_path / "made"
    words = [command, "memory://garage", "--vehicle", str(garage / "car.yaml"), "-o", str(made)]
    with pytest.raises(SplitError, match="connection lost"):
        CliRunner().invoke(group, words, standalone_mode=False, catch_exceptions=False)
    assert not made.exists()
    done = CliRunner().invoke(group, [*words, "--keep-going"], standalone_mode=False, catch_exceptions=False)
    assert done.return_value == 1 and made.exists()
    (told,) = [line for line in done.stderr.splitlines() if "left out" in line]
    assert "d0.parquet" in told and "connection lost" in told
