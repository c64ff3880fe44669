"""Thresholds calibrated by comparing two halves of the simulation's own data.

The shared model discrepancy is learned on one half of the simulation, and judged on the other half with
reality's noise, just as reality is judged. Nothing that this finds is a difference between the two: reality
has to show clearly more. Where the simulation is clean, next to nothing is found and nothing changes. Where
it is a recording itself, or where no dictionary holds its physics, the test shows how much.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.innovations.comparable import comparable
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import (
    DiscrepancyPosterior,
    MarginalLikelihood,
    build_objective,
    learn_discrepancy,
)
from split_cli.diagnosis.parallel import map_distributed, map_in_threads
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.witnesses import Witness, build_witnesses, usual_weights_by_kind
from split_cli.diagnosis.remainder.autocorrelation import residual_autocorrelation
from split_cli.diagnosis.remainder.flexible import FlexiblePiece, flexible_rows
from split_cli.diagnosis.remainder.structure import FlexibleFit, build_structure
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.parts_of_drive import most_saved
from split_cli.vehicle.effects import CATALOGUE

_BINS = 40
_WAVES = 12


@dataclass(frozen=True)
class SelfTest:
    """What one half of a simulation shows beyond what the other half taught."""

    # Rows that were judged; 0 where the halves have not been in the same places, and nothing is known.
    rows: int = 0
    # Cost that a flexible fit saves, noise included, over its freedom; about 1 when nothing is there.
    ratio: float = 1.0
    unnamed: float = 0.0  # cost that a flexible fit saves
    # Cost that each term saves alone, in its best variant, start and place.
    terms: Mapping[str, float] = field(default_factory=dict)
    autocorrelation: float = 1.0  # how much rows vary together, see `residual_autocorrelation`
    # What each term saves of the witnesses' cost alone.
    witnessed: Mapping[str, float] = field(default_factory=dict)
    # Cost that each term saves alone in the best part of the drive, see `parts_of_drive`.
    partly: Mapping[str, float] = field(default_factory=dict)

    def allow(self, objective: MarginalLikelihood) -> MarginalLikelihood:
        """Return an objective that forgives as much, with a margin.

        A model-form error saves in proportion to the rows, autocorrelated residuals save no more of more rows;
        the root lies between.
        """
        if not self.rows:
            return objective
        rules, scale = objective.policy.self_test, self._scale(sum(int(mask.sum()) for mask in objective.keep))
        most = max(self.terms.values(), default=0.0)
        return replace(
            objective,
            unnamed_floor=rules.unnamed_margin * scale * self.unnamed,
            term_floors={
                term: rules.term_margin * scale * max(saved, rules.kindred * most) for term, saved in self.terms.items()
            },
            self_test_savings={term: scale * saved for term, saved in self.terms.items()},
            witness_floors={term: rules.term_margin * scale * saved for term, saved in self.witnessed.items()},
            part_floors={term: rules.term_margin * scale * saved for term, saved in self.partly.items()},
        )

    def usual_autocorrelation(self, rows: int) -> float:
        """Return how much so many rows of the simulation vary together beyond a flexible fit, at least 1.

        A flexible fit takes slow parts with it, and of more rows it takes less. What is more than white grows as
        what is forgiven does: where the simulation is white, nothing does.
        """
        return 1.0 + (max(self.autocorrelation, 1.0) - 1.0) * (self._scale(rows) if self.rows else 1.0)

    def _scale(self, rows: int) -> float:
        """Return by how much more than the judged half so many rows may show: the root, see `allow`."""
        return float(np.sqrt(max(rows / self.rows, 1.0)))

    def form_error_inflation_of(self, gap: FlexibleFit, policy: Policy = STANDARD) -> float:
        """Return the variance inflation factor by model-form error: that between the halves, within limits.

        It is no more than reality itself shows, whose difference may hold model-form error and nothing else.
        """
        return policy.self_test.term_margin * min(self.ratio, gap.saved / max(gap.freedom, 1.0))


def self_test(
    rewhitened: Sequence[Evidence],
    discrepancy: SharedDiscrepancy,
    candidates: Sequence[Candidate],
    kinematics: Sequence[KinematicResiduals | Witness] = (),
    *,
    variance_inflation: float,
    reach: float,
    posterior: DiscrepancyPosterior | None,
    fixed_baseline: bool = False,
    policy: Policy = STANDARD,
) -> SelfTest:
    """Judge each half of a simulation by the other.

    Parameters
    ----------
    rewhitened : sequence of Evidence
        The simulation with the noise and disturbance of the real recordings, see `rewhitened_with_noise`.
    candidates : sequence of Candidate
        Terms that reality will be searched for.
    kinematics : sequence of KinematicResiduals or Witness
        Of the real recordings; nothing but their noise is taken.
    variance_inflation, reach : float
        As for reality.
    posterior : DiscrepancyPosterior or None
        Of the whole simulation: what terms would explain there, is moved along with the inputs they alter.
    fixed_baseline : bool
        Whether halves are taken as a fixed baseline.

    Notes
    -----
    Noise is not drawn: rows are whitened as noisy ones are, and what noise of unit variance adds to a saving, one
    for each parameter, is added.
    """
    scales: dict[str, float] = {}
    for one in kinematics:
        scales[one.kind] = max(one.scale, scales.get(one.kind, 0.0))
    positions = tuple(
        (k, replace(one, scale=max(one.scale, scales[one.kind])))
        for k, recording in enumerate(rewhitened)
        for one in build_witnesses(recording.series, rules=policy.believing)
        if one.kind in scales
    )
    all_rows = [np.ones(len(one.at), dtype=bool) for one in rewhitened]
    objective = build_objective(rewhitened, None, discrepancy, all_rows, [one for _, one in positions], policy=policy)
    offers = _offers(replace(objective, posterior=posterior), candidates)
    rows = tuple(tuple(flexible_rows(one, discrepancy)) for one in rewhitened)
    sides = _Sides(tuple(rewhitened), positions, rows, discrepancy, variance_inflation, reach, fixed_baseline, policy)
    dealings = (_every_other_block(rewhitened, policy), _first_half(rewhitened))
    halves = [[mask ^ turned for mask in first] for first in dealings for turned in (False, True)]
    tests = map_distributed(lambda teaching: _test_half(sides, teaching, offers), halves)
    tests = [test for test in tests if test is not None]
    if not tests:
        return SelfTest()
    names = dict.fromkeys(term for test in tests for term in test.terms)
    return SelfTest(
        max(test.rows for test in tests),
        max(test.ratio for test in tests),
        max(test.unnamed for test in tests),
        {term: max(test.terms[term] for test in tests) for term in names},
        max(test.autocorrelation for test in tests),
        {term: max(test.witnessed[term] for test in tests) for term in names},
        {term: max(test.partly[term] for test in tests) for term in names},
    )


def _every_other_block(rewhitened: Sequence[Evidence], policy: Policy) -> list[np.ndarray]:
    """Return the rows in every other block of driving time, of each recording, shape (G,).

    Halves in blocks cover the same ground, as the two drives of a comparison do where rows are compared: the first
    and the second half of a ramp of speed do not. Blocks are as long as leaves eight of them, and no longer than
    the longest: within a block, rows depend on each other. What drifts, as the biases of instruments do, differs
    between the first and the second half alone; so the recording is dealt both ways.
    """
    total = sum(len(one.at) for one in rewhitened)
    length = int(np.clip(total // policy.self_test.blocks, 1, policy.comparison.least_rows))
    first = np.cumsum([0, *(len(one.at) for one in rewhitened)])
    return [
        (before + np.arange(len(one.at))) // length % 2 == 0 for before, one in zip(first, rewhitened, strict=False)
    ]


def _first_half(rewhitened: Sequence[Evidence]) -> list[np.ndarray]:
    """Return the rows in the first half of all driving time, of each recording, shape (G,)."""
    total = sum(len(one.at) for one in rewhitened)
    first = np.cumsum([0, *(len(one.at) for one in rewhitened)])
    return [before + np.arange(len(one.at)) < total / 2 for before, one in zip(first, rewhitened, strict=False)]


@dataclass(frozen=True)
class _Offer:
    """Directions, shape (R, P) over all rows of the simulation, that one term offers to explain with."""

    term: str
    columns: np.ndarray
    located: str


def _offers(objective: MarginalLikelihood, candidates: Sequence[Candidate]) -> list[_Offer]:
    """Linearise every candidate about its starts; one with a place about its being everywhere."""
    base = objective.residual(())

    def offered(candidate: Candidate) -> list[_Offer]:
        if candidate.located:
            whole, _ = candidate.everywhere()
            return [_Offer(candidate.effect, (objective.left_by((whole,)) - base)[:, None], candidate.located)]
        neutral = {name: CATALOGUE[candidate.term].neutral.get(name) for name in candidate.ranges}
        out = []
        for start in candidate.starts:
            shape = {name: value for name, value in start.items() if neutral[name] is None}
            sizes = [name for name in start if neutral[name] is not None]
            columns = [
                objective.left_by((candidate.build({**{k: neutral[k] for k in sizes}, **shape, name: start[name]}),))
                - base
                for name in sizes
            ]
            out.append(_Offer(candidate.effect, np.stack(columns, axis=1), ""))
        return out

    return [offer for several in map_in_threads(offered, candidates) for offer in several]


@dataclass(frozen=True)
class _Sides:
    """A simulation with the noise of reality, half of it to teach and half to be judged."""

    rewhitened: tuple[Evidence, ...]
    positions: tuple[tuple[int, KinematicResiduals | Witness], ...]
    rows: tuple[tuple[FlexiblePiece, ...], ...]
    discrepancy: SharedDiscrepancy
    variance_inflation: float
    reach: float
    fixed_baseline: bool = False
    policy: Policy = STANDARD

    def windows(self, teaching: Sequence[np.ndarray]) -> tuple[list[KinematicResiduals | Witness], np.ndarray]:
        """Return kinematic windows outside the teaching half, with what is usual, and which of all they are."""
        pairs = []
        for k, one in self.positions:
            mask = teaching[k]
            pairs.append((one, mask[np.searchsorted(self.rewhitened[k].at, one.begin).clip(max=len(mask) - 1)]))
        usual_by_kind = usual_weights_by_kind(one.select(side) for one, side in pairs)
        judged = [replace(one.select(~side), usual=usual_by_kind[one.kind]) for one, side in pairs]
        return judged, np.concatenate([~side for _, side in pairs]) if pairs else np.zeros(0, dtype=bool)


def _test_half(sides: _Sides, teaching: Sequence[np.ndarray], offers: Sequence[_Offer]) -> SelfTest | None:
    rewhitened, discrepancy = sides.rewhitened, sides.discrepancy
    taught = [replace(one, weight=one.weight * mask) for one, mask in zip(rewhitened, teaching, strict=True)]
    if not any((one.weight > 0.0).any() for one in taught):
        return None
    keep = [
        comparable(one, taught, discrepancy, sides.reach, sides.policy) & ~mask
        for one, mask in zip(rewhitened, teaching, strict=True)
    ]
    rows = sum(int(mask.sum()) for mask in keep)
    if rows < sides.policy.comparison.rows_of_half:
        return None
    positions, windows = sides.windows(teaching)
    posterior = learn_discrepancy(taught, sides.variance_inflation, sides.policy.believing)
    objective = build_objective(rewhitened, posterior, discrepancy, keep, positions, policy=sides.policy)
    if sides.fixed_baseline:
        objective = objective.with_fixed_baseline()
    residuals = objective.whiten(objective.residual(()))
    structure = build_structure(objective, sides.rows)
    fit = structure.fit(residuals, sides.variance_inflation)
    chosen = np.concatenate([np.repeat(np.concatenate(keep), 3), windows])
    s = objective.places()
    lap = rewhitened[0].series.lap_length
    terms, witnessed, partly = ({offer.term: 0.0 for offer in offers} for _ in range(3))
    own = objective.of_witnesses(residuals)
    for offer in offers:
        columns = objective.whiten(offer.columns[chosen])
        witnessed[offer.term] = max(witnessed[offer.term], _saving(objective.of_witnesses(columns), own))
        if offer.located:
            saved = _best_place(columns[:, 0], residuals, s, offer.located, lap)
        else:
            saved = _saving(columns, residuals)
        terms[offer.term] = max(terms[offer.term], saved)
        if not offer.located:
            # A half may be too short to have parts.
            partly[offer.term] = max(partly[offer.term], saved, most_saved(objective, columns, residuals))
    # What the simulation lacks of reality's noise would have added its share.
    quiet = max(0.0, 1.0 - (float(residuals @ residuals) - fit.saved) / max(len(residuals) - fit.freedom, 1.0))
    return SelfTest(
        rows,
        fit.saved / fit.freedom + quiet,
        fit.saved,
        terms,
        residual_autocorrelation(structure, residuals).ratio,
        witnessed,
        partly,
    )


def _saving(columns: np.ndarray, residuals: np.ndarray) -> float:
    scale = np.sqrt(np.sum(columns**2, axis=0))
    if not scale.max(initial=0.0):
        return 0.0
    unit = columns[:, scale > 0.0] / scale[scale > 0.0]
    score = unit.T @ residuals
    return float(score @ np.linalg.solve(unit.T @ unit + 1e-9 * np.eye(len(score)), score))


def _best_place(column: np.ndarray, residuals: np.ndarray, s: np.ndarray, kind: str, lap: float | None) -> float:
    """Return what a column saves on the best stretch, or as the best wave, of the track."""
    reach = lap or max(float(s.max()), 1e-9)
    if kind == "wave":
        angles = 2.0 * np.pi * s[:, None] / reach * np.arange(1, _WAVES + 1)
        return max(
            _saving(column[:, None] * np.stack([np.sin(angle), np.cos(angle)], axis=1), residuals) for angle in angles.T
        )
    place = np.minimum((s / reach * _BINS).astype(int), _BINS - 1)
    score = np.bincount(place, column * residuals, minlength=_BINS)
    information = np.bincount(place, column**2, minlength=_BINS)
    best = 0.0
    for length in range(1, _BINS):
        window = np.arange(_BINS)[:, None] + np.arange(length)
        if lap is None:
            window = window[: _BINS - length + 1]
        known = information[window % _BINS].sum(axis=1)
        gained = score[window % _BINS].sum(axis=1) ** 2 / np.maximum(known, 1e-300)
        best = max(best, float(gained[known > 0.0].max(initial=0.0)))
    return best
