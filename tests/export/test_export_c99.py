"""The exported C: compiled as strictly as users do, compared with Python, and broken on purpose."""

import shutil
import subprocess
from dataclasses import replace

import casadi
import numpy as np
import pytest

from split_cli.errors import ExportError
from split_cli.export import tables as tables_module
from split_cli.export.c99 import c_identifier, c_source
from split_cli.export.c_check import build_driver, check_c, driver_answer
from split_cli.export.check import check_predictions
from split_cli.export.compiler import STRICT_FLAGS, find_compiler
from split_cli.export.provenance import provenance_of
from split_cli.export.straight_line import straight_line
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.validity import valid_function
from split_cli.learning.features import FeatureSet
from split_cli.vehicle.effects.term import Term
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.export.export_support import oracle_of, source_of, take_cells
from tests.factories import make_training_set, road_car


def graph_of(training_set):
    return build_nominal(SingleTrack(training_set.vehicle), training_set.features)


def checked(training_set, compiler, folder, real="double", queries=1000):
    oracle = oracle_of(training_set, queries, real)
    return check_c(source_of(training_set, real), graph_of(training_set), training_set, oracle, compiler, folder)


def test_double_agrees_with_python(small_set, compiler, tmp_path):
    found = checked(small_set, compiler, tmp_path)
    # 1e-12 is the contract; what rounding leaves is far below, so that a loss of digits would show.
    assert found.predictions.mean_error < 1e-13
    assert found.predictions.variance_error < 1e-14
    assert found.predictions.jacobian_error < 1e-9
    assert found.step_error < 1e-11


def test_five_features_agree_with_python(z1_set, compiler, tmp_path):
    found = checked(z1_set, compiler, tmp_path)
    assert found.predictions.mean_error < 1e-13
    assert found.step_error < 1e-11


def test_float_agrees_with_python_within_its_tolerance(small_set, compiler, tmp_path):
    found = checked(small_set, compiler, tmp_path, "float")
    assert 1e-9 < found.predictions.mean_error <= 1e-5
    assert found.predictions.variance_error <= 1e-5


def test_what_single_precision_cannot_hold_is_refused(compiler, tmp_path):
    # Length scales of four cells and hardly any noise: matrices are near singular, float loses a digit more.
    stiff = make_training_set(seed=0, points=1500, noise=0.0005, length_scale_cells=4.0)
    with pytest.raises(ExportError, match="Single precision cannot hold"):
        checked(stiff, compiler, tmp_path, "float")
    assert checked(stiff, compiler, tmp_path, "double").predictions.mean_error <= 1e-12


def test_single_point_set(small_set, compiler, tmp_path):
    found = checked(take_cells(small_set, 1, 1), compiler, tmp_path, queries=200)
    assert found.predictions.mean_error < 1e-14


def test_plain_labels_are_added_without_phi(small_set, compiler, tmp_path):
    # check_c compares the step with x + f_h + h g; a source that used Phi all the same must fail.
    plain = replace(small_set, plain=True)
    assert checked(plain, compiler, tmp_path).step_error < 1e-11
    oracle = oracle_of(plain, 500)
    with pytest.raises(ExportError, match="step|linearisation"):
        check_c(source_of(small_set), graph_of(plain), plain, oracle, compiler, tmp_path)


def test_an_empty_set_is_refused(small_set):
    with pytest.raises(ExportError, match="empty"):
        build_tables(take_cells(small_set, 0))


def test_a_set_that_is_not_finite_is_refused(small_set):
    y = small_set.y.copy()
    y[5, 1] = np.nan
    with pytest.raises(ExportError, match="non-finite y"):
        build_tables(replace(small_set, y=y))


def test_no_writable_globals_and_no_allocation(small_set, compiler, tmp_path):
    if shutil.which("nm") is None:
        pytest.skip("there is no nm")
    source = source_of(small_set)
    (tmp_path / "car.h").write_text(source.header)
    (tmp_path / "car.c").write_text(source.source)
    compiler.build([tmp_path / "car.c"], tmp_path / "car.o", [*STRICT_FLAGS, "-O2", "-c"])
    lines = subprocess.run(["nm", str(tmp_path / "car.o")], capture_output=True, text=True).stdout.splitlines()
    symbols = [line.split()[-2:] for line in lines]
    assert not [name for kind, name in symbols if kind in "dDbBcC"]
    external = {name for kind, name in symbols if kind == "U"} - {"_GLOBAL_OFFSET_TABLE_"}
    # Nothing but the mathematics library, and what compilers put in place of loops.
    known = {"exp", "sin", "cos", "atan", "atan2", "sqrt", "sincos", "fmin", "fmax", "memset", "memcpy", "memmove"}
    assert external <= known


MUTATIONS = {
    "reference": lambda v: v + 1e-9,
    "points": lambda v: v * (1 + 1e-8),
    "eigenvectors": lambda v: v * (1 + 1e-8),
    "gains": lambda v: v * (1 + 1e-8),
    "weights": lambda v: v * (1 + 1e-8),
    "signal_variance": lambda v: v * (1 + 1e-8),
    "length_scales": lambda v: v * (1 + 1e-8),
    "reach": lambda v: v / 3,
}


@pytest.mark.parametrize("name", MUTATIONS)
def test_a_tampered_table_is_caught(small_set, small_oracle, compiler, tmp_path, name):
    tables = build_tables(small_set)
    values = getattr(tables, name).copy()
    # One number of one cell in the middle; for the vectors of all cells the last entry.
    place = len(values) // 2 if len(values) > 5 else -1
    values[place] = MUTATIONS[name](values[place])
    tampered = replace(tables, **{name: values})
    valid = valid_function(small_set)
    source = c_source(tampered, graph_of(small_set), provenance_of(small_set, "bcm"), "car", valid)
    answer = driver_answer(build_driver(source, tmp_path, compiler, ("-O0",)), 3)
    with pytest.raises(ExportError, match="nothing was written"):
        check_predictions(answer, small_oracle, "double", "C")


def test_the_bound_on_skipped_cells_holds_and_is_used(small_set, small_oracle, compiler, tmp_path, monkeypatch):
    # With a bound of 1e-4 many more cells are skipped: answers must change, but by less than that.
    monkeypatch.setitem(tables_module.SKIP_TOLERANCE, "double", 1e-4)
    driver = build_driver(source_of(small_set), tmp_path, compiler)
    near = (np.abs(small_oracle.z) < 1.0).all(axis=1)
    answers = driver.answers(0, small_oracle.z[near], 6)
    deviation = small_oracle.reference.deviation
    mean_error = np.abs((answers[:, :3] - small_oracle.mean[near]) / deviation).max()
    variance_error = np.abs((answers[:, 3:] - small_oracle.variance[near]) / deviation**2).max()
    assert 1e-9 < mean_error < 1e-4
    assert variance_error < 1e-4


def test_effects_of_the_vehicle_are_in_the_step(compiler, tmp_path):
    effects = (
        EffectSpec("aero_drag", {"drag": 0.4}),
        EffectSpec("yaw_moment_differential", {"yaw_damping": 900.0, "slip_stiffness": 0.1}, "slip"),
    )
    training_set = make_training_set(seed=5, points=150, vehicle=road_car(effects=effects))
    assert checked(training_set, compiler, tmp_path, queries=300).step_error < 1e-11
    plain = graph_of(replace(training_set, vehicle=road_car()))
    valid = valid_function(training_set)
    source = c_source(build_tables(training_set), plain, provenance_of(training_set, "bcm"), "car", valid)
    with pytest.raises(ExportError, match="linearisation|step"):
        check_c(source, graph_of(training_set), training_set, oracle_of(training_set, 300), compiler, tmp_path)


class Headwind(Term):
    """A force that grows with time and place, so that the step needs both."""

    id = "headwind"
    units = {}

    def external(self, flow):
        flow.force_x = flow.force_x - 100.0 * flow.t - 2.0 * flow.s


class Untraceable(Headwind):
    def external(self, flow):
        if (flow.vx > 30.0).any():
            flow.force_x = flow.force_x - 1.0


class Branching(Headwind):
    def external(self, flow):
        if isinstance(flow.vx, np.ndarray):
            flow.force_x = flow.force_x - 1.0


class Stateful(Headwind):
    states = ("lagged",)


def test_terms_of_time_and_place_take_them_as_arguments(small_set, compiler, tmp_path):
    graph = build_nominal(SingleTrack(small_set.vehicle, [Headwind({})]), small_set.features)
    valid = valid_function(small_set)
    source = c_source(build_tables(small_set), graph, provenance_of(small_set, "bcm"), "car", valid)
    assert "car_real t, car_real s, car_real h" in source.header
    driver = build_driver(source, tmp_path, compiler)
    state = [0, 0, 0, 20.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1e-3]
    at = driver.answers(1, np.array([[*state, 0.0, 0.0], [*state, 30.0, 0.0], [*state, 0.0, 500.0]]), 8)
    # Over a millisecond the change of speed is h F/m up to the drag's own 1e-6.
    assert np.allclose((at[1:, 3] - at[0, 3]) / 1e-3, [-3000.0 / 1500.0, -1000.0 / 1500.0], rtol=1e-5)
    # The Runge-Kutta step lets place and time advance: the force grows by 100 h and 2 v h, its mean by half.
    state[10] = 0.1
    at = driver.answers(2, np.array([[*state, 0.0, 0.0]]), 8)
    frozen = driver.answers(1, np.array([[*state, 0.0, 0.0]]), 8)
    expected = -0.1 * (100.0 * 0.05 + 2.0 * 20.0 * 0.05) / 1500.0
    assert np.isclose(at[0, 3] - frozen[0, 3], expected, rtol=0.01)


@pytest.mark.parametrize(
    ("term", "message"),
    [(Untraceable, "traced symbolically"), (Branching, "not the one"), (Stateful, "no term says how it changes")],
)
def test_terms_that_cannot_be_exported_are_refused(small_set, term, message):
    with pytest.raises(ExportError, match=message):
        build_nominal(SingleTrack(small_set.vehicle, [term({})]), small_set.features)


def test_a_feature_that_no_state_determines_leaves_the_predictor(compiler, tmp_path):
    training_set = replace(make_training_set(seed=6, points=100), features=FeatureSet(("alpha_f", "alpha_r", "ax")))
    source = source_of(training_set)
    assert not source.with_step and "car_step" not in source.header
    oracle = oracle_of(training_set, 300)
    found = check_c(source, graph_of(training_set), training_set, oracle, compiler, tmp_path)
    assert found.step_error is None and found.predictions.mean_error < 1e-13


@pytest.mark.parametrize("real", ["double", "float"])
def test_straight_line_c_computes_what_casadi_does(compiler, tmp_path, real):
    a, b = casadi.SX.sym("a"), casadi.SX.sym("b")
    expressions = [
        casadi.if_else(a < b, casadi.sin(a), casadi.cos(b)),
        casadi.atan2(a, b),
        casadi.tanh(a) / b,
        casadi.fmin(a, b) - casadi.fmax(a, 2 * b),
        casadi.sqrt(a * a + 1),
        casadi.exp(-a),
        1 / b,
        -a,
        casadi.fabs(a),
        casadi.sign(a),
        a**3,
        casadi.if_else(casadi.logic_and(a > 0, b > 0), a, b),
        casadi.if_else(casadi.logic_not(a >= b), 1, -2.5),
        a**b * 0 + casadi.log(a * a + 2),
    ]
    count = len(expressions)
    function = casadi.Function("f", [casadi.vertcat(a, b)], [casadi.vertcat(*expressions)], {"cse": True})
    body = straight_line(function, "computed", real, "test")
    program = (
        f"#include <math.h>\n#include <stdio.h>\ntypedef {real} real;\n{body}"
        "int main(void)\n{\n    real z[2], y[32];\n    const real *in[1];\n    real *out[1];\n"
        "    double a, b;\n    in[0] = z;\n    out[0] = y;\n"
        '    while (scanf("%lf %lf", &a, &b) == 2) {\n        z[0] = (real)a;\n        z[1] = (real)b;\n'
        f"        computed(in, out);\n        for (int k = 0; k < {count}; ++k) {{\n"
        '            printf("%.17g ", (double)y[k]);\n        }\n    }\n    return 0;\n}\n'
    )
    (tmp_path / "f.c").write_text(program)
    compiler.build([tmp_path / "f.c"], tmp_path / "f", [*STRICT_FLAGS, "-O1"])
    inputs = np.random.default_rng(1).normal(0.0, 2.0, (50, 2)).astype(np.float32).astype(float)
    inputs[:2] = [[1.5, 1.5], [2.0, 3.0]]
    inputs[2:, 0] = np.abs(inputs[2:, 0])
    text = "\n".join(f"{x!r} {y!r}" for x, y in inputs.tolist())
    said = subprocess.run([str(tmp_path / "f")], input=text, capture_output=True, text=True, check=True).stdout
    found = np.array(said.split(), dtype=float).reshape(-1, count)
    expected = np.array([np.asarray(function(row)).ravel() for row in inputs])
    # One rounding of the precision each, of a library that is not CasADi's.
    assert np.allclose(
        found, expected, rtol=1e-14 if real == "double" else 1e-5, atol=1e-14 if real == "double" else 1e-5
    )


@pytest.mark.parametrize(
    ("text", "identifier"),
    [
        ("road_car", "road_car"),
        ("my car.v2", "my_car_v2"),
        ("9 lives", "model_9_lives"),
        ("", "model"),
        ("while", "model_while"),
        ("größe", "gr_e"),
        ("__x__", "x"),
        ("../../etc/passwd", "etc_passwd"),
        ("a" * 90, "a" * 48),
    ],
)
def test_any_name_becomes_an_identifier(text, identifier):
    assert c_identifier(text) == identifier
    assert c_identifier(identifier) == identifier


def test_a_vehicle_name_cannot_leave_its_comment(small_set, compiler, tmp_path):
    spoiled = replace(small_set, vehicle=replace(small_set.vehicle, name="*/ #error @NAME@ \\\n größe"))
    source = source_of(spoiled)
    assert "*/ #error" not in source.header
    build_driver(source, tmp_path, compiler)


def test_a_compiler_that_does_not_exist_is_named(monkeypatch):
    monkeypatch.setenv("CC", "no-such-compiler -O9")
    with pytest.raises(ExportError, match="no-such-compiler"):
        find_compiler()
