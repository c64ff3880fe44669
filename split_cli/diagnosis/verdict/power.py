"""Power of a match: effects that these drives could not have shown, at a large size or at any size of a real car."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.policy import Policy
from split_cli.diagnosis.recording.series import extended_model
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.term_tests import effect_to_noise_of_terms
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.statement.wording import number, percent, term_name
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import Vehicle

_MOST_UNSEEN = (
    "No difference was found, but most effects would not have been named at any size that a real car can have. "
    "Drive longer and with more excitation{calibrate}."
)
_MUCH_FORM_ERROR = (
    "small effects: halves of the simulation differ by far more than noise, and smaller effects are not "
    "identified; drive both more alike{calibrate}"
)
_PREDICTED_SECONDS = 2.0  # the longest horizon of the report [s]


@dataclass(frozen=True)
class HiddenEffect:
    """A large effect that would not have been seen on these drives."""

    term: str
    parameter: str
    value: float  # half way to the end of a real car's range
    share: float  # its share of the forces on these drives, see `force_share` [1]

    @property
    def words(self) -> str:
        """The term with its value."""
        unit = CATALOGUE[self.term].parameter_units()[self.parameter]
        return (
            f"{term_name(self.term)} with {self.parameter} = {number(self.value, 2)}{'' if unit == '1' else f' {unit}'}"
        )


def hidden_effects(
    objective: MarginalLikelihood,
    candidates: Sequence[Candidate],
    gap_to_noise: float,
    detectable: Sequence[Detectable] = (),
) -> tuple[HiddenEffect, ...]:
    """Return large effects that would not have been seen, the largest of each term, in order of their share of forces.

    Parameters
    ----------
    candidates : sequence of Candidate
        Identifiable effects.
    gap_to_noise : float
        Effect-to-noise ratio of all that differs between simulation and reality.
    detectable : sequence of Detectable
        Detection limits.

    Notes
    -----
    Simulation and reality may differ by no more than the halves of the simulation, and yet by as much as a large
    effect. An effect is large at half of a car's range. It counts if it is larger than the noise, no larger than the
    gap, and below its detection limit.
    """
    smallest = {one.term: one.parameters for one in detectable}
    least, found = objective.policy.selection.above_noise, {}
    if gap_to_noise <= least:
        return ()
    for one in candidates:
        for name, value, values in _big(one, objective.policy.abstention.greater_part):
            if _would_be_named(one, name, value, smallest.get(one.term, {})):
                continue
            term = one.build(values)
            if least < effect_to_noise_of_terms(objective, (term,)) <= gap_to_noise:
                hidden = HiddenEffect(one.term, name, value, force_share(objective, term))
                if one.term not in found or found[one.term].share < hidden.share:
                    found[one.term] = hidden
    return tuple(sorted(found.values(), key=lambda hidden: -hidden.share))


def or_calibrate(vehicle: Vehicle) -> str:
    """Return the advice to calibrate the vehicle file as an alternative; empty if that has been done."""
    return "" if vehicle.has_calibrated_tires else ", or calibrate the vehicle file (split calibrate)"


def most_unseen_in_words(vehicle: Vehicle) -> str:
    """Return that a match would say nothing, as sentences."""
    return _MOST_UNSEEN.format(calibrate=or_calibrate(vehicle))


def much_form_error_in_words(vehicle: Vehicle) -> str:
    """Return that small effects were not judged because halves of the simulation differ, as an item of a list."""
    return _MUCH_FORM_ERROR.format(calibrate=or_calibrate(vehicle))


def no_match_in_words(hidden: HiddenEffect, gap_to_noise: float, vehicle: Vehicle) -> str:
    """Return why the verdict is not ``match``, as sentences."""
    return (
        f"Simulation and reality differ by {number(gap_to_noise, 2)} times sensor noise over 0.05 s, and so do "
        f"halves of the simulation. A {hidden.words} would not be visible in that, and it changes "
        f"{percent(hidden.share)} of the forces on these drives. Drive both alike and longer{or_calibrate(vehicle)}."
    )


def hidden_in_words(hidden: Sequence[HiddenEffect]) -> str:
    """Return the effects that a match does not rule out, as a sentence; empty if there are none."""
    if not hidden:
        return ""
    listed = "; ".join(f"{one.words} ({percent(one.share)})" for one in hidden)
    return (
        "Effects that these drives could not have shown, each with its share of the forces over "
        f"{_PREDICTED_SECONDS:g} s: {listed}."
    )


def unseen_in_words(detectable: Sequence[Detectable]) -> str:
    """Return the effects that would not have been seen at any size of a real car, as a sentence; empty if none."""
    names = [term_name(one.term) for one in detectable if not one.parameters]
    within = "These effects would not have been detected at any size that a real car can have"
    return f"{within}: {', '.join(names)}." if names else ""


def is_blind(detectable: Sequence[Detectable], policy: Policy) -> bool:
    """Return whether most effects would not have been named at any size that a real car can have."""
    unseen = sum(not one.parameters for one in detectable)
    return unseen > policy.abstention.greater_part * len(detectable)


def force_share(objective: MarginalLikelihood, term: Term) -> float:
    """Return the largest share by which a term changes the longitudinal, front or rear lateral force [1].

    Notes
    -----
    The forces that a term adds are averaged over 2 s, since a prediction integrates them and short delays cancel. Their
    rms over the compared rows is divided by that of the forces of the recorded motion. These count as at least a tenth
    of the largest of the three: at constant speed the longitudinal force is small, and a small change would look large.
    """
    added, taken = [], []
    for one, keep in zip(objective.evidence, objective.keep, strict=True):
        series, inside = one.series, one.series.inside()
        at = one.at[keep]
        at = at[inside[np.minimum(at, len(inside) - 1)] & inside[at - 1]]  # no motion is known across a gap
        inverse = np.linalg.inv(one.vehicle.force_matrix()).T
        rates = series.rates(extended_model(one.vehicle, (term,))) - series.rates(extended_model(one.vehicle))
        v_x, v_y, r = series.smooth.T
        change = np.gradient(series.smooth, series.period, axis=0)
        motion = change - np.stack([v_y * r, -v_x * r, np.zeros(len(r))], axis=1)
        added.append(_averaged(rates @ inverse, series.period)[at])
        taken.append((motion @ inverse)[at])
    of_term, of_motion = (np.sqrt(np.mean(np.concatenate(rows) ** 2, axis=0)) for rows in (added, taken))
    return float(np.max(of_term / np.maximum(of_motion, 0.1 * of_motion.max() + 1e-12)))


def _averaged(rows: np.ndarray, period: float) -> np.ndarray:
    """Return moving means of rows (N, 3) over 2 s, or over all rows if these are fewer."""
    width = min(max(1, int(round(_PREDICTED_SECONDS / period))), len(rows))
    total = np.concatenate([np.zeros((1, rows.shape[1])), np.cumsum(rows, axis=0)])
    low = np.clip(np.arange(len(rows)) - width // 2, 0, len(rows) - width)
    return (total[low + width] - total[low]) / width


def _would_be_named(one: Candidate, name: str, value: float, smallest: Mapping[str, tuple[float | None, str]]) -> bool:
    """Return whether a value of a term's parameter is at or beyond its detection limit."""
    neutral, (least, _) = CATALOGUE[one.term].neutral[name], smallest.get(name, (None, ""))
    return least is not None and abs(least - neutral) <= abs(value - neutral)


def _big(one: Candidate, share: float) -> list[tuple[str, float, dict[str, float]]]:
    """Return, for each parameter of a term of the car, its name, a large value, and all values with it.

    The value is the share `share` of the way to the nearer bound. Of a ratio both x and 1/x are taken.
    """
    kind = CATALOGUE[one.term]
    if one.located or not kind.exported or kind.family in ("time", "air", "place"):
        return []
    found = []
    start = {name: kind.neutral.get(name, value) for name, value in one.starts[0].items()}
    for name, limits in one.ranges.items():
        if name in kind.neutral:
            ends = [end for end in (limits.lower, limits.upper) if end != kind.neutral[name]]
            nearer = min(ends, key=lambda end: abs(end - kind.neutral[name]))
            value = kind.neutral[name] + share * (nearer - kind.neutral[name])
            both = (value, 1.0 / value) if kind.neutral[name] == 1.0 else (value,)
            found += [(name, each, {**start, name: each}) for each in both if limits.lower <= each <= limits.upper]
    return found
