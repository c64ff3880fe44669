"""A match is said only where a big difference would have shown; steering held on purpose is no frozen sensor."""

from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.recording.cleaning import cleaned
from split_cli.diagnosis.recording.screening import unfit
from split_cli.diagnosis.search.candidates import build_candidates
from split_cli.diagnosis.search.term_tests import effect_to_noise_of_terms
from split_cli.diagnosis.statement.result import Detectable
from split_cli.diagnosis.verdict.power import (
    HiddenEffect,
    force_share,
    hidden_effects,
    hidden_in_words,
    is_blind,
    most_unseen_in_words,
    much_form_error_in_words,
    no_match_in_words,
    unseen_in_words,
)
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import LEFT_OPEN
from tests.factories import make_drive, one_run, road_car


def test_what_a_big_effect_would_make_is_hidden(nominal_objective, nominal_series):
    (grip,) = [one for one in build_candidates(road_car(), nominal_series) if one.label == "friction_scale"]
    value = 0.5 * (1.0 + grip.ranges["scale"].lower)
    less, more = (
        effect_to_noise_of_terms(nominal_objective, (CATALOGUE["friction_scale"]({"scale": one}),))
        for one in (value, 1.0 / value)
    )
    # Nobody knows to which side a hidden ratio would be; on the nominal grip's curve more of it does less.
    assert STANDARD.selection.above_noise < more < less
    (hidden,) = hidden_effects(nominal_objective, [grip], 1.01 * less)
    assert (hidden.term, hidden.parameter, hidden.value) == ("friction_scale", "scale", pytest.approx(value))
    said = no_match_in_words(hidden, 1.01 * less, road_car())
    assert "friction scale with scale" in said and "halves of the simulation" in said
    assert "friction scale with scale" in hidden_in_words([hidden])
    (hidden,) = hidden_effects(nominal_objective, [grip], 0.99 * less)
    assert hidden.value == pytest.approx(1.0 / value)
    assert hidden_effects(nominal_objective, [grip], 0.99 * more) == ()
    assert hidden_effects(nominal_objective, [grip], 0.0) == () and hidden_in_words(()) == ""


def test_nobody_is_advised_to_do_what_the_file_says_was_done():
    """A calibrated file, or one whose tyres the drives leave open, was advised to be calibrated after every run."""
    hidden = HiddenEffect("cg_shift", "dx", -0.23, 0.34)
    fitted = road_car(origins={"rear_tire.B": "calibrated"})
    tried = road_car(notes={"front_tire.B": LEFT_OPEN})
    for car, advised in ((road_car(), True), (fitted, False), (tried, False)):
        for said in (no_match_in_words(hidden, 41.0, car), most_unseen_in_words(car), much_form_error_in_words(car)):
            assert ("split calibrate" in said) is advised
            assert "rive " in said  # what is left to do
    assert "CG shift with dx = -0.23 m would" in no_match_in_words(hidden, 41.0, fitted)


def test_an_effect_that_would_have_been_named_does_not_hide(nominal_objective, nominal_series):
    (inertia,) = [one for one in build_candidates(road_car(), nominal_series) if one.label == "yaw_inertia"]
    # Half of the way to the nearer bound is what is asked for; a gap of any size is larger than that effect.
    limits = inertia.ranges["scale"]
    nearer = min((limits.lower, limits.upper), key=lambda end: abs(end - 1.0))
    big = 1.0 + STANDARD.abstention.greater_part * (nearer - 1.0)
    size = effect_to_noise_of_terms(nominal_objective, (inertia.build({"scale": big}),))
    assert size > STANDARD.selection.above_noise

    def hides(scale: float | None = None) -> bool:
        known = [] if scale is None else [Detectable("yaw_inertia", {"scale": (scale, "1")})]
        return bool(hidden_effects(nominal_objective, [inertia], 2.0 * size, known))

    assert hides()
    # Named from half of that on, to either side, it cannot hide; named from twice that on, it can.
    assert not hides(1.0 + 0.5 * (big - 1.0)) and not hides(1.0 - 0.5 * (big - 1.0))
    assert hides(1.0 + 2.0 * (big - 1.0))


def test_a_share_of_the_forces_is_that_of_the_force_itself(nominal_objective):
    """Mass that is a tenth more asks for a tenth more of every force; twice the effect is twice the share."""

    def share(term: str, **parameters: float) -> float:
        return force_share(nominal_objective, CATALOGUE[term](parameters))

    # The motion's own force is noisy and the term's is averaged over 2 s: a share is below the plain ratio.
    assert 0.03 < share("mass", scale=1.1) < 0.1
    once, twice = share("yaw_inertia", scale=1.05), share("yaw_inertia", scale=1.05**2)
    assert twice == pytest.approx(2.0 * once, rel=0.1)
    # A wheel turned by 0.02 rad all along adds B C D 0.02 N at the front axle, until its force levels off.
    steady, late = share("steer_offset", offset=0.02), share("steer_delay", delay=0.02)
    assert late < steady, "what comes late is made up for within two seconds"


def test_what_no_size_would_show_is_told_and_most_of_it_leaves_no_match():
    seen, unseen = Detectable("mass", {"scale": (1.1, "1")}), Detectable("steer_offset", {})
    assert unseen_in_words([seen]) == "" and "car can have: steer offset." in unseen_in_words([seen, unseen])
    assert not is_blind([], STANDARD) and not is_blind([seen, unseen], STANDARD)
    assert is_blind([seen, unseen, unseen], STANDARD)


def circles(noise: float, *, frozen: bool = False) -> Drive:
    """Return a minute at a constant steer angle while speed rises; frozen, the car turns to both sides."""
    t = 0.01 * np.arange(6000)
    speed = 5.0 + 8.0 * t / 60.0
    r = 0.03 * speed / (2.7 + 0.003 * speed**2) * (np.sin(0.5 * t) if frozen else 1.0)
    rng = np.random.default_rng(5)
    columns = {
        "t": t,
        "vx": speed + rng.normal(0.0, noise, 6000),
        "vy": rng.normal(0.0, noise, 6000),
        "r": r + rng.normal(0.0, 0.1 * noise, 6000),
        "T": 100.0 * np.sin(t),
        "delta": np.full(6000, 0.03),
    }
    return one_run(columns, 0.01, "circles.parquet")


def test_a_steer_angle_held_on_purpose_is_not_frozen():
    assert not any("never changes" in reason for reason in unfit(circles(0.02), road_car()))
    assert any("delta never changes" in reason for reason in unfit(circles(0.02, frozen=True), road_car()))
    kept, notes = cleaned(circles(0.02))
    assert len(kept) == 6000 and not notes


def test_torque_of_pedals_is_not_taken_for_torque_of_motion():
    drive = make_drive(3, 1, 4.0, 0.01)
    by_pedals = "derived: torque from throttle by a map to 900 N m and brake times 1 N m a unit"
    by_motion = "derived: torque from measured a_x by the nominal model of brake_car"
    unknown = "derived"
    for kind, pedals, motion in (
        (by_pedals, True, False),
        (by_motion, False, True),
        (unknown, False, True),
        ("command", False, False),
    ):
        one = replace(drive, metadata=replace(drive.metadata, kinds={"T": kind}))
        assert one.metadata.torque_is_from_pedals == pedals
        assert one.metadata.torque_follows_motion == motion
