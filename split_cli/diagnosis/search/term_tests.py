"""Tests of a single term: its size over noise, agreement of blocks of time, witnesses, and the minimum-effect test."""

from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.stats import norm
from scipy.stats import t as student_t

from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise_of
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import SelectionRules
from split_cli.diagnosis.remainder.structure import minimum_effect_p, term_allowances
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import SEARCHED_PLACES, Fit
from split_cli.diagnosis.search.form_error import residuals_beside_form_error
from split_cli.vehicle.effects import Term


def block_z(objective: MarginalLikelihood, fit: Fit, other: Fit) -> float:
    """Return the saving of a fit against another in standard errors over blocks of time [1]."""
    difference = objective.block_sums(other.residuals**2) - objective.block_sums(fit.residuals**2)
    return float(difference.sum()) / error_of_sum(difference)


def is_spread(objective: MarginalLikelihood, fit: Fit, k: int, without: Fit, rules: SelectionRules) -> bool:
    """Return whether part k saves in enough blocks of time, or whether the blocks agree about its size.

    An effect that acts in few blocks saves in few. If it is real, these agree about its size. One of three is
    sufficient: a significant saving over blocks, agreement of the blocks, or an effect larger than the noise. Terms
    with a place are exempt unless model-form error is large, since a place is passed once a lap.
    """
    seldom = fit.parts[k].candidate.located and objective.form_error_inflation <= rules.much_over_noise
    if seldom or block_z(objective, fit, without) > objective.policy.comparison.deviations:
        return True
    agree = blocks_p(objective, fit, without) < objective.policy.comparison.level
    # If one block outweighs the others, the distribution of t is not known: then t has to be very large.
    agree |= block_t(objective, fit, without) > rules.sure
    return agree or term_size(objective, fit, k) > rules.above_noise


def block_t(objective: MarginalLikelihood, fit: Fit, without: Fit) -> float:
    """Return the size of the effect that `fit` adds to `without`, in standard errors over blocks [1].

    Notes
    -----
    A Wald statistic: along the row change of the added part its size is 1.
    """
    return 1.0 / _error_of_size(objective.block, without.residuals - fit.residuals, fit.residuals)


def blocks_p(objective: MarginalLikelihood, fit: Fit, without: Fit) -> float:
    """Return the p value of no effect of what `fit` adds to `without`, from the agreement of blocks of time.

    Notes
    -----
    `block_t` in Student's t distribution. With i_b = d_b^T d_b of block b the effective number of blocks is (sum of
    i_b)^2/(sum of i_b^2) (Kish, 1965), less one for the size. The sandwich estimate with few effective clusters has
    such a heavy tail (Bell and McCaffrey, 2002).
    """
    acts = objective.block_sums((without.residuals - fit.residuals) ** 2)
    blocks = float(acts.sum()) ** 2 / max(float(acts @ acts), 1e-300)
    return float(2.0 * student_t.sf(block_t(objective, fit, without), max(blocks - 1.0, 1e-9)))


def _error_of_size(block: np.ndarray, direction: np.ndarray, left: np.ndarray) -> float:
    """Return the standard error of the least-squares size of a direction, by the sandwich over blocks [1].

    Notes
    -----
    sqrt(sum over blocks of (d_b^T e_b)^2)/d^T d with the direction d and the residuals e (Liang and Zeger, 1986).
    """
    length, scores = float(direction @ direction), np.bincount(block, direction * left)
    return (float(np.sqrt(scores @ scores)) + 1e-9) / length if length else np.inf


def error_of_sum(difference: np.ndarray) -> float:
    """Return the standard error of the sum of block values, shape (B,)."""
    return float(np.sqrt(len(difference) * np.var(difference, ddof=1))) + 1e-9


def is_witnessed(objective: MarginalLikelihood, fit: Fit, k: int) -> bool:
    """Return whether part k is a sensor fault that changes witnesses, which no model-form error does."""
    if not fit.parts[k].term.corrects:
        return False
    moved = objective.witnessed(fit.terms, fit.terms[:k] + fit.terms[k + 1 :])
    return moved > objective.policy.allowances.large


def systematic_error(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the systematic standard error of part k by other terms, over its size [1].

    Model-form error widens it, except for a sensor fault that witnesses see without a model of the car.
    """
    widened = 1.0 if is_witnessed(objective, fit, k) else max(objective.form_error_inflation, 1.0)
    systematic = objective.policy.reporting.systematic * float(np.sqrt(widened))
    return systematic / max(term_size(objective, fit, k), 1e-9)


def witnessed_p(objective: MarginalLikelihood, fit: Fit, k: int, without: Fit, rules: SelectionRules) -> float:
    """Return the p value of a late channel by its witnesses alone; 1 if they give too little evidence.

    Model-form error of the car does not affect witnesses. They have to agree with the size of the fault and to save
    more than on the simulation. Other sensor faults are not tested so: an angle, for example, also resembles a wrong
    position of the sensor.

    Notes
    -----
    Let d be the change of the witnesses' rows by the part, less their means, and e their rows without it. The confirmed
    share of the fault is d^T e/d^T d.
    """
    if not (fit.parts[k].term.moves_samples and is_witnessed(objective, fit, k)):
        return 1.0
    before, after = (objective.of_witnesses(one.residuals) for one in (without, fit))
    floor = objective.witness_floors.get(fit.parts[k].candidate.effect, 0.0)
    moved = before - after
    if min(float(moved @ moved), float(before @ before - after @ after)) < max(floor, rules.price):
        return 1.0
    share, error = _confirmed(objective, moved, before)
    agree = objective.policy.self_test.term_margin
    if not 1.0 / agree < share < agree:
        return 1.0
    return float(2.0 * norm.sf(share / error))


def _confirmed(objective: MarginalLikelihood, moved: np.ndarray, before: np.ndarray) -> tuple[float, float]:
    """Return the share of a change `moved` that rows `before` confirm, (W,) each, and its standard error [1]."""
    share = float(moved @ before) / float(moved @ moved)
    block = objective.block[len(objective.block) - len(moved) :]
    return share, _error_of_size(block, moved, before - share * moved)


def witnesses_disagree(objective: MarginalLikelihood, fit: Fit, k: int, rules: SelectionRules) -> float:
    """Return the difference between part k and its size by witnesses beyond chance, over its size [1].

    0 without witnesses, and for a bias, which changes only the mean that `MarginalLikelihood.of_witnesses` removes.
    """
    if not is_witnessed(objective, fit, k):
        return 0.0
    others = fit.terms[:k] + fit.terms[k + 1 :]
    before, after = (objective.of_witnesses(objective.residual(terms)) for terms in (others, fit.terms))
    moved = before - after
    if float(moved @ moved) < rules.price:
        return 0.0
    share, error = _confirmed(objective, moved, before)
    return max(abs(share - 1.0) - rules.same_within * error, 0.0)


def contradicts_yaw(objective: MarginalLikelihood, fit: Fit, k: int) -> bool:
    """Return whether the recorded yaw contradicts a fault of the yaw rate.

    If the yaw changes by the integral of the yaw rate, the latter has no bias or scale error. The change of yaw is
    known absolutely, so means count here too. Positions contradict nothing, since their reference point may be
    displaced or turned like the velocity sensor.
    """
    term, rules = fit.terms[k], objective.policy.selection
    if not term.corrects or term.moves_samples:
        return False
    without, with_it = (objective.yaw_rows(terms) for terms in (fit.terms[:k] + fit.terms[k + 1 :], fit.terms))
    agree = objective.policy.self_test.term_margin
    for (before, block), (after, _) in zip(without, with_it, strict=True):
        moved = before - after
        if float(np.mean(moved**2)) < objective.policy.allowances.large**2:
            continue
        share = float(moved @ before) / float(moved @ moved)
        error = _error_of_size(block, moved, before - share * moved)
        if share + rules.same_within * error < 1.0 / agree:
            return True
    return False


def is_tolerated(
    objective: MarginalLikelihood, fit: Fit, k: int, without: Fit, variance_inflation: float, level: float
) -> bool:
    """Return whether part k is a sensor fault within tolerance.

    Without position, lateral acceleration is the witness of a scaled speed or a biased yaw rate. It also feels the roll
    of the body and the bank of the road. So what it may show of a sound recording is tolerated, unless the saving in
    the equations of motion passes the test of a name by itself.

    Parameters
    ----------
    without : Fit
        The others, refitted without the part.
    level : float
        p value of a name.
    """
    part = fit.parts[k]
    if not part.is_within_tolerance or not any(part.candidate.by_acceleration.values()):
        return part.is_within_tolerance
    motion = len(fit.residuals) - len(objective.of_witnesses(fit.residuals))
    saved = float(np.sum(without.residuals[:motion] ** 2) - np.sum(fit.residuals[:motion] ** 2))
    shown = term_p(objective, fit, k, saved, variance_inflation) < level
    return part.candidate.is_within_tolerance(part.values, shown_by_motion=shown)


def exceeds_simulation_scatter(objective: MarginalLikelihood, candidate: Candidate, saved: float) -> bool:
    """Return whether a term's saving exceeds that between halves of the simulation by 1.96 squared.

    Savings grow with the squared size, and the difference between the halves is taken as one standard deviation of the
    difference between two recordings of one car.
    """
    return saved > objective.policy.selection.deviations**2 * objective.self_test_savings.get(candidate.effect, 0.0)


def is_form_error(
    objective: MarginalLikelihood, size: np.ndarray, of: np.ndarray, before: Fit, after: Fit, rules: SelectionRules
) -> bool:
    """Return whether sizes (3,) of a term are no more than the model-form error of terms with sizes `of` (3,).

    Sizes are effect-to-noise ratios in v_x, v_y and r. The error of the shared discrepancy is considered elsewhere, see
    `saved_beside_form_error`.

    In channels where the other terms hardly act, the limit (`form_error_across`) does not apply to a term that removes
    nearly all of a large remainder, since model-form error has no such simple shape. The remainder is tested as it is,
    and beside the most likely model-form error of the other terms.

    Parameters
    ----------
    before, after : Fit
        Without and with the term.
    """
    if over_form_error(objective, size, of, np.zeros(len(size))) < 1.0:
        return True
    across = np.full(len(size), rules.form_error_across)
    both = np.stack([before.residuals, after.residuals], axis=1)
    if over_form_error(objective, size, of, across) < 1.0:
        across[_settled(objective, both, rules)] = 0.0
    if over_form_error(objective, size, of, across) < 1.0:
        across[_settled(objective, residuals_beside_form_error(objective, before, both), rules)] = 0.0
    return over_form_error(objective, size, of, across) < 1.0


def over_form_error(
    objective: MarginalLikelihood, size: np.ndarray, of: np.ndarray, across: np.ndarray | None = None
) -> float:
    """Return the largest ratio of sizes (3,) to the model-form error of terms with sizes `of` (3,) [1].

    Sensor faults have none; beside them alone a term of the car has the limit of a first term.

    Parameters
    ----------
    across : ndarray, shape (3,)
        Share of the other terms' reach (`_reach`) that is wrong in each channel; by default that of the policy.
    """
    rules = objective.policy.selection
    across = np.full(len(size), rules.form_error_across) if across is None else across
    unnamed = objective.policy.allowances.unnamed
    first = np.full(len(size), unnamed) if of.any() else np.minimum(unnamed, term_allowances(objective))
    least = np.maximum(first, rules.form_error_share * of)
    return float(np.max(size / np.maximum(least, across * _reach(objective, of))))


def _reach(objective: MarginalLikelihood, of: np.ndarray) -> np.ndarray:
    """Return the effect-to-noise ratios, (3,), that the forces of terms with ratios `of` (3,) could have.

    The error of a tyre force is a force of the same tyre in any direction, of the same size. Its ratio to noise depends
    on the channel: a gyroscope may see a lateral force far better than a velocity sensor sees the same longitudinal
    force. So the force is converted from channel to channel, and the result is at most the largest of `of`.

    Notes
    -----
    A force F at an axle changes v_x and v_y by F dt/m and r by F max(l_f, l_r) dt/I_z.
    """
    reach = np.zeros(len(of))
    for one in objective.evidence:
        gain = np.abs(one.vehicle.force_matrix()).max(axis=1) / one.series.stated_noise
        reach = np.maximum(reach, np.max(of / gain) * gain)
    return np.minimum(reach, of.max())


def _settled(objective: MarginalLikelihood, both: np.ndarray, rules: SelectionRules) -> np.ndarray:
    """Return in which channels a term reduces a large remainder to next to noise, bool (3,).

    Parameters
    ----------
    both : ndarray, shape (R, 2)
        Residuals without and with the term.

    Notes
    -----
    The noise is half the mean square of successive differences (von Neumann, 1941), to which slow effects hardly
    contribute.
    """
    rows = sum(int(mask.sum()) for mask in objective.keep)
    left, still = both[: 3 * rows].T.reshape(2, rows, 3)
    noise = 0.5 * np.mean(np.diff(still, axis=0) ** 2, axis=0)
    much, little = np.mean(left**2, axis=0) - noise, np.mean(still**2, axis=0) - noise
    settled: np.ndarray = (much > rules.much_over_noise * noise) & (little < rules.fair_share * much)
    return settled


def sizes_of_terms(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> np.ndarray:
    """Return the effect-to-noise ratios of terms against a model with `without`, in v_x, v_y, r, shape (3,)."""
    size = sizes_in_velocity(objective, terms, without)
    # A fault of an accelerometer changes no prediction of the velocities: its size is the change of its witness.
    return size if size.any() else np.full(3, objective.witnessed(terms, without))


def sizes_in_velocity(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> np.ndarray:
    """Return the effect-to-noise ratios by predictions of the velocities alone, shape (3,) [1]."""
    sizes = [
        effects_to_noise_of(one, one.at[mask], terms, without, partial(objective.discrepancy_change, one))
        for one, mask in zip(objective.evidence, objective.keep, strict=True)
    ]
    return np.max(sizes, axis=0)


def part_sizes(objective: MarginalLikelihood, fit: Fit, k: int) -> np.ndarray:
    """Return the effect-to-noise ratios of part k beside the others, shape (3,) [1]."""
    return sizes_of_terms(objective, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def term_size(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the largest effect-to-noise ratio of part k beside the others [1]."""
    return float(part_sizes(objective, fit, k).max())


def effect_to_noise_of_terms(objective: MarginalLikelihood, terms: tuple[Term, ...]) -> float:
    """Return the largest effect-to-noise ratio of terms [1]."""
    return float(sizes_of_terms(objective, terms, ()).max())


def over_allowance(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> float:
    """Return the largest ratio over channels of the size of terms, against `without`, to the allowance [1]."""
    return float(np.max(sizes_of_terms(objective, terms, without) / term_allowances(objective)))


def part_over_allowance(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return `over_allowance` of part k beside the others [1]."""
    return over_allowance(objective, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def term_p(
    objective: MarginalLikelihood,
    fit: Fit,
    k: int,
    saved: float,
    variance_inflation: float,
    beside: Sequence[float] = (),
) -> float:
    """Return the p value of part k with the saving `saved`, see `p_of_effect`."""
    size = part_over_allowance(objective, fit, k)
    return p_of_effect(objective, fit.parts[k].candidate, size, saved, variance_inflation, beside)


def p_of_effect(
    objective: MarginalLikelihood,
    candidate: Candidate,
    size: float,
    saved: float,
    variance_inflation: float,
    beside: Sequence[float] = (),
) -> float:
    """Return the p value of the minimum-effect test of a term.

    The error of the shared discrepancy is considered in three ways: by the saving between halves of the simulation, by
    a variance inflation and, beside other terms, as a share of the discrepancy. The largest of the three p values is
    returned, since combining them would count one error three times.

    Parameters
    ----------
    size : float
        Size over the allowance [1].
    saved : float
        Saving of the term [chi squared].
    beside : sequence of float, optional
        Its saving beside the model-form error of other terms, and beside that of these and of the shared discrepancy.
    """
    floor = max(
        objective.policy.allowances.term_floor * objective.shared_cost, objective.term_floors.get(candidate.effect, 0.0)
    )
    ways = [(saved, candidate.complexity, variance_inflation, floor)]
    if beside:
        ways.append((beside[1], candidate.complexity, variance_inflation, 0.0))
    if objective.form_error_inflation > variance_inflation:
        searched = candidate.complexity + (SEARCHED_PLACES if candidate.located else 0.0)
        ways.append((beside[0] if beside else saved, searched, objective.form_error_inflation, 0.0))
    return max(
        minimum_effect_p(much, freedom, size, widened, spared, allowance=1.0) for much, freedom, widened, spared in ways
    )
