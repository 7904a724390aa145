"""Singularities along a trajectory: the exact times at which a motion crosses, touches or stays on them.

Type II is a zero of the signed singularity margin (smallest singular value of the scaled W with the sign of det W). It
is found on exact configurations: crossed, touched, or twice within one step. Type I is a minimum of the serial margin
that reaches zero: a motion in one working mode can touch it, not cross it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, BoolArray, Frozen, frozen
from redundancy_pin.errors import InputError, UnreachablePoseError, WorkingModeError, millimetres
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.continuation import Point, continuous
from redundancy_pin.kinematics.coordinates import difference, mode_indicator, mode_name, pose_rows
from redundancy_pin.kinematics.inverse_kinematics import SAME_CONFIGURATION, inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.named import require_matching
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, position_unit, row_scale, velocity_unit
from redundancy_pin.singularities.classify import Margins, SingularityKind, classify, margins_of
from redundancy_pin.singularities.roots import Zero, zeros
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, TimedTrajectory, continuous_motion

SPACING = 0.01
"""Longest step of the search along a path, characteristic lengths. Two dips of the margin within one step would be
needed to hide a crossing; on no shipped robot it oscillates that fast."""

SERIAL_TOUCH = 1e-6
"""Serial margin below which a motion counts as touching type I. The margin goes with the square root of the distance to
the border of the workspace: this is 1e-12 m for a robot of 1 m, and Newton's method reaches a margin of 1e-8."""

TANGENT_SLOPE = 1e-4
"""Change of the signed margin per characteristic length of path below which a path counts as tangent to the locus. A
crossing at a right angle has a slope of order one."""

_PROBE = 1e-2
"""Half of the step of the slope, and the distance within which two zeros are one, as a fraction of a sampling step."""

_FEWEST_STEPS = 400
"""Sampling steps in time at least, however short the path."""

_OVERSHOOT = 0.5
"""Change of a joint over one sampling step, rad or characteristic lengths, that is no motion along the branch: Newton's
method overshot next to a singularity. A sampling step is a hundredth of the robot's size."""

_HALVINGS, _KINK = 30, 0.2
"""Bisections of a step over which q does not follow its rate, and the fraction of its change below which the step is
smooth or a kink. At a square root each halving of time shrinks the change by 0.7, so five suffice; a jump stays."""

_NO_SIDE = 1e-6
"""Mode indicator (sine or metres) that counts as zero: Newton's method leaves as much at a type I singularity."""

_SLOW_NEWTON = 80
"""Newton iterations at a type I singularity. There the error only halves in each; 50 halvings reach rounding."""

_STAY_AWAY = "Keep the legs away from full stretch, full fold and zero length."


@dataclass(frozen=True, eq=False)
class Crossing(Frozen):
    """One singularity met along a motion.

    Attributes:
        t: time, s. Exact to about 1e-13 of the duration where the motion crosses; to about 1e-8 where it touches (at a
            minimum a time is only known to the square root of rounding).
        until: equal to ``t``, or the time, s, until which the motion stays on the singularity.
        x: (n,) or (4, 4) platform coordinates, base frame, m and rad.
        q: (nq,) configuration of the tree, carriers at zero.
        kind: type I, type II or combined.
        crosses: whether det W changes sign; if not, the motion touches the singularity or ends on it.
        slope: change of the signed margin along the path per characteristic length; zero for a touching type I.
        leg: at type I, the number (from 1) of the leg that changes its working mode there; None at type II, and without
            declared working modes.
        uncontrolled_twist: (n,) m/s and rad/s, base frame, see ``Singularities``; NaN at type I.
        lost_direction: (n,) m/s and rad/s, base frame; NaN at type II.
    """

    t: float
    until: float
    x: Array
    q: Array
    kind: SingularityKind
    crosses: bool
    slope: float
    leg: int | None
    uncontrolled_twist: Array
    lost_direction: Array

    @property
    def tangential(self) -> bool:
        """Whether the path is tangent to the singularity: it touches, or crosses with nearly zero slope."""
        return abs(self.slope) < TANGENT_SLOPE


def find_crossings(
    robot: RobotLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    spacing: float = SPACING,
    tolerance: float = RANK_TOLERANCE,
    start: Point | None = None,
) -> tuple[Crossing, ...]:
    """Return every singularity along a motion, in order of time.

    Args:
        robot: the robot, or its name or path; the motion is followed in its working mode.
        motion: a trajectory (evaluated exactly at every requested time), or N samples (interpolated by quintics
            through x, ẋ, ẍ; see ``continuous_motion``).
        spacing: longest step of the search along the path, in characteristic lengths.
        tolerance: scaled margin of W below which a minimum counts as touching type II.
        start: as in ``inverse_kinematics``, if the motion's first pose has been solved already.

    Raises:
        InputError: coordinates of another robot, a single instant, a spacing or tolerance that is not positive.
        UnreachablePoseError: the motion leaves the workspace; carries the time.
        WorkingModeError: the motion cannot be followed in the working mode; carries the time.

    Example:
        >>> for crossing in find_crossings("2rpr", reference.circle()):
        ...     print(crossing.t, crossing.kind.label, crossing.crosses)
    """
    for name, value in (("spacing", spacing), ("tolerance", tolerance)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name} is {value}.", remedy="Pass a number between 0 and 1.", name=name)
    robot = as_robot(robot)
    path = follow_law(constraint_system(robot), motion_of(robot, motion), spacing, start)

    def parallel(times: Array) -> Array:
        margins = path.margins(times)
        # at type I the entries of W are infinite and its determinant has no sign
        return np.where(margins.serial > SERIAL_TOUCH, margins.parallel, np.nan)

    type_ii = zeros(parallel, path.t, tolerance)
    type_i = zeros(lambda times: path.margins(times).serial, path.t, SERIAL_TOUCH)
    slack = _PROBE * float(np.diff(path.t).max())
    alone = [one for one in type_ii if not any(_overlap(one, other, slack) for other in type_i)]
    met = [_describe(path, zero, SingularityKind.TYPE_I) for zero in type_i]
    met += [_describe(path, zero, SingularityKind.TYPE_II) for zero in alone]
    return tuple(sorted(met, key=lambda crossing: crossing.t))


def _overlap(one: Zero, other: Zero, slack: float) -> bool:
    """Return whether two zeros are the same instant: a combined singularity shows in both margins."""
    return one.t <= other.until + slack and other.t <= one.until + slack


def _describe(path: FollowedPath, zero: Zero, expected: SingularityKind) -> Crossing:
    """Return the singularity at a zero of a margin: its kind and directions, from the configuration there."""
    system, robot = path.system, path.system.robot
    time = np.array([zero.t])
    q = path.configurations(time)
    tolerance = SERIAL_TOUCH if expected == SingularityKind.TYPE_I else RANK_TOLERANCE
    classified = classify(robot, q, tolerance=tolerance)
    type_i = expected == SingularityKind.TYPE_I
    kind = SingularityKind.COMBINED if type_i and classified.type_ii[0] else expected
    nothing = np.full(robot.n, np.nan)
    leg = None
    if type_i and robot.working_modes is not None:
        leg = int(np.abs(mode_indicator(robot, q)[0]).argmin()) + 1
    if kind == SingularityKind.COMBINED:
        uncontrolled = classified.uncontrolled_twist[0]
    else:
        uncontrolled = nothing if type_i else classified.least_controlled[0]
    return Crossing(
        t=zero.t,
        until=zero.until,
        x=frozen(path.law.sample_at(time).x[0]),
        q=frozen(q[0]),
        kind=kind,
        crosses=zero.crosses,
        slope=0.0 if type_i else _slope(system, path, zero.t),
        leg=leg,
        uncontrolled_twist=frozen(uncontrolled),
        lost_direction=frozen(classified.least_producible[0] if type_i else nothing),
    )


def _slope(system: ConstraintSystem, path: FollowedPath, t: float) -> float:
    """Return the central difference of the signed margin along the path, per characteristic length."""
    robot = system.robot
    half = _PROBE * float(np.diff(path.t).max())
    times = np.array([max(path.law.start, t - half), min(path.law.end, t + half)])
    x = path.law.sample_at(times).x
    length = float(np.linalg.norm(difference(robot, x[1:], x[:-1])[0] * row_scale(robot)))
    if length == 0.0:
        return 0.0
    margins = path.margins(times).parallel
    return float(margins[1] - margins[0]) / length * robot.characteristic_length


def motion_of(robot: Robot, source: PlatformMotion | TimedTrajectory) -> ContinuousMotion:
    """Return the motion of a robot's platform as a function of time (``continuous_motion``).

    Angles of samples may be written within a turn; between them they take the short way. Where a platform cannot move
    along some axes, the rates of its pose along them are zero.

    Raises:
        InputError: the motion does not have the robot's coordinates, or has a single instant only.
    """
    if not isinstance(source, PlatformMotion):
        law = continuous_motion(source)
        require_matching(robot, law.sample_at(np.array([law.start])))
        return law
    require_matching(robot, source)
    if source.is_pose:
        rates = np.zeros((2, len(source), 6))
        rates[:, :, pose_rows(robot)] = source.xd, source.xdd
        return continuous_motion(PlatformMotion(source.t, source.x, *rates, check_rates=source.check_rates))
    steps = np.diff(source.x, axis=0)
    turns = np.cumsum(np.round((difference(robot, source.x[1:], source.x[:-1]) - steps) / (2.0 * np.pi)), axis=0)
    x = source.x + 2.0 * np.pi * np.concatenate([np.zeros((1, robot.n)), turns])
    return continuous_motion(PlatformMotion(source.t, x, source.xd, source.xdd, check_rates=source.check_rates))


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """Closed configurations along a platform path, close enough to each other for interpolation.

    Attributes:
        system: closures and platform rows.
        law: the platform's motion.
        t: (N,) times, s.
        q: (N, nq) configurations.
    """

    system: ConstraintSystem
    law: ContinuousMotion
    t: Array
    q: Array

    def configurations(self, times: Array) -> Array:
        """Return (M, nq) configurations at increasing times between the first and the last, by Newton from a neighbour.

        Raises:
            UnreachablePoseError: the path leaves the workspace between two samples; carries the time.
            WorkingModeError: Newton reaches another branch.
        """
        model, unit = self.system.robot.model, velocity_unit(self.system.robot)
        left = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        span = configuration_difference(model, self.q[left], self.q[left + 1])
        u = ((times - self.t[left]) / (self.t[left + 1] - self.t[left]))[:, None]
        guess = integrate(model, self.q[left], u * span)
        solution = assemble(self.system, guess, self.law.sample_at(times).x, max_iterations=_SLOW_NEWTON)
        _require_closed(self.system.robot, times, solution.gap)
        miss = np.abs(configuration_difference(model, guess, solution.q) / unit).max(axis=1)
        # near a type I singularity q goes with a square root: within half of the span is on the branch, not beyond
        lost = np.flatnonzero(miss > np.maximum(np.abs(span / unit).max(axis=1), SAME_CONFIGURATION))
        if len(lost):
            t = float(times[lost[0]])
            raise WorkingModeError(
                f"At t = {t:.9g} s the configuration between two samples lies on another branch.",
                remedy="Ask for a finer spacing, or keep away from type I singularities.",
                time=t,
            )
        return solution.q

    def margins(self, times: Array) -> Margins:
        """Return the margins at increasing times; errors as ``configurations``."""
        return margins_of(self.system, self.system.evaluate(self.configurations(times)))


def follow_law(
    system: ConstraintSystem, law: ContinuousMotion, spacing: float, start: Point | None = None
) -> FollowedPath:
    """Return a path, solved on the robot's branch at steps of at most ``spacing`` characteristic lengths.

    Rotations count with the characteristic length. ``start`` is a point of the branch at or near the first pose.

    Raises:
        UnreachablePoseError: a pose cannot be reached; carries the time at which the path leaves the workspace.
        WorkingModeError: the path cannot be followed in the robot's working mode.
    """
    robot, t = system.robot, _sampling_times(system.robot, law, spacing)
    still, x = np.zeros((len(t), robot.n)), law.sample_at(t).x
    motion = PlatformMotion(t, x, still, still)
    tree = inverse_kinematics(robot, motion, mark_unreachable=True, start=start, positions_only=True)
    path = FollowedPath(system, law, t, np.array(tree.q))
    _drop_overshoots(path.q, position_unit(robot))
    if np.isnan(path.q).any():
        _fill_in(path, tree.gap)
    gamma = project(system, system.evaluate(path.q)).gamma
    _require_no_jump(path, ~continuous(system, path.q, gamma, x))
    return path


def _sampling_times(robot: Robot, law: ContinuousMotion, spacing: float) -> Array:
    """Return (N,) times with steps of at most ``spacing`` characteristic lengths between them."""
    t = np.linspace(law.start, law.end, _FEWEST_STEPS + 1)
    x = law.sample_at(t).x
    steps = np.linalg.norm(difference(robot, x[1:], x[:-1]) / coordinate_unit(robot), axis=1)
    nodes = np.concatenate([[0.0], np.cumsum(np.maximum(np.ceil(steps / spacing), 1.0))])
    return np.interp(np.arange(nodes[-1] + 1.0), nodes, t)


def _drop_overshoots(q: Array, unit: Array) -> None:
    """Set samples (N, nq) to NaN that are too far from the last sample before them to lie on its branch."""
    last: int | None = None
    for k in np.flatnonzero(np.isfinite(q[:, 0])).tolist():
        if last is not None and np.abs((q[k] - q[last]) / unit).max() > _OVERSHOOT * (k - last):
            q[k] = np.nan
        else:
            last = k


def _fill_in(path: FollowedPath, residual: Array) -> None:
    """Solve the samples (NaN in q) at or next to a type I singularity, each from its nearest neighbour.

    The inverse kinematics leaves them out: its predicted step would end on the other side of a square root. Newton's
    method without a prediction stays on its own side.

    Args:
        path: the path.
        residual: (N,) closure residuals that the inverse kinematics left, m.
    """
    system, robot, q = path.system, path.system.robot, path.q
    known, missing = np.flatnonzero(~np.isnan(q[:, 0])), np.flatnonzero(np.isnan(q[:, 0]))
    if len(known) == 0:
        _require_closed(robot, path.t, residual)
        raise WorkingModeError(
            f"No sample of the path lies in working mode {mode_name(robot.working_mode)}.",
            remedy=_STAY_AWAY,
            time=float(path.t[0]),
        )
    nearest = known[np.abs(missing[:, None] - known).argmin(axis=1)]
    solution = assemble(system, q[nearest], path.law.sample_at(path.t[missing]).x, max_iterations=_SLOW_NEWTON)
    q[missing] = solution.q
    for k in np.flatnonzero(~solution.closed)[:1]:
        _raise_border(path, int(missing[k]), float(solution.gap[k]))
    other = (mode_indicator(robot, solution.q) * np.array(robot.working_mode) < -_NO_SIDE).any(axis=1)
    for lost in path.t[missing[other]].tolist():
        raise WorkingModeError(
            f"The path cannot be followed in working mode {mode_name(robot.working_mode)} at t = {lost:.9g} s.",
            remedy=_STAY_AWAY,
            time=lost,
        )


def _raise_border(path: FollowedPath, bad: int, residual: float) -> NoReturn:
    """Raise UnreachablePoseError with the time at which the path leaves the workspace before the sample ``bad``."""
    robot, t = path.system.robot, path.t
    if bad == 0:
        _require_closed(robot, t[:1], np.array([residual]))
    inside, outside, q = float(t[bad - 1]), float(t[bad]), path.q[bad - 1]
    while len(times := np.unique(np.linspace(inside, outside, 17))) > 2:
        poses = path.law.sample_at(times[1:-1]).x
        solution = assemble(path.system, np.repeat(q[None], len(poses), axis=0), poses, max_iterations=_SLOW_NEWTON)
        reached = int(np.argmin(np.append(solution.closed, False)))
        inside, outside = float(times[reached]), float(times[reached + 1])
        q = solution.q[reached - 1] if reached else q
    raise UnreachablePoseError(
        f"The path leaves the workspace at t = {inside:.9g} s: at t = {t[bad]:.6g} s the closure residual is "
        f"{residual:.3g} m.{millimetres(residual, robot.characteristic_length)}",
        remedy="Keep the motion inside the workspace; its border is a type I singularity.",
        time=inside,
        gap=residual,
    )


def _require_closed(robot: Robot, times: Array, residual: Array) -> None:
    """Raise UnreachablePoseError for the first pose with a closure residual (N,), m, above the tolerance."""
    for k in np.flatnonzero(~(residual < closure_tolerance(robot)))[:1]:
        raise UnreachablePoseError(
            f"The pose at t = {times[k]:.9g} s cannot be reached: the closure residual is {residual[k]:.3g} m."
            f"{millimetres(float(residual[k]), robot.characteristic_length)}",
            remedy="Keep the motion inside the workspace.",
            time=float(times[k]),
            gap=float(residual[k]),
        )


def _require_no_jump(path: FollowedPath, suspects: BoolArray) -> None:
    """Bisect steps (N − 1,) over which q does not follow its rate: a kink shrinks, a jump to another branch stays.

    A leg that passes through zero length jumps: the prismatic leg of a 2-RPR turns by π at its base hinge.

    Raises:
        WorkingModeError: the configuration jumps; carries the time.
    """
    model, unit = path.system.robot.model, velocity_unit(path.system.robot)

    def distance(one: Array, other: Array) -> float:
        return float(np.abs(configuration_difference(model, one[None], other[None]) / unit).max())

    for k in np.flatnonzero(suspects):
        left, right, q_left, q_right = float(path.t[k]), float(path.t[k + 1]), path.q[k], path.q[k + 1]
        span = distance(q_left, q_right)
        limit = max(_KINK * span, SAME_CONFIGURATION)
        for _ in range(_HALVINGS):
            middle = 0.5 * (left + right)
            # from both ends: Newton cannot start at the one that is singular
            goal = path.law.sample_at(np.array([middle])).x.repeat(2, axis=0)
            solution = assemble(path.system, np.stack([q_left, q_right]), goal, max_iterations=_SLOW_NEWTON)
            if not solution.closed.any():
                break
            parts = [(distance(q_left, q), distance(q, q_right)) for q in solution.q]
            best = min(np.flatnonzero(solution.closed), key=lambda i: max(parts[i]))
            if parts[best][0] < parts[best][1]:
                left, q_left, span = middle, solution.q[best], parts[best][1]
            else:
                right, q_right, span = middle, solution.q[best], parts[best][0]
            if span < limit:
                break
        if span > limit:
            raise WorkingModeError(
                f"The configuration jumps at t = {left:.9g} s (by {span:.3g} rad or characteristic lengths): the path "
                "runs through a type I singularity, behind which the working mode is another branch.",
                remedy=_STAY_AWAY,
                time=left,
            )
