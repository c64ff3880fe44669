"""One C99 header and source from a trained set: tables, committee, nominal model."""

import re
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from textwrap import wrap
from typing import Any

import casadi
import numpy as np

from split_cli.errors import ExportError, printable
from split_cli.export.memory import Memory, present
from split_cli.export.projection import ProjectionData
from split_cli.export.provenance import Provenance
from split_cli.export.straight_line import c_literal, straight_line
from split_cli.export.symbolic import NominalGraph
from split_cli.export.tables import BcmTables, Constants, TableData, lines_of
from split_cli.learning.running_trust import LEAST_SQUARES, MEMORY, MOST_ERROR, SPAN
from split_cli.learning.trust import kept_share, supported_variance

#: What the header says of a lag that depends on what the set knows.
_KNOWLEDGE_TEXT = """
 * Of the steering's lag the share acts that the set knows, 1 - v/S0 at the step's start, with the variance v of the
 * process and S0 its prior: far from all that was learned the wheel has the commanded angle."""
#: How what evaluates the constants begins, and how where a term asks what the set knows; the rest is in `model.c.in`.
_EVALUATE = "void {name}_evaluate(const real *z, real *mean, real *variance, real *jacobian)"
_ANSWER = """\
/* With `open` also the share of the prior's variance that the labels leave of the output that they show best. */
static void answer(const real *z, real *mean, real *variance, real *jacobian, real *open)"""
#: The C that evaluates each kind of constants.
_TEMPLATES = {BcmTables: "committee.c.in", TableData: "table.c.in", ProjectionData: "projection.c.in"}
_KEYWORDS = frozenset(
    """
    auto break case char const continue default do double else enum extern float for goto if inline int long main real
    register restrict return short signed sizeof static struct switch typedef union unsigned void volatile while
    """.split()
)


@dataclass(frozen=True)
class CSource:
    """Text of the exported C."""

    name: str  # prefix of every public function
    real: str  # {"double", "float"}
    header: str
    source: str
    with_step: bool  # whether features, step and linearisation could be written
    dimension: int  # D
    place_time: bool  # whether the step takes time and track position
    memory: Memory | None  # states of the step beyond the first eight
    table_bytes: int  # size of the constant tables on the target


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


def fill(text: str, values: dict[str, str], kept: Collection[str] = ()) -> str:
    """Replace every ``@KEY@``; a placeholder without a value is a programming error.

    Lines between ``%if word`` and ``%else`` or ``%end`` stay when `kept` holds the word, those after ``%else``
    when it does not.
    """
    lines, open_ = [], [True]
    for line in text.splitlines(keepends=True):
        if line.startswith("%if "):
            open_.append(line.split()[1] in kept)
        elif line.startswith("%else"):
            open_[-1] = not open_[-1]
        elif line.startswith("%end"):
            open_.pop()
        elif all(open_):
            lines.append(line)
    return re.sub(r"@([A-Z0-9_]+)@", lambda match: values[match[1]], "".join(lines))


def c_source(
    tables: Constants,
    graph: NominalGraph,
    provenance: Provenance,
    name: str,
    valid: casadi.Function,
    plain: bool = False,
    clearest: int = 0,
) -> CSource:
    """Write header and source.

    Parameters
    ----------
    tables : BcmTables, TableData or ProjectionData
        What the predictor evaluates.
    graph : NominalGraph
        Of the set's vehicle.
    name : str
        A C identifier.
    valid : casadi.Function
        Features to whether they lie in the valid region, as `validity.valid_function` makes it.
    plain : bool
        Whether the set's labels are plain differences, so that h g itself is added.
    clearest : int
        The output whose variance says how much the set knows (`Kernel.clearest`), where a term asks.

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
    values = {**_texts(tables, graph, provenance, name, plain), "TABLES": table_text, **_predictor_values(tables)}
    asks = with_step and graph.asks_knowledge
    values |= {"CLEAREST": str(clearest), "EVALUATE": _ANSWER if asks else _EVALUATE.format(name=name)}
    parts = {"robust": getattr(tables, "robust", False), "knowledge": asks, "step": with_step}
    kept = [part for part, needed in parts.items() if needed]
    values["PREDICTOR"] = fill(template(_TEMPLATES[type(tables)]), values, kept)
    values["VALID"] = straight_line(valid, "valid_region", real, "1 where the valid region holds z, else 0.")
    memory = graph.memory if with_step else None
    values |= _memory_values(graph, memory, name, real)
    step_header, step_body = _step(values, graph, provenance, real) if with_step else ("", "")
    header = fill(template("model.h.in"), {**values, "STEP_DECLARATIONS": step_header}, kept)
    # Values are put in once; text that was put in is not searched again for placeholders.
    source = fill(template("model.c.in"), {**values, "STEP": step_body}, kept)
    needs = graph.needs_place_and_time
    return CSource(name, real, header, source, with_step, tables.feature_count, needs, memory, table_bytes)


def _texts(tables: Constants, graph: NominalGraph, provenance: Provenance, name: str, plain: bool) -> dict[str, str]:
    """Return what stands for the placeholders of header and source but tables, predictor and step."""
    supported = supported_variance(tables.trust, tables.doubt, tables.signal_variance)
    return {
        "NAME": name,
        "UPPER": name.upper(),
        "GUARD": f"{name.upper()}_H",
        "REAL": tables.real,
        "DIMENSION": str(tables.feature_count),
        "FEATURES": ", ".join(provenance.features),
        "HORIZON": f"{provenance.horizon:g}",
        "VEHICLE": _comment(provenance.vehicle["name"]),
        "VEHICLE_DIGEST": provenance.vehicle_digest[:16],
        "SET_SHA256": provenance.set_sha256,
        "TABLES_SHA256": tables.digest(),
        "VERSION": provenance.version,
        "TRUST": ", ".join(f"{value:g}" for value in tables.trust.tolist()),
        "RESERVATIONS": _reservations(provenance.reservations),
        "LOW_SPEED": f"{graph.low_speed:g}",
        "SLOWEST": f"{provenance.slowest:g}",
        "SLOWEST_EXACT": c_literal(provenance.slowest, tables.real),
        "KEPT": ", ".join(f"{value:g}" for value in _kept(tables).tolist()),
        "DOUBT": ", ".join(f"{value:g}" for value in tables.doubt.tolist()),
        "SUPPORTED": ", ".join(c_literal(value, tables.real) for value in supported.tolist()),
        "PLACE_TIME": f", {name}_real t, {name}_real s" if graph.needs_place_and_time else "",
        "RESIDUAL": "h g(z)" if plain else "h Phi g(z)",
        "RESIDUAL_A": "none" if plain else "A",
        "PLAIN": ("    static const real none[STATES * STATES] = {0};\n    (void)A;\n" if plain else ""),
        "GATHER": (
            "    const real place_time[2] = {t, s};"
            if graph.needs_place_and_time
            else "    static const real place_time[2] = {ZERO, ZERO};"
        ),
    }


def _step(values: dict[str, str], graph: NominalGraph, provenance: Provenance, real: str) -> tuple[str, str]:
    """Return declarations and code of the nominal step with the correction and its running trust."""
    values = {**values, "NOMINAL": _nominal(graph, real), "LIMITS": _limits(graph, provenance, real)}
    values["LINEAR"] = fill(template("linear.c.in"), values)
    apart = "1e-4" if real == "double" else "1e-2"
    trust = {**values, "SPAN": f"{SPAN:g}", "MEMORY": f"{MEMORY:g}", "APART": apart}
    trust |= {
        "MOST_ERROR": c_literal(MOST_ERROR, real),
        "LEAST_SQUARES": c_literal(LEAST_SQUARES, real),
        "MOST": f"{MOST_ERROR:g}",
    }
    kind, kept = "memory_step" if graph.memory else "step", memory_parts(graph.memory)
    kept = (*kept, "knowledge") if graph.asks_knowledge else kept
    values["RESPONDING"] = "STATES - 3" if graph.feeds_back else "3"
    values["SITUATION"] = str(graph.rates.size1_in(1))
    values["KNOWLEDGE_HELD"] = ", knowledge" if graph.asks_knowledge else ""
    values["KNOWLEDGE_TEXT"] = _KNOWLEDGE_TEXT if graph.asks_knowledge else ""
    header, body = (
        fill(template(f"{kind}.{end}.in"), {**values, "TRUST": fill(template(f"trust.{end}.in"), trust)}, kept)
        for end in ("h", "c")
    )
    return header, body


def _number_of(value: Any) -> float:
    """Return a vehicle's number, which may be written with its source beside it."""
    return float(value["value"] if isinstance(value, dict) else value)


def _limits(graph: NominalGraph, provenance: Provenance, real: str) -> str:
    """Return the limits that a step takes its arguments within, far beyond what a car does, as C.

    Speeds 150 m/s, yaw rate 50 rad/s, ten times the largest torque, a road wheel at 1.4 rad, each input from one
    limit to the other in a millisecond; 1e12 for the terms' states; no limit for the pose but the largest number.
    """
    car = provenance.vehicle
    largest = 1.7e308 if real == "double" else 3.4e38
    torque = 10.0 * max(_number_of(car["max_torque"]), _number_of(car.get("max_brake_torque") or 0.0))
    steer, whole = 1.4, graph.memory.whole if graph.memory else 8
    states = [largest, largest, largest, 150.0, 150.0, 50.0, torque, steer]
    if graph.memory:
        states += [1e12] * (graph.memory.continuous - 8)
        states += [torque] * graph.memory.lengths[0] + [steer] * graph.memory.lengths[1]
    arrays = {"most_state[TAKEN]": states, "most_input[INPUTS]": [2e3 * torque, 2e3 * steer]}
    parts = [f"enum {{ TAKEN = {whole} }};"]
    parts += [
        f"static const real {label} = {{{', '.join(c_literal(v, real) for v in values)}}};"
        for label, values in arrays.items()
    ]
    # 256 time constants are e^256 = 1e111; single precision ends at e^88.
    parts.append(f"static const real longest = {c_literal(256.0 if real == 'double' else 64.0, real)};")
    parts.append(f"static const real most_carried = {c_literal(largest, real)};")
    return "\n".join(parts)


def _predictor_values(tables: Constants) -> dict[str, str]:
    """Return what the templates say of the predictor."""
    if isinstance(tables, TableData):
        n0, n1, n2, _ = tables.coefficients.shape
        return {
            "KIND": f"a tricubic B-spline of {n0} x {n1} x {n2} nodes",
            "OUTSIDE": "Every query takes the same time. Far from\n * the points it is the prior.",
            "SIZES": f", WIDTH = 6, N0 = {n0}, N1 = {n1}, N2 = {n2}",
        }
    if isinstance(tables, ProjectionData):
        count = len(tables.points)
        return {
            "KIND": f"a Gaussian process on {count} points",
            "OUTSIDE": "Every query takes the same time. Far from\n * the points it is the prior.",
            "SIZES": f", POINTS = {count}, TRIANGLE = {count * (count + 1) // 2}",
        }
    kind = "robust Bayesian committee machine" if tables.robust else "Bayesian committee machine"
    return {
        "KIND": f"a {kind} over {tables.cell_count} cells and {len(tables.points)} points",
        "OUTSIDE": f"Far cells are skipped; together they\n"
        f" * change a mean by at most {tables.skip_tolerance:g} signal deviations and a variance by at most\n"
        f" * {tables.skip_tolerance:g} signal variances.",
        "SIZES": f", CELLS = {tables.cell_count}, POINTS = {len(tables.points)}, LARGEST_CELL = {tables.largest_cell}",
    }


def _nominal(graph: NominalGraph, real: str) -> str:
    rates = straight_line(
        graph.rates, "nominal_rates", real, "Nominal model with its named terms, and its exact Jacobian."
    )
    features = straight_line(
        present(graph.features), "nominal_features", real, "Features of state and input, and their Jacobian."
    )
    parts = [rates, features]
    if graph.start is not None:
        parts.append(straight_line(graph.start, "nominal_start", real, "Where the terms' states settle."))
    if graph.jumps is not None:
        parts.append(
            straight_line(graph.jumps, "nominal_jumps", real, "Where commands drag the plays, and its Jacobian.")
        )
    return "\n".join(parts)


def memory_parts(memory: Memory | None) -> tuple[str, ...]:
    """Return which parts of the templates a memory needs."""
    if memory is None:
        return ()
    parts = {"memory": True, "states": memory.states, "plays": memory.plays, "delays": memory.line}
    return tuple(name for name, needed in parts.items() if needed)


def _memory_values(graph: NominalGraph, memory: Memory | None, name: str, real: str) -> dict[str, str]:
    """Return what the templates say of states beyond the first eight; nothing where there are none."""
    if memory is None:
        # A controller written for any set calls it, whether training found a lag or not.
        start = (
            "\n/* There are no states beyond the first eight to fill. */"
            f"\nstatic inline void {name}_start({name}_real *x)\n{{\n    (void)x;\n}}\n"
        )
        return {"STATES": "8", "MEMORY_TEXT": "", "MEMORY_ENUM": "", "MEMORY_MACRO": start}
    upper, delayed = name.upper(), memory.line > 0
    arriving = f", const {name}_real *arrived" if delayed else ""
    text = "".join(f"\n *   x[{8 + k}]  {label}" for k, label in enumerate(memory.labels))
    text = f"\n * Further states, steady after {name}_start:{text}"
    if delayed:
        late = ", ".join(f"{c} by {d:g} s" for c, d in zip(("T", "delta"), memory.delays, strict=True) if d)
        text += (
            f"\n * Commands arrive late: {late}. Past commands lie {memory.step:g} s apart; what arrives is"
            "\n * linear between two of them. The step takes this interval and no other."
        )
    play = [memory.names[k] for k in memory.plays]
    if play:
        text += (
            f"\n * {', '.join(play)}: in the step dragged to where its end has it; in the right-hand side"
            "\n * and the Runge-Kutta step, as in the labels, drawn to the edge of its play at 200/s."
        )
    values = {
        "STATES": str(memory.whole),
        "MEMORY_TEXT": text,
        "MEMORY_ENUM": f", {upper}_CONTINUOUS_STATES = {memory.continuous}",
        "MEMORY_MACRO": (
            f"\n/* Interval of the step [s]. */\n#define {upper}_TIME_STEP {c_literal(memory.step, real)}\n"
            if delayed
            else ""
        ),
        "CONTINUOUS": str(memory.continuous),
        "WHOLE": str(memory.whole),
        "LATE_T": str(memory.lengths[0]),
        "LATE_DELTA": str(memory.lengths[1]),
        "MEMORY_TABLES": _memory_tables(graph, memory, real),
        "UNUSED_PLACE_TIME": "    (void)t;\n    (void)s;\n" if graph.needs_place_and_time else "",
        "ARRIVING": arriving,
        "ARRIVED": "arrived" if delayed else "x + 6",
        "ARRIVED_DECLARATION": (
            f"\n/* What arrives now [T, delta] of the commands so far. */\n"
            f"void {name}_arrived(const {name}_real *x, {name}_real *arrived);\n"
            if delayed
            else ""
        ),
        "RATES_TEXT": ": what arrives now, [T, delta], is an argument" if delayed else "",
        "RATES_INDENT": " " * len(f"void {name}_rates("),
        "STEP_TEXT": f" (not-a-number when h is not {memory.step:g})" if delayed else "",
    }
    return values


def _memory_tables(graph: NominalGraph, memory: Memory, real: str) -> str:
    """Return constants of the memory as C."""
    longest = max(1, *memory.lengths)
    units = (1.0,) * 8 + graph.units
    parts = [f"enum {{ LONGEST_LINE = {longest}, PLAYS = {len(memory.plays)} }};"]
    if memory.line:
        parts.append(f"#define STEP {c_literal(memory.step, real)}")
    if memory.plays:
        parts.append(f"static const int play[PLAYS] = {{{', '.join(str(8 + k) for k in memory.plays)}}};")
    arrays = {
        "unit[STATES]": units,
        "fastest[2]": memory.rates,
        "share_T[LATE_T + 1]": memory.weights(0),
        "share_delta[LATE_DELTA + 1]": memory.weights(1),
    }
    parts += [
        f"static const real {label} = {{{', '.join(c_literal(float(v), real) for v in values)}}};"
        for label, values in arrays.items()
    ]
    return "\n".join(parts)


def _tables(tables: Constants) -> tuple[str, int]:
    """Return the constants as C, and their bytes on the target."""
    real, parts, size = tables.real, [_macros(tables.real)], 0
    if isinstance(tables, BcmTables):
        for label, values in (("first_point", tables.offsets), ("first_square", tables.square_offsets)):
            parts.append(_array(f"static const unsigned long {label}[CELLS + 1]", [f"{v}UL" for v in values.tolist()]))
            size += 8 * len(values)
    if isinstance(tables, TableData):
        lines = lines_of(tables.coefficients)
        integers = {
            "long line_begin[N0 * N1]": lines.begin,
            "short line_first[N0 * N1]": lines.lowest,
            "short line_nodes[N0 * N1]": lines.length,
            f"short coefficients[{lines.nodes.size}]": lines.nodes,
        }
        for label, values in integers.items():
            text = [str(value) for value in np.ravel(values).tolist()]
            parts.append(_array(f"static const {label}", text, 18))
            size += (8 if label.startswith("long") else 2) * len(text)
    for label, values in _reals(tables).items():
        flat = np.ravel(values)
        parts.append(_array(f"static const real {label}", [c_literal(v, real) for v in flat.tolist()]))
        size += (4 if real == "float" else 8) * len(flat)
    return "\n".join(parts), size


def _kept(tables: Constants) -> np.ndarray:
    return kept_share(tables.trust, tables.doubt, tables.signal_variance)


def _reals(tables: Constants) -> dict[str, np.ndarray]:
    """Return the arrays of real numbers by their declarators in C."""
    shared = {
        "signal_variance[OUTPUTS]": tables.signal_variance,
        "trust[OUTPUTS]": tables.trust,
        "kept[OUTPUTS]": _kept(tables),
        "doubt[OUTPUTS]": tables.doubt,
    }
    if isinstance(tables, TableData):
        return shared | {
            "origin[DIMENSION]": tables.origin,
            "inverse_spacing[DIMENSION]": 1.0 / tables.spacing,
            "least[OUTPUTS]": tables.least,
            "node_unit[WIDTH]": tables.unit,
        }
    shared["inverse_length[DIMENSION]"] = 1.0 / tables.length_scales
    shared["points[POINTS * DIMENSION]"] = tables.points
    shared["weights[POINTS * OUTPUTS]"] = tables.weights
    if isinstance(tables, ProjectionData):
        return shared | {
            "reference[DIMENSION]": tables.reference,
            "whitening[TRIANGLE]": tables.whitening,
            "spread[OUTPUTS * TRIANGLE]": tables.spread,
            "absent[OUTPUTS]": tables.absent,
            "gain_limit[1]": tables.gain_limit,
        }
    return shared | {
        "noise_ratio[OUTPUTS]": tables.noise_ratio,
        "reference[CELLS * DIMENSION]": tables.reference,
        "reach[CELLS]": tables.reach,
        f"eigenvectors[{len(tables.eigenvectors)}]": tables.eigenvectors,
        "gains[POINTS * OUTPUTS]": tables.gains,
    }


def _macros(real: str) -> str:
    """Return the functions and constants that the templates use, as C of the precision."""
    suffix = "f" if real == "float" else ""
    upper = {"exp": "EXP", "log": "LOG", "sin": "SIN", "cos": "COS", "fabs": "FABS"}
    macros = [f"#define {macro} {function}{suffix}" for function, macro in upper.items()]
    constants = {"ZERO": 0.0, "HALF": 0.5, "ONE": 1.0, "TWO": 2.0, "THREE": 3.0, "FOUR": 4.0, "SIX": 6.0}
    macros += [f"#define {macro} {c_literal(value, real)}" for macro, value in constants.items()]
    return "\n".join(macros) + "\n"


def _array(declaration: str, literals: list[str], width: int = 6) -> str:
    rows = [", ".join(literals[k : k + width]) for k in range(0, len(literals), width)]
    return declaration + " = {\n    " + ",\n    ".join(rows) + "\n};\n"


def _reservations(sentences: tuple[str, ...]) -> str:
    """Return lines of the header's comment, none where there is nothing to say."""
    lines = [line for text in sentences for line in wrap(_comment(f"Note: {text}."), 115)]
    return "".join(f"\n * {line}" for line in lines)


def _comment(text: str) -> str:
    """Return text that cannot end a C comment, control a terminal or leave ASCII."""
    text = printable(text).encode("ascii", "replace").decode()
    return text.replace("*/", "* /").replace("/*", "/ *").replace("\\", "/")
