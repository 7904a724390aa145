"""The text of a robot.yaml for a model file: what is certain of it, and a question for the rest."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

from redundancy_pin.loading.reference import reference_positions
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import joint_names
from redundancy_pin.robot.model_files import is_urdf
from redundancy_pin.robot.propose import Proposal

FIRST_LINE = "# Written by `redundancy-pin new`.\n"
"""Of every such file."""


def declaration_text(
    proposal: Proposal,
    robot: Robot | None,
    model: str,
    settings: Mapping[str, Any],
    *,
    is_near_guess: bool,
    platform: Mapping[str, Any] = MappingProxyType({}),
) -> str:
    """Return the text of the declaration; what is not certain is left out, or a question under ``undecided``.

    Args:
        proposal: what is certain of the mechanism, and the questions.
        robot: made of it; None where none can be made yet.
        model: path of the model file, as the declaration names it.
        settings: arguments of the model file, which are no part of the declaration.
        is_near_guess: the reference is near a guess, and not where the model file starts.
        platform: the link and the axes that motions are given in, ``platform`` and ``axes``; joints if empty.
    """
    import jinja2

    positions: dict[str, float] = {}
    independent: list[str] = list(robot.independent_joints) if robot else []
    if robot and is_near_guess:
        at = reference_positions(robot)
        positions = {name: round(value, 9) for name, value in at.items() if name not in robot.carriers}
    if proposal.questions or not set(independent) <= {*joint_names(proposal.mechanism.model)}:
        independent = []  # not known, or of hinges that stand for a ball of the file
    environment = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.loading", ""), trim_blocks=True)
    environment.filters["quoted"] = lambda value: json.dumps(value, ensure_ascii=False)
    environment.filters["printable"] = lambda text: "".join(each if each.isprintable() else "\ufffd" for each in text)
    given = (
        f"--set {name}={str(value).lower() if value in (True, False) else value}" for name, value in settings.items()
    )
    text: str = environment.get_template("robot.yaml.j2").render(
        proposal=proposal,
        arguments=" ".join(given),
        path=model,
        is_urdf=is_urdf(Path(model)),
        positions=positions,
        independent=independent,
        platform=platform,
    )
    return text + "\n"


def is_undecided(path: Path) -> bool:
    """Return whether a file is one of these whose questions are open."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    return text.startswith(FIRST_LINE) and "\nundecided:\n" in text
