"""Names and numbers of generated C: every one that can be seen outside a function begins with the robot's prefix.

What a program includes in front of the code, or behind it, is not known here: names of math.h differ between -std=c99
and a compiler's own mode, headers of a vendor define what they like, and two robots may be compiled as one file. So
no list of names that are taken is kept; all names of a file's scope are found and given the prefix.
"""

from __future__ import annotations

import re

import numpy as np
from numpy.typing import ArrayLike

_TEXTS = re.compile(r"""(/\*.*?\*/|"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')""", re.S)
"""Comments, strings and characters."""

_KEYWORDS = frozenset(
    "char const double enum float if int long return short signed sizeof static struct unsigned void".split()  # noqa: SIM905
)

_BLOCK, _LIST = "\0", "\1"
"""What stands for {…} and for (…) where only what is outside of them matters."""


def file_scope_names(text: str) -> set[str]:
    """Return the names of a C file's scope: macros, types, enumerators, functions and variables, one a declaration."""
    code = _TEXTS.sub(" ", text)
    names = set(re.findall(r"^[ \t]*#[ \t]*define[ \t]+(\w+)", code, flags=re.M))
    code = re.sub(r"#ifdef __cplusplus\n.*?#endif", "", code, flags=re.S)  # extern "C", which opens no scope
    code = re.sub(r"^[ \t]*#.*", "", code, flags=re.M)
    for listed in re.findall(r"\benum\b[^{};]*\{([^{}]*)\}", code):
        names.update(re.findall(r"(\w+)[^,]*", listed))
    code = _replace_nested(r"\([^()]*\)", _LIST, _replace_nested(r"\{[^{}]*\}", _BLOCK, code))
    names.update(re.findall(rf"(\w+)\s*{_LIST}", code))
    names.update(re.findall(r"(\w+)\s*(?:\[[^\]]*\]\s*)*(?:=[^;]*)?;", code))
    return names


def _replace_nested(pattern: str, mark: str, code: str) -> str:
    """Return the code with what the pattern encloses, however deep, replaced by a mark."""
    count = 1
    while count:
        code, count = re.subn(pattern, mark, code)
    return code


def add_prefix(text: str, prefix: str) -> str:
    """Return a C file whose names of file scope begin with the prefix.

    Names of the header are written ``robot_name`` and ``ROBOT_NAME`` in the text, and become ``prefix_name`` and
    ``PREFIX_NAME``; the file's own become ``prefix_own_name`` and ``PREFIX_OWN_NAME``. So no prefix makes one of the
    other. Names that belong to the compiler stay: those with an underscore in front, and main.
    """
    own = {name for name in file_scope_names(text) - _KEYWORDS - {"main"} if not name.startswith("_")}

    def renamed(found: re.Match[str]) -> str:
        name = found[0]
        if name.startswith(("robot_", "ROBOT_")):
            return (prefix if name[0] == "r" else prefix.upper()) + name.removeprefix(name[:5])
        if name not in own:
            return name
        return f"{prefix.upper()}_OWN_{name}" if name.isupper() else f"{prefix}_own_{name}"

    # members of structures are names of their own
    pattern = re.compile(r"(?<!->)(?<!\.)\b[A-Za-z]\w*")
    parts = _TEXTS.split(text)
    parts[::2] = [pattern.sub(renamed, code) for code in parts[::2]]
    return "".join(parts)


def as_initialiser(values: ArrayLike) -> str:
    """Return an initialiser in C of a number or an array."""
    array = np.asarray(values)
    if array.ndim:
        return "{" + ", ".join(as_initialiser(part) for part in array) + "}"
    if array.dtype.kind == "i":
        return str(int(array))
    number = float(array)
    if np.isnan(number):
        return "NAN"
    return repr(number) if np.isfinite(number) else "INFINITY" if number > 0.0 else "-INFINITY"
