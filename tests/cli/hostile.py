"""Run the command line where it is used badly, and see that nothing was lost."""

import contextlib
import hashlib
import io
import os
import signal
from pathlib import Path

import pytest

from split_cli.cli.main import main


def tool(*arguments: object) -> tuple[int, str, str]:
    """Run the command line as its entry point does; returns exit code, stdout, stderr."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    out, err = io.StringIO(), io.StringIO()
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err), pytest.raises(SystemExit) as left:
            main([str(argument) for argument in arguments])
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
    return left.value.code, out.getvalue(), err.getvalue()


def refused(*arguments: object, says: tuple[str, ...], output: str | Path | None = None) -> str:
    """Run; demand exit code 1, nothing on stdout, one line with every word of `says`, and the old output whole."""
    before = state(output)
    code, out, err = tool(*arguments)
    lines = err.strip().splitlines()
    assert code == 1, (code, err)
    assert out == ""
    assert len(lines) == 1 and lines[0].startswith("split: "), err
    assert "an error of this program" not in err
    for word in says:
        assert word in lines[0], (word, lines[0])
    assert state(output) == before
    assert not [name for name in os.listdir(".") if name.endswith(".part")]
    return lines[0]


def state(path: str | Path | None) -> dict[str, str] | None:
    """Return the digests of what is at a path; None when nothing is."""
    if path is None or not Path(path).exists():
        return None
    files = sorted(p for p in Path(path).rglob("*") if p.is_file()) if Path(path).is_dir() else [Path(path)]
    return {str(file): hashlib.sha256(file.read_bytes()).hexdigest() for file in files}
