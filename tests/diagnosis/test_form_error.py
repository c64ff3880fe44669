"""Costs with a share of every effect free: against dense algebra, and on two terms that do nearly the same."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.optimize import lsq_linear
from scipy.stats import multivariate_normal

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search import form_error as module
from split_cli.diagnosis.search import selection as selecting
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts, tangent
from split_cli.diagnosis.search.form_error import (
    costs_beside_form_error,
    divided_out,
    free_to_form_error,
    marginal_cost,
    moved_between_load_laws,
    residuals_beside_form_error,
    saved_beside_form_error,
    saved_in_place_of,
)
from split_cli.diagnosis.search.forward import sizes_with_form_error
from split_cli.diagnosis.search.selection import nothing, select_terms
from split_cli.diagnosis.search.term_tests import sizes_in_velocity
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import (
    INFLATION,
    candidates_of,
    driven,
    explorer,
    first_order,
    late,
    noisy_objective,
    selected,
)


@pytest.fixture(scope="module")
def behind() -> MarginalLikelihood:
    """Steering that arrives 30 ms late."""
    return noisy_objective(driven(41, steer=lambda inputs, step: late(inputs, 0.03, step)), 3)


def fitted(objective: MarginalLikelihood, term: str) -> Fit:
    (one,) = candidates_of(objective, term)
    return min((fit_parts(objective, [Part(one, dict(start))]) for start in one.starts), key=lambda fit: fit.cost)


@pytest.fixture(scope="module")
def delay(behind) -> Fit:
    return fitted(behind, "steer_delay")


@pytest.fixture(scope="module")
def lag(behind) -> Fit:
    return fitted(behind, "steer_lag")


def test_the_cost_is_twice_the_negative_logarithm_of_a_dense_gaussian(behind, delay):
    """Of covariance v (I + M M^T), on every tenth row to keep it small; then on all rows by least squares."""
    form_error = 0.1 * behind.whiten(module._varied(behind, delay.terms, 0))
    assert form_error.shape == (len(delay.residuals), 18)
    rows = slice(0, None, 10)
    few, residuals = form_error[rows], delay.residuals[rows]
    dense = multivariate_normal(cov=INFLATION * (np.eye(len(residuals)) + few @ few.T))
    of_noise = multivariate_normal(cov=INFLATION * np.eye(len(residuals)))
    expected = 2.0 * (of_noise.logpdf(np.zeros(len(residuals))) - dense.logpdf(residuals))
    score, normal = few.T @ residuals, np.eye(18) + few.T @ few
    reference = (residuals @ residuals - score @ np.linalg.solve(normal, score)) / INFLATION
    assert reference + np.linalg.slogdet(normal)[1] == pytest.approx(expected, rel=1e-9)
    # And on all rows the quadratic part is the least of |e - M w|^2 + |w|^2.
    stacked, target = np.vstack([form_error, np.eye(18)]), np.append(delay.residuals, np.zeros(18))
    left = target - stacked @ np.linalg.lstsq(stacked, target, rcond=None)[0]
    price = np.linalg.slogdet(np.eye(18) + form_error.T @ form_error)[1]
    assert marginal_cost(behind, delay, INFLATION) == pytest.approx(left @ left / INFLATION + price, rel=1e-9)
    assert costs_beside_form_error(behind, [delay]) == pytest.approx([left @ left], rel=1e-9)


def test_products_summed_over_stretches_are_those_of_whole_columns(behind, delay, lag):
    """With three directions that the simulation left open."""
    seen = np.array([0.3, 0.9, 0.999])
    open_to = np.linalg.qr(np.random.default_rng(2).standard_normal((len(behind.weight), 3)))[0] * np.sqrt(seen)
    taught = replace(behind, basis=open_to, root=1.0 / (1.0 + np.sqrt(1.0 - seen)))
    parts, residuals = [(delay.terms, 0), (lag.terms, 0)], np.stack([delay.residuals, lag.residuals], axis=1)
    whole = module.columns_of_parts(taught, parts)
    assert len(taught.evidence[0].at) > 2 * module._ROWS_AT_A_TIME
    told = module._products(taught, parts, residuals)
    for here, there in zip(told, (whole.T @ whole, whole.T @ residuals), strict=True):
        assert here == pytest.approx(there, rel=1e-9, abs=1e-9 * np.abs(there).max())


def test_without_a_term_nothing_is_free(behind):
    base = nothing(behind)
    assert costs_beside_form_error(behind, [base]) == [base.cost]
    assert marginal_cost(behind, base, INFLATION) == base.cost / INFLATION


def test_sensor_faults_have_no_model_form_error(behind):
    one = candidates_of(behind, "sensor_lever_arm")[0]
    turned = fit_parts(behind, [Part(one, {"dx": 0.1})])
    assert marginal_cost(behind, turned, INFLATION) == turned.cost / INFLATION


def test_what_a_sensor_fault_does_is_no_error_that_hides_a_further_term(behind, delay):
    """A twentieth of what the sensor's place does counts in full, beside a delay; of the delay's effect it does not."""
    part = Part(candidates_of(behind, "sensor_lever_arm")[0], {"dx": 0.5})
    rows = behind.whiten(behind.raw_residual((*delay.terms, part.term)))
    both = Fit((*delay.parts, part), float(rows @ rows), rows, np.empty((len(rows), 0)))
    noise = np.random.default_rng(6).standard_normal(len(rows))
    calm = replace(both, residuals=noise, cost=float(noise @ noise))
    saved, plain = [], []
    for k in (0, 1):
        wrong = moved(calm, 0.05 * behind.whiten(module._varied(behind, both.terms, k))[:, 17])
        saved.append(saved_beside_form_error(behind, wrong, calm))
        plain.append(wrong.cost - calm.cost)
    assert min(plain) > 20.0 and saved[0] < 0.1 * plain[0] and saved[1] > 0.7 * plain[1]


def test_the_first_column_of_a_channel_is_the_effect_itself(behind, delay):
    varied = module._varied(behind, delay.terms, 0)
    effect = behind.residual(()) - behind.residual(delay.terms)
    assert varied[:, [0, 6, 12]].sum(axis=1) == pytest.approx(effect, abs=1e-9)


def test_a_differential_whose_constants_are_assumed_may_be_wrong_by_more(behind, delay):
    """By a quarter of its moment, in the columns of whole explanations as in the size that a further term needs."""
    stiff = CATALOGUE["yaw_moment_differential"]({"yaw_damping": 3000.0, "slip_stiffness": 0.1}, "slip")
    terms = (*delay.terms, stiff)
    parts = [(terms, 0), (terms, 1)]
    shares = np.repeat([0.1, 0.25], 18)
    expected = shares * np.hstack([behind.whiten(module._varied(behind, terms, k)) for k in (0, 1)])
    assert module.columns_of_parts(behind, parts) == pytest.approx(expected, rel=1e-12)
    products, _ = module._products(behind, parts, delay.residuals[:, None])
    assert products == pytest.approx(expected.T @ expected, rel=1e-9, abs=1e-9 * np.abs(products).max())
    alone = sizes_in_velocity(behind, (stiff,), ())
    assert sizes_with_form_error(behind, (stiff,)) == pytest.approx(2.5 * alone)
    # What acts elsewhere counts as it is: the delay in all channels, the moment in r.
    both = sizes_with_form_error(behind, terms)
    assert both[0] == pytest.approx(sizes_in_velocity(behind, terms, ())[0])
    assert both[2] == pytest.approx(2.5 * sizes_in_velocity(behind, terms, delay.terms)[2])


def test_scalings_of_a_curve_that_cancel_are_wrong_by_a_share_of_what_they_do_together(behind):
    """Four fifths of the whole curve and five fourths of its slope: at small slip the two undo each other."""
    curve, slope = (CATALOGUE[term] for term in ("friction_scale", "tire_stiffness"))
    terms = (curve({"scale": 0.8}, "curve"), slope({"front_scale": 1.25, "rear_scale": 1.25}))
    together = behind.residual(()) - behind.residual(terms)
    alone = [np.linalg.norm(behind.residual(()) - behind.residual((one,))) for one in terms]
    assert np.linalg.norm(together) < 0.4 * min(alone)
    first, second = (module._varied(behind, terms, k) for k in (0, 1))
    assert first[:, [0, 6, 12]].sum(axis=1) == pytest.approx(together, abs=1e-9)
    assert not second.any()
    # Beside any other term each counts as it is.
    lagging = CATALOGUE["steer_lag"]({"tau": 0.03})
    beside = module._varied(behind, (lagging, terms[0]), 1)[:, [0, 6, 12]].sum(axis=1)
    assert beside == pytest.approx(behind.residual((lagging,)) - behind.residual((lagging, terms[0])), abs=1e-9)


def test_a_form_error_that_favours_another_term_does_not_decide(behind, delay, lag):
    """What is wrong of the late steering's effect on v_x happens to look like a lag."""
    assert delay.cost < lag.cost
    between = lag.residuals - delay.residuals
    columns = behind.whiten(module._varied(behind, delay.terms, 0))
    column = columns[:, np.argmax(np.abs(columns.T @ between) / np.linalg.norm(columns, axis=0))]
    size = -1.5 * (lag.cost - delay.cost) / (2.0 * float(column @ between))
    moved = [
        replace(fit, residuals=fit.residuals + size * column, cost=float(np.sum((fit.residuals + size * column) ** 2)))
        for fit in (delay, lag)
    ]
    assert abs(size) < 0.5 and moved[0].cost > moved[1].cost
    beside = costs_beside_form_error(behind, moved)
    assert beside[0] < beside[1]
    assert saved_in_place_of(behind, moved[1], moved[0], INFLATION) > 0.0


def test_of_equal_residuals_the_smaller_effect_is_the_better_explanation(behind, delay):
    """A larger effect has a larger error, which could have explained more than it had to."""
    (one,) = candidates_of(behind, "steer_delay")
    larger = Part(one, {"delay": 3.0 * delay.parts[0].values["delay"]})
    same = replace(delay, parts=(larger,))
    assert marginal_cost(behind, delay, INFLATION) < marginal_cost(behind, same, INFLATION)
    assert np.diff(costs_beside_form_error(behind, [delay, same])) == pytest.approx(0.0, abs=1e-6)
    assert saved_in_place_of(behind, delay, same, INFLATION) < 0.0
    assert saved_in_place_of(behind, same, delay, INFLATION) == pytest.approx(0.0, abs=1e-6)


def test_what_one_may_get_wrong_is_free_for_the_others(behind, delay):
    """Something in v_x that the brakes do, which only a term that acts there could bend to."""
    (one,) = candidates_of(behind, "drive_gain")
    bends = fit_parts(behind, [Part(one, {"drive_gain": 0.97, "brake_gain": 0.97})])
    alone = costs_beside_form_error(behind, [delay])[0]
    together = costs_beside_form_error(behind, [delay, bends])
    assert together[0] < alone and together == pytest.approx(costs_beside_form_error(behind, [bends, delay])[::-1])
    # Of the same residuals none is better than another.
    same = replace(bends, residuals=delay.residuals)
    assert np.ptp(costs_beside_form_error(behind, [delay, same])) == pytest.approx(0.0, abs=1e-6)


def test_the_true_size_of_an_error_is_the_likeliest(behind, delay):
    """Residuals drawn with an error of a tenth cost least, on average, where a tenth is what the policy says."""
    columns = behind.whiten(module._varied(behind, delay.terms, 0))
    rng = np.random.default_rng(8)
    drawn = []
    for _ in range(20):
        left = rng.standard_normal(len(columns)) + columns @ (0.1 * rng.standard_normal(18))
        drawn.append(replace(delay, residuals=left, cost=float(left @ left)))
    costs = {}
    for share in (0.02, 0.1, 0.5):
        selection = replace(behind.policy.selection, form_error_share=share)
        objective = replace(behind, policy=replace(behind.policy, selection=selection))
        costs[share] = np.mean([marginal_cost(objective, one, 1.0) for one in drawn])
    assert costs[0.1] < min(costs[0.02], costs[0.5])


def test_an_alternative_takes_the_place_where_it_is_better_beside_form_error(behind, monkeypatch):
    candidates = candidates_of(behind, "steer_delay", "steer_lag")
    plain = selected(behind, *candidates)
    assert plain.chosen.names == ("steer_delay",)
    # Alternatives are what may be model-form error; here the lag is made one.
    monkeypatch.setattr(selecting, "explaining_as_well", lambda objective, selection, k, rivals: list(rivals))
    assert selected(behind, *candidates).chosen.names == ("steer_delay",)
    tie = behind.policy.selection.tie

    def saving(much):
        return lambda objective, before, after, variance_inflation: much * (1 if after.names == ("steer_lag",) else -1)

    monkeypatch.setattr(selecting, "saved_in_place_of", saving(0.9 * tie))
    assert selected(behind, *candidates).chosen.names == ("steer_delay",)
    monkeypatch.setattr(selecting, "saved_in_place_of", saving(1.1 * tie))
    turned = selected(behind, *candidates)
    assert turned.chosen.names == ("steer_lag",) and turned.named == (True,)
    assert "beside model-form error" in turned.history[-1]
    # What it was compared with is reported as seen from the one that is chosen now.
    (rival, *_) = turned.rivals[0]
    assert rival.fit.names == ("steer_delay",) and rival.excess == pytest.approx(-plain.rivals[0][0].excess, rel=1e-6)


def test_residuals_beside_form_error_are_what_a_dense_gaussian_leaves(behind, delay):
    """Of noise and model-form error what remains is e - M E[w | e]; the error's price is in the cost."""
    form_error = behind.policy.selection.form_error_share * behind.whiten(module._varied(behind, delay.terms, 0))
    stacked, target = np.vstack([form_error, np.eye(18)]), np.append(delay.residuals, np.zeros(18))
    weights = np.linalg.lstsq(stacked, target, rcond=None)[0]
    left = residuals_beside_form_error(behind, delay)
    np.testing.assert_allclose(left, delay.residuals - form_error @ weights, atol=1e-8)
    price = np.linalg.slogdet(np.eye(18) + form_error.T @ form_error)[1]
    cost = marginal_cost(behind, delay, 1.0)
    assert left @ left + weights @ weights + price == pytest.approx(cost, rel=1e-9)
    assert left @ left + weights @ weights == pytest.approx(costs_beside_form_error(behind, [delay])[0], rel=1e-9)
    base = nothing(behind)
    assert residuals_beside_form_error(behind, base) is base.residuals


def test_what_a_named_term_may_get_wrong_is_no_evidence_for_another(behind, delay):
    """A twentieth of the delay's own effect, more at one end of the speeds, saves next to nothing."""
    varied = behind.whiten(module._varied(behind, delay.terms, 0))
    wrong = replace(delay, residuals=delay.residuals + 0.05 * varied[:, 17], cost=0.0)
    wrong = replace(wrong, cost=float(wrong.residuals @ wrong.residuals))
    plainly, beside = wrong.cost - delay.cost, saved_beside_form_error(behind, wrong, delay)
    assert plainly > 20.0 and beside < 0.1 * plainly
    # Noise-like residuals that no model-form error makes count in full.
    rng = np.random.default_rng(1)
    apart = replace(delay, residuals=delay.residuals + 0.05 * rng.standard_normal(len(delay.residuals)))
    apart = replace(apart, cost=float(apart.residuals @ apart.residuals))
    assert saved_beside_form_error(behind, apart, delay) == pytest.approx(apart.cost - delay.cost, rel=0.1)


def test_beside_instruments_alone_all_that_a_term_of_the_car_saves_is_evidence(behind, delay):
    """What the shared discrepancy may get wrong is no more doubt there than for a first term."""
    scale = fitted(behind, "yaw_rate_scale")
    both = fit_parts(behind, [*scale.parts, *delay.parts])
    assert saved_beside_form_error(behind, scale, both) == scale.cost - both.cost
    assert saved_beside_form_error(behind, delay, both) != delay.cost - both.cost


def test_a_promise_beside_form_error_is_that_of_a_weighted_least_squares_fit(behind, delay):
    """min over x of (y - C x)^T (I + M M^T)^-1 (y - C x), as rows that the weights of M pull on."""
    (drag,) = candidates_of(behind, "aero_drag")
    line = tangent(behind, behind.residual(()), Part(drag, dict(drag.starts[0])))
    form_error = module.form_error_columns(behind, delay)
    C = np.hstack([line.slopes, delay.sensitivity])
    stacked = np.block([[C, form_error], [np.zeros((18, C.shape[1])), np.eye(18)]])
    target = np.append(delay.residuals + line.moved, np.zeros(18))
    scale = np.linalg.norm(stacked, axis=0)
    left = target - stacked / scale @ np.linalg.lstsq(stacked / scale, target, rcond=None)[0]
    promised = line.cost(delay, free_to_form_error(behind, delay))
    assert promised == pytest.approx(left @ left, rel=1e-6) and promised < line.cost(delay)


def test_a_further_term_is_sought_beyond_the_form_error_of_the_others():
    """What late steering gets wrong of the yaw rate hides a little lag of torque behind what bends to it."""
    commands = {
        "steer": lambda inputs, step: late(inputs, 0.03, step),
        "torque": lambda inputs, step: first_order(inputs, 0.008, step),
    }
    clean = noisy_objective(driven(41, **commands), 3)
    (one,), delay = clean.evidence, fitted(clean, "steer_delay")
    wrong = clean.stack(
        [
            one.whitener(
                module._varied_by(one, one.defects(()) - one.defects(delay.terms), False, module._functions(one))
            )
        ]
    )
    # Only a size that is small beside the delay's in another channel would be in doubt.
    policy = clean.policy.altered("selection", considered=1, form_error_across=0.0)
    objective = replace(clean, offset=clean.offset - 0.4 * wrong[:, 12], policy=policy)
    names = ("steer_delay", "steer_gain", "tire_stiffness", "yaw_inertia", "drive_lag")
    explore = explorer(objective, *names)
    current = fitted(objective, "steer_delay")
    plainly, beyond = (
        [fit.parts[-1].candidate.term for fit in fits]
        for fits in (explore(current), explore.beyond_form_error(current))
    )
    assert plainly[0] in ("steer_gain", "tire_stiffness") and beyond[0] == "drive_lag"
    # Where only one is considered in each step, the search finds it all the same.
    named = select_terms(objective, explore.candidates, INFLATION).terms
    assert {term.id for term in named} == {"steer_delay", "drive_lag"}


def test_of_tyres_either_axle_may_be_wrong_by_itself(behind):
    """The pieces add up to the effect; a curve that errs at the rear alone turns the car as no channel does."""
    grip = CATALOGUE["friction_scale"]({"scale": 0.9}, "curve")
    varied = module._varied(behind, (grip,), 0)
    effect = behind.residual(()) - behind.residual((grip,))
    assert varied[:, [0, 6, 12]].sum(axis=1) == pytest.approx(effect, abs=1e-9)
    # At the rear m v_y' gains what I r'/l_r loses: the two channels of the third piece before they are whitened.
    (one,) = behind.evidence
    rates = module._by_force(one.defects(()) - one.defects((grip,)), one.vehicle)[:, :, 2]
    car = one.vehicle
    across, turning = car.mass * rates[:, 1], car.yaw_inertia * rates[:, 2]
    assert np.abs(rates).max() > 0.0
    np.testing.assert_allclose(turning, -car.cg_to_rear_axle * across, atol=1e-12 * np.abs(turning).max())


@pytest.fixture(scope="module")
def heavier(behind) -> Fit:
    (one,) = (one for one in candidates_of(behind, "mass") if one.variant == "degressive")
    part = Part(one, {"scale": 1.15})
    residuals = behind.whiten(behind.raw_residual((part.term,)))
    return Fit((part,), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))


def moved(fit: Fit, by: np.ndarray) -> Fit:
    return replace(fit, residuals=fit.residuals + by, cost=float(np.sum((fit.residuals + by) ** 2)))


def test_a_heavier_car_goes_up_the_curve_of_either_axle(behind, heavier):
    """A front axle that gives a twentieth less of what the load asks turns the car, as a damping would."""
    (plain,) = (one for one in candidates_of(behind, "mass") if not one.variant)
    mass = plain.build({"scale": 1.15})
    (one,) = behind.evidence
    effect = one.defects(()) - one.defects((mass,))
    assert np.abs(effect[:, 2]).max() < 1e-12 < np.abs(module._by_force(effect, one.vehicle)[:, 2, 1]).max()
    varied = module._varied(behind, heavier.terms, 0)
    whole = behind.residual(()) - behind.residual(heavier.terms)
    assert varied[:, [0, 6, 12]].sum(axis=1) == pytest.approx(whole, abs=1e-9)
    wrong = moved(heavier, 0.05 * behind.whiten(varied[:, 6]))
    assert saved_beside_form_error(behind, wrong, heavier) < 0.1 * abs(wrong.cost - heavier.cost)


@pytest.mark.parametrize("share", [0.5, 3.0])
def test_how_tyres_carry_another_load_is_free_between_the_laws(behind, heavier, share):
    """Half-way to another law saves nothing; beyond the laws counts, as in one dense bounded problem."""
    rng = np.random.default_rng(2)
    calm = replace(heavier, residuals=rng.standard_normal(len(heavier.residuals)))
    laws = module._other_load_laws(behind, heavier)
    assert laws.shape[1] == 2
    wrong = moved(calm, share * laws[:, 0])
    saved = saved_beside_form_error(behind, wrong, moved(calm, 0.0))
    form_error = module.form_error_columns(behind, heavier)
    free = form_error.shape[1]
    stacked = np.block([[laws, form_error], [np.zeros((free, 2)), np.eye(free)]])
    low, high = (np.r_[bound, bound, np.full(free, far)] for bound, far in ((0.0, -np.inf), (1.0, np.inf)))
    here, there = (
        2.0 * lsq_linear(stacked, np.append(fit.residuals, np.zeros(free)), (low, high)).cost for fit in (wrong, calm)
    )
    assert saved == pytest.approx(here - there, rel=1e-4, abs=0.05)
    assert bool(saved > 100.0) is (share > 1.0)


def test_what_an_explanation_may_get_wrong_is_worked_out_once(behind, delay, heavier, monkeypatch):
    """However many further terms are asked beside it; anew for another one, or with a fixed baseline."""
    afters = [moved(heavier, 0.1 * rows) for rows in np.random.default_rng(3).standard_normal((3, len(behind.block)))]
    calls, made = [], module.columns_of_parts
    monkeypatch.setattr(module, "columns_of_parts", lambda *asked: calls.append(asked) or made(*asked))
    several = [saved_beside_form_error(behind, heavier, after) for after in afters]
    assert len(calls) == 1
    module.forget_form_error(behind)
    assert [saved_beside_form_error(behind, heavier, after) for after in reversed(afters)] == several[::-1]
    saved_beside_form_error(behind, moved(heavier, 0.0), afters[0])
    saved_beside_form_error(behind.with_fixed_baseline(), heavier, afters[0])
    assert len(calls) == 4


def test_a_mass_moves_to_what_it_is_with_the_law_between_the_variants(behind, heavier):
    """Residuals of 3 % more mass half-way to another law: the fit with that law finds both."""
    (part,) = heavier.parts
    more = Part(part.candidate, {"scale": part.values["scale"] + 0.01})
    slope = behind.whiten(behind.raw_residual((more.term,)) - behind.raw_residual(heavier.terms)) / 0.01
    between = 0.5 * module._other_load_laws(behind, heavier)[:, 0]
    fit = replace(heavier, sensitivity=slope[:, None], residuals=between - 0.03 * slope)
    assert moved_between_load_laws(behind, fit) == pytest.approx([0.03], abs=1e-3)
    idle = replace(fit, sensitivity=np.column_stack([slope, np.zeros(len(slope))]))  # brakes that are never used
    assert moved_between_load_laws(behind, idle) == pytest.approx([0.03, 0.0], abs=1e-3)
    alone = replace(fit, parts=(), sensitivity=np.empty((len(slope), 0)))
    assert moved_between_load_laws(behind, alone).shape == (0,)


@pytest.mark.parametrize("twice", [0.02, 0.5, 1.4, 5.0])
def test_a_law_of_load_divides_a_term_and_does_not_turn_its_sign(twice):
    """A law by which a term does 1 + c times as much leaves 1/(1 + c) of it, where a straight line says 1 - c."""
    rng = np.random.default_rng(4)
    slopes, away = rng.standard_normal((50, 1)), np.array([0.036])
    assert away + divided_out(-twice * away, away, slopes) == pytest.approx(away / (1.0 + twice))
    assert divided_out(twice * away, away, slopes) == pytest.approx(twice * away)
    # Of two parameters the whole effect is divided; what moves between them stays.
    slopes, away = np.eye(50)[:, :2], np.array([0.3, 0.4])
    between = np.array([0.4, -0.3])
    assert divided_out(between - twice * away, away, slopes) == pytest.approx(between + away / (1.0 + twice) - away)
