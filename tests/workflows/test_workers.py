"""Worker processes end with their run, however it ends, and leave nothing unfinished."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from split_cli.errors import SplitError
from split_cli.workflows.engine import open_engine
from tests.conftest import ROOT


def _process(item: int) -> int:
    time.sleep(0.5)
    return os.getpid()


def _holds_interrupts_back(item: int) -> bool:
    return signal.SIGINT in signal.pthread_sigmask(signal.SIG_BLOCK, [])


def _end(item: int) -> None:
    os._exit(1)


def _write_for_a_minute(path: Path | None) -> None:
    if path is None:
        return
    try:
        path.write_text("unfinished")
        time.sleep(60.0)
    finally:
        path.unlink(missing_ok=True)


def test_an_interrupt_waits_for_no_worker_and_leaves_no_unfinished_file(tmp_path):
    """The first item is done at once, two are under way, and two more wait beside them: none of them goes on."""
    begun = time.monotonic()
    with pytest.raises(KeyboardInterrupt), open_engine(jobs=2) as engine:
        next(engine.map(_write_for_a_minute, [None, *(tmp_path / str(number) for number in range(5))]))
        while len(list(tmp_path.iterdir())) < 2:
            time.sleep(0.1)
        raise KeyboardInterrupt
    assert time.monotonic() - begun < 50.0 and not list(tmp_path.iterdir())


def _hear_nothing(path: Path) -> None:
    """Stand for a main thread that waits for a lock of a killed sibling: no signal reaches it."""
    signal.signal(signal.SIGTERM, signal.SIG_IGN)
    path.write_text(str(os.getpid()))
    time.sleep(60.0)


def _runs(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc, as Linux has it")
def test_a_worker_that_starts_when_its_run_has_ended_says_nothing(tmp_path):
    """It printed the traceback of its own end, where a run failed while its workers were starting."""
    script = tmp_path / "run.py"
    script.write_text(
        "from concurrent.futures import ProcessPoolExecutor\n"
        "from multiprocessing import get_context\n"
        "from types import SimpleNamespace\n"
        "from split_cli.workflows import engine\n"
        "def start(lifeline):  # its listener acts at once\n"
        "    engine.threading = SimpleNamespace(Thread=lambda target, daemon: SimpleNamespace(start=target))\n"
        "    engine._start_worker(lifeline)\n"
        "if __name__ == '__main__':\n"
        "    context = get_context('spawn')\n"
        "    lifeline, alive = context.Pipe(duplex=False)\n"
        "    alive.close()\n"
        "    with ProcessPoolExecutor(1, context, start, (lifeline,)) as pool:\n"
        "        print(type(pool.submit(abs, 1).exception()).__name__)\n"
    )
    ran = subprocess.run([sys.executable, script], capture_output=True, text=True)
    assert (ran.stdout, ran.stderr) == ("BrokenProcessPool\n", "")


def test_no_worker_outlives_a_killed_parent(tmp_path):
    program = (
        "import sys, pathlib\nfrom split_cli.workflows.engine import open_engine\n"
        "from tests.workflows.test_workers import _hear_nothing\n"
        "with open_engine(jobs=2) as engine:\n"
        "    list(engine.map(_hear_nothing, map(pathlib.Path, sys.argv[1:])))\n"
    )
    files = [tmp_path / "first", tmp_path / "second"]
    parent = subprocess.Popen([sys.executable, "-c", program, *map(str, files)], cwd=ROOT)
    until = time.monotonic() + 60.0
    while not all(file.exists() and file.read_text() for file in files) and time.monotonic() < until:
        time.sleep(0.1)
    parent.kill()
    parent.wait()
    workers = [int(file.read_text()) for file in files]
    until = time.monotonic() + 30.0
    while any(map(_runs, workers)) and time.monotonic() < until:
        time.sleep(0.1)
    assert not any(map(_runs, workers))


def test_unasked_a_folder_uses_every_core_up_to_four_and_a_killed_process_is_told(monkeypatch):
    monkeypatch.setattr("split_cli.workflows.engine.cores", lambda: 2)
    with open_engine(jobs=None) as engine:
        assert list(engine.map(_process, [1])) == [os.getpid()]  # no process for a single log
        assert len({*engine.map(_process, range(6))} - {os.getpid()}) == 2
        # From their start: a worker that still loads would print a traceback.
        assert all(engine.map(_holds_interrupts_back, range(4))) and not _holds_interrupts_back(0)
        with pytest.raises(SplitError, match="a worker process was ended from outside"):
            list(engine.map(_end, range(2)))
    monkeypatch.setattr("split_cli.workflows.engine.cores", lambda: 64)
    with open_engine(jobs=None) as engine:
        assert engine.workers == 4
