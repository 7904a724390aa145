"""No file of the package imports itself through others: at the top, inside functions, by names in strings."""

from __future__ import annotations

import ast
import functools
import graphlib
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TypeGuard

import pytest

import redundancy_pin as rp

ROOT = Path(rp.__file__).parent
BY_NAME = {"import_module", "__import__"}
"""Functions that take the name of a module."""

COMPUTED = {
    "redundancy_pin": "public names, from its table",
    "redundancy_pin.cli": "commands, from its table",
    "redundancy_pin.errors": "optional libraries, or the remedy",
    "redundancy_pin.robot.formats.xacro_engine": "a private copy of the library xacro",
}
"""Modules that import by a name that they compute, and what they import."""


def files_of(root: Path) -> dict[str, Path]:
    """Return the modules of a package by their full names."""
    names = {path: (root.name, *path.relative_to(root).with_suffix("").parts) for path in root.rglob("*.py")}
    return {".".join(name[:-1] if name[-1] == "__init__" else name): path for path, name in names.items()}


def run_nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may run: everything but the imports that type checkers alone read."""
    to_do = [node]
    while to_do:
        yield (here := to_do.pop())
        typing = isinstance(here, ast.If) and last_name(here.test) == "TYPE_CHECKING"
        to_do += here.orelse if typing else ast.iter_child_nodes(here)


def names_in(node: ast.AST, package: str) -> set[str]:
    """Return names of modules, or of what is in them, that a statement or call imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        above = package.split(".")[: 1 - node.level or None] if node.level else []
        module = ".".join([*above, *([node.module] if node.module else [])])
        return {f"{module}.{alias.name}" for alias in node.names}
    if is_by_name(node):
        text = ast.literal_eval(node.args[0]) if isinstance(node.args[0], ast.Constant) else ""
        return {f"{package}{text}" if text.startswith(".") else text}
    return set()


def is_by_name(node: ast.AST) -> TypeGuard[ast.Call]:
    """Return whether a node is a call that imports a module by its name."""
    return isinstance(node, ast.Call) and last_name(node.func) in BY_NAME


def last_name(node: ast.AST) -> str:
    """Return the last of the names that dots join in an expression; empty for any other expression."""
    return node.id if isinstance(node, ast.Name) else node.attr if isinstance(node, ast.Attribute) else ""


@functools.cache
def tree_of(text: str) -> ast.Module:
    return ast.parse(text)


def graph_of(root: Path) -> dict[str, set[str]]:
    """Return by module the modules of the package that it imports."""
    files, graph = files_of(root), {}
    for name, path in files.items():
        package = name if path.name == "__init__.py" else name.rpartition(".")[0]
        found = set()
        for node in run_nodes(tree_of(path.read_text(encoding="utf-8"))):
            for target in names_in(node, package):
                module = target if target in files else target.rpartition(".")[0]
                if module in files and module != name:
                    found.add(module)
        graph[name] = found
    return graph


def circle(graph: Mapping[str, set[str]]) -> list[str]:
    """Return modules of which each imports itself through the others; none where imports point one way."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return sorted(set(error.args[1]))
    return []


def test_no_file_imports_itself_through_others() -> None:
    graph = graph_of(ROOT)
    assert "redundancy_pin.kinematics.selection" in graph["redundancy_pin.loading.mechanism"]
    # the package's own __init__ names what it offers in a table, and imports it when it is asked for
    assert circle({name: found - {"redundancy_pin"} for name, found in graph.items()}) == []


def test_names_of_modules_are_computed_where_it_is_written_down() -> None:
    """Elsewhere a string names the module, and the test above sees it."""
    computing = {
        name
        for name, path in files_of(ROOT).items()
        for node in ast.walk(tree_of(path.read_text(encoding="utf-8")))
        if is_by_name(node) and not isinstance(node.args[0], ast.Constant)
    }
    assert computing == set(COMPUTED)


@pytest.mark.parametrize(
    "back",
    [
        "from small.low import x",
        "from .low import x",
        "from . import low",
        "import small.low",
        "def f():\n    from small.low import x",
        "import importlib\ndef f():\n    importlib.import_module('small.low').x()",
        "from importlib import import_module\nimport_module('.low', 'small')",
        "__import__('small.low')",
    ],
)
def test_a_circle_of_any_kind_is_found(back: str, tmp_path: Path) -> None:
    root = tmp_path / "small"
    root.mkdir()
    (root / "__init__.py").write_text("", encoding="utf-8")
    (root / "low.py").write_text("def f():\n    from small.middle import y\n", encoding="utf-8")
    (root / "middle.py").write_text("from small import high\n", encoding="utf-8")
    (root / "high.py").write_text(back, encoding="utf-8")
    assert circle(graph_of(root)) == ["small.high", "small.low", "small.middle"]
    guarded = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    from small.low import x\n"
    (root / "high.py").write_text(guarded, encoding="utf-8")
    assert circle(graph_of(root)) == []
