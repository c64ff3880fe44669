"""The shared discrepancy on other tyres: it follows their curves, and grip and stiffness are found beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import split_cli.diagnosis.baseline.discrepancy as discrepancy_module
from split_cli.diagnosis.baseline.discrepancy import build_shared_discrepancy, tangents
from split_cli.diagnosis.baseline.tires import on_other_tires
from split_cli.diagnosis.innovations.case import gather_case
from split_cli.diagnosis.innovations.objective import build_objective
from split_cli.diagnosis.recording.series import build_series, extended_model
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.logs.track_position import places_of
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.tire import lateral_force
from tests.diagnosis.recordings import driven, prepared
from tests.diagnosis.test_calibration import drive, recorded
from tests.factories import road_car

GRIP = 0.6
SOFTER = {"front_scale": 0.7, "rear_scale": 0.65}
#: What the nominal lacks: tyres of another stiffness, and a force that no tyre makes.
LACKING = (("tire_stiffness", {"front_scale": 1.6, "rear_scale": 1.6}), ("aero_drag", {"drag": 0.8}))


def term(name: str, variant: str = "", **values: float) -> Term:
    return CATALOGUE[name](values, variant)


def lacking() -> tuple[Term, ...]:
    return tuple(term(name, **values) for name, values in LACKING)


@pytest.mark.parametrize("other", [
    term("friction_scale", scale=GRIP), term("friction_scale", "curve", scale=GRIP),
    term("tire_stiffness", **SOFTER), term("load_transfer", cg_height=0.5),
    term("aero_downforce", front=0.0, rear=2.0),
], ids=lambda one: f"{one.id}-{one.variant}")  # fmt: skip
def test_another_curve_is_that_of_the_vehicle_at_another_slip_and_of_another_size(other):
    """Closed form: k D sin(C atan(B q alpha)) with the ratios q of slips and k of forces is the altered curve."""
    car, series = road_car(), prepared(driven(3, runs=1))
    found = on_other_tires(series, car, (other,))
    old, new = (series.flow(extended_model(car, some)) for some in ((), (other,)))
    for k, axle in enumerate(("front", "rear")):
        before, after = getattr(old, axle), getattr(new, axle)
        there = lateral_force(before.B, before.C, before.D, found.slip[k] * before.slip_angle)
        truth = lateral_force(after.B, after.C, after.D, after.slip_angle)
        np.testing.assert_allclose(found.force[k] * there, truth, rtol=1e-9)
        np.testing.assert_allclose(found.force[k], after.D / before.D * np.ones(len(series)), rtol=1e-9)


def test_what_alters_no_tyre_leaves_the_curves_alone():
    car, series = road_car(), prepared(driven(3, runs=1))
    others = (term("steer_gain", gain=0.9), term("yaw_inertia", scale=1.2), term("mass", "loaded", scale=1.2))
    assert on_other_tires(series, car, others) is None


def test_what_the_nominal_lacks_as_a_term_is_that_term_on_the_other_tyres():
    """Only tangents have weights: truth is the difference of two models, both on the other tyres."""
    car, series = road_car(), prepared(driven(3, runs=2))
    discrepancy = build_shared_discrepancy(car, series)
    weights = np.zeros(discrepancy.columns(series).shape[2])
    names = [(kind.id, parameter) for kind, _, parameter, _ in tangents()]
    at = names.index(("tire_stiffness", "front_scale"))
    weights[at] = 1.0
    stiffer = term("tire_stiffness", front_scale=1.0 + tangents()[at][3], rear_scale=1.0)
    for other in (term("friction_scale", scale=GRIP), term("tire_stiffness", **SOFTER)):
        found = discrepancy.rates(series, weights, (other,))
        truth = series.rates(extended_model(car, (stiffer, other))) - series.rates(extended_model(car, (other,)))
        np.testing.assert_allclose(found, truth, atol=1e-9 * np.abs(truth).max())


def test_smooth_functions_are_taken_at_the_same_point_of_the_curve():
    """A force by |alpha| alpha of the front axle, on front tyres q times as stiff, is q^2 times itself."""
    car, series, q = road_car(), prepared(driven(3, runs=1)), 0.65
    discrepancy = build_shared_discrepancy(car, series)
    to_forces = np.linalg.inv(car.force_matrix()).T
    slip = series.flow(extended_model(car)).front.slip_angle
    inside = np.abs(slip) < discrepancy.width[0]
    columns = np.einsum("nic,ij->njc", discrepancy.columns(series), to_forces)[inside, 1]
    square = (np.abs(slip) * slip)[inside]
    alike = np.abs(square @ columns) / np.maximum(np.linalg.norm(columns, axis=0), 1e-9)
    (which,) = np.flatnonzero(alike > (1.0 - 1e-9) * np.linalg.norm(square))
    weights = np.zeros(columns.shape[1])
    weights[which] = 1.0
    softer = term("tire_stiffness", front_scale=q, rear_scale=1.0)
    found = (discrepancy.rates(series, weights, (softer,)) @ to_forces)[inside, 1]
    np.testing.assert_allclose(found, q * q * columns[:, which], atol=1e-9 * np.abs(columns[:, which]).max())


@pytest.mark.parametrize(
    ("name", "variant", "truth"), [("friction_scale", "curve", {"scale": GRIP}), ("tire_stiffness", "", SOFTER)]
)
def test_other_tyres_are_found_beside_much_that_the_nominal_lacks(name, variant, truth, monkeypatch):
    """Stiffer tyres make forces that only the shared discrepancy knows."""
    simulation = drive(1, lacking())
    reality = recorded(drive(2, (*lacking(), term(name, variant, **truth))), 2)
    places, _ = places_of([reality, simulation], road_car().wheelbase)
    series = [
        build_series(one, role, s)
        for one, role, (s, _) in zip([reality, simulation], ("real", "sim"), places, strict=True)
    ]
    case = gather_case(road_car(), series)
    candidate = next(
        one for one in build_candidates(road_car(), series[0]) if (one.term, one.variant) == (name, variant)
    )
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep, case.kinematics)

    def fitted() -> dict[str, float]:
        fixed = replace(objective.with_fixed_baseline(), memo={})
        return fit_parts(fixed, (Part(candidate, dict(candidate.starts[0])),)).parts[0].values

    assert fitted() == pytest.approx(truth, abs=0.02)
    monkeypatch.setattr(discrepancy_module, "alters_tires", lambda one: False)
    assert max(abs(value - truth[key]) for key, value in fitted().items()) > 0.03
