"""Drift of instruments, as the tolerance of sensor faults: smaller faults cannot be identified.

Navigation systems correct their heading, biases drift, and roads are banked. So the difference of two instruments
varies from one stretch of driving to the next, and two recordings of one car may differ by as much.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy.stats import f as fisher

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.evidence import ROW_SECONDS
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.witnesses import Witness
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.vehicle.effects import CATALOGUE, Term


def drift_between_stretches(
    witnesses: Sequence[KinematicResiduals | Witness],
    pattern: Callable[[KinematicResiduals | Witness], np.ndarray],
    policy: Policy = STANDARD,
) -> float:
    """Return the standard deviation of a fault's size between stretches, by witnesses of one kind, in its unit.

    Parameters
    ----------
    pattern : callable
        Returns what a fault of unit size adds to the difference of a witness, shape (W,).

    Notes
    -----
    A stretch is 10 s long. Scale error, bias, delay and steady drift of a witness are removed by least squares first.
    With windows y and the pattern p, the size of a fault in a stretch is b = p^T y/(p^T p), with the variance tau^2 +
    sigma^2/(p^T p) and the variance sigma^2 within stretches. This is a random-effects model, whose tau is estimated by
    moments (DerSimonian and Laird, 1986). It is 0 if Fisher's F test finds no more than chance.
    """
    seconds = policy.comparison.least_rows * ROW_SECONDS
    left, patterns, stretches, spent = [], [], [], 0
    for number, one in enumerate(witnesses):
        causes = np.hstack([one.error_patterns, one.drift_patterns])
        difference = one.difference(())
        left.append(difference - causes @ np.linalg.lstsq(causes, difference, rcond=1e-9)[0])
        patterns.append(pattern(one))
        stretches.append(np.stack([np.full(len(left[-1]), number), one.series.t[one.begin] // seconds], axis=1))
        spent += causes.shape[1]
    if not left:
        return 0.0
    return _between(*map(np.concatenate, (left, patterns, stretches)), spent, policy.selection.level)


def _between(values: np.ndarray, pattern: np.ndarray, stretches: np.ndarray, spent: int, level: float) -> float:
    """Return the standard deviation of a pattern's size between stretches, beyond chance.

    Parameters
    ----------
    values, pattern : ndarray, shape (N,)
    stretches : ndarray, shape (N, 2)
        Numbers of recording and stretch.
    spent : int
        Number of parameters that were fitted to the values before.
    """
    if not len(values):
        return 0.0
    own = np.unique(stretches, axis=0, return_inverse=True)[1].ravel()
    weight, moved = np.bincount(own, pattern**2), np.bincount(own, pattern * values)
    shows = weight > 0.0
    size = np.divide(moved, weight, out=np.zeros(len(weight)), where=shows)
    between, within = int(shows.sum()) - spent, int(shows[own].sum()) - int(shows.sum())
    if between < 1 or within < 1:
        return 0.0
    noise = float(np.sum((values - pattern * size[own])[shows[own]] ** 2)) / within
    total = float(weight @ size**2)
    if total <= noise * between * float(fisher.isf(level, between, within)):
        return 0.0
    return float(np.sqrt((total - noise * between) / weight.sum()))


def with_drift_tolerances(
    case: DiagnosisCase, candidates: Sequence[Candidate], policy: Policy = STANDARD
) -> list[Candidate]:
    """Return candidates whose tolerances include the drift of instruments, in reality and in the simulation.

    The tolerance is 1.96 standard deviations between stretches, by the witness that the fault changes most. Velocities
    are compared with position and yaw alone, since accelerations hardly depend on their biases.
    """

    def beyond(one: Candidate) -> Candidate:
        kind = CATALOGUE[one.term]
        if kind.exported or kind.on_command_clock or not one.starts:
            return one
        return one.with_tolerances(_tolerances(one, case.kinematics, case.simulated_kinematics, policy))

    return [beyond(one) for one in candidates]


def _tolerances(
    candidate: Candidate,
    ours: Sequence[KinematicResiduals | Witness],
    theirs: Sequence[KinematicResiduals | Witness],
    policy: Policy,
) -> dict[str, float]:
    """Return the tolerance of each parameter by the drift of the witness that it changes most."""
    found = {}
    for name, (fault, size) in _each_alone(candidate).items():

        def pattern(one: KinematicResiduals | Witness, fault=fault, size=size) -> np.ndarray:
            return _moved(one, fault) / size

        direct = [one for one in ours if _is_acceleration(one) == (name in ("ax", "ay"))]
        kind = _clearest(fault, direct)
        if kind:
            alike = ([one for one in several if one.kind == kind] for several in (ours, theirs))
            found[name] = policy.selection.deviations * max(
                drift_between_stretches(several, pattern, policy) for several in alike
            )
    return found


def _each_alone(candidate: Candidate) -> dict[str, tuple[Term, float]]:
    """Return, by parameter, the term with the start of that parameter alone, and its distance from neutral."""
    kind, start = CATALOGUE[candidate.term], candidate.starts[0]
    sizes = {name: size for name, size in candidate.away(start).items() if size}
    none = {**start, **{name: kind.neutral[name] for name in candidate.away(start)}}
    return {name: (candidate.build({**none, name: start[name]}), size) for name, size in sizes.items()}


def _is_acceleration(one: KinematicResiduals | Witness) -> bool:
    """Return whether a witness compares an acceleration with the velocities."""
    return one.kind.startswith("a_")


def _clearest(fault: Term, witnesses: Sequence[KinematicResiduals | Witness]) -> str:
    """Return the kind of the witness with the largest rms change by a fault, in its scale; empty without any change."""
    felt = [one for one in witnesses if one.is_changed_by(fault) and len(one.begin)]
    lengths = {one.kind: float(np.sqrt(np.mean(_moved(one, fault) ** 2))) / one.scale for one in felt}
    clearest = max(lengths, key=lengths.__getitem__, default="")
    return clearest if clearest and lengths[clearest] else ""


def _moved(one: KinematicResiduals | Witness, fault: Term) -> np.ndarray:
    """Return the change of a witness' difference by a fault, shape (W,)."""
    return one.difference([fault]) - one.difference(())
