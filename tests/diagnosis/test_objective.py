"""Costs of explanations against their dense formula, and against minimising over the shared discrepancy."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import sqrtm

from split_cli.diagnosis.innovations.objective import (
    DiscrepancyPosterior,
    MarginalLikelihood,
    build_objective,
    learn_discrepancy,
)
from split_cli.diagnosis.search.form_error import varied_discrepancy
from split_cli.vehicle.effects import CATALOGUE

ROWS, COLUMNS = 40, 6
_NEXT_TO_NOTHING = 2e-3  # share of a direction that may be left out


class WrittenEvidence(SimpleNamespace):
    """Rows that are simply given."""

    def rows(self, terms, discrepancy_rates=None):
        return self.nominal_rows


def written(seed: int, rows: int = ROWS, columns: int = COLUMNS, size: float = 1.0) -> WrittenEvidence:
    rng = np.random.default_rng(seed)
    return WrittenEvidence(
        nominal_rows=rng.standard_normal((rows, 3)),
        discrepancy=size * rng.standard_normal((rows, 3, columns)),
        weight=np.sqrt(rng.uniform(0.3, 1.0, rows)),
        series=SimpleNamespace(t=0.04 * np.arange(rows)),
        at=np.arange(rows),
    )


def objective_of(*evidence: WrittenEvidence, posterior: DiscrepancyPosterior | None, keep=None) -> MarginalLikelihood:
    keep = keep or [np.ones(len(one.at), dtype=bool) for one in evidence]
    return build_objective(evidence, posterior, None, keep)


def posterior_of(seed: int, strength: float, columns: int = COLUMNS) -> DiscrepancyPosterior:
    rng = np.random.default_rng(seed)
    mix = rng.standard_normal((columns, columns))
    return DiscrepancyPosterior(rng.standard_normal(columns), strength * (mix @ mix.T + np.eye(columns)))


def flat(*evidence: WrittenEvidence) -> tuple[np.ndarray, np.ndarray]:
    """Return weighted rows (R,) and columns (R, C), stacked by loops."""
    rows, columns = [], []
    for one in evidence:
        for k in range(len(one.at)):
            for channel in range(3):
                rows.append(one.weight[k] * one.nominal_rows[k, channel])
                columns.append(one.weight[k] * one.discrepancy[k, channel])
    return np.array(rows), np.array(columns)


def test_the_shared_discrepancy_is_learned_by_ridge():
    one, two = written(1), written(2, rows=25)
    for each in (one, two):
        # Nine times the variance they are whitened by: believed as five times, never less.
        each.nominal_rows *= 3.0
    rows, columns = flat(one, two)
    known = learn_discrepancy([one, two], variance_inflation=1.7)
    # What noise the rows are believed to have, told by the precision: these rows hold more than the columns do.
    believed = np.trace(columns.T @ columns) / np.trace(known.precision - np.eye(COLUMNS))
    assert believed == pytest.approx(5.0 * 1.7, rel=1e-6)
    # Standard normal priors are rows of their own; noise is wider by the root of the variance inflation.
    stacked = np.concatenate([columns / np.sqrt(believed), np.eye(COLUMNS)])
    target = np.concatenate([rows / np.sqrt(believed), np.zeros(COLUMNS)])
    np.testing.assert_allclose(known.weights, np.linalg.lstsq(stacked, target, rcond=None)[0], rtol=1e-9)
    np.testing.assert_allclose(known.precision, stacked.T @ stacked, rtol=1e-9)


def test_a_simulation_is_believed_as_far_as_the_dictionary_holds_it():
    """Rows of a tenth of the noise teach a hundred times as much, without any noise a thousand times, not more.

    What the dictionary leaves beyond the noise teaches less, down to a fifth.
    """
    truth = np.random.default_rng(23).standard_normal(COLUMNS)
    for level, expected in ((0.1, 0.01), (0.0, 1e-3), (1.5, 2.25), (9.0, 5.0)):
        one = written(24, rows=600)
        one.weight = np.ones(600)
        one.nominal_rows = one.discrepancy @ truth + level * one.nominal_rows
        known = learn_discrepancy([one], variance_inflation=1.5)
        _, columns = flat(one)
        noise = np.trace(columns.T @ columns) / np.trace(known.precision - np.eye(COLUMNS)) / 1.5
        # A long-run variance over 25 of 600 rows is known to a quarter, and the worst of three channels is taken.
        bound = level in (0.0, 9.0)
        assert noise == pytest.approx(expected, rel=1e-6) if bound else 0.7 < noise / expected < 2.0
        if level < 1.0:
            np.testing.assert_allclose(known.weights, truth, atol=0.02)


@pytest.mark.parametrize("strength", [0.1, 3.0, 100.0])
def test_costs_are_the_dense_quadratic_form(strength):
    one, two = written(3), written(4, rows=25)
    known = posterior_of(5, strength)
    objective = objective_of(one, two, posterior=known)
    rows, columns = flat(one, two)
    left = rows - columns @ known.weights
    dense = np.eye(len(rows)) + columns @ np.linalg.solve(known.precision, columns.T)
    np.testing.assert_allclose(objective.residual(()), left, rtol=1e-12, atol=1e-12)
    assert objective.cost(()) == pytest.approx(left @ np.linalg.solve(dense, left), rel=1e-9)
    # Entry by entry it is the symmetric root, so that blocks of time share the cost out as they should.
    root = np.real(sqrtm(np.linalg.inv(dense)))
    np.testing.assert_allclose(objective.whiten(left), root @ left, rtol=1e-7, atol=1e-9)
    several = np.random.default_rng(6).standard_normal((len(rows), 3))
    np.testing.assert_allclose(objective.whiten(several), root @ several, rtol=1e-7, atol=1e-9)


def test_costs_are_least_over_what_the_shared_discrepancy_may_still_be():
    """min over d of |r - Phi d|^2 + d^T H d, as one least squares problem."""
    one, known = written(7), posterior_of(8, 2.0)
    objective = objective_of(one, posterior=known)
    rows, columns = flat(one)
    left = rows - columns @ known.weights
    stacked = np.concatenate([columns, np.linalg.cholesky(known.precision).T])
    target = np.concatenate([left, np.zeros(COLUMNS)])
    moved = np.linalg.lstsq(stacked, target, rcond=None)[0]
    assert objective.cost(()) == pytest.approx(float(np.sum((target - stacked @ moved) ** 2)), rel=1e-9)


def test_directions_that_reality_says_nothing_about_change_costs_by_next_to_nothing():
    """Columns from large to tiny against what is known of them: the last is left out, and not missed."""
    one, known = written(9), DiscrepancyPosterior(np.full(COLUMNS, 0.3), np.eye(COLUMNS))
    one.discrepancy *= 10.0 ** (-0.5 * np.arange(COLUMNS))
    objective = objective_of(one, posterior=known)
    rows, columns = flat(one)
    left = rows - columns @ known.weights
    dense = np.eye(len(rows)) + columns @ np.linalg.solve(known.precision, columns.T)
    # Some 80 weighted squares a column: reality's share of what is known, from most to little.
    assert objective.basis.shape[1] == COLUMNS - 1
    difference = objective.cost(()) - left @ np.linalg.solve(dense, left)
    assert 0.0 <= difference <= _NEXT_TO_NOTHING * (left @ left)


def test_a_simulation_that_knows_everything_leaves_plain_squares():
    one, known = written(11), posterior_of(12, 1e9)
    objective = objective_of(one, posterior=known)
    rows, columns = flat(one)
    assert objective.cost(()) == pytest.approx(float(np.sum((rows - columns @ known.weights) ** 2)), rel=1e-6)


def test_a_simulation_that_knows_nothing_leaves_what_no_shared_discrepancy_reaches():
    one, known = written(13), posterior_of(14, 1e-9)
    objective = objective_of(one, posterior=known)
    rows, columns = flat(one)
    left = rows - columns @ np.linalg.lstsq(columns, rows, rcond=None)[0]
    assert objective.cost(()) == pytest.approx(float(left @ left), rel=1e-6)


def test_without_a_simulation_nothing_is_common():
    one = written(15)
    objective = objective_of(one, posterior=None)
    rows, _ = flat(one)
    assert objective.whiten(rows) is rows
    assert objective.cost(()) == pytest.approx(float(rows @ rows))
    assert objective.shared_cost == 0.0
    assert not objective.shift((CATALOGUE["steer_gain"]({"gain": 0.8}),)).any()


def test_shared_cost_is_what_the_simulation_explains_of_reality():
    one = written(16)
    truth = np.random.default_rng(17).standard_normal(COLUMNS)
    one.nominal_rows = one.discrepancy @ truth
    objective = objective_of(one, posterior=DiscrepancyPosterior(truth, 1e9 * np.eye(COLUMNS)))
    rows, _ = flat(one)
    # Everything is explained; weights that explain nothing share nothing.
    assert objective.shared_cost == pytest.approx(float(rows @ rows))
    wrong = objective_of(one, posterior=DiscrepancyPosterior(-truth, 1e9 * np.eye(COLUMNS)))
    assert wrong.shared_cost == 0.0


def test_rows_that_are_not_compared_have_no_say():
    one = written(18, rows=130)
    # The first block of 50 rows is not compared at all, of the others a third.
    mask = (np.arange(130) % 3 == 0) & (np.arange(130) >= 50)
    shorter = WrittenEvidence(
        nominal_rows=one.nominal_rows[mask],
        discrepancy=one.discrepancy[mask],
        weight=one.weight[mask],
        series=one.series,
        at=one.at[mask],
    )
    known = posterior_of(19, 1.0)
    whole = objective_of(one, posterior=known, keep=[mask])
    assert whole.cost(()) == pytest.approx(objective_of(shorter, posterior=known).cost(()), rel=1e-12)
    np.testing.assert_array_equal(whole.block, np.repeat([0] * 17 + [1] * 10, 3))


def test_blocks_are_two_seconds_of_one_recording():
    first, second = written(20, rows=120), written(21, rows=60)
    objective = objective_of(first, second, posterior=None)
    residuals = np.random.default_rng(22).standard_normal(3 * 180)
    # 50 rows of 0.04 s a block: 50, 50, 20, and the second recording begins anew.
    edges = 3 * np.array([0, 50, 100, 120, 170, 180])
    expected = [residuals[a:b].sum() for a, b in zip(edges[:-1], edges[1:], strict=True)]
    np.testing.assert_allclose(objective.block_sums(residuals), expected)


def test_the_shift_is_zero_at_neutral_and_moves_no_term_of_the_car(gathered, discrepancy):
    known = learn_discrepancy([gathered])
    keep = [np.ones(len(gathered.at), dtype=bool)]
    objective = build_objective([gathered], replace(known, weights=known.weights + 0.3), discrepancy, keep)
    assert not objective.shift((CATALOGUE["mass"]({"scale": 1.2}),)).any()
    neutral = objective.shift((CATALOGUE["steer_gain"]({"gain": 1.0}),))
    away = objective.shift((CATALOGUE["steer_gain"]({"gain": 1.1}),))
    # Two ways to the same rows: by columns that are whitened, and by rates that are.
    assert np.abs(neutral).max() < 1e-8 * np.abs(objective.offset).max()
    assert np.abs(away).max() > 1e-3 * np.abs(objective.offset).max()


def test_variants_of_equal_value_are_not_taken_for_each_other(gathered, discrepancy):
    """What is remembered of one would else depend on which of them was asked for first."""
    known = learn_discrepancy([gathered])
    keep = [np.ones(len(gathered.at), dtype=bool)]
    learned = replace(known, weights=known.weights + 0.3)
    objective = build_objective([gathered], learned, discrepancy, keep)
    whole, along = (CATALOGUE["drive_lag"]({"tau": 0.08}, variant) for variant in ("", "along"))
    first = objective.shift((whole,))
    assert not np.allclose(first, objective.shift((along,)), rtol=1e-3)
    afresh = build_objective([gathered], learned, discrepancy, keep)
    np.testing.assert_array_equal(objective.shift((along,)), afresh.shift((along,)))


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("steer_lag", {"tau": 0.08}),
        ("yaw_inertia", {"scale": 1.3}),
        ("mass", {"scale": 0.8}),
        ("cg_shift", {"dx": 0.1}),
    ],
)
def test_costs_follow_the_shared_discrepancy_where_a_term_moves_it(gathered, discrepancy, name, values):
    """The rows of model, term and moved discrepancy, whitened together, against rows and shift apart."""
    known = learn_discrepancy([gathered])
    known = replace(known, weights=known.weights + 0.3)
    objective = build_objective([gathered], known, discrepancy, [np.ones(len(gathered.at), dtype=bool)])
    terms = (CATALOGUE[name](values),)
    left = gathered.defects(terms, discrepancy.rates(gathered.series, known.weights, terms))
    expected = float(np.sum(objective.whiten(objective.stack([gathered.whitener(left)])) ** 2))
    # Between shifts of the CG that are 0.02 wheelbases apart the discrepancy runs in straight lines.
    assert objective.cost(terms) == pytest.approx(expected, rel=1e-3 if name == "cg_shift" else 1e-9)
    # The shared discrepancy that stayed as the recording has it would be a different cost, not one by rounding.
    stayed = objective.whiten(objective.stack([gathered.rows(terms)]) - objective.offset)
    assert abs(float(np.sum(stayed**2)) / expected - 1.0) > 1e-3


@pytest.mark.parametrize(
    "terms",
    [{"steer_lag": 0.08}, {"yaw_inertia": 1.3}, {"steer_lag": 0.08, "yaw_inertia": 1.3}, {"aero_drag": 0.5}],
    ids="+".join,
)
def test_the_change_of_the_shared_discrepancy_is_that_of_its_rates(gathered, discrepancy, terms):
    known = learn_discrepancy([gathered])
    known = replace(known, weights=known.weights + 0.3)
    objective = build_objective([gathered], known, discrepancy, [np.ones(len(gathered.at), dtype=bool)])
    planted = tuple(CATALOGUE[name]({next(iter(CATALOGUE[name].units)): value}) for name, value in terms.items())
    there, here = (discrepancy.rates(gathered.series, known.weights, some) for some in (planted, ()))
    np.testing.assert_allclose(objective.change_by(gathered, planted), there - here, atol=1e-9 * np.abs(here).max())


def test_columns_of_the_shared_discrepancy_are_whitened_as_the_objective_that_asks(gathered, discrepancy):
    """An objective and that of its fixed baseline share what they remember."""
    known = learn_discrepancy([gathered])
    keep = [np.ones(len(gathered.at), dtype=bool)]
    objective = build_objective([gathered], replace(known, weights=known.weights + 0.3), discrepancy, keep)
    fixed = objective.with_fixed_baseline()
    first = varied_discrepancy(objective)
    assert fixed.memo is objective.memo and not np.allclose(first, varied_discrepancy(fixed), rtol=1e-3)
    np.testing.assert_array_equal(varied_discrepancy(fixed), varied_discrepancy(replace(fixed, memo={})))


class WrittenWitness(SimpleNamespace):
    """Rows that are the sum of the terms' parameters, and how often they were asked for."""

    def is_changed_by(self, term):
        return not term.exported

    def rows(self, terms):
        self.asked += 1
        return np.full(4, sum(value for term in terms for value in term.parameters.values()))


def test_a_witness_is_asked_once_for_each_state_of_the_sensors_it_feels():
    witness = WrittenWitness(asked=0, begin=np.arange(4))
    objective = replace(objective_of(written(0), posterior=None), kinematics=(witness,))
    scale = CATALOGUE["speed_scale"]
    for k in range(100):  # more states than are kept
        value = {"scale": 1.0 + 0.01 * k}
        sensor, mass = scale(value), CATALOGUE["mass"](value)
        assert objective.witnessed([sensor, mass]) == pytest.approx(1.0 + 0.01 * k, rel=1e-12)
        assert objective.witnessed([mass]) == 0.0
    sensor, asked = scale({"scale": 0.5}), witness.asked
    for k in range(5):
        assert objective.witnessed([CATALOGUE["mass"]({"scale": 1.0 + 0.1 * k}), sensor]) == 0.5
    assert witness.asked - asked <= 2
