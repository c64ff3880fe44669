"""What one term has to show: sizes against noise, differences block by block, and the minimum-effect test."""

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
    """Return what a fit saves against another in standard errors, from differences block by block."""
    difference = objective.block_sums(other.residuals**2) - objective.block_sums(fit.residuals**2)
    return float(difference.sum()) / error_of_sum(difference)


def is_spread(objective: MarginalLikelihood, fit: Fit, k: int, without: Fit, rules: SelectionRules) -> bool:
    """Return whether one part saves in enough blocks of time, or the blocks in which it acts agree about its size.

    A place is passed once a lap. What acts in few blocks saves in few; if it is there, those agree about its size,
    and if it stands for something else they do not. What is larger than the noise is seen however seldom it acts.
    Where there is much model-form error it is worst somewhere, and a place says no more than any few moments.
    """
    seldom = fit.parts[k].candidate.located and objective.form_error_inflation <= rules.much_over_noise
    if seldom or block_z(objective, fit, without) > objective.policy.comparison.deviations:
        return True
    agree = blocks_p(objective, fit, without) < objective.policy.comparison.level
    # Where one block outweighs the others the sandwich has no tail to speak of: then it has to be small by far.
    agree |= block_t(objective, fit, without) > rules.sure
    return agree or term_size(objective, fit, k) > rules.above_noise


def block_t(objective: MarginalLikelihood, fit: Fit, without: Fit) -> float:
    """Return the size of what a fit adds to another in standard errors, from scores block by block.

    Notes
    -----
    What it adds, taken as one direction, has the size 1: a Wald statistic.
    """
    return 1.0 / _error_of_size(objective.block, without.residuals - fit.residuals, fit.residuals)


def blocks_p(objective: MarginalLikelihood, fit: Fit, without: Fit) -> float:
    """Return the p value of no size of what a fit adds to another, by how blocks of time agree about its size.

    Notes
    -----
    `block_t` in Student's t distribution. A block counts as far as the effect acts in it: with i_b = d_b^T d_b,
    there are (sum of i_b)^2/(sum of i_b^2) blocks (Kish, 1965), of which one is spent on the size. The sandwich of
    few clusters, or of clusters of which few matter, has a tail as heavy as that (Bell and McCaffrey, 2002).
    """
    acts = objective.block_sums((without.residuals - fit.residuals) ** 2)
    blocks = float(acts.sum()) ** 2 / max(float(acts @ acts), 1e-300)
    return float(2.0 * student_t.sf(block_t(objective, fit, without), max(blocks - 1.0, 1e-9)))


def _error_of_size(block: np.ndarray, direction: np.ndarray, left: np.ndarray) -> float:
    """Return the standard error of a direction's size [1], found by least squares, from scores block by block.

    Notes
    -----
    With d the direction and e the residuals left, sqrt(sum over blocks of (d_b^T e_b)^2)/d^T d: the sandwich's
    (Liang and Zeger, 1986).
    """
    length, scores = float(direction @ direction), np.bincount(block, direction * left)
    return (float(np.sqrt(scores @ scores)) + 1e-9) / length if length else np.inf


def error_of_sum(difference: np.ndarray) -> float:
    """Return the standard error of a sum over blocks, shape (B,)."""
    return float(np.sqrt(len(difference) * np.var(difference, ddof=1))) + 1e-9


def is_witnessed(objective: MarginalLikelihood, fit: Fit, k: int) -> bool:
    """Return whether a sensor's fault moves what a recording knows twice, which no model-form error does."""
    if not fit.parts[k].term.corrects:
        return False
    moved = objective.witnessed(fit.terms, fit.terms[:k] + fit.terms[k + 1 :])
    return moved > objective.policy.allowances.large


def systematic_error(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the systematic error of a part over its size [1].

    The model-form error of the car widens it, unless witnesses see a sensor's fault: they compare two instruments,
    and no model of the car enters.
    """
    widened = 1.0 if is_witnessed(objective, fit, k) else max(objective.form_error_inflation, 1.0)
    systematic = objective.policy.reporting.systematic * float(np.sqrt(widened))
    return systematic / max(term_size(objective, fit, k), 1e-9)


def witnessed_p(objective: MarginalLikelihood, fit: Fit, k: int, without: Fit, rules: SelectionRules) -> float:
    """Return the p value of a sensor's fault by what the recording knows twice; 1 where that tells too little.

    Physics that a single track lacks moves no witness, so its model-form error is no doubt about what these say.
    They have to agree about the size, and to save more than they do on the simulation. This holds for a channel
    that is late; an angle also stands for a point that is not where the map says, and needs other rows as well.

    Notes
    -----
    With d what the part moves of the witnesses, their means taken off, and e what they contradict without it, the
    share of the fault that they confirm is d^T e/d^T d.
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
    """Return the share of what a part moves of the witnesses that they confirm, and its standard error [1]."""
    share = float(moved @ before) / float(moved @ moved)
    block = objective.block[len(objective.block) - len(moved) :]
    return share, _error_of_size(block, moved, before - share * moved)


def witnesses_disagree(objective: MarginalLikelihood, fit: Fit, k: int, rules: SelectionRules) -> float:
    """Return by how much of its size witnesses contradict a sensor's fault, beyond chance [1]; 0 if they are mute.

    A bias moves the mean alone, about which `MarginalLikelihood.of_witnesses` says nothing.
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


def is_denied(objective: MarginalLikelihood, fit: Fit, k: int) -> bool:
    """Return whether yaw denies a fault of the yaw rate that it would show.

    A yaw rate has no bias where yaw turns as far as was recorded, whatever the equations of motion want of it. How
    far a car turns is known absolutely, so means count here as well. Positions deny nothing: their reference may
    be turned, or elsewhere, as the sensor is.
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


def exceeds_simulation_scatter(objective: MarginalLikelihood, candidate: Candidate, saved: float) -> bool:
    """Return whether a term saves more than what halves of the simulation differ by, as a standard deviation.

    What a term saves grows with the square of its size: halves that differ by a size are a draw of how far two
    recordings of one car lie apart.
    """
    return saved > objective.policy.selection.deviations**2 * objective.self_test_savings.get(candidate.effect, 0.0)


def is_form_error(
    objective: MarginalLikelihood, size: np.ndarray, of: np.ndarray, before: Fit, after: Fit, rules: SelectionRules
) -> bool:
    """Return whether sizes (3,) are no more than the model-form error of terms with sizes `of` (3,).

    Sizes are effect-to-noise ratios in v_x, v_y and r. What simulation and reality share is not asked here: its
    model-form error is beside what a term saves, see `saved_beside_form_error`.

    The model-form error of large terms in a channel they hardly act in has no simple shape: a term that takes
    nearly all that was left there, and much was, is none of it. What they get wrong where they act has a simple
    shape, and is no part of what is left.
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
    """Return sizes (3,) over the model-form error of terms with sizes `of` (3,), in the channel where most [1].

    Instruments have none: beside them alone a term of the car needs what a first one needs.

    Parameters
    ----------
    across : ndarray, shape (3,)
        Share of the largest size that is wrong in each channel; by default that of the policy.
    """
    rules = objective.policy.selection
    across = np.full(len(size), rules.form_error_across) if across is None else across
    unnamed = objective.policy.allowances.unnamed
    first = np.full(len(size), unnamed) if of.any() else np.minimum(unnamed, term_allowances(objective))
    least = np.maximum(first, rules.form_error_share * of)
    return float(np.max(size / np.maximum(least, across * _reach(objective, of))))


def _reach(objective: MarginalLikelihood, of: np.ndarray) -> np.ndarray:
    """Return how large terms with effect-to-noise ratios `of` (3,) would be if they acted in each channel, (3,).

    What a model gets wrong of a tyre's force is another force of the same tyre, and no larger in another direction
    than that. A quiet gyroscope sees a side force at an axle far better than a velocity sensor sees the same force
    along the car: a ratio to noise is no measure of a force. So a force is taken for no more than it would do
    there, and for no more than it does where it does most.

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
    """Return in which channels much is left before a term joins and next to noise after it, (3,) of bool.

    Parameters
    ----------
    both : ndarray, shape (R, 2)
        What is left before and after.

    Notes
    -----
    Noise is half the mean square of successive differences (von Neumann, 1941), which what varies slowly hardly
    adds to.
    """
    rows = sum(int(mask.sum()) for mask in objective.keep)
    left, still = both[: 3 * rows].T.reshape(2, rows, 3)
    noise = 0.5 * np.mean(np.diff(still, axis=0) ** 2, axis=0)
    much, little = np.mean(left**2, axis=0) - noise, np.mean(still**2, axis=0) - noise
    settled: np.ndarray = (much > rules.much_over_noise * noise) & (little < rules.fair_share * much)
    return settled


def sizes_of_terms(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> np.ndarray:
    """Return effect-to-noise ratios of terms against those of `without` in v_x, v_y and r, shape (3,)."""
    size = sizes_in_velocity(objective, terms, without)
    # An accelerometer's fault moves no prediction of the velocities: it is as large as its witness says.
    return size if size.any() else np.full(3, objective.witnessed(terms, without))


def sizes_in_velocity(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> np.ndarray:
    """Return the same of the velocities alone: the fault of an accelerometer leaves no model-form error there."""
    sizes = [
        effects_to_noise_of(one, one.at[mask], terms, without, partial(objective.carried, one))
        for one, mask in zip(objective.evidence, objective.keep, strict=True)
    ]
    return np.max(sizes, axis=0)


def part_sizes(objective: MarginalLikelihood, fit: Fit, k: int) -> np.ndarray:
    """Return the effect-to-noise ratios of one part of an explanation, the others in place, shape (3,)."""
    return sizes_of_terms(objective, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def term_size(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the effect-to-noise ratio of one part of an explanation, the others in place."""
    return float(part_sizes(objective, fit, k).max())


def effect_to_noise_of_terms(objective: MarginalLikelihood, terms: tuple[Term, ...]) -> float:
    """Return the effect-to-noise ratio of terms, in the channel where it is most."""
    return float(sizes_of_terms(objective, terms, ()).max())


def over_allowance(objective: MarginalLikelihood, terms: tuple[Term, ...], without: tuple[Term, ...]) -> float:
    """Return the size of terms against `without` over what is allowed, in the channel where that is most."""
    return float(np.max(sizes_of_terms(objective, terms, without) / term_allowances(objective)))


def part_over_allowance(objective: MarginalLikelihood, fit: Fit, k: int) -> float:
    """Return the size of one part of an explanation over what is allowed in its channel [1]."""
    return over_allowance(objective, fit.terms, fit.terms[:k] + fit.terms[k + 1 :])


def term_p(
    objective: MarginalLikelihood,
    fit: Fit,
    k: int,
    saved: float,
    variance_inflation: float,
    beside: Sequence[float] = (),
) -> float:
    """Return the minimum-effect p value of one part of an explanation that saves `saved`, see `p_of_effect`."""
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
    """Return the minimum-effect p value of a term of `size`, over what is allowed, that saves `saved`.

    What the shared discrepancy gets wrong is known in three ways: by what a term saves between halves of the
    simulation, by how much that widens chance, and, beside other terms, as a share of the discrepancy. A term has
    to stand against each, so the largest of three is returned; together they would count one error thrice.

    Parameters
    ----------
    beside : sequence of float, optional
        What it saves beside the model-form error of other terms; and of these and the shared discrepancy. What
        halves of the simulation save is without any, and is compared with `saved`.
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
