"""Pages of the documentation whose commands are run as printed."""

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from click.testing import CliRunner

from split_cli.cli.main import group

ROOT = Path(__file__).resolve().parents[1]


def page_text(name: str) -> str:
    """Return a page of the documentation."""
    return (ROOT / "docs" / name).read_text(encoding="utf-8")


def follow(page: str, folder: Path, sample_logs: Path) -> list[tuple[str, str]]:
    """Run every command of a page in turn in an empty folder; return each with what it printed.

    A command may end in ``> FILE``; what it would print then goes there, as in a shell. A shell runs what is not ours.
    """
    (folder / "sample_logs").symlink_to(sample_logs)
    said = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for block in re.findall(r"```bash\n(.*?)```", page, flags=re.S):
            for line in block.splitlines():
                name, *arguments = shlex.split(line)
                if name != "split":
                    subprocess.run(line, shell=True, check=True, cwd=folder)
                    continue
                arguments, target = (arguments[:-2], arguments[-1]) if ">" in arguments[-2:-1] else (arguments, None)
                result = CliRunner().invoke(group, arguments)
                if result.exception is not None and not isinstance(result.exception, SystemExit):
                    raise result.exception
                assert result.exit_code == 0, f"{line}\n{result.output}"
                if target:
                    Path(target).write_text(result.stdout, encoding="utf-8")
                said.append((line, result.output))
    return said
