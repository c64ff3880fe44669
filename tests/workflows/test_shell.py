"""The one page behind every report: its policy, its charts, what a reader does with them, names that stay text."""

import base64
import csv
import hashlib
import json
import re
import time
from dataclasses import replace

import numpy as np
import pytest

from split_cli.plots.chart import Band, Chart, ChartLine
from split_cli.workflows.report.markup import bar, charts_block, plain_table
from split_cli.workflows.report.shell import page
from tests.browsers import headless

HOSTILE = "</script><script>window.taken = 1</script><img src=x onerror='window.taken = 2'>\u202e"
T = np.linspace(0.0, 10.0, 101)


def charts() -> tuple[Chart, ...]:
    """Return strips of two series, one of them with a hostile name, bars with intervals, and dots in a plane."""
    strip = tuple(
        Chart(
            f"strip-{name}",
            f"{name} {HOSTILE}",
            "time [s]",
            f"{name} [m/s]",
            (
                ChartLine("measured", T, np.sin(T), along=5.0 * T),
                ChartLine(HOSTILE, T, 1.1 * np.sin(T), "simulated", along=5.0 * T),
            ),
            bands=(Band(-0.1, 0.1, "noise"),),
            other_x="distance [m]",
            wide=True,
            group="strips",
        )
        for name in ("vx", "vy")
    )
    rows = ChartLine(
        "runs",
        np.array([1.0, 2.0]),
        np.array([0, 1]),
        "learned",
        "bars",
        np.array([0.8, 1.7]),
        np.array([1.2, 2.3]),
        emphasis=(True, False),
    )
    dots = ChartLine("dots", np.cos(T), np.sin(T), "corrected", "points")
    return (
        *strip,
        Chart("ranked", "Error", "rms [m/s]", "", (rows,), rows=("first", HOSTILE)),
        Chart("gg", "Plane", "a_y", "a_x", (dots,), equal=True),
    )


def made() -> str:
    """Return a page with all kinds of charts."""
    body = f'<h1 id="verdict">Brakes weak.</h1>{charts_block(charts())}{bar(0.3)}'
    return page("race", HOSTILE, HOSTILE, body, charts())


def test_the_policy_admits_this_script_and_this_style_and_nothing_else():
    text = made()
    policy = re.search(r'Content-Security-Policy" content="([^"]*)"', text).group(1)
    for tag, kind in (("script", "script"), ("style", "style")):
        content = re.findall(rf"<{tag}>(.*?)</{tag}>", text, flags=re.S)
        digest = base64.b64encode(hashlib.sha256(content[0].encode()).digest()).decode()
        assert len(content) == 1 and f"{kind}-src 'sha256-{digest}'" in policy
    assert "unsafe" not in policy
    markup = re.sub(r"<(script|style).*?</\1>", "", text, flags=re.S)
    assert not re.search(r"<[^>]*\s(style|on\w+)\s*=", markup)
    assert not re.search(r"""(src|href)=["']?(?!data:|#)[a-z]+:""", markup)
    assert "<img" not in markup and "\u202e" not in text


def test_a_table_marks_its_best_and_escapes_its_names():
    text = plain_table(("run", "error"), [(HOSTILE, "1.0"), ("b", "2.0")], "t", best=[(0, 1)])
    assert '<td class="number win">1.0</td>' in text and text.count("number win") == 1 and "<script" not in text


@pytest.fixture(scope="module")
def downloads(tmp_path_factory):
    return tmp_path_factory.mktemp("downloads")


@pytest.fixture(scope="module")
def browser(tmp_path_factory, downloads):
    yield from headless(tmp_path_factory.mktemp("profile"), downloads)


@pytest.fixture
def opened(browser, tmp_path):
    file = tmp_path / "page.html"
    file.write_text(made(), encoding="utf-8")

    def open_page(width: int = 1180, scheme: str = "light"):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        wanted = {"features": [{"name": "prefers-color-scheme", "value": scheme}]}
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", wanted)
        browser.get(file.as_uri())
        # A style or a script that the policy refuses would be told in the console.
        assert browser.get_log("browser") == []
        assert browser.execute_script("return window.taken") is None
        return browser

    return open_page


@pytest.mark.parametrize(("change", "share"), [(3e-5, 3e-5 / 0.02), (0.1, 1.0 / 1.08)])
def test_an_axis_spans_at_least_what_can_be_seen(browser, tmp_path, change, share):
    """Ratios of 1.00000 and 1.00003 stood at the two ends of the frame, as if much had changed."""
    line = ChartLine("ours", np.array([1.0, 1.0 + change]), np.array([0, 1]), "learned", "points")
    row = (Chart("ratio-r", "r", "ratio of errors", "", (line,), rows=("a", "b"), reference=1.0, least_span=0.02),)
    (tmp_path / "row.html").write_text(page("race", "", "", charts_block(row), row), encoding="utf-8")
    browser.get((tmp_path / "row.html").as_uri())
    svg = "#chart-ratio-r .canvas > svg"
    dots = [float(dot.get_attribute("cx")) for dot in browser.find_elements("css selector", f"{svg} circle")]
    width = float(browser.find_elements("css selector", f"{svg} > rect")[0].get_attribute("width"))
    assert (dots[1] - dots[0]) / width == pytest.approx(share, rel=0.01)


def test_a_band_breaks_where_its_line_does(browser, tmp_path):
    """An interval was filled from one held-out stretch over the untested minute to the next."""
    low = np.where(abs(T - 5.0) < 1.0, np.nan, -1.0)
    line = ChartLine("learned", T, low + 1.0, "learned", low=low, high=low + 2.0)
    band = (Chart("band", "Band", "time [s]", "y", (line,)),)
    (tmp_path / "band.html").write_text(page("race", "", "", charts_block(band), band), encoding="utf-8")
    browser.get((tmp_path / "band.html").as_uri())
    drawn = [p.get_attribute("d") for p in browser.find_elements("css selector", "#chart-band .canvas > svg path")]
    assert sorted(d.count("Z") for d in drawn)[-1] == 2


def paths(browser, chart: str) -> int:
    return len(browser.find_elements("css selector", f"#chart-{chart} .canvas > svg path"))


def fetched(downloads, name: str, seconds: float = 10.0) -> bytes:
    """Return a saved file once the browser has written it."""
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        file = downloads / name
        if file.exists() and file.stat().st_size:
            content = file.read_bytes()
            file.unlink()
            return content
        time.sleep(0.05)
    raise AssertionError(f"{name} was not saved: {list(downloads.iterdir())}")


def test_series_are_switched_off_and_on(opened):
    browser = opened()
    before = paths(browser, "strip-vx")
    switches = browser.find_elements("css selector", "#chart-strip-vx .switch")
    assert [one.get_attribute("aria-pressed") for one in switches] == ["true", "true"]
    switches[1].click()
    assert paths(browser, "strip-vx") == before - 1
    assert switches[1].get_attribute("aria-pressed") == "false"
    switches[1].click()
    assert paths(browser, "strip-vx") == before


def test_strips_change_to_distance_and_zoom_together(opened):
    browser = opened()

    def title(name: str) -> str:
        return browser.find_element("css selector", f"#chart-{name} .axis-title").text

    assert title("strip-vx") == "time [s]"
    browser.find_element("css selector", "input[value=s]").find_element("xpath", "..").click()
    assert title("strip-vx") == title("strip-vy") == "distance [m]"
    before = browser.find_element("css selector", "#chart-strip-vy .canvas > svg").get_attribute("innerHTML")
    browser.find_element("css selector", "#chart-strip-vx button[aria-label='Zoom in']").click()
    after = browser.find_element("css selector", "#chart-strip-vy .canvas > svg").get_attribute("innerHTML")
    assert before != after


def test_every_chart_is_saved_as_numbers_and_as_a_picture(opened, downloads):
    browser = opened()
    browser.find_element("css selector", "#chart-strip-vx button[aria-label$='CSV']").click()
    rows = list(csv.reader(fetched(downloads, "strip-vx.csv").decode().splitlines()))
    assert float(rows[11][3]) == pytest.approx(np.sin(T[10]), abs=1e-3)
    browser.find_element("css selector", "#chart-gg button[aria-label$='PNG']").click()
    content = fetched(downloads, "gg.png")
    assert content.startswith(b"\x89PNG")
    wide, high = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    assert wide > 600 and high > 400
    for figure in browser.find_elements("css selector", "figure"):
        assert {"CSV", "PNG"} <= {button.text for button in figure.find_elements("css selector", ".zoom button")}


def test_a_saved_name_is_no_formula(opened):
    rows = [["=1+1", "-", "-1.5 m"], [-1.5, "a,b", '"q"']]
    text = opened().execute_script("return Charts.csv(arguments[0])", rows)
    assert text == '\'=1+1,-,\'-1.5 m\n-1.5,"a,b","""q"""\n'


def test_a_picture_has_its_colours_spelled_out(opened):
    """A file outside the page knows none of its variables."""
    browser = opened()
    marks = "const s = document.querySelector('#chart-gg .canvas svg'); return s.innerHTML.includes('var(--')"
    assert browser.execute_script(marks)
    # In the page they follow the scheme.
    ink = "return getComputedStyle(document.documentElement).getPropertyValue('--measured').trim()"
    light = browser.execute_script(ink)
    assert opened(scheme="dark").execute_script(ink) != light


@pytest.mark.parametrize("width", [420, 360])
def test_a_narrow_window_needs_no_sideways_scrolling(opened, width):
    browser = opened(width)
    wide, window = browser.execute_script("return [document.documentElement.scrollWidth, window.innerWidth]")
    assert wide <= window
    # Legible: text of axes is drawn at its own size, not shrunk with the picture.
    script = (
        "const s = document.querySelector('#chart-strip-vx .canvas > svg');"
        "return s.getBoundingClientRect().width / s.viewBox.baseVal.width"
    )
    assert browser.execute_script(script) == pytest.approx(1.0, abs=0.05)


def test_on_paper_every_chart_fills_its_column_and_what_is_folded_leaves_no_heading(opened):
    """A chart that is lower than on the screen is drawn lower, not shrunk: its text keeps its size."""
    browser = opened(690)
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print"})
    browser.execute_script("window.dispatchEvent(new Event('beforeprint'))")
    shown = browser.execute_script(
        "return [...document.querySelectorAll('.canvas > svg')].map((s) => [s.getBoundingClientRect().width,"
        " s.viewBox.baseVal.width, s.closest('figure').getBoundingClientRect().width])"
    )
    assert shown
    for drawn, meant, column in shown:
        assert drawn == pytest.approx(meant, rel=0.1) and drawn > 0.85 * column
    browser.execute_script(
        "document.querySelector('main').insertAdjacentHTML('beforeend',"
        " '<section id=folded><h2>a</h2><p>b</p><details><summary>c</summary>d</details></section>')"
    )
    assert not browser.find_element("id", "folded").is_displayed()
    browser.execute_script("window.dispatchEvent(new Event('afterprint'))")


def test_words_below_three_charts_are_as_wide_as_the_three(browser, tmp_path):
    """In the column of the first they took ten lines, and on paper pushed the next section to another page."""
    line = ChartLine("label", np.arange(5.0), np.arange(5.0), "measured")
    charts = [Chart(name, name.upper(), "time [s]", "y [m]", (line,)) for name in "abc"]
    alone = charts_block([replace(charts[0], note="Said of all."), *charts[1:]], thirds=True)
    both = charts_block([replace(chart, note=f"Of {chart.name}.") for chart in charts], thirds=True)
    assert "<b>A:</b>" not in alone and "<b>A:</b> Of a." in both and "<b>C:</b> Of c." in both
    file = tmp_path / "page.html"
    file.write_text(page("compare", "a", "b", f'<h1 id="verdict">x</h1>{alone}', charts), encoding="utf-8")
    browser.set_window_size(1200, 800)
    browser.get(file.as_uri())
    grid, words = (browser.find_element("css selector", name).size["width"] for name in (".thirds", ".note-line"))
    assert words == pytest.approx(grid, abs=2)


def test_names_of_rows_that_begin_alike_are_told_apart(browser, tmp_path):
    """A comparison of several sets of one car: cut at the end, all would read the same."""
    names = [f"handling_course_aggressive_{kind}.split (projected)" for kind in ("dry", "wet", "worn_front_tyres")]
    row = ChartLine("rms error", np.ones(3), np.arange(3), "learned", "bars", np.full(3, 0.9), np.full(3, 1.1))
    chart = Chart("ranked", "Error", "rms [m/s]", "", (row,), rows=tuple(names))
    body = f'<h1 id="verdict">x</h1>{charts_block((chart,), thirds=True)}'
    file = tmp_path / "page.html"
    file.write_text(page("compare", "a", "b", body, (chart,)), encoding="utf-8")
    for width in (1280, 800, 420):
        size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
        browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        browser.get(file.as_uri())
        shown = [t.text for t in browser.find_elements("css selector", "#chart-ranked svg text[text-anchor=end]")]
        assert all(any(kind in text for text in shown) for kind in ("dry", "wet", "worn")), shown
        left = "return Math.min(...[...document.querySelectorAll('#chart-ranked svg text')].map(t => t.getBBox().x))"
        assert browser.execute_script(left) >= 0.0


def test_the_best_is_named_and_rows_keep_their_names(opened):
    browser = opened()
    texts = [t.text for t in browser.find_elements("css selector", "#chart-ranked svg text")]
    assert "best" in texts and "first" in texts
    numbers = json.loads(browser.find_element("css selector", "#numbers").get_attribute("textContent"))
    assert numbers["charts"][2]["rows"][1].startswith("</script>")
