"""Atomic writing: the old file or the new one, after exceptions, a full disk and kill -9 alike."""

import errno
import hashlib
import json
import os
import signal
import stat
import subprocess
import sys
import textwrap
import threading
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from split_cli import files
from split_cli.errors import SplitError
from split_cli.files import (
    atomic_directory,
    atomic_path,
    atomic_write_bytes,
    atomic_write_text,
    json_ready,
    sha256_of_file,
)


def leftovers(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if path.name.endswith(".part"))


def test_new_content_replaces_the_old_only_at_the_end(tmp_path):
    target = tmp_path / "set.split"
    target.write_text("old")
    with atomic_path(target) as temporary:
        temporary.write_text("new")
        assert target.read_text() == "old"
    assert target.read_text() == "new"
    assert leftovers(tmp_path) == []


def test_an_exception_leaves_the_old_file_and_no_rubbish(tmp_path):
    target = tmp_path / "set.split"
    target.write_text("old")
    with pytest.raises(ValueError, match="half"), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise ValueError("half way")
    assert target.read_text() == "old"
    assert leftovers(tmp_path) == []


def test_a_keyboard_interrupt_leaves_the_old_file(tmp_path):
    target = tmp_path / "set.split"
    with pytest.raises(KeyboardInterrupt), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise KeyboardInterrupt
    assert not target.exists()
    assert leftovers(tmp_path) == []


KILLED = textwrap.dedent(
    """
    import sys, time
    from split_cli.files import atomic_path, atomic_directory
    kind, target = sys.argv[1:]
    context = atomic_path(target) if kind == "file" else atomic_directory(target)
    with context as temporary:
        part = temporary if kind == "file" else temporary / "model.c"
        with open(part, "w") as stream:
            while True:
                stream.write("half " * 1000)
                stream.flush()
                print("writing", flush=True)
                time.sleep(0.01)
    """
)


def old_output(folder: Path, kind: str) -> tuple[Path, Path]:
    """Write an output of before; return it, and the file that holds its text."""
    target = folder / "out"
    if kind == "directory":
        target.mkdir()
    old = target if kind == "file" else target / "model.c"
    old.write_text("old")
    return target, old


@pytest.mark.parametrize("kind", ["file", "directory"])
def test_kill_nine_leaves_the_old_output_whole(tmp_path, kind):
    target, old = old_output(tmp_path, kind)
    process = subprocess.Popen([sys.executable, "-c", KILLED, kind, str(target)], stdout=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stdout.readline() == b"writing\n"
    process.send_signal(signal.SIGKILL)
    process.wait(timeout=10)
    process.stdout.close()
    assert old.read_text() == "old"
    # What was half written stays under another, hidden name, so no reader takes it for output.
    assert all(name.startswith(".") for name in leftovers(tmp_path))


FULL = textwrap.dedent(
    """
    import resource, sys
    from split_cli.errors import SplitError
    from split_cli.files import atomic_path, atomic_directory
    kind, target = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_FSIZE, (10_000, 10_000))
    try:
        context = atomic_path(target) if kind == "file" else atomic_directory(target)
        with context as temporary:
            part = temporary if kind == "file" else temporary / "model.c"
            part.write_bytes(b"x" * 20_000)
    except SplitError as error:
        print(error)
    """
)


@pytest.mark.parametrize("kind", ["file", "directory"])
def test_a_limit_of_file_size_is_one_clear_error_and_the_old_output_stays(tmp_path, kind):
    target, old = old_output(tmp_path, kind)
    done = subprocess.run(
        [sys.executable, "-c", FULL, kind, str(target)], capture_output=True, text=True, check=True, timeout=30
    )
    assert "cannot be written" in done.stdout
    assert done.stdout.count("\n") == 1
    assert old.read_text() == "old"
    assert leftovers(tmp_path) == []


def test_a_full_disk_found_only_when_flushing_leaves_the_old_file(tmp_path, monkeypatch):
    # Network and overlay file systems report ENOSPC as late as fsync.
    def full(descriptor):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    target = tmp_path / "set.split"
    target.write_text("old")
    monkeypatch.setattr(files.os, "fsync", full)
    with pytest.raises(SplitError, match="No space left on device"):
        atomic_write_text(target, "new")
    assert target.read_text() == "old"
    assert leftovers(tmp_path) == []


def test_an_input_that_vanished_is_not_blamed_on_the_output(tmp_path):
    with pytest.raises(FileNotFoundError), atomic_path(tmp_path / "out"):
        (tmp_path / "input").read_bytes()
    with pytest.raises(FileNotFoundError), atomic_directory(tmp_path / "folder"):
        (tmp_path / "input").read_bytes()
    assert leftovers(tmp_path) == []


def test_missing_folder_and_folder_in_the_way_are_told(tmp_path):
    with pytest.raises(SplitError, match="does not exist") as caught:
        atomic_write_text(tmp_path / "none" / "a", "x")
    assert str(tmp_path / "none") in str(caught.value)
    (tmp_path / "folder").mkdir()
    with pytest.raises(SplitError, match="is a folder"):
        atomic_write_text(tmp_path / "folder", "x")
    (tmp_path / "file").write_text("x")
    with pytest.raises(SplitError, match="is a file"), atomic_directory(tmp_path / "file"):
        pass
    with pytest.raises(SplitError, match="does not exist"), atomic_directory(tmp_path / "none" / "b"):
        pass


def test_a_device_is_never_replaced(tmp_path):
    # As root, a rename onto a device (-o /dev/null) would replace it for the whole machine.
    fifo = tmp_path / "fifo"
    os.mkfifo(fifo)
    with pytest.raises(SplitError, match="not a regular file"):
        atomic_write_text(fifo, "x")
    assert stat.S_ISFIFO(fifo.stat().st_mode)


def test_a_write_protected_file_is_kept(tmp_path):
    """A rename asks for the folder's permission only; root and the file's owner protect a file by its mode."""
    kept = tmp_path / "kept.split"
    kept.write_text("old")
    kept.chmod(0o444)
    with pytest.raises(SplitError, match="write-protected"):
        atomic_write_text(kept, "new")
    assert kept.read_text() == "old"


def test_a_symbolic_link_stays_one_and_its_target_gets_the_content(tmp_path):
    (tmp_path / "real").mkdir()
    real = tmp_path / "real" / "a.yaml"
    real.write_text("old")
    link = tmp_path / "a.yaml"
    link.symlink_to(real)
    atomic_write_text(link, "new")
    assert link.is_symlink()
    assert real.read_text() == "new"


def test_permissions_follow_the_umask_not_the_temporary_file(tmp_path):
    old = os.umask(0o027)
    try:
        atomic_write_text(tmp_path / "a", "x")
        with atomic_directory(tmp_path / "b") as temporary:
            (temporary / "c").write_text("x")
    finally:
        os.umask(old)
    assert stat.S_IMODE((tmp_path / "a").stat().st_mode) == 0o640
    assert stat.S_IMODE((tmp_path / "b").stat().st_mode) == 0o750


def test_a_bare_name_is_written_in_the_working_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    atomic_write_text("a.yaml", "x: 1\n")
    assert (tmp_path / "a.yaml").read_bytes() == b"x: 1\n"


def test_directory_replaces_its_own_files_and_keeps_others(tmp_path):
    target = tmp_path / "out"
    (target / "sub").mkdir(parents=True)
    (target / "sub" / "a").write_text("old")
    (target / "notes").write_text("mine")
    with atomic_directory(target) as temporary:
        (temporary / "sub").mkdir()
        (temporary / "sub" / "a").write_text("new")
        (temporary / "b").write_text("new")
    assert (target / "sub" / "a").read_text() == "new"
    assert (target / "b").read_text() == "new"
    assert (target / "notes").read_text() == "mine"
    assert leftovers(tmp_path) == []


def test_directory_exception_leaves_everything_as_it_was(tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "a").write_text("old")
    with pytest.raises(ValueError, match="half"), atomic_directory(target) as temporary:
        (temporary / "a").write_text("new")
        raise ValueError("half way")
    assert (target / "a").read_text() == "old"
    with pytest.raises(ValueError, match="half"), atomic_directory(tmp_path / "fresh") as temporary:
        (temporary / "a").write_text("new")
        raise ValueError("half way")
    assert not (tmp_path / "fresh").exists()
    assert leftovers(tmp_path) == []


def test_directory_that_cannot_take_one_file_takes_none(tmp_path):
    target = tmp_path / "out"
    (target / "b").mkdir(parents=True)
    with pytest.raises(SplitError, match="is a folder"), atomic_directory(target) as temporary:
        (temporary / "a").write_text("new")
        (temporary / "b").write_text("a file where a folder is")
    assert not (target / "a").exists()


def test_directory_with_a_file_where_a_folder_must_go_is_told(tmp_path):
    target = tmp_path / "out"
    target.mkdir()
    (target / "sub").write_text("a file")
    with pytest.raises(SplitError, match="cannot be written"), atomic_directory(target) as temporary:
        (temporary / "sub").mkdir()
        (temporary / "sub" / "a").write_text("new")
    assert (target / "sub").read_text() == "a file"


@settings(max_examples=30, deadline=None)
@given(content=st.binary(max_size=3000))
def test_bytes_and_digest_round_trip(tmp_path_factory, content):
    path = tmp_path_factory.mktemp("digest") / "a"
    atomic_write_bytes(path, content)
    assert path.read_bytes() == content
    assert sha256_of_file(path) == hashlib.sha256(content).hexdigest()


def test_digest_of_a_folder_sees_names_and_content_and_not_the_order_of_creation(tmp_path):
    for folder, order in (("one", "ab"), ("two", "ba")):
        (tmp_path / folder).mkdir()
        for name in order:
            (tmp_path / folder / name).write_text(f"content of {name}")
    assert sha256_of_file(tmp_path / "one") == sha256_of_file(tmp_path / "two")
    (tmp_path / "two" / "a").rename(tmp_path / "two" / "c")
    assert sha256_of_file(tmp_path / "one") != sha256_of_file(tmp_path / "two")


def test_digest_of_a_folder_does_not_confuse_a_file_end_with_the_next_name(tmp_path):
    # "a" holding "xb" and nothing else, against "a" holding "x" and "b" empty: the same bytes when concatenated.
    for folder, content in (("one", {"a": "xb"}), ("two", {"a": "x", "b": ""})):
        (tmp_path / folder).mkdir()
        for name, text in content.items():
            (tmp_path / folder / name).write_text(text)
    assert sha256_of_file(tmp_path / "one") != sha256_of_file(tmp_path / "two")


def test_digest_of_a_missing_file_is_an_error_for_people(tmp_path):
    with pytest.raises(SplitError, match="cannot be read"):
        sha256_of_file(tmp_path / "none")


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_a_claim_waits_for_the_sweep_that_came_first(kind, tmp_path, monkeypatch):
    """Between making and locking, another run may take the new one for a leftover, and be about to remove it."""
    fcntl = pytest.importorskip("fcntl")
    make = "mkstemp" if kind == "file" else "mkdtemp"
    plain, sweeps = getattr(files.tempfile, make), []

    def swept(*how):
        made = plain(*how)
        if not sweeps:
            name = made[1] if kind == "file" else made
            handle = os.open(name, os.O_RDONLY)
            fcntl.flock(handle, fcntl.LOCK_EX)

            def remove():
                (os.unlink if kind == "file" else os.rmdir)(name)
                os.close(handle)

            sweeps.append(threading.Timer(0.2, remove))
            sweeps[0].start()
        return made

    monkeypatch.setattr(files.tempfile, make, swept)
    if kind == "file":
        handle, path = files._claimed_file(tmp_path / "a")
    else:
        path, handle = files._claimed_folder(tmp_path / "a")
    sweeps[0].join()
    os.close(handle)
    assert path.exists() and [path.name] == os.listdir(tmp_path)


def test_values_are_as_json_has_them():
    @dataclass(frozen=True)
    class Row:
        place: Path
        values: np.ndarray

    row = Row(Path("a") / "b", np.array([1.0, np.nan]))
    ready = json_ready({1: row, "kinds": (np.float32(0.5), np.int64(3), np.bool_(True), None, -np.inf)})
    assert ready == {"1": {"place": "a/b", "values": [1.0, None]}, "kinds": [0.5, 3, True, None, None]}
    assert json.loads(json.dumps(ready, allow_nan=False)) == ready
