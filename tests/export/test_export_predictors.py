"""Robust committee, table and projected process exported as C, CasADi, npz, json; the valid region."""

import json
from dataclasses import replace

import jsonschema
import numpy as np
import pytest

from split_cli.export.c_check import build_driver, check_c
from split_cli.export.casadi_function import check_casadi
from split_cli.export.check import check_predictions
from split_cli.export.documents import (
    document_answer,
    document_of,
    read_json,
    read_npz,
    schema_text,
    write_json,
    write_npz,
)
from split_cli.export.provenance import provenance_of
from split_cli.export.reference import SplineReference
from split_cli.export.step_check import make_step_oracle
from split_cli.export.symbolic import build_nominal
from split_cli.export.targets import casadi_functions, plan_export, predictor_tables, write_export
from split_cli.export.validity import is_valid, valid_function
from split_cli.learning.trust import Trust
from split_cli.prediction import make_predictor
from split_cli.prediction.table import TablePredictor
from split_cli.vehicle.single_track import SingleTrack
from tests.export.export_support import oracle_of, source_of
from tests.factories import make_training_set

PREDICTORS = ("rbcm", "table", "projected")


@pytest.fixture(scope="module")
def doubtful_set():
    """A set trusted by halves, so that trust is part of the comparison; long scales make small tables."""
    made = make_training_set(seed=3, points=300, length_scale_cells=4.0, noise=0.1)
    return replace(made, trust=Trust((0.5, 1.0, 0.0), "given"))


def test_the_table_s_reference_is_its_predictor(doubtful_set):
    table = TablePredictor(doubtful_set)
    z = table.training_set.z[:50] + 0.003
    found = SplineReference(table)
    trusted = make_predictor("bcm", table.training_set)
    assert type(trusted).__name__ == "TrustedPredictor"
    share = np.array(table.training_set.trust.share)
    np.testing.assert_allclose(found.predict(z).mean, share * table.predict(z).mean, atol=1e-14)
    np.testing.assert_allclose(found.jacobian_by_differences(z), share[:, None] * table.jacobian(z), atol=1e-7)


@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("predictor", PREDICTORS)
def test_c_agrees_with_python(doubtful_set, compiler, tmp_path, predictor, real):
    oracle = oracle_of(doubtful_set, 700, real, predictor)
    graph = build_nominal(SingleTrack(doubtful_set.vehicle), doubtful_set.features)
    source = source_of(doubtful_set, real, predictor=predictor)
    found = check_c(source, graph, doubtful_set, oracle, compiler, tmp_path)
    limit = {"double": 1e-13, "float": 1e-5}[real]
    assert found.predictions.mean_error < limit and found.predictions.variance_error < limit
    assert found.step_error < {"double": 1e-10, "float": 1e-3}[real]


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_casadi_agrees_with_python_derivatives_included(doubtful_set, predictor):
    oracle = oracle_of(doubtful_set, 200, predictor=predictor)
    graph = build_nominal(SingleTrack(doubtful_set.vehicle), doubtful_set.features)
    tables = predictor_tables(make_predictor(predictor, doubtful_set))
    functions = casadi_functions(tables, graph, "car", doubtful_set)
    steps = make_step_oracle(graph, doubtful_set, oracle.reference)
    check, step_error = check_casadi(functions, oracle, steps)
    assert check.mean_error < 1e-12 and check.jacobian_error < 1e-8 and step_error < 1e-10


@pytest.mark.parametrize("predictor", PREDICTORS)
def test_documents_carry_what_the_predictor_needs(doubtful_set, tmp_path, predictor):
    oracle = oracle_of(doubtful_set, 300, predictor=predictor)
    constants = predictor_tables(make_predictor(predictor, doubtful_set))
    document = document_of(doubtful_set, provenance_of(doubtful_set, predictor, "car.split", "a" * 64), constants)
    write_json(document, tmp_path / "car.json")
    write_npz(document, tmp_path / "car.npz")
    for found in (read_json(tmp_path / "car.json"), read_npz(tmp_path / "car.npz")):
        assert check_predictions(document_answer(found), oracle, "double", predictor).mean_error < 1e-12
    jsonschema.validate(json.loads((tmp_path / "car.json").read_text()), json.loads(schema_text()))


def test_a_table_takes_the_same_time_everywhere_and_has_no_branch_on_a_query(doubtful_set):
    """Loops of the evaluation have constant bounds, and no `if` there reads a number."""
    text = source_of(doubtful_set, predictor="table").source
    body = text[text.index("static size_t basis") : text.index("car_predict(")]
    lines = [line.strip() for line in body.splitlines()]
    conditions = [line for line in lines if line.startswith(("if", "} else if", "while"))]
    assert conditions == ["if (jacobian != NULL) {", "if (variance != NULL) {"]


def test_the_projected_process_is_exported_with_any_number_of_features(compiler, tmp_path):
    made = make_training_set(seed=5, points=60, features="z1", length_scale_cells=8.0, noise=0.1)
    plan = plan_export(("c", "npz"), "car", "double", 200, "projected")
    found = write_export(made, plan, provenance_of(made, "projected", "car.split", "a" * 64), tmp_path)
    assert all(target.check.mean_error < 1e-12 and target.check.variance_error < 1e-12 for target in found)
    z = made.z + 0.1 * made.kernel.length_scales
    mean, variance = document_answer(read_npz(tmp_path / "car.npz")).predict(z)
    expected = make_predictor("projected", made).predict(z)
    np.testing.assert_allclose(mean, expected.mean, atol=1e-11)
    np.testing.assert_allclose(variance, expected.variance, atol=1e-10)


def test_a_set_of_noise_alone_is_exported_as_well(doubtful_set):
    """Where a label's noise is above the signal no gain reaches the threshold, but for the first point."""
    kernel = replace(doubtful_set.kernel, noise_variance=2.0 * doubtful_set.kernel.signal_variance)
    oracle = oracle_of(replace(doubtful_set, kernel=kernel), 200, predictor="projected")
    assert oracle.predictor_error < 1e-12 and np.isfinite(oracle.mean).all()


def test_the_c_of_the_projected_process_is_loops_over_constants_and_has_no_branch_on_a_query(doubtful_set):
    """Small and large sets have the same code, which asks only what is wanted."""
    sets = (doubtful_set, make_training_set(seed=4, points=40, length_scale_cells=4.0, noise=0.1))
    codes = []
    for made in sets:
        text = source_of(made, predictor="projected").source
        codes.append(text[text.index("static void transposed_times") : text.index("void car_predict")])
    assert codes[0] == codes[1]
    conditions = [line.strip() for line in codes[0].splitlines() if line.strip().startswith(("if", "while"))]
    assert conditions == ["if (variance != NULL) {", "if (jacobian != NULL) {"]


def test_the_valid_region_is_that_of_training(doubtful_set, compiler, tmp_path):
    z = oracle_of(doubtful_set, 3000).z
    expected = is_valid(doubtful_set, z)
    assert 0.1 < expected.mean() < 0.9
    driver = build_driver(source_of(doubtful_set), tmp_path, compiler, ("-O0",))
    found = driver.answers(11, z, 1)[:, 0] > 0.5
    function = valid_function(doubtful_set)
    symbolic = np.asarray(function.map(len(z))(z.T))[0] > 0.5
    # Queries on a border to the last bit may fall on either side, as arithmetic orders differ.
    assert (found != expected).mean() < 0.01 and (symbolic != expected).mean() < 0.01
    assert expected[: len(doubtful_set.z)].any() and is_valid(doubtful_set, doubtful_set.z).all()
    spoiled = np.array([[np.nan, 0.0, 0.0], [0.0, np.inf, 0.0], [0.0, 0.0, 1e300]])
    assert not driver.answers(11, spoiled, 1).any()
