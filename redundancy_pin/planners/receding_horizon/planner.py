"""One plan a tick over the path known ahead, from where the carriers are."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, each, frozen, one_of, positive, require_type
from redundancy_pin.dynamics.base import Dynamics, require_dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.limits import Limits, grouped
from redundancy_pin.planners.receding_horizon.command import GOALS, Command, Goal, PlanningStatus, Weights
from redundancy_pin.planners.receding_horizon.linearised import FIRST, ZONE, Linearised, extended, nodes_from
from redundancy_pin.planners.receding_horizon.preview import SAME, Preview, Source
from redundancy_pin.planners.receding_horizon.programme import SOLVERS, Programme, Values
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

NEAR = 0.25
"""A singular instant nearer than this, in steps, is reached by the last plan; the new one begins there."""

SETTLED = 2.0
"""Steps before a singular instant in which a plan begins where the last one is, and not where the carriers are."""

EXTRA = 8
"""Nodes beyond those of even steps, for the finer ones around singular instants."""

FORCE_KEPT = 0.98
"""Share of the limit of the carriers' forces that the nodes use: between them they are a little larger."""

NO_BOUND = 1e4
"""In place of an infinite bound of a row that does not count."""

BEYOND = 1e-6
"""Room in an elastic programme for a start that is on its limit, m."""

CONVERGED = 2.5
"""Steps before a singular instant in which a tick has several rounds: W⁻¹ magnifies what is left of uᵀ f there."""

EXACT = 1e-6
"""Fraction of f that may be left."""

MOST_ROUNDS = 5

SHORTEST_STOP = 1e-6
"""s; a carrier that stops sooner stands."""

PROXIMAL = 3.0
"""Weight of the squared change of s̈ from round to round: they would go to and fro between two plans of one cost."""

SMALLEST = 0.05
"""Efforts count as of size one from this fraction of those of parked carriers."""

FIRST_ROUNDS = 3
"""Programmes of the first tick, each about the plan of the one before."""

REGULAR = 1e-3
"""Smallest over largest singular value of W from which W⁻¹ f is the effort; nearer to a pose it magnifies rounding."""


class RecedingHorizon:
    """Plans the carriers and the efforts again and again, over the path known for a short time ahead.

    Each tick solves one convex quadratic programme: s, ṡ, s̈ and τ at nodes 20 ms apart, fixed in time, with s̈ linear
    in between, W τ = f linear about the last plan, and the limits of the carriers between the nodes too. W⁻¹ is not
    formed: type II singularities ahead become nodes with what makes τ finite and continuous there (``linearised``). At
    the end of the horizon the carriers can still stop on their tracks, so there always is a motion within their limits.

    Args:
        dynamics: a backend; ``CompiledDynamics`` is the fastest by far.
        horizon: how far ahead it plans, s.
        step: between nodes, s; half of it around singular instants.
        objective: "peak" max |τ| over the horizon, beside the mean square, or "effort", that alone; or ``Weights``.
        track, speed, acceleration, jerk, effort, carrier_force: limits as of ``plan_whole_trajectory``.
        limits: these as one group.
        solver: of the programmes: "piqp" or one of casadi's (``SOLVERS``).

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
        solver: str = "piqp",
    ) -> None:
        require_dynamics(dynamics)
        robot = dynamics.robot
        require_carriers(robot)
        one_of(solver, "solver", SOLVERS)
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
        self._count = round(horizon / step) + EXTRA
        self._solver = solver
        self._bounded = (False, False)
        self._programmes: dict[bool, Programme] = {}
        self.limits = grouped("limits", limits, Limits, **flat)
        self._source: object = None
        self._preview: Preview | None = None
        self._last: Command | None = None
        self._sizes: _Sizes | None = None
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
            sizes = robot.n, robot.m, robot.k, self._count
            jerk, force = self._bounded
            self._programmes[elastic] = Programme(*sizes, self._solver, jerk, force, elastic)
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
        if self._preview is None or preview is not self._source:
            self._preview, self._source = Preview.of(preview), preview
        t = self._tick(t)
        if t < self._preview.start - SAME:
            raise InputError(
                f"The tick is at t = {t:.6g} s, and the preview begins at {self._preview.start:.6g} s.",
                remedy="Pass what is known of the motion from the tick on.",
            )
        given = tuple(
            None if part is None else each(part, name, (self.robot.k,), finite=True)
            for part, name in ((s, "s"), (sd, "sd"))
        )
        last = self._last
        command = self._plan(t, self._preview, given, last, last)
        for rounds in range(1, MOST_ROUNDS):
            if rounds >= (FIRST_ROUNDS if last is None else 1) and not self._is_rough(t, command):
                break
            another = self._plan(t, self._preview, given, last, command)
            if another.status is not PlanningStatus.PLANNED:
                break
            command = another
        self._last = command = replace(command, seconds=time.perf_counter() - began)
        self.largest = max(self.largest, float(np.abs(command.efforts(np.linspace(t, t + self.step, 5))).max()))
        return command

    def skip(self, t: float) -> Command:
        """Return what to do where a tick is missed: the last plan goes on, to its end and to the stop behind it.

        Raises:
            InputError: there is no plan yet.
        """
        if self._last is None:
            raise InputError("There is no plan to go on with.", remedy="Call update first.")
        return replace(self._last, t=self._tick(t), status=PlanningStatus.FALLBACK, reason="the tick was missed")

    def _tick(self, t: float) -> float:
        """Return the time of a tick, s, after checking that it goes on from the last one."""
        t = float(each(t, "t", (1,), finite=True)[0])
        if self._last is not None and t < self._last.t:
            raise InputError(
                f"The tick is at t = {t:.6g} s, after one at {self._last.t:.6g} s.", remedy="Go on in time."
            )
        return t

    def _is_rough(self, t: float, command: Command) -> bool:
        """Return whether a plan leaves force out next to a singular instant, which another round would put right."""
        roots = command.singular
        near = ((roots > t) & (roots < t + CONVERGED * self.step)).any()
        exact = self._sizes is None or command.residual <= EXACT * float(self._sizes.row.max())
        return bool(near) and command.status is PlanningStatus.PLANNED and not exact

    def _plan(
        self,
        t: float,
        preview: Preview,
        given: tuple[Array | None, ...],
        last: Command | None,
        about: Command | None,
    ) -> Command:
        """Return a plan that goes on from the last one, with f linear about it or about that of the round before."""
        step, k = self.step, self.robot.k
        before = t if preview.changing else t - ZONE * step  # for the nodes around one that is past
        roots = preview.singular_instants(self.dynamics, before, t + step * (self._count + 1), step)
        ahead = roots[roots > t - SAME]
        near = len(ahead) and ahead[0] <= t + NEAR * step and last is not None
        start = float(ahead[0]) if near else t
        nodes, singular = nodes_from(start, step, self._count + 1, roots)
        if last is None:
            s, sd = (np.zeros(k) if part is None else part for part in given)
            first = s, sd, np.zeros(k)
        else:
            own = extended(last.carriers, nodes[:1])
            settled = len(ahead) and ahead[0] <= t + SETTLED * step
            pairs = zip(given, (own.s[0], own.sd[0]), strict=True)
            s, sd = (planned if part is None or settled else part for part, planned in pairs)
            first = s, sd, own.sdd[0]
        if about is None:
            at = CarrierMotion(*(np.tile(part, (len(nodes), 1)) for part in first), check_rates=False)
        else:
            at = extended(about.carriers, nodes)
        lin = Linearised.about(self.dynamics, preview, nodes, singular, at)
        if self._sizes is None:
            self._sizes = _Sizes.of(lin)
        sizes = self._sizes
        if last is not None:  # of all rounds the same, or the second would be off to another plan
            share = min(max(last.peak / sizes.tau, SMALLEST), 1.0)
            sizes = _Sizes(share * sizes.tau, sizes.row)
        jerk = None if last is None else last.carriers.derivative(3)(nodes[:1], "left")[0]
        proximal = PROXIMAL if about is not last else 0.0
        return _Tick(self, lin, first, last is None, jerk, sizes, proximal).command(t, last, roots, preview)


@dataclass(frozen=True, eq=False)
class _Sizes:
    """What unknowns and rows are divided by: ``tau``, N or N·m; ``row`` (n,), N or N·m."""

    tau: float
    row: Array

    @staticmethod
    def of(lin: Linearised) -> _Sizes:
        W, f = lin.W[lin.known] / lin.row_scale[:, None], lin.f[lin.known] / lin.row_scale
        largest = float(np.median(np.linalg.norm(W, ord=2, axis=(1, 2)))) if len(W) else 1.0
        # where the platform rests, what a carrier's acceleration of 1 m/s² asks for
        wanted = max(float(np.abs(f).max(initial=0.0)), 0.1 * float(np.abs(lin.slopes[2]).max(initial=0.0)), 1e-6)
        return _Sizes(wanted / largest, wanted * lin.row_scale)


class _Tick:
    """One programme: its numbers, its solution, and the command it makes."""

    def __init__(
        self,
        planner: RecedingHorizon,
        lin: Linearised,
        first: tuple[Array, ...],
        free: bool,
        jerk: Array | None,
        sizes: _Sizes,
        proximal: float,
    ) -> None:
        self._planner, self._lin, self._first, self._free, self._jerk, self._sizes = (
            planner,
            lin,
            first,
            free,
            jerk,
            sizes,
        )
        limits = planner.resolved
        width = np.diff(limits.track, axis=1)[:, 0]
        self._proximal = proximal
        self._u = (
            np.where(np.isfinite(width), 0.5 * width, 1.0),
            np.where(np.isfinite(limits.speed), limits.speed, 1.0),
            np.where(np.isfinite(limits.acceleration), limits.acceleration, 10.0),
        )
        # with everything at its start given, the efforts there are decided; but for what W loses at a singular instant
        self._counts = lin.known.copy()
        self._counts[0] &= free or (0 in lin.singular)

    def _equations(self, elastic: bool) -> dict[str, tuple[Array, Array]]:
        lin, (us, ud, ua), ut, row = self._lin, self._u, self._sizes.tau, self._sizes.row
        count, n = lin.f.shape
        h, k = np.diff(lin.nodes)[:, None], len(us)
        one, none = np.ones((count - 1, k)), np.zeros((count - 1) * k)
        position = np.stack([one, h * ud / us, h**2 / 3.0 * ua / us, h**2 / 6.0 * ua / us, -one], axis=-1)
        speed = np.stack([one, 0.5 * h * ua / ud, 0.5 * h * ua / ud, -one], axis=-1)
        motion = tuple(zip(lin.slopes, (lin.at.s, lin.at.sd, lin.at.sdd), self._u, strict=True))
        wide = np.concatenate([lin.W * ut, *(-part * unit for part, _, unit in motion)], axis=2) / row[:, None]
        right = (lin.f - sum(np.einsum("nik,nk->ni", part, at) for part, at, _ in motion)) / row
        if len(lin.singular) and lin.singular[0] == 0 and not self._free:
            # all but the direction that W loses: what the given start leaves of f there is beyond this plan
            u = lin.lost[0] * row / np.linalg.norm(lin.lost[0] * row)
            wide[0] -= np.outer(u, u @ wide[0])
            right[0] -= u * (u @ right[0])
        wide = np.concatenate([wide, np.ones((count, n, 1))], axis=2).reshape(count * n, -1)
        before, after = np.zeros((2, count, wide.shape[1] + k))
        start, value, active = np.zeros((1, wide.shape[1])), np.zeros(count), np.zeros(count, dtype=bool)
        q, m = lin.singular, lin.W.shape[2]
        if len(q):
            size = np.abs(lin.W[q]).max(axis=(1, 2)) / self._planner.horizon  # where the motion only touches it
            size = ut * np.maximum(np.abs(lin.W_rate).max(axis=1), 0.1 * size)[:, None]
            *slopes, by_jerk = lin.slope_rates
            at = zip(slopes, (lin.at.s, lin.at.sd, lin.at.sdd), self._u, strict=True)
            parts = [(part, part * unit, own[q]) for part, own, unit in at]
            base = np.concatenate([lin.W_rate * ut, *(-scaled for _, scaled, _ in parts)], axis=1) / size
            value[q] = (lin.f_rate - sum((part * own).sum(axis=1) for part, _, own in parts)) / size[:, 0]
            active[q] = lin.known[q]
            share = by_jerk * ua / size
            for side, table, steps in ((1.0, before, q - 1), (-1.0, after, np.minimum(q, count - 2))):
                rate = side * share / h[steps]  # s⃛ is ± (s̈ here − s̈ there) / h
                table[q, : m + 3 * k] = base
                table[q, m + 2 * k : m + 3 * k] -= rate
                table[q, m + 3 * k : -1] = rate
                table[q, -1] = 1.0
            if q[0] == 0 and self._jerk is not None:
                start[0, :-1], start[0, -1] = base[0], 1.0
                value_at_start = value[0] + by_jerk[0] @ self._jerk / size[0, 0]
        first = active[:1] & (self._jerk is not None)
        entries = slice(None) if elastic else slice(-1)  # the last of a row is what is missing
        return {
            "position": (position.reshape(-1, 5), none),
            "speed": (speed.reshape(-1, 4), none),
            "dynamics": _counting(np.repeat(self._counts, n), wide[:, entries], right.ravel()),
            "before": _counting(active[1:], before[1:, entries], value[1:]),
            "start": _counting(first, start[:, entries], np.array([value_at_start if first[0] else 0.0])),
            "after": _counting(active[:-1], after[:-1, entries], value[:-1]),
        }

    def _inequalities(self, low: Array, high: Array, speed: Array) -> dict[str, tuple[Array, Array, Array]]:
        lin, limits, (us, ud, ua) = self._lin, self._planner.resolved, self._u
        count, m = len(lin.nodes), lin.W.shape[2]
        h, one = np.diff(lin.nodes)[:, None], np.ones((count - 1, len(us)))
        there = np.repeat(self._counts, m)[:, None]
        none = np.zeros(count * m)
        low, high, most = (
            np.maximum(low / us, -NO_BOUND),
            np.minimum(high / us, NO_BOUND),
            np.minimum(speed / ud, NO_BOUND),
        )

        def hull(share: Array, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
            """Return rows of a point of the Bézier hull of each step, and their bounds."""
            return np.stack([one, share * one], axis=-1).reshape(-1, 2), lower, upper

        # no parabola leaves a chord: ṡ² ≤ ṡ_max |ṡ|
        fastest = np.minimum(limits.speed, np.sqrt(2.0 * limits.acceleration * np.diff(limits.track)[:, 0]))
        stopping = np.isfinite(fastest) & np.isfinite(limits.acceleration)  # else at once, or on a track without end
        after = np.divide(fastest, 2.0 * limits.acceleration, out=np.zeros_like(fastest), where=stopping)
        stop = np.stack([one[0], after * ud / us], axis=-1)
        lowest, highest = np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])
        rows = {
            "above": (there * [1.0, -1.0], none - np.inf, none),
            "below": (there * [1.0, 1.0], none, none + np.inf),
            "hull_left": hull(h / 3.0 * ud / us, lowest, highest),
            "hull_right": hull(-h / 3.0 * ud / us, lowest, highest),
            "hull_speed": hull(0.5 * h * ua / ud, -most[:-1], most[:-1]),
            "stop": (stop, low[-1], high[-1]),
            "stop_back": (stop * [1.0, -1.0], low[-1], high[-1]),
        }
        if np.isfinite(limits.jerk).any():
            most = limits.jerk * h / ua
            rows["jerk"] = (np.stack([-one, one], axis=-1).reshape(-1, 2), -most, most)
        if np.isfinite(limits.carrier_force).any():
            motion = zip(lin.force_slopes, (lin.at.s, lin.at.sd, lin.at.sdd), self._u, strict=True)
            parts = [(part * unit, np.einsum("nik,nk->ni", part, at)) for part, at, unit in motion]
            size = np.where(np.isfinite(limits.carrier_force), limits.carrier_force, 1.0)
            base = (lin.force - sum(own for _, own in parts)) / size
            wide = np.concatenate([part for part, _ in parts], axis=2) / size[:, None] * lin.known[:, None, None]
            most = np.where(lin.known[:, None] & np.isfinite(limits.carrier_force), FORCE_KEPT, NO_BOUND)
            rows["force"] = (wide.reshape(-1, wide.shape[2]), -most - base, most - base)
        return rows

    def values(self, elastic: bool) -> Values:
        """Return the numbers of the programme; an elastic one lets out what the start is beyond."""
        planner, lin = self._planner, self._lin
        programme, limits, w = planner.programme(elastic), planner.resolved, planner.weights
        (us, ud, ua), ut, (s, sd, _) = self._u, self._sizes.tau, self._first
        each_node = np.ones((len(lin.nodes), 1))
        low, high, speed = limits.track[:, 0] * each_node, limits.track[:, 1] * each_node, limits.speed * each_node
        if elastic:
            # room for a start beyond a limit, and for going back with half the acceleration
            after, most = (lin.nodes - lin.nodes[0])[:, None], np.minimum(limits.acceleration, 1e3)
            turn = 1.5 * most * (lin.nodes[1] - lin.nodes[0])
            high = np.maximum(high, s + (sd + turn) * after - 0.25 * most * after**2 + BEYOND)
            low = np.minimum(low, s + (sd - turn) * after + 0.25 * most * after**2 - BEYOND)
            speed = np.maximum(speed, np.abs(sd) + turn - 0.5 * most * after)
        lower, upper = np.full((2, programme.variables), [[-np.inf], [np.inf]])
        bounds = (
            (programme.s, low / us, high / us),
            (programme.sd, -speed / ud, speed / ud),
            (programme.sdd, -limits.acceleration / ua, limits.acceleration / ua),
            (programme.tau, -limits.effort / ut, limits.effort / ut),
        )
        for at, least, largest in bounds:
            lower[at], upper[at] = least, largest
        for at, value, unit in zip((programme.s, programme.sd, programme.sdd), self._first, self._u, strict=True):
            if at is not programme.sdd or not self._free:
                lower[at[0]] = upper[at[0]] = value / unit
        if not self._counts[0]:
            lower[programme.tau[0]], upper[programme.tau[0]] = 0.0, 0.0
        step = np.diff(lin.nodes, prepend=lin.nodes[0], append=lin.nodes[-1])
        share = (step[:-1] + step[1:])[:, None] / (lin.nodes[-1] - lin.nodes[0])
        P = np.full(programme.variables, 1e-8)
        P[programme.tau] = w.effort * share
        P[programme.s] += w.centre * share
        lower[programme.peak] = w.memory * self._planner.largest / ut
        P[programme.sdd] = (w.acceleration + self._proximal) * share
        q = np.zeros(programme.variables)
        q[programme.sdd] = -self._proximal * share * lin.at.sdd / ua
        P[programme.s[-1]] += 2.0 * w.end
        P[programme.sd[-1]] += 2.0 * w.end_speed
        P[programme.missing] = w.missing
        P[programme.peak] = 2.0 * w.peak + 1e-8
        # jerks, over one that brings s̈ to its limit in a step
        jerk = w.jerk * (self._planner.step / np.diff(lin.nodes))[:, None] / self._planner._count * np.ones(len(us))
        P[programme.sdd[:-1]] += 2.0 * jerk
        P[programme.sdd[1:]] += 2.0 * jerk
        P = programme.hessian(P, -2.0 * jerk)
        A, b = programme.equal.values(self._equations(elastic))
        G, least, largest = programme.within.values(self._inequalities(low, high, speed))
        return Values(P, q, A, b, G, least, largest, lower, upper)

    def command(self, t: float, last: Command | None, roots: Array, preview: Preview) -> Command:
        planner, lin = self._planner, self._lin
        programme = planner.programme(elastic=False)
        began, status, reason = time.perf_counter(), PlanningStatus.PLANNED, ""
        x, solved = programme.solve(self.values(elastic=False))
        if not solved:
            programme = planner.programme(elastic=True)
            x, solved = programme.solve(self.values(elastic=True))
            status = PlanningStatus.ELASTIC
            reason = "no plan keeps every limit"
        seconds = time.perf_counter() - began
        if not solved:
            if last is None:
                raise InfeasiblePlanError(
                    f"No plan was found at t = {t:.6g} s.", remedy="Start elsewhere, or widen the limits.", time=t
                )
            reason = "the solver found none"
            return replace(last, t=t, status=PlanningStatus.FALLBACK, reason=reason, solver_seconds=seconds)
        s, sd, _ = self._first
        a = x[programme.sdd] * self._u[2]
        h = np.diff(lin.nodes)[:, None]
        # integrated once more: the solver's own are off by its tolerance
        speeds = sd + np.concatenate([0.0 * a[:1], np.cumsum(0.5 * h * (a[:-1] + a[1:]), axis=0)])
        moved = np.cumsum(h * speeds[:-1] + h**2 / 6.0 * (2.0 * a[:-1] + a[1:]), axis=0)
        carriers = PiecewisePolynomial.linear(lin.nodes, s + np.concatenate([0.0 * a[:1], moved]), speeds, a)
        carriers = PiecewisePolynomial.joined([carriers, *self._stop(carriers.end, carriers, speeds[-1])])
        efforts, forces, residual, peak = self._efforts(carriers, x[programme.tau] * self._sizes.tau)
        if lin.nodes[0] > t + SAME and last is not None:  # to the singular instant by the last plan
            carriers, efforts = (
                PiecewisePolynomial.joined([old.between(t, float(lin.nodes[0])), new])
                for old, new in ((last.carriers, carriers), (last.efforts, efforts))
            )
        unknown = np.flatnonzero(~lin.known)
        known_until = float(lin.nodes[max(unknown[0] - 1, 0)]) if len(unknown) else float(lin.nodes[-1])
        if len(unknown) and lin.nodes[unknown[0]] <= preview.end:
            status = PlanningStatus.REFUSED
            reason = f"at t = {lin.nodes[unknown[0]]:.6g} s the preview leads where the machine cannot go"
        return Command(
            t, status, reason, carriers, efforts, forces, residual, peak, frozen(roots), known_until, 0.0, seconds
        )

    def _stop(self, t: float, carriers: PiecewisePolynomial, sd: Array) -> list[PiecewisePolynomial]:
        """Return the stop after the horizon, for which there is room: every carrier slows down as fast as it can."""
        durations = np.abs(sd) / self._planner.resolved.acceleration
        durations[durations < SHORTEST_STOP] = 0.0
        if not durations.any():
            return []
        after = np.unique(np.append(0.0, durations))
        slowing = after[:, None] < durations
        a = -np.divide(sd, durations, out=np.zeros_like(sd), where=durations > 0.0)
        past = np.minimum(after[:, None], durations)
        place = carriers(np.array([t]), "left") + past * sd + 0.5 * past**2 * a
        return [
            PiecewisePolynomial.taylor(
                t + after, place, np.where(slowing, sd + past * a, 0.0), np.where(slowing, a, 0.0)
            )
        ]

    def _efforts(
        self, carriers: PiecewisePolynomial, tau: Array
    ) -> tuple[PiecewisePolynomial, PiecewisePolynomial, float, float]:
        """Return efforts and carriers' forces as functions of time, the residual at the nodes, the largest effort."""
        lin = self._lin
        exact = lin.of_plan(carriers)
        W, f = np.nan_to_num(exact.W), np.nan_to_num(exact.f)
        counts = self._counts.copy()
        counts[FIRST + 1 :] = False
        left = np.einsum("nij,nj->ni", W[lin.places], tau) - f[lin.places]
        residual = float(np.abs(left[counts] / lin.row_scale).max(initial=0.0))
        inside = lin.inside
        forces = PiecewisePolynomial.linear(exact.t[inside], np.nan_to_num(exact.carrier_force[inside]))
        scaled = W[inside] / lin.row_scale[:, None]
        singular_values = np.linalg.svd(scaled, compute_uv=False)
        fine = singular_values[:, -1] > REGULAR * singular_values[:, 0]
        inside = inside[fine]
        t = exact.t
        if not counts[0]:  # the start decides the efforts there, but for the preload of redundant actuators
            tau = np.concatenate([tau[1:2], tau[1:]])
        planned = PiecewisePolynomial.linear(lin.nodes, tau)(t[inside])  # of redundant actuators these decide
        missing = f[inside] - np.einsum("nij,nj->ni", W[inside], planned)
        own = planned + np.einsum("nij,nj->ni", np.linalg.pinv(W[inside]), missing)
        rest = counts & ~np.isin(lin.places, inside)
        times, values = np.append(t[inside], lin.nodes[rest]), np.concatenate([own, tau[rest]])
        if not len(times):
            times, values = lin.nodes[:1], tau[:1]
        order = np.argsort(times)
        times, values = times[order], values[order]
        if len(times) == 1:
            times, values = np.append(times, times + self._planner.step), np.repeat(values, 2, axis=0)
        peak = float(np.abs(tau[counts]).max(initial=0.0))
        most = self._planner.resolved.effort
        return PiecewisePolynomial.linear(times, np.clip(values, -most, most)), forces, residual, peak


def _counting(counts: BoolArray, entries: Array, right: Array) -> tuple[Array, Array]:
    """Return the equations of a block: (r, e) entries and (r,) right sides, zero where a row does not count."""
    return entries * counts[:, None], np.where(counts, right, 0.0)
