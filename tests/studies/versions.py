"""Install the project with its oldest or newest dependencies into an environment of its own, and run tests there.

Example: ``python -m tests.studies.versions oldest``. The oldest are the lower bounds in ``pyproject.toml``.
Prints the versions that were installed and the last line of the tests; exits with the tests' code.
"""

import argparse
import os
import re
import subprocess
import sys
import tempfile
import tomllib
import venv
from pathlib import Path

ROOT = Path(__file__).parents[2]
TESTS = (
    "tests/test_signals.py",
    "tests/logs/test_readers_tables.py",
    "tests/logs/test_readers_mcap.py",
    "tests/learning/test_training_set.py",
    "tests/learning/test_labels.py",
    "tests/prediction/test_predictors.py",
    "tests/export/test_export_c99.py",
    "tests/control/test_qp.py",
)
"""Of every layer that a dependency carries: tables, messages, compiled learning and prediction, export, solver."""
NEEDED = ("pytest>=8", "pytest-xdist>=3.5", "hypothesis>=6.90", "pandas>=2.1")


def constraints(which: str) -> list[str]:
    """Return requirements that pin each dependency of the project at its lower bound, none for the newest."""
    if which == "newest":
        return []
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    bounds = [re.match(r"([A-Za-z0-9_-]+)>=([\d.]+)", text) for text in project["dependencies"]]
    return [f"{bound[1]}=={bound[2]}" for bound in bounds if bound]


def main() -> int:
    """Run from the command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("which", choices=["oldest", "newest"])
    parser.add_argument("tests", nargs="*", default=TESTS)
    given = parser.parse_args()
    pinned = constraints(given.which)
    with tempfile.TemporaryDirectory() as name:
        venv.create(name, with_pip=True)
        python = Path(name) / "bin" / "python"
        (Path(name) / "pinned.txt").write_text("\n".join(pinned) + "\n")
        install = [python, "-m", "pip", "install", "-q", "-c", Path(name) / "pinned.txt", ROOT, *NEEDED]
        if subprocess.run(install, check=False).returncode:
            print("the dependencies cannot be installed together", file=sys.stderr)
            return 1
        subprocess.run([python, "-m", "pip", "uninstall", "-q", "-y", "split-cli"], check=True)
        listed = subprocess.run([python, "-m", "pip", "list", "--format=freeze"], capture_output=True, text=True)
        names = {text.split(">=")[0].lower() for text in _dependencies()}
        print(" ".join(line for line in listed.stdout.split() if line.split("==")[0].lower() in names))
        done = subprocess.run(
            [python, "-m", "pytest", "-n", "2", "-p", "no:cacheprovider", *given.tests],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=False,
            # Code that another version of numba compiled lies beside the source.
            env={**os.environ, "NUMBA_CACHE_DIR": f"{name}/numba"},
        )
        lines = (done.stdout.strip() or done.stderr.strip()).splitlines()
        counts = [line for line in lines if " passed" in line]
        print("\n".join(counts[-1:] if done.returncode == 0 else lines[-40:]))
        return done.returncode


def _dependencies() -> list[str]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]


if __name__ == "__main__":
    sys.exit(main())
