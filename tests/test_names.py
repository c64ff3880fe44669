"""Names: one name, one meaning."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent / "split_cli"


@pytest.fixture(scope="module")
def nodes() -> list[tuple[Path, ast.AST]]:
    """Every node of the code of every module."""
    trees = {path: ast.parse(path.read_text(encoding="utf-8")) for path in sorted(ROOT.rglob("*.py"))}
    return [(path.relative_to(ROOT), node) for path, tree in trees.items() for node in ast.walk(tree)]


def test_no_two_classes_share_a_name(nodes):
    """One name, one meaning: a reader who meets a class knows which one it is, in tests and studies, too."""
    where: dict[str, list[str]] = {}
    tests = [(path, ast.parse(path.read_text(encoding="utf-8"))) for path in (ROOT.parent / "tests").rglob("*.py")]
    for path, node in [*nodes, *((path, node) for path, tree in tests for node in ast.walk(tree))]:
        if isinstance(node, ast.ClassDef):
            where.setdefault(node.name, []).append(str(path))
    assert {name: places for name, places in where.items() if len(places) > 1} == {}


#: Functions of one name that mean the same: what a notebook calls and what does it, a compiled loop and its caller,
#: numbers in a sentence and on a page. `cli` is left out, whose functions are called as the commands are.
SAME_MEANING = {"advance", "diagnose", "evaluate", "number", "percent"}


def test_no_two_functions_that_others_import_share_a_name(nodes):
    """A function without an underscore serves other modules, where its name alone has to say what it does."""
    where: dict[str, set[str]] = {}
    for path, node in nodes:
        for one in node.body if isinstance(node, ast.Module) and path.parts[0] != "cli" else ():
            if isinstance(one, ast.FunctionDef) and not one.name.startswith("_"):
                where.setdefault(one.name, set()).add(str(path))
    assert {name: places for name, places in where.items() if len(places) > 1 and name not in SAME_MEANING} == {}


def test_the_map_of_the_data_names_what_there_is():
    """CONTRIBUTING leads a newcomer by files and functions: each is where it says."""
    page = (
        (ROOT.parent / "CONTRIBUTING.md").read_text(encoding="utf-8").split("## Where data goes")[1].split("\n## ")[0]
    )
    named = re.findall(r"`([\w/]+\.py)(?:: (\w+))?`", page)
    assert len(named) > 8
    for file, function in named:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert not function or function in {getattr(node, "name", "") for node in tree.body}, f"{file}: {function}"


def test_no_test_patches_a_private_name():
    """What a test sets is part of what a module offers: give it a name without an underscore, or a parameter."""
    patched = []
    for path in sorted((ROOT.parent / "tests").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call) and getattr(node.func, "attr", "") in ("setattr", "setitem", "patch"):
                names = [one.value for one in node.args[:2] if isinstance(one, ast.Constant)]
                patched += [f"{path.name}: {one}" for one in names if "._" in f".{one}" and "__" not in str(one)]
            for one in getattr(node, "targets", ()) if isinstance(node, ast.Assign) else ():
                if isinstance(one, ast.Attribute) and one.attr.startswith("_") and ast.unparse(one.value) != "self":
                    patched.append(f"{path.name}: {ast.unparse(one)}")
    assert not patched


def test_words_that_mean_nothing_are_no_names(nodes):
    """What is "told" is a finding, a note, a remark, a document or what labels taught: a name says which."""
    named = []
    for path, node in nodes:
        names = [getattr(node, word, None) for word in ("id", "arg", "attr", "name")]
        named += [
            f"{path.name}: {one}"
            for one in names
            if isinstance(one, str) and {"told", "stranger", "strangers"} & set(one.lower().split("_"))
        ]
    assert not named


def test_plain_is_a_kind_of_label(nodes):
    """As a parameter, an attribute or a field the word means the paper's plain difference, and nothing else."""
    others = []
    for path, node in nodes:
        named = getattr(node, "arg", None) or getattr(node, "attr", None)
        if isinstance(node, ast.AnnAssign) and isinstance(node.value, ast.Call):
            named = getattr(node.target, "id", None)
        if named == "plain" and path.parts[0] not in ("learning", "scoring", "export", "workflows", "cli"):
            others.append(f"{path}:{node.lineno}")
    assert not others
