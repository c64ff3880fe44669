"""Resampling: exact for polynomials, of the order claimed, low-passed as claimed, nothing across gaps."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.logs.assembling.assemble import assemble_drive
from split_cli.logs.assembling.clean import CleanSeries, written_on_change
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.assembling.resample import (
    Resampled,
    SampleClock,
    is_sampled_and_held,
    make_grid,
    resample_held,
    resample_together,
    runs_of,
)
from split_cli.logs.assembling.trim import trim
from tests.logs.planted import PlantedDrive, planted_map


def jittered(rng, seconds: float, step: float, jitter: float = 0.5) -> np.ndarray:
    time = np.arange(0.0, seconds, step)
    return time + jitter * step * rng.uniform(-0.5, 0.5, len(time))


def resampled(time: np.ndarray, values: np.ndarray, grid: SampleClock, gap: float) -> Resampled:
    return resample_together(time, [values], grid, gap=gap)[0]


def grid_over(time: np.ndarray, period: float) -> SampleClock:
    return make_grid([[(float(time[0]), float(time[-1]))]], period)[0]


@pytest.mark.parametrize("step", [0.001, 0.002, 0.008, 0.01, 0.02])
@pytest.mark.parametrize("jitter", [0.0, 0.6])
def test_a_line_comes_through_unchanged_at_every_ratio_of_rates_and_to_the_ends(step, jitter):
    time = jittered(np.random.default_rng(0), 4.0, step, jitter)
    grid = grid_over(time, 0.01 if step < 0.01 else step)
    result = resampled(time, 3.0 - 7.0 * time, grid, gap=0.1)
    # Both schemes reproduce cubics, so only rounding remains: 28 times 1e-16 times the condition of the fit.
    np.testing.assert_allclose(result.values, 3.0 - 7.0 * grid.time, atol=1e-9)


def test_equal_clocks_hand_the_samples_through():
    time = 5.0 + 0.01 * np.arange(400)
    values = np.random.default_rng(1).standard_normal(400)
    result = resampled(time, values, grid_over(time, 0.01), gap=0.1)
    np.testing.assert_array_equal(result.values, values)
    assert result.gain == 1.0 and result.autocorrelation == (1.0,) and not result.low_passed


def test_interpolation_is_of_fourth_order():
    def error(step: float) -> float:
        time = np.arange(0.0, 6.0, step)
        grid = grid_over(time + 0.37 * step, step)
        inside = slice(4, -4)
        truth = np.sin(3.0 * grid.time)
        return float(np.max(np.abs(resampled(time, np.sin(3.0 * time), grid, gap=1.0).values - truth)[inside]))

    order = np.log2(error(0.04) / error(0.02))
    # Four nodes: the error falls with the fourth power of the step.
    assert order == pytest.approx(4.0, abs=0.15)


def test_the_low_pass_keeps_what_the_drive_can_show_and_removes_what_would_alias():
    time = np.arange(0.0, 20.0, 0.001)
    grid = grid_over(time, 0.02)

    def amplitude(frequency: float) -> float:
        values = resampled(time, np.sin(2 * np.pi * frequency * time), grid, gap=0.1).values[50:-50]
        return float(np.sqrt(2.0 * np.mean(values**2)))

    assert amplitude(5.0) == pytest.approx(1.0, abs=0.01)  # a tenth of the rate
    assert amplitude(35.0) < 0.03  # would alias to 15 Hz
    assert amplitude(90.0) < 0.01


def test_noise_gain_and_autocorrelation_are_what_noise_itself_shows():
    rng = np.random.default_rng(3)
    time = jittered(rng, 400.0, 0.002)
    grid = grid_over(time, 0.01)
    noise = rng.standard_normal(len(time))
    result = resampled(time, noise, grid, gap=0.1)
    x = result.values[20:-20]
    # 40,000 rows that are correlated over three: the standard error of a correlation is about 0.008.
    assert np.std(x) == pytest.approx(result.gain, rel=0.02)
    for lag, expected in enumerate(result.autocorrelation[:4]):
        assert np.mean(x[: len(x) - lag] * x[lag:]) / np.mean(x * x) == pytest.approx(expected, abs=0.03)
    assert result.low_passed and 0.3 < result.gain < 0.7


def test_nothing_is_interpolated_across_a_gap_and_a_new_segment_starts_there():
    time = np.concatenate([np.arange(0.0, 1.0, 0.01), np.arange(1.5, 3.0, 0.01)])
    spans = [[(float(time[a]), float(time[b - 1])) for a, b in runs_of(time, 0.1)]]
    grid, _ = make_grid(spans, 0.01)
    assert grid.segment.max() == 1
    assert not np.any((grid.time > 0.995) & (grid.time < 1.495))
    everywhere = SampleClock(0.0, 0.01, np.arange(300), np.zeros(300, np.int32))
    values = resampled(time, time, everywhere, gap=0.1).values
    assert np.isnan(values[(everywhere.time > 1.0) & (everywhere.time < 1.49)]).all()


def test_a_step_of_exactly_the_gap_is_still_bridged():
    time = 0.1 * np.arange(50)
    assert runs_of(time, 0.1) == [(0, 50)]


def test_all_segments_share_one_clock():
    grid, _ = make_grid([[(0.003, 1.0), (2.0007, 3.0)], [(0.0, 1.5), (1.9, 2.9)]], 0.01)
    phase = np.mod(grid.time - 0.003 + 1e-9, 0.01)
    assert np.all(phase < 1e-8)
    assert grid.time[grid.segment == 1][0] >= 2.0007 and grid.time[-1] <= 2.9 + 1e-9


def test_a_held_signal_takes_the_last_value_and_goes_stale():
    time, values = np.array([0.0, 0.5, 1.0]), np.array([1.0, 2.0, 3.0])
    grid = SampleClock(-0.1, 0.1, np.arange(20), np.zeros(20, np.int32))
    held = resample_held(time, values, grid, longest=0.55)
    expected = np.select([grid.time < -1e-9, grid.time < 0.5 - 1e-9, grid.time < 1.0 - 1e-9], [np.nan, 1.0, 2.0], 3.0)
    expected[grid.time > 1.551] = np.nan
    np.testing.assert_array_equal(held, expected)


def test_a_held_signal_keeps_its_time_whatever_the_jitter_of_its_stamps():
    """A command of 50 Hz with stamps up to 8 ms early or late: its integral is kept, and no phase is added."""
    rng = np.random.default_rng(3)
    for count in (1, 3):  # samples in a period of the drive
        time = 0.02 / count * np.arange(1500 * count) + rng.uniform(-8e-3, 8e-3, 1500 * count) / count
        values = rng.normal(size=len(time)).cumsum()
        for first in (-8e-3, 8e-3):
            grid = SampleClock(0.2 + first, 0.02, np.arange(1400), np.zeros(1400, np.int32))
            fine = np.arange(0.5, 200.0) / 200.0
            slow = [values[np.searchsorted(time, t + 0.02 * fine, side="right") - 1].mean() for t in grid.time]
            held = resample_held(time, values, grid, longest=0.1)
            np.testing.assert_allclose(held, slow, atol=0.02)


def test_holding_is_told_from_quantisation():
    t = np.arange(0.0, 60.0, 0.01)
    truth = 0.1 * np.sin(0.7 * t)
    assert is_sampled_and_held(np.repeat(truth[::5], 5))
    assert not is_sampled_and_held(np.round(truth / 0.003) * 0.003)  # repeats too, but steps by its resolution
    assert not is_sampled_and_held(truth)


def test_a_dropped_sample_in_a_jittery_fast_signal_does_no_harm():
    rng = np.random.default_rng(5)
    time = jittered(rng, 10.0, 0.004, 0.9)
    time = time[rng.uniform(size=len(time)) > 0.3]
    grid = grid_over(time, 0.01)
    result = resampled(time, np.sin(2.0 * time), grid, gap=0.1)
    # The window spans +-25 ms, its cubic leaves (2 x 0.025)^4/24 = 3e-7; where the clock is too uneven for a cubic
    # a line over at most 20 ms leaves (2 x 0.02)^2/8 = 2e-4.
    error = np.abs(result.values - np.sin(2.0 * grid.time))
    assert np.max(error) < 2e-4 and np.quantile(error, 0.97) < 1e-6


def test_a_short_outage_of_a_fast_signal_is_bridged_not_zeroed():
    time = np.arange(0.0, 4.0, 0.002)
    time = time[(time < 2.0) | (time > 2.09)]
    grid = grid_over(time, 0.01)
    result = resampled(time, 5.0 + time, grid, gap=0.1)
    np.testing.assert_allclose(result.values, 5.0 + grid.time, atol=1e-8)


def _series(time: np.ndarray, values: np.ndarray) -> CleanSeries:
    return CleanSeries("delta", "delta", time, values, float(np.median(np.diff(time))))


def test_what_is_written_only_on_change_is_told_from_regular_messages_and_from_a_sensor_with_jitter():
    t = np.arange(0.0, 60.0, 0.02)
    steps = np.round(0.05 * np.sin(0.3 * t) / 0.01) * 0.01
    changed = np.concatenate([[True], np.diff(steps) != 0.0])
    assert _series(t[changed], steps[changed]).on_change
    # Every sample, and with a drop-out: what is missing there may have been anything.
    kept = (t < 20.0) | (t > 25.0)
    assert not _series(t[kept], steps[kept]).on_change
    rng = np.random.default_rng(1)
    jitter = np.cumsum(rng.exponential(0.02, 500))
    assert not _series(jitter, np.sin(jitter) + 1e-3 * rng.standard_normal(500)).on_change


def test_a_command_of_several_fields_is_written_on_change_though_its_angle_repeats():
    """A message is sent where the speed or the angle changes; neither bursts nor a drop-out is that."""
    t = np.arange(0.0, 60.0, 0.01)
    speed = np.round(5.0 + np.sin(0.2 * t) + np.sin(0.05 * t**1.2), 1)
    angle = np.where(np.sin(0.3 * t) > 0.0, np.round(0.2 * np.sin(0.3 * t), 2), 0.0) + 1e-4 * np.sin(t)
    sent = np.concatenate([[True], (np.diff(speed) != 0.0) | (np.diff(np.round(angle, 2)) != 0.0)])
    command = replace(_series(t[sent], np.round(angle[sent], 3)), command=True)
    assert command.on_change and not replace(command, command=False).on_change
    bursts = np.sort(np.concatenate([0.1 * np.arange(600) + 0.001 * k for k in range(5)]))
    for time in (bursts, t[(t < 20.0) | (t > 25.0)], t + 0.004 * np.sin(7.0 * t)):
        assert not replace(_series(time, np.sin(time)), command=True).on_change


def test_a_steer_angle_that_is_written_only_on_change_is_held_over_straights():
    """Straights of seconds without a sample had been gaps of a command, and an error of a measured angle."""
    planted = PlantedDrive(seconds=60.0)
    channels = ("vx", "vy", "r", "T", "delta")
    for kind in ("command", "measured"):
        log = planted.recording(channels)
        sensor = log.signals["delta"]
        steps = np.round(sensor.values / 0.01) * 0.01
        changed = np.concatenate([[True], np.diff(steps) != 0.0])
        log.signals["delta"] = replace(sensor, time=sensor.time[changed], values=steps[changed])
        made = assemble_drive(log, planted_map(channels, delta={"kind": kind}), planted.vehicle)
        # The last value holds on, but only what all signals cover is a drive.
        assert made.drive["t"][-1] - made.drive["t"][0] > 59.0 - (sensor.time[-1] - sensor.time[changed][-1])
        assert len(made.drive.segments()) == 1
        assert np.max(np.abs(made.drive["delta"] - planted.at("delta", made.drive["t"]))) < 0.0101


@pytest.mark.parametrize("joined", [False, True])
def test_no_value_written_on_change_is_held_over_a_pause_or_into_the_next_run(joined):
    """What the steer angle was at the end of one run had been its value at the beginning of the next one."""
    planted = PlantedDrive(seconds=60.0)
    channels = ("vx", "vy", "r", "T", "delta")
    log = planted.recording(channels)
    for name, signal in log.signals.items():
        kept, values = (signal.time < 25.0) | (signal.time > 33.0), signal.values
        if name == "delta":
            values = np.round(values / 0.01) * 0.01
            kept &= np.concatenate([[True], np.diff(values) != 0.0])
            again = signal.time[kept & (signal.time > 33.0)][0]
        # Behind the pause, the clock goes on or begins again.
        time = np.where(signal.time > 33.0, signal.time - (33.0 if joined else 0.0), signal.time)
        log.signals[name] = replace(signal, time=time[kept], values=values[kept])
    made = assemble_drive(log, planted_map(channels, delta={"kind": "command"}), planted.vehicle)
    time, delta = made.drive["t"], made.drive["delta"]
    first, second = made.drive.segments()
    assert len(made.drive) * made.drive.period > 50.0
    back = time[second.start] - again
    truth = np.concatenate([planted.at("delta", time[first]), planted.at("delta", time[second] - back)])
    assert np.max(np.abs(delta - truth)) < 0.0101


def test_what_a_signal_written_on_change_becomes_in_a_cut_holds_behind_it():
    """What it was before the cut had been held until its next change, seconds later."""
    t = np.arange(0.0, 60.0, 0.02)
    # Turns of ever other lengths up to 30 s, and straight from there on.
    steps = np.where(t < 30.0, np.round(0.05 * np.sin(3.0 * t + np.sin(t)) / 0.01) * 0.01, 0.0)
    changed = np.concatenate([[True], np.diff(steps) != 0.0])
    series = {
        "vx": (RawSeries("vx", "vx", t, np.full(len(t), 10.0)),),
        "delta": (RawSeries("delta", "delta", t[changed], steps[changed]),),
    }
    before = float(steps[t < 20.3][-1])
    assert before != 0.0
    kept, _ = trim(series, 5.0, None, [(20.3, 40.0)], 0.1)
    (delta,) = kept["delta"]
    assert delta.time[0] == 5.0 and delta.values[0] == steps[t <= 5.0][-1]
    assert delta.time[-1] == 40.0 and delta.values[-1] == 0.0
    assert np.array_equal(kept["vx"][0].time, t[(t >= 5.0) & ((t < 20.3) | (t >= 40.0))])
    # A value that comes back in the cut stands once: it is still told as written on change.
    rows = np.flatnonzero(steps[changed] == 0.02)
    pair = next((a, b) for a, b in zip(rows[:-1], rows[1:], strict=True) if b - a > 1)
    at = t[changed]
    kept, _ = trim(series, None, None, [(float(at[pair[0]]) + 0.01, float(at[pair[1]]) + 0.01)], 0.02)
    (delta,) = kept["delta"]
    assert written_on_change(delta.time, delta.values)
