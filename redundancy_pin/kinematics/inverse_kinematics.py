"""From a platform motion to the motion of the tree: every sample closed, on one branch, in the working mode."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from redundancy_pin.arrays import ROUNDED_SHARE, Array, BoolArray, Frozen, IntArray, read_only
from redundancy_pin.errors import (
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
    millimetres,
)
from redundancy_pin.kinematics.assembly import assemble, evaluated
from redundancy_pin.kinematics.branch import (
    SAME_CONFIGURATION,
    BranchEnd,
    ClosedState,
    Follower,
    Rates,
    follower,
)
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import difference, in_working_mode, mode_indicator, mode_name, working_modes
from redundancy_pin.kinematics.mobility import worst_dependent_row
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.kinematics.whole_turns import advance_turns, are_too_many_turns_away
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import require_matching
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, velocity_unit
from redundancy_pin.status import SampleStatus

_FAR_STARTS = 5
"""Samples at which multistart is tried where Newton's method closes no sample in the working mode."""

_LARGEST_CACHE = 20_000
"""Samples that the cache of one motion holds at most, kilobytes each."""

_SAMPLES_PER_REPORT = 500
"""Samples between two calls of ``progress``."""

_FEWER_TURNS = "Count the coordinate from a nearer turn, or follow a motion that leads there."
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
        residual: (N,) closure residual, m; angles count times the characteristic length.
        reachable: (N,) false where no configuration was found in the working mode, and at a type I singularity; q, v,
            a, gamma and W are NaN there.
        serial_margin_bound: (N,) lower bound of the distance to a type I singularity, scaled; see
            ``branch.ClosedState``.
    """

    robot: Robot
    motion: PlatformMotion
    q: Array
    v: Array
    a: Array
    gamma: Array
    W: Array
    residual: Array
    reachable: BoolArray
    serial_margin_bound: Array

    @cached_property
    def out_of_range(self) -> BoolArray:
        """(N,) whether some joint, passive ones too, is beyond its range; see ``robot.joint_ranges``."""
        return out_of_range(self.robot, self.q)

    def state(self, k: int) -> ClosedState:
        """Return sample k as a closed state: where other motions on the same branch may start from."""
        return follower(self.robot).state_at(self.q[k], self.motion.x[k], self.gamma[k])

    def with_carriers(self, carriers: CarrierMotion) -> JointTrajectory:
        """Return the motion with the carriers' motion (N samples) in it."""
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
    start: ClosedState | None = None,
    cache: dict[bytes, Rates] | None = None,
) -> JointTrajectory:
    """Return the motion of the tree along a platform motion.

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
        cache: samples of the same platform motion that were solved before, by ``sample_key``. They are taken from here,
            and those solved now are added.

    Raises:
        InputError: the motion does not have the robot's coordinates.
        UnreachablePoseError: no configuration closes the chains; carries sample and residual.
        SingularPoseError: a sample is a type I singularity.
        WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.

    Example:
        >>> motion = rp.trajectory.reference.corner().sample(0.01)
        >>> rp.inverse_kinematics("3rrr", motion).q.shape[1]
        10
    """
    robot = as_robot(robot)
    require_matching(robot, motion)
    solution = MotionSolution(follower(robot), motion, progress, cache)
    if mark_unreachable:
        solution.solve_what_is_reachable(start)
    else:
        count, _, end = solution.follow(range(len(motion)), solution.first_state() if start is None else start)
        if end is not None:
            raise _error(end, motion, count, start)
    return solution.trajectory()


class MotionSolution:
    """The samples of a motion in progress, NaN without a configuration.

    Args:
        follower: of the robot.
        motion: N samples of the independent coordinates.
        progress: as of ``inverse_kinematics``.
        cache: as of ``inverse_kinematics``.
    """

    def __init__(
        self,
        follower: Follower,
        motion: PlatformMotion,
        progress: Callable[[int, int], None] | None = None,
        cache: dict[bytes, Rates] | None = None,
    ) -> None:
        self._follower, self._motion = follower, motion
        self.system, self._cache = follower.system, cache
        self._progress, self._done = progress, 0
        robot, samples = follower.robot, len(motion)
        self.q = np.full((samples, robot.model.nq), np.nan)
        self.v, self.a = np.full((2, samples, robot.model.nv), np.nan)
        self.gamma = np.full((samples, robot.model.nv, robot.n), np.nan)
        self.residual, self.margin = np.full((2, samples), np.nan)

    def follow(self, order: Sequence[int], here: ClosedState) -> tuple[int, ClosedState, BranchEnd | None]:
        """Solve samples one after the other from a state of the branch.

        Returns:
            How many have a state, the last of the states, and why the branch ends there; None where all have one.
        """
        cache, motion = self._cache, self._motion
        last: int | None = None
        for count, k in enumerate(order):
            key = b"" if cache is None else sample_key(motion, k)
            before = cache.get(key) if cache else None
            if before is None or not self._continues(here, before.state):
                reached = self._solved(here, k, None if last is None else self._bend(last, k))
            else:
                reached = before
            if isinstance(reached, BranchEnd):
                return count, here, reached
            if cache is not None and len(cache) < _LARGEST_CACHE:
                cache[key] = reached
            here, last = self._keep(k, reached), k
        return len(order), here, None

    def _bend(self, last: int, k: int) -> Array:
        """Return (nv,) the displacement of the tree from a solved sample to sample k beyond Γ Δx, to second order."""
        motion = self._motion
        time = motion.t[k] - motion.t[last]
        bend: Array = (0.5 * time * time) * (self.a[last] - self.gamma[last].dot(motion.xdd[last]))
        return bend

    def _continues(self, here: ClosedState, known: ClosedState) -> bool:
        """Return whether a state that was solved before is plainly on the branch of another, not whole turns away."""
        own = self._follower
        increment = difference(own.robot, known.x, here.x)
        return own.is_continuous(own.tangent(here.q, known.q), here.gamma, known.gamma, increment)

    def first_state(self) -> ClosedState:
        """Return where the branch is followed from: the first sample if it is known, else by ``point_on_branch``."""
        reached = None if self._cache is None else self._cache.get(sample_key(self._motion, 0))
        return point_on_branch(self.system, self._motion.x[0]) if reached is None else reached.state

    def solve_what_is_reachable(self, start: ClosedState | None) -> None:
        """Solve samples from the first reachable one on, then from there back; others stay NaN."""
        found = self._first_reachable(start)
        if found is None:
            self._mark(range(len(self._motion)), self._follower.home)
            return
        first, state = found
        self._follow_marked(range(first, len(self._motion)), state)
        self._follow_marked(range(first - 1, -1, -1), state)

    def _first_reachable(self, start: ClosedState | None) -> tuple[int, ClosedState] | None:
        lost = UnreachablePoseError, SingularPoseError, WorkingModeError
        follower, x = self._follower, self._motion.x
        if start is not None and isinstance(self._solved(start, 0), Rates):
            return 0, start
        if start is None:
            with contextlib.suppress(*lost):
                return 0, point_on_branch(self.system, x[0])
        near = _reacquire(follower, x, np.array(follower.robot.q_reference))
        if near is not None:
            return near
        for sample in _spread(np.arange(len(x)))[1:]:
            with contextlib.suppress(*lost):
                return sample, point_on_branch(self.system, x[sample])
        return None

    def _follow_marked(self, order: range, here: ClosedState) -> None:
        """Follow samples; behind those without a state the motion is reacquired, and followed back along its branch."""
        while order:
            count, here, end = self.follow(order, here)
            order = order[count:]
            if end is None:
                return
            if end.reason:  # nothing is known there; the samples behind it may be near again
                self._mark(order[:1], here)
                order = order[1:]
                continue
            # the chains may close on another branch at once: the sample is marked all the same
            near = _reacquire(self._follower, self._motion.x[order], here.q)
            skipped = len(order) if near is None else max(near[0], 1)
            joined = 0 if near is None else self.follow(order[1:skipped][::-1], near[1])[0]
            self._mark(order[: skipped - joined], here)
            if near is None:
                return
            here, order = near[1], order[skipped:]

    def _mark(self, samples: range, last: ClosedState) -> None:
        """Note the closure residual at samples that the branch of a state does not lead to."""
        if samples:
            ends = self._follower.diagnose_each([last] * len(samples), self._motion.x[samples])
            self.residual[samples] = [end.residual for end in ends]

    def _solved(self, here: ClosedState, k: int, bend: Array | None = None) -> Rates | BranchEnd:
        """Return a sample on the branch of a state, or why it is not there; ``bend`` as of ``extrapolate``."""
        follower, motion = self._follower, self._motion
        x, xd, xdd = motion.x[k], motion.xd[k], motion.xdd[k]
        # several joints go straight; of one alone whole turns are multiples of the first
        reached = advance_turns(follower, here, x) if follower.robot.n == 1 else follower.follow(here, x, bend)
        if isinstance(reached, BranchEnd):
            return reached
        if reached.margin >= follower.near:
            return follower.rates(reached, xd, xdd)
        lost = reached.interpolated or follower.closures_lose_rank(reached.q, reached.basis)
        passed = follower.pass_through(here, x, xd, xdd) if lost else None
        if passed is None and lost:  # the sample before may be too far for one step
            passed = follower.pass_through(reached, x, xd, xdd)
        if passed is not None:  # its margin is that of the closed state next to it
            return passed._replace(state=replace(passed.state, margin=reached.margin))
        rated = None if reached.interpolated else follower.rates(reached, xd, xdd)
        if rated is None or is_rounded(follower, rated):
            return follower.diagnose(reached, x)
        return rated

    def _keep(self, k: int, solved: Rates) -> ClosedState:
        state, self.v[k], self.a[k] = solved
        self.q[k], self.gamma[k], self.residual[k], self.margin[k] = state.q, state.gamma, state.residual, state.margin
        self._done += 1
        if self._progress is not None and (self._done % _SAMPLES_PER_REPORT == 0 or self._done == len(self.q)):
            self._progress(self._done, len(self.q))
        return state

    def trajectory(self) -> JointTrajectory:
        """Return the samples."""
        robot = self._follower.robot
        good = np.isfinite(self.v).all(axis=1)
        W = np.ascontiguousarray(self.gamma[:, robot.actuated_velocity, :].transpose(0, 2, 1))
        margin = np.where(good, self.margin, 0.0)
        parts = (self.q, self.v, self.a, self.gamma, W, self.residual, good, margin)
        return JointTrajectory(robot, self._motion, *(read_only(part) for part in parts))


def sample_key(motion: PlatformMotion, k: int) -> bytes:
    """Return the bits of time, coordinates and rates of sample k: what its solution depends on along one motion."""
    return b"".join(part[k].tobytes() for part in (motion.t, motion.x, motion.xd, motion.xdd))


def is_rounded(follower: Follower, solved: Rates) -> bool:
    """Return whether rounding of the configuration takes too much of Γ or of accelerations.

    It makes Γ wrong by 1e-16 / margin², and accelerations by the square of the rates times 1e-16 / margin³. Near a
    stretched leg, or where the branch turns sharply, both are themselves that large; at a rank loss that the branch
    goes through they are not. Each loop counts with its own margin and its own rates: one that stands near its rank
    loss loses no digits because another moves.
    """
    system, state = follower.system, solved.state
    scale, columns = velocity_unit(system.robot), system.pose_columns
    gamma = np.abs(state.gamma * (coordinate_unit(system.robot) / scale[:, None])).max(axis=1)[columns]
    speed, a = np.abs(solved.v / scale)[columns], np.abs(solved.a / scale)[columns]
    most = max(float(a.max()), float(speed.max()) ** 2)
    for rows, own in state.blocks:
        margin = 1.0 / float(np.linalg.norm(state.inverse[own[:, None], rows]))
        if margin**2 * max(float(gamma[own].max()), 1.0) < ROUNDED_SHARE:
            return True
        if margin**3 * most < ROUNDED_SHARE * float(speed[own].max()) ** 2:
            return True
    return False


def point_on_branch(system: ConstraintSystem, x: Array, time: float | None = None) -> ClosedState:
    """Return a closed state at coordinates, in the robot's working mode.

    First the straight line from the reference configuration is followed; where that leaves the workspace, multistart
    takes the solution nearest to the reference in the right working mode.

    Args:
        system: closures and platform rows; the robot's ``q_reference`` must be closed.
        x: (n,) coordinates or a pose (4, 4), base frame.
        time: s, to name in errors; otherwise they name sample 0.

    Raises:
        UnreachablePoseError: no start leads to a closed configuration; carries the smallest residual.
        SingularPoseError: the pose is a type I singularity.
        WorkingModeError: there are closed configurations, but none in the working mode.
    """
    robot, own = system.robot, follower(system.robot)
    home = own.home
    where = "of sample 0" if time is None else f"at t = {time:.9g} s"
    details: dict[str, float] = {"sample": 0} if time is None else {"time": time}
    reached = advance_turns(own, home, x) if np.isfinite(home.gamma).all() else None
    if isinstance(reached, BranchEnd) and reached.reason:
        raise UnreachablePoseError(reached.reason, remedy=_FEWER_TURNS, **details)
    if isinstance(reached, ClosedState):
        # a configuration where working modes meet belongs to both
        between = bool((np.abs(mode_indicator(robot, reached.q[None])) < SAME_CONFIGURATION).any())
        if between or in_working_mode(robot, reached.q[None])[0]:
            return reached
    q, residual, in_mode = multistart(system, home.q, x)
    closed, pose = residual < closure_tolerance(robot), f"The pose {where}, x = {np.round(x, 6).tolist()},"
    if closed and evaluated(system, q[None]).margin[0] == 0.0:
        raise SingularPoseError(
            f"{pose} is a type I singularity: the platform velocity does not determine the joint velocities.",
            remedy=_STAY_AWAY,
            **details,
        )
    if closed and not in_mode:
        raise WorkingModeError(
            f"{pose} closes only in other working modes than {mode_name(robot.working_mode)} of {robot.name}, such as "
            f"{mode_name(tuple(working_modes(robot, q[None])[0]))}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            **details,
        )
    state = own.close(q, x) if in_mode else None
    if state is None:
        mode, other = "", ""
        if robot.working_mode:
            mode, other = f" in the working mode of {robot.name}", ", or load the robot in another working_mode"
        raise UnreachablePoseError(
            f"{pose} cannot be reached{mode}: the chains stay open by {residual:.3g} m"
            f"{worst_dependent_row(system, q)}.{millimetres(residual, robot.characteristic_length)}",
            remedy=f"Move the pose into the workspace{other}.",
            **details,
            residual=residual,
        )
    return state


def _reacquire(own: Follower, targets: Array, q: Array) -> tuple[int, ClosedState] | None:
    """Return a pose that closes in the working mode, by its index, and its state; None if no pose closes.

    Newton's method starts from a configuration (nq,) and from the reference, at blocks of poses that get longer. Where
    the chains close in other modes only, multistart looks for the mode at some of the poses. Poses before the one found
    may close too: they are on its branch.
    """
    system, robot = own.system, own.robot
    start, count = 0, 32
    while start < len(targets):
        part = targets[start : start + count]
        guesses = np.array([q, robot.q_reference])
        solutions = [
            assemble(system, np.repeat(guess[None], len(part), axis=0), part, shortest_step=2.0**-3)
            for guess in guesses
        ]
        near = ~are_too_many_turns_away(robot, own.home.x, part)
        for k in np.flatnonzero(near & np.any([solution.usable for solution in solutions], axis=0)).tolist():
            for solution in solutions:
                state = own.close(solution.q[k], part[k]) if solution.usable[k] else None
                if state is not None and state.margin > 0.0:
                    return start + k, state
        closed = np.flatnonzero(near & np.any([solution.regular for solution in solutions], axis=0))
        for k in _spread(closed):
            solved = multistart(system, q, part[k])
            state = own.close(solved.q, part[k]) if solved.in_mode else None
            if state is not None and state.margin > 0.0:
                return start + k, state
        start, count = start + count, 2 * count
    return None


def _spread(samples: IntArray) -> list[int]:
    """Return the first and the last of some samples, and some between them, each once."""
    places = np.linspace(0, len(samples) - 1, min(_FAR_STARTS, len(samples))).round().astype(int)
    return [int(samples[place]) for place in places]


def _error(end: BranchEnd, motion: PlatformMotion, k: int, start: ClosedState | None) -> RedundancyPinError:
    """Return the error of sample k, which a branch does not lead to; ``start``: as of ``inverse_kinematics``."""
    robot, t, x = end.last.robot, float(motion.t[k]), motion.x[k]
    place = f"sample {k} (t = {t:.6g} s, x = {np.round(x, 6).tolist()})"
    if end.reason:
        return UnreachablePoseError(end.reason, remedy=_FEWER_TURNS, sample=k)
    if end.status is SampleStatus.UNREACHABLE:
        worst = worst_dependent_row(constraint_system(robot), end.q)
        return UnreachablePoseError(
            f"The pose of {place} cannot be reached: the chains stay open by {end.residual:.3g} m{worst}."
            f"{millimetres(end.residual, robot.characteristic_length)}",
            remedy='Keep the motion inside the workspace. Inverse dynamics can mark such samples: unreachable="mark", '
            "on the command line --unreachable mark.",
            sample=k,
            residual=end.residual,
        )
    if end.rank_lost:
        return SingularPoseError(
            f"At {place} the closures lose rank, and no branch leads smoothly through that pose: the joint velocities "
            "are undetermined.",
            remedy="Keep away from that pose, or change a length a little so that branches do not meet.",
            sample=k,
            time=t,
            x=x.tolist(),
        )
    if end.status is SampleStatus.TYPE_I:
        return SingularPoseError(
            f"Sample {k} (t = {t:.6g} s) is a type I singularity: the platform velocity does not determine the joint "
            "velocities.",
            remedy=_STAY_AWAY,
            sample=k,
        )
    if start is not None and k == 0:
        return WorkingModeError(
            f"The pose of sample 0, x = {np.round(x, 6).tolist()}, cannot be reached continuously from the start at "
            f"x = {np.round(start.x, 6).tolist()}: the straight line leaves the workspace or passes a type I "
            "singularity.",
            remedy="Start nearer to it, or leave the start out.",
            sample=0,
        )
    if not in_working_mode(robot, end.q[None])[0]:
        leg = int(np.argmax(mode_indicator(robot, end.q[None])[0] * np.array(robot.working_mode) <= 0.0))
        name = robot.working_modes.joints[leg] if robot.working_modes else ""
        return WorkingModeError(
            f"The motion leaves the working mode {mode_name(robot.working_mode)} at sample {k} (t = {t:.6g} s): leg "
            f"{leg + 1} ({name}) changes over.",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
            leg=leg + 1,
        )
    before = max(k - 1, 0)
    return WorkingModeError(
        f"The motion cannot be followed continuously from sample {before} to {k} (t = {motion.t[before]:.6g} to "
        f"{t:.6g} s, x = {np.round(x, 6).tolist()}): the way there leaves the workspace, or passes "
        "a type I singularity (a leg at full stretch, full fold or zero length) or a rank loss of the closures that no "
        "smooth branch is known to lead across.",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=k,
    )
