"""Which closure rows count and which joints are independent, for models that do not state it.

A loop closed by a ball or a weld has more rows than it needs: of the three of a ball in a planar loop one is redundant.
Rows are left out where they depend on the others at the reference and all around it, and only where the loops stay
closed in the rows that were left out. The rank at one configuration proves nothing: a mechanism that moves against
Grübler's count (Bricard's six hinges) has rows that are redundant there and still keep a hinge from opening.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import FILE_TOLERANCE, RANK_TOLERANCE, Array, BoolArray
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.closing import closed_near, closed_neighbours
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.mobility import free_motions, independent_columns, row_names
from redundancy_pin.kinematics.spinning_rods import centre_off_axis, find_spinning_rod, hinges_of, with_spin_fixed
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint

_AROUND = 6, 0.1
"""Number of configurations around the reference, and how far the joints are from it, rad or characteristic lengths."""

EXACT = 1e-6
"""``FILE_TOLERANCE`` of models whose rows are no more redundant than that: short levers make rows that are independent
by 1e-4 only (Cassie's feet), and the loops open where they are left out."""

_DOUBTFUL = 3e-2
"""Rows that are independent by less, rad or characteristic lengths, may be redundant ones of wrong placements."""

_WELL_APART = 1e-2
"""A velocity whose column is nearer to the others, in its own length, is taken as dependent only where there is no
other: it would make a reference next to a singularity of type I."""

_ON_AXIS = 2e-5
"""Characteristic lengths: distance of a centre of mass from the line between two balls that is rounding."""


class Selection(NamedTuple):
    """What was chosen.

    Attributes:
        robot: the robot with the closures that are left, or the ones it had.
        left_out: names of the rows left out, such as ``"z of 'left = right'"``.
        opened: how far those open around the reference, m or rad: rounding, of Newton or of the file's numbers.
        fixed_spins: joints whose spin about the line between two balls is held by a row that was added.
        off_axis: how far the centre of mass of what spins there is from that line, m, by joint; more than rounding.
        independent: names of the independent joints.
        q: (nq,) a closed configuration.
    """

    robot: Robot
    left_out: tuple[str, ...]
    opened: float
    fixed_spins: tuple[str, ...]
    off_axis: dict[str, float]
    independent: tuple[str, ...]
    q: Array


def selected(
    robot: Robot, q: Array, *, redundant: bool, declared: int | None, resisted: Set[str] = frozenset()
) -> Selection:
    """Choose closure rows and independent joints near a configuration.

    Args:
        robot: a robot without independent velocities.
        q: (nq,) a configuration from which the loops can be closed.
        redundant: let rows be redundant and leave them out; else they stay, and the loader refuses them by name.
        declared: number of degrees of freedom, if declared.
        resisted: balls with damping or armature: of two on a rod its spin is held there, where it is held by these too.

    Raises:
        DeclarationError: the loops do not close; rows that depend on the others at the reference only, or except for
            more than the rounding of a file; or a joint of several freedoms that the loops leave free.
    """
    left_out: tuple[str, ...] = ()
    opened, start = 0.0, q
    if redundant and (robot.closures or robot.couplings):
        # numbers of a file are rounded; where the loops open in what would be redundant then, they mean what they say
        every = robot
        try:
            robot, left_out, opened, q = _without_redundant_rows(every, start, FILE_TOLERANCE, _DOUBTFUL)
        except DeclarationError:
            _refuse_wrong_placements(every, start, declared)
            robot, left_out, opened, q = _without_redundant_rows(every, start, EXACT, EXACT)
        else:
            rows = ConstraintSystem(robot).closure_rows(q)
            if len(independent_columns(rows.T, _DOUBTFUL)) < len(rows):
                _refuse_wrong_placements(every, start, declared)
    else:
        q = closed_near(robot, start)
    rods, off_axis = list[str](), dict[str, float]()
    independent, loose = _independent(robot, q)
    while redundant:
        # a spin of hinges may be an independent coordinate, where a declaration counts it
        hinges = independent if declared is None or len(independent) > declared else ()
        if not (spinning := find_spinning_rod(robot, (*loose, *hinges), rods, q)):
            break
        name, rod = spinning
        rods.append(name)
        if (away := centre_off_axis(robot, name, rod, q)) > _ON_AXIS * robot.characteristic_length:
            off_axis[name] = away
        robot = with_spin_fixed(robot, name, rod, q, at_first=not resisted.isdisjoint(hinges_of(robot, name)))
        independent, loose = _independent(robot, q)
    if loose:
        balls = tuple(name for name in loose if find_joint(robot.model, name).nq == 4)
        raise DeclarationError(
            f"{robot.name} has the joint(s) {', '.join(map(repr, loose))} of several freedoms, which its loops leave "
            "free in part: they cannot be independent, only joints of one freedom can.",
            remedy="Make each of hinges and slides, one freedom each.",
            joints=loose,
            **({"balls": balls} if balls == loose else {}),
        )
    return Selection(robot, left_out, opened, tuple(rods), off_axis, independent, q)


def _without_redundant_rows(
    robot: Robot, start: Array, tolerance: float, rank_tolerance: float
) -> tuple[Robot, tuple[str, ...], float, Array]:
    """Return the robot with the rows that count, the names of the others, how far these open, and a configuration.

    Args:
        robot: with all rows.
        start: (nq,) where the loops are closed from.
        tolerance: largest distance of redundant rows from the span of the others, and largest residual in them, rad or
            characteristic lengths.
        rank_tolerance: as of ``assemble``, when the loops are closed.
    """
    system = ConstraintSystem(robot)
    q, keep = _independent_rows(robot, start, tolerance, rank_tolerance, tolerance)
    if keep.all():
        return robot, (), 0.0, closed_near(robot, q)
    fewer, left_out = _with_rows(robot, keep)
    # with these rows alone, do the others stay closed, and stay redundant, which shows earlier?
    around, opened = _opened(robot, fewer, q)
    ranks = [len(independent_columns(system.closure_rows(each).T, tolerance)) for each in around]
    if opened.max() <= tolerance and max(ranks) == keep.sum():
        return fewer, left_out, float(opened.max()), q
    wide = [name for name, gap in zip(row_names(robot), opened, strict=True) if gap > min(tolerance, opened.max() / 2)]
    raise DeclarationError(
        f"{robot.name} is over-constrained: {len(system.rows)} closure rows have rank {int(keep.sum())}, but where "
        f"{', '.join(left_out)} are left out the loops open, by {opened.max():.3g} in {', '.join(wide)}.",
        remedy="It moves against Grübler's count. Give a joint of the loop the freedom that it needs, such as a "
        "ball in place of a hinge.",
        rank=int(keep.sum()),
        residual=float(opened.max()),
    )


def _refuse_wrong_placements(robot: Robot, start: Array, declared: int | None) -> None:
    """Raise DeclarationError for rows that are redundant except for wrong placements; it names how far they open.

    Short levers and loops in line make rows that are hardly independent, too: those hold more and more on the way from
    there, leave the number of degrees of freedom that is declared, or lock no joint of a machine with another number of
    motors.
    """
    system = ConstraintSystem(robot)
    try:
        q, keep = _independent_rows(robot, start, 10.0 * _DOUBTFUL, _DOUBTFUL, _DOUBTFUL)
    except DeclarationError:
        return
    rank, velocities = int(keep.sum()), len(system.pose_columns)
    if rank == min(len(keep), velocities) or declared not in (None, velocities - rank):
        return
    fewer, doubtful = _with_rows(robot, keep)
    free, held = (
        np.abs(free_motions(each, q, EXACT)).max(axis=0, initial=0.0) for each in (ConstraintSystem(fewer), system)
    )
    if robot.m != velocities - rank and not ((free > FILE_TOLERANCE) & (held < FILE_TOLERANCE)).any():
        return
    around, gaps = _opened(robot, fewer, q)
    opened = float(gaps.max())
    least = [float(np.linalg.svd(system.closure_rows(each), compute_uv=False)[rank]) for each in around]
    residual = max(opened, least[0])
    wrong = max(least) <= _DOUBTFUL if opened > FILE_TOLERANCE else FILE_TOLERANCE < max(least) <= 2.0 * least[0]
    if wrong:
        raise DeclarationError(
            f"{robot.name} has closure rows that are redundant except for {residual:.3g} (characteristic "
            f"lengths or rad): {', '.join(doubtful)}.",
            remedy=f"Correct the placements of joints and closures, of which {FILE_TOLERANCE:g} counts as rounding; or "
            "write a declaration with as many independent joints as these rows leave.",
            residual=residual,
        )


def _independent_rows(
    robot: Robot, start: Array, tolerance: float, rank_tolerance: float, apart: float
) -> tuple[Array, BoolArray]:
    """Return a closed configuration (nq,) and (r,) which rows are independent around it, at the place where most are.

    At a singular reference the rank is lower than around it. The first tolerances are those of ``closed_near``,
    ``apart``: as in ``independent_columns``.
    """
    system, q = ConstraintSystem(robot), closed_near(robot, start, tolerance, rank_tolerance)
    around = closed_neighbours(system, q, *_AROUND, tolerance, rank_tolerance)
    keep = np.zeros(len(system.rows), dtype=bool)
    keep[max((independent_columns(system.closure_rows(each).T, apart) for each in around), key=len)] = True
    return q, keep


def _opened(robot: Robot, fewer: Robot, q: Array) -> tuple[Array, Array]:
    """Return configurations (N, nq) closed in fewer rows around q (nq,), and (r,) the largest residual of each row.

    Residuals are in characteristic lengths or rad.
    """
    system, around = ConstraintSystem(robot), closed_neighbours(ConstraintSystem(fewer), q, *_AROUND)
    opened: Array = np.abs(system.evaluate(around).phi / system.closure_unit).max(axis=0)
    return around, opened


def _with_rows(robot: Robot, keep: BoolArray) -> tuple[Robot, tuple[str, ...]]:
    """Return the robot with some of its closure rows, and the names of the others."""
    closures, row = [], 0
    for closure in robot.closures:
        axes = tuple(axis for i, axis in enumerate(closure.axes) if keep[row + i])
        row += len(closure.axes)
        if axes:
            closures.append(replace(closure, axes=axes))
    couplings = tuple(each for each, kept in zip(robot.couplings, keep[row:], strict=True) if kept)
    return replace(robot, closures=tuple(closures), couplings=couplings), tuple(
        name for name, kept in zip(row_names(robot), keep, strict=True) if not kept
    )


def _independent(robot: Robot, q: Array) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints whose velocities the closures leave free, preferably actuated ones.

    Behind them those of several freedoms that are left free in part.

    Of joints with several freedoms none can be independent, so they are made dependent first, then joints that follow
    others by couplings, then passive ones.
    """
    model, system = robot.model, ConstraintSystem(robot)
    columns = system.pose_columns.tolist()
    rows = system.closure_rows(q)
    owner = {}
    for index in range(1, model.njoints):
        joint = model.joints[index]
        owner.update({joint.idx_v + i: (str(model.names[index]), int(joint.nv)) for i in range(joint.nv)})
    wide = [i for i, column in enumerate(columns) if owner[column][1] > 1]
    driven = [i for i, column in enumerate(columns) if owner[column][0] in robot.actuated]
    follow = {coupling.joint for coupling in robot.couplings}
    following = [i for i, column in enumerate(columns) if owner[column][0] in follow and i not in (*wide, *driven)]
    passive = [i for i in range(len(columns)) if i not in (*wide, *driven, *following)]
    dependent = _dependent(rows, [wide, following, passive, driven])
    free = [i for i in range(len(columns)) if i not in dependent]
    loose = tuple(sorted({owner[columns[i]][0] for i in free if i in wide}))
    names = {owner[columns[i]][0] for i in free}
    first = [name for name in robot.actuated if name in names]
    return (*first, *(str(name) for name in model.names if str(name) in names and str(name) not in first)), loose


def _dependent(rows: Array, classes: Sequence[Sequence[int]]) -> set[int]:
    """Return as many columns as the rows have rank, independent of one another, from the first classes where possible.

    Each column counts in its own length. Columns that are nearly dependent on the ones taken already wait until all
    classes were asked, and so do those that move the loops by no more than the rounding of a file (the spin of a rod).
    """
    size = np.linalg.norm(rows, axis=0)
    rank, taken = len(independent_columns(rows.T, EXACT)), list[int]()
    for apart, short in ((_WELL_APART, FILE_TOLERANCE), (RANK_TOLERANCE, RANK_TOLERANCE)):
        own = np.where(size > short, size, np.inf)
        for group in classes:
            taken = independent_columns(rows / own, apart, taken=taken, among=group, most=rank)
    return set(taken)
