"""The report: numbers that survive packing, names that cannot act, and a page that works in a browser."""

import base64
import hashlib
import html
import json
import math
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from split_cli.diagnosis.statement.improvement import HorizonErrors, Improvement
from split_cli.diagnosis.statement.result import (
    Detectable,
    Diagnosis,
    Finding,
    GapSeries,
    InputFile,
    Location,
    ParameterEstimate,
    Place,
    RemainderTest,
    RivalSummary,
)
from split_cli.diagnosis.statement.sentences import summarise
from split_cli.vehicle.effects import CATALOGUE
from split_cli.workflows.report.headline import finding_headline
from split_cli.workflows.report.page import report_page
from split_cli.workflows.report.payload import chart_numbers, embedded_json
from split_cli.workflows.report.sections import all_sections
from split_cli.workflows.report.words import chance, escape, number, parameter, percent, readable

HOSTILE = "</script><script>window.taken = 1</script><img src=x onerror='window.taken = 2'>\u202e\u2028&\".parquet"

# As long as an exact degeneracy gets, and nowhere a space to break a line at.
CLASS = "mass+yaw_inertia+friction_scale+drive_gain+aero_drag+rolling_resistance"


def gap_along_a_circle(name: str = "lap.parquet", rows: int = 2000) -> GapSeries:
    """Return two laps of 30 m radius with a hole of 4 s, with a gap of 100 N in front lateral force that physics
    takes down to 10 N, and the last tenth not compared."""
    rng = np.random.default_rng(4)
    t = 0.04 * np.arange(rows) + np.where(np.arange(rows) >= rows // 2, 4.0, 0.0)
    angle = 4.0 * np.pi * np.arange(rows) / rows
    noise = rng.normal(0.0, 5.0, (rows, 3))
    shape = np.stack([0.0 * angle, np.sin(angle), 0.1 * np.cos(angle)], axis=1)
    point = np.stack([0.1 * np.sin(angle), 0.08 * np.sin(angle + 0.2), np.cos(3 * angle), 15 + angle], axis=1)
    return GapSeries(
        name,
        t,
        np.mod(30.0 * angle, 60.0 * np.pi),
        np.arange(rows),
        30.0 * np.cos(angle),
        30.0 * np.sin(angle),
        point,
        np.arange(rows) < 0.9 * rows,
        100.0 * shape + noise,
        10.0 * shape + noise,
    )


def rollout(horizon: float, before: float) -> HorizonErrors:
    """Return rollout errors of which physics halves those before."""
    sizes = (before, 0.5 * before, 0.7 * before, 0.45 * before, 10.0 * before, 0.4 * before)
    names = ("before", "physics", "split_only", "after", "persistence")
    intervals = {n: [[0.8 * v, 1.2 * v]] * 3 for n, v in zip(names, sizes[:5], strict=True)} | {"blocks": 9}
    return HorizonErrors(horizon, *((size,) * 3 for size in sizes), intervals, 120)


def mismatch(name: str = "lap.parquet") -> Diagnosis:
    """Return a diagnosis in which every part of the report has something to say."""
    rivals = (RivalSummary("mass", "loaded", 4.0, 0.3), RivalSummary("wind", "", 900.0, 12.0))
    finding = Finding(
        "steer_gain",
        "",
        {"gain": ParameterEstimate(0.9512, 0.01, "1", (0.9312, 0.9712))},
        0.8,
        ("mass", CLASS),
        f"In reality the wheels turn less. On this data it cannot be told from mass, {CLASS}.",
        0.9,
        rivals,
        ("a drive with ballast",),
    )
    errors = Improvement(
        (0.5, 0.9, 0.2),
        (0.5, 0.5, 0.15),
        (0.5, 0.45, 0.14),
        (0.5, 0.7, 0.16),
        (4.0, 3.0, 2.0),
        (0.4, 0.4, 0.1),
        {"before": [[0.4, 0.6], [0.8, 1.0], [0.1, 0.3]], "blocks": 12},
        (rollout(0.5, 0.1), rollout(1.0, 0.2), rollout(2.0, 0.4)),
        {"physics": (0.6, 0.4, 0.7), "split_only": None, "after": (0.65, 0.5, 0.8)},
    )
    shares = {"longitudinal": 0.1, "front_lateral": 0.8, "rear_lateral": 0.1}
    remainder = RemainderTest(1e-5, 0.2, 0.1, (("memory", 60.0), ("time", 20.0)), "F ~ 3 N sign(r)")
    place = Place(150.0, 20.0, 188.5, "position", 30.0, 0.0)
    return Diagnosis(
        "mismatch",
        1e-9,
        0.9,
        ("brake gain: there is no braking; brake hard once",),
        Location(shares, (("delta", 0.5), ("s", 0.2)), {"delta": (0.01, 0.05)}, place, (10.0, 20.0), 0.6, 0.2),
        (finding,),
        True,
        remainder,
        errors,
        (InputFile(name, "ab" * 32, "real"), InputFile("car.yaml", "cd" * 32, "vehicle")),
        {"holdout_share": 0.25},
        (gap_along_a_circle(name),),
        ("added steer_gain, saves 100",),
        ("Simulation and reality differ.", "In reality the wheels turn less.", "The gap is large."),
    )


MATCH = replace(
    mismatch(),
    verdict="match",
    p_value=0.4,
    location=None,
    findings=(),
    unexplained=False,
    remainder=None,
    improvement=None,
    history=(),
    sentences=("Simulation and reality agree within noise wherever both have been.",),
)
UNDECIDED = Diagnosis("undecided", None, 0.02, ("lap.parquet has 3.0 s without a gap; drive for 8 s.",))


@pytest.mark.parametrize(
    ("share", "words"),
    [
        (0.213, "within noise at the 21 % of the real drive's operating points that both have."),
        (1.0, "within noise at all operating points of the real drive."),
    ],
)
def test_a_match_says_how_much_of_the_drive_it_is_about(share, words):
    (sentence,) = summarise("match", compared_share=share)
    assert sentence.endswith(words)
    page = all_sections(replace(MATCH, compared_share=share, sentences=(sentence,)))
    assert words.removeprefix("within noise") in re.sub(r"\s", " ", html.unescape(page))


def test_many_sentences_stand_below_the_numbers_of_the_first_screen():
    few, many = (replace(mismatch(), sentences=tuple(f"It is so {k}." for k in range(n))) for n in (5, 20))
    for diagnosis, below in ((few, False), (many, True)):
        page = all_sections(diagnosis)
        assert page.count("It is so 4.") == 1
        assert (page.index("It is so 4.") > page.index("p value")) is below


@pytest.mark.parametrize("variant", CATALOGUE["channel_delay"].variants)
def test_the_headline_names_the_sensor_that_is_late(variant):
    late = {
        {"velocity": "vx", "imu": "r"}.get(variant, variant): ParameterEstimate(0.0452, 7e-4, "s", (0.0438, 0.0466))
    }
    said = finding_headline(Finding("channel_delay", variant, late, 0.5, (), "Late.", 9.0))
    words = {"r": "Yaw rate", "velocity": "Velocities", "imu": "Inertial unit"}
    assert said.endswith(" late: 45.2 ms") and said.startswith(words.get(variant, ("Longitudinal", "Lateral")))


def test_the_headline_has_the_digits_that_the_interval_supports():
    """Grip 49.8 % less, between 16 and 67 %: three digits of which the first is doubtful."""
    vague = {"scale": ParameterEstimate(0.502, 0.17, "1", (0.33, 0.84))}
    finding = Finding("friction_scale", "front", vague, 0.5, (), "", 9.0)
    assert finding_headline(finding) == "Grip of the front tyres 50 % less"
    assert finding.label == "friction_scale (front)"  # in the table of the command


def test_the_headline_names_the_axle_that_lost_grip():
    lost = {"scale": ParameterEstimate(0.87, 0.02, "1", (0.83, 0.91))}
    said = [finding_headline(Finding("friction_scale", one, lost, 0.5, (), "", 9.0)) for one in ("", "front", "rear")]
    assert said == [
        "Tyre grip 13.0 % less",
        "Grip of the front tyres 13.0 % less",
        "Grip of the rear tyres 13.0 % less",
    ]


def unpacked(column: dict) -> np.ndarray:
    values = np.array([math.nan if v is None else v for v in column["values"]], dtype=float)
    return column["origin"] + values * 10.0 ** column["exponent"]


class TestNumbers:
    def test_packed_columns_come_back_to_half_a_step(self):
        gap = gap_along_a_circle()
        gap = replace(gap, x=np.where(gap.t < 1.0, np.nan, gap.x))
        (drive,) = chart_numbers(replace(MATCH, gaps=(gap,)))["drives"]
        for name, values in (("t", gap.t), ("x", gap.x), ("alpha_f", gap.operating_point[:, 0])):
            # A step is the power of ten at or below a 5000th of the range: no pixel could tell half of one.
            step = 10.0 ** drive[name]["exponent"]
            assert step <= np.nanmax(values) - np.nanmin(values) and step * 5000 <= np.nanmax(values) - np.nanmin(
                values
            )
            np.testing.assert_allclose(unpacked(drive[name]), values, atol=0.5001 * step)

    def test_thinning_averages_forces_and_never_across_a_hole(self):
        gap = gap_along_a_circle(rows=26_000)
        (drive,) = chart_numbers(replace(MATCH, gaps=(gap,)))["drives"]
        assert len(drive["t"]["values"]) <= 12_000
        first, second = drive["run"]
        assert first == 0
        # Groups of three rows, started anew behind the hole; each mean against a plain loop.
        half = 13_000
        groups = [
            gap.forces[k : min(k + 3, end), 1]
            for end, begin in ((half, 0), (26_000, half))
            for k in range(begin, end, 3)
        ]
        assert second == math.ceil(half / 3)
        step = 10.0 ** drive["before"][1]["exponent"]
        np.testing.assert_allclose(unpacked(drive["before"][1]), [g.mean() for g in groups], atol=0.5001 * step)

    @pytest.mark.parametrize(
        ("said", "expected"),
        [
            (number(0.00166), "0.00166"),
            (number(1234.5), "1,234"),
            (number(-3.0e-6), "−3.00 × 10−6".replace("10−6", "10⁻⁶")),
            (number(0.0), "0"),
            (number(math.nan), "–"),
            (percent(0.996), "> 99 %"),
            (percent(1.0), "100 %"),
            (percent(0.0004), "< 1 %"),
            (parameter(0.951234, 0.04), "0.951"),
            (parameter(1234.4, 90.0), "1,234"),
            (chance(0.0), "p < 10⁻⁶"),
            (chance(None), "–"),
        ],
    )
    def test_numbers_in_words(self, said, expected):
        assert said == expected


class Reader(HTMLParser):
    """Collects elements, attributes, the embedded scripts and whether every element is closed."""

    VOID = frozenset({"meta", "link", "img", "input", "br", "hr"})

    def __init__(self, page: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.found: list[tuple[str, dict]] = []
        self.scripts: list[tuple[dict, str]] = []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.found.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if self.open and self.open[-1] == "script":
            self.scripts.append((self.found[-1][1], data))


@pytest.mark.parametrize("diagnosis", [mismatch(HOSTILE), MATCH, UNDECIDED], ids=["mismatch", "match", "undecided"])
class TestPage:
    def test_is_well_formed_and_ids_are_unique(self, diagnosis):
        page = Reader(report_page(diagnosis))
        assert page.open == []
        ids = [attributes["id"] for _, attributes in page.found if "id" in attributes]
        assert len(ids) == len(set(ids))
        targets = [a["href"][1:] for tag, a in page.found if tag == "a" and a["href"].startswith("#")]
        targets += [a["aria-labelledby"] for _, a in page.found if "aria-labelledby" in a]
        assert set(targets) <= set(ids)

    def test_loads_nothing(self, diagnosis):
        page = report_page(diagnosis)
        assert set(re.findall(r"https?://[^\"' ]+", page)) <= {"http://www.w3.org/2000/svg"}
        loading = [a for tag, a in Reader(page).found if tag in ("img", "iframe", "object", "embed") or "src" in a]
        assert loading == []
        assert "@import" not in page and "url(" not in page.replace("url(#${clip})", "")

    def test_only_its_own_script_may_run(self, diagnosis):
        page = Reader(report_page(diagnosis))
        (policy,) = [a["content"] for _, a in page.found if a.get("http-equiv") == "Content-Security-Policy"]
        (numbers, program) = page.scripts
        digest = base64.b64encode(hashlib.sha256(program[1].encode()).digest()).decode()
        assert f"script-src 'sha256-{digest}'" in policy and policy.startswith("default-src 'none'")
        assert "unsafe" not in policy
        assert json.loads(numbers[1])["verdict"] == diagnosis.verdict


def test_a_name_stays_text():
    page = report_page(mismatch(HOSTILE))
    assert "<script>window.taken" not in page and "<img" not in page and "\u202e" not in page
    assert json.loads(embedded_json([HOSTILE])) == [HOSTILE]
    assert not set("<>&\u2028") & set(embedded_json([HOSTILE]))
    assert escape("a\u202eb\udcff\n") == "a\\u202eb\\udcff\\n"
    # What people do call their files is left alone.
    assert readable("Würzburg – 東京 è.parquet") == "Würzburg – 東京 è.parquet"


def test_another_form_of_an_exact_alternative_is_not_as_good():
    """Rolling resistance is a constant grade; a grade in waves that was fitted in its place is still worse."""
    finding = mismatch().findings[0]
    wave = RivalSummary("mass", "loaded", 12_711.0, 5.5)
    assert finding.is_as_good(finding.runners_up[0]) and not finding.is_as_good(wave)
    assert not finding.is_as_good(finding.runners_up[1])
    page = report_page(replace(mismatch(), findings=(replace(finding, runners_up=(wave,)),)))
    assert "<td>as good</td>" not in page and "worse" in page


def test_what_a_verdict_may_not_show():
    assert "What could not be judged" in report_page(MATCH) and "Brake hard once." in report_page(MATCH)
    assert "What the simulation lacks" not in report_page(MATCH) and 'id="plot-strip"' not in report_page(MATCH)
    undecided = report_page(UNDECIDED)
    assert "drive for 8 s." in undecided and 'id="where"' not in undecided and 'id="help"' not in undecided
    exact = report_page(replace(mismatch(), findings=(), remainder=None, improvement=None))
    assert "No effect of the catalogue was identified." in exact
    # 20 % is what a smooth function holds; without a finding all of the gap is unexplained.
    nameless, named = (report_page(one) for one in (replace(mismatch(), findings=()), mismatch()))
    assert "<dd>all<small>of the gap</small>" in nameless and "The gap is unexplained, 0.10 times" in nameless
    assert "<dd>20 %<small>of the gap</small>" in named and "20 % of the gap is unexplained, 0.10 times" in named


def opened(browser, page: str | Path, folder: Path, width: int = 1180) -> None:
    """Open a page, given as text or by its path, in a window of some width; the console must stay empty."""
    path = page if isinstance(page, Path) else folder / "report.html"
    if not isinstance(page, Path):
        path.write_text(page, encoding="utf-8")
    size = {"width": width, "height": 900, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    browser.get(path.as_uri())
    assert browser.get_log("browser") == []


def one(browser, selector: str):
    return browser.find_element("css selector", selector)


def label_of(browser, chart: str) -> str:
    return one(browser, f"#plot-{chart} svg[role=img]").get_attribute("aria-label")


def ticks_across(browser, chart: str) -> list[float]:
    """Return the numbers along a chart's x axis: its texts in the lowest row but the title."""
    texts = browser.execute_script(
        "return [...document.querySelectorAll(`#plot-${arguments[0]} .canvas > svg text[text-anchor=middle]`)]"
        ".filter((t) => !t.classList.contains('axis-title')).map((t) => t.textContent)",
        chart,
    )
    return [float(text.replace("\u2212", "-").replace(",", "")) for text in texts]


class TestInABrowser:
    def test_verdict_channel_and_names(self, browser, tmp_path):
        from selenium.webdriver.support.select import Select

        opened(browser, report_page(mismatch(HOSTILE)), tmp_path)
        assert one(browser, "#verdict").text == "Steering 4.9 % less than commanded; 20 % of the gap unexplained."
        assert one(browser, ".verdict .kicker").text == "Simulation and reality differ."
        assert browser.execute_script("return window.taken") is None
        assert "<img src=x" in one(browser, "header").text
        # The gap is in front lateral force, so that is what the charts begin with.
        assert "front lateral" in label_of(browser, "track")
        before = one(browser, "#plot-strip svg").get_attribute("innerHTML")
        controls = one(browser, "#controls")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", controls)
        one(browser, "input[name=channel][value='2']").find_element("xpath", "..").click()
        assert "rear lateral" in label_of(browser, "track") and "Rear lateral" in label_of(browser, "strip")
        assert one(browser, "#plot-strip svg").get_attribute("innerHTML") != before
        one(browser, "input[name=stage][value='compared']").find_element("xpath", "..").click()
        assert "samples compared" in label_of(browser, "map")
        # What is said of torque stands beside a map over torque alone.
        assert one(browser, "#plot-map .hint").is_displayed()
        Select(one(browser, "#controls select")).select_by_visible_text("front \u00d7 rear slip angle")
        assert not one(browser, "#plot-map .hint").is_displayed()
        assert browser.get_log("browser") == []

    def test_zoom_hover_and_reset(self, browser, tmp_path):
        from selenium.webdriver import ActionChains

        opened(browser, report_page(mismatch()), tmp_path)
        strip = one(browser, "#plot-strip svg")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", strip)
        everything = ticks_across(browser, "strip")
        cells = len(browser.find_elements("css selector", "#plot-map svg g rect"))
        drag = ActionChains(browser).move_to_element_with_offset(strip, -300, -20)
        drag.click_and_hold().move_by_offset(120, 10).release().perform()
        part = ticks_across(browser, "strip")
        assert part[-1] - part[0] < 0.3 * (everything[-1] - everything[0])
        assert everything[0] <= part[0] and part[-1] <= everything[-1]
        # The operating points of those seconds are fewer than those of the whole drive.
        assert len(browser.find_elements("css selector", "#plot-map svg g rect")) < cells
        ActionChains(browser).move_to_element_with_offset(strip, 5, 0).perform()
        told = one(browser, "#plot-strip .tip").text
        moment = float(re.search(r"t ([\d.]+) s", told).group(1))
        assert part[0] - 2.0 < moment < part[-1] + 2.0 and "with the physics" in told
        one(browser, "#plot-strip button[aria-label='Show all']").click()
        assert ticks_across(browser, "strip") == everything
        strip.send_keys("+")
        assert len(ticks_across(browser, "strip")) and ticks_across(browser, "strip") != everything
        assert browser.get_log("browser") == []

    def test_a_constant_gap_and_what_is_left_of_it_are_both_in_view(self, browser, tmp_path):
        gap = gap_along_a_circle()
        constant = replace(gap, forces=gap.remainder - np.array([0.0, 400.0, 0.0]))
        opened(browser, report_page(replace(mismatch(), gaps=(constant,))), tmp_path)
        heights = browser.execute_script(
            "const boxes = [...document.querySelectorAll('#plot-strip svg path')].map((p) => p.getBBox());"
            "return boxes.map((b) => [b.y, b.height])"
        )
        top = min(y for y, height in heights if height > 0)
        bottom = max(y + height for y, height in heights if height > 0)
        assert top > 0.0 and bottom < one(browser, "#plot-strip svg").rect["height"]

    def test_the_hover_says_the_gap_that_is_there(self, browser, tmp_path):
        from selenium.webdriver import ActionChains

        opened(browser, report_page(mismatch()), tmp_path)
        track = one(browser, "#plot-track svg")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", track)
        # The circle's top, where the gap is 100 N; averaging over 1 s and noise of 5 N leave 95 to 105.
        box = track.rect
        x, y = browser.execute_script(
            "const t = [...document.querySelectorAll('#plot-track path')].map((p) => p.getBBox());"
            "const top = Math.min(...t.map((b) => b.y));"
            "const left = Math.min(...t.map((b) => b.x)), right = Math.max(...t.map((b) => b.x + b.width));"
            "return [(left + right) / 2, top]"
        )
        ActionChains(browser).move_to_element_with_offset(
            track, round(x - box["width"] / 2), round(y - box["height"] / 2) + 2
        ).perform()
        told = one(browser, "#plot-track .tip").text
        gap, left = (float(v) for v in re.findall(r"(?:gap|physics): ([\d.]+) N", told))
        assert 85.0 < gap < 115.0 and 0.0 < left < 25.0

    def test_rollouts_say_every_stage_and_the_floor(self, browser, tmp_path):
        from selenium.webdriver import ActionChains

        opened(browser, report_page(mismatch()), tmp_path)
        charts = browser.find_elements("css selector", "#rollouts svg[role=img]")
        assert len(charts) == 3
        assert "simulation as it is 0.400" in charts[1].get_attribute("aria-label")
        browser.execute_script("arguments[0].scrollIntoView({block: 'center', behavior: 'instant'})", charts[1])
        ActionChains(browser).move_to_element_with_offset(charts[1], 100, 0).perform()
        told = browser.find_elements("css selector", "#rollouts .tip")[1].text
        for line in (
            "2.00 s ahead",
            "with the identified effects: 0.200 m/s (0.160 to 0.240)",
            "noise floor: 0.160 m/s",
        ):
            assert line in told
        # Without a named term there is no stage to show for it.
        unnamed = replace(mismatch(), findings=())
        opened(browser, report_page(unnamed), tmp_path)
        label = browser.find_elements("css selector", "#rollouts svg[role=img]")[1].get_attribute("aria-label")
        assert "SPLIT only 0.280" in label and "identified effects" not in label
        assert "With the identified effects" not in one(browser, "#help").text

    @pytest.mark.parametrize(
        "diagnosis", [mismatch("x" * 180), MATCH, UNDECIDED], ids=["mismatch", "match", "undecided"]
    )
    def test_a_narrow_window_needs_no_sideways_scrolling(self, browser, tmp_path, diagnosis):
        opened(browser, report_page(diagnosis), tmp_path, width=360)
        wide, window = browser.execute_script("return [document.documentElement.scrollWidth, window.innerWidth]")
        assert wide <= window

    def test_without_position_the_gap_is_drawn_over_distance(self, browser, tmp_path):
        gap = gap_along_a_circle()
        nowhere = np.full_like(gap.x, np.nan)
        opened(browser, report_page(replace(mismatch(), gaps=(replace(gap, x=nowhere, y=nowhere),))), tmp_path)
        titles = [t.text for t in browser.find_elements("css selector", "#plot-track .axis-title")]
        assert titles == ["track position s [m]", "gap force [N]"]

    def test_prints(self, browser, tmp_path):
        opened(browser, report_page(mismatch()), tmp_path)
        printed = browser.execute_cdp_cmd("Page.printToPDF", {"printBackground": True, "preferCSSPageSize": True})
        content = base64.b64decode(printed["data"])
        # A4 upright; a page that did not reflow would have been scaled or cut into a second column of sheets.
        assert content.startswith(b"%PDF") and 2 <= len(re.findall(rb"/Type\s*/Page\b", content)) <= 6


class TestWhatWouldHaveBeenNamed:
    told = (Detectable("steer_delay", {"delay": (0.0137, "s")}), Detectable("wind", {}))

    def test_a_match_shows_it(self):
        page = all_sections(Diagnosis("match", 0.5, 1.0, detectable=self.told))
        assert "<details open><summary>Effect by effect" in page
        assert "<th scope=row>Steer delay</th><td>delay 0.0137 s</td>" in page
        assert "<th scope=row>Wind</th><td>at no size of a real car</td>" in page

    def test_a_mismatch_has_it_folded_and_an_abstention_not_at_all(self):
        page = all_sections(Diagnosis("mismatch", 0.0, 1.0, unexplained=True, detectable=self.told))
        assert "<details><summary>Effect by effect" in page
        assert "Effect by effect" not in all_sections(Diagnosis("undecided", None, 0.0, ("too short",)))
