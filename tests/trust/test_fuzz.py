"""A short run of the study that mutates files of every kind; the long one is `python -m tests.studies.fuzz`."""

import gzip
import random
import time

import pytest

from split_cli.errors import LogError
from tests.studies.fuzz import FuzzTally, fuzz, judge, mutate
from tests.studies.fuzz_seeds import SLOW


def test_mutated_files_are_read_counted_or_refused():
    tallies = fuzz(76 * 4, seed=20_26)
    assert not [line for tally in tallies.values() for line in tally.broken]
    counts = {kind: tally.read + tally.dropped + tally.refused for kind, tally in tallies.items()}
    assert len(counts) > 60 and {kind for kind, n in counts.items() if n < (1 if kind in SLOW else 4)} == set()
    assert sum(tally.refused for tally in tallies.values()) > 35


@pytest.mark.parametrize(
    ("read", "expected"),
    [
        (lambda path: {}["x"], "KeyError"),
        (lambda path: (_ for _ in ()).throw(LogError("bad \x1b name\u2028")), None),
        (lambda path: time.sleep(60), "over"),
    ],
)
def test_the_judge_sees_a_rule_broken(tmp_path, monkeypatch, read, expected):
    monkeypatch.setattr("tests.studies.fuzz.LONGEST_SECONDS", 0.2)
    found = judge(tmp_path / "x", read, FuzzTally())
    assert (found is None) if expected is None else found.startswith(expected)


def test_an_input_that_takes_much_memory_is_kept(tmp_path, monkeypatch):
    """Of files of one byte, the reader of which takes 64 MB where it was changed."""

    def read(path):
        return len(b"x" * (1 << 26)) * 0 if path.read_bytes() != b"\x00" else 0

    def one_kind(folder):
        (folder / "one").write_bytes(b"\x00")
        return {"one": (folder / "one", read)}

    monkeypatch.setattr("tests.studies.fuzz.seeds", one_kind)
    monkeypatch.setattr("tests.studies.fuzz.MOST_MEMORY", 1 << 26)
    (tally,) = fuzz(20, seed=1, keep=tmp_path / "kept").values()
    assert tally.grown > 1 << 25 and all("memory: " in line for line in tally.broken)
    kept = [gzip.decompress(path.read_bytes()) for path in (tmp_path / "kept").iterdir()]
    assert len(kept) == len(tally.broken) and any(content != b"\x00" for content in kept)


def test_mutations_are_those_of_the_seed():
    content, other = bytes(range(256)), b"other"
    once = [mutate(content, other, random.Random(seed)) for seed in range(50)]
    assert once == [mutate(content, other, random.Random(seed)) for seed in range(50)]
    assert len(set(once)) > 40
