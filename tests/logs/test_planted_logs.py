"""Mistakes in a log that units alone do not name: clocks, delays, exchanged wheels, places and crooked sensors."""

import tracemalloc
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.assembling.quality import render_quality
from split_cli.logs.checking.checks import Unjudged
from split_cli.logs.checking.consistency import Consistency
from split_cli.logs.checking.copies import copied_channels
from split_cli.logs.checking.measuring_point import or_its_place
from split_cli.logs.checking.relations import ConsistencyFinding
from split_cli.logs.raw import RawSignal, TableRecording
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import map_from_mapping, read_map
from split_cli.vehicle.parameters import read_vehicle
from tests.factories import one_run
from tests.logs.planted import UNITS, PlantedDrive

CHANNELS = tuple(c for c in UNITS if not c.startswith("wheel"))


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=90.0)


def ingested(planted, *, time=1.0, unit="s", backwards=False, wheels=None, without=(), **altered):
    """Ingest a table at 50 Hz; `time` multiplies its clock, read in `unit`; `altered` changes channels."""
    t = np.arange(0.0, planted.seconds, 0.02)
    columns = {c: planted.at(c, t) for c in CHANNELS if c not in without}
    if wheels:
        half = 0.7
        side = {"fl": -1, "fr": 1, "rl": -1, "rr": 1}
        for source, corner in wheels.items():
            columns[f"wheel_speed_{source}"] = columns["vx"] + side[corner] * half * columns["r"]
    for channel, change in altered.items():
        columns[channel] = change(t, columns[channel])
    if backwards:
        columns = {c: v[::-1] for c, v in columns.items()}
    signals = {c: RawSignal(c, None, v, UNITS.get(c, "m/s")) for c, v in {"t": time * t, **columns}.items()}
    signals["t"] = replace(signals["t"], unit="s")
    named = {"time": {"source": "t", "unit": unit}, "channels": {c: {"source": c} for c in columns}}
    recording = TableRecording("log.csv", Path("log.csv"), signals)
    return assemble_drive(recording, map_from_mapping(named, where="map"), planted.vehicle).quality.consistency


def only(found):
    (finding,) = found.findings
    return finding


def test_a_clock_in_another_unit_is_named_where_no_row_can_be_used(planted):
    with pytest.raises(LogError, match="probably in ms"):
        ingested(planted, time=1e3)
    with pytest.raises(LogError, match="probably in s, not in ms"):
        ingested(planted, unit="us")
    for factor in (1e-6, 1e27):  # no unit makes these a drive, and "probably in s" was said of seconds
        with pytest.raises(LogError, match="No unit of time makes a drive of it"):
            ingested(planted, time=factor)


def test_rows_that_run_backwards_are_one_mistake_and_turn_no_channel(planted):
    finding = only(ingested(planted, backwards=True))
    assert finding.channel == "time" and "backwards" in finding.text


@pytest.mark.parametrize(("channel", "late"), [("r", 0.2), ("delta", 0.3), ("ay", -0.15)])
def test_a_late_channel_is_told_without_being_asked_for_and_no_other_is(planted, channel, late):
    finding = only(ingested(planted, **{channel: lambda t, v: planted.at(channel, t - late)}))
    assert finding.check == "delay" and finding.channel == channel
    assert finding.measured == pytest.approx(late, abs=0.04)


def test_exchanged_wheels_are_told_by_the_side_that_is_faster_in_a_turn(planted):
    found = ingested(planted, wheels={"fl": "fr", "fr": "fl", "rl": "rl", "rr": "rr"})
    finding = only(found)
    assert finding.check == "swapped" and "exchanged" in finding.text and "rl" not in finding.text
    assert finding.measured == pytest.approx(-1.4, rel=0.02)


def test_a_steering_sensor_beside_its_zero_shows_on_straights(planted):
    finding = only(ingested(planted, delta=lambda t, v: v + np.radians(2.0)))
    assert finding.channel == "delta" and finding.measured == pytest.approx(np.radians(2.0), abs=2e-3)


@pytest.mark.parametrize(
    ("channel", "factor", "words"),
    [
        ("vy", 1e3, "is in mm/s"),
        ("vx", 1 / 0.3048, "is in ft/s"),
        ("ax", 1 / 0.3048, "is in ft/s^2"),
        ("T", 1e-3, "is in kN m"),
    ],
)
def test_rarer_units_are_named(planted, channel, factor, words):
    finding = only(ingested(planted, **{channel: lambda t, v: factor * v}))
    assert finding.channel == channel and words in finding.text


def test_a_lateral_velocity_in_mm_is_not_taken_for_the_longitudinal_one(planted):
    t = np.arange(0.0, planted.seconds, 0.02)
    c = {name: planted.at(name, t) for name in ("vx", "vy", "r", "T", "delta")}
    for factor, exchanged in ((1e3, False), (1.0, True)):
        columns = {**c, "t": t, "vy": factor * c["vy"]}
        if exchanged:
            columns |= {"vx": c["vy"], "vy": c["vx"]}
        signals = {n: RawSignal(n, None, v, {**UNITS, "t": "s"}[n]) for n, v in columns.items()}
        named = {"time": {"source": "t"}, "channels": {n: {"source": n} for n in c}}
        made = assemble_drive(
            TableRecording("a", Path("a"), signals), map_from_mapping(named, where="map"), planted.vehicle
        )
        assert any("swapped" in f.text for f in made.quality.consistency.findings) is exchanged


def test_v_y_of_the_rear_axle_is_a_place_and_no_unit(planted):
    arm = planted.vehicle.cg_to_rear_axle
    finding = only(ingested(planted, vy=lambda t, v: v - arm * planted.at("r", t)))
    assert finding.check == "place" and "position: rear_axle" in finding.text


def test_a_pose_of_the_other_hand_is_one_question_and_no_mistake_of_sign(planted):
    pose = {
        "X": lambda t, v: planted.at("Y", t),
        "Y": lambda t, v: planted.at("X", t),
        "yaw": lambda t, v: 0.5 * np.pi - v,
    }
    found = {finding.channel: finding.text for finding in ingested(planted, **pose).findings}
    assert set(found) == {"yaw", "X"}
    assert "`world: ned`" in found["yaw"] and "`frame: frd`" in found["yaw"] and "scale: -1" not in found["yaw"]
    # The same question is asked where the car is mirrored and the pose is not.
    car = {c: (lambda t, v: -v) for c in ("r", "vy", "ay", "delta")}
    assert {f.channel: f.text for f in ingested(planted, **car).findings}.keys() == found.keys()


def test_v_y_of_the_rear_axle_is_found_beside_a_mirrored_path_and_nothing_is_called_late(planted):
    behind = planted.vehicle.cg_to_rear_axle
    found = ingested(
        planted,
        X=lambda t, v: planted.at("Y", t),
        Y=lambda t, v: planted.at("X", t),
        vy=lambda t, v: v - behind * planted.at("r", t),
    ).findings
    assert {finding.channel: finding.check for finding in found} == {"X": "sign", "vy": "place"}


def test_a_delay_is_told_beside_a_unit_that_is_sure(planted):
    found = ingested(planted, ay=lambda t, v: np.interp(t - 0.2, t, v) / 9.80665).findings
    assert [(finding.channel, finding.check) for finding in found] == [("ay", "scale"), ("ay", "delay")]
    assert found[1].measured == pytest.approx(0.2, abs=0.02)


def test_a_copied_and_a_computed_yaw_rate_are_told_and_judge_nobody(planted):
    degrees = ingested(planted, ay=lambda t, v: np.degrees(planted.at("r", t)))
    assert only(degrees).check == "copied" and "times 57.3" in only(degrees).text

    def computed(t, v):
        return planted.at("vx", t) * np.tan(planted.at("delta", t)) / 2.6

    finding = only(ingested(planted, r=computed))
    assert (finding.channel, finding.check) == ("r", "copied") and finding.measured == pytest.approx(1 / 2.6, rel=1e-3)


@pytest.mark.parametrize("delay", [0.05, 0.133, 0.3, -0.1])
def test_a_computed_yaw_rate_that_comes_late_is_no_other_channels_fault(delay, planted):
    def computed(t, v):
        return planted.at("vx", t - delay) * np.tan(planted.at("delta", t - delay)) / 2.6

    finding = only(ingested(planted, r=computed))
    assert (finding.channel, finding.check) == ("r", "copied") and finding.measured == pytest.approx(1 / 2.6, rel=0.01)
    assert f"{abs(delay):.2f} s {'earlier' if delay > 0 else 'later'}" in finding.text


def test_a_measured_yaw_rate_is_not_taken_for_a_computed_one(planted):
    assert not [f for f in ingested(planted).findings if f.check == "copied"]


def test_the_search_for_a_late_copy_holds_few_columns_at_a_time():
    """A column for each of a hundred delays took a gigabyte of a million rows."""
    t, rng = np.arange(0.0, 300.0, 0.01), np.random.default_rng(0)
    columns = {"vx": 10.0 + np.sin(t), "delta": 0.05 * np.sin(2.0 * t), "r": rng.normal(size=len(t))}
    drive = one_run(columns, 0.01)
    copied_channels(drive, {})  # what is loaded at the first time
    tracemalloc.start()
    assert not copied_channels(drive, {})
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 15 * t.nbytes


@pytest.mark.parametrize(("time", "unit"), [(1e3, "s"), (1.0, "ms")])
def test_a_clock_in_another_unit_hides_no_second_mistake(time, unit, planted):
    with pytest.raises(LogError, match="probably in") as alone:
        ingested(planted, time=time, unit=unit)
    assert "With the time in" not in str(alone.value)
    with pytest.raises(LogError, match="probably in") as error:
        ingested(planted, time=time, unit=unit, r=lambda t, v: np.degrees(v))
    assert "With the time in" in str(error.value) and "r is in deg/s" in str(error.value)


def test_a_late_steer_angle_in_steps_is_told_and_one_that_is_only_in_steps_is_not(planted):
    def in_steps(late):
        return lambda t, v: np.repeat(np.interp(t - late, t, v)[::3], 3)[: len(t)]

    assert ingested(planted, delta=in_steps(0.0)).findings == ()
    finding = only(ingested(planted, delta=in_steps(0.3)))
    assert (finding.channel, finding.check) == ("delta", "delay")
    assert finding.measured == pytest.approx(0.3, abs=0.03)


def test_without_a_pose_a_late_yaw_rate_is_told_by_two_channels_and_left_open_by_one(planted):
    late = {"r": lambda t, v: np.interp(t - 0.3, t, v)}
    pose = ("X", "Y", "yaw")
    finding = only(ingested(planted, without=pose, **late))
    assert (finding.channel, finding.check) == ("r", "delay") and "against delta and ay" in finding.text
    assert finding.measured == pytest.approx(0.3, abs=0.03)
    one = only(ingested(planted, without=pose, delta=lambda t, v: 0.01 * np.sin(40.0 * t), **late))
    assert one.channel == "ay" and "Or r is as much late" in one.text
    assert "kind: command" not in one.text
    early = only(ingested(planted, without=(*pose, "ay"), delta=lambda t, v: np.interp(t + 0.15, t, v)))
    assert early.measured == pytest.approx(-0.15, abs=0.03)
    assert "If delta is a command, which comes first, say `kind: command` in the map. Or r is as" in early.text


def test_a_v_y_that_nothing_judges_is_beyond_every_car_in_millimetres(planted):
    def sideways(t, v):
        return 1e3 * v * np.sin(3.0 * t)  # of no car that turns like this one

    found = ingested(planted, without=("X", "Y", "yaw"), vy=sideways).findings
    assert {(f.channel, f.check) for f in found} == {("vy", "range")}
    assert "v_y/v_x reaches" in found[0].text


def test_a_late_steer_angle_is_told_by_the_yaw_rate_where_the_angle_of_v_y_wanders(planted):
    def wandering(t, v):
        return v - (0.012 + 0.006 * np.sin(0.05 * t)) * planted.at("vx", t)

    found = ingested(planted, vy=wandering, delta=lambda t, v: planted.at("delta", t - 0.2)).findings
    delay = next(finding for finding in found if finding.check == "delay")
    assert delay.channel == "delta" and "for the yaw rate" in delay.text
    assert delay.measured == pytest.approx(0.2, abs=0.04)


def test_a_delay_of_the_steer_angle_that_does_not_show_is_among_what_could_not_be_judged(planted):
    noise = 0.02 * np.random.default_rng(1).standard_normal(4500)
    found = ingested(
        planted, without=("X", "Y", "yaw"), vy=lambda t, v: np.sin(3.0 * t), delta=lambda t, v: v + noise[: len(t)]
    )
    assert found.findings == () and "delay of delta" in {unjudged.check for unjudged in found.unjudged}


def test_wheel_speeds_in_rad_per_s_of_another_radius_are_told_with_both(planted):
    """The wheel is 20 % larger than the file says: neither a unit nor a radius alone explains the factor."""
    corners = ("fl", "fr", "rl", "rr")
    turning = {f"wheel_speed_{c}": lambda t, v: v / (1.2 * planted.vehicle.wheel_radius) for c in corners}
    found = ingested(planted, wheels=dict(zip(corners, corners, strict=True)), **turning)
    text = next(f.text for f in found.findings if f.channel == "wheel_speed_fl")
    assert "is in rad/s, and the wheel rolls on another radius" in text and "set `unit: rad/s`" in text


def test_a_torque_that_a_doubtful_speed_cannot_judge_is_listed(planted):
    """v_x 6 % too large against the path: T without the brakes is not silently passed."""
    corners = ("fl", "fr", "rl", "rr")
    true_wheels = {f"wheel_speed_{c}": lambda t, v: planted.at("vx", t) for c in corners}
    wheels = dict(zip(corners, corners, strict=True))
    without_brakes = {"vx": lambda t, v: 1.06 * v, "T": lambda t, v: np.maximum(v, 0.0)}
    found = ingested(planted, wheels=wheels, **true_wheels, **without_brakes)
    assert any("T where the car is driven" in entry.check for entry in found.unjudged)


def test_a_place_of_v_y_that_a_noisy_heading_only_suggests_is_listed(planted):
    """2.2 m behind the CG, beside a heading that sways by 0.7 deg, as of two antennas."""
    sway = {"yaw": lambda t, v: v + 0.012 * np.sin(2.5 * t)}
    found = ingested(planted, vy=lambda t, v: v - 2.2 * planted.at("r", t), without=("ay",), **sway)
    (reason,) = (u.reason for u in found.unjudged if "may be measured" in u.reason)
    assert "2.2" in reason.split(" m behind the CG")[0] and "position: {x: -2.2" in reason
    assert not any("may be measured" in u.reason for u in ingested(planted, without=("ay",), **sway).unjudged)


def test_a_sign_of_v_y_is_not_blamed_alone_where_a_place_fits_better(planted):
    """In a slow slalom v_y of a place behind the rear axle goes with the path, turned."""
    blamed = ConsistencyFinding("sign", "vy", "vy is right-positive.")
    beside = or_its_place(blamed, SimpleNamespace(possible_arm=1.4, vehicle=planted.vehicle))
    assert "Or it is measured 1.40 m behind the CG" in beside.text and "`position: rear_axle`" in beside.text
    assert or_its_place(blamed, SimpleNamespace(possible_arm=0.0, vehicle=planted.vehicle)) == blamed


def test_a_speed_in_km_h_makes_no_steer_angle_early():
    """Before v_x has its unit the place of v_y is not judged, and its angle passed for a delay of 0.1 s."""
    samples = Path(__file__).resolve().parents[2] / "sample_logs"
    car = read_vehicle(samples / "road_car.yaml")
    drive = assemble_drive(open_recording(samples / "road_handling_moderate.mcap"), read_map("split_sim"), car).drive
    columns = dict(drive.columns) | {"vx": 3.6 * drive["vx"], "yaw": np.degrees(drive["yaw"])}
    for side, name in ((-0.8, "fl"), (0.8, "fr"), (-0.8, "rl"), (0.8, "rr")):
        columns[f"wheel_speed_{name}"] = drive["vx"] + side * drive["r"]
    table = TableRecording("log", Path("log"), {c: RawSignal(c, None, v, None) for c, v in columns.items()})
    found = assemble_drive(table, read_map("canonical"), car).quality.consistency.findings
    assert [(finding.channel, finding.check) for finding in found] == [("vx", "scale"), ("yaw", "scale")]


def test_a_car_that_stands_is_said_to_stand_and_no_channel_is_blamed(planted):
    """Four channels of a standing car were "probably not measured", and the map was to be corrected."""
    rest = np.random.default_rng(5)
    still = {name: lambda t, v: np.zeros(len(t)) for name in ("vy", "ax", "ay", "r", "T", "delta")}
    still["vx"] = lambda t, v: 0.004 + 0.002 * rest.standard_normal(len(t))
    still["yaw"] = lambda t, v: np.full(len(t), 0.7)
    still |= {name: lambda t, v: 0.01 * rest.standard_normal(len(t)) for name in ("X", "Y")}
    found = ingested(planted, **still)
    finding = only(found)
    assert (finding.check, finding.channel) == ("standing", "vx") and "the car stands from end to end" in finding.text
    # Where the path goes on, it is the speed that is not measured.
    moving = {"vx": lambda t, v: np.zeros(len(t))}
    assert any("vx never changes" in finding.text for finding in ingested(planted, **moving).findings)


def test_checks_that_fail_for_one_reason_share_a_line_and_much_steering_is_explained():
    reasons = (("a", "hardly any turns"), ("b", "too short"), ("c", "hardly any turns"))
    slope = SimpleNamespace(slope=1.65)
    steering = SimpleNamespace(name="delta against the steady steer angle", leaf="delta", slope=slope)
    report = SimpleNamespace(
        duration=1.0,
        recorded=1.0,
        channels=(),
        segments=1,
        clock="",
        skipped=(),
        assumed=(),
        contradictions=(),
        delays=(),
        warnings=(),
        unverified="",
        consistency=Consistency((), (steering,), tuple(Unjudged(*one) for one in reasons)),
    )
    lines = render_quality(report).splitlines()
    assert "  a; c: hardly any turns" in lines and "  b: too short" in lines
    said = lines[1]
    assert "angle 1.65). Understeer asks for more steer angle" in said and said.endswith("3 could not be judged")
