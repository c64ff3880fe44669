"""The command that ingest prints to run next, with the derivation that a finding names."""

import shlex
from dataclasses import replace

import numpy as np
from click.testing import CliRunner

from split_cli.cli.main import group
from split_cli.vehicle.parameters import write_vehicle
from tests.logs.planted import PlantedDrive, write_table


def _run(words) -> tuple[int, str]:
    done = CliRunner().invoke(group, list(words), standalone_mode=False, catch_exceptions=False)
    return done.return_value, done.stderr


def test_a_log_of_another_car_is_told_before_its_map_is_blamed(tmp_path):
    """A 1:10 car's log with a road car's file got seven remedies for the map, each of them wrong."""
    planted = PlantedDrive(seconds=40.0)
    t = np.arange(0.0, 40.0, 0.01)
    names = ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta", "ax", "ay")
    write_table(tmp_path / "lap.csv", {"t": t, **{name: planted.at(name, t) for name in names}})
    car = planted.vehicle
    small = {"mass": 3.7, "yaw_inertia": 0.05, "wheel_radius": 0.05, "cg_to_front_axle": 0.16, "cg_to_rear_axle": 0.17}
    write_vehicle(replace(car, **small, name="small", max_torque=1.0, max_brake_torque=1.0), tmp_path / "small.yaml")
    write_vehicle(car, tmp_path / "own.yaml")
    words = ["ingest", str(tmp_path / "lap.csv"), "-o", str(tmp_path / "lap.parquet"), "--vehicle"]
    _, said = _run([*words, str(tmp_path / "small.yaml")])
    assert "looks like a recording of another car than 'small' (3.7 kg, wheelbase 0.33 m): it turns 0.12" in said
    assert "next: ingest the log of" in said and "correct the map" not in said
    _, said = _run([*words, str(tmp_path / "own.yaml")])
    assert "another car" not in said and "split train" in said


def test_the_next_command_has_the_derivation_that_the_finding_names(tmp_path):
    """The fault named --derive lateral-velocity-from-straights, and the next command trained without it."""
    planted = PlantedDrive(seconds=90.0)
    t = np.arange(0.0, 90.0, 0.01)
    names = ("X", "Y", "yaw", "vx", "vy", "r", "T", "delta", "ax", "ay")
    columns = {"t": t, **{name: planted.at(name, t) for name in names}}
    columns["vy"] = columns["vy"] + 0.02 * columns["vx"]
    write_table(tmp_path / "a lap.csv", columns)
    write_vehicle(planted.vehicle, tmp_path / "car.yaml")
    words = ["ingest", str(tmp_path / "a lap.csv"), "--vehicle", str(tmp_path / "car.yaml"), "--cut", "1:2.5"]
    words += ["--delay", "ay=0", "--keep-going", "-o", str(tmp_path / "a.parquet")]
    code, said = _run(words)
    (line,) = [one for one in said.splitlines() if "ingest again" in one]
    again = shlex.split(line.partition("ingest again: ")[2])
    derive = ["--derive", "lateral-velocity-from-straights"]
    assert code == 0 and sorted(again) == sorted(["split", *words, *derive])
    code, said = _run(again[1:])
    assert code == 0 and "ingest again" not in said and "split train" in said
