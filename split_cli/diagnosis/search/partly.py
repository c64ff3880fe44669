"""A term that acts in a part of the drive only: brakes that are weak for a while, a tyre that picks up.

It has no name, since all along the drive it is not what its name says. A difference it is. A part that is as long
as a drive has to be is asked what a drive is asked: whether what a term saves there is more than chance and more
than what is allowed, and whether the moments of that part agree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise_of
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.remainder.structure import minimum_effect_p, term_allowances
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Part, Tangent
from split_cli.diagnosis.together import together
from split_cli.vehicle.effects import CATALOGUE

__all__ = ["ActingPart", "Parts", "most_saved", "parts_of_drive", "strongest_part"]

_MOST_BLOCKS = 240  # of which parts are made, eight minutes in blocks of 2 s: their number grows with its square


@dataclass(frozen=True)
class ActingPart:
    """A part of the drive in which a term acts.

    Attributes
    ----------
    part : Part
        A term with its parameters there.
    recording : int
        Which of the real recordings it begins in.
    begin, end : float
        In that recording's time [s].
    p_value : float
        Of an effect no larger than what is allowed, after counting all parts and terms that were asked.
    """

    part: Part
    recording: int
    begin: float
    end: float
    p_value: float


@dataclass(frozen=True)
class Parts:
    """What directions save in every part of a drive that is long enough.

    Attributes
    ----------
    first, last : ndarray of int, shape (W,)
        Blocks of time that a part begins and ends with.
    size, saved : ndarray, shape (W, P)
        Best size of each direction in each part, and the cost that it saves there.
    z : ndarray, shape (W, P)
        The same in standard errors, from differences block by block, see `block_z`.
    t : ndarray, shape (W, P)
        The size in standard errors, from scores block by block, see `block_t`.
    """

    first: np.ndarray
    last: np.ndarray
    size: np.ndarray
    saved: np.ndarray
    z: np.ndarray
    t: np.ndarray


def parts_of_drive(objective: MarginalLikelihood, columns: np.ndarray, residuals: np.ndarray) -> Parts:
    """Return what directions (R, P) save of residuals (R,) in each part of the drive.

    A part is a run of blocks of time with as many rows as a drive needs to be decided on. What a recording knows
    twice is left out. Both have been whitened.

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
    # Where a direction does nothing, running sums leave what rounding makes of all the rest.
    acts = known > 1e-9 * i.sum(axis=0)
    size = np.divide(score, known, out=np.zeros_like(score), where=acts)
    saved = score * size
    ss, si, ii = within(s * s), within(s * i), within(i * i)
    squared = size**2 * (4.0 * ss - 4.0 * size * si + size**2 * ii)
    error = np.sqrt(np.maximum(squared - saved**2 / blocks, 0.0) * blocks / np.maximum(blocks - 1, 1))
    scores = np.sqrt(np.maximum(ss - 2.0 * size * si + size**2 * ii, 0.0))
    return Parts(first, last, size, saved, saved / (error + 1e-9), np.abs(score) / (scores + 1e-9))


def _blocks(objective: MarginalLikelihood) -> tuple[np.ndarray, int]:
    """Return the block of each compared row's entries, and how many blocks the shortest part has.

    Where there are many, several are taken as one. A part has as many blocks as a drive that is just long enough:
    fewer could not tell whether they agree.
    """
    block = objective.block[: 3 * sum(int(mask.sum()) for mask in objective.keep)]
    longest = np.bincount(block).max(initial=1) / 3.0
    several = 1 + int(block.max(initial=0)) // _MOST_BLOCKS
    return block // several, int(np.ceil(objective.policy.comparison.least_rows / longest))


def most_saved(objective: MarginalLikelihood, columns: np.ndarray, residuals: np.ndarray) -> float:
    """Return the cost that the best of some directions saves in the best part of the drive."""
    return float(parts_of_drive(objective, columns, residuals).saved.max(initial=0.0))


def strongest_part(
    objective: MarginalLikelihood,
    lines: Sequence[Tangent],
    residuals: np.ndarray,
    variance_inflation: float,
) -> ActingPart | None:
    """Return the part of the drive and the term whose effect there is surest; None where no part is long enough.

    Parameters
    ----------
    objective : MarginalLikelihood
    lines : sequence of Tangent
        Terms, as straight lines.
    residuals : ndarray, shape (R,)
        Whitened, what nothing has explained.
    variance_inflation : float
    """
    widened = max(variance_inflation, objective.form_error_inflation)

    def asked(line: Tangent) -> tuple[int, list[ActingPart]]:
        one = line.part.candidate
        sizes = [k for k, name in enumerate(line.part.values) if CATALOGUE[one.term].neutral.get(name) is not None]
        if not sizes or _has_witnesses(objective, line):
            return 0, []
        parts = parts_of_drive(objective, line.slopes[:, sizes], residuals)
        found = []
        rules = objective.policy
        agree = (parts.z > rules.comparison.deviations) | (parts.t > rules.selection.sure)
        for column, k in enumerate(sizes):
            saved = np.where(agree[:, column], parts.saved[:, column], 0.0)
            for w in np.argsort(-saved)[: rules.selection.considered]:
                if saved[w] > widened:
                    found.append(_stretch(objective, line, k, parts, int(w), column, widened))
        return parts.saved.size, found

    answers = together(asked, lines)
    tried = sum(count for count, _ in answers)
    best = min((one for _, found in answers for one in found if one), key=lambda one: one.p_value, default=None)
    return None if best is None else replace(best, p_value=min(1.0, best.p_value * tried))


def _has_witnesses(objective: MarginalLikelihood, line: Tangent) -> bool:
    """Return whether a sensor's fault moves what the recording knows twice, which parts leave out.

    Velocities alone are asked in a part. There model-form error looks like a late channel, all along the drive
    where witnesses deny it.
    """
    return line.part.term.corrects and bool(objective.of_witnesses(line.slopes).any())


def _stretch(
    objective: MarginalLikelihood, line: Tangent, k: int, parts: Parts, w: int, column: int, widened: float
) -> ActingPart | None:
    """Return a term in a part of the drive, with its p value; nothing where any sound recording has as much."""
    one, name = line.part.candidate, list(line.part.values)[k]
    values = _at(one, line.part.values, name, float(parts.size[w, column]))
    if one.is_everyday(values):
        return None
    term, inside = one.build(values), _rows_of(objective, int(parts.first[w]), int(parts.last[w]))
    sizes = [
        effects_to_noise_of(it, it.at[rows], (term,), (), partial(objective.carried, it))
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
    return ActingPart(Part(one, values), recording, float(t[0]), float(t[-1]), p_value)


def _at(one: Candidate, values: Mapping[str, float], name: str, steps: float) -> dict[str, float]:
    """Return values at which one parameter is so many steps from no effect and the others have none.

    A direction takes off the residuals what it explains: the size found is minus the steps that explain it.
    """
    neutral = {key: CATALOGUE[one.term].neutral.get(key) for key in values}
    none = {key: value if neutral[key] is None else neutral[key] for key, value in values.items()}
    limit = one.ranges[name]
    wanted = neutral[name] - steps * limit.step
    return {**none, name: float(np.clip(wanted, limit.lower, limit.upper))}


def _rows_of(objective: MarginalLikelihood, first: int, last: int) -> list[np.ndarray]:
    """Return which rows of each recording lie in some blocks, shape (G,) each."""
    block, out = _blocks(objective)[0][::3], []
    for mask in objective.keep:
        own, block = np.split(block, [int(mask.sum())])
        inside = np.zeros(len(mask), dtype=bool)
        inside[mask] = (own >= first) & (own <= last)
        out.append(inside)
    return out
