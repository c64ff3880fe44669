"""Consistency: each planted fault is named, with its factor; a sound drive says nothing."""

import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.checking.checks import Checks
from split_cli.logs.checking.consistency import Consistency, check_consistency
from split_cli.logs.checking.kinematics import Kinematics, block_interval, fit_linear, fit_slope
from tests.factories import one_run, road_car
from tests.logs.planted import UNITS, PlantedDrive, planted_map

DEGREES = 180.0 / np.pi
NOISE = {"vx": 0.02, "vy": 0.02, "r": 0.003, "yaw": 0.002, "ax": 0.1, "ay": 0.1, "delta": 1e-3, "X": 0.02, "Y": 0.02}


@pytest.fixture(scope="module")
def drive() -> PlantedDrive:
    return PlantedDrive()


def judged(drive: PlantedDrive, channels=tuple(UNITS), **recording) -> Consistency:
    made = assemble_drive(
        drive.recording(channels, noise={**NOISE, **recording.pop("noise", {})}, **recording),
        planted_map(channels),
        drive.vehicle,
    )
    return made.quality.consistency


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_sound_drive_has_no_findings(seed):
    result = judged(PlantedDrive(seed=seed), seed=seed)
    assert result.findings == ()
    assert len(result.relations) == 9  # all of them were measured, none was skipped for want of excitation


def test_delays_of_an_ordinary_logger_are_not_called_faults(drive):
    told = judged(drive, delays={"r": 0.1, "ax": 0.15, "X": 0.2, "Y": 0.2, "delta": 0.1}).findings
    assert {finding.check for finding in told} == {"delay"}
    assert next(f for f in told if f.channel == "ax").measured == pytest.approx(0.15, abs=0.02)


@pytest.mark.parametrize(
    ("fault", "channel", "words", "factor"),
    [
        ({"r": lambda v: v * DEGREES}, "r", "r is in deg/s", DEGREES),
        ({"r": lambda v: -v}, "r", "r is left-handed", -1.0),
        # What autoware reports of some cars: 57 times too large and inverted at once.
        ({"r": lambda v: -v * DEGREES}, "r", "r is in deg/s, and has the opposite sign", -DEGREES),
        ({"vx": lambda v: 3.6 * v}, "vx", "vx is in km/h", 3.6),
        ({"vx": lambda v: v / 0.44704}, "vx", "vx is in mph", 1 / 0.44704),
        ({"yaw": lambda v: -v}, "yaw", "yaw is clockwise positive", -1.0),
        ({"yaw": lambda v: v * DEGREES}, "yaw", "yaw is in deg", 1 / DEGREES),
        ({"delta": lambda v: v * DEGREES}, "delta", "delta is in deg ", DEGREES),
        ({"delta": lambda v: -v}, "delta", "delta is right-positive", -1.0),
        ({"delta": lambda v: 15.0 * v}, "delta", "steering-wheel angle ", 15.0),
        ({"delta": lambda v: -15.0 * v * DEGREES}, "delta", "steering-wheel angle, right-positive, in degrees", -859.4),
        ({"ax": lambda v: v / 9.80665}, "ax", "ax is in g", 1 / 9.80665),
        ({"ay": lambda v: -v}, "ay", "ay is right-positive", -1.0),
        ({"wheel_speed_fl": lambda v: 3.6 * v}, "wheel_speed_fl", "wheel_speed_fl is in km/h", 3.6),
        ({"X": lambda v: v / 0.3048, "Y": lambda v: v / 0.3048}, "X", "X and Y are in ft", 0.3048),
        ({"T": lambda v: v / 8.0}, "T", "torque of engine or motor", 1 / 8.0),
        ({"T": lambda v: -v}, "T", "T is positive when braking", -1.0),
    ],
)
def test_a_wrong_unit_or_sign_is_blamed_on_its_channel_with_the_measured_slope(drive, fault, channel, words, factor):
    result = judged(drive, altered=fault)
    assert [finding.channel for finding in result.findings] == [channel]
    assert words in result.findings[0].text
    # The noise of a ratio of deviations over two minutes is within a few per cent.
    assert result.findings[0].measured == pytest.approx(factor, rel=0.06)


def test_the_shorter_story_wins(drive):
    flipped = {"yaw": lambda v: -v, "delta": lambda v: -v, "ay": lambda v: -v}
    result = judged(drive, ("vx", "vy", "r", "T", "delta", "yaw", "ay"), altered=flipped)
    # r and v_y left-handed explain yaw, delta and ay alike; three channels wrong is the longer story.
    assert {f.channel for f in result.findings} == {"r", "vy"}


SIDES = [
    (1.0, 0.0, "scale", "without the brakes"),
    (0.0, 1.0, "scale", "without the drive"),
    (0.0, 0.7, "scale", "that of the front axle"),  # the car is driven by its rear wheels, and braked 70 % in front
    (1.0, 0.3, "scale", "that of the rear axle"),
    (0.45, 0.75, "scale", "brakes or the other axle are missing"),
    (1.0, 0.7, "uneven", "brakes or the other axle are missing"),  # weak brakes would look alike: no fault
    (0.7376, 0.7376, "factor", "in lbf ft"),
    (1.4, 1.4, "factor", "mass times wheel radius of 6[3-7].* kg m would fit"),  # 1.4 times 1500 kg times 0.31 m
]


@pytest.mark.parametrize(("driving", "braking", "check", "words"), SIDES, ids=str)
def test_a_torque_that_is_not_the_sum_at_the_wheels_is_told_with_its_shares(drive, driving, braking, check, words):
    car = replace(drive.vehicle, drive_split_front=0.0, brake_split_front=0.7)
    altered = drive.recording(noise=NOISE, altered={"T": lambda v: np.where(v > 0.0, driving, braking) * v})
    (finding,) = assemble_drive(altered, planted_map(), car).quality.consistency.findings
    assert (finding.channel, finding.check) == ("T", check) and re.search(words, finding.text)
    told = re.search(r"T is (-?[\d.]+) .* and (-?[\d.]+) .* times where it is braked", finding.text)
    assert [float(share) for share in told.groups()] == pytest.approx([driving, braking], abs=0.05)


@pytest.mark.parametrize(("driving", "braking"), [(1.0, 1.2), (0.87, 0.87), (1.15, 1.15)])
def test_a_torque_that_drive_or_brakes_deliver_not_quite_as_asked_is_the_cars_and_not_the_logs(drive, driving, braking):
    assert judged(drive, altered={"T": lambda v: np.where(v > 0.0, driving, braking) * v}).findings == ()


def test_a_template_without_drag_does_not_make_a_torque_lack_its_brakes():
    """At full throttle a car accelerates less the faster it is: shares were 0.54 and 1.23 by a file without drag."""
    vx, gas, speeds, rates = 15.0, True, [], []
    for _ in range(6000):
        gas = vx < 42.0 if gas else vx < 15.0
        speeds.append(vx)
        rates.append(5.0 * (1.0 - vx / 48.0) if gas else -4.0)
        vx += 0.02 * rates[-1]
    car, vx = replace(road_car(), drag_coefficient=0.0), np.array(speeds)
    needed = car.wheel_radius * car.mass * np.array(rates)
    drag = car.wheel_radius * 1.2 * vx**2
    told = check_consistency(one_run({"vx": vx, "T": needed + drag}, 0.02, "laps"), car, {})
    assert len(told.relations) == 1 and not [f for f in told.findings if f.channel == "T"]


def test_where_nothing_recorded_decides_both_possibilities_are_told(drive):
    channels = ("vx", "vy", "r", "T", "delta", "yaw")
    recording = drive.recording(channels, altered={"yaw": lambda v: -v}, noise=NOISE)
    (finding,) = assemble_drive(recording, planted_map(channels)).quality.consistency.findings
    assert "yaw is clockwise positive" in finding.text and "Or: r is left-handed" in finding.text
    assert "nothing recorded decides" in finding.text


def test_a_factor_of_no_known_unit_is_told_as_such(drive):
    result = judged(drive, altered={"vx": lambda v: 1.13 * v})
    assert result.findings and all("no usual mistake" in f.text for f in result.findings)
    assert any(f.measured == pytest.approx(1.13, rel=0.01) for f in result.findings)


def test_swapped_velocities(drive):
    recording = drive.recording(noise=NOISE)
    recording.signals["vx"], recording.signals["vy"] = recording.signals["vy"], recording.signals["vx"]
    result = assemble_drive(recording, planted_map(), drive.vehicle).quality.consistency
    assert [f.check for f in result.findings] == ["swapped"] and "Exchange" in result.findings[0].text


@pytest.mark.parametrize("bias", [-0.12, 0.2])
def test_a_lateral_velocity_bias_is_measured_on_straights(drive, bias):
    (finding,) = judged(drive, altered={"vy": lambda v: v + bias}).findings
    assert (finding.channel, finding.check) == ("vy", "bias on straights")
    assert finding.measured == pytest.approx(bias, abs=0.01)
    assert f"offset: {-bias:.2f}"[:11] in finding.text


def test_a_lateral_velocity_that_the_path_confirms_has_no_factor_by_the_accelerometer(drive):
    """A receiver's own v_y was called 4.21 times too large: a_y was what did not follow it."""
    slide = drive._splines["vy"](np.arange(0.0, drive.seconds, 0.01), 1)
    given = {"altered": {"ay": lambda v: v - 0.5 * slide}, "noise": {"vy": 0.002, "ay": 0.02}}
    assert "size" not in [f.check for f in judged(drive, **given).findings]
    # Nor has it one beside the mistake of another channel, which is put right before v_y is looked at.
    beside = {**given, "altered": {**given["altered"], "ax": lambda v: v / 9.80665}}
    assert "size" not in [f.check for f in judged(drive, **beside).findings]
    without_path = tuple(channel for channel in UNITS if channel not in ("X", "Y", "yaw"))
    (size,) = [f for f in judged(drive, without_path, **given).findings if f.channel == "vy"]
    assert size.check == "size" and size.measured == pytest.approx(2.0, rel=0.1)


def test_a_lateral_acceleration_bias_is_measured_on_straights(drive):
    (finding,) = judged(drive, altered={"ay": lambda v: v - 0.64}).findings
    assert finding.channel == "ay" and finding.measured == pytest.approx(-0.64, abs=0.03)


def test_the_sign_and_the_place_of_lateral_velocity_follow_from_its_share_of_yaw_rate(drive):
    (flipped,) = judged(drive, altered={"vy": lambda v: -v}).findings
    assert flipped.channel == "vy" and flipped.check == "sign"
    l_r = drive.vehicle.cg_to_rear_axle
    recording = drive.recording(noise=NOISE)
    at_axle = recording.signals["vy"].values - l_r * drive.at("r", recording.signals["vy"].time)
    recording.signals["vy"] = replace(recording.signals["vy"], values=at_axle)
    (placed,) = assemble_drive(recording, planted_map(), drive.vehicle).quality.consistency.findings
    assert placed.check == "place" and "position: rear_axle" in placed.text
    assert placed.measured == pytest.approx(0.0, abs=0.1)
    # Following the advice leaves nothing to find, and gives v_y at the CG back.
    moved = assemble_drive(recording, planted_map(vy={"position": "rear_axle"}), drive.vehicle)
    assert moved.quality.consistency.findings == ()
    np.testing.assert_allclose(moved.drive["vy"], drive.at("vy", moved.drive["t"]), atol=0.15)


@pytest.mark.parametrize("others", [("X", "Y", "yaw", "ay"), ("ay",), ()])
def test_a_lateral_velocity_of_neither_axle_nor_cg_is_told_by_whatever_shows_it(drive, others):
    """Half the way to the rear axle: the path tells, else the accelerometer; the sideslip alone leaves a doubt."""
    half = 0.5 * drive.vehicle.cg_to_rear_axle
    channels = ("vx", "vy", "r", "T", "delta", *others)
    recording = drive.recording(channels, noise=NOISE)
    sensor = recording.signals["vy"]
    moved = sensor.values - half * drive.at("r", sensor.time)
    recording.signals["vy"] = replace(sensor, values=moved)
    found = assemble_drive(recording, planted_map(channels), drive.vehicle).quality.consistency
    if others:
        (placed,) = found.findings
        assert placed.check == "place" and abs(placed.measured - half) < 0.05 + 2.0 * (placed.error or 0.0)
        assert f"position: {{x: -{drive.vehicle.cg_to_rear_axle - placed.measured:.2f}, y: 0.0}}" in placed.text
    else:
        (doubt,) = [one.reason for one in found.unjudged if one.check == "place of v_y"]
        assert found.findings == ()  # no delay of the steer angle either: its identity needs v_y
        assert float(doubt.split("place ")[1].split()[0]) == pytest.approx(half, abs=0.1)


def test_yaw_with_another_zero_is_told_with_its_offset(drive):
    (finding,) = judged(drive, altered={"yaw": lambda v: v + 0.5 * np.pi}).findings
    assert finding.check == "direction" and finding.measured == pytest.approx(-0.5 * np.pi, abs=0.02)


def test_low_excitation_is_said_instead_of_judged(drive):
    still = {channel: (lambda v: 0.0 * v) for channel in ("r", "vy", "ay", "delta", "ax", "T")}
    still["vx"] = lambda v: 0.0 * v + 15.0
    quiet = {"X": lambda v: 15.0 * np.arange(len(v)) * 0.01, "Y": lambda v: 0.0 * v, "yaw": lambda v: 0.0 * v}
    noise = {channel: 0.2 * sigma for channel, sigma in NOISE.items()}
    recording = drive.recording(altered={**still, **quiet})
    rng = np.random.default_rng(0)
    for name, sigma in noise.items():
        signal = recording.signals[name]
        recording.signals[name] = replace(
            signal, values=signal.values + sigma * rng.standard_normal(len(signal.values))
        )
    result = assemble_drive(recording, planted_map(), drive.vehicle).quality.consistency
    assert [f for f in result.findings if f.check != "constant"] == []
    assert {"r against dyaw/dt", "a_x against dv_x/dt - v_y r", "delta against the steady steer angle"} <= {
        u.check for u in result.unjudged
    }


def test_a_channel_that_never_changes_is_said(drive):
    result = judged(drive, altered={"vy": lambda v: 0.0 * v}, noise={"vy": 0.0})
    assert any(f.check == "constant" and f.channel == "vy" for f in result.findings)


POSE = ("X", "Y", "yaw", "delta", "ay")


def judged_from_pose(drive: PlantedDrive, **recording) -> Consistency:
    """A recording of pose and inputs only, as motion capture gives it: velocities are derived."""
    made = assemble_drive(
        drive.recording(POSE, noise={"X": 1e-3, "Y": 1e-3, "yaw": 2e-4, "delta": 1e-4, "ay": 0.02}, **recording),
        planted_map(POSE),
        drive.vehicle,
        IngestSettings(derive=("velocity-from-pose", "torque-from-acceleration")),
    )
    return made.quality.consistency


def test_a_recording_of_pose_and_inputs_is_judged_by_its_derived_motion(drive):
    result = judged_from_pose(drive)
    assert result.findings == ()
    assert {relation.name for relation in result.relations} >= {
        "dyaw/dt against the turning of X, Y",
        "delta against the steady steer angle",
        "a_y against v_x r",
    }


@pytest.mark.parametrize(
    ("channel", "words", "factor"),
    [
        ("delta", "delta is right-positive", -1.0),
        ("delta", "delta is in deg", DEGREES),
        ("ay", "ay is in g", 1.0 / 9.80665),
        ("yaw", "yaw is clockwise positive", -1.0),
    ],
)
def test_a_mistake_beside_a_pose_is_blamed_on_the_recorded_channel(drive, channel, words, factor):
    found = judged_from_pose(drive, altered={channel: lambda values: values * factor}).findings
    assert [f.channel for f in found] == [channel]
    assert words in found[0].text


def test_a_lateral_velocity_that_is_mostly_error_contradicts_the_path(drive):
    """An error of 0.1 rad beside a sideslip of some 0.01 rad; a smaller one only hides the relation."""
    t = np.arange(0.0, drive.seconds, 0.01)
    wave = np.sin(2.0 * np.pi * t / 7.3)
    found = judged(drive, altered={"vy": lambda v: v + 1.5 * wave}).findings
    assert [(f.check, f.channel) for f in found] == [("contradiction", "vy")]
    assert "does not follow the path" in found[0].text and "--derive velocity-from-pose" in found[0].text
    assert judged(drive, altered={"vy": lambda v: v + 0.1 * wave}).findings == ()


def test_a_course_over_ground_is_told_from_a_yaw_by_the_slip_that_tyres_need(drive):
    """The course is yaw + sideslip; with it for yaw a derived v_y would be zero, whatever the car does."""
    t = np.arange(0.0, drive.seconds, 0.01)
    sideslip = np.arctan2(drive.at("vy", t), drive.at("vx", t))
    found = judged(drive, altered={"yaw": lambda v: v + sideslip}).findings
    assert ("course", "yaw") in [(f.check, f.channel) for f in found]
    # At the rear axle a rolling car has no sideslip, but its tyres have: that is a yaw.
    yaw, ahead = drive.at("yaw", t), -drive.vehicle.cg_to_rear_axle
    moved = {"X": lambda v: v + ahead * np.cos(yaw), "Y": lambda v: v + ahead * np.sin(yaw)}
    assert "course" not in {f.check for f in judged(drive, altered=moved).findings}


@pytest.mark.parametrize(("sideslip", "turning"), [(0.1, 0.01), (0.0, 0.6)])
def test_at_a_steady_speed_neither_sideslip_nor_corners_are_faults_of_scale(sideslip, turning):
    """At 11 m/s +- 0.1 the speed of a smoothed path varies more by sideslip, or by corners cut, than v_x does."""
    t = np.arange(0.0, 60.0, 0.01)
    vy, r = 11.0 * sideslip * np.sin(0.4 * t), turning * np.sin(0.2 * t)
    vx = 11.0 + 0.1 * (vy / 1.1) ** 2 - 0.2 * (r / 0.6) ** 2  # it varies with them, as a driver's does
    yaw = np.cumsum(r) * 0.01
    steps = np.stack([vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw)]) * 0.01
    x, y = np.cumsum(steps, axis=1)
    columns = {"vx": vx, "vy": vy, "r": r, "T": np.sin(t), "delta": 0.1 * np.sin(t), "X": x, "Y": y, "yaw": yaw}
    made = one_run(columns, 0.01, "steady")
    assert "scale" not in {finding.check for finding in check_consistency(made, None, {}).findings}


@pytest.mark.parametrize(("speed", "rate"), [((15.0, 8.0), 0.0), ((12.0, 0.0), 0.4)], ids=["straight", "circle"])
def test_a_drive_that_cannot_tell_a_course_from_a_yaw_is_not_said_to_have_one(speed, rate):
    """A simulation without noise, straight ahead or round one circle at one speed: slip and place are one."""
    t = np.arange(0.0, 40.0, 0.02)
    vx, yaw = speed[0] + speed[1] * np.sin(t / 5.0), rate * t
    vy = 1.4 * rate - 0.003 * vx**2 * rate
    X, Y = (np.cumsum(v) * 0.02 for v in (vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw)))
    columns = {
        "t": t,
        "vx": vx,
        "vy": vy,
        "r": rate + 0.0 * t,
        "X": X,
        "Y": Y,
        "yaw": yaw,
        "delta": np.full(len(t), 0.01),
        "T": 100.0 * np.cos(t),
    }
    drive = one_run(columns, 0.02, "sim")
    assert "course" not in {f.check for f in check_consistency(drive, PlantedDrive().vehicle, {}, frozenset()).findings}


def of_a_clock(drive: PlantedDrive, factor: float, begin: float, end: float, altered=(), without=()) -> Consistency:
    """Return what is found where the clock counts `factor` times too fast from `begin` to `end` [s]."""
    recording = drive.recording(noise=NOISE)
    for name, signal in recording.signals.items():
        fast = np.clip(signal.time, begin, end) - begin
        values = np.where(fast % (end - begin) > 0.0, factor, 1.0) * signal.values
        recording.signals[name] = (
            replace(signal, values=values)
            if name in altered
            else replace(signal, time=signal.time + (0.0 if altered else factor - 1.0) * fast)
        )
    channels = tuple(channel for channel in recording.signals if channel not in without)
    return assemble_drive(recording, planted_map(channels), drive.vehicle).quality.consistency


@pytest.mark.parametrize(
    ("factor", "begin", "end", "without"),
    [
        (1.3, 60.0, 120.0, ()),
        (0.8, 30.0, 70.0, ()),
        (1.05, 0.0, 40.0, ()),
        (1.3, 20.0, 110.0, ()),
        (1.3, 60.0, 120.0, ("X", "Y")),
    ],
)
def test_a_clock_that_runs_wrong_for_a_while_is_told_with_its_samples(drive, factor, begin, end, without):
    (found,) = of_a_clock(drive, factor, begin, end, without=without).findings
    assert (found.check, found.channel) == ("clock", "time")
    assert found.measured == pytest.approx(factor, rel=0.01)
    told = found.text.split("from ")[1].split(" s (rows")[0].split(" to ")
    # Its end is told by its own clock.
    assert [float(t) for t in told] == pytest.approx([begin, begin + factor * (end - begin)], abs=1.5)


def test_a_clock_that_is_wrong_throughout_is_told_as_one_mistake(drive):
    (found,) = of_a_clock(drive, 1.3, -1.0, 200.0).findings
    assert (found.check, found.channel) == ("scale", "time") and "too fast" in found.text
    assert found.measured == pytest.approx(1.3, rel=0.01)


@pytest.mark.parametrize("altered", [("vx",), ("r", "vy"), ("vx", "wheel_speed_fl")])
def test_channels_that_are_wrong_for_a_while_are_no_clock(drive, altered):
    assert "time" not in {finding.channel for finding in of_a_clock(drive, 1.3, 60.0, 120.0, altered).findings}


@pytest.mark.parametrize("zeroed", [False, True])
def test_the_error_of_a_slope_is_that_of_slopes_with_a_block_left_out(zeroed):
    rng = np.random.default_rng(5)
    x = 3.0 + np.cumsum(rng.normal(size=1003))
    y = -1.7 * x + rng.normal(size=1003)

    def slope_of(rows):
        a, b = (y[rows], x[rows]) if zeroed else (y[rows] - y[rows].mean(), x[rows] - x[rows].mean())
        return np.array([-np.sqrt(np.sum(a * a) / np.sum(b * b))])

    fitted = fit_slope(y, x, np.ones(1003, dtype=bool), zeroed=zeroed)
    slope, error = block_interval(slope_of, 1003)
    assert fitted.count == 1003
    assert fitted.slope == pytest.approx(slope[0], rel=1e-12)
    assert fitted.error == pytest.approx(error[0], rel=1e-9)


@pytest.mark.parametrize("count", [7, 1003])
def test_coefficients_and_errors_are_those_of_least_squares_with_a_block_left_out(count):
    rng = np.random.default_rng(6)
    # Columns of far different size, as a rate beside an offset: squares of a condition of 1e6 would be felt.
    design = np.stack([1e6 * rng.normal(size=count), rng.normal(size=count), np.ones(count)], axis=1)
    y = design @ [2e-6, -0.7, 3.0] + rng.normal(size=count)
    expected = block_interval(lambda rows: np.linalg.lstsq(design[rows], y[rows], rcond=None)[0], count)
    for found, known in zip(fit_linear(design, y), expected, strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-9)


def test_sideslip_and_turning_go_with_the_path_where_speed_and_direction_change_together():
    """A model car that brakes into its turns: smoothing moves its direction of travel by as much as its sideslip."""
    period = 0.01
    t = np.arange(0.0, 40.0, period)
    vx, r = 3.0 + 1.2 * np.sin(2.0 * t), 1.5 * np.cos(2.0 * t) + 0.4 * np.sin(3.1 * t)
    vy = 0.03 * vx * np.sin(3.1 * t)
    yaw = 0.75 * np.sin(2.0 * t) - 0.4 / 3.1 * np.cos(3.1 * t)
    X, Y = (
        cumulative_trapezoid(vx * np.cos(yaw) - vy * np.sin(yaw), t, initial=0.0),
        cumulative_trapezoid(vx * np.sin(yaw) + vy * np.cos(yaw), t, initial=0.0),
    )
    columns = {"t": t, "vx": vx, "vy": vy, "r": r, "yaw": yaw, "X": X, "Y": Y}
    k = Kinematics(columns, period, [slice(0, len(t))])
    across = fit_slope(k.sideslip(), k.path_across(), k.moving)
    assert across.slope == pytest.approx(1.0, abs=0.03) and across.correlation > 0.995
    plain, without_that = (fit_slope(k.signal("r"), rate, k.moving) for rate in k.course_rates())
    assert abs(without_that.slope - 1.0) < 0.5 * abs(plain.slope - 1.0) and without_that.correlation > 0.995


@pytest.mark.parametrize(("by_slip_speed", "arm"), [(True, 1.5), (True, 2.7), (False, 1.5)])
def test_forces_by_slip_speed_are_told_from_those_by_slip_angle(by_slip_speed, arm):
    """v_y = p r - q v_x a of tyres, and p r - q a of contacts in physics engines, in turns at all speeds."""
    rng, car, t = np.random.default_rng(2), road_car(), np.arange(0.0, 60.0, 0.01)
    vx = 14.0 + 7.0 * np.sin(0.41 * t)
    lateral = 3.5 * np.sin(0.83 * t) * np.sin(0.11 * t + 0.3)
    vy = arm * lateral / vx - (0.07 if by_slip_speed else 0.005 * vx) * lateral
    columns = {"vx": vx, "vy": vy + 0.005 * rng.standard_normal(len(t)), "r": lateral / vx}
    drive = one_run(columns, 0.01)
    fitted, errors = Checks(drive.columns, drive, car, {}).sideslip_fit()
    assert abs(fitted[0] - arm) < max(4.0 * errors[0], 0.05 * arm)


@pytest.mark.parametrize(
    ("factor", "words"),
    [(12.0, "turns of a motor"), (3.6, "is in km/h"), (1.0 / road_car().wheel_radius, "is in rad/s")],
)
def test_wheel_speeds_of_motors_blame_no_speed_of_the_car(drive, factor, words):
    """Four motors behind a reduction: v_x was said to be in m/s though it says km/h, and both accelerations wrong."""
    t = np.arange(0.0, 110.0, 0.01)
    columns = {
        channel: drive.at(channel, t) for channel in ("vx", "vy", "r", "ax", "ay", "delta", "T", "X", "Y", "yaw")
    }
    for corner, side in (("fl", -1), ("fr", 1), ("rl", -1), ("rr", 1)):
        columns[f"wheel_speed_{corner}"] = factor * (columns["vx"] + side * 0.75 * columns["r"])
    found = check_consistency(one_run(columns, 0.01), drive.vehicle, {}).findings
    assert {finding.channel for finding in found} == {f"wheel_speed_{corner}" for corner in ("fl", "fr", "rl", "rr")}
    assert all(words in finding.text and "decides" not in finding.text for finding in found)


def test_channels_that_never_change_have_no_direction_of_travel():
    """A pose that stands still beside a v_x that does not ended in an internal error."""
    columns = {name: np.zeros(1000) for name in ("X", "Y", "yaw")}
    still = one_run({"vx": np.full(1000, 0.7), **columns}, 0.02)
    found = check_consistency(still, road_car(), {}).findings
    assert {f.channel for f in found if "never changes" in f.text} >= {"yaw", "vx"}
    assert not [f for f in found if f.check == "direction"]
