"""Races and manoeuvres that are refused before they begin, in words."""

import re
from dataclasses import replace

import numpy as np
import pytest

from split_cli.control.limits import Limits
from split_cli.control.mpcc import MpccSettings
from split_cli.errors import SplitError
from split_cli.learning.cells import empty_set
from split_cli.learning.features import parse_features
from split_cli.learning.kernel import Kernel
from split_cli.learning.region import Grid, Region, z2_grid
from split_cli.learning.training_set import write_set
from split_cli.learning.trust import Trust
from split_cli.vehicle.parameters import read_vehicle
from split_cli.workflows.racing.entry import check_trusted
from split_cli.workflows.racing.maneuver import ManeuverSettings, run_maneuvers
from split_cli.workflows.racing.race import run_race
from split_cli.workflows.racing.settings import RaceSettings
from tests.control.courses import CAR, ROOT, invoke


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"track": "nowhere"}, "no track"),
        ({"learner": "guess"}, "no learner"),
        ({"laps": -1}, "number of laps"),
        ({"laps": 10**21}, "from 0 to 200"),
        ({"laps": 0, "start_set": "a.split"}, "nothing would be driven"),
        ({"hyperparameters": "default", "start_set": "a.split"}, "start set keeps the kernel"),
        ({"grip": 0.0}, "positive"),
        ({"track": "small", "width": 9.0}, "wide at"),
        ({"assumed_friction": 0.0}, "positive"),
        ({"max_torque": -5.0}, "positive"),
        ({"max_torque": 51.0}, "rolling resistance alone takes 52 N m"),
        ({"max_speed": 0.8}, "more than 1 m/s"),
        ({"seed": -1}, "from 0"),
        ({"features": "alpha_f,warp"}, "warp"),
        ({"features": "alpha_f,alpha_r,drive_lag.torque"}, "drive_lag.torque"),
        ({"features": "z1", "predictor": "table"}, "three features"),
        ({"predictor": "tabel"}, "Did you mean table"),
        ({"hyperparameters": "nowhere.yaml"}, "nowhere.yaml"),
        ({"car": "f1tenth_car"}, "wheelbase"),
        ({"settings": MpccSettings(limits=Limits(p_ellipse=1.2))}, "share of the peak"),
        ({"margin": -1.0}, "--margin: is -1"),
        ({"margin": 4.0}, "beside the car"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_the_first_step(options, says):
    with pytest.raises(SplitError, match=says):
        run_race(RaceSettings(**options), CAR)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"speeds": (-3.0,)}, "--speed: is -3, a positive number"),
        ({"p_ellipse": 1.5}, "share of the peak"),
        ({"car": "f1tenth_car"}, "wheelbase"),
        ({"seed": -2}, "from 0"),
        ({"scenario": "moose"}, "moose"),
        ({"features": "alpha_f,alpha_r,drive_lag.torque"}, "drive_lag.torque"),
    ],
)
def test_manoeuvres_that_cannot_be_driven_are_refused(options, says):
    with pytest.raises(SplitError, match=says):
        run_maneuvers(ManeuverSettings(**options), CAR)


def test_a_table_of_a_set_with_other_than_three_features_is_refused_before_the_first_step(tmp_path):
    car, features = read_vehicle(CAR), parse_features("speed,steer_rate")
    grid, kernel = Grid((1.0, 1.0), (0.0, -1.0), (9.0, 1.0)), Kernel(np.ones(2), np.ones(3), np.ones(3))
    write_set(empty_set(car, features, Region(), grid, kernel, horizon=0.05), tmp_path / "two.split")
    set_of_two = {"start_set": tmp_path / "two.split", "predictor": "table"}
    with pytest.raises(SplitError, match="three features, there are 2: speed, steer_rate"):
        run_maneuvers(ManeuverSettings(**set_of_two), CAR)
    with pytest.raises(SplitError, match="three features, there are 2"):
        run_race(RaceSettings(learner="none", **set_of_two), CAR)
    with pytest.raises(SplitError, match="--features: asks for z2, and .*two.split corrects by speed, steer_rate"):
        run_race(RaceSettings(start_set=tmp_path / "two.split", features="z2"), CAR)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ("race --learner none --set a.split", "no set would be written"),
        ("race -o a.parquet --set ./a.parquet", "is --(output|set) too, it would be overwritten"),
        ("race --iol-update incremental", "--iol-update belongs to --learner iol"),
        ("race --learner none --predictor bcm", "--predictor belongs to --learner split"),
        ("maneuver iso3888-1 --features z1", "--features belongs to --set"),
        ("maneuver iso3888-1 --max-torque 1", "rolling resistance alone takes 52 N m"),
    ],
)
def test_options_that_would_change_nothing_or_contradict_are_refused(options, says, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    refused = invoke(*options.split(), "--vehicle", CAR)
    assert refused.exit_code != 0 and re.search(says, refused.output + str(refused.exception))


def test_a_start_that_is_not_on_the_track_is_refused(tmp_path):
    angle = np.arange(80) * 2 * np.pi / 80
    rows = [f"{60 * np.cos(a):.3f},{40 * np.sin(a):.3f},6.0,0.3" for a in angle]
    (tmp_path / "aside.csv").write_text("\n".join(rows))
    with pytest.raises(SplitError, match=r"0\.30 m from the centre line at the start"):
        run_race(RaceSettings(track=str(tmp_path / "aside.csv")), CAR)


def test_a_set_of_another_vehicle_is_refused(tmp_path):
    trained = tmp_path / "other.split"
    other = str(ROOT / "sample_logs" / "road_car_start.yaml")  # the same body, other tyres
    log = str(ROOT / "sample_logs" / "road_car_tests.parquet")
    done = invoke("train", log, "--vehicle", other, "--hyperparameters", "default", "-o", str(trained))
    assert done.exit_code == 0, done.output
    for command in (["race"], ["maneuver", "iso3888-1"]):
        refused = invoke(*command, "--vehicle", CAR, "--start-set", str(trained))
        says = r"another vehicle of the same name, road_car: rolling_resistance_front is 91 in the set and 101"
        with pytest.raises(SplitError, match=says):
            raise refused.exception


def test_a_set_whose_correction_is_not_to_be_trusted_is_refused():
    car = read_vehicle(CAR)
    region, kernel = Region.of(car), Kernel(np.ones(3), np.ones(3), np.ones(3))
    trained = empty_set(car, parse_features("z2"), region, z2_grid(car, region), kernel, horizon=0.05)
    check_trusted(trained, car, "a.split")
    trust = Trust((0.0, 0.0, 0.3), "held-out")
    check_trusted(replace(trained, trust=trust), car, "a.split")
    for origin, says in (("held-out", "helped no output"), ("unjudged", "too short to judge")):
        with pytest.raises(SplitError, match=says):
            check_trusted(replace(trained, trust=Trust((0.0, 0.0, 0.0), origin)), car, "a.split")


def test_a_set_of_a_vehicle_that_differs_in_late_digits_is_refused_in_words():
    car = read_vehicle(CAR)
    region, kernel = Region.of(car), Kernel(np.ones(3), np.ones(3), np.ones(3))
    other = replace(car, mass=car.mass * (1.0 + 1e-9))
    trained = empty_set(other, parse_features("z2"), region, z2_grid(car, region), kernel, horizon=0.05)
    with pytest.raises(SplitError, match="mass is "):
        check_trusted(trained, car, "a.split")
