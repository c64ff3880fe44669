"""A fault of the commands put into recordings, and what its term saves of them: filtered as a drive that has it.

The whitening filter rests on the nominal model at the recorded commands, and on the disturbance that they leave.
With a fault both are others, and so is what the simulation taught at these commands. A tyre that is asked beyond
its peak hardly pushes back, and the filter believes slow errors less. So faults are put in before whitening.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.linalg import solve_triangular

from split_cli.diagnosis.innovations.case import DiagnosisCase
from split_cli.diagnosis.innovations.evidence import Evidence
from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.series import Series
from split_cli.diagnosis.search.term_tests import over_allowance
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.single_track import SingleTrack

_POWERS = 3  # of what a lag or a play takes off commands, by which these are undone


def alters_commands(term: Term) -> bool:
    """Return whether a term changes what arrives of the commands."""
    return type(term).actuate is not Term.actuate


def planted_saving(
    objective: MarginalLikelihood, term: Term, others: Sequence[Term] = (), *, case: DiagnosisCase, reach: float
) -> tuple[float, float]:
    """Return what a term saves of recordings that have it, and its size there over what is allowed.

    Parameters
    ----------
    objective : MarginalLikelihood
        Of recordings without it.
    term : Term
        One that alters commands, at its true values.
    others : sequence of Term
        Beside which it is asked, of these recordings as they are.
    case : DiagnosisCase
        The recordings.
    reach : float
        See `ComparisonRules`.

    Notes
    -----
    With Phi the columns of the shared discrepancy, H what the simulation says of their weights, and L L^T = H +
    Phi^T Phi, rows r cost |r|^2 - |L^-1 Phi^T r|^2; with a fixed baseline |r|^2.
    """
    planted = case.recorded_as([faulty(one, term) for one in case.real], reach, objective.policy)
    pairs = zip(planted.real, planted.keep, strict=True)
    weight = np.concatenate([np.repeat(one.weight[mask], 3) for one, mask in pairs])
    witnesses = sum(len(one.begin) for one in objective.kinematics)
    weight = np.append(weight, np.ones(witnesses))
    there = replace(
        objective, evidence=planted.real, keep=planted.keep, memo={}, weight=weight, offset=np.zeros(len(weight))
    )
    if objective.posterior is not None:
        columns = there.stack([one.discrepancy for one in planted.real])
        there = replace(there, offset=columns @ objective.posterior.weights)
    rows = np.stack([there.left_by(terms) for terms in (others, (*others, term))], axis=1)
    costs = np.sum(rows**2, axis=0)
    if objective.posterior is not None and not objective.fixed_baseline:
        lower = np.linalg.cholesky(objective.posterior.precision + columns.T @ columns)
        costs -= np.sum(solve_triangular(lower, columns.T @ rows, lower=True) ** 2, axis=0)
    return float(costs[0] - costs[1]), over_allowance(there, (*others, term), tuple(others))


def faulty(one: Evidence, term: Term) -> Series:
    """Return a recording of the same motion by a car that has a fault of its commands.

    The commands are those that the faulty car needs to do what was done: a weak steering has been asked for more.

    Notes
    -----
    A term is undone by its values on the other side of none: a delay by a lead, a gain by its inverse. What has
    states, as a lag or a play, has no such values. If it makes A u of commands u, it is undone by u + (1 - A) u +
    (1 - A)^2 u + ...: what is left falls with each power where commands are slower than the lag.
    """
    series, model = one.series, SingleTrack(one.vehicle, (term if term.state_names else _turned(term),))
    if not term.state_names:
        torque, steer_angle = series.inputs(model, series.smooth)
        return replace(series, torque=torque, steer_angle=steer_angle)
    asked = series
    for _ in range(_POWERS):
        torque, steer_angle = asked.inputs(model, series.smooth)
        torque, steer_angle = asked.torque - torque, asked.steer_angle - steer_angle
        asked = replace(series, torque=series.torque + torque, steer_angle=series.steer_angle + steer_angle)
    return asked


def _turned(term: Term) -> Term:
    """Return a term with values as far to the other side of no effect, a ratio's inverse."""
    turned = other_side(CATALOGUE[term.id].neutral, term.parameters)
    return type(term)({**term.parameters, **turned}, term.variant)


def other_side(neutral: Mapping[str, float | None], values: Mapping[str, float]) -> dict[str, float]:
    """Return values that have a neutral one as far to its other side, a ratio's inverse."""
    return {
        name: 1.0 / value if neutral[name] == 1.0 else 2.0 * neutral[name] - value
        for name, value in values.items()
        if neutral.get(name) is not None
    }
