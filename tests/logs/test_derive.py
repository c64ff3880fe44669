"""Derived channels: inverses of the model, planted truth, convergence."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import MapError
from split_cli.logs.assembling.assemble import IngestSettings, assemble_drive
from split_cli.logs.assembling.derivations import derivation_named
from split_cli.logs.assembling.derived_motion import velocity_from_pose
from split_cli.logs.assembling.derived_torque import (
    torque_from_acceleration,
    torque_from_current,
    torque_from_throttle_and_brake,
)
from split_cli.logs.assembling.smoothing import _third_difference_bands, derivative, smooth
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import road_car
from tests.logs.planted import PlantedDrive, planted_map


@pytest.mark.parametrize("kappa", [0.0, 0.4, 1.0])
def test_torque_from_acceleration_inverts_the_nominal_model_at_any_steer_angle(kappa):
    car = road_car(drive_split_front=kappa, brake_split_front=min(1.0, kappa + 0.2), drag_coefficient=0.5)
    rng = np.random.default_rng(0)
    vx, vy, r = rng.uniform(5, 40, 400), rng.uniform(-2, 2, 400), rng.uniform(-1, 1, 400)
    delta, T = rng.uniform(-0.7, 0.7, 400), rng.uniform(-6000, 3000, 400)
    dvx, _, _ = SingleTrack(car).velocity_derivative(vx, vy, r, T, delta)
    back = torque_from_acceleration(dvx - vy * r, vx, vy, r, delta, car)
    # The share of the axles switches with the sign of the sum of forces, not of T: resistance lies between.
    same = np.sign(back) == np.sign(T)
    near_zero = np.abs(T) < car.wheel_radius * 1500.0
    assert np.all(same | near_zero)
    np.testing.assert_allclose(back[same & ~near_zero], T[same & ~near_zero], rtol=1e-9)


def test_pedal_map_and_current():
    T = torque_from_throttle_and_brake(
        np.array([0.0, 0.5, 1.0, 0.0]),
        np.array([0.0, 0.0, 0.0, 2.0e6]),
        np.array([20.0, 20.0, 50.0, 20.0]),
        drive_map=np.array([[0.0, -100.0], [0.5, 800.0], [1.0, 2000.0]]),
        brake_gain=1.5e-3,
        wheel_radius=0.3,
        max_power=250_000.0,
    )
    np.testing.assert_allclose(T, [-100.0, 800.0, 250_000 * 0.3 / 50.0, -100.0 - 3000.0])
    # Gear losses take from the drive and help the brake.
    np.testing.assert_allclose(torque_from_current(np.array([10.0, -10.0]), 0.003, 12.0, 0.9), [0.324, -0.4])


def test_the_banded_penalty_is_that_of_the_dense_third_difference():
    dense = np.diff(np.eye(12), n=3, axis=0)
    expected = dense @ dense.T
    bands = _third_difference_bands(9)
    for offset in range(4):
        np.testing.assert_array_equal(bands[3 - offset, offset:], np.diag(expected, offset))


def test_smoothing_leaves_a_parabola_alone_and_gives_the_noise_back():
    t = np.arange(0.0, 30.0, 0.01)
    parabola = 3.0 - 2.0 * t + 0.5 * t**2
    np.testing.assert_allclose(smooth(parabola), parabola, atol=1e-8)
    rng = np.random.default_rng(0)
    truth = 5.0 * np.sin(0.7 * t)
    noisy = truth + 0.05 * rng.standard_normal(len(t))
    smoothed = smooth(noisy)
    assert np.std(noisy - smoothed) == pytest.approx(0.05, rel=0.05)
    assert np.sqrt(np.mean((smoothed - truth) ** 2)) < 0.05 / 5.0


def test_smoothing_is_the_dense_whittaker_smoother():
    """x - lambda D'(I + lambda DD')^-1 D x equals (I + lambda D'D)^-1 x for one lambda, found by fitting it."""
    rng = np.random.default_rng(1)
    x = np.sin(np.arange(40) * 0.2) + 0.1 * rng.standard_normal(40)
    z = smooth(x)
    dense = np.diff(np.eye(40), n=3, axis=0)
    penalty = dense.T @ dense
    # (I + lambda P) z = x: lambda is the ratio of x - z to P z, in every row.
    lam = float((x - z) @ (penalty @ z) / ((penalty @ z) @ (penalty @ z)))
    np.testing.assert_allclose(np.linalg.solve(np.eye(40) + lam * penalty, x), z, atol=1e-9)


def test_the_derivative_is_of_fourth_order_inside():
    def error(step: float) -> float:
        t = np.arange(0.0, 4.0, step)
        return float(np.max(np.abs(derivative(np.sin(t), step) - np.cos(t))[2:-2]))

    assert np.log2(error(0.1) / error(0.05)) == pytest.approx(4.0, abs=0.1)


def test_velocities_from_a_noisy_pose_follow_the_planted_ones():
    drive = PlantedDrive(seconds=60.0)
    rng = np.random.default_rng(4)
    t = np.arange(0.0, 60.0, 0.01)
    X, Y = (drive.at(name, t) + 0.005 * rng.standard_normal(len(t)) for name in ("X", "Y"))
    yaw = drive.at("yaw", t) + 0.001 * rng.standard_normal(len(t))
    vx, vy, r = velocity_from_pose(X, Y, yaw, 0.01, [slice(0, len(t))])
    inside = slice(100, -100)
    rms = {
        name: float(np.sqrt(np.mean((got - drive.at(name, t))[inside] ** 2)))
        for name, got in (("vx", vx), ("vy", vy), ("r", r))
    }
    # Plain differences of this pose would be off by 0.005 sqrt(2)/0.02 = 0.35 m/s and 0.07 rad/s.
    assert rms["vx"] < 0.02 and rms["vy"] < 0.025 and rms["r"] < 0.006


def test_velocities_of_a_perfect_pose_are_exact_to_the_differences():
    drive = PlantedDrive(seconds=20.0)
    t = np.arange(0.0, 20.0, 0.01)
    got = velocity_from_pose(drive.at("X", t), drive.at("Y", t), drive.at("yaw", t), 0.01, [slice(0, len(t))])
    for name, values in zip(("vx", "vy", "r"), got, strict=True):
        np.testing.assert_allclose(values[2:-2], drive.at(name, t)[2:-2], atol=1e-5)


def test_a_derived_channel_is_marked_and_its_torque_agrees_with_the_planted_one():
    drive = PlantedDrive(seconds=40.0)
    channels = ("vx", "vy", "r", "delta", "ax")
    settings = IngestSettings(derive=("torque-from-acceleration",))
    made = assemble_drive(drive.recording(channels), planted_map(channels), drive.vehicle, settings)
    assert made.drive.metadata.kinds["T"].startswith("derived: torque from measured a_x")
    assert made.drive.metadata.noise_of("T").reason == "derived (torque-from-acceleration)"
    assert any("longitudinal label" in text for text in made.quality.warnings)
    np.testing.assert_allclose(made.drive["T"], drive.at("T", made.drive["t"]), atol=1e-6 * 1700)


def test_torque_from_speed_alone_and_velocities_from_pose_in_one_ingest():
    drive = PlantedDrive(seconds=40.0)
    channels = ("X", "Y", "yaw", "delta")
    settings = IngestSettings(derive=("torque-from-acceleration", "velocity-from-pose"))
    made = assemble_drive(
        drive.recording(channels),
        planted_map(channels, derivations={"torque_from_acceleration": {"acceleration": "vx"}}),
        drive.vehicle,
        settings,
    )
    inside = slice(10, -10)
    for name, tolerance in (("vx", 1e-4), ("vy", 1e-4), ("r", 1e-4), ("T", 5.0)):
        np.testing.assert_allclose(made.drive[name][inside], drive.at(name, made.drive["t"])[inside], atol=tolerance)


def test_a_pose_replaces_velocities_that_are_logged_but_worthless():
    """What an F1TENTH odometry gives: v_y = 0, at the rear axle. The pose is there too."""
    drive = PlantedDrive(seconds=40.0)
    recording = drive.recording(altered={"vy": lambda v: 0.0 * v, "r": lambda v: 1.2 * v})
    l_r = drive.vehicle.cg_to_rear_axle
    for name, share in (("X", np.cos), ("Y", np.sin)):
        signal = recording.signals[name]
        at_axle = signal.values - l_r * share(drive.at("yaw", signal.time))
        recording.signals[name] = replace(signal, values=at_axle)
    rear = {"position": "rear_axle"}
    made = assemble_drive(
        recording,
        planted_map(X=rear, Y=rear, vx=rear, vy=rear, derivations={"velocity_from_pose": {"channels": ["vy", "r"]}}),
        drive.vehicle,
        IngestSettings(derive=("velocity-from-pose",)),
    )
    inside = slice(10, -10)
    for name in ("vx", "vy", "r"):
        np.testing.assert_allclose(made.drive[name][inside], drive.at(name, made.drive["t"])[inside], atol=1e-3)
    assert made.drive.metadata.kinds["vx"] == "measured"
    assert made.drive.metadata.kinds["vy"].startswith("derived")


def test_what_a_derivation_lacks_is_said():
    drive = PlantedDrive(seconds=20.0)
    channels = ("vx", "vy", "r", "delta", "ax")
    recording = drive.recording(channels)
    with pytest.raises(MapError, match="T is required and not mapped.*--derive torque-from-acceleration"):
        assemble_drive(recording, planted_map(channels), drive.vehicle)
    named = replace(
        planted_map(channels),
        channels=tuple(
            replace(one, channel="torque") if one.channel == "ax" else one for one in planted_map(channels).channels
        ),
    )
    with pytest.raises(MapError, match="The map has 'torque', which is no channel: is it meant"):
        assemble_drive(recording, named, drive.vehicle)
    with pytest.raises(MapError, match="needs the vehicle"):
        assemble_drive(recording, planted_map(channels), None, IngestSettings(derive=("torque-from-acceleration",)))
    with pytest.raises(MapError, match="motor_current"):
        assemble_drive(recording, planted_map(channels), drive.vehicle, IngestSettings(derive=("torque-from-current",)))
    with pytest.raises(MapError, match="torque-from-acceleration"):
        derivation_named("torque_from_accelerations")
    misspelt = replace(planted_map(channels), derivations={"torque_from_acceleration": {"aceleration": "ax"}})
    with pytest.raises(MapError, match="unknown key 'aceleration'.*acceleration"):
        assemble_drive(recording, misspelt, drive.vehicle, IngestSettings(derive=("torque-from-acceleration",)))
