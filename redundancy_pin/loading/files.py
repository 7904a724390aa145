"""Load a robot by its name or its file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TypeAlias

import numpy as np

from redundancy_pin.arrays import require_type
from redundancy_pin.errors import DeclarationError, ModelFileError
from redundancy_pin.kinematics.coordinates import gravity_acts
from redundancy_pin.loading.mechanism import OpenedModel, warn_once
from redundancy_pin.loading.undecided import require_decided, settled
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import too_few_motors
from redundancy_pin.robot.declaration import read_declaration, require_conditions
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE
from redundancy_pin.robot.formats.urdf import WITHOUT_INERTIAL
from redundancy_pin.robot.formats.xacro_file import known_values
from redundancy_pin.robot.model_files import is_model_file, open_model
from redundancy_pin.robot.propose import propose
from redundancy_pin.robot.shipped import declaration_path, is_shipped

RobotLike: TypeAlias = Robot | str | Path
"""A robot, the name of a shipped one, or the path of a declaration or of its folder."""


def as_robot(robot: RobotLike) -> Robot:
    """Return a robot, loaded as ``load_robot`` does if it is named: the first line of every function that takes one.

    Raises:
        InputError: neither a robot nor a name or path.
        RedundancyPinError: what ``load_robot`` raises.

    Example:
        >>> from redundancy_pin.loading import as_robot
        >>> as_robot("3rrr").n
        3
    """
    if isinstance(robot, (str, Path)):
        return load_robot(robot)
    require_type(robot, Robot, "A robot", "Pass load_robot(...), or the name or path of one.")
    return robot


def load_robot(
    source: str | Path,
    *,
    gravity: Sequence[float] | None = None,
    working_mode: Sequence[int] | None = None,
    trust: bool = False,
    untrusted: bool = False,
    **arguments: object,
) -> Robot:
    """Load a robot, close its chains at the declared reference and check its mobility.

    A robot is data: expressions in its files calculate and no more, and cannot cost more than a second or two.

    Args:
        source: name of a shipped robot ("2rpr", "delta", ...: ``redundancy-pin info``), path of a ``robot.yaml``, of
            the folder that holds one, or of a model file (URDF, xacro, MJCF, SDF) that states its loops and motors.
        gravity: (3,) acceleration of gravity in the world frame, m/s²; as declared when left out.
        working_mode: ±1 a leg; as declared when left out.
        trust: let the expressions of a xacro file be any Python, which runs with your rights, and let MJCF read files
            of other folders: for files whose author you trust.
        untrusted: let third-party compilers (xacro, MuJoCo's) read a stranger's file in a child process, which has
            limits of time and memory.
        **arguments: xacro arguments of the robot's URDF (``carrier_mass=2.0``). Model files without a declaration take
            ``base`` ("fixed" or "free") and ``actuated``, the motors ("a,b" or a list of names).

    Raises:
        ModelFileError: missing or broken files, expressions that are more than calculation, numbers that Pinocchio
            would read differently.
        InputError: an unknown xacro argument, a gravity or working mode of the wrong form.
        DeclarationError: a declaration that contradicts the URDF or itself: unknown names, joints in two roles, over-
            or under-constrained chains, a reference that does not close.

    Example:
        >>> rp.load_robot("3rrr", carrier_mass=2.0).carriers
        ('carrier_1', 'carrier_2', 'carrier_3')
    """
    robot = load_with(source, arguments, gravity=gravity, working_mode=working_mode, trust=trust, untrusted=untrusted)
    for note in filter(None, (idle_gravity(robot, gravity), too_few_motors(robot))):
        warn_once(note)
    return robot


def idle_gravity(robot: Robot, given: Sequence[float] | None) -> str:
    """Return a warning if a gravity that the user passed moves nothing; empty otherwise."""
    if given is None or not np.any(robot.gravity) or gravity_acts(robot):
        return ""
    return (
        f"gravity = {robot.gravity.tolist()} is normal to the plane in which {robot.name} moves: it has no effect on "
        "efforts."
    )


def load_with(
    source: str | Path,
    arguments: Mapping[str, object],
    *,
    gravity: Sequence[float] | None = None,
    working_mode: Sequence[int] | None = None,
    trust: bool = False,
    untrusted: bool = False,
) -> Robot:
    """Load a robot as ``load_robot``, with xacro arguments that come from a file.

    Among keywords, a file could name ``trust`` as one of them.
    """
    path, files = declaration_path(source), {"trust": trust, "untrusted": untrusted}
    opened = OpenedModel(path, gravity=gravity, working_mode=working_mode)
    if trust or not is_shipped(path) or is_model_file(path):
        return _load(opened, arguments, **files)
    # as written, since 1, 1.0 and True are three arguments of xacro; by a path that means the same in all folders
    key = path.resolve(), repr((sorted(arguments.items()), gravity, working_mode)), untrusted
    if (robot := _SHIPPED.get(key)) is None:
        robot = _load(opened, arguments, **files)
        if len(_SHIPPED) >= _MOST_KEPT:
            _SHIPPED.clear()
        _SHIPPED[key] = robot
    return replace(robot, model=robot.model.copy())  # of what is shared, all that can be changed


_SHIPPED: dict[tuple[Path, str, bool], Robot] = {}
"""Shipped robots, whose files do not change: sweeps, commands and tests load the same ones many times."""

_MOST_KEPT = 64


def _load(opened: OpenedModel, arguments: Mapping[str, object], *, trust: bool, untrusted: bool) -> Robot:
    """Load a mechanism with what a declaration adds to it, or without one."""
    if not (opened.data or is_model_file(opened.path)):
        declared = read_declaration(opened.path)
        with declared.naming():
            return _load(replace(opened, data=declared.data), arguments, trust=trust, untrusted=untrusted)
    data = opened.data
    file = opened.file
    try:
        parameters, read = open_model(file, arguments, trust=trust, untrusted=untrusted)
    except ModelFileError:
        if data and file.suffix.lower() == ".xacro":  # whose errors of a negative length, say, are cryptic
            with suppress(DeclarationError):  # conditions on what xacro would have evaluated
                require_conditions(data, known_values(file, arguments))
        raise
    require_conditions(data, parameters)
    opened = replace(opened, parameters=parameters)
    if data:
        kinds = opened.declaration().joint_types if data.get("joint_types") else {}
        robot = opened.robot(read(kinds, opened.named))
    else:
        proposal = propose(read(None, ()))
        require_decided(proposal, file)
        proposal, robot = settled(proposal, opened)
        require_decided(proposal, file)
    _log_notes(robot.notes, file)
    return replace(robot, urdf_folder=str(file.resolve().parent))


def _log_notes(notes: Iterable[str], file: Path) -> None:
    """Log the notes that change results: forces of the file that are ignored, links whose mass it does not state."""
    for note in notes:
        if note.startswith((NOT_IN_FORCE, WITHOUT_INERTIAL)):
            warn_once(f"{file.name}: {note}")
