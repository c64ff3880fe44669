"""Parameters that follow a variable give it away; parameters that are constant do not."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.verdict.constancy import parameter_drifts
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import candidates_of, driven, noisy_objective


class Drifting(Term):
    """A steering gain that follows one quantity of the flow."""

    id = "drifting"

    def __init__(self, gain) -> None:
        super().__init__({})
        self.gain = gain

    def actuate(self, flow) -> None:
        """Scale the wheel angle."""
        flow.delta = flow.delta * self.gain(flow)


def objective_of(*terms: Term) -> MarginalLikelihood:
    return noisy_objective(driven(61, terms), 4)


def fit_of(objective: MarginalLikelihood, term: str = "steer_gain"):
    (one, *_) = candidates_of(objective, term)
    return fit_parts(objective, [Part(one, dict(one.starts[0]))])


@pytest.mark.parametrize(
    ("variable", "gain"),
    [
        ("speed", lambda flow: 0.9 + 0.01 * (flow.vx - 18.0)),
        ("torque", lambda flow: 0.9 + 0.06 * flow.T / 1000.0),
        ("the side of the turn", lambda flow: 0.9 + 0.04 * np.sign(flow.r)),
        ("time", lambda flow: 0.9 + 0.001 * (flow.t - 48.0)),
    ],
)
def test_the_variable_a_parameter_follows_comes_first(variable, gain):
    objective = objective_of(Drifting(gain))
    first, second, *_ = parameter_drifts(objective, fit_of(objective))
    assert first.variable == variable and first.freedom == 1
    assert chi2.sf(first.saved, 1) < 1e-6
    assert first.saved > 1.5 * second.saved


def test_constant_parameters_save_what_noise_does():
    objective = objective_of(CATALOGUE["tire_stiffness"]({"front_scale": 0.9, "rear_scale": 1.1}))
    drifts = parameter_drifts(objective, fit_of(objective, "tire_stiffness"))
    assert [one.freedom for one in drifts] == [2] * 7
    # Seven tests, of which the least likely is one in a thousand by chance.
    assert min(chi2.sf(one.saved, one.freedom) for one in drifts) > 1e-3
    assert [one.saved for one in drifts] == sorted((one.saved for one in drifts), reverse=True)


def test_savings_are_those_of_least_squares():
    """Beside the slope itself, the slope times the variable: one dense problem."""
    objective = objective_of(Drifting(lambda flow: 0.9 + 0.01 * (flow.vx - 18.0)))
    fit = fit_of(objective)
    (part,) = fit.parts
    step = part.candidate.ranges["gain"].step
    slope = (
        objective.residual((part.candidate.build({"gain": part.values["gain"] + step}),)) - fit.residuals
    ) / step
    one = objective.evidence[0]
    speed = np.repeat(one.series.smooth[one.at, 0], 3)
    speed = np.clip(speed / np.quantile(speed, 0.98), -1.5, 1.5)
    without = np.linalg.lstsq(slope[:, None], fit.residuals, rcond=None)[1][0]
    beside = np.linalg.lstsq(np.stack([slope, speed * slope], axis=1), fit.residuals, rcond=None)[1][0]
    (told,) = (drift for drift in parameter_drifts(objective, fit) if drift.variable == "speed")
    assert told.saved == pytest.approx(float(without - beside), rel=1e-6)


def test_nothing_fitted_drifts_nowhere(nominal_objective):
    assert parameter_drifts(nominal_objective, nothing(nominal_objective)) == ()
