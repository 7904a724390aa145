"""Make a robot of a declaration and a mechanism: roles, independent closure rows, reference configuration."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np

from redundancy_pin.arrays import AGREEMENT_TOLERANCE, checked, frozen
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.selection import Selection, selected
from redundancy_pin.loading.reference import close_reference
from redundancy_pin.robot import Closure, Robot
from redundancy_pin.robot.build import read_robot
from redundancy_pin.robot.declaration import Declaration, parse
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.formats.xacro_file import Argument
from redundancy_pin.robot.model_files import is_urdf, states_gravity
from redundancy_pin.robot.rebuild import span
from redundancy_pin.robot.shipped import source_of


def build_robot(
    data: Mapping[str, Any],
    mechanism: Mechanism,
    *,
    drop_dependent: bool,
    gravity: Sequence[float] | None = None,
    mode: Sequence[int] | None = None,
    parameters: Mapping[str, Argument] = MappingProxyType({}),
    source: str = "",
    own_model: bool = False,
) -> Robot:
    """Return the robot of a declaration and a mechanism.

    Args:
        data: the declaration, checked here; without ``independent`` joints are chosen.
        mechanism: the tree, which becomes the robot's own; the search for the reference begins at its start.
        drop_dependent: leave out dependent closure rows.
        gravity: (3,) m/s²; the model's when left out.
        mode: ±1 a leg; as declared when left out.
        parameters: of the robot.
        source: of a robot that was read from a file, whose numbers may be rounded.
        own_model: the tree is the user's; its joints are not replaced.
    """
    choose = not data.get("independent")
    declaration = parse({**data, "independent": {"joints": list(data["actuated"])}} if choose else data, parameters)
    robot, dropped = select_rows(
        declaration,
        mechanism,
        gravity=gravity,
        drop_dependent=drop_dependent,
        choose=choose,
        parameters=parameters,
        source=source,
        mode=mode,
        own_model=own_model,
    )
    return close_reference(robot, declaration, parameters, dropped)


def select_rows(
    declaration: Declaration,
    mechanism: Mechanism,
    *,
    gravity: Sequence[float] | None = None,
    drop_dependent: bool = False,
    choose: bool = False,
    **of: Any,
) -> tuple[Robot, bool]:
    """Return the robot, its reference not closed yet, and whether dependent closure rows were left out.

    They are left out on demand (``drop_dependent``), where the declaration expects them, and where joints close loops:
    joints of a planar mechanism constrain more than it needs. Gravity is the given one, the
    declaration's, or the model's.
    """
    if gravity is not None:
        mechanism.model.gravity.linear = np.array(checked(gravity, "gravity", (3,)))
    elif "gravity" in declaration.model_fields_set:
        mechanism.model.gravity.linear = np.array(declaration.gravity)
    robot = read_robot(declaration, mechanism, **of)
    has_joints = bool(declaration.loop_joints or mechanism.loop_joints)
    drop_dependent = drop_dependent or declaration.redundant_rows or has_joints
    if not (drop_dependent or choose):
        return robot, False
    model, resisted = robot.model, {load.joint for load in mechanism.forces}
    resisted |= {str(model.names[i]) for i in range(1, model.njoints) if np.any(model.armature[span(model, i, "v")])}
    selection = selected(
        replace(robot, platform=None, independent_joints=()),
        np.array(robot.q_reference),
        redundant=drop_dependent,
        declared=None if choose else robot.n,
        resisted=resisted,
    )
    kept, notes, every = selection.robot, [*robot.notes, *_notes(selection)], robot.closures
    robot = replace(robot, model=kept.model, closures=kept.closures, couplings=kept.couplings)
    if selection.left_out:
        # rows that are left say less of the side on which a weld closes: what follows starts on the right one
        robot = replace(
            robot,
            q_reference=frozen(selection.q),
            all_closures=_with_redundant_rows(kept.closures, every),
            dependent_residual=selection.opened,
        )
    if choose:
        notes.append(f"Independent joints, chosen: {', '.join(selection.independent)}.")
        robot = replace(robot, independent_joints=selection.independent)
    return replace(robot, notes=tuple(notes)), drop_dependent


def _notes(selection: Selection) -> Iterator[str]:
    """Yield notes on a choice of closure rows."""
    if selection.fixed_spins:
        yield (
            f"The spin of {', '.join(selection.fixed_spins)} about the line between two balls, which moves nothing "
            "else, is held: one ball is a universal joint, the first where it has damping or armature; where both "
            "have, this is an approximation."
        )
    if selection.off_axis:
        listed = ", ".join(f"{name} by {away:.2g} m" for name, away in selection.off_axis.items())
        yield (
            f"The centre of mass is off that line: {listed}. There a rod between two balls swings, which is left out: "
            "what holds its spin carries the moment."
        )
    if selection.left_out:
        rows, opened = ", ".join(selection.left_out), selection.opened
        nearby = (
            f" to {opened:.1g} (characteristic lengths or rad) nearby: numbers are rounded, or the loops move to first "
            "order only"
            if opened > AGREEMENT_TOLERANCE
            else ""
        )
        yield f"Redundant closure rows left out, the loops stay closed in them{nearby}: {rows}."


def _with_redundant_rows(closures: tuple[Closure, ...], all_rows: tuple[Closure, ...]) -> tuple[Closure, ...]:
    """Return closures with the axes that they have among all; empty if no axis is missing.

    A closure between other frames than before, as if the spin of a rod is fixed, has all its axes.
    """
    given = {(each.name, each.frame_a, each.frame_b): each for each in all_rows}
    whole = [given.get((each.name, each.frame_a, each.frame_b), each) for each in closures]
    names = {each.name for each in closures}
    whole += [each for each in all_rows if each.name not in names]
    return tuple(whole) if whole != list(closures) else ()


_LOG = logging.getLogger("redundancy_pin.loading")


@lru_cache(maxsize=100)
def warn_once(text: str) -> None:
    """Log a warning, once per process."""
    _LOG.warning(text)


# --- of a file --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class OpenedModel:
    """A model file whose arguments are known, its declaration, and the user's gravity and working mode.

    Attributes:
        path: the declaration, or the model file without one.
        data: the declaration, not checked yet; empty without one.
        parameters: arguments of the model file, with their values.
        gravity: (3,) m/s²; None for the gravity of the files.
        working_mode: ±1 per leg; None for the declared one.
    """

    path: Path
    data: Mapping[str, Any] = field(default_factory=dict)
    parameters: Mapping[str, Argument] = field(default_factory=dict)
    gravity: Sequence[float] | None = None
    working_mode: Sequence[int] | None = None

    @property
    def file(self) -> Path:
        """The model file."""
        return self.path.parent / self.data["urdf"] if self.data else self.path

    @property
    def complete_data(self) -> dict[str, Any]:
        """The declaration, with defaults for what may be left out."""
        return {"name": self.path.resolve().parent.name, "reference": {}, **self.data}

    @property
    def named(self) -> tuple[str, ...]:
        """The joints that the declaration drives or has as independent ones."""
        roles = (
            self.data.get("actuated"),
            of.get("joints") if isinstance(of := self.data.get("independent"), dict) else (),
        )
        return tuple(str(name) for names in roles if isinstance(names, list) for name in names)

    def declaration(self) -> Declaration:
        """Return the declaration, checked."""
        return parse(self.complete_data, self.parameters)

    def robot(self, mechanism: Mechanism) -> Robot:
        """Return the robot of a mechanism, with three hinges in place of each ball that moves freely.

        Raises:
            DeclarationError: as ``build_robot``; the file drives no joint.
        """
        try:
            return self._build(mechanism)
        except DeclarationError as error:
            if "balls" not in error.details:
                raise
            hinged = mechanism.with_hinges(cast("tuple[str, ...]", error.details["balls"]))
        return self._build(hinged)

    def _build(self, mechanism: Mechanism) -> Robot:
        """Return the robot, its roles from the declaration, otherwise from the file."""
        given = self.complete_data if self.data else {"name": mechanism.name, "reference": {}}
        if mechanism.carriers:
            given = {"carriers": [{"joint": name} for name in mechanism.carriers], **given}
        if mechanism.independent:
            given = {"independent": {"joints": list(mechanism.independent)}, **given}
        given = {"urdf": self.file.name, "actuated": list(mechanism.actuated), **given}
        if not given["actuated"]:
            named = "Name what is driven under `actuated`." if self.data else "It has no joint that could be: add one."
            raise DeclarationError(f"{self.file.name} drives no joint.", remedy=named)
        if is_declared_urdf := bool(self.data) and is_urdf(self.file):
            given = {"gravity": [0.0, 0.0, 0.0], **given}  # which a URDF does not state
        robot = build_robot(
            given,
            replace(mechanism, model=mechanism.model.copy()),  # it gets frames, and may be needed again
            gravity=self.gravity,
            drop_dependent=not is_declared_urdf,
            mode=self.working_mode,
            parameters=self.parameters,
            source=source_of(self.path),
        )
        if self.gravity is not None or "gravity" in self.data or states_gravity(self.file):
            return robot
        stated = robot.gravity.tolist()
        note = f"No file states gravity: it is {stated} m/s²; gravity=... or a robot.yaml states another."
        return replace(robot, notes=(*robot.notes, note))
