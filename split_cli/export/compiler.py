"""Finding, running and measuring with a C compiler; exports are complete without one, but not verified in C."""

import os
import re
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from split_cli.errors import ExportError

STRICT_FLAGS = ("-std=c99", "-Wall", "-Wextra", "-Wpedantic", "-Werror")
_TIMEOUT = 600.0


@dataclass(frozen=True)
class Compiler:
    """A C compiler that exists here."""

    command: tuple[str, ...]  # program and the arguments ``$CC`` gives
    version: str  # first line of what ``--version`` prints

    def build(self, sources: Sequence[Path], output: Path, flags: Sequence[str]) -> None:
        """Compile and link `sources` into `output`.

        Raises
        ------
        ExportError
            With the compiler's first message, if it refuses.
        """
        arguments = [*self.command, *flags, *map(str, sources), "-o", str(output)]
        if "-c" not in flags:
            arguments.append("-lm")
        done = run_program(arguments, b"", "the C compiler")
        if done.returncode:
            lines = done.stderr.decode(errors="replace").splitlines()
            first = next((line for line in lines if "error" in line), lines[0] if lines else "no message")
            what = f"the generated C does not compile: {first}"
            raise ExportError(what, where=" ".join(self.command), advice="Name another compiler in $CC.")

    def compile(self, source: Path, folder: Path, flags: Sequence[str]) -> Path:
        """Compile one source into an object file in `folder` and return its path; raises as `build` does."""
        target = folder / f"{source.stem}.o"
        self.build([source], target, [*flags, "-c"])
        return target


def section_bytes(target: Path) -> tuple[int, int] | None:
    """Return bytes of code and of constants in an object file, None where there is no `size` to ask."""
    size = shutil.which("size")
    if size is None:
        return None
    done = run_program([size, "-A", str(target)], b"", "size")
    sections = re.findall(r"^(\.[\w.]+)\s+(\d+)", done.stdout.decode(errors="replace"), re.MULTILINE)
    code = sum(int(count) for name, count in sections if name.startswith(".text"))
    constants = sum(int(count) for name, count in sections if name.startswith((".rodata", ".data.rel.ro")))
    return code, constants


@dataclass(frozen=True)
class Driver:
    """A compiled program that answers queries; a crash of the C under test cannot take this process with it."""

    program: Path
    real: str  # {"double", "float"}

    @property
    def dtype(self) -> type:
        """The NumPy type of the C's real numbers."""
        return np.float32 if self.real == "float" else np.float64

    def answers(self, what: int, queries: np.ndarray, width: int) -> np.ndarray:
        """Return what function number `what` answers, float64 shape (N, width).

        Raises
        ------
        ExportError
            If the program fails.
        """
        content: np.ndarray = np.ascontiguousarray(queries, dtype=self.dtype)
        command = [str(self.program), str(what), *map(str, (len(content), content.shape[1], width))]
        done = run_program(command, content.tobytes(), "the exported C")
        expected = len(content) * width * np.dtype(self.dtype).itemsize
        if done.returncode or len(done.stdout) != expected:
            message = done.stderr.decode(errors="replace").strip().splitlines()
            raise ExportError(
                f"the exported C stopped with {done.returncode}: {message[0] if message else 'no message'}"
            )
        return np.frombuffer(done.stdout, dtype=self.dtype).reshape(-1, width).astype(float)

    def seconds_per_query(self, queries: np.ndarray) -> float:
        """Return processor time of one prediction [s], the mean over `queries`."""
        content: np.ndarray = np.ascontiguousarray(queries, dtype=self.dtype)
        width = 6 + 3 * content.shape[1]
        command = [str(self.program), "9", str(len(content)), str(content.shape[1]), str(width)]
        done = run_program(command, content.tobytes(), "the exported C")
        if done.returncode:
            raise ExportError(f"the exported C stopped with {done.returncode} while it was timed")
        return float(done.stdout.split()[0])


def find_compiler() -> Compiler | None:
    """Return the compiler of ``$CC``, or the first of cc, gcc, clang that runs; None if there is none.

    Raises
    ------
    ExportError
        If ``$CC`` names one that does not run.
    """
    named = os.environ.get("CC", "").strip()
    for candidate in [named] if named else ["cc", "gcc", "clang"]:
        command = tuple(shlex.split(candidate))
        if shutil.which(command[0]) is None:
            if named:
                raise ExportError(f"$CC names {named!r}, which does not exist", advice="Unset CC or correct it.")
            continue
        done = run_program([*command, "--version"], b"", candidate)
        if done.returncode == 0:
            first = done.stdout.decode(errors="replace").splitlines() or [candidate]
            return Compiler(command, first[0])
        if named:
            raise ExportError(f"$CC names {named!r}, which does not run", advice="Unset CC or correct it.")
    return None


def run_program(command: list[str], given: bytes, what: str) -> subprocess.CompletedProcess[bytes]:
    """Run a program on `given` input; return code and output, or an error that names `what`.

    Raises
    ------
    ExportError
        If it cannot be run or does not finish within ten minutes.
    """
    try:
        return subprocess.run(command, input=given, capture_output=True, timeout=_TIMEOUT, check=False)
    except subprocess.TimeoutExpired:
        advice = "Name another compiler in $CC, or export when the machine is idle."
        raise ExportError(f"{what} did not finish within {_TIMEOUT:g} s", advice=advice) from None
    except OSError as error:
        raise ExportError(f"{what} cannot be run ({error.strerror or error})", where=command[0]) from error
