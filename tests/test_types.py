"""Types: mypy, with the settings of pyproject.toml, finds nothing in the packages that others build on."""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent


def test_there_is_no_type_error():
    done = subprocess.run([sys.executable, "-m", "mypy"], cwd=ROOT, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr


def test_nothing_is_waved_through():
    """What mypy is told to pass over it cannot find: a line may do so with its reason beside it, and few do."""
    checked = [ROOT / "split_cli" / name for name in ("vehicle", "learning", "prediction", "scoring", "export")]
    lines = [line for folder in checked for path in folder.rglob("*.py") for line in path.read_text().splitlines()]
    assert not [line for line in lines if "type: ignore" in line]
