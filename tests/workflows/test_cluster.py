"""Commands on a real cluster: a scheduler and two worker processes give what one process gives, bit for bit."""

import json
import os
import shutil
import subprocess
import sys
from functools import partial
from pathlib import Path

import fsspec
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.parallel import distributing_by
from split_cli.diagnosis.policy import STANDARD
from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive, write_drive
from split_cli.proof.store import write_seal
from split_cli.vehicle.parameters import write_vehicle
from split_cli.workflows.engine import open_engine
from tests.factories import MissingForce, make_drive, road_car
from tests.optional import needed

needed("cloudpickle")
dask = needed("dask")
distributed = needed("distributed")


@pytest.fixture(scope="module")
def address():
    """Address of a scheduler with two worker processes."""
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A car and three drives of it."""
    root = tmp_path_factory.mktemp("drives")
    (root / "in").mkdir()
    car = road_car()
    write_vehicle(car, root / "car.yaml")
    for seed in range(3):
        terms = [MissingForce({"front_lateral": 150.0})]
        drive = make_drive(seed, segments=8, seconds=3.0, vehicle=car, terms=terms, name=f"{seed}.parquet")
        write_drive(drive, root / "in" / f"{seed}.parquet")
    return root


def run(*words: object) -> str:
    told = CliRunner().invoke(group, [str(word) for word in words])
    assert told.exit_code == 0, (told.output, told.exception)
    return told.stdout


def test_workers_that_are_ended_are_told_in_one_line():
    once = dask.config.set({"distributed.scheduler.allowed-failures": 0})
    with once, open_engine("dask") as engine, pytest.raises(SplitError, match="ended from outside"):
        list(engine.map(os._exit, [1, 1]))


def ways(address: str) -> dict[str, tuple[object, ...]]:
    return {"one": ("--jobs", 1), "cluster": ("--engine", "dask", "--scheduler", address)}


def test_a_set_is_the_same(folder, tmp_path, address):
    for name, way in ways(address).items():
        run("train", folder / "in", "--vehicle", folder / "car.yaml", "-o", tmp_path / f"{name}.split", *way)
    sets = {(tmp_path / f"{name}.split").read_bytes() for name in ways(address)}
    assert len(sets) == 1


def test_labels_are_the_same(folder, tmp_path, address):
    for name, way in ways(address).items():
        run("label", folder / "in", "--vehicle", folder / "car.yaml", "-o", tmp_path / name, *way)
    written = [{path.name: path.read_bytes() for path in (tmp_path / name).iterdir()} for name in ways(address)]
    assert written[0] == written[1] and len(written[0]) == 3


def test_an_evaluation_is_the_same(folder, address, monkeypatch):
    # A drive that stays in its file travels by its name.
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    fsspec.filesystem("memory").put(str(folder / "in"), "/evaluated", recursive=True)
    given = sorted((folder / "in").iterdir()), ["memory://evaluated"]
    reports = []
    for way, drives in zip(ways(address).values(), given, strict=True):
        told = run("evaluate", *drives, "--vehicle", folder / "car.yaml", "--predictor", "bcm", "--json", *way)
        report = json.loads(told)
        for one in report["scores"]:
            del one["time_per_query"]
        reports.append(report)
    assert reports[0]["rollouts"]
    assert reports[1] == reports[0]


def test_a_diagnosis_is_the_same(tmp_path, address, monkeypatch):
    """Of a stretch of the samples, long enough for the halves of the simulation to be tested."""
    samples = Path(__file__).parents[2] / "sample_logs"
    for name in ("real", "sim"):
        drive = read_drive(samples / f"road_pair_{name}.parquet")
        write_drive(drive.stretch(0, 1500), tmp_path / f"{name}.parquet")
    given = (
        "--real",
        tmp_path / "real.parquet",
        "--sim",
        tmp_path / "sim.parquet",
        "--vehicle",
        samples / "road_car.yaml",
    )
    told, travelled = {}, []

    def noting(apply):
        def noted(function, items):
            travelled.append(getattr(function, "func", function).__qualname__)
            return apply(function, items)

        return distributing_by(noted)

    monkeypatch.setattr("split_cli.workflows.diagnose.distributing_by", noting)
    # What travels is asked for here, not what a long search finds.
    short = STANDARD.altered("selection", full_fits=3, rounds=2)
    monkeypatch.setattr("split_cli.workflows.diagnose.diagnose", partial(diagnose, policy=short))
    for name, way in ways(address).items():
        told[name] = json.loads(run("diagnose", *given, "--out", tmp_path / name, "--json", *way))
        assert (tmp_path / name / "report.html").exists()
    assert told["cluster"] == told["one"]
    for name in ("self_test", "detection_limits", "_fitted", "refitted"):
        assert any(function.startswith(name) for function in travelled), name
    assert told["one"]["verdict"] != "undecided" and told["one"]["detectable"]


def test_blind_identification_writes_the_same_files(tmp_path, address):
    """Of two short cases, one with a simulation: the answers stand sealed, as no worker reads them."""
    samples = Path(__file__).parents[2] / "sample_logs"
    for name, shown in (("0001", ("real",)), ("0002", ("real", "sim"))):
        case = tmp_path / "one" / "cases" / name
        case.mkdir(parents=True)
        for kind in shown:
            write_drive(read_drive(samples / f"road_pair_{kind}.parquet").stretch(0, 1000), case / f"{kind}.parquet")
        shutil.copy(samples / "road_car.yaml", case / "vehicle.yaml")
        (tmp_path / "one" / "sealed").mkdir(exist_ok=True)
        (tmp_path / "one" / "sealed" / f"{name}.json").write_text("{}")
    write_seal(tmp_path / "one", seed=1)
    shutil.copytree(tmp_path / "one", tmp_path / "cluster")
    written = []
    for name, way in ways(address).items():
        run("prove", "identify", tmp_path / name, *way)
        results = tmp_path / name / "results"
        notes = [json.loads((results / f"{case}.json").read_text()) for case in ("0001", "0002")]
        assert [note["error"] for note in notes] == ["", ""]
        written.append({p.relative_to(results): p.read_bytes() for p in results.glob("*/*")})
    assert written[0] == written[1] and len(written[0]) == 2


def test_a_faulty_log_ends_a_run_in_one_line(folder, tmp_path):
    """Workers told in Dask's own words which tasks they dropped."""
    shutil.copytree(folder / "in", tmp_path / "logs")
    (tmp_path / "logs" / "-1.mcap").write_bytes(b"\x89MCAP0\r\n" + bytes(50))
    words = ["ingest", "logs", "-o", "drives", "--engine", "dask", "--jobs", "2"]
    ended = subprocess.run([sys.executable, "-m", "split_cli", *words], cwd=tmp_path, capture_output=True, text=True)
    assert ended.returncode == 1 and ended.stderr.startswith("split: -1.mcap")
    assert len(ended.stderr.splitlines()) == 1 and not (tmp_path / "drives").exists()
