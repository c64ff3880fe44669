"""Words for findings: every term and variant, both signs, small and large cars, what would tell terms apart."""

import re
from dataclasses import replace

import pytest

from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import Finding, Location, ParameterEstimate, Place, RemainderTest
from split_cli.diagnosis.statement.sentences import (
    acting_in_a_part,
    sentence_for,
    separations,
    summarise,
    unexplained_part,
)
from split_cli.diagnosis.statement.separation import (
    exact_mimics,
    look_alike,
    separable_by_lacking,
    separation,
    without_doubles,
)
from split_cli.diagnosis.statement.wording import amount, number, percent, term_name
from split_cli.vehicle.effects import CATALOGUE
from tests.factories import road_car

VARIANTS = [(term, variant) for term, kind in CATALOGUE.items() for variant in kind.variants]
#: Words for more than in the simulation, and for less; terms that have no other side are not here.
SIDES = {
    "friction_scale": ("higher", "lower"),
    "friction_patch": ("higher", "lower"),
    "grip_fade": ("fades", "grows"),
    "tire_stiffness": ("stiffer", "softer"),
    "aero_downforce": ("more", "less"),
    "aero_drag": ("more", "less"),
    "rolling_resistance": ("more", "less"),
    "wind": ("along", "against"),
    "road_grade": ("climbs", "falls"),
    "road_bank": ("to the left", "to the right"),
    "drive_gain": ("too strong", "too weak"),
    "steer_gain": ("more", "less"),
    "steer_offset": ("to the left", "to the right"),
    "cg_shift": ("further forward", "further back"),
    "mass": ("heavier", "lighter"),
    "yaw_inertia": ("larger", "smaller"),
    "sensor_lever_arm": ("further forward", "further back"),
    "sensor_misalignment": ("counter-clockwise", " clockwise"),
}


def estimate(value: float, error: float, unit: str = "1") -> ParameterEstimate:
    return ParameterEstimate(value, error, unit, (value - 2.0 * error, value + 2.0 * error))


def planted(term: str, variant: str, size: float, sign: float) -> dict[str, ParameterEstimate]:
    """Return parameters `size` away from where the term vanishes, known to a tenth of that."""
    kind = CATALOGUE[term]
    out = {}
    for name, unit in kind.parameter_units(variant).items():
        if name in ("s_start", "s_end", "wavelength", "phase", "tau") and name not in kind.neutral:
            out[name] = estimate({"s_start": 310.0, "s_end": 420.0, "wavelength": 55.0}.get(name, 30.0), 1.0, unit)
        else:
            neutral = kind.neutral.get(name, 0.0)
            out[name] = estimate(neutral + sign * size, 0.1 * size, unit)
    return out


@pytest.mark.parametrize(("term", "variant"), VARIANTS)
@pytest.mark.parametrize("size", [0.00302, 0.18, 41.0])
def test_every_term_reads_right_for_either_sign(term, variant, size):
    """Sizes as of a model car, of a full-size one, and absurdly large."""
    told = {sign: sentence_for(term, variant, planted(term, variant, size, sign), ()) for sign in (1.0, -1.0)}
    for sentence in told.values():
        assert sentence.endswith(".") and "{" not in sentence and "nan" not in sentence
        # Never a number that says nothing, never a sign that a word should say.
        assert not re.search(r"(?<![\d.,])0\.0+(?![\d])", sentence)
        # Ids have underscores; a reader gets words.
        assert "_" not in sentence
        assert "95 %" in sentence or term == "grip_fade"
    if term in SIDES and variant != "wave":
        more, less = SIDES[term]
        assert more in told[1.0] and less in told[-1.0] and told[1.0] != told[-1.0]
        assert not re.search(r"-\d", told[-1.0])
    if CATALOGUE[term].exported:
        assert told[1.0].startswith("In reality ") and "the simulation lacks this effect" in told[1.0]
    else:
        assert told[1.0].startswith("The measurement, not the car: ")


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (amount(estimate(-0.00302, 0.00045, "m"), more="forward", less="back"), "3.02 mm back (95 %: 2.12 to 3.92 mm)"),
        (amount(estimate(0.213, 0.011, "m"), more="forward", less="back"), "0.213 m forward (95 %: 0.191 to 0.235 m)"),
        (
            amount(estimate(0.988, 0.011), neutral=1.0, share=True, more="more", less="less"),
            "1.2 % less (95 %: 3.4 % less to 1.0 % more)",
        ),
        # A narrow interval needs the digits it is reported in.
        (
            amount(estimate(0.98812, 0.00002), neutral=1.0, share=True, more="more", less="less"),
            "1.1880 % less (95 %: 1.1840 to 1.1920 %)",
        ),
        (amount(estimate(0.0234, 0.02, "s"), one_sided=True), "23 ms (95 %: 0 to 63 ms)"),
        # Of what is hardly known, no more digits than its interval has.
        (
            amount(estimate(-0.00012, 0.0004, "m"), more="forward", less="back"),
            "0.12 mm back (95 %: 0.92 mm back to 0.68 mm forward)",
        ),
        (amount(estimate(4210.0, 300.0, "N")), "4,210 N (95 %: 3,610 to 4,810 N)"),
        (amount(ParameterEstimate(0.5, None, "1", (float("nan"),) * 2)), "0.500"),
        (number(0.0), "0.00"),
        (number(0.001234), "0.00123"),
        (number(12345.0), "12,345"),
        (percent(0.996), "over 99 %"),
        (percent(0.004), "less than 1 %"),
        (percent(1.0), "100 %"),
        (term_name("cg_shift+steer_gain"), "CG shift and steer gain together"),
        (term_name("mass+steer_gain+wind"), "mass, steer gain and wind together"),
    ],
)
def test_amounts(said, expected):
    assert said == expected


def test_lost_grip_is_told_in_the_cars_own_forces():
    # By hand: the front brakes 0.66 of 0.6 of 4,000 N m at 0.31 m, 5,110 N of D = 7,900 N; sqrt(1 - 0.8 0.418).
    sentence = sentence_for("combined_slip", "", {"strength": estimate(0.8, 0.05)}, (), road_car())
    assert "the front axle loses 18 % of its lateral force at 60 % of the largest braking torque" in sentence


@pytest.mark.parametrize("term", CATALOGUE)
def test_every_declared_mimic_has_a_hint_or_is_exact(term):
    for mimic in CATALOGUE[term].mimics:
        assert mimic.exact != bool(mimic.separated_by), mimic
        assert mimic.when and set(mimic.terms.split("+")) <= set(CATALOGUE)
        assert set(mimic.variants) <= set(CATALOGUE[term].variants)


@pytest.mark.parametrize(("term", "variant"), VARIANTS)
def test_any_alternative_comes_with_what_would_tell(term, variant):
    others = [other for other in CATALOGUE if other != term] + ["cg_shift+tire_stiffness", "mass+drive_gain"]
    hints = separations(term, variant, others)
    assert len(hints) == len(others)
    for other, hint in zip(others, hints, strict=True):
        name, _, how = hint.partition(": ")
        assert name.lower() == term_name(other).lower() and len(how) > 8
        assert ("no recording can" in hint) == (other in exact_mimics(term, variant))


def test_declared_hints_come_before_those_of_the_kind():
    assert "torque step" in separation("steer_delay", "", "sensor_delay").hint
    assert separation("sensor_delay", "", "steer_delay").hint == separation("steer_delay", "", "sensor_delay").hint
    assert separation("steer_lag", "", "sensor_delay").hint == "a torque step"
    # Declared by the other alone.
    assert "position and yaw" in separation("cg_shift", "", "sensor_lever_arm").hint
    assert separation("mass", "", exact_mimics("mass", "")[0]).exact


def test_exactness_depends_on_the_variant():
    # Rolling resistance is a constant grade; a grade is none where an accelerometer feels it.
    assert exact_mimics("rolling_resistance", "") == ("road_grade",)
    assert exact_mimics("road_grade", "") == exact_mimics("road_grade", "stretch") == ()
    assert "accelerometer" in separation("road_grade", "", "rolling_resistance").hint
    assert "other direction" in separation("road_grade", "stretch", "rolling_resistance").hint
    assert exact_mimics("friction_scale", "") == () != exact_mimics("friction_scale", "curve")


def test_one_force_under_two_names_is_one_alternative():
    assert without_doubles(["mass", "road_grade", "rolling_resistance"]) == ["mass", "rolling_resistance"]
    assert without_doubles(["mass", "road_grade", "a+b"]) == ["mass", "road_grade", "a+b"]


def test_what_a_missing_channel_alone_would_tell_apart_is_declared_by_either():
    inertial = {"vx", "vy", "r", "ay", "yaw"}
    assert set(separable_by_lacking("sensor_lever_arm", "", inertial)) == {"cg_shift+tire_stiffness", "tire_stiffness"}
    assert set(separable_by_lacking("steer_delay", "", inertial)) == {"channel_delay"}
    assert set(separable_by_lacking("channel_delay", "r", inertial)) == {"steer_lag", "steer_delay"}
    assert set(separable_by_lacking("channel_delay", "vx", inertial)) == {"drive_lag", "drive_delay"}
    for term in ("sensor_lever_arm", "steer_delay", "channel_delay"):
        assert not separable_by_lacking(term, "", {*inertial, "X", "Y"})


def test_a_sentence_names_alternatives_in_words_with_the_id_once():
    parameters = {"delay": estimate(0.034, 0.002, "s")}
    sentence = sentence_for("steer_delay", "", parameters, ("steer_lag", "sensor_delay"))
    for name in ("steer lag (steer_lag)", "sensor delay (sensor_delay)"):
        assert sentence.count(name) == 1
    exact = sentence_for("mass", "", {"scale": estimate(1.1, 0.01)}, exact_mimics("mass", ""))
    assert "No recording can distinguish it from friction scale, drive gain, " in exact and "only F/m" in exact


def improvement() -> Improvement:
    def row(first: float) -> tuple[float, float, float]:
        return (first, 0.01, 0.001)

    last = HorizonErrors(2.0, row(0.54), row(0.014), row(0.3), row(0.02), row(1.0), row(0.013), {}, 100)
    return Improvement(*([row(0.1)] * 5), row(0.05), {}, (last,), {"physics": (0.97, 0.874, 1.0)})


def test_the_summary_says_what_where_and_whether_it_helps():
    finding = Finding("friction_patch", "", planted("friction_patch", "", 0.22, -1.0), 0.9, ("grip_fade",), "", 1.0)
    location = Location(
        {"longitudinal": 0.1, "front_lateral": 0.8, "rear_lateral": 0.1},
        (("s", 0.91), ("delta", 0.2)),
        {},
        Place(311.0, 421.0, 1200.0, "position", None, None),
        None,
        0.87,
        0.09,
    )
    said = " ".join(summarise("mismatch", (finding,), False, location, None, (), improvement()))
    for part in (
        "between s = 310 and 420 m grip is 22.0 % lower",
        "These data are explained as well by grip fade (grip_fade).",
        "mostly front lateral force (80 %). Track position alone explains 91 %",
        "87 % of the gap lies between s = 311 and 421 m, in 9 % of the samples",
        "the squared one-step error above the noise floor falls by 97 % (95 %: 87 to 100 %). After 2 s",
        "the error of v_x changes from 0.54 to 0.014 m/s (persistence: 1.0; noise floor: 0.013)",
    ):
        assert part in said


def test_held_out_time_without_the_gap_tells_nothing():
    """A patch that the last quarter of a drive does not touch: errors are at the noise floor already."""
    finding = Finding("friction_patch", "", planted("friction_patch", "", 0.22, -1.0), 0.9, (), "", 1.0)
    quiet = (0.011, 0.01, 0.001)
    last = HorizonErrors(2.0, *([quiet] * 5), (0.0105, 0.0098, 0.001), {}, 100)
    blind = Improvement(*([quiet] * 5), quiet, {}, (last,), {"physics": None})
    said = " ".join(summarise("mismatch", (finding,), improvement=blind))
    assert (
        "The held-out data show too little of the gap to tell whether the identified effects would reduce it." in said
    )
    assert not blind.shows_gap and improvement().shows_gap


def test_what_persistence_predicts_better_is_told_with_its_mean_error():
    """A force of 50 N too much on 1,000 kg is 0.1 m/s after 2 s: most of an error of 0.11 m/s."""
    car = replace(road_car(), mass=1000.0)
    last = HorizonErrors(
        2.0,
        (0.2, 0.3, 0.01),
        (0.11, 0.1, 0.01),
        *([(0.05, 0.2, 0.02)] * 3),
        (0.01, 0.01, 0.001),
        {},
        40,
        mean={"physics": (0.1, 0.0, 0.0)},
    )
    finding = Finding("friction_scale", "", planted("friction_scale", "", 0.5, -1.0), 0.9, (), "", 1.0)
    helped = Improvement(*([(0.1,) * 3] * 5), (0.05,) * 3, {}, (last,), {"physics": (0.5, 0.4, 0.6)})
    said = " ".join(summarise("mismatch", (finding,), improvement=helped, vehicle=car))
    assert "Persistence still predicts v_x better. The mean error of v_x is 0.10 m/s, 83 % of the squared" in said
    assert "as of 50 N of longitudinal force too much." in said and "mean error of v_y" not in said
    assert last.mean_share("before", 0) is None
    # A hundredth of the squared error is no force that lasts.
    little = replace(last, mean={"physics": (0.011, 0.0, 0.0)})
    said = " ".join(summarise("mismatch", (finding,), improvement=replace(helped, rollouts=(little,)), vehicle=car))
    assert "Persistence still predicts v_x better." in said and "mean error" not in said


@pytest.mark.parametrize(
    ("after", "change", "told"),
    [
        ((0.1, 0.33, 0.247), (0.0, 1.0, 3.0), "in v_y (0.33 instead of 0.15 m/s) and r (0.25 instead of 0.030 rad/s)"),
        ((0.1, 0.18, 0.05), (0.0, 1.0, 3.0), "in r (0.050 instead of 0.030 rad/s)"),
        ((0.1, 0.18, 0.05), (0.0, 1.0, 1.0), ""),
    ],
)
def test_what_split_makes_worse_beside_the_effects_is_told(after, change, told):
    """Beyond chance; or beyond persistence, of 0.2 and 0.2 in v_y and r, as where one run diverges."""
    physics, held, noise = (0.1, 0.15, 0.03), (0.3, 0.2, 0.2), (0.01, 0.01, 0.001)
    last = HorizonErrors(2.0, (0.5, 0.3, 0.1), physics, (0.4,) * 3, after, held, noise, {}, 40, beside_physics=change)
    finding = Finding("friction_scale", "", planted("friction_scale", "", 0.5, -1.0), 0.9, (), "", 1.0)
    helped = Improvement(*([(0.1,) * 3] * 5), (0.05,) * 3, {}, (last,), {"physics": (0.5, 0.4, 0.6)})
    said = " ".join(summarise("mismatch", (finding,), improvement=helped))
    expected = f"A correction learned by SPLIT beside them makes it worse {told}: use the effects alone."
    assert (expected in said) if told else ("by SPLIT beside" not in said)


def test_a_correction_that_is_not_applied_changes_no_error():
    last = HorizonErrors(2.0, *([(0.5, 0.1, 0.02)] * 4), (0.2, 0.2, 0.2), (0.01, 0.01, 0.001), {}, 40)
    row = (0.1, 0.1, 0.1)
    helped = Improvement(
        row,
        row,
        row,
        row,
        row,
        (0.05,) * 3,
        {},
        (last,),
        {"split_only": (0.0, 0.0, 0.0)},
        trust={"split_only": (0.0, 0.0, 0.0)},
    )
    said = " ".join(summarise("mismatch", (), True, improvement=helped))
    assert "does not hold on training time, and none is applied. After 2 s of open-loop simulation" in said
    assert "0.50 m/s in v_x (persistence: 0.20), 0.10 m/s in v_y (persistence: 0.20) and 0.020 rad/s in r" in said
    assert "falls by" not in said and "changes from" not in said


def test_findings_that_explain_little_are_not_headed_by_a_small_unexplained_part():
    """A quarter explained and 1 % with structure: three quarters have no name, and the heading says so."""
    finding = Finding("friction_scale", "", planted("friction_scale", "", 0.5, -1.0), 0.25, (), "", 1.0)
    rest = RemainderTest(1e-9, 0.01, 3.0, ())
    assert unexplained_part((finding,), rest) == "75 % of the gap unexplained"
    together = replace(rest, explained=0.97)  # beside another finding, with which its share overlaps
    assert unexplained_part((finding, finding), together) == "1 % of the gap unexplained"
    assert unexplained_part((finding,), replace(together, share=0.002)) == "less than 1 % of the gap unexplained"
    # Structure was found in what is left, and the findings explain all that can be measured of it.
    assert unexplained_part((finding,), replace(together, share=0.0)) == "less than 1 % of the gap unexplained"


def test_place_does_not_stand_for_what_repeats_every_lap():
    shares = {"longitudinal": 0.2, "front_lateral": 0.5, "rear_lateral": 0.3}
    location = Location(shares, (("s", 0.9), ("delta", 0.6)), {"delta": (0.05, 0.2)}, None, None, 1.0, 1.0)
    said = " ".join(summarise("mismatch", (), True, location))
    assert "Steer angle alone explains" in said and "a steer angle of 0.0500 to 0.200 rad" in said


def test_terms_look_alike_whichever_of_them_declares_it():
    assert look_alike("steer_lag", "steer_delay") and look_alike("steer_delay", "steer_lag")
    assert look_alike("steer_backlash", "steer_delay") and look_alike("steer_delay", "steer_backlash")
    assert not look_alike("steer_lag", "aero_drag")


@pytest.mark.parametrize(("explained", "unnamed", "rest"), [(0.09, 0.02, "89 %"), (0.6, 0.35, None)])
def test_shares_that_do_not_add_up_are_told_with_what_is_left(explained, unnamed, rest):
    """A drift explained to 9 % with 2 % unexplained: where the other 89 % belong has to be said."""
    finding = Finding("friction_scale", "", planted("friction_scale", "", 0.5, -1.0), explained, (), "", 1.0)
    said = " ".join(summarise("mismatch", (finding,), True, None, RemainderTest(1e-9, unnamed, 3.0, ())))
    alone = f"{unnamed:.0%} of the gap is explained by no effect of the catalogue".replace("%", " %")
    beside = f"{unnamed:.0%} of the gap has a structure that no effect of the catalogue explains".replace("%", " %")
    assert (alone in said) == (rest is None) and (beside in said) == (rest is not None)
    assert ("scatter, or the error of the model's form" in said) == (rest is not None)
    assert rest is None or f"Another {rest} has neither name nor structure" in said


def test_a_share_of_nothing_is_not_said_to_be_unexplained_beside_a_rest_without_structure():
    finding = Finding("friction_scale", "", planted("friction_scale", "", 0.5, -1.0), 0.57, (), "", 1.0)
    said = " ".join(summarise("mismatch", (finding,), True, None, RemainderTest(1e-9, 0.0, 3.0, ())))
    assert "Less than 1 % of the gap has a structure" in said and "Another 43 % has neither name" in said
    assert " 0 % of the gap" not in said


def test_what_acts_in_a_part_is_told_with_its_interval_and_what_else_it_may_be():
    """A share has no unit, one drive needs no number; where many explain it, or nothing does, no name is given."""
    gain = ("drive_gain", "brake_gain", ParameterEstimate(0.85, 0.02, "1", (0.81, 0.89)))
    delay = ("drive_delay", "delay", ParameterEstimate(0.12, 0.01, "s", (0.1, 0.14)))
    told = acting_in_a_part([gain, delay], 24.9, 55.9, 4)
    assert told.startswith("Between 24.9 and 55.9 s it looks like drive gain (drive_gain) with brake_gain = 0.850 (95")
    assert "0.810 to 0.890" in told and "not all along the drive" in told and "a lead, not a finding" in told
    assert "nearly as well there by drive delay (drive_delay) with delay = 0.120 s" in told
    assert "55.9 s of real drive 2 it" in acting_in_a_part([gain], 24.9, 55.9, 4, 2)
    assert "many effects" in acting_in_a_part([gain] * 6, 1.0, 20.0, 4)
    assert "no effect that a real car can have" in acting_in_a_part([], 1.0, 20.0, 4)


def test_a_remainder_that_swings_is_said_to_be_a_mass_on_a_spring():
    swings = RemainderTest(1e-9, 0.4, 0.5, (("swinging at 0.7 Hz", 90.0), ("swinging at 0.49 Hz", 30.0)))
    said = summarise("mismatch", (), True, None, swings)
    assert any("as a mass on a spring does, swinging at 0.7 Hz." in sentence for sentence in said)
    other = summarise("mismatch", (), True, None, replace(swings, by_group=(("memory", 90.0),)))
    assert not any("mass on a spring" in sentence for sentence in other)
