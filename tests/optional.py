"""Modules that some tests need and not every installation has: skipped at home, missed where all should be."""

import importlib
import os
from types import ModuleType

import pytest

#: Set by `.ci/run`: what `pip install 'split-cli[test]'` brings has to be there.
COMPLETE = "SPLIT_TESTS_COMPLETE"


def needed(name: str) -> ModuleType:
    """Return a module; where it is missing, skip the test, or fail if the installation should be complete."""
    try:
        return importlib.import_module(name)
    except ImportError as error:
        if os.environ.get(COMPLETE):
            pytest.fail(f"{name} should be installed where {COMPLETE} is set: {error}", pytrace=False)
        pytest.skip(f"{name} is not installed: pip install 'split-cli[test]'", allow_module_level=True)
