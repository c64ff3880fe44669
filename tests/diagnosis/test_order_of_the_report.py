"""The order of a diagnosis' page: what is found and not found stands before the charts."""

import re
from dataclasses import replace

from split_cli.diagnosis.statement.result import Detectable, Lead
from split_cli.plots.chart import Chart
from split_cli.workflows.report.sections import all_sections
from tests.diagnosis.test_report import MATCH, UNDECIDED, mismatch

CHART = Chart("strip-vx", "Longitudinal velocity v_x", "time [s]", "v_x [m/s]", (), wide=True)


def order(page: str) -> list[str]:
    """Return the names of a page's sections behind the verdict, from the top."""
    return re.findall(r'<section id="([a-z-]+)"', page)


def test_findings_and_their_errors_stand_before_the_charts():
    """The findings stood six screens below the headline, behind every chart."""
    lead = Lead("road_bank", "", {}, {}, 0.4, (), "A bank of 17 degrees would explain it.")
    diagnosis = replace(mismatch(), leads=(lead,), detectable=(Detectable("wind", {}),))
    page = all_sections(diagnosis, (CHART,))
    assert order(page) == ["what", "help", "leads", "not-judged", "would-show", "where", "motion", "read"]
    assert page.count(lead.sentence) == 1


def test_a_match_says_what_its_silence_is_worth_before_the_charts():
    page = all_sections(replace(MATCH, detectable=(Detectable("wind", {}),)), (CHART,))
    assert order(page) == ["not-judged", "would-show", "where", "motion", "read"]


def test_an_undecided_one_has_no_charts():
    assert order(all_sections(UNDECIDED, (CHART,))) == ["not-judged", "read"]
