"""Tests for structure without a name: its p values under noise, at the allowance and beyond, and its groups."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import chi2

from split_cli.diagnosis.innovations.effect_to_noise import (
    effect_to_noise,
    effects_to_noise_of,
    products_over_noise,
    rms_over_noise,
    windowed,
)
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.remainder import structure as module
from split_cli.diagnosis.remainder.flexible import flexible_rows
from split_cli.diagnosis.remainder.structure import Structure, build_structure, minimum_effect_p
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import SIGMA, driven, noisy_objective

REPLICATES = 400


class TestMinimumEffect:
    def test_without_an_allowance_it_is_chi_squared(self):
        for saved, freedom, variance_inflation in ((30.0, 4.0, 1.0), (30.0, 4.0, 1.5), (8.0, 1.0, 2.0)):
            p = minimum_effect_p(saved, freedom, 1.0, variance_inflation, 0.0, 0.0)
            assert p == pytest.approx(chi2.sf(saved / variance_inflation, freedom), rel=1e-9)

    def test_more_that_is_saved_is_less_likely(self):
        p = [minimum_effect_p(saved, 3.0, 0.5, 1.5, 4.0) for saved in np.linspace(1.0, 300.0, 60)]
        assert np.all(np.diff(p) < 0.0)

    def test_a_larger_effect_that_saves_as_much_is_less_likely(self):
        p = [minimum_effect_p(100.0, 3.0, size, 1.5) for size in (0.02, 0.05, 0.06, 0.1, 0.3, 1.0)]
        assert np.all(np.diff(p[1:]) < 0.0) and p[0] == p[1]

    def test_an_effect_within_the_allowance_is_none_however_sure(self):
        for saved in (50.0, 1e3, 1e5):
            assert minimum_effect_p(saved, 2.0, 0.04, 1.5, 0.0, 0.05) > 0.3
        assert minimum_effect_p(1e5, 2.0, 0.08, 1.5, 0.0, 0.05) < 1e-10

    def test_what_is_forgiven_counts_as_the_allowance_does(self):
        assert minimum_effect_p(100.0, 2.0, 5.0, 1.0, 98.0) > 0.3
        assert minimum_effect_p(100.0, 2.0, 5.0, 1.0, 20.0) < 1e-3
        assert minimum_effect_p(0.0, 2.0, 5.0, 1.0) == minimum_effect_p(9.0, 2.0, 0.0, 1.0) == 1.0

    def test_it_holds_its_level_for_an_effect_of_just_the_allowed_size(self):
        """Simulated: saving of a fit of 5 parameters whose true effect is the allowance, size as fitted."""
        rng, allowance, mean = np.random.default_rng(7), 0.05, np.zeros(5)
        mean[0] = 6.0  # in standard errors: this data shows the allowance clearly
        p = []
        for _ in range(REPLICATES):
            fitted = mean + rng.standard_normal(5)
            saved = float(fitted @ fitted)
            # An effect of the allowed size saves 36 without noise; of what is saved the chance part is taken off.
            size = allowance * np.sqrt(max(saved - 5.0, 0.0) / 36.0)
            p.append(minimum_effect_p(saved, 5.0, size, 1.0, 0.0, allowance))
        for level in (0.01, 0.05, 0.2):
            # Not more often than that, by more than three binomial deviations.
            spread = np.sqrt(level * (1.0 - level) / REPLICATES)
            assert np.mean(np.array(p) < level) <= level + 3.0 * spread


def test_products_of_functions_tell_the_size_of_any_sum_of_them():
    rng = np.random.default_rng(3)
    errors, weights = rng.standard_normal((40, 3, 5)), rng.standard_normal(5)
    series = SimpleNamespace(stated_noise=SIGMA)
    products = products_over_noise(series, [errors])
    told = np.sqrt(products @ weights @ weights)
    np.testing.assert_allclose(told, rms_over_noise(series, errors @ weights), rtol=1e-12)
    assert not products_over_noise(series, [errors[:0]]).any()  # a recording of which no row is compared


class TestFlexibleFit:
    """A handful of orthonormal columns, each of which is a known effect-to-noise ratio."""

    rows, columns = 300, 6

    def structure(self, policy: Policy = STANDARD) -> Structure:
        rng = np.random.default_rng(1)
        columns = np.linalg.qr(rng.standard_normal((self.rows, self.columns)))[0]
        samples = 400
        # Column k adds a constant rate to v_x: effect-to-noise ratio in proportion to its weight.
        defect = np.zeros((samples - 1, 3, self.columns))
        defect[:, 0, :] = 1e-4
        series = SimpleNamespace(period=0.01, noise=SIGMA, stated_noise=SIGMA)
        every = np.arange(samples - 5)
        windows = windowed(series, defect, every)
        one = SimpleNamespace(series=series, at=every)
        objective = SimpleNamespace(posterior=None, evidence=(one,), keep=(every >= 0,), policy=policy)
        factor = np.linalg.cholesky(columns.T @ columns * (1.0 + module._RIDGE_SHARE * self.rows)).T
        groups = ("a", "a", "b", "b", "b", "c")
        return Structure(
            objective, (columns[:, :4], columns[:, 4:]), (products_over_noise(series, [windows]),), groups, factor
        )

    def test_saving_freedom_and_effect_to_noise_by_hand(self):
        one = self.structure()
        weights = np.array([40.0, 0.0, 0.0, 0.0, 0.0, 0.0])
        fit = one.fit(np.hstack(one.blocks) @ weights, 1.0)
        shrink = 1.0 / (1.0 + module._RIDGE_SHARE * self.rows)
        assert fit.saved == pytest.approx(shrink * 1600.0)
        assert fit.freedom == pytest.approx(shrink * self.columns)
        # Five samples of 1e-4 times the weight, over root two times the noise, less the share of chance.
        plain = 5.0 * 1e-4 * 40.0 * shrink / (np.sqrt(2.0) * SIGMA[0])
        assert fit.effect_to_noise == pytest.approx(plain * np.sqrt(1.0 - fit.freedom / fit.saved), rel=1e-9)
        groups = dict(fit.group_saved)
        assert groups["a"] == pytest.approx(fit.saved) and groups["b"] == pytest.approx(0.0, abs=1e-9)
        assert next(iter(groups)) == "a"

    def test_white_noise_is_called_structure_no_more_often_than_it_should(self):
        """Even with no allowance at all: then the ridge alone is on the cautious side."""
        one, rng = self.structure(STANDARD.altered("allowances", unnamed=0.0)), np.random.default_rng(5)
        p = np.array([one.fit(rng.standard_normal(self.rows), 1.0).p_value for _ in range(REPLICATES)])
        for level in (0.01, 0.05, 0.2):
            assert np.mean(p < level) <= level + 3.0 * np.sqrt(level * (1.0 - level) / REPLICATES)
        # And not because it never says anything: four parameters' worth of noise is seen.
        assert one.fit(one.blocks[0][:, 0] * 12.0 + rng.standard_normal(self.rows), 1.0).p_value < 1e-6


def test_effects_to_noise_of_a_constant_rate_by_hand(nominal_series):
    """0.4 m/s^2 more along the car: 0.02 m/s in 0.05 s, against 0.02 root two of noise."""
    defect = np.zeros((len(nominal_series) - 1, 3))
    defect[:, 0] = 0.4 * nominal_series.period
    expected = 0.02 / (np.sqrt(2.0) * nominal_series.noise[0])
    assert effect_to_noise(nominal_series, defect) == pytest.approx(expected, rel=1e-9)
    # A rate that changes its sign with every sample is gone after an even number, and one sample after five.
    defect[1::2] *= -1.0
    assert effect_to_noise(nominal_series, defect) == pytest.approx(expected / 5.0, rel=1e-3)


def test_effects_to_noise_of_a_force_is_that_of_its_rate(nominal_evidence):
    force = CATALOGUE["rolling_resistance"]({"force": 300.0})
    # Gaps between runs count as no error: one window in a hundred.
    expected = 300.0 / 1500.0 * 0.05 / (np.sqrt(2.0) * nominal_evidence.series.noise[0])
    assert effects_to_noise_of(nominal_evidence, nominal_evidence.at, (force,)).max() == pytest.approx(
        expected, rel=0.01
    )
    assert effects_to_noise_of(nominal_evidence, nominal_evidence.at, (force,), (force,)).max() == 0.0


class OneSided(Term):
    """Front grip that is lost in turns to one side and gained in those to the other."""

    id = "one_sided"

    def lateral(self, flow) -> None:
        """Take a share of the front force's size from it."""
        force = flow.front.lateral_force
        flow.front.lateral_force = force - self.parameters["share"] * np.abs(force)


def structure_of(objective, discrepancy) -> Structure:
    return build_structure(objective, [flexible_rows(one, discrepancy) for one in objective.evidence])


@pytest.fixture(scope="module")
def nominal_structure(nominal_objective, discrepancy):
    return structure_of(nominal_objective, discrepancy)


def test_a_car_without_anything_shows_nothing(nominal_objective, nominal_structure):
    residuals = nominal_objective.whiten(nominal_objective.residual(()))
    assert nominal_structure.fit(residuals, 1.5).p_value > 0.05


def test_a_planted_asymmetry_is_found_in_its_group(discrepancy):
    objective = noisy_objective(driven(31, (OneSided({"share": 0.1}),)), 2)
    fit = structure_of(objective, discrepancy).fit(objective.residual(()), 1.5)
    saved = dict(fit.group_saved)
    assert fit.p_value < 1e-6
    assert fit.group_saved[0][0] == "left against right"
    # A steady push to one side holds part of it, and fits every group that knows a constant.
    assert saved["left against right"] > 1.2 * fit.group_saved[1][1]


def test_a_symmetric_loss_is_found_at_the_operating_point(discrepancy):
    lost = CATALOGUE["friction_scale"]({"scale": 0.9})
    objective = noisy_objective(driven(32, (lost,)), 2)
    fit = structure_of(objective, discrepancy).fit(objective.residual(()), 1.5)
    assert fit.group_saved[0][0] == "operating point" and fit.p_value < 1e-6
    # What it makes of noise is taken off its size, up to the scatter of one draw of it.
    assert fit.effect_to_noise == pytest.approx(
        effects_to_noise_of(objective.evidence[0], objective.evidence[0].at, (lost,)).max(), rel=0.2
    )


def test_the_fit_is_ridge_regression(nominal_objective, nominal_structure):
    """Against one augmented least squares problem."""
    rng = np.random.default_rng(9)
    columns = np.hstack(nominal_structure.blocks)
    residuals = rng.standard_normal(len(columns)) + columns @ rng.standard_normal(columns.shape[1]) * 0.02
    penalty = np.sqrt(module._RIDGE_SHARE * len(columns))
    stacked = np.concatenate([columns, penalty * np.eye(columns.shape[1])])
    target = np.concatenate([residuals, np.zeros(columns.shape[1])])
    weights = np.linalg.lstsq(stacked, target, rcond=None)[0]
    left = target - stacked @ weights
    fit = nominal_structure.fit(residuals, 1.5)
    assert fit.saved == pytest.approx(float(residuals @ residuals - left @ left), rel=1e-6)
    # Effective parameters: the trace of the hat matrix.
    trace = np.trace(columns @ np.linalg.solve(stacked.T @ stacked, columns.T))
    assert fit.freedom == pytest.approx(trace, rel=1e-6)


def test_next_to_nothing_saved_is_no_effect_however_much_is_allowed():
    """There the series of the non-central chi squared overflows."""
    assert minimum_effect_p(6e-9, 1.0, 1e-6, 1.5, floor=735.0, allowance=1.0) == 1.0
