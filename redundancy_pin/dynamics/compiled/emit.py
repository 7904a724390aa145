"""C99 from casadi's expressions: one assignment per operation.

casadi's own generator adds a runtime and unused parameters. Here a function is

    void name(const double *const *arg, double *const *res)

with arrays that the caller owns; all it needs is math.h.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from redundancy_pin.dynamics.compiled.symbols import ca
from redundancy_pin.errors import UnsupportedRobotError

_UNARY = {
    "OP_ASSIGN": "{}",
    "OP_NEG": "-{}",
    "OP_SIN": "sin({})",
    "OP_COS": "cos({})",
    "OP_SQRT": "sqrt({})",
    "OP_SQ": "{0} * {0}",
    "OP_TWICE": "2.0 * {}",
    "OP_INV": "1.0 / {}",
    "OP_FLOOR": "floor({})",
    "OP_TANH": "tanh({})",
}
_BINARY = {
    "OP_ADD": "{} + {}",
    "OP_SUB": "{} - {}",
    "OP_MUL": "{} * {}",
    "OP_DIV": "{} / {}",
    "OP_ATAN2": "atan2({}, {})",
    "OP_POW": "pow({}, {})",
    "OP_CONSTPOW": "pow({}, {})",
    "OP_EQ": "{} == {}",
}


def c_functions(functions: Iterable[Any], storage: str = "") -> str:
    """Return the C of casadi Functions of scalar expressions; ``storage`` may be ``"static"``."""
    return "\n".join(_function(function, f"{storage} void".strip()) for function in functions)


def _function(function: Any, returned: str) -> str:
    unary = {getattr(ca, name): form for name, form in _UNARY.items()}
    binary = {getattr(ca, name): form for name, form in _BINARY.items()}
    lines: list[str] = []
    known: dict[int, str] = {}
    """By place in casadi's memory its present content: a name, or a constant. Casadi reuses places, but names are
    assigned once each, which suits compilers."""
    for k in range(function.n_instructions()):
        operation, at, out = function.instruction_id(k), function.instruction_input(k), function.instruction_output(k)
        if operation == ca.OP_OUTPUT:
            lines.append(f"  res[{out[0]}][{out[1]}] = {known[at[0]]};")
        elif operation == ca.OP_INPUT:
            known[out[0]] = _assigned(lines, k, f"arg[{at[0]}][{at[1]}]")
        elif operation == ca.OP_CONST:
            value = function.instruction_constant(k)
            known[out[0]] = repr(float(value)) if value >= 0.0 else f"({float(value)!r})"
        elif operation in unary:
            known[out[0]] = _assigned(lines, k, unary[operation].format(known[at[0]]))
        elif operation in binary:
            known[out[0]] = _assigned(lines, k, binary[operation].format(known[at[0]], known[at[1]]))
        else:
            raise UnsupportedRobotError(
                f"Operation {operation} of casadi has no C here (function {function.name()}).",
                remedy="Use RneaDynamics, which covers every robot.",
            )
    unused = [f"  (void){name};" for name, used in (("arg", "arg["), ("res", "res[")) if not _used(lines, used)]
    head = f"{returned} {function.name()}(const double *const *arg, double *const *res) {{"
    return "\n".join([head, *unused, *lines, "}\n"])


def _assigned(lines: list[str], k: int, value: str) -> str:
    lines.append(f"  const double a{k} = {value};")
    return f"a{k}"


def _used(lines: list[str], text: str) -> bool:
    return any(text in line for line in lines)
