"""Closing the loops of a compiled robot along a motion: the branch of the reference, followed by the driver.

A motion is followed in as many parts as there are threads, which count only if they join. The driver does not say why
it fails: a motion that it cannot follow goes to ``kinematics``, which names what is wrong, marks samples, or passes the
bifurcation. Motions that the driver follows share nothing with ``kinematics``.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.dynamics.compiled.build import Library
from redundancy_pin.dynamics.compiled.parameters import trig_at, turning_joints
from redundancy_pin.errors import WorkingModeError
from redundancy_pin.kinematics.branch import BranchEnd, ClosedState, follower, known_state
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import position_unit

CLOSED, _LOST = range(2)
"""Statuses of the driver: CLOSED, and the one of samples that it has not come to."""

_PER_THREAD = 400
"""Samples below which a second thread costs more than it brings."""

LARGEST_TURN = 0.5
"""Longest turn, rad, of a pose at a time on the way from the reference: half a turn away the direction is lost."""


@dataclass(frozen=True, eq=False)
class Loops:
    """What closes the loops of a robot, and threads for many samples."""

    robot: Robot
    kernel: Library
    threads: int

    @cached_property
    def reference(self) -> tuple[Array, Array]:
        """The reference configuration (nq,) and its coordinates, (n,) or the 16 of a pose."""
        q, platform = np.array(self.robot.q_reference), self.robot.platform
        x = np.empty(16 if platform is not None and platform.is_pose else self.robot.n)
        self.kernel.map("rp_coordinates", 1, [q[None], trig_at(self.robot, q[None])], [x[None]])
        return q, x


class Start(NamedTuple):
    """A configuration q (nq,) to go on from, and its Γ (nv, n) where K may have no inverse, as at a rank loss."""

    q: Array
    gamma: Array | None


class Lifted(NamedTuple):
    """Motion of the tree; see ``kinematics.inverse_kinematics.JointTrajectory``."""

    motion: PlatformMotion
    q: Array
    trig: Array
    v: Array
    a: Array
    gamma: Array
    W: Array
    gap: Array
    margin: Array
    reachable: BoolArray


def lifted(loops: Loops, motion: PlatformMotion, *, mark: bool, start: Start | None = None) -> Lifted:
    """Return the tree's motion along one of the platform.

    Args:
        loops: of the robot.
        motion: the platform's.
        mark: leave samples that do not close NaN in place of raising.
        start: where kinematics go on from, in place of the reference.

    Raises:
        RedundancyPinError: what ``kinematics.inverse_kinematics`` raises.
    """
    robot, samples = loops.robot, len(motion)
    q0 = _start(loops, motion) if start is None else None
    if q0 is not None:
        x = np.ascontiguousarray(motion.x.reshape(samples, -1))
        nq, nv, n, m = robot.model.nq, robot.model.nv, robot.n, robot.m
        shapes = ((nq,), (2 * len(turning_joints(robot)),), (nv,), (nv,), (nv, n), (n, m), (), ())
        arrays = [np.empty((samples, *shape)) for shape in shapes]
        status = np.full(samples, _LOST, dtype=np.intc)
        _run(loops, motion, x, q0, arrays, status)
        good: BoolArray = status == CLOSED
        if good.all():
            q, trig, v, a, gamma, W, gap, margin = (read_only(array) for array in arrays)
            return Lifted(motion, q, trig, v, a, gamma, W, gap, margin, read_only(good))
    state = None if start is None else _state_at(robot, start)
    tree = inverse_kinematics(robot, motion, mark_unreachable=mark, start=state)
    trig = read_only(trig_at(robot, tree.q))
    return Lifted(
        motion, tree.q, trig, tree.v, tree.a, tree.gamma, tree.W, tree.gap, tree.serial_margin_bound, tree.reachable
    )


def _start(loops: Loops, motion: PlatformMotion) -> Array | None:
    """Return a configuration (nq,) closed at the first sample: straight from the reference; otherwise by kinematics.

    None where a motion of one sample, or a first sample out of reach, is for kinematics as a whole.
    """
    reference, here = loops.reference
    x, q, status = np.ascontiguousarray(motion.x[0].reshape(-1)), reference.copy(), CLOSED
    for target in waypoints(here, x, motion.is_pose):
        status = loops.kernel.call("rp_follow", q, here, target)
        here = target
        if status == _LOST:
            break
    if status == CLOSED:
        return q
    if len(motion) == 1:
        return None
    tree = inverse_kinematics(loops.robot, motion[:1], mark_unreachable=True)
    return np.array(tree.q[0]) if tree.reachable[0] else None


def _state_at(robot: Robot, start: Start) -> ClosedState:
    """Return the closed state at a start; raises WorkingModeError where the chains do not close nearby."""
    own, q = follower(robot), start.q.copy()
    q[robot.carrier_position] = 0.0
    own.chain.place(q)
    x = read_only(own.chain.coordinates(q))
    if start.gamma is not None:
        return known_state(robot, x, q, start.gamma)
    closed = own.close(q, x)
    if closed is None:
        raise WorkingModeError(
            f"The chains of {robot.name} do not close at the start, or K is singular there: no branch goes on from it.",
            remedy="Start from a closed configuration away from singularities.",
        )
    return closed


def follow_motors(robot: Robot, q: Array, position: Array) -> Array | None:
    """Return the configuration (nq,) at positions (m,) of the main actuators on the branch of another one, or None.

    The motors move straight, as the independent coordinates of a robot without a platform.
    """
    if robot.m != robot.n:
        return None
    driven = replace(robot, platform=None, independent_joints=robot.actuated, working_modes=None, working_mode=())
    try:
        here = _state_at(driven, Start(q, None))
    except WorkingModeError:
        return None
    reached = follower(driven).advance(here, position)
    return np.array(reached.q) if isinstance(reached, ClosedState) else None


def _run(
    loops: Loops,
    motion: PlatformMotion,
    x: Array,
    start: Array,
    arrays: list[Array],
    status: NDArray[np.intc],
) -> None:
    """Follow all samples, in as many parts as there are threads, which count only if they join."""
    kernel, samples = loops.kernel, len(motion)
    # a motion keeps the layout it was given in, say of a transposed array; C reads row by row
    t, xd, xdd = (np.ascontiguousarray(part) for part in (motion.t, motion.xd, motion.xdd))

    def follow(part: slice, q: Array) -> None:
        rest = [array[part] for array in (t, x, xd, xdd)]
        outputs = [*(array[part] for array in arrays), status[part]]
        kernel.call("rp_lift", part.stop - part.start, *rest, q, x[part.start], *outputs)

    parts = parts_of(samples, loops.threads)
    if len(parts) > 1:
        starts = [start]
        for part in parts[1:]:
            q = starts[-1].copy()
            if kernel.call("rp_follow", q, x[parts[len(starts) - 1].start], x[part.start]) != CLOSED:
                break
            starts.append(q)
        if len(starts) == len(parts):
            each(lambda pair: follow(*pair), list(zip(parts, starts, strict=True)))
            if (status == CLOSED).all() and all(_joined(loops, arrays[0], x, part.start) for part in parts[1:]):
                return
        status[:] = _LOST  # the straight way to a part led elsewhere than the motion: one after the other
    follow(slice(0, samples), start)


def _joined(loops: Loops, q: Array, x: Array, k: int) -> bool:
    """Return whether sample k continues the branch of the one before."""
    reached = q[k - 1].copy()
    closed = loops.kernel.call("rp_follow", reached, x[k - 1], x[k]) == CLOSED
    return closed and float(np.abs((reached - q[k]) / position_unit(loops.robot)).max()) < _SAME


_SAME = 1e-9
"""Two configurations nearer than this (rad, characteristic lengths) are one, computed twice."""


def parts_of(samples: int, threads: int) -> list[slice]:
    """Return parts of many samples, one a thread, of few all in one."""
    count = min(threads, samples // _PER_THREAD)
    if count <= 1:
        return [slice(0, samples)]
    edges = np.linspace(0, samples, count + 1).round().astype(int).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


def each(work: Callable[[Any], Any], items: list[Any]) -> None:
    """Do some work for each item, in a thread each; compiled code runs beside Python."""
    if len(items) == 1:
        work(items[0])
        return
    with ThreadPoolExecutor(len(items)) as pool:
        list(pool.map(work, items))


def waypoints(home: Array, x: Array, is_pose: bool) -> list[Array]:
    """Return coordinates on the way from one pose to another, the last one last; a pose turns a little at a time."""
    if not is_pose:
        return [x]
    first, last = home.reshape(4, 4), x.reshape(4, 4)
    rotations = Rotation.from_matrix(np.stack([first[:3, :3], last[:3, :3]]))
    angle = (rotations[1] * rotations[0].inv()).magnitude()
    shares = np.linspace(0.0, 1.0, int(np.ceil(angle / LARGEST_TURN)) + 1)[1:] if angle > 0.0 else np.ones(1)
    poses = np.repeat(np.eye(4)[None], len(shares), axis=0)
    poses[:, :3, :3] = Slerp([0.0, 1.0], rotations)(shares).as_matrix()
    poses[:, :3, 3] = first[:3, 3] + shares[:, None] * (last[:3, 3] - first[:3, 3])
    poses[-1] = last
    return [pose.ravel() for pose in poses]


def branch_ends(robot: Robot, q: Array, x0: Array, x: Array) -> bool:
    """Return whether no configuration at x continues the branch of q (nq,), which is closed at x0 nearby."""
    own, configuration = follower(robot), q.copy()
    configuration[robot.carrier_position] = np.array(robot.q_reference)[robot.carrier_position]
    here = own.close(configuration, x0)
    reached = None if here is None else own.advance(here, x)
    return isinstance(reached, BranchEnd) and reached.is_final
