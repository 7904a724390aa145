"""All numbers of a tick's programme against a dense one that is written out node by node, in units: random ticks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest
from scipy.linalg import polar

from redundancy_pin.arrays import Array
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.receding_horizon import Weights
from redundancy_pin.planners.receding_horizon.ahead import Linearised
from redundancy_pin.planners.receding_horizon.programme import (
    INFINITE,
    Programme,
    TickProblem,
    TickScales,
    units_of,
)

pytest.importorskip("piqp")

CLOSER, IN_HAND, FORCE_KEPT, BEYOND = 1e-5, 0.1, 0.98, 1e-6
"""What the module's constants say: of the limits at the end of the horizon, of forces between the nodes, m."""

REGULAR = 1e-7
"""Each unknown has a cost, so that it is decided; not more than this part of one of the others."""

WEIGHTS = Weights(0.11, 0.7, 0.8, 0.13, 0.31, 0.17, 0.23, 0.19, 2e4)
NODES = 8


@dataclass(frozen=True)
class Kind:
    """What a random tick is like.

    ``known``: nodes from which on the motion is not known; ``outside``: carriers begin beyond limits; ``open``: there
    is no limit of each kind for some; ``short``: no carrier gets to its speed limit on its track.
    """

    n: int = 2
    m: int = 2
    k: int = 2
    free: bool = False
    elastic: bool = False
    singular: tuple[int, ...] = ()
    known: int = NODES
    jerk: bool = True
    outside: bool = False
    open: bool = False
    short: bool = False


KINDS = {
    "first tick": Kind(free=True, jerk=False),
    "on the way": Kind(),
    "crossings ahead": Kind(singular=(2, 5)),
    "from a crossing on": Kind(singular=(0, 3)),
    "begins at a crossing": Kind(singular=(0,), free=True, jerk=False),
    "a jerk that is not known": Kind(singular=(0,), jerk=False),
    "ends at a crossing": Kind(singular=(1, NODES - 1)),
    "preview ends": Kind(singular=(2, 5), known=5),
    "elastic": Kind(elastic=True, singular=(0, 4)),
    "elastic, first tick": Kind(elastic=True, free=True, jerk=False, singular=(3,)),
    "elastic, beyond limits": Kind(elastic=True, outside=True),
    "elastic, beyond limits at first": Kind(elastic=True, outside=True, free=True, jerk=False),
    "three coordinates": Kind(n=3, m=3, k=1, singular=(0, 4), elastic=True),
    "more motors": Kind(n=2, m=4, k=3, known=6),
    "short tracks": Kind(short=True),
    "limits left out": Kind(open=True, singular=(3,)),
    "limits left out, elastic": Kind(open=True, elastic=True, outside=True),
}


def random_tick(kind: Kind, seed: int) -> TickProblem:
    """A tick of random numbers: nothing of it needs to be a machine's."""
    rng = np.random.default_rng([seed, kind.n, kind.m, kind.k])
    n, m, k, q = kind.n, kind.m, kind.k, len(kind.singular)

    def within(*shape: int) -> Array:
        return rng.uniform(-1.0, 1.0, shape)

    def about(size: float, count: int) -> Array:
        return size * rng.uniform(0.5, 2.0, count)

    track = np.stack([-about(0.2, k), about(0.2, k)], axis=1) + 0.1
    limits = ResolvedLimits(
        tuple("abc"[:k]), track, about(1.0, k), about(9.0, k), about(30.0, k), about(400.0, k), about(40.0, m),
        np.full(m, np.inf),
    )  # fmt: skip
    if kind.short:
        limits = replace(limits, speed=9.0 * limits.speed)
    if kind.open:  # of each kind at one carrier, and one side of a track
        spoilt = {name: getattr(limits, name).copy() for name in LIMITS}
        spoilt["track"][0, 1] = spoilt["speed"][1] = spoilt["acceleration"][1] = np.inf
        spoilt["jerk"][0] = spoilt["carrier_force"][1] = spoilt["effort"][0] = np.inf
        limits = replace(limits, **spoilt)
    nodes = 3.0 + np.concatenate([[0.0], np.cumsum(about(0.02, NODES - 1))])
    halves = within(NODES, k, 3, 3) * [0.1, 0.3, 0.5]
    lin = Linearised(
        nodes, np.array(kind.singular, dtype=int), np.arange(NODES) < kind.known,
        tuple(size * within(NODES, k) for size in (0.1, 0.5, 5.0)), within(NODES, n, m), 3.0 * within(NODES, n),
        within(3, NODES, n, k), 9.0 * within(NODES, k), within(3, NODES, k), within(q, n),
        # where the motion only touches the singularity W hardly changes
        within(q, m) * np.where(np.arange(q) % 2, 1e-3, 9.0)[:, None], 5.0 * within(q),
        tuple(within(q, k) for _ in range(4)), halves + halves.swapaxes(2, 3), about(0.5, n), float(nodes[-1]),
    )  # fmt: skip
    speed, place = 0.9 * limits.speed, 0.5 * track.sum(axis=1) + 0.1 * within(k) * np.diff(track)[:, 0]
    sd = np.where(np.isfinite(speed), speed, 1.0) * 0.05 * within(k)
    if kind.outside:  # one at its upper end, one too fast towards the lower one, another well within
        place[0], sd[0] = track[0, 1] - 1e-3, 0.5
        sd[1] = -1.3 * (speed[1] if np.isfinite(speed[1]) else 1.0)
    first = place, sd, 3.0 * within(k)
    jerk = 90.0 * within(k) if kind.jerk else None
    sizes = TickScales(float(about(2.0, 1)[0]), about(3.0, n))
    return TickProblem(lin, limits, WEIGHTS, sizes, first, kind.free, jerk, 0.02, 0.4, 7.0)


LIMITS = ("track", "speed", "acceleration", "jerk", "carrier_force", "effort")


class Written:
    """A tick's programme written out. Expressions of unknowns in units are rows of as many numbers as unknowns."""

    def __init__(self, tick: TickProblem, programme: Programme) -> None:
        self.tick, self.lin, self.elastic = tick, tick.lin, programme.elastic
        limits = tick.limits
        self.n, self.m, self.k = tick.lin.f.shape[1], tick.lin.W.shape[2], len(limits.speed)
        one = np.eye(programme.variables)
        width = limits.track[:, 1] - limits.track[:, 0]
        self.us = np.array([0.5 * w if np.isfinite(w) else 1.0 for w in width])
        self.ud = np.array([v if np.isfinite(v) else 1.0 for v in limits.speed])
        self.ua = np.array([a if np.isfinite(a) else 10.0 for a in limits.acceleration])
        self.s, self.sd, self.sdd = (
            one[places] * unit[:, None]
            for places, unit in zip(
                (programme.s, programme.sd, programme.sdd), (self.us, self.ud, self.ua), strict=True
            )
        )
        self.tau, self.peak = one[programme.tau] * tick.sizes.tau, one[programme.peak] * tick.sizes.tau
        self.missing = one[programme.missing]
        self.h = np.diff(tick.lin.nodes)
        self.gone = (tick.lin.nodes - tick.lin.nodes[0]) / (tick.lin.nodes[-1] - tick.lin.nodes[0])
        self.given = not tick.free
        self.nothing = np.zeros(programme.variables)

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
        for i in range(NODES - 1):
            a, b = self.sdd[i], self.sdd[i + 1]  # linear in between
            s = self.s[i] + h[i] * self.sd[i] + h[i] ** 2 * (a / 3 + b / 6)
            sd = self.sd[i] + h[i] * (a + b) / 2
            rows["position"] += [((s - self.s[i + 1])[j] / self.us[j], 0.0) for j in range(self.k)]
            rows["speed"] += [((sd - self.sd[i + 1])[j] / self.ud[j], 0.0) for j in range(self.k)]
        for i in range(NODES):
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
        rows["before"] = [self.rate(i, (self.sdd[i] - self.sdd[i - 1]) / h[i - 1], 0) for i in range(1, NODES)]
        rows["after"] = [self.rate(i, (self.sdd[i + 1] - self.sdd[i]) / h[i], 1) for i in range(NODES - 1)]
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
        low, high, fast = (np.empty((NODES, self.k)) for _ in range(3))
        for i in range(NODES):
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
        held = [(i, j) for i in range(NODES) for j in range(self.m)]
        free = (self.nothing, -inf, inf)
        rows["above"] = [((self.tau[i, j] - self.peak) / ut, -inf, 0.0) if self.counts(i) else free for i, j in held]
        rows["below"] = [((self.tau[i, j] + self.peak) / ut, 0.0, inf) if self.counts(i) else free for i, j in held]
        rows["track"] = [
            # control points of a cubic spline are its values at (t⁻, t, t⁺): its blossom
            ((self.s[i] + (h[i] - h[i - 1]) / 3 * self.sd[i] - h[i] * h[i - 1] / 6 * self.sdd[i])[j] / self.us[j],
             low[i - 1 : i + 2, j].min() / self.us[j], high[i - 1 : i + 2, j].max() / self.us[j])
            for i in range(1, NODES - 1) for j in k
        ]  # fmt: skip
        rows["last_track"] = [
            ((self.s[-1] - h[-1] / 3 * self.sd[-1])[j] / self.us[j], low[-2:, j].min() / self.us[j],
             high[-2:, j].max() / self.us[j])
            for j in k
        ]  # fmt: skip
        rows["hull_speed"] = [
            free if i == 0 and self.given else
            ((self.sd[i] + h[i] / 2 * self.sdd[i])[j] / self.ud[j], -fast[i, j] / self.ud[j], fast[i, j] / self.ud[j])
            for i in range(NODES - 1) for j in k
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
                for i in range(NODES - 1) for j in k
            ]  # fmt: skip
        if np.isfinite(limits.carrier_force).any():
            rows["force"] = []
            for i in range(NODES):
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

        for i in range(NODES):
            for j in range(self.k):
                given = i == 0 and self.given
                bound(self.sdd[i, j], inf if given else limits.acceleration[j] * (1.0 - IN_HAND * self.gone[i]))
            for j in range(self.m):
                bound(self.tau[i, j], limits.effort[j])
        for j in range(self.k):
            bound(self.sd[-1, j], fast[-1, j])
        lower = -upper
        place = int(np.flatnonzero(self.peak)[0])
        lower[place] = WEIGHTS.memory * self.tick.largest / self.tick.sizes.tau
        return lower, upper

    def cost(self) -> tuple[Array, Array]:
        """P and q of ½ xᵀ P x + qᵀ x."""
        w, h, total = self.tick.weights, self.h, self.lin.nodes[-1] - self.lin.nodes[0]
        P, q = np.zeros((len(self.nothing),) * 2), self.nothing.copy()

        def add(weight: float, *expressions: Array) -> None:
            for e in expressions:
                P[:] += 2.0 * weight * np.outer(e, e)

        us, ud, ua = (unit[:, None] for unit in (self.us, self.ud, self.ua))
        for i in range(NODES):
            share = sum(h[max(i - 1, 0) : i + 1] if i else h[:1]) / (2.0 * total)  # trapezia
            add(w.effort * share, *self.tau[i] / self.tick.sizes.tau)
            add(w.acceleration * share, *self.sdd[i] / ua)
            add(w.centre * share, *self.s[i] / us)
            add(w.missing / 2.0, *self.missing[i])
        for i in range(NODES - 1):
            step, horizon = self.tick.step, self.tick.horizon
            add(w.jerk * h[i] / horizon, *((self.sdd[i + 1] - self.sdd[i]) / h[i] / (ua / step)))
        end = max([i for i, known in enumerate(self.lin.known) if known], default=1) or 1
        add(w.end, *self.s[end] / us)
        add(w.end_speed, *self.sd[end] / ud)
        add(w.peak, self.peak / self.tick.sizes.tau)
        for i in range(NODES):
            for j in range(self.k):
                unit = np.array([self.us[j], self.ud[j], self.ua[j]])
                H = self.lin.curvature[i, j] * np.outer(unit, unit)
                convex = 0.5 * (H + polar(H)[1])  # (H + |H|) / 2
                x = np.stack([self.s[i, j], self.sd[i, j], self.sdd[i, j]]) / unit[:, None]
                at = np.array([part[i, j] for part in self.lin.at]) / unit
                P += x.T @ convex @ x
                q -= x.T @ convex @ at
        return P, q


def dense(part: Any) -> Array:
    return np.array(part.toarray() if hasattr(part, "toarray") else part)


@pytest.mark.parametrize("kind", [pytest.param(kind, id=name) for name, kind in KINDS.items()])
@pytest.mark.parametrize("seed", [1, 2])
def test_numbers_are_those_of_the_programme_written_out(kind: Kind, seed: int) -> None:
    tick = random_tick(kind, seed)
    programme = Programme(kind.n, kind.m, kind.k, NODES - 1, tick.limits, kind.elastic)
    P, q, A, b, G, least, most, lower, upper = (dense(part) for part in programme.numbers_of(tick))
    written = Written(tick, programme)
    # each unknown has one place
    groups = (programme.s, programme.sd, programme.sdd, programme.tau, programme.missing, np.array(programme.peak))
    assert sorted(np.concatenate([group.ravel() for group in groups]).tolist()) == list(range(programme.variables))
    near = {"rtol": 1e-9, "atol": 1e-10}
    expected = written.equations()
    assert list(expected) == list(programme.equal.blocks)
    for name, rows in expected.items():
        at = programme.equal.rows(name)
        np.testing.assert_allclose(A[at], np.array([row for row, _ in rows]), err_msg=name, **near)
        np.testing.assert_allclose(b[at], [value for _, value in rows], err_msg=name, **near)
    assert len(b) == sum(map(len, expected.values()))
    limited = written.inequalities()
    assert list(limited) == list(programme.within.blocks)
    for name, limited_rows in limited.items():
        at = programme.within.rows(name)
        for row, low, high, (wanted, lowest, highest) in zip(G[at], least[at], most[at], limited_rows, strict=True):
            if np.isinf([lowest, highest]).all():  # holds nothing, and the solver can have it
                assert not row.any()
                assert (low, high) in ((-1.0, 1.0), (-INFINITE, 1.0), (-1.0, INFINITE))
                continue
            np.testing.assert_allclose(row, wanted, err_msg=name, **near)
            ends = np.maximum(lowest, -INFINITE), np.minimum(highest, INFINITE)
            np.testing.assert_allclose((low, high), ends, err_msg=name, **near)
    assert len(least) == sum(map(len, limited.values()))
    for found, bound in zip((lower, upper), written.bounds(), strict=True):
        np.testing.assert_allclose(found, np.clip(bound, -INFINITE, INFINITE), **near)
    cost, slope = written.cost()
    np.testing.assert_allclose(P, cost, rtol=1e-9, atol=REGULAR)
    np.testing.assert_allclose(q, slope, rtol=1e-9, atol=REGULAR)
    assert np.diag(P).min() > 0.0


def test_sizes_are_those_of_what_is_known_of_f_and_of_the_gain_of_the_motors() -> None:
    lin = random_tick(Kind(n=3, m=3, known=5), 4).lin
    scaled = [(lin.W[i] / lin.row_scale[:, None], lin.f[i] / lin.row_scale) for i in range(5)]
    asked = max(np.abs(f).max() for _, f in scaled)
    gain = np.median([np.linalg.svd(W)[1][0] for W, _ in scaled])
    sizes = TickScales.of(lin)
    np.testing.assert_allclose((sizes.tau, *sizes.row), (asked / gain, *asked * lin.row_scale), rtol=1e-12)
    # where the platform rests a tenth of what a carrier asks for that is accelerated by 1 m/s², however far ahead
    rests = replace(lin, f=0.0 * lin.f)
    sizes = TickScales.of(rests)
    asked = 0.1 * np.abs(lin.slopes[2]).max()
    np.testing.assert_allclose((sizes.tau, *sizes.row), (asked / gain, *asked * lin.row_scale), rtol=1e-12)
    # nothing known, nothing asked for: sizes all the same
    sizes = TickScales.of(replace(rests, known=np.zeros(NODES, dtype=bool), slopes=0.0 * lin.slopes))
    np.testing.assert_allclose((sizes.tau, *sizes.row), (1e-6, *1e-6 * lin.row_scale), rtol=1e-12)


def test_units_where_there_is_no_limit() -> None:
    limits = random_tick(Kind(k=1), 1).limits
    none = replace(limits, track=np.array([[-np.inf, 0.3]]), speed=np.array([np.inf]), acceleration=np.array([np.inf]))
    assert [unit.tolist() for unit in units_of(none)] == [[1.0], [1.0], [10.0]]


class Solver:
    """In place of the solver: answers as told, and counts what it is asked."""

    asked: ClassVar[list[str]] = []

    def __init__(self, answer: dict[str, float], solved: bool, x: Array, y: Array) -> None:
        self.solved, self.result = solved, SimpleNamespace(x=x, y=y, info=SimpleNamespace(**answer))

    def setup(self, *numbers: Any) -> None:
        self.asked.append("setup")

    def update(self, *numbers: Any) -> None:
        self.asked.append("update")

    def solve(self) -> Any:
        import piqp

        return piqp.PIQP_SOLVED if self.solved else piqp.PIQP_MAX_ITER_REACHED


EXACT = {"primal_res": 0.0, "dual_res": 0.0, "duality_gap_rel": 0.0}


@pytest.mark.parametrize(
    ("answer", "solved", "taken"),
    [
        ({"primal_res": 1.0}, True, True),
        ({"primal_res": 0.7e-6}, False, True),
        ({"primal_res": 1.4e-6}, False, False),
        ({"primal_res": 0.7e-6, "dual_res": 0.7e-4}, False, True),
        ({"dual_res": 1.4e-4}, False, False),
        ({"duality_gap_rel": 0.7e-4}, False, True),
        ({"duality_gap_rel": 1.4e-4}, False, False),
    ],
)
def test_an_answer_counts_where_the_solver_says_so_or_comes_near(
    monkeypatch: pytest.MonkeyPatch, answer: dict[str, float], solved: bool, taken: bool
) -> None:
    """To a millionth of the equations, and a hundred times that of the cost."""
    tick = random_tick(Kind(n=3, m=3), 1)
    programme = Programme(3, 3, 2, NODES - 1, tick.limits, False)
    x, y = (
        np.random.default_rng(2).uniform(-1.0, 1.0, size)
        for size in (programme.variables, programme.equal.matrix.shape[0])
    )
    tried: list[float] = []

    def new(relative: float) -> Solver:
        tried.append(relative)
        return Solver({**EXACT, **answer}, solved, x, y)

    monkeypatch.setattr(programme, "new_solver", new)
    monkeypatch.setattr(Solver, "asked", [])
    found = programme.solve(tick)
    assert (found is not None) == taken
    if found is None:
        assert len(tried) == 2
        assert tried[0] < tried[1]  # less is asked of the second one
    again = programme.solve(tick)
    assert (again is None) == (found is None)
    # one that has answered goes on with new numbers; one that has not is set up anew
    assert Solver.asked == (["setup", "update"] if taken else ["setup"] * 4)
    if found is not None:
        np.testing.assert_array_equal(found[0], x)
        # multipliers are of the rows, which are over their sizes
        rows = y[programme.equal.rows("dynamics")].reshape(NODES, 3)
        np.testing.assert_allclose(found[1], rows / tick.sizes.row)


def test_an_answer_that_is_no_number_is_none(monkeypatch: pytest.MonkeyPatch) -> None:
    tick = random_tick(Kind(), 1)
    programme = Programme(2, 2, 2, NODES - 1, tick.limits, False)
    x, y = np.full(programme.variables, np.nan), np.zeros(programme.equal.matrix.shape[0])
    monkeypatch.setattr(programme, "new_solver", lambda relative: Solver(EXACT, True, x, y))
    assert programme.solve(tick) is None
