"""One C99 header and source from a trained set: tables, committee, nominal model."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

import numpy as np

from split_cli.errors import ExportError
from split_cli.export.provenance import Provenance
from split_cli.export.straight_line import number, straight_line
from split_cli.export.symbolic import NominalGraph
from split_cli.export.tables import BcmTables

__all__ = ["CSource", "c_identifier", "c_source", "template"]

_KEYWORDS = frozenset(
    (
        "auto", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum", "extern",
        "float", "for", "goto", "if", "inline", "int", "long", "main", "real", "register", "restrict", "return",
        "short", "signed", "sizeof", "static", "struct", "switch", "typedef", "union", "unsigned", "void",
        "volatile", "while",
    )
)  # fmt: skip


@dataclass(frozen=True)
class CSource:
    """Text of the exported C.

    Attributes
    ----------
    name : str
        Prefix of every public function.
    real : {"double", "float"}
    header, source : str
    with_step : bool
        Whether features, step and linearisation could be written.
    dimension : int
        D.
    place_time : bool
        Whether the step takes time and track position.
    table_bytes : int
        Size of the constant tables on the target.
    """

    name: str
    real: str
    header: str
    source: str
    with_step: bool
    dimension: int
    place_time: bool
    table_bytes: int


def c_identifier(text: str) -> str:
    """Return a C identifier for any name: other characters become ``_``, a bad start gets ``model_``."""
    name = re.sub(r"[^0-9A-Za-z_]+", "_", text).strip("_")
    if not name or name[0].isdigit() or name.lower() in _KEYWORDS:
        name = f"model_{name}".rstrip("_")
    return name[:48]


@cache
def template(name: str) -> str:
    """Return the text of one of this package's templates."""
    return (files("split_cli.export") / "templates" / name).read_text(encoding="utf-8")


def fill(text: str, values: dict[str, str]) -> str:
    """Replace every ``@KEY@``; a placeholder without a value is a programming error."""
    filled = re.sub(r"@([A-Z0-9_]+)@", lambda match: values[match[1]], text)
    return filled


def c_source(
    tables: BcmTables, graph: NominalGraph, provenance: Provenance, name: str, plain: bool = False
) -> CSource:
    """Write header and source.

    Parameters
    ----------
    tables : BcmTables
    graph : NominalGraph
        Of the set's vehicle.
    provenance : Provenance
    name : str
        A C identifier.
    plain : bool
        Whether the set's labels are plain differences, so that h g itself is added.

    Raises
    ------
    ExportError
        If `name` is not an identifier or the model holds what C99 cannot say.
    """
    if name != c_identifier(name):
        raise ExportError(f"{name!r} is not a C identifier", advice=f"Use --name {c_identifier(name)}.")
    real = tables.real
    with_step = graph.features is not None
    table_text, table_bytes = _tables(tables)
    values = {
        "NAME": name,
        "UPPER": name.upper(),
        "GUARD": f"{name.upper()}_H",
        "REAL": real,
        "DIMENSION": str(tables.feature_count),
        "CELLS": str(tables.cell_count),
        "POINTS": str(len(tables.points)),
        "LARGEST_CELL": str(tables.largest_cell),
        "FEATURES": ", ".join(provenance.features),
        "HORIZON": f"{provenance.horizon:g}",
        "VEHICLE": _comment(provenance.vehicle["name"]),
        "VEHICLE_DIGEST": provenance.vehicle_digest[:16],
        "SET_SHA256": provenance.set_sha256,
        "TABLES_SHA256": tables.digest(),
        "VERSION": provenance.version,
        "SKIP": f"{tables.skip_tolerance:g}",
        "TABLES": table_text,
        "PLACE_TIME": f", {name}_real t, {name}_real s" if graph.needs_place_and_time else "",
        "RESIDUAL": "h g(z)" if plain else "h Phi g(z)",
        "RESIDUAL_A": "none" if plain else "A",
        "PLAIN": ("    static const real none[STATES * STATES] = {ZERO};\n    (void)A;\n" if plain else ""),
        "GATHER": (
            "    const real place_time[2] = {t, s};"
            if graph.needs_place_and_time
            else "    static const real place_time[2] = {ZERO, ZERO};"
        ),
    }
    step_header = step_body = ""
    if with_step:
        values["NOMINAL"] = _nominal(graph, real)
        step_header, step_body = fill(template("step.h.in"), values), fill(template("step.c.in"), values)
    header = fill(template("model.h.in"), {**values, "STEP_DECLARATIONS": step_header})
    # Values are put in once; text that was put in is not searched again for placeholders.
    source = fill(template("model.c.in"), {**values, "STEP": step_body})
    return CSource(
        name, real, header, source, with_step, tables.feature_count, graph.needs_place_and_time, table_bytes
    )


def _nominal(graph: NominalGraph, real: str) -> str:
    rates = straight_line(
        graph.rates, "nominal_rates", real, "Nominal model with its named terms, and its exact Jacobian."
    )
    features = straight_line(
        graph.features, "nominal_features", real, "Features of state and input, and their Jacobian."
    )
    return rates + "\n" + features


def _tables(tables: BcmTables) -> tuple[str, int]:
    """Return the constant tables as C, and their bytes on the target."""
    real = tables.real
    suffix = "f" if real == "float" else ""
    upper = {"exp": "EXP", "sin": "SIN", "cos": "COS", "fabs": "FABS"}
    macros = [f"#define {macro} {function}{suffix}" for function, macro in upper.items()]
    constants = {"ZERO": 0.0, "HALF": 0.5, "ONE": 1.0, "TWO": 2.0, "SIX": 6.0}
    macros += [f"#define {macro} {number(value, real)}" for macro, value in constants.items()]
    reals = {
        "inverse_length[DIMENSION]": 1.0 / tables.length_scales,
        "signal_variance[OUTPUTS]": tables.signal_variance,
        "noise_ratio[OUTPUTS]": tables.noise_ratio,
        "reference[CELLS * DIMENSION]": tables.reference,
        "reach[CELLS]": tables.reach,
        "points[POINTS * DIMENSION]": tables.points,
        "eigenvectors[" + str(len(tables.eigenvectors)) + "]": tables.eigenvectors,
        "gains[POINTS * OUTPUTS]": tables.gains,
        "weights[POINTS * OUTPUTS]": tables.weights,
    }
    size, parts = 0, ["\n".join(macros) + "\n"]
    for label, values in (("first_point", tables.offsets), ("first_square", tables.square_offsets)):
        parts.append(_array(f"static const unsigned long {label}[CELLS + 1]", [f"{v}UL" for v in values.tolist()]))
        size += 8 * len(values)
    for label, values in reals.items():
        flat = np.ravel(values)
        parts.append(_array(f"static const real {label}", [number(v, real) for v in flat.tolist()]))
        size += (4 if real == "float" else 8) * len(flat)
    return "\n".join(parts), size


def _array(declaration: str, literals: list[str]) -> str:
    rows = [", ".join(literals[k : k + 6]) for k in range(0, len(literals), 6)]
    return declaration + " = {\n    " + ",\n    ".join(rows) + "\n};\n"


def _comment(text: str) -> str:
    """Return text that cannot end a C comment or leave ASCII."""
    return text.encode("ascii", "replace").decode().replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")
