"""Import paths of version 0.1.0 that its documentation showed: they still work, and say where the module is now."""

from __future__ import annotations

import importlib
import importlib.util
import sys
import warnings
from collections.abc import Sequence
from importlib.machinery import ModuleSpec
from types import ModuleType

MOVED = {
    "dynamics.status": "dynamics.distribution",
    "experiments": "studies",
    "files": "io.files",
    "kinematics.modes": "kinematics.coordinates",
    "kinematics.singular_crossings": "singularities.crossings",
    "kinematics.singular_locus": "singularities.locus",
    "kinematics.singularity": "singularities.classify",
    "kinematics.state": "kinematics.inverse_kinematics",
    "kinematics.three_rrr": "dynamics.virtual_work.three_rrr",
    "kinematics.two_rpr": "dynamics.virtual_work.two_rpr",
    "planners.plan_file": "planners.plan",
    "simulation.control": "simulation.controllers.base",
    "simulation.reference": "planners.reference",
    "visualisation.live_view": "visualisation.viewer.page",
    "visualisation.plots": "visualisation.figures.plots",
    "visualisation.scene": "visualisation.viewer.scene",
    "visualisation.show": "visualisation.viewer.page",
    "visualisation.snapshots": "visualisation.figures.paths",
    "visualisation.style": "visualisation.figures.style",
}
"""Old module to new one, below the package; a package stands for what is in it."""


class _Finder:
    """Puts the module that is there now under the old name too.

    No base of ``importlib.abc``: its import takes a fifth of all that ``import redundancy_pin`` does.
    """

    def create_module(self, spec: ModuleSpec) -> None:
        """Leave it to the import system."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        new = _new_name(fullname)
        try:
            there = new is not None and importlib.util.find_spec(new) is not None
        except ModuleNotFoundError:  # not even the package it would be in
            there = False
        return ModuleSpec(fullname, self) if there else None  # type: ignore[arg-type]

    def exec_module(self, module: ModuleType) -> None:
        new = _new_name(module.__name__)
        if new is None:  # find_spec offers only names it knows
            raise ImportError(f"{module.__name__} has not moved.")
        warnings.warn(f"{module.__name__} is now {new}.", DeprecationWarning, stacklevel=2)
        # the import system hands out what stands in sys.modules after this
        sys.modules[module.__name__] = importlib.import_module(new)


def _new_name(name: str) -> str | None:
    package, _, rest = name.partition(".")
    for old, new in MOVED.items():
        if package == __package__ and (rest == old or rest.startswith(f"{old}.")):
            return f"{package}.{new}{rest.removeprefix(old)}"
    return None


def install() -> None:
    """Let the import system know, before it looks for files: old and new modules may share a folder."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())
