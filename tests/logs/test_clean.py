"""Cleaning: every kind of bad sample is dropped or moved, and counted."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.errors import LogError
from split_cli.logs.assembling.clean import clean_series, join_clock_resets, longest_repeat
from split_cli.logs.assembling.conversion import RawSeries
from split_cli.logs.assembling.repeated_rows import without_repeated_rows
from split_cli.logs.assembling.synchronize import clean_channels
from tests.logs.planted import planted_map


def series(time, values, channel="vx", delay=0.0) -> RawSeries:
    return RawSeries(channel, channel, np.asarray(time, float), np.asarray(values, float), delay)


def drops(clean) -> dict[str, int]:
    return {drop.reason: drop.count for drop in clean.drops}


def test_every_drop_is_counted_by_reason_and_the_rest_is_as_it_was():
    time = np.arange(200) * 0.01
    values = np.sin(time)
    time[20], values[30], values[31], values[40] = np.nan, np.nan, np.nan, np.inf
    time[50] = time[49]
    time[[80, 81]] = time[[81, 80]]
    values[[80, 81]] = values[[81, 80]]
    clean = clean_series(series(time, values))
    assert drops(clean) == {
        "time not finite": 1,
        "NaN": 2,
        "infinite": 1,
        "out of order, sorted": 1,
        "duplicate time": 1,
    }
    assert np.all(np.diff(clean.time) > 0)
    np.testing.assert_allclose(clean.values, np.sin(clean.time), atol=1e-12)


@pytest.mark.parametrize("piece", [7, 50])
def test_a_long_signal_is_cleaned_piece_by_piece_as_a_whole_one_is(monkeypatch, piece):
    rng = np.random.default_rng(piece)
    yaw = (np.cumsum(rng.normal(0.0, 1.5, 999)) + np.pi) % (2.0 * np.pi) - np.pi
    yaw[rng.random(999) < 0.1] = np.nan
    held = np.repeat(rng.normal(size=333), 3)
    held[[40, 41, 700]] += 90.0
    entries = planted_map(("yaw", "ax")).channels

    def cleaned() -> list:
        made, _ = clean_channels(
            {c: [series(np.arange(999) * 0.01, v, c)] for c, v in (("yaw", yaw), ("ax", held))},
            {entry.channel: entry for entry in entries},
            ("yaw", "ax"),
            gap=0.1,
            despike=True,
        )
        return [made.clean["yaw"][0].values, made.clean["ax"][0].values, made.clean["ax"][0].repeats]

    whole = cleaned()
    finite = np.isfinite(yaw)
    np.testing.assert_array_equal(whole[0], np.unwrap(yaw[finite]))
    assert whole[2] == 3
    for place in ("clean", "synchronize"):
        monkeypatch.setattr(f"split_cli.logs.assembling.{place}.PIECE", piece)
    for one, other in zip(whole, cleaned(), strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_delay_moves_times_earlier():
    clean = clean_series(series(np.arange(10) * 0.1, np.arange(10.0), delay=0.25))
    assert clean.time[0] == pytest.approx(-0.25)


def test_isolated_spikes_go_but_steps_and_rough_signals_stay():
    rng = np.random.default_rng(0)
    t = np.arange(3000) * 0.01
    values = np.sin(t) + 0.01 * rng.standard_normal(len(t))
    spiked = values.copy()
    spiked[[500, 1500, 1501]] += [40.0, -30.0, -30.0]
    clean = clean_series(series(t, spiked))
    assert clean.spikes == 3 and drops(clean) == {"spike": 3}
    stepped = np.where(t > 15.0, values + 5.0, values)
    assert clean_series(series(t, stepped)).spikes == 0
    assert clean_series(series(t, rng.standard_cauchy(len(t)).clip(-4, 4))).spikes == 0
    kept = clean_series(series(t, spiked), despike=False)
    assert kept.spikes == 3 and len(kept.values) == len(t)


def test_a_sensor_slower_than_its_log_is_read_at_its_own_rate():
    t = np.arange(2000) * 0.005
    slow = np.sin(t[::4])
    clean = clean_series(series(t, np.repeat(slow, 4)))
    assert clean.repeats == 4 and clean.period == pytest.approx(0.02)
    np.testing.assert_array_equal(clean.values, slow)
    # At rest it repeats longer than that; the samples stay evenly spaced then, so that no gap opens.
    rest = np.concatenate([np.repeat(slow, 4), np.full(400, slow[-1])])
    t = np.arange(len(rest)) * 0.005
    assert np.max(np.diff(clean_series(series(t, rest)).time)) == pytest.approx(0.02)
    assert longest_repeat(np.round(np.sin(t[:2000]) / 0.02) * 0.02) == 1  # quantised, of uneven runs


def test_a_clock_that_jumps_back_continues_behind_with_a_gap_in_all_channels_alike():
    clock = np.concatenate([np.arange(0, 5, 0.01), np.arange(0, 4, 0.01)])
    fine = np.concatenate([np.arange(0, 5, 0.002), np.arange(0, 4, 0.002)])
    truth = np.arange(len(clock)) * 0.01
    joined, said = join_clock_resets({"vx": (series(clock, truth),), "r": (series(fine, fine, "r"),)}, 0.1)
    assert len(said) == 1 and "jumps back" in said[0]
    time, other = joined["vx"][0].time, joined["r"][0].time
    assert np.all(np.diff(time) > 0) and np.max(np.diff(time)) == pytest.approx(1.0, abs=0.02)
    # Both channels are moved by the same time, or they would no longer belong together.
    assert time[500] - clock[500] == pytest.approx(other[2500] - fine[2500], abs=1e-12)


def test_a_few_late_messages_are_no_clock_jump():
    late = [*range(200), *range(202, 302), 200, 201, *range(302, 1000)]  # they come 1 s behind their time
    time = np.array(late) * 0.01
    joined, said = join_clock_resets({"vx": (series(time, time),)}, 0.1)
    assert said == () and joined["vx"][0].time is time


def test_channels_that_disagree_about_jumps_are_refused():
    jumping = np.concatenate([np.arange(0, 5, 0.01), np.arange(0, 4, 0.01)])
    steady = np.arange(0, 9, 0.01)
    with pytest.raises(LogError, match="clock of vx jumps back 1 times.*--clock"):
        join_clock_resets({"vx": (series(jumping, jumping),), "r": (series(steady, steady, "r"),)}, 0.1)


def test_too_little_left_is_an_error_that_says_what_was_dropped():
    with pytest.raises(LogError, match="2 usable samples of vx.*3 NaN"):
        clean_series(series(np.arange(5), [1, 2, np.nan, np.nan, np.nan]))


@pytest.mark.parametrize(
    ("rows", "by"),
    [([0], 1e17), ([250], 1e17), ([100, 101, 102], 1e17), ([3, 250], 1e17), ([250], -1.0), ([100, 101, 300], -50.0)],
)
def test_stamps_that_do_not_fit_those_around_them_cost_their_rows_alone(rows, by):
    """One wrong stamp moved all that followed behind it; one too early was sorted to a wrong place."""
    time = np.arange(500) * 0.01
    wrong = time.copy()
    wrong[rows] += by
    wrong[400] += 2.0  # and one more, of another kind
    joined, said = join_clock_resets({"vx": (series(wrong, time),), "r": (series(time, time, "r"),)}, 0.1)
    kept = np.isfinite(joined["vx"][0].time)
    np.testing.assert_array_equal(np.flatnonzero(~kept), [*rows, 400])
    np.testing.assert_array_equal(joined["vx"][0].time[kept], time[kept])
    np.testing.assert_array_equal(joined["r"][0].time, time)
    assert said == (f"{len(rows) + 1} stamps that fit neither those before nor behind were left out",)


def test_each_jump_is_told_by_its_own_size():
    clock = np.arange(900) * 0.01
    for row in (300, 600):
        clock[row:] -= 0.5
    _, said = join_clock_resets({"vx": (series(clock, clock),)}, 0.1)
    assert [text.split(":")[0] for text in said] == ["the clock jumps back by 0.490 s"] * 2


def test_two_clocks_by_turns_are_no_clock():
    """Sorted by such stamps, the rows of both would lie between each other: v_x was wrong by 0.75 m/s rms."""
    time = np.arange(1000) * 0.01
    time[::2] += 0.5
    with pytest.raises(LogError, match=r"goes back by more than 0\.1 s 500 times in 1000 rows"):
        join_clock_resets({"vx": (series(time, time),)}, 0.1)


def test_joined_runs_are_further_apart_than_any_source_is_bridged():
    """A gap of 3 s, or a receiver of 0.5 Hz that is held for five samples, reached over a pause of 1 s."""
    clock = np.concatenate([np.arange(0.0, 30.0, 0.1), np.arange(0.0, 30.0, 0.1)])
    fix = np.concatenate([np.arange(0.0, 30.0, 2.0), np.arange(0.0, 30.0, 2.0)])
    for sources, gap, bridged in (
        ({"vx": (series(clock, clock),)}, 3.0, 3.0),
        ({"vx": (series(clock, clock),), "X": (series(fix, fix, "X"),)}, 0.2, 5 * 2.0),
        # The same receiver in a table of 10 Hz: each of its values stands in 20 rows.
        ({"vx": (series(clock, clock),), "X": (series(clock, clock // 2.0, "X"),)}, 0.2, 5 * 2.0),
    ):
        joined, _ = join_clock_resets(sources, gap)
        assert all(np.max(np.diff(part.time)) > bridged for parts in joined.values() for part in parts)


def test_a_block_that_a_file_holds_twice_is_counted_and_left_out():
    """A duplicated block of 200 rows was taken for a clock that starts again, and learned twice."""
    time = np.arange(1000) * 0.02
    rows = np.concatenate([np.arange(600), np.arange(300, 600), np.arange(600, 1000)])
    values = np.sin(time)
    values[400] = np.nan
    whole = series(time[rows], values[rows])
    other = replace(whole, channel="r", values=np.cos(time)[rows])
    kept, said = without_repeated_rows({"vx": (whole,), "r": (other,)}, 0.1)
    assert said == ["300 rows repeat earlier ones, with their time: left out"]
    np.testing.assert_array_equal(kept["vx"][0].time, time)
    np.testing.assert_array_equal(kept["r"][0].values, np.cos(time))
    assert join_clock_resets(kept, 0.1)[1] == ()


def test_a_lap_that_starts_its_time_again_and_a_standing_car_are_no_repetition():
    time = np.tile(np.arange(500) * 0.02, 2)
    lap = series(time, np.sin(np.arange(1000) * 0.013))
    gear = replace(lap, channel="gear", values=np.full(1000, 4.0))  # the same in both laps
    for parts in ({"vx": (lap,), "gear": (gear,)}, {"gear": (gear,)}):
        kept, said = without_repeated_rows(parts, 0.1)
        assert said == [] and all(kept[channel] == list(parts[channel]) for channel in parts)
