"""Self-test of the simulation: thresholds for reality from two halves of the simulation's own data.

The shared model discrepancy is learned on one half of the simulation. The other half, with the noise of reality, is
then judged as reality is. Whatever this finds is no difference between simulation and reality, so reality has to show
clearly more. With a clean simulation it finds next to nothing. If the simulation is itself a recording, or if no basis
function represents its physics, it shows how large such false differences are.
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
from split_cli.diagnosis.remainder.oscillation import OscillatorRows, build_oscillators, oscillator_rows
from split_cli.diagnosis.remainder.structure import FlexibleFit, build_structure
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.form_error import varied_discrepancy
from split_cli.diagnosis.search.parts_of_drive import most_saved
from split_cli.vehicle.effects import CATALOGUE

_BINS = 40  # parts of a lap that form stretches [1]; judgement, the search itself takes 50
_SHARES = np.geomspace(1e-3, 1.0, 100)  # shares of the discrepancy that are tried as its error [1]
_WAVES = 12  # harmonics of a lap that are tried [1], as in the search


@dataclass(frozen=True)
class SelfTest:
    """Result of the self-test: one half of a simulation tested against the discrepancy learned on the other half."""

    # Judged rows; 0 if the halves have no common operating points, so that nothing is known.
    rows: int = 0
    # Cost that a flexible fit saves, noise included, over its degrees of freedom; about 1 without a difference.
    ratio: float = 1.0
    unnamed: float = 0.0  # cost that a flexible fit saves [chi squared]
    # Cost that each term saves alone, in its best variant, start and place [chi squared].
    terms: Mapping[str, float] = field(default_factory=dict)
    autocorrelation: float = 1.0  # ratio of `residual_autocorrelation` [1]
    # The part of the witnesses in the saving of each term.
    witnessed: Mapping[str, float] = field(default_factory=dict)
    # Cost that each term saves alone in the best part of the drive, see `parts_of_drive`.
    partly: Mapping[str, float] = field(default_factory=dict)
    # Cost that the oscillators of each frequency save beyond noise [chi squared].
    swinging: Mapping[str, float] = field(default_factory=dict)
    shared_error: float = np.inf  # upper bound of `error_of_discrepancy` [1]; infinite if nothing is known

    def allow(self, objective: MarginalLikelihood) -> MarginalLikelihood:
        """Return an objective with thresholds of these savings, scaled to its rows and with a margin.

        Savings by model-form error are proportional to the number of rows, those by autocorrelation do not depend on
        it. They are scaled with the root, in between.
        """
        if not self.rows:
            return objective
        rules, scale = objective.policy.self_test, self._scale(sum(int(mask.sum()) for mask in objective.keep))
        most = max(self.terms.values(), default=0.0)
        return replace(
            objective,
            term_floors={
                term: rules.term_margin * scale * max(saved, rules.kindred * most) for term, saved in self.terms.items()
            },
            self_test_savings={term: scale * saved for term, saved in self.terms.items()},
            witness_floors={term: rules.term_margin * scale * saved for term, saved in self.witnessed.items()},
            part_floors={term: rules.term_margin * scale * saved for term, saved in self.partly.items()},
            shared_error=min(self.shared_error, objective.policy.selection.form_error_share),
        )

    def floor(self, saved: float, objective: MarginalLikelihood) -> float:
        """Return what a fit without names may save on an objective's rows without a difference [chi squared].

        Parameters
        ----------
        saved : float
            What it saves between the halves: `unnamed`, or one of `swinging`.
        """
        if not self.rows:
            return 0.0
        rows = sum(int(mask.sum()) for mask in objective.keep)
        return objective.policy.self_test.unnamed_margin * self._scale(rows) * saved

    def usual_autocorrelation(self, rows: int) -> float:
        """Return the ratio of `residual_autocorrelation` expected from the simulation for so many rows, at least 1.

        A flexible fit removes slow parts, fewer with more rows. The excess over 1 is scaled as other savings are.
        """
        return 1.0 + (max(self.autocorrelation, 1.0) - 1.0) * (self._scale(rows) if self.rows else 1.0)

    def _scale(self, rows: int) -> float:
        """Return the factor on savings of the judged half for so many rows [1], see `allow`."""
        return float(np.sqrt(max(rows / self.rows, 1.0)))

    def form_error_inflation_of(self, gap: FlexibleFit, policy: Policy = STANDARD) -> float:
        """Return the variance inflation factor of model-form error [1].

        It follows from the difference between the halves, or from that of reality if it is smaller: the latter may be
        model-form error alone.
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
    """Judge each half of a simulation by the other, and return the largest values over all splits.

    Parameters
    ----------
    rewhitened : sequence of Evidence
        The simulation with the noise and disturbance of the real recordings, see `rewhitened_with_noise`.
    candidates : sequence of Candidate
        Terms of the later search.
    kinematics : sequence of KinematicResiduals or Witness
        Of the real recordings; only their noise is used.
    variance_inflation, reach : float
        As for reality.
    posterior : DiscrepancyPosterior or None
        Of the whole simulation. The effect of terms that alter inputs on the discrepancy is computed with it.
    fixed_baseline : bool
        Whether the half that is learned from is a fixed baseline.

    Notes
    -----
    No random noise is added. Rows are whitened as noisy ones, and the expected saving by noise of unit variance, 1 for
    each parameter, is added.
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
    swings = tuple(map(oscillator_rows, rewhitened))
    settings = discrepancy, variance_inflation, reach, fixed_baseline, policy
    sides = _Sides(tuple(rewhitened), positions, rows, swings, *settings)
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
        {group: max(test.swinging[group] for test in tests) for group in tests[0].swinging},
        max(test.shared_error for test in tests),
    )


def _every_other_block(rewhitened: Sequence[Evidence], policy: Policy) -> list[np.ndarray]:
    """Return the rows in every other block of driving time, of each recording, shape (G,).

    Halves of alternating blocks have common operating points, as compared drives do; the first and the second half of a
    speed ramp do not. There are at least eight blocks, each no longer than the policy's longest. A drift, as of a bias,
    shows only between the first and the second half. So the recording is split both ways.
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
    """Row changes, shape (R, P) on all rows of the simulation, by the parameters of one term."""

    term: str
    columns: np.ndarray
    located: str


def _offers(objective: MarginalLikelihood, candidates: Sequence[Candidate]) -> list[_Offer]:
    """Return every candidate linearised about its starts; one with a place about acting all along the track."""
    base = objective.residual(())

    def offered(candidate: Candidate) -> list[_Offer]:
        if candidate.located:
            whole, _ = candidate.everywhere()
            return [_Offer(candidate.effect, (objective.raw_residual((whole,)) - base)[:, None], candidate.located)]
        neutral = {name: CATALOGUE[candidate.term].neutral.get(name) for name in candidate.ranges}
        out = []
        for start in candidate.starts:
            shape = {name: value for name, value in start.items() if neutral[name] is None}
            sizes = [name for name in start if neutral[name] is not None]
            bare = {**shape, **{name: neutral[name] for name in sizes}}
            columns = [objective.raw_residual((candidate.build({**bare, name: start[name]}),)) - base for name in sizes]
            out.append(_Offer(candidate.effect, np.stack(columns, axis=1), ""))
        return out

    return [offer for several in map_in_threads(offered, candidates) for offer in several]


@dataclass(frozen=True)
class _Sides:
    """A simulation whitened with the noise of reality, to be split into a learning and a judged half."""

    rewhitened: tuple[Evidence, ...]
    positions: tuple[tuple[int, KinematicResiduals | Witness], ...]
    # Rows of the flexible fit and of the oscillators, of each recording.
    rows: tuple[tuple[FlexiblePiece, ...], ...]
    swings: tuple[OscillatorRows, ...]
    discrepancy: SharedDiscrepancy
    variance_inflation: float
    reach: float
    fixed_baseline: bool = False
    policy: Policy = STANDARD

    def windows(self, teaching: Sequence[np.ndarray]) -> tuple[list[KinematicResiduals | Witness], np.ndarray]:
        """Return witnesses on the judged half, with `usual` from the learning half, and a mask of these windows."""
        pairs = []
        for k, one in self.positions:
            mask = teaching[k]
            pairs.append((one, mask[np.searchsorted(self.rewhitened[k].at, one.begin).clip(max=len(mask) - 1)]))
        usual_by_kind = usual_weights_by_kind(one.select(side) for one, side in pairs)
        judged = [replace(one.select(~side), usual=usual_by_kind[one.kind]) for one, side in pairs]
        return judged, np.concatenate([~side for _, side in pairs]) if pairs else np.zeros(0, dtype=bool)


def _test_half(sides: _Sides, teaching: Sequence[np.ndarray], offers: Sequence[_Offer]) -> SelfTest | None:
    """Judge one half by the other; None if too few rows can be compared. Masks `teaching` choose the learning half."""
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
            # A half may be too short for parts; then the whole counts.
            partly[offer.term] = max(partly[offer.term], saved, most_saved(objective, columns, residuals))
    # The expected contribution of noise that the simulation does not have.
    quiet = max(0.0, 1.0 - (float(residuals @ residuals) - fit.saved) / max(len(residuals) - fit.freedom, 1.0))
    oscillators = build_oscillators(objective, sides.swings, {})
    return SelfTest(
        rows,
        fit.saved / fit.freedom + quiet,
        fit.saved,
        terms,
        residual_autocorrelation(structure, residuals).ratio,
        witnessed,
        partly,
        oscillators.savings(residuals, sides.variance_inflation, 1.0 - quiet),
        error_of_discrepancy(
            varied_discrepancy(objective), residuals, sides.variance_inflation, quiet, sides.policy.selection.deviations
        ),
    )


def error_of_discrepancy(
    columns: np.ndarray,
    residuals: np.ndarray,
    variance_inflation: float,
    quiet: float,
    deviations: float = STANDARD.selection.deviations,
) -> float:
    """Return the upper bound of the 95 % interval of the shared discrepancy's model-form error over its size [1].

    Parameters
    ----------
    columns : ndarray, shape (R, 18)
        `varied_discrepancy`, of size one.
    residuals : ndarray, shape (R,)
        What the discrepancy that was learned elsewhere leaves.
    quiet : float
        Variance of the noise that the residuals lack [1], whose expected effect is added.
    deviations : float
        Standard deviations that hold 95 %.

    Notes
    -----
    With the share s the residuals have the covariance v (I + s^2 M M^T). The bound is the largest s on a grid at which
    twice the log-likelihood is below its maximum by no more than the square of the deviations (Wilks, 1938).
    """
    own, directions = np.linalg.eigh(columns.T @ columns)
    along = (directions.T @ (columns.T @ residuals)) ** 2 + quiet * np.maximum(own, 0.0)
    shares = np.append(0.0, _SHARES)[:, None]
    widened = 1.0 + shares**2 * np.maximum(own, 0.0)
    cost = np.sum(np.log(widened) - shares**2 * along / widened / variance_inflation, axis=1)
    return float(shares[cost <= cost.min() + deviations**2].max())


def _saving(columns: np.ndarray, residuals: np.ndarray) -> float:
    """Return the cost that columns (R, P) save of residuals (R,) by least squares [chi squared]."""
    scale = np.sqrt(np.sum(columns**2, axis=0))
    if not scale.max(initial=0.0):
        return 0.0
    unit = columns[:, scale > 0.0] / scale[scale > 0.0]
    score = unit.T @ residuals
    return float(score @ np.linalg.solve(unit.T @ unit + 1e-9 * np.eye(len(score)), score))


def _best_place(column: np.ndarray, residuals: np.ndarray, s: np.ndarray, kind: str, lap: float | None) -> float:
    """Return the cost that a column saves on the best stretch of the track, or as the best wave [chi squared]."""
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
