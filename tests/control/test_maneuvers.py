"""Courses of the manoeuvres, their cones, and short runs on the plant."""

import json
from dataclasses import replace

import numpy as np
import pytest

from split_cli.control.scenarios import CONE_RADIUS, build_scenario, cones_hit
from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive
from split_cli.plant.cars import F1TENTH_CAR, FORMULA_CAR, ROAD_CAR
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.entry import check_trusted
from split_cli.workflows.racing.maneuver import ManeuverSettings, course_scale, run_maneuvers
from tests.control.courses import CAR, ROOT, invoke


def test_a_lane_change_is_driven_between_its_cones(tmp_path):
    trained = tmp_path / "run.split"
    done = invoke(
        f"maneuver iso3888-2 --vehicle {CAR} -o {tmp_path / 'run.parquet'} --json --set {trained} "
        "--features z2,feature_lag"
    )
    assert done.exit_code == 0, done.output
    (run,) = json.loads(done.stdout)["runs"]
    assert run["hit"] == 0 and not run["ended"] and run["failures"] == 0
    assert run["entered"] == pytest.approx(10.0, abs=0.3)
    assert run["deviation"] < 0.4
    # The recent past needs a term that the vehicle file lacks; the set brings it, and is still one of this file.
    kept = read_set(trained)
    assert [effect.term for effect in kept.found] == ["feature_lag"]
    check_trusted(kept, read_vehicle(CAR), trained)
    judged = invoke("evaluate", str(tmp_path / "run.parquet"), "--set", str(trained), "--rollout", "0.5")
    assert judged.exit_code == 0, judged.output


def test_lanes_are_those_of_the_papers_table_at_its_width():
    first, second = build_scenario("iso3888-1", 1.6), build_scenario("iso3888-2", 1.6)
    assert [lane.width for lane in first.lanes] == pytest.approx([2.01, 2.17, 2.33])
    assert [lane.width for lane in second.lanes] == pytest.approx([2.01, 2.60, 3.00])
    assert first.lanes[1].right - first.lanes[0].right == pytest.approx(3.5)
    assert second.lanes[1].right - second.lanes[0].right == pytest.approx(3.01)
    brake = build_scenario("brake-avoid", 1.6)
    speeds = brake.speed(np.array([0.0, brake.brake_begin, brake.brake_end, 90.0]))
    assert speeds == pytest.approx([14.0, 14.0, 5.0, 5.0])


@pytest.mark.parametrize("name", ["iso3888-1", "iso3888-2", "brake-avoid"])
def test_a_scaled_course_is_the_full_one_times_the_scale(name):
    scale = 0.25
    full, small = build_scenario(name, 1.6), build_scenario(name, 1.6 * scale, scale=scale)
    np.testing.assert_allclose(small.cones, scale * full.cones)
    np.testing.assert_allclose([small.finish, small.brake_end], [scale * full.finish, scale * full.brake_end])
    s = np.linspace(0.0, full.finish, 500)
    one, other = full.path.at(s), small.path.at(scale * s)
    np.testing.assert_allclose([other.x, other.y], [scale * one.x, scale * one.y], atol=1e-6)
    # Equal accelerations along and across the line: v and the time of a step go with the root of the length.
    across = one.curvature * full.speed(s) ** 2
    np.testing.assert_allclose(other.curvature * small.speed(scale * s) ** 2, across, atol=1e-3)
    assert small.step == pytest.approx(0.5 * full.step)


def test_a_model_car_has_a_course_of_its_size():
    """It brakes and avoids there without a cone at 0.7 of the full course's speed, scaled."""
    assert course_scale(F1TENTH_CAR) == pytest.approx(F1TENTH_CAR.wheelbase / ROAD_CAR.wheelbase)
    assert course_scale(ROAD_CAR) == course_scale(FORMULA_CAR) == 1.0
    said = []
    small = ManeuverSettings(scenario="brake-avoid", car="f1tenth_car", speeds=(3.4,))
    result = run_maneuvers(small, str(ROOT / "sample_logs" / "f1tenth_car.yaml"), progress=said.append)
    assert result.highest_passed == 3.4 and result.scale == course_scale(F1TENTH_CAR)
    assert said[0] == "course: for full-size cars, scaled by 0.123 for a wheelbase of 0.33 m"


def test_a_cone_is_hit_when_the_body_reaches_it():
    cones = np.array([[5.0, 1.0 + CONE_RADIUS], [5.0, -1.2 - CONE_RADIUS], [20.0, 0.0]])
    x = np.linspace(0.0, 12.0, 200)
    still = np.zeros_like(x)
    # A car 2 m wide passes along its border without touching; turned a little its corner does.
    assert not cones_hit(cones, x, still, still, 2.0, 2.0, 2.0).any()
    assert cones_hit(cones, x, still, still + 0.02, 2.0, 2.0, 2.0).tolist() == [True, False, False]
    assert cones_hit(cones, x + 6.5, still, still, 2.0, 2.0, 2.0).tolist() == [False, False, True]


def test_on_half_the_grip_a_set_passes_where_the_file_of_a_dry_road_does_not(tmp_path):
    trained = tmp_path / "wet.split"
    wet = ManeuverSettings(grip=0.5, seed=3)
    run_maneuvers(replace(wet, speeds=(12.0,)), CAR, set_output=trained)
    fast = replace(wet, speeds=(15.0,))
    (nominal,) = run_maneuvers(fast, CAR).runs
    (learned,) = run_maneuvers(replace(fast, start_set=trained), CAR).runs
    assert nominal.hit > 2 and nominal.deviation > 0.5
    assert learned.passed and learned.deviation < 0.25


def test_a_run_is_learned_up_to_where_an_axle_lets_go(tmp_path):
    wet = ManeuverSettings(grip=0.5, seed=100, speeds=(22.0,))
    (lost,) = run_maneuvers(wet, CAR, output=tmp_path / "lost.parquet", set_output=tmp_path / "lost.split").runs
    drive, trained = read_drive(tmp_path / "lost.parquet"), read_set(tmp_path / "lost.split")
    side_slip = np.abs(np.arctan2(drive["vy"], drive["vx"]))
    assert lost.hit > 5 and side_slip.max() > 0.4
    before = drive["t"][np.argmax(side_slip > trained.region.alpha_max)]
    assert 0 < trained.t.max() < before and trained.size > 40
