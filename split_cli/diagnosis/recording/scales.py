"""Scale errors of speed and yaw rate, from position and yaw.

A wrong scale of a sensor looks like another mass, grip or inertia, so it is looked for first. A speed that reads 3 %
too high integrates to 3 % more distance than the positions show. A scale that the simulation has too is no difference.
"""

from collections.abc import Sequence

import numpy as np

from split_cli.diagnosis.policy import STANDARD, Screening
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.vehicle.effects import Term

_BLOCKS = 20  # blocks of windows of which the median scale is taken [1]
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
    """Return which scales of v_x and r differ from those of the simulation, in words; empty if none does.

    Parameters
    ----------
    real, simulated : sequence of KinematicResiduals
        Without a simulation the scales are compared with 1.
    terms : sequence of Term
        Findings, by which the real sensors are corrected first.
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
    """Return the scales [1] that `out_of_scale` reports, by the id of the term that would correct each."""
    wrong = _wrong(real, simulated, terms, rules)
    return {_TERMS[name]: ours - theirs + 1.0 for name, (ours, theirs) in wrong.items()}


def _wrong(
    real: Sequence[KinematicResiduals], simulated: Sequence[KinematicResiduals], terms: Sequence[Term], rules: Screening
) -> dict[str, tuple[float, float]]:
    """Return the scale in reality and in the simulation [1] of each of v_x and r in which they differ."""
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
    """Return what `out_of_scale` reports as sentences for a summary."""
    return [f"The recording contradicts itself: {one}." for one in contradictions]


def scale_of(
    name: str, several: Sequence[KinematicResiduals], terms: Sequence[Term] = ()
) -> tuple[float, float] | None:
    """Return the scale of a channel against position or yaw, and its standard error [1]; None without enough motion.

    Parameters
    ----------
    name : {"v_x", "r"}
    several : sequence of KinematicResiduals
        Recordings with the same sensors.
    terms : sequence of Term
        Whose sensor faults are corrected first.

    Notes
    -----
    The median over blocks of time of sum(a b)/sum(b^2), with a from the channel and b from position or yaw. The
    standard error follows from the median absolute deviation of the blocks. Noise of b is neglected: the noise of
    positions is far smaller than the displacement in 0.5 s.
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
