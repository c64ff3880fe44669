"""The direction of v_y on straights over time and its correction; friction, delays, spikes beyond the usual."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.quality import EARLIER, render_quality
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.checking.kinematics import Kinematics
from split_cli.logs.checking.steering_zero import steering_zero
from split_cli.logs.checking.straights import Stretch, course_of
from split_cli.logs.drive import write_drive
from split_cli.logs.readers.opening import open_recording
from split_cli.logs.signal_map import read_map
from tests.logs.planted import UNITS, PlantedDrive, planted_map

DERIVE = IngestSettings(derive=("lateral-velocity-from-straights",))
COURSES = {
    "constant": lambda t: np.full_like(t, 0.009),
    "drifting": lambda t: -0.006 + 0.016 * t / 200.0,
    "stepping": lambda t: np.where(t < 90.0, -0.004, 0.011),
    "wandering": lambda t: 0.008 * np.sin(2.0 * np.pi * t / 90.0),
}


@pytest.fixture(scope="module")
def planted() -> PlantedDrive:
    return PlantedDrive(seconds=200.0)


def recorded(planted: PlantedDrive, angle):
    def turned(vy: np.ndarray) -> np.ndarray:
        t = np.arange(len(vy)) * 0.01
        return vy + planted.at("vx", t) * np.tan(angle(t))

    return planted.recording(altered={"vy": turned}, noise={"vy": 0.01})


@pytest.mark.parametrize("kind", COURSES)
def test_a_course_is_told_and_taken_off(planted, kind):
    angle = COURSES[kind]
    raw = assemble_drive(recorded(planted, angle), planted_map(), planted.vehicle)
    told = next(f for f in raw.quality.consistency.findings if f.channel == "vy")
    assert f"As a direction: {kind}" in told.text and "--derive lateral-velocity-from-straights" in told.text
    made = assemble_drive(recorded(planted, angle), planted_map(), planted.vehicle, DERIVE)
    assert made.drive.metadata.kinds["vy"].startswith(f"derived: v_y less its direction on straights ({kind}")
    t = made.drive["t"]
    left = (made.drive["vy"] - planted.at("vy", t)) / planted.at("vx", t)
    before = (raw.drive["vy"] - planted.at("vy", t)) / planted.at("vx", t)
    # Noise of 0.01 m/s and the turning inside a "straight" leave half a milliradian. The straights are 30 s apart:
    # where a step or a wander goes between two of them is not seen.
    most = {"stepping": 2e-3, "wandering": 4e-3}.get(kind, 1e-3)
    assert np.sqrt(np.mean(left**2)) < most < np.sqrt(np.mean(before**2))
    assert made.drive.metadata.noise_of("vy").sigma == pytest.approx(raw.drive.metadata.noise_of("vy").sigma)


def test_a_right_recording_has_no_course(planted):
    made = assemble_drive(recorded(planted, lambda t: 0.0 * t), planted_map(), planted.vehicle)
    assert not [f for f in made.quality.consistency.findings if f.channel == "vy"]


def test_noise_alone_is_constant():
    rng = np.random.default_rng(4)
    kinds = set()
    for _ in range(200):
        stretches = [Stretch(10.0 * i, 3.0, float(a)) for i, a in enumerate(1e-3 * rng.standard_normal(20))]
        kinds.add(course_of(stretches).kind)
    assert kinds == {"constant"}
    assert course_of([]) is None
    assert course_of([Stretch(0.0, 2.0, 0.01)]).at(np.array([-5.0, 50.0])) == pytest.approx([0.01, 0.01])


def test_friction_beyond_the_file_is_told_with_what_the_recording_shows(planted):
    car = planted.vehicle
    # The planted car reaches its own peak on linear tyres; a file with a third of the grip cannot carry that.
    recording = planted.recording()
    weak = replace(
        car,
        front_tire=replace(car.front_tire, D=car.front_tire.D / 5.0, B=car.front_tire.B * 5.0),
        rear_tire=replace(car.rear_tire, D=car.rear_tire.D / 5.0, B=car.rear_tire.B * 5.0),
    )
    made = assemble_drive(recording, planted_map(), weak)
    told = [f for f in made.quality.consistency.findings if f.check == "grip"]
    t = made.drive["t"]
    lateral = np.abs(planted.at("ay", t))
    carried = (weak.front_tire.D + weak.rear_tire.D) / weak.mass
    assert told and np.sum(lateral > 1.1 * carried) > 200
    # For a second at 100 Hz; smoothing over 0.2 s takes 3 % off the peaks.
    assert told[0].measured == pytest.approx(np.sort(lateral)[-100], rel=0.05)
    assert f"a friction of at least {told[0].measured / 9.80665:.2f}" in told[0].text
    # The advice is enough: with tyres so scaled nothing is told.
    by = told[0].measured / carried
    strong = replace(
        weak,
        front_tire=replace(weak.front_tire, D=by * weak.front_tire.D),
        rear_tire=replace(weak.rear_tire, D=by * weak.rear_tire.D),
    )
    assert not [f for f in check_consistency(made.drive, strong, {}).findings if f.check == "grip"]
    sound = assemble_drive(recording, planted_map(), car)
    assert not [f for f in sound.quality.consistency.findings if f.check == "grip"]


def test_a_delay_beyond_the_search_says_what_to_pass(planted):
    settings = IngestSettings(estimate_delays=True)
    few = ("vx", "vy", "r", "T", "delta", "ax")
    recording = planted.recording(few, delays={"ax": 2.4})
    made = assemble_drive(recording, planted_map(few), planted.vehicle, settings)
    told = next(e for e in made.quality.delays if e.channel == "ax")
    assert told.delay == 0.0 and "--delay ax=2.4" in told.refusal
    given = IngestSettings(delays={"ax": 2.4})
    moved = assemble_drive(recording, planted_map(few), planted.vehicle, given).drive
    np.testing.assert_allclose(moved["ax"][:-300], planted.at("ax", moved["t"][:-300]), atol=0.02)


def test_spikes_of_a_measured_steer_angle_go_and_those_of_a_command_stay(planted):
    def spiky(delta: np.ndarray) -> np.ndarray:
        delta = delta.copy()
        delta[[2000, 5000, 5001, 9000]] += 0.5
        return delta

    recording = planted.recording(altered={"delta": spiky})
    made = assemble_drive(recording, planted_map(), planted.vehicle)
    np.testing.assert_allclose(made.drive["delta"], planted.at("delta", made.drive["t"]), atol=2e-3)
    assert next(c for c in made.quality.channels if c.channel == "delta").spikes == 4
    kept = assemble_drive(recording, planted_map(delta={"kind": "command"}), planted.vehicle)
    assert np.count_nonzero(np.abs(kept.drive["delta"] - planted.at("delta", kept.drive["t"])) > 0.3) == 4


def test_steps_of_a_sampled_steer_angle_are_no_spikes(planted):
    def stepped(delta: np.ndarray) -> np.ndarray:
        held = np.repeat(delta[::10], 10)[: len(delta)]
        held[7000:7010] += 0.5
        return held

    made = assemble_drive(planted.recording(altered={"delta": stepped}), planted_map(), planted.vehicle)
    assert next(c for c in made.quality.channels if c.channel == "delta").spikes == 10
    error = made.drive["delta"] - planted.at("delta", made.drive["t"])
    assert np.max(np.abs(error)) < 0.1


def test_a_drive_ingested_again_keeps_what_was_derived_and_assumed(planted, tmp_path):
    channels = tuple(name for name in UNITS if name != "T")
    settings = IngestSettings(derive=("torque-from-acceleration", "lateral-velocity-from-straights"))
    signals = planted.recording(channels)
    bare = replace(signals, signals={n: replace(s, unit=None) for n, s in signals.signals.items()})
    first = assemble_drive(bare, planted_map(channels, delta={"kind": "command"}), planted.vehicle, settings)
    write_drive(first.drive, tmp_path / "first.parquet")
    again = assemble_drive(open_recording(tmp_path / "first.parquet"), read_map("canonical"), planted.vehicle)
    kinds = again.drive.metadata.kinds
    assert kinds["T"].startswith("derived:") and kinds["vy"].startswith("derived:") and kinds["delta"] == "command"
    assert any("vx in m/s" in text and "first ingested" in text for text in again.quality.assumed)
    # Columns of a drive are in SI by definition: nothing is assumed a second time, and the rest takes one line.
    assert set(again.quality.assumed) == {f"{text}{EARLIER}" for text in first.quality.assumed}
    assert render_quality(again.quality).count("first ingested") == 1
    assert set(first.drive.metadata.conversions) <= set(again.drive.metadata.conversions)


@pytest.mark.parametrize("offset", [0.0, 0.035, -0.035])
def test_turns_of_both_hands_tell_the_zero_of_a_steering_that_never_goes_straight(offset):
    t = np.arange(0.0, 60.0, 0.01)
    car = PlantedDrive(seconds=1.0).vehicle
    vx, r = 12.0 + 2.0 * np.sin(0.2 * t), 0.3 * np.sin(0.4 * t) + 0.1 * np.sin(1.1 * t)
    tyres = 0.004 * vx * r + 2e-5 * (vx * r) ** 3
    columns = {"vx": vx, "r": r, "delta": car.wheelbase * r / vx + tyres + offset}
    found = steering_zero(Kinematics(columns, 0.01, [slice(0, len(t))]), car, None)
    assert [round(f.measured, 3) for f in found] == ([offset] if offset else [])
    # Of one hand alone, understeer and zero look the same.
    one_hand = {**columns, "r": np.abs(r), "delta": np.abs(columns["delta"] - offset) + offset}
    assert not steering_zero(Kinematics(one_hand, 0.01, [slice(0, len(t))]), car, None)


def test_a_steering_that_follows_the_yaw_rate_is_late_without_any_v_y(planted):
    """No car turns before it is steered, whatever its tyres."""
    channels = ("vx", "r", "ay", "delta", "T")
    derived = IngestSettings(derive=("lateral-velocity-from-accelerations",))
    for delay in (0.0, 0.2):
        log = planted.recording(channels, delays={"delta": delay}, noise={"delta": 1e-4})
        made = assemble_drive(log, planted_map(channels), planted.vehicle, derived)
        told = [f for f in made.quality.consistency.findings if f.check == "delay"]
        assert [f.channel for f in told] == (["delta"] if delay else [])
        # The car is steered before it yaws; the range says how well the file knows how long before.
        assert not told or (abs(told[0].measured - delay) < told[0].error < 0.06 and "it is steered" in told[0].text)
