"""The suite leaves out slow tests, and every one of them runs in one part."""

import re
from pathlib import Path

import pytest

from tests.slowness import LIST, chosen, listed, part_of
from tests.studies.slow_tests import ALWAYS, slow_ones

ROOT = Path(__file__).parents[1]
NODES = ["a.py::one", "a.py::two[x]", "a.py::two[y]", "b.py::whole", "c.py::C::three", "d.py::four"]
SLOW = listed("# seconds\n  5.0 a.py::two\n 40 b.py\n 3.5 c.py::C::three\n")


def test_what_is_listed_is_left_out_with_all_its_parameters():
    assert SLOW == {"a.py::two": 5.0, "b.py": 40.0, "c.py::C::three": 3.5}
    assert chosen(NODES, SLOW, "") == [True, False, False, False, False, True]
    assert chosen(NODES, SLOW, "all") == [False, True, True, True, True, False]


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_each_slow_test_is_in_one_part_and_a_file_stays_whole(count):
    parts = [chosen(NODES, SLOW, f"{number}/{count}") for number in range(1, count + 1)]
    assert [sum(column) for column in zip(*parts, strict=True)] == [0, 1, 1, 1, 1, 0]
    assert all(part[1] == part[2] for part in parts)


@pytest.mark.parametrize("part", ["0/4", "5/4", "x", "1/0"])
def test_a_part_that_is_none_is_refused(part):
    with pytest.raises(ValueError):
        part_of(["a.py"], part)


def test_the_longest_test_of_a_function_and_shared_fixtures_decide():
    rows = [(1.0, "test", "a.py::one[x]"), (1.6, "test", "a.py::one[y]"), (15.0, "fixtures", "b.py::two")]
    rows += [(6.0, "fixtures", "b.py::three"), (19.0, "fixtures", "c.py::four"), (90.0, "test", ALWAYS[0])]
    assert slow_ones(rows) == {"a.py::one": 1.6, "b.py": 21.0}


def test_what_is_listed_exists():
    for name in [*listed(LIST.read_text()), *ALWAYS]:
        file, _, function = name.partition("::")
        text = (ROOT / file).read_text()
        assert not function or re.search(rf"def {function.split('::')[-1]}\(", text), name
