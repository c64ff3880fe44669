"""Moves that replace one term by two or two by one: taken where they are true, and only there."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from split_cli.diagnosis.search import form_error
from split_cli.diagnosis.search.exchange import (
    all_as_one,
    fewer_by_another_variant,
    inverted_stretch,
    move_in_words,
    one_as_hidden_pair,
    one_as_pair,
    pair_as_one,
    with_fewer_parts,
)
from split_cli.diagnosis.search.exploration import Explorer
from split_cli.diagnosis.search.fitting import Fit, Part, fit_parts
from split_cli.diagnosis.search.rivals import Rival
from split_cli.diagnosis.search.selection import Selection, _best_rival, nothing, select_terms
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.flow import Flow
from tests.diagnosis.recordings import (
    INFLATION,
    LAP,
    candidates_of,
    driven,
    explorer,
    first_order,
    late,
    noisy_objective,
    objective_with,
    planted,
)

ACTUATORS = ("drive_lag", "drive_delay", "steer_lag", "steer_delay", "sensor_delay")


def behind(inputs, step: float, *, tau: float = 0.0, delay: float = 0.0):
    """Return inputs (runs, K) behind a lag or a delay."""
    return first_order(inputs, tau, step) if tau else late(inputs, delay, step)


def fitted(explore: Explorer, **starts: dict[str, float]) -> Fit:
    """Fit parts given as ``term`` or ``term__variant`` with the values to start from."""
    parts = []
    for label, values in starts.items():
        term, _, variant = label.partition("__")
        (one,) = (one for one in explore.candidates if (one.term, one.variant) == (term, variant))
        parts.append(Part(one, values))
    return fit_parts(explore.objective, parts)


def test_a_peak_and_both_stiffnesses_merge_into_a_curve():
    """Scale D and divide B by the scale: that is the peak variant; D alone with B up is what `curve` needs."""
    grip = CATALOGUE["friction_scale"]({"scale": 0.7}, "")
    objective = noisy_objective(driven(31, [grip]), 2)
    explore = explorer(objective, "friction_scale", "tire_stiffness")
    stiff = {"front_scale": 1.3, "rear_scale": 1.3}
    both = fitted(explore, friction_scale__curve={"scale": 0.75}, tire_stiffness=stiff)
    assert both.parts[1].values["front_scale"] == pytest.approx(1.0 / 0.7, rel=0.05)
    found = fewer_by_another_variant(explore, nothing(objective), both, (True, True))
    (part,) = found.parts
    assert part.candidate.label == "friction_scale" and part.values["scale"] == pytest.approx(0.7, abs=0.02)
    assert move_in_words(both, found) == "another variant in place of tire_stiffness"
    alone = select_terms(objective, explore.candidates, INFLATION)
    assert [term.id for term in alone.terms] == ["friction_scale"]


@pytest.mark.parametrize("axle", ["front", "rear"])
def test_grip_that_one_axle_lost_is_told_from_grip_of_both_and_from_softer_tyres(axle):
    objective = noisy_objective(driven(31, [CATALOGUE["friction_scale"]({"scale": 0.75}, axle)]), 2)
    explore = explorer(objective, "friction_scale", "tire_stiffness")
    (part,) = select_terms(objective, explore.candidates, INFLATION).chosen.parts
    assert part.candidate.label == f"friction_scale ({axle})"
    assert part.values["scale"] == pytest.approx(0.75, abs=0.02)


def test_one_term_takes_the_place_of_two_that_imitate_it_and_of_no_true_pair():
    turned, slow = CATALOGUE["steer_gain"]({"gain": 0.9}, ""), CATALOGUE["steer_delay"]({"delay": 0.06}, "")
    starts = {"tire_stiffness": {"front_scale": 0.9, "rear_scale": 0.95}, "steer_delay": {"delay": 0.02}}

    def found(effects) -> Fit | None:
        objective = noisy_objective(driven(33, effects), 4)
        explore = explorer(objective, "steer_gain", "tire_stiffness", "steer_delay")
        both = fitted(explore, **starts)
        assert all_as_one(explore, nothing(objective), both, (True, False)) is None
        return all_as_one(explore, nothing(objective), both, (True, True))

    (part,) = found([turned]).parts
    assert part.candidate.term == "steer_gain" and part.values["gain"] == pytest.approx(0.9, abs=0.01)
    assert found([CATALOGUE["tire_stiffness"]({"front_scale": 0.8, "rear_scale": 0.9}, ""), slow]) is None


@pytest.fixture(scope="module")
def heavier():
    """A car a fifth heavier whose tyres take the load degressively."""
    return noisy_objective(driven(31, [CATALOGUE["mass"]({"scale": 1.2}, "degressive")]), 2)


def repaired(explore: Explorer) -> Fit:
    """Fit another mass, with the softer tyres that repair it."""
    return fitted(explore, mass__loaded={"scale": 1.2}, tire_stiffness={"front_scale": 0.9, "rear_scale": 0.9})


def test_a_stiffness_that_repairs_a_wrong_variant_of_a_mass_gives_way_to_the_right_one(heavier):
    """Proportional load makes stiffness grow with the mass m, degressive load with its root: 1.2^-0.5 = 0.91."""
    explore = explorer(heavier, "mass", "tire_stiffness")
    both = repaired(explore)
    assert both.parts[1].values["front_scale"] == pytest.approx(1.2**-0.5, rel=0.01)
    (part,) = fewer_by_another_variant(explore, nothing(heavier), both, (True, True)).parts
    assert part.candidate.label == "mass (degressive)" and part.values["scale"] == pytest.approx(1.2, abs=0.002)
    # What is no name stays: it takes nothing from those that are.
    assert fewer_by_another_variant(explore, nothing(heavier), both, (True, False)) is None


def test_a_repair_gives_way_though_it_fits_better_by_what_a_single_track_gets_wrong(heavier):
    """Some hundredths of what the mass does, by operating point, look like the repair."""
    explore = explorer(heavier, "mass", "tire_stiffness")
    both, right = repaired(explore), fitted(explore, mass__degressive={"scale": 1.2})
    columns = form_error._varied(heavier, right.terms, 0)
    weights = 1.6 * np.linalg.lstsq(columns, both.residuals - right.residuals, rcond=None)[0]
    assert np.sqrt(np.mean(weights**2)) < heavier.policy.selection.form_error_share
    wrong = replace(heavier, offset=heavier.offset + columns @ weights)
    explore = explorer(wrong, "mass", "tire_stiffness")
    both, right = repaired(explore), fitted(explore, mass__degressive={"scale": 1.2})
    assert explore.price(right) > explore.price(both) + explore.rules.price
    assert (
        fewer_by_another_variant(explore, nothing(wrong), both, (True, True)).parts[0].candidate.label
        == "mass (degressive)"
    )


def test_tyres_that_differ_beside_a_mass_stay():
    """No variant of a mass makes one axle softer and the other stiffer."""
    tyres = CATALOGUE["tire_stiffness"]({"front_scale": 1.05, "rear_scale": 0.95})
    objective = noisy_objective(driven(31, [CATALOGUE["mass"]({"scale": 1.2}, "degressive"), tyres]), 2)
    explore = explorer(objective, "mass", "tire_stiffness")
    assert fewer_by_another_variant(explore, nothing(objective), repaired(explore), (True, True)) is None


def test_the_rest_of_a_lap_gives_way_to_the_stretch_and_a_stretch_beside_a_true_force_stays():
    """Uphill on the rest of the lap beside a force m g sin(angle) along the car is downhill on the stretch."""
    slope = {"angle": -0.01, "s_start": 120.0, "s_end": 240.0}
    grade, force = CATALOGUE["road_grade"](slope, "stretch"), CATALOGUE["rolling_resistance"]({"force": 60.0})
    starts = {"angle": 0.01, "s_start": 240.0, "s_end": 120.0}
    explore = explorer(noisy_objective(driven(35, [grade]), 6), "road_grade", "rolling_resistance")
    both = fitted(explore, road_grade__stretch=starts, rolling_resistance={"force": -120.0})
    mass = explore.objective.evidence[0].vehicle.mass
    assert both.parts[1].values["force"] == pytest.approx(-mass * 9.81 * 0.01, rel=0.1)
    (part,) = inverted_stretch(explore, both).parts
    assert part.values["angle"] == pytest.approx(-0.01, abs=0.001)
    assert part.values["s_start"] == pytest.approx(120.0, abs=0.02 * LAP)
    explore = explorer(noisy_objective(driven(35, [grade, force]), 6), "road_grade", "rolling_resistance")
    assert (
        inverted_stretch(explore, fitted(explore, road_grade__stretch=slope, rolling_resistance={"force": 50.0}))
        is None
    )
    # Another term that made up for the force of the rest of the lap leaves it no place, and gives way to it.
    explore = explorer(explore.objective, "road_grade", "rolling_resistance", "aero_drag")
    found = inverted_stretch(explore, fitted(explore, road_grade__stretch=starts, aero_drag={"drag": -0.2}))
    values = {part.candidate.term: part.values for part in found.parts}
    assert set(values) == {"road_grade", "rolling_resistance"} and values["road_grade"]["angle"] < 0.0
    assert values["rolling_resistance"]["force"] == pytest.approx(60.0, rel=0.1)


def test_steering_and_torque_late_by_the_same_join_into_late_sensors_and_by_unlike_do_not():
    for steer, found_terms in ((0.08, {"sensor_delay"}), (0.02, None)):
        late_inputs = {"steer": partial(behind, delay=steer), "torque": partial(behind, delay=0.08)}
        explore = explorer(noisy_objective(driven(21, **late_inputs), 5), *ACTUATORS)
        both = fitted(explore, steer_delay={"delay": steer}, drive_delay={"delay": 0.08})
        found = pair_as_one(explore, nothing(explore.objective), both, (True, True))
        assert (set(found.names) if found else None) == found_terms


def test_late_sensors_join_where_another_part_made_up_for_the_difference():
    delayed = partial(behind, delay=0.05)
    heavy = CATALOGUE["yaw_inertia"]({"scale": 1.12})
    explore = explorer(
        noisy_objective(driven(22, [heavy], steer=delayed, torque=delayed), 6),
        *ACTUATORS,
        "yaw_inertia",
        "tire_relaxation",
    )
    late_inputs = {"steer_delay": {"delay": 0.06}, "drive_delay": {"delay": 0.05}}
    wrong = fitted(explore, **late_inputs, tire_relaxation={"length": 0.1})
    rival = fitted(explore, **late_inputs, yaw_inertia={"scale": 1.1})
    assert set(pair_as_one(explore, nothing(explore.objective), wrong, (True,) * 3, [rival]).names) == {
        "sensor_delay",
        "yaw_inertia",
    }


def test_late_sensors_split_into_a_lag_and_a_delay_where_that_is_what_acts():
    objective = noisy_objective(driven(21, steer=partial(behind, tau=0.05), torque=partial(behind, delay=0.12)), 5)
    explore = explorer(objective, *ACTUATORS)
    one = fitted(explore, sensor_delay={"delay": 0.045})
    found = one_as_pair(explore, nothing(objective), one, (True,))
    assert set(found.names) == {"steer_lag", "drive_delay"}
    values = {part.candidate.term: next(iter(part.values.values())) for part in found.parts}
    assert values["steer_lag"] == pytest.approx(0.05, abs=0.005)
    assert values["drive_delay"] == pytest.approx(0.12, abs=0.005)
    assert move_in_words(one, found) == "drive_delay and steer_lag in place of sensor_delay"
    # What has no name is not split.
    assert one_as_pair(explore, nothing(objective), one, (False,)) is None


@pytest.mark.parametrize(("steer", "torque", "commands"), [(0.02, 0.05, True), (-0.03, 0.05, False)])
def test_late_sensors_beside_a_steering_logged_late_are_two_late_commands(steer, torque, commands):
    """The two say the same but where a run begins; where the wheels answer early, no two late commands do."""
    delayed = partial(behind, delay=torque)
    objective = noisy_objective(driven(22, steer=partial(behind, delay=steer), torque=delayed), 6)
    explore = explorer(objective, *ACTUATORS, "steer_signal_delay")
    both = fitted(explore, sensor_delay={"delay": torque}, steer_signal_delay={"delay": torque - steer})
    found = one_as_pair(explore, nothing(objective), both, (True, True))
    if not commands:
        assert found is None or "steer_delay" not in found.names
        return
    assert set(found.names) == {"steer_delay", "drive_delay"}
    assert found.cost < both.cost + 1.0
    values = {part.candidate.term: part.values["delay"] for part in found.parts}
    assert values["steer_delay"] == pytest.approx(steer, abs=0.003)
    assert values["drive_delay"] == pytest.approx(torque, abs=0.003)


def test_late_sensors_stay_one_where_they_are():
    delayed = partial(behind, delay=0.05)
    objective = noisy_objective(driven(22, steer=delayed, torque=delayed), 6)
    explore = explorer(objective, *ACTUATORS)
    one = fitted(explore, sensor_delay={"delay": 0.045})
    assert one_as_pair(explore, nothing(objective), one, (True,)) is None
    assert fewer_by_another_variant(explore, nothing(objective), one, (True,)) is None


def test_a_relaxing_tyre_gives_way_to_the_two_effects_that_imitate_it():
    """Late steering of a car that turns in easily: each of the two saves little without the other."""
    light = CATALOGUE["yaw_inertia"]({"scale": 0.8})
    objective = noisy_objective(driven(21, [light], steer=partial(behind, delay=0.03)), 5)
    terms = "steer_delay", "steer_lag", "yaw_inertia", "tire_relaxation"
    explore = explorer(replace(objective, about_explanation=True), *terms)
    one = fitted(explore, tire_relaxation={"length": 0.3})
    found = one_as_hidden_pair(explore, nothing(objective), one, (True,))
    values = {part.candidate.term: next(iter(part.values.values())) for part in found.parts}
    assert values == {"steer_delay": pytest.approx(0.03, abs=0.002), "yaw_inertia": pytest.approx(0.8, abs=0.02)}
    assert one_as_hidden_pair(explore, nothing(objective), one, (False,)) is None
    assert one_as_hidden_pair(explorer(objective, *terms), nothing(objective), one, (True,)) is None


def test_a_relaxing_tyre_stays_where_it_is_one():
    objective = replace(objective_with(*planted(tire_relaxation=0.3)), about_explanation=True)
    explore = explorer(objective, "steer_delay", "steer_lag", "yaw_inertia", "tire_relaxation")
    one = fitted(explore, tire_relaxation={"length": 0.25})
    assert one_as_hidden_pair(explore, nothing(objective), one, (True,)) is None


class Blunt(Term):
    """Tyres of another shape with the same stiffness, whose front axle has less grip."""

    id = "blunt"

    def tire(self, flow: Flow) -> None:
        flow.front.D, flow.front.B = 0.85 * flow.front.D, flow.front.B / 0.85
        for axle in (flow.front, flow.rear):
            axle.B, axle.C = axle.B * axle.C, 1.0


def test_the_grip_of_one_axle_stays_one_name_on_tyres_of_another_shape():
    """Grip of both axles and a moved CG fit better, by no more than what any name gets wrong of such tyres."""
    objective = noisy_objective(driven(61, [Blunt({})]), 6)
    explore = explorer(objective, "friction_scale", "tire_stiffness", "cg_shift")
    one = fitted(explore, friction_scale__front={"scale": 0.9})
    both = fitted(explore, friction_scale={"scale": 0.9}, cg_shift={"dx": 0.01})
    assert explore.price(both) < explore.price(one) - 1000.0
    assert one_as_pair(explore, nothing(objective), one, (True,)) is None


def test_two_terms_that_imitate_a_moved_centre_of_gravity_give_way_to_it():
    """A CG further ahead changes arms and slips, as stiffnesses and a sensor elsewhere do in part."""
    objective = noisy_objective(driven(31, [CATALOGUE["cg_shift"]({"dx": 0.05}, "loaded")]), 2)
    explore = explorer(objective, "cg_shift", "tire_stiffness", "sensor_lever_arm")
    stiff = {"front_scale": 1.03, "rear_scale": 0.97}
    both = fitted(explore, tire_stiffness=stiff, sensor_lever_arm={"dx": 0.05})
    rivals = [
        fitted(explore, tire_stiffness=stiff, cg_shift__loaded={"dx": 0.02}),
        fitted(explore, sensor_lever_arm={"dx": 0.05}, cg_shift__loaded={"dx": 0.02}),
    ]
    found = with_fewer_parts(explore, both, rivals)
    (part,) = found.parts
    assert part.candidate.label == "cg_shift (loaded)" and part.values["dx"] == pytest.approx(0.05, abs=0.005)
    assert move_in_words(both, found) == "cg_shift in place of sensor_lever_arm and tire_stiffness"
    # Where all of them act none is needless.
    true = [CATALOGUE["cg_shift"]({"dx": 0.05}, "loaded"), CATALOGUE["tire_stiffness"](stiff, "")]
    explore = explorer(noisy_objective(driven(31, true), 2), "cg_shift", "tire_stiffness", "sensor_lever_arm")
    both = fitted(explore, tire_stiffness=stiff, cg_shift__loaded={"dx": 0.05})
    other = fitted(explore, tire_stiffness=stiff, sensor_lever_arm={"dx": 0.05})
    assert with_fewer_parts(explore, both, [other]) is None
    # One term in the places of both has no part left that could go, and costs far more than both.
    assert with_fewer_parts(explore, both, [other, fitted(explore, sensor_lever_arm={"dx": 0.05})]) is None


def test_what_ends_at_its_limit_takes_no_place_of_what_does_not():
    """Wheels as heavy as any car's saved 2 in the place of a weak torque, which then had no name."""
    objective = noisy_objective(driven(31, []), 2)
    (inertia,) = candidates_of(objective, "yaw_inertia")
    chosen = fit_parts(objective, (Part(inertia, {"scale": 1.1}),))

    def rival(scale: float, excess: float) -> Rival:
        return Rival(replace(chosen, parts=(Part(inertia, {"scale": scale}),)), excess, 3.0)

    heavy, possible = rival(inertia.ranges["scale"].upper, -50.0), rival(1.3, -10.0)
    assert inertia.at_limit(heavy.fit.parts[0].values)
    several = Selection(nothing(objective), chosen, (), ((heavy, possible),), ((),), (True,))
    assert _best_rival(several) is possible
    assert _best_rival(replace(several, rivals=((heavy,),))) is None
