"""`DiagnosisCase`: whitened recordings of one diagnosis, and what was learned from the simulation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from split_cli.diagnosis.baseline.discrepancy import SharedDiscrepancy, build_shared_discrepancy
from split_cli.diagnosis.innovations.comparable import comparable
from split_cli.diagnosis.innovations.evidence import Evidence, gather_evidence, rewhitened_with_noise
from split_cli.diagnosis.innovations.objective import DiscrepancyPosterior, learn_discrepancy
from split_cli.diagnosis.innovations.shared_terms import have_settled, shared_terms_of
from split_cli.diagnosis.parallel import map_in_threads
from split_cli.diagnosis.policy import STANDARD, Believing, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.recording.witnesses import Witness, build_witnesses, usual_weights_by_kind
from split_cli.vehicle.effects import Term
from split_cli.vehicle.parameters import Vehicle

_MOST_PASSES = 8
"""How often the shared terms are fitted at most [1]. Judgement: a relaxation length comes half of the rest nearer by
each pass, so that eight passes leave less than a hundredth."""
_SETTLED = 0.02
"""Change of a shared term by a pass below which no further one follows, as a share of the value [1]: judgement, a
fifth of the smallest interval that was found for any of them."""


@dataclass(frozen=True)
class DiagnosisCase:
    """Whitened recordings, the shared discrepancy with its posterior, and which rows are compared."""

    vehicle: Vehicle
    real: tuple[Evidence, ...]
    holdout: tuple[Evidence, ...]
    discrepancy: SharedDiscrepancy
    posterior: DiscrepancyPosterior | None  # None where the nominal model is the simulation
    # keep, keep_holdout: bool (G,): rows of each real and held-out recording that are compared.
    keep: tuple[np.ndarray, ...]
    # kinematics, simulated_kinematics: witnesses of the real and of the simulated recordings.
    kinematics: tuple[KinematicResiduals | Witness, ...]
    simulated_kinematics: tuple[KinematicResiduals | Witness, ...] = ()
    simulated: tuple[Evidence, ...] = ()
    keep_holdout: tuple[np.ndarray, ...] = ()
    # The simulated recordings, whitened with the noise and disturbance of the real ones.
    rewhitened: tuple[Evidence, ...] = ()
    # predicting, settling, explaining: of the real recordings, see `gather_evidence`.
    predicting: tuple[Term, ...] = ()
    settling: tuple[Term, ...] = ()
    explaining: tuple[Term, ...] = ()
    # (C,): weights with which the discrepancy is part of what predicts states and is linearised; None if nothing is
    # shared.
    weights: np.ndarray | None = None

    def compared(self, reach: float, policy: Policy = STANDARD) -> DiagnosisCase:
        """Return the case that compares real rows within the distance `reach` of a simulated one, see `comparable`."""
        keep, kept_out = (
            tuple(comparable(one, self.simulated, self.discrepancy, reach, policy) for one in several)
            for several in (self.real, self.holdout)
        )
        return replace(self, keep=keep, keep_holdout=kept_out)

    def visited(self, reach: float, policy: Policy = STANDARD) -> np.ndarray:
        """Return which rows of all simulations are within `reach` of a real one, bool, shape (M,)."""
        near = [comparable(one, self.real, self.discrepancy, reach, policy) for one in self.simulated]
        return np.concatenate([*near, np.zeros(0, dtype=bool)])

    def recorded_as(self, series: Sequence[Series], reach: float, policy: Policy = STANDARD) -> DiagnosisCase:
        """Return the case with other real recordings, whitened and compared in the same way, and the same witnesses."""
        real = self._gathered(series, policy.believing)
        keep = (comparable(one, self.simulated, self.discrepancy, reach, policy) for one in real)
        return replace(self, real=tuple(real), keep=tuple(keep))

    def whitened_about(self, terms: Sequence[Term], policy: Policy = STANDARD) -> DiagnosisCase:
        """Return the case whose real recordings are whitened about a model of these terms, see `gather_evidence`.

        Models are evaluated at predicted states, and a linearisation leads from there to the measured ones. A car that
        is damped in another way than the nominal model answers differently to the noise of these states. Predicted by
        the nominal model, and with that model linearised, a part of the noise looks like an effect. The same rows are
        compared as before.

        Disturbance and robust weights come from what the terms leave, and the simulation is whitened and learned again
        with this disturbance. Faults that correct channels are no part of the model; without other terms the case
        stays as it is.
        """
        found = tuple(term for term in terms if term.moves_car and not term.corrects)
        if not found:
            return self
        case = replace(self, predicting=(*self.discrepancy.shared_terms, *found), explaining=tuple(terms))
        real, holdout = (
            case._gathered([one.series for one in several], policy.believing) for several in (self.real, self.holdout)
        )
        case = replace(case, real=tuple(real), holdout=tuple(holdout))
        before, after = (_largest_disturbance(several) for several in (self.real, real))
        if not self.simulated or np.array_equal(before, after):
            return case
        rewhitened, posterior = _learned(case.simulated, real, case.discrepancy, policy)
        return replace(case, rewhitened=rewhitened, posterior=posterior)

    def _gathered(self, series: Sequence[Series], rules: Believing) -> list[Evidence]:
        """Whiten real recordings in the way of this case."""
        asked = self.discrepancy, self.simulated, rules, self.weights, self.predicting, self.settling, self.explaining
        return map_in_threads(lambda one: _gathered(self.vehicle, one, *asked), series)

    def judged_with_residue(self) -> DiagnosisCase:
        """Return the case whose late channels are shifted as a whole, for steps that fit no delay.

        See `Series.with_residue_moved`.
        """
        real, holdout = (
            tuple(replace(one, series=replace(one.series, residue_moves=True)) for one in several)
            for several in (self.real, self.holdout)
        )
        return replace(self, real=real, holdout=holdout)

    def discrepancy_rates(self, evidence: Evidence, terms: Sequence[Term] = ()) -> np.ndarray:
        """Return the rates of the shared discrepancy along a recording, beside a model with terms, shape (N, 3)."""
        if self.posterior is None:
            return np.zeros_like(evidence.series.measured)
        return self.discrepancy.rates(evidence.series, self.posterior.weights, terms)


def gather_case(vehicle: Vehicle, series: Sequence[Series], policy: Policy = STANDARD) -> DiagnosisCase:
    """Whiten every recording and learn the shared discrepancy from the simulated ones.

    Parameters
    ----------
    series : sequence of Series
        Of all roles: ``real``, ``sim`` and ``holdout``.
    """
    rules = policy.believing
    by_role = {role: [one for one in series if one.role == role] for role in ("real", "sim", "holdout")}
    discrepancy = build_shared_discrepancy(vehicle, (by_role["sim"] or by_role["real"])[0])

    def with_shared_terms(series: Sequence[Series]) -> tuple[SharedDiscrepancy, list[Evidence]]:
        """Return the discrepancy with `SHARED_TERMS` as these recordings show them, and their rows."""

        def whitened(discrepancy: SharedDiscrepancy) -> list[Evidence]:
            return map_in_threads(partial(gather_evidence, vehicle, discrepancy=discrepancy, rules=rules), series)

        found, evidence = discrepancy, whitened(discrepancy)
        # The terms decide where the models are evaluated, and how late forces follow deviations.
        for _ in range(_MOST_PASSES if series else 0):
            before = found.shared_terms
            found = replace(found, shared_terms=shared_terms_of(evidence, found))
            evidence = whitened(found)
            if have_settled(before, found.shared_terms, vehicle, _SETTLED):
                break
        return found, evidence

    discrepancy, simulated = with_shared_terms(by_role["sim"])
    # Without a simulation nothing is shared. What the car has itself then says which states follow from earlier ones.
    predicting = (discrepancy if simulated else with_shared_terms(by_role["real"])[0]).shared_terms
    weights = None
    if simulated:
        # What the simulation teaches is a part of the model that predicts states and is linearised.
        weights = learn_discrepancy(simulated, policy.comparison.variance_inflation, rules).weights
        again = partial(gather_evidence, vehicle, discrepancy=discrepancy, rules=rules, weights=weights)
        simulated = map_in_threads(again, by_role["sim"])
    asked = discrepancy, simulated, rules, weights, predicting
    real, holdout = (
        map_in_threads(lambda one: _gathered(vehicle, one, *asked), by_role[role]) for role in ("real", "holdout")
    )
    rewhitened, posterior = _learned(simulated, real, discrepancy, policy) if simulated else ((), None)
    theirs = [one for series in by_role["sim"] for one in build_witnesses(series, rules=rules)]
    usual_by_kind = usual_weights_by_kind(theirs)
    kinematics = [one for series in by_role["real"] for one in build_witnesses(series, usual_by_kind, rules)]
    if by_role["sim"]:
        # Without the same instrument in the simulation its usual error is not known.
        kinematics = [one for one in kinematics if one.kind in usual_by_kind]
    case = DiagnosisCase(
        vehicle,
        tuple(real),
        tuple(holdout),
        discrepancy,
        posterior,
        (),
        tuple(kinematics),
        tuple(theirs),
        tuple(simulated),
        rewhitened=rewhitened,
        predicting=tuple(predicting),
        settling=tuple(predicting),
        weights=weights,
    )
    return case.compared(policy.comparison.reach, policy)


def _learned(
    simulated: Sequence[Evidence], real: Sequence[Evidence], discrepancy: SharedDiscrepancy, policy: Policy
) -> tuple[tuple[Evidence, ...], DiscrepancyPosterior]:
    """Return the simulations whitened with noise and disturbance of reality, and the discrepancy that they show."""
    noise = np.median([one.series.stated_noise for one in real], axis=0)
    disturbance = _largest_disturbance(real)
    rewhitened = tuple(rewhitened_with_noise(one, noise, disturbance, discrepancy) for one in simulated)
    return rewhitened, learn_discrepancy(rewhitened, policy.comparison.variance_inflation, policy.believing)


def _largest_disturbance(several: Sequence[Evidence]) -> np.ndarray:
    return np.max([one.disturbance for one in several], axis=0)


def _gathered(
    vehicle: Vehicle,
    series: Series,
    discrepancy: SharedDiscrepancy,
    simulated: Sequence[Evidence],
    rules: Believing,
    weights: np.ndarray | None,
    predicting: Sequence[Term],
    settling: Sequence[Term] | None = None,
    explaining: Sequence[Term] = (),
) -> Evidence:
    """Whiten a real recording, with at least the disturbance of the simulated ones."""
    least = _largest_disturbance(simulated) if simulated else None
    own = gather_evidence(vehicle, series, discrepancy, least, rules, predicting, settling, explaining, weights)
    # Without a simulation nothing is shared.
    return own if simulated else replace(own, discrepancy=np.empty((*own.nominal_rows.shape, 0)))
