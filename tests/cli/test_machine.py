"""A full disk, a closed stdout and a stop at any moment leave the old file, or none, or the new one."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from split_cli.learning.training_set import read_set
from split_cli.logs.drive import read_drive, write_drive
from tests.cli.hostile import state, tool


def spawn(*arguments: object, **options) -> subprocess.Popen:
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **options}
    return subprocess.Popen([sys.executable, "-m", "split_cli", *map(str, arguments)], text=True, **pipes)


def no_room() -> None:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))


def test_a_full_disk_leaves_the_old_output(here):
    for output, command in (
        ("d0.parquet", ("ingest", "lap.csv", "-o", "d0.parquet")),
        ("l.parquet", ("label", "d0.parquet", "--vehicle", "car.yaml", "-o", "l.parquet")),
        ("z.mcap", ("simulate", "--track", "small", "--duration", 3, "-o", "z.mcap")),
        ("out", ("export", "a.split", "--target", "npz", "--queries", 200, "-o", "out")),
    ):
        before, beside = state(output), sorted(os.listdir("."))
        run = spawn(*command, preexec_fn=no_room)
        err = run.communicate(timeout=120)[1].splitlines()
        assert run.returncode == 1
        assert "cannot be written" in err[-1] and "Traceback" not in "".join(err)
        assert state(output) == before and sorted(os.listdir(".")) == beside


def test_a_stdout_that_is_full_or_closed_is_no_error_of_this_program(here):
    with open("/dev/full", "w") as full:
        run = spawn("info", "a.split", stdout=full)
    assert run.communicate(timeout=60)[1] == "split: reading or writing: No space left on device\n"
    assert run.returncode == 1
    run = spawn("info", "a.split", stdout=None, preexec_fn=lambda: os.close(1))
    assert run.communicate(timeout=60)[1] == ""
    assert run.returncode == 0


COMPILED = """
import math, numba, numpy, threading
@numba.njit("Tuple((f8[:], i8))(i8)")
def work(steps):
    found = numpy.zeros(2)
    for k in range(steps):
        found[0] = math.sin(found[0] + k)
    return found, steps
threading.Timer(0.05, end).start()
try:
 work(30_000_000)
"""


@pytest.mark.parametrize(
    "swallow",
    [
        "class Held:\n def __del__(self): end()\nheld = Held()\ntry:\n del held",
        "try:\n try: end()\n except: pass",
        COMPILED,
    ],
    ids=["as an object is taken down", "by a library that catches everything", "in compiled code"],
)
def test_a_stop_that_is_swallowed_comes_once_more(swallow):
    """Python swallows what is raised in a destructor, and prints it; the run would go on.

    Compiled code that returns several arrays makes a segmentation fault of it.
    """
    program = f"""
import os, signal, time
from split_cli.cli.main import _stop_cleanly
came = _stop_cleanly()
def end():
    os.kill(os.getpid(), signal.SIGTERM)
    time.sleep(0.05)
{swallow}
 time.sleep(5.0)
 print("went on")
except KeyboardInterrupt as interrupt:
    time.sleep(0.1)  # whoever holds it is not interrupted again
    print("stopped", came == [signal.SIGTERM] * 2, flush=True)
    os._exit(0)
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert (run.stdout, run.stderr) == ("stopped True\n", "")


def test_a_stop_inside_the_exec_of_a_library_leaves_with_130(here):
    """Python notes an interrupt of an `exec`, and would end by SIGINT later; halfway loaded modules make noise."""
    Path("sitecustomize.py").write_text("""
import os, signal, sys
class Late:
    def find_spec(self, name, path=None, target=None):
        if name == "split_cli.workflows.info":
            sys.meta_path.remove(self)
            exec("os.kill(os.getpid(), signal.SIGTERM)")
sys.meta_path.insert(0, Late())
""")
    run = spawn("info", "a.split", env={**os.environ, "PYTHONPATH": os.pathsep.join([".", *sys.path])})
    out, err = run.communicate(timeout=60)
    assert (run.returncode, out) == (130, "")
    assert err.strip() == "split: stopped; what was being written is left as it was before"


def test_a_stop_with_a_lock_of_workers_in_hand_says_one_line():
    """Python's tracker of such locks told of each that was left when the process ended."""
    program = """
import importlib, multiprocessing, os, signal, click
signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background job begins without one
lock = multiprocessing.get_context("spawn").Lock()
main = importlib.import_module("split_cli.cli.main")
def stop(**_):
    try:
        os.kill(os.getpid(), signal.SIGINT)
    except KeyboardInterrupt:
        raise click.exceptions.Abort from None
main.group.main = stop
main.main([])
"""
    run = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert run.returncode == 130 and run.stderr.count("\n") == 1


def test_two_drives_that_are_appended_at_once_are_both_learned(here):
    """Each read the set and wrote its own: one drive was lost, four times of four."""
    drive = read_drive("d1.parquet")
    half = len(drive) // 2
    write_drive(replace(drive.stretch(0, half), name="e1.parquet"), "e1.parquet")
    write_drive(replace(drive.stretch(half, len(drive)), name="e2.parquet"), "e2.parquet")
    runs = [
        spawn("train", name, "--vehicle", "car.yaml", "-o", "a.split", "--append")
        for name in ("e1.parquet", "e2.parquet")
    ]
    assert [run.communicate(timeout=120)[1] for run in runs] and [run.returncode for run in runs] == [0, 0]
    assert {source.name for source in read_set("a.split").sources} == {"d0.parquet", "e1.parquet", "e2.parquet"}


def handles(process: int, number: int) -> bool:
    """Tell whether a process has a handler of its own for a signal."""
    status = Path(f"/proc/{process}/status").read_text()
    caught = int(status.split("SigCgt:")[1].split()[0], 16)
    return bool(caught >> (number - 1) & 1)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_run_that_is_stopped_leaves_the_old_set_or_the_new_one(here, number):
    old = state("a.split")
    shutil.copy("a.split", "whole.split")
    assert tool("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "whole.split", "--append")[0] == 0
    new = list(state("whole.split").values())
    for wait in (0.05, 0.3, 0.6):
        shutil.copy("whole.split", "scratch.split")
        shutil.copy("a.split", "b.split")
        run = spawn("train", "d1.parquet", "--vehicle", "car.yaml", "-o", "b.split", "--append")
        while not handles(run.pid, signal.SIGTERM):
            time.sleep(0.01)  # Python itself is starting, which on a crowded machine takes a while
        time.sleep(wait)
        run.send_signal(number)
        err = run.communicate(timeout=60)[1]
        assert list(state("b.split").values()) in (list(old.values()), new)
        if number != signal.SIGKILL:
            assert "Traceback" not in err and "an error of this program" not in err
            assert run.returncode in (0, 130, -number)
            assert not [name for name in os.listdir(".") if name.endswith(".part")]


@pytest.mark.parametrize("threads", ["4,2", "many"])
def test_a_list_of_threads_for_nested_loops_is_no_number_for_a_library(here, threads):
    """numexpr, which pyarrow loads with pandas, ended with an error of its own; the drive was blamed for it."""
    run = spawn("info", "d0.parquet", env={**os.environ, "OMP_NUM_THREADS": threads})
    assert run.communicate(timeout=120)[1] == "" and run.returncode == 0
