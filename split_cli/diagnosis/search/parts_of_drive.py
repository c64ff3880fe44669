"""Test for terms that act in a part of the drive only, such as brakes that are weak until they are warm.

Such a term is a difference between simulation and reality, but no finding, since it does not act all along the drive. A
part as long as a drive has to be is tested like a drive: the saving must be significant and above the allowance, and
the blocks of time in it must agree.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise_of
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.remainder.structure import minimum_effect_p, term_allowances
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, Tangent, fit_parts
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.vehicle.effects import CATALOGUE

# Blocks of which parts are formed [1]: 8 min in blocks of 2 s. The number of parts grows with its square.
_MOST_BLOCKS = 240


class PartReading(NamedTuple):
    """One parameter of a term that explains a part of the drive."""

    term: str
    parameter: str
    estimate: ParameterEstimate  # in that part


@dataclass(frozen=True)
class ActingPart:
    """A part of the drive in which a term acts."""

    part: Part  # the term with its values there
    recording: int  # number of the real recording that it begins in
    # begin, end: in that recording's time [s].
    begin: float
    end: float
    # p value of the minimum-effect test, corrected for the number of parts and terms.
    p_value: float
    share: float  # share of the compared rows in it [1]
    # Terms that explain this part nearly as well within a car's range, best first.
    readings: tuple[PartReading, ...] = ()


@dataclass(frozen=True)
class Parts:
    """Savings of directions in all parts of a drive that are long enough."""

    # first, last: (W,): first and last block of time of each part.
    first: np.ndarray
    last: np.ndarray
    # size, saved: (W, P): least-squares size of each direction in each part, and the cost that it saves there.
    size: np.ndarray
    saved: np.ndarray
    z: np.ndarray  # (W, P): the saving in standard errors over blocks, see `block_z`
    t: np.ndarray  # (W, P): the size in standard errors over blocks, see `block_t`


def parts_of_drive(objective: MarginalLikelihood, columns: np.ndarray, residuals: np.ndarray) -> Parts:
    """Return what whitened directions (R, P) save of whitened residuals (R,) in each part of the drive.

    A part is a run of blocks of time with at least the rows that a diagnosis needs. Witnesses are left out.

    Notes
    -----
    With s_b = d_b^T e_b and i_b = d_b^T d_b over the rows of block b, a part saves (sum of s_b)^2/(sum of i_b),
    and its blocks a (2 s_b - a i_b) with a = (sum of s_b)/(sum of i_b). A scan statistic over intervals of time
    (Naus, 1965), each interval with its own chi squared of one degree of freedom.
    """
    block, least = _blocks(objective)
    d, e = columns[: len(block)], residuals[: len(block)]
    count = int(block.max(initial=-1)) + 1
    length = np.bincount(block, minlength=count) / 3.0

    def of_blocks(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(block, column, minlength=count) for column in values.T], axis=1)

    s, i = of_blocks(d * e[:, None]), of_blocks(d * d)
    before = np.concatenate([[0.0], np.cumsum(length)])
    first, last = np.triu_indices(count)
    long = before[last + 1] - before[first] >= objective.policy.comparison.least_rows
    long &= last - first + 1 >= least
    first, last = first[long], last[long]

    def within(values: np.ndarray) -> np.ndarray:
        total = np.concatenate([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
        return total[last + 1] - total[first]

    score, known, blocks = within(s), within(i), (last - first + 1)[:, None]
    # Where a direction has no effect, differences of running sums are rounding errors.
    acts = known > 1e-9 * i.sum(axis=0)
    size = np.divide(score, known, out=np.zeros_like(score), where=acts)
    saved = score * size
    ss, si, ii = within(s * s), within(s * i), within(i * i)
    squared = size**2 * (4.0 * ss - 4.0 * size * si + size**2 * ii)
    error = np.sqrt(np.maximum(squared - saved**2 / blocks, 0.0) * blocks / np.maximum(blocks - 1, 1))
    scores = np.sqrt(np.maximum(ss - 2.0 * size * si + size**2 * ii, 0.0))
    return Parts(first, last, size, saved, saved / (error + 1e-9), np.abs(score) / (scores + 1e-9))


def _blocks(objective: MarginalLikelihood) -> tuple[np.ndarray, int]:
    """Return the block of time of each entry without witnesses, and the least number of blocks in a part.

    On long drives several blocks are joined. A part needs as many blocks as the shortest drive that is diagnosed, so
    that their agreement can be tested.
    """
    block = objective.block[: 3 * sum(int(mask.sum()) for mask in objective.keep)]
    longest = np.bincount(block).max(initial=1) / 3.0
    several = 1 + int(block.max(initial=0)) // _MOST_BLOCKS
    return block // several, int(np.ceil(objective.policy.comparison.least_rows / longest))


def most_saved(objective: MarginalLikelihood, columns: np.ndarray, residuals: np.ndarray) -> float:
    """Return the largest saving of any of the directions in any part of the drive [chi squared]."""
    return float(parts_of_drive(objective, columns, residuals).saved.max(initial=0.0))


def strongest_beside_tolerated(
    objective: MarginalLikelihood,
    tangents: Callable[[], Sequence[Tangent]],
    variance_inflation: float,
    base: Fit,
    chosen: Fit,
) -> ActingPart | None:
    """Return `strongest_part` beside the sensor errors within tolerance of an explanation, which are refitted.

    Such an error, as an offset of the gyroscope, acts all along the drive.
    """
    tolerated = [part for part in chosen.parts if part.is_within_tolerance]
    fit = fit_parts(objective, tolerated, slopes_of=chosen) if tolerated else base
    return strongest_part(objective, tangents(), fit.residuals, variance_inflation)


def strongest_part(
    objective: MarginalLikelihood, tangents: Sequence[Tangent], residuals: np.ndarray, variance_inflation: float
) -> ActingPart | None:
    """Return the part of the drive and the term with the smallest p value; None if no part is long enough.

    Parameters
    ----------
    tangents : sequence of Tangent
        Terms, linearised.
    residuals : ndarray, shape (R,)
        Whitened, of the explanation without any term of the car.
    """
    widened = max(variance_inflation, objective.form_error_inflation)
    tangents = [linear for linear in tangents if not _has_witnesses(objective, linear)]

    def asked(linear: Tangent) -> tuple[int, list[tuple[ActingPart, tuple[int, int]]]]:
        sizes = _sizes(linear)
        if not sizes:
            return 0, []
        parts = parts_of_drive(objective, linear.slopes[:, sizes], residuals)
        found = []
        rules = objective.policy
        agree = (parts.z > rules.comparison.deviations) | (parts.t > rules.selection.sure)
        for column, k in enumerate(sizes):
            saved = np.where(agree[:, column], parts.saved[:, column], 0.0)
            for w in np.argsort(-saved)[: rules.selection.considered]:
                one = _stretch(objective, linear, k, parts, int(w), column, widened) if saved[w] > widened else None
                if one is not None:
                    found.append((one, (int(parts.first[w]), int(parts.last[w]))))
        return parts.saved.size, found

    answers = map_in_threads(asked, tangents)
    tried = sum(count for count, _ in answers)
    every = (one for _, found in answers for one in found)
    best, blocks = min(every, key=lambda one: one[0].p_value, default=(None, (0, 0)))
    if best is None:
        return None
    readings = _readings(objective, tangents, residuals, blocks, widened)
    return replace(best, p_value=min(1.0, best.p_value * tried), readings=readings)


def _sizes(linear: Tangent) -> list[int]:
    """Return the numbers of a tangent's parameters that have a neutral value."""
    neutral = CATALOGUE[linear.part.candidate.term].neutral
    return [k for k, name in enumerate(linear.part.values) if neutral.get(name) is not None]


def _readings(
    objective: MarginalLikelihood,
    tangents: Sequence[Tangent],
    residuals: np.ndarray,
    blocks: tuple[int, int],
    widened: float,
) -> tuple[PartReading, ...]:
    """Return the terms that explain a part of the drive nearly as well as the best one, each with one parameter.

    Parameters
    ----------
    objective, tangents, residuals
        As for `strongest_part`.
    blocks : tuple of int
        First and last block of the part.
    widened : float
        Variance inflation factor [1].

    Notes
    -----
    The standard error is the larger of two: that of noise, widened by autocorrelation and model-form error, and the
    sandwich over blocks. Values at the end of a car's range are left out.
    """
    block, rules = _blocks(objective)[0], objective.policy.selection
    inside = (block >= blocks[0]) & (block <= blocks[1])
    own, e = block[inside] - blocks[0], residuals[: len(block)][inside]
    best: dict[str, tuple[float, PartReading]] = {}
    for linear in tangents:
        one, names = linear.part.candidate, list(linear.part.values)
        for k in _sizes(linear):
            d = linear.slopes[: len(block), k][inside]
            score, known = np.bincount(own, d * e), np.bincount(own, d * d)
            if known.sum() <= 0.0:
                continue
            steps = float(score.sum() / known.sum())
            saved = steps * float(score.sum())
            values = _at(one, linear.part.values, names[k], steps)
            if one.is_within_tolerance(values) or one.at_limit(values):
                continue
            scores = float(np.linalg.norm(score - steps * known)) / known.sum()
            error = max(scores, float(np.sqrt(widened / known.sum()))) * one.ranges[names[k]].step
            if saved > best.get(one.term, (0.0,))[0]:
                best[one.term] = saved, _reading(one, names[k], values[names[k]], error, rules.deviations)
    enough = (1.0 - rules.fair_share) * max((saved for saved, _ in best.values()), default=0.0)
    ranked = sorted(best.values(), key=lambda pair: -pair[0])
    return tuple(reading for saved, reading in ranked if saved >= enough)


def _reading(one: Candidate, name: str, value: float, error: float, deviations: float) -> PartReading:
    """Return a value with its interval, clipped to a car's range."""
    limit, unit = one.ranges[name], CATALOGUE[one.term].parameter_units(one.variant)[name]
    ends = np.clip([value - deviations * error, value + deviations * error], limit.lower, limit.upper)
    return PartReading(one.term, name, ParameterEstimate(value, error, unit, (float(ends[0]), float(ends[1]))))


def _has_witnesses(objective: MarginalLikelihood, linear: Tangent) -> bool:
    """Return whether a term is a sensor fault that changes witnesses.

    Parts of a drive are tested without witnesses. There model-form error may look like a late channel, which witnesses
    would deny.
    """
    return linear.part.term.corrects and bool(objective.of_witnesses(linear.slopes).any())


def _stretch(
    objective: MarginalLikelihood, linear: Tangent, k: int, parts: Parts, w: int, column: int, widened: float
) -> ActingPart | None:
    """Return a term in a part of the drive with its p value; None if it is a sensor error within tolerance."""
    one, name = linear.part.candidate, list(linear.part.values)[k]
    values = _at(one, linear.part.values, name, float(parts.size[w, column]))
    if one.is_within_tolerance(values):
        return None
    term, inside = one.build(values), _rows_of(objective, int(parts.first[w]), int(parts.last[w]))
    sizes = [
        effects_to_noise_of(it, it.at[rows], (term,), (), partial(objective.discrepancy_change, it))
        for it, rows in zip(objective.evidence, inside, strict=True)
        if rows.any()
    ]
    size = float(np.max(np.max(sizes, axis=0) / term_allowances(objective)))
    floor = max(
        objective.policy.allowances.term_floor * objective.shared_cost, objective.part_floors.get(one.effect, 0.0)
    )
    p_value = minimum_effect_p(float(parts.saved[w, column]), 1.0, size, widened, floor, allowance=1.0)
    recording = next(k for k, rows in enumerate(inside) if rows.any())
    t = objective.evidence[recording].series.drive["t"][objective.evidence[recording].at[inside[recording]]]
    share = sum(int(rows.sum()) for rows in inside) / sum(int(mask.sum()) for mask in objective.keep)
    return ActingPart(Part(one, values), recording, float(t[0]), float(t[-1]), p_value, share)


def _at(one: Candidate, values: Mapping[str, float], name: str, steps: float) -> dict[str, float]:
    """Return values with one parameter so many steps from neutral, and the others neutral.

    `steps` is the least-squares size of the derivative of the residuals, so the value that explains them is minus that.
    """
    neutral = {key: CATALOGUE[one.term].neutral.get(key) for key in values}
    none = {key: value if neutral[key] is None else neutral[key] for key, value in values.items()}
    limit = one.ranges[name]
    wanted = neutral[name] - steps * limit.step
    return {**none, name: float(np.clip(wanted, limit.lower, limit.upper))}


def _rows_of(objective: MarginalLikelihood, first: int, last: int) -> list[np.ndarray]:
    """Return which rows of each recording lie in the blocks `first` to `last`, bool (G,) each."""
    block, out = _blocks(objective)[0][::3], []
    for mask in objective.keep:
        own, block = np.split(block, [int(mask.sum())])
        inside = np.zeros(len(mask), dtype=bool)
        inside[mask] = (own >= first) & (own <= last)
        out.append(inside)
    return out
