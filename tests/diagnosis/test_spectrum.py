"""Lines in the spectrum: planted over time and over distance, absent from noise, shown by the simulation too."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.signal import lfilter

from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.remainder.spectrum import strongest_line
from tests.diagnosis.recordings import SIGMA, bare_objective, driven, light_evidence, noisy, prepared

REPLICATES = 60


@pytest.fixture(scope="module")
def drive():
    """Forty seconds in one run: lines are sharpest without gaps."""
    return driven(71, runs=1, seconds=40.0)


def shaken(drive, channel: str, angle: np.ndarray, amplitude: float, seed: int = 1):
    """Return a recording whose `channel` changes by `amplitude` sin(angle) more a second, and with noise."""
    rate = amplitude * np.sin(angle)
    moved = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))]) * drive.period
    return prepared(noisy(replace(drive, columns={**drive.columns, channel: drive[channel] + moved}), seed))


def way(drive) -> np.ndarray:
    return np.concatenate([[0.0], np.cumsum(0.5 * (drive["vx"][1:] + drive["vx"][:-1]))]) * drive.period


def line_of(series: Series, *simulated: Series):
    return strongest_line(bare_objective(light_evidence(series)), (), [light_evidence(one) for one in simulated])


def test_a_line_over_time(drive):
    series = shaken(drive, "vx", 2.0 * np.pi * 13.0 * drive["t"], 1.5)
    line = line_of(series)
    assert (line.over, line.channel) == ("time", "v_x")
    # Forty seconds tell frequencies to a fortieth of a hertz; the rate to a tenth or better.
    assert line.frequency == pytest.approx(13.0, abs=1.0 / 40.0)
    assert line.amplitude == pytest.approx(1.5, rel=0.15)
    assert line.p_value < 1e-6
    # By hand: over 0.05 s the sine sums to 2 a/w sin(w 0.025), rms over root two, against root two of noise.
    omega = 2.0 * np.pi * 13.0
    expected = 2.0 * 1.5 / omega * abs(np.sin(omega * 0.025)) / np.sqrt(2.0) / (np.sqrt(2.0) * SIGMA[0])
    assert line.effect_to_noise == pytest.approx(expected, rel=0.15)
    assert line.in_words() == f"v_x' oscillates by {line.amplitude:.2g} m/s^2 at 13 Hz"


def test_a_line_over_distance(drive):
    """A wheel out of balance: one swing every 1.9 m, whatever the speed."""
    series = shaken(drive, "r", 2.0 * np.pi * way(drive) / 1.9, 0.5)
    line = line_of(series)
    assert (line.over, line.channel) == ("distance", "r")
    # Some 700 m are driven: a wave between two whole fractions of that is reported by the nearer one, which holds
    # two thirds of its amplitude at least.
    assert 1.0 / line.frequency == pytest.approx(1.9, rel=0.005)
    assert 0.6 * 0.5 < line.amplitude < 1.1 * 0.5
    assert "rad/s^2 every 1.9 m" in line.in_words()


def test_a_line_that_the_simulation_shows_too_is_common(drive):
    angle = 2.0 * np.pi * 13.0 * drive["t"]
    real = shaken(drive, "vx", angle, 1.5)
    assert line_of(real, prepared(noisy(drive, 5))).frequency == pytest.approx(13.0, abs=1.0 / 40.0)
    assert line_of(real, shaken(drive, "vx", angle + 1.0, 1.5, seed=5)) is None
    # Much weaker than in reality it is not the same.
    assert line_of(real, shaken(drive, "vx", angle + 1.0, 0.4, seed=5)) is not None
    # One that shakes as much at another frequency has lines of its own; one that shakes less has not this one.
    faster = 2.0 * np.pi * 17.0 * drive["t"]
    assert line_of(real, shaken(drive, "vx", faster, 1.5, seed=6)) is None
    assert line_of(real, shaken(drive, "vx", faster, 0.4, seed=5)) is not None
    assert line_of(real, shaken(drive, "vy", faster, 1.5, seed=5)) is not None
    # One that swings the other way for ten seconds shakes as much in each block of them, though less as one line.
    turned = angle + np.pi * (np.floor(drive["t"] / 10.0) == 2.0)
    assert line_of(shaken(drive, "vx", turned, 0.9, seed=5)).amplitude < 0.5 * 1.5
    assert line_of(real, shaken(drive, "vx", turned, 0.9, seed=5)) is None


def test_what_shakes_at_one_speed_alone_is_common_where_the_simulation_does_so_too(drive):
    """In most blocks of ten seconds neither shakes; compared are those of the same speed."""

    def shaken_in(block: float, order: list[int], amplitude: float, seed: int) -> Series:
        first = drive.select(slice(0, 4000))
        rows = np.concatenate([np.arange(1000) + 1000 * k for k in order])
        columns = {name: each[rows] for name, each in first.columns.items()}
        dealt = replace(first, columns={**columns, "t": first["t"]})
        shakes = np.floor(dealt["t"] / 10.0) == block
        return shaken(dealt, "vx", 2.0 * np.pi * 13.0 * dealt["t"], np.where(shakes, amplitude, 0.0), seed)

    real = shaken_in(1.0, [0, 1, 2, 3], 3.0, seed=1)
    # At the end of a drive such a stretch makes no line of its own.
    assert line_of(shaken_in(3.0, [0, 2, 3, 1], 2.5, seed=5)) is None
    assert line_of(real, shaken_in(3.0, [0, 2, 3, 1], 2.5, seed=5)) is None
    # An amplitude of 0.5 is told of noise alone, so a difference from one of 1 needs a large one.
    assert line_of(shaken_in(1.0, [0, 1, 2, 3], 5.0, seed=1), shaken_in(3.0, [0, 2, 3, 1], 1.0, seed=5)) is not None
    # What shakes as much at another speed is no sure difference either.
    assert line_of(real, shaken_in(3.0, [0, 1, 2, 3], 2.5, seed=5)) is None


def test_what_is_out_of_balance_shakes_by_the_square_of_speed():
    """A simulation that was as fast for a moment only, on average 16 m/s, beside 25 m/s in reality."""

    def unbalanced(seed: int, amplitude: float) -> Series:
        own = driven(seed, runs=1, seconds=40.0)
        return shaken(own, "r", 2.0 * np.pi * way(own) / 1.9, amplitude * (own["vx"] / 25.0) ** 2, seed)

    slow = unbalanced(75, 1.0)
    fast_once = replace(slow, smooth=np.concatenate([[[40.0, 0.0, 0.0]], slow.smooth[1:]]))
    assert line_of(unbalanced(74, 1.0), fast_once) is None
    assert line_of(unbalanced(74, 2.5), fast_once) is not None


def test_a_few_samples_say_nothing_of_a_common_line(drive):
    """After 20 s one row is compared, of which two samples lie in the last ten seconds: too few for an amplitude."""
    cut = drive.select(np.arange(len(drive)) != 1002)  # rows begin anew there, and one of them 20 ms before 30 s
    angle = 2.0 * np.pi * 8.0 * cut["t"]
    real = bare_objective(light_evidence(shaken(cut, "vx", angle, 0.5)))
    (evidence,) = real.evidence
    policy = replace(real.policy, unnamed=replace(real.policy.unnamed, fewest=1000))
    at = evidence.series.t[evidence.at]
    asked = replace(real, keep=((at < 19.9) | (np.abs(at - 30.0) < 0.02),), policy=policy)
    assert strongest_line(asked, ()) is not None
    assert strongest_line(asked, (), [light_evidence(shaken(cut, "vx", angle + 1.0, 0.5, seed=5))]) is None


def test_the_second_line_is_told_where_the_first_is_common(drive):
    both = 2.0 * np.pi * 13.0 * drive["t"]
    real = shaken(drive, "vx", both, 1.5)
    faster = shaken(drive, "vy", 2.0 * np.pi * 21.0 * drive["t"], 1.5, seed=1)
    together = replace(real, measured=np.stack([*real.measured.T[:1], *faster.measured.T[1:]], axis=1))
    line = line_of(together, shaken(drive, "vx", both, 1.5, seed=5))
    assert (line.channel, round(line.frequency)) == ("v_y", 21)


def test_noise_has_no_lines_more_often_than_it_should(drive):
    """Told at p below 1e-3: in sixty drives of noise the second would be one in two thousand."""
    told = [line_of(prepared(noisy(drive, 100 + seed))) for seed in range(REPLICATES)]
    assert sum(line is not None for line in told) <= 1


def test_a_resonance_is_no_line(drive):
    """Noise through a spring and a damper at 21 Hz, 1 Hz wide: no frequency of it is apart from its neighbours."""
    radius, turn = np.exp(-np.pi * 1.0 * drive.period), 2.0 * np.pi * 21.0 * drive.period

    def resonant(seed: int) -> Series:
        noise = np.random.default_rng(seed).normal(0.0, 0.01, len(drive))
        rings = lfilter([1.0, -1.0], [1.0, -2.0 * radius * np.cos(turn), radius**2], noise)
        columns = {**drive.columns, "vx": drive["vx"] + rings}
        return prepared(noisy(replace(drive, columns=columns), seed))

    assert not any(line_of(resonant(300 + seed)) for seed in range(6))


def test_swings_that_a_driver_could_make_are_no_lines(drive):
    """At 0.6 Hz, and every 30 m: slower than what shakes by itself; what spills over is below what is reported."""
    for swing in (2.0 * np.pi * 0.6 * drive["t"], 2.0 * np.pi * way(drive) / 30.0):
        line = line_of(shaken(drive, "vx", swing, 1.0))
        assert line is None or line.effect_to_noise < 0.12


def test_too_short_to_tell(drive):
    short = drive.select(slice(0, 1500))
    assert line_of(shaken(short, "vx", 2.0 * np.pi * 13.0 * short["t"], 3.0)) is None


def test_only_what_is_compared_and_no_faster_than_the_simulation_is_asked_for_lines(drive):
    """Shaken where it is fast, by twice the amplitude: rows left out and a slower simulation say nothing of it."""
    fast = drive["vx"] > np.quantile(drive["vx"], 0.5)
    real = shaken(drive, "vx", 2.0 * np.pi * 13.0 * drive["t"], np.where(fast, 3.0, 0.0))
    evidence = light_evidence(real)
    everything = bare_objective(evidence)
    policy = replace(everything.policy, unnamed=replace(everything.policy.unnamed, fewest=1000))
    everything = replace(everything, policy=policy)
    assert strongest_line(everything, ()).frequency == pytest.approx(13.0, abs=1.0 / 20.0)
    slow_rows = [~fast[evidence.at]]
    assert strongest_line(replace(everything, keep=slow_rows), ()) is None
    assert strongest_line(replace(everything, keep=[fast[evidence.at]]), ()) is not None
    slower = light_evidence(prepared(noisy(drive, 5)))
    assert strongest_line(everything, (), [slower]) is not None
    limited = replace(slower.series, smooth=np.minimum(slower.series.smooth, [np.median(drive["vx"]), 9.0, 9.0]))
    assert strongest_line(everything, (), [replace(slower, series=limited)]) is None
