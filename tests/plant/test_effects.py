"""Effects that `split simulate` conceals: each does what its name says, and nothing at its neutral value."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import SplitError
from split_cli.logs.drive import read_drive
from split_cli.plant.cars import F1TENTH_CAR
from split_cli.plant.effects import EFFECTS, Setting, apply_effects, parse_effect
from split_cli.plant.faults import SOUND
from split_cli.plant.road import Road
from split_cli.plant.sensors import perfect, sensors_of
from split_cli.workflows.simulate import SimulateSettings, simulate_log

QUICK = SimulateSettings(
    car="f1tenth_car", track="f1tenth", duration=6.0, aggressiveness=0.8, seed=3, instruments="perfect"
)
SOUND_SETTING = Setting(F1TENTH_CAR, Road(), SOUND, perfect(sensors_of("f1tenth_car")), 52.0)

# An effect that can be felt in this car, and the value at which it is the sound car.
FELT = {
    "steer_offset": ("offset=0.02", "offset=0"),
    "steer_gain": ("gain=0.9", "gain=1"),
    "steer_delay": ("delay=0.04", "delay=0"),
    "steer_lag": ("tau=0.08", "tau=0.03"),
    "steer_backlash": ("width=0.03", "width=0"),
    "drive_gain": ("drive_gain=0.9,brake_gain=0.8", ""),
    "drive_delay": ("delay=0.04", "delay=0"),
    "drive_lag": ("tau=0.1", "tau=0.03"),
    "mass": ("scale=1.1", "scale=1"),
    "yaw_inertia": ("scale=1.3", "scale=1"),
    "cg_shift": ("dx=0.02", "dx=0"),
    "load_transfer": ("cg_height=0.12", "cg_height=0.074"),
    "aero_drag": ("drag=0.02", "drag=0"),
    "aero_downforce": ("front=0.05,rear=0.05", "front=0,rear=0"),
    "yaw_moment_differential": ("locking=0.01", "locking=0.0001"),
    "rolling_resistance": ("force=0.3", "force=0"),
    "tire_stiffness": ("front_scale=0.9", ""),
    "tire_relaxation": ("length=0.15", "length=0.05"),
    "combined_slip": ("strength=0", "strength=1"),
    "friction_scale": ("scale=0.9", "scale=1"),
    "friction_patch": ("scale=0.8,s_start=0,s_end=30", "scale=1,s_start=0,s_end=30"),
    "grip_fade": ("final_loss=0.2,tau=3", "final_loss=0,tau=3"),
    "road_grade": ("amplitude=0.03", "amplitude=0"),
    "road_bank": ("amplitude=0.03", "amplitude=0"),
    "wind": ("wx=5,wy=3", "wx=0,wy=0"),
    "sensor_delay": ("delay=0.03", "delay=0"),
    "sensor_misalignment": ("angle=0.02", "angle=0"),
    "torque_bend": ("bend=0.3", "bend=0"),
    "torque_steer": ("angle=0.05", "angle=0"),
    "brake_fade": ("loss=0.5", "loss=0"),
}


def simulated(folder, *effects, settings=QUICK):
    """Return what perfect sensors recorded and the truth."""
    simulate_log(replace(settings, effects=effects), folder / "log.parquet", truth=folder / "truth.parquet")
    return read_drive(folder / "log.parquet"), read_drive(folder / "truth.parquet")


@pytest.fixture(scope="module")
def sound(tmp_path_factory):
    return simulated(tmp_path_factory.mktemp("sound"))[0]


def test_every_effect_is_tried_here():
    assert set(FELT) == set(EFFECTS)


@pytest.mark.parametrize("name", sorted(FELT))
def test_an_effect_moves_the_car_and_its_neutral_value_does_not(name, sound, tmp_path):
    felt, neutral = (simulated(tmp_path, f"{name}:{values}")[0] for values in FELT[name])
    # Faults take the compiled code another way round; all else is the same arithmetic on the same numbers.
    np.testing.assert_allclose(neutral["vx"], sound["vx"], atol=1e-9)
    np.testing.assert_allclose(neutral["r"], sound["r"], atol=1e-9)
    # More than the model car's sensors resolve: 1 mm/s, 1 mrad/s.
    moved = max(np.abs(felt[channel] - sound[channel]).max() for channel in ("vx", "vy", "r"))
    assert moved > 2e-3


def test_actuators_do_what_is_told(tmp_path):
    gain, offset, brake = 0.9, 0.01, 0.8
    _, truth = simulated(
        tmp_path, f"steer_gain:gain={gain}", f"steer_offset:offset={offset}", f"drive_gain:brake_gain={brake}"
    )
    # The car's own lag of 30 ms on the held commands, solved exactly from row to row.
    keep = np.exp(-0.01 / 0.03)
    steer, torque = np.zeros(len(truth)), np.zeros(len(truth))
    steer[0], torque[0] = truth["delta_actual"][0] - offset, truth["T_actual"][0]
    for k in range(len(truth) - 1):
        steer[k + 1] = keep * steer[k] + (1.0 - keep) * gain * truth["delta"][k]
        scaled = truth["T"][k] * (brake if truth["T"][k] < 0.0 else 1.0)
        torque[k + 1] = keep * torque[k] + (1.0 - keep) * scaled
    # Rate limits bend the answer to the largest steps; they act on few rows.
    assert np.quantile(np.abs(steer + offset - truth["delta_actual"]), 0.9) < 2e-3
    assert np.quantile(np.abs(torque - truth["T_actual"]), 0.9) < 0.01 * np.ptp(truth["T_actual"])
    assert truth["T"].min() < -0.3  # there was braking to be scaled


def test_late_sensors_leave_the_commands_on_time(sound, tmp_path):
    log, truth = simulated(tmp_path, "sensor_delay:delay=0.03")
    for channel in ("X", "vx", "vy", "r", "ay"):
        np.testing.assert_allclose(log[channel][3:], truth[channel][:-3], atol=1e-9)
    np.testing.assert_array_equal(log["delta"], sound["delta"])


def test_a_patch_may_lie_across_the_start_line():
    setting = apply_effects(SOUND_SETTING, (parse_effect("friction_patch:scale=0.7,s_start=46,s_end=10"),))
    s = np.arange(512) * 52.0 / 512
    edge = 52.0 / 512
    well_inside = (s > 46.0 + 2 * edge) | (s < 10.0 - 2 * edge)
    well_outside = (s > 10.0 + 2 * edge) & (s < 46.0 - 2 * edge)
    np.testing.assert_allclose(setting.road.friction[well_inside], 0.7)
    np.testing.assert_allclose(setting.road.friction[well_outside], 1.0)
    # Together with a grade, both are there.
    both = apply_effects(setting, (parse_effect("road_grade:amplitude=0.02,waves=2"),))
    np.testing.assert_array_equal(both.road.friction, setting.road.friction)
    np.testing.assert_allclose(both.road.grade, 0.02 * np.sin(4.0 * np.pi * s / 52.0), atol=1e-12)


def test_effects_are_told_in_result_and_truth_and_nowhere_else(tmp_path):
    asked = replace(QUICK, effects=("mass:scale=1.2", "friction_scale:scale=0.9"))
    result = simulate_log(asked, tmp_path / "a.parquet", truth=tmp_path / "truth.parquet")
    assert result.effects == asked.effects
    assert read_drive(tmp_path / "truth.parquet").metadata.quality["effects"] == list(asked.effects)
    # In the log itself nothing gives them away.
    assert b"mass:" not in (tmp_path / "a.parquet").read_bytes()


def test_the_driver_does_not_know_of_them(sound, tmp_path):
    slippery, _ = simulated(tmp_path, "friction_scale:scale=0.85")
    # Who knew would take every corner at the root of 0.85 of the speed: 8 % slower.
    assert np.mean(slippery["vx"]) > 0.98 * np.mean(sound["vx"])


def test_a_lead_in_takes_the_first_seconds_off(sound, tmp_path):
    log, truth = simulated(tmp_path, settings=replace(QUICK, lead_in=1.0))
    assert log["t"][0] == truth["t"][0] == 0.0
    for channel in ("vx", "delta", "ay"):
        np.testing.assert_allclose(log[channel], sound[channel][100:], atol=1e-12)
        np.testing.assert_allclose(log[channel], truth[channel], atol=1e-9)


@pytest.mark.parametrize(
    ("effect", "words"),
    [
        ("sterlag:tau=0.1", "steer_lag"),
        ("steer_lag", "lacks tau"),
        ("steer_lag:tu=0.1", "tau=VALUE"),
        ("steer_lag:tau=much", "no number"),
        ("steer_lag:tau=nan", "between"),
        ("steer_lag:tau=3", "between 0.002 and 1 s"),
        ("mass", "lacks scale"),
    ],
)
def test_effects_at_fault_are_told(effect, words, tmp_path):
    with pytest.raises(SplitError, match=words):
        simulate_log(replace(QUICK, effects=(effect,)), tmp_path / "a.parquet")


def test_a_place_needs_a_track(tmp_path):
    settings = replace(QUICK, track=None, maneuver="step_steer", effects=("road_bank:amplitude=0.1",))
    with pytest.raises(SplitError, match="--track"):
        simulate_log(settings, tmp_path / "a.parquet")
    with pytest.raises(SplitError, match="--lead-in"):
        simulate_log(replace(QUICK, lead_in=60.0), tmp_path / "a.parquet")
