"""Series of longer samples: inputs keep their sums, and no sample crosses a gap."""

from dataclasses import replace

import numpy as np

from split_cli.diagnosis.recording.series import of_every
from split_cli.vehicle.effects import Recording


def test_longer_samples_hold_the_means_of_inputs_and_the_states_of_their_begin(nominal_series):
    gaps = replace(nominal_series, recording=Recording(nominal_series.period, ((0, 11), (11, 20), (20, 21))))
    columns = ("smooth", "measured", "torque", "steer_angle", "t", "s", "yaw")
    series = replace(gaps, **{name: getattr(gaps, name)[:21] for name in columns})
    longer, place = of_every(series, 4)
    assert longer.period == 4 * series.period
    assert longer.recording.segments == ((0, 3), (3, 6), (6, 7))
    np.testing.assert_array_equal(place, [0] * 4 + [1] * 4 + [2] * 3 + [3] * 4 + [4] * 4 + [5] + [6])
    for k in range(7):
        rows = np.flatnonzero(place == k)
        np.testing.assert_allclose(longer.torque[k], np.mean(series.torque[rows]), rtol=1e-12)
        np.testing.assert_allclose(longer.steer_angle[k], np.mean(series.steer_angle[rows]), rtol=1e-12)
        np.testing.assert_array_equal(longer.smooth[k], series.smooth[rows[0]])
        assert longer.t[k] == series.t[rows[0]]


def test_samples_of_one_are_those_of_the_series(nominal_series):
    longer, place = of_every(nominal_series, 1)
    np.testing.assert_array_equal(place, np.arange(len(nominal_series)))
    np.testing.assert_array_equal(longer.torque, nominal_series.torque)
    assert longer.recording == nominal_series.recording
