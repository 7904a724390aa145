"""Singularities along a trajectory: the exact times at which a motion crosses, touches or stays on them.

Type II is a zero of the signed singularity margin (smallest singular value of the scaled W with the sign of det W). It
is found on exact configurations: crossed, touched, or twice within one step. Type I is a minimum of the serial margin
that reaches zero: a motion in one working mode can touch it, not cross it.
"""

from __future__ import annotations

from bisect import bisect, insort
from dataclasses import dataclass
from typing import NoReturn

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, frozen
from redundancy_pin.errors import (
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
    millimetres,
)
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.branch import BranchEnd, ClosedState, follower
from redundancy_pin.kinematics.closure import ConstraintSystem, constraint_system
from redundancy_pin.kinematics.coordinates import distance, mode_indicator, mode_name
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.classify import Margins, SingularityKind, classify, margins_of
from redundancy_pin.singularities.roots import ZOOM, Zero, zeros
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory
from redundancy_pin.trajectory.robot_motion import robot_motion

SPACING = 0.01
"""Longest step of the search along a path, characteristic lengths. Two dips of the margin within one step would be
needed to hide a crossing; on no shipped robot it oscillates that fast."""

SERIAL_TOUCH = 1e-6
"""Serial margin below which a motion counts as touching type I. The margin goes with the square root of the distance to
the border of the workspace: this is 1e-12 m for a robot of 1 m, and Newton's method reaches a margin of 1e-8."""

TANGENT_SLOPE = 1e-4
"""Change of the signed margin per characteristic length of path below which a path counts as tangent to the locus. A
crossing at a right angle has a slope of order one."""

_FEWEST_STEPS = 400
"""Sampling steps in time at least, however short the path."""


@dataclass(frozen=True, eq=False)
class Crossing(Frozen):
    """One singularity met along a motion.

    Attributes:
        t: time, s. Exact to about 1e-13 of the duration at a crossing; to about 1e-8 if the motion only touches (at a
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
    start: ClosedState | None = None,
) -> tuple[Crossing, ...]:
    """Return every singularity along a motion, in order of time.

    Args:
        robot: the robot, or its name or path; the motion is followed in its working mode.
        motion: a trajectory (evaluated exactly at every requested time), or N samples (interpolated by quintics
            through x, ẋ, ẍ; see ``as_motion``).
        spacing: longest step of the search along the path, in characteristic lengths.
        tolerance: scaled margin of W below which a minimum counts as touching type II.
        start: as in ``inverse_kinematics``, if the motion's first pose has been solved already.

    Raises:
        InputError: coordinates of another robot, a single instant, a spacing or tolerance that is not positive.
        UnreachablePoseError: the motion leaves the workspace; carries the time.
        WorkingModeError: the motion cannot be followed in the working mode; carries the time.

    Example:
        >>> for crossing in rp.find_crossings("2rpr", rp.trajectory.reference.circle()):
        ...     print(round(crossing.t, 2), crossing.kind.label, crossing.crosses)
        0.52 type_ii True
        0.83 type_ii True
    """
    for name, value in (("spacing", spacing), ("tolerance", tolerance)):
        if not 0.0 < value < 1.0:
            raise InputError(f"{name} is {value}.", remedy="Pass a number between 0 and 1.", name=name)
    robot = as_robot(robot)
    path = FollowedPath(constraint_system(robot), robot_motion(robot, motion), spacing, start)

    def parallel(times: Array) -> Array:
        margins = path.margins(times)
        # at type I the entries of W are infinite and its determinant has no sign
        return np.where(margins.serial > SERIAL_TOUCH, margins.parallel, np.nan)

    type_ii = zeros(parallel, path.t, tolerance)
    type_i = zeros(lambda times: path.margins(times).serial, path.t, SERIAL_TOUCH)
    slack = float(np.diff(path.t).max()) / ZOOM
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
    half = float(np.diff(path.t).max()) / ZOOM
    times = np.array([max(path.law.start, t - half), min(path.law.end, t + half)])
    x = path.law.sample_at(times).x
    length = float(distance(robot, x[1:], x[:-1])[0])
    if length == 0.0:
        return 0.0
    margins = path.margins(times).parallel
    return float(margins[1] - margins[0]) / length * robot.characteristic_length


class FollowedPath:
    """Closed configurations along a platform path, on one branch: each from the nearest one that is known.

    Args:
        system: closures and platform rows.
        law: the platform's motion.
        spacing: longest step between two samples, characteristic lengths; rotations count with that length.
        start: a point of the branch at or near the first pose; otherwise found from the reference configuration.

    Attributes:
        t: (N,) times of the samples, s.

    Raises:
        UnreachablePoseError: the path leaves the workspace; carries the time.
        SingularPoseError, WorkingModeError: the path cannot be followed in the robot's working mode.
    """

    def __init__(self, system: ConstraintSystem, law: Motion, spacing: float, start: ClosedState | None = None) -> None:
        self.system, self.law, self._follower = system, law, follower(system.robot)
        self.t = _sampling_times(system.robot, law, spacing)
        x = law.sample_at(self.t).x
        first = 0
        if start is None:
            try:
                start = point_on_branch(system, x[0], float(self.t[0]))
            except SingularPoseError:  # a motion may start on a type I singularity; the next sample is regular
                first, start = 1, point_on_branch(system, x[1], float(self.t[1]))
        self._states, self._q = {float(self.t[first]): start}, dict[float, Array]()
        self._known = [*self._states]  # their times in order
        self.configurations(self.t)

    def configurations(self, times: Array) -> Array:
        """Return (M, nq) configurations at times of the motion: on the branch, or closed at a type I singularity.

        At a type I singularity the branch ends: the chains are closed from the nearest state on it.

        Raises:
            UnreachablePoseError, WorkingModeError: as of the class.
        """
        new = [t for t in times.tolist() if t not in self._q]
        x = self.law.sample_at(np.array(new)).x if new else np.empty(0)
        beyond = [k for k, t in enumerate(new) if not self._keep(t, self._follower.step(self._nearest(t), x[k]))]
        if beyond:
            # many instants next to a touch at once; all else is for the follower, one after the other
            ends = self._follower.diagnose_each([self._nearest(new[k]) for k in beyond], x[beyond])
            for k, end in zip(beyond, ends, strict=True):
                if end.is_singular:
                    self._q[new[k]] = end.q
                else:
                    self._advance(new[k], x[k])
        return np.array([self._q[t] for t in times.tolist()])

    def _nearest(self, t: float) -> ClosedState:
        """Return the state on the branch that is nearest in time."""
        after = bisect(self._known, t)
        return self._states[min(self._known[max(after - 1, 0) : after + 1], key=lambda known: abs(known - t))]

    def _keep(self, t: float, reached: ClosedState | None) -> bool:
        """Note a state on the branch, if there is one; return whether there is."""
        if reached is None:
            return False
        if t not in self._states:
            insort(self._known, t)
        self._states[t], self._q[t] = reached, reached.q
        return True

    def _advance(self, t: float, x: Array) -> None:
        """Note the configuration at a time that is more than a step from a known one."""
        end = self._follower.advance(self._nearest(t), x)
        if isinstance(end, ClosedState):
            self._keep(t, end)
        elif end.status is SampleStatus.TYPE_I:
            self._q[t] = end.q
        elif end.status is SampleStatus.UNREACHABLE:
            self._raise_border(t, end)
        else:
            mode = self.system.robot.working_mode
            raise WorkingModeError(
                f"The path cannot be followed {f'in working mode {mode_name(mode)} ' if mode else ''}at t = {t:.9g} s.",
                remedy="Keep the legs away from full stretch, full fold and zero length.",
                time=t,
            )

    def _raise_border(self, t: float, end: BranchEnd) -> NoReturn:
        """Raise UnreachablePoseError with the time before t at which the path leaves the workspace."""
        # a search that started at its second sample needs times before all known states
        inside, outside = self._known[max(bisect(self._known, t) - 1, 0)], t
        while (middle := 0.5 * (inside + outside)) not in (inside, outside):
            closed = assemble(self.system, end.last.q[None], self.law.sample_at(np.array([middle])).x).closed[0]
            inside, outside = (middle, outside) if closed else (inside, middle)
        raise UnreachablePoseError(
            f"The path leaves the workspace at t = {inside:.9g} s: at t = {t:.6g} s the closure residual is "
            f"{end.residual:.3g} m.{millimetres(end.residual, self.system.robot.characteristic_length)}",
            remedy="Keep the motion inside the workspace; its border is a type I singularity.",
            time=inside,
            residual=end.residual,
        )

    def margins(self, times: Array) -> Margins:
        """Return the margins at increasing times; errors as of the class."""
        return margins_of(self.system, self.system.evaluate(self.configurations(times)))


def _sampling_times(robot: Robot, law: Motion, spacing: float) -> Array:
    """Return (N,) times with steps of at most ``spacing`` characteristic lengths of path between them.

    The path is measured at the breakpoints of the motion too: one that oscillates between even instants would hide.
    """
    even = np.linspace(law.start, law.end, _FEWEST_STEPS + 1)
    inner = np.concatenate([law.breaks, law.knots])
    t = np.union1d(even, inner[(inner > law.start) & (inner < law.end)])
    x = law.sample_at(t).x
    path = np.concatenate([[0.0], np.cumsum(distance(robot, x[1:], x[:-1]) / robot.characteristic_length)])
    at = np.searchsorted(t, even)
    lengths = np.diff(path[at])
    counts = np.maximum(np.ceil(lengths / spacing), 1.0).astype(np.intp)
    times = [
        np.interp(np.linspace(path[a], path[b], count + 1)[:-1], path[a : b + 1], t[a : b + 1]) if count > 1 else t[[a]]
        for a, b, count in zip(at, at[1:], counts, strict=False)
    ]
    return np.unique(np.concatenate([*times, t[-1:]]))
