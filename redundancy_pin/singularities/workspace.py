"""Workspace maps: reachable positions of the platform and their singularity margins, as slices and clouds of any robot.

A grid over up to three translations, the other coordinates fixed, is solved by continuation from the reference, in each
working mode by itself. Islands, which are not connected to the start within the slice, are found from random starts.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    IntArray,
    checked,
    frozen,
    one_of,
    read_only,
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
from redundancy_pin.io.files import write_text
from redundancy_pin.io.summary import Summary, TextTable
from redundancy_pin.kinematics.coordinates import all_working_modes, mode_name
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.grid import (
    Slice,
    axes_between,
    bounded_axes,
    default_axes,
    describe,
    require_resolution,
    slice_through,
    solve_grid,
)
from redundancy_pin.trajectory.csv_file import checked_poses, coordinate_names, csv_rows, unit_of

_RESOLUTION = {1: 400, 2: 100, 3: 25}
"""Nodes along each axis, by the number of axes."""


@dataclass(frozen=True, eq=False, repr=False)
class Workspace(Frozen):
    """A slice of the workspace, or a cloud of points in it, in M working modes; returned by ``workspace``.

    Attributes:
        robot: the robot.
        names: names of the coordinates that vary, such as ("x", "z").
        units: of each, "m" or "rad".
        axes: (A,), (B,), ... the grid along each.
        x: (A·B·…, n) coordinates or (A·B·…, 4, 4) poses of all nodes, the last axis running fastest.
        modes: working modes, ±1 per leg; a single empty one if the robot declares none.
        reachable: (M, A, B, …) whether a closed configuration was found in each mode.
        in_range: (M, A, B, …) reachable with all joints within their ranges.
        margin: (M, A, B, …) signed scaled margin to type II, NaN where not reachable.
        serial_margin: (M, A, B, …) scaled margin to type I.
        island: (M, A, B, …) 0 for nodes connected to the start of the mode within the slice, 1, 2, … for islands, −1
            where not reachable.
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

    def __repr__(self) -> str:
        """Return what tells workspaces apart, not their arrays."""
        return (
            f"Workspace({self.robot.name!r}; {describe(self.names, self.units, self.axes)}, "
            f"{len(self.modes)} mode(s), {int(self.in_range.any(axis=0).sum())} in range, size {self.size:.4g})"
        )

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
        """Length, area or volume of these nodes' cells within the bounds, m, m² or m³ (rad of joints)."""
        # the cell of a node reaches half a step to each side, at the ends of an axis to the inside alone
        size: Array = self.in_range.any(axis=0).astype(float)
        for axis in reversed(self.axes):
            widths = np.gradient(axis)
            widths[[0, -1]] *= 0.5
            size = size @ widths
        return float(size)

    def summary(self) -> Summary:
        """Return a summary: a mapping of bounds, nodes, size, and counts of nodes by mode.

        Its ``print`` shows a table.
        """
        parts = zip(self.modes, self.reachable, self.in_range, self.island, strict=True)
        facts: dict[str, Any] = {
            "robot": self.robot.name,
            "bounds": {name: [axis[0], axis[-1]] for name, axis in zip(self.names, self.axes, strict=True)},
            "nodes": int(self.reachable[0].size),
            "size": self.size,
            "modes": {
                mode_name(mode) if mode else "": {
                    "reachable": int(reachable.sum()),
                    "in_range": int(in_range.sum()),
                    "islands": int(island.max(initial=0)),
                }
                for mode, reachable, in_range, island in parts
            },
        }
        power = {1: "", 2: "²", 3: "³"}
        unit = "·".join(f"{kind}{power[self.units.count(kind)]}" for kind in dict.fromkeys(self.units))
        rows = [
            *(
                (f"{name} [{one}]", f"{low:.6g} to {high:.6g}")
                for (name, (low, high)), one in zip(facts["bounds"].items(), self.units, strict=True)
            ),
            (f"size [{unit}]", f"{self.size:.6g}"),
        ]
        for mode, one in facts["modes"].items():
            islands = f", {one['islands']} island(s) not reached from the reference" if one["islands"] else ""
            counts = f"{one['reachable']} of {facts['nodes']} reachable, {one['in_range']} in range{islands}"
            rows.append((mode or "nodes", counts))
        return Summary(facts, TextTable(f"{self.robot.name}: workspace over {', '.join(self.names)}", rows))

    def to_csv(self, path: str | Path) -> None:
        """Write a row for each node and working mode to a CSV file.

        Columns: ``mode``; the coordinates with their unit (of a pose the origin); ``reachable`` and ``in_range``, 0 or
        1; ``margin``, ``serial_margin``, NaN where not reachable; ``island``.

        Raises:
            OutputError: the file cannot be written; an earlier one is as it was.
        """
        x = self.x[:, :3, 3] if self.x.ndim == 3 else self.x
        names = coordinate_names(self.robot)[: x.shape[1]]
        places = {name: (unit_of(self.robot, name), np.tile(x[:, k], len(self.modes))) for k, name in enumerate(names)}
        columns: dict[str, tuple[str, NDArray[Any]]] = {
            "mode": ("", np.repeat([mode_name(mode) if mode else "" for mode in self.modes], len(x))),
            **places,
            "reachable": ("", self.reachable.astype(int).ravel()),
            "in_range": ("", self.in_range.astype(int).ravel()),
            "margin": ("", self.margin.ravel()),
            "serial_margin": ("", self.serial_margin.ravel()),
            "island": ("", self.island.ravel()),
        }
        write_text(path, csv_rows(columns))


def workspace(
    robot: RobotLike,
    free: Sequence[str] | None = None,
    *,
    at: ArrayLike | None = None,
    bounds: Sequence[tuple[float, float]] | None = None,
    resolution: int | None = None,
    modes: Sequence[Sequence[int]] | str = "own",
) -> Workspace:
    """Return the reachable positions of a platform, with singularity margins and ranges of joints.

    Args:
        robot: the robot, or its name or path.
        free: one, two or three of the platform's translations, such as ("x", "z"); all of them when left out. Of a
            robot without a platform one or two of its independent joints.
        at: (n,) coordinates that the slice goes through, or a pose, (4, 4) or (7,) position, m, and unit quaternion x,
            y, z, w; the reference when left out. What is not free stays as it is there.
        bounds: (lower, upper) for each free coordinate; the whole workspace when left out, or four characteristic
            lengths to each side if it is unbounded within eight.
        resolution: nodes along each axis; 400, 100 or 25 by the number of axes.
        modes: "own", "all", or working modes; those in which the robot cannot be at ``at`` are left out.

    Raises:
        InputError: names or bounds that do not fit, too many nodes.
        UnsupportedRobotError: no translation to vary.
        UnreachablePoseError, SingularPoseError, WorkingModeError: the robot cannot be at ``at``.

    Example:
        >>> space = rp.workspace("five_bar", resolution=10)
        >>> space.best.shape
        (10, 10)
    """
    robot = as_robot(robot)
    names = _names(robot, free)
    nodes = require_resolution(_RESOLUTION[len(names)] if resolution is None else resolution, len(names))
    axes = None if bounds is None else bounded_axes(robot, names, bounds, nodes)
    slices = _slices(robot, names, at, _modes(robot, modes))
    if axes is None:
        each = np.array([[axis[[0, -1]] for axis in default_axes(one, nodes, within_ranges=True)] for one in slices])
        axes = axes_between(np.stack([each[..., 0].min(axis=0), each[..., 1].max(axis=0)], axis=1), nodes)
    grids = [solve_grid(one, axes, islands=True) for one in slices]
    shape = (len(slices), *(len(axis) for axis in axes))

    def stacked(parts: Iterable[NDArray[Any]]) -> NDArray[Any]:
        return read_only(np.reshape([*parts], shape))

    return Workspace(
        robot=robot,
        names=names,
        units=slices[0].units,
        axes=tuple(map(frozen, axes)),
        x=grids[0].x,
        modes=tuple(one.system.robot.working_mode for one in slices),
        reachable=stacked(grid.reachable for grid in grids),
        in_range=stacked(grid.in_range for grid in grids),
        margin=stacked(grid.margins.parallel for grid in grids),
        serial_margin=stacked(grid.margins.serial for grid in grids),
        island=stacked(grid.part for grid in grids),
    )


def _modes(robot: Robot, modes: Sequence[Sequence[int]] | str) -> tuple[tuple[int, ...], ...]:
    """Return the working modes to be mapped."""
    known = all_working_modes(robot)
    if isinstance(modes, str):
        one_of(modes, "modes", ("own", "all"))
        return (robot.working_mode,) if modes == "own" else tuple(known)
    try:
        signs = tuple(tuple(int(sign) for sign in mode) for mode in modes)
    except (TypeError, ValueError):
        signs = ()
    if not signs:
        raise InputError(f"modes is {shown(modes)}.", remedy=f"Pass 'own', 'all', or some of {known}.")
    for mode in signs:
        if mode not in (*known, robot.working_mode):
            raise InputError(f"{robot.name} has no working mode {mode}.", remedy=f"Pass some of {known}, or 'all'.")
    return signs


def _slices(
    robot: Robot, names: tuple[str, ...], at: ArrayLike | None, modes: Sequence[tuple[int, ...]]
) -> list[Slice]:
    """Return the slice through ``at`` in each working mode in which the robot can be there.

    Raises:
        RedundancyPinError: it cannot be there in its own mode, if that is wanted, or in none of the modes.
    """
    home = slice_through(robot, names).x
    x = home
    if at is not None and home.ndim == 2 and np.ndim(at) == 1:
        x = checked_poses(checked(at, "at", (7,))[None], "at")[0]
    elif at is not None:
        x = checked(at, "at", home.shape)
    slices = []
    for mode in modes:
        own = mode == robot.working_mode
        try:
            chosen = robot if own else replace(robot, working_mode=mode)
            slices.append(slice_through(chosen, names, None if own and at is None else x))
        except RedundancyPinError:
            if own:
                raise
    if not slices:
        raise WorkingModeError(
            f"{robot.name} can be at {x.tolist()} in none of the working modes {list(modes)}.",
            remedy="Pass another `at`, or other modes.",
        )
    return slices


def _names(robot: Robot, free: Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of the coordinates that vary."""
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
    return names
