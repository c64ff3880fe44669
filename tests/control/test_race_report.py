"""The page of a race: its numbers, names that cannot act, and a page that works in a browser."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from split_cli.control.path import resampled
from split_cli.workflows.racing.race_page import race_charts, race_page
from split_cli.workflows.racing.result import Lap, RaceResult

HOSTILE = "</script><script>window.taken = 1</script>"


def race(name: str = "ring") -> RaceResult:
    angle = np.arange(60) * 2 * np.pi / 60
    width = np.full(60, 4.0)
    path = resampled(name, 40 * np.stack([np.cos(angle), np.sin(angle)], axis=1), width, width, closed=True)
    laps, traces = [], []
    for number, speed in enumerate((10.0, 12.5, 11.0)):
        t = np.arange(0.0, path.length / speed, 0.05)
        s, turn = speed * t, speed * t / 40
        trace = np.zeros((len(t), 13))
        trace[:, 0], trace[:, 1], trace[:, 4], trace[:, 5] = 7.0 + t, s + number * path.length, turn, speed
        trace[:, 2], trace[:, 3], trace[:, 11] = 40 * np.cos(turn), 40 * np.sin(turn), speed**2 / 40
        errors = (0.4, 0.5, 0.3), (0.3, 0.2, 0.1)
        laps.append(
            Lap(
                number,
                path.length / speed,
                speed,
                speed**2 / 40 / 9.81,
                9,
                8,
                7,
                *errors,
                len(t),
                len(t),
                (5.0, 9.0, 12.0),
                (8.0, 15.0, 20.0),
                (1.0, 2.0, 3.0),
                0,
                0.0,
            )
        )
        traces.append(trace)
    told = name, "road_car", "car", "split", path.length
    return RaceResult(*told, tuple(laps), None, None, (), tuple(traces), path)


def test_the_page_holds_the_laps_and_loads_nothing():
    result = race()
    page = race_page([result], result.path)
    numbers = json.loads(re.search(r'id="numbers">(.*?)</script>', page, flags=re.S).group(1))
    assert [lap["v"][3] for lap in numbers["laps"]] == [10.0, 12.5, 11.0]
    assert all(abs(lap["s"][0]) < 1.0 for lap in numbers["laps"])
    gap = np.linalg.norm(np.array(numbers["left"]) - np.array(numbers["right"]), axis=1)
    assert gap == pytest.approx(np.full(len(gap), 8.0), abs=0.02)
    # Lap 0 alone is no rival, since the nominal model drives it carefully; a race without a learner is one.
    assert "20.11\u00a0s (lap 1)." in page and "less than the best nominal" not in page
    nominal = replace(result, learner="none", laps=result.laps[:1], traces=result.traces[:1])
    both = race_page([nominal, result], result.path)
    assert "20.11\u00a0s (split, lap 1), 20.0\u00a0% less than the best nominal one" in both
    assert not re.search(r"""(src|href)=["']?(?!data:)[a-z]+:""", page)


def test_gaps_are_to_the_first_shown_lap_at_the_same_place():
    """A car of 12.5 m/s is a fourth of its time ahead of one of 10 m/s, wherever it is."""
    gap = race_charts([race()])[0]
    assert gap.title == "Time gap to lap 0 (negative: ahead)"
    same, ahead, _ = gap.series
    np.testing.assert_allclose(same.y, 0.0, atol=1e-12)
    inside = np.isfinite(ahead.y)
    np.testing.assert_allclose(ahead.y[inside], -0.25 * ahead.x[inside], atol=1e-9)
    assert inside.mean() > 0.95


def test_the_best_lap_is_compared_with_the_best_nominal_one():
    """Where nobody learns, laps after lap 0 are nominal, too."""
    learned = race()
    laps = learned.laps[0], replace(learned.laps[2], time=22.344)
    nobody = replace(learned, learner="none", laps=laps, traces=learned.traces[:2])
    page = race_page([nobody, learned], learned.path)
    assert "20.11\u00a0s (split, lap 1), 10.0\u00a0% less than the best nominal one" in page


def test_a_race_off_the_track_is_no_success_and_what_drove_it_is_named():
    """A page of one lap 2 cm off the track was green, and did not say that an export had driven."""
    driven = race()
    off = replace(driven, learner="none", start="export car (projected)")
    off = replace(off, laps=tuple(replace(lap, outside=0.02 + lap.number, outside_at=34.0) for lap in driven.laps))
    page = race_page([off], off.path)
    assert 'class="verdict mismatch"' in page and "The best one left it by 0.02\u00a0m." in page
    assert "with the vehicle file car and export car (projected)" in page and "laps with export car" in page
    assert 'class="verdict match"' in race_page([driven], driven.path)


def test_the_best_clean_lap_of_each_learner_is_shown_at_first():
    """With one learner its first lap beside it; a lap off the track is not clean, however fast."""
    learned = race()
    off = replace(
        learned, laps=(learned.laps[0], replace(learned.laps[1], outside=0.3, outside_at=87.4), learned.laps[2])
    )
    assert "0.30 at 87 m</td>" in race_page([off], off.path)
    races = [replace(learned, learner="none", laps=learned.laps[:1], traces=learned.traces[:1]), learned, off]
    for given, shown in (([learned], [0, 1]), (races, [0, 2, 6])):
        numbers = json.loads(
            re.search(r'id="numbers">(.*?)</script>', race_page(given, learned.path), flags=re.S).group(1)
        )
        assert [k for k, lap in enumerate(numbers["laps"]) if lap["shown"]] == shown
        for chart in race_charts(given):
            assert [k for k, line in enumerate(chart.series) if line.shown] == shown
    assert numbers["laps"][0]["name"] == "nominal, lap 0"
    # The track has the colours of the charts, and what is shown at first has colours of its own.
    roles = [lap["role"] for lap in numbers["laps"]]
    assert roles == [line.role for line in chart.series] and len({roles[k] for k in shown}) == 3
    assert race_charts([learned, races[0]])[0].title == "Time gap to split, lap 1 (negative: ahead)"


def test_one_lap_of_two_learners_is_called_no_comparison():
    split = race()
    one = replace(split, laps=split.laps[:2], traces=split.traces[:2])
    other = replace(one, learner="iol")
    other = replace(other, verdict="Learning <b>did not help</b>.", notes=("features <i>z2</i>",))
    page = race_page([one, other], split.path)
    assert "not a comparison" in page and "iol: Learning &lt;b&gt;did not help" in page
    assert "iol: features &lt;i&gt;z2&lt;/i&gt;" in page
    assert "not a comparison" not in race_page([split, other], split.path)
    assert "not a comparison" not in race_page([one, replace(one, learner="none")], split.path)


def test_what_two_races_noted_is_said_once_and_behind_the_tables():
    noted = replace(race(), notes=("the same of both",))
    page = race_page([replace(noted, learner="iol"), replace(noted, learner="split")], noted.path)
    assert page.count("the same of both") == 1 and "iol, split: the same of both" in page
    assert page.index("table-timing") < page.index("the same of both")


def test_a_lap_that_was_lost_at_once_stands_in_the_tables():
    """It has no trace to draw, and its row says why."""
    result = race()
    lost = replace(result.laps[2], time=None, ended="no plan")
    result = replace(result, laps=(*result.laps[:2], lost), traces=(*result.traces[:2], np.empty((0, 13))))
    page = race_page([result], result.path)
    assert "not finished: no plan" in page
    assert len(race_charts([result])[0].series) == 2


def test_a_name_cannot_act():
    result = race(HOSTILE)
    page = race_page([result], result.path)
    assert HOSTILE not in page
    assert page.count("<script") == 2


def test_laps_are_chosen_compared_and_played_in_a_browser(browser, tmp_path):
    from selenium.webdriver.support.ui import WebDriverWait

    result = race(HOSTILE)
    file = tmp_path / "race.html"
    file.write_text(race_page([result], result.path), encoding="utf-8")
    browser.get(file.as_uri())
    assert browser.get_log("browser") == []
    assert browser.execute_script("return window.taken") is None

    def one(selector: str):
        return browser.find_element("css selector", selector)

    boxes = browser.find_elements("css selector", "#choice input")
    # The nominal lap and the best one are chosen at first.
    assert [box.is_selected() for box in boxes] == [True, True, False]
    ink = (
        "const c = document.getElementById(arguments[0]), d = c.getContext('2d').getImageData(0, 0, c.width, "
        "c.height).data; let n = 0; for (let i = 3; i < d.length; i += 4) n += d[i] > 0; return n"
    )
    assert browser.execute_script(ink, "track") > 500
    drawn = browser.find_elements("css selector", "#chart-speed .canvas > svg path, #chart-gg .canvas > svg path")
    assert len(drawn) >= 4
    # Half way through the slower lap's time the cars are where their speeds bring them.
    browser.execute_script(
        "const s = document.getElementById('time'); s.value = '10'; s.dispatchEvent(new Event('input'))"
    )
    assert one("#clock").text == "10.0 s"
    assert one("#status").text == "lap 0: 100 m, 10.0 m/s; lap 1: 125 m, 12.5 m/s"
    boxes[1].click()
    boxes[2].click()
    # What is chosen is drawn in every chart.
    for chart in ("gap", "speed", "steer", "gg"):
        keys = browser.find_elements("css selector", f"#chart-{chart} .legend .switch")
        assert [key.get_attribute("aria-pressed") for key in keys] == ["true", "false", "true"]
    assert one("#status").text == "lap 0: 100 m, 10.0 m/s; lap 2: 110 m, 11.0 m/s"
    marks = "return document.querySelectorAll(`#strips svg line[stroke-dasharray='3 3']`).length"
    strips = len([chart for chart in race_charts([result]) if chart.wide])
    assert browser.execute_script(marks) == strips
    # It stays where charts are drawn anew, as in another window, on paper, or over time.
    switch = "document.querySelector('#along input[value=t]').click()"
    for change in ("dispatchEvent(new Event('beforeprint')); dispatchEvent(new Event('afterprint'))", switch):
        browser.execute_script(change)
        assert browser.execute_script(marks) == strips
    whole = "return document.getElementById('track').toDataURL()"
    before = browser.execute_script(whole)
    browser.execute_script("view.value = 'car'; view.dispatchEvent(new Event('change'))")
    assert browser.execute_script(whole) != before
    # At true pace a lap outlasts a busy machine.
    browser.execute_script("document.getElementById('pace').value = '1'")
    one("#play").click()
    assert one("#play").text == "Pause"
    WebDriverWait(browser, 10).until(lambda _: float(one("#clock").text.split()[0]) > 11.0)
    one("#play").click()
    assert one("#play").text == "Play"
    for box in browser.find_elements("css selector", "#choice input:checked"):
        box.click()
    assert one("#status").text == "No lap is chosen."
    assert len(browser.find_elements("css selector", "#table-laps tbody tr")) == 3
    assert browser.get_log("browser") == []


def test_tables_fit_on_paper_and_the_page_into_a_narrow_window(browser, tmp_path):
    results = [race("ring"), race("ring"), race("ring")]
    file = tmp_path / "race.html"
    file.write_text(race_page(results, results[0].path), encoding="utf-8")
    sheet = 688  # A4 less the page's own margins of 14 mm, at 96 dots per inch
    try:
        for media, width in (("print", sheet), ("screen", 420)):
            browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": media})
            size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": media == "screen"}
            browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
            browser.get(file.as_uri())
            assert browser.execute_script("return document.documentElement.scrollWidth") <= width
            right = "return document.querySelector('#table-laps').getBoundingClientRect().right"
            assert (browser.execute_script(right) <= width) == (media == "print"), "it scrolls on a screen"
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
