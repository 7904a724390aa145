"""Follow a solution branch: from one closed configuration to the next, continuously.

``Follower.advance`` goes from a closed state to other coordinates: a prediction by Γ, Newton's method, one acceptance
test, and shorter steps where that fails (``closed_state``). Where the closure rows lose rank branches cross, and the
branch continues with the tangent it came with (``passage``). ``BranchEnd`` states why a branch ends.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache
from typing import overload

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, LARGEST, Array, Frozen, checked, read_only
from redundancy_pin.errors import InputError, WorkingModeError
from redundancy_pin.kinematics.assembly import SETTLED_STEP, assemble
from redundancy_pin.kinematics.closed_state import CONTINUITY, ROUNDING, ClosedState, LoopSolver, Rates
from redundancy_pin.kinematics.coordinates import difference, mode_indicators, moved
from redundancy_pin.kinematics.passage import PASSED, SAME_TANGENT, SPACINGS, find_passage
from redundancy_pin.motion import require_poses
from redundancy_pin.robot import Robot
from redundancy_pin.status import SampleStatus

__all__ = ["BranchEnd", "ClosedState", "Follower", "Rates", "follower"]

LONGEST_STEP = 0.04
"""Longest step along a path, in characteristic lengths or rad: Newton converges from the prediction by Γ."""

_MOST_STEPS = 20_000
"""Steps along one straight path: eight hundred characteristic lengths."""

_FARTHEST_JOINT = 20.0
"""rad or characteristic lengths, three turns: no longer way of several joints is followed to one sample."""

_NEAR_TARGET = 2.0**-2
"""Part of the longest step within which a target that Newton's method does not close is out of reach: from farther
away it may miss one, next to a singularity."""

SAME_CONFIGURATION = 1e-6
"""Closed configurations of one pose nearer than this (rad, characteristic lengths) are the same, computed twice."""


@dataclass(frozen=True, eq=False)
class BranchEnd(Frozen):
    """Why a branch does not lead to coordinates: the answer of ``Follower.advance`` in place of a state.

    Attributes:
        status: ``UNREACHABLE``: Newton's method from the last state does not close the loops at the coordinates.
            ``TYPE_I``: it closes them where K is singular and no smooth branch leads through. ``BRANCH_LOST``: it
            closes them, but what lies between is not on one branch. ``NOT_FINITE``: the coordinates, or Γ of the start,
            are not finite, or beyond 1e100.
        x: (n,) the coordinates, or a pose (4, 4).
        last: the farthest state on the way there that is on the branch.
        q: (nq,) the configuration that Newton's method ends at.
        residual: the closure residual there, m.
        rank_lost: whether the closure rows themselves lose rank there, for ``TYPE_I``.
        reason: why the way there is not followed at all, for ``UNREACHABLE``; otherwise empty.

    Example:
        >>> from redundancy_pin.kinematics.branch import ClosedState, follower
        >>> branch = follower(rp.load_robot("five_bar"))
        >>> end = branch.advance(branch.home, branch.home.x + 2.0)
        >>> isinstance(end, ClosedState), end.status.label
        (False, 'unreachable')
    """

    status: SampleStatus
    x: Array
    last: ClosedState
    q: Array
    residual: float
    rank_lost: bool = False
    reason: str = ""

    @property
    def is_singular(self) -> bool:
        """Whether ``q`` is closed at a singular K where the closure rows keep rank, so that no branch leads on."""
        return self.status is SampleStatus.TYPE_I and not self.rank_lost

    @property
    def is_final(self) -> bool:
        """Whether the coordinates themselves are at fault, so that shorter steps towards them do not help."""
        return self.status is SampleStatus.UNREACHABLE or self.is_singular


class Follower(LoopSolver):
    """Follows branches of a robot; a workspace that holds Pinocchio data, see ``follower``.

    docs/simulation.md has a simulator that is made of it.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot)
        self._legs = list(zip(*(part.tolist() for part in mode_indicators(robot)[:2]), strict=True))

    @cached_property
    def home(self) -> ClosedState:
        """The reference configuration, whose Γ is NaN where it is singular."""
        q = np.array(self.robot.q_reference)
        closed = self.state_at(q)
        if closed is not None and closed.margin > 0.0:
            return replace(closed, q=read_only(q))
        gamma = np.full((self.robot.model.nv, self.robot.n), np.nan)
        return self.singular_state(self.coordinates_at(q), q, gamma)

    @overload
    def state_at(self, q: Array, x: Array | None = None) -> ClosedState | None: ...

    @overload
    def state_at(self, q: Array, x: Array, gamma: Array) -> ClosedState: ...

    def state_at(self, q: Array, x: Array | None = None, gamma: Array | None = None) -> ClosedState | None:
        """Return the closed state at or next to a configuration, or None if no closed one is near.

        Newton's method keeps the independent coordinates and moves the other joints, by rounding or the noise of
        measurements. Where it moves those of an open configuration so far that K may be singular on the way, the chains
        may close on another branch: the result is None then.

        Args:
            q: (nq,) a configuration, closed or nearly so, carriers at any place.
            x: (n,) its coordinates, or a pose (4, 4); by default computed from q.
            gamma: (nv, n) Γ there, where it is known, as of a sample of a ``JointTrajectory``. Near a singular K, where
                Newton's method does not close the chains, q and Γ are taken as they are, and ``residual`` says how far
                q is from closed.

        Raises:
            InputError: a configuration of another shape.

        Example:
            >>> state = follower(robot).state_at(tree.q[0], motion.x[0], tree.gamma[0])
        """
        if np.shape(q) != (self.robot.model.nq,):
            checked(q, "q", (self.robot.model.nq,))  # which raises
        parked = np.array(q)
        parked[self.robot.carrier_position] = 0.0
        if x is None:
            x = self.coordinates_at(parked)
        closed = self.close(parked, x)
        if closed is not None and not self.length(self.tangent(parked, closed.q)) < 0.5 * closed.margin:
            # next to a stretched leg even rounding moves far
            was_closed = self.identity_error(parked, x, closed.gamma, None)[0] < CLOSURE_TOLERANCE
            closed = closed if was_closed else None
        if gamma is None or (closed is not None and closed.margin > self.near):
            return closed
        residual, _ = self.identity_error(parked, x, gamma, None)
        return self.singular_state(x, parked, gamma, residual * self.robot.characteristic_length)

    # --- along a branch ----------------------------------------------------------------------------------------------

    def advance(self, here: ClosedState, x: Array) -> ClosedState | BranchEnd:
        """Return the state at coordinates x on the branch of ``here``, along the straight line, or why the branch ends.

        Steps are halved until each is accepted. A rank loss of the closures that the branch goes smoothly through is
        passed.

        Args:
            here: a state of the branch.
            x: (n,) coordinates, m and rad, or a pose (4, 4), base frame.

        Raises:
            InputError: coordinates of another shape, a matrix that is not a pose, or a state of another robot.
        """
        given = np.asarray(x)
        if given.dtype.kind not in "fiu" or np.ma.is_masked(x):
            checked(x, "x", here.x.shape)  # which raises
        x = read_only(np.array(given, dtype=np.float64))
        self._require_own(here)
        self.require_shapes(here.q, x)
        if not (np.abs(x) <= LARGEST).all():
            return BranchEnd(SampleStatus.NOT_FINITE, x, here, here.q, math.nan)
        if x.ndim == 2:
            require_poses(x[None])
        return self.follow(here, x)

    def follow(self, here: ClosedState, x: Array, bend: Array | None = None) -> ClosedState | BranchEnd:
        """Return what ``advance`` does, for read-only coordinates that were checked, as in a ``PlatformMotion``.

        ``bend`` is the one of ``extrapolate``, for where one step leads there.
        """
        if here.interpolated and not np.isfinite(here.gamma).all():
            return BranchEnd(SampleStatus.NOT_FINITE, x, here, here.q, math.nan)
        self._require_own(here)
        start, whole = here.x, difference(self.robot, x, here.x)
        scaled = whole / self.unit
        length = math.sqrt(scaled.dot(scaled))
        longest = size = 1.0 / min(max(math.ceil(length / LONGEST_STEP), 1), _MOST_STEPS)
        done = within_reach = 0.0
        while done < 1.0:
            end = 1.0 if done + size >= 1.0 - 1e-12 else done + size
            target = x if end == 1.0 else read_only(moved(self.robot, start, whole * end))
            reached = self.step(here, target, bend if size == 1.0 else None) or self._at_rank_loss(here, target)
            if reached is not None:
                here, done, size = reached, end, min(2.0 * size, longest)
                continue
            if end > within_reach:
                problem = self.diagnose(here, target)
                unreachable = problem.status is SampleStatus.UNREACHABLE
                if not unreachable or size <= _NEAR_TARGET * longest:
                    if end == 1.0 and problem.is_final:
                        return problem
                    if unreachable:
                        break  # the line leaves the workspace: shorter steps would only creep up to its border
                    within_reach = end
            size = 0.5 * (end - done)
            if size * max(length, 1.0) < SETTLED_STEP:
                break
        return here if done == 1.0 else self.diagnose(here, x)

    def diagnose(self, last: ClosedState, x: Array) -> BranchEnd:
        """Return why a branch that was followed to its last state does not lead to coordinates x beyond it."""
        return self.diagnose_each([last], x[None])[0]

    def diagnose_each(self, last: Sequence[ClosedState], x: Array) -> list[BranchEnd]:
        """Return why branches that were followed to N last states do not lead to coordinates x (N, n) or (N, 4, 4)."""
        solved = assemble(self.system, np.array([state.q for state in last]), x)
        closed, ends = solved.closed, []
        for k, state in enumerate(last):
            q = read_only(solved.q[k].copy())
            rank_lost = bool(closed[k]) and self.closure_margin(q) < self.near
            status = SampleStatus.BRANCH_LOST if solved.regular[k] and not rank_lost else SampleStatus.TYPE_I
            if not closed[k]:
                status = SampleStatus.UNREACHABLE
            ends.append(BranchEnd(status, read_only(x[k].copy()), state, q, float(solved.residual[k]), rank_lost))
        return ends

    def step(self, here: ClosedState, x: Array, bend: Array | None = None) -> ClosedState | None:
        """Return the state at coordinates x nearby in one step, or None if it may lie on another branch.

        A step within which K may become singular is refused, except where the branch goes smoothly through a rank loss
        of the closures there.

        Args:
            here: a state of the branch.
            x: (n,) coordinates, or a pose (4, 4).
            bend: as of ``extrapolate``.

        Raises:
            InputError: coordinates of another shape, or a state of another robot.
        """
        self._require_own(here)
        new = self.extrapolate(here, x, bend)
        if new is None:
            return None
        same_side = self._same_sides(here.q, new.q)
        if self.length(self.tangent(here.q, new.q)) < 0.5 * min(here.margin, new.margin):
            return new if same_side else None  # K stays regular within the step
        if self.changes_sign(here, new):
            return new if self.crosses(here, new) else None
        increment = difference(self.robot, x, here.x)
        bend, predicted = new.gamma - here.gamma, 0.5 * (here.gamma + new.gamma)
        even = self.length(bend.dot(increment)) <= SAME_TANGENT * self.length(predicted.dot(increment))
        if same_side and (here.interpolated or even):
            return new
        return new if same_side and not self._vanishes(here, new, increment) else None

    def require_near(self, here: ClosedState, x: Array) -> None:
        """Raise WorkingModeError where several joints are coordinates, and one is too far away for a control loop.

        It would take minutes: steps of 0.04 rad lead there. Whole turns of a single one are not followed one by one.

        Args:
            here: a state of the branch.
            x: (n,) the coordinates of one sample.
        """
        if self.robot.platform is not None or self.robot.n == 1:
            return
        away = float(np.abs(difference(self.robot, x, here.x) / self.unit).max())
        if not away <= _FARTHEST_JOINT:
            raise WorkingModeError(
                f"A joint of {self.robot.name} would move by {away:.3g} rad or characteristic lengths to one sample.",
                remedy=f"Ask for positions within {_FARTHEST_JOINT:g} of those before.",
            )

    def _require_own(self, here: ClosedState) -> None:
        """Raise InputError for a state of another robot, unless it is one of this robot too (another mode, or loads).

        It then closes the loops, and K Γ = (0, 1), where Γ is known.
        """
        if here.robot is self.robot:
            return
        fits = here.q.shape == (self.robot.model.nq,) and here.x.shape == self._shape
        if fits and here.gamma.shape == (self.robot.model.nv, self.robot.n):
            residual, slip = self.identity_error(here.q, here.x, here.gamma, None)
            if residual <= CLOSURE_TOLERANCE and not slip > PASSED:
                return
        raise InputError(
            f"The state is one of {here.robot.name}, and no closed state of {self.robot.name}.",
            remedy="Make it with the follower of the same robot.",
        )

    def _vanishes(self, before: ClosedState, after: ClosedState, increment: Array) -> bool:
        """Return whether a determinant comes to zero within a step without a change of sign, by its slopes.

        A determinant that is linear on both sides of its zero loses all of its value and more within the step, from
        either end.
        """
        lost, share = [], math.sqrt(ROUNDING)  # of the step, for differences
        for state, part in ((before, share), (after, -share)):
            K = self.matrix(self.integrate(state.q, state.gamma.dot(part * increment)), state.basis)[0]
            inside = np.array([np.linalg.slogdet(K[rows[:, None], columns])[1] for rows, columns in state.blocks])
            lost.append(-np.expm1(inside - state.determinants[1]) > 0.9 * share)
        return bool((lost[0] & lost[1]).any())

    def changes_sign(self, before: ClosedState, after: ClosedState) -> bool:
        """Return whether a determinant changes its sign from one state to the next, of the same rows."""
        known = not before.interpolated and before.basis is None and after.basis is None
        return known and bool((before.determinants[0] * after.determinants[0] < 0.0).any())

    def _same_sides(self, before: Array, after: Array) -> bool:
        """Return whether every leg is, and was, on the same side of the change of its working mode."""
        for column, turns in self._legs:
            old, new = float(before[column]), float(after[column])
            if not (math.sin(new) * math.sin(old) if turns else new * old) > 0.0:
                return False
        return True

    # --- through a rank loss of the closures -------------------------------------------------------------------------

    def crosses(self, before: ClosedState, after: ClosedState) -> bool:
        """Return whether a rank loss that the branch goes smoothly through lies between two neighbouring states.

        The determinant of a loop changes its sign there, and so may the indicator of a working mode. Where several
        loops do so, the branch has to go smoothly through the rank loss of each.
        """
        (sign0, log0), (sign1, log1) = before.determinants, after.determinants
        most = np.maximum(log0, log1)
        size0, size1 = np.exp(log0 - most), np.exp(log1 - most)
        lost = np.flatnonzero((sign0 * sign1 <= 0.0) | (np.minimum(size0, size1) <= ROUNDING))
        if not len(lost) or not np.isfinite(most[lost]).all():
            return False
        chord, still = difference(self.robot, after.x, before.x), np.zeros(self.robot.n)
        for loop in lost.tolist():
            share = float(size0[loop] / (size0[loop] + size1[loop]))
            between = self.integrate(before.q, share * self.tangent(before.q, after.q))
            ends = [self.closure_margin(state.q, before.basis, loop) for state in (before, after)]
            if not self.closure_margin(between, before.basis, loop) < 0.5 * max(ends):
                return False  # the closures keep rank: a leg is stretched, folded or of no length
            root = read_only(moved(self.robot, before.x, chord * share))
            beyond = self.pass_through(before, root, still, still, chord)
            if beyond is None:
                return False
            # nearly linear on a branch that goes through zero; on one that keeps its side nothing vanishes there
            K = self.matrix(beyond.state.q, before.basis)[0]
            rows, columns = self.blocks[loop]
            if not np.linalg.slogdet(K[rows[:, None], columns])[1] - most[loop] < math.log(CONTINUITY):
                return False
        return True

    def _at_rank_loss(self, here: ClosedState, x: Array) -> ClosedState | None:
        """Return the state at coordinates where the closures lose rank, None if they do not, or if the branch ends."""
        guess = self.integrate(here.q, here.gamma.dot(difference(self.robot, x, here.x)))
        if not self.closures_lose_rank(guess, here.basis):
            return None
        closed = self.close(guess, x, here.basis)
        if closed is not None and closed.margin > self.near:
            return None
        changed = closed is not None and closed.margin > 0.0 and self.changes_sign(here, closed)
        if closed is not None and changed and not self.crosses(here, closed):
            return None  # the branch on the other side is another one
        still = np.zeros(self.robot.n)
        result = self.pass_through(here, x, still, still)
        return None if result is None else result.state

    def pass_through(
        self, here: ClosedState, x: Array, xd: Array, xdd: Array, along: Array | None = None
    ) -> Rates | None:
        """Return the state at or near a rank loss of the closures on the branch of ``here``, by interpolation.

        Args:
            here: a state of the branch.
            x: (n,) coordinates, or a pose (4, 4).
            xd: (n,) their rates.
            xdd: (n,) their second rates.
            along: (n,) direction of the line of nodes; otherwise that from ``here`` to x or, where that goes along a
                rank loss, one coordinate's, or that of all.

        Returns:
            None if the branch does not continue smoothly (a leg at full stretch: a fold).
        """
        self.require_shapes(here.q, x)
        self._require_own(here)
        chord = difference(self.robot, x, here.x)
        directions = (chord, *np.eye(self.robot.n), self.unit) if along is None else (along,)
        for direction in directions:
            size = float(np.linalg.norm(direction / self.unit))
            for spacing in SPACINGS[1:] if size > 0.0 else ():
                passage = find_passage(self, here, x, direction / size * spacing)
                result = None if passage is None else passage.at(x, xd, xdd)
                if result is not None:
                    return result
        return None


@lru_cache(maxsize=32)
def _follower(robot: Robot, thread: int) -> Follower:
    return Follower(robot)


def follower(robot: Robot) -> Follower:
    """Return the follower of a robot in this thread, made once: it is a workspace, which no two threads share.

    Example:
        >>> from redundancy_pin.kinematics.branch import follower
        >>> branch = follower(rp.load_robot("five_bar"))
        >>> branch.advance(branch.home, branch.home.x + 0.01).W.shape
        (2, 2)
    """
    return _follower(robot, threading.get_ident())
