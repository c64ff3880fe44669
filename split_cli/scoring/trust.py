"""Trust: the share of each correction that held-out blocks support, and the doubt, the variance beyond it."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri, stdtrit

from split_cli.learning.kernel import Kernel
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import STATES, Trust, kept_share
from split_cli.logs.drive_metadata import circular_in_all
from split_cli.scoring.evidence import FEWEST_BLOCKS, HORIZONS, TrainingDrive, TrustEvidence, held_out_evidence

#: One-sided level of 95 %: a gain within chance is not believed. Of Student's t with many blocks; with few blocks
#: the quantile of their own degrees of freedom is taken.
_LEVEL = 0.95
#: Increase of a mean squared error that counts as none: 1 % of its root over all driving, 5 % in a third of it.
#: docs/decisions/0032 shows how little hangs on them.
NEGLIGIBLE = 0.02
_NEGLIGIBLE_IN_A_THIRD = 0.10
#: Errors below this share of how far the state moves count as none: 1 cm/s where the speed changes by 1 m/s.
_NEGLIGIBLE_MOVEMENT = 0.01
#: Trust must do no harm in any third even if the correction were this many times as strong: the next drive's gain
#: differs from this one's. docs/decisions/0032 has what other factors gave.
_MARGIN = 1.5
#: Horizon at which blocks are compared [s]: the shortest rollout, which a running trust judges by as well.
_STRETCH = HORIZONS[0]
#: Of the driving there is: what would take more is called no gain. It decides what is said, not what is trusted.
_MOST_TIMES = 10
_LEVELS_OF_INTERVALS = (0.5, 0.9, 0.95)
_GRID = np.linspace(0.0, 1.0, 21)


class Judgement(NamedTuple):
    """What held-out blocks say of a correction."""

    trust: Trust
    gain: float  # of `best_trust` [1]; minus infinity where there are too few blocks
    needed: int | None  # of `driving_needed`, where no output is trusted


def judge_correction(
    drives: Sequence[TrainingDrive],
    empty: TrainingSet,
    progress: Callable[[str], None] = lambda text: None,
    most: Sequence[float] = (1.0, 1.0, 1.0),
) -> Judgement:
    """Return the trust of each output, found on held-out blocks of the drives, and its gain.

    Parameters
    ----------
    empty : TrainingSet
        Without points: its settings and kernel are those of the set that is trained on everything.
    progress : callable
        Called with a line of text at each step.
    most : sequence of float, shape (3,)
        Largest trust of each output.

    Returns
    -------
    Judgement
        With the trust ``unjudged`` and 0 when the drives are too short for five blocks: what no held-out driving
        speaks for is not applied.

    Notes
    -----
    A state of which no drive says anything (`logs.drive_metadata.CIRCULAR`) has no correction.
    """
    # Not with the default predictor: the trust it finds of itself did more harm on other drives (decision 0030).
    evidence, blocks = held_out_evidence(drives, empty, "rbcm", progress)
    if blocks < FEWEST_BLOCKS:
        return Judgement(Trust((0.0, 0.0, 0.0), "unjudged", blocks), -np.inf, None)
    unknown = circular_in_all([part.drive.metadata for part in drives])
    most = [0.0 if state in unknown else largest for state, largest in zip(STATES, most, strict=True)]
    share, gain = best_trust(evidence, most)
    doubt = doubt_from(evidence, share, empty.kernel)
    needed = None if share.any() else driving_needed(evidence, most)
    return Judgement(Trust(tuple(share.tolist()), "held-out", blocks, tuple(doubt.tolist())), gain, needed)


def driving_needed(evidence: Sequence[TrustEvidence], most: Sequence[float] = (1.0, 1.0, 1.0)) -> int | None:
    """Return how many times as much driving would show a gain beyond chance, None where ten times would not.

    Notes
    -----
    With n times as many blocks of the same gain and scatter the standard error is 1/sqrt(n) of what it is, and the
    quantile that of n times as many blocks. More driving also teaches more, so this is no lower bound.
    """
    return next((n for n in range(2, _MOST_TIMES + 1) if best_trust(evidence, most, n)[0].any()), None)


def best_trust(
    evidence: Sequence[TrustEvidence], most: Sequence[float] = (1.0, 1.0, 1.0), times: int = 1
) -> tuple[np.ndarray, float]:
    """Return the trust of each output that the evidence supports, shape (3,), and its gain over the vehicle file.

    Parameters
    ----------
    most : sequence of float, shape (3,)
        Largest trust of each output.
    times : int
        As if there were so many times as many blocks, of the same errors.

    Notes
    -----
    With nominal error e and changes d of the three outputs, trust tau changes the squared error by
    -2 tau.(e d) + tau.(d d^T) tau. Of all trusts on a grid of 0.05, those are left out that make any state at any
    horizon worse, as a whole or in a third of the driving by torque rate, steer rate, speed, lateral acceleration,
    torque, time or drive, beyond what is negligible and beyond one standard error over blocks there. Of the rest
    the one is taken whose gain, as a share of the nominal error and less the uncertainty of its mean over blocks
    (95 %, one-sided), is largest in sum over states and horizons. No trust gains nothing: where the data show no
    gain beyond chance it is taken.

    Where the set's vehicle holds effects beyond the vehicle file, those act whatever the trust, and everything is
    judged against the file: no trust may then be allowed, not even none, and the gain is minus infinity.

    Two cautions are for the next drive, which is driven otherwise. No third may be made worse even by 1.5 times
    the correction. And no output is trusted beyond its `own_shares`: what a late torque or the speed explains as
    well goes with slip and torque in one style of driving only. If a new stretch of driving does not bear what was
    found so, the trust is found once more within the `harmless_shares`.
    """
    limits = np.minimum(own_shares(evidence), most)
    share, gain = _largest_gain(evidence, limits, times)
    borne = harmless_shares(evidence, share)
    if (share <= borne + 1e-9).all():
        return share, gain
    return _largest_gain(evidence, np.minimum(limits, borne), times)


def _largest_gain(evidence: Sequence[TrustEvidence], limits: np.ndarray, times: int) -> tuple[np.ndarray, float]:
    """Return the trust within limits, shape (3,), that gains most of those that do no harm, and its gain."""
    shares = np.stack(np.meshgrid(_GRID, _GRID, _GRID, indexing="ij"), axis=-1).reshape(-1, 3)
    shares = shares[(shares <= limits + 1e-9).all(axis=1)]
    gain = np.zeros(len(shares))
    for part in evidence:
        everything = np.ones(len(part.error), dtype=bool)
        base, unnoticed = _sizes(part, everything)
        if base + unnoticed > 0.0:
            worse, error = _increase(part, everything, shares)
            quantile = float(stdtrit(max(times * len(np.unique(part.block)) - 1, 1), _LEVEL))
            gain -= (worse + quantile * error / np.sqrt(times)) / (base + unnoticed)
            gain[worse > NEGLIGIBLE * base + unnoticed] = -np.inf
    # The file as it is gains nothing and is always allowed; what gains less need not be looked at.
    kept = np.flatnonzero(gain >= 0.0)
    shares, gain = shares[kept], gain[kept]
    for part in evidence:
        for inside in _thirds(part.conditions):
            base, unnoticed = _sizes(part, inside)
            worse, error = _increase(part, inside, _MARGIN * shares)
            allowed = worse <= _NEGLIGIBLE_IN_A_THIRD * base + unnoticed + error / np.sqrt(times)
            shares, gain = shares[allowed], gain[allowed]
    if not len(gain):
        return np.zeros(3), -np.inf
    return shares[int(np.argmax(gain))], float(gain.max())


def own_shares(evidence: Sequence[TrustEvidence]) -> np.ndarray:
    """Return the share of each correction that the rivals do not explain as well, from 0 to 1, shape (3,).

    Notes
    -----
    The coefficient of the correction in the least-squares regression of the held-out label on the correction and
    the rivals less their means, less its standard error over blocks. By Frisch, Waugh and Lovell, both label and
    correction are freed of what the rivals say of them, and one is regressed on the other. A constant correction
    stays the correction's own. 1 without rivals, and where the correction is theirs entirely 0.
    """
    own = np.ones(3)
    for part in evidence:
        if part.horizon or part.rivals is None or len(part.error) <= part.rivals.shape[1] + 2:
            continue
        spread = part.rivals.std(axis=0)
        rivals = (part.rivals - part.rivals.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0)
        both = np.column_stack([part.change[:, part.state], part.error])
        change, error = (both - rivals @ np.linalg.lstsq(rivals, both, rcond=None)[0]).T
        numbers, member = np.unique(part.block, return_inverse=True)
        together, power = (np.bincount(member, change * other) for other in (error, change))
        if not power.sum() > 0.0:
            own[part.state] = 0.0
            continue
        slope, count = together.sum() / power.sum(), len(numbers)
        scatter = count / max(count - 1, 1) * np.square(together - slope * power).sum()
        own[part.state] = np.clip(slope - np.sqrt(scatter) / power.sum(), 0.0, 1.0)
    return own


def harmless_shares(evidence: Sequence[TrustEvidence], share: np.ndarray) -> np.ndarray:
    """Return the share up to which each correction does no harm to its own state in a new block, 0 to 1, shape (3,).

    Parameters
    ----------
    share : ndarray, shape (3,)
        Trust of the outputs: the corrections of the other two are applied beside each.

    Notes
    -----
    With error e of the others' corrections and change d, share tau changes a block's squared error by tau^2 d.d - 2
    tau e.d. That is harm beyond twice the block's best share, e.d/d.d. Best shares differ from block to block (random
    effects). Over blocks weighted by d.d they have the mean m and the standard deviation s. A new block's is
    predicted to lie within s sqrt(1 + 1/n) of m, n the number of blocks of equal weight (Higgins, Thompson and
    Spiegelhalter 2009), and the lower end counts. More blocks narrow the interval of m, and leave that of the next
    block as it is. Errors count after `_STRETCH`.
    """
    most = np.ones(3)
    for part in evidence:
        if part.horizon != _STRETCH:
            continue
        member = np.unique(part.block, return_inverse=True)[1]
        change = part.change[:, part.state]
        error = part.error - part.change @ share + share[part.state] * change
        together, power = (np.bincount(member, change * other) for other in (error, change))
        together, power = together[power > 0.0], power[power > 0.0]
        if (count := len(power)) < 2:
            continue
        best, weight = together / power, power / power.sum()
        mean, equal = float(weight @ best), 1.0 / float(weight @ weight)
        variance = count / (count - 1) * float(weight @ np.square(best - mean))
        most[part.state] = np.clip(2.0 * (mean - np.sqrt(variance * (1.0 + 1.0 / equal))), 0.0, 1.0)
    return most


def doubt_from(evidence: Sequence[TrustEvidence], share: np.ndarray, kernel: Kernel) -> np.ndarray:
    """Return the variance of what remains wrong beyond the process's and the label noise, shape (3,).

    Parameters
    ----------
    share : ndarray, shape (3,)
        Trust of each output.
    kernel : Kernel
        Of the set.

    Notes
    -----
    Of a range of variances the one is taken with which 50, 90 and 95 % intervals of held-out labels hold shares
    closest to these, in squares. Labels of whole blocks that training has not seen count, so what differs between
    stretches of driving is in it.
    """
    doubt = np.zeros(3)
    for part in evidence:
        if part.horizon or part.variance is None or not len(part.error):
            continue
        tau, signal = share[part.state], kernel.signal_variance[part.state]
        squared, noise = np.square(part.error - part.change @ share), kernel.noise_variance[part.state]
        largest = float(np.mean(squared) + np.mean(tau**2 * part.variance) + noise)
        tried = largest * np.append(0.0, np.geomspace(1e-4, 4.0, 80))
        missed = np.zeros(len(tried))
        for number, (doubted, kept) in enumerate(zip(tried, kept_share(tau, tried, signal), strict=True)):
            ratio = squared / (kept * part.variance + doubted + noise)
            for level in _LEVELS_OF_INTERVALS:
                missed[number] += np.square(np.mean(ratio <= ndtri(0.5 + 0.5 * level) ** 2) - level)
        doubt[part.state] = tried[int(np.argmin(missed))]
    return doubt


def _sizes(part: TrustEvidence, inside: np.ndarray) -> tuple[float, float]:
    """Return the nominal sum of squared errors, and the sum of squares that nobody would notice."""
    moved = _NEGLIGIBLE_MOVEMENT * part.movement[inside]
    return float(np.square(part.file_error[inside]).sum()), float(np.square(moved).sum())


def _increase(part: TrustEvidence, inside: np.ndarray, shares: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return how the sum of squares changes for every trust, and the standard error of that over blocks."""
    terms = np.concatenate([-2.0 * shares, *(shares[:, i, None] * shares for i in range(3))], axis=1)
    numbers, member = np.unique(part.block[inside], return_inverse=True)
    error, change = part.error[inside], part.change[inside]
    products = np.concatenate([error[:, None] * change, *(change[:, i, None] * change for i in range(3))], axis=1)
    sums = np.zeros((len(numbers), products.shape[1]))
    np.add.at(sums, member, products)
    before = np.square(error) - np.square(part.file_error[inside])
    by_block = terms @ sums.T + np.bincount(member, before)
    total, count = by_block.sum(axis=1), len(numbers)
    spread = by_block - by_block.mean(axis=1, keepdims=True)
    return total, np.sqrt(count / max(count - 1, 1) * np.square(spread).sum(axis=1))


def _thirds(conditions: np.ndarray) -> list[np.ndarray]:
    """Return masks of the lowest, middle and highest third of each condition, and of each drive."""
    masks = []
    for column in conditions.T[:-1]:
        low, high = np.quantile(column, [1 / 3, 2 / 3])
        masks += [column <= low, (column > low) & (column <= high), column > high]
    masks += [conditions[:, -1] == number for number in np.unique(conditions[:, -1])]
    fewest = max(20, len(conditions) // 20)
    return [mask for mask in masks if fewest <= mask.sum() < len(mask)]
