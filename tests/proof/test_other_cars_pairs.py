"""Effects, sensors, sizes, seeds and judgements of the study with cars of other equations."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from split_cli.proof.outcome import Named, Statement
from split_cli.vehicle.effects import CATALOGUE
from tests.studies.other_cars.cars import KINDS
from tests.studies.other_cars.course import STYLES, draw_course
from tests.studies.other_cars.driver import LostCar, draw_driver, drive
from tests.studies.other_cars.effects import EFFECTS, STRANGE, PlantedEffect, may_join
from tests.studies.other_cars.generate import PairTruth, generate_pairs, pair_name, truth_from, write_pair
from tests.studies.other_cars.judging import PairAnswer, PairAnswers, diagnosed, judged_pair, summary_lines
from tests.studies.other_cars.recording import SensorFaults, recorded, sensed
from tests.studies.other_cars.sizes import effect_over_noise


def driven(kind, duration: float = 12.0):
    generator = np.random.default_rng(3)
    while True:
        course = draw_course(generator, "closed course", kind.room)
        driver = draw_driver(generator, "closed course")
        try:
            return drive(kind, kind.base, course, driver, duration, generator)
        except LostCar:
            continue


@pytest.fixture(scope="module")
def van_drive():
    return driven(KINDS["van"])


def drawn(name: str, kind_name: str = "van", seed: int = 0) -> PlantedEffect:
    generator, kind = np.random.default_rng(seed), KINDS[kind_name]
    course = draw_course(generator, "closed course", kind.room)
    return (EFFECTS | STRANGE)[name](generator, kind, kind.base, course)


@pytest.mark.parametrize("name", EFFECTS)
def test_an_effect_has_parameters_of_its_catalogue_term_and_changes_one_thing(name):
    effect = drawn(name)
    known = CATALOGUE[effect.term].parameter_units("")
    assert effect.name == name
    assert set(effect.values) <= set(known)
    car, sensors = effect.on_car(KINDS["van"].base), effect.on_sensors(SensorFaults())
    changed = {field for field in car._fields if getattr(car, field) != getattr(KINDS["van"].base, field)}
    assert bool(changed) != (sensors != SensorFaults())
    assert changed <= {*effect.scaled, *effect.added}


@pytest.mark.parametrize("name", STRANGE)
def test_a_strange_effect_has_no_name_in_the_catalogue(name):
    assert drawn(name).term == ""
    assert drawn(name).on_car(KINDS["van"].base) != KINDS["van"].base


def test_a_cg_that_moves_forward_keeps_the_wheelbase():
    effect = drawn("CG moved")
    car, base = effect.on_car(KINDS["van"].base), KINDS["van"].base
    assert car.front + car.rear == pytest.approx(base.front + base.rear)
    assert base.front - car.front == pytest.approx(effect.values["dx"]) == effect.moves_the_cg_by


def test_what_no_drive_separates_does_not_stand_together():
    assert not may_join(drawn("grade"), [drawn("more rolling resistance")])
    assert not may_join(drawn("front grip"), [drawn("rear grip")])  # one term
    assert may_join(drawn("grade"), [drawn("mass")])


def test_sensors_misread_as_the_catalogue_says(van_drive):
    """Signs of docs/catalogue.md: a sensor ahead reads v_y + dx r; one turned to the left sees the car go right."""
    true = sensed(van_drive, SensorFaults())
    ahead = sensed(van_drive, SensorFaults(lever=0.3))
    np.testing.assert_allclose(ahead["vy"], true["vy"] + 0.3 * true["r"])
    turned = sensed(van_drive, SensorFaults(turned=0.01))
    direction = np.arctan2(turned["vy"], turned["vx"]) - np.arctan2(true["vy"], true["vx"])
    np.testing.assert_allclose(direction, -0.01)
    biased = sensed(van_drive, SensorFaults(angle_bias=0.01))
    np.testing.assert_allclose(biased["vy"], true["vy"] + 0.01 * true["vx"], atol=2e-4)
    late = sensed(van_drive, SensorFaults(yaw_rate_late=3 * van_drive.period, yaw_rate_bias=0.02))
    np.testing.assert_allclose(late["r"][3:], true["r"][:-3] + 0.02)
    fast = sensed(van_drive, SensorFaults(speed=1.03))
    np.testing.assert_allclose(fast["vx"] / true["vx"], 1.03)


@pytest.mark.parametrize("name", KINDS)
def test_recorded_velocity_acceleration_and_position_belong_to_one_motion(name):
    """Central differences of X, Y, yaw and the velocities are the velocities and what accelerometers feel."""
    kind = KINDS[name]
    run = driven(kind, 6.0)
    true = sensed(run, SensorFaults())
    inner = slice(1, -1)

    def rate(channel):
        return (true[channel][2:] - true[channel][:-2]) / (2.0 * run.period)

    c, s = np.cos(true["yaw"][inner]), np.sin(true["yaw"][inner])
    pairs = {
        "vx": c * rate("X") + s * rate("Y"),
        "vy": -s * rate("X") + c * rate("Y"),
        "r": rate("yaw"),
        "ax": rate("vx") - true["vy"][inner] * true["r"][inner],
        "ay": rate("vy") + true["vx"][inner] * true["r"][inner],
    }
    for channel, derived in pairs.items():
        # A command that changes bends the acceleration, which a difference over two periods rounds off.
        error = np.sqrt(np.mean((derived - true[channel][inner])[5:] ** 2))
        assert error < 0.03 * np.sqrt(np.mean(true[channel] ** 2)), channel


def test_noise_has_its_size_and_no_other_value_changes(van_drive):
    kind = KINDS["van"]
    given = {"position": True, "acceleration": True}
    columns = recorded(kind, van_drive, SensorFaults(), 0.02, np.random.default_rng(1), **given)
    true = sensed(van_drive, SensorFaults())
    for name, size in kind.noise.items():
        # 600 samples: the deviation of a deviation is 3 %.
        assert np.std(columns[name] - true[name]) == pytest.approx(size, rel=0.12)
    without = recorded(
        kind, van_drive, SensorFaults(), 0.02, np.random.default_rng(1), position=False, acceleration=False
    )
    assert "X" not in without and "ay" not in without
    np.testing.assert_array_equal(without["r"], columns["r"])


def test_the_size_of_an_effect_is_none_without_it_and_grows_with_it(van_drive):
    kind = KINDS["van"]
    assert effect_over_noise(kind, van_drive, PlantedEffect("", "", added={"steer_offset": 0.0})) == 0.0
    small, large = (
        effect_over_noise(kind, van_drive, PlantedEffect("", "", added={"steer_offset": size}))
        for size in (0.001, 0.003)
    )
    assert large == pytest.approx(3.0 * small, rel=0.05)


def test_a_biased_gyroscope_errs_by_v_x_times_its_bias(van_drive):
    """v_y' lacks -v_x r_0: in 0.05 s at 15 m/s a bias of 0.01 rad/s errs by 7.5 mm/s before tyres answer to it."""
    kind = KINDS["van"]
    size = effect_over_noise(kind, van_drive, PlantedEffect("", "", sensors={"yaw_rate_bias": 0.01}))
    least = np.sqrt(np.mean(van_drive.states[:, 3] ** 2)) * 0.01 * 0.05 / (np.sqrt(2.0) * kind.noise["vy"])
    assert 0.5 * least < size < 4.0 * least


@pytest.mark.parametrize("style", STYLES)
def test_courses_are_closed_and_their_curvature_is_that_of_their_points(style):
    course = draw_course(np.random.default_rng(4), style, 90.0)
    gaps = np.hypot(np.diff(course.x, append=course.x[0]), np.diff(course.y, append=course.y[0]))
    np.testing.assert_allclose(gaps, course.spacing, rtol=2e-3)
    total = course.curvature.sum() * course.spacing
    assert abs(total) == pytest.approx(0.0 if style == "figure eight" else 2.0 * np.pi, abs=1e-6)


def test_equal_seeds_give_equal_drives_and_others_do_not():
    kind = KINDS["van"]

    def made(seed):
        generator = np.random.default_rng(seed)
        course = draw_course(generator, "mixed driving", kind.room)
        return drive(kind, kind.base, course, draw_driver(generator, "mixed driving"), 4.0, generator)

    np.testing.assert_array_equal(made(8).states, made(8).states)
    assert not np.allclose(made(8).steer, made(9).steer)


def test_equal_seeds_give_equal_files(tmp_path):
    truths = [write_pair(tmp_path / name, 700, 3) for name in ("first", "second")]
    assert truths[0] == truths[1]
    for name in ("real.parquet", "sim.parquet", "vehicle.yaml"):
        first, second = (tmp_path / one / "cases" / "003" / name for one in ("first", "second"))
        assert first.read_bytes() == second.read_bytes()


def truth_of(*names: str) -> PairTruth:
    effects = tuple(drawn(name) for name in names)
    return PairTruth(0, "van", "slalom", "mixed driving", 0.02, True, True, effects, (1.0,) * len(effects))


def found(term: str, *alternatives: str, **values: tuple[float, float, float]) -> Named:
    return Named(term, values, alternatives)


def judged(truth: PairTruth, *findings: Named, unexplained: bool = False):
    verdict = "mismatch" if findings or unexplained else "match"
    return judged_pair(truth, Statement(verdict, findings, unexplained))


def test_names_alternatives_and_lost_effects_are_counted_apart():
    truth = truth_of("mass", "steering late", "bank", "grip")
    row = judged(
        truth,
        found("drive_gain", "mass+friction_scale"),
        found("steer_delay"),
        found("aero_drag", "rolling_resistance"),
    )
    assert row.named == ("steer_delay",)
    assert row.by_alternative == ("mass", "friction_scale")
    assert row.lost == ("road_bank",)
    assert row.wrong == ("aero_drag",)
    assert row.outcome == "wrong"


def test_an_alternative_of_several_terms_counts_only_if_all_are_there():
    row = judged(truth_of("mass"), found("drive_gain", "mass+friction_scale"))
    assert (row.by_alternative, row.lost, row.wrong, row.outcome) == ((), ("mass",), ("drive_gain",), "wrong")


def test_two_axles_of_less_grip_are_one_name():
    row = judged(truth_of("grip"), found("friction_scale"), found("friction_scale"))
    assert (row.outcome, row.wrong) == ("exact", ())


def test_an_interval_is_judged_where_the_term_has_a_true_value():
    truth = truth_of("mass", "stiffer differential")
    true = truth.effects[0].values["scale"]
    inside, outside = (
        judged(
            truth,
            found("mass", scale=(low, low - 0.01, low + 0.01)),
            found("yaw_moment_differential", yaw_damping=(1.0, 0.0, 2.0)),
        )
        for low in (true, true + 0.1)
    )
    assert inside.intervals == {"mass.scale": True}
    assert outside.intervals == {"mass.scale": False}
    assert inside.outcome == "exact"


def test_strange_effects_and_equal_pairs_are_judged_by_what_is_unexplained_or_called_different():
    strange, equal = truth_of("gusts"), truth_of()
    assert judged(strange, unexplained=True).outcome == "exact"
    assert judged(strange, found("road_bank")).outcome == "wrong"
    assert judged(equal).outcome == "exact"
    rows = [
        (strange, Statement("mismatch", unexplained=True)),
        (equal, Statement("match")),
        (equal, Statement("mismatch", (found("mass"),))),
    ]
    text = "\n".join(summary_lines(rows))
    assert "equal pairs called different: 50.0 % (1/2" in text
    assert "strange effects called unexplained: 100.0 % (1/1" in text


def test_a_truth_comes_back_from_its_file():
    truth = truth_of("tyre stiffness", "gusts")
    assert truth_from(json.loads(json.dumps(asdict(truth)))) == truth


def test_answers_are_kept_between_runs_and_seeds_are_not_mixed(tmp_path):
    truth = truth_of("mass")
    said = Statement("mismatch", (found("mass", "drive_gain", scale=(1.0, 0.9, 1.1)),), True)
    answer = PairAnswer(pair_name(truth.number), said, "in words", 3.0)
    PairAnswers(tmp_path, True).keep(answer)
    assert PairAnswers(tmp_path, True).answer(truth) == answer
    assert not PairAnswers(tmp_path, False).has(truth)  # without held-out time it is another study
    (tmp_path / "truth.json").write_text(json.dumps({"seed": 700, "pairs": []}))
    with pytest.raises(ValueError, match="seed 700, not 701"):
        generate_pairs(tmp_path, 701, [0])


def test_a_differential_that_makes_tyres_slip_is_named_alone(tmp_path):
    """A constant yaw damping beside it left a shift of the CG and a steering gain; the car has brush tyres."""
    lock, car = 310.0, KINDS["sports car"].base
    planted = PlantedEffect("stiffer differential", "yaw_moment_differential", added={"lock": lock})
    truth = write_pair(tmp_path, 750, 2, (planted,), "sports car")
    (found,) = diagnosed(tmp_path, truth, False).said.findings
    assert found.term == "yaw_moment_differential"
    # Torque of the coupling over the wheels' difference of speeds is half the lock. Tyres that push across as well
    # slip more under the same force, which the term does not have: that takes about half of the damping.
    own = 0.5 * lock * (car.track / car.radius) ** 2
    assert 0.3 * own < found.parameters["yaw_damping"][0] < 1.2 * own


def test_a_higher_centre_of_gravity_is_named_alone_with_its_height(tmp_path):
    """What more load that moves across takes of the tyres was named as less grip beside a third less height."""
    truth = write_pair(tmp_path, 701, 10)
    (planted,) = truth.effects
    assert planted.name == "CG higher"
    (found,) = diagnosed(tmp_path, truth, False).said.findings
    assert found.term == "load_transfer"
    _, low, high = found.parameters["cg_height"]
    assert 0.5 * planted.values["cg_height"] < low < planted.values["cg_height"] < high
