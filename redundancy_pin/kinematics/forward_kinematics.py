"""Forward kinematics: from the positions of the main actuators to the platform, along one branch.

Motors are independent coordinates like any others: the same tree and closures with the actuated joints in the place of
the platform are a robot whose ``inverse_kinematics`` is the forward kinematics. Its K is T = [J_c; S], so that its type
I poses are the type II poses of the robot: there the motors do not determine the platform, and two assembly modes meet.
With rates u̇ of the motors and v = Γ' u̇

    ẋ = J_x Γ' u̇,      ẍ = J_x a + J̇_x v.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import (
    AGREEMENT_TOLERANCE,
    Array,
    BoolArray,
    Frozen,
    IntArray,
    blocks,
    checked,
    read_only,
    rows_of,
)
from redundancy_pin.errors import InputError, SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.assembly import (
    closed_configurations,
    configuration_difference,
    integrate,
)
from redundancy_pin.kinematics.branch import ClosedState, follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import angle_columns, coordinates, with_independent_joints
from redundancy_pin.kinematics.inverse_kinematics import MotionSolution
from redundancy_pin.kinematics.mobility import independent_columns
from redundancy_pin.kinematics.whole_turns import are_too_many_turns_away
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import range_excess, range_slack
from redundancy_pin.robot.scales import turning_velocities, velocity_unit
from redundancy_pin.robot.whole_turns import FARTHEST, TURN, counted_turns
from redundancy_pin.status import SampleStatus, solved_status

_WEAKENED = 0.5
"""Part of the margin at which redundant motors began to be followed, no unit: below it others are looked for."""

_MOST_TURNS = 100
"""Whole turns of several motors between samples, which are followed one by one: a few seconds."""


@dataclass(frozen=True, eq=False)
class ForwardKinematics(Frozen):
    """Pose of the platform; made by ``forward_kinematics``. NaN where the status is that of an unknown pose.

    Attributes:
        robot: the robot.
        x: (N, n) coordinates of the platform or (N, 4, 4) poses, base frame, m and rad; angles continue beyond ±π, and
            count from the reference the turns that the joints do.
        xd: (N, n) their rate.
        xdd: (N, n) its rate.
        q: (N, nq) configurations, carriers at zero; pass one as ``start`` to continue from there.
        jacobian: (N, n, m) ẋ per rate of each main actuator; of redundant ones those that were followed have columns,
            the others zeros.
        status: (N,) a ``SampleStatus`` each.
        residual: (N,) closure residual, m (angles times the characteristic length); of redundant motors also what they
            contradict each other by.
        margin: (N,) lower bound of the scaled distance to type II, as ``JointTrajectory.serial_margin_bound``; of
            redundant motors that of those which were followed.
        excess: (N, joints) how far each joint of the model is beyond its range, m or rad, not positive inside.
    """

    robot: Robot
    x: Array
    xd: Array
    xdd: Array
    q: Array
    jacobian: Array
    status: IntArray
    residual: Array
    margin: Array
    excess: Array

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.status)

    @property
    def known(self) -> BoolArray:
        """(N,) whether pose and rates are known, in range or not."""
        return read_only(solved_status(self.status))

    @property
    def status_labels(self) -> NDArray[np.str_]:
        """(N,) the statuses as text, such as ``"ok"``."""
        return read_only(np.array([status.label for status in SampleStatus])[self.status])


def forward_kinematics(
    robot: RobotLike,
    actuated: ArrayLike,
    *,
    rates: ArrayLike | None = None,
    accelerations: ArrayLike | None = None,
    start: ArrayLike | None = None,
) -> ForwardKinematics:
    """Return where the platform is for positions of the motors, on the branch of a start.

    The motors go in a straight line from their positions at the start to the first sample, and from sample to sample;
    the branch is followed continuously all the way. It ends at the first sample that is singular or out of reach. For
    all poses that positions of the motors allow, see ``assembly_modes``. Of redundant motors those are followed that
    determine the platform best, others from where these come near a singularity of theirs.

    Args:
        robot: the robot, or its name or path.
        actuated: (N, m) positions of the main actuators, or (m,) of one sample, m and rad; full turns count.
        rates: same shape, their rates; at rest when left out.
        accelerations: same shape, their accelerations; zero when left out.
        start: (nq,) a closed configuration; ``robot.q_reference`` when left out.

    Raises:
        InputError: wrong shapes, a start that is not closed, angles beyond 3e7 rad, more than a hundred
            turns of several motors between samples.
        UnsupportedRobotError: fewer motors than freedoms.
        SingularPoseError: the start is a type II singularity, where branches meet.

    Example:
        >>> rp.forward_kinematics("2rpr", [0.4, 0.5]).x.round(3)
        array([[0.16 , 0.367]])
    """
    robot = as_robot(robot)
    u = rows_of(actuated, "actuated", ("N", robot.m))
    ud, udd = (
        np.zeros(u.shape) if given is None else rows_of(given, name, u.shape)
        for given, name in ((rates, "rates"), (accelerations, "accelerations"))
    )
    system = constraint_system(robot)
    q0 = np.array(robot.q_reference if start is None else checked(start, "start", (robot.model.nq,)))
    segments, followed = [], followed_motors(system, q0)
    while True:
        segment = _follow(system, (u, ud, udd), q0, followed)
        kept, others = _switch_motors(system, segment, followed)
        segments.append([getattr(segment, field.name)[:kept] for field in fields(segment)[1:]])
        if others is None:
            return ForwardKinematics(
                robot, *(read_only(np.concatenate(parts)) for parts in zip(*segments, strict=True))
            )
        q0, followed = segment.q[kept - 1], others
        u, ud, udd = u[kept:], ud[kept:], udd[kept:]


def _switch_motors(
    system: ConstraintSystem, segment: ForwardKinematics, followed: IntArray
) -> tuple[int, IntArray | None]:
    """Return how many samples of a segment count, and which motors are followed behind them; None for no others.

    Of redundant motors those that are followed may come to a singularity of theirs where all of them are well: others
    take over on the way there, or where the last sample is that they lead to.
    """
    reference = segment.margin[:1]
    good = int(np.argmin(np.append(segment.known, False)))
    for i in range(min(good, len(segment) - 1)) if system.robot.m > system.robot.n else ():
        if segment.margin[i] < _WEAKENED * reference[0] or i == good - 1:
            others = followed_motors(system, segment.q[i])
            if not np.array_equal(others, followed):
                return i + 1, others
            reference = segment.margin[i : i + 1]
    return len(segment), None


def _follow(
    system: ConstraintSystem, given: tuple[Array, Array, Array], q0: Array, followed: IntArray
) -> ForwardKinematics:
    """Return where motors at ``given`` positions, rates and accelerations (N, m) take the platform from q0 (nq,)."""
    robot, u = system.robot, given[0]
    driven = with_independent_joints(robot, tuple(robot.actuated[j] for j in followed))
    own, first = follower(driven), _start(driven, q0)
    still = np.zeros(driven.n)  # the motors come from the start, which is the first sample
    before = first.x, still, still
    path = [np.concatenate([start[None], part[:, followed]]) for start, part in zip(before, given, strict=True)]
    _require_few_turns(driven, path[0])
    solution = MotionSolution(own, PlatformMotion(np.arange(len(path[0])), *path, check_rates=False))
    end, last, _ = solution.follow(range(1, len(path[0])), first)
    tree, positions = solution.trajectory(), path[0][1:]
    q, v, a, gamma, residual, margin = (
        np.array(part[1:]) for part in (tree.q, tree.v, tree.a, tree.gamma, tree.residual, tree.serial_margin_bound)
    )
    status: IntArray = np.full(len(u), int(SampleStatus.OK))
    solved = end
    if end < len(u):
        ends = own.diagnose_each([last] * (len(u) - end), positions[end:])
        singular = [one.status is SampleStatus.TYPE_I for one in ends]  # K of the motors as coordinates: of type II
        solved += int(np.logical_and.accumulate(singular).sum())  # behind another sample the branch is unknown
        for k in range(end, solved):
            q[k] = ends[k - end].q
        far = are_too_many_turns_away(driven, last.x, positions[end:])
        unreachable = ~far & [one.status is SampleStatus.UNREACHABLE for one in ends]
        status[end:] = np.where(unreachable, SampleStatus.UNREACHABLE, SampleStatus.BRANCH_LOST)
        status[end:solved] = SampleStatus.TYPE_II
        residual[end:] = np.where(far, np.nan, [one.residual for one in ends])
        margin[end:] = np.where(singular, 0.0, np.nan)
    placed = system.evaluate(q[:solved])
    x = np.full((len(u), 4, 4) if is_pose(robot) else (len(u), robot.n), np.nan)
    x[:solved] = coordinates(robot, placed)
    if not is_pose(robot):
        x[:solved] += _turns(system, q[:solved])
    xd, xdd = platform_rates(robot, q, v, a)
    J = np.full((len(u), robot.n, robot.m), np.nan)
    J[:end] = 0.0
    J[:end, :, followed] = placed.Jx[:end] @ gamma[:end]
    residual = np.where(np.isnan(residual), np.nan, np.fmax(residual, motor_mismatch(system, followed, u, q)))
    contradicted = (status == SampleStatus.OK) & (residual > AGREEMENT_TOLERANCE * robot.characteristic_length)
    status[contradicted] = SampleStatus.UNREACHABLE
    for part in (x, xd, xdd, q, J):
        part[contradicted] = np.nan
    excess = range_excess(robot, q)
    status[(status == SampleStatus.OK) & (excess > range_slack(robot)).any(axis=1)] = SampleStatus.OUT_OF_RANGE
    return ForwardKinematics(robot, x, xd, xdd, q, J, status, residual, margin, excess)


def _start(driven: Robot, q: Array) -> ClosedState:
    """Return the state of motors at a configuration (nq,).

    Raises:
        InputError: it is not closed.
        SingularPoseError: it is a type II singularity.
    """
    home = closed_configurations(driven, q, "start")
    if home.singular[0]:
        raise SingularPoseError(
            f"The start is a type II singularity of {driven.name}: branches meet there, and the motors do not say "
            "which one is meant.",
            remedy="Start from a configuration nearby.",
        )
    return follower(driven).state_at(q, coordinates(driven, home.state)[0], home.gamma[0])


def followed_motors(system: ConstraintSystem, q: Array) -> IntArray:
    """Return which n of the m motors are followed: those that determine the platform best at a configuration (nq,)."""
    robot = system.robot
    if robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.m} main actuators and {robot.n} freedoms: they do not say where its platform is.",
            remedy="Declare more joints as actuated, or use inverse_kinematics from platform to joints.",
        )
    if robot.m == robot.n:
        return np.arange(robot.m)
    free = np.linalg.svd(system.closure_rows(q))[2][-robot.n :]
    motors = free[:, np.searchsorted(system.pose_columns, robot.actuated_velocity)]
    return np.sort(np.array(independent_columns(motors, 0.0), dtype=np.intp))


def motor_mismatch(system: ConstraintSystem, followed: IntArray, u: Array, q: Array) -> Array:
    """Return (N,) how far motors that are not followed are from positions u (N, m) at configurations q, m."""
    robot, unit = system.robot, velocity_unit(system.robot)[system.robot.actuated_velocity]
    left = [j for j in range(robot.m) if j not in followed]
    worst: Array = np.abs((u - robot.joint_positions(q)) / unit)[:, left].max(axis=1, initial=0.0)
    return worst * robot.characteristic_length


def _require_few_turns(driven: Robot, u: Array) -> None:
    """Check that positions of motors (N, n) do not turn too often.

    One motor that turns comes to the same place after some turns, which ``inverse_kinematics`` finds. What several
    motors do has no such period.

    Raises:
        InputError: several motors turn too often between samples, or positions are too large.
    """
    angles = u[:, counted_turns(driven).coordinates]
    largest = float(np.abs(angles).max(initial=0.0))
    if largest > FARTHEST:
        raise InputError(
            f"The motors of {driven.name} are at up to {largest:.3g} rad: such a number does not say where in a turn.",
            remedy="Take whole turns off.",
        )
    turns = int((np.abs(np.diff(angles, axis=0)) // TURN).max(axis=1, initial=0.0).sum())
    if driven.n > 1 and turns > _MOST_TURNS:
        raise InputError(
            f"The motors of {driven.name} make {turns} whole turns between samples, which has to be followed turn by "
            "turn.",
            remedy="Pass samples in between, or take whole turns off.",
            turns=turns,
        )


def platform_rates(robot: Robot, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return ẋ = J_x v and ẍ = J_x a + J̇_x v (N, n) at states q (N, nq), v and a (N, nv); NaN where q is."""
    chain = ClosedChain(robot)
    xd, xdd = np.full((2, len(q), robot.n), np.nan)
    for k in np.flatnonzero(np.isfinite(q).all(axis=1)):
        chain.update(q[k], v[k])
        rows = chain.platform_jacobian()
        xd[k], xdd[k] = rows @ v[k], rows @ a[k] + chain.full_bias()[chain.rows :]
    return xd, xdd


def _turns(system: ConstraintSystem, q: Array) -> Array:
    """Return (N, n) the whole turns, rad, that the platform's angles are away from (−π, π] at configurations (N, nq).

    Joints that count their turns say it: of straight lines between configurations, from the reference on, each is
    divided until no part of it can turn anything by more than a right angle. The loops may open on the way. Whole turns
    of a joint are as many times what one turn of it does.
    """
    robot, columns = system.robot, angle_columns(system.robot)
    turns = np.zeros((len(q), robot.n))
    if not columns or not len(q):
        return turns
    model, reference = robot.model, np.array(robot.q_reference)[None]
    before = np.concatenate([reference, q[:-1]])
    step = configuration_difference(model, before, q)
    counted = [joint.idx_v for joint in model.joints[1:] if counted_turns(robot).angles[joint.idx_q]]
    whole = np.trunc(step[:, counted] / TURN)
    step[:, counted] -= TURN * whole
    once = np.zeros((len(counted), len(columns)))
    for k in np.flatnonzero(whole.any(axis=0)):
        turn = np.zeros((1, model.nv))
        turn[0, counted[k]] = TURN
        there, _ = _angles_along(system, reference, turn)
        once[k] = TURN * np.round((there[1] - there[0]) / TURN)
    followed, short = _angles_along(system, before, step)
    turns[:, columns] = (followed - short)[1:] + np.cumsum(whole, axis=0) @ once
    return turns


def _angles_along(system: ConstraintSystem, before: Array, step: Array) -> tuple[Array, Array]:
    """Return the platform's angles at the first of ``before`` (N, nq) and after each step (N, nv), two of (N + 1, c).

    The first are followed continuously, the second are in (−π, π].
    """
    robot, columns = system.robot, angle_columns(system.robot)
    parts = np.ceil(np.abs(step[:, turning_velocities(robot)]).sum(axis=1) / (0.5 * np.pi)).astype(int).clip(1)
    last = np.cumsum(parts)
    share = (np.arange(last[-1]) - np.repeat(last - parts, parts) + 1.0) / np.repeat(parts, parts)
    path = integrate(robot.model, np.repeat(before, parts, axis=0), share[:, None] * np.repeat(step, parts, axis=0))
    between = np.concatenate([before[:1], path])
    x = np.concatenate([coordinates(robot, system.evaluate(between[part])) for part in blocks(len(between))])
    ends = np.append(0, last)
    return np.unwrap(x[:, columns], axis=0)[ends], x[ends][:, columns]
