"""Exports of vehicles with effects: every term and variant, alone and together, in C and CasADi."""

import json
import subprocess
from dataclasses import replace

import casadi
import numpy as np
import pytest

from split_cli.errors import ExportError
from split_cli.export.c_check import check_c
from split_cli.export.casadi_function import CasadiFunctions, committee_function, generate_c, model_step
from split_cli.export.casadi_step import memory_functions
from split_cli.export.compiler import STRICT_FLAGS
from split_cli.export.documents import document_of, read_json, require_equal, schema_text, write_json
from split_cli.export.provenance import provenance_of
from split_cli.export.stepped_model import rk4_substeps
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.targets import acados_source
from split_cli.learning.training_set import write_set
from split_cli.vehicle.effects import CATALOGUE, Recording
from split_cli.vehicle.integration import Situation, integrate_recorded, integrate_with_memory
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from split_cli.vehicle.windows import recorded_inputs
from split_cli.workflows.export import export_set
from tests.export.effect_cases import (
    CASES,
    REMEMBERING,
    SINGLES,
    STEP,
    Exported,
    build_library,
    effect,
    manoeuvre,
    silent_set,
)
from tests.export.export_support import build_acados_caller, oracle_of, source_of
from tests.factories import make_training_set, road_car
from tests.optional import needed

ALL = "everything with a memory"


@pytest.fixture(scope="session")
def exported(compiler, tmp_path_factory) -> dict[str, Exported]:
    """The C of every case in one library: starting the compiler 40 times would take most of the time."""
    return build_library(compiler, tmp_path_factory.mktemp("cases"), {"plain": (), **CASES})


def test_every_exported_term_and_variant_is_among_the_cases():
    expected = {(name, v) for name, kind in CATALOGUE.items() if kind.exported for v in kind.variants}
    expected -= {("steer_lag", "learned")}  # in test_export_learned_lag
    assert {(effects[0].term, effects[0].variant) for effects in SINGLES.values()} == expected
    for effects in CASES.values():
        SingleTrack(road_car(effects=effects))  # raises where a parameter is missing


def python_drive(case: Exported, substeps: int) -> np.ndarray:
    """Return (X, Y, yaw, v_x, v_y, r) at the end of the manoeuvre by the house's own means.

    Delays by `recorded_inputs`, the rest by one call of `integrate_recorded`, memory included: neither knows of
    whole states, past commands or single steps. Terms of time and place are told both at every step instead.
    """
    x, commands, t, s = manoeuvre()
    velocity = np.tile(x[3:6], (len(t), 1))
    clock = Recording.single(STEP, len(t))
    late = recorded_inputs(case.model, velocity, *commands.T, clock, Situation(t, s, x[2]))
    inputs = late.torque[None], late.steer_angle[None]
    if not case.graph.needs_place_and_time:
        return integrate_recorded(case.model, x[None, :6], *inputs, STEP, substeps)[0]
    state, states = x[None, :6], None
    for k in range(len(t) - 1):
        now = (series[:, k : k + 2] for series in inputs)
        situation = Situation(t[k], s[k], states=states)
        state, states = integrate_with_memory(case.model, state, *now, STEP, substeps, situation)
    return state[0]


@pytest.mark.parametrize("name", CASES)
def test_runge_kutta_drives_as_python_integrates_recordings(exported, name):
    case = exported[name]
    substeps = rk4_substeps(case.memory)
    end = case.drive(*manoeuvre(), rk4=substeps)[-1, :6]
    # Rounding of 40 steps of the same arithmetic; forces of 1e4 N leave 1e-12 of a velocity a step.
    assert np.allclose(end, python_drive(case, substeps), rtol=0, atol=1e-10)
    # And the effect is there: the plain car ends elsewhere, unless the term keeps features and has no force.
    plain = exported["plain"].drive(*manoeuvre(), rk4=substeps)[-1, :6]
    if name == "feature_lag":
        assert np.allclose(end, plain, rtol=0, atol=1e-10)
    else:
        assert np.abs(end - plain).max() > 1e-3


@pytest.mark.parametrize("name", CASES)
def test_casadi_and_c_drive_alike(exported, name):
    case = exported[name]
    x, commands, t, s = manoeuvre()
    path = case.drive(x, commands, t, s)
    predict = committee_function(build_tables(case.training_set), "car")
    step = model_step(predict, case.graph, "car_step")
    now = path[0]
    if case.memory is not None:
        start = memory_functions(predict, case.graph, "car")[0]
        now = np.asarray(start(x, *([[t[0], s[0]]] if case.graph.needs_place_and_time else []))).ravel()
    for k in range(len(commands) - 1):
        u = (commands[k + 1] - commands[k]) / STEP
        now = np.asarray(step(*[now, u, STEP, [t[k], s[k]]][: step.n_in()])).ravel()
        # Two orders of summation of the same series; sizes of states reach 1e4.
        assert np.allclose(now, path[k + 1], rtol=1e-10, atol=1e-10)


@pytest.mark.parametrize("name", REMEMBERING)
def test_the_right_hand_side_is_that_of_the_model(exported, name):
    case = exported[name]
    x, commands, t, s = manoeuvre()
    memory = case.memory
    late = (np.array([333.0, 0.021]),) if memory.line else ()
    now = case.drive(x, commands, t, s)[17]
    u, found = np.array([400.0, -0.3]), np.empty(memory.continuous)
    case.call("rates", now, u, *late, *case.place(t[17], s[17]), found)
    T, delta = late[0] if memory.line else now[6:8]
    states = dict(zip(memory.names, now[8:], strict=False)) or None
    flow = case.model.flow(*now[3:6], T, delta, yaw=now[2], t=t[17], s=s[17], states=states)
    cosine, sine = np.cos(now[2]), np.sin(now[2])
    pose = [now[3] * cosine - now[4] * sine, now[3] * sine + now[4] * cosine, now[5]]
    expected = [*pose, *case.model.balance(flow), *u, *(flow.rates[key] for key in memory.names)]
    assert np.allclose(found, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(("name", "column", "tau"), [("steer_lag", 7, 0.1), ("drive_lag", 6, 0.15)])
def test_a_lag_follows_a_ramp_as_its_closed_form_does(exported, name, column, tau):
    case = exported[name]
    x, commands, t, s = manoeuvre()
    slope = (0.0, 0.02)[column == 7] or 300.0
    commands = np.tile(commands[0], (len(t), 1))
    commands[:, column - 6] += slope * (t - t[0])
    path = case.drive(x, commands, t, s)
    clock = t - t[0]
    # tau y' = u - y, y(0) = u(0), u = u(0) + a t: y - u(0) = a (t - tau + tau e^(-t/tau)).
    expected = commands[0, column - 6] + slope * (clock - tau + tau * np.exp(-clock / tau))
    # The linearised step is exact for what is linear; 1e-12 of the signal.
    assert np.allclose(path[:, 8], expected, rtol=1e-12, atol=1e-12)
    # The Runge-Kutta step's error is (substep/tau)^4/120 of the signal, here 2e-5 with 3 substeps.
    assert np.allclose(case.drive(x, commands, t, s, rk4=3)[:, 8], expected, rtol=1e-4)


@pytest.mark.parametrize(("name", "column", "delay"), [("steer_delay", 7, 0.08), ("drive_delay", 6, 0.12)])
def test_a_delayed_ramp_arrives_shifted_and_linear_between_samples(exported, name, column, delay):
    case = exported[name]
    x, commands, t, s = manoeuvre()
    ramp = np.tile(commands[0], (len(t), 1))
    slope = 0.01 if column == 7 else 300.0
    ramp[:, column - 6] += slope * (t - t[0])
    path = case.drive(x, ramp, t, s)
    assert case.size == 8 + int(np.ceil(delay / STEP))
    arrived = np.empty((len(t), 2))
    for k, state in enumerate(path):
        case.call("arrived", np.ascontiguousarray(state), arrived[k])
    # Held before the start, then the ramp of `delay` ago: the kink at the start lies on a sample.
    expected = commands[0, column - 6] + slope * np.maximum(t - t[0] - delay, 0.0)
    assert np.allclose(arrived[:, column - 6], expected, rtol=1e-12)
    assert np.allclose(arrived[:, 7 - column], commands[0, 7 - column], rtol=1e-12)
    # The command itself is not late.
    assert np.allclose(path[:, column], ramp[:, column - 6], rtol=1e-12)


def test_a_delay_of_whole_steps_is_the_plain_car_with_shifted_commands(compiler, tmp_path):
    cases = {
        "late": (EffectSpec("steer_delay", {"delay": 3 * STEP}), EffectSpec("drive_delay", {"delay": STEP})),
        "plain": (),
    }
    built = build_library(compiler, tmp_path, cases)
    x, commands, t, s = manoeuvre()
    shifted = np.column_stack([commands[np.maximum(np.arange(len(t)) - k, 0), c] for c, k in ((0, 1), (1, 3))])
    found = built["late"].drive(x, commands, t, s)
    expected = built["plain"].drive(x, shifted, t, s)
    assert np.allclose(found[:, :6], expected[:, :6], rtol=0, atol=1e-12)
    # A whole number of steps needs just so many past commands, whatever 3 * 0.05 / 0.05 rounds to.
    assert found.shape[1] == 8 + 4


def test_another_interval_than_that_of_the_past_commands_is_refused(exported):
    case = exported["steer_delay"]
    x, commands, t, s = manoeuvre()
    now, following = case.start(x, t[0], s[0]), np.empty(case.size)
    for interval, finite in ((STEP, True), (STEP * 1.0005, True), (0.04, False), (0.06, False), (np.nan, False)):
        case.call("step", now, np.zeros(2), float(interval), following)
        assert np.isfinite(following).all() == finite
        step = model_step(committee_function(build_tables(case.training_set), "car"), case.graph, "car_step")
        assert np.isfinite(np.asarray(step(now, np.zeros(2), interval))).all() == finite


def test_a_play_keeps_still_until_it_is_dragged(exported):
    case = exported["steer_backlash"]
    x, commands, t, s = manoeuvre()
    commands = np.tile(commands[0], (len(t), 1))
    commands[:, 1] = 0.02 - np.abs(0.02 - 0.002 * np.arange(len(t)))[: len(t)]
    x[7] = commands[0, 1]
    wheel = case.drive(x, commands, t, s)[:, 8]
    # Up to 0.02 and down again, total play 0.01: half of it behind on the way up, at rest while the command goes
    # back through the whole play, half of it ahead on the way down.
    up, down = np.arange(11), np.arange(11, len(t))
    assert np.allclose(wheel[up], np.maximum(commands[up, 1] - 0.005, 0.0), atol=1e-15)
    assert np.allclose(wheel[down], np.minimum(0.015, commands[down, 1] + 0.005), atol=1e-15)


def test_the_exact_step_converges_to_the_model_in_second_order(compiler, tmp_path):
    """A short interval leaves no room for linearisation: both steps must meet, four times closer at half of it."""
    effects = (effect("steer_lag"), effect("drive_lag"), effect("tire_relaxation"))
    case = build_library(compiler, tmp_path, {"lags": effects})["lags"]
    x, *_ = manoeuvre()
    errors = []
    for h in (0.02, 0.01, 0.005):
        exact, fine = case.start(x, 0.0, 0.0), case.start(x, 0.0, 0.0)
        for k in range(round(0.4 / h)):
            u = np.array([800.0, 0.2 * np.cos(4.0 * k * h)])
            case.call("step", exact, u, h, exact)
            case.call("step_rk4", fine, u, h, 20, fine)
        errors.append(np.abs(exact - fine)[:6].max())
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert errors[-1] < 1e-4
    assert ((ratios > 3.5) & (ratios < 4.5)).all()


CALLER = """
#include "car.h"
#include <stdio.h>

/* A controller's predictor: reads the first eight states, then a command a line, and prints every whole state. */
int main(void)
{
    car_real x[CAR_STATES], A[CAR_STATES * CAR_STATES], B[CAR_STATES * CAR_INPUTS];
    car_real y[CAR_STATES], f[CAR_CONTINUOUS_STATES], a[2];
    car_trust trust = {{1, 1, 1}, {0}, {0}};
    double value, torque, angle, s = 3.0, t = 3.0;
    for (int i = 0; i < 8; ++i) {
        if (scanf("%lf", &value) != 1) {
            return 1;
        }
        x[i] = (car_real)value;
    }
    car_start(x, (car_real)t, (car_real)s);
    while (scanf("%lf %lf", &torque, &angle) == 2) {
        const car_real h = CAR_TIME_STEP;
        const car_real u[2] = {((car_real)torque - x[6]) / h, ((car_real)angle - x[7]) / h};
        car_arrived(x, a);
        car_rates(x, u, a, (car_real)t, (car_real)s, f);
        car_linearise(x, u, (car_real)t, (car_real)s, h, A, B);
        car_step_rk4(x, u, (car_real)t, (car_real)s, h, 1, y);
        car_observe(x, u, (car_real)t, (car_real)s, h, 1, y, &trust);
        car_step_trusted(y, u, (car_real)t, (car_real)s, h, 1, &trust, y);
        car_linearise_trusted(x, u, (car_real)t, (car_real)s, h, &trust, A, B);
        car_step(x, u, (car_real)t, (car_real)s, h, x);
        t += (double)h;
        s += (double)h * (double)x[3];
        for (int i = 0; i < CAR_STATES; ++i) {
            printf("%.17g ", (double)x[i]);
        }
    }
    return 0;
}
"""


@pytest.mark.parametrize("real", ["double", "float"])
def test_a_hand_written_caller_runs_clean_under_sanitizers(exported, compiler, tmp_path, real):
    case = exported[ALL]
    source = source_of(case.training_set, real)
    (tmp_path / "car.h").write_text(source.header)
    (tmp_path / "car.c").write_text(source.source)
    # One substep is asked for, the play needs ten.
    (tmp_path / "caller.c").write_text(CALLER)
    flags = [*STRICT_FLAGS, "-Wshadow", "-O1", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]
    try:
        compiler.build([tmp_path / "car.c", tmp_path / "caller.c"], tmp_path / "caller", flags)
    except ExportError as error:
        if "sanitize" in str(error) or "lasan" in str(error) or "lubsan" in str(error):
            pytest.skip("the compiler has no sanitizers")
        raise
    x, commands, t, _ = manoeuvre(20)
    text = " ".join(map(repr, x.tolist())) + "\n" + "\n".join(f"{a!r} {b!r}" for a, b in commands[1:].tolist())
    done = subprocess.run([str(tmp_path / "caller")], input=text, capture_output=True, text=True, check=True)
    found = np.array(done.stdout.split(), dtype=float).reshape(20, case.size)
    now, place, expected = case.start(x, t[0], 3.0), 3.0, []
    for k in range(20):
        u = np.ascontiguousarray((commands[k + 1] - now[6:8]) / STEP)
        case.call("step", now, u, float(t[0] + k * STEP), float(place), STEP, now)
        place += STEP * now[3]
        expected.append(now.copy())
    tolerance = {"double": 1e-9, "float": 2e-3}[real]
    assert np.allclose(found, expected, rtol=tolerance, atol=tolerance)


@pytest.mark.parametrize("real", ["double", "float"])
def test_verification_covers_memory_residual_and_linearisation(compiler, tmp_path, real):
    training_set = make_training_set(seed=5, points=150, vehicle=road_car(effects=CASES[ALL]))
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    oracle = oracle_of(training_set, 300, real)
    found = check_c(source_of(training_set, real), graph, training_set, oracle, compiler, tmp_path)
    assert found.step_error < {"double": 1e-11, "float": 1e-3}[real]


MUTATIONS = {
    "the line does not move": (
        "x_next[i] = k == 0 && LATE_T > 0 ? x[6] : (k == LATE_T ? x[7] : x[i - 1]);",
        "x_next[i] = k == 0 && LATE_T > 0 ? x[6] : (k == LATE_T ? x[7] : x[i]);",
    ),
    "shares the other way round": ("sum += share[1 + k] * line[k];", "sum += share[1 + k] * line[count - 1 - k];"),
    "a play that is let go": ("f[play[k]] = rates[k];", "f[play[k]] += ZERO * rates[k];"),
    "memory that starts at rest": ("nominal_start(in, out);\n", "nominal_start(in, out);\n    x[9] = ZERO;\n"),
    "the residual sees late torque": ("w[STATES] = command[0];", "w[STATES] = state[6] + ZERO * command[0];"),
    "slopes without the play": ("drive[play[k]] = h != ZERO ?", "drive[play[k]] = h == ZERO ?"),
    "a trust that mixes up the velocities": ("running->driven[4 * column + k % 4]", "running->driven[k]"),
    "a right-hand side without residual": ("rates[3 + o] += at.g[o];", "rates[3 + o] += ZERO * at.g[o];"),
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_wrong_memory_is_caught_before_anything_is_written(compiler, tmp_path, name):
    effects = tuple(effect(term) for term in ("steer_delay", "drive_delay", "steer_backlash", "drive_lag"))
    training_set = make_training_set(seed=5, points=60, vehicle=road_car(effects=effects))
    source = source_of(training_set)
    before, after = MUTATIONS[name]
    assert source.source.count(before) == 1
    wrong = replace(source, source=source.source.replace(before, after))
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    with pytest.raises(ExportError, match="nothing was written"):
        check_c(wrong, graph, training_set, oracle_of(training_set, 100), compiler, tmp_path)


def test_sensor_terms_correct_recordings_and_leave_no_trace(compiler, tmp_path):
    sensors = (EffectSpec("sensor_delay", {"delay": 0.07}), EffectSpec("sensor_lever_arm", {"dx": 0.4}))
    built = build_library(compiler, tmp_path, {"with": sensors, "without": ()})
    x, commands, t, s = manoeuvre()
    with_sensors, without = (built[name].drive(x, commands, t, s) for name in ("with", "without"))
    assert np.array_equal(with_sensors, without)


@pytest.mark.parametrize(
    ("effects", "message"),
    [
        ([EffectSpec("tire_relaxation", {"length": 1e-3})], "tire_relaxation reacts within .* too fast"),
        ([EffectSpec("steer_delay", {"delay": 2.2})], "220 past commands"),
        ([EffectSpec("steer_lag", {"tau": 0.1}), EffectSpec("steer_lag", {"tau": 0.2})], "twice"),
    ],
)
def test_a_memory_that_no_step_can_keep_is_refused(effects, message):
    training_set = silent_set()
    with pytest.raises(ExportError, match=message):
        build_nominal(SingleTrack(road_car(effects=tuple(effects))), training_set.features, 0.01)


def test_a_lag_of_no_time_is_exported_as_none(tmp_path):
    """The set's own check compares the C with Python step by step, over many queries."""
    effects = (EffectSpec("steer_lag", {"tau": 0.0}), EffectSpec("tire_relaxation", {"length": 0.0}))
    write_set(silent_set(effects), tmp_path / "car.split")
    export_set(tmp_path / "car.split", tmp_path / "out", ["c"], queries=100, insist=True)
    assert (tmp_path / "out" / "car.c").exists()


def test_the_controllers_interval_decides_how_many_past_commands_there_are(tmp_path):
    write_set(silent_set((effect("steer_delay"),)), tmp_path / "car.split")
    for step, past in ((0.02, 4), (0.08, 1), (0.1, 1), (None, 2)):
        export_set(tmp_path / "car.split", tmp_path / "out", ["npz"], queries=100, step=step, insist=True)
        memory = json.loads((tmp_path / "out" / "manifest.json").read_text())["memory"]
        assert (memory["step"], len(memory["states"])) == (step or 0.05, past)
    with pytest.raises(ExportError, match="step of"):
        export_set(tmp_path / "car.split", tmp_path / "out", ["npz"], queries=100, step=-0.02, insist=True)


def test_numbers_tell_of_the_memory_and_fit_their_schema(tmp_path):
    jsonschema = needed("jsonschema")
    training_set = silent_set(CASES["steer_delay+steer_lag"])
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features, STEP)
    provenance = replace(provenance_of(training_set, "bcm"), memory=graph.memory.to_mapping())
    document = document_of(training_set, provenance)
    write_json(document, tmp_path / "car.json")
    require_equal(document, read_json(tmp_path / "car.json"), "json")
    content = json.loads((tmp_path / "car.json").read_text())
    jsonschema.validate(content, json.loads(schema_text()))
    assert content["memory"]["states"] == [
        "steer_lag.angle [rad]",
        "delta of 1 step ago [rad]",
        "delta of 2 steps ago [rad]",
    ]
    assert content["memory"]["delays"] == {"T": 0.0, "delta": 0.08} and content["memory"]["step"] == STEP


ACADOS_CALLER = """
#include "car_acados.c"
int main(void)
{
    static struct blasfeo_dvec state, input, next;
    static struct blasfeo_dmat slopes;
    struct blasfeo_dvec_args xa = {&state, 0}, ua = {&input, 0}, fa = {&next, 0};
    struct blasfeo_dmat_args ja = {&slopes, 0, 0};
    void *in[2] = {&xa, &ua};
    void *out[2] = {&fa, &ja};
    double p[2] = {0.0, 0.0};
    slopes.rows = CAR_NV;
    for (int k = 0; k < CAR_NX; ++k) { if (scanf("%lf", &state.pa[k]) != 1) { return 2; } }
    for (int k = 0; k < 2; ++k) { if (scanf("%lf", &input.pa[k]) != 1) { return 2; } }
    for (int k = 0; k < 2; ++k) { if (scanf("%lf", &p[k]) != 1) { return 2; } }
    if (car_acados_fun(in, out, p)) { return 3; }
    for (int k = 0; k < CAR_NX; ++k) { printf("%.17g ", next.pa[k]); }
    if (car_acados_fun_jac(in, out, p)) { return 4; }
    for (int k = 0; k < CAR_NV * CAR_NX; ++k) { printf("%.17g ", slopes.pA[k]); }
    return 0;
}
"""


def test_acados_gets_the_memory_as_states_and_time_and_place_as_parameters(exported, compiler, tmp_path):
    case = exported["friction_patch+steer_lag"]
    predict = committee_function(build_tables(case.training_set), "car")
    step = model_step(predict, case.graph, "car_step")
    generate_c(CasadiFunctions(predict, step), "car", tmp_path)
    (tmp_path / "car_acados.c").write_text(acados_source("car", case.graph, STEP))
    ask = build_acados_caller(compiler, ACADOS_CALLER, tmp_path)
    x, commands, t, s = manoeuvre()
    now, u = case.drive(x, commands, t, s)[9], np.array([300.0, 0.2])
    answers = []
    for place in (20.0, 100.0):  # on the patch and beyond it
        numbers = ask([*now, *u, t[9], place])
        expected = np.empty(9)
        case.call("step", now, u, float(t[9]), place, STEP, expected)
        assert np.allclose(numbers[:9], expected, rtol=1e-12, atol=1e-12)
        symbols = [casadi.MX.sym("x", 9), casadi.MX.sym("u", 2)]
        slopes = casadi.jacobian(step(*symbols, STEP, [t[9], place]), casadi.vertcat(symbols[1], symbols[0]))
        expected = np.asarray(casadi.Function("slopes", symbols, [casadi.densify(slopes)])(now, u))
        assert np.allclose(numbers[9:].reshape(9, 11), expected, rtol=1e-10, atol=1e-12)
        answers.append(numbers[:9])
    assert np.abs(answers[0] - answers[1]).max() > 1e-4
