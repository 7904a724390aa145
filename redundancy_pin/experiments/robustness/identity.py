"""What the trials of a study depend on: all that must be the same where a journal is taken up again."""

from __future__ import annotations

import hashlib
import importlib.metadata
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import redundancy_pin
from redundancy_pin.experiments.journal import DIGITS
from redundancy_pin.experiments.robustness.draws import Imperfections
from redundancy_pin.experiments.robustness.scenarios import MASS, PLANNED_TRACK, Scenario
from redundancy_pin.experiments.robustness.trial import ATOL, RTOL
from redundancy_pin.robot.urdf import models_root
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr, bryson_weights

LIBRARIES = ("casadi", "numpy", "pin", "scipy")
"""Whose versions may change a digit of a plan or a simulation."""

UNUSED = ("cli", "crosscheck", "experiments", "view.py", "visualisation", "workers.py")
"""Parts of the package that no trial uses, but for its own modules in ``experiments``."""

OWN = ("draws.py", "scenarios.py", "trial.py")


def identity(bounds: Imperfections, seed: int, scenarios: Sequence[Scenario]) -> dict[str, Any]:
    """Return what decides the outcome of each trial but scenario, drive and number, as plain data.

    What says most to a user comes first; a change of the code that nothing else tells is in the digest at the end.

    Args:
        bounds: of the draws, scaled.
        seed: of the draws.
        scenarios: the crossings.
    """
    return {
        "seed": seed,
        "imperfections": asdict(bounds),
        "scenarios": [asdict(one) for one in scenarios],
        "machine": {**MASS, "planned_track": PLANNED_TRACK},
        "tolerances": [RTOL, ATOL],
        "computed torque": _defaults(ComputedTorque.__init__),
        "LQR": {**_defaults(TimeVaryingLqr.__init__), **_defaults(bryson_weights)},
        "encoders": _defaults(Encoders.__init__),
        "libraries": {name: _version(name) for name in LIBRARIES},
        "code": code_digest(),
    }


def code_digest() -> str:
    """Return a hash of the source files of the package that trials use, and of the shipped models."""
    root, models = Path(redundancy_pin.__file__).parent, models_root()
    parts = [path for path in root.iterdir() if path.name not in (*UNUSED, models.name)]
    files = [file for part in parts for file in ([part] if part.is_file() else part.rglob("*.py"))]
    files += [root / "experiments" / "robustness" / name for name in OWN]
    named = {f"package/{file.relative_to(root)}": file for file in files if file.suffix == ".py"}
    named.update({f"models/{file.relative_to(models)}": file for file in models.rglob("*") if file.is_file()})
    found = hashlib.sha256()
    for name in sorted(named):
        # line ends differ between systems
        found.update(f"{name}\n".encode() + named[name].read_bytes().replace(b"\r\n", b"\n") + b"\n")
    return found.hexdigest()[:DIGITS]


def _defaults(made: Callable[..., Any]) -> Mapping[str, float]:
    """Return the settings with which the study makes something: the numbers among the defaults."""
    given: Mapping[str, object] = getattr(made, "__kwdefaults__", None) or {}
    return {name: value for name, value in given.items() if isinstance(value, (int, float))}


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""
