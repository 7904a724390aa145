"""A platform path solved along one branch, and its singular margins at any time in between."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NoReturn, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, IntArray
from redundancy_pin.errors import InputError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.continuation import continuous
from redundancy_pin.kinematics.coordinates import difference, mode_indicator, mode_name, require_matching, row_scale
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import PlatformMotion, require_consistent, require_sampled
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.singularities.classify import Margins, margins_of

_FEWEST_STEPS = 400
"""Steps in time at least, however short the path."""

_BISECTIONS = 50
"""Halvings of a step that reach the rounding of its time."""

_SAME_CONFIGURATION = 1e-6
"""Configurations nearer than this (rad, m) are the same one, computed twice."""

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


class TimedMotion(Protocol):
    """What kinematics needs of a trajectory: a duration, and samples at any times in [0, duration]."""

    @property
    def duration(self) -> float:
        """Total time, s."""

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the motion at (N,) increasing times, s."""


@dataclass(frozen=True, eq=False)
class PositionLaw:
    """Platform coordinates over time.

    Attributes:
        start, end: first and last time, s.
        at: from (N,) increasing times in [start, end] to (N, n) coordinates or (N, 4, 4) poses.
    """

    start: float
    end: float
    at: Callable[[Array], Array]


def position_law(robot: Robot, source: PlatformMotion | TimedMotion) -> PositionLaw:
    """Return the platform coordinates of a trajectory or a sampled motion as a function of time.

    A trajectory is asked for its own exact coordinates. Between the samples of a motion the coordinates are the quintic
    that matches x, ẋ, ẍ at both ends (error O(Δt⁶)); the orientation of a pose is the cubic in the rotation vector from
    the left sample that matches orientation and angular velocity at both ends (error O(Δt⁴)).

    Raises:
        InputError: the motion does not have the robot's coordinates, or has a single instant only.
    """
    if not isinstance(source, PlatformMotion):
        trajectory = source
        if not (hasattr(trajectory, "duration") and hasattr(trajectory, "sample_at")):
            require_sampled(trajectory)
        require_matching(robot, trajectory.sample_at([0.0]))
        return PositionLaw(0.0, float(trajectory.duration), lambda times: trajectory.sample_at(times).x)
    require_matching(robot, source)
    require_consistent(source)
    if source.t[-1] == source.t[0]:
        raise InputError(
            "The motion has a single instant: nothing is crossed between samples.",
            remedy="Pass at least two samples, or classify the configuration.",
        )
    left = np.flatnonzero(np.diff(source.t) > 0.0)  # the two halves of a two-sided sample are in different intervals
    if source.is_pose:
        interpolate = _poses(robot, source, left)
    else:
        change = difference(robot, source.x[left + 1], source.x[left])
        interpolate = _quintic(source, left, source.x[left], source.x[left] + change, source.xd, source.xdd)
    return PositionLaw(float(source.t[0]), float(source.t[-1]), interpolate)


def _quintic(motion: PlatformMotion, left: IntArray, x0: Array, x1: Array, xd: Array, xdd: Array) -> BPoly:
    """Return the piecewise quintic between interval ends x0, x1 (I, n), with the rates of N samples."""
    h = (motion.t[left + 1] - motion.t[left])[:, None]
    (v0, v1), (a0, a1) = ((h * xd[left], h * xd[left + 1]), (h * h * xdd[left], h * h * xdd[left + 1]))
    control = [x0, x0 + v0 / 5, x0 + 2 * v0 / 5 + a0 / 20, x1 - 2 * v1 / 5 + a1 / 20, x1 - v1 / 5, x1]
    return BPoly(np.stack(control), np.append(motion.t[left], motion.t[-1]))


def _poses(robot: Robot, motion: PlatformMotion, left: IntArray) -> Callable[[Array], Array]:
    rows = [AXES.index(axis) for axis in robot.platform.axes] if robot.platform else []
    rate, acceleration = np.zeros((len(motion), 6)), np.zeros((len(motion), 6))
    rate[:, rows], acceleration[:, rows] = motion.xd, motion.xdd
    p, R = motion.x[:, :3, 3], motion.x[:, :3, :3]
    position = _quintic(motion, left, p[left], p[left + 1], rate[:, :3], acceleration[:, :3])
    h = (motion.t[left + 1] - motion.t[left])[:, None]
    between = R[left + 1] @ R[left].transpose(0, 2, 1)
    turn = Rotation.from_matrix(between).as_rotvec()
    # φ̇ of exp([φ]×) that turns with ω in world axes: the inverse of the left Jacobian, the transpose of the right one's
    end_rate = np.array([pin.Jlog3(one).T @ omega for one, omega in zip(between, rate[left + 1, 3:], strict=True)])
    rotation_vector = BPoly(
        np.stack([np.zeros_like(turn), h * rate[left, 3:] / 3.0, turn - h * end_rate / 3.0, turn]), position.x
    )

    def at(times: Array) -> Array:
        interval = np.clip(np.searchsorted(position.x, times, side="right") - 1, 0, len(left) - 1)
        poses = np.zeros((len(times), 4, 4))
        poses[:, :3, :3] = Rotation.from_rotvec(rotation_vector(times)).as_matrix() @ R[left[interval]]
        poses[:, :3, 3] = position(times)
        poses[:, 3, 3] = 1.0
        return poses

    return at


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """Closed configurations along a platform path, near enough to each other to interpolate between.

    Attributes:
        system: closures and platform rows.
        law: platform coordinates over time.
        t: (N,) times, s.
        q: (N, nq) configurations.
    """

    system: ConstraintSystem
    law: PositionLaw
    t: Array
    q: Array

    def configurations(self, times: Array) -> Array:
        """Return (M, nq) configurations at increasing times between the first and the last, by Newton from a neighbour.

        Raises:
            UnreachablePoseError: the path leaves the workspace between two samples; carries the time.
            WorkingModeError: Newton reaches another branch.
        """
        model = self.system.robot.model
        left = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        span = configuration_difference(model, self.q[left], self.q[left + 1])
        u = ((times - self.t[left]) / (self.t[left + 1] - self.t[left]))[:, None]
        guess = integrate(model, self.q[left], u * span)
        solution = assemble(self.system, guess, self.law.at(times), max_iterations=_SLOW_NEWTON)
        _require_closed(times, solution.gap)
        miss = np.abs(configuration_difference(model, guess, solution.q)).max(axis=1)
        # near a type I singularity q goes with a square root: within half of the span is on the branch, not beyond
        lost = np.flatnonzero(miss > np.maximum(np.abs(span).max(axis=1), _SAME_CONFIGURATION))
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


def follow_law(system: ConstraintSystem, law: PositionLaw, spacing: float) -> FollowedPath:
    """Solve a path on the robot's branch at steps of at most ``spacing`` characteristic lengths.

    Rotations count with the characteristic length.

    Raises:
        UnreachablePoseError: a pose cannot be reached; carries the time at which the path leaves the workspace.
        WorkingModeError: the path cannot be followed in the robot's working mode.
    """
    t, x = _times(system.robot, law, spacing)
    still = np.zeros((len(t), system.robot.n))  # rates play no part here
    tree = lift(system.robot, PlatformMotion(t, x, still, still), mark_unreachable=True)
    q = _without_strays(np.array(tree.q))
    if np.isnan(q).any():
        _fill_in(system, law, t, x, q, tree.gap)
    path = FollowedPath(system, law, t, q)
    _require_no_jump(path, ~continuous(system, q, project(system, system.evaluate(q)).gamma, x))
    return path


def _times(robot: Robot, law: PositionLaw, spacing: float) -> tuple[Array, Array]:
    """Return times and coordinates, no step longer than ``spacing`` characteristic lengths."""
    t = np.linspace(law.start, law.end, _FEWEST_STEPS + 1)
    x = law.at(t)
    steps = np.linalg.norm(difference(robot, x[1:], x[:-1]) * row_scale(robot), axis=1)
    pieces = np.maximum(np.ceil(steps / (spacing * robot.characteristic_length)), 1).astype(np.intp)
    if (pieces == 1).all():
        return t, x
    within = np.arange(pieces.sum()) - np.repeat(np.cumsum(pieces) - pieces, pieces)
    fraction = within / np.repeat(pieces, pieces)
    t = np.append(np.repeat(t[:-1], pieces) + fraction * np.repeat(np.diff(t), pieces), law.end)
    return t, law.at(t)


def _without_strays(q: Array) -> Array:
    """Set runs of samples to NaN that lie far from the samples before them: Newton overshot next to a singularity."""
    step = np.abs(np.diff(q, axis=0)).max(axis=1)
    starts = np.concatenate([[0], np.flatnonzero(~(step < _STRAY)) + 1])
    last = -1
    for start, stop in zip(starts.tolist(), np.append(starts[1:], len(q)).tolist(), strict=True):
        if np.isnan(q[start, 0]) or (last >= 0 and np.abs(q[start] - q[last]).max() > _STRAY * (start - last)):
            q[start:stop] = np.nan
        else:
            last = stop - 1
    return q


def _fill_in(system: ConstraintSystem, law: PositionLaw, t: Array, x: Array, q: Array, gap: Array) -> None:
    """Close the samples that the lift passed over (NaN in q), each from its nearest neighbour.

    They lie at a type I singularity, or so near that a predicted step would end behind it. Newton without prediction
    stays on its side of a square root.
    """
    robot = system.robot
    known, missing = np.flatnonzero(~np.isnan(q[:, 0])), np.flatnonzero(np.isnan(q[:, 0]))
    if len(known) == 0:
        _require_closed(t, gap)
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
    model = path.system.robot.model

    def distance(one: Array, other: Array) -> float:
        return float(np.abs(configuration_difference(model, one[None], other[None])).max())

    for k in np.flatnonzero(suspects):
        left, right, q_left, q_right = float(path.t[k]), float(path.t[k + 1]), path.q[k], path.q[k + 1]
        span = first = distance(q_left, q_right)
        for _ in range(_HALVINGS):
            middle = 0.5 * (left + right)
            # from both ends: Newton cannot start at the one that is singular
            goal = path.law.at(np.array([middle])).repeat(2, axis=0)
            solution = assemble(path.system, np.stack([q_left, q_right]), goal, max_iterations=_SLOW_NEWTON)
            if not solution.closed.any():
                break
            parts = [(distance(q_left, q), distance(q, q_right)) for q in solution.q]
            best = min(np.flatnonzero(solution.closed), key=lambda i: max(parts[i]))
            if parts[best][0] < parts[best][1]:
                left, q_left, span = middle, solution.q[best], parts[best][1]
            else:
                right, q_right, span = middle, solution.q[best], parts[best][0]
            if span < max(_KINK * first, _SAME_CONFIGURATION):
                break
        if span > max(_KINK * first, _SAME_CONFIGURATION):
            raise WorkingModeError(
                f"The configuration jumps at t = {left:.9g} s (by {span:.3g} rad or m): the path runs through a type I "
                "singularity, behind which the working mode is another branch.",
                remedy=_STAY_AWAY,
                time=left,
            )


def _require_closed(times: Array, gap: Array) -> None:
    bad = np.flatnonzero(~(gap < CLOSURE_TOLERANCE))
    if len(bad):
        k = int(bad[0])
        raise UnreachablePoseError(
            f"The pose at t = {times[k]:.9g} s cannot be reached: the chains stay open by {gap[k]:.3g} m.",
            remedy="Keep the motion inside the workspace.",
            time=float(times[k]),
            gap=float(gap[k]),
        )


def _raise_border(system: ConstraintSystem, law: PositionLaw, t: Array, q: Array, bad: int, gap: float) -> NoReturn:
    """Bisect for the time at which the path leaves the workspace, and say so."""
    if bad == 0:
        _require_closed(t[:1], np.array([gap]))
    inside, outside, at = float(t[bad - 1]), float(t[bad]), q[bad - 1]
    for _ in range(_BISECTIONS):
        middle = 0.5 * (inside + outside)
        solution = assemble(system, at[None], law.at(np.array([middle])), max_iterations=_SLOW_NEWTON)
        if solution.closed[0]:
            inside, at = middle, solution.q[0]
        else:
            outside = middle
    raise UnreachablePoseError(
        f"The path leaves the workspace at t = {inside:.9g} s: by t = {t[bad]:.6g} s the chains stay open by "
        f"{gap:.3g} m.",
        remedy="Keep the motion inside the workspace; its border is a type I singularity.",
        time=inside,
        gap=gap,
    )
