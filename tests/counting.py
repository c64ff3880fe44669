"""In CI, how much of the two lowest layers their own tests run through; below the floor the run fails.

Lines are counted while modules are imported and while tests of these layers run: over all tests it would cost a
sixth more time. Each worker counts for itself, and the process that started them adds up.
"""

import io
import os
import tempfile
from pathlib import Path

import coverage
import pytest

__all__ = ["Counting", "share_of"]

#: Where workers leave what they counted; set by the process that starts them.
FOLDER = "SPLIT_COUNTED_IN"
COUNTED = tuple(Path(__file__).resolve().parent / layer for layer in ("vehicle", "learning"))


def share_of(folder: Path, **settings) -> tuple[float, float]:
    """Return the percentage of statements that all counts in a folder ran together, and the floor."""
    total = coverage.Coverage(data_file=str(folder / "counted"), **settings)
    total.combine([str(folder)], keep=True)
    return total.report(file=io.StringIO()), float(total.get_option("report:fail_under"))


class Counting:
    """A pytest plugin; coverage's settings are in pyproject.toml."""

    def __init__(self) -> None:
        self.folder = Path(os.environ.setdefault(FOLDER, "") or tempfile.mkdtemp(prefix="split-counted-"))
        os.environ[FOLDER] = str(self.folder)
        self.counter = coverage.Coverage(data_file=str(self.folder / "counted"), data_suffix=True)
        self.counter.start()

    def pytest_collection_finish(self) -> None:
        """Stop counting when all test files have imported what they test."""
        self.counter.stop()

    @pytest.hookimpl(hookwrapper=True)
    def pytest_runtest_protocol(self, item: pytest.Item):
        """Count what tests of the layers run."""
        counts = any(layer in item.path.parents for layer in COUNTED)
        if counts:
            self.counter.start()
        yield
        if counts:
            self.counter.stop()

    @pytest.hookimpl(trylast=True)
    def pytest_sessionfinish(self, session: pytest.Session) -> None:
        """Leave the count to the process that started this one, or add up and compare with the floor."""
        self.counter.stop()
        self.counter.save()
        if hasattr(session.config, "workerinput"):
            return
        share, floor = share_of(self.folder)
        whole = session.config.args_source is pytest.Config.ArgsSource.TESTPATHS and not session.config.option.slow
        print(f"\n{share:.1f} % of the statements of vehicle and learning run in their tests, floor {floor:g} %")
        if whole and share < floor and session.exitstatus == 0:
            session.exitstatus = pytest.ExitCode.TESTS_FAILED
