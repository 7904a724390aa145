"""One update: a plan by machine code, and what it does not see between its nodes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_model import SLIDING_TERMS, TURNING_TERMS
from redundancy_pin.planners.limits import LIMIT_TOLERANCE, ResolvedLimits
from redundancy_pin.planners.receding_horizon.ahead import Ahead
from redundancy_pin.planners.receding_horizon.command import Command, TickPlan, Weights, extended
from redundancy_pin.planners.receding_horizon.compiled import CompiledTick, TickScales, tick_library
from redundancy_pin.planners.receding_horizon.constants import CUT_OFF, EXTRA, NEAR, SAME, SAME_SPEED
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial


class TickPlanner:
    """Plans tick after tick.

    Args:
        robot: the robot.
        step: between nodes, s.
        horizon: s.
        weights: of the objective.
        limits: in force; ``set_limits`` changes them.

    Attributes:
        count: steps of a plan.
        ahead: what is in sight; set before the first tick.
        last: the last plan.
        sizes: of the first one; all are over them.
        largest: largest |τ| so far, N or N·m.

    Raises:
        CompilerError: there is no C compiler, or it fails.
    """

    ahead: Ahead

    def __init__(self, robot: Robot, step: float, horizon: float, weights: Weights, limits: ResolvedLimits) -> None:
        self.robot, self.step = robot, step
        steps = round(horizon / step)
        self.count = min(steps, NEAR) + max(steps - NEAR, 0) // 2 + EXTRA
        self.last: TickPlan | None = None
        self.sizes: TickScales | None = None
        self.largest = 0.0
        turning = bool(turning_velocities(robot)[robot.carrier_velocity].any())
        terms = (TURNING_TERMS if turning else SLIDING_TERMS)[-1] + 1
        sizes = {"N": robot.n, "M": robot.m, "K": robot.k, "TERMS": terms, "COUNT": self.count + 1}
        self._compiled = CompiledTick(tick_library(sizes), sizes, step, horizon, weights, limits)
        self.set_limits(limits)

    def set_limits(self, limits: ResolvedLimits) -> None:
        """Keep limits from the next tick on."""
        self.limits = limits
        self._cuts = bool(np.isfinite(limits.effort).any() or np.isfinite(limits.carrier_force).any())
        self._compiled.set_limits(limits)

    def tick(self, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan:
        """Return a plan from a time on, and keep it; ``t`` and ``until``, when the known motion ends, s.

        ``given``: (k,) s and ṡ of the carriers; None where those of the last plan are to be believed.

        Raises:
            InfeasiblePlanError: a first tick has no plan.
        """
        plan, last = self._planned(t, until, given, strict=False), self.last
        if plan is not None:
            return self._kept(t, plan)
        if last is None:
            raise InfeasiblePlanError(
                f"No plan was found at t = {t:.6g} s.", remedy="Start elsewhere, or widen the limits.", time=t
            )
        command = replace(
            last.command, t=t, status=UpdateStatus.FALLBACK, reason="the solver found none", solver_seconds=0.0
        )
        return self._kept(t, replace(last, command=command, left=np.inf))

    def within_limits(self, ahead: Ahead, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan | None:
        """Return a plan along what is ahead, and keep both; None where there is none that keeps every limit."""
        before, self.ahead, plan = self.ahead, ahead, None
        try:
            plan = self._planned(t, until, given, strict=True)
            if plan is not None and self.checked_between(t, plan.command).status is not UpdateStatus.OK:
                plan = None
        finally:  # a preview may raise, too
            if plan is None:
                self.ahead = before
        return None if plan is None else self._kept(t, plan)

    def _kept(self, t: float, plan: TickPlan) -> TickPlan:
        command = self.checked_between(t, plan.command)
        if command is not plan.command:
            plan = replace(plan, command=command)
        self.last, self.largest = plan, max(self.largest, plan.largest)
        return plan

    def _planned(self, t: float, until: float, given: tuple[Array | None, ...], *, strict: bool) -> TickPlan | None:
        self.ahead.look(t, until)
        last = self.last
        plan, self.sizes = self._compiled.plan(
            self.ahead, t, until, given, last, self.sizes, self.largest, strict=strict
        )
        return plan if plan is None or last is None else self.begun(plan, last.command)

    def begun(self, plan: TickPlan, last: Command) -> TickPlan:
        """Return a plan that has the last one's beginning where it starts at a singular instant after the tick."""
        command, start = plan.command, float(plan.nodes[0])
        if start <= command.t + SAME and command.efforts.start <= start + SAME:
            return plan
        parts = zip(
            (last.carriers, last.efforts, last.forces),
            (command.carriers, command.efforts, command.forces),
            strict=True,
        )
        carriers, efforts, forces = (begun_with(old, new, command.t, start) for old, new in parts)
        early = max(int(efforts.edges.searchsorted(start, "right")), 1)  # between them efforts are linear
        largest = max(plan.largest, float(np.abs(efforts.coefficients[-1, :early]).max()))
        return replace(
            plan, command=replace(command, carriers=carriers, efforts=efforts, forces=forces), largest=largest
        )

    def checked_between(self, t: float, command: Command) -> Command:
        """Return a command whose status and residual know of the limits up to the next node, which may not show them.

        Between nodes f and the carriers' forces may be larger than at them, above all where ẍ jumps: the efforts are
        cut off then, the forces are not. The programme does not bound the speed of the first half step, which is given.
        """
        if command.status is not UpdateStatus.OK:
            return command
        limits, end = self.limits, min(t + self.step, command.carriers.end)
        _, (sd,), (sdd,) = extended(command.carriers, np.array([t]))
        if (np.abs(sd) + 0.5 * self.step * np.abs(sdd) > limits.speed).any() and end > t:
            least, most = command.carriers.between(t, end).derivative().ranges()
            if (np.maximum(-least, most) > limits.speed * (1.0 + SAME_SPEED)).any():
                reason = "between the nodes a carrier exceeds its speed"
                return replace(command, status=UpdateStatus.RELAXED, reason=reason)
        if self.sizes is None or not self._cuts:
            return command
        ahead, end = self.ahead, command.known_until
        times = ahead.instants(np.array([t, end]), end) if end > t else np.array([t])
        times = times[times <= t + self.step + SAME]
        if (np.abs(command.forces(times)) > limits.carrier_force * (1.0 + LIMIT_TOLERANCE)).any():
            reason = "between the nodes a carrier exceeds its force"
            return replace(command, status=UpdateStatus.RELAXED, reason=reason)
        efforts = command.efforts(times)
        meets = (np.abs(efforts) >= limits.effort * (1.0 - 1e-12)).any(axis=1)
        if not meets.any():
            return command
        places, n = ahead.at(times[meets]), self.robot.n
        f = ahead.known.values(places, *extended(command.carriers, times[meets]))[:, :n]
        missing = np.abs(np.einsum("nij,nj->ni", ahead.known.W[places], efforts[meets]) - f) / ahead.row_scale
        residual = max(command.residual, float(missing.max()))
        if missing.max() <= CUT_OFF * float(self.sizes.row.max()):
            return replace(command, residual=residual)
        reason = "between the nodes the efforts meet their limits"
        return replace(command, status=UpdateStatus.RELAXED, reason=reason, residual=residual)


def begun_with(last: PiecewisePolynomial, new: PiecewisePolynomial, t: float, start: float) -> PiecewisePolynomial:
    """Return the new function with its beginning: to the singular instant where its plan starts it is the last one's.

    From there on efforts are linear up to the first instant at which W⁻¹ f is known: just behind a singular one it is
    not, and their value at the start, where s̈ is given, is that of the last plan.
    """
    before = [last.between(t, start)] if start > t + SAME else []
    if new.start > start + SAME:
        ends = np.array([start, new.start])
        before.append(PiecewisePolynomial.linear(ends, np.array([last.at(start), new.at(new.start)])))
    return PiecewisePolynomial.joined([*before, new]) if before else new
