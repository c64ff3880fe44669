"""Faults of single instruments: told by what a recording knows twice, and found again where they were planted."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

from split_cli.diagnosis.recording.witnesses import build_witnesses, late_against_position, usual_weights_by_kind
from split_cli.diagnosis.search.candidates import Candidate, build_candidates
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.identifiable import identifiable
from split_cli.diagnosis.search.late_channel import late_by_witnesses, with_late_channel
from split_cli.diagnosis.search.rivals import rivals_of
from split_cli.diagnosis.search.selection import Selection, nothing
from split_cli.diagnosis.search.term_tests import (
    exceeds_simulation_scatter,
    systematic_error,
    witnessed_p,
    witnesses_disagree,
)
from split_cli.logs.drive import Drive
from split_cli.vehicle.effects import CATALOGUE, Recording, Term
from tests.diagnosis.recordings import (
    INFLATION,
    bare_objective,
    candidates_of,
    driven,
    explorer,
    light_evidence,
    noisy,
    prepared,
    verdict_of,
)
from tests.factories import road_car

PLANTED = [
    ("velocity_bias", "", {"angle": 0.01, "drift": 4e-4}),
    ("velocity_bias", "step", {"angle": 0.0, "step": 0.03, "at": 40.0}),
    ("acceleration_bias", "", {"ax": 0.3, "ay": -0.5}),
    ("yaw_rate_bias", "", {"r": 0.01}),
    ("speed_scale", "", {"scale": 1.04}),
    ("speed_scale", "vx", {"scale": 1.04}),
    ("yaw_rate_scale", "", {"scale": 0.96}),
    ("channel_delay", "r", {"r": 0.06}),
    ("channel_delay", "velocity", {"vx": 0.08, "vy": 0.08}),
    ("channel_delay", "ay", {"ay": 0.09}),
    ("channel_delay", "imu", {"r": 0.06}),
    ("sensor_lever_arm", "unit", {"dx": 0.8}),
    ("velocity_bias", "offset", {"offset": 0.2}),
]


def recording(
    seed: int, *faults: Term, share: float = 1.0, seconds: float = 8.0, terms: tuple[Term, ...] = ()
) -> Drive:
    """Return a minute of a car that has these terms, with position and accelerations, as faulty sensors record it."""
    drive = driven(seed, terms, runs=8, seconds=seconds, spaced=9.0)
    columns = dict(drive.columns)
    rates = {name: np.zeros(len(drive)) for name in ("vx", "vy")}
    for rows in drive.segments():
        for name, rate in rates.items():
            rate[rows] = np.gradient(columns[name][rows], drive.period)
    columns["ax"] = rates["vx"] - columns["vy"] * columns["r"]
    columns["ay"] = rates["vy"] + columns["vx"] * columns["r"]
    for term in terms:
        for name, felt in zip(("ax", "ay"), term.gravity_component(drive["s"]), strict=True):
            columns[name] = columns[name] + felt
    clock = Recording(drive.period, tuple((run.start, run.stop) for run in drive.segments()))
    for fault in faults:
        columns = fault.corrupt(columns, clock)
    rng = np.random.default_rng(seed + 900)
    for name in ("ax", "ay"):
        columns[name] = columns[name] + rng.normal(0.0, 0.1 * share, len(drive))
    return noisy(replace(drive, columns=columns), seed + 500, share=share, position=0.01 * share)


def fault(term: str, variant: str, parameters: dict[str, float]) -> Term:
    return CATALOGUE[term](parameters, variant)


@pytest.mark.parametrize(("term", "variant", "parameters"), PLANTED)
def test_what_a_fault_puts_in_its_correction_takes_off(term, variant, parameters):
    clean = driven(31, runs=2)
    columns = {**clean.columns, "ax": np.sin(clean["t"]), "ay": np.cos(clean["t"])}
    clock = Recording(clean.period, tuple((run.start, run.stop) for run in clean.segments()))
    one = fault(term, variant, parameters)
    back = one.correct(one.corrupt(columns, clock), clock)
    inside = np.ones(len(clean), dtype=bool)
    for run in clean.segments():
        # A moved channel holds its ends.
        inside[run.start : run.start + 12] = inside[run.stop - 12 : run.stop] = False
    for name, values in columns.items():
        # Shifts by whole samples and rotations are undone to rounding.
        np.testing.assert_allclose(back[name][inside], values[inside], rtol=0.0, atol=1e-9, err_msg=name)


@pytest.mark.parametrize(("term", "variant", "parameters"), PLANTED)
def test_a_witness_contradicts_the_fault_and_agrees_once_it_is_corrected(term, variant, parameters):
    one = fault(term, variant, parameters)
    clean = build_witnesses(prepared(recording(32)))
    scales = {witness.kind: witness.scale for witness in clean}
    faulty = build_witnesses(prepared(recording(33, one)), usual_weights_by_kind(clean))
    # A fault that varies widens what a recording takes for its noise, so that of the clean one is taken.
    faulty = [replace(witness, scale=scales[witness.kind]) for witness in faulty]
    for witness in faulty:
        right = np.mean(witness.rows((one,)) ** 2)
        assert right < 3.0, (witness.kind, right)
    assert max(np.mean(witness.rows(()) ** 2) for witness in faulty) > 5.0


def test_physics_moves_no_witness():
    (heavy,) = (build_witnesses(prepared(recording(34))),)
    assert {one.kind for one in heavy} == {"lateral", "yaw", "distance", "a_x", "a_y"}
    for one in heavy:
        np.testing.assert_array_equal(one.rows((CATALOGUE["mass"]({"scale": 1.5}),)), one.rows(()))


def test_an_inclined_road_is_felt_by_accelerometers_and_by_nothing_else():
    """a_y = v_y' + v_x r + g sin(bank): a drive on a bank contradicts itself until the bank is told."""
    drive = recording(35)
    felt = replace(drive, columns={**drive.columns, "ay": drive["ay"] + 9.80665 * np.sin(0.03)})
    bank = CATALOGUE["road_bank"]({"angle": 0.03}, "")
    # A grade is felt along the car; a stretch only where it is.
    grade = CATALOGUE["road_grade"]({"angle": 0.05, "s_start": 10.0, "s_end": 20.0}, "stretch")
    assert grade.gravity_component(np.array([5.0, 15.0]))[0] == pytest.approx([0.0, 9.80665 * np.sin(0.05)])
    for level, banked in zip(build_witnesses(prepared(drive)), build_witnesses(prepared(felt)), strict=True):
        right = level.rows(())
        assert banked.rows((bank,)) * banked.scale == pytest.approx(right * level.scale, abs=1e-9)
        moved = np.abs(banked.difference(()) - level.difference(())).max()
        # A window of half a second gains g sin(bank) times its length.
        assert moved == pytest.approx(0.5 * 9.80665 * np.sin(0.03) if level.kind == "a_y" else 0.0, abs=1e-9)


def test_a_constant_grade_is_no_rolling_resistance_where_an_accelerometer_feels_it():
    """Without a_x the two are the same force, and either is an alternative of the other."""
    grade = CATALOGUE["road_grade"]({"angle": 0.03})
    simulation, reality = recording(36), recording(37, terms=(grade,))
    (finding,) = verdict_of([reality], road_car(), [simulation]).findings
    low, high = finding.parameters["angle"].interval_95
    assert finding.term == "road_grade" and low <= 0.03 <= high
    blind = [replace(one, columns={n: c for n, c in one.columns.items() if n != "ax"}) for one in (reality, simulation)]
    (finding,) = verdict_of(blind[:1], road_car(), blind[1:]).findings
    assert finding.term == "rolling_resistance" and "road_grade" in finding.alternatives


def test_a_derived_position_is_no_witness():
    drive = recording(35)
    metadata = replace(drive.metadata, kinds={"X": "derived: from vx", "ax": "derived: from vx", "ay": "derived"})
    assert not build_witnesses(prepared(replace(drive, metadata=metadata)))


def test_an_accelerometer_without_some_of_its_numbers_witnesses_the_rest():
    drive = recording(37)
    holed = {**drive.columns, "ay": np.where(np.arange(len(drive)) % 400 < 8, np.nan, drive["ay"])}
    whole, rest = (
        {one.kind: one for one in build_witnesses(prepared(replace(drive, columns=columns)))}
        for columns in (drive.columns, holed)
    )
    known = np.isin(whole["a_y"].begin, rest["a_y"].begin)
    # Every fourth second has a hole, which costs the one or two windows of 0.5 s that it touches, edges included.
    assert 0.5 < known.mean() < 0.95
    assert set(rest["a_y"].begin) <= set(whole["a_y"].begin)
    ours, theirs = rest["a_y"].difference(()), whole["a_y"].difference(())[known]
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    # Of holes so near each other that no window is whole nothing is witnessed, and nothing is warned of.
    torn = {**drive.columns, "ay": np.where(np.arange(len(drive)) % 20 == 0, np.nan, drive["ay"])}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert "a_y" not in {one.kind for one in build_witnesses(prepared(replace(drive, columns=torn)))}


def test_what_was_derived_from_position_is_late_against_nothing():
    drive = recording(38)
    car = road_car()

    def late(**kinds: str) -> set[str]:
        one = prepared(replace(drive, metadata=replace(drive.metadata, kinds=kinds)))
        candidates = identifiable(build_candidates(car, one), [one], car)
        return {candidate.variant for candidate in candidates if candidate.term == "channel_delay"}

    assert late() == {"r", "vx", "vy", "velocity", "ax", "ay", "imu"}
    # Without position the accelerometers witness; without either nothing does.
    assert late(X="derived: from vx") == late()
    assert late(X="derived: from vx", ay="derived: from vy") == {"ax"}
    assert late(vy="derived: from X, Y, yaw smoothed by their noise") == {"ax", "ay"}


def test_a_lateral_velocity_integrated_from_a_y_tells_no_sensor_of_it_and_no_bank():
    drive = recording(42)
    kinds = {"vy": "derived: v_y from a_y - v_x r, held where driving is gentle"}
    one = prepared(replace(drive, metadata=replace(drive.metadata, kinds=kinds)))
    every = build_candidates(road_car(), one)
    told = identifiable(every, [one], road_car())
    gone = {candidate.term for candidate in every} - {candidate.term for candidate in told}
    assert gone == {"sensor_lever_arm", "sensor_misalignment", "velocity_bias", "road_bank"}
    assert not {"ay", "vy", "velocity", "imu"} & {candidate.variant for candidate in told if candidate.needs}
    assert {witness.kind for witness in build_witnesses(one)} >= {"yaw", "a_x"}
    assert "a_y" not in {witness.kind for witness in build_witnesses(one)}


def test_what_any_road_does_to_an_accelerometer_is_within_tolerance():
    every = build_candidates(road_car(), prepared(recording(39)))
    both, ahead = (one for one in every if one.label in ("acceleration_bias", "acceleration_bias (ax)"))
    # A crossfall of 2.5 % is 0.245 m/s^2.
    assert both.is_within_tolerance({"ax": 0.1, "ay": -0.24}) and not both.is_within_tolerance({"ax": 0.1, "ay": -0.3})
    assert ahead.is_within_tolerance({"ax": 0.2}) and not ahead.is_within_tolerance({"ax": -0.26})
    (heavy,) = (one for one in every if one.label == "mass")
    assert not heavy.is_within_tolerance({"scale": 1.0001})


def test_a_channel_less_than_a_millisecond_late_is_within_tolerance():
    """A yaw rate named as 0.6 ms late was wrong in a blind test: many loggers write whole milliseconds."""
    every = build_candidates(road_car(), prepared(recording(39)))
    late, lateral = (one for one in every if one.label in ("channel_delay (r)", "channel_delay (ay)"))
    assert late.is_within_tolerance({"r": 0.0006}) and not late.is_within_tolerance({"r": 0.0011})
    # A body that leans makes lateral acceleration later than that.
    assert lateral.is_within_tolerance({"ay": 0.004})


def test_velocities_of_position_are_late_only_where_they_were_shifted_since():
    """The linear estimate of the delay by the turn of yaw: none as recorded, found where 40 ms were put in."""
    sound = recording(40, share=0.1)
    shifted = recording(40, fault("channel_delay", "r", {"r": 0.04}), share=0.1)
    assert not late_against_position(prepared(sound)) and late_against_position(prepared(shifted))
    kinds = {name: "derived: from X, Y, yaw" for name in ("vx", "vy", "r")}

    def offered(drive: Drive, kinds: dict[str, str] = kinds) -> set[str]:
        series = prepared(replace(drive, metadata=replace(drive.metadata, kinds=kinds)))
        told = identifiable(build_candidates(road_car(), series), [series], road_car())
        return {one.label for one in told}

    frames = {"sensor_lever_arm (frame)", "sensor_misalignment (frame)"}
    assert "channel_delay (r)" not in offered(sound) >= frames
    assert "channel_delay (r)" in offered(shifted) and not frames & offered(shifted)
    # A sensor of its own is no frame.
    assert not frames & offered(sound, {})


def test_half_a_degree_of_a_sensor_is_no_fault_where_no_position_tells_it_from_the_car():
    series = prepared(recording(41))
    without = replace(series.drive, columns={k: v for k, v in series.drive.columns.items() if k not in "XY"})

    def turned(one) -> Candidate:
        every = build_candidates(road_car(), one)
        return next(c for c in identifiable(every, [one], road_car()) if c.term == "sensor_misalignment")

    assert not turned(series).is_within_tolerance({"angle": 0.001})
    blind = turned(replace(series, drive=without))
    assert blind.is_within_tolerance({"angle": -0.008}) and not blind.is_within_tolerance({"angle": 0.0095})


@pytest.fixture(scope="module")
def late_yaw_rate():
    """A yaw rate that is 40 ms late, with position and accelerations as witnesses."""
    series = prepared(recording(42, fault("channel_delay", "r", {"r": 0.04}), seconds=12.0))
    usual_by_kind = usual_weights_by_kind(build_witnesses(prepared(recording(43, seconds=12.0))))
    return bare_objective(light_evidence(series), kinematics=build_witnesses(series, usual_by_kind))


def test_a_variant_that_witnesses_deny_is_far_off_however_large_model_form_error_is():
    """A moved unit: with the velocity alone moved v_y fits as well, and the accelerometer contradicts."""
    series = prepared(recording(44, fault("sensor_lever_arm", "unit", {"dx": 0.8}), seconds=12.0))
    usual_by_kind = usual_weights_by_kind(build_witnesses(prepared(recording(45, seconds=12.0))))
    evidence, felt = light_evidence(series), [w for w in build_witnesses(series, usual_by_kind) if w.kind == "a_y"]

    def excess(kinematics) -> float:
        objective = replace(bare_objective(evidence, kinematics=kinematics), form_error_inflation=150.0)
        sensors = candidates_of(objective, "sensor_lever_arm")
        candidates = tuple(one for one in sensors if one.variant != "frame")
        (unit,) = (one for one in candidates if one.variant == "unit")
        chosen = fit_parts(objective, (Part(unit, dict(unit.starts[0])),))
        _, (sibling,) = rivals_of(explorer(objective, *candidates), chosen, 0, nothing(objective))
        return sibling.excess

    assert abs(excess([])) < 1e-3 and excess(felt) > 100.0


def test_a_nuisance_that_looks_like_a_name_hides_no_alternative():
    """A biased velocity told as a sensor that is turned beside a little bias: the bias alone explains as much."""
    biased = fault("velocity_bias", "", {"angle": 0.015, "drift": 0.0})
    objective = bare_objective(light_evidence(prepared(recording(46, biased, seconds=12.0))))
    candidates = candidates_of(objective, "sensor_misalignment", "velocity_bias")
    own = {(one.term, one.variant): one for one in candidates}
    turned, offset = own["sensor_misalignment", ""], own["velocity_bias", "offset"]
    parts = [Part(one, dict(one.starts[0])) for one in (turned, offset)]
    chosen, rest = fit_parts(objective, parts), fit_parts(objective, parts[1:])
    explore = explorer(objective, *candidates)

    def alone(nuisances: list[int]) -> list[tuple[float, Fit]]:
        others, _ = rivals_of(explore, chosen, 0, rest, nuisances=nuisances)
        return [(one.excess, one.fit) for one in others if one.fit.parts[-1].candidate is own["velocity_bias", ""]]

    ((excess, fit),) = alone([1])
    assert [part.candidate.term for part in fit.parts] == ["velocity_bias"] and excess < explore.rules.price
    assert fit.parts[0].values["angle"] == pytest.approx(0.015, abs=0.001)
    assert not alone([])


def test_witnesses_speak_for_a_rival_whatever_model_form_error_makes_of_its_cost(late_yaw_rate):
    """A late yaw rate told as late steering: yaw and a_y say which, by what a chi squared of 1.5 is in doubt."""
    candidates = tuple(candidates_of(late_yaw_rate, "channel_delay", "steer_delay"))
    (late,) = (one for one in candidates if one.variant == "r")
    (steer,) = (one for one in candidates if one.term == "steer_delay")

    def excess(objective) -> tuple[float, Fit, Fit]:
        chosen = fit_at(objective, Part(steer, {"delay": 0.04}))
        others, _ = rivals_of(explorer(objective, *candidates), chosen, 0, nothing(objective))
        (rival,) = (one for one in others if one.fit.parts[-1].candidate is late)
        return rival.excess, rival.fit, chosen

    told, fit, chosen = excess(replace(late_yaw_rate, form_error_inflation=150.0))
    own = late_yaw_rate.of_witnesses(fit.residuals) ** 2 - late_yaw_rate.of_witnesses(chosen.residuals) ** 2
    assert told == pytest.approx((fit.cost - chosen.cost - own.sum()) / 150.0 + own.sum() / 1.5)
    # Where halves of the simulation contradict themselves as much, they say nothing.
    floors = {late.effect: 1e6}
    mute, fit, chosen = excess(replace(late_yaw_rate, form_error_inflation=150.0, witness_floors=floors))
    assert mute == pytest.approx((fit.cost - chosen.cost) / 150.0)
    assert told < mute


def test_witnesses_alone_confirm_a_delay_and_by_how_much(late_yaw_rate):
    rules = late_yaw_rate.policy.selection
    (one,) = (c for c in candidates_of(late_yaw_rate, "channel_delay") if c.variant == "r")
    base = nothing(late_yaw_rate)
    right, twice = (fit_at(late_yaw_rate, Part(one, {"r": delay})) for delay in (0.04, 0.08))
    assert witnessed_p(late_yaw_rate, right, 0, base, rules) < 1e-12
    assert witnesses_disagree(late_yaw_rate, right, 0, rules) < 0.1
    # Twice the delay is confirmed by half, which is no confirmation.
    assert witnesses_disagree(late_yaw_rate, twice, 0, rules) == pytest.approx(0.5, abs=0.15)
    assert witnessed_p(late_yaw_rate, twice, 0, base, rules) == 1.0
    # Nor is it one where halves of the simulation contradict themselves by as much.
    floor = base.cost
    same = replace(late_yaw_rate, witness_floors={"channel_delay (r)": floor})
    assert witnessed_p(same, right, 0, base, rules) == 1.0


def test_what_witnesses_see_has_no_systematic_error_of_the_car(late_yaw_rate):
    """Model-form error widens what is said of a late steering by its root, and nothing of a late yaw rate."""
    wide = replace(late_yaw_rate, form_error_inflation=150.0)
    (channel,) = (c for c in candidates_of(wide, "channel_delay") if c.variant == "r")
    (steer,) = candidates_of(wide, "steer_delay")
    for part, expected in ((Part(channel, {"r": 0.04}), 1.0), (Part(steer, {"delay": 0.04}), np.sqrt(150.0))):
        fit = fit_at(wide, part)
        assert systematic_error(wide, fit, 0) == pytest.approx(expected * systematic_error(late_yaw_rate, fit, 0))
    (bias,) = candidates_of(wide, "velocity_bias")[:1]
    # So little of it moves the witnesses by less than it could.
    small = fit_at(wide, Part(bias, {**bias.starts[0], "angle": 1e-6, "drift": 0.0}))
    assert systematic_error(wide, small, 0) > 10.0 * systematic_error(late_yaw_rate, small, 0)


def test_without_yaw_a_y_separates_a_biased_yaw_rate_from_a_banked_road():
    """The bias moves a_y by v_x times it, and a bank moves a_y by the same at every speed."""
    faulty = recording(48, fault("yaw_rate_bias", "", {"r": 0.03}))
    series = prepared(replace(faulty, columns={k: v for k, v in faulty.columns.items() if k not in ("X", "Y", "yaw")}))
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))
    every = identifiable(build_candidates(road_car(), series), [series], road_car())
    bias, bank = (next(one for one in every if one.term == term) for term in ("yaw_rate_bias", "road_bank"))
    biased, banked = (fit_parts(objective, (Part(one, dict(one.starts[0])),)) for one in (bias, bank))
    assert biased.parts[0].values["r"] == pytest.approx(0.03, abs=0.003)
    assert banked.cost > biased.cost + 50.0


def test_witnesses_alone_tell_how_late_a_channel_is(late_yaw_rate):
    every = tuple(candidates_of(late_yaw_rate, "channel_delay", "yaw_rate_scale", "yaw_rate_bias", "speed_scale"))
    part = late_by_witnesses(late_yaw_rate, every)
    assert part.candidate.variant == "r" and part.values["r"] == pytest.approx(0.04, abs=0.004)
    told = with_late_channel(late_yaw_rate, without_a_name(late_yaw_rate), every, INFLATION)
    assert [term.parameters for term in told.terms] == [part.values] and told.first_p < 1e-12
    # Halves of the simulation that contradict themselves as much leave no name, nor do equations that deny it.
    seen = late_yaw_rate.witnesses_cost(told.base.residuals) - late_yaw_rate.witnesses_cost(told.chosen.residuals)
    same = replace(late_yaw_rate, witness_floors={"channel_delay (r)": 0.4 * seen})
    assert with_late_channel(same, without_a_name(same), every, INFLATION) is None
    base = told.base
    denied = replace(base, cost=base.cost - 2.0 * seen - (base.cost - told.chosen.cost))
    assert (
        with_late_channel(late_yaw_rate, replace(without_a_name(late_yaw_rate), base=denied), every, INFLATION) is None
    )


def test_a_late_channel_is_told_beside_a_name(late_yaw_rate):
    """The parts that were named stay as they were, and each is judged with the late channel beside it."""
    (gain,) = candidates_of(late_yaw_rate, "steer_gain")
    chosen, base = fit_at(late_yaw_rate, Part(gain, {"gain": 0.95})), nothing(late_yaw_rate)
    before = Selection(base, chosen, (base,), ((),), ((),), (True,), first_p=1e-9)
    every = tuple(candidates_of(late_yaw_rate, "channel_delay", "steer_gain", "yaw_rate_scale", "speed_scale"))
    told = with_late_channel(late_yaw_rate, before, every, INFLATION)
    first, second = told.terms
    assert first.parameters == {"gain": 0.95} and second.parameters["r"] == pytest.approx(0.04, abs=0.004)
    assert told.chosen.cost == pytest.approx(late_yaw_rate.cost(told.terms), rel=1e-6)
    assert told.without[0].cost == pytest.approx(late_yaw_rate.cost([second]), rel=1e-2)
    assert told.without[1] is chosen and told.chosen.sensitivity.shape[1] == 2 and told.first_p == 1e-9
    assert with_late_channel(late_yaw_rate, told, every, INFLATION) is None  # not twice


@pytest.mark.parametrize("k", [None, 3, 4, 6])
def test_what_is_not_late_is_not_told_to_be(k):
    """A clean recording, and those of a sensor that is biased or scaled."""
    faults = [] if k is None else [fault(*PLANTED[k])]
    series = prepared(recording(46, *faults))
    usual_by_kind = usual_weights_by_kind(build_witnesses(prepared(recording(47))))
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series, usual_by_kind))
    names = ("channel_delay", "velocity_bias", "yaw_rate_scale", "yaw_rate_bias", "speed_scale")
    every = tuple(candidates_of(objective, *names))
    assert with_late_channel(objective, without_a_name(objective), every, INFLATION) is None


def test_a_term_is_one_where_it_saves_twice_what_halves_of_the_simulation_differ_by(late_yaw_rate):
    (one,) = (c for c in candidates_of(late_yaw_rate, "channel_delay") if c.variant == "r")
    known = replace(late_yaw_rate, self_test_savings={"channel_delay (r)": 100.0})
    # Sizes go with the root of what they save: 1.96 times the size is 3.84 times the saving.
    assert exceeds_simulation_scatter(known, one, 385.0) and not exceeds_simulation_scatter(known, one, 384.0)
    assert exceeds_simulation_scatter(late_yaw_rate, one, 1.0)


def test_rows_of_lists_that_differ_little_are_those_of_each_list():
    """To the bit, with each instrument's fault moved in turn, a lean of the road and a drag."""
    series = prepared(recording(5, share=0.1, seconds=3.0))
    objective = bare_objective(light_evidence(series), kinematics=build_witnesses(series))
    values = [*PLANTED, ("road_bank", "", {"angle": 0.02}), ("aero_drag", "", {"drag": 0.1})]
    terms = [CATALOGUE[name](dict.fromkeys(at, 0.0) | at, variant) for name, variant, at in values]
    moved = [
        [
            *terms[:k],
            type(one)({key: 1.1 * value for key, value in one.parameters.items()}, one.variant),
            *terms[k + 1 :],
        ]
        for k, one in enumerate(terms)
    ]
    found = objective.raw_residuals_of_each(moved, terms, objective.raw_residual(terms))
    for several, rows in zip(moved, found, strict=True):
        bare = replace(objective, memo={})
        np.testing.assert_array_equal(rows, bare.raw_residual(several))


def without_a_name(objective) -> Selection:
    base = nothing(objective)
    return Selection(base, base, (), (), (), ())


def fit_at(objective, part: Part) -> Fit:
    """Return an explanation by one part as it is, not fitted."""
    residuals = objective.residual((part.term,))
    return Fit((part,), float(residuals @ residuals), residuals, np.empty((len(residuals), 0)))


@pytest.mark.parametrize("k", [2, 6, 10, 11])
def test_a_planted_fault_is_named_with_its_value(k):
    term, variant, parameters = PLANTED[k]
    said = verdict_of([recording(36, fault(term, variant, parameters))], road_car())
    assert said.verdict == "mismatch"
    assert [one.term for one in said.findings] == [term]
    (finding,) = said.findings
    assert finding.variant == variant and not finding.exported
    for name, value in parameters.items():
        low, high = finding.parameters[name].interval_95
        assert low <= value <= high, name
        assert finding.parameters[name].value == pytest.approx(value, rel=0.15)


def test_where_an_acceleration_jumps_between_samples_it_is_no_witness():
    """For 0.6 s torque chatters, and what a_x is at its samples is not what it is between them."""
    drive = recording(77)
    rows = drive.segments()[2]
    chatters = slice(rows.start + 300, rows.start + 360)
    felt = drive["ax"].copy()
    felt[chatters] += np.random.default_rng(3).choice([0.0, 0.0, 8.0], 60)
    torn = replace(drive, columns={**drive.columns, "ax": felt})

    def witness(one: Drive):
        return next(w for w in build_witnesses(prepared(one)) if w.kind == "a_x")

    whole, kept = witness(drive), witness(torn)
    near = (whole.end > chatters.start) & (whole.begin < chatters.stop)
    assert 1 < near.sum() < 5
    gone = ~np.isin(whole.begin, kept.begin)
    assert gone[near].all() and gone.sum() <= near.sum() + 2
    assert np.abs(kept.rows(())).max() < 6.0
    # A drive without noise is smooth, and loses no window; nor does noise cost one.
    clean = witness(recording(77, share=1e-3))
    assert len(clean.begin) == len(whole.begin)
    # A step of the torque is no chatter: a jump of 3 m/s^2 once leaves nearly all that it is told by.
    step = felt.copy()
    step[rows] = drive["ax"][rows] + 3.0 * (np.arange(len(felt[rows])) > 400)
    stepped = witness(replace(drive, columns={**drive.columns, "ax": step}))
    assert len(whole.begin) - len(stepped.begin) <= 2
