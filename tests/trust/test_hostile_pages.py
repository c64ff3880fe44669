"""Every page of ours in a browser, with names that would act if they could: nothing runs, and the layout stays."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from split_cli.scoring.comparison import RunErrors, rank
from split_cli.scoring.report import EvaluationSettings
from split_cli.workflows.compare import ModelComparison
from split_cli.workflows.drive_charts import recording_charts
from split_cli.workflows.evaluate import evaluate
from split_cli.workflows.racing.race_page import race_page
from split_cli.workflows.report.comparison import comparison_page
from split_cli.workflows.report.evaluation import evaluation_page
from split_cli.workflows.report.page import report_page
from split_cli.workflows.report.recording import recording_page
from tests.control.test_race_report import race
from tests.diagnosis.test_report import mismatch
from tests.factories import make_drive, road_car

ACTS = "window.taken = 1"
ELEMENTS = f"</title></style></script><script>{ACTS}</script><img src=x onerror='{ACTS}'><svg onload={ACTS}>"
ATTRIBUTES = f"\" onmouseover=\"{ACTS}\" autofocus onfocus='{ACTS}' x='&quot;&#34;"
IN_JSON = f'"}}]}}</ScRiPt ><script>{ACTS}//\u2028\u2029\\u003c/script\\u003e<!--<script>'
LINKS = f"javascript:{ACTS} data:text/html,<script>{ACTS}</script> ${{{ACTS}}} {{{{{ACTS}}}}} `{ACTS}`"
NAMES = {
    "elements and attributes": ELEMENTS + ATTRIBUTES,
    "attributes, JSON and links": ATTRIBUTES + IN_JSON + LINKS,
    "JSON, directions and terminals": IN_JSON
    + "\u202elap\u2066\u200f\u061c \x1b[31m\x1b]0;x\x07\x9b2J\x00\x7f\udcff\ufeff",
}
LONG = {"one word of 10 kB, a Latin one with marks": "x" * 10_000 + " lap" + "\u0301" * 3000}
CLICKS = """
    const all = [...document.querySelectorAll("button, summary, input, a[href^='#']")];
    for (const button of all.slice(0, 12)) { button.click(); button.focus(); }
"""
FOUND = "vx is 3.6 times what the position says: km/h, not m/s"


def _recording(name: str) -> str:
    drive = replace(make_drive(3, 4, 4.0, vehicle=road_car()), name=name)
    told = {
        "consistency": {"findings": [{"text": f"{FOUND}; {name}"}]},
        "channels": [
            {
                "channel": name,
                "source": name,
                "rate": 100.0,
                "gaps": 1,
                "spikes": 2,
                "low": 0.0,
                "high": 30.0,
                "drops": [{"source": name, "reason": name, "count": 7}],
            }
        ],
        "contradictions": [name],
        "assumed": [name],
    }
    return recording_page(drive, told, recording_charts(drive, replace(road_car(), name=name)))


def _comparison(name: str) -> str:
    errors = {name: np.full((100, 3), 0.5), f"{name}2": np.full((100, 3), 1.0)}
    measured = np.stack([np.linspace(-1.0, 1.0, 100)] * 3, axis=1)
    scores = rank([RunErrors(1.0, errors, np.full((100, 3), 2.0), measured, np.arange(100) // 10)])
    told = (name,), (name,)
    return comparison_page(ModelComparison((name, f"{name}2"), (name,), 100, 0, scores, ((name, scores),), *told))


def _race(name: str) -> str:
    result = race(name)
    return race_page([replace(result, vehicle=name)], result.path)


@pytest.fixture(scope="module")
def evaluated():
    drive = make_drive(3, 40, 4.0, vehicle=road_car(), name="lap.parquet")
    settings = EvaluationSettings(predictors=("bcm",), rollout=(0.5,), any_vehicle=True)
    return evaluate([drive], road_car(), settings)


@pytest.fixture(scope="module")
def pages(evaluated) -> dict[str, Callable[[str], str]]:
    def evaluation(name: str) -> str:
        report = evaluated.report
        drives = tuple(replace(drive, name=name) for drive in report.drives)
        told = replace(report, vehicle=name, drives=drives, notes=(*report.notes, name))
        return evaluation_page(replace(evaluated, report=told))

    return {
        "ingest": _recording,
        "evaluate": evaluation,
        "diagnose": lambda name: report_page(mismatch(name)),
        "race": _race,
        "compare": _comparison,
    }


@pytest.mark.parametrize("command", ["ingest", "evaluate", "diagnose", "race", "compare"])
def test_no_name_acts_or_breaks_the_page(command, pages, browser, tmp_path):
    file = tmp_path / "page.html"

    def opened(page: str, width: int):
        file.write_text(page, encoding="utf-8")
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": width < 500}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get(file.as_uri())
        return browser

    def counted() -> list[int]:
        kinds = ["script", "style", "img", "iframe", "object", "a", "canvas", "section", "figure", "table", "form"]
        count = "return arguments[0].map((kind) => document.querySelectorAll(kind).length)"
        return browser.execute_script(count, kinds)

    opened(pages[command]("lap.parquet"), 1180)
    sound = counted()
    for kind, name in (NAMES | LONG).items():
        page = pages[command](name)
        for width in (1180, 420) if kind in LONG else (1180,):
            opened(page, width)
            browser.execute_script(CLICKS)
            assert browser.execute_script("return window.taken === undefined"), kind
            assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == [], kind
            assert counted() == sound, kind
            across = "return [document.documentElement.scrollWidth, window.innerWidth]"
            wide, window = browser.execute_script(across)
            assert wide <= window, f"{kind}, {width}"
        text = browser.find_element("css selector", "html").get_attribute("textContent")
        assert not set("\u202e\u2066\u200f\u061c\x1b\x9b\x07") & set(text), kind
