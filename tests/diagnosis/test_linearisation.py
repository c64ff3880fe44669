"""How rates answer to deviations of the velocities: against differences of the model that has the memory itself."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy
from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.evidence import gather_evidence
from split_cli.diagnosis.innovations.linearisation import linearise
from split_cli.diagnosis.recording.series import Series, build_series, extended_model
from split_cli.logs.drive import Drive
from split_cli.proof.sets import scripted_drive
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.effects.recording import over_samples
from split_cli.vehicle.library import library_path
from split_cli.vehicle.parameters import EffectSpec, Vehicle, read_vehicle
from tests.diagnosis.recordings import noisy_series

CAR = read_vehicle(library_path("av21"))
#: A car of a tenth of the size: half of a deviation is gone within two samples of 10 ms.
SMALL = read_vehicle(Path(__file__).resolve().parents[2] / "sample_logs" / "f1tenth_car.yaml")
SMALL_NOISE = np.array([0.012, 0.010, 0.02])


def relaxation(length: float) -> Term:
    return CATALOGUE["tire_relaxation"]({"length": length})


@pytest.mark.parametrize("length", [0.0, 0.005, 0.3, 2.0])
def test_it_is_the_derivative_of_a_model_with_memory(length):
    """By central differences of the model's rates along the recording, at a deviation that changes slowly."""
    series = noisy_series(CAR, (), 41, "sim")
    model = extended_model(CAR, (relaxation(length),))
    t = series.t[:, None]
    deviation = np.hstack([0.5 * np.sin(1.3 * t), np.sin(4.0 * t + 0.3), 0.2 * np.cos(2.0 * t)])
    ahead, behind = (series.rates(model, series.predicted + side * 1e-5 * deviation) for side in (1.0, -1.0))
    expected = (ahead - behind) / 2e-5
    found = over_samples(linearise(CAR, series, (relaxation(length),)).of_deviation(deviation), series.recording)
    inside = np.append(series.inside(), False)
    assert np.abs(found - expected)[inside].max() < 0.01 * np.abs(expected)[inside].max()


def test_a_force_that_builds_up_at_once_is_that_of_the_jacobian():
    series = noisy_series(CAR, (), 41, "sim")
    plain, short = (linearise(CAR, series, (relaxation(length),)) for length in (0.0, 1.1e-3))
    deviation = np.random.default_rng(3).normal(0.0, 0.1, (len(series), 3))
    assert plain.of_noise() is plain.jacobian
    assert short.of_noise() == pytest.approx(plain.jacobian, rel=0.02, abs=0.1)
    assert short.of_deviation(deviation) == pytest.approx(plain.of_deviation(deviation), rel=0.05, abs=0.3)


def test_lateral_forces_alone_build_up():
    """Of v_x' = ... + v_y r and v_y' = ... - v_x r the products answer at once, and so does drag."""
    series = noisy_series(CAR, (), 41, "sim")
    vx, vy, r = series.predicted.T
    zero = np.zeros(len(series))
    drag = -2.0 * CAR.drag_coefficient * vx / CAR.mass
    expected = np.array([[drag, r, vy], [-r, zero, -vx], [zero, zero, zero]]).transpose(2, 0, 1)
    assert linearise(CAR, series, (relaxation(0.4),)).immediate == pytest.approx(expected, abs=1e-6)


def test_a_relaxation_of_the_vehicle_file_counts():
    late = CAR.with_effects(EffectSpec("tire_relaxation", {"length": 0.4}))
    series = noisy_series(CAR, (), 41, "sim")
    own, given = linearise(late, series), linearise(CAR, series, (relaxation(0.4),))
    assert own.of_noise() == pytest.approx(given.of_noise()) and own.rate == pytest.approx(given.rate)


def small_series(vehicle: Vehicle, terms: tuple[Term, ...], seed: int, times_noise: float) -> Series:
    columns, rng = dict(scripted_drive(vehicle, terms, seed, runs=12)), np.random.default_rng(seed)
    segment = columns.pop("segment")
    for name, sigma in zip(("vx", "vy", "r"), times_noise * SMALL_NOISE, strict=True):
        columns[name] = columns[name] + rng.normal(0.0, sigma, len(segment))
    drive = Drive("small.parquet", columns, segment, 0.01).with_held(("T", "delta"))
    return build_series(drive, "sim", np.cumsum(0.01 * columns["vx"]))


def test_noise_shortens_no_relaxation_length():
    """With forces that answer to noise at once, 0.12 m became 0.06 m in a model car."""
    found = []
    for seed in (51, 52, 53):
        series = small_series(SMALL, (relaxation(0.12), CATALOGUE["steer_lag"]({"tau": 0.04})), seed, 1.0)
        shared = {
            one.id: one for one in gather_case(SMALL, [series, replace(series, role="real")]).discrepancy.shared_terms
        }
        found.append(shared["tire_relaxation"].parameters["length"])
    assert np.mean(found) == pytest.approx(0.12, rel=0.15)


def test_rows_of_the_right_model_are_of_unit_variance():
    """What noise of earlier samples leaves in forces is small beside what a sample's own noise does."""
    series = small_series(SMALL, (relaxation(0.12),), 54, 1.0)
    discrepancy = replace(build_shared_discrepancy(SMALL, series), shared_terms=(relaxation(0.12),))
    evidence = gather_evidence(SMALL, series, discrepancy)
    assert np.var(evidence.nominal_rows, axis=0) == pytest.approx(1.0, abs=0.15)
