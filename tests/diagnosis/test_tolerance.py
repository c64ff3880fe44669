"""What any sound recording may have is known and no finding: it stands beside the names, and a lead states it."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.recording.witnesses import build_witnesses
from split_cli.diagnosis.search.candidates import Candidate
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.selection import Selection, nothing
from split_cli.diagnosis.search.term_tests import is_tolerated
from split_cli.diagnosis.statement.result import ParameterEstimate
from split_cli.diagnosis.verdict.held_out_split import fitted_alone
from split_cli.diagnosis.verdict.tolerance import is_worth_a_word, named_or_tolerated, tolerance_leads
from tests.diagnosis.recordings import (
    INFLATION,
    bare_objective,
    candidates_of,
    driven,
    explorer,
    light_evidence,
    named,
    noisy,
    prepared,
    selected,
)

BIAS = 0.015  # [rad/s], a gyroscope's at rest


@pytest.fixture(scope="module")
def shifted() -> MarginalLikelihood:
    """A drive with a shifted yaw rate, and without yaw and position that would show whose it is."""
    return shifted_by(BIAS)


def shifted_by(bias: float) -> MarginalLikelihood:
    series = prepared(noisy(driven(44), 10))
    drive = replace(series.drive, columns={**series.drive.columns, "r": series.drive["r"] + bias})
    columns = {name: values for name, values in drive.columns.items() if name not in ("X", "Y", "yaw")}
    return bare_objective(light_evidence(prepared(replace(drive, columns=columns))))


def selection_of(objective: MarginalLikelihood, candidate: Candidate, is_named: bool) -> Selection:
    base = nothing(objective)
    chosen = fit_parts(objective, (Part(candidate, {"r": 0.01}),))
    return Selection(base, chosen, (base,), ((),), ((),), (is_named,))


def test_a_bias_without_a_witness_is_a_lead_with_its_value_and_how_much_is_usual(shifted):
    (bias,) = explorer(shifted, "yaw_rate_bias").candidates
    tolerated = selection_of(shifted, bias.without_position(beside_simulation=False), False)
    (lead,) = tolerance_leads(shifted, tolerated, INFLATION, taken_off=False)
    assert lead.term == "yaw_rate_bias" and not lead.limits and lead.share == pytest.approx(1.0)
    assert lead.parameters["r"].value == pytest.approx(BIAS, abs=0.003)
    assert "Up to 0.0175 rad/s is usual in sound recordings" in lead.sentence
    assert lead.sentence.startswith("A lead, not a finding: the measurement, not the car: the yaw rate reads")
    (beside,) = tolerance_leads(shifted, tolerated, INFLATION, taken_off=True)
    assert beside.sentence == f"{lead.sentence} The held-out errors with the identified effects are without it."
    # What is more than usual is no lead of this kind, named or not.
    assert tolerance_leads(shifted, selection_of(shifted, bias, True), INFLATION, taken_off=False) == ()


def test_an_error_far_below_what_is_usual_is_no_lead_unless_figures_are_without_it():
    """A lead of 0.0055 m/s^2 where 0.245 is usual told an engineer nothing, and that it is no fault."""
    for r, told in ((0.0016, False), (0.004, True)):
        read = {"r": ParameterEstimate(r, 0.0002, "rad/s", (0.0, 0.01))}
        assert is_worth_a_word(read, {"r": 0.0175}, "yaw_rate_bias", taken_off=False) is told
        assert is_worth_a_word(read, {"r": 0.0175}, "yaw_rate_bias", taken_off=True)
    # A small part of what is usual is a lead still where it is certain.
    objective = shifted_by(0.4 * BIAS)
    (bias,) = explorer(objective, "yaw_rate_bias").candidates
    small = selection_of(objective, bias.without_position(beside_simulation=False), False)
    (lead,) = tolerance_leads(objective, small, INFLATION, taken_off=False)
    assert lead.parameters["r"].value == pytest.approx(0.4 * BIAS, abs=0.003)
    # No velocity is other without an accelerometer's error, so nothing is hidden where it is not said.
    for ax, told in ((0.0055, False), (0.13, True)):
        read = {name: ParameterEstimate(value, 0.001, "m/s^2", (0.0, 0.2)) for name, value in (("ax", ax), ("ay", 0.0))}
        assert is_worth_a_word(read, {"ax": 0.245, "ay": 0.245}, "acceleration_bias", taken_off=True) is told


def test_what_is_within_tolerance_stands_beside_the_names_and_needs_no_finding(shifted):
    (bias,) = explorer(shifted, "yaw_rate_bias").candidates
    usual, fault = (
        selection_of(shifted, bias.without_position(beside_simulation=False), False),
        selection_of(shifted, bias, False),
    )
    assert named_or_tolerated(usual) == (True,) and named_or_tolerated(fault) == (False,)
    (kept,) = fitted_alone(shifted, usual.chosen, named_or_tolerated(usual), ())
    assert kept.values == usual.chosen.parts[0].values
    assert fitted_alone(shifted, fault.chosen, named_or_tolerated(fault), ()) == ()


def test_the_equations_of_motion_name_a_bias_without_a_witness_beside_a_simulation(shifted):
    """Against the bare nominal model they have model-form error, so the same bias is no name there."""
    (bias,) = explorer(shifted, "yaw_rate_bias").candidates
    beside, bare = (bias.without_position(beside_simulation=one) for one in (True, False))
    assert beside.is_within_tolerance({"r": BIAS}) and bare.is_within_tolerance({"r": BIAS})
    assert named(selected(shifted, beside)) == {"yaw_rate_bias"} and named(selected(shifted, bare)) == set()
    (found,) = selected(shifted, beside).chosen.parts
    assert found.values["r"] == pytest.approx(BIAS, abs=0.003)


def test_a_scale_that_lateral_acceleration_alone_shows_is_tolerated():
    """The body of the real car rolls, so that its accelerometer feels 5 % more than v_y' + v_x r."""
    series = prepared(noisy(driven(44), 10))
    drive = series.drive
    felt = np.gradient(drive["vy"], drive["t"]) + drive["vx"] * drive["r"]
    columns = {name: values for name, values in drive.columns.items() if name not in ("X", "Y", "yaw")}
    rolling = prepared(replace(drive, columns={**columns, "ay": 1.05 * felt}))
    objective = bare_objective(light_evidence(rolling), kinematics=build_witnesses(rolling))
    scale = next(one for one in candidates_of(objective, "speed_scale") if one.variant == "vx")
    scale = scale.without_position(beside_simulation=True)
    part = Part(scale, {"scale": 1.0 / 1.05})
    rows = objective.whiten(objective.raw_residual((part.term,)))
    base, fit = nothing(objective), Fit((part,), float(rows @ rows), rows, np.empty((len(rows), 0)))
    motion = len(rows) - len(objective.of_witnesses(rows))
    assert motion < len(rows) and np.sum(rows[motion:] ** 2) < np.sum(base.residuals[motion:] ** 2)
    assert is_tolerated(objective, fit, 0, base, INFLATION, 0.01)
    # Position in the place of a_y has no such tolerance.
    named_by_position = Part(replace(scale, by_acceleration={}), part.values)
    assert not is_tolerated(objective, replace(fit, parts=(named_by_position,)), 0, base, INFLATION, 0.01)
