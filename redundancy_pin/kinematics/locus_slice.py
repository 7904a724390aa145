"""The slice of the workspace that a locus is drawn in: which coordinates vary, which are held, and how far they go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import find_on_branch
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.kinematics.workspace_grid import solve_grid
from redundancy_pin.robot import Robot

_REACH = 4.0
"""Half width of the search for the workspace, in characteristic lengths."""

_COARSE = 61
_BORDER = 0.03
"""Room left around the workspace, as a fraction of its size."""


@dataclass(frozen=True, eq=False)
class Slice:
    """Where a locus is drawn.

    Attributes:
        names: names of the coordinates that vary.
        units: of each, "m" or "rad".
        free: their columns in x.
        fixed: by name, the values of the coordinates that are held, rad.
        x: (n,) a point of the slice: the reference position, turned to the orientation of the slice.
        q: (nq,) the configuration there.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    free: tuple[int, ...]
    fixed: dict[str, float]
    x: Array
    q: Array


def slice_of(system: ConstraintSystem, orientation: float | None) -> Slice:
    """Return the slice of a robot through its reference position.

    Raises:
        UnsupportedRobotError: not planar.
        InputError: an orientation for a robot that has none, or one that is not finite.
        UnreachablePoseError, WorkingModeError: the reference position cannot be reached at this orientation.
    """
    robot = system.robot
    names, free = _free(robot)
    unit = "rad" if _turns(robot) else "m"
    held = tuple(column for column in range(robot.n) if column not in free)
    reference = np.array(robot.q_reference)
    x = np.array(coordinates(robot, system.evaluate(reference[None]))[0])
    if orientation is not None:
        if not held or not np.isfinite(orientation):
            raise InputError(
                f"orientation is {orientation}, and the coordinates of {robot.name} are {', '.join(_names(robot))}.",
                remedy="Leave it out for a robot without orientation; pass a finite angle in rad otherwise.",
            )
        x[held[0]] = orientation
        reference = find_on_branch(system, x)
    return Slice(
        names, (unit,) * len(free), free, {_names(robot)[column]: float(x[column]) for column in held}, x, reference
    )


def default_axes(system: ConstraintSystem, place: Slice, resolution: int) -> tuple[Array, ...]:
    """Return the grid that covers the workspace around a slice's start.

    A coarse grid finds how far the workspace goes; where it is not at an end after ``_REACH`` characteristic
    lengths it is cut there. A joint that turns is taken once round.
    """
    robot = system.robot
    if robot.platform is None:
        half = np.pi if _turns(robot) else _REACH * robot.characteristic_length
        return (np.linspace(place.x[0] - half, place.x[0] + half, resolution),)
    half = _REACH * robot.characteristic_length
    rough = tuple(np.linspace(place.x[c] - half, place.x[c] + half, _COARSE) for c in place.free)
    grid = solve_grid(system, place.free, rough, place.x, place.q)
    axes = []
    for column, axis in zip(place.free, rough, strict=True):
        reached = grid.x[grid.reachable, column]
        cell = axis[1] - axis[0]
        low, high = float(reached.min()) - cell, float(reached.max()) + cell
        room = _BORDER * (high - low)
        axes.append(np.linspace(max(low - room, axis[0]), min(high + room, axis[-1]), resolution))
    return tuple(axes)


def _turns(robot: Robot) -> bool:
    """Whether the first free coordinate is the angle of a joint."""
    if robot.platform is not None:
        return False
    joint = robot.model.joints[robot.model.getJointId(robot.independent_joints[0])]
    return not str(joint.shortname()).startswith("JointModelP")


def _names(robot: Robot) -> tuple[str, ...]:
    return robot.platform.axes if robot.platform else robot.independent_joints


def _free(robot: Robot) -> tuple[tuple[str, ...], tuple[int, ...]]:
    names = _names(robot)
    if robot.platform is None and robot.n == 1:
        return names, (0,)
    free = tuple(k for k, name in enumerate(names) if not name.startswith("r"))
    if robot.platform is None or len(free) != 2 or len(names) - len(free) > 1:
        raise UnsupportedRobotError(
            f"The singular locus of {robot.name} cannot be drawn: its coordinates are {', '.join(names)}.",
            remedy="A locus is for two translations with at most one rotation, or a single joint; of other robots "
            "look at the singular instants of a motion, with find_crossings.",
        )
    return tuple(names[k] for k in free), free
