"""Folders are exchanged whole, leftovers of killed runs go, and two runs do not lose each other's work."""

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from split_cli.cli.main import group as main_group
from split_cli.cli.options import OutputPath
from split_cli.errors import LogError, SplitError, VehicleError
from split_cli.files import ScratchFolder, atomic_directory, atomic_path, exclusive_access
from split_cli.logs.readers import open_recording
from split_cli.vehicle.parameters import read_vehicle


def written(folder: Path, generation: int, names: int = 8) -> None:
    with atomic_directory(folder) as temporary:
        for name in range(names):
            (temporary / f"f{name}").write_text(str(generation))
        (temporary / "sub").mkdir()
        (temporary / "sub" / "deep").write_text(str(generation))


def test_a_folder_is_exchanged_in_one_step(tmp_path):
    # A reader that lists the folder through one handle sees one generation, whatever is written meanwhile.
    target = tmp_path / "out"
    written(target, 0)
    stop, mixed = threading.Event(), []

    def read() -> None:
        while not stop.is_set():
            handle = os.open(target, os.O_RDONLY)
            try:
                found = set()
                for name in [f"f{n}" for n in range(8)] + ["sub/deep"]:
                    opened = os.open(name, os.O_RDONLY, dir_fd=handle)
                    found.add(os.read(opened, 20))
                    os.close(opened)
                if len(found) != 1:
                    mixed.append(found)
            except FileNotFoundError:
                pass  # the old folder, while it is taken away
            finally:
                os.close(handle)

    reader = threading.Thread(target=read)
    reader.start()
    for generation in range(1, 30):
        written(target, generation)
    stop.set()
    reader.join()
    assert not mixed
    assert (target / "sub" / "deep").read_text() == "29"


def test_files_of_other_names_stay(tmp_path):
    target = tmp_path / "out"
    (target / "own" / "deeper").mkdir(parents=True)
    (target / "own" / "deeper" / "notes.txt").write_text("mine")
    (target / "link").symlink_to("own")
    (target / "f0").write_text("old")
    written(target, 7)
    assert (target / "own" / "deeper" / "notes.txt").read_text() == "mine"
    assert os.readlink(target / "link") == "own"
    assert (target / "f0").read_text() == "7"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out"]


def test_the_folder_one_stands_in_is_written_too(tmp_path, monkeypatch):
    target = tmp_path / "out"
    target.mkdir()
    monkeypatch.chdir(target)
    written(Path("."), 3)
    assert Path("f0").read_text() == "3"


KILLED = """
import os, sys, time
from split_cli.files import atomic_directory, atomic_path
with (atomic_path if sys.argv[2] == "file" else atomic_directory)(sys.argv[1]) as temporary:
    print("ready", flush=True)
    time.sleep(60)
"""


@pytest.mark.parametrize("kind", ["file", "folder"])
def test_leftovers_of_a_killed_run_are_swept_and_those_of_a_living_one_are_not(tmp_path, kind):
    target = tmp_path / "out"

    def start() -> subprocess.Popen:
        run = subprocess.Popen([sys.executable, "-c", KILLED, str(target), kind], stdout=subprocess.PIPE)
        assert run.stdout is not None and run.stdout.readline() == b"ready\n"
        return run

    killed, living = start(), start()
    os.kill(killed.pid, signal.SIGKILL)
    killed.wait()
    assert len(list(tmp_path.glob(".out.*.part"))) == 2
    with (atomic_path if kind == "file" else atomic_directory)(target) as temporary:
        (temporary if kind == "file" else temporary / "f").write_text("new")
    assert len(list(tmp_path.glob(".out.*.part"))) == 1
    living.kill()
    living.wait()


def test_two_runs_take_turns_at_one_file(tmp_path):
    target = tmp_path / "count"
    target.write_text("0")

    def add() -> None:
        for _ in range(20):
            with exclusive_access(target):
                value = int(target.read_text())
                time.sleep(0.0005)
                with atomic_path(target) as temporary:
                    temporary.write_text(str(value + 1))

    threads = [threading.Thread(target=add) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert target.read_text() == "80"


def test_a_name_as_long_as_the_file_system_allows_is_written_and_a_longer_one_is_an_error(tmp_path):
    longest = tmp_path / ("é" * 127 + "x")
    for _ in range(2):
        with atomic_path(longest) as temporary:
            temporary.write_text("whole")
    with atomic_directory(tmp_path / ("x" * 255)) as temporary:
        (temporary / "f").write_text("whole")
    for write in (atomic_path, atomic_directory):
        with pytest.raises(SplitError, match="File name too long"), write(tmp_path / ("x" * 256)):
            pass
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted([longest.name, "x" * 255])
    assert longest.read_text() == "whole"


@pytest.mark.parametrize(("read", "kind"), [(open_recording, LogError), (read_vehicle, VehicleError)])
def test_a_pipe_is_refused_and_not_waited_for(tmp_path, read, kind):
    os.mkfifo(tmp_path / "pipe.yaml")
    with pytest.raises(kind, match="is a pipe"):
        read(tmp_path / "pipe.yaml")


def test_an_error_does_nothing_to_a_terminal():
    assert str(SplitError("bad\x1b[31m \u202e name", where="a\rb\x9b")) == r"a\x0db\x9b: bad\x1b[31m \u202e name"


def every_command(group: click.Group) -> Iterator[click.Command]:
    context = click.Context(group)
    for name in group.list_commands(context):
        command = group.get_command(context, name)
        if isinstance(command, click.Group):
            yield from every_command(command)
        else:
            yield command


def test_a_place_that_cannot_be_written_is_said_before_any_work(tmp_path, monkeypatch):
    """Of every command that has an output; the user that runs the tests may be allowed everything."""
    monkeypatch.setattr(os, "access", lambda path, mode: not str(path).startswith(str(tmp_path)))
    refused = []
    for command in every_command(main_group):
        for option in command.params:
            if isinstance(option.type, OutputPath):
                done = CliRunner().invoke(command, [option.opts[0], str(tmp_path / "out")])
                assert isinstance(done.exception, SplitError), (command.name, done.output)
                assert "no permission" in str(done.exception) and "Nothing was computed" in str(done.exception)
                refused.append(command.name)
                if option.type.kind == "file":
                    done = CliRunner().invoke(command, [option.opts[0], str(tmp_path)])
                    assert "is a folder, a file was to be written" in str(done.exception), command.name
    assert {"race", "simulate", "maneuver"} <= {name for name in refused if refused.count(name) > 1}
    assert {"ingest", "train", "diagnose", "race", "simulate", "evaluate", "export"} <= set(refused)


def test_files_that_a_run_does_not_write_again_go_in_the_same_step(tmp_path):
    target = tmp_path / "out"
    written(target, 1)
    (target / "notes.txt").write_text("mine")
    with atomic_directory(target, without=["f0", "f1", "sub/deep", "never"]) as temporary:
        (temporary / "f1").write_text("new")
    assert sorted(p.name for p in target.iterdir()) == ["f1", *(f"f{n}" for n in range(2, 8)), "notes.txt", "sub"]
    assert (target / "f1").read_text() == "new"
    assert not list((target / "sub").iterdir())


def test_scratch_of_a_killed_run_goes_with_the_next_run(tmp_path):
    code = f"import os, split_cli.files as f; s = f.ScratchFolder({str(tmp_path)!r}); os.kill(os.getpid(), 9)"
    subprocess.run([sys.executable, "-c", code], check=False)
    (left,) = tmp_path.iterdir()
    kept = ScratchFolder(tmp_path)
    assert not left.exists() and kept.path.is_dir()
    with ScratchFolder(tmp_path) as folder:
        (folder / "large").write_text("1")
        assert kept.path.is_dir()  # of a living run
    assert not folder.exists()
    del kept
    assert not list(tmp_path.iterdir())
