"""Compiled code finds a folder of its own where neither the installation nor the home can be written."""

import os
import stat
import subprocess
import sys

import pytest

from split_cli import compiled_code
from split_cli.compiled_code import cache_folder, provide_cache


@pytest.fixture
def nothing_else(tmp_path, monkeypatch):
    """Neither package nor home can be written, as on a read-only file system; a temporary folder can."""
    monkeypatch.setattr(compiled_code.tempfile, "gettempdir", lambda: str(tmp_path))
    monkeypatch.setattr(compiled_code.os, "access", lambda path, mode: str(path).startswith(str(tmp_path)))
    monkeypatch.setitem(os.environ, "NUMBA_CACHE_DIR", "")
    monkeypatch.setitem(os.environ, "MPLCONFIGDIR", "")
    return tmp_path


def test_a_private_folder_is_taken_and_said(nothing_else):
    said = provide_cache("/opt/split_cli", {"XDG_CACHE_HOME": "/nonexistent"})
    folder = os.environ["NUMBA_CACHE_DIR"]
    assert folder in said and folder.startswith(str(nothing_else))
    assert stat.S_IMODE(os.stat(folder).st_mode) == 0o700
    # Matplotlib would warn at every start; its list of fonts goes there too.
    assert os.environ["MPLCONFIGDIR"] == os.path.join(folder, "matplotlib")
    assert stat.S_IMODE(os.stat(os.environ["MPLCONFIGDIR"]).st_mode) == 0o700


def test_a_folder_that_others_may_write_to_is_not_taken(nothing_else):
    first = cache_folder()
    os.chmod(first, 0o777)
    second = cache_folder()
    assert second != first and stat.S_IMODE(os.stat(second).st_mode) == 0o700


def test_a_link_is_not_followed(nothing_else, tmp_path):
    target = tmp_path / "elsewhere"
    target.mkdir(mode=0o700)
    (tmp_path / f"split-compiled-{os.getuid()}").symlink_to(target)
    assert not os.path.samefile(cache_folder(), target)


def test_nothing_is_done_where_the_usual_folders_do(tmp_path):
    assert provide_cache(str(tmp_path), {}) is None
    assert provide_cache("/nonexistent", {"XDG_CACHE_HOME": str(tmp_path)}) is None
    assert provide_cache("/proc", {"NUMBA_CACHE_DIR": "/somewhere"}) is None


def test_compiled_functions_load_from_the_folder(tmp_path):
    code = "import split_cli.learning._compiled"
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=environment)
    assert done.returncode == 0, done.stderr
