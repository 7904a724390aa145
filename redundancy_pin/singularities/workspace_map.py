"""Where a platform can go, and how far from singularities it is there: slices and clouds of any robot.

Nodes of a grid over two or three translations, the other coordinates held, are solved by continuation from the
reference (``workspace``), in each working mode by itself. Islands, which are not connected to the start inside the
slice, are looked for from random starts at a few nodes that were not reached, and spread from there.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    IntArray,
    blocks,
    checked,
    frozen,
    one_of,
    read_only,
    require_few,
    require_type,
)
from redundancy_pin.errors import (
    InputError,
    RedundancyPinError,
    UnsupportedRobotError,
    WorkingModeError,
    did_you_mean,
    shown,
)
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import all_working_modes, coordinates
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.named import is_pose
from redundancy_pin.robot.scales import is_revolute
from redundancy_pin.singularities.classify import margins_of
from redundancy_pin.singularities.workspace import Slice, default_axes, solve_grid

_MOST_NODES = 200_000
_FARTHEST = 1e9
"""Bounds in characteristic lengths: squares of numbers beyond any machine overflow."""
_RESOLUTION = {1: 400, 2: 100, 3: 25}
"""Nodes along each axis, by the number of axes."""


@dataclass(frozen=True, eq=False)
class Workspace(Frozen):
    """A slice of the workspace, or a cloud of points in it; made by ``workspace``. M working modes.

    Attributes:
        robot: the robot.
        names: of the coordinates that vary, such as ("x", "z").
        units: of each, "m" or "rad".
        axes: (A,), (B,), ... the grid along each.
        x: (A·B·…, n) coordinates or (A·B·…, 4, 4) poses of all nodes, the last axis running fastest.
        modes: working modes, ±1 a leg; one empty one where the robot declares none.
        reachable: (M, A, B, …) whether the chains close there in each mode.
        in_range: (M, A, B, …) reachable with all joints within their ranges.
        margin: (M, A, B, …) signed scaled margin to type II, NaN where not reachable.
        serial_margin: (M, A, B, …) scaled margin to type I.
        island: (M, A, B, …) 0 where the start of the mode reaches without leaving the slice, 1, 2, … in parts that it
            does not reach, −1 where not reachable.
    """

    robot: Robot
    names: tuple[str, ...]
    units: tuple[str, ...]
    axes: tuple[Array, ...]
    x: Array
    modes: tuple[tuple[int, ...], ...]
    reachable: BoolArray
    in_range: BoolArray
    margin: Array
    serial_margin: Array
    island: IntArray

    @property
    def best(self) -> Array:
        """(A, B, …) largest |margin| of all modes in which the joints are within their ranges; NaN where in none."""
        size = np.where(self.in_range, np.abs(self.margin), -np.inf).max(axis=0)
        return read_only(np.where(np.isfinite(size), size, np.nan))

    @property
    def points(self) -> Array:
        """(P, f) the free coordinates of the nodes that some mode reaches within the ranges of its joints."""
        mesh = np.stack([part.ravel() for part in np.meshgrid(*self.axes, indexing="ij")], axis=1)
        return read_only(mesh[self.in_range.any(axis=0).ravel()])

    @property
    def size(self) -> float:
        """Length, area or volume of these nodes' cells, m, m² or m³."""
        cell = float(np.prod([axis[1] - axis[0] for axis in self.axes]))
        return cell * int(self.in_range.any(axis=0).sum())


def workspace(
    robot: RobotLike,
    free: Sequence[str] | None = None,
    *,
    at: ArrayLike | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    resolution: int | None = None,
    modes: Sequence[Sequence[int]] | str = "own",
) -> Workspace:
    """Return where the platform of any robot can go, with margins to singularities and ranges of joints.

    Args:
        robot: the robot, or its name or path.
        free: one, two or three of the platform's translations, such as ("x", "z"); all of them when left out. Of a
            robot without a platform one or two of its independent joints.
        at: (n,) coordinates or a pose (4, 4) that the slice goes through; the reference when left out. What is not free
            stays as it is there.
        bounds: (lower, upper) for each free coordinate; the whole workspace when left out, or four characteristic
            lengths to each side where it has no end within eight.
        resolution: nodes along each axis; 400, 100 or 25 by the number of axes.
        modes: "own", "all", or working modes; those in which ``at`` cannot be taken are left out.

    Raises:
        InputError: names or bounds that do not fit, too many nodes.
        UnsupportedRobotError: no translation to vary.
        UnreachablePoseError, SingularPoseError, WorkingModeError: ``at`` cannot be taken.
    """
    robot = as_robot(robot)
    names, columns = _free(robot, free)
    nodes = _RESOLUTION[len(columns)] if resolution is None else resolution
    require_type(nodes, (int, np.integer), "A number of nodes", "Pass a whole number, at least 3.")
    require_few(int(nodes) ** len(columns), _MOST_NODES, "The grid has {} nodes", "Ask for a lower resolution.")
    ends = np.zeros((len(columns), 2)) if bounds is None else checked(bounds, "bounds", (len(columns), 2))
    if np.abs(ends).max() > _FARTHEST * robot.characteristic_length:
        raise InputError(
            f"bounds are {np.abs(ends).max():g}, a robot of {robot.characteristic_length:g} m is not there.",
            remedy=f"Stay within {_FARTHEST:g} times that.",
        )
    if nodes < 3 or (bounds is not None and not (ends[:, 0] < ends[:, 1]).all()):
        raise InputError(
            f"resolution is {resolution} and bounds are {bounds!r}; the slice runs over {', '.join(names)}.",
            remedy="Pass at least 3 nodes, and one (lower, upper) pair for each of them.",
        )
    wanted = _modes(robot, modes)
    system = constraint_system(robot)
    home = coordinates(robot, system.evaluate(np.array(robot.q_reference)[None]))[0]
    x = np.array(home if at is None else checked(at, "at", home.shape))
    starts = [_start(robot, mode, x, at is None) for mode in wanted]
    turning = [robot.platform is None and is_revolute(robot, name) for name in names]
    units = tuple("rad" if turns else "m" for turns in turning)
    there = [(ConstraintSystem(one), Slice(names, units, columns, {}, x, q)) for one, q in starts if q is not None]
    if not there:
        raise WorkingModeError(
            f"{robot.name} can be at {x.tolist()} in none of the working modes {list(wanted)}.",
            remedy="Pass another `at`, or other modes.",
        )
    if bounds is None:
        each = [default_axes(*one, nodes, within_ranges=True) for one in there]
        spans = np.array([[(axis[0], axis[-1]) for axis in one] for one in each])
        ends = np.stack([spans[..., 0].min(axis=0), spans[..., 1].max(axis=0)], axis=1)
    axes = tuple(np.linspace(low, high, nodes) for low, high in ends)
    grids = [solve_grid(*one, axes, islands=True) for one in there]
    shape = (len(there), *(len(axis) for axis in axes))
    island = np.stack([grid.part for grid in grids])
    reachable = island >= 0
    in_range, margins = np.zeros(reachable.shape, dtype=bool), np.full((2, *reachable.shape), np.nan)
    for k, ((one, _), grid) in enumerate(zip(there, grids, strict=True)):
        q = grid.q[grid.reachable]
        in_range[k, grid.reachable] = ~out_of_range(robot, q, motion=False)
        for part in blocks(len(q)):
            to = np.flatnonzero(grid.reachable)[part]
            margins[:, k, to] = margins_of(one, one.evaluate(q[part]))
    maps = [read_only(part.reshape(shape)) for part in (reachable, in_range, *margins, island)]
    modes_there = tuple(one.robot.working_mode for one, _ in there)
    return Workspace(robot, names, units, tuple(map(frozen, axes)), grids[0].x, modes_there, *maps)


def _modes(robot: Robot, modes: Sequence[Sequence[int]] | str) -> tuple[tuple[int, ...], ...]:
    """Return the working modes to be mapped."""
    if isinstance(modes, str):
        one_of(modes, "modes", ("own", "all"))
        return (robot.working_mode,) if modes == "own" else tuple(all_working_modes(robot))
    try:
        signs = tuple(tuple(int(sign) for sign in mode) for mode in modes)
    except (TypeError, ValueError):
        signs = ()
    if not signs:
        raise InputError(
            f"modes is {shown(modes)}.", remedy=f"Pass 'own', 'all', or some of {all_working_modes(robot)}."
        )
    return signs


def _start(robot: Robot, mode: tuple[int, ...], x: Array, home: bool) -> tuple[Robot, Array | None]:
    """Return the robot in a working mode and a configuration at x; of another mode than its own None, if there is none.

    Raises:
        RedundancyPinError: there is none in its own mode.
    """
    if mode == robot.working_mode:
        return robot, np.array(robot.q_reference) if home else point_on_branch(constraint_system(robot), x).q
    if mode not in all_working_modes(robot):
        raise InputError(
            f"{robot.name} has no working mode {mode}.", remedy=f"Pass some of {all_working_modes(robot)}, or 'all'."
        )
    other = replace(robot, working_mode=mode)
    try:
        return other, point_on_branch(constraint_system(other), x).q
    except RedundancyPinError:
        return other, None


def _free(robot: Robot, free: Sequence[str] | None) -> tuple[tuple[str, ...], tuple[int, ...]]:
    """Return names and columns of the coordinates that vary."""
    known = robot.platform.axes if robot.platform else robot.independent_joints
    possible = [name for name in known if robot.platform is None or not name.startswith("r")]
    require_type(free, (str, Sequence, type(None)), "Names of coordinates", f"Choose from {', '.join(possible)}.")
    names = tuple(possible if free is None else [free] if isinstance(free, str) else map(str, free))
    if not possible or not 1 <= len(names) <= 3 or (robot.platform is None and len(names) > 2):
        raise UnsupportedRobotError(
            f"The workspace of {robot.name} has no picture over {', '.join(names) or 'no coordinate'}.",
            remedy=f"Choose up to three of its translations, or two of its joints: {', '.join(possible) or 'none'}.",
        )
    if len(set(names)) < len(names) or not set(names) <= set(possible):
        unknown = [name for name in names if name not in possible]
        meant = did_you_mean(unknown[0], possible) if unknown else "Name each once. "
        raise InputError(f"free is {names}.", remedy=f"{meant}Choose from {', '.join(possible)}.")
    # of a pose the row of the translation, of coordinates their column
    return names, tuple("xyz".index(name) if is_pose(robot) else known.index(name) for name in names)
