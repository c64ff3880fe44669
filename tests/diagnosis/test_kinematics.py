"""Faults of the velocity sensor, found from position and yaw alone."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.recording.kinematics import build_kinematics, usual_weights
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Recording
from tests.diagnosis.recordings import bare_objective, faulty, light_evidence, noisy, prepared
from tests.factories import one_run

POSITION = 0.01  # standard deviation of X and Y [m]


def series_of(drive: Drive, seed: int = 3, **fault: float):
    return prepared(noisy(faulty(drive, **fault), seed, position=POSITION))


def solved(kinematics, *terms: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the parameters that position and yaw alone ask for, and their standard errors: three Newton steps."""
    names = [(term, next(iter(CATALOGUE[term].units))) for term in terms]
    values = np.zeros(len(names))

    def rows(values):
        return kinematics.rows([CATALOGUE[t]({p: float(v)}) for (t, p), v in zip(names, values, strict=True)])

    for _ in range(3):
        here = rows(values)
        slopes = np.stack([(rows(values + 1e-4 * unit) - here) / 1e-4 for unit in np.eye(len(names))], axis=1)
        values = values - np.linalg.lstsq(slopes, here, rcond=None)[0]
    return values, np.sqrt(np.diag(np.linalg.inv(slopes.T @ slopes)))


def test_misalignment_and_lever_arm_are_recovered_together(nominal_drive):
    kinematics = build_kinematics(series_of(nominal_drive, angle=0.02, dx=0.3))
    values, errors = solved(kinematics, "sensor_misalignment", "sensor_lever_arm")
    # Either is known to a tenth at least.
    assert np.all(errors < [0.002, 0.03])
    assert np.all(np.abs(values - [0.02, 0.3]) < 3.0 * errors)


def test_a_sensor_that_is_right_contradicts_nothing(nominal_drive):
    kinematics = build_kinematics(series_of(nominal_drive))
    values, errors = solved(kinematics, "sensor_misalignment", "sensor_lever_arm")
    assert np.all(np.abs(values) < 3.0 * errors)
    # Rows are in units of their spread: their robust deviation is 1 by definition, and without outliers their rms.
    assert np.sqrt(np.mean(kinematics.rows(()) ** 2)) == pytest.approx(1.0, abs=0.25)


def test_a_tracked_frame_that_is_off_moves_position_with_velocity_and_contradicts_nothing(nominal_drive):
    """A whole drive in the frame of a point 0.3 m ahead with its axis turned by 0.02 rad, by hand."""
    ahead, turned = 0.3, 0.02
    columns = faulty(nominal_drive, angle=turned, dx=ahead).columns
    x, y, yaw = (columns[name] for name in ("X", "Y", "yaw"))
    columns = {**columns, "X": x + ahead * np.cos(yaw), "Y": y + ahead * np.sin(yaw), "yaw": yaw + turned}
    kinematics = build_kinematics(prepared(noisy(replace(nominal_drive, columns=columns), 3, position=POSITION)))
    values, errors = solved(kinematics, "sensor_misalignment", "sensor_lever_arm")
    assert np.all(np.abs(values) < 3.0 * errors)
    kinds = ("sensor_misalignment", {"angle": turned}), ("sensor_lever_arm", {"dx": ahead})
    frame, sensor = ([CATALOGUE[term](p, variant) for term, p in kinds] for variant in ("frame", ""))
    np.testing.assert_array_equal(kinematics.rows(frame), kinematics.rows(()))
    assert np.std(kinematics.rows(sensor)) > 3.0 * np.std(kinematics.rows(()))
    # Both are the same to the velocities.
    np.testing.assert_array_equal(kinematics.series.corrected(frame)[1], kinematics.series.corrected(sensor)[1])


def test_a_simulation_that_contradicts_itself_is_no_fault_of_reality(nominal_drive):
    """Velocities of a point 0.3 m ahead in both: what is usual in the simulation, taken off reality's rows."""
    usual = usual_weights([build_kinematics(series_of(nominal_drive, 4, dx=0.3))])
    assert usual[0] == pytest.approx(-0.3, abs=0.03) and abs(usual[1]) < 0.002
    values, errors = solved(build_kinematics(series_of(nominal_drive, 3, dx=0.3), usual), "sensor_lever_arm")
    # What is usual is as uncertain as the answer.
    assert abs(values[0]) < 3.0 * np.sqrt(2.0) * errors[0]
    np.testing.assert_array_equal(usual_weights([]), np.zeros(2))


def test_a_straight_line_by_hand(nominal_drive):
    """At 20 m/s straight ahead, a sensor turned by 0.01 rad sees 0.2 m/s that is not there: 0.1 m in 0.5 s."""
    count = 1001
    zero, t = np.zeros(count), 0.01 * np.arange(count)
    columns = {"t": t, "X": 20.0 * t * np.cos(0.4), "Y": 20.0 * t * np.sin(0.4), "yaw": zero + 0.4, "s": 20.0 * t}
    columns |= {"vx": zero + 20.0 * np.cos(0.01), "vy": zero - 20.0 * np.sin(0.01)}
    drive = one_run(columns, 0.01, "straight")
    kinematics = build_kinematics(prepared(drive))
    np.testing.assert_allclose(kinematics.difference(()), 0.5 * 20.0 * np.sin(0.01), rtol=1e-9)
    right = (CATALOGUE["sensor_misalignment"]({"angle": 0.01}),)
    np.testing.assert_allclose(kinematics.difference(right), 0.0, atol=1e-9)
    np.testing.assert_allclose(
        kinematics.error_patterns, np.tile([0.0, 10.0 * np.cos(0.01)], (len(kinematics.begin), 1))
    )


def test_a_weave_that_turns_in_quickly_contradicts_nothing():
    """A model car weaves at 1.6 Hz. Means of 0.2 s take 16 % of such a swing, of positions and of velocities alike.

    Where the mean of positions was compared with plain velocities, 5 mm were left by a sensor that was right.
    """
    fine, every = 1e-4, 100
    t = fine * np.arange(300_001)
    turning = 2.0 * np.pi * 1.6
    yaw, vx, vy = 0.3 * np.sin(turning * t), 4.0 + 0.0 * t, 0.15 * np.cos(turning * t + 0.4)
    x, y = (
        np.concatenate([[0.0], np.cumsum(0.5 * fine * (rate[1:] + rate[:-1]))])
        for rate in (vx * np.cos(yaw) - vy * np.sin(yaw), vx * np.sin(yaw) + vy * np.cos(yaw))
    )
    r = 0.3 * turning * np.cos(turning * t)
    columns = {"t": t, "X": x, "Y": y, "yaw": yaw, "vx": vx, "vy": vy, "r": r, "s": 4.0 * t}
    drive = one_run({name: values[::every] for name, values in columns.items()}, fine * every, "weave")
    kinematics = build_kinematics(prepared(drive))
    # The trapezoidal rule errs by h^2/12 of the change of the acceleration: 12 m/s^2 make 0.1 mm.
    np.testing.assert_allclose(kinematics.difference(()), 0.0, atol=2e-4)
    np.testing.assert_allclose(kinematics.ahead(()), kinematics.along, atol=2e-4)


def test_what_the_car_lacks_moves_no_row_of_position_and_yaw(nominal_drive):
    series = series_of(nominal_drive)
    kinematics = build_kinematics(series)
    objective = bare_objective(light_evidence(series), kinematics=[kinematics])
    last = slice(-len(kinematics.begin), None)
    plain = objective.residual(())
    for term in (
        CATALOGUE["mass"]({"scale": 1.3}),
        CATALOGUE["steer_gain"]({"gain": 0.7}),
        CATALOGUE["cg_shift"]({"dx": 0.2}),
    ):
        moved = objective.residual((term,))
        np.testing.assert_array_equal(moved[last], plain[last])
        assert np.abs(moved - plain).max() > 0.1
    turned = objective.residual((CATALOGUE["sensor_misalignment"]({"angle": 0.02}),))
    # 0.02 rad at some 18 m/s is 0.18 m in half a second, against some centimetres.
    assert np.median(np.abs(turned[last] - plain[last])) > 3.0


def test_no_rows_without_position_or_with_too_few_windows(nominal_drive):
    bare = {name: values for name, values in nominal_drive.columns.items() if name not in ("X", "Y", "yaw")}
    assert build_kinematics(prepared(replace(nominal_drive, columns=bare))) is None
    # A run of 5 s holds nine windows; twelve are asked for.
    one = nominal_drive.select(nominal_drive.segment == 0)
    assert build_kinematics(prepared(one)) is None
    assert build_kinematics(prepared(nominal_drive.select(nominal_drive.segment < 2))) is not None


@pytest.mark.parametrize(
    ("name", "variant", "values"),
    [("channel_delay", "vy", {"vy": 0.05}), ("velocity_bias", "", {"angle": 0.0, "drift": 0.001})],
)
def test_a_fault_of_the_sensor_is_no_noise_and_does_not_hide_in_its_own_spread(nominal_drive, name, variant, values):
    sound = noisy(nominal_drive, 3, position=POSITION)
    recording = Recording(sound.period, tuple((run.start, run.stop) for run in sound.segments()))
    columns = CATALOGUE[name](values, variant).corrupt(dict(sound.columns), recording)
    ours, theirs = (build_kinematics(prepared(one)) for one in (sound, replace(sound, columns=columns)))
    assert theirs.scale < 1.5 * ours.scale
    assert np.mean(theirs.rows(()) ** 2) > 3.0 * np.mean(ours.rows(()) ** 2)


def test_a_late_channel_is_put_right_with_the_fast_signal_that_smoothing_takes_for_noise(nominal_drive):
    """A shake of 12 Hz within the noise: four samples later and corrected, it is the drive that was recorded."""
    drive = noisy(nominal_drive, 3)
    shaken = {**drive.columns, "r": drive["r"] + 0.004 * np.sin(24.0 * np.pi * drive["t"])}
    sound = prepared(replace(drive, columns=shaken))
    delay = CATALOGUE["channel_delay"]({"r": 4.0 * drive.period}, "r")
    late = prepared(replace(drive, columns={**shaken, "r": np.concatenate([shaken["r"][:4], shaken["r"][:-4]])}))
    inner = np.concatenate([np.arange(len(drive))[run][30:-30] for run in drive.segments()])

    def wrong(series) -> float:
        return float(np.std((series.corrected([delay])[0] - sound.measured)[inner, 2]))

    moved = late.with_residue_moved([delay])
    assert wrong(moved) < 1e-4 and wrong(late) > 0.003
    # Where no delay is tried, a correction moves both.
    assert wrong(replace(late, residue_moves=True)) < 1e-4 and wrong(replace(moved, residue_moves=True)) > 0.003
    # What a fit moves is the smooth part: the noise is the same at every delay it tries.
    np.testing.assert_allclose(moved.measured - moved.smooth, moved.corrected([delay])[0] - moved.corrected([delay])[1])
    objective = bare_objective(light_evidence(late))
    again = objective.with_residue_moved([delay])
    assert again.cost([delay]) < objective.cost([delay])
    np.testing.assert_array_equal(
        objective.with_residue_moved([]).raw_residual([delay]), objective.raw_residual([delay])
    )
