"""Labels: forces recovered, a model's own drive without residual, convergence, gaps, bad samples."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from split_cli.errors import DriveError
from split_cli.learning.features import Z1, Z2, FeatureSet
from split_cli.learning.label_file import read_labels, write_labels
from split_cli.learning.labels import Reason, compute_labels, nominal_errors
from split_cli.learning.region import Region
from split_cli.logs.columns_of_file import ColumnsOfFile
from split_cli.logs.drive import Drive, open_drive, read_drive, write_drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.integration import integrate_recorded
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.factories import MissingForce, make_drive, one_run, road_car

CAR = road_car()


def pushed_straight(speed: float, force: float, horizon: float, samples: int = 1) -> Drive:
    """Windows that start straight at `speed` while the real front axle makes `force` [N] more than the nominal."""
    model = SingleTrack(CAR, [MissingForce({"front_lateral": force})])
    period = horizon / samples
    state = np.array([[speed, 0.0, 0.0]])
    states = [state]
    for _ in range(samples):
        state = integrate_recorded(model, state, np.zeros((1, 2)), np.zeros((1, 2)), period, 200)
        states.append(state)
    return one_run(dict(zip(("vx", "vy", "r"), np.concatenate(states).T, strict=True)), period, "pushed")


def front_and_rear(y: np.ndarray) -> tuple[float, float]:
    _, front, rear = np.linalg.solve(CAR.force_matrix(), y)
    return float(front), float(rear)


@pytest.mark.parametrize("speed", [5.01, 20.0])
def test_a_missing_force_is_recovered_where_the_plain_difference_is_damped(speed):
    drive = pushed_straight(speed, 500.0, 0.05)
    region = Region.of(CAR, minimum_speed=4.0)
    front, rear = front_and_rear(compute_labels(drive, CAR, Z2, region).y[0])
    # The missing force is constant; the nominal tyres bend by less than a thousandth over these slip angles.
    assert front == pytest.approx(500.0, abs=0.5)
    assert rear == pytest.approx(0.0, abs=0.5)

    # The plain difference is what exp(A s) leaves of it on average over h: less than 70 %, and some at the rear.
    jacobian = SingleTrack(CAR).velocity_jacobian(*np.array([[speed], [0.0], [0.0], [0.0], [0.0]]))[0]
    left = np.mean([expm(jacobian * s) for s in (np.arange(2000) + 0.5) / 2000 * 0.05], axis=0)
    expected = front_and_rear(left @ CAR.force_matrix() @ [0.0, 500.0, 0.0])
    found = front_and_rear(compute_labels(drive, CAR, Z2, region, plain=True).y[0])
    np.testing.assert_allclose(found, expected, atol=0.5)
    assert found[0] < 0.7 * 500.0


def test_labels_do_not_depend_on_the_horizon_but_plain_differences_do():
    region = Region.of(CAR, minimum_speed=4.0)
    fronts, plains = [], []
    for horizon in (0.01, 0.02, 0.05, 0.1):
        drive = pushed_straight(12.0, 300.0, horizon)
        fronts.append(front_and_rear(compute_labels(drive, CAR, Z2, region, horizon=horizon).y[0])[0])
        plain = compute_labels(drive, CAR, Z2, region, horizon=horizon, plain=True)
        plains.append(front_and_rear(plain.y[0])[0])
    # 300 N are small: the tyre is linear within a percent or so, and Phi exact for what is linear.
    assert np.ptp(fronts) < 0.02 * 300.0
    assert np.ptp(plains) > 0.3 * 300.0


@pytest.mark.parametrize("effects", [(), (EffectSpec("aero_drag", {"drag": 0.3}),)])
def test_a_model_leaves_no_residual_of_its_own_drive(effects):
    car = CAR.with_effects(*effects)
    drive = make_drive(1, segments=10, seconds=2.0, period=0.01, vehicle=car)
    labels = compute_labels(drive, car, Z2)
    # |lambda| step is at most about 0.3 here, so RK4 errs by its fifth power over 120, some 1e-5 of the rates.
    assert np.abs(labels.y[labels.accepted]).max() < 1e-3
    assert labels.accepted.sum() > 300


def test_terms_with_memory_are_followed_along_the_drive():
    """A car whose steering lags leaves no residual when the model knows it, and a large one when it does not."""
    car = CAR.with_effects(EffectSpec("steer_lag", {"tau": 0.08}))
    model = SingleTrack(car)
    period, count, runs = 0.02, 40, 3
    knots = np.random.default_rng(6).normal(0.0, 0.03, (runs, 9))
    steer = np.array([np.interp(np.arange(count) / 5.0, np.arange(9), row) for row in knots])
    torque = np.full((runs, count), 200.0)
    start = np.stack([np.array([10.0, 15.0, 20.0]), np.zeros(runs), np.zeros(runs)], axis=1)
    states = [start]
    for k in range(1, count):
        states.append(integrate_recorded(model, start, torque[:, : k + 1], steer[:, : k + 1], period, 4))
    velocity = np.stack(states, axis=1).reshape(-1, 3)
    columns = {"t": np.arange(runs * count) * period, "T": torque.ravel(), "delta": steer.ravel()}
    columns |= {name: velocity[:, i] for i, name in enumerate(("vx", "vy", "r"))}
    drive = Drive("lagging", columns, np.repeat(np.arange(runs), count).astype(np.int32), period)
    known = compute_labels(drive, car, Z2)
    unknown = compute_labels(drive, CAR, Z2)
    assert known.accepted.sum() > 40
    # The first-order lag is solved exactly for inputs linear between samples, as these are; the rest is RK4 at a
    # step of 0.02 s with |lambda| up to some 30/s: (0.6)^5/120 of rates that change by some 10 m/s^2.
    assert np.abs(known.y[known.accepted]).max() < 1e-2
    assert np.abs(unknown.y[unknown.accepted]).max() > 0.5


def test_the_residual_of_its_own_drive_falls_with_the_fourth_power_of_the_period():
    errors = []
    # One split for driving and braking: where T changes sign inside a step the other has a kink, and no order.
    car = road_car(brake_split_front=0.4)
    for period in (0.02, 0.01, 0.005):
        drive = make_drive(2, segments=20, seconds=2.0, period=period, vehicle=car)
        labels = compute_labels(drive, car, Z2, horizon=0.1)
        errors.append(np.sqrt(np.mean(labels.y[labels.accepted] ** 2)))
    order = np.log2(np.array(errors[:-1]) / errors[1:])
    # Four, where one substep a sample is used throughout (|lambda| 0.02 < 1 above 8 m/s).
    assert (np.abs(order - 4.0) < 0.4).all()


def test_the_compiled_path_equals_the_plain_one():
    drive = make_drive(3, segments=60, seconds=2.0, vehicle=CAR, terms=[MissingForce({"front_grip_loss": 0.2})])
    slow = replace_speed(drive, 0.3)  # stiff: several substeps a sample
    model = SingleTrack(CAR)
    for tested in (drive, slow):
        starts = np.concatenate([np.arange(run.start, run.stop - 5) for run in tested.segments()])
        for plain in (False, True):
            fast = nominal_errors(model, tested, starts, 5, plain=plain)
            reference = nominal_errors(model, tested, starts, 5, plain=plain, compiled=False)
            # Rates of up to some 100 are differences of velocities near 30 over 0.1 s: 1e-16 * 30/0.1, times the
            # operations of some ten substeps.
            np.testing.assert_allclose(fast, reference, rtol=1e-9, atol=1e-10)


def test_a_term_that_only_remembers_leaves_the_compiled_path():
    """Features behind a lag change no motion: errors are those of the plain model, to the bit."""
    drive = make_drive(3, segments=20, seconds=2.0, vehicle=CAR, terms=[MissingForce({"front_grip_loss": 0.2})])
    starts = np.concatenate([np.arange(run.start, run.stop - 5) for run in drive.segments()])
    remembering = SingleTrack(CAR, [CATALOGUE["feature_lag"]({"tau": 0.08})])
    fast = nominal_errors(remembering, drive, starts, 5)
    np.testing.assert_array_equal(fast, nominal_errors(SingleTrack(CAR), drive, starts, 5))
    # Its Jacobian is closed; that of a model with terms is made of differences, exact to 1e-9.
    reference = nominal_errors(remembering, drive, starts, 5, compiled=False)
    np.testing.assert_allclose(fast, reference, rtol=1e-6, atol=1e-6)
    lagging = SingleTrack(CAR, [CATALOGUE["feature_lag"]({"tau": 0.08}), CATALOGUE["steer_lag"]({"tau": 0.1})])
    assert [term.id for term in lagging.in_motion.terms] == ["steer_lag"]
    assert np.abs(nominal_errors(lagging, drive, starts, 5) - fast).max() > 0.1


def replace_speed(drive: Drive, factor: float) -> Drive:
    return replace(drive, columns={**drive.columns, "vx": factor * drive["vx"]})


def test_windows_start_every_h_and_never_reach_over_a_gap():
    drive = make_drive(0, segments=3, seconds=1.0, period=0.01, vehicle=CAR)  # 3 runs of 101 samples
    labels = compute_labels(drive, CAR, Z2, horizon=0.05)
    assert labels.window == 5
    expected = [*range(0, 101, 5), *range(101, 202, 5), *range(202, 298, 5)]
    assert labels.row.tolist() == expected
    assert labels.row[labels.reason == Reason.GAP].tolist() == [100, 201]
    assert not np.isfinite(labels.y[labels.reason == Reason.GAP]).any()
    inside = labels.reason != Reason.GAP
    assert (drive.segment[labels.row[inside] + 5] == labels.segment[inside]).all()
    dense = compute_labels(drive, CAR, Z2, horizon=0.05, stride=1)
    assert len(dense) == 3 * 101 - 5
    both = np.isin(dense.row, labels.row)
    np.testing.assert_array_equal(dense.y[both], labels.y)


def test_the_horizon_is_rounded_to_whole_samples_and_at_least_one():
    drive = make_drive(0, segments=2, seconds=2.0, period=0.04, vehicle=CAR)
    assert compute_labels(drive, CAR, Z2, horizon=0.05).horizon == pytest.approx(0.04)
    assert compute_labels(drive, CAR, Z2, horizon=0.001).window == 1
    assert compute_labels(drive, CAR, Z2, horizon=0.07).window == 2


def test_each_sample_gets_the_first_reason_that_applies():
    drive = make_drive(4, segments=1, seconds=4.0, period=0.05, vehicle=CAR)
    columns = {name: values.copy() for name, values in drive.columns.items()}
    quiet = slice(0, 20)
    columns["vx"][quiet], columns["vy"][quiet], columns["r"][quiet] = 15.0, 0.0, 0.0
    columns["T"][quiet], columns["delta"][quiet] = 0.0, 0.0
    columns["vx"][2] = 1.0
    columns["delta"][4] = 0.25
    columns["delta"][6] = 0.12
    columns["T"][8] = 2500.0  # 8 kN through wheels that hold 7 kN
    columns["r"][10] = np.nan
    columns["vx"][12] = np.inf
    labels = compute_labels(replace(drive, columns=columns), CAR, Z2)
    found = [Reason(code) for code in labels.reason[:14]]
    assert found[0] is Reason.ACCEPTED
    assert found[2] is Reason.SPEED
    assert found[4] is Reason.SLIP
    assert found[6] is Reason.SLIP_DIFFERENCE
    assert found[9:13] == [Reason.NON_FINITE] * 4
    assert np.isfinite(labels.y[labels.accepted]).all()
    hard = Region.of(CAR, p_long=3.0)
    assert Reason(compute_labels(drive_at(columns, drive), CAR, Z2, hard).reason[8]) is Reason.ELLIPSE
    assert sum(labels.counts().values()) + labels.accepted.sum() == len(labels)


def drive_at(columns: dict, like: Drive) -> Drive:
    return replace(like, columns=columns)


def test_held_out_rows_touch_no_label():
    drive = make_drive(0, segments=2, seconds=4.0, period=0.02, vehicle=CAR)
    labels = compute_labels(drive, CAR, Z2)
    rows = np.ones(len(drive), dtype=bool)
    rows[100:150] = False
    kept = labels.within(rows)
    for start in kept.row:
        assert rows[start : start + labels.window + 1].all()
    dropped = np.setdiff1d(labels.row, kept.row)
    assert all(not rows[start : start + labels.window + 1].all() for start in dropped)


def test_features_are_what_their_names_say():
    drive = make_drive(0, segments=2, seconds=1.0, vehicle=CAR)
    labels = compute_labels(drive, CAR, Z1)
    at = labels.row
    np.testing.assert_array_equal(labels.z[:, 0], drive["vx"][at])
    np.testing.assert_allclose(labels.z[:, 3], drive["T"][at] / 2500.0, rtol=1e-15)
    alpha = compute_labels(drive, CAR, FeatureSet(("alpha_f", "steer_rate"))).z
    vx, vy, r, delta = (drive[name][at] for name in ("vx", "vy", "r", "delta"))
    np.testing.assert_allclose(alpha[:, 0], delta - np.arctan((vy + 1.25 * r) / vx), atol=1e-15)
    with pytest.raises(DriveError, match="alpha_f"):
        compute_labels(drive, CAR, FeatureSet(("alpha_g",)))


def test_too_short_a_drive_says_so():
    drive = make_drive(0, segments=3, seconds=0.2, period=0.02, vehicle=CAR)
    with pytest.raises(DriveError, match=r"too short for a label.*11 samples.*needs 12"):
        compute_labels(drive, CAR, Z2, horizon=0.22)


def test_a_label_file_gives_the_labels_back(tmp_path):
    drive = make_drive(0, segments=3, seconds=1.0, vehicle=CAR)
    labels = compute_labels(drive, CAR, Z1)
    write_labels(labels, tmp_path / "a.parquet")
    again = read_labels(tmp_path / "a.parquet")
    for name in ("t", "row", "segment", "z", "y", "reason"):
        assert getattr(again, name).tobytes() == getattr(labels, name).tobytes()
    assert (again.features, again.region, again.horizon) == (labels.features, labels.region, labels.horizon)
    write_labels(again, tmp_path / "b.parquet")
    assert (tmp_path / "a.parquet").read_bytes() == (tmp_path / "b.parquet").read_bytes()
    (tmp_path / "c.parquet").write_bytes((tmp_path / "a.parquet").read_bytes()[:-20])
    with pytest.raises(DriveError, match="cannot be read as labels"):
        read_labels(tmp_path / "c.parquet")


@pytest.mark.parametrize("held", [(), ("T", "delta")])
@pytest.mark.parametrize(
    "effects",
    [
        (),
        (EffectSpec("drive_lag", {"tau": 0.3}, "along"), EffectSpec("steer_lag", {"tau": 0.8})),
        (EffectSpec("steer_backlash", {"width": 0.01}), EffectSpec("tire_relaxation", {"length": 3.0})),
        (EffectSpec("grip_fade", {"final_loss": 0.1, "tau": 9.0}), EffectSpec("drive_delay", {"delay": 0.07})),
    ],
    ids=["plain", "lags", "play", "delays"],
)
def test_labels_are_the_same_to_the_bit_whatever_the_pieces(effects, held, monkeypatch, tmp_path):
    car = road_car(effects=effects)
    made = make_drive(3, segments=4, seconds=7.0, vehicle=CAR).with_held(held)
    made.columns["vx"][40:60] = 2.0  # rejected, and beside accepted ones
    write_drive(made, tmp_path / "a.parquet")
    features = FeatureSet(("alpha_f", "steer_rate", "T"))
    whole = compute_labels(read_drive(tmp_path / "a.parquet"), car, features, horizon=0.1, stride=3)
    assert len(np.unique(whole.reason)) >= 3
    monkeypatch.setattr("split_cli.logs.drive.LONG_ROWS", 100)
    long = open_drive(tmp_path / "a.parquet")
    assert isinstance(long.columns, ColumnsOfFile)
    # Borders inside segments, on theirs and beside them.
    for rows in (57, 351, 352):
        monkeypatch.setattr("split_cli.learning.pieces.PIECE_ROWS", rows)
        for drive in (made, long):
            again = compute_labels(drive, car, features, horizon=0.1, stride=3)
            for name in ("t", "row", "segment", "z", "y", "reason"):
                assert getattr(again, name).tobytes() == getattr(whole, name).tobytes(), (name, rows)
