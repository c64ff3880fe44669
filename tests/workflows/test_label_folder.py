"""Labels of a folder of drives: the same bits in one process, in two, and drive by drive."""

import json

import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.label import label_drive
from tests.factories import make_drive, road_car


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("labels")
    write_vehicle(road_car(), made / "car.yaml")
    (made / "drives" / "monday").mkdir(parents=True)
    for seed, place in enumerate(("a.parquet", "monday/a.parquet", "b.parquet")):
        write_drive(make_drive(seed, segments=2, seconds=2.0, vehicle=road_car()), made / "drives" / place)
    return made


def run(*words: object):
    return CliRunner().invoke(group, [str(word) for word in words])


def test_two_processes_write_what_one_writes_and_what_a_drive_alone_gives(folder, tmp_path):
    asked = ("label", folder / "drives", "--vehicle", folder / "car.yaml", "--json")
    for jobs in (1, 2):
        told = run(*asked, "-o", tmp_path / str(jobs), "--jobs", jobs)
        assert told.exit_code == 0, told.output
        assert len(json.loads(told.stdout)) == 3
    places = sorted(p.relative_to(tmp_path / "1").as_posix() for p in (tmp_path / "1").rglob("*.parquet"))
    assert places == ["a.labels.parquet", "b.labels.parquet", "monday/a.labels.parquet"]
    for place in places:
        drive = folder / "drives" / place.replace(".labels", "")
        label_drive(drive, folder / "car.yaml", tmp_path / "alone.parquet")
        alone = (tmp_path / "alone.parquet").read_bytes()
        assert all((tmp_path / name / place).read_bytes() == alone for name in ("1", "2"))


def test_two_drives_of_one_name_are_refused_before_anything_is_written(folder, tmp_path):
    both = (folder / "drives" / "a.parquet", folder / "drives" / "monday" / "a.parquet")
    told = run("label", *both, "--vehicle", folder / "car.yaml", "-o", tmp_path / "out")
    assert told.exit_code != 0 and "two drives have this name" in str(told.exception)
    assert not (tmp_path / "out").exists()


def test_a_folder_of_labels_alone_is_told(folder, tmp_path):
    (tmp_path / "lap.labels.parquet").touch()
    told = run("label", tmp_path, "--vehicle", folder / "car.yaml", "-o", tmp_path / "out")
    assert told.exit_code != 0 and "label files and no drive" in str(told.exception)
