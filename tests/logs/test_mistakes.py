"""What ingest says of mistakes of unit and sign, alone and in pairs, on the bundled recordings; and of none."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from split_cli.logs.checking.consistency import ConsistencyFinding, check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import Vehicle, read_vehicle
from split_cli.workflows.ingesting.ingest import ingest_logs

DEGREES = 180.0 / np.pi
STANDARD_GRAVITY = 9.80665

MISTAKES = {
    "yaw rate in deg/s": ({"r": lambda v: v * DEGREES}, "r", "is in deg/s"),
    "yaw rate clockwise": ({"r": lambda v: -v}, "r", "left-handed"),
    "yaw rate clockwise in deg/s": ({"r": lambda v: -v * DEGREES}, "r", "is in deg/s, and has the opposite"),
    "speed in km/h": ({"vx": lambda v: 3.6 * v}, "vx", "is in km/h"),
    "speeds in mph": ({"vx": lambda v: v / 0.44704, "vy": lambda v: v / 0.44704}, "vx", "is in mph"),
    "yaw clockwise": ({"yaw": lambda v: -v}, "yaw", "clockwise"),
    "yaw of a compass": ({"yaw": lambda v: 0.5 * np.pi - v}, "yaw", "compass bearing"),
    "yaw in degrees": ({"yaw": lambda v: v * DEGREES}, "yaw", "is in deg"),
    "steer angle in degrees": ({"delta": lambda v: v * DEGREES}, "delta", "is in deg"),
    "steer angle right-positive": ({"delta": lambda v: -v}, "delta", "right-positive"),
    "angle of the steering wheel": ({"delta": lambda v: 15.0 * v}, "delta", "steering-wheel angle"),
    "angle of the steering wheel in degrees": (
        {"delta": lambda v: 15.0 * v * DEGREES},
        "delta",
        "steering-wheel angle in degrees",
    ),
    "a_x in g": ({"ax": lambda v: v / STANDARD_GRAVITY}, "ax", "is in g"),
    "a_x positive when braking": ({"ax": lambda v: -v}, "ax", "positive when braking"),
    "a_y in g": ({"ay": lambda v: v / STANDARD_GRAVITY}, "ay", "is in g"),
    "a_y right-positive": ({"ay": lambda v: -v}, "ay", "right-positive"),
    "position in feet": ({"X": lambda v: v / 0.3048, "Y": lambda v: v / 0.3048}, "X", "ft"),
    "torque of the engine": ({"T": lambda v: v / 8.0}, "T", "engine"),
    "torque positive when braking": ({"T": lambda v: -v}, "T", "positive when braking"),
    "v_y in mm/s": ({"vy": lambda v: 1000.0 * v}, "vy", "is in mm/s"),
    "v_y right-positive": ({"vy": lambda v: -v}, "vy", "right-positive"),
}


def with_mistakes(drive: Drive, *names: str) -> Drive:
    columns = dict(drive.columns)
    for name in names:
        for channel, change in MISTAKES[name][0].items():
            columns[channel] = change(columns[channel])
    return replace(drive, columns=columns)


def told(drive: Drive, vehicle: Vehicle) -> tuple[ConsistencyFinding, ...]:
    return check_consistency(drive, vehicle, drive.metadata.kinds).findings


def assert_all_named(findings: tuple[ConsistencyFinding, ...], names: tuple[str, ...]) -> None:
    for name in names:
        _, channel, words = MISTAKES[name]
        assert any(f.channel == channel and words in f.text for f in findings), (name, findings)
    blamed = {channel for name in names for channel in (*MISTAKES[name][0], MISTAKES[name][1])}
    assert {f.channel for f in findings} <= blamed, (names, findings)
    assert not any("no usual mistake" in f.text for f in findings), (names, findings)


@pytest.fixture(scope="module", params=["road_handling_moderate", "road_handling_aggressive", "f1tenth_laps"])
def sample(request, sample_logs, tmp_path_factory) -> tuple[Drive, Vehicle]:
    car = sample_logs / ("f1tenth_car.yaml" if request.param.startswith("f1") else "road_car.yaml")
    output = tmp_path_factory.mktemp("drives") / "drive.parquet"
    ingest_logs([sample_logs / f"{request.param}.mcap"], output, maps=["split_sim"], vehicle_path=car)
    return read_drive(output), read_vehicle(car)


def test_a_right_recording_is_told_nothing(sample):
    drive, vehicle = sample
    assert told(drive, vehicle) == ()


@pytest.mark.parametrize("name", MISTAKES)
def test_each_mistake_alone_is_named_and_blames_no_other_channel(sample, name):
    drive, vehicle = sample
    assert_all_named(told(with_mistakes(drive, name), vehicle), (name,))


def noisy(drive: Drive, seed: int = 0) -> Drive:
    """Return a drive as measured by everyday sensors: noise, wandering v_y, banked road, coarse steering wheel."""
    rng, t, size = np.random.default_rng(seed), drive.columns["t"], float(drive.columns["vx"].mean()) / 25.0
    small = min(size, 1.0)
    noise = {
        "vx": 0.1 * small,
        "vy": 0.08 * small,
        "r": 0.01,
        "yaw": 0.01,
        "X": 0.15 * small,
        "Y": 0.15 * small,
        "ax": 0.6,
        "ay": 0.6,
    }
    c = {k: v + noise.get(k, 0.0) * rng.standard_normal(len(t)) for k, v in drive.columns.items()}
    c["vy"] = c["vy"] + 0.008 * c["vx"] * np.sin(2.0 * np.pi * t / 60.0)
    c["ay"], c["r"] = c["ay"] + 0.15, c["r"] + 0.002
    step = np.radians(0.5) / 15.0
    c["delta"] = step * np.round(c["delta"] / step)
    return replace(drive, columns={**c, "t": t})


def test_everyday_noise_and_other_tyres_raise_no_alarm_and_hide_no_mistake(sample):
    drive, vehicle = sample
    drive = noisy(drive.select(slice(0, min(len(drive), 7000))))
    for stiffness in (0.7, 1.0, 1.3):
        tires = [replace(tire, B=stiffness * tire.B) for tire in (vehicle.front_tire, vehicle.rear_tire)]
        assert told(drive, replace(vehicle, front_tire=tires[0], rear_tire=tires[1])) == ()
    for name in [*MISTAKES][::3]:
        assert_all_named(told(with_mistakes(drive, name), vehicle), (name,))
    # Of gentle driving v_y is lost in noise: then that is said.
    turned = with_mistakes(drive, "v_y right-positive")
    found = check_consistency(turned, vehicle, turned.metadata.kinds)
    named = any("vy is right-positive" in f.text for f in found.findings)
    assert named or any(u.check == "place and sign of v_y" for u in found.unjudged)


def test_pairs_of_mistakes_are_both_named(sample):
    drive, vehicle = sample
    # A lap's worth is enough for the checks; every ninth pair, since all of them take a minute.
    drive = drive.select(slice(0, min(len(drive), 7000)))
    pairs = [pair for pair in combinations(MISTAKES, 2) if not set(MISTAKES[pair[0]][0]) & set(MISTAKES[pair[1]][0])]
    for pair in pairs[::9]:
        assert_all_named(told(with_mistakes(drive, *pair), vehicle), pair)


def test_a_relation_that_nothing_explains_silences_no_other(sample):
    drive, vehicle = sample
    columns = {**with_mistakes(drive, "yaw rate in deg/s").columns}
    columns["ax"] = 0.49 * columns["ax"]  # a filter of the logger
    findings = told(replace(drive, columns=columns), vehicle)
    assert {f.channel for f in findings} == {"r", "ax"}
    assert any("is in deg/s" in f.text for f in findings)


def test_accelerations_along_each_others_axes_are_told_so(sample):
    drive, vehicle = sample
    columns = {**drive.columns, "ax": drive.columns["ay"], "ay": drive.columns["ax"]}
    findings = told(replace(drive, columns=columns), vehicle)
    assert {(f.check, f.channel) for f in findings} == {("swapped", "ax"), ("swapped", "ay")}


def test_what_every_story_says_is_corrected_though_they_differ_in_another_channel(sample):
    # Without a path, nothing tells the hand of r and a_y together; their units are sure.
    drive, vehicle = sample
    wrong = with_mistakes(drive, "yaw rate in deg/s", "a_y in g")
    columns = {name: wrong.columns[name] for name in ("t", "vx", "vy", "r", "T", "delta", "ax", "ay")}
    kinds = {**drive.metadata.kinds, "vy": "derived: nothing", "delta": "derived: nothing"}
    found = check_consistency(replace(wrong, columns=columns), vehicle, kinds)
    assert found.factors["r"] == pytest.approx(DEGREES)
    assert found.factors["ay"] == pytest.approx(1.0 / STANDARD_GRAVITY)
