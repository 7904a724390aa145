"""The pages of the API reference: one for every module whose names are public, written when the site is built."""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import Mapping
from pathlib import Path
from types import ModuleType

import redundancy_pin

NAMES: Mapping[str, str] = {
    "redundancy_pin": "redundancy_pin (rp)",
    "redundancy_pin.visualisation.plots": "rp.plot",
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
    "redundancy_pin.experiments.beyond",
    "redundancy_pin.experiments.planned",
)
"""Modules with an ``__all__`` that other pages describe, or that only the package itself imports."""


def public_modules() -> list[str]:
    """Return the names of all modules that say what is public, the package itself first."""
    found = ["redundancy_pin"]
    for module in pkgutil.walk_packages(redundancy_pin.__path__, "redundancy_pin."):
        if module.name.startswith(NOT_AN_API):
            continue
        if module.name in WITHOUT_ALL or getattr(importlib.import_module(module.name), "__all__", None):
            found.append(module.name)
    return found


def write_pages(folder: Path) -> None:
    """Write a page for each public module into a folder, and remove those of modules that are gone."""
    folder.mkdir(exist_ok=True)
    modules = public_modules()
    for path in folder.glob("*.md"):
        if path.stem not in modules:
            path.unlink()
    for name in modules:
        path, text = folder / f"{name}.md", page(importlib.import_module(name))
        if not path.is_file() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")


def page(module: ModuleType) -> str:
    """Return the page of a module as Markdown."""
    title = NAMES.get(module.__name__, module.__name__)
    return f"# {title}\n\n```{{eval-rst}}\n.. automodule:: {module.__name__}\n   :members:\n```\n"
