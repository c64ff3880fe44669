"""Variants of a term that one step does not tell apart, told by open-loop simulation."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.objective import MarginalLikelihood
from split_cli.diagnosis.innovations.rollouts import HORIZONS, RolloutErrors
from split_cli.diagnosis.remainder.flexible import flexible_rows
from split_cli.diagnosis.remainder.structure import Structure, build_structure
from split_cli.diagnosis.search import variant_choice
from split_cli.diagnosis.search.candidates import Range
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Part, fit_parts
from split_cli.diagnosis.search.selection import Selection, nothing, with_chosen
from split_cli.diagnosis.search.variant_choice import open_loop_errors, with_variants_by_rollout
from tests.diagnosis.recordings import INFLATION, candidates_of, objective_with, planted, selected


@pytest.fixture(scope="module")
def objective() -> MarginalLikelihood:
    return objective_with(*planted(load_transfer=0.9))


@pytest.fixture(scope="module")
def structure(objective) -> Structure:
    return build_structure(objective, [flexible_rows(one, objective.discrepancy) for one in objective.evidence])


@pytest.fixture(scope="module")
def variants(objective) -> list:
    """With room for all the height that the wrong one wants: at the end of its search it would have no name."""
    wide = Range(0.0, 20.0, 0.01)
    several = candidates_of(objective, "load_transfer")
    return [replace(one, ranges={"cg_height": wide}) for one in several if "tau" not in one.ranges]


@pytest.fixture(scope="module")
def wrong(objective, variants) -> Selection:
    """A selection that has taken the variant that moves the peak alone."""
    selection = selected(objective, *variants)
    peak = next(one for one in variants if one.variant == "peak")
    fit = fit_parts(objective, (Part(peak, dict(peak.starts[0])),))
    return with_chosen(Explorer(objective, tuple(variants), INFLATION), selection, fit)


def test_the_truth_runs_freely_as_far_as_noise_lets_it(objective, variants, wrong):
    selection = selected(objective, *variants)
    assert selection.chosen.parts[0].candidate.variant == ""
    base, true, peak = open_loop_errors(objective, [nothing(objective), selection.chosen, wrong.chosen])
    assert 0.8 < true < 1.2
    assert base > 1.5 * true and peak > 1.1 * true


def test_a_lag_that_a_fit_has_shrunk_to_nothing_is_none(objective):
    """Beside other terms a refit may end there; no step could follow it."""
    none = nothing(objective)
    lags = [Part(one, {"tau": 0.0}) for one in candidates_of(objective, "steer_lag", "drive_lag")]
    assert len(lags) == 2
    without, shrunk = open_loop_errors(objective, [none, replace(none, parts=tuple(lags))])
    assert shrunk == without


def test_an_error_is_the_geometric_mean_of_rms_over_what_noise_makes(objective, monkeypatch):
    """Twice the noise in every channel at every horizon is two, whatever the units."""
    floor = np.ones((7, 3, 3)) * np.array([1.0, 1e-4, 1e-6])

    def errors(one, stages, held):
        squared = {name: (4.0 if name == "0" else 9.0) * floor for name in stages}
        return RolloutErrors(HORIZONS, np.arange(7.0), squared, floor)

    monkeypatch.setattr(variant_choice, "roll_out_stages", errors)
    np.testing.assert_allclose(open_loop_errors(objective, [nothing(objective), nothing(objective)]), [2.0, 3.0])


def test_the_variant_that_runs_takes_the_place_of_one_that_does_not(structure, variants, wrong):
    """The wrong variant leaves something without a name; the right one is among what explains the data as well."""
    found = with_variants_by_rollout(structure, variants, wrong, INFLATION)
    assert found.chosen.parts[0].candidate.variant == ""
    assert found.named == (True,) and found.chosen.cost < wrong.chosen.cost
    assert "of its open-loop error" in found.history[-1] and found.first_p == wrong.first_p


def test_where_nothing_is_left_without_a_name_one_step_decides(objective, structure, variants):
    selection = selected(objective, *variants)
    assert with_variants_by_rollout(structure, variants, selection, INFLATION) is selection


def test_a_variant_that_runs_as_well_takes_no_place(structure, variants, wrong, monkeypatch):
    for error, taken in ((0.95, False), (0.85, True)):
        monkeypatch.setattr(
            variant_choice, "open_loop_errors", lambda objective, fits, e=error: [1.0, *[e] * len(fits[1:])]
        )
        found = with_variants_by_rollout(structure, variants, wrong, INFLATION)
        assert (found is not wrong) == taken


def test_no_variant_takes_a_place_that_would_lose_a_name(structure, variants, wrong):
    named_twice = replace(wrong, named=(True, True))
    assert with_variants_by_rollout(structure, variants, named_twice, INFLATION) is named_twice
