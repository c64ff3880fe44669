"""How far instruments wander by themselves: no sensor's fault that is smaller can be told from that.

Navigation systems correct their heading as they go, biases drift, and roads lean. So what one instrument says of
another wanders from one stretch of driving to the next. Two recordings of one car may lie as far apart.
"""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.stats import f as fisher

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.evidence import ROW_SECONDS
from split_cli.diagnosis.policy import STANDARD, Policy
from split_cli.diagnosis.recording.kinematics import KinematicResiduals
from split_cli.diagnosis.recording.witnesses import Witness
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.vehicle.effects import CATALOGUE


def wandering(witnesses: Sequence[KinematicResiduals | Witness], policy: Policy = STANDARD) -> dict[str, float]:
    """Return how far witnesses of each kind wander from stretch to stretch, in the unit of their difference.

    Notes
    -----
    A stretch is as long as the evidence that a decision takes. Of what an instrument says beside the velocities,
    scale, bias, delay and a steady drift are taken off by least squares: those have terms of their own. The mean
    of n_j windows has the variance tau^2 + sigma^2/n_j, sigma^2 that within stretches: a one-way analysis
    of variance with random effects, whose moments give tau (DerSimonian and Laird, 1986). It is 0 where Fisher's F
    test finds no more than chance.
    """
    seconds = policy.comparison.least_rows * ROW_SECONDS
    by_kind: dict[str, list[KinematicResiduals | Witness]] = {}
    for one in witnesses:
        by_kind.setdefault(one.kind, []).append(one)
    found = {}
    for kind, several in by_kind.items():
        left, stretches, spent = [], [], 0
        for number, one in enumerate(several):
            causes = np.hstack([one.causes, one.slow_causes])
            difference = one.difference(())
            left.append(difference - causes @ np.linalg.lstsq(causes, difference, rcond=1e-9)[0])
            stretches.append(np.stack([np.full(len(left[-1]), number), one.series.t[one.begin] // seconds], axis=1))
            spent += causes.shape[1]
        found[kind] = _between(np.concatenate(left), np.concatenate(stretches), spent, policy.selection.level)
    return found


def _between(values: np.ndarray, stretches: np.ndarray, spent: int, level: float) -> float:
    """Return the deviation between stretches beyond that within, of values (N,) numbered by rows (N, 2)."""
    if not len(values):
        return 0.0
    own, count = np.unique(stretches, axis=0, return_inverse=True, return_counts=True)[1:]
    mean = np.bincount(own.ravel(), values) / count
    between, within = len(count) - spent, len(values) - len(count)
    if between < 1 or within < 1:
        return 0.0
    noise = float(np.sum((values - mean[own.ravel()]) ** 2)) / within
    total = float(count @ mean**2)
    if total <= noise * between * float(fisher.isf(level, between, within)):
        return 0.0
    return float(np.sqrt((total - noise * between) / len(values)))


def beyond_wandering(
    case: DiagnosisCase, candidates: Sequence[Candidate], policy: Policy = STANDARD
) -> list[Candidate]:
    """Return candidates of which no size is a fault that instruments wander by, in reality or in the simulation.

    A size is a fault where it moves the witness that shows it most by more than that wanders, 95 % of a normal
    deviate. Velocities are held against position and yaw alone: accelerometers hardly feel their biases. Delays
    are not asked: what wanders slowly is none.
    """
    ours, theirs = (wandering(several, policy) for several in (case.kinematics, case.simulated_kinematics))
    most = {kind: policy.selection.deviations * max(size, theirs.get(kind, 0.0)) for kind, size in ours.items()}
    return [_beyond(one, case.kinematics, most) if any(most.values()) else one for one in candidates]


def _beyond(
    candidate: Candidate, witnesses: Sequence[KinematicResiduals | Witness], most: Mapping[str, float]
) -> Candidate:
    """Return a candidate that is no fault where it moves its clearest witness by no more than `most`, by kind."""
    kind = CATALOGUE[candidate.term]
    if kind.exported or kind.moves_samples or kind.on_command_clock or not candidate.starts:
        return candidate
    start, none, everyday = candidate.starts[0], dict(candidate.starts[0]), {}
    sizes = candidate.away(start)
    none.update({name: kind.neutral[name] for name in sizes})
    for name, size in sizes.items():
        fault, clearest = candidate.build({**none, name: start[name]}), 0.0
        for one in witnesses:
            direct = one.kind.startswith("a_") != one.series.is_moved_by(fault)
            if size and direct and one.feels(fault) and len(one.begin):
                moved = one.difference([fault]) - one.difference(())
                length = float(np.sqrt(np.mean(moved**2)))
                if length / one.scale > clearest:
                    clearest, everyday[name] = length / one.scale, most[one.kind] * size / length
    return candidate.beyond(everyday)
