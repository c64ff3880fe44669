"""Grip that is lost on a stretch of the road: which stretch is named, and how much of its saving is chance."""

import numpy as np
import pytest
from scipy import stats

from split_cli.diagnosis.search.fitting import SEARCHED_PLACES, Part, fit_parts
from split_cli.diagnosis.search.rivals import rivals_of
from split_cli.diagnosis.search.selection import nothing
from split_cli.vehicle.effects import CATALOGUE
from tests.diagnosis.recordings import LAP, candidates_of, explorer, named, objective_with, selected


def test_the_best_of_many_places_has_to_save_more_where_there_is_form_error():
    """The stretch with most of what model-form errors, of many: it saves no more than it is allowed by chance."""
    rng = np.random.default_rng(3)
    rows, lengths = 1000, range(5, 100)
    best = []
    for _ in range(200):
        sums = np.concatenate([[0.0], np.cumsum(rng.standard_normal(rows))])
        best.append(max(float(np.max((sums[n:] - sums[:-n]) ** 2)) / n for n in lengths))
    assert np.mean(stats.chi2.sf(best, 1.0 + SEARCHED_PLACES) < 0.05) < 0.08
    assert np.mean(stats.chi2.sf(best, 6.0) < 0.05) > 0.2


def test_a_stretch_over_nearly_the_whole_lap_is_none():
    """Grip lost on 380 of 400 m: the whole road has less of it, as far as names go."""
    objective = objective_with(CATALOGUE["friction_patch"]({"scale": 0.8, "s_start": 10.0, "s_end": 390.0}))
    patches = candidates_of(objective, "friction_patch")
    for fit in explorer(objective, *patches)(nothing(objective)):
        values = fit.parts[0].values
        assert (values["s_end"] - values["s_start"]) % LAP <= 0.8 * LAP
    selection = selected(objective, *patches, *candidates_of(objective, "friction_scale"))
    assert named(selection) == {"friction_scale"}


def test_a_stretch_is_named_and_not_the_whole_road():
    objective = objective_with(CATALOGUE["friction_patch"]({"scale": 0.7, "s_start": 120.0, "s_end": 220.0}))
    candidates = candidates_of(objective, "friction_patch", "friction_scale")
    assert named(selected(objective, *candidates)) == {"friction_patch"}


def test_a_stretch_that_lies_elsewhere_than_it_saves_most_is_searched_for_again():
    """Ends of a stretch do not move over ground where it does nothing: what was found first put them there."""
    objective = objective_with(CATALOGUE["friction_patch"]({"scale": 0.7, "s_start": 120.0, "s_end": 220.0}))
    patch = candidates_of(objective, "friction_patch")[0]
    explore, base = explorer(objective, patch), nothing(objective)
    elsewhere = fit_parts(objective, [Part(patch, {"scale": 0.9, "s_start": 20.0, "s_end": 60.0})])
    _, (again,) = rivals_of(explore, elsewhere, 0, base)
    assert again.excess < -100.0 and again.fit.parts[0].values["s_end"] == pytest.approx(220.0, abs=0.02 * LAP)
    # Where it lies where it should, it is no rival of itself.
    assert rivals_of(explore, again.fit, 0, base) == ((), ())
