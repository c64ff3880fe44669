"""A disk that is full: one line, and nothing half written."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from split_cli.learning.training_set import write_set
from split_cli.logs.drive import write_drive
from split_cli.vehicle.parameters import write_vehicle
from tests.factories import make_drive, make_training_set, road_car

ROOT = Path(__file__).parents[2]
# What a full disk does to a write is what a limit on the size of files does: a part is written, then an error.
FULL = """
import resource, signal, sys
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
from split_cli.cli.main import main
from split_cli.learning.cells import warm_up
warm_up()
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
sys.exit(main())
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("inputs")
    write_vehicle(road_car(), made / "car.yaml")
    drive = make_drive(0, segments=8, seconds=3.0, vehicle=road_car())
    write_drive(drive, made / "lap.parquet")
    write_set(make_training_set(points=80), made / "a.split")
    return made


# Two that are quick; ingest and train write through the same `atomic_path` and `atomic_directory`.
COMMANDS = {
    "label": ("label", "lap.parquet", "--vehicle", "car.yaml", "-o", "out/labels.parquet"),
    "export": ("export", "a.split", "--target", "npz", "--queries", "100", "-o", "out/export", "--insist"),
}  # fmt: skip


def run(folder: Path, output: Path, arguments, limit: int) -> subprocess.CompletedProcess:
    given = [a.replace("out", str(output), 1) if a == "out" or a.startswith("out/") else a for a in arguments]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, "-c", FULL, str(limit), *given]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_a_full_disk_leaves_nothing_and_says_so_in_a_line(folder, tmp_path, name):
    done = run(folder, tmp_path, COMMANDS[name], 2000)
    assert done.returncode == 1, (done.stdout, done.stderr)
    assert "Traceback" not in done.stderr and "error of this program" not in done.stderr, done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("split: ") and ("large" in last or "space" in last or "written" in last), done.stderr
    assert [p for p in tmp_path.rglob("*") if p.is_file()] == []
