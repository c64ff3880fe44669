"""Velocities and accelerations that are not along the car: another of its axes, or those of the world."""

from collections.abc import Callable, Mapping

import numpy as np

from split_cli.logs.checking.kinematics import fit_slope
from split_cli.logs.drafting.draft import Suggestion
from split_cli.logs.drafting.trial import Trial, TrialCandidate
from split_cli.logs.drafting.vocabulary import concepts_of, tokens_of

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
    opened = []
    for candidate, size in sizes.items():
        speed = next((c for c in speeds if size < _FORWARD_SHARE * sizes[c]), None)
        if speed is not None:
            usable["vx"].remove(candidate)
            why = f"{size / sizes[speed]:.2g} of {speed.sources[0]}: not along the car"
            opened.append(Suggestion("vx", candidate.sources, status="open", reason=why))
    return opened


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
    velocity = [trial.column(chosen[c]) for c in ("vx", "vy")]
    if any(v is None for v in velocity):
        changes = {}
    else:
        changes = _changes(*(_smooth(v, trial.rate) for v in velocity), trial.rate)
    for channel, (of_the_world, of_the_car) in changes.items():
        column = trial.column(chosen[channel]) if channel in chosen else None
        if column is None:
            continue
        # On a winding straight road both look alike: only what goes better with the world is of it.
        world, own = (_correlation(_smooth(column, trial.rate), change) for change in (of_the_world, of_the_car))
        if world > max(_GOES_WITH, own):
            source = chosen[{"ax": "vx", "ay": "vy"}[channel]].sources[0]
            reasons[channel] = f"the change of {source}: along the axes of the world"
    opened = []
    for channel, reason in reasons.items():
        sources = chosen[channel].sources
        usable[channel] = [c for c in usable[channel] if c.sources != sources]
        if not usable[channel]:
            del usable[channel]
        opened.append(Suggestion(channel, sources, status="open", reason=reason))
    return opened


def _changes(east: np.ndarray, north: np.ndarray, rate: float) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Return what accelerations of the world, and of the car, are for a velocity along the world's axes."""
    speed, course = np.hypot(east, north), np.unwrap(np.arctan2(north, east))
    along, across = np.gradient(speed, 1.0 / rate), speed * np.gradient(course, 1.0 / rate)
    return {"ax": (np.gradient(east, 1.0 / rate), along), "ay": (np.gradient(north, 1.0 / rate), across)}


def _correlation(values: np.ndarray, motion: np.ndarray) -> float:
    slope = fit_slope(values, motion, np.isfinite(motion))
    return 0.0 if slope is None else abs(slope.correlation)


def _smooth(values: np.ndarray, rate: float) -> np.ndarray:
    from scipy.ndimage import gaussian_filter1d

    return gaussian_filter1d(values, 0.2 * rate)
