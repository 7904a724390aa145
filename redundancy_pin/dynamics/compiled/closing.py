"""Closing the loops of a compiled robot along a motion: the branch of the reference, followed by the driver.

A motion is lifted in as many parts as there are threads, which count only if they join; where it cannot be followed the
samples are marked, or an error says what is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.dynamics.compiled.build import Library
from redundancy_pin.errors import (
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
    millimetres,
)
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import random_spread
from redundancy_pin.robot.scales import closure_tolerance, position_unit, velocity_unit

CLOSED, _LOST, _SINGULAR, _OTHER_MODE, NOT_FINITE = range(5)
"""Statuses of the driver."""

_STARTS = 60
"""Random configurations from which a pose is looked for that the straight way from the reference does not reach."""

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
        self.kernel.map("rp_coordinates", 1, [q[None], self.kernel.trig_at(q[None])], [x[None]])
        return q, x


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


def lifted(loops: Loops, motion: PlatformMotion, *, mark: bool) -> Lifted:
    """Return the tree's motion along one of the platform; with ``mark``, samples that do not close are NaN."""
    robot, samples = loops.robot, len(motion)
    x = np.ascontiguousarray(motion.x.reshape(samples, -1))
    nq, nv, n, m = robot.model.nq, robot.model.nv, robot.n, robot.m
    shapes = ((nq,), (loops.kernel.trigs,), (nv,), (nv,), (nv, n), (n, m))
    arrays = [np.empty((samples, *shape)) for shape in shapes]  # samples that are not closed become NaN below
    arrays += [np.full(samples, np.nan) for _ in ("gap", "margin")]
    status = np.full(samples, _LOST, dtype=np.intc)
    first, failed = 0, 0
    start = _start(loops, motion, 0, mark)
    while True:
        if start is not None:
            failed = _run(loops, motion, x, first, start, arrays, status)
            # the sample that cannot be followed stays marked: what is reacquired behind it may be another branch
            first = failed
        first += 1
        if not mark or first >= samples:
            break
        away = first - failed
        start = _start(loops, motion, first, mark, thorough=away & (away - 1) == 0)
    status[(status == CLOSED) & _blurred(arrays[2], arrays[3], velocity_unit(robot), arrays[7])] = _SINGULAR
    good: BoolArray = status == CLOSED
    if not good.all():
        if not mark:
            _refuse(loops, motion, x, arrays, status, int(np.argmin(good)))
        for array in arrays[:6]:
            array[~good] = np.nan
        missing = np.flatnonzero(~good)
        for k in missing[np.isnan(arrays[6][missing])]:
            arrays[6][k] = _nearest(loops, x[k], arrays[0], int(k))[1]
    q, trig, v, a, gamma, W, gap, margin = (read_only(array) for array in arrays)
    return Lifted(motion, q, trig, v, a, gamma, W, gap, margin, read_only(good))


def _blurred(v: Array, a: Array, unit: Array, margin: Array) -> BoolArray:
    """Return (N,) where v and a (N, nv), over their units (nv,), show a rank loss that the motion steps across.

    A configuration that is good to 1e-16 gives accelerations to the square of the rates times 1e-16 / margin³. A share
    of 1e-5 and more of them is too much; towards a stretched leg they are themselves as large as rates squared over the
    margin squared, and stay good. Small margins all along, as of short levers, are none.
    """
    usual = margin[np.isfinite(margin)].max(initial=0.0)
    if not (margin < 0.1 * usual).any():
        return np.zeros(len(margin), dtype=bool)
    with np.errstate(invalid="ignore", over="ignore"):
        squared = np.abs(v / unit).max(axis=1) ** 2
        size = np.maximum(np.abs(a / unit).max(axis=1), squared)
        result: BoolArray = (margin < 0.1 * usual) & (margin**3 * size < 1e-16 / 1e-5 * squared)
    return result


def _run(
    loops: Loops,
    motion: PlatformMotion,
    x: Array,
    first: int,
    start: Array,
    arrays: list[Array],
    status: NDArray[np.intc],
) -> int:
    """Lift the samples from ``first`` on; return the first that is not closed, or how many there are.

    A whole motion is lifted in as many parts as there are threads, which count only if they join.
    """
    kernel, samples = loops.kernel, len(motion)
    # a motion keeps the layout it was given in, say of a transposed array; C reads row by row
    t, xd, xdd = (np.ascontiguousarray(part) for part in (motion.t, motion.xd, motion.xdd))

    def inverse_kinematics(part: slice, q: Array) -> int:
        rest = [array[part] for array in (t, x, xd, xdd)]
        outputs = [*(array[part] for array in arrays), status[part]]
        return kernel.call("rp_lift", part.stop - part.start, *rest, q, x[part.start], *outputs)

    parts = parts_of(samples, loops.threads)
    if len(parts) > 1 and first == 0:
        starts = [start]
        for part in parts[1:]:
            q = starts[-1].copy()
            if kernel.call("rp_follow", q, x[parts[len(starts) - 1].start], x[part.start]) != CLOSED:
                break
            starts.append(q)
        if len(starts) == len(parts):
            each(lambda pair: inverse_kinematics(*pair), list(zip(parts, starts, strict=True)))
            if (status == CLOSED).all() and all(_joined(loops, arrays[0], x, part.start) for part in parts[1:]):
                return samples
        status[:] = _LOST  # the straight way to a part led elsewhere than the motion: one after the other
    return first + inverse_kinematics(slice(first, samples), start)


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


def _start(loops: Loops, motion: PlatformMotion, sample: int, mark: bool, thorough: bool = True) -> Array | None:
    """Return a configuration (nq,) closed at a sample: straight from the reference, or the nearest in the mode.

    None, with ``mark``, where there is none.
    """
    kernel = loops.kernel
    reference, home = loops.reference
    x = np.ascontiguousarray(motion.x[sample].reshape(-1))
    q, here = reference.copy(), home
    for target in waypoints(home, x, motion.is_pose):
        status = kernel.call("rp_follow", q, here, target)
        here = target
        if status == _LOST:
            break
    if status == CLOSED:
        return q
    best, gap = _multistart(loops, x) if thorough else (None, np.nan)
    if best is not None:
        return best
    if mark:
        return None
    raise _no_start(loops, motion, sample, gap)


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


def _multistart(loops: Loops, x: Array) -> tuple[Array | None, float]:
    """Return the configuration nearest to the reference in the working mode, and the smallest gap that was met."""
    kernel, robot = loops.kernel, loops.robot
    reference, _ = loops.reference
    random, spread = np.random.default_rng(0), random_spread(robot)
    best, nearest, least = None, np.inf, np.inf
    for trial in range(_STARTS):
        step = random.uniform(-1.0, 1.0, len(spread)) * spread if trial else np.zeros(len(spread))
        q: Array = pin.integrate(robot.model, reference, step)
        gap = kernel.assemble(q, x)
        least = min(least, gap)
        if gap < closure_tolerance(robot) and kernel.call("rp_follow", q, x, x) == CLOSED:
            away = float(np.abs(pin.difference(robot.model, reference, q) / velocity_unit(robot)).max())
            if away < nearest:
                best, nearest = q, away
    return best, least


def _nearest(loops: Loops, x: Array, q: Array, k: int) -> tuple[Array, float]:
    """Return where Newton's method ends at sample k from the last one that was closed, and by how much it is open."""
    known = np.flatnonzero(~np.isnan(q[:k, 0]))
    nearest = q[known[-1]].copy() if len(known) else loops.reference[0].copy()
    return nearest, loops.kernel.assemble(nearest, x)


def _is_singular(kernel: Library, q: Array, x: Array, size: int) -> bool:
    """Return whether K is singular at a configuration, to the square root of rounding."""
    residual, K, alignment = np.empty((1, size)), np.empty((1, size, size)), np.empty((1, kernel.alignments))
    kernel.map("rp_rows", 1, [q[None], kernel.trig_at(q[None]), x[None]], [residual, K, alignment])
    return bool(np.linalg.cond(K[0]) > _SINGULAR_CONDITION)


_SINGULAR_CONDITION = 1e5
"""Ratio of singular values above which K counts as singular in a message: Newton reaches a double root to 1e-6."""


# --- what is wrong ----------------------------------------------------------------------------------------------------


def _no_start(loops: Loops, motion: PlatformMotion, sample: int, gap: float) -> RedundancyPinError:
    robot, pose = loops.robot, f"The pose of sample {sample}, x = {np.round(motion.x[sample], 6).tolist()},"
    if gap < closure_tolerance(robot) and robot.working_modes is not None:
        return WorkingModeError(
            f"{pose} closes only in other working modes than {_mode(robot)} of {robot.name}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            sample=sample,
        )
    if gap < closure_tolerance(robot):
        return SingularPoseError(
            f"{pose} is a type I singularity: the platform velocity does not determine the joint velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=sample,
        )
    return UnreachablePoseError(
        f"{pose} cannot be reached in the working mode of {robot.name}: the chains stay open by {gap:.3g} m."
        f"{millimetres(gap, robot.characteristic_length)}",
        remedy="Move the pose into the workspace, or load the robot in another working_mode.",
        sample=sample,
        gap=gap,
    )


def _refuse(
    loops: Loops, motion: PlatformMotion, x: Array, arrays: list[Array], status: NDArray[np.intc], k: int
) -> None:
    when = f"sample {k} (t = {motion.t[k]:.6g} s"
    if status[k] == _OTHER_MODE:
        raise WorkingModeError(
            f"The motion leaves the working mode {_mode(loops.robot)} at {when}).",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
        )
    nearest, gap = _nearest(loops, x[k], arrays[0], k)
    if status[k] == _LOST and gap >= closure_tolerance(loops.robot):
        raise UnreachablePoseError(
            f"The pose of {when}, x = {np.round(motion.x[k], 6).tolist()}) cannot be reached: the chains stay open by "
            f"{gap:.3g} m.{millimetres(gap, loops.robot.characteristic_length)}",
            remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
            sample=k,
            gap=gap,
        )
    if status[k] == _SINGULAR or _is_singular(loops.kernel, nearest, x[k], loops.robot.model.nv - loops.robot.k):
        raise SingularPoseError(
            f"At {when}) the motion meets a type I singularity: the platform velocity does not determine the joint "
            "velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=k,
        )
    raise WorkingModeError(
        f"The motion cannot be followed continuously to {when}): the way there leaves the workspace or passes a type I "
        "singularity (a leg at full stretch, full fold or zero length).",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=k,
    )


def _mode(robot: Robot) -> str:
    return "".join("+" if sign > 0 else "-" for sign in robot.working_mode)
