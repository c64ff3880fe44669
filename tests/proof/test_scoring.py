"""Judging statements, intervals of rates, and what becomes of them in a score."""

import numpy as np
import pytest

from split_cli.proof.cases import Answer, ConcealedEffect
from split_cli.proof.outcome import Named, Statement, judge, share_of_true, wilson
from split_cli.proof.scoring import CaseScore, score_case, score_of_cases


@pytest.mark.parametrize(("hits", "of"), [(0, 190), (7, 7), (3, 4), (50, 100), (1, 1000)])
def test_the_wilson_interval_solves_its_quadratic(hits, of):
    # (p - p_hat)^2 = z^2 p (1 - p)/n as a polynomial in p, solved by its companion matrix.
    share, z2 = hits / of, 1.959963984540054**2
    roots = np.sort(np.roots([1.0 + z2 / of, -2.0 * share - z2 / of, share**2]).real)
    np.testing.assert_allclose(wilson(hits, of), roots, atol=1e-9)


def test_no_false_alarm_in_190_nulls_allows_to_claim_two_per_cent():
    assert wilson(0, 190)[1] < 0.02 < wilson(0, 188)[1] + 1e-3
    assert share_of_true([]).share is None


def said(*names, unexplained=False, **alternatives):
    found = tuple(Named(name, alternatives=tuple(alternatives.get(name, ()))) for name in names)
    return Statement("mismatch", found, unexplained)


@pytest.mark.parametrize(
    ("truth", "statement", "outcome"),
    [
        ((), Statement("match"), "exact"),
        ((), Statement("undecided"), "exact"),
        ((), said(unexplained=True), "wrong"),
        (("mass",), said("mass"), "exact"),
        (("mass",), said("drive_gain", drive_gain=["mass"]), "class"),
        (("mass",), said("drive_gain", drive_gain=["wind", "mass+yaw_inertia"]), "wrong"),
        (("mass", "yaw_inertia"), said("drive_gain", drive_gain=["mass+yaw_inertia"]), "class"),
        (("mass",), said("mass", "wind"), "wrong"),
        (("mass",), said("wind", unexplained=True), "abstained"),
        (("mass",), said(unexplained=True), "abstained"),
        (("mass",), Statement("match"), "missed"),
        (("mass", "wind"), said("wind", "mass"), "exact"),
        (("mass", "wind"), said("mass"), "wrong"),
        (("mass", "wind"), said("drive_gain", "wind", drive_gain=["mass"]), "class"),
    ],
)
def test_statements_are_judged_as_a_reader_would_take_them(truth, statement, outcome):
    assert judge(truth, statement) == outcome


@pytest.mark.parametrize(
    ("statement", "outcome"),
    [
        (said(unexplained=True), "exact"),
        (said("wind", unexplained=True), "exact"),
        (said("wind"), "wrong"),
        (Statement("match"), "missed"),
    ],
)
def test_outside_the_catalogue_only_abstaining_is_right(statement, outcome):
    assert judge(("slosh",), statement, in_catalogue=False) == outcome


def answer(kind="single", tier="realistic", *terms, number=0):
    effects = tuple(ConcealedEffect(term, 0.1, 0.5, {"scale": 1.1}, ("scale",)) for term in terms)
    return Answer(number, kind, tier, effects, "road_car", "bare", "plant", 0.01, 0.5, 1.0)


def test_coverage_counts_rightly_named_parameters_only():
    right = Statement("mismatch", (Named("mass", {"scale": (1.09, 1.05, 1.12)}),))
    narrow = Statement("mismatch", (Named("mass", {"scale": (1.02, 1.01, 1.03)}),))
    other = Statement("mismatch", (Named("wind", {"wx": (1.0, 0.0, 2.0)}),))
    scores = [
        score_case(str(i), answer("single", "realistic", "mass"), s, None, np.ones(3), None)
        for i, s in enumerate((right, narrow, other))
    ]
    assert [s.covered for s in scores] == [(("mass.scale", True),), (("mass.scale", False),), ()]
    score = score_of_cases(scores)
    assert (score.coverage.hits, score.coverage.of) == (1, 2)
    rates = dict(score.groups)["single realistic"]
    assert {name: rate.hits for name, rate in rates.items() if rate.hits} == {"exact": 2, "wrong": 1}
    assert score.confusion == (("mass", "wind", 1),)


def test_targets_are_met_or_not_by_their_own_measure():
    nulls = [CaseScore(str(i), answer("null", ""), Statement("match"), "exact") for i in range(99)]
    alarm = CaseScore("99", answer("null", ""), said("wind"), "wrong")
    met = {what: ok for what, _, _, ok in score_of_cases([*nulls, alarm]).targets}
    assert met["nulls called a mismatch"] is True
    assert met["pairs, both right"] is None
    met = {what: ok for what, _, _, ok in score_of_cases([*nulls[:9], alarm]).targets}
    assert met["nulls called a mismatch"] is False
