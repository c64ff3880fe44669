"""Recordings with a fault of the commands put in, and the saving of its term on them, for detection limits.

A fault of the commands changes more than the residuals. The whitening filter uses the Jacobian at the commands and the
disturbance that they leave, and the shared discrepancy depends on them too. So the fault is put into the recording
before whitening.
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

_POWERS = 3  # terms of the series by which a lag or a play is inverted [1]


def saving_on_faulty_recordings(
    objective: MarginalLikelihood, term: Term, others: Sequence[Term] = (), *, case: DiagnosisCase, reach: float
) -> tuple[float, float]:
    """Return the saving of a term on recordings that have its effect, and its size there over the allowance [1].

    Parameters
    ----------
    objective : MarginalLikelihood
        Of the recordings as they are.
    term : Term
        A term that alters commands, with the values of the fault.
    others : sequence of Term
        Findings of the recordings as they are, beside which the saving is computed.
    case : DiagnosisCase
        The recordings as they are.
    reach : float
        See `ComparisonRules`.

    Notes
    -----
    With the columns Phi of the shared discrepancy, the precision H of their weights and L L^T = H + Phi^T Phi, rows r
    cost |r|^2 - |L^-1 Phi^T r|^2; with a fixed baseline |r|^2.
    """
    faulty_case = case.recorded_as([faulty(one, term) for one in case.real], reach, objective.policy)
    pairs = zip(faulty_case.real, faulty_case.keep, strict=True)
    weight = np.concatenate([np.repeat(one.weight[mask], 3) for one, mask in pairs])
    witnesses = sum(len(one.begin) for one in objective.kinematics)
    weight = np.append(weight, np.ones(witnesses))
    there = replace(
        objective,
        evidence=faulty_case.real,
        keep=faulty_case.keep,
        memo={},
        weight=weight,
        offset=np.zeros(len(weight)),
    )
    if objective.posterior is not None:
        columns = there.stack([one.discrepancy for one in faulty_case.real])
        there = replace(there, offset=columns @ objective.posterior.weights)
    rows = np.stack([there.raw_residual(terms) for terms in (others, (*others, term))], axis=1)
    costs = np.sum(rows**2, axis=0)
    if objective.posterior is not None and not objective.fixed_baseline:
        lower = np.linalg.cholesky(objective.posterior.precision + columns.T @ columns)
        costs -= np.sum(solve_triangular(lower, columns.T @ rows, lower=True) ** 2, axis=0)
    return float(costs[0] - costs[1]), over_allowance(there, (*others, term), tuple(others))


def faulty(one: Evidence, term: Term) -> Series:
    """Return a recording of the same motion by a car with a fault of its commands: these are the ones it would need.

    Notes
    -----
    A term without states is inverted by the opposite values: a delay by a lead, a gain by its inverse. A term with
    states, as a lag or a play, maps commands u to A u. Its inverse is the series u + (1 - A) u + (1 - A)^2 u + ...
    (Neumann), which converges for commands slower than the lag.
    """
    series, model = one.series, SingleTrack(one.vehicle, (term if term.state_names else _with_opposite_values(term),))
    if not term.state_names:
        torque, steer_angle = series.inputs(model, series.smooth)
        return replace(series, torque=torque, steer_angle=steer_angle)
    asked = series
    for _ in range(_POWERS):
        torque, steer_angle = asked.inputs(model, series.smooth)
        torque, steer_angle = asked.torque - torque, asked.steer_angle - steer_angle
        asked = replace(series, torque=series.torque + torque, steer_angle=series.steer_angle + steer_angle)
    return asked


def _with_opposite_values(term: Term) -> Term:
    """Return a term with the opposite values, see `other_side`."""
    turned = other_side(CATALOGUE[term.id].neutral, term.parameters)
    return type(term)({**term.parameters, **turned}, term.variant)


def other_side(neutral: Mapping[str, float | None], values: Mapping[str, float]) -> dict[str, float]:
    """Return the values mirrored about neutral (the inverse of a ratio), of parameters that have a neutral value."""
    return {
        name: 1.0 / value if neutral[name] == 1.0 else 2.0 * neutral[name] - value
        for name, value in values.items()
        if neutral.get(name) is not None
    }
