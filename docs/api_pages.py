"""The pages of the API reference: one for every module whose names are public, written when the site is built."""

from __future__ import annotations

import importlib
import inspect
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import redundancy_pin

NAMES: Mapping[str, str] = {
    "redundancy_pin": "redundancy_pin (rp)",
    "redundancy_pin.visualisation.figures.plots": "rp.plot",
    "redundancy_pin.trajectory": "rp.trajectory",
    "redundancy_pin.trajectory.reference": "rp.trajectory.reference",
    "redundancy_pin.simulation": "rp.simulation",
}
"""What users call a module, where that is not its name."""

WITHOUT_ALL = ("redundancy_pin.trajectory.reference", "redundancy_pin.errors")
"""Modules of which everything is public, and which therefore have no ``__all__``."""

NOT_AN_API = (
    "redundancy_pin.cli",
    "redundancy_pin.dynamics",
)
"""Modules with an ``__all__`` that other pages describe, or that only the package itself imports."""


def public_modules() -> list[str]:
    """Return the names of all modules that say what is public, the package itself first."""
    modules = ["redundancy_pin"]
    for module in pkgutil.walk_packages(redundancy_pin.__path__, "redundancy_pin."):
        if module.name.startswith(NOT_AN_API):
            continue
        if module.name in WITHOUT_ALL or getattr(importlib.import_module(module.name), "__all__", None):
            modules.append(module.name)
    return modules


def write_pages(folder: Path) -> None:
    """Write a page for each public module into a folder, and remove those of modules that are gone."""
    folder.mkdir(exist_ok=True)
    modules = public_modules()
    for path in folder.glob("*.md"):
        if path.stem not in modules:
            path.unlink()
    described: dict[int, str] = {}
    for name in modules:
        (folder / f"{name}.md").write_text(page(importlib.import_module(name), described), encoding="utf-8")
    (folder.parent / "names.md").write_text(index(modules), encoding="utf-8")


def index(modules: list[str]) -> str:
    """Return a page with one sentence for each public function and class, as Markdown."""
    text, seen = "# All names, a sentence each\n", set[int]()
    for module in map(importlib.import_module, modules):
        public = {name: getattr(module, name) for name in getattr(module, "__all__", ())}
        new = {name: value for name, value in public.items() if callable(value) and id(value) not in seen}
        seen |= {id(value) for value in new.values()}
        rows = "".join(f"| `{name}` | {sentence(value)} |\n" for name, value in sorted(new.items()))
        title = NAMES.get(module.__name__, module.__name__)
        text += f"\n## [{title}](modules/{module.__name__}.md)\n\n| name | |\n|---|---|\n{rows}" if rows else ""
    return text


def sentence(value: object) -> str:
    """Return the first sentence of a docstring, for a table."""
    lines = (inspect.getdoc(value) or "").partition("\n\n")[0].split("\n")
    return " ".join(lines).replace("``", "`").replace("|", "\\|")


def page(module: ModuleType, described: dict[int, str]) -> str:
    """Return the page of a module as Markdown.

    Args:
        module: the module.
        described: identity of what has been described, with the name of the module; what is new is added.
    """
    title = NAMES.get(module.__name__, module.__name__)
    public = {name: getattr(module, name) for name in getattr(module, "__all__", ())}
    twice = {name: described[id(value)] for name, value in public.items() if id(value) in described}
    described.update({id(value): module.__name__ for name, value in public.items() if name not in twice})
    options = "   :members:\n" + (f"   :exclude-members: {', '.join(twice)}\n" if twice else "")
    elsewhere = "".join(f"- `{name}`: see [{NAMES.get(where, where)}]({where}.md)\n" for name, where in twice.items())
    text = f"# {title}\n\n```{{eval-rst}}\n.. automodule:: {module.__name__}\n{options}```\n"
    return text + (f"\nAlso here:\n\n{elsewhere}" if twice else "")
