"""A platform path solved along one branch, and its singular margins at any time in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NoReturn

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.errors import UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.continuation import continuous
from redundancy_pin.kinematics.coordinates import difference, row_scale
from redundancy_pin.kinematics.modes import mode_indicator, mode_name
from redundancy_pin.kinematics.position_law import PositionLaw
from redundancy_pin.kinematics.projection import project
from redundancy_pin.kinematics.singular_matrices import actuation_matrix, serial_matrix, signed_margin
from redundancy_pin.kinematics.state import lift
from redundancy_pin.motion import PlatformMotion

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
