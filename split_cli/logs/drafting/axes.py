"""Velocities and accelerations that are not along the car: another of its axes, or those of the world."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from split_cli.logs.checking.kinematics import fit_slope
from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.trial import Trial, TrialCandidate
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of

__all__ = ["without_other_axes", "without_the_world"]

_FORWARD_SHARE = 0.2
"""Of the speed, below which a velocity is not the forward one [1]: less than a wrong unit makes (1/3.6)."""
_GOES_WITH = 0.8
"""Correlation of an acceleration with the change of a velocity along the same axis of the world [1]."""
Guess = Callable[[TrialCandidate], Suggestion]


def without_other_axes(usable: dict[str, list[TrialCandidate]], trial: Trial, guess: Guess) -> list[Suggestion]:
    """Leave out velocities along x that are small beside a recorded speed: in games x is to the right."""
    sizes = {}
    for candidate in usable.get("vx", []):
        column = trial.column(guess(candidate))
        if column is not None:
            sizes[candidate] = float(np.sqrt(np.nanmean(column**2)))
    speeds = [c for c in sizes if "long" not in concepts_of(tokens_of(c.sources[0]))[0] and c.unit is not None]
    told = []
    for candidate, size in sizes.items():
        speed = next((c for c in speeds if size < _FORWARD_SHARE * sizes[c]), None)
        if speed is not None:
            usable["vx"].remove(candidate)
            why = f"{size / sizes[speed]:.2g} of {speed.sources[0]}: not along the car"
            told.append(Suggestion("vx", candidate.sources, status="open", reason=why))
    return told


def without_the_world(
    usable: dict[str, list[TrialCandidate]], chosen: Mapping[str, Suggestion], trial: Trial
) -> list[Suggestion]:
    """Leave out a chosen v_x and v_y that turn with the car, and accelerations that are the change of these.

    What is left out goes from `usable`; empty where the velocity is along the car.
    """
    verdict = trial.judge(chosen)
    found = {f.channel: f.text for f in verdict.findings if f.check == "world"}
    if not found:
        return []
    reasons = {channel: found[channel].split(". Nothing")[0] for channel in ("vx", "vy")}
    for channel, velocity in (("ax", "vx"), ("ay", "vy")):
        pair = [trial.column(chosen[c]) if c in chosen else None for c in (channel, velocity)]
        if pair[0] is None or pair[1] is None:
            continue
        change = np.gradient(_smooth(pair[1], trial.rate), 1.0 / trial.rate)
        slope = fit_slope(_smooth(pair[0], trial.rate), change, np.isfinite(change))
        if slope is not None and abs(slope.correlation) > _GOES_WITH:
            reasons[channel] = f"the change of {chosen[velocity].sources[0]}: along the axes of the world"
    told = []
    for channel, reason in reasons.items():
        sources = chosen[channel].sources
        usable[channel] = [c for c in usable[channel] if c.sources != sources]
        if not usable[channel]:
            del usable[channel]
        told.append(Suggestion(channel, sources, status="open", reason=reason))
    return told


def _smooth(values: np.ndarray, rate: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, 0.2 * rate)
