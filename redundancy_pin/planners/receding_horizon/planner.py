"""One plan a tick over the path known ahead, from where the carriers are."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BPoly, PPoly

from redundancy_pin.arrays import Array, each, frozen, one_of, positive, require_type
from redundancy_pin.dynamics.base import Dynamics, require_dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.limits import Limits, ResolvedLimits, grouped
from redundancy_pin.planners.receding_horizon.ahead import FIRST, Ahead, Linearised, nodes_from
from redundancy_pin.planners.receding_horizon.ahead import NEAR as NEAR_STEPS
from redundancy_pin.planners.receding_horizon.command import GOALS, Command, Goal, PlanningStatus, Weights, extended
from redundancy_pin.planners.receding_horizon.preview import SAME, Preview, Source
from redundancy_pin.planners.receding_horizon.programme import BEYOND, Programme, TickProblem, TickScales, units_of
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

NEAR = 0.25
"""A singular instant nearer than this, in steps, is reached by the last plan; the new one begins there."""

SETTLED = 2.0
"""Steps before a singular instant in which a plan begins where the last one is, and not where the carriers are."""

EXTRA = 8
"""Nodes beyond those of even steps, for the finer ones around singular instants."""

CONVERGED = 2.5
"""Steps before a singular instant in which a tick has several rounds: W⁻¹ magnifies what is left of uᵀ f there."""

EXACT = 1e-6
"""Fraction of f that may be left."""

CUT_OFF = 1e-3
"""Fraction of f that limits of the efforts may cut off between the nodes of a plan that keeps every limit."""

MOST_ROUNDS = 8

STUCK = 0.1
"""Fraction of f that a plan may miss, f being linear in its programme, and still be preferred to an elastic one."""

SLOW = 0.99
"""An elastic programme that is left with more than this fraction of what the one before was is as near as it comes."""

LINEAR = 1e-2
"""Fraction of f by which a plan may miss W τ = f at a node, f being linear in its programme: else it has one more."""

ASIDE = 0.6
"""Fraction of half the tracks out to which other motions to begin with go."""

SHORTEST_STOP = 1e-6
"""s; a carrier that stops sooner stands."""

REGULAR = 1e-3
"""Smallest over largest singular value of W from which W⁻¹ f is the effort; nearer to a pose it magnifies rounding."""

SMALLEST = 0.05
"""Efforts count as of size one from this fraction of those of parked carriers."""

FIRST_ROUNDS = 3
"""Programmes of the first tick, each about the plan of the one before."""


@dataclass(frozen=True, eq=False)
class _Round:
    """A plan, and what the next one begins with.

    ``nodes`` (N,) s; ``at``: s, ṡ and s̈ (N, k) there; ``multipliers`` (N, n) of W τ = f there; ``left``: by which
    fraction of f that is missed at most.
    """

    command: Command
    nodes: Array
    at: tuple[Array, ...]
    multipliers: Array
    left: float

    @property
    def doubt(self) -> float:
        """What is left; not less than a bit where a limit kept the programme from an answer: it may come no nearer."""
        return self.left if self.command.status is PlanningStatus.PLANNED else max(self.left, STUCK)

    def halfway(self, other: _Round) -> _Round:
        """Return another of the same nodes, of which the next one begins with the mean of both."""
        at = tuple(0.5 * (own + their) for own, their in zip(self.at, other.at, strict=True))
        return replace(other, at=at, multipliers=0.5 * (self.multipliers + other.multipliers))


class RecedingHorizon:
    """Plans the carriers and the efforts again and again, over the path known for a short time ahead.

    Each tick solves a convex quadratic programme: s, ṡ, s̈ and τ at nodes 20 ms apart, from a fifth of a second on 40,
    fixed in time, with s̈ linear in between, W τ = f linear about the last plan, its curvature in the cost as far as
    that is convex, and the limits of the carriers between the nodes too. Where that is too far off it solves others.
    W⁻¹ is not formed: type II singularities ahead become nodes with what makes τ finite and continuous there
    (``ahead``). At the end of the horizon the carriers can still stop on their tracks, so there always is a motion
    within their limits.

    Args:
        dynamics: a backend; ``CompiledDynamics`` is the fastest by far.
        horizon: how far ahead it plans, s.
        step: between nodes, s; half of it around singular instants.
        objective: "peak" max |τ| over the horizon, beside the mean square, or "effort", that alone; or ``Weights``.
        track, speed, acceleration, jerk, effort, carrier_force: limits as of ``plan_whole_trajectory``.
        limits: these as one group.

    Attributes:
        limits: in force from the next tick on; may be set between ticks. ``resolved`` has them as arrays.
        largest: largest |τ| so far, N or N·m.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: no carriers.
        RedundancyPinError: the solver is not installed.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        horizon: float = 0.5,
        step: float = 0.02,
        objective: Goal | Weights = "peak",
        track: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        jerk: ArrayLike | None = None,
        effort: ArrayLike | None = None,
        carrier_force: ArrayLike | None = None,
        limits: Limits | None = None,
    ) -> None:
        require_dynamics(dynamics)
        robot = dynamics.robot
        require_carriers(robot)
        if not isinstance(objective, Weights):
            one_of(objective, "objective", GOALS)
        self.dynamics, self.robot = dynamics, robot
        self.step, self.horizon = positive(step, "step", "s"), positive(horizon, "horizon", "s")
        if not 2.0 * step <= horizon <= 200.0 * step:
            raise InputError(
                f"The horizon of {horizon:g} s has {horizon / step:g} steps of {step:g} s.", remedy="Have 2 to 200."
            )
        self.weights = objective if isinstance(objective, Weights) else GOALS[objective]
        flat = {"track": track, "speed": speed, "acceleration": acceleration}
        flat |= {"jerk": jerk, "effort": effort, "carrier_force": carrier_force}
        steps = round(horizon / step)
        self._count = min(steps, NEAR_STEPS) + max(steps - NEAR_STEPS, 0) // 2 + EXTRA
        self._bounded = (False, False)
        self._programmes: dict[bool, Programme] = {}
        self.limits = grouped("limits", limits, Limits, **flat)
        self._source: object = None
        self._ahead: Ahead
        self._last: _Round | None = None
        self._guesses = 0
        self._sizes: TickScales | None = None
        self.largest = 0.0

    @property
    def started(self) -> bool:
        """Whether there is a plan."""
        return self._last is not None

    @property
    def limits(self) -> Limits:
        """Limits as they were given."""
        return self._given_limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        require_type(limits, Limits, "The limits of a planner", "Pass Limits(track=..., speed=..., ...).")
        self._given_limits, self.resolved = limits, limits.resolved(self.robot)
        jerk, force = (bool(np.isfinite(part).any()) for part in (self.resolved.jerk, self.resolved.carrier_force))
        if self._bounded != (jerk, force):
            self._bounded = (jerk, force)
            self._programmes.clear()

    def programme(self, elastic: bool) -> Programme:
        """Return the programme of a tick, which is put together once."""
        if elastic not in self._programmes:
            robot = self.robot
            self._programmes[elastic] = Programme(robot.n, robot.m, robot.k, self._count, self.resolved, elastic)
        return self._programmes[elastic]

    def update(self, t: float, preview: Source, s: ArrayLike | None = None, sd: ArrayLike | None = None) -> Command:
        """Return what to do from a time on.

        Args:
            t: the tick, s; not before the one before.
            preview: the platform's motion ahead; a trajectory or samples that are passed again are read once.
            s: scalar or (k,) where the carriers are, m; where the last plan has them when left out, at first 0. Within
                two steps of a singular instant the last plan goes on all the same.
            sd: the same for their speeds, m/s.

        Raises:
            InputError: values that are not finite, a preview that is none, a time before the last one.
            InfeasiblePlanError: no plan at the first tick, with none before it to go on with.
        """
        began = time.perf_counter()
        if preview is not self._source:
            self._ahead, self._source = Ahead(self.dynamics, Preview.of(preview), self.step), preview
        t, known = self._tick(t), self._ahead.preview
        if t < known.start - SAME:
            raise InputError(
                f"The tick is at t = {t:.6g} s, and the preview begins at {known.start:.6g} s.",
                remedy="Pass what is known of the motion from the tick on.",
            )
        given = tuple(
            None if part is None else each(part, name, (self.robot.k,), finite=True)
            for part, name in ((s, "s"), (sd, "sd"))
        )
        last, until = self._last, min(t + self.horizon, known.end)
        self._ahead.look(t, until)
        plan = self._rounds(t, until, given, last)
        if last is not None and plan.command.status is PlanningStatus.ELASTIC:
            # it may be stuck where W τ = f is missed least nearby
            another = self._rounds(t, until, given, self._guess(t, until, last))
            if another.doubt < plan.doubt:
                plan = another
        command = plan.command
        if command.status is PlanningStatus.PLANNED:
            command = self._checked_between(t, command)
        command = replace(command, seconds=time.perf_counter() - began)
        self._last = replace(plan, command=command)
        self.largest = max(self.largest, float(np.abs(command.efforts(np.linspace(t, t + self.step, 5))).max()))
        return command

    def _rounds(self, t: float, until: float, given: tuple[Array | None, ...], about: _Round | None) -> _Round:
        """Return a plan after as many programmes as it takes, each linear about the plan of the one before."""
        best = plan = self._plan(t, until, given, about)
        for done in range(1, MOST_ROUNDS):
            if done >= (FIRST_ROUNDS if about is None else 1) and self._is_settled(t, best):
                break
            another = self._plan(t, until, given, plan)
            if another.doubt > max(best.doubt, LINEAR):  # too far: f is linear nearer to the best so far
                plan = best.halfway(another)
                continue
            stuck = another.doubt > SLOW * best.doubt and another.command.status is PlanningStatus.ELASTIC
            best = plan = another
            if stuck:
                break
        if best.command.status is PlanningStatus.PLANNED and best.left > STUCK:
            reason = f"ahead {best.left:.0%} of the force is missing"
            best = replace(best, command=replace(best.command, status=PlanningStatus.ELASTIC, reason=reason))
        return best

    def _guess(self, t: float, until: float, last: _Round) -> _Round:
        """Return a motion to begin with, each time another one: to rest nearby, in the middle, towards a corner."""
        s, sd, sdd = last.command.motion_at(t)
        track, bound = self.resolved.track, np.isfinite(self.resolved.track).all(axis=1)
        middle, half = np.where(bound, track.mean(axis=1), s), np.where(bound, 0.5 * np.diff(track)[:, 0], 0.0)
        nearby = s + 0.5 * sd * np.abs(sd) / self.resolved.acceleration
        corners = [middle + np.copysign(ASIDE * half, side) for side in product((-1, 1), repeat=self.robot.k)]
        targets = [nearby, middle, *corners]
        target = targets[self._guesses % len(targets)]
        self._guesses += 1
        curve = BPoly.from_derivatives([t, until], [[s, sd, sdd], [target, np.zeros_like(s), np.zeros_like(s)]])
        carriers = PiecewisePolynomial(curve.x, PPoly.from_bernstein_basis(curve).c)
        multipliers = np.zeros_like(last.multipliers)
        return replace(last, command=replace(last.command, carriers=carriers), multipliers=multipliers)

    def _checked_between(self, t: float, command: Command) -> Command:
        """Return a command whose status and residual know of what the efforts' limits cut off up to the next node.

        Between nodes f may be larger than at them, above all where ẍ jumps.
        """
        if not (self._sizes and np.isfinite(self.resolved.effort).any()):
            return command
        ahead, end = self._ahead, command.known_until
        times = ahead.instants(np.array([t, end]), end) if end > t else np.array([t])
        times = times[times <= t + self.step + SAME]
        efforts = command.efforts(times)
        meets = (np.abs(efforts) >= self.resolved.effort * (1.0 - 1e-12)).any(axis=1)
        if not meets.any():
            return command
        places, n = ahead.at(times[meets]), self.robot.n
        f = ahead.known.values(places, *extended(command.carriers, times[meets]))[:, :n]
        missing = np.abs(np.einsum("nij,nj->ni", ahead.known.W[places], efforts[meets]) - f) / ahead.row_scale
        residual = max(command.residual, float(missing.max()))
        if missing.max() <= CUT_OFF * float(self._sizes.row.max()):
            return replace(command, residual=residual)
        reason = "between the nodes the efforts meet their limits"
        return replace(command, status=PlanningStatus.ELASTIC, reason=reason, residual=residual)

    def skip(self, t: float) -> Command:
        """Return what to do where a tick is missed: the last plan goes on, to its end and to the stop behind it.

        Raises:
            InputError: there is no plan yet.
        """
        if self._last is None:
            raise InputError("There is no plan to go on with.", remedy="Call update first.")
        return replace(
            self._last.command, t=self._tick(t), status=PlanningStatus.FALLBACK, reason="the tick was missed"
        )

    def _tick(self, t: float) -> float:
        """Return the time of a tick, s, after checking that it goes on from the last one."""
        t = float(each(t, "t", (1,), finite=True)[0])
        if self._last is not None and t < self._last.command.t:
            raise InputError(
                f"The tick is at t = {t:.6g} s, after one at {self._last.command.t:.6g} s.", remedy="Go on in time."
            )
        return t

    def _is_settled(self, t: float, plan: _Round) -> bool:
        """Return whether another round would bring nothing."""
        command = plan.command
        if command.status is not PlanningStatus.PLANNED:
            return command.status is not PlanningStatus.ELASTIC
        roots = command.singular
        near = bool(((roots > t) & (roots < t + CONVERGED * self.step)).any())
        exact = self._sizes is None or command.residual <= EXACT * float(self._sizes.row.max())
        return plan.left <= LINEAR and (exact or not near)

    def _plan(self, t: float, until: float, given: tuple[Array | None, ...], about: _Round | None) -> _Round:
        """Return a plan that goes on from the last one, with f linear about that or that of the round before."""
        last = self._last.command if self._last is not None else None
        step, k, ahead = self.step, self.robot.k, self._ahead
        coming = ahead.roots[ahead.roots > t - SAME]
        near = len(coming) and coming[0] <= t + NEAR * step and last is not None
        start = float(coming[0]) if near else t
        # the nodes around a singular instant stay when it is past
        nodes, singular = nodes_from(start, step, self._count + 1, ahead.roots)
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
        if self._sizes is None:
            self._sizes = TickScales.of(lin)
        sizes = self._sizes
        if last is not None:  # of all rounds the same, or the second would be off to another plan
            share = min(max(last.peak / sizes.tau, SMALLEST), 1.0)
            sizes = TickScales(share * sizes.tau, sizes.row)
        jerk = None
        if last is not None:
            piece = max(int(np.searchsorted(last.carriers.edges, nodes[0])) - 1, 0)
            jerk = 6.0 * last.carriers.coefficients[-4, min(piece, len(last.carriers.edges) - 2)]
        problem = TickProblem(
            lin,
            self.resolved,
            self.weights,
            sizes,
            first,
            last is None,
            jerk,
            step,
            self.horizon,
            self.largest,
        )
        return self._command(problem, t, last, coming)

    def _command(self, problem: TickProblem, t: float, last: Command | None, roots: Array) -> _Round:
        """Return what to do from t, s, on; the last command where the programme has no solution.

        Raises:
            InfeasiblePlanError: nor is there a last one.
        """
        lin, (s, sd, _) = problem.lin, problem.first
        began, status, reason = time.perf_counter(), PlanningStatus.PLANNED, ""
        solution = None if is_beyond(self.resolved, s, sd) else self.programme(False).solve(problem)
        if solution is None:
            solution = self.programme(True).solve(problem)
            status, reason = PlanningStatus.ELASTIC, "no plan keeps every limit"
        seconds = time.perf_counter() - began
        if solution is None:
            if last is None or self._last is None:
                raise InfeasiblePlanError(
                    f"No plan was found at t = {t:.6g} s.", remedy="Start elsewhere, or widen the limits.", time=t
                )
            reason = "the solver found none"
            command = replace(last, t=t, status=PlanningStatus.FALLBACK, reason=reason, solver_seconds=seconds)
            return replace(self._last, command=command, left=np.inf)
        (x, multipliers), programme = solution, self.programme(status is PlanningStatus.ELASTIC)
        a = x[programme.sdd] * units_of(self.resolved)[2]
        h, none = np.diff(lin.nodes)[:, None], np.zeros_like(a[:1])
        # integrated once more: the solver's own are off by its tolerance
        speeds = sd + np.concatenate([none, np.cumsum(0.5 * h * (a[:-1] + a[1:]), axis=0)])
        moved = np.cumsum(h * speeds[:-1] + h**2 / 6.0 * (2.0 * a[:-1] + a[1:]), axis=0)
        places = s + np.concatenate([none, moved])
        carriers = with_stop(self.resolved.acceleration, lin.nodes, places, speeds, a)
        tau, counts = x[programme.tau] * problem.sizes.tau, problem.counts
        efforts, forces, residual, peak = self._efforts(problem, carriers, tau)
        f = self._ahead.known.values(self._ahead.at(lin.nodes[counts]), places[counts], speeds[counts], a[counts])
        missed = np.einsum("nij,nj->ni", lin.W[counts], tau[counts]) - f[:, : self.robot.n]
        left = float(np.abs(missed / problem.sizes.row).max(initial=0.0))
        if last is not None:
            parts = zip((last.carriers, last.efforts, last.forces), (carriers, efforts, forces), strict=True)
            carriers, efforts, forces = (begun_with(old, new, t, float(lin.nodes[0])) for old, new in parts)
        unknown = np.flatnonzero(~lin.known)
        known_until = float(lin.nodes[max(unknown[0] - 1, 0)]) if len(unknown) else float(lin.nodes[-1])
        if len(unknown) and lin.nodes[unknown[0]] <= lin.until + SAME:
            status = PlanningStatus.REFUSED
            reason = f"at t = {lin.nodes[unknown[0]]:.6g} s the preview leads where the machine cannot go"
        command = Command(
            t, status, reason, carriers, efforts, forces, residual, peak, frozen(roots), known_until, 0.0, seconds
        )
        return _Round(command, lin.nodes, (places, speeds, a), multipliers, left)

    def _efforts(
        self, problem: TickProblem, carriers: PiecewisePolynomial, tau: Array
    ) -> tuple[PiecewisePolynomial, PiecewisePolynomial, float, float]:
        """Return efforts and carriers' forces as functions of time, the residual at the nodes, the largest effort."""
        ahead, lin, n = self._ahead, problem.lin, self.robot.n
        counts = problem.counts
        early = FIRST + 1
        t = ahead.instants(lin.nodes[:early], lin.until)
        places = ahead.at(np.minimum(t, lin.until))
        coefficients = ahead.known
        value = coefficients.values(places, *extended(carriers, t))
        W, f, forces = coefficients.W[places], value[:, :n], PiecewisePolynomial.linear(t, value[:, n:])
        at_node = np.searchsorted(t, lin.nodes[:early] - SAME).clip(0, len(t) - 1)
        left = np.einsum("nij,nj->ni", lin.W[:early], tau[:early]) - f[at_node]
        residual = float(np.abs(left[counts[:early]] / lin.row_scale).max(initial=0.0))
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
        most = self.resolved.effort
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
