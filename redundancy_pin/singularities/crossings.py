"""Singularities along a trajectory: the exact times at which a motion crosses, touches or stays on one.

Type II is a zero of the signed margin (smallest singular value of the scaled W with the sign of det W), found on exact
configurations: crossed, touched, or two within one step. Type I is a minimum of the serial margin that reaches zero: a
motion in one working mode can touch it, not cross it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, BoolArray, Frozen, frozen
from redundancy_pin.errors import InputError, UnreachablePoseError, WorkingModeError, millimetres
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.branch import SAME_CONFIGURATION, ClosedState, continuous
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import difference, mode_indicator, mode_name, pose_rows
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.named import require_matching
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, position_unit, row_scale, velocity_unit
from redundancy_pin.singularities.classify import Margins, SingularityKind, classify, margins_of
from redundancy_pin.singularities.roots import Zero, zeros
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, TimedTrajectory, continuous_motion

_FEWEST_STEPS = 400
"""Steps in time at least, however short the path."""

_STRAY = 0.5
"""Change of q (rad, m) over one step of the path that is no motion of the branch: a step is a hundredth of the robot's
size."""

_HALVINGS = 30
_KINK = 0.2
"""A step that bisection shrinks below this fraction is a kink or a steep stretch: at a square root each halving of time
shrinks it by 0.7, so that five do. A jump stays."""

_MODE_ROUNDING = 1e-6
"""A mode indicator (sine or metres) this small is zero: what Newton leaves at a type I singularity."""

_SLOW_NEWTON = 80
"""At a type I singularity Newton converges linearly, halving the error: 50 halvings reach rounding."""

_STAY_AWAY = "Keep the legs away from full stretch, full fold and zero length."


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
    """Closed configurations along a platform path, near enough to each other to interpolate between.

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
    system: ConstraintSystem, law: ContinuousMotion, spacing: float, start: ClosedState | None = None
) -> FollowedPath:
    """Solve a path on the robot's branch at steps of at most ``spacing`` characteristic lengths.

    Rotations count with the characteristic length. ``start`` is a point of the branch at or near the first pose, where
    one is known.

    Raises:
        UnreachablePoseError: a pose cannot be reached; carries the time at which the path leaves the workspace.
        WorkingModeError: the path cannot be followed in the robot's working mode.
    """
    t, x = _times(system.robot, law, spacing)
    still = np.zeros((len(t), system.robot.n))
    tree = inverse_kinematics(
        system.robot, PlatformMotion(t, x, still, still), mark_unreachable=True, start=start, positions_only=True
    )
    q = _without_strays(np.array(tree.q), position_unit(system.robot))
    if np.isnan(q).any():
        _fill_in(system, law, t, x, q, tree.gap)
    path = FollowedPath(system, law, t, q)
    _require_no_jump(path, ~continuous(system, q, project(system, system.evaluate(q)).gamma, x))
    return path


def _times(robot: Robot, law: ContinuousMotion, spacing: float) -> tuple[Array, Array]:
    """Return times and coordinates, no step longer than ``spacing`` characteristic lengths."""
    t = np.linspace(law.start, law.end, _FEWEST_STEPS + 1)
    x = law.sample_at(t).x
    steps = np.linalg.norm(difference(robot, x[1:], x[:-1]) / coordinate_unit(robot), axis=1)
    pieces = np.maximum(np.ceil(steps / spacing), 1).astype(np.intp)
    if (pieces == 1).all():
        return t, x
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    fraction = within / np.repeat(pieces, pieces)
    t = np.append(np.repeat(t[:-1], pieces) + fraction * np.repeat(np.diff(t), pieces), law.end)
    return t, law.sample_at(t).x


def _without_strays(q: Array, unit: Array) -> Array:
    """Set runs of samples to NaN that lie far from the samples before them: Newton overshot next to a singularity."""
    step = np.abs(np.diff(q, axis=0) / unit).max(axis=1)
    starts = np.concatenate([[0], np.flatnonzero(~(step < _STRAY)) + 1])
    last = -1
    for start, stop in zip(starts.tolist(), np.append(starts[1:], len(q)).tolist(), strict=True):
        if np.isnan(q[start, 0]) or (last >= 0 and np.abs((q[start] - q[last]) / unit).max() > _STRAY * (start - last)):
            q[start:stop] = np.nan
        else:
            last = stop - 1
    return q


def _fill_in(system: ConstraintSystem, law: ContinuousMotion, t: Array, x: Array, q: Array, gap: Array) -> None:
    """Close the samples that the inverse kinematics passed over (NaN in q), each from its nearest neighbour.

    They lie at a type I singularity, or so near that a predicted step would end behind it. Newton without prediction
    stays on its side of a square root.
    """
    robot = system.robot
    known, missing = np.flatnonzero(~np.isnan(q[:, 0])), np.flatnonzero(np.isnan(q[:, 0]))
    if len(known) == 0:
        _require_closed(robot, t, gap)
        raise WorkingModeError(
            f"No sample of the path lies in working mode {mode_name(robot.working_mode)}.",
            remedy=_STAY_AWAY,
            time=float(t[0]),
        )
    nearest = known[np.abs(missing[:, None] - known).argmin(axis=1)]
    solution = assemble(system, q[nearest], x[missing], max_iterations=_SLOW_NEWTON)
    q[missing] = solution.q
    if not solution.closed.all():
        first = int(np.argmin(solution.closed))
        _raise_border(system, law, t, q, int(missing[first]), float(solution.gap[first]))
    other = (mode_indicator(robot, solution.q) * np.array(robot.working_mode) < -_MODE_ROUNDING).any(axis=1)
    if other.any():
        lost = float(t[missing[np.argmax(other)]])
        raise WorkingModeError(
            f"The path cannot be followed in working mode {mode_name(robot.working_mode)} at t = {lost:.9g} s.",
            remedy=_STAY_AWAY,
            time=lost,
        )


def _require_no_jump(path: FollowedPath, suspects: BoolArray) -> None:
    """Bisect steps over which q does not follow its rate: a kink shrinks, a jump to another branch stays.

    A leg that passes through zero length jumps: the prismatic leg of a 2-RPR turns by π at its base hinge.
    """
    model, unit = path.system.robot.model, velocity_unit(path.system.robot)

    def distance(one: Array, other: Array) -> float:
        return float(np.abs(configuration_difference(model, one[None], other[None]) / unit).max())

    for k in np.flatnonzero(suspects):
        left, right, q_left, q_right = float(path.t[k]), float(path.t[k + 1]), path.q[k], path.q[k + 1]
        span = first = distance(q_left, q_right)
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
            if span < max(_KINK * first, SAME_CONFIGURATION):
                break
        if span > max(_KINK * first, SAME_CONFIGURATION):
            raise WorkingModeError(
                f"The configuration jumps at t = {left:.9g} s (by {span:.3g} rad or characteristic lengths): the path "
                "runs through a type I singularity, behind which the working mode is another branch.",
                remedy=_STAY_AWAY,
                time=left,
            )


def _require_closed(robot: Robot, times: Array, gap: Array) -> None:
    bad = np.flatnonzero(~(gap < closure_tolerance(robot)))
    if len(bad):
        k = int(bad[0])
        raise UnreachablePoseError(
            f"The pose at t = {times[k]:.9g} s cannot be reached: the chains stay open by {gap[k]:.3g} m."
            f"{millimetres(float(gap[k]), robot.characteristic_length)}",
            remedy="Keep the motion inside the workspace.",
            time=float(times[k]),
            gap=float(gap[k]),
        )


def _raise_border(
    system: ConstraintSystem, law: ContinuousMotion, t: Array, q: Array, bad: int, gap: float
) -> NoReturn:
    """Close in on the time at which the path leaves the workspace, and say so: sixteen parts of an interval at once."""
    if bad == 0:
        _require_closed(system.robot, t[:1], np.array([gap]))
    inside, outside, at = float(t[bad - 1]), float(t[bad]), q[bad - 1]
    while len(times := np.unique(np.linspace(inside, outside, 17))) > 2:
        poses = law.sample_at(times[1:-1]).x
        solution = assemble(system, np.repeat(at[None], len(poses), axis=0), poses, max_iterations=_SLOW_NEWTON)
        reached = int(np.argmin(np.append(solution.closed, False)))
        inside, outside = float(times[reached]), float(times[reached + 1])
        at = solution.q[reached - 1] if reached else at
    raise UnreachablePoseError(
        f"The path leaves the workspace at t = {inside:.9g} s: by t = {t[bad]:.6g} s the chains stay open by "
        f"{gap:.3g} m.{millimetres(gap, system.robot.characteristic_length)}",
        remedy="Keep the motion inside the workspace; its border is a type I singularity.",
        time=inside,
        gap=gap,
    )


SPACING = 0.01
"""Distance of samples along the path, in characteristic lengths. On every shipped robot the margin is far from
oscillating within such a step; two dips within one would be needed to hide a crossing."""

SERIAL_TOUCH = 1e-6
"""Serial margin below which a motion counts as touching type I. The margin goes with the square root of the distance
to the border of the workspace: this is 1e-12 m on a one-metre machine, and Newton reaches a margin of 1e-8."""

TANGENT_SLOPE = 1e-4
"""Change of the signed margin per characteristic length of path below which the path counts as tangent to the locus;
crossing at a right angle gives a slope of order one."""

_PROBE = 1e-2
"""Half of the step of the slope, and the distance within which two zeros are one: this fraction of a step."""


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
        leg: at type I, the number (from 1) of the leg that changes its working mode there; None where no
            working modes are declared, and at type II.
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
        """Whether the path is tangent to the singularity: it touches, or crosses with (nearly) zero slope."""
        return abs(self.slope) < TANGENT_SLOPE


def find_crossings(
    robot: RobotLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    spacing: float = SPACING,
    tolerance: float = RANK_TOLERANCE,
    start: ClosedState | None = None,
) -> tuple[Crossing, ...]:
    """Return every singularity along a motion, in order of time.

    Args:
        robot: the robot, or its name or path; the motion is followed in its working mode.
        motion: a trajectory (evaluated exactly at every time asked for), or N samples (interpolated by quintics
            through x, ẋ, ẍ; see ``continuous_motion``).
        spacing: longest step of the search along the path, in characteristic lengths.
        tolerance: scaled margin of W below which a minimum counts as touching type II.
        start: as in ``inverse_kinematics``, where the motion's first pose has been solved already.

    Raises:
        InputError: coordinates of another robot, a single instant, a spacing or tolerance that is not positive.
        UnreachablePoseError: the motion leaves the workspace; carries the time.
        WorkingModeError: the motion cannot be followed in the working mode; carries the time.
    """
    for name, value in (("spacing", spacing), ("tolerance", tolerance)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name} is {value}.", remedy="Pass a number between 0 and 1.", name=name)
    robot = as_robot(robot)
    path = follow_law(constraint_system(robot), motion_of(robot, motion), spacing, start)

    def parallel(times: Array) -> Array:
        margins = path.margins(times)
        # at type I the entries of W are infinite and its sign means nothing
        return np.where(margins.serial > SERIAL_TOUCH, margins.parallel, np.nan)

    type_ii = zeros(parallel, path.t, tolerance)
    type_i = zeros(lambda times: path.margins(times).serial, path.t, SERIAL_TOUCH)
    slack = _PROBE * float(np.diff(path.t).max())
    alone = [one for one in type_ii if not any(_overlap(one, other, slack) for other in type_i)]
    met = [_described(path, zero, SingularityKind.TYPE_I) for zero in type_i]
    met += [_described(path, zero, SingularityKind.TYPE_II) for zero in alone]
    return tuple(sorted(met, key=lambda crossing: crossing.t))


def _overlap(one: Zero, other: Zero, slack: float) -> bool:
    """Whether two zeros are one (a combined singularity shows in both margins)."""
    return one.t <= other.until + slack and other.t <= one.until + slack


def _described(path: FollowedPath, zero: Zero, expected: SingularityKind) -> Crossing:
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
