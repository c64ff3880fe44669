"""Slow tests: ``slow_tests.txt`` lists them, and they run when asked for, so that the suite stays quick.

``pytest`` leaves them out and counts them as deselected. ``pytest --slow all`` runs them alone, and ``--slow 2/4`` the
second of four parts, file by file. A test or a file that the command line names runs in any case.
"""

from collections.abc import Iterable
from pathlib import Path

import pytest

LIST = Path(__file__).with_name("slow_tests.txt")


def listed(text: str) -> dict[str, float]:
    """Return the seconds of processor time by test function or whole file, of lines ``seconds name``."""
    lines = (line.split("#")[0].split() for line in text.splitlines())
    return {name: float(seconds) for seconds, name in filter(None, lines)}


def name_of(nodeid: str) -> str:
    """Return the name under which a test is listed: its parameters are left out."""
    return nodeid.split("[")[0]


def part_of(files: Iterable[str], part: str) -> set[str]:
    """Return the K-th of N parts, ``K/N``, of files in the order of their names; every file is in one part."""
    number, count = map(int, part.split("/"))
    if not 1 <= number <= count:
        raise ValueError(part)
    return set(sorted(files)[number - 1 :: count])


def chosen(nodeids: list[str], slow: dict[str, float], part: str) -> list[bool]:
    """Return which tests run: the quick ones for an empty part, else slow ones."""
    is_slow = [name_of(one) in slow or one.split("::")[0] in slow for one in nodeids]
    if not part:
        return [not one for one in is_slow]
    files = {one.split("::")[0] for one, it_is in zip(nodeids, is_slow, strict=True) if it_is}
    here = files if part == "all" else part_of(files, part)
    return [it_is and one.split("::")[0] in here for one, it_is in zip(nodeids, is_slow, strict=True)]


def add_option(parser: pytest.Parser) -> None:
    """Add ``--slow``."""
    parser.addoption("--slow", metavar="PART", default="", help="Run the slow tests instead: all, or a part, as 2/4.")


def deselect(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Take out of the items what does not run."""
    named = config.args_source is pytest.Config.ArgsSource.ARGS and any(".py" in one for one in config.args)
    part = config.getoption("--slow")
    if named and not part:
        return
    try:
        runs = chosen([item.nodeid for item in items], listed(LIST.read_text()), part)
    except ValueError:
        raise pytest.UsageError(f"--slow {part}: give all, or a part such as 2/4") from None
    left = [item for item, it_runs in zip(items, runs, strict=True) if not it_runs]
    config.hook.pytest_deselected(items=left)
    items[:] = [item for item, it_runs in zip(items, runs, strict=True) if it_runs]
