"""Whether a mechanism has the degrees of freedom that are declared: Grübler's count, and the rank of rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from redundancy_pin.arrays import FILE_TOLERANCE, RANK_TOLERANCE, Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import Assembly, assemble, evaluated, smallest_independent
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.robot.build import with_pointer
from redundancy_pin.robot.scales import closure_tolerance


def check_mobility(system: ConstraintSystem, *, dropped: bool = False) -> None:
    """Compare the degrees of freedom with the declaration; the error names superfluous rows or joints.

    ``dropped``: rows that are redundant all along the motion were left out already, as `redundant_rows: true` asks.
    """
    robot = system.robot
    rows, velocities = len(system.rows), len(system.pose_columns)
    freedoms = velocities - rows
    if not robot.n and freedoms <= 0:
        raise DeclarationError(
            f"{robot.name} does not move: {velocities} joint velocities less {rows} closure rows leave {freedoms} "
            "freedoms.",
            remedy="Add a joint, take a closure, or axes of one, out, or correct placements at which redundant rows "
            "contradict each other.",
            freedoms=freedoms,
        )
    if freedoms == robot.n:
        return
    reference = assemble(system, np.array(robot.q_reference)[None])
    rank, redundant = _rank(system, reference.q[0], FILE_TOLERANCE)
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
        kind, only, where = "under", "only ", _left_free(reference)
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


def _left_free(near: Assembly) -> str:
    """Return which joints still move when the independent velocities are zero at a configuration."""
    robot, columns = near.system.robot, near.system.pose_columns
    values, basis = np.linalg.svd(near.system.relative(near.state.K)[0])[1:]
    free = np.abs(basis[int((values > RANK_TOLERANCE * max(values.max(initial=0.0), 1e-300)).sum()) :])
    moving = {int(columns[k]) for k in np.flatnonzero(free.max(axis=0, initial=0.0) > RANK_TOLERANCE)}
    names = [
        str(name)
        for name, joint in zip(robot.model.names, robot.model.joints, strict=True)
        if moving & set(range(joint.idx_v, joint.idx_v + joint.nv))
    ]
    fixed = f"{robot.platform.frame!r} held along its axes" if robot.platform else "the independent joints held"
    return f" With {fixed}, these joints still move: {', '.join(names)}." if names else ""


def check_reference_rank(system: ConstraintSystem, *, dropped: bool = False) -> Robot:
    """Check that at the reference rows are independent, and that it is not a type I singularity.

    ``dropped``: as of ``check_mobility``.

    Returns:
        The robot. A platform with one rotation whose frame turns about the axis that tells its angle, which stays then,
        has another axis tell it.

    Raises:
        DeclarationError: it is; names the rows.
    """
    robot = system.robot
    rank, redundant = _rank(system, np.array(robot.q_reference))
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
    if _margin(system) == 0.0:
        if robot.platform is not None and len(robot.platform.rotations) == 1:
            platforms = (replace(robot.platform, pointer=axis) for axis in range(3))
            other = max((ConstraintSystem(replace(robot, platform=each)) for each in platforms), key=_margin)
            if _margin(other) > RANK_TOLERANCE:
                return other.robot
        raise DeclarationError(
            f"The reference of {robot.name} is a type I singularity: its independent velocities do not determine the "
            "joint velocities.",
            remedy="Move the reference, or declare other independent velocities." + _fitting(robot, robot.n),
        )
    return robot


def _margin(system: ConstraintSystem) -> float:
    """Return how far the reference is from a type I singularity, 0 at one."""
    return float(evaluated(system, np.array(system.robot.q_reference)[None]).margin[0])


def _fitting(robot: Robot, count: int) -> str:
    """Return a remedy that names the platform axes, so many, that determine the reference best, empty where none do."""
    platform = robot.platform
    if platform is None:
        return ""
    q, margins = np.array(robot.q_reference)[None], {}
    for axes in combinations(AXES, count):
        other = replace(platform, axes=axes)
        system = ConstraintSystem(replace(robot, platform=with_pointer(other, robot.model, q[0])))
        if len(system.rows) + count == len(system.pose_columns):
            margins[axes] = float(evaluated(system, q).margin[0])
    best = max(margins, key=lambda axes: round(margins[axes], 9), default=())
    if not margins.get(best, 0.0) > RANK_TOLERANCE:
        return ""
    return f" These axes of {platform.frame!r} fit: [{', '.join(best)}]."


def other_axes(robot: Robot) -> str:
    """Return a remedy where the platform's axes do not determine the configuration near the guess, else nothing."""
    system = ConstraintSystem(robot)
    near = assemble(system, np.array(robot.q_reference)[None])
    if robot.platform is None or not near.closed[0] or near.margin[0] > RANK_TOLERANCE:
        return ""
    return _fitting(replace(robot, q_reference=near.q[0]), robot.n).strip()


def independent_columns(
    matrix: Array,
    apart: float = RANK_TOLERANCE,
    *,
    taken: Sequence[int] = (),
    among: Sequence[int] | None = None,
    most: int | None = None,
) -> list[int]:
    """Return columns that are independent of one another, the farthest from the span of those before it first.

    It is the QR decomposition with column pivoting (Golub and Van Loan, "Matrix Computations", 2013, section 5.4.2).

    Args:
        matrix: (r, c).
        apart: smallest distance of a column from the span of the others; as of ``smallest_independent``.
        taken: columns that are chosen already; they come first.
        among: columns to choose from, all when left out.
        most: number of columns at which to stop.

    Example:
        >>> independent_columns(np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]]))
        [1, 2]
    """
    basis, longest = np.zeros((len(matrix), 0)), np.linalg.norm(matrix, axis=0).max(initial=0.0)
    chosen, waiting = list(taken), list(range(matrix.shape[1]) if among is None else among)
    most, apart = min(matrix.shape) if most is None else most, float(smallest_independent(longest, apart))

    def extend(column: Array) -> None:
        nonlocal basis
        for _ in range(2):  # once leaves the rounding of a column that is nearly dependent
            column = column - basis @ (basis.T @ column)
            column = column / np.linalg.norm(column)
        basis = np.column_stack([basis, column])

    for index in chosen:
        extend(matrix[:, index])
    while len(chosen) < most:
        waiting = [index for index in waiting if index not in chosen]
        rest = matrix[:, waiting] - basis @ (basis.T @ matrix[:, waiting])
        lengths = np.linalg.norm(rest, axis=0)
        if not lengths.max(initial=0.0) > apart:
            break
        # the first of equals, whatever their rounding
        chosen.append(waiting[int(np.argmax(lengths > (1.0 - RANK_TOLERANCE) * lengths.max()))])
        extend(matrix[:, chosen[-1]])
    return chosen


def free_motions(system: ConstraintSystem, q: Array, apart: float = RANK_TOLERANCE) -> Array:
    """Return (f, p) orthonormal displacements, without units, that the closure rows leave free at q (nq,).

    ``apart``: as of ``independent_columns``.

    Example:
        >>> free_motions(system, np.array(robot.q_reference)).shape[0]  # degrees of freedom
    """
    rows = system.closure_rows(q)
    rank = len(independent_columns(rows.T, apart))
    free: Array = np.linalg.svd(rows)[2][rank:] if rows.size else np.eye(rows.shape[1])
    return free


def _rank(system: ConstraintSystem, q: Array, apart: float = RANK_TOLERANCE) -> tuple[int, list[str]]:
    """Return the rank of the closure rows at q (nq,) and the names of those that depend on the others."""
    kept = independent_columns(system.closure_rows(q).T, apart)
    return len(kept), [name for row, name in enumerate(row_names(system.robot)) if row not in kept]


def worst_dependent_row(system: ConstraintSystem, q: Array) -> str:
    """Return the message about the dependent row with the largest residual at a configuration (nq,).

    Empty where all rows close, and where those that were kept do not close either: then the pose is out of their reach.
    """
    kept_open = system.largest_residual(system.evaluate(q[None]).phi)[0] >= closure_tolerance(system.robot)
    if kept_open or not system.dependent_row_residual(q[None])[0]:
        return ""
    every, kept = system.every, set(row_names(system.robot))
    residual = np.abs(every.evaluate(q[None]).phi[0] / every.closure_unit)
    names = row_names(every.robot)
    worst = max((i for i, name in enumerate(names) if name not in kept), key=lambda i: float(residual[i]))
    return f", in {names[worst]}, which was left out as redundant near the reference"


def row_names(robot: Robot) -> list[str]:
    """Return the names of the constraint rows as messages have them."""
    closures = (f"{axis} of {closure.name!r}" for closure in robot.closures for axis in closure.axes)
    return [*closures, *(f"the coupling {coupling.name!r}" for coupling in robot.couplings)]
