"""`Explorer`: what each further term would save beside an explanation, by linear estimates and fits of the best."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from split_cli.diagnosis.cache import RecentResults, release_memory
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.parallel import map_distributed_with, map_in_threads
from split_cli.diagnosis.policy import SelectionRules
from split_cli.diagnosis.recording.series import key_of_terms
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import (
    Fit,
    Part,
    Tangent,
    effect_everywhere,
    fit_parts,
    scan_places,
    sensitivity_of,
    tangent,
    without_parts,
)
from split_cli.diagnosis.search.form_error import forget_form_error, free_to_form_error, saved_beside_form_error
from split_cli.diagnosis.search.term_tests import contradicts_yaw
from split_cli.logs.drive import INPUT_CHANNELS
from split_cli.vehicle.effects import CATALOGUE


@dataclass(frozen=True)
class Explorer:
    """Fits of each candidate beside an explanation, with caches of linearised terms and of earlier results."""

    objective: MarginalLikelihood
    candidates: tuple[Candidate, ...]
    variance_inflation: float
    # Memory of cached residuals and sensitivities, the newest [bytes]. Older ones are computed again when needed, so
    # this affects memory and time, and results only within the accuracy of forward differences. Judgement: an eighth of
    # the gigabyte that a diagnosis may take.
    held: int = 2**27
    # Caches: explanations with the cost limit of the call and the fits beside each; tangents; refits without parts.
    _explored: list[tuple[Fit, float, list[Fit]]] = field(default_factory=list, init=False, repr=False, compare=False)
    _beside: RecentResults[list[Tangent]] = field(
        default_factory=lambda: RecentResults(1), init=False, repr=False, compare=False
    )
    _reduced: RecentResults[tuple[Fit, tuple[Fit, ...]]] = field(
        default_factory=lambda: RecentResults(1), init=False, repr=False, compare=False
    )

    @property
    def rules(self) -> SelectionRules:
        """The objective's rules of the selection."""
        return self.objective.policy.selection

    def price(self, fit: Fit) -> float:
        """Return a fit's cost over the variance inflation, plus the price of its parameters [chi squared].

        It is infinite where the fit states one delay of a command twice, see `repeats_a_delay`.
        """
        if repeats_a_delay([part.candidate.term for part in fit.parts]):
            return np.inf
        return fit.cost / self.variance_inflation + self.rules.price * fit.complexity

    def __call__(self, current: Fit, worth: float = np.inf) -> list[Fit]:
        """Return explanations with one further candidate, the last part, for those of least estimated cost, best first.

        Parameters
        ----------
        worth : float
            Estimated cost below which up to `full_fits` variants are fitted; above it only the first few
            (`considered`).
        """
        begun: dict[str, Fit] = {}
        for known, as_much, fits in self._explored:
            close = abs(known.cost - current.cost) < self.rules.tie * self.variance_inflation
            if close and _labels(known) == _labels(current):
                if as_much >= worth:
                    return fits
                begun |= {fit.parts[-1].candidate.label: fit for fit in fits}
        forget_form_error(self.objective)
        starts = self._starts(current, worth=worth)
        found = self._fits(current, {label: several for label, several in starts.items() if label not in begun})
        fits = _best_of_each(sorted([*begun.values(), *found], key=self.price))
        self._explored.append((current, worth, fits))
        self._forget_oldest()
        release_memory()
        return fits

    def without(self, nothing: Fit, fit: Fit) -> tuple[Fit, ...]:
        """Return `without_parts` of a fit, from the cache for the last fit."""
        made = self._reduced(id(fit), lambda: (fit, without_parts(self.objective, nothing, fit)))
        return made[1]

    def close(self) -> None:
        """Clear the caches of explanations at the end of a search; tangents stay."""
        self._explored.clear()
        self._reduced.clear()

    def _forget_oldest(self) -> None:
        """Drop explanations beyond the memory limit; fits still in use elsewhere lose their sensitivity."""
        held, seen, kept = 0, set(), 1
        for number, (current, _, fits) in enumerate(reversed(self._explored), start=1):
            for fit in {id(fit): fit for fit in (current, *fits)}.values():
                held += 0 if id(fit) in seen else fit.residuals.nbytes + fit.sensitivity.nbytes
                if held > self.held and id(fit) not in seen:
                    fit.forget()
                seen.add(id(fit))
            kept = number if held <= self.held else kept
        del self._explored[:-kept]

    def beyond_form_error(self, current: Fit) -> list[Fit]:
        """Return explanations with one further candidate, ordered by the saving beyond model-form error.

        Beside large terms, the candidates with the largest saving may be those that resemble their model-form error.
        """
        known = {fit.parts[-1].candidate.label: fit for fit in self(current)}
        starts = self._starts(current, free_to_form_error(self.objective, current))
        fits = [known[label] for label in starts if label in known]
        fits += _best_of_each(self._fits(current, {k: v for k, v in starts.items() if k not in known}))

        def worth(fit: Fit) -> float:
            saved = saved_beside_form_error(self.objective, current, fit) / self.variance_inflation
            return saved - self.rules.price * fit.parts[-1].candidate.complexity

        return sorted(fits, key=worth, reverse=True)

    @cached_property
    def _base(self) -> np.ndarray:
        return self.objective.residual(())

    @cached_property
    def _tangents(self) -> list[Tangent]:
        starts = [Part(one, dict(start)) for one in self.candidates for start in one.starts]
        return self._tangents_at(starts)

    def _tangents_at(self, parts: Sequence[Part]) -> list[Tangent]:
        base = self._base
        return map_in_threads(lambda part: tangent(self.objective, base, part), parts)

    @cached_property
    def _effects(self) -> list[tuple[Candidate, np.ndarray]]:
        return [(one, effect_everywhere(self.objective, self._base, one)) for one in self.candidates if not one.starts]

    def tangents_beside(self, current: Fit) -> list[Tangent]:
        """Return all further terms without a place, linearised at their starts.

        With a fixed baseline, terms that act on commands are linearised beside the sensor faults of the explanation.
        The discrepancy is then evaluated at corrected velocities, without which a late steering might show no saving.
        """
        beside, taken = current.terms, self.taken(current)
        further = [one for one in self._tangents if one.part.candidate.term not in taken]
        if not (self.objective.fixed_baseline and any(term.corrects for term in beside)):
            return further

        def made() -> list[Tangent]:
            left = self.objective.raw_residual(beside)

            def linear(one: Tangent) -> Tangent:
                acts = one.part.term.acts_on_commands()
                return tangent(self.objective, left, one.part, beside) if acts else one

            return map_in_threads(linear, further)

        return self._beside(key_of_terms(beside), made)

    def tangents(self) -> list[Tangent]:
        """Return all terms without a place, linearised at their starts without other terms."""
        return self._tangents

    def taken(self, current: Fit) -> set[str]:
        """Return the terms that have no place beside an explanation: its own, and delays that it states already."""
        own = [part.candidate.term for part in current.parts]
        return {*own, *(one.term for one in self.candidates if repeats_a_delay([*own, one.term]))}

    def estimated_costs(self, current: Fit, free: np.ndarray | None = None) -> list[tuple[float, Tangent]]:
        """Return the estimated cost with each start of each candidate, in order of cost with price.

        `free` is as of `Tangent.cost`.
        """
        sensitivity_of(self.objective, current)
        taken = self.taken(current)
        tangents = [*self.tangents_beside(current)]
        for candidate, effect in self._effects:
            if candidate.term not in taken:
                starts = scan_places(self.objective, current.residuals, candidate, effect)
                tangents += self._tangents_at([Part(candidate, start) for start in starts])
        estimates = map_in_threads(lambda one: (one.cost(current, free), one), tangents)
        return sorted(
            estimates,
            key=lambda one: one[0] / self.variance_inflation + self.rules.price * one[1].part.candidate.complexity,
        )

    def first_tangents(self, current: Fit) -> list[Tangent]:
        """Return every term that is not in the explanation, without a place, in its best variant, linearised."""
        sensitivity_of(self.objective, current)
        taken = self.taken(current)
        best: dict[str, tuple[float, Tangent]] = {}
        for estimated, linear in map_in_threads(lambda one: (one.cost(current), one), self._tangents):
            term = linear.part.candidate.term
            if term not in taken and (term not in best or estimated < best[term][0]):
                best[term] = estimated, linear
        return [linear for _, linear in best.values()]

    def _starts(
        self, current: Fit, free: np.ndarray | None = None, worth: float = np.inf
    ) -> dict[str, list[tuple[float, Tangent]]]:
        """Return the best starts by label of candidate, with estimated costs."""
        starts: dict[str, list[tuple[float, Tangent]]] = {}
        for estimated, linear in self.estimated_costs(current, free):
            label = linear.part.candidate.label
            most = self.rules.full_fits if estimated <= worth else self.rules.considered
            if label in starts or len(starts) < most:
                starts.setdefault(label, []).append((estimated, linear))
        return starts

    def _fits(self, current: Fit, starts: dict[str, list[tuple[float, Tangent]]]) -> list[Fit]:
        """Return fits of the starts, of two starts of a variant if the second one may be better, best first."""
        found = map_distributed_with(self.objective, _fitted, [(current, estimates) for estimates in starts.values()])
        fits = [fit for several in found for fit in several]
        return sorted((fit for fit in fits if self.is_possible(fit, len(fit.parts) - 1)), key=self.price)

    def is_possible(self, fit: Fit, k: int) -> bool:
        """Return whether part k of a fit is not a degenerate stretch or another term, and not denied by yaw."""
        return not (self.is_everywhere(fit.parts[k]) or contradicts_yaw(self.objective, fit, k))

    def is_everywhere(self, part: Part) -> bool:
        """Return whether a stretch covers nearly the whole track, or a term equals another one at its values."""
        if part.candidate.is_another(part.values):
            return True
        if "s_start" not in part.values:
            return False
        reach, most = part.candidate.ranges["s_end"].upper, self.objective.policy.reporting.everywhere
        return (part.values["s_end"] - part.values["s_start"]) % reach > most * reach


def repeats_a_delay(terms: Sequence[str]) -> bool:
    """Return whether terms, by id, state one delay of a command twice.

    Steering that acts late by one time and is logged late by another is late by their difference. So are the
    commands of torque and steering, each late by itself, and all other channels that are late: three delays of two
    commands.

    Notes
    -----
    A delay is a vector over the commands that it moves. Delays that are linearly dependent say one of them twice.
    """
    moved = [getattr(CATALOGUE[one], "late_inputs", ()) for one in terms]
    rows = np.array([[name in names for name in INPUT_CHANNELS] for names in moved if names], dtype=float)
    return len(rows) > 1 and bool(np.linalg.matrix_rank(rows) < len(rows))


def _fitted(objective: MarginalLikelihood, asked: tuple[Fit, list[tuple[float, Tangent]]]) -> list[Fit]:
    """Return fits of the starts of one variant beside an explanation."""
    current, estimates = asked
    fits: list[Fit] = []
    for estimated, linear in estimates:
        # A second start is fitted if it may be better than the first fit.
        if len(fits) < 2 and all(fit.cost >= estimated for fit in fits):
            parts = (*current.parts, linear.part)
            fits.append(fit_parts(objective, parts, slopes_of=current, tangents=(linear,)))
    return fits


def _best_of_each(fits: Sequence[Fit]) -> list[Fit]:
    """Return the first fit of each variant, in their order."""
    best: dict[str, Fit] = {}
    for fit in fits:
        best.setdefault(fit.parts[-1].candidate.label, fit)
    return list(best.values())


def nearest_start(candidate: Candidate, part: Part) -> dict[str, float]:
    """Return the start of a candidate whose first parameter is nearest to that of a part, by ratio."""
    size = max(abs(next(iter(part.values.values()))), 1e-9)
    return dict(min(candidate.starts, key=lambda one: abs(np.log(abs(next(iter(one.values()))) / size))))


def _labels(fit: Fit) -> list[str]:
    return sorted(part.candidate.label for part in fit.parts)
