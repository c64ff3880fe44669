"""Inputs that keep their value between samples: integration, memory and evidence against slow references."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.effects.recording import first_order_from_means, first_order_response, over_samples
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import recorded_inputs
from tests.factories import one_run, road_car

PERIOD, FINE = 0.02, 40


def staircase(rng: np.random.Generator, count: int, size: float) -> np.ndarray:
    return size * np.cumsum(rng.standard_normal(count)) / np.sqrt(count)


def finely(values: np.ndarray) -> np.ndarray:
    """The same staircase on a clock FINE times as fast, where a step is a line of a 40th of the sample."""
    return np.repeat(values, FINE)


def test_a_staircase_is_integrated_as_a_staircase():
    """Held inputs over 12 samples equal many short stretches of constant input, and straight lines do not."""
    rng = np.random.default_rng(3)
    model, start = SingleTrack(road_car()), np.array([[20.0, 0.0, 0.0]])
    torque, steer = 400.0 + staircase(rng, 13, 600.0), staircase(rng, 13, 0.05)
    state = start
    for k in range(12):
        constant = [np.full((1, 2), value[k]) for value in (torque, steer)]
        state = integrate_recorded(model, state, *constant, PERIOD, 30)
    held = integrate_recorded(model, start, torque[None], steer[None], PERIOD, 30, held=("T", "delta"))
    lines = integrate_recorded(model, start, torque[None], steer[None], PERIOD, 30)
    np.testing.assert_allclose(held, state, rtol=1e-12)
    assert np.abs(lines - state).max() > 1e3 * np.abs(held - state).max() + 1e-4


@pytest.mark.parametrize("delay", [0.0, 0.013, 0.034])
def test_lag_and_delay_of_a_staircase_are_exact(delay):
    """The lag's state at samples and the delayed torque's mean over each equal those on a finer clock."""
    rng = np.random.default_rng(5)
    count, tau = 60, 0.05
    torque = 300.0 + staircase(rng, count, 500.0)
    velocity = np.tile([20.0, 0.0, 0.0], (count, 1))
    terms = [CATALOGUE["drive_delay"]({"delay": delay}), CATALOGUE["drive_lag"]({"tau": tau})]
    model, clock = SingleTrack(road_car(), terms), Recording.single(PERIOD, count)
    found = recorded_inputs(model, velocity, torque, np.zeros(count), clock, held=("T",))
    late = np.concatenate([np.full(4 * FINE, torque[0]), finely(torque)])
    late = late[4 * FINE - round(delay / PERIOD * FINE) :][: count * FINE]
    state, states = torque[0], []
    for k, value in enumerate(late):
        if k % FINE == 0:
            states.append(state)
        state = value + (state - value) * np.exp(-PERIOD / FINE / tau)
    means = late.reshape(count, FINE).mean(axis=1)
    np.testing.assert_allclose(found.torque, means, rtol=1e-12)
    # A step inside a sample is told by its mean: the state errs by what a step's place does over a fifth of tau.
    tolerance = 1e-10 if delay == 0.0 else 0.05 * np.abs(np.diff(torque)).max() * PERIOD / tau
    np.testing.assert_allclose(found.situation.states[:, 0], states, atol=tolerance)


def test_the_mean_of_a_response_is_the_response_to_means():
    """A lag of a staircase, averaged over samples, equals the lag of lines between the samples' middles."""
    rng = np.random.default_rng(8)
    count, tau = 50, 0.03
    steps, clock = staircase(rng, count, 1.0), Recording.single(PERIOD, count)
    fine = finely(steps)
    state, out = steps[0], []
    share = PERIOD / FINE / tau
    for value in fine:
        # The mean of an exponential over its step, in closed form.
        out.append(value + (state - value) * -np.expm1(-share) / share)
        state = value + (state - value) * np.exp(-share)
    means = np.reshape(out, (count, FINE)).mean(axis=1)
    np.testing.assert_allclose(first_order_response(steps, 1.0 / tau, clock), means, atol=1e-12)
    at_rows = first_order_from_means(steps, 1.0 / tau, clock)
    assert at_rows[0] == steps[0]
    reached = at_rows[-1] + (steps[-1] - at_rows[-1]) * -np.expm1(-PERIOD / tau)
    np.testing.assert_allclose(reached, state, rtol=1e-12)


def test_means_of_straight_lines_lie_halfway_and_end_with_a_segment():
    values = np.array([0.0, 1.0, 4.0, 10.0, 20.0])
    clock = Recording(PERIOD, ((0, 3), (3, 5)))
    np.testing.assert_array_equal(over_samples(values, clock), [0.5, 2.5, 4.0, 15.0, 20.0])


def test_windows_resume_from_the_memory_of_a_staircase():
    """A whole run equals its second half begun from `recorded_inputs`, lag and relaxation included."""
    rng = np.random.default_rng(2)
    count = 100
    terms = [CATALOGUE["drive_lag"]({"tau": 0.08}), CATALOGUE["steer_lag"]({"tau": 0.06})]
    model, clock = SingleTrack(road_car(), terms), Recording.single(PERIOD, count + 1)
    torque, steer = 300.0 + staircase(rng, count + 1, 300.0), staircase(rng, count + 1, 0.03)
    start = np.array([[20.0, 0.0, 0.0]])
    both = {"held": ("T", "delta")}
    states = [start]
    for k in range(1, count + 1):
        inputs = torque[None, : k + 1], steer[None, : k + 1]
        states.append(integrate_recorded(model, start, *inputs, PERIOD, 4, **both))
    velocity = np.concatenate(states)
    recorded = recorded_inputs(model, velocity, torque, steer, clock, **both)
    half = count // 2
    resumed = integrate_recorded(
        model,
        velocity[half : half + 1],
        torque[None, half:],
        steer[None, half:],
        PERIOD,
        4,
        recorded.situation.at(np.array([half])),
        held=recorded.held,
    )
    # RK4 with 5 ms steps follows lags of 60 ms to about 1e-6.
    np.testing.assert_allclose(resumed[0], velocity[-1], atol=2e-5)


def test_compiled_labels_agree_with_the_reference_for_every_course_of_the_inputs():
    from split_cli.learning.labels import nominal_errors

    rng = np.random.default_rng(4)
    count = 200
    columns = {
        "vx": 20.0 + staircase(rng, count, 1.0),
        "vy": staircase(rng, count, 0.3),
        "r": staircase(rng, count, 0.2),
        "T": staircase(rng, count, 500.0),
        "delta": staircase(rng, count, 0.05),
    }
    plain = one_run(columns, PERIOD, "plain")
    model, starts = SingleTrack(road_car()), np.arange(0, 190, 3)
    found = {}
    for held in ((), ("T",), ("delta",), ("T", "delta")):
        drive = plain.with_held(held)
        found[held] = nominal_errors(model, drive, starts, 4)
        slow = nominal_errors(model, drive, starts, 4, compiled=False)
        np.testing.assert_allclose(found[held], slow, rtol=1e-9, atol=1e-9)
    assert np.abs(found[("T",)] - found[()])[:, 0].max() > 0.01
    assert np.abs(found[("delta",)] - found[()])[:, 1].max() > 0.01


def test_a_stated_course_is_kept_in_files_and_a_wrong_one_is_told(tmp_path):
    from split_cli.errors import DriveError
    from split_cli.logs.drive import DriveMetadata, read_drive, unstated_inputs, write_drive

    metadata = DriveMetadata(between={"T": "held", "r": "held"})
    drive = one_run({"vx": np.zeros(5)}, PERIOD, "d", metadata=metadata)
    write_drive(drive, tmp_path / "d.parquet")
    back = read_drive(tmp_path / "d.parquet")
    assert back.held == ("T",)
    assert "--held delta" in unstated_inputs([back])[0]
    assert read_drive(tmp_path / "d.parquet", ("delta",)).held == ("T", "delta")
    stated = DriveMetadata(between={"T": "held", "delta": "continuous"})
    assert not unstated_inputs([replace(back, metadata=stated)])
    with pytest.raises(DriveError, match="'vx' cannot be held"):
        read_drive(tmp_path / "d.parquet", ("vx",))


def test_drives_that_are_compared_read_their_commands_in_one_way():
    """A recording beside a copy of itself without that statement was called 5 ms late: half a sample."""
    from split_cli.logs.drive import DriveMetadata, with_inputs_alike

    def drive(name: str, **between: str) -> Drive:
        return one_run({"vx": np.zeros(5)}, PERIOD, name, metadata=DriveMetadata(between=between))

    silent, stated, other = drive("a"), drive("b", T="held", delta="continuous"), drive("c", T="continuous")
    groups, notes = with_inputs_alike([[silent], [stated], []])
    assert [one.metadata.between for group in groups for one in group] == [stated.metadata.between] * 2
    assert groups[2] == [] and notes == (
        "a does not say what T does between samples: held, as in b",
        "a does not say what delta does between samples: continuous, as in b",
    )
    # Statements that contradict each other stand, and are told; nothing stated stays so.
    groups, notes = with_inputs_alike([[stated], [other]])
    assert groups[0][0].held == ("T",) and groups[1][0].held == () and "--held T" in notes[0]
    assert with_inputs_alike([[silent], [silent]])[1] == ()
