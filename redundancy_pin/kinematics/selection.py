"""Which closure rows count and which joints are independent, for models that do not say it.

A loop closed by a ball or a weld has more rows than it needs: of the three of a ball in a planar loop one is redundant.
Rows are left out where they depend on the others at the reference and all around it, and only where the loops stay
closed in the rows that were left out. The rank at one configuration proves nothing: a mechanism that moves against
Grübler's count (Bricard's six hinges) has rows that are redundant there and still keep a hinge from opening.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, RANK_TOLERANCE, Array, BoolArray
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.closing import close, closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system, with_all_rows
from redundancy_pin.kinematics.mobility import free_motions, independent_columns, row_names
from redundancy_pin.kinematics.multistart import SEED, draw_starts
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link_index

_NEIGHBOURS, _SPREAD = 6, 0.1
"""Configurations around the reference, and how far the joints are from it, rad, or in characteristic lengths."""

STAYS_CLOSED = 1e-8
"""Largest residual of rows that are left out, characteristic lengths or rad. Newton leaves 1e-11; false ones open by
1e-3 and more."""

_ROUNDED = 2e-5
"""The same where a file's numbers are rounded, with a note: axes that are parallel except for five digits of π/2
(1.5708) open by 5e-6."""

_REDUNDANT = 1e-6
"""Scaled singular values, relative to the largest, of rows that are redundant."""

_WELL_APART = 1e-2
"""A velocity whose column is nearer to the others, in its own length, is taken as dependent only where there is no
other: it would make a reference next to a singularity of type I."""

_SHORT = 1e-3
"""Of the longest column: shorter ones count as this long there. What spins a rod between two balls is 2e-5 and less
where the file is rounded."""


UNIVERSAL = "::universal"
"""How names of frames end between which a row holds the spin of a rod."""


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


class _Rod(NamedTuple):
    """A body between two balls.

    Attributes:
        closure: number of the closure that is the second ball, None where it is a joint.
        ends: the joints that carry the two sides of the second ball.
        near: (3,) centre of the first ball, m.
        far: (3,) centre of the second ball, m.
    """

    closure: int | None
    ends: tuple[int, ...]
    near: Array
    far: Array


def selected(robot: Robot, q: Array, *, redundant: bool, rounded: bool, resisted: Collection[str] = ()) -> Selection:
    """Choose closure rows and independent joints near a configuration.

    Args:
        robot: a robot without independent velocities.
        q: (nq,) a configuration from which the loops can be closed.
        redundant: let rows be redundant and leave them out; else they stay, and the loader refuses them by name.
        rounded: the robot's numbers are those of a file of another program, which may have rounded them.
        resisted: balls with damping or armature: of two on a rod its spin is held there, where it is held by these too.

    Raises:
        DeclarationError: the loops do not close; rows that depend on the others at the reference only; or a joint of
            several freedoms that the loops leave free.
    """
    opens = _ROUNDED if rounded else STAYS_CLOSED
    q = closed_near(robot, q, opens if redundant else CLOSURE_TOLERANCE)
    left_out: tuple[str, ...] = ()
    opened = 0.0
    if redundant and (robot.closures or robot.couplings):
        robot, left_out, opened = _without_redundant_rows(robot, q, opens)
    independent, loose = _independent(robot, q)
    rods = {name: rod for name in loose if redundant and (rod := _spins(robot, name, q)) is not None}
    fixed_spins = tuple(rods)
    near = _ROUNDED * robot.characteristic_length
    off_axis = {name: away for name, rod in rods.items() if (away := _off_axis(robot, name, rod, q)) > near}
    for name in fixed_spins:
        robot = _with_spin_fixed(robot, name, q, at_first=name in resisted)
    if fixed_spins:
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
    return Selection(robot, left_out, opened, fixed_spins, off_axis, independent, q)


def rows_at(robot: Robot, q: Array) -> Robot:
    """Return a robot whose redundant rows were left out with those rows that say most at a closed configuration."""
    full = with_all_rows(robot)
    rows = constraint_system(full).closure_rows(q)
    keep = np.zeros(len(rows), dtype=bool)
    keep[independent_columns(rows.T, most=len(constraint_system(robot).rows))] = True
    return replace(_with_rows(full, keep)[0], all_closures=robot.all_closures)


def _spins(robot: Robot, joint: str, q: Array) -> _Rod | None:
    """Return the rod that a ball joint carries, if it has one more end, another ball, of a closure or of the tree."""
    model, data = robot.model, robot.model.createData()
    index = find_joint_index(model, joint)
    if model.joints[index].nq != 4:
        return None
    pin.framesForwardKinematics(model, data, q)
    joints = [each for each in range(index + 1, model.njoints) if model.parents[each] == index]
    ends = [_Rod(None, (index, each), data.oMi[index].translation, data.oMi[each].translation) for each in joints]
    for number, closure in enumerate(robot.closures):
        frames = [find_link_index(model, name) for name in (closure.frame_a, closure.frame_b)]
        carriers = tuple(int(model.frames[frame].parentJoint) for frame in frames)
        for frame, carrier in zip(frames, carriers, strict=True):
            if carrier == index:
                ends.append(_Rod(number, carriers, data.oMi[index].translation, data.oMf[frame].translation))
    if len(ends) != 1 or (np.linalg.norm(ends[0].far - ends[0].near) <= RANK_TOLERANCE * robot.characteristic_length):
        return None
    rod = ends[0]
    is_ball = model.joints[joints[0]].nq == 4 if rod.closure is None else robot.closures[rod.closure].axes == AXES[:3]
    return rod if is_ball else None


def _off_axis(robot: Robot, joint: str, rod: _Rod, q: Array) -> float:
    """Return how far the centre of mass of a rod is from the line between its balls, m; zero without a mass."""
    model, data, index = robot.model, robot.model.createData(), find_joint_index(robot.model, joint)
    if model.inertias[index].mass == 0.0:
        return 0.0
    pin.forwardKinematics(model, data, q)
    along, centre = rod.far - rod.near, data.oMi[index].act(model.inertias[index].lever) - rod.near
    return float(np.linalg.norm(np.cross(along, centre)) / np.linalg.norm(along))


def _with_spin_fixed(robot: Robot, joint: str, q: Array, *, at_first: bool) -> Robot:
    """Return the robot with one row more: a universal joint in place of the first or second of two balls on a rod."""
    rod = _spins(robot, joint, q)
    if rod is None:
        return robot
    model = pin.Model(robot.model)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    z = (rod.far - rod.near) / np.linalg.norm(rod.far - rod.near)
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    place = pin.SE3(np.column_stack([x, np.cross(z, x), z]), rod.near if at_first else rod.far)
    index = find_joint_index(model, joint)
    ends = (int(model.parents[index]), int(index)) if at_first else rod.ends
    names = f"{joint}:a{UNIVERSAL}", f"{joint}:b{UNIVERSAL}"
    for name, carrier in zip(names, ends, strict=True):
        model.addFrame(pin.Frame(name, carrier, data.oMi[carrier].inverse() * place, pin.FrameType.BODY))
    spin = Closure(f"spin of {joint}", names[0], names[1], ("rz",))
    if at_first or rod.closure is None:
        return replace(robot, model=model, closures=(*robot.closures, spin))
    closures = list(robot.closures)
    closures[rod.closure] = replace(spin, name=closures[rod.closure].name, axes=(*AXES[:3], "rz"))
    return replace(robot, model=model, closures=tuple(closures))


def _without_redundant_rows(robot: Robot, q: Array, most: float) -> tuple[Robot, tuple[str, ...], float]:
    """Return the robot with the rows that count, the names of the others, and how far these open (at ``most``)."""
    system = ConstraintSystem(robot)
    # at a singular reference the rank is lower than around it, and the choice is made where it is not
    rows = [system.closure_rows(each) for each in _neighbours(system, q, most)]
    chosen = max((independent_columns(each.T, _REDUNDANT) for each in rows), key=len)
    keep = np.zeros(len(system.rows), dtype=bool)
    keep[chosen] = True
    if keep.all():
        return robot, (), 0.0
    fewer, left_out = _with_rows(robot, keep)
    # with these rows alone, do the others stay closed?
    again = _neighbours(ConstraintSystem(fewer), q)
    opened = np.abs(system.evaluate(again).phi / system.closure_unit).max(axis=0)
    if opened.max() <= most:
        return fewer, left_out, float(opened.max())
    wide = [name for name, gap in zip(row_names(robot), opened, strict=True) if gap > most]
    raise DeclarationError(
        f"{robot.name} is over-constrained: {len(system.rows)} closure rows have rank {len(chosen)}, but where "
        f"{', '.join(left_out)} are left out the loops open, by {opened.max():.3g} in {', '.join(wide)}.",
        remedy="It moves against Grübler's count. Give a joint of the loop the freedom that it needs, such as a "
        "ball in place of a hinge.",
        rank=len(chosen),
        residual=float(opened.max()),
    )


def _neighbours(system: ConstraintSystem, q: Array, tolerance: float = CLOSURE_TOLERANCE) -> Array:
    """Return configurations (N, nq) closed to a relative tolerance, the first of them q itself.

    They are displaced along the motions that the rows leave free: from anywhere else Newton's method may turn a short
    lever over.
    """
    rng, free = np.random.default_rng(SEED), free_motions(system, q, _REDUNDANT)
    starts = draw_starts(system, q, _NEIGHBOURS, rng, turn=_SPREAD, slide=_SPREAD, along=free)
    reached = [close(system, each) for each in (q, *starts)]
    closed = [each for each, gap in reached if gap < tolerance * system.robot.characteristic_length]
    return np.array(closed) if closed else q[None]


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
    """Return the joints whose velocities the closures leave free, actuated ones where there is a choice.

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
    classes were asked.
    """
    size = np.linalg.norm(rows, axis=0)
    own = np.where(size < RANK_TOLERANCE, np.inf, np.maximum(size, _SHORT * size.max(initial=0.0)))
    rank, taken = len(independent_columns(rows.T, _REDUNDANT)), list[int]()
    for apart in (_WELL_APART, RANK_TOLERANCE):
        for group in classes:
            taken = independent_columns(rows / own, apart, taken=taken, among=group, most=rank)
    return set(taken)
