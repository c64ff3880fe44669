"""Straight-line C99 from a loop-free CasADi function: one constant local a line, nothing else needed."""

import casadi

from split_cli.errors import OUR_FAULT, ExportError

_UNARY = {
    casadi.OP_NEG: "-{0}",
    casadi.OP_SQ: "{0} * {0}",
    casadi.OP_TWICE: "@TWO@ * {0}",
    casadi.OP_INV: "@ONE@ / {0}",
    casadi.OP_NOT: "(real)(!({0} != @ZERO@))",
    casadi.OP_ASSIGN: "{0}",
    casadi.OP_SIGN: "(real)(({0} > @ZERO@) - ({0} < @ZERO@))",
}
_FUNCTIONS = {
    getattr(casadi, f"OP_{name.upper()}"): name
    for name in """
        sin cos tan asin acos atan atan2 tanh sinh cosh exp log sqrt fabs fmin fmax pow floor ceil fmod hypot
    """.split()
} | {casadi.OP_CONSTPOW: "pow"}
_BINARY = {
    casadi.OP_ADD: "{0} + {1}",
    casadi.OP_SUB: "{0} - {1}",
    casadi.OP_MUL: "{0} * {1}",
    casadi.OP_DIV: "{0} / {1}",
    casadi.OP_LT: "(real)({0} < {1})",
    casadi.OP_LE: "(real)({0} <= {1})",
    casadi.OP_EQ: "(real)({0} == {1})",
    casadi.OP_NE: "(real)({0} != {1})",
    casadi.OP_AND: "(real)(({0} != @ZERO@) && ({1} != @ZERO@))",
    casadi.OP_OR: "(real)(({0} != @ZERO@) || ({1} != @ZERO@))",
    casadi.OP_IF_ELSE_ZERO: "({0} != @ZERO@) ? {1} : @ZERO@",
}


def c_literal(value: float, real: str) -> str:
    """Return a C literal that reads back to exactly `value` rounded to `real`."""
    if real == "float":
        import numpy as np

        text = np.format_float_scientific(np.float32(value), unique=True, trim="0")
        return f"{text}F"
    return repr(float(value))


def straight_line(function: casadi.Function, name: str, real: str, comment: str) -> str:
    """Return a static C function ``void name(const real *const in[], real *const out[])``.

    Parameters
    ----------
    function : casadi.Function
        Of SX expressions, dense inputs and outputs. Matrices come out column by column.
    name : str
        C identifier.
    real : {"double", "float"}
    comment : str
        One line above the function.

    Raises
    ------
    ExportError
        If the graph holds an operation C99's mathematics library has not.
    """
    suffix = "f" if real == "float" else ""
    lines: list[str] = []
    slots: dict[int, str] = {}
    inputs: set[int] = set()
    for k in range(function.n_instructions()):
        operation = function.instruction_id(k)
        taken, given = function.instruction_input(k), function.instruction_output(k)
        if operation == casadi.OP_OUTPUT:
            lines.append(f"    out[{given[0]}][{given[1]}] = {slots[taken[0]]};")
            continue
        if operation == casadi.OP_CONST:
            slots[given[0]] = _constant(function.instruction_constant(k), real)
            continue
        if operation == casadi.OP_INPUT:
            inputs.add(taken[0])
            expression = f"in[{taken[0]}][{taken[1]}]"
        else:
            expression = _expression(operation, [slots[i] for i in taken], suffix)
        # Every value gets a name of its own: the graph's work slots are reused, constants in C are not.
        slots[given[0]] = f"a{k}"
        lines.append(f"    const real a{k} = {expression};")
    body = "\n".join(lines)
    for token, value in (("@ZERO@", 0.0), ("@ONE@", 1.0), ("@TWO@", 2.0)):
        body = body.replace(token, c_literal(value, real))
    unused = "" if inputs else "    (void)in;\n"
    return f"/* {comment} */\nstatic void {name}(const real *const *in, real *const *out)\n{{\n{unused}{body}\n}}\n"


def _constant(value: float, real: str) -> str:
    if value != value or value in (float("inf"), float("-inf")):
        raise ExportError(f"the nominal model holds the constant {value}", advice="Check the vehicle file.")
    text = c_literal(value, real)
    return f"({text})" if text.startswith("-") else text


def _expression(operation: int, names: list[str], suffix: str) -> str:
    if operation in _UNARY:
        return _UNARY[operation].format(*names)
    if operation in _BINARY:
        return _BINARY[operation].format(*names)
    if operation in _FUNCTIONS:
        return f"{_FUNCTIONS[operation]}{suffix}({', '.join(names)})"
    what = f"the nominal model uses CasADi operation {operation}, which C99 export does not know"
    raise ExportError(what, advice=OUR_FAULT)
