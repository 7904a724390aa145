"""One tick of on-line planning: the numbers of its programme, and what its solution commands."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, frozen
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon.command import Command, PlanningStatus, Weights
from redundancy_pin.planners.receding_horizon.linearised import FIRST, Linearised
from redundancy_pin.planners.receding_horizon.preview import SAME, Preview
from redundancy_pin.planners.receding_horizon.programme import Programme, Values
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

FORCE_KEPT = 0.98
"""Share of the limit of the carriers' forces that the nodes use: between them they are a little larger."""

NO_BOUND = 1e4
"""In place of an infinite bound of a row that does not count."""

BEYOND = 1e-6
"""Room in an elastic programme for a start that is on its limit, m."""

SHORTEST_STOP = 1e-6
"""s; a carrier that stops sooner stands."""

REGULAR = 1e-3
"""Smallest over largest singular value of W from which W⁻¹ f is the effort; nearer to a pose it magnifies rounding."""


@dataclass(frozen=True, eq=False)
class Setup:
    """What a planner plans with at a tick.

    ``step``, ``horizon``: s; ``count``: nodes but one; ``largest``: |τ| so far, N or N·m; ``programme``: with elastic
    limits or without.
    """

    limits: ResolvedLimits
    weights: Weights
    step: float
    horizon: float
    count: int
    largest: float
    programme: Callable[[bool], Programme]


@dataclass(frozen=True, eq=False)
class Sizes:
    """What unknowns and rows are divided by: ``tau``, N or N·m; ``row`` (n,), N or N·m."""

    tau: float
    row: Array

    @staticmethod
    def of(lin: Linearised) -> Sizes:
        """Return the sizes of W and f along the plan that they are linear about."""
        W, f = lin.W[lin.known] / lin.row_scale[:, None], lin.f[lin.known] / lin.row_scale
        largest = float(np.median(np.linalg.norm(W, ord=2, axis=(1, 2)))) if len(W) else 1.0
        # where the platform rests, what a carrier's acceleration of 1 m/s² asks for
        wanted = max(float(np.abs(f).max(initial=0.0)), 0.1 * float(np.abs(lin.slopes[2]).max(initial=0.0)), 1e-6)
        return Sizes(wanted / largest, wanted * lin.row_scale)


@dataclass(frozen=True, eq=False)
class Tick:
    """One programme: its numbers, its solution, and the command it makes.

    ``first``: s, ṡ and s̈ at the start, s̈ of which is ``free`` in a first plan; ``jerk`` (k,) there of the last plan;
    ``proximal``: weight of the change of s̈ from what ``lin`` is about.
    """

    setup: Setup
    lin: Linearised
    first: tuple[Array, ...]
    free: bool
    jerk: Array | None
    sizes: Sizes
    proximal: float

    @cached_property
    def _u(self) -> tuple[Array, Array, Array]:
        """What s, ṡ and s̈ are divided by, (k,) each."""
        limits = self.setup.limits
        width = np.diff(limits.track, axis=1)[:, 0]
        return (
            np.where(np.isfinite(width), 0.5 * width, 1.0),
            np.where(np.isfinite(limits.speed), limits.speed, 1.0),
            np.where(np.isfinite(limits.acceleration), limits.acceleration, 10.0),
        )

    @cached_property
    def _counts(self) -> BoolArray:
        """(M,) nodes whose equations count."""
        # with everything at its start given, the efforts there are decided; but for what W loses at a singular instant
        counts = self.lin.known.copy()
        counts[0] &= self.free or (0 in self.lin.singular)
        return counts

    def _equations(self, elastic: bool) -> dict[str, tuple[Array, Array]]:
        lin, (us, ud, ua), ut, row = self.lin, self._u, self.sizes.tau, self.sizes.row
        count, n = lin.f.shape
        h, k = np.diff(lin.nodes)[:, None], len(us)
        one, none = np.ones((count - 1, k)), np.zeros((count - 1) * k)
        position = np.stack([one, h * ud / us, h**2 / 3.0 * ua / us, h**2 / 6.0 * ua / us, -one], axis=-1)
        speed = np.stack([one, 0.5 * h * ua / ud, 0.5 * h * ua / ud, -one], axis=-1)
        motion = tuple(zip(lin.slopes, (lin.at.s, lin.at.sd, lin.at.sdd), self._u, strict=True))
        wide = np.concatenate([lin.W * ut, *(-part * unit for part, _, unit in motion)], axis=2) / row[:, None]
        right = (lin.f - sum(np.einsum("nik,nk->ni", part, at) for part, at, _ in motion)) / row
        if len(lin.singular) and lin.singular[0] == 0 and not self.free:
            # all but the direction that W loses: what the given start leaves of f there is beyond this plan
            u = lin.lost[0] * row / np.linalg.norm(lin.lost[0] * row)
            wide[0] -= np.outer(u, u @ wide[0])
            right[0] -= u * (u @ right[0])
        wide = np.concatenate([wide, np.ones((count, n, 1))], axis=2).reshape(count * n, -1)
        before, after = np.zeros((2, count, wide.shape[1] + k))
        start, value, active = np.zeros((1, wide.shape[1])), np.zeros(count), np.zeros(count, dtype=bool)
        q, m = lin.singular, lin.W.shape[2]
        if len(q):
            size = np.abs(lin.W[q]).max(axis=(1, 2)) / self.setup.horizon  # where the motion only touches it
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
            if q[0] == 0 and self.jerk is not None:
                start[0, :-1], start[0, -1] = base[0], 1.0
                value_at_start = value[0] + by_jerk[0] @ self.jerk / size[0, 0]
        first = active[:1] & (self.jerk is not None)
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
        lin, limits, (us, ud, ua) = self.lin, self.setup.limits, self._u
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
        setup, lin = self.setup, self.lin
        programme, limits, w = setup.programme(elastic), setup.limits, setup.weights
        (us, ud, ua), ut, (s, sd, _) = self._u, self.sizes.tau, self.first
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
        for at, value, unit in zip((programme.s, programme.sd, programme.sdd), self.first, self._u, strict=True):
            if at is not programme.sdd or not self.free:
                lower[at[0]] = upper[at[0]] = value / unit
        if not self._counts[0]:
            lower[programme.tau[0]], upper[programme.tau[0]] = 0.0, 0.0
        step = np.diff(lin.nodes, prepend=lin.nodes[0], append=lin.nodes[-1])
        share = (step[:-1] + step[1:])[:, None] / (lin.nodes[-1] - lin.nodes[0])
        P = np.full(programme.variables, 1e-8)
        P[programme.tau] = w.effort * share
        P[programme.s] += w.centre * share
        lower[programme.peak] = w.memory * self.setup.largest / ut
        P[programme.sdd] = (w.acceleration + self.proximal) * share
        q = np.zeros(programme.variables)
        q[programme.sdd] = -self.proximal * share * lin.at.sdd / ua
        P[programme.s[-1]] += 2.0 * w.end
        P[programme.sd[-1]] += 2.0 * w.end_speed
        P[programme.missing] = w.missing
        P[programme.peak] = 2.0 * w.peak + 1e-8
        # jerks, over one that brings s̈ to its limit in a step
        jerk = w.jerk * (self.setup.step / np.diff(lin.nodes))[:, None] / self.setup.count * np.ones(len(us))
        P[programme.sdd[:-1]] += 2.0 * jerk
        P[programme.sdd[1:]] += 2.0 * jerk
        P = programme.hessian(P, -2.0 * jerk)
        A, b = programme.equal.values(self._equations(elastic))
        G, least, largest = programme.within.values(self._inequalities(low, high, speed))
        return Values(P, q, A, b, G, least, largest, lower, upper)

    def command(self, t: float, last: Command | None, roots: Array, preview: Preview) -> Command:
        """Return what to do from t, s, on; the last command where the programme has no solution.

        Raises:
            InfeasiblePlanError: nor is there a last one.
        """
        setup, lin = self.setup, self.lin
        programme = setup.programme(False)
        began, status, reason = time.perf_counter(), PlanningStatus.PLANNED, ""
        x, solved = programme.solve(self.values(elastic=False))
        if not solved:
            programme = setup.programme(True)
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
        s, sd, _ = self.first
        a = x[programme.sdd] * self._u[2]
        h = np.diff(lin.nodes)[:, None]
        # integrated once more: the solver's own are off by its tolerance
        speeds = sd + np.concatenate([0.0 * a[:1], np.cumsum(0.5 * h * (a[:-1] + a[1:]), axis=0)])
        moved = np.cumsum(h * speeds[:-1] + h**2 / 6.0 * (2.0 * a[:-1] + a[1:]), axis=0)
        carriers = PiecewisePolynomial.linear(lin.nodes, s + np.concatenate([0.0 * a[:1], moved]), speeds, a)
        carriers = PiecewisePolynomial.joined([carriers, *self._stop(carriers.end, carriers, speeds[-1])])
        efforts, forces, residual, peak = self._efforts(carriers, x[programme.tau] * self.sizes.tau)
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
        durations = np.abs(sd) / self.setup.limits.acceleration
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
        lin = self.lin
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
            times, values = np.append(times, times + self.setup.step), np.repeat(values, 2, axis=0)
        peak = float(np.abs(tau[counts]).max(initial=0.0))
        most = self.setup.limits.effort
        return PiecewisePolynomial.linear(times, np.clip(values, -most, most)), forces, residual, peak


def _counting(counts: BoolArray, entries: Array, right: Array) -> tuple[Array, Array]:
    """Return the equations of a block: (r, e) entries and (r,) right sides, zero where a row does not count."""
    return entries * counts[:, None], np.where(counts, right, 0.0)
