"""Commands that draft a map, list, describe or label take a folder, a glob and an address, and give what files give."""

import json

import fsspec
import numpy as np
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from tests.factories import write_garage

NAMES = ("monday.csv", "tuesday.csv")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Two recordings of one car in a folder, and in memory."""
    made = tmp_path_factory.mktemp("logs")
    (made / "day").mkdir()
    for phase, name in enumerate(NAMES):
        rows = [f"{0.02 * k:.2f},{9.0 + np.sin(0.01 * k + phase):.4f},{0.1 * np.sin(0.03 * k):.4f}" for k in range(500)]
        (made / "day" / name).write_text("t [s],vx [m/s],yaw_rate [rad/s]\n" + "\n".join(rows) + "\n")
    fsspec.filesystem("memory").put(str(made / "day"), "/logs/day", recursive=True)
    return made


def ways(folder) -> dict[str, list[str]]:
    """Return the two recordings by their names, as a folder, a glob and addresses."""
    return {
        "names": [str(folder / "day" / name) for name in NAMES],
        "folder": [str(folder / "day")],
        "glob": [str(folder / "day" / "*.csv")],
        "local": [f"file://{folder / 'day'}"],
        "remote": ["memory://logs/day"],
        "pattern": ["memory://logs/day/*.csv"],
    }


def run(*words: object, code: int = 0):
    done = CliRunner().invoke(group, [str(word) for word in words], standalone_mode=False)
    given = 1 if done.exception else done.return_value or 0
    assert given == code, (done.output, done.exception)
    return done


@pytest.mark.parametrize("together", [[], ["--together"]])
def test_a_drafted_map(folder, tmp_path, together):
    maps = {}
    for name, logs in ways(folder).items():
        out = tmp_path / name
        step = run("init", *logs, *together, "-o", out).stdout.splitlines()[-1]
        named = " ".join(logs).removeprefix("file://")
        assert f"split ingest {named} " in step.replace("'", "")
        assert step.endswith("-o monday.parquet" if together else "-o monday_drives")
        maps[name] = (out / "map.yaml").read_text()
    assert "monday.csv" in maps["names"] and "tuesday.csv" in maps["names"]
    assert all(text == maps["names"] for text in maps.values())


def test_a_log_of_its_own_is_named_by_its_address(folder, tmp_path):
    told = run("init", "memory://logs/day/monday.csv", "-o", tmp_path / "car").stdout
    assert "split ingest memory://logs/day/monday.csv --vehicle" in told and told.endswith("-o monday.parquet\n")


@pytest.mark.parametrize("together", [[], ["--together"]])
def test_channels_and_drafts_that_ingest_shows(folder, together):
    for shown in ("--list", "--suggest-map"):
        found = {}
        for name, logs in ways(folder).items():
            told = json.loads(run("ingest", *logs, *together, shown, "--json").stdout)
            found[name] = [{key: value for key, value in one.items() if key != "log"} for one in _list(told)]
        assert len(found["names"]) == (1 if together else 2)
        assert all(one == found["names"] for one in found.values())
    assert run("ingest", "memory://logs/day", *together, "--list").stdout.count("/logs/day/tuesday.csv") == 1


def _list(told) -> list:
    return told if isinstance(told, list) else [told]


def test_files_made_one_drive(folder, tmp_path):
    drives = []
    for name, logs in ways(folder).items():
        out = tmp_path / f"{name}.parquet"
        run("init", *logs, "--together", "-o", tmp_path / name)
        failed = run("ingest", *logs, "--together", "--map", tmp_path / name / "map.yaml", "-o", out, code=1)
        drives.append(str(failed.exception))
    assert len(set(drives)) == 1


def test_descriptions(folder):
    found = {}
    for name, files in ways(folder).items():
        told = json.loads(run("info", *files, "--json").stdout)
        assert [one["path"].rpartition("/")[2] for one in told] == list(NAMES)
        found[name] = [(one["kind"], one["facts"]) for one in told]
    assert all(one == found["names"] for one in found.values())
    assert run("info", "memory://logs/day").stdout.startswith("memory://")


def test_a_description_that_fails_is_named_last_and_the_others_are_given(folder, tmp_path):
    for name in NAMES:
        (tmp_path / name).write_bytes((folder / "day" / name).read_bytes())
    (tmp_path / "week").mkdir()
    (tmp_path / "week" / "middle.mcap").write_bytes(b"\x89MCAP0\r\n")
    (tmp_path / "notes.docx").write_text("not looked at")
    fsspec.filesystem("memory").put(str(tmp_path), "/faulty", recursive=True)
    for where in (str(tmp_path), "memory://faulty"):
        done = run("info", where, code=1)
        assert [line for line in done.stdout.splitlines() if line.endswith(": recording")][1].endswith(
            "tuesday.csv: recording"
        )
        (line,) = done.stderr.splitlines()
        assert line.startswith("split: ") and "middle.mcap" in line
        assert "week/middle.mcap: holds no readable message" in line
    # Of a copy that is gone, the address is named.
    fsspec.filesystem("memory").pipe("/faulty/car.split", b"ARROW1")
    alone = run("info", "memory://faulty/car.split", code=1)
    assert str(alone.exception).startswith("memory:///faulty/car.split: ") or print(alone.exception)


def test_what_stands_for_nothing_is_said(tmp_path):
    (tmp_path / "empty").mkdir()
    for command in (["init", "-o", str(tmp_path / "car")], ["info"]):
        for address in (str(tmp_path / "empty"), str(tmp_path / "*.csv"), "memory://nowhere/*.csv"):
            done = CliRunner().invoke(group, [*command, address])
            assert done.exit_code == 1 and "holds no" in str(done.exception)
    assert not (tmp_path / "car").exists()


def test_labels(tmp_path):
    (tmp_path / "garage").mkdir()
    garage = write_garage(tmp_path / "garage", segments=2, seconds=2.0)
    (garage / "drives").mkdir()
    for name in ("d0.parquet", "d1.parquet"):
        (garage / name).rename(garage / "drives" / name)
    fsspec.filesystem("memory").put(str(garage / "drives"), "/labelled", recursive=True)
    drives = garage / "drives"
    many = {"folder": drives, "glob": drives / "*.parquet", "remote": "memory://labelled"}
    made = {}
    for name, where in many.items():
        run("label", where, "--vehicle", garage / "car.yaml", "-o", tmp_path / name, "--jobs", 1)
        made[name] = {path.name: path.read_bytes() for path in (tmp_path / name).iterdir()}
    assert set(made["folder"]) == {"d0.labels.parquet", "d1.labels.parquet"}
    assert all(one == made["folder"] for one in made.values())
    run("label", "memory://labelled/d0.parquet", "--vehicle", garage / "car.yaml", "-o", tmp_path / "one.parquet")
    assert (tmp_path / "one.parquet").read_bytes() == made["folder"]["d0.labels.parquet"]
