"""Pages of a recording and of an evaluation: what they say first, and that names of others stay text."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from split_cli.plots.charts import handling, handling_charts
from split_cli.scoring.handling.understeer import Understeer
from split_cli.scoring.report import EvaluationSettings
from split_cli.scoring.verdict import Comparison
from split_cli.vehicle.parameters import read_vehicle, write_vehicle
from split_cli.workflows.drive_charts import recording_charts
from split_cli.workflows.evaluate import evaluate
from split_cli.workflows.pages import write_recording_report
from split_cli.workflows.report.evaluation import _headline, evaluation_charts, evaluation_page
from split_cli.workflows.report.recording import recording_page
from tests.factories import MissingForce, make_drive, road_car

HOSTILE = "</script><script>window.taken = 1</script>.parquet"
FOUND = {
    "consistency": {"findings": [{"text": f"vx is 3.6 times what the position says: km/h, not m/s; {HOSTILE}"}]},
    "channels": [
        {
            "channel": "vx",
            "source": HOSTILE,
            "rate": 100.0,
            "gaps": 1,
            "spikes": 2,
            "low": 0.0,
            "high": 30.0,
            "drops": [{"source": "x", "reason": "not finite", "count": 7}],
        }
    ],
    "contradictions": [],
}


@pytest.fixture(scope="module")
def car():
    return road_car()


@pytest.fixture(scope="module")
def drive():
    """A drive whose name would run if it could: a front axle of a fifth less force than its file says."""
    return make_drive(3, 40, 4.0, terms=[MissingForce({"front_grip_loss": 0.2})], name=HOSTILE)


def numbers_of(page: str) -> dict:
    return json.loads(re.search(r'id="numbers">(.*?)</script>', page, flags=re.S).group(1))


def test_a_recording_is_headed_by_what_is_wrong_with_it(drive, car):
    page = recording_page(drive, FOUND, recording_charts(drive, car))
    assert '<h1 id="verdict">vx is 3.6 times what the position says.</h1>' in page
    assert "7 not finite" in page and page.count("<script") == 2
    held, open_ = {"name": "r against dyaw/dt"}, {"check": "a_y against v_x r", "reason": "too short"}
    sound = recording_page(drive, {"consistency": {"relations": [held], "unjudged": [open_]}}, ())
    assert "The channels fit together." in sound and "<dd>1 of 2" in sound
    # What was not checked does not fit together.
    assert "could not be checked" in recording_page(drive, {"consistency": {"unjudged": [open_]}}, ())
    # A finding without a short clause heads no page, and what it quotes is set as code.
    told = f"v_y {'and more of it ' * 9}is 1.58 +- 0.01 m off: set `position: rear_axle`"
    long = recording_page(drive, {"consistency": {"findings": [{"text": told.replace(": ", " ", 1)}]}}, ())
    assert '<h1 id="verdict">The channels do not fit together.</h1>' in long
    assert "1.58 ± 0.01\u00a0m" in long and "<code>position: rear_axle</code>" in long
    # A headline ends before a bracket, not within.
    told = "delta is the steering-wheel angle (delta against the steady steer angle: slope 16.9, correlation 1)."
    bracketed = recording_page(drive, {"consistency": {"findings": [{"text": told}]}}, ())
    assert '<h1 id="verdict">delta is the steering-wheel angle.</h1>' in bracketed and "slope 16.9" in bracketed


def test_a_recording_is_drawn_as_it_was_measured(drive, car):
    charts = {chart.name: chart for chart in recording_charts(drive, car)}
    measured, model = charts["strip-vx"].series
    assert measured.role == "measured" and model.role == "simulated"
    rows = np.searchsorted(drive["t"], measured.x[np.isfinite(measured.x)] - 1e-9)
    np.testing.assert_allclose(measured.y[np.isfinite(measured.y)], drive["vx"][rows])
    assert {"tire-front", "tire-rear", "force-x", "gg"} <= set(charts)
    (torque,) = charts["strip-T"].series  # of the recording alone, at its times and places
    for axis in ("x", "along"):
        np.testing.assert_array_equal(getattr(torque, axis), getattr(measured, axis))
    # What ingest computed is not called so, and columns that no command knows are counted.
    kinds = {**drive.metadata.kinds, "vy": "derived: from X, Y, yaw"}
    columns = {**drive.columns, "Oil Temp": np.zeros(len(drive))}
    other = replace(drive, columns=columns, metadata=replace(drive.metadata, kinds=kinds))
    named = {c.name: c.series[0].name for c in recording_charts(other, car) if c.name.startswith("strip-v")}
    assert named == {"strip-vx": "measured", "strip-vy": "derived"}
    assert "and 1 kept as recorded" in recording_page(other, FOUND, ())


def test_the_command_writes_it_whole(drive, car, tmp_path):
    write_vehicle(car, tmp_path / "car.yaml")
    assert read_vehicle(tmp_path / "car.yaml").digest() == car.digest()
    write_recording_report(drive, tmp_path / "car.yaml", tmp_path / "page.html")
    numbers = numbers_of((tmp_path / "page.html").read_text(encoding="utf-8"))
    assert len(numbers["charts"]) >= 8


@pytest.fixture(scope="module")
def run(drive, car):
    return evaluate([drive], car, EvaluationSettings(predictors=("bcm",), rollout=(0.5,), any_vehicle=True))


def test_an_evaluation_shows_every_state_beside_the_vehicle_file(run):
    charts = {chart.name: chart for chart in evaluation_charts(run)}
    assert {"ratio-vx", "ratio-vy", "ratio-r", "strip-vy", "coverage-r", "white-vx"} <= set(charts)
    # The chart's numbers are the report's: corrected over nominal, with its interval.
    first = next(c for c in run.report.comparisons if c.state == "v_y" and c.name == "bcm")
    series = charts["ratio-vy"].series[0]
    assert (series.x[0], series.low[0], series.high[0]) == pytest.approx(first.to_nominal)
    # Of every row of charts one says what to see.
    noted = {name.partition("-")[0] for name, chart in charts.items() if chart.note}
    assert {name.partition("-")[0] for name in charts} - noted == {"force"}  # it stands beside those of tyres
    # What is left after the correction is less than before, where the report says so.
    before, after = (np.std(s.y) for s in charts["white-vy"].series)
    assert np.isfinite([before, after]).all()


def test_its_page_says_the_verdict_first_and_lets_no_name_act(run):
    page = evaluation_page(run)
    headline = re.search(r'<h1 id="verdict">(.*?)</h1>', page).group(1)
    assert re.search("errors up to|changes nothing|worse|Too little", headline)
    assert page.count("<script") == 2 and HOSTILE not in page


def test_its_headline_leaves_out_what_a_derived_torque_makes_true(run):
    """T made of the acceleration gives the nominal model v_x: no error of v_x tells of the drive train."""
    trace = run.traces[0]
    made = replace(trace.held.drive.metadata, kinds={"T": "derived: torque from measured a_x"})
    held = replace(trace.held, drive=replace(trace.held.drive, metadata=made))
    page = evaluation_page(replace(run, traces=(replace(trace, held=held), *run.traces[1:])))
    headline = re.search(r'<h1 id="verdict">(.*?)</h1>', page).group(1)
    assert "v_x" not in headline and "ongitudinal" not in headline
    assert "errors and intervals of v_x say nothing" in page.split("</section>")[0]


def test_its_warnings_and_colour_are_those_of_the_headlines_predictor(run):
    told = ("WARNING: v_y is worse than holding the velocities", "a note")

    def verdict(*ratios: tuple[str, tuple[float, float, float]]) -> str:
        found = tuple(Comparison(name, "z2", "v_y", 0.5, 20, 1.0, 1.0, 1.0, ratio, ratio) for name, ratio in ratios)
        settings = replace(run.report.settings, predictors=("bcm", "rbcm"))
        report = replace(run.report, comparisons=found, notes=told, settings=settings)
        return evaluation_page(replace(run, report=report)).split('<section class="verdict ')[1].split("</section>")[0]

    good, bad, none = (0.5, 0.4, 0.6), (1.5, 1.4, 1.6), (1.0, 0.9, 1.1)
    helped = verdict(("bcm", good), ("rbcm", bad))
    assert helped.startswith("match")
    assert "Note: v_y is worse than holding the velocities." in helped and "a note" not in helped
    assert verdict(("bcm", bad), ("rbcm", good)).startswith("mismatch")
    assert verdict(("bcm", none), ("rbcm", good)).startswith("undecided")


def test_the_headline_calls_harm_what_the_verdict_does():
    """An error of 1.001 times the nominal one made it say worse above a page whose verdict said hardly."""

    def judged(state: str, *ratio: float) -> Comparison:
        return Comparison("bcm", "z2", state, 0.5, 20, 1.0, 1.0, 1.0, ratio, ratio)

    hardly = judged("v_y", 1.001, 1.0005, 1.002)
    assert _headline([hardly]) == ("undecided", "The learned correction changes hardly anything.")
    assert _headline([hardly, judged("r", 0.5, 0.4, 0.6)])[1].startswith("The correction helps: errors up to 50 %")
    assert "worse" in _headline([hardly, judged("r", 1.02, 1.01, 1.03)])[1]


def test_the_headline_calls_every_state_by_its_words_and_its_symbol():
    """It said "smaller in longitudinal velocity, smaller in v_y and r too"."""

    def judged(state: str, *ratio: float) -> Comparison:
        return Comparison("bcm", "z2", state, 0.5, 20, 1.0, 1.0, 1.0, ratio, ratio)

    better = [judged("v_x", 0.5, 0.4, 0.6), judged("v_y", 0.7, 0.6, 0.8), judged("r", 0.8, 0.7, 0.9)]
    assert _headline(better)[1] == (
        "The correction helps: errors up to 50 % smaller in longitudinal velocity v_x, and smaller in lateral velocity "
        "v_y and yaw rate r."
    )
    worse = [judged("v_y", 1.5, 1.4, 1.6), judged("r", 1.5, 1.4, 1.6)]
    assert _headline(worse)[1] == "The learned correction makes lateral velocity v_y and yaw rate r worse."


def test_in_a_browser_no_name_runs_or_hides(run, drive, car, browser, tmp_path):
    pages = recording_page(drive, FOUND, recording_charts(drive, car)), evaluation_page(run)
    for page in pages:
        (tmp_path / "page.html").write_text(page, encoding="utf-8")
        browser.get((tmp_path / "page.html").as_uri())
        for button in browser.find_elements("css selector", "button")[:8]:
            browser.execute_script("arguments[0].click()", button)
        assert browser.execute_script("return window.taken === undefined && document.images.length === 0")
        assert HOSTILE in browser.find_element("css selector", "body").text
        assert not [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"]


def test_an_understeer_gradient_of_the_model_alone_is_not_drawn(monkeypatch, car):
    """A short test stretch gave a line of the model and none of the car, beside which it says nothing."""
    lateral = np.linspace(-1.0, 3.0, 9)
    gradient = Understeer(
        gradient=0.002,
        interval=(0.001, 0.003),
        offset=0.0,
        ratio=1.0,
        ratio_interval=(0.9, 1.1),
        lateral=lateral,
        slip_difference=0.002 * lateral,
        limit=3.9,
    )
    one = SimpleNamespace(name="measured", role="measured", shown=True, lateral_motion=None, vehicle=None, drive="real")
    real, model = one, SimpleNamespace(**vars(one) | {"vehicle": car, "motion": "model"})
    for known, drawn in ((("model",), []), (("real", "model"), ["understeer"])):
        monkeypatch.setattr(handling, "understeer_of", lambda motion, _, known=known: motion in known and gradient)
        assert [chart.name for chart in handling_charts([real, model], car)] == drawn
    monkeypatch.setattr(handling, "understeer_of", lambda motion, _: motion == "real" and gradient)
    (chart,) = handling_charts([real, SimpleNamespace(**vars(model) | {"name": "nominal model"})], car)
    assert chart.note.endswith(" There is too little gentle cornering for a slope of nominal model.")
    assert "ranges differ" not in chart.note and "over |a_y| up to 3.0 m/s²" in chart.note
    # Its line ends where the moments do.
    assert chart.series[-1].x.min() >= lateral.min() and chart.series[-1].x.max() <= lateral.max()
    # Two gradients stood side by side, one of up to 3 m/s² and one of up to 1, as if they were comparable.
    gentle = replace(gradient, lateral=lateral / 3.0)
    monkeypatch.setattr(handling, "understeer_of", lambda motion, _: gradient if motion == "real" else gentle)
    (chart,) = handling_charts([real, SimpleNamespace(**vars(model) | {"name": "nominal model"})], car)
    measured, modelled, reason = re.split(r"; |(?<=m/s²)\. ", chart.note, maxsplit=2)
    assert measured.endswith("over |a_y| up to 3.0 m/s²") and modelled.endswith("over |a_y| up to 1.0 m/s²")
    assert reason.startswith("These ranges differ, since")
    monkeypatch.setattr(handling, "understeer_of", lambda motion, _: None)
    response = SimpleNamespace(frequency=[0.5], gain=[4.0], gain_low=[3.0], gain_high=[5.0], phase=[-9.0], windows=12)
    monkeypatch.setattr(handling, "steering_response", lambda motion, _: response)
    steered = SimpleNamespace(**vars(real) | {"lateral_motion": "real"})
    gain, _ = handling_charts([steered], car)
    assert gain.note.endswith("Too little gentle, steady cornering was measured for an understeer gradient.")
