"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio.

Names are imported when they are first used: a program pays for the subpackages it uses, and for no others. The stub
``__init__.pyi`` lists them, for type checkers and for this file.
"""

import ast
import importlib
import importlib.util
from pathlib import Path
from typing import Any

_PLACES = {
    name.asname or name.name: (node.module, name.name)
    for node in ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8")).body
    if isinstance(node, ast.ImportFrom) and node.module != "typing"
    for name in node.names
}
"""Module and name there of each public name."""

__all__ = sorted(_PLACES)
__version__ = "0.2.0"


def __getattr__(name: str) -> Any:
    """Import a public name, or a subpackage such as ``rp.errors``, when it is first used (PEP 562)."""
    module, original = _PLACES.get(name, (__name__, name))
    if module != __name__ and hasattr(place := importlib.import_module(module), original):
        value = getattr(place, original)
    elif name.startswith("_") or importlib.util.find_spec(f"{module}.{original}") is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    else:
        value = importlib.import_module(f"{module}.{original}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
