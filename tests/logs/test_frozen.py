"""Channels that stand still while the car says otherwise, motion without noise, and steps that are too coarse."""

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.checking.consistency import check_consistency
from split_cli.logs.drive import Drive, read_drive
from split_cli.vehicle.parameters import read_vehicle
from tests.logs.planted import PlantedDrive, planted_map

NOISE = {"X": 0.01, "Y": 0.01, "yaw": 1e-3, "vx": 0.02, "vy": 0.02, "r": 2e-3, "ax": 0.05, "ay": 0.05, "T": 5.0}
NOISE["delta"] = 5e-4


@pytest.fixture(scope="module")
def car() -> PlantedDrive:
    return PlantedDrive(seconds=80.0)


def frozen(first: float, last: float):
    """Return what keeps the value at `first` until `last` [s] of values at 100 Hz."""

    def keep(values: np.ndarray) -> np.ndarray:
        kept = values.copy()
        kept[round(100 * first) : round(100 * last)] = values[round(100 * first)]
        return kept

    return keep


def in_steps(step: float):
    return lambda values: step * np.round(values / step)


def made(car, *, noise=None, altered=None, **entries):
    recording = car.recording(noise=noise, altered=altered)
    return assemble_drive(recording, planted_map(**entries), car.vehicle, IngestSettings())


def stopped(result) -> list[str]:
    return [finding.channel for finding in result.quality.consistency.findings if finding.check == "stopped"]


@pytest.mark.parametrize("channel", ["delta", "T"])
def test_a_command_that_freezes_while_the_car_goes_on_is_named(car, channel):
    noise = {name: size for name, size in NOISE.items() if name != channel}
    result = made(car, noise=noise, altered={channel: frozen(40.0, 48.0)}, **{channel: {"kind": "command"}})
    assert stopped(result) == [channel]
    (text,) = [f.text for f in result.quality.consistency.findings if f.check == "stopped"]
    assert "from t = 40.0 to 48.0 s" in text and "--cut" in text
    assert any(f"{channel} stands still" in remark for remark in result.drive.metadata.remarks)  # `train` repeats it


@pytest.mark.parametrize("channel", ["X", "yaw", "vx", "ax", "delta", "T", "wheel_speed_fl"])
def test_a_measured_channel_without_noise_that_freezes_is_named(car, channel):
    assert stopped(made(car, altered={channel: frozen(40.0, 48.0)})) == [channel]


def test_steady_inputs_and_commands_written_on_change_are_no_fault(car, sample_logs):
    """Circles at one steering, steps of torque and coasting; and commands in steps that the car follows."""
    drive = read_drive(sample_logs / "road_car_tests.parquet")
    found = check_consistency(drive, read_vehicle(sample_logs / "road_car.yaml"), drive.metadata.kinds)
    assert not [f for f in found.findings if f.check == "stopped"]
    coarse = {"delta": in_steps(0.02), "T": in_steps(400.0)}
    kinds = {name: {"kind": "command"} for name in coarse}
    assert stopped(made(car, noise={**NOISE, "delta": 0.0, "T": 0.0}, altered=coarse, **kinds)) == []


def test_a_circle_at_one_steering_and_rising_speed_is_no_fault(car):
    """The car understeers more than its file says: L r/v_x falls by a third while the steering stands still."""
    vehicle, t = car.vehicle, np.arange(0.0, 60.0, 0.01)
    vx = 8.0 + 0.1 * np.maximum(t - 30.0, 0.0)
    # Half a minute of weaving, then the circle.
    delta = np.where(t < 30.0, 0.06 * np.sin(0.8 * t), 0.06 * np.sin(24.0))
    r = delta * vx / (vehicle.wheelbase + (vehicle.understeer_gradient + 0.004) * vx**2)
    columns = {
        "t": t,
        "vx": vx,
        "vy": vehicle.cg_to_rear_axle * r,
        "r": r,
        "T": 100.0 * np.ones_like(t),
        "delta": delta,
    }
    drive = Drive("circle", columns, np.zeros(len(t), dtype=int), 0.01)
    kinds = {"vx": "measured", "vy": "measured", "r": "measured", "T": "command", "delta": "command"}
    found = check_consistency(drive, vehicle, kinds)
    assert not [f for f in found.findings if f.check == "stopped"]


def test_motion_without_noise_is_noted(car):
    notes = " ".join(made(car).quality.warnings)
    assert "without any sensor noise: v_x, v_y and r" in notes
    assert "without any sensor noise" not in " ".join(made(car, noise=NOISE).quality.warnings)


def test_steps_that_are_too_coarse_to_learn_from_are_noted(car):
    coarse = {"vx": in_steps(1.0 / 3.6), "r": in_steps(np.radians(1.0)), "delta": in_steps(np.radians(2.0))}
    notes = [w for w in made(car, noise=NOISE, altered=coarse).quality.warnings if "in steps of" in w]
    assert [note.split(" ")[0] for note in notes] == ["v_x", "r", "delta"]
    assert "0.278 m/s" in notes[0] and "2.3 m/s^2" in notes[0]  # 0.278/sqrt(6)/0.05
    fine = {"vx": in_steps(0.01), "r": in_steps(1e-3), "delta": in_steps(1e-3)}
    assert not [w for w in made(car, noise=NOISE, altered=fine).quality.warnings if "in steps of" in w]
    command = made(car, noise=NOISE, altered={"delta": in_steps(np.radians(2.0))}, delta={"kind": "command"})
    assert not [w for w in command.quality.warnings if "in steps of" in w]


def test_an_input_that_looks_like_a_command_is_asked_about(car):
    noise = {**NOISE, "delta": 0.0}
    told = [w for w in made(car, noise=noise).quality.warnings if "was taken as measured" in w]
    assert [("`kind: command`" in text) for text in told] == [False, True]  # T has noise
    assert not [
        w for w in made(car, noise=noise, delta={"kind": "measured"}).quality.warnings if "delta was taken" in w
    ]
