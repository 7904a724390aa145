"""Forward kinematics: from the positions of the main actuators to the platform, along one branch, and all branches.

Motors are independent coordinates like any others: the same tree and closures with the actuated joints in the place of
the platform are a robot whose ``inverse_kinematics`` is the forward kinematics. Its K is T = [J_c; S], so that its type
I poses are the type II poses of the robot: there the motors do not determine the platform, and two assembly modes meet.
With rates u̇ of the motors and v = Γ' u̇

    ẋ = J_x Γ' u̇,      ẍ = J_x a + J̇_x v.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import (
    Array,
    BoolArray,
    Frozen,
    IntArray,
    blocks,
    checked,
    positive,
    read_only,
    rows_of,
)
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, UnsupportedRobotError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.branch import ClosedState, known_state
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import angle_columns, coordinates, joint_position, with_independent_joints
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.kinematics.multistart import wrapped
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.joint_ranges import out_of_range, random_spread, range_excess, range_slack
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.named import is_pose
from redundancy_pin.robot.scales import turning_velocities, velocity_unit
from redundancy_pin.status import SampleStatus, solved_status

_AGREE = 1e-8
"""Largest contradiction between positions of redundant motors, in characteristic lengths or rad: rounding."""

_WEAKER = 0.5
"""Of the margin at which redundant motors began to be followed: below it others are looked for."""

_STARTS, _MOST_STARTS, _IN_VAIN = 128, 2048, 512
"""Random starts of a round, of all rounds, and of all where none closes."""
_SEEN, _OFTEN = 1e-3, 6
"""Random starts go on until one more has a chance below the first of finding a mode that none has found, and each mode
was found as often as the second on average."""

_SHORTEST_STEP = 2.0**-5
_SAME_MODE = 1e-6
"""Configurations whose frames are nearer than this, in characteristic lengths, are the same mode."""

_SEED = 20141

_FEW_TURNS, _MOST_TURNS = 3, 100
"""Turns between samples that are followed as they are; of several motors at most, which takes seconds."""
_SAME_TURN = 1e-6
"""rad; configurations this near, turns apart, are one."""


@dataclass(frozen=True, eq=False)
class ForwardKinematics(Frozen):
    """Where the platform is; made by ``forward_kinematics``. NaN where the status says that nothing is known.

    Attributes:
        robot: the robot.
        x: (N, n) coordinates of the platform or (N, 4, 4) poses, base frame, m and rad; angles go on beyond ±π, and
            count from the reference the turns that the joints do.
        xd: (N, n) their rate.
        xdd: (N, n) its rate.
        q: (N, nq) configurations, carriers at zero; pass one as ``start`` to go on from there.
        jacobian: (N, n, m) ẋ per rate of each main actuator; of redundant ones those that were followed have columns,
            the others zeros.
        status: (N,) a ``SampleStatus`` each.
        gap: (N,) closure residual, m (angles times the characteristic length); of redundant motors also what they
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
    gap: Array
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
        InputError: wrong shapes, a start that is not closed, angles beyond 8e9 rad, more than a hundred
            turns between samples of several motors, or of one that is not back after a turn.
        UnsupportedRobotError: fewer motors than freedoms.
        SingularPoseError: the start is a type II singularity, where branches meet.
    """
    robot = as_robot(robot)
    u = rows_of(actuated, "actuated", ("N", robot.m))
    ud, udd = (
        np.zeros(u.shape) if given is None else rows_of(given, name, u.shape)
        for given, name in ((rates, "rates"), (accelerations, "accelerations"))
    )
    system = constraint_system(robot)
    q0 = np.array(robot.q_reference if start is None else checked(start, "start", (robot.model.nq,)))
    stretches, followed, path = [], _followed(system, q0), (u, ud, udd)
    while True:
        stretch = _stretch(system, path, q0, followed)
        kept, others = _handed_over(system, stretch, followed)
        stretches.append([part[:kept] for part in stretch])
        if others is None:
            return ForwardKinematics(
                robot, *(read_only(np.concatenate(parts)) for parts in zip(*stretches, strict=True))
            )
        q0, followed, path = stretch.q[kept - 1], others, (path[0][kept:], path[1][kept:], path[2][kept:])


class _Stretch(NamedTuple):
    """What ``ForwardKinematics`` has, of samples along which the same motors are followed."""

    x: Array
    xd: Array
    xdd: Array
    q: Array
    jacobian: Array
    status: IntArray
    gap: Array
    margin: Array
    excess: Array


def _handed_over(system: ConstraintSystem, stretch: _Stretch, followed: IntArray) -> tuple[int, IntArray | None]:
    """Return how many samples of a stretch count, and which motors are followed behind them; None for no others.

    Of redundant motors those that are followed may come to a singularity of theirs where all of them are well: others
    take over on the way there, or where the last sample is that they lead to.
    """
    count, reference = len(stretch.status), stretch.margin[:1]
    good = int(np.argmin(np.append(solved_status(stretch.status), False)))
    for i in range(min(good, count - 1)) if system.robot.m > system.robot.n else ():
        if stretch.margin[i] < _WEAKER * reference[0] or i == good - 1:
            others = _followed(system, stretch.q[i])
            if not np.array_equal(others, followed):
                return i + 1, others
            reference = stretch.margin[i : i + 1]
    return count, None


def _stretch(system: ConstraintSystem, given: tuple[Array, Array, Array], q0: Array, followed: IntArray) -> _Stretch:
    """Return where motors at ``given`` positions, rates and accelerations take the platform from a configuration."""
    robot, (u, ud, udd) = system.robot, given
    driven = with_independent_joints(robot, tuple(robot.actuated[j] for j in followed))
    motors = constraint_system(driven)
    home = assemble(motors, q0[None], max_iterations=0)
    if not home.closed[0]:
        raise InputError(
            f"start does not close the chains of {robot.name}: they stay open by {home.gap[0]:.3g} m.",
            remedy="Pass a configuration of inverse_kinematics, assembly_modes or forward_kinematics.",
        )
    if home.projection.margin[0] == 0.0:
        raise SingularPoseError(
            f"The start is a type II singularity of {robot.name}: branches meet there, and the motors do not say which "
            "one is meant.",
            remedy="Start beside it.",
        )
    u0 = coordinates(driven, home.state)
    before = u0, np.zeros(u0.shape), np.zeros(u0.shape)  # the motors come from the start
    path = [np.concatenate([first, part[:, followed]]) for first, part in zip(before, (u, ud, udd), strict=True)]
    first = known_state(driven, u0[0], q0, home.gamma[0])
    route = _without_whole_turns(driven, path[0])
    tree, branch = _lifted(driven, route, path, first)
    if not route.leads_back(branch):  # as behind a gear: few turns are followed as they are
        route = _every_turn(driven, path[0], "and a turn of its motor does not lead back to the same configuration")
        tree, branch = _lifted(driven, route, path, first)
    places = route.places[1:]
    v, a, gamma, gap, margin = (
        part[places] for part in (tree.v, tree.a, tree.gamma, tree.gap, tree.serial_margin_bound)
    )
    end = int(np.isfinite(branch[places]).all(axis=1).sum())
    status: IntArray = np.full(len(u), int(SampleStatus.OK))
    q = branch[places]
    if end < len(u):
        v[end:], a[end:], gamma[end:] = np.nan, np.nan, np.nan
        rest = q[end:], status[end:], gap[end:], margin[end:]
        _judge_rest(motors, route.u[places[end:]], tree.q[route.places[end]], rest)
        branch[places[end:]] = q[end:]
    x = _platform_at(system, branch)
    xd, xdd = platform_rates(system, q, v, a)
    J = np.full((len(u), robot.n, robot.m), np.nan)
    J[:end] = 0.0
    J[:end, :, followed] = system.evaluate(q[:end]).Jx @ gamma[:end]
    q, x = route.turned(branch, q), x[places] if is_pose(robot) else route.turned(x, x[places])
    gap = np.fmax(gap, _contradiction(system, followed, u, q))
    contradicted = (status == SampleStatus.OK) & (gap > _AGREE * robot.characteristic_length)
    status[contradicted] = SampleStatus.UNREACHABLE
    for part in (x, xd, xdd, q, J):
        part[contradicted] = np.nan
    excess = range_excess(robot, q)
    status[(status == SampleStatus.OK) & (excess > range_slack(robot)).any(axis=1)] = SampleStatus.OUT_OF_RANGE
    return _Stretch(x, xd, xdd, q, J, status, gap, margin, excess)


def _followed(system: ConstraintSystem, q: Array) -> IntArray:
    """Return which n of the m motors are followed: those that determine the platform best at a configuration (nq,)."""
    robot = system.robot
    if robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.m} main actuators and {robot.n} freedoms: they do not say where its platform is.",
            remedy="Declare more joints as actuated, or use inverse_kinematics from platform to joints.",
        )
    if robot.m == robot.n:
        return np.arange(robot.m)
    from scipy.linalg import qr

    columns = system.pose_columns
    closures = system.evaluate(q[None]).Jc[0][:, columns] * system.step_unit / system.closure_unit[:, None]
    free = np.linalg.svd(closures)[2][-robot.n :]
    chosen = qr(free[:, np.searchsorted(columns, robot.actuated_velocity)], mode="r", pivoting=True)[1][: robot.n]
    return np.sort(chosen)


def _contradiction(system: ConstraintSystem, followed: IntArray, u: Array, q: Array) -> Array:
    """Return (N,) how far motors that are not followed are from positions u (N, m) at configurations q, m."""
    robot, unit = system.robot, velocity_unit(system.robot)[system.robot.actuated_velocity]
    left = [j for j in range(robot.m) if j not in followed]
    off = [(u[:, j] - joint_position(robot, robot.actuated[j], q)) / unit[j] for j in left]
    worst: Array = np.abs(np.reshape(off, (len(off), len(u)))).max(axis=0, initial=0.0)
    return worst * robot.characteristic_length


def _judge_rest(motors: ConstraintSystem, u: Array, last: Array, rest: tuple[Array, IntArray, Array, Array]) -> None:
    """Write q, status, gap and margin of the samples behind the end of the branch, which ``last`` (nq,) is."""
    solved = assemble(motors, np.repeat(last[None], len(u), axis=0), u)
    singular = solved.closed & (solved.projection.margin == 0.0)
    passed = int(np.argmin(np.append(singular, False)))  # only until another sample is met the branch is known
    q, status, gap, margin = rest
    status[:] = np.where(solved.closed, SampleStatus.BRANCH_LOST, SampleStatus.UNREACHABLE)
    status[:passed] = SampleStatus.TYPE_II
    q[:passed], gap[:], margin[:] = solved.q[:passed], solved.gap, np.where(singular, 0.0, np.nan)


class _Route(NamedTuple):
    """Positions u (A, n) of the motors that are followed, and ``places`` (N + 1,) of the samples, the start first.

    ``jumps`` say where whole turns are left out: places before and behind one turn, and how many more follow.
    """

    u: Array
    places: IntArray
    jumps: tuple[tuple[int, int, int], ...]

    def leads_back(self, along: Array) -> bool:
        """Return whether values (A, d) on the way are whole turns apart before and behind turns that stand for more."""
        steps = np.diff(along[np.array([jump[:2] for jump in self.jumps], dtype=int).reshape(-1, 2)], axis=1)
        return not bool((np.abs(steps - _whole(steps)) > _SAME_TURN).any())

    def turned(self, along: Array, values: Array) -> Array:
        """Return values (N, d) at the samples with whole turns that were left out, from values (A, d) on the way."""
        result = np.array(values)
        for before, behind, count in self.jumps:
            once = _whole(along[behind] - along[before])
            result[self.places[1:] >= behind] += count * np.where(np.isfinite(once), once, 0.0)
        return result


def _whole(angles: Array) -> Array:
    return np.asarray(2.0 * np.pi * np.round(angles / (2.0 * np.pi)))


def _lifted(driven: Robot, route: _Route, path: list[Array], first: ClosedState) -> tuple[JointTrajectory, Array]:
    """Return the motion along a route, rates of the path at samples, and its (A, nq), NaN where the branch ends."""
    rate, second = np.zeros((2, *route.u.shape))
    rate[route.places], second[route.places] = path[1:]
    motion = PlatformMotion(np.arange(len(route.u)), route.u, rate, second, check_rates=False)
    tree = inverse_kinematics(driven, motion, mark_unreachable=True, start=first)
    good = np.logical_and.accumulate(tree.reachable)
    return tree, np.where(
        good[:, None], tree.q, np.nan
    )  # what inverse_kinematics takes up again behind a gap is on any branch


def _whole_turns(driven: Robot, u: Array) -> IntArray:
    """Return (N, n) the whole turns of the motors between positions (N + 1, n).

    Raises:
        InputError: positions too large to say where in a turn they are.
    """
    joints = [find_joint(driven.model, name) for name in driven.independent_joints]
    turning = np.array([bool(turning_velocities(driven)[each.idx_v]) and each.nq == 1 for each in joints])
    angles = np.where(turning, u, 0.0)
    largest = float(np.abs(angles).max(initial=0.0))
    if np.spacing(largest) > _SAME_TURN:
        raise InputError(
            f"The motors of {driven.name} are at up to {largest:.3g} rad: such a number does not say where in a turn.",
            remedy="Take whole turns off.",
        )
    return (np.abs(np.diff(angles, axis=0)) // (2.0 * np.pi)).astype(int)


def _every_turn(driven: Robot, u: Array, why: str) -> _Route:
    """Return the route along positions (N + 1, n) as they are.

    Raises:
        InputError: the motors turn too often between samples.
    """
    turns = int(_whole_turns(driven, u).max(axis=1).sum())
    if turns > _MOST_TURNS:
        raise InputError(
            f"The motors of {driven.name} make {turns} whole turns between samples, {why}.",
            remedy="Pass samples in between, or take whole turns off.",
            turns=turns,
        )
    return _Route(u, np.arange(len(u)), ())


def _without_whole_turns(driven: Robot, u: Array) -> _Route:
    """Return the route along positions of motors (N + 1, n), the start first, in bounded length.

    One motor that turns comes to the same place after a turn, if it does after the first: all but this one and the last
    are left out. What several motors do has no such period.

    Raises:
        InputError: several motors turn too often between samples, or positions are too large.
    """
    whole = _whole_turns(driven, u)
    if whole.max(initial=0) < _FEW_TURNS:
        return _Route(u, np.arange(len(u)), ())
    if driven.n > 1 or driven.model.nq != driven.model.nv:
        return _every_turn(driven, u, "which has to be followed turn by turn")
    route, places, jumps, away = [u[0]], [0], [], 0.0
    for target, last, count in zip(u[1:], u[:-1], whole[:, 0].tolist(), strict=True):
        if count >= _FEW_TURNS:
            turn = np.copysign(2.0 * np.pi, target - last)
            jumps.append((len(route) - 1, len(route), count - 1))
            route.append(route[-1] + turn)
            away = away + (count - 1) * turn
        route.append(target - away)
        places.append(len(route) - 1)
    return _Route(np.array(route), np.array(places), tuple(jumps))


def _platform_at(system: ConstraintSystem, q: Array) -> Array:
    """Return (N, n) coordinates or (N, 4, 4) poses of the platform at configurations, NaN where these are."""
    robot, known = system.robot, np.isfinite(q).all(axis=1)
    x = np.full((len(q), 4, 4) if is_pose(robot) else (len(q), robot.n), np.nan)
    x[known] = coordinates(robot, system.evaluate(q[known]))
    if not is_pose(robot) and known.any():
        x[known] += _turns(system, q[known])
    return x


def platform_rates(system: ConstraintSystem, q: Array, v: Array, a: Array) -> tuple[Array, Array]:
    """Return ẋ and ẍ (N, n) of the independent coordinates at states (N, nq), (N, nv), (N, nv); NaN where q is."""
    robot, known = system.robot, np.isfinite(q).all(axis=1)
    state = system.evaluate(q[known])
    xd, xdd = np.full((2, len(q), robot.n), np.nan)
    xd[known] = np.einsum("ijv,iv->ij", state.Jx, v[known])
    xdd[known] = np.einsum("ijv,iv->ij", state.Jx, a[known]) + system.bias(state, v[known])[1]
    return xd, xdd


def _turns(system: ConstraintSystem, q: Array) -> Array:
    """Return (N, n) the whole turns, rad, that the platform's angles are away from (−π, π] at configurations (N, nq).

    Joints that count their turns say it: of straight lines between configurations, from the reference on, each is
    divided until no part of it can turn anything by more than a right angle. The loops may open on the way.
    """
    robot, columns = system.robot, angle_columns(system.robot)
    turns = np.zeros((len(q), robot.n))
    if not len(columns):
        return turns
    before = np.concatenate([np.array(robot.q_reference)[None], q[:-1]])
    step = configuration_difference(robot.model, before, q)
    parts = np.ceil(np.abs(step[:, turning_velocities(robot)]).sum(axis=1) / (0.5 * np.pi)).astype(int).clip(1)
    first, last = np.repeat(before, parts, axis=0), np.cumsum(parts)
    share = (np.arange(last[-1]) - np.repeat(last - parts, parts) + 1.0) / np.repeat(parts, parts)
    path = integrate(robot.model, first, share[:, None] * np.repeat(step, parts, axis=0))
    between = np.concatenate([before[:1], path])
    x = np.concatenate([coordinates(robot, system.evaluate(between[part])) for part in blocks(len(between))])
    for column in columns:
        turns[:, column] = (np.unwrap(x[:, column]) - x[:, column])[last]
    return turns


@dataclass(frozen=True, eq=False)
class AssemblyModes(Frozen):
    """All that positions of the motors allow, as far as it was found; made by ``assembly_modes``.

    Attributes:
        robot: the robot.
        q: (M, nq) a configuration of each mode, angles in (−π, π]; that nearest to the reference first.
        x: (M, n) coordinates or (M, 4, 4) poses of the platform.
        margin: (M,) lower bound of the scaled distance to type II, where modes meet.
        in_range: (M,) whether all joints are within their limits.
        hits: (M,) how many random starts led to each.
        unseen: estimated chance that one more start finds another mode (Good and Turing: the share of modes that were
            found once among all successful starts).
    """

    robot: Robot
    q: Array
    x: Array
    margin: Array
    in_range: BoolArray
    hits: IntArray
    unseen: float

    def __len__(self) -> int:
        """Return the number of modes."""
        return len(self.q)


def assembly_modes(robot: RobotLike, actuated: ArrayLike, *, most_starts: int = _MOST_STARTS) -> AssemblyModes:
    """Return the configurations that positions of the motors allow: two of a five-bar, up to forty of a Gough platform.

    Newton from random starts, the same ones every time, until another start would hardly find a new mode. Modes are
    alike where joints, platform and closures are at the same places: a universal joint turned over is no other mode.

    Args:
        robot: the robot, or its name or path.
        actuated: (m,) positions of the main actuators, m and rad.
        most_starts: bound on the number of starts.

    Raises:
        InputError: wrong shape.
        UnsupportedRobotError: fewer motors than freedoms.
        UnreachablePoseError: no start closes the chains.
    """
    robot, most_starts = as_robot(robot), int(positive(most_starts, "most_starts", ""))
    u = np.array(checked(actuated, "actuated", (robot.m,)))
    reference, system = np.array(robot.q_reference), constraint_system(robot)
    followed = _followed(system, reference)
    motors = constraint_system(with_independent_joints(robot, tuple(robot.actuated[j] for j in followed)))
    model, columns, rng = robot.model, motors.pose_columns, np.random.default_rng(_SEED)
    spread = random_spread(robot)[columns]
    q, keys, hits = np.zeros((0, model.nq)), np.zeros((0, 0)), np.zeros(0, dtype=np.intp)
    gap, starts = np.inf, 0
    while starts < (most_starts if len(q) else min(most_starts, _IN_VAIN)):
        steps = np.zeros((_STARTS, model.nv))
        steps[:, columns] = rng.uniform(-1.0, 1.0, (_STARTS, len(columns))) * spread
        steps[0] *= starts > 0  # the reference itself comes first
        guess = integrate(model, np.repeat(reference[None], _STARTS, axis=0), steps)
        solved = assemble(motors, guess, np.repeat(u[None, followed], _STARTS, axis=0), shortest_step=_SHORTEST_STEP)
        off = np.fmax(solved.gap, _contradiction(system, followed, np.repeat(u[None], _STARTS, axis=0), solved.q))
        starts, gap = starts + _STARTS, min(gap, float(np.nanmin(off)))
        for one in solved.q[solved.closed & (off < _AGREE * robot.characteristic_length)]:
            key = _frames(robot, one)[None]
            keys = keys.reshape(len(q), key.shape[1])
            same = np.flatnonzero(np.abs(keys - key).max(axis=1) < _SAME_MODE * robot.characteristic_length)
            if len(same):
                hits[same[0]] += 1
            else:
                q, keys, hits = np.concatenate([q, one[None]]), np.concatenate([keys, key]), np.append(hits, 1)
        if (hits == 1).sum() < _SEEN * hits.sum() and hits.mean() >= _OFTEN:
            break
    if not len(q):
        raise UnreachablePoseError(
            f"No configuration of {robot.name} has its motors at {np.round(u, 6).tolist()}: the chains stay open by "
            f"{gap:.3g} m in {starts} attempts.",
            remedy="Move the motors back towards the reference.",
            gap=gap,
        )
    q = wrapped(motors.robot, q)
    order = np.argsort(np.abs(keys - _frames(robot, reference)).max(axis=1), kind="stable")
    q = q[order]
    margin = project(motors, motors.evaluate(q)).margin
    unseen = float((hits == 1).sum() / hits.sum())
    x = coordinates(robot, system.evaluate(q))
    shown = (
        read_only(q),
        read_only(x),
        margin,
        read_only(~out_of_range(robot, q, motion=False)),
        read_only(hits[order]),
    )
    return AssemblyModes(robot, *shown, unseen)


def _frames(robot: Robot, q: Array) -> Array:
    """Return the origins of joints and of frames of closures and platform, and the platform's axes, m, at one state."""
    model = robot.model
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    pose = constraint_system(robot).evaluate(q[None]).pose
    parts = [*(data.oMi[k].translation for k in range(1, model.njoints))]
    parts += [origin[:, 0] for origin in pose.frame_origin.values()]
    if robot.platform is not None:
        parts.append(robot.characteristic_length * pose.frame_rotation[robot.platform.frame][:, :, 0].ravel())
    return np.concatenate(parts)
