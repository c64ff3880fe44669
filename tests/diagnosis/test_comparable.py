"""Which rows are compared: where the simulation was asked for the same, or moved the same."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, build_shared_discrepancy, features
from split_cli.diagnosis.engine import _is_common
from split_cli.diagnosis.innovations.comparable import comparable
from split_cli.diagnosis.innovations.evidence import Evidence, gather_evidence
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.recording.series import build_series
from split_cli.diagnosis.search.self_test import SelfTest
from split_cli.logs.drive import Drive
from tests.factories import make_drive, road_car

REACH = 0.35


def evidence_of(drive: Drive, discrepancy: SharedDiscrepancy | None = None) -> tuple[Evidence, SharedDiscrepancy]:
    series = build_series(drive, "real", np.zeros(len(drive)))
    discrepancy = discrepancy or build_shared_discrepancy(road_car(), series)
    return gather_evidence(road_car(), series, discrepancy), discrepancy


@pytest.fixture(scope="module")
def simulated() -> tuple[Evidence, SharedDiscrepancy]:
    return evidence_of(make_drive(1, 8, 10.0, 0.02))


def asked_alike(one: Evidence, other: Evidence, discrepancy: SharedDiscrepancy) -> np.ndarray:
    """Return the rows near in what was asked for, by every distance there is."""
    mine, theirs = (
        (features(each.series, each.vehicle)[each.at] - discrepancy.center) / discrepancy.width for each in (one, other)
    )
    return np.array([np.min(np.linalg.norm(theirs - point, axis=1)) <= REACH for point in mine])


def share_of_grip(one: Evidence) -> np.ndarray:
    """Return the lateral and longitudinal acceleration of the recording over what its tyres have, (G,)."""
    car, series = one.vehicle, one.series
    vx, vy, r = series.smooth.T
    along, side = (np.zeros(len(vx)) for _ in range(2))
    for begin, end in series.recording.segments:
        run = slice(begin, end)
        along[run] = np.gradient(vx[run], series.period) - vy[run] * r[run]
        side[run] = np.gradient(vy[run], series.period) + vx[run] * r[run]
    return np.hypot(along, side)[one.at] * car.mass / (car.front_tire.D + car.rear_tire.D)


def test_rows_are_compared_only_where_rows_of_weight_have_been(simulated):
    one, discrepancy = simulated
    assert comparable(one, [one], discrepancy, REACH)[one.series.smooth[one.at, 0] > 4.0].all()
    first = np.arange(len(one.at)) < 100
    near = comparable(one, [replace(one, weight=one.weight * first)], discrepancy, REACH)
    assert near[:100].mean() > 0.9
    assert 0.0 < near.mean() < 0.9


def test_what_was_asked_alike_is_compared_unless_axles_push_as_they_never_did(simulated):
    one, discrepancy = simulated
    other, _ = evidence_of(make_drive(2, 8, 10.0, 0.02), discrepancy)
    alike = asked_alike(other, one, discrepancy) & (other.weight > 0.0)
    fast = other.series.smooth[other.at, 0] >= 0.6 * other.vehicle.minimum_speed
    assert 0 < alike.sum() < len(alike)
    assert comparable(other, [one], discrepancy, REACH)[alike & fast].all()
    # Three times the mass is three times the force of the same slips.
    car = one.vehicle
    heavy = replace(one, vehicle=replace(car, mass=3.0 * car.mass, yaw_inertia=3.0 * car.yaw_inertia))
    kept, hard = comparable(heavy, [one], discrepancy, REACH), share_of_grip(heavy)
    assert kept[hard < 0.3].mean() > 0.5
    assert not kept[hard > 3.5 * np.quantile(share_of_grip(one), 0.9)].any()


@pytest.mark.parametrize("change", [{"delta": 1.0 / 0.7}, {"T": 1.0 / 0.6}])
def test_a_drive_that_moves_the_same_is_compared_though_its_commands_are_elsewhere(simulated, change):
    one, discrepancy = simulated
    drive = make_drive(1, 8, 10.0, 0.02)
    faulty = replace(drive, columns={**drive.columns, **{k: drive[k] * v for k, v in change.items()}})
    other, _ = evidence_of(faulty, discrepancy)
    usable = other.weight > 0.0
    sure = usable & (share_of_grip(other) < 0.4)
    off = sure & ~asked_alike(other, one, discrepancy)
    # There are rows that only the motion brings back, and it brings most of them back.
    assert off.sum() > 20
    assert comparable(other, [one], discrepancy, REACH)[off].mean() > 0.8


def test_at_the_limit_motion_alone_proves_nothing(simulated):
    one, discrepancy = simulated
    drive = make_drive(1, 8, 10.0, 0.02)
    other, _ = evidence_of(replace(drive, columns={**drive.columns, "delta": drive["delta"] / 0.7}), discrepancy)
    car = other.vehicle
    # The same motion with tyres that hardly manage it.
    weak = replace(
        car,
        front_tire=replace(car.front_tire, D=0.3 * car.front_tire.D),
        rear_tire=replace(car.rear_tire, D=0.3 * car.rear_tire.D),
    )
    limited = replace(other, vehicle=weak)
    beyond = (share_of_grip(limited) > 0.9) & ~asked_alike(other, one, discrepancy) & (other.weight > 0.0)
    assert beyond.sum() > 20
    assert comparable(other, [one], discrepancy, REACH)[beyond].mean() > 0.5
    # All but the few that slip and push as another row did.
    assert comparable(limited, [one], discrepancy, REACH)[beyond].mean() < 0.2


def test_at_the_limit_the_same_slips_speed_and_force_are_compared_whatever_torque_was_asked(simulated):
    """Nine tenths of the peak force are asked of tyres that slip and push as they did, by other torques."""
    one, discrepancy = simulated
    drive = make_drive(1, 8, 10.0, 0.02)
    other, _ = evidence_of(replace(drive, columns={**drive.columns, "T": drive["T"] / 0.6}), discrepancy)
    tires = {name: getattr(one.vehicle, name) for name in ("front_tire", "rear_tire")}
    weak = replace(one.vehicle, **{name: replace(tire, D=0.3 * tire.D) for name, tire in tires.items()})
    limited = replace(other, vehicle=weak)
    beyond = (share_of_grip(limited) > 0.9) & ~asked_alike(other, one, discrepancy) & (other.weight > 0.0)
    assert beyond.sum() > 20
    assert comparable(limited, [one], discrepancy, REACH)[beyond].mean() > 0.9


def test_sliding_without_the_forces_of_sliding_proves_nothing_either(simulated):
    """A heading that is 0.25 rad off turns the velocity: slips beyond the peak, and the motion as it was."""
    one, discrepancy = simulated
    drive = make_drive(1, 8, 10.0, 0.02)
    turned = {"vy": drive["vy"] + 0.25 * drive["vx"]}
    other, _ = evidence_of(replace(drive, columns={**drive.columns, **turned}), discrepancy)
    tire = other.vehicle.rear_tire
    slip = features(other.series, other.vehicle)[other.at, 1]
    peak = tire.C * np.arctan(tire.B * np.abs(slip)) > 0.5 * np.pi
    unlike = peak & (share_of_grip(other) < 0.4) & ~asked_alike(other, one, discrepancy)
    assert unlike.sum() > 20
    assert not comparable(other, [one], discrepancy, REACH)[unlike].any()


@pytest.mark.parametrize(
    ("share", "theirs", "common"),
    [(0.9, 0.3, True), (0.1, 0.9, False), (0.9, 0.1, False), (0.19, 1.0, False), (0.21, 0.21, True)],
)
def test_names_ask_for_a_fair_share_of_either_drive_where_the_vehicle_file_errs_much(share, theirs, common):
    rows = np.arange(1000) < 1000 * theirs
    much, little, unknown = SelfTest(rows=300, ratio=3.3), SelfTest(rows=300, ratio=2.7), SelfTest()
    assert _is_common(share, rows, much, STANDARD) is common and _is_common(share, rows, unknown, STANDARD) is common
    # If one half of the simulation is as the other taught, what little is common can be judged.
    assert _is_common(share, rows, little, STANDARD)
    # A simulation of many drives has been elsewhere, too: rows of a decision are enough of it.
    many = np.concatenate([rows, np.zeros(5000, dtype=bool)])
    assert _is_common(share, many, much, STANDARD) is (share >= 0.2 and 1000 * theirs >= 250)
