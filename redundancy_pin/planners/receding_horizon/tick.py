"""One tick: programmes about the last plan until W τ = f is met, and what becomes of their solutions."""

from __future__ import annotations

import time
import warnings
from contextlib import suppress
from dataclasses import replace
from itertools import product

import numpy as np
from scipy.interpolate import BPoly, PPoly

from redundancy_pin.arrays import Array, frozen
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_model import SLIDING_TERMS, TURNING_TERMS
from redundancy_pin.planners.limits import LIMIT_TOLERANCE, ResolvedLimits
from redundancy_pin.planners.receding_horizon import ahead as sight
from redundancy_pin.planners.receding_horizon import programme as programmes
from redundancy_pin.planners.receding_horizon.ahead import FIRST, SOON, Ahead, Linearised, nodes_from
from redundancy_pin.planners.receding_horizon.ahead import NEAR as NEAR_STEPS
from redundancy_pin.planners.receding_horizon.command import STUCK, Command, TickPlan, Weights, extended
from redundancy_pin.planners.receding_horizon.compiled import CompiledTick, tick_library
from redundancy_pin.planners.receding_horizon.preview import SAME, place_of
from redundancy_pin.planners.receding_horizon.programme import BEYOND, Programme, TickProblem, TickScales, units_of
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

NEAR = 0.25
"""A singular instant nearer than this, in steps, is reached by the last plan; the new one begins there."""

SETTLED = 2.0
"""Steps before a singular instant in which a plan begins where the last one is, and not where the carriers are."""

EXTRA = 8
"""Nodes beyond those of even steps, for the finer ones around singular instants and turns."""

CONVERGED = 2.5
"""Steps before a singular instant in which a tick has several rounds: W⁻¹ magnifies what is left of uᵀ f there."""

EXACT = 1e-6
"""Fraction of f that may be left."""

CUT_OFF = 1e-3
"""Fraction of f that limits of the efforts may cut off between the nodes of a plan that keeps every limit."""

MOST_ROUNDS = 8

SAME_SPEED = 1e-8
"""By this fraction a speed may be beyond its limit, which a plan meets but for rounding."""

SLOW = 0.99
"""An elastic programme that is left with more than this fraction of what the one before was is as near as it comes."""

LINEAR = 1e-2
"""Fraction of f by which a plan may miss W τ = f at a node, f being linear in its programme: else it has one more."""

ASIDE = 0.6
"""Fraction of half the tracks out to which other motions to begin with go."""

SHORTEST_STOP = 1e-9
"""s; a carrier that stops sooner stands."""

REGULAR = 1e-3
"""Smallest over largest singular value of W from which W⁻¹ f is the effort; nearer to a pose it magnifies rounding."""

SMALLEST = 0.1
"""Efforts count as of size one from this fraction of those of parked carriers."""

FIRST_ROUNDS = 3
"""Programmes of the first tick, each about the plan of the one before."""

_SIGHT = "FIRST", "BESIDE", "DIFFERENCE", "ZONE", "SHARP_ZONE", "MOST_SHARP", "NEAR", "SOON"

CONSTANTS = {
    **{name: getattr(sight, name) for name in _SIGHT},
    **{name: getattr(programmes, name) for name in ("CLOSER", "IN_HAND", "FORCE_KEPT", "BEYOND")},
    "APART_SINGULAR": sight.APART[0],
    "APART_OTHER": sight.APART[1],
    "NEAR_ROOT": NEAR,
    "SAME": SAME,
    "SETTLED": SETTLED,
    "CONVERGED": CONVERGED,
    "EXACT": EXACT,
    "MOST_ROUNDS": MOST_ROUNDS,
    "STUCK": STUCK,
    "LINEAR": LINEAR,
    "SHORTEST_STOP": SHORTEST_STOP,
    "REGULAR": REGULAR,
    "SMALLEST": SMALLEST,
}
"""What machine code is told of all these, by its names."""


class TickPlanner:
    """Plans tick after tick: in machine code, or in Python where there is none, or where that has no answer.

    Args:
        robot: the robot.
        step: between nodes, s.
        horizon: s.
        weights: of the objective.
        limits: in force; ``set_limits`` changes them.
        interpret: no machine code.

    Attributes:
        count: steps of a plan.
        ahead: what is in sight; set before the first tick.
        last: the last plan.
        sizes: of the first one; all are over them.
        largest: largest |τ| so far, N or N·m.
        compiled: machine code, once it is known how many terms f has.
    """

    ahead: Ahead

    def __init__(
        self, robot: Robot, step: float, horizon: float, weights: Weights, limits: ResolvedLimits, *, interpret: bool
    ) -> None:
        self.robot, self.step, self.horizon, self.weights = robot, step, horizon, weights
        steps = round(horizon / step)
        self.count = min(steps, NEAR_STEPS) + max(steps - NEAR_STEPS, 0) // 2 + EXTRA
        self._programmes: dict[bool, Programme] = {}
        self._bounded = (False, False)
        self.last: TickPlan | None = None
        self.sizes: TickScales | None = None
        self.largest = 0.0
        self._guesses = 0
        self.compiled: CompiledTick | None = None
        if not interpret and robot.m >= robot.n:
            turning = bool(turning_velocities(robot)[robot.carrier_velocity].any())
            terms = (TURNING_TERMS if turning else SLIDING_TERMS)[-1] + 1
            sizes = {"N": robot.n, "M": robot.m, "K": robot.k, "TERMS": terms, "COUNT": self.count + 1}
            library, reason = tick_library(sizes, CONSTANTS)
            if library is None:
                told = f"Ticks of {robot.name} are planned in Python, not in machine code: {reason}."
                warnings.warn(told, RuntimeWarning, stacklevel=3)
            else:
                self.compiled = CompiledTick(library, sizes, CONSTANTS, step, horizon, weights, limits)
        self.set_limits(limits)

    def set_limits(self, limits: ResolvedLimits) -> None:
        """Keep limits from the next tick on."""
        jerk, force, effort = (
            bool(np.isfinite(part).any()) for part in (limits.jerk, limits.carrier_force, limits.effort)
        )
        self.limits, self._cuts = limits, effort or force
        if self._bounded != (jerk, force):
            self._bounded = (jerk, force)
            self._programmes.clear()
        if self.compiled is not None:
            self.compiled.set_limits(limits)

    def tick(self, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan:
        """Return a plan from a time on, and keep it; ``t`` and ``until``, when the known motion ends, s.

        ``given``: (k,) s and ṡ of the carriers; None where those of the last plan are to be believed.
        """
        self.ahead.look(t, until)
        plan = self._compiled(t, until, given)
        return self._kept(t, self.interpreted(t, until, given) if plan is None else plan)

    def within_limits(self, ahead: Ahead, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan | None:
        """Return a plan along what is ahead, and keep both; None where there is none that keeps every limit."""
        before, self.ahead, plan = self.ahead, ahead, None
        try:
            plan = self._within_limits(t, until, given)
        finally:  # a preview may raise, too
            if plan is None:
                self.ahead = before
        return None if plan is None else self._kept(t, plan)

    def _within_limits(self, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan | None:
        self.ahead.look(t, until)
        plan: TickPlan | None = None
        if self.compiled is None or self.last is None:
            with suppress(InfeasiblePlanError):  # as of a first tick without any plan
                plan = self.rounds(t, until, given, self.last)
        else:
            plan = self._compiled(t, until, given)
        if plan is None or self.checked_between(t, plan.command).status is not UpdateStatus.OK:
            return None
        return plan

    def _kept(self, t: float, plan: TickPlan) -> TickPlan:
        command = self.checked_between(t, plan.command)
        if command is not plan.command:
            plan = replace(plan, command=command)
        self.last, self.largest = plan, max(self.largest, plan.largest)
        return plan

    def _compiled(self, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan | None:
        """Return a plan by machine code, or None: of the first tick, and where none keeps every limit."""
        last = self.last
        if self.compiled is None or last is None or self.sizes is None or len(last.command.carriers.coefficients) != 4:
            return None
        plan = self.compiled.plan(self.ahead, t, until, given, last, self.sizes, self.largest)
        return None if plan is None else self.begun(plan, last.command)

    def interpreted(self, t: float, until: float, given: tuple[Array | None, ...]) -> TickPlan:
        """Return a plan by programmes of numpy."""
        last = self.last
        plan = self.rounds(t, until, given, last)
        if last is not None and plan.command.status is UpdateStatus.RELAXED:
            # it may be stuck where W τ = f is missed least nearby
            another = self.rounds(t, until, given, self.guess(t, until, last))
            if another.doubt < plan.doubt:
                plan = another
        return plan

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

    def programme(self, elastic: bool) -> Programme:
        """Return the programme of a tick, which is put together once."""
        if elastic not in self._programmes:
            robot = self.robot
            self._programmes[elastic] = Programme(robot.n, robot.m, robot.k, self.count, self.limits, elastic)
        return self._programmes[elastic]

    def rounds(self, t: float, until: float, given: tuple[Array | None, ...], about: TickPlan | None) -> TickPlan:
        """Return a plan after as many programmes as it takes, each linear about the plan of the one before."""
        best = plan = self.plan(t, until, given, about)
        for done in range(1, MOST_ROUNDS):
            if done >= (FIRST_ROUNDS if about is None else 1) and self.is_settled(t, best):
                break
            another = self.plan(t, until, given, plan)
            if another.doubt > max(best.doubt, LINEAR):  # too far: f is linear nearer to the best so far
                plan = best.halfway(another)
                continue
            stuck = another.doubt > SLOW * best.doubt and another.command.status is UpdateStatus.RELAXED
            best = plan = another
            if stuck:
                break
        if best.command.status is UpdateStatus.OK and best.left > STUCK:
            reason = f"ahead {best.left:.0%} of the force is missing"
            best = replace(best, command=replace(best.command, status=UpdateStatus.RELAXED, reason=reason))
        return best

    def guess(self, t: float, until: float, last: TickPlan) -> TickPlan:
        """Return a motion to begin with, each time another one: to rest nearby, in the middle, towards a corner."""
        s, sd, sdd = last.command.motion_at(t)
        track, bound = self.limits.track, np.isfinite(self.limits.track).all(axis=1)
        track = np.where(np.expand_dims(bound, 1), track, s[:, None])
        middle, half = track.mean(axis=1), 0.5 * np.diff(track)[:, 0]
        nearby = s + 0.5 * sd * np.abs(sd) / self.limits.acceleration
        corners = [middle + np.copysign(ASIDE * half, side) for side in product((-1, 1), repeat=self.robot.k)]
        targets = [nearby, middle, *corners]
        target = targets[self._guesses % len(targets)]
        self._guesses += 1
        curve = BPoly.from_derivatives([t, until], [[s, sd, sdd], [target, np.zeros_like(s), np.zeros_like(s)]])
        carriers = PiecewisePolynomial(curve.x, PPoly.from_bernstein_basis(curve).c)
        multipliers = np.zeros_like(last.multipliers)
        return replace(last, command=replace(last.command, carriers=carriers), multipliers=multipliers)

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
        if not (self.sizes and self._cuts):
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

    def is_settled(self, t: float, plan: TickPlan) -> bool:
        """Return whether another round would bring nothing."""
        command = plan.command
        if command.status is not UpdateStatus.OK:
            return command.status is not UpdateStatus.RELAXED
        roots = command.singular
        near = bool(((roots > t) & (roots < t + CONVERGED * self.step)).any())
        exact = self.sizes is None or command.residual <= EXACT * float(self.sizes.row.max())
        return plan.left <= LINEAR and (exact or not near)

    def plan(self, t: float, until: float, given: tuple[Array | None, ...], about: TickPlan | None) -> TickPlan:
        """Return a plan that goes on from the last one, with f linear about that or that of the round before."""
        last = self.last.command if self.last is not None else None
        step, k, ahead = self.step, self.robot.k, self.ahead
        coming = ahead.roots[ahead.roots > t - SAME]
        near = len(coming) and coming[0] <= t + NEAR * step and last is not None
        start = float(coming[0]) if near else t
        # the nodes around a singular instant stay when it is past
        nodes, singular = nodes_from(start, step, self.count + 1, ahead.roots, ahead.sharp)
        if last is None:
            s, sd = (np.zeros(k) if part is None else part for part in given)
            first = s, sd, np.zeros(k)
        else:
            own = extended(last.carriers, nodes[:1])
            settled = len(coming) and coming[0] <= t + SETTLED * step
            pairs = zip(given, (own[0][0], own[1][0]), strict=True)
            s, sd = (planned if part is None or settled else part for part, planned in pairs)
            first = s, sd, own[2][0]
        multipliers = np.zeros((len(nodes), self.robot.n))
        if about is None:
            at = tuple(np.tile(part, (len(nodes), 1)) for part in first)
        else:
            own_round = about.command.t == t and np.array_equal(about.nodes, nodes)
            at = about.at if own_round else extended(about.command.carriers, nodes)
            places = np.searchsorted(about.nodes, nodes - SAME).clip(max=len(about.nodes) - 1)
            same = np.abs(about.nodes[places] - nodes) <= SAME
            multipliers[same] = about.multipliers[places[same]]
        lin = Linearised.about(ahead, nodes, singular, at, multipliers, until)
        if self.sizes is None:
            self.sizes = TickScales.of(lin)
        sizes = self.sizes
        if last is not None:  # of all rounds the same, or the second would be off to another plan
            share = min(max(last.peak / sizes.tau, SMALLEST), 1.0)
            sizes = TickScales(share * sizes.tau, sizes.row)
        jerk = None
        if last is not None:
            piece = max(int(np.searchsorted(last.carriers.edges, nodes[0])) - 1, 0)
            jerk = 6.0 * last.carriers.coefficients[-4, min(piece, len(last.carriers.edges) - 2)]
        problem = TickProblem(
            lin,
            self.limits,
            self.weights,
            sizes,
            first,
            last is None,
            jerk,
            step,
            self.horizon,
            self.largest,
        )
        return self.command(problem, t, last, coming)

    def command(self, problem: TickProblem, t: float, last: Command | None, roots: Array) -> TickPlan:
        """Return what to do from t, s, on; the last command where the programme has no solution.

        Raises:
            InfeasiblePlanError: nor is there a last one.
        """
        lin, (s, sd, _) = problem.lin, problem.first
        began, status, reason = time.perf_counter(), UpdateStatus.OK, ""
        solution = None if is_beyond(self.limits, s, sd) else self.programme(False).solve(problem)
        if solution is None:
            solution = self.programme(True).solve(problem)
            status, reason = UpdateStatus.RELAXED, "no plan keeps every limit"
        seconds = time.perf_counter() - began
        if solution is None:
            if last is None or self.last is None:
                raise InfeasiblePlanError(
                    f"No plan was found at t = {t:.6g} s.", remedy="Start elsewhere, or widen the limits.", time=t
                )
            reason = "the solver found none"
            command = replace(last, t=t, status=UpdateStatus.FALLBACK, reason=reason, solver_seconds=seconds)
            return replace(self.last, command=command, left=np.inf)
        (x, multipliers), programme = solution, self.programme(status is UpdateStatus.RELAXED)
        a = x[programme.sdd] * units_of(self.limits)[2]
        h, none = np.diff(lin.nodes)[:, None], np.zeros_like(a[:1])
        # integrated once more: the solver's own are off by its tolerance
        speeds = sd + np.concatenate([none, np.cumsum(0.5 * h * (a[:-1] + a[1:]), axis=0)])
        moved = np.cumsum(h * speeds[:-1] + h**2 / 6.0 * (2.0 * a[:-1] + a[1:]), axis=0)
        places = s + np.concatenate([none, moved])
        carriers = with_stop(self.limits.acceleration, lin.nodes, places, speeds, a)
        tau, counts = x[programme.tau] * problem.sizes.tau, problem.counts
        efforts, forces, residual, peak = self.efforts(problem, carriers, tau)
        at = self.ahead.at(lin.nodes[counts])
        f = self.ahead.known.values(at, places[counts], speeds[counts], a[counts])
        missed = np.einsum("nij,nj->ni", lin.W[counts], tau[counts]) - f[:, : self.robot.n]
        left = float(np.abs(missed / problem.sizes.row).max(initial=0.0))
        unknown = np.flatnonzero(~lin.known)
        known_until = float(lin.nodes[max(unknown[0] - 1, 0)]) if len(unknown) else float(lin.nodes[-1])
        if len(unknown) and lin.nodes[unknown[0]] <= lin.until + SAME:
            status = UpdateStatus.REFUSED
            where = place_of(self.ahead.preview.states(lin.nodes[unknown[:1]])[0][0])
            reason = f"at t = {lin.nodes[unknown[0]]:.6g} s the preview leads where the machine cannot go, to {where}"
        command = Command(
            t, status, reason, carriers, efforts, forces, residual, peak, frozen(roots), known_until, 0.0, seconds
        )
        largest = float(np.abs(efforts(np.linspace(t, t + self.step, 5))).max())
        plan = TickPlan(command, lin.nodes, (places, speeds, a), multipliers, left, largest)
        return plan if last is None else self.begun(plan, last)

    def efforts(
        self, problem: TickProblem, carriers: PiecewisePolynomial, tau: Array
    ) -> tuple[PiecewisePolynomial, PiecewisePolynomial, float, float]:
        """Return efforts and carriers' forces as functions of time, the residual at the nodes, the largest effort."""
        ahead, lin, n = self.ahead, problem.lin, self.robot.n
        counts = problem.counts
        # a clock that is early leaves out a node that is too near (``SOON``), and the others are that much later
        early = int((lin.nodes <= lin.nodes[0] + (FIRST + SOON) * self.step + SAME).sum())
        t = ahead.instants(lin.nodes[:early], lin.until)
        places = ahead.at(np.minimum(t, lin.until))
        coefficients = ahead.known
        value = coefficients.values(places, *extended(carriers, t))
        W, f, force = coefficients.W[places], value[:, :n], value[:, n:]
        if len(t) == 1:  # nothing more is known
            forces = PiecewisePolynomial.linear(np.append(t, t + self.step), np.repeat(force, 2, axis=0))
        else:
            forces = PiecewisePolynomial.linear(t, force)
        at_node = np.searchsorted(t, lin.nodes[:early] - SAME).clip(0, len(t) - 1)
        left = np.einsum("nij,nj->ni", lin.W[:early], tau[:early]) - f[at_node]
        looked_at = slice(min(early, FIRST + 1))  # of finer nodes as many
        residual = float(np.abs(left[looked_at][counts[looked_at]] / lin.row_scale).max(initial=0.0))
        singular_values = np.linalg.svd(W / lin.row_scale[:, None], compute_uv=False)
        fine = singular_values[:, -1] > REGULAR * singular_values[:, 0]
        peak = float(np.abs(tau[counts]).max(initial=0.0))
        if self.robot.m == n:
            own = np.linalg.solve(W[fine], f[fine][:, :, None])[:, :, 0]
        else:
            if not counts[0]:  # the start decides the efforts there, but for the preload of redundant actuators
                tau = np.concatenate([tau[1:2], tau[1:]])
            planned = PiecewisePolynomial.linear(lin.nodes, tau)(t[fine])  # which these decide
            missing = f[fine] - np.einsum("nij,nj->ni", W[fine], planned)
            own = planned + np.einsum("nij,nj->ni", np.linalg.pinv(W[fine]), missing)
        rest = counts.copy()
        rest[:early] &= ~fine[at_node]
        times, values = np.append(t[fine], lin.nodes[rest]), np.concatenate([own, tau[rest]])
        if not len(times):
            times, values = lin.nodes[:1], tau[:1]
        order = np.argsort(times)
        times, values = times[order], values[order]
        if len(times) == 1:
            times, values = np.append(times, times + self.step), np.repeat(values, 2, axis=0)
        most = self.limits.effort
        return PiecewisePolynomial.linear(times, np.clip(values, -most, most)), forces, residual, peak


def is_beyond(limits: ResolvedLimits, s: Array, sd: Array) -> bool:
    """Return whether a start is beyond the limits by more than rounding: then no plan keeps them."""
    outside = (s < limits.track[:, 0] - BEYOND) | (s > limits.track[:, 1] + BEYOND)
    return bool((outside | (np.abs(sd) > limits.speed + BEYOND)).any())


def with_stop(acceleration: Array, nodes: Array, s: Array, sd: Array, sdd: Array) -> PiecewisePolynomial:
    """Return the carriers' motion, and a stop behind it: every carrier slows down as fast as it can, (k,) m/s²."""
    durations = np.abs(sd[-1]) / acceleration
    durations[durations < SHORTEST_STOP] = 0.0
    after = np.unique(np.append(0.0, durations))
    past = np.minimum(after[:, None], durations)
    a = -np.divide(sd[-1], durations, out=np.zeros_like(sd[-1]), where=durations > 0.0)
    slowing = after[:, None] < durations
    stop = s[-1] + past * sd[-1] + 0.5 * past**2 * a, (sd[-1] + past * a) * slowing, a * slowing
    jerk = np.append(np.diff(sdd, axis=0) / np.diff(nodes)[:, None], np.zeros_like(past), axis=0)
    whole = (np.append(own[:-1], behind, axis=0) for own, behind in zip((s, sd, sdd), stop, strict=True))
    return PiecewisePolynomial.taylor(np.append(nodes[:-1], nodes[-1] + after), *whole, jerk)


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
