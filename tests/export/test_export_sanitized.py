"""The exported C under address and undefined-behaviour sanitizers at inputs of every kind, and under cppcheck."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from split_cli.errors import ExportError
from split_cli.export.c_check import build_driver
from tests.export.export_support import source_of, take_cells
from tests.export.test_export_finite import fuzz
from tests.optional import needed

SANITIZERS = ("-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all")


def hostile(asked: np.ndarray, real: str, seed: int = 2) -> np.ndarray:
    """Return the arguments with a tenth of the numbers made NaN, infinite, subnormal or a border's neighbour."""
    rng = np.random.default_rng(seed)
    limits = np.finfo(np.float32 if real == "float" else np.float64)
    kinds = np.array([np.nan, np.inf, -np.inf, float(limits.smallest_subnormal), -float(limits.tiny) / 4, -0.0])
    spoiled = asked.copy()
    chosen = rng.random(asked.shape) < 0.1
    spoiled[chosen] = rng.choice(kinds, int(chosen.sum()))
    return spoiled


@pytest.fixture(scope="module", params=["double", "float"])
def sanitized(request, small_set, compiler, tmp_path_factory):
    folder = tmp_path_factory.mktemp("sanitized")
    try:
        source = source_of(take_cells(small_set, 60), request.param)
        driver = build_driver(source, folder, compiler, SANITIZERS)
        driver.answers(0, small_set.z[:1], 6)
    except ExportError as error:
        pytest.skip(f"the compiler has no sanitizers here: {error}")
    return driver, request.param


def test_predictions_at_any_input_touch_nothing_they_should_not(sanitized, small_set):
    driver, real = sanitized
    width = small_set.z.shape[1]
    rng = np.random.default_rng(5)
    edges = np.array(small_set.grid.edges)
    # Points, and the borders of cells with their neighbours in floating point; then every size, then no numbers.
    borders = np.round(small_set.z[:300] / edges) * edges
    asked = [small_set.z[:300], borders, np.nextafter(borders, np.inf), np.nextafter(borders, -np.inf)]
    asked.append(fuzz(1000, 13, real)[:, :width])
    finite = np.concatenate(asked)
    spoiled = hostile(np.concatenate([finite, rng.standard_normal((2000, width))]), real)
    # Mean and variance, Jacobian, validity.
    for what, answered in ((0, 6), (5, 3 * width), (11, 1)):
        assert np.isfinite(driver.answers(what, finite, answered)).all()
        answers = driver.answers(what, spoiled, answered)
        if what == 0:
            assert np.isnan(answers[np.isnan(spoiled).any(axis=1)]).all()


def test_the_step_at_any_input(sanitized):
    driver, real = sanitized
    asked = fuzz(500, 13, real, seed=3)
    # A car as it drives; then velocities, yaw rate, torque or steer angle lost: that is seen in the answer.
    driving = np.array([0, 0, 0.1, 20.0, 0.1, 0.2, 300.0, 0.02, 100.0, 0.1, 0.05, 0.0, 0.0])
    lost = np.where(np.eye(10, 13, dtype=bool), np.nan, driving)
    for what, width in ((1, 8), (2, 8)):
        driver.answers(what, hostile(asked, real), width)
        assert np.isfinite(driver.answers(what, driving[None], width)).all()
        assert np.isnan(driver.answers(what, lost[3:8], width)).any(axis=1).all()


def test_the_sanitizer_sees_a_fault(small_set, compiler, tmp_path):
    broken = tmp_path / "broken.c"
    broken.write_text("int main(int n, char **v) { int a[2] = {0}; (void)v; return a[n + 4]; }\n")
    done = subprocess.run(
        [*compiler.command, *SANITIZERS, str(broken), "-o", str(tmp_path / "broken")], capture_output=True, check=False
    )
    if done.returncode:
        pytest.skip("the compiler has no sanitizers here")
    assert subprocess.run([str(tmp_path / "broken")], capture_output=True, check=False).returncode != 0


@pytest.fixture(scope="module", params=["bcm", "rbcm", "projected", "table"])
def checked(request, small_set, tmp_path_factory):
    """What cppcheck says of an export, its constants shortened by the command of docs/export.md."""
    needed("cppcheck")
    folder = tmp_path_factory.mktemp(request.param)
    source = source_of(take_cells(small_set, 20), predictor=request.param)
    shorten = re.search(r'^python -c "(.*)" \\$', checks_of_the_page(), re.MULTILINE)[1]
    short = subprocess.run(
        [sys.executable, "-c", shorten], input=source.source, capture_output=True, text=True, check=True
    ).stdout
    assert len(short) < 50_000 and short.count(";") == source.source.count(";")
    (folder / "car.h").write_text(source.header)
    (folder / "car.c").write_text(short)

    def check(*options: str) -> str:
        checker = (sys.executable, "-c", "import sys, cppcheck; sys.exit(cppcheck.cppcheck())")
        command = [*checker, "--std=c99", "--quiet", *options, str(folder / "car.c")]
        return subprocess.run(command, capture_output=True, text=True, check=False, timeout=240).stderr

    return check


def checks_of_the_page() -> str:
    page = (Path(__file__).parents[2] / "docs" / "export.md").read_text(encoding="utf-8")
    return page.partition("## Static checks of the C")[2].partition("\n## ")[0]


def test_cppcheck_finds_nothing(checked):
    assert checked("--enable=warning,performance,portability") == ""


def test_every_finding_of_misra_is_explained(checked):
    """By its rule, in docs/export.md."""
    found = set(re.findall(r"\[misra-c2012-([0-9.]+)\]", checked("--enable=style", "--addon=misra")))
    assert "8.14" in found and found <= set(re.findall(r"\b\d+\.\d+\b", checks_of_the_page()))
