"""`MarginalLikelihood`: the cost of an explanation, minus twice its log marginal likelihood up to a constant.

An explanation is a list of terms with values. The baseline is the nominal model with the shared model discrepancy,
whose weights are learned from the simulation. They are integrated out with their posterior (a *marginalised* baseline),
or fixed at its mean (a *fixed* baseline). Rows of the witnesses are appended to those of the recordings.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.diagnosis.baseline.body import alters_body, moved_axles, moves_axles, with_cg_ahead
from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy
from split_cli.diagnosis.baseline.tires import AxleBalance, alters_tires, at_scaled_slips
from split_cli.diagnosis.cache import RecentResults
from split_cli.diagnosis.innovations.autocovariance import LAG_ROWS, autocovariances, bartlett_sum
from split_cli.diagnosis.innovations.evidence import Evidence, integrated, weighted_rows
from split_cli.diagnosis.innovations.projection import damped
from split_cli.diagnosis.policy import STANDARD, Believing, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.series import Series, key_of_terms
from split_cli.diagnosis.recording.witnesses import is_integral
from split_cli.vehicle.effects import Term

#: Share of a direction's prior variance that the real recordings remove, below which the direction is left out [1].
#: Judgement: it changes no cost.
_LEAST_INFORMED = 2e-3
#: Cached results of one kind, by values of terms [1]. Rates of the discrepancy are as long as the recording.
_REMEMBERED = 64
#: Step of CG shifts, in wheelbases, between which rates of the discrepancy are interpolated linearly [1].
_SHIFTS = 0.02
#: Lists of terms whose rows are filtered together [1]; affects time and memory alone.
_LISTS_AT_A_TIME = 8
#: Length of blocks of time for standard errors of sums [s]. Judgement: longer than transients.
_BLOCK_SECONDS = 2.0


@dataclass(frozen=True)
class DiscrepancyPosterior:
    """Posterior of the shared discrepancy's weights, learned from the simulation."""

    weights: np.ndarray  # (C,): mean
    precision: np.ndarray  # (C, C): inverse covariance


def learn_discrepancy(
    simulations: Sequence[Evidence], variance_inflation: float = 1.0, rules: Believing = STANDARD.believing
) -> DiscrepancyPosterior:
    """Learn the shared discrepancy from whitened simulations.

    Parameters
    ----------
    variance_inflation : float
        Factor by which autocorrelation widens the variance of the rows [1].

    Notes
    -----
    Bayesian linear regression with standard normal priors. The variance of the rows is the long-run variance of the
    residuals, estimated by iteration. It is 1 for rows of unit noise, and larger if the basis functions miss what rows
    have in common. It is small for a simulation without noise. The policy bounds it: no basis represents the physics of
    a real car exactly, and beyond the upper bound nothing would be learned.
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
    """Return the Bartlett estimate of the long-run variance of rows (G, 3) over 1 s, at least their variance, (3,)."""
    lags = max(min(LAG_ROWS, len(rows) // 4) - 1, 0)
    shared = bartlett_sum(autocovariances(rows, lags), LAG_ROWS)
    return np.mean(rows**2, axis=0) + np.maximum(shared, 0.0)


def alters_inputs(term: Term) -> bool:
    """Return whether a term changes the inputs behind the actuators, or what is measured."""
    return not term.exported or term.acts_on_commands()


def alters_car(term: Term) -> bool:
    """Return whether a term changes tyres or body, and so the shared discrepancy, see `at_another_car`."""
    return alters_tires(term) or alters_body(term)


@dataclass(frozen=True)
class MarginalLikelihood:
    """Cost of explanations on the compared rows of all real recordings, and on their witnesses.

    Notes
    -----
    The shared discrepancy's weights are integrated out. With r the weighted rows that the terms and the posterior mean
    leave, Phi the discrepancy's columns and H the precision, the cost is r^T (I + Phi H^-1 Phi^T)^-1 r = |r|^2 - |V^T
    r|^2. Its unit is that of chi squared. R counts the entries: three for each compared row, then one a window of the
    witnesses.
    """

    evidence: tuple[Evidence, ...]
    posterior: DiscrepancyPosterior | None  # None where the nominal model is the simulation, and nothing is shared
    discrepancy: SharedDiscrepancy
    keep: tuple[np.ndarray, ...]  # bool (G,): compared rows of each recording
    offset: np.ndarray  # (R,): weighted rows of the shared discrepancy at the posterior mean
    basis: np.ndarray  # (R, C): V; without columns when nothing is shared
    block: np.ndarray  # (R,): block of time each entry lies in
    weight: np.ndarray  # (R,): root of each entry's robust weight
    root: np.ndarray  # (C,): M, diagonal in the directions of V, with (I - V M V^T)^2 = I - V V^T
    # Witnesses, whose rows come last. Sensor faults change them, and road angles those of accelerations; other
    # physics does not.
    kinematics: tuple[KinematicResiduals, ...] = ()
    # Cost that a term may save without a difference, from the halves of the simulation, see `SelfTest`.
    term_floors: Mapping[str, float] = field(default_factory=dict)
    # Cost that each term saves between halves of the simulation, scaled to the number of rows here.
    self_test_savings: Mapping[str, float] = field(default_factory=dict)
    witness_floors: Mapping[str, float] = field(default_factory=dict)  # as `term_floors`, of the witnesses' cost alone
    part_floors: Mapping[str, float] = field(default_factory=dict)  # as `term_floors`, in the best part of the drive
    form_error_inflation: float = 1.0  # variance inflation factor of model-form error that no basis function represents
    # Model-form error of the shared discrepancy over its size [1], from the halves of the simulation.
    shared_error: float = STANDARD.selection.form_error_share
    about_explanation: bool = False  # whether rows are about an explanation, see `DiagnosisCase.whitened_about`
    fixed_baseline: bool = False  # whether the simulation is a fixed baseline, see `with_fixed_baseline`
    policy: Policy = STANDARD
    # Cache of rates and rows by values of terms, of effect-to-noise ratios and of profiles of delays.
    memo: dict = field(default_factory=dict, repr=False, compare=False)

    def __getstate__(self) -> dict:
        # Cache keys hold ids of objects, which are not unique across processes.
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
        """Return the objective with a fixed baseline: the discrepancy's weights are fixed at their posterior mean.

        If no basis represents the physics of the simulation, the weights stay uncertain where the simulation has not
        been. A fault that takes a recording there then saves no cost with a marginalised baseline.
        """
        return replace(self, basis=np.zeros((len(self.weight), 0)), root=np.zeros(0), fixed_baseline=True)

    def with_residue_moved(self, terms: Sequence[Term]) -> MarginalLikelihood:
        """Return the objective of recordings whose late channels are shifted as a whole, see `Series`."""
        moved = [replace(one, series=one.series.with_residue_moved(terms)) for one in self.evidence]
        again = tuple(replace(one, nominal_rows=one.rows(())) for one in moved)
        return replace(self, evidence=again, memo={})

    def residual(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the rows that terms leave, with the discrepancy at the recorded inputs, (R,), before `whiten`."""
        rows = self.stack([one.rows(terms, self.discrepancy_change(one, terms)) for one in self.evidence]) - self.offset
        return self._with_witnesses(rows, terms)

    def _with_witnesses(self, rows: np.ndarray, terms: Sequence[Term]) -> np.ndarray:
        """Return rows (R,) with those of the witnesses filled in, in place."""
        first = len(rows)
        for one in reversed(self.kinematics):
            rows[first - len(one.begin) : first] = self._kinematic_rows(one, terms)
            first -= len(one.begin)
        return rows

    def _kinematic_rows(self, one: KinematicResiduals, terms: Sequence[Term]) -> np.ndarray:
        """Return the rows of a witness, shape (W,), from the cache if no term that changes them has a new value."""
        felt = [term for term in terms if one.is_changed_by(term)]
        return self._remembered(("kinematics", id(one)), felt, lambda: one.rows(felt))

    def _remembered(
        self, what: Hashable, terms: Sequence[Term], made: Callable[[], np.ndarray], *, for_good: bool = False
    ) -> np.ndarray:
        """Return the result of `made` for terms, from the cache `what` if their values are known.

        `for_good` keeps all results, else the last `_REMEMBERED`.
        """
        known = self.memo.get(what)
        if known is None:
            known = self.memo.setdefault(what, RecentResults(sys.maxsize if for_good else _REMEMBERED))
        return known(key_of_terms(terms), made)

    def witness_rows(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the rows of all witnesses with terms corrected, shape (W,): the last entries of every stack."""
        rows = [self._kinematic_rows(one, terms) for one in self.kinematics]
        return np.concatenate([*rows, np.zeros(0)])

    def places(self) -> np.ndarray:
        """Return the track position of each entry [m], shape (R,)."""
        pairs = zip(self.evidence, self.keep, strict=True)
        rows = [np.repeat(one.series.s[one.at][keep], 3) for one, keep in pairs]
        return np.concatenate([*rows, *(one.series.s[(one.begin + one.end) // 2] for one in self.kinematics)])

    def witnessed(self, terms: Sequence[Term], without: Sequence[Term] = ()) -> float:
        """Return the rms change of rows that terms cause in the witness that they change most [1].

        The change is against `without`, in robust deviations of a window.
        """
        moved = [self._kinematic_rows(one, terms) - self._kinematic_rows(one, without) for one in self.kinematics]
        return max((float(np.sqrt(np.mean(rows**2))) for rows in moved if len(rows)), default=0.0)

    def yaw_rows(self, terms: Sequence[Term]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return rows of the yaw witness of each recording with terms corrected, (W,), and their blocks of time, (W,).

        Their means are kept. A yaw that was integrated from the yaw rate is left out, since it confirms nothing.
        """
        out, first = [], len(self.block) - sum(len(one.begin) for one in self.kinematics)
        for one in self.kinematics:
            own = slice(first, first + len(one.begin))
            first = own.stop
            if one.kind == "yaw" and len(one.begin) and not self._is_integral(one.series):
                out.append((self._kinematic_rows(one, terms), self.block[own]))
        return out

    def _is_integral(self, series: Series) -> bool:
        """Return whether the recorded yaw was integrated from the yaw rate, from the cache if known."""
        key = ("yaw is an integral", id(series))
        if key not in self.memo:
            self.memo[key] = is_integral(series, self.policy.abstention.greater_part)
        return self.memo[key]

    def of_witnesses(self, rows: np.ndarray) -> np.ndarray:
        """Return the rows of the witnesses among rows (R, ...), less the mean of each witness, shape (W, ...).

        A drifting bias or a banked road changes the mean, so that only the variation is evidence of a sensor fault.
        """
        sizes = [len(one.begin) for one in self.kinematics if len(one.begin)]  # a short manoeuvre may have none
        own = np.split(rows[len(rows) - sum(sizes) :], np.cumsum(sizes)[:-1]) if sizes else []
        return np.concatenate([one - one.mean(axis=0) for one in own]) if own else rows[:0]

    def witnesses_cost(self, residuals: np.ndarray) -> float:
        """Return the cost of the witnesses' rows alone, less their means, from residuals (R,)."""
        own = self.of_witnesses(residuals)
        return float(own @ own)

    def shift(self, terms: Sequence[Term]) -> np.ndarray:
        """Return how the shared discrepancy's rows change by terms that alter inputs or sensors, shape (R,).

        Zero if none of the terms does.
        """
        altering = self._altering(terms)
        if not altering:
            return np.zeros(len(self.weight))
        others = [term for term in terms if alters_car(term)]

        def rows() -> np.ndarray:
            moved = [(one, self._shifted_rates(one, altering, others)) for one in self.evidence]
            return self.stack([one.whitener(integrated(one.series, rates, one.linear)) for one, rates in moved])

        return self._remembered(("shift", bool(others)), [*altering, *others], rows, for_good=not others)

    def change_by(self, one: Evidence, terms: Sequence[Term]) -> np.ndarray:
        """Return how terms change the shared discrepancy's rates of a recording, shape (N, 3); zeros if none does."""
        change = self.discrepancy_change(one, terms)
        out = np.zeros((len(one.series.t), 3)) if change is None else change
        altering = self._altering(terms)
        if altering:
            out = out + self._shifted_rates(one, altering, [term for term in terms if alters_car(term)])
        return out

    def _altering(self, terms: Sequence[Term]) -> list[Term]:
        """Return the terms that alter inputs or sensors and so the shared discrepancy; none if nothing is shared."""
        return self._moving([term for term in terms if alters_inputs(term)]) if self.posterior is not None else []

    def _shifted_rates(self, one: Evidence, altering: Sequence[Term], others: Sequence[Term]) -> np.ndarray:
        """Return how `altering` change the shared discrepancy's rates of a car with `others`, shape (N, 3)."""
        moving = [term for term in others if moves_axles(self.discrepancy.vehicle, term)]
        here, there = (self._rates(one, [*some, *moving]) for some in ((), altering))
        return self.discrepancy.at_another_car(there - here, one.series, others)

    def _rates(self, one: Evidence, altering: Sequence[Term]) -> np.ndarray:
        """Return the discrepancy's rates (N, 3) at the inputs and slip angles that terms lead to; cached.

        Tyres and body are those of the vehicle.
        """
        return self._remembered(
            ("discrepancy rates", id(one)),
            altering,
            lambda: self.discrepancy.rates_of_own_car(one.series, self.posterior.weights, altering)[0],
        )

    def discrepancy_change(self, one: Evidence, terms: Sequence[Term]) -> np.ndarray | None:
        """Return how terms that alter tyres or body change the discrepancy's rates, shape (N, 3); None if none does.

        From the cache if their values are known.
        """
        others = [term for term in terms if alters_car(term)]
        if self.posterior is None or not others:
            return None

        def change() -> np.ndarray:
            similar = self.discrepancy.similarity(one.series, others)
            there = at_scaled_slips(
                lambda scale: self._rates_at_axles(one, others, scale),
                similar.slip,
                AxleBalance(moved_axles(self.discrepancy.vehicle, others), one.series.steer_angle),
            )
            return self.discrepancy.at_another_car(there, one.series, others, similar.peak) - self._rates(one, ())

        return self._remembered(("discrepancy change", id(one)), others, change)

    def _rates_at_axles(self, one: Evidence, terms: Sequence[Term], scale: float) -> np.ndarray:
        """Return the shared discrepancy's rates (N, 3) with a shifted CG, interpolated between steps of the shift.

        The rates are smooth in the shift. Evaluating them at each step of a fit would take a third of its time.

        Parameters
        ----------
        scale : float
            Factor of the slip angles of both axles [1].
        """
        vehicle = self.discrepancy.vehicle
        ahead = vehicle.cg_to_front_axle - moved_axles(vehicle, terms).cg_to_front_axle
        step = _SHIFTS * vehicle.wheelbase
        below, share = divmod(ahead / step, 1.0)
        slips = {} if scale == 1.0 else {1: scale, 2: scale}

        def at(shift: float) -> np.ndarray:
            there = replace(self.discrepancy, vehicle=with_cg_ahead(vehicle, shift * step))
            return self._remembered(
                ("rates at axles", id(one), shift, scale),
                (),
                lambda: there.rates_of_own_car(one.series, self.posterior.weights, (), slips)[0],
            )

        return at(below) if share < 1e-9 else (1.0 - share) * at(below) + share * at(below + 1.0)

    def raw_residual(self, terms: Sequence[Term]) -> np.ndarray:
        """Return the rows that terms leave, with the discrepancy at the inputs they alter, (R,), before `whiten`."""
        return self.residual(terms) - self.shift(terms)

    def raw_residuals_of_each(
        self, several: Sequence[Sequence[Term]], beside: Sequence[Term], here: np.ndarray
    ) -> Iterator[np.ndarray]:
        """Yield `raw_residual` of several lists of terms that differ in few values from the list `beside`.

        Parameters
        ----------
        here : ndarray, shape (R,)
            `raw_residual` of `beside`.

        Notes
        -----
        Several lists are filtered together. Lists that differ only in terms that change witnesses are not filtered.
        """
        known = key_of_terms(self._moving(beside))
        for begin in range(0, len(several), _LISTS_AT_A_TIME):
            some = several[begin : begin + _LISTS_AT_A_TIME]
            moved = [terms for terms in some if key_of_terms(self._moving(terms)) != known]
            carried = [[self.discrepancy_change(one, terms) for terms in moved] for one in self.evidence]
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
        """Return the terms that change the model or the velocities; others change witnesses alone."""
        return [term for term in terms if any(one.series.is_moved_by(term) for one in self.evidence)]

    def whiten(self, rows: np.ndarray) -> np.ndarray:
        """Return rows (R, ...) times a symmetric root of (I + Phi H^-1 Phi^T)^-1: sums of their squares are costs."""
        if not self.basis.shape[1]:
            return rows
        return damped(rows, self.basis, self.root)

    def cost(self, terms: Sequence[Term]) -> float:
        """Return the cost of terms with their values, in units of chi squared."""
        residuals = self.whiten(self.raw_residual(terms))
        return float(residuals @ residuals)

    @property
    def shared_cost(self) -> float:
        """Cost that the shared discrepancy at its posterior mean saves of the real recordings."""
        if "shared cost" not in self.memo:
            plain = self.stack([evidence.nominal_rows for evidence in self.evidence])
            self.memo["shared cost"] = max(float(plain @ plain - np.sum((plain - self.offset) ** 2)), 0.0)
        return self.memo["shared cost"]

    def block_sums(self, residuals: np.ndarray) -> np.ndarray:
        """Return the sums of entries (R, ...) over blocks of time of 2 s, shape (B, ...)."""
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
    """Return the objective on the kept rows of recordings and on their witnesses.

    Parameters
    ----------
    posterior : DiscrepancyPosterior or None
        None if nothing is shared with a simulation.
    keep : sequence of ndarray of bool, shape (G,)
        Rows of each recording that are compared.
    """
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
    # With V^T V = U diag(d) U^T the root is U diag(1/(1 + sqrt(1 - d))) U^T. Directions with next to no information
    # in the real recordings change no cost and are left out.
    d, U = np.linalg.eigh(basis.T @ basis)
    informed = d > _LEAST_INFORMED
    root = 1.0 / (1.0 + np.sqrt(np.clip(1.0 - d[informed], 0.0, 1.0)))
    basis = np.ascontiguousarray(basis @ U[:, informed])
    return replace(objective, offset=columns @ posterior.weights, basis=basis, root=root)
