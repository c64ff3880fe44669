"""Measure the processor time of every test and list those that the suite leaves out in ``tests/slow_tests.txt``.

Example: ``python -m tests.studies.slow_tests``. It runs all tests with two workers. A function is listed where one of
its tests takes longer than 1.5 seconds, a file where its shared fixtures take longer than twenty. Tests of
``ALWAYS`` stay in the suite.
"""

import os
import subprocess
import sys
import tempfile
from collections import Counter
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

from tests.slowness import LIST, name_of

#: Processor time of one test [s]. Study: this command; nine of ten tests are shorter, and take a third of the time.
LONGEST = 1.5
#: Processor time of a file's shared fixtures [s]; judgement: shorter ones serve the quick tests of their file.
LONGEST_FIXTURES = 20.0
ALWAYS = (
    "tests/test_types.py::test_there_is_no_type_error",
    "tests/test_project.py::test_the_site_builds_without_a_warning",
    "tests/test_project.py::test_the_package_builds_and_is_clean",
    "tests/test_tutorial.py",
    "tests/diagnosis/test_engine.py",
    "tests/diagnosis/test_engine.py::test_the_same_car_matches",
    "tests/workflows/test_cluster.py",
    "tests/workflows/test_cluster.py::test_a_set_is_the_same",
    "tests/control/test_closed_loop.py::test_two_laps_of_a_ring_are_driven_learned_and_written",
    "tests/control/test_maneuvers.py::test_on_half_the_grip_a_set_passes_where_the_file_of_a_dry_road_does_not",
    "tests/trust/test_fuzz.py::test_mutated_files_are_read_counted_or_refused",
)
"""One test of each whole way: log to C, a diagnosis, a cluster, a lap, a manoeuvre, hostile files, types, packages."""
FOLDER = "SPLIT_TIMES_IN"


def spent() -> float:
    """Return the processor time of this process and of what it started [s]."""
    times = os.times()
    return times.user + times.system + times.children_user + times.children_system


@pytest.hookimpl(wrapper=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Note the time of fixtures."""
    return (yield from _noted(item, "fixtures"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Note the time of a test."""
    return (yield from _noted(item, "test"))


def _noted(item: pytest.Item, what: str) -> Iterator[None]:
    begin = spent()
    try:
        return (yield)
    finally:
        with (Path(os.environ[FOLDER]) / f"{os.getpid()}").open("a") as file:
            file.write(f"{spent() - begin:.2f}\t{what}\t{item.nodeid}\n")


def slow_ones(rows: Iterable[tuple[float, str, str]]) -> dict[str, float]:
    """Return what is listed, by name, of rows of seconds, ``test`` or ``fixtures``, and node id."""
    tests: dict[str, float] = {}
    files: Counter[str] = Counter()
    for seconds, what, nodeid in rows:
        if what == "test":
            name = name_of(nodeid)
            tests[name] = max(tests.get(name, 0.0), seconds)
        else:
            files[nodeid.split("::")[0]] += seconds
    found = {name: seconds for name, seconds in tests.items() if seconds > LONGEST}
    found |= {name: seconds for name, seconds in files.items() if seconds > LONGEST_FIXTURES}
    return {name: found[name] for name in sorted(found) if name not in ALWAYS}


def main() -> int:
    """Run from the command line."""
    with tempfile.TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "pytest", "-n", "2", "-p", "tests.studies.slow_tests"]
        for part in ([], ["--slow", "all"]):
            subprocess.run([*command, *part], env={**os.environ, FOLDER: folder}, check=False)
        lines = [line.split("\t") for file in Path(folder).iterdir() for line in file.read_text().splitlines()]
    rows = [(float(seconds), what, nodeid) for seconds, what, nodeid in lines]
    listed = slow_ones(rows)
    head = "# Processor time [s] of slow tests and files, by `python -m tests.studies.slow_tests`.\n"
    LIST.write_text(head + "".join(f"{seconds:6.1f} {name}\n" for name, seconds in listed.items()))
    print(f"{len(listed)} entries; all tests took {sum(row[0] for row in rows):.0f} s of processor time")
    return 0


if __name__ == "__main__":
    sys.exit(main())
