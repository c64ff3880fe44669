"""Small trained sets, and a compiler where there is one."""

from dataclasses import replace

import pytest

from split_cli.export.check import Oracle
from split_cli.export.compiler import Compiler, find_compiler
from split_cli.learning.training_set import TrainingSet
from split_cli.learning.trust import Trust
from tests.export.export_support import oracle_of
from tests.factories import make_training_set


@pytest.fixture(scope="session")
def small_set() -> TrainingSet:
    """About 400 points in 250 cells, trusted in part, not at all, and fully."""
    return replace(make_training_set(seed=3, points=400), trust=Trust((0.6, 0.0, 1.0), "given"))


@pytest.fixture(scope="session")
def z1_set() -> TrainingSet:
    """Five features."""
    return make_training_set(seed=4, points=300, features="z1")


@pytest.fixture(scope="session")
def small_oracle(small_set) -> Oracle:
    return oracle_of(small_set, 2000)


@pytest.fixture(scope="session")
def compiler() -> Compiler:
    found = find_compiler()
    if found is None:
        pytest.skip("there is no C compiler here")
    return found
