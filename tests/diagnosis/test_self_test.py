"""Thresholds from the simulation against itself."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.remainder.structure import FlexibleFit
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.self_test import SelfTest, error_of_discrepancy, self_test
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import case_of, verdict_of
from tests.factories import make_drive, road_car

NOISE = {"vx": 0.01, "vy": 0.01, "r": 0.002}


def wandering(length: int, seconds: float, period: float, rng: np.random.Generator) -> np.ndarray:
    """Return an Ornstein-Uhlenbeck path of unit variance, sampled exactly."""
    keep = np.exp(-period / seconds)
    steps = rng.standard_normal(length) * np.sqrt(1.0 - keep**2)
    out = np.empty(length)
    out[0] = rng.standard_normal()
    for k in range(1, length):
        out[k] = keep * out[k - 1] + steps[k]
    return out


def recorded(drive: Drive, seed: int, *, restless: float = 0.0) -> Drive:
    """Return a drive with sensor noise and, as in real ones, a lateral velocity that wanders [m/s]."""
    rng = np.random.default_rng(seed)
    columns = {**drive.columns}
    for name, sigma in NOISE.items():
        columns[name] = columns[name] + sigma * rng.standard_normal(len(drive))
    columns["vy"] = columns["vy"] + restless * wandering(len(drive), 0.5, drive.period, rng)
    return replace(drive, columns=columns)


def drive(seed: int, terms=()) -> Drive:
    return make_drive(seed, 8, 10.0, 0.02, terms=terms, name=f"{seed}.parquet")


def against_itself(simulation: Drive, reality: Drive) -> SelfTest:
    case = case_of(reality, simulation)
    candidates = build_candidates(road_car(), case.real[0].series)
    return self_test(
        case.rewhitened, case.discrepancy, candidates, variance_inflation=1.5, reach=0.35, posterior=case.posterior
    )


@pytest.fixture(scope="module")
def clean() -> SelfTest:
    return against_itself(drive(1), recorded(drive(2), 2))


@pytest.fixture(scope="module")
def restless() -> SelfTest:
    return against_itself(recorded(drive(1), 1, restless=0.1), recorded(drive(2), 2, restless=0.1))


def test_a_clean_simulation_shows_nothing_against_itself(clean):
    # The nominal model is exact here: what is left is its integration over a sample, far below noise.
    assert clean.rows > 300
    assert clean.ratio == pytest.approx(1.0, abs=0.03)
    # Noise alone would save one for each of some 150 parameters.
    assert max(clean.unnamed, *clean.terms.values()) < 10.0


def test_a_restless_recording_shows_what_is_to_be_forgiven(clean, restless):
    # Wandering of 0.1 m/s over 0.5 s is ten times the noise of a sample and slower than the rows.
    assert restless.ratio > 1.5 > 1.2 * clean.ratio
    # The best of some fifty directions in white noise saves about 9.
    assert max(restless.terms.values()) > 15.0
    assert restless.unnamed > 50.0 * clean.unnamed


def test_physics_that_comes_and_goes_is_forgiven_as_a_term():
    grip = CATALOGUE["friction_scale"]({"scale": 0.8})
    plain, slippery = drive(1), drive(1, (grip,))
    columns = {name: np.where(plain.segment % 2, slippery[name], plain[name]) for name in plain.columns}
    changed = against_itself(replace(plain, columns=columns), recorded(drive(2), 2))
    # A fifth of the grip for half of the time is far beyond noise, and one term holds most of it.
    assert changed.terms["friction_scale"] > 1000.0
    assert changed.terms["friction_scale"] <= changed.unnamed * 1.05
    # What has nothing to do with grip is forgiven less.
    assert changed.terms["drive_lag"] < 0.2 * changed.terms["friction_scale"]


def test_two_recordings_of_one_restless_car_match():
    """With a fault it is named: test_baselines."""
    simulation = recorded(drive(1), 1, restless=0.1)
    same = verdict_of([recorded(drive(2), 2, restless=0.1)], road_car(), [simulation])
    assert same.verdict == "match"
    assert not same.findings


def objective(rows: int) -> MarginalLikelihood:
    """Return an objective of which only the number of rows is known."""
    car, one, empty = road_car(), SimpleNamespace(), np.zeros(0)
    return MarginalLikelihood((one,), None, car, (np.ones(rows, dtype=bool),), empty, empty, empty, empty, empty)


def test_forgiveness_goes_with_the_rows(restless):
    once, fourfold = (restless.allow(objective(k * restless.rows)).term_floors["wind"] for k in (1, 4))
    assert fourfold == pytest.approx(2.0 * once)
    assert not SelfTest().allow(objective(10)).term_floors


def test_form_error_is_what_the_halves_show_and_reality_does_not_rule_out():
    def gap(saved: float) -> FlexibleFit:
        return FlexibleFit(saved, 200.0, 1.0, 0.0, ())

    halves = SelfTest(rows=800, ratio=20.0)
    assert halves.form_error_inflation_of(gap(1600.0)) == pytest.approx(1.5 * 8.0)
    assert halves.form_error_inflation_of(gap(80_000.0)) == pytest.approx(1.5 * 20.0)
    # Without a simulation to ask, none is known.
    assert SelfTest().form_error_inflation_of(gap(80_000.0)) == pytest.approx(1.5)


def test_of_more_rows_a_flexible_fit_takes_less_of_what_varies_together():
    assert SelfTest(rows=800, autocorrelation=1.7).usual_autocorrelation(3200) == pytest.approx(2.4)
    assert SelfTest(rows=800, autocorrelation=1.7).usual_autocorrelation(400) == pytest.approx(1.7)
    # Where the simulation is white, or nothing is known of it, nothing more is forgiven.
    assert SelfTest(rows=800).usual_autocorrelation(3200) == SelfTest().usual_autocorrelation(3200) == 1.0


def test_the_error_of_the_discrepancy_is_bounded_from_above():
    """Drawn with a known share, with noise or without: the bound is above it as often as stated, and not far above."""
    rng = np.random.default_rng(5)
    columns = rng.standard_normal((600, 18)) * np.geomspace(3.0, 30.0, 18)
    for quiet in (0.0, 1.0):
        bounds = []
        for _ in range(200):
            left = columns @ (0.03 * rng.standard_normal(18)) + (1.0 - quiet) * rng.standard_normal(600)
            bounds.append(error_of_discrepancy(columns, left, 1.0, quiet))
        assert np.mean(np.array(bounds) > 0.03) >= 0.9 and np.median(bounds) < 0.07
    # A discrepancy too small to be seen has an error of any size.
    assert error_of_discrepancy(1e-6 * columns, rng.standard_normal(600), 1.0, 0.0) == 1.0
    # One that is seen and is right has next to none.
    assert error_of_discrepancy(columns, rng.standard_normal(600), 1.0, 0.0) < 0.01


def test_the_likelihood_of_the_error_is_that_of_a_dense_gaussian():
    """The bound is where the dense likelihood has fallen by half of the square of 1.96."""
    rng = np.random.default_rng(6)
    columns = rng.standard_normal((80, 18))
    left = columns @ (0.4 * rng.standard_normal(18)) + rng.standard_normal(80)

    def likelihood(share):
        return multivariate_normal(cov=1.5 * (np.eye(80) + share**2 * columns @ columns.T)).logpdf(left)

    bound = error_of_discrepancy(columns, left, 1.5, 0.0)
    best = max(likelihood(share) for share in np.geomspace(1e-3, 1.0, 100))
    step = 10.0 ** (3.0 / 99.0)
    fallen = 0.5 * 1.96**2
    assert best - likelihood(bound) <= fallen < best - likelihood(bound * step)


def test_a_discrepancy_that_both_halves_have_is_known_well():
    """Simulation and reality share softer tyres, a large discrepancy of the nominal model."""
    softer = (CATALOGUE["tire_stiffness"]({"front_scale": 0.7, "rear_scale": 0.8}),)
    tested = against_itself(drive(1, softer), recorded(drive(2, softer), 2))
    assert 0.0 < tested.shared_error < 0.05


def test_the_error_that_is_allowed_for_is_at_most_that_of_any_effect(clean):
    """Of nothing that is shared, any share is as likely as another."""
    most = STANDARD.selection.form_error_share
    assert clean.shared_error > most and clean.allow(objective(10)).shared_error == most
    assert replace(clean, shared_error=0.02).allow(objective(10)).shared_error == 0.02
    assert SelfTest().allow(objective(10)).shared_error == most
