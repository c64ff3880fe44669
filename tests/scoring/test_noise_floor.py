"""The noise floor against Monte Carlo: noise planted on drives that the nominal model predicts perfectly."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.verdict.label_errors import label_errors
from split_cli.learning.features import Z2
from split_cli.learning.labels import compute_labels
from split_cli.logs.drive import Drive, DriveMetadata, NoiseEstimate
from split_cli.scoring.evaluation import HeldOutSamples, pooled_noise_floor
from split_cli.scoring.noise import NoiseFloor, fast_motion, noise_floor
from split_cli.scoring.splits import whole_drive
from split_cli.vehicle.single_track import SingleTrack
from tests.diagnosis.recordings import recorded
from tests.factories import make_drive, make_labels, road_car

CAR = road_car()
SIGMA = {"vx": 0.02, "vy": 0.015, "r": 0.004, "T": 40.0, "delta": 0.002}


@pytest.fixture(scope="module")
def clean() -> Drive:
    """A drive at 100 Hz whose labels are zero up to rounding and RK4."""
    return make_drive(4, segments=60, seconds=4.0, period=0.01, vehicle=CAR)


def noisy(drive: Drive, channels: tuple[str, ...], filter_taps: tuple[float, ...], **metadata) -> Drive:
    """Return the drive with white noise through a filter of unit gain in variance added to channels."""
    rng = np.random.default_rng(11)
    taps = np.array(filter_taps) / np.linalg.norm(filter_taps)
    columns = dict(drive.columns)
    for name in channels:
        white = rng.normal(size=len(drive) + len(taps) - 1)
        columns[name] = columns[name] + SIGMA[name] * np.convolve(white, taps, mode="valid")
    return replace(drive, columns=columns, metadata=DriveMetadata(**metadata))


def autocorrelation(filter_taps: tuple[float, ...]) -> tuple[float, ...]:
    taps = np.array(filter_taps)
    full = np.correlate(taps, taps, mode="full")[len(taps) - 1 :]
    return tuple(full / full[0])


def label_rms(drive: Drive) -> np.ndarray:
    y = compute_labels(drive, CAR, Z2).y
    return np.sqrt(np.nanmean(np.square(y), axis=0))


@pytest.mark.parametrize("taps", [(1.0,), (1.0, 1.0), (1.0, 2.0, 3.0, 3.0, 3.0, 2.0, 1.0)])
@pytest.mark.parametrize("channels", [("vx", "vy", "r"), ("T", "delta"), ("vx", "vy", "r", "T", "delta")])
def test_the_floor_is_what_planted_noise_makes_of_labels(clean, taps, channels):
    known = tuple(
        NoiseEstimate(name, SIGMA[name] if name in channels else 0.0, None, autocorrelation(taps)) for name in SIGMA
    )
    drive = noisy(clean, channels, taps, noise=known)
    floor = noise_floor(SingleTrack(CAR), drive, compute_labels(drive, CAR, Z2))
    assert floor.reason == ""
    # Some 4,700 labels, correlated over a few: their rms scatters by about 1.5 %; 400 windows stand for all, whose
    # gains differ with speed by a few percent; curvature of the tyre enters at some percent of a noise this small.
    np.testing.assert_allclose(floor.rms, label_rms(drive), rtol=0.06)
    # Without the noise nothing would be left: the labels are the noise's alone.
    assert (label_rms(clean) < 0.02 * floor.rms).all()


def test_a_drive_without_notes_has_its_noise_estimated_from_differences(clean):
    drive = noisy(clean, ("vx", "vy", "r"), (1.0,), kinds={"T": "command", "delta": "command"})
    floor = noise_floor(SingleTrack(CAR), drive, compute_labels(drive, CAR, Z2))
    # The median of 24,000 differences gives sigma within 2 %; motion left in third differences adds a little.
    np.testing.assert_allclose(floor.rms, label_rms(drive), rtol=0.08)


def test_a_command_has_no_noise_of_its_own_but_a_measured_input_has(clean):
    known = tuple(NoiseEstimate(name, sigma, None) for name, sigma in SIGMA.items())
    labels = compute_labels(clean, CAR, Z2)
    model = SingleTrack(CAR)
    measured = noise_floor(model, replace(clean, metadata=DriveMetadata(noise=known)), labels)
    kinds = {"T": "command", "delta": "command"}
    commanded = noise_floor(model, replace(clean, metadata=DriveMetadata(noise=known, kinds=kinds)), labels)
    assert (commanded.rms < measured.rms).all()
    silent = (*known[:3], NoiseEstimate("T", 0.0, None), NoiseEstimate("delta", 0.0, None))
    without = noise_floor(model, replace(clean, metadata=DriveMetadata(noise=silent)), labels)
    np.testing.assert_array_equal(commanded.rms, without.rms)


def test_what_cannot_be_told_is_null_or_a_lower_bound_with_the_reason(clean):
    labels = compute_labels(clean, CAR, Z2)
    model = SingleTrack(CAR)
    known = {name: NoiseEstimate(name, sigma, None) for name, sigma in SIGMA.items()}

    def floor_with(**changed: NoiseEstimate):
        noise = tuple({**known, **changed}.values())
        return noise_floor(model, replace(clean, metadata=DriveMetadata(noise=noise)), labels)

    unknown = floor_with(vy=NoiseEstimate("vy", None, None, reason="held samples"))
    assert unknown.rms is None
    assert unknown.norm is None
    assert unknown.reason == "the noise of vy is unknown: held samples"
    bound = floor_with(delta=NoiseEstimate("delta", None, None, reason="recorded in steps of 0.01"))
    assert bound.reason == "a lower bound: without the noise of delta (recorded in steps of 0.01)"
    assert (bound.rms <= floor_with().rms).all()


def test_floors_of_drives_are_pooled_by_squares_and_samples(clean):
    model = SingleTrack(CAR)

    def held(drive: Drive, sigma: float) -> HeldOutSamples:
        noise = tuple(NoiseEstimate(name, sigma * value, None) for name, value in SIGMA.items())
        drive = replace(drive, metadata=DriveMetadata(noise=noise))
        labels = compute_labels(drive, CAR, Z2)
        return HeldOutSamples(drive, whole_drive(drive), labels, labels.z)

    parts = [held(clean, 1.0), held(clean.select(slice(0, 6000)), 3.0)]
    alone = [pooled_noise_floor(model, [part]) for part in parts]
    counts = np.array([len(part.tested) for part in parts])
    expected = np.sqrt(sum(n * f.rms**2 for n, f in zip(counts, alone, strict=True)) / counts.sum())
    np.testing.assert_allclose(pooled_noise_floor(model, parts).rms, expected, rtol=1e-12)


def test_motion_between_labels_is_told_from_noise():
    """Labels every 50 ms see an oscillation of 8 Hz as a jump, but neither noise at the floor nor a slow swing."""
    rng = np.random.default_rng(3)
    t = np.arange(4000) * 0.05
    noise = rng.normal(size=(len(t), 3)) * [0.2, 0.02, 0.05]
    floor = NoiseFloor(np.array([0.2, 0.02, 0.05]))
    slow = 2.0 * np.sin(2 * np.pi * 0.3 * t)[:, None] * [1.0, 0.2, 0.5]
    assert fast_motion(make_labels(np.zeros((len(t), 3)), slow + noise), floor) == ""
    shaken = slow + noise
    shaken[:, 1] += 0.3 * np.sin(2 * np.pi * 8.0 * t)
    told = fast_motion(make_labels(np.zeros((len(t), 3)), shaken), floor)
    # |second difference| of the sine: 0.3 (2 sin(pi 0.4))^2 = 1.085, its rms over sqrt(6): 0.313.
    assert "v_y by 0.31 m/s^2, 16 times" in told
    assert "v_x" not in told
    assert "r by" not in told
    assert fast_motion(make_labels(np.zeros((len(t), 3)), shaken), NoiseFloor(None, "unknown")) == ""
    # Without any noise, what little a slow swing jumps is no finding either.
    assert fast_motion(make_labels(np.zeros((len(t), 3)), slow), NoiseFloor(np.full(3, 1e-9))) == ""


def test_the_floor_of_a_diagnosis_is_this_one_for_white_noise_of_the_velocities_alone():
    """A diagnosis carries noise by the linear model around smoothed states, an evaluation by its integrator."""
    evidence = recorded(4)
    drive = replace(evidence.series.drive, metadata=DriveMetadata(kinds={"T": "command", "delta": "command"}))
    told = label_errors(evidence, (), None, None, np.ones(len(drive), dtype=bool))
    floor = noise_floor(SingleTrack(CAR), drive, replace(told.labels, plain=True))
    # 400 of the windows stand for all, and over 50 ms the second order of the flow adds some permille.
    np.testing.assert_allclose(np.sqrt(told.floor.mean(axis=0)), floor.rms, rtol=0.01)
