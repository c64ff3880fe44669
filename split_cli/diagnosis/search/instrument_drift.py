"""How far instruments drift by themselves: no sensor's fault that is smaller can be identified.

Navigation systems correct their heading as they go, biases drift, and roads lean. So what one instrument says of
another changes from one stretch of driving to the next. Two recordings of one car may lie as far apart.
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
    """Return how far the size of a fault drifts from stretch to stretch by witnesses of one kind, as a deviation.

    Parameters
    ----------
    pattern : callable
        What a fault of unit size adds to the difference of a witness, shape (W,).

    Notes
    -----
    A stretch is as long as the evidence that a decision takes. Of what an instrument says beside the velocities,
    scale, bias, delay and a steady drift are taken off by least squares: those have terms of their own. With
    windows y and the pattern p, a stretch says b = p^T y/(p^T p), of the variance tau^2 + sigma^2/(p^T p), sigma^2
    that within stretches: an analysis of variance with random effects, whose moments give tau (DerSimonian and
    Laird, 1986). It is 0 where Fisher's F test finds no more than chance.
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
    """Return the deviation of a pattern's size between stretches beyond chance.

    Parameters
    ----------
    values, pattern : ndarray, shape (N,)
    stretches : ndarray, shape (N, 2)
        Numbers of recording and stretch.
    spent : int
        How many causes were taken off the values.
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
    """Return candidates of which no size is a fault that instruments drift by, in reality or in the simulation.

    A size is a fault where it exceeds how far sizes of single stretches lie apart, by the witness that shows it most,
    95 % of a normal deviate. Velocities are held against position and yaw alone: accelerometers hardly feel their
    biases.
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
    """Return from which size on each parameter exceeds how far stretches lie apart, by its clearest witness."""
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
    """Return by parameter the term with its first start of that alone, and how far that is from no effect."""
    kind, start = CATALOGUE[candidate.term], candidate.starts[0]
    sizes = {name: size for name, size in candidate.away(start).items() if size}
    none = {**start, **{name: kind.neutral[name] for name in candidate.away(start)}}
    return {name: (candidate.build({**none, name: start[name]}), size) for name, size in sizes.items()}


def _is_acceleration(one: KinematicResiduals | Witness) -> bool:
    """Return whether a witness holds an accelerometer against the velocities: these hardly feel their biases."""
    return one.kind.startswith("a_")


def _clearest(fault: Term, witnesses: Sequence[KinematicResiduals | Witness]) -> str:
    """Return the kind of the witness that a fault moves most [rms], in its spreads; empty if it moves none."""
    felt = [one for one in witnesses if one.is_changed_by(fault) and len(one.begin)]
    lengths = {one.kind: float(np.sqrt(np.mean(_moved(one, fault) ** 2))) / one.scale for one in felt}
    clearest = max(lengths, key=lengths.__getitem__, default="")
    return clearest if clearest and lengths[clearest] else ""


def _moved(one: KinematicResiduals | Witness, fault: Term) -> np.ndarray:
    """Return by how much a fault changes the difference of a witness, shape (W,)."""
    return one.difference([fault]) - one.difference(())
