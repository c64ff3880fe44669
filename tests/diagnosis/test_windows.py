"""Sums over windows, compiled, against the passes over whole arrays that they stand for."""

import numpy as np
from scipy.ndimage import uniform_filter1d

from split_cli.diagnosis.recording.windows import changes, displacements, integrals

BEGIN = np.arange(0, 560, 40)
END = BEGIN + 50  # windows overlap, and the first begins where the recording does


def moving_mean(values, edge):
    return uniform_filter1d(values, 2 * edge + 1, mode="nearest")


def over_windows(values, edge):
    smooth = moving_mean(values, edge)
    return smooth[END] - smooth[BEGIN]


def summed(rate):
    return np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]))])


def test_windows_are_those_of_running_sums_and_running_means():
    rng = np.random.default_rng(5)
    velocity = rng.normal(size=(600, 3))
    angle = rng.normal(size=600)
    sine, cosine = np.sin(angle), np.cos(angle)
    x = velocity[:, 0] * cosine - velocity[:, 1] * sine
    y = velocity[:, 0] * sine + velocity[:, 1] * cosine
    for edge in (0, 10):
        # Sums of 600 numbers of unit size: rounding leaves some 1e-13.
        for found, wanted in (
            (changes(angle, BEGIN, END, edge), angle),
            (integrals(velocity[:, 2], BEGIN, END, edge), summed(velocity[:, 2])),
            *zip(displacements(velocity, sine, cosine, BEGIN, END, edge), map(summed, (x, y)), strict=True),
        ):
            np.testing.assert_allclose(found, over_windows(wanted, edge), rtol=0.0, atol=1e-11)


def test_a_constant_rate_adds_its_time():
    np.testing.assert_allclose(integrals(np.full(700, 2.0), BEGIN[1:], END[1:], 10), 100.0, rtol=1e-12)
