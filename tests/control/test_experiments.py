"""The plan of the experiments hangs together, and its page is filled from what was kept."""

import json

import numpy as np
import pytest

from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.maneuver import ManeuverSettings
from split_cli.workflows.racing.result import RaceResult
from tests.studies import experiments
from tests.studies.experiments import PLAN, run_experiments
from tests.studies.experiments_page import fill_pages, tables


def lap(number: int, time: float | None, outside: float = 0.0) -> dict:
    return {
        "number": number,
        "time": time,
        "outside": outside,
        "margin": 0.8,
        "mean_speed": 16.0,
        "max_lateral": 0.85,
        "updates": 4,
        "size": 3,
        "cells": 2,
        "failures": 0,
        "error_before": [0.4, 0.5, 0.3],
        "error_after": [0.4, 0.25, 0.1],
        "motion_before": [0.4, 0.5, 0.3],
        "motion_after": [0.2, 0.1, 0.03],
        "solver_ms": [5.0, 9.0, 10.0],
        "step_ms": [8.0, 12.0, 15.0],
        "update_ms": [1.0, 2.0, 3.0],
    }


def result(name: str, model: str, laps: list[dict], group: str = "small", grip: float = 1.0) -> dict:
    settings = {"seed": 0, "car": "road_car", "track": "small", "grip": grip, "max_speed": 22.0}
    told = {"name": name, "group": group, "model": model, "settings": settings}
    trace = np.zeros((20, 13))
    trace[:, 1], trace[:, 5] = np.arange(20), 10.0
    traces = {f"lap{one['number']}": trace for one in laps}
    return told | {"result": {"laps": laps, "length": 20.0}, "traces": traces}


def test_every_start_set_is_written_by_an_experiment_before_it():
    written = []
    for experiment in PLAN:
        settings = experiment.settings
        if isinstance(settings, ManeuverSettings):
            if settings.start_set is not None:
                assert settings.start_set in written
            elif settings.scenario == "iso3888-1":
                written.append(experiment.name)
        elif settings.learner != "none":
            written.append(experiment.name)
    names = [experiment.name for experiment in PLAN]
    assert len(set(names)) == len(names)


def test_gains_are_on_the_nominal_races_of_the_same_road():
    races = {
        "a": result("a", "nominal", [lap(0, 40.0)]),
        "b": result("b", "nominal", [lap(0, 50.0)], "wet", 0.5),
        "c": result("c", "split", [lap(0, 50.0), lap(1, 45.0)], "wet", 0.5),
    }
    assert "| split | 1 of 1 | 45.00 | 10.0 | 45.00 | 10.0 |" in tables(races)["race-wet"]
    del races["b"]
    assert "| split | 1 of 1 | 45.00 | - | 45.00 | - |" in tables(races)["race-wet"]


def test_seeds_of_a_model_stand_side_by_side():
    races = {str(k): result(str(k), "split", [lap(0, 40.0), lap(1, 38.0 + k)]) for k in range(2)}
    races["1"]["settings"] |= {"seed": 1}
    made = tables(races)
    assert made["times-small"].endswith("| 1 | 38.00 / 39.00 |")
    assert "| split | 1 of 1 / 1 of 1 | 38.00 / 39.00 | - |" in made["race-small"]
    # Medians 8, 99 % values 12 and worst values 15 ms of two races.
    assert "| split | 2 | 5.0 / 9.0 / 10.0 | 8.0 / 12.0 / 15.0 | 1.0 / 2.0 / 3.0 | 0 |" in made["timing"]


def test_a_lap_off_the_track_does_not_count_and_the_page_is_filled(tmp_path, sample_logs):
    races = {
        "a": result("a", "nominal", [lap(0, 38.0, 0.5), lap(1, 40.0), lap(2, None)]),
        "b": result("b", "split", [lap(0, 40.0), lap(1, 38.0), lap(2, 36.0)]),
    }
    made = tables(races)
    # Lap 0 of a learner is the nominal model's, and no gain of its own.
    assert "| nominal | 1 of 3 | 40.00 | 0.0 | 40.00 | 0.0 |" in made["race-small"]
    # The motion's error fell from 0.4, 0.5, 0.3 to 0.2, 0.1, 0.03.
    assert "| split | 2 of 2 | 36.00 | 10.0 | 37.00 | 7.5 | 0.85 | 3 | 2 | 50 | 80 | 90 |" in made["race-small"]
    assert "| 0 | 38.00 (0.50) | 40.00 |" in made["times-small"] and "not finished" in made["times-small"]
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- table: race-small -->\nold\n<!-- end -->\nafter\n")
    record = tmp_path / "record.md"
    record.write_text("<!-- table: times-small -->\nold\n<!-- end -->\n")
    figures, left_out = fill_pages([page, record], races, read_vehicle(sample_logs / "road_car.yaml"))
    text = page.read_text()
    assert text.startswith("before\n") and text.endswith("after\n") and "old" not in text and "36.00" in text
    assert "38.00 (0.50)" in record.read_text() and left_out == ["timing"]
    assert all((tmp_path / "figures" / name).stat().st_size > 5000 for name in figures) and len(figures) == 3
    page.write_text("<!-- table: maneuvers -->\nearlier\n<!-- end -->\n")
    fill_pages([page], races, read_vehicle(sample_logs / "road_car.yaml"))
    assert "earlier" in page.read_text(), "nothing was kept of its experiments"


def test_what_is_kept_of_a_race_is_json_as_every_reader_takes_it(tmp_path, sample_logs, monkeypatch):
    """A value that is not a number is null; bare NaN is no JSON."""
    driven = RaceResult("small", "road_car", "road_car", "none", float("nan"), (), None, None, ())
    monkeypatch.setattr(experiments, "run_race", lambda *words, **options: driven)
    name = next(e.name for e in PLAN if e.vehicle == "gentle")
    assert run_experiments(tmp_path, {"gentle": sample_logs / "road_car.yaml"}, only=name) == [name]
    kept = json.loads((tmp_path / f"{name}.json").read_text(), parse_constant=pytest.fail)
    assert kept["result"]["length"] is None and kept["settings"]["laps"] == 10
    assert experiments.stored(tmp_path)[name]["traces"] == {}
