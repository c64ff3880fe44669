"""CasADi's generated C, compiled and compared with Python."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from split_cli.export.c99 import fill, template
from split_cli.export.check import ExportAnswer, Oracle, check_predictions
from split_cli.export.compiler import Compiler, Driver, section_bytes
from split_cli.export.step_check import StepOracle, compare_drives, compare_states

# CasADi leaves parameters unused and declares none of its helpers static inline, so it cannot be as strict.
_FLAGS = ("-std=c99", "-O1")
_QUERIES = 1000


def build_generated(
    name: str, source: Path, scratch: Path, compiler: Compiler, with_step: bool, states: int = 8
) -> Driver:
    """Compile ``NAME_casadi.c`` of folder `source` with a driver in folder `scratch`.

    Parameters
    ----------
    with_step : bool
        Whether there is a discrete step.
    states : int
        Size of its state.
    """
    driver = scratch / "casadi_driver.c"
    cases = f"    case 1: function = {name}_discrete; break;\n" if with_step else ""
    driver.write_text(fill(template("casadi_driver.c.in"), {"NAME": name, "STEP": cases, "N": str(states)}))
    program = scratch / "casadi_driver"
    flags = [*_FLAGS, f"-I{source}"]
    compiled = compiler.compile(source / f"{name}_casadi.c", scratch, flags)
    compiler.build([compiled, driver], program, flags)
    return Driver(program, "double")


def check_generated(
    name: str,
    source: Path,
    scratch: Path,
    compiler: Compiler,
    oracle: Oracle,
    with_step: bool,
    steps: StepOracle | None,
) -> int | None:
    """Compile and run the generated C and compare it with Python; return its code's bytes.

    Raises
    ------
    ExportError
        If it does not compile or differs.
    """
    states = 8 if steps is None else steps.size
    driver = build_generated(name, source, scratch, compiler, with_step, states)
    dimension = oracle.z.shape[1]

    def predict(z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        out = driver.answers(0, z, 6)
        return out[:, :3], out[:, 3:]

    def jacobian(z: np.ndarray) -> np.ndarray:
        # CasADi stores matrices column by column.
        return driver.answers(2, z, 6 + 3 * dimension)[:, 6:].reshape(-1, dimension, 3).transpose(0, 2, 1)

    some = slice(None, None, max(1, len(oracle.z) // _QUERIES))
    few = replace(oracle, z=oracle.z[some], mean=oracle.mean[some], variance=oracle.variance[some])
    check_predictions(ExportAnswer(predict, jacobian), few, "double", "CasADi's C")
    if with_step and steps is not None:

        def step(asked: np.ndarray) -> np.ndarray:
            return driver.answers(1, asked, states)

        compare_states(step(steps.asked), steps.exact, steps, "double", "CasADi's C: the step")
        if steps.drives is not None:
            compare_drives(step, steps, "exact", "double", "CasADi's C: the step over a drive")
    sizes = section_bytes(scratch / f"{name}_casadi.o")
    return sizes[0] if sizes else None
