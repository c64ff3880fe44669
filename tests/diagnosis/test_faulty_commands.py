"""A promised size holds for drives that have the effect: they are filtered otherwise than those without."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from split_cli.diagnosis.innovations.case import DiagnosisCase, gather_case
from split_cli.diagnosis.innovations.objective import MarginalLikelihood, build_objective
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import nothing
from split_cli.diagnosis.search.term_tests import term_p
from split_cli.diagnosis.verdict.detectable import detection_limits
from split_cli.diagnosis.verdict.faulty_commands import faulty, saving_on_faulty_recordings
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.single_track import SingleTrack
from tests.diagnosis.recordings import INFLATION, LEVEL, candidates_of, driven, noisy, prepared
from tests.factories import road_car

REACH = STANDARD.comparison.reach
MUCH = 600.0  # form-error inflation at which only a large effect has a name


def at_the_limit(seed: int) -> Drive:
    """Return a drive with twice the usual steer angles on six tenths of the grip that the vehicle file states."""
    slippery = (CATALOGUE["friction_scale"]({"scale": 0.6}, ""),)
    drive = driven(seed, slippery, runs=8, steer=lambda inputs, step: 2.0 * inputs)
    return noisy(replace(drive, columns={**drive.columns, "delta": 2.0 * drive["delta"]}), seed)


def asked_for_more(drive: Drive, gain: float) -> Drive:
    """Return a drive of the same motion by a car whose steering has that gain."""
    return replace(drive, columns={**drive.columns, "delta": drive["delta"] / gain})


def case_with(gain: float) -> DiagnosisCase:
    real, simulated = asked_for_more(at_the_limit(31), gain), at_the_limit(32)
    return gather_case(road_car(), [prepared(real, "real"), prepared(simulated, "sim")])


def objective_of(case: DiagnosisCase) -> MarginalLikelihood:
    objective = build_objective(case.real, case.posterior, case.discrepancy, case.keep)
    return replace(objective, form_error_inflation=MUCH)


@pytest.fixture(scope="module")
def sound() -> DiagnosisCase:
    return case_with(1.0)


@pytest.fixture(scope="module")
def promised(sound) -> tuple[float, float]:
    """Gains that are promised with the filter of the sound drive, and with that of drives that have them."""
    objective = objective_of(sound)
    candidates = candidates_of(objective, "steer_gain")
    ways = None, partial(saving_on_faulty_recordings, case=sound, reach=REACH)
    found = [detection_limits((objective,), candidates, INFLATION, LEVEL, way) for way in ways]
    before, after = (one.parameters["gain"][0] for (one,) in found)
    return before, after


@pytest.fixture(scope="module")
def as_promised(promised, sound) -> MarginalLikelihood:
    return faulty_objective(1.0 / promised[1], sound)


def faulty_objective(gain: float, sound: DiagnosisCase) -> MarginalLikelihood:
    """Return the objective of a drive that has a steering gain, with what the simulation taught."""
    return objective_of(replace(case_with(gain), posterior=sound.posterior))


def p_of_fault(objective: MarginalLikelihood, gain: float) -> float:
    """Return the p value of a steering gain, fitted on a drive that has it."""
    (candidate,) = candidates_of(objective, "steer_gain")
    fit = fit_parts(objective, (Part(candidate, {"gain": gain}),))
    return term_p(objective, fit, 0, nothing(objective).cost - fit.cost, INFLATION)


def rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_a_drive_passes_that_has_what_is_promised_by_its_own_filter_but_not_by_the_sound_ones(
    promised, as_promised, sound
):
    """It holds to either side: a steering that turns more than it is asked for has the smaller commands."""
    before, after = 1.0 / promised[0], 1.0 / promised[1]
    assert p_of_fault(faulty_objective(before, sound), before) > LEVEL > p_of_fault(as_promised, after)


def test_what_a_fault_saves_is_what_it_saves_of_a_drive_that_has_it(promised, as_promised, sound):
    (candidate,) = candidates_of(as_promised, "steer_gain")
    term = candidate.build({"gain": 1.0 / promised[1]})
    rows = [as_promised.whiten(as_promised.raw_residual(terms)) for terms in ((), (term,))]
    saved, _ = saving_on_faulty_recordings(objective_of(sound), term, case=sound, reach=REACH)
    assert saved == pytest.approx(rows[0] @ rows[0] - rows[1] @ rows[1], rel=1e-3)


def test_without_a_simulation_recordings_that_have_a_fault_may_keep_other_rows():
    case = gather_case(road_car(), [prepared(at_the_limit(31), "real")])
    every_other = tuple(np.arange(len(mask)) % 2 == 0 for mask in case.keep)
    term = CATALOGUE["steer_offset"]({"offset": 0.05}, "")
    saved, _ = saving_on_faulty_recordings(
        build_objective(case.real, None, case.discrepancy, every_other), term, case=case, reach=REACH
    )
    faulty_case = case.recorded_as([faulty(one, term) for one in case.real], REACH)
    there = build_objective(faulty_case.real, None, case.discrepancy, faulty_case.keep)
    assert len(there.weight) > 3 * sum(mask.sum() for mask in every_other)
    assert saved == pytest.approx(there.cost(()) - there.cost((term,)), rel=1e-9)


@pytest.mark.parametrize(
    ("kind", "values"),
    [
        ("steer_gain", {"gain": 0.8}),
        ("steer_delay", {"delay": 0.05}),
        ("steer_offset", {"offset": 0.02}),
        ("steer_lag", {"tau": 0.05}),
        ("steer_backlash", {"width": 0.02}),
    ],
)
def test_the_faulty_car_makes_of_the_faulty_commands_what_was_done(sound, kind, values):
    (one,) = sound.real
    fault = SingleTrack(one.vehicle, (CATALOGUE[kind](values, ""),))
    asked, done = faulty(one, fault.terms[0]), one.series.steer_angle
    (_, made), (_, plain) = (series.inputs(fault, series.smooth) for series in (asked, one.series))
    assert rms(made - done) < 0.25 * rms(plain - done)
