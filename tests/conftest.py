"""Fixtures shared by all tests."""

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests import slowness
from tests.browsers import headless

# As the command line does: BLAS threads stall on small matrices when other programs are busy.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
os.environ.setdefault("MKL_NUM_THREADS", "1")

ROOT = Path(__file__).resolve().parent.parent

COUNTING = None
if os.environ.get("SPLIT_TESTS_COMPLETE"):  # before anything that is counted is imported
    from tests.counting import Counting

    COUNTING = Counting()


@pytest.fixture(scope="session")
def datasets() -> Path:
    """Folder of the foreign recordings; tests that need it skip when it is absent."""
    folder = Path(os.environ.get("SPLIT_DATASETS", ROOT.parent / "shared" / "datasets"))
    if not folder.is_dir():
        pytest.skip("the foreign recordings are not here (set SPLIT_DATASETS)")
    return folder


@pytest.fixture(scope="module")
def browser(tmp_path_factory) -> Iterator:
    """A headless browser."""
    yield from headless(tmp_path_factory.mktemp("profile"))


@pytest.fixture(scope="session")
def sample_logs() -> Path:
    """Folder of the bundled sample logs."""
    return ROOT / "sample_logs"


_LONGEST = ("test_types.py", "test_tutorial.py", "workflows/test_cluster.py", "diagnosis/test_engine.py")
"""Files of few tests that take long: xdist would leave them for the end, where one worker waits for the other."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let slow tests be asked for."""
    slowness.add_option(parser)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave out slow tests and begin with the longest files; the others keep their order."""
    slowness.deselect(config, items)
    items.sort(key=lambda item: not item.path.as_posix().endswith(_LONGEST))


def pytest_configure(config: pytest.Config) -> None:
    """Count statements where CI says that the tests are complete."""
    if COUNTING is not None:
        config.pluginmanager.register(COUNTING)
