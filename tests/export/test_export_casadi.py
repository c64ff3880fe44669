"""CasADi's functions and the C it generates: value, Jacobian, Hessian and step."""

from dataclasses import replace

import casadi
import numpy as np
import pytest

from split_cli.errors import ExportError
from split_cli.export.casadi_function import (
    CasadiFunctions,
    check_casadi,
    check_hessian,
    committee_function,
    generate_c,
    model_step,
)
from split_cli.export.casadi_trust import trust_functions
from split_cli.export.generated_check import check_generated
from split_cli.export.step_check import make_step_oracle
from split_cli.export.symbolic import build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.targets import acados_source
from split_cli.vehicle.single_track import SingleTrack
from tests.export.export_support import build_acados_caller, oracle_of, take_cells


def functions_of(training_set):
    graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features)
    predict = committee_function(build_tables(training_set), "car")
    return graph, CasadiFunctions(predict, model_step(predict, graph, "car_step", training_set.plain))


@pytest.mark.parametrize("features", ["z2", "z1"])
def test_value_jacobian_hessian_and_step_agree(small_set, z1_set, features):
    training_set = small_set if features == "z2" else z1_set
    graph, functions = functions_of(training_set)
    oracle = oracle_of(training_set, 500)
    found, step_error = check_casadi(functions, oracle, make_step_oracle(graph, training_set, oracle.reference))
    assert found.mean_error < 1e-13 and found.variance_error < 1e-14
    assert found.jacobian_error < 1e-9
    assert step_error < 1e-11


def test_the_hessian_at_the_only_point_of_a_cell(small_set):
    # There 1 - q is the least it can be, rho/(1 + rho): a bound of just that gives half the second derivative.
    single = take_cells(small_set, 20, 1)
    _, functions = functions_of(single)
    oracle = oracle_of(single, 200)
    assert check_hessian(functions.predict, replace(oracle, slope_z=single.z)) < 1e-8


def test_a_wrong_function_is_refused(small_set):
    graph, functions = functions_of(small_set)
    z = casadi.MX.sym("z", 3)
    mean, variance = functions.predict(z)
    bent = casadi.Function("bent", [z], [mean * (1 + 1e-10), variance])
    oracle = oracle_of(small_set, 500)
    with pytest.raises(ExportError, match="mean is"):
        check_casadi(CasadiFunctions(bent, None), oracle, None)
    heavier = build_nominal(
        SingleTrack(type(small_set.vehicle)(**{**vars(small_set.vehicle), "mass": 1500.1})), small_set.features
    )
    wrong = model_step(functions.predict, heavier, "wrong")
    steps = make_step_oracle(graph, small_set, oracle.reference)
    with pytest.raises(ExportError, match="step"):
        check_casadi(CasadiFunctions(functions.predict, wrong), oracle, steps)
    trust = [trust_functions(functions.predict, one, "car", small_set.plain) for one in (graph, heavier)]
    with pytest.raises(ExportError, match="CasADi: the running trust is"):
        check_casadi(replace(functions, trust=(trust[0][0], trust[1][1])), oracle, steps)
    check_casadi(replace(functions, trust=trust[0]), oracle, steps)


def test_a_saved_function_answers_the_same(small_set, tmp_path):
    _, functions = functions_of(small_set)
    functions.predict.save(str(tmp_path / "car.casadi"))
    loaded = casadi.Function.load(str(tmp_path / "car.casadi"))
    assert (loaded.name_in(), loaded.name_out()) == (["z"], ["mean", "variance"])
    for z in small_set.z[:5]:
        pairs = zip(loaded(z), functions.predict(z), strict=True)
        assert all(np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs)


def test_generated_c_agrees(small_set, compiler, tmp_path):
    graph, functions = functions_of(small_set)
    generate_c(functions, "car", tmp_path)
    oracle = oracle_of(small_set, 500)
    scratch = tmp_path / "scratch"
    scratch.mkdir()
    steps = make_step_oracle(graph, small_set, oracle.reference)
    assert check_generated("car", tmp_path, scratch, compiler, oracle, True, steps) != 0
    text = (tmp_path / "car_casadi.c").read_text()
    # Tables of another set must not pass for those of this one.
    other = functions_of(take_cells(small_set, 50))[1]
    generate_c(other, "car", tmp_path)
    assert (tmp_path / "car_casadi.c").read_text() != text
    with pytest.raises(ExportError, match="CasADi's C"):
        check_generated("car", tmp_path, scratch, compiler, oracle, True, steps)


CALLER = """
#include "car_acados.c"
int main(void)
{
    static struct blasfeo_dvec state, input, next;
    static struct blasfeo_dmat slopes;
    struct blasfeo_dvec_args xa = {&state, 3}, ua = {&input, 1}, fa = {&next, 2};
    struct blasfeo_dmat_args ja = {&slopes, 0, 0};
    void *in[2] = {&xa, &ua};
    void *out[2] = {&fa, &ja};
    slopes.rows = 10;
    for (int k = 0; k < 8; ++k) { if (scanf("%lf", &state.pa[3 + k]) != 1) { return 2; } }
    for (int k = 0; k < 2; ++k) { if (scanf("%lf", &input.pa[1 + k]) != 1) { return 2; } }
    if (car_acados_fun(in, out, NULL)) { return 3; }
    for (int k = 0; k < 8; ++k) { printf("%.17g ", next.pa[2 + k]); }
    if (car_acados_fun_jac(in, out, NULL)) { return 4; }
    for (int k = 0; k < 8; ++k) { printf("%.17g ", next.pa[2 + k]); }
    for (int k = 0; k < 80; ++k) { printf("%.17g ", slopes.pA[k]); }
    return 0;
}
"""


def test_the_acados_adapter_hands_over_step_and_transposed_jacobian(small_set, compiler, tmp_path):
    # The offsets into the vectors are not zero.
    graph, functions = functions_of(small_set)
    generate_c(functions, "car", tmp_path)
    (tmp_path / "car_acados.c").write_text(acados_source("car", graph, 0.05))
    x = np.array([1.0, 2.0, 0.3, 22.0, 0.4, 0.3, 400.0, 0.03])
    u = np.array([500.0, 0.2])
    numbers = build_acados_caller(compiler, CALLER, tmp_path)([*x, *u])
    expected = np.asarray(functions.step(x, u, 0.05)).ravel()
    assert np.allclose(numbers[:8], expected, rtol=1e-13) and np.allclose(numbers[8:16], expected, rtol=1e-13)
    found = numbers[16:].reshape(8, 10)
    for column, (vector, index) in enumerate([(u, 0), (u, 1), *((x, k) for k in range(8))]):
        step = 1e-6 * (1.0 + abs(vector[index]))
        vector[index] += step
        ahead = np.asarray(functions.step(x, u, 0.05)).ravel()
        vector[index] -= 2 * step
        behind = np.asarray(functions.step(x, u, 0.05)).ravel()
        vector[index] += step
        # Central differences of second order: truncation 1e-12 of third derivatives, rounding 1e-10.
        assert np.allclose(found[:, column], (ahead - behind) / (2 * step), rtol=1e-6, atol=1e-7)
