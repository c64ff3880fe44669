"""Compiled loops follow the files that they call: numba itself looks at the file of the loop only."""

import hashlib
import importlib
import sys
from pathlib import Path

import pytest

from split_cli.plant import _loops_numba

CALLED = "from numba import njit\n\n\n@njit\ndef rate():\n    return {}\n"
LOOP = """
import hashlib
from pathlib import Path
from numba import njit
import called

def make(digest):
    @njit(cache=True)
    def loop():
        _ = digest
        return called.rate()
    return loop

loop = make({})
"""
DIGEST = "hashlib.sha256(Path(called.__file__).read_bytes()).hexdigest()"


@pytest.mark.parametrize("digest, answers", [(DIGEST, [1, 22]), ("''", [1, 1])], ids=["as here", "without"])
def test_a_loop_that_closes_over_a_digest_never_runs_old_code(tmp_path, monkeypatch, digest, answers):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "loop.py").write_text(LOOP.format(digest))
    found = []
    for value in (1, 22):  # of another length: Python itself tells sources of the same second by their size
        (tmp_path / "called.py").write_text(CALLED.format(value))
        for name in ("called", "loop"):
            sys.modules.pop(name, None)
            importlib.invalidate_caches()
        found.append(importlib.import_module("loop").loop())
    for name in ("called", "loop"):
        sys.modules.pop(name)
    assert found == answers


@pytest.mark.parametrize("loop", [_loops_numba.run, _loops_numba.follow])
def test_the_loops_of_the_plant_close_over_every_compiled_file_beside_them(loop):
    folder = Path(_loops_numba.__file__).parent
    called = [folder / "_compiled.py", *sorted(set(folder.glob("_*_numba.py")) - {Path(_loops_numba.__file__)})]
    digest = int.from_bytes(hashlib.sha256(b"".join(path.read_bytes() for path in called)).digest()[:7], "big")
    assert [cell.cell_contents for cell in loop.py_func.__closure__] == [digest]
