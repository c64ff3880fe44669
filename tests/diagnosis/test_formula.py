"""The sparse formula: planted forces read off again, and nothing read into noise."""

import re

import numpy as np
import pytest

from split_cli.diagnosis.baseline.discrepancy import features
from split_cli.diagnosis.remainder.formula import sparse_formula
from tests.factories import road_car


def terms_of(formula: str) -> tuple[str, dict[str, float], float]:
    """Return the force, the weights by name [N] and the share told."""
    force, rest = formula.split(" = ")
    body, share = re.fullmatch(r"(.*) \((\d+) ?% of it\)", rest).groups()
    sums = re.split(r" (?=[+-][\d.]+(?:e[+-]?\d+)? N)", body)
    pairs = [(one.partition(" N")[0], one.partition(" N")[2].strip()) for one in sums]
    return force, {name: float(weight) for weight, name in pairs}, float(share) / 100.0


@pytest.fixture(scope="module")
def columns(nominal_series):
    """Torque over its maximum and B alpha at every sample, by their definitions."""
    car = road_car()
    z = features(nominal_series, car)
    return {"torque": z[:, 2], "front": car.front_tire.B * z[:, 0], "rear": car.rear_tire.B * z[:, 1]}


def formula_of(evidence, forces: np.ndarray) -> str:
    return sparse_formula([evidence], [forces], [np.ones(len(evidence.at), dtype=bool)])


def noise(seed: int, shape: tuple[int, ...], level: float = 30.0) -> np.ndarray:
    return level * np.random.default_rng(seed).standard_normal(shape)


def test_one_planted_term_is_read_off(nominal_evidence, columns):
    forces = noise(1, (len(nominal_evidence.series), 3))
    braking = np.maximum(-columns["torque"], 0.0)
    forces[:, 1] += 900.0 * columns["front"] * braking
    force, weights, share = terms_of(formula_of(nominal_evidence, forces))
    assert force == "front lateral force" and set(weights) == {"B alpha_f (T/T_max)_-"}
    # Four hundred rows of noise of 30 N against a column of about 0.1: some twenty newtons.
    assert weights["B alpha_f (T/T_max)_-"] == pytest.approx(900.0, rel=0.1)
    # Of the rows it looks at, every fifth.
    rows = nominal_evidence.at[::5]
    left = (forces[:, 1] - 900.0 * columns["front"] * braking)[rows]
    assert share == pytest.approx(1.0 - np.mean(left**2) / np.mean(forces[rows, 1] ** 2), abs=0.02)


def test_two_planted_terms_are_read_off_with_their_signs(nominal_evidence, columns):
    forces = noise(2, (len(nominal_evidence.series), 3))
    forces[:, 2] += 2500.0 * columns["rear"] ** 2 - 250.0
    force, weights, _ = terms_of(formula_of(nominal_evidence, forces))
    assert force == "rear lateral force" and set(weights) == {"(B alpha_r)^2", ""}  # a constant has no name
    assert weights["(B alpha_r)^2"] == pytest.approx(2500.0, rel=0.15)
    assert weights[""] == pytest.approx(-250.0, rel=0.1)


def test_the_force_that_is_explained_most_is_told(nominal_evidence, columns):
    forces = noise(3, (len(nominal_evidence.series), 3))
    forces[:, 0] += 300.0 * columns["torque"]
    forces[:, 1] += 700.0 * columns["front"]
    strong, weak = np.var(forces[:, 1]), np.var(forces[:, 0])
    assert strong > 1.5 * weak
    force, weights, _ = terms_of(formula_of(nominal_evidence, forces))
    assert force == "front lateral force" and set(weights) == {"B alpha_f"}


def test_noise_has_no_formula(nominal_evidence):
    found = [formula_of(nominal_evidence, noise(seed, (len(nominal_evidence.series), 3))) for seed in range(20, 26)]
    # Twenty-six functions of three forces each: the criterion asks for 2.4 deviations, stability for most halves.
    assert sum(bool(text) for text in found) <= 2


def test_what_one_stretch_of_time_shows_is_not_stable(nominal_evidence, columns):
    """A push in one block of four seconds of ninety-six: half of the draws do not have it."""
    forces = noise(4, (len(nominal_evidence.series), 3), 20.0)
    moment = (nominal_evidence.series.t >= 48.0) & (nominal_evidence.series.t < 52.0)
    forces[moment, 1] += 600.0 * columns["front"][moment]
    text = formula_of(nominal_evidence, forces)
    assert not text or "B alpha_f" not in terms_of(text)[1] or terms_of(text)[2] < 0.1
