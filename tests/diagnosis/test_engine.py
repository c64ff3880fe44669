"""The whole diagnosis on short drives: what it names, what it leaves unnamed, what must not change its answer."""

import json
import os
import pty
import re
import subprocess
import sys
import threading
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from split_cli.diagnosis import engine
from split_cli.diagnosis.engine import diagnose
from split_cli.diagnosis.policy import STANDARD
from split_cli.diagnosis.search.baselines import SearchOutcome, search
from split_cli.diagnosis.statement.document import diagnosis_to_mapping, diagnosis_to_text, read_schema
from split_cli.diagnosis.statement.result import Diagnosis
from split_cli.logs.drive import Drive, write_drive
from split_cli.vehicle.effects import CATALOGUE, Term
from split_cli.vehicle.parameters import write_vehicle
from tests.diagnosis import recordings
from tests.diagnosis.recordings import driven, noisy
from tests.diagnosis.test_report import label_of, one, opened
from tests.factories import road_car

GAIN = CATALOGUE["steer_gain"]({"gain": 0.93})
# The long search finds no more in these drives.
SHORT = STANDARD.altered("selection", full_fits=3, rounds=2)
verdict_of = partial(recordings.verdict_of, policy=SHORT)


def recording(seed: int, *terms: Term, name: str = "drive.parquet", runs: int = 5) -> Drive:
    """Return noisy runs of eight seconds, since fewer are not judged; forty seconds unless said."""
    return noisy(driven(seed, terms, runs=runs, seconds=8.0, spaced=9.0, name=name), seed + 500, position=0.01)


@pytest.fixture(scope="module")
def simulation() -> Drive:
    return recording(81, name="simulation.parquet")


@pytest.fixture(scope="module")
def reality() -> Drive:
    return recording(82, GAIN, name="reality.parquet")


@pytest.fixture(scope="module")
def same_car() -> Drive:
    return recording(83)


@pytest.fixture(scope="module")
def strange_car() -> Drive:
    """What is in no catalogue."""
    return recording(85, Lopsided({"share": 0.3}))


@pytest.fixture(scope="module")
def run(reality, simulation, tmp_path_factory) -> tuple[Path, subprocess.CompletedProcess, str]:
    """Run `split diagnose` on a car that steers 7 % less than commanded, with a terminal for its stderr."""
    folder = tmp_path_factory.mktemp("diagnosed")
    write_drive(reality, folder / "real.parquet")
    write_drive(simulation, folder / "sim.parquet")
    write_vehicle(road_car(), folder / "car.yaml")
    ours, theirs = pty.openpty()
    words = "diagnose --real real.parquet --sim sim.parquet --vehicle car.yaml --out out --json --exit-code"
    shown = []
    # A terminal that nobody reads holds a few thousand characters, and then the command waits.
    reader = threading.Thread(target=lambda: shown.extend(iter(lambda: read_terminal(ours), b"")), daemon=True)
    reader.start()
    finished = subprocess.run(
        [sys.executable, "-m", "split_cli", *words.split()],
        cwd=folder,
        stdout=subprocess.PIPE,
        stderr=theirs,
        timeout=900,
    )
    os.close(theirs)
    reader.join(timeout=10)
    os.close(ours)
    return folder / "out", finished, b"".join(shown).decode()


def read_terminal(end: int) -> bytes:
    """Return what has been written to a terminal; nothing once the other end is closed."""
    try:
        return os.read(end, 100_000)
    except OSError:  # EIO, as Linux tells that nobody writes any more
        return b""


@pytest.fixture(scope="module")
def answer(run) -> dict:
    return json.loads((run[0] / "diagnosis.json").read_text(encoding="utf-8"))


def test_a_single_is_named_with_the_truth_inside_its_interval(answer):
    assert answer["verdict"] == "mismatch" and answer["p_value"] < 0.01 and not answer["unexplained"]
    (finding,) = answer["findings"]
    assert finding["term"] == "steer_gain"
    low, high = finding["parameters"]["gain"]["interval_95"]
    assert low <= 0.93 <= high and high - low < 0.04
    assert finding["gap_explained"] > 0.9


@pytest.mark.parametrize(
    ("term", "shared", "more", "width"), [("steer_lag", 0.02, 0.025, 0.02), ("tire_relaxation", 0.4, 0.4, 0.3)]
)
def test_a_lag_longer_than_that_of_the_simulation_is_one_name(term, shared, more, width):
    """The vehicle file has neither lag. A lag behind the simulation's own would need a delay beside it."""
    kind = CATALOGUE[term]
    simulation, reality = (
        recording(seed, kind({kind.slow: late})) for seed, late in ((181, shared), (182, shared + more))
    )
    found = verdict_of([reality], road_car(), [simulation])
    (finding,) = found.findings
    assert (finding.term, finding.variant) == (term, "changed")
    low, high = finding.parameters[kind.slow].interval_95
    assert low <= more <= high and high - low < width


@pytest.mark.parametrize(
    ("shares", "names"), [(True, {"friction_scale"}), (False, {"friction_scale", "combined_slip"})]
)
def test_what_less_grip_makes_of_an_ellipse_that_both_drives_share_is_no_other_name(shares, names):
    """F_y sqrt(1 - (F_x/D)^2): with a smaller D driving takes more, of a simulated car that has this as well."""
    ellipse, grip = CATALOGUE["combined_slip"]({"strength": 1.0}), CATALOGUE["friction_scale"]({"scale": 0.7})
    simulation = recording(191, *([ellipse] if shares else []), runs=12)
    reality = recording(192, grip, ellipse, runs=12)
    found = verdict_of([reality], road_car(), [simulation])
    assert {one.term for one in found.findings} == names


def test_the_command_prints_the_file_and_tells_a_mismatch_by_its_code(run):
    out, finished, shown = run
    assert finished.returncode == 3
    assert finished.stdout == (out / "diagnosis.json").read_bytes()
    # Progress on a terminal: one bar, drawn again and again, with the step that is under way.
    drawn = [text for text in re.split(r"[\r\n]+", re.sub(r"\x1b\[[0-9;]*[A-Za-z]", "", shown)) if text.strip()]
    drawn = [text for text in drawn if not text.startswith("note: ")]
    told = [re.fullmatch(r"([█░]+)  .+?  (\w[\w ]*?) *", text) for text in drawn]
    assert all(told) and len({match.group(2) for match in told}) >= 5
    filled = [match.group(1).count("█") for match in told]
    assert filled == sorted(filled) and told[-1].group(2) == "writing"


def test_a_diagnosis_leaves_a_report_that_says_what_its_json_says(run, answer):
    page = (run[0] / "report.html").read_text(encoding="utf-8")
    assert '<p class="kicker">Simulation and reality differ.</p>' in page
    assert 'id="chart-strip-vx"' in page and 'id="chart-tire-front"' in page
    for finding in answer["findings"]:
        assert f"<code>{finding['term']}" in page
    for file in answer["inputs"]:
        assert file["sha256"] in page


def test_that_report_opens(run, browser, tmp_path):
    opened(browser, run[0] / "report.html", tmp_path)
    assert one(browser, ".kicker").text == "Simulation and reality differ."
    # The first words are the part of the car.
    assert one(browser, "#verdict").text.startswith("Steering")
    assert len(browser.find_elements("css selector", "#chart-strip-vx svg path")) >= 3
    assert len(browser.find_elements("css selector", "#plot-map svg g rect")) > 20
    assert "front lateral" in label_of(browser, "track")


def test_the_same_car_matches(simulation, same_car):
    same = diagnose([same_car], road_car(), [simulation])
    assert same.verdict == "match" and same.p_value >= 0.01
    assert not same.findings and not same.unexplained
    # Positions and velocities of one car agree: no scale of a speed is doubted.
    assert not any("integral of" in reason for reason in same.not_judged)
    jsonschema.validate(diagnosis_to_mapping(same), read_schema())


def test_what_acts_for_a_while_is_no_match():
    """Steering 5 % short in two of eight runs, from 9 to 26 s: no test of the whole drive sees it."""

    def steer(angles: np.ndarray, step: float) -> np.ndarray:
        out = angles.copy()
        out[1:3] *= 0.95
        return out

    drive = noisy(driven(82, runs=8, seconds=8.0, spaced=9.0, steer=steer), 582, position=0.01)
    found = verdict_of([drive], road_car(), [recording(81, runs=8)])
    assert found.verdict == "mismatch" and found.p_value < STANDARD.comparison.level
    assert not found.findings and found.unexplained
    assert "it looks like steer gain (steer_gain) with gain = 0.9" in found.summary
    begin, end = re.search(r"Between (\d+(?:\.\d+)?) and (\d+(?:\.\d+)?) s", found.summary).groups()
    assert float(begin) == pytest.approx(9.0, abs=2.5) and float(end) == pytest.approx(26.0, abs=2.5)


def test_the_result_is_valid_by_the_schema(answer):
    jsonschema.validate(answer, read_schema())


@pytest.fixture(scope="module")
def pair() -> tuple[list[Drive], Diagnosis]:
    """Two drives, and what is said of them against the nominal model."""
    drives = [recording(seed, GAIN, runs=2) for seed in (82, 84)]
    return drives, diagnose(drives, road_car(), policy=SHORT)


def test_neither_names_nor_running_again_change_a_number(pair):
    """Files called as if they were others, and a term no drive has."""
    drives, said = pair
    names = ("null_friction_patch_sim.parquet", "real_steer_delay.parquet")
    renamed = [replace(drive, name=name) for drive, name in zip(drives, names, strict=True)]
    misleading = diagnose(renamed, road_car(name="wind"), policy=SHORT)
    assert diagnosis_to_text(misleading) == diagnosis_to_text(said)


def test_the_order_of_drives_changes_nothing(pair):
    drives, one = pair
    other = verdict_of(drives[::-1], road_car())
    assert one.verdict == other.verdict == "mismatch"
    assert [finding.term for finding in one.findings] == [finding.term for finding in other.findings]
    # Sums of the same rows in another order; the fit stops within a seventh of a standard error.
    for mine, its in zip(one.findings, other.findings, strict=True):
        for name, told in mine.parameters.items():
            assert told.value == pytest.approx(its.parameters[name].value, abs=told.std_error / 7.0)


class Lopsided(Term):
    """Front grip that is lost in turns to one side and gained in those to the other: in no catalogue."""

    id = "lopsided"

    def lateral(self, flow) -> None:
        """Take a share of the front force's size from it."""
        force = flow.front.lateral_force
        flow.front.lateral_force = force - self.parameters["share"] * np.abs(force)


@pytest.fixture(scope="module")
def strange(simulation, strange_car) -> tuple[Diagnosis, SearchOutcome]:
    """What is said of it, and what its search found."""
    found: list[SearchOutcome] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(engine, "search", lambda *a, **k: found.append(search(*a, **k)) or found[0])
        return verdict_of([strange_car], road_car(), [simulation]), found[0]


def test_what_is_in_no_catalogue_is_unexplained(strange):
    said, _ = strange
    assert said.verdict == "mismatch" and said.unexplained
    assert said.remainder.p_value < 0.01
    # The lead is the right one: the front axle, by the size of its slip angle.
    assert "front lateral force" in said.remainder.formula and "|B alpha_f|" in said.remainder.formula


@dataclass(frozen=True)
class Spread:
    """A case of which as many rows are within a distance as that is in hundredths."""

    reach: float = STANDARD.comparison.reach
    simulated: tuple[str, ...] = ("one",)

    @property
    def keep(self):
        return [np.arange(100) < round(100.0 * self.reach)]

    def compared(self, reach, policy):
        return Spread(reach, self.simulated)


@pytest.mark.parametrize(("least", "expected"), [(30, 0.35), (36, 0.40), (41, 0.45), (68, 0.70), (90, 0.70)])
def test_no_more_is_compared_than_has_to_be(least, expected):
    case, kept, reach = engine._compared(Spread(), STANDARD.altered("comparison", least_rows=least))
    assert reach == case.reach == pytest.approx(expected)
    assert kept == round(100.0 * expected)
    nominal = engine._compared(Spread(simulated=()), STANDARD.altered("comparison", least_rows=90))
    assert nominal[1:] == (35, STANDARD.comparison.reach)


class TestFarFromTheSimulation:
    """Hardly a row lies near a simulated one: those further off are compared, and told so."""

    # Fewer rows lie within a tenth, and more within twice as much.
    near = SHORT.altered("comparison", reach=0.1, least_rows=375)

    def test_what_has_a_name_is_named(self, reality, simulation, answer):
        far = verdict_of([reality], road_car(), [simulation], policy=self.near)
        assert [one.term for one in far.findings] == [one["term"] for one in answer["findings"]]
        assert far.compared_share > 0.3 and any("further off" in text for text in far.not_judged)
        assert not any("further off" in text for text in answer["not_judged"])

    def test_what_has_none_may_be_what_the_simulation_has_not_shown(self, simulation, strange_car):
        far = verdict_of([strange_car], road_car(), [simulation], policy=self.near)
        assert far.verdict == "undecided" and not far.unexplained
        assert "no effect of the catalogue" in far.not_judged[0]

    def test_nor_is_it_told_from_that_in_a_tenth_of_the_drive(self, simulation, strange_car, strange, monkeypatch):
        """The search does not ask for the share, so its outcome is that of the whole drive's."""
        monkeypatch.setattr(engine, "search", lambda *_, **__: strange[1])
        little = SHORT.altered("comparison", least_share=1.1)
        near = verdict_of([strange_car], road_car(), [simulation], policy=little)
        assert near.verdict == "undecided" and "no effect of the catalogue" in near.not_judged[0]

    def test_the_same_car_matches(self, simulation, same_car):
        far = verdict_of([same_car], road_car(), [simulation], policy=self.near)
        assert far.verdict == "match"

    def test_too_far_is_too_far(self, reality, simulation):
        far = diagnose([reality], road_car(), [simulation], policy=STANDARD.altered("comparison", reach=1e-6))
        assert far.verdict == "undecided" and "operating points" in far.not_judged[0]
