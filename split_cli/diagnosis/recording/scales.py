"""Whether speed and yaw rate have the scale of position and yaw, in reality as in the simulation.

What a sensor out of scale does to the rest looks like mass, grip or inertia, so it has to be named first.
Position and yaw tell: a car that reads 3 % too fast covers 3 % more ground than it does.
"""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.vehicle.effects import Term

_BLOCKS = 20
_WORDS = {
    "v_x": "speed against position: the integral of v_x is {share} {more} than the distance by X and Y",
    "r": "yaw rate against yaw: the integral of r is {share} {more} than the change of yaw",
}
_TERMS = {"v_x": "speed_scale", "r": "yaw_rate_scale"}
_ADVICE = (
    "; correct the scale of that sensor and diagnose again, "
    "effects of the car that depend on it are not identified before"
)


def out_of_scale(
    real: Sequence[KinematicResiduals],
    simulated: Sequence[KinematicResiduals],
    terms: Sequence[Term] = (),
    rules: Screening = STANDARD.screening,
) -> tuple[str, ...]:
    """Return in words which of v_x and r contradict position and yaw in reality, and not so in the simulation.

    Parameters
    ----------
    real, simulated : sequence of KinematicResiduals
        Without any simulated, scales are held against 1.
    terms : sequence of Term
        Found; the real sensors are corrected by them.
    """
    out = []
    for name, (ours, theirs) in _wrong(real, simulated, terms, rules).items():
        and_not = ", in the simulation they agree" if simulated and abs(theirs - 1.0) <= rules.least_scale_error else ""
        share = f"{100.0 * abs(ours - theirs):.2g} %"
        out.append(_WORDS[name].format(share=share, more="more" if ours > theirs else "less") + and_not + _ADVICE)
    return tuple(out)


def scales_as_terms(
    real: Sequence[KinematicResiduals],
    simulated: Sequence[KinematicResiduals],
    terms: Sequence[Term] = (),
    rules: Screening = STANDARD.screening,
) -> dict[str, float]:
    """Return the scale [1] of what `out_of_scale` tells of, by the id of the term that corrects it."""
    wrong = _wrong(real, simulated, terms, rules)
    return {_TERMS[name]: ours - theirs + 1.0 for name, (ours, theirs) in wrong.items()}


def _wrong(
    real: Sequence[KinematicResiduals], simulated: Sequence[KinematicResiduals], terms: Sequence[Term], rules: Screening
) -> dict[str, tuple[float, float]]:
    """Return the scales of v_x and r in reality and in the simulation [1], of those that differ."""
    out = {}
    for name in _WORDS:
        theirs = scale_of(name, simulated) if simulated else (1.0, 0.0)
        ours = scale_of(name, real, terms)
        if ours is None or theirs is None:
            continue
        error = float(np.hypot(ours[1], theirs[1]))
        if abs(ours[0] - theirs[0]) > max(rules.least_scale_error, rules.sure_scale_error * error):
            out[name] = ours[0], theirs[0]
    return out


def in_sentences(contradictions: Sequence[str]) -> list[str]:
    """Return what `out_of_scale` tells as sentences of a summary."""
    return [f"The recording contradicts itself: {one}." for one in contradictions]


def scale_of(
    name: str, several: Sequence[KinematicResiduals], terms: Sequence[Term] = ()
) -> tuple[float, float] | None:
    """Return what a channel makes over what position or yaw does, and its standard error; None if nothing moves.

    Notes
    -----
    The median over blocks of time of sum(a b)/sum(b^2), b from position or yaw; its error from their median
    absolute deviation. Noise of b is left in: that of positions is far below half a second's way.
    """
    pairs = [one.against_position(name, terms) for one in several]
    if not pairs:
        return None
    made, true = (np.concatenate(columns) for columns in zip(*pairs, strict=True))
    blocks = [
        (float(a @ b), float(b @ b))
        for a, b in zip(np.array_split(made, _BLOCKS), np.array_split(true, _BLOCKS), strict=True)
        if len(b)
    ]
    least = 0.1 * np.mean([below for _, below in blocks])
    slopes = np.array([above / below for above, below in blocks if below > max(least, 1e-12)])
    if len(slopes) < _BLOCKS // 2:
        return None
    middle = float(np.median(slopes))
    spread = 1.4826 * float(np.median(np.abs(slopes - middle)))
    return middle, 1.2533 * spread / float(np.sqrt(len(slopes)))
