"""Imports run one way, read from the syntax tree; and each heavy library stays in its place."""

import ast
import subprocess
import sys
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent / "split_cli"

# A layer may import itself and everything of a smaller number. logs stands above vehicle; plant beside vehicle.
LAYERS = {
    "errors": 0,
    "compiled_code": 0,
    "files": 1,
    "signals": 1,
    "yaml_file": 1.5,
    "vehicle": 2,
    "plant": 2,
    "logs": 3,
    "learning": 4,
    "prediction": 5,
    "scoring": 6,
    "diagnosis": 7,
    "control": 8,
    "export": 7,
    "proof": 7,
    "plots": 8,
    "workflows": 9,
    "api": 10,
    "cli": 10,
}
# The rooms of the diagnosis, from the ground up: `engine.py` on top, `policy.py` and `parallel.py` below all.
ROOMS = ("statement", "recording", "baseline", "innovations", "remainder", "search", "verdict", "engine")
# The rooms of other layers, from the ground up; files beside them are the ground, which imports no room.
ROOMS_OF = {
    "logs": ("readers", "checking", "assembling", "drafting"),
    "workflows": ("ingesting", "training", "verifying", "proving", "racing"),
}
# diagnosis may see neither the plant that makes test recordings nor the proof that conceals them (one number, so
# neither may import the other), and the plant nothing but the ground.
PLANT_MAY_IMPORT = {"plant", "signals", "files", "yaml_file", "errors"}
MAY_IMPORT_PLANT = {"plant", "workflows", "proof"}

HOMES = {
    "click": ("cli",),
    "matplotlib": ("plots",),
    "mcap": ("logs",),
    "mcap_ros1": ("logs",),
    "mcap_ros2": ("logs",),
    "mcap_protobuf": ("logs",),
    "rosbags": ("logs",),
    "h5py": ("logs",),
    "openpyxl": ("logs",),
    "asammdf": ("logs",),
    "casadi": ("export", "control"),
}
# The plant writes logs that the readers have never seen; its one writer of MCAP is the named exception.
HOME_EXCEPTIONS = {("plant/recording.py", "mcap"), ("plant/recording.py", "mcap_ros2")}
HEAVY = (
    "numpy",
    "pandas",
    "scipy",
    "numba",
    "casadi",
    "matplotlib",
    "pyarrow",
    "mcap",
    "rosbags",
    "h5py",
    "openpyxl",
    "asammdf",
)


@dataclass(frozen=True)
class Import:
    """One import of a module: where, what, and whether it runs when the importing module is imported."""

    file: str
    line: int
    module: str
    level: int
    at_import_time: bool

    @property
    def place(self) -> str:
        return f"split_cli/{self.file}:{self.line}"


def imports_of(source: str, file: str) -> list[Import]:
    found = []

    def visit(node: ast.AST, at_import_time: bool) -> None:
        for child in ast.iter_child_nodes(node):
            inside = at_import_time and not isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda)
            if isinstance(child, ast.Import):
                found.extend(Import(file, child.lineno, a.name, 0, at_import_time) for a in child.names)
            elif isinstance(child, ast.ImportFrom):
                module = child.module or ""
                # `from split_cli import plots` names a layer in its list, not in its module.
                names = [f"{module}.{a.name}" for a in child.names] if module == "split_cli" else [module]
                found.extend(Import(file, child.lineno, n, child.level, at_import_time) for n in names)
            elif isinstance(child, ast.Call) and _is_dynamic_import(child):
                argument = child.args[0] if child.args else None
                if isinstance(argument, ast.Constant):
                    found.append(Import(file, child.lineno, str(argument.value), 0, at_import_time))
            visit(child, inside)

    visit(ast.parse(source), True)
    return found


def _is_dynamic_import(call: ast.Call) -> bool:
    name = call.func.attr if isinstance(call.func, ast.Attribute) else getattr(call.func, "id", "")
    return name in ("import_module", "__import__")


def layer_of(file: str) -> str:
    return file.split("/")[0].removesuffix(".py")


SOURCES = {path.relative_to(ROOT).as_posix(): path.read_text(encoding="utf-8") for path in ROOT.rglob("*.py")}


@cache
def every_import() -> list[Import]:
    """Return all imports of the package; found when a test asks, since every worker collects this file."""
    return [found for file, source in SOURCES.items() for found in imports_of(source, file)]


def upward(found: Import) -> bool:
    """Tell whether an import of one of our modules points up, or crosses to where it may not."""
    parts = found.module.split(".")
    here = layer_of(found.file)
    if parts[0] != "split_cli" or len(parts) < 2 or here not in LAYERS or parts[1] not in LAYERS:
        return False
    there = parts[1]
    if here == there:
        return False
    if here == "plant":
        return there not in PLANT_MAY_IMPORT
    if there == "plant":
        return here not in MAY_IMPORT_PLANT
    return LAYERS[there] >= LAYERS[here]


def test_every_top_level_name_has_a_layer():
    unknown = {layer_of(file) for file in SOURCES} - set(LAYERS) - {"__init__", "__main__"}
    assert not unknown, f"give {sorted(unknown)} a layer in tests/test_imports.py"


def test_no_import_points_upward():
    wrong = [f"{found.place} imports {found.module}" for found in every_import() if upward(found)]
    assert not wrong, "\n".join(wrong)


def upward_between_rooms(found: Import) -> bool:
    """Tell whether an import inside a layer with rooms points to a higher room than its own."""
    here, there = found.file.split("/"), found.module.split(".")
    rooms = ROOMS_OF.get(here[0], ())
    if there[:2] != ["split_cli", here[0]] or len(there) < 3 or there[2] not in rooms:
        return False
    return here[1] not in rooms or rooms.index(there[2]) > rooms.index(here[1])


def test_rooms_of_every_layer_import_one_way():
    wrong = [f"{found.place} imports {found.module}" for found in every_import() if upward_between_rooms(found)]
    assert not wrong, "\n".join(wrong)


def upward_in_diagnosis(found: Import) -> bool:
    """Tell whether an import inside the diagnosis points to its own or a higher room from a lower one."""
    here, there = found.file.split("/"), found.module.split(".")
    if here[0] != "diagnosis" or there[:2] != ["split_cli", "diagnosis"] or len(there) < 3:
        return False
    room = here[1].removesuffix(".py")
    if there[2] not in ROOMS:
        return False  # the ground
    return room not in ROOMS or ROOMS.index(there[2]) > ROOMS.index(room)


def test_rooms_of_the_diagnosis_import_one_way():
    rooms = {file.split("/")[1] for file in SOURCES if file.startswith("diagnosis/") and file.count("/") == 2}
    assert rooms <= set(ROOMS) and len(rooms) <= 7
    wrong = [f"{found.place} imports {found.module}" for found in every_import() if upward_in_diagnosis(found)]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "room",
    [f"diagnosis/{one}" for one in ROOMS[:-1]] + [f"{a}/{one}" for a, rooms in ROOMS_OF.items() for one in rooms],
)
def test_a_room_says_in_two_lines_what_lives_there(room):
    text = ast.get_docstring(ast.parse(SOURCES[f"{room}/__init__.py"]))
    first, blank, second = text.split("\n")
    assert first.endswith(".") and not blank and second.startswith("May import: ")


def test_no_relative_imports():
    wrong = [found.place for found in every_import() if found.level]
    assert not wrong, "\n".join(wrong)


def test_no_cycle_is_hidden_behind_type_checking():
    wrong = [file for file, source in SOURCES.items() if "TYPE_CHECKING" in source]
    assert not wrong, "\n".join(wrong)


def test_each_library_stays_in_its_home():
    wrong = []
    for found in every_import():
        library = found.module.split(".")[0]
        home = HOMES.get(library)
        if home and layer_of(found.file) not in home and (found.file, library) not in HOME_EXCEPTIONS:
            wrong.append(f"{found.place} imports {library}, which belongs in {' or '.join(home)}")
    assert not wrong, "\n".join(wrong)


def test_no_pickle():
    pickling = ("pickle", "joblib", "dill", "shelve")
    wrong = [found.place for found in every_import() if found.module.split(".")[0] in pickling]
    assert not wrong, "\n".join(wrong)


def test_the_command_line_imports_nothing_heavy_before_a_command_runs():
    wrong = [
        f"{found.place} imports {found.module}"
        for found in every_import()
        if layer_of(found.file) in ("cli", "__init__", "__main__")
        and found.at_import_time
        and (found.module.split(".")[0] in HEAVY or found.module.startswith("split_cli.workflows"))
    ]
    assert not wrong, "\n".join(wrong)


def test_importing_a_command_loads_no_heavy_library():
    """What the tree cannot see: a light module that imports a heavy one; the first that does is named."""
    files = sorted(f for f in SOURCES if f.startswith("cli/"))
    modules = ["split_cli." + f.removesuffix(".py").replace("/", ".").removesuffix(".__init__") for f in files]
    heavy = ("pandas", "scipy.optimize", "numba", "casadi", "matplotlib", "pyarrow", "rosbags", "h5py")
    code = (
        "import importlib, sys\n"
        f"for name in {modules!r}:\n"
        "    importlib.import_module(name)\n"
        f"    [print(name, 'loads', m) for m in {heavy!r} if m in sys.modules]\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert len(modules) > 20 and done.stdout == ""


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("vehicle/tire.py", "from split_cli.logs.drive import Drive", True),
        ("vehicle/tire.py", "def f():\n    import split_cli.learning.kernel", True),
        ("vehicle/tire.py", "from split_cli import plots", True),
        ("vehicle/tire.py", "from split_cli.vehicle.operations import NUMPY", False),
        ("plant/car.py", "from split_cli.vehicle.tire import MagicFormula", True),
        ("diagnosis/gap.py", "from split_cli.plant.car import Car", True),
        ("diagnosis/gap.py", "from split_cli.proof.world import World", True),
        ("proof/world.py", "import split_cli.diagnosis.innovations.judge", True),
        ("proof/world.py", "from split_cli.plant.car import Car", False),
        ("export/c99.py", "from split_cli.plots.base import figure", True),
        ("export/c99.py", "import importlib\nimportlib.import_module('split_cli.cli.main')", True),
        ("scoring/metrics.py", "from split_cli.prediction.full import Full", False),
        ("workflows/simulate.py", "from split_cli.plant.car import Car", False),
        ("files.py", "from split_cli.signals import CHANNELS", True),
        ("errors.py", "from split_cli.files import atomic_path", True),
    ],
)
def test_the_reader_of_arrows_sees_an_upward_one(file, text, expected):
    assert any(upward(found) for found in imports_of(text, file)) is expected


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("diagnosis/search/fitting.py", "from split_cli.diagnosis.verdict.findings import describe", True),
        ("diagnosis/verdict/findings.py", "from split_cli.diagnosis.search.fitting import Fit", False),
        ("diagnosis/parallel.py", "from split_cli.diagnosis.statement.result import Diagnosis", True),
        ("diagnosis/recording/series.py", "from split_cli.diagnosis.engine import diagnose", True),
        ("logs/checking/channel_delays.py", "from split_cli.logs.assembling.derivations import derive", True),
        ("logs/drafting/trial.py", "from split_cli.logs.checking.checks import Check", False),
        ("logs/drive.py", "from split_cli.logs.checking.checks import Check", True),
    ],
)
def test_the_reader_of_arrows_sees_one_between_rooms(file, text, expected):
    found = imports_of(text, file)
    assert any(upward_in_diagnosis(one) or upward_between_rooms(one) for one in found) is expected
