"""Robots with other masses, lengths or xacro arguments."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.errors import InputError
from redundancy_pin.loading.files import RobotLike, as_robot, load_with
from redundancy_pin.loading.mechanism import OpenedModel, select_rows, warn_once
from redundancy_pin.loading.reference import close_reference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.changes import changed_urdf, require_still_joined
from redundancy_pin.robot.declaration import read_declaration
from redundancy_pin.robot.loads import Load
from redundancy_pin.robot.lookup import has_joint, joint_names
from redundancy_pin.robot.model_files import is_model_file, is_urdf, mechanism_of_urdf
from redundancy_pin.robot.propose import propose
from redundancy_pin.robot.urdf import declaration_path


def with_parameters(
    robot: RobotLike,
    /,
    *,
    masses: Mapping[str, float] | None = None,
    lengths: Mapping[str, Any] | None = None,
    **arguments: object,
) -> Robot:
    """Return a robot with other masses, lengths or xacro arguments, closed and checked as when it was loaded.

    Gravity, working mode and loads stay; limits too, unless xacro arguments are given. A robot whose masses or
    lengths are changed has no closed form any more (``VirtualWork`` refuses it): that is written in the arguments.

    Args:
        robot: a robot, or its name or path.
        masses: kg, by link; the moments of inertia of a link grow as its mass does, its centre stays. (Derivatives
            by ``"JOINT.mass"`` hold the inertia about the centre: ``dynamics.compiled.design_of``.)
        lengths: by joint, its distance from the joint before it, m; or (3,) its place in the frame of its parent
            link, m. This moves joints and frames only: masses, centres and moments of inertia of the links stay as
            they were, which ``notes`` and the log say. Xacro arguments of a file change both.
        **arguments: xacro arguments, as of ``load_robot``; the others stay.

    Raises:
        InputError: unknown names, values out of their domain, a robot that was not loaded from a URDF, or lengths
            that part a frame of a closure or the platform from a joint or frame at the same place.
        DeclarationError: the chains do not close at the declared reference any more.

    Example:
        >>> heavier = with_parameters(load_robot("four_bar"), masses={"rocker_link": 2.5})
    """
    robot = as_robot(robot)
    masses, lengths = {} if masses is None else masses, {} if lengths is None else lengths
    path = declaration_path(robot.source) if robot.source else None
    file = None if path is None or is_model_file(path) else read_declaration(path)
    if path is None or not is_urdf(path if file is None else Path(file.data["urdf"])):
        raise InputError(
            f"{robot.name} was not loaded from a URDF.",
            remedy="Change its Pinocchio model, or its file, and make the robot of that.",
        )
    mode = robot.working_mode or None
    if arguments:
        if any(note.startswith(_CHANGED) for note in robot.notes):
            raise InputError(
                f"Masses or lengths of {robot.name} are changed already; its arguments would be read from its files.",
                remedy="Give the arguments first, or all in one call.",
            )
        loads = robot.loads
        robot = load_with(
            robot.source, {**robot.parameters, **arguments}, gravity=robot.gravity.tolist(), working_mode=mode
        )
        robot = _with_added(robot, loads)
    if not (masses or lengths):
        return robot
    with nullcontext() if file is None else file.naming():
        roles = {"actuated": list(robot.actuated), "independent": {"joints": list(robot.independent_joints)}}
        data = {"urdf": path.name, **roles} if file is None else file.data
        declaration = OpenedModel(path, data, robot.parameters).declaration()
        mechanism = mechanism_of_urdf(
            changed_urdf(robot.urdf, masses, lengths),
            path.parent / declaration.urdf,
            robot.parameters,
            None if file is None else declaration.joint_types,
        )
        if file is None:  # ends of loops that were found stay ends; the reference is the nearest closed configuration
            stated = {joint.name for joint in mechanism.loop_joints}
            found = [f"{each.frame_a},{each.frame_b}" for each in robot.closures if each.name not in stated]
            mechanism = propose(mechanism, close=found, is_open=True).mechanism
            if turned := [name for name in joint_names(mechanism.model) if not has_joint(robot.model, name)]:
                mechanism = mechanism.with_hinges(turned)  # the balls that moved freely when the robot was loaded
            mechanism = replace(mechanism, start=np.array(robot.q_reference))
        new, dropped = select_rows(
            declaration,
            mechanism,
            gravity=robot.gravity.tolist(),
            parameters=robot.parameters,
            source=robot.source,
            mode=mode,
            rods={each.name: each.length for each in robot.closures},
        )
        new = replace(
            new,
            name=robot.name,
            urdf_folder=robot.urdf_folder,
            carrier_limits=robot.carrier_limits,
            own_meshes_only=robot.own_meshes_only,
            closed_form=None,  # it is written in the arguments, which say something else now
            notes=(*robot.notes, f"{_CHANGED} {', '.join([*masses, *lengths])}", *_lengths_only(robot, lengths)),
        )
        for bound in ("lower", "upper"):
            for what in ("Position", "Velocity", "Effort"):
                setattr(new.model, f"{bound}{what}Limit", getattr(robot.model, f"{bound}{what}Limit"))
        if lengths:
            require_still_joined(robot, new)
            new = close_reference(new, declaration, robot.parameters, dropped)
        else:  # masses close no loop: the reference is that of the robot
            new = replace(new, q_reference=robot.q_reference, characteristic_length=robot.characteristic_length)
        return _with_added(new, robot.loads)


def _with_added(robot: Robot, loads: tuple[Load, ...]) -> Robot:
    """Return a robot that was read anew with the loads it got since: those of its files come first, and it has them."""
    added = loads[len(robot.loads) :]
    return robot.loaded(*added) if added else robot


_CHANGED = "changed since it was loaded:"
"""How a note begins that says so."""


def _lengths_only(robot: Robot, lengths: Iterable[str]) -> tuple[str, ...]:
    """Return a note that lengths change no masses, and log it; nothing without lengths."""
    if not (names := ", ".join(lengths)):
        return ()
    note = f"The lengths at {names} move joints and frames: links keep masses, centres and moments of inertia."
    warn_once(f"{robot.name}: {note}")
    return (note,)
