"""Parameters that follow a variable give it away; parameters that are constant do not."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.form_error import form_error_columns
from split_cli.diagnosis.verdict import constancy
from split_cli.diagnosis.verdict.constancy import bends, beyond_form_error
from split_cli.diagnosis.verdict.findings import _sure_bends
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import INFLATION, candidates_of, driven, noisy_objective, selected


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


SLOW = Drifting(lambda flow: 0.9 + 0.001 * (flow.t - 48.0))
SIDED = Drifting(lambda flow: 0.9 + 0.04 * np.sign(flow.r))
FAST = Drifting(lambda flow: 0.9 + 0.01 * (flow.vx - 18.0))
CONSTANT = CATALOGUE["steer_gain"]({"gain": 0.9})


@pytest.mark.parametrize(
    ("term", "variable", "size"),
    # Of a tenth less steering: 0.001 times the spread of 96 s evenly, 28 s, and 0.04 to either side; 0.01 times
    # that of speeds from 10 to 26 m/s, 4.6 m/s.
    [(SLOW, "time", 0.28), (SIDED, "the side of the turn", 0.4), (FAST, "speed", 0.46)],
)
def test_a_term_that_stands_for_what_changes_bends_with_it(term, variable, size):
    objective = objective_of(term)
    first, *_ = bends(objective, fit_of(objective), (True,), INFLATION)
    assert (first.term, first.variable) == ("steer_gain", variable) and first.p_value < 1e-6
    # Rows count by how much they are steered, and part of a change with time is one with the operating point.
    assert 0.6 * size < first.size < 1.4 * size
    assert bends(objective, fit_of(objective), (False,), INFLATION) == ()


def test_what_a_single_track_gets_wrong_is_no_bend():
    """A constant gain bends with nothing, and one that is another by a tenth of itself may be by chance."""
    for term in (CONSTANT, Drifting(lambda flow: 0.9 + 0.008 * np.sign(flow.r))):
        objective = objective_of(term)
        found = bends(objective, fit_of(objective), (True,), INFLATION)
        assert {one.variable for one in found} >= {"time", "heat of sliding", "heat of braking", "heat of work"}
        assert min(one.p_value for one in found) * len(found) > 0.01


def test_a_bend_is_that_of_generalised_least_squares():
    """Parameters and model-form error stand beside the bend as ridge columns in one dense problem."""
    objective = objective_of(SLOW)
    fit, noise = fit_of(objective), 1.5
    (told,) = (one for one in bends(objective, fit, (True,), noise) if one.variable == "time")
    (part,) = fit.parts
    step = part.candidate.ranges["gain"].step
    moved = objective.residual((part.candidate.build({"gain": part.values["gain"] + step}),))
    effect = (moved - objective.residual(fit.terms)) * (part.values["gain"] - 1.0) / step
    columns = effect[:, None] * constancy._variables(objective)["time"]
    ridged = np.hstack(
        [1e3 * effect[:, None] / np.linalg.norm(effect), form_error_columns(objective, fit) / noise**0.5]
    )
    both = np.hstack([columns, ridged])
    stacked = np.vstack([both, np.hstack([np.zeros((ridged.shape[1], 4)), np.eye(ridged.shape[1])])])
    target = np.append(fit.residuals, np.zeros(ridged.shape[1]))
    weights, squares = np.linalg.lstsq(stacked, target, rcond=None)[:2]
    without = np.linalg.lstsq(stacked[:, 4:], target, rcond=None)[1]
    bent = columns @ weights[:4]
    bent -= effect * (effect @ bent) / (effect @ effect)
    share = 1.0 - noise * 4 / float(without[0] - squares[0])
    assert told.size == pytest.approx(np.linalg.norm(bent) / np.linalg.norm(effect) * share**0.5, rel=1e-3)


def test_a_selection_that_bends_is_not_all():
    for term, bent in ((SLOW, True), (CONSTANT, False)):
        objective = objective_of(term)
        selection = selected(objective, "steer_gain")
        assert [one.id for one in selection.terms] == ["steer_gain"]
        assert bool(_sure_bends(objective, selection, INFLATION)) is bent


class Bending(Term):
    """An engine that gives less than twice as much at full pedal as at half."""

    id = "bending"

    def __init__(self, bend: float) -> None:
        super().__init__({})
        self.bend = bend

    def actuate(self, flow) -> None:
        """Bend the driving torque."""
        flow.T = flow.T * (1.0 - self.bend * np.clip(flow.T / 1000.0, 0.0, 1.0))


@pytest.mark.parametrize(("bend", "gain", "beyond"), [(0.5, 1.0, True), (0.0, 0.7, False)])
def test_a_gain_that_would_err_by_more_than_a_single_track_is_not_all_that_acts(bend, gain, beyond):
    """Free to err by torque, a gain takes all of an engine map that bends, and bends no more."""
    term = Bending(bend) if bend else CATALOGUE["drive_gain"]({"drive_gain": gain, "brake_gain": 1.0})
    objective = objective_of(term)
    fit = fit_of(objective, "drive_gain")
    (p_value,) = beyond_form_error(objective, fit, [True], INFLATION).values()
    assert (p_value < 1e-6) is beyond and (beyond or p_value > 0.5)
    assert beyond_form_error(objective, fit, [False], INFLATION) == {}


def test_model_form_errors_as_large_as_the_prior_has_them_are_none_too_many():
    """Weights drawn from their prior exceed what is expected no more often than the level; five times do."""
    objective = objective_of(CATALOGUE["drive_gain"]({"drive_gain": 0.7, "brake_gain": 0.7}))
    fit = fit_of(objective, "drive_gain")
    columns, rng = form_error_columns(objective, fit), np.random.default_rng(6)

    def p_value(size: float) -> float:
        drawn = columns @ rng.normal(0.0, size, columns.shape[1])
        (found,) = beyond_form_error(objective, replace(fit, residuals=fit.residuals + drawn), [True], 1.0).values()
        return found

    assert sum(p_value(1.0) < 0.1 for _ in range(40)) <= 8
    assert all(p_value(5.0) < 1e-3 for _ in range(10))


def test_an_error_counts_by_what_it_does_and_not_by_its_share_of_next_to_nothing():
    """A steering gain along the car: ten times what the prior has of nearly nothing is nothing."""
    objective = objective_of(CATALOGUE["steer_gain"]({"gain": 0.9}))
    fit = fit_of(objective)
    columns = form_error_columns(objective, fit)
    sizes = np.linalg.norm(columns, axis=0)
    along, across = int(np.argmin(np.where(sizes > 0.0, sizes, np.inf))), int(np.argmax(sizes[1:]) + 1)
    assert 0.0 < sizes[along] < 0.2 * sizes[across]

    def p_value(k: int, size: float) -> float:
        moved = replace(fit, residuals=fit.residuals + size * columns[:, k])
        return beyond_form_error(objective, moved, [True], INFLATION)["steer_gain"]

    assert p_value(along, 10.0) > 0.1 > 1e-6 > p_value(across, 10.0)
