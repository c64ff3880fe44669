"""A term is named, and rivals excused, only beyond the model-form error of what acts beside it, and beyond chance."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.innovations.effect_to_noise import effects_to_noise_of
from split_cli.diagnosis.innovations.objective import DiscrepancyPosterior, MarginalLikelihood
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.remainder.structure import term_allowances
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.form_error import form_error_columns, saved_beside_form_error
from split_cli.diagnosis.search.rivals import rivals_of
from split_cli.diagnosis.search.selection import explaining_as_well
from split_cli.diagnosis.search.term_tests import is_form_error, over_form_error, term_p, term_size
from tests.diagnosis.recordings import INFLATION, NAMES, candidates_of, named, objective_with, planted, selected

DISCREPANCY = "discrepancy to noise"
VARIED = "varied discrepancy"


def ignorant(objective: MarginalLikelihood) -> DiscrepancyPosterior:
    """Return knowledge of a simulation that shows nothing beyond the nominal model."""
    count = objective.discrepancy.columns(objective.evidence[0].series).shape[2]
    return DiscrepancyPosterior(np.zeros(count), np.eye(count))


def test_a_further_term_no_larger_than_a_form_error_is_not_named():
    """A little steering offset beside a third of the inertia more: a tenth of its size, in its channel."""
    objective = objective_with(*planted(yaw_inertia=1.33, steer_offset=0.00035))
    selection = selected(objective, "yaw_inertia", "steer_offset")
    assert named(selection) == {"yaw_inertia"}
    assert "steer_offset" in selection.history[-1] and "model-form error" in selection.history[-1]
    # Alone, as large as it is, it would be named.
    alone = objective_with(*planted(steer_offset=0.00035))
    assert named(selected(alone, "yaw_inertia", "steer_offset")) == {"steer_offset"}


def test_beside_an_instrument_a_term_of_the_car_needs_what_a_first_one_needs(pair):
    """A displaced sensor is no physics of which a single track could get a tenth wrong."""
    quiet = replace(pair, posterior=ignorant(pair), memo={DISCREPANCY: np.zeros(3)})
    allowed, further = STANDARD.allowances.term, STANDARD.allowances.unnamed
    size, some = np.array([1.0, 0.0, 0.0]), np.full(3, 0.01)
    assert term_allowances(quiet) == pytest.approx(np.full(3, allowed)) and allowed < 0.9 * further
    for share, alone in ((0.9, True), (1.1, False)):
        assert (over_form_error(quiet, share * allowed * size, np.zeros(3)) < 1.0) is alone
        assert over_form_error(quiet, share * allowed * size, some) < 1.0
    assert over_form_error(quiet, 1.1 * further * size, some) > 1.0
    # Against the bare nominal model nobody knows what the file gets wrong.
    bare = replace(quiet, posterior=None)
    assert over_form_error(bare, 0.9 * further * size, np.zeros(3)) < 1.0


def test_a_force_is_wrong_by_a_share_of_itself_however_well_a_gyroscope_sees_it(pair):
    """A side force at the front that is 20 times the noise of r: along the car it would be this many times v_x's."""
    quiet = replace(pair, posterior=ignorant(pair), memo={DISCREPANCY: np.zeros(3)})
    car, noise = pair.evidence[0].vehicle, pair.evidence[0].series.stated_noise
    side_force = 20.0 * noise[2] * car.yaw_inertia / car.cg_to_front_axle  # [N s]
    sizes = np.array([0.0, side_force / car.mass / noise[1], 20.0])
    allowed = STANDARD.selection.form_error_across * side_force / car.mass / noise[0]
    assert STANDARD.allowances.unnamed < allowed < 0.5 * STANDARD.selection.form_error_across * sizes[2]
    along = np.array([1.0, 0.0, 0.0])
    assert over_form_error(quiet, along, sizes) == pytest.approx(1.0 / allowed)
    # A force along the car moves the yaw rate by no more than its own ratio: nobody knows its lever arm.
    turning = np.array([0.0, 0.0, 1.0])
    assert over_form_error(quiet, turning, 20.0 * along) == pytest.approx(
        1.0 / (20.0 * STANDARD.selection.form_error_across)
    )


def test_evidence_for_a_further_term_is_what_it_saves_beyond_a_form_error_of_the_shared_discrepancy(pair):
    """No dictionary is exact: its columns times a tenth, their weights integrated out."""
    rng, count = np.random.default_rng(7), len(pair.weight)
    columns = 3.0 * rng.standard_normal((count, 18))
    share = STANDARD.selection.form_error_share
    objective = replace(pair, posterior=ignorant(pair), basis=np.zeros((count, 0)), memo={VARIED: columns})
    noise, like, other = rng.standard_normal(count), columns @ rng.standard_normal(18), rng.standard_normal(count)

    def left(rows: np.ndarray) -> Fit:
        return Fit((), float(rows @ rows), rows, np.empty((count, 0)))

    def saved(rows: np.ndarray) -> float:
        return saved_beside_form_error(objective, left(rows), left(noise))

    # Of columns Q R with orthonormal Q, what lies beside them stays, and what is along them is divided.
    along, triangle = np.linalg.qr(share * columns)
    inverse = np.linalg.inv(np.eye(18) + triangle @ triangle.T) - np.eye(18)

    def cost(rows: np.ndarray) -> float:
        return float(rows @ rows + (along.T @ rows) @ inverse @ (along.T @ rows))

    for rows in (noise + share * like, noise + other):
        assert saved(rows) == pytest.approx(cost(rows) - cost(noise), rel=1e-6)
    # What resembles it saves no more than its eighteen weights do by chance; anything else saves all but as much.
    assert left(noise + share * like).cost - left(noise).cost > 100.0 * saved(noise + share * like)
    assert saved(noise + other) == pytest.approx(left(noise + other).cost - left(noise).cost, rel=0.05)


def test_a_term_that_settles_a_channel_is_no_form_error_of_a_large_one_elsewhere(pair):
    """What was left in v_x is a slow wave of five times the noise: taken wholly, or but half of it."""
    rng, count = np.random.default_rng(4), len(pair.weight)
    noise, wave = rng.standard_normal(count).reshape(-1, 3), np.zeros((count // 3, 3))
    wave[:, 0] = 5.0 * np.sin(np.arange(count // 3) / 50.0)

    def left(share: float) -> Fit:
        return Fit((), 0.0, (noise + share * wave).ravel(), np.empty((count, 0)))

    size, other = np.array([0.5, 0.0, 0.0]), np.array([0.0, 10.0, 0.0])
    for before, after, refused in ((1.0, 0.0, False), (1.0, 0.4, False), (1.0, 0.5, True), (0.3, 0.0, True)):
        assert is_form_error(pair, size, other, left(before), left(after), STANDARD.selection) == refused
    # Not larger than a model-form error in that channel anyway, or of what acts in the same.
    assert not is_form_error(pair, size, 0.7 * other, left(1.0), left(1.0), STANDARD.selection)
    assert is_form_error(pair, size, np.array([10.0, 0.0, 0.0]), left(1.0), left(0.0), STANDARD.selection)


def test_what_settles_a_channel_is_asked_beside_the_form_error_of_what_acts_there(pair, chosen_pair):
    """A drag that is wrong in v_x by its own shape leaves more than a wave that another term takes wholly."""
    rng, chosen = np.random.default_rng(4), chosen_pair.chosen
    noise, wave = rng.standard_normal((len(pair.weight) // 3, 3)), np.zeros((len(pair.weight) // 3, 3))
    wave[:, 0] = 5.0 * np.sin(np.arange(len(wave)) / 50.0)
    columns = form_error_columns(pair, chosen)
    wrong = (columns @ rng.standard_normal(columns.shape[1])).reshape(-1, 3)
    wrong *= 5.0 / np.sqrt(np.mean(wrong[:, 0] ** 2))
    assert np.mean(wave**2) * STANDARD.selection.fair_share < np.mean(wrong[:, 0] ** 2)
    size, other = np.array([0.5, 0.0, 0.0]), np.array([0.0, 10.0, 0.0])

    def refused(parts: tuple[Part, ...], after: float) -> bool:
        before, still = (replace(chosen, parts=parts, residuals=(noise + wrong + k * wave).ravel()) for k in (1, after))
        return is_form_error(pair, size, other, before, still, STANDARD.selection)

    assert refused((), 0.0) and not refused(chosen.parts, 0.0) and refused(chosen.parts, 0.6)


def test_a_term_is_allowed_a_share_of_the_shared_discrepancy_in_its_channel(pair, chosen_pair):
    fit = chosen_pair.chosen
    saved = fit_parts(pair, fit.parts[1:]).cost - fit.cost
    (evidence,) = pair.evidence
    sizes = effects_to_noise_of(evidence, evidence.at, fit.terms, fit.terms[1:])

    def p_value(discrepancy: np.ndarray) -> float:
        objective = replace(pair, posterior=ignorant(pair), memo={DISCREPANCY: discrepancy})
        return term_p(objective, fit, 0, saved, INFLATION)

    assert p_value(np.zeros(3)) < 1e-10
    assert p_value(sizes.max() / STANDARD.allowances.discrepancy_share * np.ones(3)) > 0.4
    # Much the shared discrepancy in another channel is no excuse.
    elsewhere = np.where(np.arange(3) == np.argmax(sizes), 0.0, 1e3)
    assert p_value(elsewhere) < 1e-10


def test_what_could_be_form_error_or_chance_explains_as_well(pair, chosen_pair):
    k = 0
    saved = chosen_pair.without[k].cost - chosen_pair.chosen.cost
    (rival, *_) = chosen_pair.rivals[k]
    share = max(STANDARD.allowances.unnamed / term_size(pair, chosen_pair.chosen, k), 0.1) ** 2

    def as_well(excess: float, z: float) -> bool:
        return bool(explaining_as_well(pair, chosen_pair, k, [replace(rival, excess=excess, z=z)]))

    # By model-form error: whatever the standard error.
    assert as_well(0.99 * share * saved, 50.0) and not as_well(1.01 * share * saved, 50.0)
    # By chance: within 2.58 standard errors, and by no more than 20 % of what the term saves.
    assert as_well(0.19 * saved, 2.5) and not as_well(0.19 * saved, 2.7) and not as_well(0.21 * saved, 1.0)


def test_the_p_value_of_a_term_grows_with_what_the_simulation_shows_against_itself(pair, chosen_pair):
    fit = chosen_pair.chosen
    k = next(k for k, part in enumerate(fit.parts) if part.candidate.term == "aero_drag")
    saved = fit_parts(pair, fit.parts[:k] + fit.parts[k + 1 :]).cost - fit.cost
    plain = term_p(pair, fit, k, saved, INFLATION)
    forgiving, other = (
        term_p(replace(pair, term_floors={name: 2.0 * saved}), fit, k, saved, INFLATION)
        for name in ("aero_drag", "mass")
    )
    assert plain < 1e-10 and forgiving > 0.9
    assert other == plain


def test_form_error_widens_chance_and_is_not_counted_twice(pair, chosen_pair):
    fit = chosen_pair.chosen
    k = next(k for k, part in enumerate(fit.parts) if part.candidate.term == "aero_drag")
    saved = fit_parts(pair, fit.parts[:k] + fit.parts[k + 1 :]).cost - fit.cost
    floors = {"aero_drag": 0.5 * saved}

    def p_value(**known) -> float:
        return term_p(replace(pair, **known), fit, k, saved, INFLATION)

    widened = saved / 30.0
    # The same as chance that is so wide, unless chance is wider itself.
    assert p_value(form_error_inflation=widened) == pytest.approx(term_p(pair, fit, k, saved, widened), rel=1e-12)
    assert p_value(form_error_inflation=widened) > 1e-8 > p_value(form_error_inflation=INFLATION) == p_value()
    both = p_value(form_error_inflation=widened, term_floors=floors)
    assert both == max(p_value(form_error_inflation=widened), p_value(term_floors=floors))
    assert both < term_p(replace(pair, term_floors=floors), fit, k, saved, widened)
    # Beside other terms each of three stands for itself: the floor is of what is saved without any of their error.
    known = replace(pair, form_error_inflation=widened, term_floors=floors)
    for apart, assumed in ((0.9, 0.8), (0.4, 0.3), (0.9, 0.005)):
        ways = (
            p_value(term_floors=floors),
            term_p(replace(pair, form_error_inflation=widened), fit, k, apart * saved, INFLATION),
            term_p(pair, fit, k, assumed * saved, INFLATION),
        )
        together = term_p(known, fit, k, saved, INFLATION, (apart * saved, assumed * saved))
        assert together == pytest.approx(max(ways), rel=1e-9)


def test_rivals_are_as_far_off_as_form_error_lets_them_be(pair, chosen_pair):
    candidates = tuple(candidates_of(pair, *NAMES))
    free = STANDARD.altered("selection", price=0.0)
    explore = Explorer(replace(pair, form_error_inflation=10.0 * INFLATION, policy=free), candidates, INFLATION)
    (near, *_), _ = rivals_of(explore, chosen_pair.chosen, 0, chosen_pair.without[0])
    (far, *_), _ = rivals_of(replace(explore, objective=pair), chosen_pair.chosen, 0, chosen_pair.without[0])
    assert far.excess == pytest.approx(10.0 * near.excess, rel=1e-9) and far.excess > 0.0
    assert far.z == pytest.approx(near.z, rel=1e-6)
