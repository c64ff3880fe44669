"""Every exported term and variant with plausible parameters, and some of them together."""

import ctypes
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from split_cli.export.c99 import c_source
from split_cli.export.compiler import STRICT_FLAGS, Compiler
from split_cli.export.memory import Memory, exported_model
from split_cli.export.provenance import provenance_of
from split_cli.export.symbolic import NominalGraph, build_nominal
from split_cli.export.tables import build_tables
from split_cli.export.validity import valid_function
from split_cli.learning.training_set import TrainingSet
from split_cli.vehicle.effects import CATALOGUE
from split_cli.vehicle.parameters import EffectSpec
from split_cli.vehicle.single_track import SingleTrack
from tests.export.export_support import take_cells
from tests.factories import make_training_set, road_car
from tests.term_examples import EXAMPLES

STEP = 0.05

TOGETHER = {
    "steer_delay+steer_lag": ("steer_delay", "steer_lag"),
    "drive_lag+tire_relaxation": ("drive_lag", "tire_relaxation"),
    "friction_patch+steer_lag": ("friction_patch", "steer_lag"),
    "steer_backlash+drive_delay": ("steer_backlash", "drive_delay"),
    "the whole steering": ("steer_backlash", "steer_gain", "steer_lag", "steer_offset"),
    "wind+grip_fade+load_transfer": ("wind", "grip_fade", "load_transfer"),
    "every term there is": tuple(name for name, kind in CATALOGUE.items() if kind.exported),
    "everything with a memory": (
        "steer_delay",
        "steer_gain",
        "steer_backlash",
        "steer_lag",
        "drive_delay",
        "drive_gain",
        "drive_lag",
        "tire_relaxation",
        "combined_slip",
        "friction_patch",
    ),
}


def effect(term: str, variant: str = "") -> EffectSpec:
    """Return a term with the parameters of its example."""
    return EffectSpec(term, EXAMPLES[term, variant], variant)


#: Without what acts as far as a set knows: `test_export_learned_lag` has sets that know something.
SINGLES = {
    f"{name} {variant}".strip(): (effect(name, variant),)
    for name, kind in CATALOGUE.items()
    if kind.exported
    for variant in kind.variants
    if variant != "learned"
}
CASES: dict[str, tuple[EffectSpec, ...]] = {
    **SINGLES,
    **{name: tuple(effect(term) for term in terms) for name, terms in TOGETHER.items()},
}
REMEMBERING = [
    name
    for name, effects in CASES.items()
    if any(CATALOGUE[e.term](e.parameters, e.variant).state_names or e.term.endswith("_delay") for e in effects)
]


@dataclass(frozen=True)
class Exported:
    """A case's model in Python, its graph, and its C."""

    model: SingleTrack
    graph: NominalGraph
    training_set: TrainingSet
    name: str
    library: ctypes.CDLL

    @property
    def memory(self) -> Memory | None:
        return self.graph.memory

    @property
    def size(self) -> int:
        return 8 if self.memory is None else self.memory.whole

    def call(self, function: str, *arguments: np.ndarray | float | int) -> None:
        """Call a C function; arrays are passed as they lie, floats as double."""
        passed = [
            a.ctypes.data_as(ctypes.c_void_p)
            if isinstance(a, np.ndarray)
            else (ctypes.c_int(a) if isinstance(a, int) else ctypes.c_double(a))
            for a in arguments
        ]
        getattr(self.library, f"{self.name}_{function}")(*passed)

    def place(self, t: float, s: float) -> tuple[float, ...]:
        """Return time and place where the C takes them."""
        return (float(t), float(s)) if self.graph.needs_place_and_time else ()

    def start(self, x: np.ndarray, t: float, s: float) -> np.ndarray:
        """Return the whole state from the first eight."""
        whole = np.concatenate([x, np.full(self.size - 8, np.nan)])
        if self.memory is not None:
            self.call("start", whole, *self.place(t, s))
        return whole

    def drive(self, x: np.ndarray, commands: np.ndarray, t: np.ndarray, s: np.ndarray, rk4: int = 0) -> np.ndarray:
        """Return whole states (K + 1, n) over commands (K + 1, 2), a step apart; `rk4` substeps, 0 for `step`."""
        now = self.start(x, t[0], s[0])
        path = [now.copy()]
        for k in range(len(commands) - 1):
            u = np.ascontiguousarray((commands[k + 1] - commands[k]) / STEP)
            following = np.empty(self.size)
            more = (rk4,) if rk4 else ()
            self.call("step_rk4" if rk4 else "step", now, u, *self.place(t[k], s[k]), STEP, *more, following)
            now = following
            path.append(now.copy())
        return np.array(path)


def silent_set(effects: tuple[EffectSpec, ...] = (), seed: int = 8) -> TrainingSet:
    """Return a small set whose residual is zero everywhere, so that steps show the model alone."""
    small = take_cells(make_training_set(seed=seed, points=40, vehicle=road_car(effects=effects)), 8)
    return replace(small, y=np.zeros_like(small.y))


def build_library(compiler: Compiler, folder: Path, cases: dict[str, tuple[EffectSpec, ...]]) -> dict[str, Exported]:
    """Compile the C of all cases into one library, as strictly as users do but without optimisation, for speed."""
    plain = silent_set()
    tables, sources, parts = build_tables(plain), [], {}
    for number, (case, effects) in enumerate(cases.items()):
        training_set = replace(plain, vehicle=road_car(effects=effects))
        graph = build_nominal(SingleTrack(training_set.vehicle), training_set.features, STEP)
        name = f"case{number}"
        source = c_source(tables, graph, provenance_of(training_set, "bcm"), name, valid_function(training_set))
        (folder / f"{name}.h").write_text(source.header)
        sources.append(folder / f"{name}.c")
        sources[-1].write_text(source.source)
        parts[case] = (exported_model(SingleTrack(training_set.vehicle)), graph, training_set, name)
    compiler.build(sources, folder / "cases.so", [*STRICT_FLAGS, "-O0", "-shared", "-fPIC"])
    library = ctypes.CDLL(str(folder / "cases.so"))
    return {case: Exported(*content, library) for case, content in parts.items()}


def manoeuvre(steps: int = 40, speed: float = 18.0) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return a start x (8,), commands (K + 1, 2), times and places (K + 1,): braking and driving in turns."""
    t = 3.0 + STEP * np.arange(steps + 1)
    clock = t - t[0]
    commands = np.column_stack(
        [
            500.0 + 700.0 * np.sin(4.0 * clock) - 600.0 * (clock > 1.0),
            0.03 * np.sin(3.0 * clock) + 0.012 * np.sin(11.0 * clock),
        ]
    )
    x = np.array([5.0, -2.0, 0.6, speed, 0.05, 0.04, *commands[0]])
    return x, commands, t, 3.0 + speed * clock
