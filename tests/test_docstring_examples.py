"""Examples in docstrings of public names run as they are written, in a folder with the files that they name."""

from __future__ import annotations

import doctest
import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from doc_blocks import blocks_of

import redundancy_pin as rp

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "docs"))
from api_pages import public_modules  # noqa: E402 - it lies in docs

FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE


def _examples() -> dict[str, Any]:
    """Return the public functions and classes that have an example, by one of their names."""
    found: dict[int, tuple[str, Any]] = {}
    for module in public_modules():
        for name in getattr(importlib.import_module(module), "__all__", ()):
            thing = getattr(importlib.import_module(module), name)
            if (inspect.isfunction(thing) or inspect.isclass(thing)) and ">>>" in (thing.__doc__ or ""):
                found.setdefault(id(thing), (f"{module}.{name}", thing))
    return dict(found.values())


EXAMPLES = _examples()


@pytest.mark.long_for(
    "redundancy_pin.exciting_motion", "redundancy_pin.simulation.controllers.TimeVaryingLqr", "redundancy_pin.sweep"
)
@pytest.mark.parametrize("name", EXAMPLES)
def test_an_example_runs_as_written(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (motion,) = (
        block.text
        for block in blocks_of(ROOT / "docs/reference/files.md", "files")
        if "motion.csv" in block.marks.values()
    )
    (tmp_path / "motion.csv").write_text(motion, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    thing = EXAMPLES[name]
    finder = doctest.DocTestFinder(recurse=False)
    for example in finder.find(thing, name, globs={"rp": rp, "np": np}):
        assert doctest.DocTestRunner(optionflags=FLAGS).run(example).failed == 0


def test_every_public_function_has_an_example() -> None:
    without = []
    for module in ("redundancy_pin", "redundancy_pin.simulation", "redundancy_pin.trajectory"):
        for name in importlib.import_module(module).__all__:
            thing = getattr(importlib.import_module(module), name)
            if inspect.isfunction(thing) and ">>>" not in (thing.__doc__ or ""):
                without.append(f"{module}.{name}")
    assert not without
