"""The quadratic programme of an on-line update, written out node by node and solved by DAQP: the C planner's judge.

Nothing of the planner's own is used: f and its derivatives are made of a backend's terms along whole motions by complex
steps, and the programme is dense, in s, ṡ, s̈ and τ at each node, with its equations eliminated by a null space.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import daqp
import numpy as np
from scipy.linalg import polar, qr

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.carrier_model import carrier_model, terms
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon import RecedingHorizon, Weights
from redundancy_pin.planners.receding_horizon.command import UpdatePlan, extended
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.robot.scales import row_scale, turning_velocities

CLOSER, IN_HAND, FORCE_KEPT, BEYOND = 1e-5, 0.1, 0.98, 1e-6
"""Of the limits at the end of the horizon, of forces between the nodes, m."""

REGULAR = 1e-8
"""Each unknown has a cost, so that it is decided; not more than this part of one of the others."""

SAME, DIFFERENCE, TINY, BEND = 1e-9, 1e-4, 1e-30, 1e-3
"""s; s; complex steps; steps of second derivatives, m and m/s."""

SETTLED, SMALLEST = 2.0, 0.1
"""Steps before a singular instant in which a plan goes on from the last one; least share of the unit of effort."""


@dataclass(frozen=True, eq=False)
class Linearised:
    """W τ = f at N nodes, linear about a plan; n coordinates, m main actuators, k carriers.

    Attributes:
        nodes: (N,) s.
        singular: (q,) indices of those that are singular instants.
        known: (N,) whether the motion there is known, and can be reached.
        at: (N, k) s, ṡ, s̈ that all is linear about.
        W: (N, n, m).
        f: (N, n) at that motion, N and N·m.
        slopes: (3, N, n, k) derivatives of f by s, ṡ, s̈.
        force: (N, k) the carriers' forces, N.
        force_slopes: (3, N, k) their derivatives by their own motion.
        lost: (q, n) directions u that W loses.
        W_rate: (q, m) uᵀ Ẇ.
        f_rate: (q,) uᵀ f̄′.
        slope_rates: four (q, k) of uᵀ ḟ, by δs, δṡ, δs̈ and s⃛.
        curvature: (N, k, 3, 3) second derivatives of −yᵀ f by s, ṡ and s̈, with the multipliers y of W τ = f.
        row_scale: (n,) see ``ReducedDynamics``.
        until: s, after which nothing is known.
    """

    nodes: Array
    singular: IntArray
    known: BoolArray
    at: tuple[Array, ...]
    W: Array
    f: Array
    slopes: Array
    force: Array
    force_slopes: Array
    lost: Array
    W_rate: Array
    f_rate: Array
    slope_rates: tuple[Array, ...]
    curvature: Array
    row_scale: Array
    until: float


class Table(NamedTuple):
    """Of N instants: whether they can be reached (N,), W (N, n, m), and f and the carriers' forces by terms."""

    known: BoolArray
    W: Array
    constant: Array
    terms: Array


class Ahead:
    """W and f along a preview as sums of terms of the carriers' motion, read off a backend along whole motions."""

    def __init__(self, dynamics: Dynamics, preview: Preview) -> None:
        self.dynamics, self.preview, self.row_scale = dynamics, preview, row_scale(dynamics.robot)
        robot = dynamics.robot
        self._turning = bool(turning_velocities(robot)[robot.carrier_velocity].any())
        self._read: dict[bytes, Table] = {}

    def at(self, times: Array) -> Table:
        """Return what is at times, s; the same times are asked for again and again."""
        key = times.tobytes()
        if key not in self._read:
            self._read[key] = self._table(times)
        return self._read[key]

    def _table(self, times: Array) -> Table:
        once, places = np.unique(times, return_inverse=True)
        along = self.dynamics.along(self.preview.motion(once), unreachable="mark")
        model, own = carrier_model(along, turning=self._turning), np.arange(self.dynamics.robot.k)
        of_f = model.f_terms.transpose(0, 2, 3, 1)
        of_force = np.zeros((*of_f.shape[:3], model.k))
        of_force[:, own, :, own] = model.force_terms.transpose(1, 0, 2)
        known = np.logical_and.accumulate(np.isfinite(model.f0).all(axis=1))
        parts = (
            model.W,
            np.concatenate([model.f0, model.force0], axis=1),
            np.concatenate([of_f, of_force], axis=3),
        )
        return Table(known[places], *(np.nan_to_num(part)[places] for part in parts))


def slopes(ahead: Ahead, times: Array, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
    """Return f and the carriers' forces (N, n + k), and their derivatives (3, N, n + k, k) by s, ṡ and s̈."""
    table = ahead.at(times)
    stacked = np.stack([s, sd, sdd])[:, None] + 1j * TINY * np.eye(3)[:, :, None, None]
    by_term = np.stack(terms(*stacked, table.terms.shape[2], np), axis=-1)  # type: ignore[arg-type, misc]
    by_term = np.concatenate([by_term[:1].real, by_term.imag / TINY]).transpose(1, 2, 0, 3)
    of_all = by_term @ table.terms
    return table.constant + of_all[:, :, 0].sum(axis=1), of_all[:, :, 1:].transpose(2, 0, 3, 1)


def curvature(ahead: Ahead, times: Array, at: tuple[Array, ...], along: Array) -> Array:
    """Return second derivatives (N, k, 3, 3) of f along directions (N, n), by s, ṡ and s̈ of each carrier."""
    table = ahead.at(times)
    count, n = table.terms.shape[2], along.shape[1]
    by_term = (table.terms[..., :n] @ along[:, None, :, None])[..., 0]
    steps = BEND * np.stack([np.eye(3), -np.eye(3)])[:, None] + 1j * TINY * np.eye(3)[:, None]
    s, sd, sdd = np.moveaxis(steps[..., None, None] + np.stack(at), 3, 0)
    slope = np.stack(terms(s, sd, sdd, count, np), axis=-1).imag / TINY
    second: Array = ((slope[0] - slope[1]) * by_term).sum(axis=-1) / (2.0 * BEND)
    return second.transpose(2, 3, 0, 1)


def linearised(
    ahead: Ahead, nodes: Array, singular: IntArray, at: tuple[Array, ...], multipliers: Array, until: float
) -> Linearised:
    """Return W τ = f about a motion of the carriers, three (N, k), and multipliers (N, n) of it there."""
    n, k, times = len(ahead.row_scale), at[0].shape[1], np.minimum(nodes, until)
    value, by = slopes(ahead, times, *at)
    table = ahead.at(times)
    W, reachable = table.W, table.known
    own, sides = np.arange(k), []
    s, sd, sdd = (part[singular] for part in at)
    for h in (-DIFFERENCE, DIFFERENCE) if len(singular) else ():
        beside = np.minimum(nodes[singular] + h, until)
        f, slope = slopes(ahead, beside, s + h * sd, sd + h * sdd, sdd)
        sides.append((ahead.at(beside).W, f[:, :n], slope[:, :, :n]))
    u = np.linalg.svd(W[singular] / ahead.row_scale[:, None])[0][:, :, -1] / ahead.row_scale
    if not sides:
        sides = [(W[singular], value[singular, :n], by[:, singular, :n])] * 2
    W_rate, f_rate, slope_rate = (
        np.einsum(f"qn,{axes}->{axes.replace('n', '')}", u, (two - one) / (2.0 * DIFFERENCE))
        for one, two, axes in zip(*sides, ("qnm", "qn", "dqnk"), strict=True)
    )
    by_s, by_sd, by_sdd = np.einsum("qn,dqnk->dqk", u, by[:, singular, :n])
    rates = slope_rate[0], by_s + slope_rate[1], by_sd + slope_rate[2], by_sdd
    known = (nodes <= until + SAME) & np.logical_and.accumulate(reachable)
    return Linearised(
        nodes, singular, known, at, W, value[:, :n], by[:, :, :n], value[:, n:], by[:, :, n + own, own], u, W_rate,
        f_rate, rates, curvature(ahead, times, at, -multipliers), ahead.row_scale, until,
    )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sizes:
    """What efforts and rows are divided by: ``tau``, N or N·m; ``row`` (n,)."""

    tau: float
    row: Array


@dataclass(frozen=True, eq=False)
class Problem:
    """What a programme asks for.

    ``first``: s, ṡ and s̈ (k,) at the start, s̈ of which is ``free`` in a first plan; ``jerk`` (k,) there of the last
    plan; ``step``, ``horizon``: s; ``largest``: |τ| so far, N or N·m; ``relaxed``: whether W τ = f may be missed.
    """

    lin: Linearised
    limits: ResolvedLimits
    weights: Weights
    sizes: Sizes
    first: tuple[Array, ...]
    free: bool
    jerk: Array | None
    step: float
    horizon: float
    largest: float
    relaxed: bool = False

    @property
    def counts(self) -> BoolArray:
        """(N,) nodes whose equations count."""
        counts = self.lin.known.copy()
        counts[0] &= self.free or (0 in self.lin.singular)
        return counts


class Written:
    """A tick's programme written out. Expressions of unknowns in units are rows of as many numbers as unknowns."""

    def __init__(self, tick: Problem) -> None:
        self.tick, self.lin, self.elastic = tick, tick.lin, tick.relaxed
        limits = tick.limits
        self.n, self.m, self.k = tick.lin.f.shape[1], tick.lin.W.shape[2], len(limits.speed)
        self.nodes, spare = len(tick.lin.nodes), self.n + 2 if tick.relaxed else 0
        width = 3 * self.k + self.m + spare
        at = np.arange(self.nodes)[:, None] * width
        one = np.eye(self.nodes * width + 1)
        places = [at + i * self.k + np.arange(self.k) for i in range(3)]
        torques, unmet = at + 3 * self.k + np.arange(self.m), at + 3 * self.k + self.m + np.arange(spare)
        width = limits.track[:, 1] - limits.track[:, 0]
        self.us = np.array([0.5 * w if np.isfinite(w) else 1.0 for w in width])
        self.ud = np.array([v if np.isfinite(v) else 1.0 for v in limits.speed])
        self.ua = np.array([a if np.isfinite(a) else 10.0 for a in limits.acceleration])
        self.s, self.sd, self.sdd = (
            one[places] * unit[:, None]
            for places, unit in zip((places[0], places[1], places[2]), (self.us, self.ud, self.ua), strict=True)
        )
        self.tau, self.peak = one[torques] * tick.sizes.tau, one[-1] * tick.sizes.tau
        self.missing = one[unmet]
        self.h = np.diff(tick.lin.nodes)
        self.gone = (tick.lin.nodes - tick.lin.nodes[0]) / (tick.lin.nodes[-1] - tick.lin.nodes[0])
        self.given = not tick.free
        self.nothing = np.zeros(len(one))

    def counts(self, i: int) -> bool:
        """Whether W τ = f is asked for at a node: at a given start only what it does not decide."""
        return bool(self.lin.known[i]) and (i > 0 or self.tick.free or 0 in self.lin.singular)

    def equations(self) -> dict[str, list[tuple[Array, float]]]:
        """Expressions and what they are."""
        lin, h = self.lin, self.h
        rows: dict[str, list[tuple[Array, float]]] = {
            name: [] for name in ("given", "position", "speed", "dynamics", "before", "start", "after")
        }
        for part, value, unit, holds in zip(
            (self.s, self.sd, self.sdd), self.tick.first, (self.us, self.ud, self.ua), (True, True, self.given),
            strict=True,
        ):  # fmt: skip
            rows["given"] += [(holds * part[0, j] / unit[j], holds * value[j] / unit[j]) for j in range(self.k)]
        rows["given"] += [
            (self.nothing if self.counts(0) else self.tau[0, i] / self.tick.sizes.tau, 0.0) for i in range(self.m)
        ]
        for i in range(self.nodes - 1):
            a, b = self.sdd[i], self.sdd[i + 1]  # linear in between
            s = self.s[i] + h[i] * self.sd[i] + h[i] ** 2 * (a / 3 + b / 6)
            sd = self.sd[i] + h[i] * (a + b) / 2
            rows["position"] += [((s - self.s[i + 1])[j] / self.us[j], 0.0) for j in range(self.k)]
            rows["speed"] += [((sd - self.sd[i + 1])[j] / self.ud[j], 0.0) for j in range(self.k)]
        for i in range(self.nodes):
            left, right = lin.W[i] @ self.tau[i], lin.f[i].copy()
            for by, part, at in zip(lin.slopes[:, i], (self.s, self.sd, self.sdd), lin.at, strict=True):
                left, right = left - by @ part[i], right - by @ at[i]
            left, right = left / self.tick.sizes.row[:, None], right / self.tick.sizes.row
            if i == 0 and 0 in lin.singular and self.given:
                u = lin.lost[0] * self.tick.sizes.row  # that direction, of the rows
                without = np.eye(self.n) - np.outer(u, u) / (u @ u)
                left, right = without @ left, without @ right
            if self.elastic:
                left = left + self.missing[i, : self.n]
            rows["dynamics"] += [(self.counts(i) * a, self.counts(i) * b) for a, b in zip(left, right, strict=True)]
        none = (self.nothing, 0.0)
        rows["before"] = [self.rate(i, (self.sdd[i] - self.sdd[i - 1]) / h[i - 1], 0) for i in range(1, self.nodes)]
        rows["after"] = [self.rate(i, (self.sdd[i + 1] - self.sdd[i]) / h[i], 1) for i in range(self.nodes - 1)]
        jerk = self.tick.jerk
        rows["start"] = [none if jerk is None else self.rate(0, jerk, 0)]
        return rows

    def rate(self, i: int, jerk: Array, side: int) -> tuple[Array, float]:
        """uᵀ Ẇ τ = uᵀ ḟ at a node that is singular, over the size of its left side; the jerk is known, or unknown."""
        lin = self.lin
        if i not in lin.singular or not lin.known[i]:
            return self.nothing, 0.0
        q = lin.singular.tolist().index(i)
        by_s, by_sd, by_sdd, by_jerk = (part[q] for part in lin.slope_rates)
        left = lin.W_rate[q] @ self.tau[i] - by_s @ self.s[i] - by_sd @ self.sd[i] - by_sdd @ self.sdd[i]
        right = lin.f_rate[q] - by_s @ lin.at[0][i] - by_sd @ lin.at[1][i] - by_sdd @ lin.at[2][i]
        if jerk.ndim == 2:
            left = left - by_jerk @ jerk
        else:
            right = right + by_jerk @ jerk
        # a motion that only touches it takes the horizon to change W by a tenth of it
        size = max(np.abs(lin.W_rate[q]).max(), 0.1 * np.abs(lin.W[i]).max() / self.tick.horizon) * self.tick.sizes.tau
        extra = self.missing[i, self.n + side] if self.elastic else 0.0
        return left / size + extra, right / size

    def room(self) -> tuple[Array, Array, Array]:
        """Lowest and highest place, m, and largest speed, m/s, at each node."""
        limits, (s, sd, _) = self.tick.limits, self.tick.first
        low, high, fast = (np.empty((self.nodes, self.k)) for _ in range(3))
        for i in range(self.nodes):
            less = CLOSER * self.gone[i]
            for j in range(self.k):
                low[i, j] = limits.track[j, 0] + less * self.us[j]
                high[i, j] = limits.track[j, 1] - less * self.us[j]
                fast[i, j] = limits.speed[j] * (1.0 - less)
        if not self.elastic:
            return low, high, fast
        h, t = self.h[0], self.lin.nodes - self.lin.nodes[0]
        ends = limits.track
        for j in range(self.k):
            a = min(limits.acceleration[j], 1e3)
            turn = 1.5 * a * h
            # the first step at the speed and s̈ of the start, and braking as hard as it can from that speed on
            moved = h * abs(sd[j]) + h**2 * a / 6.0 + sd[j] ** 2 / (2.0 * a)
            back = turn * t - 0.5 * (0.5 * a) * t**2 + BEYOND
            if s[j] + moved > ends[j, 1]:
                high[:, j] = np.maximum(high[:, j], s[j] + sd[j] * t + back)
            if s[j] - moved < ends[j, 0]:
                low[:, j] = np.minimum(low[:, j], s[j] + sd[j] * t - back)
            if abs(sd[j]) > limits.speed[j]:
                fast[:, j] = np.maximum(fast[:, j], abs(sd[j]) + turn - 0.5 * a * t)
        return low, high, fast

    def inequalities(self) -> dict[str, list[tuple[Array, float, float]]]:
        """Lower bounds, expressions, upper bounds."""
        limits, h, inf, k = self.tick.limits, self.h, np.inf, range(self.k)
        low, high, fast = self.room()
        rows: dict[str, list[tuple[Array, float, float]]] = {}
        ut = self.tick.sizes.tau
        held = [(i, j) for i in range(self.nodes) for j in range(self.m)]
        free = (self.nothing, -inf, inf)
        rows["above"] = [((self.tau[i, j] - self.peak) / ut, -inf, 0.0) if self.counts(i) else free for i, j in held]
        rows["below"] = [((self.tau[i, j] + self.peak) / ut, 0.0, inf) if self.counts(i) else free for i, j in held]
        rows["track"] = [
            # control points of a cubic spline are its values at (t⁻, t, t⁺): its blossom
            ((self.s[i] + (h[i] - h[i - 1]) / 3 * self.sd[i] - h[i] * h[i - 1] / 6 * self.sdd[i])[j] / self.us[j],
             low[i - 1 : i + 2, j].min() / self.us[j], high[i - 1 : i + 2, j].max() / self.us[j])
            for i in range(1, self.nodes - 1) for j in k
        ]  # fmt: skip
        rows["last_track"] = [
            ((self.s[-1] - h[-1] / 3 * self.sd[-1])[j] / self.us[j], low[-2:, j].min() / self.us[j],
             high[-2:, j].max() / self.us[j])
            for j in k
        ]  # fmt: skip
        rows["hull_speed"] = [
            free if i == 0 and self.given else
            ((self.sd[i] + h[i] / 2 * self.sdd[i])[j] / self.ud[j], -fast[i, j] / self.ud[j], fast[i, j] / self.ud[j])
            for i in range(self.nodes - 1) for j in k
        ]  # fmt: skip
        for name, sign in (("stop", 1.0), ("stop_back", -1.0)):
            rows[name] = []
            for j in k:
                # from the largest speed that may occur it takes fastest / 2 a times the speed
                length, a = limits.track[j, 1] - limits.track[j, 0], limits.acceleration[j]
                fastest = min(limits.speed[j], (2.0 * a * length) ** 0.5)
                taken = fastest / (2.0 * a) if np.isfinite([fastest, a]).all() else 0.0
                place = (self.s[-1, j] + sign * taken * self.sd[-1, j]) / self.us[j]
                rows[name].append((place, low[-1, j] / self.us[j], high[-1, j] / self.us[j]))
        if np.isfinite(limits.jerk).any():
            rows["jerk"] = [
                ((self.sdd[i + 1, j] - self.sdd[i, j]) / self.ua[j], -limits.jerk[j] * h[i] / self.ua[j],
                 limits.jerk[j] * h[i] / self.ua[j])
                for i in range(self.nodes - 1) for j in k
            ]  # fmt: skip
        if np.isfinite(limits.carrier_force).any():
            rows["force"] = []
            for i in range(self.nodes):
                for j in k:
                    lin, most = self.lin, limits.carrier_force[j]
                    known = lin.force[i, j] - sum(lin.force_slopes[d, i, j] * lin.at[d][i, j] for d in range(3))
                    parts = (self.s, self.sd, self.sdd)
                    force = sum(lin.force_slopes[d, i, j] * parts[d][i, j] for d in range(3))
                    share = FORCE_KEPT - CLOSER * self.gone[i]
                    counts = lin.known[i] and np.isfinite(most)
                    row = (force / most, -share - known / most, share - known / most)
                    rows["force"].append(row if counts else free)
        return rows

    def bounds(self) -> tuple[Array, Array]:
        """Of each unknown."""
        limits, inf = self.tick.limits, np.inf
        upper = np.full(len(self.nothing), inf)
        fast = self.room()[2]

        def bound(expression: Array, value: float) -> None:
            place = int(np.flatnonzero(expression)[0])
            upper[place] = value / expression[place]

        for i in range(self.nodes):
            for j in range(self.k):
                given = i == 0 and self.given
                bound(self.sdd[i, j], inf if given else limits.acceleration[j] * (1.0 - IN_HAND * self.gone[i]))
            for j in range(self.m):
                bound(self.tau[i, j], limits.effort[j])
        for j in range(self.k):
            bound(self.sd[-1, j], fast[-1, j])
        lower = -upper
        place = int(np.flatnonzero(self.peak)[0])
        lower[place] = self.tick.weights.memory * self.tick.largest / self.tick.sizes.tau
        return lower, upper

    def cost(self) -> tuple[Array, Array]:
        """P and q of ½ xᵀ P x + qᵀ x."""
        w, h, total = self.tick.weights, self.h, self.lin.nodes[-1] - self.lin.nodes[0]
        P, q = np.zeros((len(self.nothing),) * 2), self.nothing.copy()

        def add(weight: float, *expressions: Array) -> None:
            rows = np.reshape(expressions, (-1, len(q)))
            P[:] += 2.0 * weight * rows.T @ rows

        us, ud, ua = (unit[:, None] for unit in (self.us, self.ud, self.ua))
        for i in range(self.nodes):
            share = sum(h[max(i - 1, 0) : i + 1] if i else h[:1]) / (2.0 * total)  # trapezia
            add(w.effort * share, *self.tau[i] / self.tick.sizes.tau)
            add(w.acceleration * share, *self.sdd[i] / ua)
            add(w.centre * share, *self.s[i] / us)
            add(w.missing / 2.0, *self.missing[i])
        for i in range(self.nodes - 1):
            step, horizon = self.tick.step, self.tick.horizon
            add(w.jerk * h[i] / horizon, *((self.sdd[i + 1] - self.sdd[i]) / h[i] / (ua / step)))
        end = max([i for i, known in enumerate(self.lin.known) if known], default=1) or 1
        add(w.end, *self.s[end] / us)
        add(w.end_speed, *self.sd[end] / ud)
        add(w.peak, self.peak / self.tick.sizes.tau)
        for i in range(self.nodes):
            for j in range(self.k):
                unit = np.array([self.us[j], self.ud[j], self.ua[j]])
                H = self.lin.curvature[i, j] * np.outer(unit, unit)
                convex = 0.5 * (H + polar(H)[1])  # (H + |H|) / 2
                x = np.stack([self.s[i, j], self.sd[i, j], self.sdd[i, j]]) / unit[:, None]
                at = np.array([part[i, j] for part in self.lin.at]) / unit
                P += x.T @ convex @ x
                q -= x.T @ convex @ at
        return P, q


@dataclass(frozen=True, eq=False)
class Solution:
    """The optimum: ``cost``; ``at``: s, ṡ and s̈ (N, k); ``tau`` (N, m), N or N·m; ``multipliers`` (N, n) of W τ = f."""

    cost: float
    at: tuple[Array, Array, Array]
    tau: Array
    multipliers: Array


class Judge:
    """Costs of plans of one programme, by how much they miss its rows, and its optimum."""

    def __init__(self, problem: Problem) -> None:
        self.problem, self.written = problem, Written(problem)
        rows = self.written.equations()
        starts = {name: sum(len(part) for part in list(rows.values())[:i]) for i, name in enumerate(rows)}
        self.dynamics = slice(starts["dynamics"], starts["dynamics"] + len(rows["dynamics"]))
        pairs = [pair for part in rows.values() for pair in part]
        self.A, self.b = np.array([row for row, _ in pairs]), np.array([value for _, value in pairs])
        limited = [row for part in self.written.inequalities().values() for row in part]
        limited = [row for row in limited if np.isfinite(row[1:]).any()]
        self.G, self.low, self.high = (np.array([row[i] for row in limited]) for i in range(3))
        lower, upper = self.written.bounds()
        self.lower, self.upper = np.maximum(lower, -1e30), np.minimum(upper, 1e30)
        self.P, self.q = self.written.cost()
        self.P += REGULAR * np.eye(len(self.q))

    def unknowns(self, at: tuple[Array, ...], tau: Array) -> Array:
        """Return the unknowns, in units, of a motion (three (N, k)) and efforts (N, m), what is missing included."""
        w, problem = self.written, self.problem
        x = np.zeros(len(self.q))
        for expression, values in ((w.s, at[0]), (w.sd, at[1]), (w.sdd, at[2]), (w.tau, tau)):
            places = np.abs(expression).argmax(axis=2)
            x[places] = values / np.take_along_axis(expression, places[..., None], axis=2)[..., 0]
        x[np.abs(w.tau).argmax(axis=2)[~problem.counts]] = 0.0
        ut = problem.sizes.tau
        x[-1] = max(np.abs(tau[problem.counts]).max(initial=0.0), problem.weights.memory * problem.largest) / ut
        if problem.relaxed:
            left = self.b - self.A @ x
            for row in np.flatnonzero(np.abs(self.A[:, w.missing.argmax(axis=2).ravel()]).any(axis=1)):
                own = w.missing.argmax(axis=2).ravel()
                x[own[self.A[row, own] != 0.0]] = left[row]
        return x

    def efforts(self, at: tuple[Array, ...], tau: Array) -> Array:
        """Return the efforts (N, m) nearest to some that W τ = f, linear as it is here, asks for with a motion."""
        w, problem, x = self.written, self.problem, self.unknowns(at, tau)
        places = np.abs(w.tau).argmax(axis=2)[problem.counts].ravel()
        rows = self.A[:, places]
        if problem.relaxed or not len(places):
            return tau
        x[places] += np.linalg.lstsq(rows, self.b - self.A @ x, rcond=1e-9)[0]
        return w.tau @ x

    def cost(self, x: Array) -> float:
        """Return the cost of unknowns."""
        return float(0.5 * x @ self.P @ x + self.q @ x)

    def missed(self, x: Array) -> tuple[float, float]:
        """Return by how much unknowns, which are all of size one, miss equations, and bounds."""
        beyond = (self.G @ x - self.high, self.low - self.G @ x, x - self.upper, self.lower - x)
        return float(np.abs(self.A @ x - self.b).max()), float(max(part.max() for part in beyond))

    def solve(self) -> Solution | None:
        """Return the optimum by DAQP; None where it finds none."""
        Q, R, order = qr(self.A.T, pivoting=True)
        size = np.abs(np.diag(R))
        rank = int((size > 1e-11 * size[0]).sum())
        x0 = Q[:, :rank] @ np.linalg.solve(R[:rank, :rank].T, self.b[order[:rank]])
        Z = np.ascontiguousarray(Q[:, rank:])
        H, rows = Z.T @ self.P @ Z, np.vstack([self.G @ Z, Z])
        shift = np.concatenate([self.G @ x0, x0])
        least, most = np.concatenate([self.low, self.lower]) - shift, np.concatenate([self.high, self.upper]) - shift
        bounded = (np.abs(rows).max(axis=1) > 1e-12) & ((least > -1e20) | (most < 1e20))
        least, most = np.maximum(least, -1e30)[bounded], np.minimum(most, 1e30)[bounded]
        rows, slope = np.ascontiguousarray(rows[bounded]), Z.T @ (self.P @ x0 + self.q)
        sense = np.zeros(len(rows), dtype=np.int32)
        z, _, flag, info = daqp.solve(
            0.5 * (H + H.T), slope, rows, most, least, sense, primal_tol=1e-10, dual_tol=1e-12
        )
        if flag < 1:
            return None
        x = x0 + Z @ z
        force = np.zeros(len(bounded))
        force[bounded] = info["lam"]
        gradient = self.P @ x + self.q + np.vstack([self.G, np.eye(len(x))]).T @ force
        y = np.zeros(len(self.b))
        y[order[:rank]] = np.linalg.solve(R[:rank, :rank], -Q[:, :rank].T @ gradient)
        w, problem = self.written, self.problem
        at = tuple(part @ x for part in (w.s, w.sd, w.sdd))
        multipliers = y[self.dynamics].reshape(problem.lin.f.shape) / problem.sizes.row
        return Solution(self.cost(x), (at[0], at[1], at[2]), w.tau @ x, multipliers)


@dataclass(frozen=True, eq=False)
class Asked:
    """What an update was asked for, and its plan.

    ``last``: the plan before, None before a first one; ``made``: that of the update; ``given``: (k,) measured s and ṡ
    of the carriers, m and m/s, None where those of the last plan count; ``largest``: |τ| before the update.
    """

    planner: RecedingHorizon
    last: UpdatePlan | None
    made: UpdatePlan
    given: tuple[Array | None, ...]
    largest: float

    def problem(self, about: tuple[Array, ...], multipliers: Array, *, relaxed: bool) -> Problem:
        """Return a programme at the nodes of the plan, linear about a motion, three (N, k), and multipliers (N, n)."""
        planner, nodes, t = self.planner, self.made.nodes, self.made.command.t
        ahead, made, jerk = Ahead(planner.dynamics, planner._preview), self.made, None
        tau = made.tau
        if self.last is not None:
            tau *= min(max(self.last.command.peak / tau, SMALLEST), 1.0)
            carriers = self.last.command.carriers
            piece = max(int(np.searchsorted(carriers.edges, nodes[0])) - 1, 0)
            jerk = 6.0 * carriers.coefficients[-4, min(piece, len(carriers.edges) - 2)]
        until = min(t + planner.horizon, ahead.preview.end)
        lin = linearised(ahead, nodes, np.flatnonzero(np.isin(nodes, planner.updates.roots)), about, multipliers, until)
        return Problem(
            lin, planner.resolved, planner.weights, Sizes(tau, made.row), self.first, self.last is None, jerk,
            planner.step, planner.horizon, self.largest, relaxed,
        )  # fmt: skip

    @property
    def first(self) -> tuple[Array, ...]:
        """Where the plan begins: s, ṡ and s̈ (k,)."""
        planner, k, t = self.planner, self.planner.robot.k, self.made.command.t
        if self.last is None:
            return *(np.zeros(k) if part is None else part for part in self.given), np.zeros(k)
        own = [part[0] for part in extended(self.last.command.carriers, self.made.nodes[:1])]
        coming = planner.updates.roots[planner.updates.roots > t - SAME]
        settled = len(coming) and coming[0] <= t + SETTLED * planner.step
        pairs = zip(self.given, own[:2], strict=True)
        return *(planned if part is None or settled else part for part, planned in pairs), own[2]

    def begins_about(self) -> tuple[tuple[Array, ...], Array]:
        """Return what its first programme is linear about: the last plan, with multipliers of the nodes of both."""
        nodes, last = self.made.nodes, self.last
        multipliers = np.zeros((len(nodes), self.planner.robot.n))
        if last is None:
            return tuple(np.tile(part, (len(nodes), 1)) for part in self.first), multipliers
        for i, node in enumerate(nodes):
            for j in np.flatnonzero(np.abs(last.nodes - node) <= SAME):
                multipliers[i] = last.multipliers[j]
        again = last.command.t == self.made.command.t and np.array_equal(last.nodes, nodes)
        return last.at if again else extended(last.command.carriers, nodes), multipliers

    def solve(self) -> tuple[Judge, Solution]:
        """Return the last one of as many programmes as the update had, each about the solution of the one before."""
        about, multipliers = self.begins_about()
        beyond = is_beyond(self.planner.resolved, self.first)
        for _ in range(self.made.rounds):
            judge = Judge(self.problem(about, multipliers, relaxed=False))
            best = None if beyond else judge.solve()
            if best is None:
                judge = Judge(self.problem(about, multipliers, relaxed=True))
                best = judge.solve()
            assert best is not None
            about, multipliers = best.at, best.multipliers
        return judge, best


def is_beyond(limits: ResolvedLimits, first: tuple[Array, ...]) -> bool:
    """Return whether a start is beyond limits by more than rounding, so that no plan keeps them."""
    s, sd, _ = first
    outside = (s < limits.track[:, 0] - BEYOND) | (s > limits.track[:, 1] + BEYOND)
    return bool((outside | (np.abs(sd) > limits.speed + BEYOND)).any())
