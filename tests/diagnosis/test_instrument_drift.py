"""How far instruments drift by themselves, against drift that was planted."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.diagnosis.recording.witnesses import build_witnesses
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.instrument_drift import _between, with_drift_tolerances
from split_cli.logs.drive import Drive
from tests.diagnosis.recordings import driven, noisy, prepared
from tests.factories import road_car

POSITION = 0.01  # standard deviation of X and Y [m]
RUNS = 30


def turned(drive: Drive, angles: np.ndarray) -> Drive:
    """Return a drive whose velocity is turned by another angle [rad] in every run."""
    angle, vx, vy = angles[drive.segment], drive["vx"], drive["vy"]
    columns = {"vx": vx - angle * vy, "vy": vy + angle * vx}
    return replace(drive, columns={**drive.columns, **columns})


@pytest.fixture(scope="module")
def drive() -> Drive:
    """Return a drive in stretches of 10 s."""
    return driven(81, runs=RUNS, seconds=8.0, spaced=10.0)


def moved(drive: Drive, places: np.ndarray) -> Drive:
    """Return a drive whose velocity is measured at another place [m] ahead in every run."""
    return replace(drive, columns={**drive.columns, "vy": drive["vy"] + places[drive.segment] * drive["r"]})


def witnesses_of(drive: Drive, seed: int) -> list:
    return build_witnesses(prepared(noisy(drive, seed, position=POSITION)))


def tolerances(ours: list, theirs: list) -> dict[str, dict[str, float]]:
    """Return what is no fault by term in its first variant."""
    case = SimpleNamespace(kinematics=ours, simulated_kinematics=theirs)
    found = {}
    for one in with_drift_tolerances(case, build_candidates(road_car(), ours[0].series)):
        found.setdefault(one.term, {name: limit.tolerance for name, limit in one.ranges.items()})
    return found


def test_the_deviation_between_stretches_is_that_of_random_effects():
    """1000 stretches of 20 windows: 0.3 between beside 1 within; of noise none, but at the level."""
    rng, stretches = (np.random.default_rng(5), np.stack([np.zeros(20_000), np.repeat(np.arange(1000), 20)], axis=1))
    noise = rng.normal(0.0, 1.0, 20_000)
    wander = np.repeat(rng.normal(0.0, 0.3, 1000), 20)
    # A variance of 0.09 is known to (0.09 + 1/20) sqrt(2/1000).
    assert _between(noise + wander, np.ones(20_000), stretches, 1, 0.01) == pytest.approx(0.3, abs=3.0 * 0.0063 / 0.6)
    few = np.stack([np.zeros(160), np.repeat(np.arange(8), 20)], axis=1)
    found = [_between(rng.normal(0.0, 1.0, 160), np.ones(160), few, 0, 0.01) for _ in range(2000)]
    assert np.mean(np.array(found) > 0.0) == pytest.approx(0.01, abs=3.0 * np.sqrt(0.01 * 0.99 / 2000))
    assert _between(noise[:20], np.ones(20), few[:20], 1, 0.01) == 0.0  # a single stretch tells nothing


def test_a_direction_that_wanders_is_no_fault_up_to_twice_its_deviation(drive):
    """An angle of 3 milliradians (rms) from run to run: on one side alone, and not where none was planted."""
    angles = np.random.default_rng(6).normal(0.0, 0.003, RUNS)
    sound, wanders = witnesses_of(drive, 11), witnesses_of(turned(drive, angles), 12)
    found = tolerances(wanders, sound)
    # Some stretches hold parts of two runs, of which the mean is what counts.
    assert found["sensor_misalignment"]["angle"] == pytest.approx(1.96 * np.std(angles), rel=0.25)
    assert found["velocity_bias"]["angle"] == pytest.approx(found["sensor_misalignment"]["angle"], rel=0.1)
    # An angle that grows evenly over 300 s is as large, rms.
    span = np.ptp(drive["t"]) / np.sqrt(12.0)
    drift = found["velocity_bias"]["drift"]
    assert drift * span == pytest.approx(found["sensor_misalignment"]["angle"], rel=0.2)
    assert tolerances(sound, wanders)["sensor_misalignment"]["angle"] == pytest.approx(
        found["sensor_misalignment"]["angle"], rel=0.25
    )
    assert not any(tolerances(sound, sound)["sensor_misalignment"].values())


def test_a_place_of_the_sensor_is_a_fault_beyond_what_its_places_in_stretches_wander_by(drive):
    """Places 0.3 m (rms) from run to run; a sensor 1 m off all along does not wander."""
    places, sound = np.random.default_rng(8).normal(0.5, 0.3, RUNS), witnesses_of(drive, 18)
    wanders = witnesses_of(moved(drive, places), 19)
    for ours, theirs in ((wanders, sound), (sound, wanders)):
        assert tolerances(ours, theirs)["sensor_lever_arm"]["dx"] == pytest.approx(1.96 * np.std(places), rel=0.3)
    assert tolerances(witnesses_of(moved(drive, np.ones(RUNS)), 20), sound)["sensor_lever_arm"]["dx"] == 0.0


def test_a_constant_fault_and_a_steady_drift_are_taken_off(drive):
    for angles in (np.full(RUNS, 0.02), np.linspace(-0.02, 0.02, RUNS)):
        found = witnesses_of(turned(drive, angles), 13)
        assert not any(tolerances(found, found)["sensor_misalignment"].values())


def test_a_bias_of_the_yaw_rate_that_grows_is_taken_off(drive):
    """From 0 to 0.01 rad/s over the whole drive."""
    growing = 0.01 * (drive["t"] - drive["t"][0]) / np.ptp(drive["t"])
    found = witnesses_of(replace(drive, columns={**drive.columns, "r": drive["r"] + growing}), 14)
    assert not any(tolerances(found, found)["yaw_rate_bias"].values())


def late_yaw_rate(drive: Drive, delays: np.ndarray) -> Drive:
    """Return a drive whose yaw rate is late by another time [s] in every run."""
    t, r = drive["t"], drive["r"].copy()
    for run, delay in enumerate(delays):
        own = drive.segment == run
        r[own] = np.interp(t[own] - delay, t[own], drive["r"][own])
    return replace(drive, columns={**drive.columns, "r": r})


def test_a_delay_is_a_fault_beyond_what_delays_of_stretches_wander_by(drive):
    """Delays of 30 ms (rms) from run to run, on one side alone; a delay of 60 ms all along is no drift.

    A channel of any recording may be a millisecond late.
    """
    delays = np.random.default_rng(7).normal(0.06, 0.03, RUNS)
    sound, wanders = witnesses_of(drive, 15), witnesses_of(late_yaw_rate(drive, delays), 16)
    for ours, theirs in ((wanders, sound), (sound, wanders)):
        assert tolerances(ours, theirs)["channel_delay"]["r"] == pytest.approx(1.96 * np.std(delays), rel=0.3)
    constant = witnesses_of(late_yaw_rate(drive, np.full(RUNS, 0.06)), 17)
    assert tolerances(constant, sound)["channel_delay"]["r"] == 0.001
