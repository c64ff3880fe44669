"""Fit named terms together by damped Gauss-Newton on whitened rows."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.parallel import map_distributed_with
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.vehicle.descent import Slopes, descend
from split_cli.vehicle.effects import Term

_ITERATIONS = 12
_JOINT_ITERATIONS = 6  # of all terms at once, to see which of them are needed
_LEAST_GAIN = 0.02  # of a step [chi squared], below which a fit ends
#: Share of a step's change of the residuals that derivatives may miss and still be followed to the next step.
#: Judgement: nine drives of development keep their verdicts, names and sizes to 0.01 standard errors with it.
#: Where a step gains nothing derivatives are computed anew, so it decides time and no result.
_BENT = 0.1
RIDGE = 1e-9  # of a column's length 1: keeps systems of columns that say the same solvable
_PLACES = 50  # into which a lap is cut to look for a stretch
#: What the best of all stretches saves of model-form error beyond any one [chi squared], 2 ln of their number.
SEARCHED_PLACES = 2.0 * np.log(_PLACES * (_PLACES - 1) / 2)


@dataclass(frozen=True)
class Part:
    """A candidate and the values it has: one term of an explanation."""

    candidate: Candidate
    values: dict[str, float]

    @property
    def term(self) -> Term:
        """The term with these values."""
        return self.candidate.build(self.values)

    @property
    def is_within_tolerance(self) -> bool:
        """Whether any sound recording may have these values: a bias of sensors that no witness tells from the car."""
        return self.candidate.is_within_tolerance(self.values)


@dataclass(frozen=True)
class Prior:
    """A normal prior of one parameter: mean and standard deviation, in its unit."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class Fit:
    """An explanation fitted on an objective's rows; frozen but for its sensitivity, which may be forgotten."""

    parts: tuple[Part, ...]
    cost: float  # in units of chi squared
    residuals: np.ndarray  # (R,): whitened residuals it leaves, the shared discrepancy taken out
    # (R, P): derivative of the residuals by each parameter, over the parts in order; without columns where it was
    # forgotten: see `sensitivity_of`.
    sensitivity: np.ndarray

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms."""
        return tuple(part.term for part in self.parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the terms, sorted."""
        return tuple(sorted(part.candidate.term for part in self.parts))

    @property
    def complexity(self) -> float:
        """Parameters effectively searched for."""
        return sum(part.candidate.complexity for part in self.parts)

    def forget(self) -> None:
        """Let go of the sensitivity, the greater part of what a fit holds; `sensitivity_of` works it out anew."""
        self._hold(np.empty((len(self.residuals), 0)))

    def _hold(self, sensitivity: np.ndarray) -> None:
        object.__setattr__(self, "sensitivity", sensitivity)


def sensitivity_of(objective: MarginalLikelihood, fit: Fit) -> np.ndarray:
    """Return a fit's sensitivity, shape (R, P), worked out anew by forward differences where it was forgotten."""
    if not fit.sensitivity.shape[1] and any(part.values for part in fit.parts):
        steps = [part.candidate.ranges[name].step for part in fit.parts for name in part.values]
        fit._hold(objective.whiten(raw_slopes(objective, fit.parts)) / np.array(steps))
    return fit.sensitivity


def fit_parts(
    objective: MarginalLikelihood, parts: Sequence[Part], *, known: Fit | None = None, lines: Sequence[Tangent] = ()
) -> Fit:
    """Refit all parameters of all parts together from where they are.

    Parameters
    ----------
    known : Fit, optional
        On the same objective; the derivatives of parts that it shares with these serve the first step.
    lines : sequence of Tangent
        Of others of the parts, for the same use.
    """
    parts = tuple(parts)
    # What a place does has corners at its ends: no step there tells what the next one will do.
    lines = () if any(part.candidate.located for part in parts) else lines
    return _fit(objective, parts, _ITERATIONS, known=known, lines=lines)


def refitted(objective: MarginalLikelihood, asked: tuple[Sequence[Part], Fit]) -> Fit:
    """Return `fit_parts` of parts beside what is known of them: a piece of work that may travel."""
    parts, known = asked
    return fit_parts(objective, parts, known=known)


def fits_without(objective: MarginalLikelihood, fit: Fit, numbers: Iterable[int]) -> list[Fit]:
    """Return an explanation refitted without each of some of its parts in turn."""
    fewer = [fit.parts[:k] + fit.parts[k + 1 :] for k in numbers]
    return map_distributed_with(objective, refitted, [(parts, fit) for parts in fewer])


def without_parts(objective: MarginalLikelihood, base: Fit, fit: Fit) -> tuple[Fit, ...]:
    """Return an explanation refitted without each of its parts; `base` is the one without any."""
    several = len(fit.parts) > 1
    return tuple(fits_without(objective, fit, range(len(fit.parts)))) if several else (base,) * len(fit.parts)


def fit_with_prior(
    objective: MarginalLikelihood, parts: Sequence[Part], priors: Sequence[Mapping[str, Prior]]
) -> tuple[Fit, np.ndarray]:
    """Refit all parameters together where priors hold what the rows do not tell: many terms that look alike.

    Parameters
    ----------
    priors : sequence of mapping of str to Prior
        For each part, by parameter; those without one are free.

    Returns
    -------
    Fit
        With the residuals' cost alone, its sensitivity forgotten.
    ndarray, shape (P, P)
        Half the curvature of the cost with the priors, in steps of the parameters.
    """
    parts = tuple(parts)
    means, roots = [], []
    for part, prior in zip(parts, priors, strict=True):
        for name in part.values:
            step = part.candidate.ranges[name].step
            means.append(prior[name].mean / step if name in prior else 0.0)
            roots.append(step / prior[name].deviation if name in prior else 0.0)
    pulls = np.array(means), np.array(roots) ** 2
    fit = _fit(objective, parts, _JOINT_ITERATIONS, pulls)
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    curvature = np.outer(steps, steps) * (fit.sensitivity.T @ fit.sensitivity) + np.diag(pulls[1])
    fit.forget()
    return fit, curvature


def _fit(
    objective: MarginalLikelihood,
    parts: tuple[Part, ...],
    iterations: int,
    pulls: tuple[np.ndarray, np.ndarray] | None = None,
    known: Fit | None = None,
    lines: Sequence[Tangent] = (),
) -> Fit:
    """Refit all parameters from where they are.

    `pulls` are the means and the precisions of priors, in steps of the parameters.

    Notes
    -----
    See `descend`; derivatives by forward differences. What one term does hardly depends on the others beside it,
    so the first step may use derivatives that another fit left. Each step tells how true they were, see
    `_followed`: only where residuals bend are they worked out anew.
    """
    names = [(k, name) for k, part in enumerate(parts) for name in part.values]
    limits = [parts[k].candidate.ranges[name] for k, name in names]
    steps = np.array([limit.step for limit in limits])
    lower = np.array([limit.lower for limit in limits]) / steps
    upper = np.array([limit.upper for limit in limits]) / steps
    x = np.clip(np.array([parts[k].values[name] for k, name in names]) / steps, lower, upper)

    terms_at = _terms_of(parts, steps)
    mean, precision = pulls if pulls is not None else (np.zeros(len(x)), np.zeros(len(x)))

    def evaluate(x: np.ndarray) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
        here = objective.left_by(terms_at(x))
        residuals = objective.whiten(here)
        return float(residuals @ residuals) + float(precision @ (x - mean) ** 2), (here, residuals)

    def slopes_of(jacobian: np.ndarray, x: np.ndarray, state: tuple, missed: float = 0.0) -> Slopes:
        slope = jacobian.T @ state[1] + precision * (x - mean)
        # Noise is no more like what derivatives miss than like anything else.
        beyond = max(float(state[1] @ state[1]) - len(state[1]), 1.0)
        return Slopes(jacobian, slope, jacobian.T @ jacobian + np.diag(precision), missed**2 * beyond)

    def linearise(x: np.ndarray, state: tuple, shared: Mapping[int, np.ndarray] = MappingProxyType({})) -> Slopes:
        here, _ = state
        if len(x) and not shared:
            return slopes_of(objective.whiten(_slopes(objective, terms_at, here, x, upper, range(len(x)))), x, state)
        jacobian = np.empty((len(here), len(x)))
        for p, column in shared.items():
            jacobian[:, p] = column
        own = [p for p in range(len(x)) if p not in shared]
        if own:
            jacobian[:, own] = objective.whiten(_slopes(objective, terms_at, here, x, upper, own))
        return slopes_of(jacobian, x, state)

    def follow(slopes: Slopes, before: tuple[np.ndarray, tuple], after: tuple[np.ndarray, tuple]) -> Slopes | None:
        jacobian, missed = _followed(slopes, after[0] - before[0], after[1][1] - before[1][1])
        return slopes_of(jacobian, *after, missed) if missed < _BENT else None

    first, placed = evaluate(x), any(part.candidate.located for part in parts)
    shared = _shared_slopes(parts, known, lines, steps)
    begun = linearise(x, first[1], shared) if shared else None
    if begun is not None and (lines or len(shared) < len(x)):
        begun = replace(begun, doubt=np.inf)  # no fit has ended with these yet
    found = descend(
        lambda at: first if at is x else evaluate(at),
        linearise,
        x,
        lower,
        upper,
        enough=lambda gained, _: gained < _LEAST_GAIN,
        iterations=iterations,
        known=begun,
        follow=None if pulls is not None or placed else follow,
    )
    residuals, jacobian = found.state[1], found.slopes.jacobian
    parts = _with(parts, names, found.parameters * steps)
    # In its place: of all terms at once it is the largest array of a search.
    return Fit(parts, float(residuals @ residuals), residuals, np.divide(jacobian, steps, out=jacobian))


def _followed(slopes: Slopes, step: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, float]:
    """Return derivatives after a step that changed the residuals, shape (R, P), and the share that lines missed.

    Broyden's (1965) update: the least that makes them tell the change, in units of what each parameter does.
    """
    missed = change - slopes.jacobian @ step
    along = np.diag(slopes.curvature) * step
    share = np.linalg.norm(missed) / (np.linalg.norm(change) + 1e-300)
    return slopes.jacobian + np.outer(missed, along / (along @ step)), float(share)


def raw_slopes(objective: MarginalLikelihood, parts: Sequence[Part]) -> np.ndarray:
    """Return derivatives of the residuals by each parameter's step, the discrepancy still in, shape (R, P)."""
    parts = tuple(parts)
    names = [(k, name) for k, part in enumerate(parts) for name in part.values]
    limits = [parts[k].candidate.ranges[name] for k, name in names]
    steps = np.array([limit.step for limit in limits])
    upper = np.array([limit.upper for limit in limits]) / steps
    x = np.array([parts[k].values[name] for k, name in names]) / steps
    terms_at = _terms_of(parts, steps)
    return _slopes(objective, terms_at, objective.left_by(terms_at(x)), x, upper, range(len(x)))


def _shared_slopes(
    parts: Sequence[Part], known: Fit | None, lines: Sequence[Tangent], steps: np.ndarray
) -> dict[int, np.ndarray]:
    """Return derivatives by steps that are known of parts, by the parameters' numbers, shape (R,) each."""
    of_lines = {id(line.part): line.slopes for line in lines}
    of_fit = {}
    for part in known.parts if known is not None and known.sensitivity.shape[1] else ():
        first = sum(slopes.shape[1] for slopes in of_fit.values())
        of_fit[id(part)] = known.sensitivity[:, first : first + len(part.values)]
    columns, number = {}, 0
    for part in parts:
        for i in range(len(part.values)):
            if id(part) in of_lines:
                columns[number] = of_lines[id(part)][:, i]
            elif id(part) in of_fit:
                columns[number] = of_fit[id(part)][:, i] * steps[number]
            number += 1
    return columns


def _slopes(
    objective: MarginalLikelihood,
    terms_at: Callable[[np.ndarray], list[Term]],
    here: np.ndarray,
    x: np.ndarray,
    upper: np.ndarray,
    own: Sequence[int],
) -> np.ndarray:
    """Return derivatives of what terms leave by `own` of x, shape (R, len(own)), by differences of one step.

    `here` is what they leave at x.
    """
    out, directions, moved = np.empty((len(here), len(own))), [], []
    for p in own:
        # Away from a bound; one step is small against what matters, large against rounding.
        directions.append(-1.0 if x[p] + 1.0 > upper[p] else 1.0)
        ahead = x.copy()
        ahead[p] += directions[-1]
        moved.append(terms_at(ahead))
    left = objective.left_by_each(moved, terms_at(x), here)
    for column, one, direction in zip(out.T, left, directions, strict=True):
        np.multiply(one - here, direction, out=column)
    return out


@dataclass(frozen=True)
class Tangent:
    """A part at a start and straight lines from there, on an objective's whitened rows.

    What one term does beside others is taken for what it does alone: good enough to see what promises most.
    """

    part: Part
    moved: np.ndarray  # (R,): what the part at its start does to the residuals
    slopes: np.ndarray  # (R, P): derivatives by its parameters, a step each

    def cost(self, current: Fit, free: np.ndarray | None = None) -> float:
        """Return the cost that one linear fit of this part and those of an explanation promises.

        What lies in `free`, shape (R, C), costs less or nothing: a square root of 1 less the rows' precision.
        """
        columns = of_length_one(np.hstack([self.slopes, current.sensitivity]))
        here = current.residuals + self.moved
        rows = np.column_stack([columns, here])
        products = rows.T @ rows
        if free is not None:
            seen = free.T @ rows
            products -= seen.T @ seen
        normal, score = products[:-1, :-1], products[:-1, -1]
        promised = score @ np.linalg.solve(normal + RIDGE * np.eye(len(score)), score)
        return float(products[-1, -1] - promised)


def of_length_one(columns: np.ndarray) -> np.ndarray:
    """Return columns (R, P) over their lengths; one that is nothing stays nothing."""
    scaled: np.ndarray = columns / (np.linalg.norm(columns, axis=0) + 1e-300)
    return scaled


def tangent(objective: MarginalLikelihood, base: np.ndarray, part: Part, beside: tuple[Term, ...] = ()) -> Tangent:
    """Return a part's lines at the values it has.

    Parameters
    ----------
    base : ndarray, shape (R,)
        What is left without it, by `MarginalLikelihood.left_by`.
    beside : tuple of Term
        Others that act.
    """
    steps = np.array([part.candidate.ranges[name].step for name in part.values])
    x, terms_at = np.array(list(part.values.values())) / steps, _terms_of((part,), steps)
    terms = [*beside, *terms_at(x)]
    here = objective.left_by(terms)
    moved = [[*beside, *terms_at(x + unit)] for unit in np.eye(len(x))]
    columns = [here - base, *(one - here for one in objective.left_by_each(moved, terms, here))]
    lines = objective.whiten(np.stack(columns, axis=1))
    return Tangent(part, np.ascontiguousarray(lines[:, 0]), np.ascontiguousarray(lines[:, 1:]))


def _terms_of(parts: Sequence[Part], steps: np.ndarray) -> Callable[[np.ndarray], list[Term]]:
    """Return what makes the terms of parts at values in steps (P,), over the parts in order; each made once."""
    known: list[dict[tuple[float, ...], Term]] = [{} for _ in parts]

    def terms_at(x: np.ndarray) -> list[Term]:
        out, left = [], iter((x * steps).tolist())
        for part, made in zip(parts, known, strict=True):
            own = dict(zip(part.values, left, strict=False))
            key = tuple(own.values())
            if key not in made:
                made[key] = part.candidate.build(own)
            out.append(made[key])
        return out

    return terms_at


def _with(parts: tuple[Part, ...], names: list[tuple[int, str]], values: np.ndarray) -> tuple[Part, ...]:
    new = [dict(part.values) for part in parts]
    for (k, name), value in zip(names, values, strict=True):
        new[k][name] = float(value)
    return tuple(Part(part.candidate, entry) for part, entry in zip(parts, new, strict=True))


def effect_everywhere(objective: MarginalLikelihood, base: np.ndarray, candidate: Candidate) -> np.ndarray:
    """Return what one unit of a candidate with a place takes off `base`, `objective.residual(())`, anywhere."""
    whole, size = candidate.everywhere()
    return (base - objective.residual((whole,))) / size


def scan_places(
    objective: MarginalLikelihood, residuals: np.ndarray, candidate: Candidate, effect: np.ndarray
) -> list[dict]:
    """Return starts for a candidate that acts on a stretch or as a wave, from scores place by place.

    Parameters
    ----------
    residuals : ndarray, shape (R,)
        Whitened residuals left by what is explained already.
    effect : ndarray, shape (R,)
        Of `effect_everywhere`.
    """
    amount, neutral = ("scale", 1.0) if candidate.located == "patch" else ("angle", 0.0)
    s = objective.places()
    reach = max(limit.upper for name, limit in candidate.ranges.items() if name in ("s_start", "s_end", "wavelength"))
    left = objective.whiten(residuals)
    closed = objective.evidence[0].series.lap_length is not None
    if candidate.located == "wave":
        return _scan_waves(left, effect, s, reach / 4.0, closed)
    bins = _PLACES
    place = np.minimum((s / reach * bins).astype(int), bins - 1)
    score = np.bincount(place, effect * left, minlength=bins)
    information = np.bincount(place, effect**2, minlength=bins)
    found = []
    for begin in range(bins):
        total_score = total_information = 0.0
        for length in range(1, bins):
            end = begin + length
            if end > bins and not closed:
                break
            index = (end - 1) % bins
            total_score += score[index]
            total_information += information[index]
            if total_information > 0.0:
                found.append((total_score**2 / total_information, begin, end, total_score / total_information))
    found.sort(reverse=True)
    starts = []
    for _, begin, end, gain in found:
        if all(abs(begin - b) + abs(end - e) > 3 for b, e, _ in starts):
            starts.append((begin, end, gain))
        if len(starts) == 2:
            break
    width = reach / bins
    return [
        {
            amount: neutral + gain,
            "s_start": begin * width,
            "s_end": (end * width) % reach if end > bins else end * width,
        }
        for begin, end, gain in starts
    ]


def _scan_waves(left: np.ndarray, effect: np.ndarray, s: np.ndarray, reach: float, closed: bool) -> list[dict]:
    waves = reach / np.arange(1, 13) if closed else reach * np.geomspace(2.0, 0.05, 24)
    found = []
    for wavelength in waves:
        angle = 2.0 * np.pi * s / wavelength
        pair = np.stack([effect * np.sin(angle), effect * np.cos(angle)], axis=1)
        normal = pair.T @ pair + 1e-9 * np.eye(2)
        a, b = np.linalg.solve(normal, pair.T @ left)
        found.append((float((pair.T @ left) @ [a, b]), wavelength, np.hypot(a, b), np.arctan2(b, a)))
    found.sort(reverse=True)
    return [
        {"amplitude": amplitude, "wavelength": wavelength, "phase": phase}
        for _, wavelength, amplitude, phase in found[:2]
    ]
