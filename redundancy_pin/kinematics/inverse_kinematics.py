"""From a platform motion to the motion of the tree: every sample closed, on one branch, in the working mode."""

from __future__ import annotations

import contextlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import NoReturn

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, blocks, read_only, runs
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError, millimetres
from redundancy_pin.kinematics.assembly import (
    Assembly,
    assemble,
    configuration_difference,
    inverses,
    project,
    rates,
)
from redundancy_pin.kinematics.chain import tracker
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system, left_open, with_all_rows
from redundancy_pin.kinematics.continuation import (
    NEAR_RANK_LOSS,
    Anchors,
    Point,
    continuous,
    crosses,
    follow,
    initial_guess,
    loops,
    near_rank_loss,
    reacquire,
    through_rank_loss,
    usual_margin,
)
from redundancy_pin.kinematics.coordinates import difference, in_working_mode, mode_indicator, mode_name, working_modes
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.kinematics.selection import rows_at
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.named import require_matching
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, velocity_unit
from redundancy_pin.robot.whole_turns import follow_whole_turns

_FAR_STARTS = 5
"""Samples of a motion that no Newton from the reference closes anywhere at which multistart is tried before it is
given up."""

SAME_CONFIGURATION = 1e-6
"""Closed configurations of one pose nearer than this (rad, characteristic lengths) are the same, computed twice."""

_ALMOST_CLOSED = 1e-6
"""Residual, in characteristic lengths, that Newton reaches at a rank loss too, where each step halves the error."""

_POOR, _POOR_PART = 0.1, 0.3
"""Margin below which rows that were left out may help those that count, as it is and as a part of the robot's usual
one: at 1e-3 accelerations lose eight digits."""

_HELPED = 3.0
"""How many times larger the margin is with rows that help. Rows that were left out for rounding agree with those that
count to some 1e-10 only, and those that count are what the motion is judged by."""

_NO_SIDE = 1e-6
"""A mode indicator (sine, or characteristic lengths) this small at a pose where modes meet is zero."""

_EVEN = 0.5
"""Least part of its largest margin that a stretch keeps which is near a rank loss all along and goes through none."""

_ROUNDED_SHARE = 1e-16 / 1e-5
"""Rounding of a configuration, rad, over the share that it may take of Γ and of accelerations."""

_STAY_AWAY = "Keep the legs away from full stretch, full fold and zero length."


@dataclass(frozen=True, eq=False)
class JointTrajectory(Frozen):
    """Motion of the tree with the chains closed, carriers at zero; made by ``inverse_kinematics``.

    Carriers do not change the pose: their positions, rates and accelerations are added to their own entries of q, v, a.

    Attributes:
        robot: the robot.
        motion: the platform motion.
        q: (N, nq) configurations.
        v: (N, nv) tree velocities, v = Γ ẋ.
        a: (N, nv) tree accelerations, a = Γ ẍ + the part due to J̇_c v and J̇_x v.
        gamma: (N, nv, n) velocity per unit of each independent velocity, J_c Γ = 0.
        W: (N, n, m) actuation matrix, Γᵀ Sᵀ.
        gap: (N,) closure residual, m; angles count times the characteristic length.
        reachable: (N,) false where no configuration was found in the working mode, and at a type I singularity; q, v,
            a, gamma and W are NaN there.
        serial_margin_bound: (N,) lower bound of the distance to a type I singularity, scaled; see
            ``assembly.Projection``.
    """

    robot: Robot
    motion: PlatformMotion
    q: Array
    v: Array
    a: Array
    gamma: Array
    W: Array
    gap: Array
    reachable: BoolArray
    serial_margin_bound: Array

    @cached_property
    def out_of_range(self) -> BoolArray:
        """(N,) whether some joint, passive ones too, is beyond its range; see ``robot.joint_ranges``."""
        return out_of_range(self.robot, self.q)

    def with_carriers(self, carriers: CarrierMotion) -> JointTrajectory:
        """Return the motion with that of the carriers (N samples) in it."""
        q, v, a = np.array(self.q), np.array(self.v), np.array(self.a)
        q[:, self.robot.carrier_position] = carriers.s
        v[:, self.robot.carrier_velocity] = carriers.sd
        a[:, self.robot.carrier_velocity] = carriers.sdd
        return replace(self, q=read_only(q), v=read_only(v), a=read_only(a))


def inverse_kinematics(
    robot: RobotLike,
    motion: PlatformMotion,
    *,
    mark_unreachable: bool = False,
    progress: Callable[[int, int], None] | None = None,
    start: Point | None = None,
    positions_only: bool = False,
) -> JointTrajectory:
    """Lift a platform motion to the tree.

    The first pose is found on the branch of the reference configuration (and in the robot's working mode); from there
    the branch is followed continuously.

    Args:
        robot: the robot, or its name or path.
        motion: N samples of the independent coordinates.
        mark_unreachable: instead of raising, mark samples without a configuration in the working mode, and type I
            singularities, with NaN. Behind them the motion is reacquired in the working mode; a robot that declares no
            modes may come back on another branch, but never without a marked sample in between.
        progress: called with samples done and samples in all, now and then.
        start: a point of the branch to come from, in place of the reference configuration: the first pose lies on the
            straight line from it, and is not looked for elsewhere.
        positions_only: rates play no part. Where a motion is near a rank loss all along, as where a loop that does not
            move stands beside one, they are not carried there from farther away, which takes a dozen times as long.

    Raises:
        InputError: the motion does not have the robot's coordinates.
        UnreachablePoseError: no configuration closes the chains; carries sample and gap.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
    """
    robot = as_robot(robot)
    require_matching(robot, motion)
    system = constraint_system(robot)
    if len(motion) == 1 and (tree := _lift_one(robot, motion, start)) is not None:
        return tree
    # the guesses lie on the branch, so that all samples can be solved at once: no sample waits for the one before
    guesses, first = guesses_along(system, motion, mark_unreachable, start)
    solved = _solve(system, motion, guesses, progress)
    _solve_rank_losses(motion, solved, first if start is None else start, positions_only)
    solved.gap[:] = np.maximum(solved.gap, left_open(robot, solved.q))  # NaN, where it was not closed, stays
    if not mark_unreachable and not solved.regular.all():
        _require_closed_and_regular(motion, solved, 0)
    good = solved.regular & _require_modes(motion, solved, start, mark=mark_unreachable)
    breaks = _branch_breaks(motion, solved, good)
    if len(breaks) and not mark_unreachable:
        k = int(breaks[0])
        raise WorkingModeError(
            f"The motion cannot be followed continuously from sample {k - 1} to {k} (t = {motion.t[k - 1]:.6g} to "
            f"{motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}): another branch of the kinematics is "
            "nearer.",
            remedy="Keep away from type I singularities, or sample the motion more finely.",
            sample=k,
        )
    good[breaks] = False  # closed, but on another branch than the sample before
    q, gamma, v, a = solved.q, solved.gamma, solved.v, solved.a
    W = np.ascontiguousarray(gamma[:, robot.actuated_velocity, :].transpose(0, 2, 1))
    for array in (q, gamma, v, a, W):
        array[~good] = np.nan
    parts = (q, v, a, gamma, W, solved.gap, good, solved.margin)
    return JointTrajectory(robot, motion, *(read_only(part) for part in parts))


def _lift_one(robot: Robot, motion: PlatformMotion, start: Point | None) -> JointTrajectory | None:
    """Lift a motion of one sample where the way to it is plainly regular, as it mostly is."""
    follower = tracker(robot)
    reached = follower.towards(start or follower.home, motion.x[0])
    if reached is None or left_open(robot, reached.point.q[None])[0]:
        return None
    v, a = follower.rates(reached, motion.xd[0], motion.xdd[0])
    q, gamma = reached.point.q, reached.point.gamma
    W = np.ascontiguousarray(gamma[robot.actuated_velocity].T)
    parts = q, v, a, gamma, W, reached.gap, True, reached.margin
    return JointTrajectory(robot, motion, *(read_only(np.array([part])) for part in parts))


@dataclass(eq=False)
class _Lifted:
    """Samples that Newton reached, in progress: those at a rank loss are replaced in place, and ``carried`` (N,)."""

    system: ConstraintSystem
    q: Array
    gamma: Array
    v: Array
    a: Array
    gap: Array
    margin: Array
    carried: BoolArray

    @property
    def closed(self) -> BoolArray:
        """(N,) whether the gap is below the closure tolerance."""
        return self.gap < closure_tolerance(self.system.robot)

    @property
    def regular(self) -> BoolArray:
        """(N,) closed, and either no type I singularity or one that the branch goes smoothly through."""
        return self.closed & ((self.margin > 0.0) | self.carried)


def _solve(
    system: ConstraintSystem, motion: PlatformMotion, guess: Array, progress: Callable[[int, int], None] | None
) -> _Lifted:
    """Assemble all samples, in blocks: what a block takes besides its results is a dozen times as much."""
    samples, (nv, n) = len(motion), (system.robot.model.nv, system.robot.n)
    gamma, v, a = np.empty((samples, nv, n)), np.empty((samples, nv)), np.empty((samples, nv))
    gap, margin = np.empty((2, samples))
    for part in blocks(samples):
        one = assemble(system, guess[part], motion.x[part], max_iterations=30)
        guess[part], gamma[part], gap[part], margin[part] = one.q, one.gamma, one.gap, one.projection.margin
        v[part], a[part] = rates(system, one.state, one.projection, motion.xd[part], motion.xdd[part])
        if progress is not None:
            progress(part.stop, samples)
    return _Lifted(system, guess, gamma, v, a, gap, margin, np.zeros(samples, dtype=bool))


def _solve_rank_losses(motion: PlatformMotion, solved: _Lifted, start: Point | None, positions_only: bool) -> None:
    """Replace the samples at and beside a rank loss of the closures that the branch goes through.

    ``start`` is a point of the branch at the first sample or before it.
    """
    system, carried = solved.system, solved.carried
    almost = solved.gap < _ALMOST_CLOSED * system.robot.characteristic_length
    near = almost & (solved.margin < NEAR_RANK_LOSS)
    if near.any():
        near &= solved.margin < near_rank_loss(system)
    if system.robot.all_closures:
        low = min(_POOR, _POOR_PART * usual_margin(system))
        poor = np.flatnonzero(almost & (solved.margin < low))
        near[_made_up_for(motion, solved, poor)] = False
    parts = solved.q, solved.gamma, solved.v, solved.a, solved.gap
    unit = coordinate_unit(system.robot)
    for first, stop in runs(near):
        beside = solved.margin[max(first - 1, 0) : stop + 1]
        if positions_only and solved.regular[first:stop].all() and beside.min() > _EVEN * beside.max():
            continue
        while first < stop:
            away = np.linalg.norm(
                difference(system.robot, motion.x[first:stop], motion.x[first : first + 1]) / unit, axis=1
            )
            last = first + int(np.argmax(np.append(away, np.inf) > NEAR_RANK_LOSS))
            part = slice(first, last)
            neighbours = [
                k
                for k in (first - 1, stop)
                if 0 <= k < len(near) and (carried[k] or (solved.regular[k] and not near[k]))
            ]
            points = [_point(motion, solved, k) for k in neighbours]
            if first == 0 and start is not None:
                points.append(start)
            for point in points:
                result = through_rank_loss(system, point, motion.x[part], motion.xd[part], motion.xdd[part])
                if result is not None:
                    for array, new in zip(parts, result, strict=True):
                        array[part] = new
                    carried[part] = True
                    break
            first = last
    if not positions_only:
        left = np.flatnonzero(near & ~carried)
        if len(left):
            solved.margin[left[_blurred(solved, left)]] = 0.0


def _made_up_for(motion: PlatformMotion, solved: _Lifted, samples: IntArray) -> IntArray:
    """Solve samples with all closure rows, by least squares, and return those at which these keep a rank that is lost.

    Which rows say all changes along the motion of over-constrained mechanisms: where those that count lose rank, the
    ones that were left out say what they no longer do, and together they have one solution.
    """
    if not len(samples):
        return samples
    full = constraint_system(with_all_rows(solved.system.robot))
    one = assemble(full, solved.q[samples], motion.x[samples], redundant=True)
    projection = project(full, one.state)
    good = one.closed & (projection.margin > np.maximum(near_rank_loss(full), _HELPED * solved.margin[samples]))
    v, a = rates(full, one.state, projection, motion.xd[samples], motion.xdd[samples])
    parts = solved.q, solved.gamma, solved.v, solved.a, solved.gap, solved.margin
    for array, new in zip(parts, (one.q, projection.gamma, v, a, one.gap, projection.margin), strict=True):
        array[samples[good]] = new[good]
    return samples[good]


def _blurred(solved: _Lifted, samples: IntArray) -> BoolArray:
    """Return, of some samples, where Newton's rounding takes too much of Γ or of accelerations.

    It makes Γ wrong by 1e-16 / margin², and accelerations by the square of the rates times 1e-16 / margin³. Towards a
    stretched leg, or where the branch turns sharply, both are themselves that large; at a rank loss that the branch
    goes through they are not. Each loop counts with its own margin and its own rates: one that stands beside its rank
    loss loses no digits because another moves.
    """
    system = solved.system
    unit, scale, columns = coordinate_unit(system.robot), velocity_unit(system.robot), system.pose_columns
    with np.errstate(invalid="ignore", over="ignore"):
        K = system.relative(system.evaluate(solved.q[samples]).K)
        gamma = np.abs(solved.gamma[samples] * (unit / scale[:, None])).max(axis=2, initial=0.0)[:, columns]
        speed, a = (np.abs(rate[samples] / scale)[:, columns] for rate in (solved.v, solved.a))
        most = np.maximum(a.max(axis=1), speed.max(axis=1) ** 2)
        result = np.zeros(len(samples), dtype=bool)
        for rows, own in loops(system):
            inverse = inverses(K[:, rows[:, None], own])
            size = np.sqrt(np.einsum("nij,nij->n", inverse, inverse))
            margin = np.where(np.isfinite(size), 1.0 / size, 0.0)
            result |= margin**2 * np.maximum(gamma[:, own].max(axis=1), 1.0) < _ROUNDED_SHARE
            result |= margin**3 * most < _ROUNDED_SHARE * speed[:, own].max(axis=1) ** 2
    return result


def _point_from(system: ConstraintSystem, motion: PlatformMotion, start: Point) -> Point:
    """Return the first sample on the branch of a point, and nowhere else."""
    anchors = follow(system, np.stack([start.x, motion.x[0]]), start.q, start.gamma)
    if anchors.valid[-1]:
        return Point(motion.x[0], anchors.q[-1], anchors.gamma[-1])
    last = assemble(system, anchors.q[-1:], motion.x[:1])
    _require_closed_and_regular(motion[:1], last, 0)
    raise WorkingModeError(
        f"The pose of sample 0, x = {np.round(motion.x[0], 6).tolist()}, cannot be reached continuously from the "
        f"start at x = {np.round(start.x, 6).tolist()}: the straight line leaves the workspace or passes a type I "
        "singularity.",
        remedy="Start nearer to it, or leave the start out.",
        sample=0,
    )


def point_on_branch(system: ConstraintSystem, x: Array, sample: int = 0) -> Point:
    """Return a pose in the robot's working mode, with its configuration.

    First the straight line from the reference configuration is followed; where that leaves the workspace, multistart
    takes the solution nearest to the reference in the right working mode.

    Args:
        system: closures and platform rows; the robot's ``q_reference`` must be closed.
        x: (n,) coordinates or a pose (4, 4), base frame.
        sample: index to name in the error.

    Raises:
        UnreachablePoseError: no start leads to a closed configuration; carries the smallest gap.
        SingularPoseError: the pose is a type I singularity.
        WorkingModeError: there are closed configurations, but none in the working mode.
    """
    robot, home = system.robot, tracker(system.robot).home
    reference, direct = home.q, tracker(robot).towards(home, x)
    if direct is not None:
        reached, valid = direct.point, True
    else:
        reached, valid = _straight(system, home, x)
    # a configuration where working modes meet belongs to both
    if valid and (
        in_working_mode(robot, reached.q[None])[0] or (np.abs(mode_indicator(robot, reached.q[None])) < _NO_SIDE).any()
    ):
        return reached
    q, gap, in_mode = multistart(system, reference, x)
    closed, pose = gap < closure_tolerance(robot), f"The pose of sample {sample}, x = {np.round(x, 6).tolist()},"
    projection = project(system, system.evaluate(q[None]))
    if closed and projection.margin[0] == 0.0:
        raise SingularPoseError(
            f"{pose} is a type I singularity: the platform velocity does not determine the joint velocities.",
            remedy=_STAY_AWAY,
            sample=sample,
        )
    if closed and not in_mode:
        raise WorkingModeError(
            f"{pose} closes only in other working modes than {mode_name(robot.working_mode)} of {robot.name}, such as "
            f"{mode_name(tuple(working_modes(robot, q[None])[0]))}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            sample=sample,
        )
    if not in_mode:
        raise UnreachablePoseError(
            f"{pose} cannot be reached in the working mode of {robot.name}: the chains stay open by {gap:.3g} m."
            f"{millimetres(gap, robot.characteristic_length)}",
            remedy="Move the pose into the workspace, or load the robot in another working_mode.",
            sample=sample,
            gap=gap,
        )
    return Point(x, q, projection.gamma[0])


def _straight(system: ConstraintSystem, home: Point, x: Array) -> tuple[Point, bool]:
    """Return what the straight way from the reference leads to, and whether it leads to the coordinates."""
    gamma = home.gamma

    def follow(q: Array, start: Array, target: Array) -> Array | None:
        nonlocal gamma
        anchors = anchors_along(system, np.stack([start, target]), q, None, False)
        gamma = anchors.gamma[-1]
        return anchors.q[-1] if anchors.valid[-1] else None

    q = follow_whole_turns(system.robot, home.q, home.x, x, follow)
    return Point(x, home.q if q is None else q, gamma), q is not None


def guesses_along(
    system: ConstraintSystem, motion: PlatformMotion, mark: bool, start: Point | None
) -> tuple[Array, Point | None]:
    """Return (N, nq) guesses along the branch, and the first sample's point where it is on it.

    They go from the first sample solved on the branch onward, and from there back.
    """
    solved = first_on_branch(system, motion, mark, start)
    if solved is None:
        return np.repeat(system.robot.q_reference[None], len(motion), axis=0), None
    first, point = solved
    _, q, slope, _ = point
    onward = motion.x[first:]
    anchors = anchors_along(system, onward, q, slope, mark)
    if not mark and not anchors.valid.all():
        _raise_branch_end(system, motion, anchors)
    guess = initial_guess(system, onward, anchors)
    if first == 0:
        return guess, point
    back = motion.x[first::-1]
    before = initial_guess(system, back, anchors_along(system, back, q, slope, mark))
    return np.concatenate([before[:0:-1], guess]), None


def anchors_along(system: ConstraintSystem, x: Array, q: Array, slope: Array | None, mark: bool) -> Anchors:
    """Return ``follow`` along a path, with other closure rows from where those that count lose rank and all keep it."""
    anchors = follow(system, x, q, slope, resume=mark)
    while system.robot.all_closures and not anchors.valid.all():
        reached = int(np.argmin(anchors.valid)) - 1
        if reached < 0:
            return anchors
        full, rest = constraint_system(with_all_rows(system.robot)), anchors.x[reached:]
        ahead = assemble(full, anchors.q[reached : reached + 1], rest[1:2], redundant=True)
        if not ahead.closed[0]:
            return anchors
        other = constraint_system(rows_at(system.robot, ahead.q[0]))
        again = follow(other, rest, anchors.q[reached], anchors.gamma[reached], resume=mark, every_sample=True)
        if not again.valid[1:2].all():
            return anchors
        places = np.interp(again.position, np.arange(len(rest)), anchors.position[reached:])
        before = (part[:reached] for part in (anchors.position, anchors.x, anchors.q, anchors.gamma, anchors.valid))
        behind = places, again.x, again.q, again.gamma, again.valid
        anchors = Anchors(*(np.concatenate(pair) for pair in zip(before, behind, strict=True)))
        system = other
    return anchors


def first_on_branch(
    system: ConstraintSystem, motion: PlatformMotion, mark: bool, start: Point | None
) -> tuple[int, Point] | None:
    """Return the first sample that is solved on the branch, and its solution."""
    try:
        return 0, point_on_branch(system, motion.x[0]) if start is None else _point_from(system, motion, start)
    except (UnreachablePoseError, SingularPoseError, WorkingModeError):
        if not mark:
            raise
    near = reacquire(system, motion.x, np.array(system.robot.q_reference))
    if near is not None:
        return near
    for sample in np.linspace(0, len(motion) - 1, _FAR_STARTS).round().astype(int)[1:]:
        with contextlib.suppress(UnreachablePoseError, SingularPoseError, WorkingModeError):
            return int(sample), point_on_branch(system, motion.x[sample], int(sample))
    return None


def _branch_breaks(motion: PlatformMotion, solved: _Lifted, good: BoolArray) -> IntArray:
    """Return the samples whose configuration does not continue the branch of the sample before, both being good."""
    system, q, x = solved.system, solved.q, motion.x
    steps = [(part.start, part.stop) for part in blocks(len(q) - 1)]
    if len(q) < 2:
        return np.zeros(0, dtype=np.intp)
    same = [continuous(system, *(array[first : last + 1] for array in (q, solved.gamma, x))) for first, last in steps]
    suspects = np.flatnonzero(good[1:] & good[:-1] & ~np.concatenate(same))

    def reached_again(k: int) -> bool:
        again = follow(system, x[k : k + 2], q[k], solved.gamma[k])
        apart = configuration_difference(system.robot.model, again.q[-1:], q[k + 1 : k + 2])
        apart = np.abs(apart / velocity_unit(system.robot))
        return bool(again.valid.all()) and float(apart.max()) <= SAME_CONFIGURATION

    # a step between sparse samples may be long without being a break: go there again in small steps
    return np.array([k + 1 for k in suspects.tolist() if not reached_again(k)], dtype=np.intp)


def _raise_branch_end(system: ConstraintSystem, motion: PlatformMotion, anchors: Anchors) -> NoReturn:
    """Raise what ended a branch whose anchors do not reach the end of the motion."""
    lost = int(np.argmin(anchors.valid))
    first = int(np.floor(anchors.position[max(lost - 1, 0)]))
    last = int(np.ceil(anchors.position[lost]))
    poses = motion.x[first : last + 1]
    solved = assemble(system, np.repeat(anchors.q[lost][None], len(poses), axis=0), poses)
    _require_closed_and_regular(motion, solved, first)
    if not solved.in_mode.all():
        raise _leaves_mode(motion, system.robot, first + int(np.argmin(solved.in_mode)), solved.q[~solved.in_mode][0])
    raise WorkingModeError(
        f"The motion cannot be followed continuously to sample {last} (t = {motion.t[last]:.6g} s, "
        f"x = {np.round(motion.x[last], 6).tolist()}): the way there leaves the workspace, or passes a type I "
        "singularity (a leg at full stretch, full fold or zero length) or a rank loss of the closures that no smooth "
        "branch is known to lead across.",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=last,
    )


def _require_modes(motion: PlatformMotion, solved: _Lifted, start: Point | None, *, mark: bool) -> BoolArray:
    """Return (N,) which samples are in the working mode, or in the one that the branch has led to from it.

    Raises:
        WorkingModeError: one is not, and none is to be marked.
    """
    system, robot, regular, carried = solved.system, solved.system.robot, solved.regular, solved.carried
    in_mode = np.ones(len(regular), dtype=bool)
    if robot.working_modes is None:
        return in_mode
    indicator = mode_indicator(robot, solved.q)
    side = np.where(carried[:, None] & (np.abs(indicator) < _NO_SIDE), 0.0, np.sign(indicator))
    declared = mode = np.array(robot.working_mode, dtype=float)
    if start is not None:
        own = np.sign(mode_indicator(robot, start.q[None])[0])
        mode = np.where(own == 0.0, declared, own)
        if regular[0] and (side[0] * mode < 0.0).any() and crosses(system, start, _point(motion, solved, 0)):
            mode = np.where(side[0] == 0.0, mode, side[0])
    changes = np.flatnonzero((side[1:] != side[:-1]).any(axis=1) | (regular[1:] != regular[:-1])) + 1
    for first, stop in pairwise([0, *changes.tolist(), len(side)]):
        if first > 0 and not regular[first - 1]:
            mode = declared  # behind a gap the motion is reacquired
        if (side[first] * mode < 0.0).any() and first > 0 and regular[first - 1 : first + 1].all():
            known = np.flatnonzero(~carried[:first])  # a carried sample says little of its side
            points = [_point(motion, solved, k) for k in (*known[-1:], first)]
            # a motion that starts at a rank loss starts between two modes
            if len(points) == 1 or (regular[known[-1] : first].all() and crosses(system, *points)):
                mode = np.where(side[first] == 0.0, mode, side[first])
        in_mode[first:stop] = (side[first] * mode >= 0.0).all() & (carried[first] | (side[first] != 0.0).all())
    wrong = regular & ~in_mode
    if wrong.any() and not mark:
        k = int(np.argmax(wrong))
        raise _leaves_mode(motion, robot, k, solved.q[k])
    return in_mode


def _point(motion: PlatformMotion, solved: _Lifted, k: int) -> Point:
    return Point(motion.x[k], solved.q[k], solved.gamma[k])


def _leaves_mode(motion: PlatformMotion, robot: Robot, k: int, q: Array) -> WorkingModeError:
    leg = int(np.argmax(mode_indicator(robot, q[None])[0] * np.array(robot.working_mode) <= 0.0))
    name = robot.working_modes.joints[leg] if robot.working_modes else ""
    return WorkingModeError(
        f"The motion leaves the working mode {mode_name(robot.working_mode)} at sample {k} "
        f"(t = {motion.t[k]:.6g} s): leg {leg + 1} ({name}) changes over.",
        remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
        sample=k,
        leg=leg + 1,
    )


def _require_closed_and_regular(motion: PlatformMotion, solved: Assembly | _Lifted, first: int) -> None:
    """Check samples of a motion from number ``first`` on."""
    closed, regular = solved.closed, solved.regular
    if not closed.all():
        i = int(np.argmin(closed))
        k, gap = first + i, float(solved.gap[i])
        raise UnreachablePoseError(
            f"The pose of sample {k} (t = {motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}) cannot be "
            f"reached: the chains stay open by {gap:.3g} m."
            f"{millimetres(gap, solved.system.robot.characteristic_length)}",
            remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
            sample=k,
            gap=gap,
        )
    if not regular.all():
        i = int(np.argmin(regular))
        k, system = first + i, solved.system
        state, columns = system.evaluate(solved.q[i : i + 1]), system.pose_columns
        closures = state.Jc[0][:, columns] * system.step_unit / system.closure_unit[:, None]
        values = np.linalg.svd(closures, compute_uv=False)
        if values[-1] < near_rank_loss(system):
            raise SingularPoseError(
                f"At sample {k} (t = {motion.t[k]:.6g} s, x = {np.round(motion.x[k], 6).tolist()}) the closures lose "
                "rank, and no branch leads smoothly through that pose: the joint velocities are undetermined.",
                remedy="Keep away from that pose, or change a length a little so that branches do not meet.",
                sample=k,
                time=float(motion.t[k]),
                x=motion.x[k].tolist(),
            )
        raise SingularPoseError(
            f"Sample {k} (t = {motion.t[k]:.6g} s) is a type I singularity: the platform velocity does not determine "
            "the joint velocities.",
            remedy=_STAY_AWAY,
            sample=k,
        )
