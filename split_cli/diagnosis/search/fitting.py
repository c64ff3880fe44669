"""Joint fits of terms by damped Gauss-Newton on whitened rows (`Fit`), and linearised terms (`Tangent`)."""

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

_ITERATIONS = 12  # iterations of a fit at most [1]
_JOINT_ITERATIONS = 6  # iterations of a fit of all terms at once, which only shows which are needed [1]
# Gain of a step below which a fit ends [chi squared], times the variance of its residuals where these exceed noise.
# Judgement: a fiftieth of what one parameter saves by chance.
_LEAST_GAIN = 0.02
#: Error of the predicted change of the residuals, over that change, up to which derivatives are updated instead of
#: computed [1]. Judgement: nine drives of development keep verdicts, names and sizes to 0.01 standard errors.
#: Derivatives are computed whenever a step gains nothing, so this affects time and no result.
_MOST_UPDATE_ERROR = 0.1
RIDGE = 1e-9  # ridge on columns of length 1, so that systems with collinear columns can be solved [1]
_PLACES = 50  # parts of a lap in the search for a stretch [1]
#: Degrees of freedom that the choice among all stretches adds [1]: 2 ln of their number.
SEARCHED_PLACES = 2.0 * np.log(_PLACES * (_PLACES - 1) / 2)


@dataclass(frozen=True)
class Part:
    """One term of an explanation: a candidate with values of its parameters."""

    candidate: Candidate
    values: dict[str, float]

    @property
    def term(self) -> Term:
        """The term with these values."""
        return self.candidate.build(self.values)

    @property
    def is_within_tolerance(self) -> bool:
        """Whether these values are within the tolerance of sound sensors, so that the part is no finding."""
        return self.candidate.is_within_tolerance(self.values)


@dataclass(frozen=True)
class Prior:
    """Normal prior of one parameter: mean and standard deviation in its unit."""

    mean: float
    deviation: float


@dataclass(frozen=True)
class Fit:
    """An explanation fitted to an objective. It is immutable except for its sensitivity, which may be dropped."""

    parts: tuple[Part, ...]
    cost: float  # in units of chi squared
    residuals: np.ndarray  # (R,): residuals after `MarginalLikelihood.whiten`; the cost is the sum of their squares
    # (R, P): derivatives of the residuals with respect to the parameters, per unit, in the order of the parts; without
    # columns if it was dropped: see `sensitivity_of`.
    sensitivity: np.ndarray

    @property
    def terms(self) -> tuple[Term, ...]:
        """The terms of all parts, with their values."""
        return tuple(part.term for part in self.parts)

    @property
    def names(self) -> tuple[str, ...]:
        """Ids of the terms, sorted."""
        return tuple(sorted(part.candidate.term for part in self.parts))

    @property
    def complexity(self) -> float:
        """Number of parameters that the price counts."""
        return sum(part.candidate.complexity for part in self.parts)

    def forget(self) -> None:
        """Drop the sensitivity, the largest array of a fit; `sensitivity_of` computes it again."""
        self._hold(np.empty((len(self.residuals), 0)))

    def _hold(self, sensitivity: np.ndarray) -> None:
        object.__setattr__(self, "sensitivity", sensitivity)


def sensitivity_of(objective: MarginalLikelihood, fit: Fit) -> np.ndarray:
    """Return a fit's sensitivity, shape (R, P), computed by forward differences if it was dropped."""
    if not fit.sensitivity.shape[1] and any(part.values for part in fit.parts):
        steps = [part.candidate.ranges[name].step for part in fit.parts for name in part.values]
        fit._hold(objective.whiten(raw_slopes(objective, fit.parts)) / np.array(steps))
    return fit.sensitivity


def fit_parts(
    objective: MarginalLikelihood,
    parts: Sequence[Part],
    *,
    slopes_of: Fit | None = None,
    tangents: Sequence[Tangent] = (),
) -> Fit:
    """Return a joint fit of all parameters of parts, started at the parts' values.

    Parameters
    ----------
    slopes_of : Fit, optional
        A fit on the same objective. Its derivatives with respect to parts in common are used for the first step.
    tangents : sequence of Tangent
        Derivatives of further parts for the first step.
    """
    parts = tuple(parts)
    # The effect of a place is not differentiable at its ends, so that derivatives cannot be reused.
    tangents = () if any(part.candidate.located for part in parts) else tangents
    return _fit(objective, parts, _ITERATIONS, slopes_of=slopes_of, tangents=tangents)


def refitted(objective: MarginalLikelihood, asked: tuple[Sequence[Part], Fit]) -> Fit:
    """Return `fit_parts` of parts with the slopes of a fit, as a task for `map_distributed_with`."""
    parts, fit = asked
    return fit_parts(objective, parts, slopes_of=fit)


def fits_without(objective: MarginalLikelihood, fit: Fit, numbers: Iterable[int]) -> list[Fit]:
    """Return the fits without one part each, for parts by number."""
    fewer = [fit.parts[:k] + fit.parts[k + 1 :] for k in numbers]
    return map_distributed_with(objective, refitted, [(parts, fit) for parts in fewer])


def without_parts(objective: MarginalLikelihood, base: Fit, fit: Fit) -> tuple[Fit, ...]:
    """Return the fits without one part each, for all parts; `base` is the fit without any part."""
    several = len(fit.parts) > 1
    return tuple(fits_without(objective, fit, range(len(fit.parts)))) if several else (base,) * len(fit.parts)


def fit_with_prior(
    objective: MarginalLikelihood, parts: Sequence[Part], priors: Sequence[Mapping[str, Prior]]
) -> tuple[Fit, np.ndarray]:
    """Return a joint fit with normal priors, which many similar terms need, and its curvature.

    Parameters
    ----------
    priors : sequence of mapping of str to Prior
        For each part, by parameter; those without one are free.

    Returns
    -------
    Fit
        Its cost is that of the residuals alone; its sensitivity is dropped.
    ndarray, shape (P, P)
        Half the Hessian of the cost with the priors, per step of the parameters.
    """
    parts = tuple(parts)
    means, roots = [], []
    for part, prior in zip(parts, priors, strict=True):
        for name in part.values:
            step = part.candidate.ranges[name].step
            means.append(prior[name].mean / step if name in prior else 0.0)
            roots.append(step / prior[name].deviation if name in prior else 0.0)
    moments = np.array(means), np.array(roots) ** 2
    fit = _fit(objective, parts, _JOINT_ITERATIONS, moments)
    steps = np.array([part.candidate.ranges[name].step for part in fit.parts for name in part.values])
    curvature = np.outer(steps, steps) * (fit.sensitivity.T @ fit.sensitivity) + np.diag(moments[1])
    fit.forget()
    return fit, curvature


def _fit(
    objective: MarginalLikelihood,
    parts: tuple[Part, ...],
    iterations: int,
    moments: tuple[np.ndarray, np.ndarray] | None = None,
    slopes_of: Fit | None = None,
    tangents: Sequence[Tangent] = (),
) -> Fit:
    """Return a joint fit by at most so many iterations.

    `moments` are means and precisions of normal priors, in steps of the parameters.

    Notes
    -----
    Damped Gauss-Newton, see `descend`, with derivatives by forward differences. The effect of a term hardly depends on
    the others, so that the first step may use derivatives of another fit. Each step shows how accurate they are; then
    they are updated (`_broyden_update`), or computed again if the residuals are too nonlinear.
    """
    names = [(k, name) for k, part in enumerate(parts) for name in part.values]
    limits = [parts[k].candidate.ranges[name] for k, name in names]
    steps = np.array([limit.step for limit in limits])
    lower = np.array([limit.lower for limit in limits]) / steps
    upper = np.array([limit.upper for limit in limits]) / steps
    x = np.clip(np.array([parts[k].values[name] for k, name in names]) / steps, lower, upper)

    terms_at = _terms_of(parts, steps)
    mean, precision = moments if moments is not None else (np.zeros(len(x)), np.zeros(len(x)))

    def evaluate(x: np.ndarray) -> tuple[float, tuple[np.ndarray, np.ndarray]]:
        here = objective.raw_residual(terms_at(x))
        residuals = objective.whiten(here)
        return float(residuals @ residuals) + float(precision @ (x - mean) ** 2), (here, residuals)

    def slopes_at(jacobian: np.ndarray, x: np.ndarray, state: tuple, missed: float = 0.0) -> Slopes:
        slope = jacobian.T @ state[1] + precision * (x - mean)
        # The error of derivatives is projected on the part of the residuals that is more than noise.
        beyond = max(float(state[1] @ state[1]) - len(state[1]), 1.0)
        return Slopes(jacobian, slope, jacobian.T @ jacobian + np.diag(precision), missed**2 * beyond)

    def linearise(x: np.ndarray, state: tuple, shared: Mapping[int, np.ndarray] = MappingProxyType({})) -> Slopes:
        here, _ = state
        if len(x) and not shared:
            return slopes_at(objective.whiten(_slopes(objective, terms_at, here, x, upper, range(len(x)))), x, state)
        jacobian = np.empty((len(here), len(x)))
        for p, column in shared.items():
            jacobian[:, p] = column
        own = [p for p in range(len(x)) if p not in shared]
        if own:
            jacobian[:, own] = objective.whiten(_slopes(objective, terms_at, here, x, upper, own))
        return slopes_at(jacobian, x, state)

    def update(slopes: Slopes, before: tuple[np.ndarray, tuple], after: tuple[np.ndarray, tuple]) -> Slopes | None:
        jacobian, missed = _broyden_update(slopes, after[0] - before[0], after[1][1] - before[1][1])
        return slopes_at(jacobian, *after, missed) if missed < _MOST_UPDATE_ERROR else None

    first, placed = evaluate(x), any(part.candidate.located for part in parts)
    shared = _shared_slopes(parts, slopes_of, tangents, steps)
    begun = linearise(x, first[1], shared) if shared else None
    if begun is not None and (tangents or len(shared) < len(x)):
        begun = replace(begun, missed=np.inf)  # a fit must not end with derivatives of another one
    found = descend(
        lambda at: first if at is x else evaluate(at),
        linearise,
        x,
        lower,
        upper,
        enough=lambda gained, cost: gained < _LEAST_GAIN * max(1.0, cost / len(first[1][1])),
        iterations=iterations,
        first=begun,
        update=None if moments is not None or placed else update,
    )
    residuals, jacobian = found.state[1], found.slopes.jacobian
    parts = _with(parts, names, found.parameters * steps)
    # Divided in place: with all terms at once this is the largest array of a search.
    return Fit(parts, float(residuals @ residuals), residuals, np.divide(jacobian, steps, out=jacobian))


def _broyden_update(slopes: Slopes, step: np.ndarray, change: np.ndarray) -> tuple[np.ndarray, float]:
    """Return updated derivatives after a step, shape (R, P), and the relative error of the old ones [1].

    Broyden's (1965) update: the smallest change with which they predict the change of the residuals, with parameters
    scaled by their effect.
    """
    missed = change - slopes.jacobian @ step
    along = np.diag(slopes.curvature) * step
    share = np.linalg.norm(missed) / (np.linalg.norm(change) + 1e-300)
    return slopes.jacobian + np.outer(missed, along / (along @ step)), float(share)


def raw_slopes(objective: MarginalLikelihood, parts: Sequence[Part]) -> np.ndarray:
    """Return derivatives of `raw_residual` per step of each parameter, before `whiten`, shape (R, P)."""
    parts = tuple(parts)
    names = [(k, name) for k, part in enumerate(parts) for name in part.values]
    limits = [parts[k].candidate.ranges[name] for k, name in names]
    steps = np.array([limit.step for limit in limits])
    upper = np.array([limit.upper for limit in limits]) / steps
    x = np.array([parts[k].values[name] for k, name in names]) / steps
    terms_at = _terms_of(parts, steps)
    return _slopes(objective, terms_at, objective.raw_residual(terms_at(x)), x, upper, range(len(x)))


def _shared_slopes(
    parts: Sequence[Part], fit: Fit | None, tangents: Sequence[Tangent], steps: np.ndarray
) -> dict[int, np.ndarray]:
    """Return known derivatives per step, shape (R,) each, by the number of the parameter."""
    of_tangents = {id(linear.part): linear.slopes for linear in tangents}
    of_fit = {}
    for part in fit.parts if fit is not None and fit.sensitivity.shape[1] else ():
        first = sum(slopes.shape[1] for slopes in of_fit.values())
        of_fit[id(part)] = fit.sensitivity[:, first : first + len(part.values)]
    columns, number = {}, 0
    for part in parts:
        for i in range(len(part.values)):
            if id(part) in of_tangents:
                columns[number] = of_tangents[id(part)][:, i]
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
    """Return derivatives of `raw_residual` with respect to the entries `own` of x, in steps, shape (R, len(own)).

    `here` is `raw_residual` at x.
    """
    out, directions, moved = np.empty((len(here), len(own))), [], []
    for p in own:
        # Away from a bound. A step is small compared with relevant changes, and large compared with rounding.
        directions.append(-1.0 if x[p] + 1.0 > upper[p] else 1.0)
        ahead = x.copy()
        ahead[p] += directions[-1]
        moved.append(terms_at(ahead))
    left = objective.raw_residuals_of_each(moved, terms_at(x), here)
    for column, one, direction in zip(out.T, left, directions, strict=True):
        np.multiply(one - here, direction, out=column)
    return out


@dataclass(frozen=True)
class Tangent:
    """A part linearised about its values, on an objective's whitened rows.

    Its effect beside other terms is taken to be that without them, which is accurate enough to rank candidates.
    """

    part: Part
    moved: np.ndarray  # (R,): change of the residuals by the part at its values
    slopes: np.ndarray  # (R, P): derivatives of the residuals per step of its parameters

    def cost(self, current: Fit, free: np.ndarray | None = None) -> float:
        """Return the cost of an explanation with this part, by one linear least-squares fit [chi squared].

        Parameters
        ----------
        free : ndarray, shape (R, C), optional
            N as of `free_to_form_error`: residuals along its columns count less.
        """
        columns = of_length_one(np.hstack([self.slopes, current.sensitivity]))
        here = current.residuals + self.moved
        rows = np.column_stack([columns, here])
        products = rows.T @ rows
        if free is not None:
            seen = free.T @ rows
            products -= seen.T @ seen
        normal, score = products[:-1, :-1], products[:-1, -1]
        estimated = score @ np.linalg.solve(normal + RIDGE * np.eye(len(score)), score)
        return float(products[-1, -1] - estimated)


def of_length_one(columns: np.ndarray) -> np.ndarray:
    """Return columns (R, P) over their lengths; a zero column stays zero."""
    scaled: np.ndarray = columns / (np.linalg.norm(columns, axis=0) + 1e-300)
    return scaled


def tangent(objective: MarginalLikelihood, base: np.ndarray, part: Part, beside: tuple[Term, ...] = ()) -> Tangent:
    """Return a part linearised about its values.

    Parameters
    ----------
    base : ndarray, shape (R,)
        `MarginalLikelihood.raw_residual` of the other terms.
    beside : tuple of Term
        The other terms.
    """
    steps = np.array([part.candidate.ranges[name].step for name in part.values])
    x, terms_at = np.array(list(part.values.values())) / steps, _terms_of((part,), steps)
    terms = [*beside, *terms_at(x)]
    here = objective.raw_residual(terms)
    moved = [[*beside, *terms_at(x + unit)] for unit in np.eye(len(x))]
    columns = [here - base, *(one - here for one in objective.raw_residuals_of_each(moved, terms, here))]
    rows = objective.whiten(np.stack(columns, axis=1))
    return Tangent(part, np.ascontiguousarray(rows[:, 0]), np.ascontiguousarray(rows[:, 1:]))


def _terms_of(parts: Sequence[Part], steps: np.ndarray) -> Callable[[np.ndarray], list[Term]]:
    """Return a function from values in steps, shape (P,), to the terms of parts; equal terms are built once."""
    built: list[dict[tuple[float, ...], Term]] = [{} for _ in parts]

    def terms_at(x: np.ndarray) -> list[Term]:
        out, left = [], iter((x * steps).tolist())
        for part, made in zip(parts, built, strict=True):
            own = dict(zip(part.values, left, strict=False))
            key = tuple(own.values())
            if key not in made:
                made[key] = part.candidate.build(own)
            out.append(made[key])
        return out

    return terms_at


def _with(parts: tuple[Part, ...], names: list[tuple[int, str]], values: np.ndarray) -> tuple[Part, ...]:
    """Return parts with other values, given by part number and parameter name."""
    new = [dict(part.values) for part in parts]
    for (k, name), value in zip(names, values, strict=True):
        new[k][name] = float(value)
    return tuple(Part(part.candidate, entry) for part, entry in zip(parts, new, strict=True))


def effect_everywhere(objective: MarginalLikelihood, base: np.ndarray, candidate: Candidate) -> np.ndarray:
    """Return the change of residuals, shape (R,), by a unit of a located candidate that acts all along the track."""
    whole, size = candidate.everywhere()
    return (base - objective.residual((whole,))) / size


def scan_places(
    objective: MarginalLikelihood, residuals: np.ndarray, candidate: Candidate, effect: np.ndarray
) -> list[dict]:
    """Return starts for a candidate that acts on a stretch or as a wave, from scores place by place.

    Parameters
    ----------
    residuals : ndarray, shape (R,)
        Whitened residuals of the explanation so far.
    effect : ndarray, shape (R,)
        `effect_everywhere` of the candidate.
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
