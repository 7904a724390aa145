"""Closing the loops of a compiled robot along a motion: the branch of the reference, followed by the driver.

The driver reports no cause of a failure: a motion that it cannot follow goes to ``kinematics``, which names the cause,
marks samples, or passes the bifurcation. Motions that the driver follows share nothing with ``kinematics``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.compiled.build import Library
from redundancy_pin.dynamics.compiled.parameters import trig_at, turning_joints
from redundancy_pin.errors import SingularPoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import evaluated
from redundancy_pin.kinematics.branch import LONGEST_STEP, BranchEnd, ClosedState, follower
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import coordinates, difference, with_independent_joints
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import column_scale, coordinate_unit, row_scale

_PER_THREAD = 400
"""Samples below which a second thread costs more than it brings."""


Start: TypeAlias = ClosedState | Array
"""Start of the branch for kinematics: a closed state, or a configuration (nq,) at which the chains close. A rank loss
requires a state, whose Γ determines the branch."""


class ClosedMotion(NamedTuple):
    """Motion of the tree with the chains closed, carriers at zero, and ``parameters.trig_at`` of its configurations."""

    tree: JointTrajectory
    trig: Array


def close_motion(
    robot: Robot, kernel: Library, motion: PlatformMotion, *, mark: bool, start: Start | None = None
) -> ClosedMotion:
    """Return the tree's motion along one of the platform.

    Args:
        robot: the robot.
        kernel: its library.
        motion: the platform's.
        mark: leave samples that do not close NaN in place of raising.
        start: state where the branch starts, in place of the reference.

    Raises:
        RedundancyPinError: any error of ``kinematics.inverse_kinematics``.
        WorkingModeError: also as ``Follower.require_near``.
    """
    lifted, here = None, _state_of(robot, start)
    if start is None:
        lifted = _lift(robot, kernel, motion, robot.q_reference)
        if lifted is None and len(motion) > 1:  # its beginning may be on no straight way from the reference
            first = inverse_kinematics(robot, motion[:1], mark_unreachable=True)
            lifted = _lift(robot, kernel, motion, first.q[0]) if first.reachable[0] else None
    if lifted is not None:
        return lifted
    if here is not None:
        follower(robot).require_near(here, motion.x[0])
    tree = inverse_kinematics(robot, motion, mark_unreachable=mark, start=here)
    return ClosedMotion(tree, read_only(trig_at(robot, tree.q)))


def _lift(robot: Robot, kernel: Library, motion: PlatformMotion, q0: Array) -> ClosedMotion | None:
    """Return the tree's motion on the branch of a closed configuration (nq,); None where the driver loses it."""
    # a motion keeps the layout of its input, for example of a transposed array; C reads row by row
    given = [np.ascontiguousarray(part) for part in (motion.t, motion.x, motion.xd, motion.xdd)]
    samples, nq, nv, n, m = len(motion), robot.model.nq, robot.model.nv, robot.n, robot.m
    shapes = ((nq,), (2 * len(turning_joints(robot)),), (nv,), (nv,), (nv, n), (n, m), (), (2,))
    arrays = [np.empty((samples, *shape)) for shape in shapes]
    if kernel.call("rp_lift", samples, *given, np.array(q0), *arrays) < samples:
        return None
    q, trig, v, a, gamma, W, residual, sizes = map(read_only, arrays)
    everywhere = read_only(np.ones(samples, dtype=bool))
    return ClosedMotion(JointTrajectory(robot, motion, q, v, a, gamma, W, residual, everywhere, sizes[:, 0]), trig)


def _state_of(robot: Robot, start: Start | None) -> ClosedState | None:
    """Return the closed state at a start, None without one.

    Raises:
        SingularPoseError: K is singular there, so that no branch continues from it.
        WorkingModeError: the chains do not close next to it.
    """
    if start is None or isinstance(start, ClosedState):
        return start
    closed, remedy = follower(robot).state_at(start), "Start from a closed configuration away from singularities."
    if closed is not None and closed.margin > 0.0:
        return closed
    if evaluated(constraint_system(robot), start[None]).singular[0]:
        raise SingularPoseError(f"The start of {robot.name} is singular: no branch continues from it.", remedy=remedy)
    raise WorkingModeError(f"The chains of {robot.name} do not close at the start.", remedy=remedy)


class Driven(NamedTuple):
    """A configuration from the main actuators: q (nq,), v (nv,), x and xd as of ``JointStateSample``.

    ``state``: start of the next sample, whose coordinates are the main actuators'; ``margin``: smallest singular value
    of the scaled W, and ``serial_margin`` of its inverse, zero at a type I singularity; ``closing_margin`` of K, zero
    also at a rank loss of the closures, no units; ``residual`` of the closures, m.
    """

    q: Array
    v: Array
    x: Array
    xd: Array
    state: ClosedState
    margin: float
    serial_margin: float
    closing_margin: float
    residual: float


@lru_cache(maxsize=32)
def _driven(robot: Robot) -> Robot:
    """Return the robot with its main actuators as coordinates; made once, for its follower is."""
    return with_independent_joints(robot, robot.actuated)


def follow_motors(robot: Robot, start: Start | None, position: Array, velocity: Array) -> Driven:
    """Return the configuration at positions (m,) and velocities (m,) of as many main actuators as degrees of freedom.

    They move straight, as the independent coordinates of a robot without a platform, whose K may be singular where that
    of the robot is not. With u̇ of the actuators ẋ = J_x Γ u̇, so that W⁻ᵀ = J_x Γ.

    Args:
        robot: the robot.
        start: state where the branch starts.
        position: (m,) positions of the main actuators, m and rad.
        velocity: (m,) their rates.

    Raises:
        UnreachablePoseError: as ``inverse_kinematics``.
        WorkingModeError: as ``inverse_kinematics``, and ``Follower.require_near``.
        SingularPoseError: a type II singularity, or a rank loss that no smooth branch leads through.
    """
    driven = _driven(robot)
    here = _state_of(driven, start)
    if here is not None:
        follower(driven).require_near(here, position)
    motion = PlatformMotion(np.zeros(1), position[None], velocity[None], np.zeros((1, robot.m)), check_rates=False)
    tree = inverse_kinematics(driven, motion, start=here)
    q, v, gamma, own = tree.q[0], tree.v[0], tree.gamma[0], follower(robot)
    closed = own.state_at(q)
    closing_margin = 0.0 if closed is None else closed.margin
    own.chain.update(q, v)
    by_motors = own.chain.platform_jacobian() @ gamma
    sizes = np.linalg.svd(by_motors * row_scale(robot)[:, None] / column_scale(robot), compute_uv=False)
    margins = 1.0 / float(sizes[0]), float(sizes[-1]), closing_margin
    x, xd, residual = coordinates(robot, own.chain), by_motors @ velocity, float(tree.residual[0])
    return Driven(q, v, x, xd, tree.state(0), *margins, residual)


def in_threads(work: Callable[[slice], None], samples: int, threads: int) -> None:
    """Run a function on parts of many samples, one thread per part; compiled code releases the interpreter lock."""
    count = max(min(threads, samples // _PER_THREAD), 1)
    edges = np.linspace(0, samples, count + 1).round().astype(int).tolist()
    parts = [slice(*ends) for ends in pairwise(edges)]
    if count == 1:
        work(parts[0])
        return
    with ThreadPoolExecutor(count) as pool:
        list(pool.map(work, parts))


def branch_ends(robot: Robot, q: Array, x0: Array, x: Array) -> bool:
    """Return whether no configuration at x continues the branch of q (nq,), which is closed at x0.

    Only a branch that is a follower's step away at most is followed; others are not known to end.
    """
    own = follower(robot)
    if not np.linalg.norm(difference(robot, x[None], x0[None]) / coordinate_unit(robot)) <= LONGEST_STEP:
        return False
    here = own.state_at(q, x0)
    reached = None if here is None else own.advance(here, x)
    return isinstance(reached, BranchEnd) and reached.is_final
