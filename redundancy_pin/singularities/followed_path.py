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

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, IntArray
from redundancy_pin.errors import InputError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.continuation import continuous
from redundancy_pin.kinematics.coordinates import difference, require_matching, row_scale
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.kinematics.modes import mode_indicator, mode_name
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import AXES, Robot
from redundancy_pin.singularities.classify import actuation_matrix, serial_matrix, signed_margin


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
        require_matching(robot, trajectory.sample_at([0.0]))
        return PositionLaw(0.0, float(trajectory.duration), lambda times: trajectory.sample_at(times).x)
    require_matching(robot, source)
    if source.t[-1] == source.t[0]:
        raise InputError(
            "The motion has a single instant: nothing is crossed between samples.",
            remedy="Pass at least two samples, or classify the configuration.",
        )
    interpolate = _poses(robot, source) if source.is_pose else _coordinates(robot, source)
    return PositionLaw(float(source.t[0]), float(source.t[-1]), interpolate)


def _coordinates(robot: Robot, motion: PlatformMotion) -> Callable[[Array], Array]:
    step = np.diff(motion.t)
    left = np.flatnonzero(step > 0.0)  # the two halves of a two-sided sample belong to different intervals
    right = left + 1
    change = difference(robot, motion.x[right], motion.x[left])
    return _quintic(motion, left, motion.x[left], motion.x[left] + change, motion.xd, motion.xdd)


def _quintic(
    motion: PlatformMotion,
    left: IntArray,
    x0: Array,
    x1: Array,
    xd: Array,
    xdd: Array,
) -> Callable[[Array], Array]:
    """Return the piecewise quintic through (I, n) interval ends, in Bernstein form."""
    right = left + 1
    h = (motion.t[right] - motion.t[left])[:, None]
    control = np.stack(
        [
            x0,
            x0 + h * xd[left] / 5.0,
            x0 + 2.0 * h * xd[left] / 5.0 + h * h * xdd[left] / 20.0,
            x1 - 2.0 * h * xd[right] / 5.0 + h * h * xdd[right] / 20.0,
            x1 - h * xd[right] / 5.0,
            x1,
        ]
    )
    polynomial = BPoly(control, np.append(motion.t[left], motion.t[-1]))
    return lambda times: np.asarray(polynomial(times))


def _poses(robot: Robot, motion: PlatformMotion) -> Callable[[Array], Array]:
    rows = [AXES.index(axis) for axis in robot.platform.axes] if robot.platform else []
    rate, acceleration = np.zeros((len(motion), 6)), np.zeros((len(motion), 6))
    rate[:, rows], acceleration[:, rows] = motion.xd, motion.xdd
    left = np.flatnonzero(np.diff(motion.t) > 0.0)
    right = left + 1
    h = (motion.t[right] - motion.t[left])[:, None]
    R = motion.x[:, :3, :3]
    turn = Rotation.from_matrix(R[right] @ R[left].transpose(0, 2, 1)).as_rotvec()
    end_rate = _rotation_vector_rate(turn, rate[right, 3:])
    position = _quintic(motion, left, motion.x[left, :3, 3], motion.x[right, :3, 3], rate[:, :3], acceleration[:, :3])
    control = np.stack([np.zeros_like(turn), h * rate[left, 3:] / 3.0, turn - h * end_rate / 3.0, turn])
    knots = np.append(motion.t[left], motion.t[-1])
    rotation_vector = BPoly(control, knots)

    def at(times: Array) -> Array:
        interval = np.clip(np.searchsorted(knots, times, side="right") - 1, 0, len(left) - 1)
        poses = np.zeros((len(times), 4, 4))
        poses[:, :3, :3] = Rotation.from_rotvec(rotation_vector(times)).as_matrix() @ R[left[interval]]
        poses[:, :3, 3] = position(times)
        poses[:, 3, 3] = 1.0
        return poses

    return at


def _rotation_vector_rate(phi: Array, omega: Array) -> Array:
    """Return φ̇ (N, 3) of R = exp([φ]×) R0 that turns with the world-axes angular velocity ω (N, 3).

    The inverse of the left Jacobian of SO(3): φ̇ = ω − ½ φ×ω + (1 − (θ/2) cot(θ/2))/θ² φ×(φ×ω), θ = |φ|.
    """
    theta = np.linalg.norm(phi, axis=1, keepdims=True)
    half = 0.5 * np.maximum(theta, _SMALL_ANGLE)
    factor = np.where(theta > _SMALL_ANGLE, (1.0 - half / np.tan(half)) / (4.0 * half**2), 1.0 / 12.0)
    turned = np.cross(phi, omega)
    result: Array = omega - 0.5 * turned + factor * np.cross(phi, turned)
    return result


_SMALL_ANGLE = 1e-4
"""Below it the first term of the series, 1/12, is exact to 1e-11 and the closed form loses digits."""


_FEWEST_STEPS = 400
"""Steps in time at least, however short the path."""

_BISECTIONS = 50
"""Halvings of a step that reach the rounding of its time."""


@dataclass(frozen=True, eq=False)
class Margins:
    """Margins at N configurations.

    Attributes:
        parallel: (N,) signed margin to type II, see ``signed_margin``; NaN exactly at type I.
        serial: (N,) margin to type I, not negative.
    """

    parallel: Array
    serial: Array


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


def margins_of(system: ConstraintSystem, state: ConstraintState) -> Margins:
    """Return the margins of evaluated configurations."""
    K = serial_matrix(system, state)
    return Margins(signed_margin(actuation_matrix(system, K)), np.asarray(np.linalg.svd(K, compute_uv=False)[:, -1]))


def follow_law(system: ConstraintSystem, law: PositionLaw, spacing: float) -> FollowedPath:
    """Solve a path on the robot's branch at steps of at most ``spacing`` characteristic lengths.

    Args:
        system: closures and platform rows.
        law: platform coordinates over time.
        spacing: longest step, in characteristic lengths (rotations count with that length).

    Raises:
        UnreachablePoseError: a pose cannot be reached; carries the time at which the path leaves the workspace.
        WorkingModeError: the path cannot be followed in the robot's working mode.
    """
    t, x = _times(system, law, spacing)
    tree = lift(system.robot, _still(t, x), mark_unreachable=True)
    q = _without_strays(np.array(tree.q))
    if np.isnan(q).any():
        q = _with_missing_samples(system, law, t, x, q, tree.gap)
    _require_no_jump(system, law, t, q)
    return FollowedPath(system, law, t, q)


def _times(system: ConstraintSystem, law: PositionLaw, spacing: float) -> tuple[Array, Array]:
    """Return times and coordinates, no step longer than ``spacing`` characteristic lengths."""
    robot = system.robot
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


def _still(t: Array, x: Array) -> PlatformMotion:
    """Return a motion that only carries positions: rates play no part here."""
    n = 6 if x.ndim == 3 else x.shape[1]
    return PlatformMotion(t, x, np.zeros((len(t), n)), np.zeros((len(t), n)))


def _without_strays(q: Array) -> Array:
    """Set runs of samples to NaN that lie far from the samples before them: Newton overshot next to a singularity."""
    step = np.abs(np.diff(q, axis=0)).max(axis=1)
    starts = np.concatenate([[0], np.flatnonzero(~(step < _STRAY)) + 1])
    stops = np.append(starts[1:], len(q))
    last = -1
    for start, stop in zip(starts.tolist(), stops.tolist(), strict=True):
        if np.isnan(q[start, 0]) or (last >= 0 and np.abs(q[start] - q[last]).max() > _STRAY * (start - last)):
            q[start:stop] = np.nan
        else:
            last = stop - 1
    return q


def _with_missing_samples(
    system: ConstraintSystem, law: PositionLaw, t: Array, x: Array, q: Array, gap: Array
) -> Array:
    """Close the samples that the lift passed over, each from its nearest neighbour.

    They lie at a type I singularity, or so near that a predicted step would end behind it. Newton without prediction
    stays on its side of a square root.
    """
    robot = system.robot
    known = np.flatnonzero(~np.isnan(q[:, 0]))
    missing = np.flatnonzero(np.isnan(q[:, 0]))
    if len(known) == 0:
        _require_closed(t, gap)
        raise WorkingModeError(
            f"No sample of the path lies in working mode {mode_name(robot.working_mode)}.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            time=float(t[0]),
        )
    nearest = known[np.abs(missing[:, None] - known).argmin(axis=1)]
    solution = assemble(system, q[nearest], x[missing], max_iterations=_SLOW_NEWTON)
    filled = q.copy()
    filled[missing] = solution.q
    if not solution.closed.all():
        first = int(missing[np.argmin(solution.closed)])
        _raise_border(system, law, t, filled, first, float(solution.gap[np.argmin(solution.closed)]))
    other = (mode_indicator(robot, solution.q) * np.array(robot.working_mode) < -_MODE_ROUNDING).any(axis=1)
    if other.any():
        lost = float(t[missing[np.argmax(other)]])
        raise WorkingModeError(
            f"The path cannot be followed in working mode {mode_name(robot.working_mode)} at t = {lost:.9g} s.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            time=lost,
        )
    return filled


def _require_no_jump(system: ConstraintSystem, law: PositionLaw, t: Array, q: Array) -> None:
    """Bisect steps over which q does not follow its rate: a kink shrinks, a jump to another branch stays.

    A leg that passes through zero length jumps: the prismatic leg of a 2-RPR turns by π at its base hinge.
    """
    model = system.robot.model
    gamma = project(system, system.evaluate(q)).gamma
    for k in np.flatnonzero(~continuous(system, q, gamma, law.at(t))):
        left, right, q_left, q_right = float(t[k]), float(t[k + 1]), q[k], q[k + 1]
        span = first = _distance(model, q_left, q_right)
        for _ in range(_HALVINGS):
            middle = np.array([0.5 * (left + right)])
            # from both ends: Newton cannot start at the one that is singular
            starts = np.stack([q_left, q_right])
            solution = assemble(system, starts, law.at(middle).repeat(2, axis=0), max_iterations=_SLOW_NEWTON)
            if not solution.closed.any():
                break
            parts = [(_distance(model, q_left, q), _distance(model, q, q_right)) for q in solution.q]
            best = min(np.flatnonzero(solution.closed), key=lambda i: max(parts[i]))
            if parts[best][0] < parts[best][1]:
                left, q_left, span = float(middle[0]), solution.q[best], parts[best][1]
            else:
                right, q_right, span = float(middle[0]), solution.q[best], parts[best][0]
            if span < _KINK * first or span < _SAME_CONFIGURATION:
                break
        if span > _KINK * first and span > _SAME_CONFIGURATION:
            raise WorkingModeError(
                f"The configuration jumps at t = {left:.9g} s (by {span:.3g} rad or m): the path runs through a type I "
                "singularity, behind which the working mode is another branch.",
                remedy="Keep the legs away from full stretch, full fold and zero length.",
                time=left,
            )


def _distance(model: pin.Model, one: Array, other: Array) -> float:
    return float(np.abs(configuration_difference(model, one[None], other[None])).max())


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
        _require_closed(t[bad : bad + 1], np.array([gap]))
    inside, outside, at = t[bad - 1], t[bad], q[bad - 1]
    for _ in range(_BISECTIONS):
        middle = np.array([0.5 * (inside + outside)])
        solution = assemble(system, at[None], law.at(middle), max_iterations=_SLOW_NEWTON)
        if solution.closed[0]:
            inside, at = float(middle[0]), solution.q[0]
        else:
            outside = float(middle[0])
    raise UnreachablePoseError(
        f"The path leaves the workspace at t = {inside:.9g} s: by t = {t[bad]:.6g} s the chains stay open by "
        f"{gap:.3g} m.",
        remedy="Keep the motion inside the workspace; its border is a type I singularity.",
        time=float(inside),
        gap=gap,
    )


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
