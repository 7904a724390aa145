"""Whether a mechanism has the freedoms that are declared: Grübler's count, and the rank of rows at the reference."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import assemble, project
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.robot.build import with_pointer

_MOVES = 1e-6
"""Part of a unit motion, scaled, that a joint must have in it to be said to move."""


def check_mobility(system: ConstraintSystem, *, dropped: bool = False) -> None:
    """Compare the count of freedoms with the declaration, and say which rows or freedoms are too many.

    ``dropped``: rows that are redundant all along the motion were left out already, as `redundant_rows: true` asks.
    """
    robot = system.robot
    rows, velocities = len(system.rows), len(system.pose_columns)
    freedoms = velocities - rows
    if not robot.n and freedoms <= 0:
        raise DeclarationError(
            f"{robot.name} does not move: {velocities} joint velocities less {rows} closure rows leave {freedoms} "
            "freedoms.",
            remedy="Add a joint, or take a closure, or axes of one, out.",
            freedoms=freedoms,
        )
    if freedoms == robot.n:
        return
    reference = assemble(system, np.array(robot.q_reference)[None])
    rank, redundant = _rank(system, reference.state)
    if freedoms < robot.n:
        kind, only = "over", ""
        where = f" At the reference {len(redundant)} row(s) are redundant: {', '.join(redundant)}." if redundant else ""
        remedy = (
            "Rows that are redundant all along the motion are left out already. Take axes out of a closure that holds "
            "what should move, correct frames that are not exactly where the links meet, or declare fewer independent "
            "velocities."
            if dropped
            else "Take the redundant axes out of the closures (a planar pin joint is [x, y]), or, where the loops move "
            "all the same, say `redundant_rows: true`; or declare fewer independent velocities."
        )
    else:
        kind, only, where = "under", "only ", _left_free(system)
        remedy = "Add the missing closure axes, declare more independent velocities, or list carriers as carriers."
    if not redundant and freedoms > 0:
        remedy += _fitting(replace(robot, q_reference=reference.q[0]), freedoms)
    raise DeclarationError(
        f"{robot.name} is {kind}-constrained: {velocities} joint velocities less {rows} closure rows leave {freedoms} "
        f"freedoms, but {only}{robot.n} independent velocities are declared.{where}",
        remedy=remedy,
        freedoms=freedoms,
        declared=robot.n,
        rank=rank,
    )


def _left_free(system: ConstraintSystem) -> str:
    """Return which joints still move when the independent velocities are held, near the reference."""
    robot = system.robot
    state = assemble(system, np.array(robot.q_reference)[None]).state
    columns = system.pose_columns
    rows = system.relative(state.K)[0]
    values, basis = np.linalg.svd(rows)[1:]
    free = np.abs(basis[int((values > RANK_TOLERANCE * max(values.max(initial=0.0), 1e-300)).sum()) :])
    moving = {int(columns[k]) for k in np.flatnonzero(free.max(axis=0, initial=0.0) > _MOVES)}
    names = [
        str(name)
        for name, joint in zip(robot.model.names, robot.model.joints, strict=True)
        if moving & set(range(joint.idx_v, joint.idx_v + joint.nv))
    ]
    fixed = f"{robot.platform.frame!r} held along its axes" if robot.platform else "the independent joints held"
    return f" With {fixed}, these joints still move: {', '.join(names)}." if names else ""


def check_reference_rank(system: ConstraintSystem, *, dropped: bool = False) -> None:
    """Check that the reference is no place where rows depend on one another, or a type I singularity.

    ``dropped``: as of ``check_mobility``.

    Raises:
        DeclarationError: it is; names the rows.
    """
    robot = system.robot
    state = system.evaluate(np.array(robot.q_reference)[None])
    rank, redundant = _rank(system, state)
    if redundant:
        raise DeclarationError(
            f"Grübler's count gives {robot.name} {robot.n} freedoms, but its closure rows have rank {rank} of "
            f"{len(system.rows)} at the reference: {len(system.pose_columns) - rank} freedoms. Redundant: "
            f"{', '.join(redundant)}.",
            remedy="Rows that are redundant all along the motion are left out already; these are so at the reference "
            "alone. Move the reference to where the links are not in line."
            if dropped
            else "Move the reference, where the rows are redundant there alone (links in line). Otherwise take the "
            "redundant axes out of the closures and add the ones that are missing; or, where the loops move all the "
            "same, say `redundant_rows: true`.",
            rank=rank,
        )
    projection = project(system, state)
    if projection.margin[0] == 0.0:
        raise DeclarationError(
            f"The reference of {robot.name} is a type I singularity: its independent velocities do not determine the "
            "joint velocities.",
            remedy="Move the reference, or declare other independent velocities." + _fitting(robot, robot.n),
        )


def fitting_axes(robot: Robot, count: int) -> tuple[str, ...] | None:
    """Return the platform axes, so many, that determine the reference best; None where none do, or for joints."""
    platform = robot.platform
    if platform is None:
        return None
    q, margins = np.array(robot.q_reference)[None], {}
    for axes in combinations(AXES, count):
        other = replace(platform, axes=axes)
        system = ConstraintSystem(replace(robot, platform=with_pointer(other, robot.model, q[0])))
        if len(system.rows) + count == len(system.pose_columns):
            margins[axes] = float(project(system, system.evaluate(q)).margin[0])
    best = max(margins, key=lambda axes: round(margins[axes], 9), default=())
    return best if margins.get(best, 0.0) > RANK_TOLERANCE else None


def _fitting(robot: Robot, count: int) -> str:
    """Return a remedy that names axes that fit, empty where none do."""
    axes = fitting_axes(robot, count)
    return f" These axes of {robot.platform.frame!r} fit: [{', '.join(axes)}]." if robot.platform and axes else ""


def other_axes(robot: Robot) -> str:
    """Return a remedy where the platform's axes do not determine the configuration near the guess, else nothing."""
    system = ConstraintSystem(robot)
    near = assemble(system, np.array(robot.q_reference)[None])
    if robot.platform is None or not near.closed[0] or near.projection.margin[0] > RANK_TOLERANCE:
        return ""
    return _fitting(replace(robot, q_reference=near.q[0]), robot.n).strip()


def _rank(system: ConstraintSystem, state: ConstraintState) -> tuple[int, list[str]]:
    """Return the rank of the closure rows and the names of those that depend on the others (pivoted QR of Jᵀ)."""
    jacobian = state.Jc[0][:, system.pose_columns] * system.step_unit / system.closure_unit[:, None]
    if min(jacobian.shape) == 0:
        return 0, []
    singular = np.linalg.svd(jacobian, compute_uv=False)
    if len(singular) == len(jacobian) and singular[-1] > RANK_TOLERANCE * singular[0]:
        return len(jacobian), []  # the diagonal below lies between these two: its verdict is the same
    from scipy.linalg import qr  # imported where rows are to be named only: it takes as long as all of Pinocchio

    _, triangle, order = qr(jacobian.T, pivoting=True, mode="economic")
    diagonal = np.abs(np.diag(triangle))
    rank = int((diagonal > RANK_TOLERANCE * max(diagonal.max(initial=0.0), np.finfo(float).tiny)).sum())
    names = row_names(system.robot)
    return rank, [names[row] for row in sorted(order[rank:])]


def row_names(robot: Robot) -> list[str]:
    """Return the names of the constraint rows as messages have them."""
    closures = (f"{axis} of {closure.name!r}" for closure in robot.closures for axis in closure.axes)
    return [*closures, *(f"the coupling {coupling.name!r}" for coupling in robot.couplings)]
