"""What a project owes those who install it: metadata, dependencies it uses, a package and a site that build."""

import ast
import re
import subprocess
import sys
import tomllib
import zipfile
from functools import cache
from pathlib import Path

import pytest

from split_cli.workflows.demo import INSTALLED, demo_steps
from tests.studies.versions import constraints

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
# Names of packages whose module is called otherwise.
MODULES = {
    "pyyaml": "yaml",
    "mcap-ros2-support": "mcap_ros2",
    "mcap-protobuf-support": "mcap_protobuf",
    "commonroad-vehicle-models": "vehiclemodels",
}


@cache
def imported() -> set[str]:
    """Return the top-level names that the package imports, inside functions too."""
    names = set()
    for path in (ROOT / "split_cli").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text("utf-8"))):
            names |= {one.name for one in node.names} if isinstance(node, ast.Import) else set()
            names |= {node.module or ""} if isinstance(node, ast.ImportFrom) else set()
    return {name.split(".")[0] for name in names}


@pytest.mark.parametrize("arguments", [("check",), ("format", "--check")])
def test_the_code_is_linted_and_laid_out(arguments):
    command = [sys.executable, "-m", "ruff", *arguments, "."]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.parametrize("requirement", PROJECT["dependencies"])
def test_what_is_installed_is_used(requirement):
    name = re.split(r"[<>=\[ ]", requirement)[0].lower()
    assert MODULES.get(name, name.replace("-", "_")) in imported()


def test_metadata_is_what_an_index_shows():
    assert PROJECT["license"] == "MIT" and (ROOT / PROJECT["license-files"][0]).is_file()
    assert PROJECT["keywords"] and "Programming Language :: Python :: 3.11" in PROJECT["classifiers"]


def run(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]


def test_the_package_builds_and_is_clean(tmp_path):
    run("build", "--no-isolation", "--outdir", str(tmp_path), str(ROOT))
    built = sorted(tmp_path.iterdir())
    assert [path.suffix for path in built] == [".whl", ".gz"]
    run("twine", "check", "--strict", *map(str, built))
    assert_the_demo_is_in(built[0], tmp_path)


def assert_the_demo_is_in(wheel: Path, folder: Path) -> None:
    """Assert that every sample the demo reads is installed where it is looked for."""
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
    read = {Path(a).name for step in demo_steps(folder, Path("output")) for a in step.arguments if str(folder) in a}
    data = f"{wheel.name.rsplit('-', 3)[0]}.data/data/{INSTALLED}"
    assert read and {f"{data}/{name}" for name in read} <= set(names)


def test_the_site_builds_without_a_warning(tmp_path):
    run("mkdocs", "build", "--strict", "--quiet", "-f", ".mkdocs.yml", "-d", str(tmp_path / "site"))
    assert "Policy" in (tmp_path / "site" / "api" / "index.html").read_text(encoding="utf-8")


def test_the_oldest_dependencies_are_those_that_were_tried():
    """A bound of `pyproject.toml` that changes asks for `python -m tests.studies.versions oldest` again."""
    page = (ROOT / "docs" / "trust.md").read_text()
    tried = page.split("<!-- oldest versions that were tried -->\n```text\n")[1].split("```")[0].split()
    assert tried == constraints("oldest")
