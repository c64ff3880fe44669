"""The objective: minus twice the log marginal likelihood of real recordings under named terms, up to a constant.

The baseline is the nominal model with the shared model discrepancy, whose weights the simulation taught. They are
integrated out (a marginalised baseline), or taken for what they are (a fixed baseline).
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.diagnosis.baseline.body import alters_body, moved_axles, moves_axles, with_cg_ahead
from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.baseline.tires import alters_tires
from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.innovations.autocovariance import LAG_ROWS, autocovariances, bartlett_sum
from split_cli.diagnosis.innovations.evidence import Evidence, integrated, weighted_rows
from split_cli.diagnosis.innovations.projection import damped
from split_cli.diagnosis.policy import STANDARD, Believing, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.series import Series, key_of_terms
from split_cli.diagnosis.recording.witnesses import is_integral
from split_cli.vehicle.effects import Term

_LEAST_INFORMED = 2e-3
#: States of terms of which rows and rates are kept while a fit moves other parameters [1]; the discrepancy's rates
#: are as long as the recording, and those without any term are kept for good.
_REMEMBERED = 64
#: Shifts of the CG in wheelbases between which the shared discrepancy runs in straight lines.
_SHIFTS = 0.02
#: Lists of terms whose rows are filtered together [1]; decides time and memory alone.
_FILTERED_AT_ONCE = 8
#: Length [s] of stretches over which rows count as one, for errors of sums. Judgement: longer than transients.
_BLOCK_SECONDS = 2.0


@dataclass(frozen=True)
class DiscrepancyPosterior:
    """What the simulation taught about the shared discrepancy: weights and their precision."""

    weights: np.ndarray  # (C,)
    precision: np.ndarray  # (C, C)


def learn_discrepancy(
    simulations: Sequence[Evidence], variance_inflation: float = 1.0, rules: Believing = STANDARD.believing
) -> DiscrepancyPosterior:
    """Learn the shared discrepancy from whitened simulations.

    Parameters
    ----------
    variance_inflation : float
        By which autocorrelation widens the noise.

    Notes
    -----
    Rows are believed as far as the dictionary holds them: their noise is the long-run variance of what it leaves,
    which is 1 for rows of unit noise, small for a simulation without any, but never 0, since no dictionary
    holds the physics of a real car, and larger where the dictionary misses what rows have in common, up to a
    bound beyond which nothing would be known.
    """
    columns = weighted_rows(simulations, [one.discrepancy for one in simulations])
    target = weighted_rows(simulations, [one.nominal_rows for one in simulations])
    normal, score = columns.T @ columns, columns.T @ target
    prior = np.eye(len(score))
    noise = variance_inflation
    for _ in range(2):
        weights = np.linalg.solve(prior + normal / noise, score / noise)
        left = (target - columns @ weights).reshape(-1, 3)
        long_run = _long_run_variance(left).max()
        noise = variance_inflation * float(np.clip(long_run, rules.least_noise, rules.most_noise))
    precision = prior + normal / noise
    return DiscrepancyPosterior(np.linalg.solve(precision, score / noise), precision)


def _long_run_variance(rows: np.ndarray) -> np.ndarray:
    """Return the Bartlett estimate of rows (G, 3) over a second, at least their variance, shape (3,)."""
    lags = max(min(LAG_ROWS, len(rows) // 4) - 1, 0)
    shared = bartlett_sum(autocovariances(rows, lags), LAG_ROWS)
    return np.mean(rows**2, axis=0) + np.maximum(shared, 0.0)


def alters_inputs(term: Term) -> bool:
    """Return whether a term changes what arrives of the commands, or what is measured."""
    return not term.exported or type(term).actuate is not Term.actuate


def alters_car(term: Term) -> bool:
    """Return whether a term changes the tyres or the body that the shared discrepancy's forces belong to."""
    return alters_tires(term) or alters_body(term)


@dataclass(frozen=True)
class MarginalLikelihood:
    """Costs of explanations on a choice of rows of the real recordings.

    The shared discrepancy's weights are integrated out: with r the weighted rows left by the terms and the
    simulation's weights, the cost is r^T (I + Phi H^-1 Phi^T)^-1 r = |r|^2 - |V^T r|^2.
    """

    evidence: tuple[Evidence, ...]
    posterior: DiscrepancyPosterior | None  # None where the nominal model is the simulation: nothing is common
    discrepancy: SharedDiscrepancy
    keep: tuple[np.ndarray, ...]  # rows used, of every recording
    offset: np.ndarray  # (R,): weighted rows of the shared discrepancy at the simulation's weights
    basis: np.ndarray  # (R, C): V; without columns when nothing is common
    block: np.ndarray  # (R,): block of time each entry lies in
    weight: np.ndarray  # (R,): root of each entry's robust weight
    root: np.ndarray  # (C,): M, diagonal in the directions of V, with (I - V M V^T)^2 = I - V V^T
    # Recordings against themselves; their rows come last in every stack. Sensors move them, and inclined roads
    # what accelerometers feel; no other physics does.
    kinematics: tuple[KinematicResiduals, ...] = ()
    # Cost that a flexible fit may save without a difference: what simulation shows against itself, see
    # `calibration`.
    unnamed_floor: float = 0.0
    term_floors: Mapping[str, float] = field(default_factory=dict)  # the same for terms
    # What each term saves between halves of the simulation, at as many rows.
    self_test_savings: Mapping[str, float] = field(default_factory=dict)
    witness_floors: Mapping[str, float] = field(default_factory=dict)  # the same of the witnesses' cost alone
    part_floors: Mapping[str, float] = field(default_factory=dict)  # the same in the best part of the drive
    form_error_inflation: float = 1.0  # by how much what no dictionary holds widens what a term saves by chance
    fixed_baseline: bool = False  # whether the simulation is a fixed baseline, see `with_fixed_baseline`
    policy: Policy = STANDARD
    # What was computed before: shifts and effect-to-noise ratios of the shared discrepancy, kinematic rows without
    # faulty sensors.
    memo: dict = field(default_factory=dict, repr=False, compare=False)

    def __getstate__(self) -> dict:
        # What is remembered is found by ids of objects, which another process gives to others.
        return {**self.__dict__, "memo": {}}

    def stack(self, rows: Sequence[np.ndarray]) -> np.ndarray:
        """Return the kept, weighted elements of rows (G, 3, ...) of all recordings, shape (R, ...)."""
        out, end = np.zeros((len(self.weight), *rows[0].shape[2:])), 0
        for part, keep in zip(rows, self.keep, strict=True):
            kept = (part if keep.all() else np.compress(keep, part, axis=0)).reshape(-1, *part.shape[2:])
            begin, end = end, end + len(kept)
            weight = self.weight[begin:end]
            np.multiply(kept, weight if kept.ndim == 1 else weight[:, None], out=out[begin:end])
        return out

    def with_fixed_baseline(self) -> MarginalLikelihood:
        """Return the objective with a fixed baseline: the shared discrepancy is what the simulation taught.

        What the simulation leaves open is much where no dictionary holds its physics. All that brings a recording
        back to where the simulation has been is open, too, and saves nothing. With a fixed baseline it saves what
        it brings back.
        """
        return replace(self, basis=np.zeros((len(self.weight), 0)), root=np.zeros(0), fixed_baseline=True)

    def with_residue_moved(self, terms: Sequence[Term]) -> MarginalLikelihood:
        """Return the objective of recordings whose late channels have their fast signal moved, too."""
        moved = [replace(one, series=one.series.with_residue_moved(terms)) for one in self.evidence]
        again = tuple(replace(one, nominal_rows=one.rows(())) for one in moved)
        return replace(self, evidence=again, memo={})

    def residual(self, terms: Sequence[Term]) -> np.ndarray:
        """Return what terms and the simulation's shared discrepancy leave, shape (R,)."""
        rows = self.stack([one.rows(terms, self.carried(one, terms)) for one in self.evidence]) - self.offset
        return self._with_witnesses(rows, terms)

    def _with_witnesses(self, rows: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Return rows (R,) with those of what a recording knows twice in their places, the last ones."""
        first = len(rows)
        for one in reversed(self.kinematics):
            rows[first - len(one.begin) : first] = self._kinematic_rows(one, terms)
            first -= len(one.begin)
        return rows

    def _kinematic_rows(self, one: KinematicResiduals, terms: Sequence[Term]) -> np.ndarray:
        """Return the rows of a witness, shape (W,); only terms that it feels can change them."""
        felt = [term for term in terms if one.is_changed_by(term)]
        return self._remembered(("kinematics", id(one)), felt, lambda: one.rows(felt))

    def _remembered(
        self, what: Hashable, terms: Sequence[Term], made: Callable[[], np.ndarray], *, for_good: bool = False
    ) -> np.ndarray:
        """Return what is made of terms, as it was made before for the same values of them."""
        known = self.memo.get(what)
        if known is None:
            known = self.memo.setdefault(what, RecentResults(sys.maxsize if for_good else _REMEMBERED))
        return known(key_of_terms(terms), made)

    def witness_rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return what a recording knows twice, terms corrected, shape (W,): the last rows of every stack."""
        rows = [self._kinematic_rows(one, terms) for one in self.kinematics]
        return np.concatenate([*rows, np.zeros(0)])

    def places(self) -> np.ndarray:
        """Return how far along the track each entry lies [m], shape (R,)."""
        pairs = zip(self.evidence, self.keep, strict=True)
        rows = [np.repeat(one.series.s[one.at][keep], 3) for one, keep in pairs]
        return np.concatenate([*rows, *(one.series.s[(one.begin + one.end) // 2] for one in self.kinematics)])

    def witnessed(self, terms: Sequence[Term], without: Sequence[Term] = ()) -> float:
        """Return how far terms move what a recording knows twice, in spreads of a window, where most [rms]."""
        moved = [self._kinematic_rows(one, terms) - self._kinematic_rows(one, without) for one in self.kinematics]
        return max((float(np.sqrt(np.mean(rows**2))) for rows in moved if len(rows)), default=0.0)

    def yaw_rows(self, terms: Sequence[Term]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return what yaw witnesses of each recording, means kept, terms corrected, (W,), and its blocks.

        A yaw that was integrated from the yaw rate is none.
        """
        out, first = [], len(self.block) - sum(len(one.begin) for one in self.kinematics)
        for one in self.kinematics:
            own = slice(first, first + len(one.begin))
            first = own.stop
            if one.kind == "yaw" and len(one.begin) and not self._is_integral(one.series):
                out.append((self._kinematic_rows(one, terms), self.block[own]))
        return out

    def _is_integral(self, series: Series) -> bool:
        """Return whether a yaw was integrated from the yaw rate, so that it denies nothing of it."""
        key = ("yaw is an integral", id(series))
        if key not in self.memo:
            self.memo[key] = is_integral(series, self.policy.abstention.greater_part)
        return self.memo[key]

    def of_witnesses(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (R, ...) of what a recording knows twice, less the mean of each witness.

        A bias of an accelerometer drifts, and a road that leans is one: only what varies tells an instrument.
        """
        sizes = [len(one.begin) for one in self.kinematics if len(one.begin)]  # a short manoeuvre may have none
        own = np.split(rows[len(rows) - sum(sizes) :], np.cumsum(sizes)[:-1]) if sizes else []
        return np.concatenate([one - one.mean(axis=0) for one in own]) if own else rows[:0]

    def witnesses_cost(self, residuals: np.ndarray) -> float:
        """Return which part of a cost is that of what a recording knows twice; `residuals` has shape (R,)."""
        own = self.of_witnesses(residuals)
        return float(own @ own)

    def shift(self, terms: Sequence[Term]) -> np.ndarray:
        """Return how the shared discrepancy's rows change where terms alter inputs or sensors, shape (R,).

        Zero unless one of them does.
        """
        altering = [term for term in terms if alters_inputs(term)] if self.posterior is not None else []
        altering = self._moving(altering)
        if not altering:
            return np.zeros(len(self.weight))
        others = [term for term in terms if alters_car(term)]
        moving = [term for term in others if moves_axles(self.discrepancy.vehicle, term)]

        def rows() -> np.ndarray:
            moved = []
            for one in self.evidence:
                here, there = (self._rates(one, [*some, *moving]) for some in ((), altering))
                rates = self.discrepancy.at_another_car(there - here, one.series, others)
                moved.append(one.whitener(integrated(one.series, rates)))
            return self.stack(moved)

        return self._remembered(("shift", bool(others)), [*altering, *others], rows, for_good=not others)

    def _rates(self, one: Evidence, altering: Sequence[Term]) -> np.ndarray:
        """Return the shared discrepancy's rates (N, 3) where terms alter inputs, sensors or the axles' slips."""
        return self._remembered(
            ("discrepancy rates", id(one)),
            altering,
            lambda: self.discrepancy.rates(one.series, self.posterior.weights, altering),
        )

    def carried(self, one: Evidence, terms: Sequence[Term]) -> np.ndarray | None:
        """Return how the discrepancy rates change where terms alter tyres or body, shape (N, 3), or nothing."""
        others = [term for term in terms if alters_car(term)]
        if self.posterior is None or not others:
            return None
        there = self._rates_at_axles(one, others)
        return self.discrepancy.at_another_car(there, one.series, others) - self._rates(one, ())

    def _rates_at_axles(self, one: Evidence, terms: Sequence[Term]) -> np.ndarray:
        """Return the shared discrepancy's rates (N, 3) at other slips, in straight lines between shifts of the CG.

        Slips are smooth in the shift; to evaluate all functions at each step of a fit would take a third of it.
        """
        vehicle = self.discrepancy.vehicle
        ahead = vehicle.cg_to_front_axle - moved_axles(vehicle, terms).cg_to_front_axle
        step = _SHIFTS * vehicle.wheelbase
        below, share = divmod(ahead / step, 1.0)

        def at(shift: float) -> np.ndarray:
            there = replace(self.discrepancy, vehicle=with_cg_ahead(vehicle, shift * step))
            return self._remembered(
                ("rates at axles", id(one), shift), (), lambda: there.rates(one.series, self.posterior.weights)
            )

        return at(below) if share < 1e-9 else (1.0 - share) * at(below) + share * at(below + 1.0)

    def left_by(self, terms: Sequence[Term]) -> np.ndarray:
        """Return what terms leave, the shared discrepancy moved along with the inputs they alter, shape (R,)."""
        return self.residual(terms) - self.shift(terms)

    def left_by_each(
        self, several: Sequence[Sequence[Term]], beside: Sequence[Term], here: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield `left_by` of lists of terms that differ little from one whose result `here`, (R,), is known.

        Their rows are filtered some at a time, and not at all where witnesses alone feel what differs.
        """
        known = key_of_terms(self._moving(beside))
        for begin in range(0, len(several), _FILTERED_AT_ONCE):
            some = several[begin : begin + _FILTERED_AT_ONCE]
            moved = [terms for terms in some if key_of_terms(self._moving(terms)) != known]
            carried = [[self.carried(one, terms) for terms in moved] for one in self.evidence]
            rows = [one.rows_of_each(moved, rates) for one, rates in zip(self.evidence, carried, strict=True)]
            columns = iter(range(len(moved)))
            for terms in some:
                if not any(terms is one for one in moved):
                    yield self._with_witnesses(here.copy(), terms)
                    continue
                k = next(columns)
                left = self.stack([one[:, :, k] for one in rows]) - self.offset
                yield self._with_witnesses(left, terms) - self.shift(terms)

    def _moving(self, terms: Sequence[Term]) -> list[Term]:
        """Return the terms without sensors' faults that leave the velocities as they are: witnesses feel those."""
        return [term for term in terms if any(one.series.is_moved_by(term) for one in self.evidence)]

    def whiten(self, rows: np.ndarray) -> np.ndarray:
        """Return residuals from which the still free part of the shared discrepancy is taken out, shape as given.

        Sums of squares of the result are costs: it applies a symmetric root of (I + Phi H^-1 Phi^T)^-1.
        """
        if not self.basis.shape[1]:
            return rows
        return damped(rows, self.basis, self.root)

    def cost(self, terms: Sequence[Term]) -> float:
        """Return an explanation's cost in units of chi squared, the shared discrepancy moved along."""
        residuals = self.whiten(self.left_by(terms))
        return float(residuals @ residuals)

    @property
    def shared_cost(self) -> float:
        """Cost that the shared discrepancy, at the simulation's weights, explains of the real recordings."""
        if "shared cost" not in self.memo:
            plain = self.stack([evidence.nominal_rows for evidence in self.evidence])
            self.memo["shared cost"] = max(float(plain @ plain - np.sum((plain - self.offset) ** 2)), 0.0)
        return self.memo["shared cost"]

    def block_sums(self, residuals: np.ndarray) -> np.ndarray:
        """Return sums over blocks of time, shape (B, ...)."""
        total = np.zeros((int(self.block.max()) + 1, *residuals.shape[1:]))
        np.add.at(total, self.block, residuals)
        return total


def build_objective(
    evidence: Sequence[Evidence],
    posterior: DiscrepancyPosterior | None,
    discrepancy: SharedDiscrepancy,
    keep: Sequence[np.ndarray],
    kinematics: Sequence[KinematicResiduals] = (),
    policy: Policy = STANDARD,
) -> MarginalLikelihood:
    """Set up the costs on the kept rows; blocks are stretches of time of a recording."""
    numbers, first = [], 0
    for one, mask in zip(evidence, keep, strict=True):
        number = (one.series.t[one.at] // _BLOCK_SECONDS).astype(np.int64)
        number = first + np.unique(number, return_inverse=True)[1]
        first = int(number.max(initial=first - 1)) + 1
        numbers.append(np.repeat(number[mask], 3))
    for one in kinematics:
        number = (one.series.t[one.begin] // _BLOCK_SECONDS).astype(np.int64)
        numbers.append(first + np.unique(number, return_inverse=True)[1])
        first = int(numbers[-1].max(initial=first - 1)) + 1
    block = np.unique(np.concatenate(numbers), return_inverse=True)[1]
    weights = [np.repeat(one.weight[mask], 3) for one, mask in zip(evidence, keep, strict=True)]
    weight = np.concatenate([*weights, *(np.ones(len(one.begin)) for one in kinematics)])
    objective = MarginalLikelihood(
        tuple(evidence),
        posterior,
        discrepancy,
        tuple(keep),
        offset=np.zeros(len(weight)),
        basis=np.zeros((len(weight), 0)),
        block=block,
        weight=weight,
        root=np.zeros(0),
        kinematics=tuple(kinematics),
        policy=policy,
    )
    if posterior is None:
        return objective
    columns = objective.stack([one.discrepancy for one in evidence])
    lower = np.linalg.cholesky(posterior.precision + columns.T @ columns)
    basis = solve_triangular(lower, columns.T, lower=True).T
    # With V^T V = U diag(d) U^T the root is U diag(1/(1 + sqrt(1 - d))) U^T; directions that reality says next to
    # nothing about change no cost and are left out.
    d, U = np.linalg.eigh(basis.T @ basis)
    informed = d > _LEAST_INFORMED
    root = 1.0 / (1.0 + np.sqrt(np.clip(1.0 - d[informed], 0.0, 1.0)))
    basis = np.ascontiguousarray(basis @ U[:, informed])
    return replace(objective, offset=columns @ posterior.weights, basis=basis, root=root)
