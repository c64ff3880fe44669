"""A short race on the plant: its laps, what ends one, and what of it is written."""

import gc
import json
import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from split_cli.control.learner import settling_time
from split_cli.control.policy import FIRST_DEVIATION, MARGIN, SETTLED, SIZE
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive
from split_cli.plant.cars import F1TENTH_CAR, ROAD_CAR
from split_cli.vehicle.parameters import EffectSpec, read_vehicle
from split_cli.workflows.racing.driving import Race, garbage_collection_paused
from split_cli.workflows.racing.race import run_race
from split_cli.workflows.racing.settings import RaceSettings
from tests.control.courses import CAR, ROOT, invoke, ring


def test_two_laps_of_a_ring_are_driven_learned_and_written(tmp_path):
    drive, trained = tmp_path / "ring.parquet", tmp_path / "ring.split"
    done = invoke(
        f"race --vehicle {CAR} --track {ring(tmp_path)} --laps 1 --max-speed 14 -o {drive} --set {trained} --json"
    )
    assert done.exit_code == 0, done.output
    result = json.loads(done.stdout)
    nominal, learned = result["laps"]
    for lap in (nominal, learned):
        assert not lap["ended"] and lap["outside"] == 0.0 and lap["failures"] == 0
        # The lap's length over its time is its speed, as far as the car keeps to the middle of the road.
        assert lap["time"] == pytest.approx(result["length"] / lap["mean_speed"], rel=0.15)
    # The nominal model drives lap 0, and what it drove is learned once the kernel is fitted to it.
    assert nominal["error_before"] == nominal["error_after"] and nominal["updates"] >= nominal["size"] > 20
    assert nominal["updates"] + learned["updates"] >= learned["size"] > nominal["size"]
    # A learner begins as far from the border as the nominal model does.
    assert nominal["margin"] == learned["margin"] == pytest.approx(MARGIN + FIRST_DEVIATION)
    kept = read_set(trained)
    assert (kept.size, kept.cell_count) == (learned["size"], learned["cells"])
    recorded = read_drive(drive)
    assert recorded["t"][-1] - recorded["t"][0] == pytest.approx(nominal["time"] + learned["time"], abs=0.2)
    assert invoke("info", str(trained)).exit_code == 0


@pytest.mark.parametrize("lost", ["ice", "solver"])
def test_a_lap_that_is_lost_says_so_and_what_was_learned_is_kept(tmp_path, monkeypatch, lost):
    drive, trained = tmp_path / "ring.parquet", tmp_path / "ring.split"

    def say(text: str) -> None:
        if text == "lap 1" and lost == "ice":
            slippery = replace(ROAD_CAR.rear_tire, p_dy1=0.1, p_dx1=0.1)
            race.world.car = replace(ROAD_CAR, front_tire=slippery, rear_tire=slippery)
        elif text == "lap 1":
            none = SimpleNamespace(solved=False, seconds=0.0)
            monkeypatch.setattr(race.controller.programme, "solve", lambda data: none)

    settings = RaceSettings(track=str(ring(tmp_path, 20.0, 12.0)), laps=2, max_speed=14.0)
    race = Race(settings, read_vehicle(CAR), trained, say)
    race.begin()
    race.run()
    race.write(drive)
    result = race.result(drive)
    no_plan = "10 quadratic programmes in a row had no solution"
    what = f"the car spun|the car left the track|{no_plan}" if lost == "ice" else no_plan
    assert [lap.number for lap in result.laps] == [0, 1] and result.laps[1].time is None
    assert re.fullmatch(rf"({what}) at \d+ m", result.laps[1].ended)
    assert "Learning did not help" in result.verdict
    assert read_set(trained).size > 20 and len(read_drive(drive)["t"]) > 400


def test_a_lap_is_driven_without_collections_and_what_ends_it_brings_them_back():
    with pytest.raises(KeyboardInterrupt), garbage_collection_paused():
        assert not gc.isenabled()
        raise KeyboardInterrupt
    assert gc.isenabled()


def test_commands_matter_as_long_as_delays_and_lags_last_and_a_lag_of_no_time_takes_none():
    car = read_vehicle(CAR)
    specs = {tau: EffectSpec("steer_lag", {"tau": tau}) for tau in (0.0, 0.1)}
    delay = EffectSpec("steer_delay", {"delay": 0.05})
    assert settling_time(car.with_effects(specs[0.0], delay)) == pytest.approx(0.05)
    assert settling_time(car.with_effects(specs[0.1], delay)) == pytest.approx(0.05 + 0.1 * SETTLED)
    assert settling_time(car.with_effects(EffectSpec("tire_relaxation", {"length": 0.0}))) == 0.0


def test_a_small_car_keeps_lengths_in_proportion_and_its_plans_to_its_actuators():
    small = RaceSettings(car="f1tenth_car", track="f1tenth")
    race = Race(small, read_vehicle(ROOT / "sample_logs" / "f1tenth_car.yaml"), None, lambda text: None)
    share = F1TENTH_CAR.wheelbase / ROAD_CAR.wheelbase
    assert race.mpcc.margin == pytest.approx(MARGIN * share) and race.deviation == FIRST_DEVIATION * share
    assert (race.actuators.max_steer, race.actuators.torque_rate) == (0.4189, 40.0)
    own = Race(replace(small, margin=0.2), race.vehicle, None, lambda text: None)
    assert own.mpcc.margin == 0.2
    assert ROAD_CAR.wheelbase == SIZE


def test_a_lap_may_take_as_long_as_its_bends_ask_whatever_the_largest_speed(tmp_path):
    """Eight times as long as at 300 m/s, and 10 s, was once all the time there was."""
    track = str(ring(tmp_path, 40.0, 20.0))
    result = run_race(RaceSettings(track=track, learner="none", laps=0, max_speed=300.0, max_torque=300.0), CAR)
    assert not result.laps[0].ended
    assert result.laps[0].time > 10.0 + 8.0 * result.length / 300.0


def test_learners_are_compared_in_one_report(tmp_path):
    report = tmp_path / "laps.html"
    done = invoke(
        f"race --vehicle {CAR} --track {ring(tmp_path)} --laps 0 --max-speed 10 --learner none --learner "
        f"split --report {report} --json --features z2"
    )
    assert done.exit_code == 0, done.output
    (first,), (second,) = (result["laps"] for result in json.loads(done.stdout))
    # Nothing is known in lap 0, so both drive the same one.
    assert first["time"] == pytest.approx(second["time"], abs=1e-9)
    assert first["share"] == second["share"] == pytest.approx(0.75)
    page = report.read_text()
    assert "nominal, lap 0" in page and "split, lap 0" in page
    both = invoke("race", "--vehicle", CAR, "--learner", "none", "--learner", "split", "-o", "x.parquet")
    assert both.exit_code == 2 and "name one" in both.output
