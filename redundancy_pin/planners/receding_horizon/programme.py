"""The convex quadratic programme of one tick: s, ṡ, s̈ and τ at each node, with W τ = f linear about the last plan.

Its pattern never changes, so that the solver is set up once; equations that do not count at a tick are rows of zeros.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.errors import optional
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon.ahead import Linearised
from redundancy_pin.planners.receding_horizon.command import Weights

PRECISION, GAP = 1e-8, 1e-6
"""Of the solution, whose unknowns are of size one, and of the cost."""

RELATIVE = 1e-10, 1e-8
"""The same relative to the largest number in a programme, at first and where no solution is found."""

ENOUGH = 1e-6
"""Of the solution where the solver comes no nearer, as with a start on a limit; of its cost a hundred times that."""

ITERATIONS = 60

INFINITE = 1e30
"""What the solver takes for no bound."""

FORCE_KEPT = 0.98
"""Share of the limit of the carriers' forces that the nodes use: between them they are a little larger."""

CLOSER = 1e-5
"""By this fraction the limits are closer at the end of the horizon: the rest of a plan is not on the limits of the next
one, which it would miss by rounding."""

IN_HAND = 0.1
"""So is the limit of acceleration, by this fraction: a plan that is to be put right as it comes nearer needs some."""

BEYOND = 1e-6
"""Room in an elastic programme for a start that is on its limit, m."""


@dataclass(frozen=True, eq=False)
class TickScales:
    """What unknowns and rows are divided by: ``tau``, N or N·m; ``row`` (n,), N or N·m."""

    tau: float
    row: Array

    @staticmethod
    def of(lin: Linearised) -> TickScales:
        """Return the sizes of W and f along the plan that they are linear about."""
        W, f = lin.W[lin.known] / lin.row_scale[:, None], lin.f[lin.known] / lin.row_scale
        largest = float(np.median(np.linalg.norm(W, ord=2, axis=(1, 2)))) if len(W) else 1.0
        # where the platform rests, what a carrier's acceleration of 1 m/s² asks for
        wanted = max(float(np.abs(f).max(initial=0.0)), 0.1 * float(np.abs(lin.slopes[2]).max(initial=0.0)), 1e-6)
        return TickScales(wanted / largest, wanted * lin.row_scale)


@dataclass(frozen=True, eq=False)
class TickProblem:
    """What a tick asks for.

    ``first``: s, ṡ and s̈ (k,) at the start, s̈ of which is ``free`` in a first plan; ``jerk`` (k,) there of the last
    plan; ``step``, ``horizon``: s; ``largest``: |τ| so far, N or N·m.
    """

    lin: Linearised
    limits: ResolvedLimits
    weights: Weights
    sizes: TickScales
    first: tuple[Array, ...]
    free: bool
    jerk: Array | None
    step: float
    horizon: float
    largest: float

    @property
    def counts(self) -> BoolArray:
        """(N,) nodes whose equations count."""
        # with everything at its start given, the efforts there are decided; but for what W loses at a singular instant
        counts = self.lin.known.copy()
        counts[0] &= self.free or (0 in self.lin.singular)
        return counts


class Rows:
    """Rows of a sparse matrix of a fixed pattern, put together from blocks."""

    def __init__(self) -> None:
        self.blocks: dict[str, int] = {}
        self._columns: list[IntArray] = []

    def add(self, name: str, *columns: Any) -> None:
        """Add rows with entries in columns: arrays (r,) of one entry a row, or (r, e) of several."""
        if len(columns) > 1:
            columns = (np.stack([np.ravel(part) for part in np.broadcast_arrays(*columns)], axis=1),)
        self.blocks[name] = len(columns[0])
        self._columns.append(columns[0])

    def rows(self, name: str) -> slice:
        """Return where the rows of a block are."""
        sizes, place = list(self.blocks.values()), list(self.blocks).index(name)
        return slice(sum(sizes[:place]), sum(sizes[: place + 1]))

    def finish(self, sparse: Any, variables: int) -> None:
        """Order the entries by column, as solvers want them."""
        entries = np.concatenate([np.full(len(part), part.shape[1]) for part in self._columns])
        rows, columns = np.repeat(np.arange(len(entries)), entries), np.concatenate([p.ravel() for p in self._columns])
        self.order = np.lexsort((rows, columns))
        starts = np.searchsorted(columns[self.order], np.arange(variables + 1))
        self._row, data = rows, np.zeros(len(rows))
        self.matrix = sparse.csc_matrix((data, rows[self.order], starts), shape=(len(entries), variables))

    def fill(self, blocks: Mapping[str, tuple[Array, ...]]) -> list[Array]:
        """Set the entries, and return what else comes with the rows of each block: right sides or bounds.

        Rows with two infinite bounds, which the solver refuses, become rows of zeros, which hold nothing. Large numbers
        as bounds would not do: the solver's tolerance is relative to the largest.
        """
        entries, *sides = (
            np.concatenate([part.ravel() for part in parts])
            for parts in zip(*(blocks[name] for name in self.blocks), strict=True)
        )
        if len(sides) == 2:
            low, high = sides
            nothing = np.isinf(low) & np.isinf(high)
            entries[nothing[self._row]] = 0.0
            sides = [
                np.where(nothing, -1.0, np.maximum(low, -INFINITE)),
                np.where(nothing, 1.0, np.minimum(high, INFINITE)),
            ]
        self.matrix.data[:] = entries[self.order]
        return sides


class Programme:
    """Which variable and which row stands where, and their values at a tick.

    Variables, all over their sizes: s, ṡ, s̈ (k each), τ (m) and, in an elastic one, what is missing of W τ = f (n + 2)
    at each of the nodes; the peak.
    """

    def __init__(self, n: int, m: int, k: int, steps: int, limits: ResolvedLimits, elastic: bool) -> None:
        from scipy import sparse

        _piqp()
        self.elastic, spare = elastic, n + 2 if elastic else 0
        width = 3 * k + m + spare
        self.variables = (steps + 1) * width + 1
        at, carrier = np.arange(steps + 1)[:, None] * width, np.arange(k)
        self.s, self.sd, self.sdd = s, sd, sdd = tuple(at + j * k + carrier for j in range(3))
        self.tau = tau = at + 3 * k + np.arange(m)
        self.missing = missing = at + 3 * k + m + np.arange(spare)
        self.peak = self.variables - 1
        first, last, inner = slice(0, -1), slice(1, None), slice(1, -1)
        wide = np.concatenate([tau, s, sd, sdd], axis=1)
        self.equal, self.within = equal, within = Rows(), Rows()
        equal.add("given", np.concatenate([s[0], sd[0], sdd[0], tau[0]])[:, None])
        equal.add("position", s[first], sd[first], sdd[first], sdd[last], s[last])
        equal.add("speed", sd[first], sdd[first], sdd[last], sd[last])
        equal.add(
            "dynamics", np.concatenate([np.repeat(wide, n, axis=0), missing[:, :n].reshape(len(tau) * n, -1)], axis=1)
        )
        equal.add("before", np.concatenate([wide[last], sdd[first], missing[last, n : n + 1]], axis=1))
        equal.add("start", np.concatenate([wide[:1], missing[:1, n : n + 1]], axis=1))
        equal.add("after", np.concatenate([wide[first], sdd[last], missing[first, n + 1 :]], axis=1))
        within.add("above", tau, self.peak)
        within.add("below", tau, self.peak)
        within.add("track", s[inner], sd[inner], sdd[inner])
        within.add("last_track", s[-1], sd[-1])
        within.add("hull_speed", sd[first], sdd[first])
        within.add("stop", s[-1], sd[-1])
        within.add("stop_back", s[-1], sd[-1])
        if np.isfinite(limits.jerk).any():
            within.add("jerk", sdd[first], sdd[last])
        if np.isfinite(limits.carrier_force).any():
            within.add("force", s, sd, sdd)
        for rows in (equal, within):
            rows.finish(sparse, self.variables)
        pair = [
            np.concatenate([part.ravel() for part in side])
            for side in ((sdd[first], s, s, sd), (sdd[last], sd, sdd, sdd))
        ]
        every = np.arange(self.variables)
        down, across = np.concatenate([every, *pair]), np.concatenate([every, *pair[::-1]])
        self._order = np.lexsort((down, across))
        starts = np.searchsorted(across[self._order], np.arange(self.variables + 1))
        shape = (self.variables, self.variables)
        self._cost = sparse.csc_matrix((np.zeros(len(down)), down[self._order], starts), shape=shape)
        self._solver: Any = None

    def __getstate__(self) -> dict[str, Any]:
        """Return what travels: the solver is set up again."""
        return {**self.__dict__, "_solver": None}

    def solve(self, problem: TickProblem) -> tuple[Array, Array] | None:
        """Return the variables and the multipliers (N, n) of W τ = f, or None where no optimum is found."""
        values = self.numbers_of(problem)
        for relative in RELATIVE:
            if self._solver is None:
                self._solver = self.new_solver(relative)
                self._solver.setup(*values)
            else:
                self._solver.update(*values)
            solved = self._solver.solve() == _piqp().PIQP_SOLVED
            info = self._solver.result.info
            near = info.primal_res < ENOUGH and max(info.dual_res, info.duality_gap_rel) < 100.0 * ENOUGH
            x, y = np.array(self._solver.result.x), np.array(self._solver.result.y)
            if (solved or near) and np.isfinite(x).all():
                return x, y[self.equal.rows("dynamics")].reshape(problem.lin.f.shape) / problem.sizes.row
            self._solver = None
        return None

    def new_solver(self, relative: float) -> Any:
        """Return a solver with its settings; ``relative`` as of ``RELATIVE``."""
        piqp = _piqp()
        solver = piqp.SparseSolver()
        settings = solver.settings
        settings.kkt_solver = piqp.KKTSolver.sparse_ldlt_ineq_cond
        settings.eps_abs, settings.eps_rel = PRECISION, relative
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = GAP
        settings.eps_primal_inf = settings.eps_dual_inf = PRECISION  # of what is nearly infeasible more is asked
        settings.max_iter = ITERATIONS
        settings.preconditioner_iter = 0  # all is of size one
        return solver

    def numbers_of(self, problem: TickProblem) -> tuple[Any, ...]:
        """Return P, q, A, b, G and bounds: ½ xᵀ P x + qᵀ x, A x = b, low ≤ G x ≤ high, lower ≤ x ≤ upper."""
        lin, limits, w, ut = problem.lin, problem.limits, problem.weights, problem.sizes.tau
        us, ud, ua = units = units_of(limits)
        s, sd, _ = problem.first
        closer = CLOSER * (lin.nodes - lin.nodes[0])[:, None] / (lin.nodes[-1] - lin.nodes[0])
        low, high = limits.track[:, 0] + closer * us, limits.track[:, 1] - closer * us
        speed, acceleration = limits.speed * (1.0 - closer), limits.acceleration * (1.0 - closer * (IN_HAND / CLOSER))
        if self.elastic:
            # room for a start that leaves a limit, and for going back with half the acceleration; for no other
            after, most = (lin.nodes - lin.nodes[0])[:, None], np.minimum(limits.acceleration, 1e3)
            h = lin.nodes[1] - lin.nodes[0]
            turn, moved = 1.5 * most * h, h * np.abs(sd) + h**2 / 6.0 * most + 0.5 * sd**2 / most
            up = np.maximum(high, s + (sd + turn) * after - 0.25 * most * after**2 + BEYOND)
            down = np.minimum(low, s + (sd - turn) * after + 0.25 * most * after**2 - BEYOND)
            high, low = np.where(s + moved > high[0], up, high), np.where(s - moved < low[0], down, low)
            over = np.maximum(speed, np.abs(sd) + turn - 0.5 * most * after)
            speed = np.where(np.abs(sd) > limits.speed, over, speed)
        upper = np.full(self.variables, INFINITE)
        upper[self.sdd] = acceleration / ua
        if not problem.free:
            upper[self.sdd[0]] = INFINITE  # it is given
        upper[self.sd[-1]] = speed[-1] / ud
        upper[self.tau] = limits.effort / ut
        lower = -np.minimum(upper, INFINITE, out=upper)
        lower[self.peak] = w.memory * problem.largest / ut
        step = np.diff(lin.nodes, prepend=lin.nodes[0], append=lin.nodes[-1])
        share = (step[:-1] + step[1:])[:, None] / (lin.nodes[-1] - lin.nodes[0])
        diagonal, q = np.full(self.variables, 1e-8), np.zeros(self.variables)
        diagonal[self.tau] = w.effort * share
        diagonal[self.s] += w.centre * share
        diagonal[self.sdd] = w.acceleration * share
        end = max(int(lin.known.sum()) - 1, 1)  # known are the first ones: what is after the horizon is not
        diagonal[self.s[end]] += 2.0 * w.end
        diagonal[self.sd[end]] += 2.0 * w.end_speed
        diagonal[self.missing] = w.missing
        diagonal[self.peak] += 2.0 * w.peak
        # jerks, over one that brings s̈ to its limit in a step
        jerk = w.jerk * (problem.step / np.diff(lin.nodes)) * problem.step / problem.horizon
        jerk = np.tile(jerk[:, None], len(us))
        diagonal[self.sdd[:-1]] += 2.0 * jerk
        diagonal[self.sdd[1:]] += 2.0 * jerk
        # curvature of the constraints, as far as it is convex: without it the plans of two ticks may go to and fro
        sizes = np.stack(units, axis=1)  # (k, 3)
        size, axes = np.linalg.eigh(lin.curvature * sizes[:, :, None] * sizes[:, None])
        bend = (axes * np.maximum(size, 0.0)[..., None, :]) @ axes.swapaxes(2, 3)
        slope = (bend @ (np.stack(lin.at, axis=-1) / sizes)[..., None])[..., 0]
        for i, place in enumerate((self.s, self.sd, self.sdd)):
            diagonal[place] += bend[..., i, i]
            q[place] -= slope[..., i]
        beside = np.concatenate([-2.0 * jerk.ravel(), *(bend[..., i, j].ravel() for i, j in ((0, 1), (0, 2), (1, 2)))])
        self._cost.data[:] = np.concatenate([diagonal, beside, beside])[self._order]
        (b,) = self.equal.fill(self._equations(problem, units))
        least, most = self.within.fill(self._inequalities(problem, units, low, high, speed))
        return self._cost, q, self.equal.matrix, b, self.within.matrix, least, most, lower, upper

    def _equations(self, problem: TickProblem, units: tuple[Array, ...]) -> dict[str, tuple[Array, Array]]:
        lin, (us, ud, ua), ut, row = problem.lin, units, problem.sizes.tau, problem.sizes.row
        count, n = lin.f.shape
        h, k = np.diff(lin.nodes)[:, None], len(us)
        m, counts, q = lin.W.shape[2], problem.counts, lin.singular
        one, none = np.ones((count - 1, k)), np.zeros((count - 1) * k)
        position = np.stack([one, h * (ud / us), h**2 * (ua / us / 3.0), h**2 * (ua / us / 6.0), -one], axis=-1)
        half = h * (0.5 * ua / ud)
        speed = np.stack([one, half, half, -one], axis=-1)
        entries = np.empty((count, n, m + 3 * k + self.elastic))
        entries[:, :, :m] = lin.W * ut
        scaled = lin.slopes * np.stack(units)[:, None, None]
        entries[:, :, m : m + 3 * k] = -scaled.transpose(1, 2, 0, 3).reshape(count, n, 3 * k)
        entries[:, :, : m + 3 * k] /= row[:, None]
        entries[:, :, m + 3 * k :] = 1.0
        right = (lin.f - np.einsum("dnik,dnk->ni", lin.slopes, np.stack(lin.at))) / row
        if len(q) and q[0] == 0 and not problem.free:
            # all but the direction that W loses: what the given start leaves of f there is beyond this plan
            u = lin.lost[0] * row / np.linalg.norm(lin.lost[0] * row)
            entries[0] -= np.outer(u, u @ entries[0])
            right[0] -= u * (u @ right[0])
            entries[0, :, m + 3 * k :] = 1.0
        before, after = np.zeros((2, count, m + 4 * k + self.elastic))
        start, value, active = np.zeros((1, m + 3 * k + self.elastic)), np.zeros(count), np.zeros(count, dtype=bool)
        value_at_start = np.zeros(1)
        if len(q):
            size = np.abs(lin.W[q]).max(axis=(1, 2)) / problem.horizon  # where the motion only touches it
            size = ut * np.maximum(np.abs(lin.W_rate).max(axis=1), 0.1 * size)[:, None]
            *slopes, by_jerk = lin.slope_rates
            at = list(zip(slopes, lin.at, units, strict=True))
            base = np.concatenate([lin.W_rate * ut, *(-part * unit for part, _, unit in at)], axis=1) / size
            value[q] = (lin.f_rate - sum((part * own[q]).sum(axis=1) for part, own, _ in at)) / size[:, 0]
            active[q] = lin.known[q]
            share = by_jerk * ua / size
            for side, table, steps in ((1.0, before, q - 1), (-1.0, after, np.minimum(q, count - 2))):
                rate = side * share / h[steps]  # s⃛ is ± (s̈ here − s̈ there) / h
                table[q, : m + 3 * k] = base
                table[q, m + 2 * k : m + 3 * k] -= rate
                table[q, m + 3 * k : m + 4 * k] = rate
                table[q, m + 4 * k :] = 1.0
            if active[0] and problem.jerk is not None:
                start[0, : m + 3 * k], start[0, m + 3 * k :] = base[0], 1.0
                value_at_start = value[:1] + by_jerk[:1] @ problem.jerk / size[0]
        fixed = np.concatenate([np.ones(2 * k), np.full(k, not problem.free), np.full(m, not counts[0])])
        given = [part / unit for part, unit in zip(problem.first, units, strict=True)]
        return {
            "given": (fixed, np.concatenate([*given, np.zeros(m)]) * fixed),
            "position": (position, none),
            "speed": (speed, none),
            "dynamics": (entries * counts[:, None, None], right * counts[:, None]),
            "before": (before[1:] * active[1:, None], value[1:] * active[1:]),
            "start": (start, value_at_start),
            "after": (after[:-1] * active[:-1, None], value[:-1] * active[:-1]),
        }

    def _inequalities(
        self, problem: TickProblem, units: tuple[Array, ...], low: Array, high: Array, speed: Array
    ) -> dict[str, tuple[Array, Array, Array]]:
        lin, limits, (us, ud, ua) = problem.lin, problem.limits, units
        count, m = len(lin.nodes), lin.W.shape[2]
        h, one = np.diff(lin.nodes)[:, None], np.ones((count, len(us)))
        there = np.repeat(problem.counts, m).astype(np.float64)[:, None]
        room, without = 1.0 - there[:, 0], np.full(count * m, INFINITE)
        # no parabola leaves a chord: ṡ² ≤ ṡ_max |ṡ|
        fastest = np.minimum(limits.speed, np.sqrt(2.0 * limits.acceleration * np.diff(limits.track)[:, 0]))
        stopping = np.isfinite(fastest) & np.isfinite(limits.acceleration)  # else at once, or on a track without end
        after = np.divide(fastest, 2.0 * limits.acceleration, out=np.zeros_like(fastest), where=stopping)
        after *= ud / us
        low, high, speed = low / us, high / us, speed / ud
        if not problem.free:
            speed[0] = np.inf  # that of the first half step is given
        lowest, highest = np.minimum(low[:-1], low[1:]), np.maximum(high[:-1], high[1:])
        # control points of s as a cubic spline, of which it is a mean everywhere; and of ṡ
        place = [one[1:-1], (h[1:] - h[:-1]) * (ud / us / 3.0), h[1:] * h[:-1] * (-ua / us / 6.0)]
        rows = {
            "above": (np.hstack([there, -there]), -without, room),
            "below": (np.hstack([there, there]), -room, without),
            "track": (
                np.stack(place, axis=-1),
                np.minimum(lowest[:-1], lowest[1:]),
                np.maximum(highest[:-1], highest[1:]),
            ),
            "last_track": (np.stack([one[0], -h[-1] / 3.0 * ud / us], axis=1), lowest[-1], highest[-1]),
            "hull_speed": (np.stack([one[1:], h * (0.5 * ua / ud)], axis=-1), -speed[:-1], speed[:-1]),
            "stop": (np.stack([one[0], after], axis=1), low[-1], high[-1]),
            "stop_back": (np.stack([one[0], -after], axis=1), low[-1], high[-1]),
        }
        if "jerk" in self.within.blocks:
            most = limits.jerk * h / ua
            rows["jerk"] = (np.stack([-one[1:], one[1:]], axis=-1), -most, most)
        if "force" in self.within.blocks:
            size = limits.carrier_force
            base = (lin.force - (lin.force_slopes * np.stack(lin.at)).sum(axis=0)) / size
            wide = np.moveaxis(lin.force_slopes * np.stack(units)[:, None], 0, 2) / size[:, None]
            counting = lin.known[:, None] & np.isfinite(limits.carrier_force)
            closer = CLOSER * (lin.nodes - lin.nodes[0])[:, None] / (lin.nodes[-1] - lin.nodes[0])
            most, base = np.where(counting, FORCE_KEPT - closer, np.inf), base * counting
            rows["force"] = (wide, -most - base, most - base)
        return rows


def _piqp() -> Any:
    return optional("piqp", "On-line planning needs", "Install it with `pip install 'redundancy_pin[optimal]'`.")


def units_of(limits: ResolvedLimits) -> tuple[Array, Array, Array]:
    """Return what s, ṡ and s̈ are divided by, (k,) each."""
    width = np.diff(limits.track, axis=1)[:, 0]
    return (
        np.where(np.isfinite(width), 0.5 * width, 1.0),
        np.where(np.isfinite(limits.speed), limits.speed, 1.0),
        np.where(np.isfinite(limits.acceleration), limits.acceleration, 10.0),
    )
