"""The recordings that others made: what is in them is read, with the units they state."""

import numpy as np
import pytest

from split_cli.logs.readers import open_recording

pytestmark = pytest.mark.foreign

AV21_UNITS = {
    "time": "s",
    "x": "m",
    "y": "m",
    "vx": "m/s",
    "vy": "m/s",
    "phi": "rad",
    "delta": "rad",
    "omega": "rad/s",
    "ax": "m/s^2",
    "deltadelta": "rad/s",
    "wheel_fl": "km/h",
    "wheel_fr": "km/h",
    "wheel_rl": "km/h",
    "wheel_rr": "km/h",
    "roll": "rad",
    "throttle_ped_cmd": "%",
    "brake_ped_cmd": "kPa",
}
TUM_UNITS = {
    "vx_mps": "m/s",
    "vy_mps": "m/s",
    "dpsi_radps": "rad/s",
    "ax_mps2": "m/s^2",
    "ay_mps2": "m/s^2",
    "deltawheel_rad": "rad",
    "TwheelRL_Nm": "N m",
    "TwheelRR_Nm": "N m",
    "pBrakeF_bar": "bar",
    "pBrakeR_bar": "bar",
}
GENESIS = {"t", "x", "y", "psi", "vx", "vy", "wz", "df", "a_long", "a_lat", "a", "v", "lat", "lon"}


def read_all(path):
    recording = open_recording(path)
    infos = recording.channels()
    return recording, infos, recording.read([info.name for info in infos])


def test_genesis(datasets):
    recording, infos, signals = read_all(datasets / "genesis_slow" / "cpg_slow_lap.mat")
    assert {info.name for info in infos} == GENESIS
    assert {len(signal.values) for signal in signals.values()} == {36_115}
    assert all(info.unit is None for info in infos)
    assert recording.notes == []
    # 361 s at 100 Hz, gentle: what its description says.
    time = signals["t"].values
    assert time[-1] - time[0] == pytest.approx(361, abs=1) and np.median(np.diff(time)) == pytest.approx(0.01, 0.05)
    # The yaw rate is the slope of the yaw angle, which would not hold for columns taken for each other.
    yaw = np.unwrap(signals["psi"].values)
    assert np.corrcoef(np.gradient(yaw, time)[::10], signals["wz"].values[::10])[0, 1] > 0.9


def test_av21(datasets):
    recording, infos, signals = read_all(datasets / "av21_lvms" / "LVMS_23_01_04_B.csv")
    assert {info.name: info.unit for info in infos} == AV21_UNITS
    assert {len(signal.values) for signal in signals.values()} == {16_791}
    assert all(np.isfinite(signal.values).all() for signal in signals.values())
    assert recording.notes == []
    time = signals["time"].values
    assert time[0] == 1672875115.41200042
    assert np.median(np.diff(time)) == pytest.approx(0.04, abs=1e-6)
    # Wheels in km/h, speed in m/s, in one column each.
    fast = signals["vx"].values > 20
    ratio = signals["wheel_fl"].values[fast] / signals["vx"].values[fast]
    assert np.median(ratio) == pytest.approx(3.6, rel=0.05)


@pytest.mark.parametrize(("name", "rows"), [("data_to_run.csv", 14_380), ("data_to_train_12.csv", 24_855)])
def test_tum(datasets, name, rows):
    recording, infos, signals = read_all(datasets / "tum_sim" / name)
    assert {info.name: info.unit for info in infos} == TUM_UNITS
    assert {len(signal.values) for signal in signals.values()} == {rows}
    assert all(signal.time is None for signal in signals.values())
    assert recording.notes == []
    # The whole text read by NumPy's own slow reader is the oracle of the values.
    expected = np.loadtxt(datasets / "tum_sim" / name, delimiter=",", skiprows=1, max_rows=2000)
    for column, values in zip(expected.T, signals.values(), strict=True):
        np.testing.assert_array_equal(values.values[:2000], column)
