"""Lags and combined slip that simulation and reality share: found on the simulation, and a yaw inertia beside."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, build_shared_discrepancy
from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.evidence import gather_evidence
from split_cli.diagnosis.innovations.objective import build_objective, learn_discrepancy
from split_cli.diagnosis.innovations.shared_terms import shared_terms_of
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.recording.series import Series, build_series
from split_cli.logs.drive import Drive
from split_cli.proof.sets import scripted_drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import read_vehicle
from tests.diagnosis.recordings import noisy_series

CAR = read_vehicle(library_path("av21"))
SHARED = {
    "drive_lag": {"tau": 0.08},
    "steer_lag": {"tau": 0.06},
    "tire_relaxation": {"length": 0.5},
    "combined_slip": {"strength": 0.8},
}


@pytest.fixture(scope="module")
def late_pair() -> tuple[Series, Series]:
    """Two cars that answer late and share their grip, the second with 15 % more yaw inertia, both with sensor noise."""
    shared, heavy = (
        [CATALOGUE[term](values) for term, values in SHARED.items()],
        CATALOGUE["yaw_inertia"]({"scale": 1.15}),
    )
    return noisy_series(CAR, shared, 31, "sim"), noisy_series(CAR, (*shared, heavy), 32, "real")


def yaw_inertia_found(discrepancy: SharedDiscrepancy, sim: Series, real: Series) -> float:
    taught, seen = (gather_evidence(CAR, one, discrepancy) for one in (sim, real))
    objective = build_objective([seen], learn_discrepancy([taught]), discrepancy, [np.ones(len(seen.at), dtype=bool)])
    scales = np.linspace(0.9, 1.4, 101)
    costs = [objective.cost((CATALOGUE["yaw_inertia"]({"scale": scale}),)) for scale in scales]
    return float(scales[int(np.argmin(costs))])


def test_terms_of_a_simulation_are_found(late_pair):
    found = {one.id: dict(one.parameters) for one in gather_case(CAR, late_pair).discrepancy.shared_terms}
    for term, values in SHARED.items():
        # Of four drives combined slip is 0.60 to 1.00, with a mean of 0.81.
        assert found[term] == pytest.approx(values, rel=0.3 if term == "combined_slip" else 0.15), term


def test_a_nominal_car_has_none():
    columns = dict(scripted_drive(CAR, (), 33, runs=8))
    drive = Drive("nominal.parquet", columns, columns.pop("segment"), 0.01).with_held(("T", "delta"))
    series = build_series(drive, "sim", np.cumsum(0.01 * columns["vx"]))
    discrepancy = build_shared_discrepancy(CAR, series)
    torque, steer, relaxation, ellipse = shared_terms_of([gather_evidence(CAR, series, discrepancy)], discrepancy)
    assert torque.parameters["tau"] < 1e-3 and steer.parameters["tau"] < 1e-3
    assert relaxation.parameters["length"] < 0.01 and ellipse.parameters["strength"] < 0.05


def test_a_yaw_inertia_is_found_beside_terms_that_both_cars_have(late_pair):
    discrepancy = gather_case(CAR, late_pair).discrepancy
    assert yaw_inertia_found(discrepancy, *late_pair) == pytest.approx(1.15, abs=0.02)


def begun_later(series: Series, seconds: float) -> Series:
    """Return a recording whose every segment begins later, in the midst of driving."""
    segment, period = series.drive.segment, series.period
    into = np.arange(len(segment)) - np.searchsorted(segment, segment)
    columns = {name: values[into * period >= seconds] for name, values in series.drive.columns.items()}
    drive = replace(series.drive, columns=columns, segment=segment[into * period >= seconds])
    return build_series(drive, series.role, np.cumsum(period * columns["vx"]))


def test_what_a_late_car_did_before_a_recording_began_is_not_compared(late_pair):
    """The wheels' angle, the torque and the tyres' forces at the begin answer to commands that were not recorded."""
    series = begun_later(late_pair[0], 1.0)
    shared = tuple(CATALOGUE[term](values) for term, values in SHARED.items())
    discrepancy = replace(build_shared_discrepancy(CAR, series), shared_terms=shared)
    whole = replace(STANDARD.believing, settling=0.0)
    everything, settled = (
        gather_evidence(CAR, series, discrepancy, rules=rules) for rules in (whole, STANDARD.believing)
    )
    began = np.concatenate([np.full(end - begin, begin) for begin, end in series.recording.segments])
    since = (everything.at - began[everything.at]) * series.period
    # Three times the longer one of both chains: torque, or steering and then tyres.
    speed = np.abs(series.smooth[began[everything.at], 0])
    unsettled = since < 3.0 * np.maximum(0.08, 0.06 + 0.5 / speed) - 0.02
    assert not settled.weight[unsettled].any() and (settled.weight[since > 0.3] > 0.0).all()
    wrong, right = (np.mean(everything.nominal_rows[rows] ** 2) for rows in (unsettled, settled.weight > 0.0))
    assert wrong > 10.0 and 0.8 < right < 1.1
    # A car that answers at once is compared from its first row.
    at_once = gather_evidence(CAR, series, replace(discrepancy, shared_terms=()))
    assert (at_once.weight > 0.0).all()
