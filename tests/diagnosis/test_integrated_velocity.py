"""A lateral velocity integrated from a_y errs slowly: its error makes no physics, and planted physics is found."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.vehicle.effects import CATALOGUE, Term
from tests.diagnosis.recordings import bare_objective, candidates_of, driven, light_evidence, noisy, prepared

STD = 0.05  # [m/s], every two seconds another error


def objective(kind: str, *terms: Term) -> MarginalLikelihood:
    """Return the objective of a drive with slow errors in v_y, which is said to be of this kind."""
    plain = driven(3, terms, runs=6, seconds=6.0, spaced=7.0)
    rng, vy = np.random.default_rng(3), np.array(plain["vy"])
    for run in plain.segments():
        rows = np.arange(run.stop - run.start)
        knots = np.arange(0, len(rows) + 200, 200)
        vy[run] += np.interp(rows, knots, STD * rng.standard_normal(len(knots)))
    drive = noisy(plain, 3)
    columns = {**drive.columns, "vy": vy, "vy_std": np.full(len(vy), STD)}
    series = prepared(replace(drive, columns=columns, metadata=replace(drive.metadata, kinds={"vy": kind})))
    return bare_objective(light_evidence(replace(series, noise=series.stated_noise)))


def stiffness(of: MarginalLikelihood) -> tuple[Fit, float]:
    """Return the best stiffness of both axles and what cost it saves."""
    candidate = candidates_of(of, "tire_stiffness")[0]
    found = fit_parts(of, (Part(candidate, dict(candidate.starts[0])),))
    return found, of.cost(()) - of.cost(found.terms)


def test_slow_errors_of_an_integrated_velocity_make_no_soft_tyres():
    """The same samples, called measured, want a rear axle softer by a sixth, and would save millions."""
    _, trusted = stiffness(objective("measured"))
    found, saved = stiffness(objective("derived: v_y from a_y - v_x r"))
    assert trusted > 1e4
    assert saved < 30.0
    assert found.parts[0].values == pytest.approx({"front_scale": 1.0, "rear_scale": 1.0}, abs=0.01)


def test_soft_tyres_are_found_through_an_integrated_velocity():
    planted = CATALOGUE["tire_stiffness"]({"front_scale": 0.85, "rear_scale": 1.0})
    found, saved = stiffness(objective("derived: v_y from a_y - v_x r", planted))
    assert saved > 100.0
    assert found.parts[0].values == pytest.approx({"front_scale": 0.85, "rear_scale": 1.0}, abs=0.03)
