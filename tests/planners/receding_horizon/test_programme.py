"""The programme of a tick as a whole: each row and the cost at random plans, by the other backend and by formulas."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import BPoly, PPoly, make_interp_spline
from scipy.linalg import polar

import redundancy_pin as rp
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon, Weights
from redundancy_pin.planners.receding_horizon.ahead import Ahead, Linearised
from redundancy_pin.planners.receding_horizon.command import Command
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.planners.receding_horizon.programme import (
    CLOSER,
    FORCE_KEPT,
    Programme,
    TickProblem,
    TickScales,
    units_of,
)
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import circle_path

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
ROBOT = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}

TRACK = np.array([(-0.15, 0.2), (-0.2, 0.17)])
LIMITS = Limits(
    TRACK, speed=(0.9, 1.1), acceleration=(9.0, 11.0), jerk=(400.0, 500.0), carrier_force=(30.0, 35.0),
    effort=(40.0, 50.0),
)  # fmt: skip
WEIGHTS = Weights(0.11, 0.7, 0.8, 0.13, 0.31, 0.17, 0.23, 0.19, 2e4)
"""All different, so that none passes for another."""

PLANS = 5

FAR = 50.0
"""Unknowns are of size one: a bound with so much room holds nothing."""


@cache
def other() -> rp.VirtualWork:
    return rp.VirtualWork(rp.load_robot("2rpr", **ROBOT))


@cache
def updates() -> tuple[RecedingHorizon, list[TickProblem], list[tuple[float, int, Command]]]:
    """The planner, what it solved, and of each tick the time, how much had been solved before, and what came of it."""
    seen, made, solve = [], [], Programme.solve
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Programme, "solve", lambda self, problem: seen.append(problem) or solve(self, problem))
        dynamics = rp.CompiledDynamics(rp.load_robot("2rpr", **ROBOT))
        planner = RecedingHorizon(dynamics, objective=WEIGHTS, limits=LIMITS, interpret=True)
        crossing = rp.find_crossings(dynamics.robot, ACROSS)[0].t
        for t in (*np.arange(0.0, crossing - 0.01, 0.02), crossing - 0.003):
            before = len(seen)
            made.append((t, before, planner.update(t, ACROSS)))
    return planner, seen, made


@cache
def ticks() -> dict[str, tuple[RecedingHorizon, TickProblem]]:
    """The first tick, the second round of it, one on the way, and one that begins at a singular instant."""
    planner, seen, _ = updates()
    assert seen[0].free
    assert not seen[0].lin.curvature.any()
    assert seen[1].lin.curvature.any()
    assert seen[-1].lin.singular[0] == 0
    cases = {"first": seen[0], "second round": seen[1], "on the way": seen[6], "begins there": seen[-1]}
    return {name: (planner, problem) for name, problem in cases.items()}


def test_a_tick_goes_on_from_the_jerk_of_the_plan_before_it() -> None:
    _, seen, made = updates()
    assert seen[0].jerk is None
    for (_, _, last), (t, before, _), (_, after, _) in zip(
        made, made[1:], [*made[2:], (0.0, len(seen), None)], strict=False
    ):
        assert after > before
        for problem in seen[before:after]:
            expected = last.carriers.derivative(3)(np.array([t]), "left")[0]
            np.testing.assert_allclose(problem.jerk, expected, atol=1e-9 * LIMITS.jerk[0])


class Rows:
    """The numbers of a tick's programme, dense, and the blocks of its rows."""

    def __init__(self, planner: RecedingHorizon, tick: TickProblem, elastic: bool = False) -> None:
        self.tick, self.lin, self.programme = tick, tick.lin, planner.ticks.programme(elastic)
        values = self.programme.numbers_of(tick)
        self.P, self.q, self.A, self.b, self.G, self.low, self.high, self.lower, self.upper = (
            np.array(part.todense() if hasattr(part, "todense") else part) for part in values
        )
        self.units = units_of(tick.limits)
        lin, rng = tick.lin, np.random.default_rng(5)
        self.plans, self.splines = [], []
        for _ in range(PLANS):
            changes = [size * rng.uniform(-1.0, 1.0, lin.at[0].shape) for size in (0.02, 0.2, 2.0)]
            self._add(self.plans, rng, [own + change for own, change in zip(lin.at, changes, strict=True)])
            ends = [(1, rng.uniform(-0.3, 0.3, 2)), (1, rng.uniform(-0.3, 0.3, 2))]
            spline = make_interp_spline(lin.nodes, 0.1 * changes[0] / 0.02, 3, bc_type=([ends[0]], [ends[1]]))
            self._add(
                self.splines, rng, [spline.derivative(i)(lin.nodes) if i else spline(lin.nodes) for i in range(3)]
            )
            self.splines[-1] = (*self.splines[-1], spline.c)

    def _add(self, plans, rng, motion):
        p = self.programme
        tau, peak = 5.0 * rng.uniform(-1.0, 1.0, (len(self.lin.nodes), 2)), 5.0 * rng.random()
        x = np.zeros(p.variables)
        for place, part, unit in zip((p.s, p.sd, p.sdd), motion, self.units, strict=True):
            x[place] = part / unit
        x[p.tau], x[p.peak] = tau / self.tick.sizes.tau, peak / self.tick.sizes.tau
        plans.append((x, *motion, tau, peak))

    def block(self, name):
        """The numbers of the rows of a block."""
        for rows in (self.programme.equal, self.programme.within):
            before = 0
            for other, count in rows.blocks.items():
                if other == name:
                    return slice(before, before + count)
                before += count
        raise KeyError(name)

    def left(self, name):
        """What is left of each equation of a block at each plan, (plans, rows)."""
        rows = self.block(name)
        return np.array([self.A[rows] @ plan[0] - self.b[rows] for plan in self.plans])

    def room(self, name, plans):
        """The room below the upper and above the lower bound of each row of a block at each plan, (2, plans, rows)."""
        rows = self.block(name)
        value = np.array([self.G[rows] @ plan[0] for plan in plans])
        return np.array([self.high[rows] - value, value - self.low[rows]])

    def pieces(self, plan):
        """Position and speed of the carriers from a node to the next by the values at the first, as Bézier points.

        (4, steps, k) and (3, steps, k): s̈ is linear in between.
        """
        _, s, sd, sdd, *_ = plan
        h = np.diff(self.lin.nodes)[:, None]
        powers = np.array([np.diff(sdd, axis=0) / h / 6.0, sdd[:-1] / 2.0, sd[:-1], s[:-1]])
        # one polynomial after the other, each from its own beginning
        curve = PPoly(powers, self.lin.nodes)
        return BPoly.from_power_basis(curve).c, BPoly.from_power_basis(curve.derivative()).c

    def f(self, places, motion, t=0.0, what="f"):
        """What the other backend makes of a motion of the carriers, at nodes or beside them."""
        carriers = rp.CarrierMotion(*motion, check_rates=False)
        return getattr(other().reduce(ACROSS.sample_at(self.lin.nodes[places] + t), carriers, check_track=False), what)

    def linear(self, plan, what):
        """The same at the nodes, linear about the last plan: quadratic terms cancel."""
        at, every = self.lin.at, slice(None)
        change = [1e-2 * (new - old) for new, old in zip(plan[1:4], at, strict=True)]
        ends = [self.f(every, [a + sign * c for a, c in zip(at, change, strict=True)], 0.0, what) for sign in (1, -1)]
        return self.f(every, at, 0.0, what) + (ends[0] - ends[1]) / 2e-2

    def rate(self, index, plan, jerk):
        """uᵀ Ẇ τ − uᵀ ḟ at a singular instant, ḟ linear about the last plan, by differences of the other backend."""
        q = self.lin.singular[index]
        at = [*(part[q] for part in self.lin.at), np.zeros(2)]
        change = [1e-2 * (new - old) for new, old in zip([*(part[q] for part in plan[1:4]), jerk], at, strict=True)]
        u, h = self.lin.lost[index], 1e-4

        def slope(sign):
            s, sd, sdd, sddd = (a + sign * c for a, c in zip(at, change, strict=True))
            ends = []
            for t in (h, -h):
                motion = s + t * sd + t**2 / 2 * sdd + t**3 / 6 * sddd, sd + t * sdd + t**2 / 2 * sddd, sdd + t * sddd
                ends.append(u @ self.f([q], [part[None] for part in motion], t)[0])
            return (ends[0] - ends[1]) / (2.0 * h)

        nothing = [np.zeros((1, 2))] * 3
        W = [u @ self.f([q], nothing, t, "W")[0] for t in (h, -h)]
        return (W[0] - W[1]) / (2.0 * h) @ plan[4][q] - slope(0.0) - (slope(1.0) - slope(-1.0)) / 2e-2


def assert_multiples(rows, expected, tolerance=1e-9):
    """Each column is a positive multiple of what is expected: a row may be divided by a size."""
    size = np.linalg.norm(rows, axis=0) / np.linalg.norm(expected, axis=0)
    assert (size > 1e-4).all()
    assert (size < 1e4).all()
    np.testing.assert_allclose(rows / size, expected, atol=tolerance * np.abs(expected).max())


@pytest.fixture(params=["first", "second round", "on the way", "begins there"])
def rows(request) -> Rows:
    return Rows(*ticks()[request.param])


def test_rows_are_the_equations_of_a_plan(rows):
    lin, tick = rows.lin, rows.tick
    assert lin.known[lin.singular].all()
    assert lin.known.mean() > 0.8  # of what is not, nothing is asked
    position, speed = (
        np.array([part.T for part in parts]) for parts in zip(*map(rows.pieces, rows.plans), strict=True)
    )
    s, sd = (np.array([plan[i][1:].T for plan in rows.plans]) for i in (1, 2))
    for name, end, node in (("position", position[..., -1], s), ("speed", speed[..., -1], sd)):
        left = (end - node).transpose(0, 2, 1).reshape(PLANS, -1)
        assert_multiples(rows.left(name), left)
    W = rows.f(slice(None), [np.zeros((len(lin.nodes), 2))] * 3, 0.0, "W")
    left = np.array([np.einsum("nij,nj->ni", W, plan[4]) - rows.linear(plan, "f") for plan in rows.plans])
    counts = tick.counts
    if not tick.free:
        begins = lin.singular[0] == 0
        u = np.linalg.svd(W[0])[0][:, -1]
        left[:, 0] -= np.outer(left[:, 0] @ u, u) * begins
    found = rows.left("dynamics").reshape(left.shape)
    assert_multiples(found[:, counts].reshape(PLANS, -1), left[:, counts].reshape(PLANS, -1), 1e-6)
    assert not found[:, ~counts].any()
    before, after = rows.left("before"), rows.left("after")
    for index, q in enumerate(lin.singular):
        jerks = [np.diff(plan[3], axis=0) / np.diff(lin.nodes)[:, None] for plan in rows.plans]
        sides = [(before, q - 1), (after, q)]
        for found, step in sides:
            if 0 <= step < len(lin.nodes) - 1:
                left = [rows.rate(index, plan, jerk[step]) for plan, jerk in zip(rows.plans, jerks, strict=True)]
                assert_multiples(found[:, [step]], np.array(left)[:, None], 1e-4)
    steps = np.arange(len(lin.nodes) - 1)
    assert not before[:, ~np.isin(steps, lin.singular - 1)].any()
    assert not after[:, ~np.isin(steps, lin.singular)].any()
    if not tick.free and lin.singular[0] == 0:
        left = [rows.rate(0, plan, tick.jerk) for plan in rows.plans]
        assert_multiples(rows.left("start"), np.array(left)[:, None], 1e-4)
    else:
        assert not rows.left("start").any()


def test_rows_are_the_limits_of_a_plan_between_its_nodes_too(rows):
    """Of cubic splines: track limits by their control points, which scipy knows; closer by ``CLOSER`` at the end."""
    limits, plans, tick = rows.tick.limits, rows.splines, rows.tick
    _, speed = (np.array(parts) for parts in zip(*map(rows.pieces, plans), strict=True))
    h = np.diff(rows.lin.nodes)[:, None]
    jerk = np.array([np.diff(plan[3], axis=0) / h for plan in plans])
    tau, peak = np.array([plan[4] for plan in plans]), np.array([plan[5] for plan in plans])[:, None, None]
    s, sd = (np.array([plan[i][-1:] for plan in plans]) for i in (1, 2))
    control = np.array([plan[6] for plan in plans])
    inner, last = control[:, 2:-2], control[:, -2:-1]
    speed_most, force = limits.speed, FORCE_KEPT * limits.carrier_force
    fastest = np.minimum(limits.speed, np.sqrt(2.0 * limits.acceleration * np.diff(TRACK)[:, 0]))
    stop = fastest**2 / (2.0 * limits.acceleration) * sd / fastest  # at this speed, and no more at any lower
    forces = np.array([rows.linear(plan, "carrier_force") for plan in plans])
    expected = {
        "above": (-(tau - peak), None),
        "below": (None, tau + peak),
        "track": (TRACK[:, 1] - inner, inner - TRACK[:, 0]),
        "last_track": (TRACK[:, 1] - last, last - TRACK[:, 0]),
        "hull_speed": (speed_most - speed[:, 1], speed[:, 1] + speed_most),
        "stop": (TRACK[:, 1] - s - stop, s + stop - TRACK[:, 0]),
        "stop_back": (TRACK[:, 1] - s + stop, s - stop - TRACK[:, 0]),
        "jerk": (limits.jerk - jerk, jerk + limits.jerk),
        "force": (force - forces, forces + force),
    }
    assert expected.keys() == rows.programme.within.blocks.keys()
    for name, rooms in expected.items():
        for left, room in zip(rows.room(name, plans), rooms, strict=True):
            if room is None:
                assert (left > FAR).all()
                continue
            counting = slice(None)
            if name in ("above", "below"):
                counting = np.repeat(tick.counts, 2)
            elif name == "force":
                counting = np.repeat(rows.lin.known, 2)
            elif name == "hull_speed" and not tick.free:
                assert (left[:, :2] == 1.0).all()  # a row of zeros: the first half step is given
                counting = slice(2, None)
            room = room.reshape(PLANS, -1)
            assert_multiples(left[:, counting], room[:, counting], 3.0 * CLOSER)


def test_bounds_are_the_limits_at_the_nodes_and_what_the_start_is(rows):
    tick, p, limits = rows.tick, rows.programme, rows.tick.limits
    ut, near = tick.sizes.tau, {"rtol": 2.0 * CLOSER}
    given = int(not tick.free)
    # a tenth of the acceleration is kept in hand for the end of the horizon, so that a plan can be put right later
    after = ((rows.lin.nodes - rows.lin.nodes[0]) / np.ptp(rows.lin.nodes))[given:, None]
    np.testing.assert_allclose(rows.upper[p.sdd[given:]] * rows.units[2], limits.acceleration * (1.0 - 0.1 * after))
    np.testing.assert_allclose(rows.upper[p.sd[-1]] * rows.units[1], limits.speed, **near)
    np.testing.assert_allclose(rows.upper[p.tau] * ut, limits.effort + 0.0 * p.tau, rtol=1e-12)
    np.testing.assert_array_equal(rows.lower[:-1], -rows.upper[:-1])
    np.testing.assert_allclose(rows.lower[p.peak] * ut, WEIGHTS.memory * tick.largest)
    # what is given is an equation each: place and speed, and later the acceleration and efforts that these decide
    block = rows.block("given")
    A, b = rows.A[block], rows.b[block]
    wanted = [part / unit for part, unit in zip(tick.first, rows.units, strict=True)] + [np.zeros(2)]
    for part, (places, value) in enumerate(zip((p.s[0], p.sd[0], p.sdd[0], p.tau[0]), wanted, strict=True)):
        counts = (True, True, not tick.free, not tick.counts[0])[part]
        own = slice(2 * part, 2 * part + 2)
        np.testing.assert_allclose(A[own][:, places], counts * np.eye(2))
        np.testing.assert_allclose(b[own], counts * value, atol=1e-15)
    assert np.count_nonzero(A) == b.size - 2 * tick.free - 2 * tick.counts[0]


def test_the_cost_is_the_weighted_mean_squares_of_the_page(rows):
    tick, lin, w = rows.tick, rows.lin, WEIGHTS
    duration, steps = lin.nodes[-1] - lin.nodes[0], np.diff(lin.nodes)[:, None]
    end = np.flatnonzero(lin.known)[-1]  # what comes after the horizon is not known

    def mean(values):
        return np.trapezoid((values**2).sum(axis=1), lin.nodes) / duration

    sizes = np.stack(rows.units, axis=-1)
    curvature = lin.curvature * sizes[:, :, None] * sizes[:, None]
    convex = 0.5 * (curvature + [[polar(part)[1] for part in node] for node in curvature])  # (H + |H|) / 2

    def bent(motion):
        change = (np.stack(motion, axis=-1) - np.stack(lin.at, axis=-1)) / sizes
        return 0.5 * np.einsum("nki,nkij,nkj->", change, convex, change)

    for x, *motion, tau, peak in rows.plans:
        s, sd, sdd = (part / unit for part, unit in zip(motion, rows.units, strict=True))
        tau, peak = tau / tick.sizes.tau, peak / tick.sizes.tau
        jerk = np.diff(sdd, axis=0) * tick.step / steps  # over that which reaches the limit in a step
        expected = (
            w.effort * mean(tau)
            + w.peak * peak**2
            + w.acceleration * mean(sdd)
            + w.jerk * (jerk**2 * steps).sum() / tick.horizon
            + w.centre * mean(s)
            + w.end * (s[end] ** 2).sum()
            + w.end_speed * (sd[end] ** 2).sum()
            + bent(motion)
            - bent([0.0 * part for part in motion])
        )
        np.testing.assert_allclose(0.5 * x @ rows.P @ x + rows.q @ x, expected, rtol=1e-6, atol=1e-6)


def test_multipliers_are_what_more_of_f_would_cost(rows):
    """And it is their curvature that the next round has in its cost."""
    lin, programme, h = rows.lin, rows.programme, 1e-4
    solution = programme.solve(rows.tick)
    assert solution is not None
    node = int(np.flatnonzero(rows.tick.counts)[-1])

    def cost(more):
        f = lin.f.copy()
        f[node] += more * rows.tick.sizes.row * [0.6, 0.8]
        tick = replace(rows.tick, lin=replace(lin, f=f))
        x, _ = programme.solve(tick)
        P, q, *_ = programme.numbers_of(tick)
        dense = P.toarray()
        return 0.5 * x @ dense @ x + q @ x

    # L = cost + yᵀ (W τ − f): more of f costs −y
    expected = -(solution[1][node] * rows.tick.sizes.row * [0.6, 0.8]).sum()
    np.testing.assert_allclose((cost(h) - cost(-h)) / (2.0 * h), expected, rtol=1e-2, atol=1e-5)


@pytest.mark.parametrize("arm", [0.0, 0.2], ids=["sliding", "turning"])
def test_the_curvature_is_that_of_second_differences_by_the_other_backend(arm):
    robot = rp.load_robot("2rpr", **ROBOT, arm_length=arm)
    rng, nodes, backend = np.random.default_rng(3), np.array([0.1, 0.3, 0.5]), rp.RneaDynamics(robot)
    ahead = Ahead(rp.CompiledDynamics(robot), Preview.of(ACROSS), 0.02)
    at = tuple(size * rng.uniform(-1.0, 1.0, (3, robot.k)) for size in (0.1, 0.5, 5.0))
    y = rng.uniform(-1.0, 1.0, (3, robot.n))
    lin = Linearised.about(ahead, nodes, np.empty(0, dtype=int), at, y, 1.0)

    def value(changes):
        carriers = rp.CarrierMotion(*(a + c for a, c in zip(at, changes, strict=True)), check_rates=False)
        return -(y * backend.reduce(ACROSS.sample_at(nodes), carriers, check_track=False).f).sum(axis=1)

    h = 2e-3  # m, m/s, m/s²
    assert np.abs(lin.curvature).max() > 0.1
    for carrier in range(robot.k):
        unit = h * np.eye(robot.k)[carrier]
        for i in range(3):
            for j in range(3):
                ends = [
                    a * b * value([(a * (i == own) + b * (j == own)) * unit for own in range(3)])
                    for a in (1.0, -1.0)
                    for b in (1.0, -1.0)
                ]
                second = sum(ends) / (4.0 * h**2)
                np.testing.assert_allclose(lin.curvature[:, carrier, i, j], second, rtol=1e-4, atol=1e-5)


def test_a_start_that_can_stay_within_the_limits_has_no_room_beyond_them():
    """It can where full braking, the given s̈ fading in the first step, ends on the track."""
    planner, tick = ticks()["on the way"]
    limits, h = tick.limits, tick.lin.nodes[1] - tick.lin.nodes[0]
    speed, most = np.array([0.8, -1.0]), limits.acceleration
    braking = PPoly(np.array([[-2.0 * most / h, 0.0 * most], [most, -most]]) * np.sign(speed), [0.0, h, 1.0])
    moved = braking.antiderivative(2)(np.linspace(0.0, 0.3, 30001)) + speed * np.linspace(0.0, 0.3, 30001)[:, None]
    farthest = np.sign(speed) * (moved * np.sign(speed)).max(axis=0)
    ends = np.array([TRACK[0, 1], TRACK[1, 0]])
    for short, room in ((1e-6, False), (-1e-6, True)):
        first = ends - farthest - short * np.sign(speed), speed, most * np.sign(speed)
        soft, hard = (Rows(planner, replace(tick, first=first), elastic=elastic) for elastic in (True, False))
        more = [bound.max() for bound in np.abs((soft.high - hard.high, soft.low - hard.low))[:, soft.block("track")]]
        assert (np.array(more) > 0.0).all() == room
        np.testing.assert_array_equal(soft.high[soft.block("hull_speed")], hard.high[hard.block("hull_speed")])


def test_sizes_divide_unknowns_by_what_they_are_at_most(rows):
    limits = rows.tick.limits
    half = 0.5 * np.diff(TRACK)[:, 0]
    for unit, expected in zip(rows.units, (half, limits.speed, limits.acceleration), strict=True):
        np.testing.assert_allclose(unit, expected)
    # motors of twice the transmission need half the efforts for the same forces
    lin = rows.tick.lin
    once, twice = TickScales.of(lin), TickScales.of(replace(lin, W=2.0 * lin.W))
    assert (twice.tau, *twice.row) == pytest.approx((0.5 * once.tau, *once.row), rel=1e-12)


def test_an_elastic_programme_has_room_to_come_back_and_pays_for_what_is_missing():
    """A carrier too fast to stay on its track comes back with half of its acceleration; no farther, and no other."""
    planner, tick = ticks()["on the way"]
    start = np.array([0.125, -0.112]), np.array([1.0, -1.2]), np.array([9.0, -11.0])
    rows = Rows(planner, replace(tick, first=start), elastic=True)
    p, units, limits = rows.programme, rows.units, tick.limits
    t = tick.lin.nodes - tick.lin.nodes[0]
    # as hard as it may outwards, at once after the first node half as hard back
    sdd = np.where(t[:, None] > 0.0, -0.5 * np.sign(start[0]) * limits.acceleration, start[2])
    curve = PPoly(np.array([np.diff(sdd, axis=0) / np.diff(t)[:, None], sdd[:-1]]), t)
    speed = curve.antiderivative()
    sd, s = start[1] + speed(t), start[0] + t[:, None] * start[1] + speed.antiderivative()(t)
    back = np.argmax((np.abs(s) < 0.15) & (sd * start[0] < 0.0), axis=0)  # from there on it may stop
    assert (back > 0).all()
    x = np.zeros(p.variables)
    for place, unit, value in ((p.s, units[0], s), (p.sd, units[1], sd), (p.sdd, units[2], sdd)):
        x[place] = value / unit
    for name, before in (("track", back - 2), ("hull_speed", back - 2)):
        rooms = rows.room(name, [(x,)])[:, 0].reshape(2, -1, 2)
        for j in range(2):
            assert rooms[:, : before[j], j].min() >= -1e-9
    turn = 1.5 * limits.acceleration * t[1]  # of speed, at most, until it has turned round
    block = rows.block("track")
    high, low = (bound[block].reshape(-1, 2) * units[0] for bound in (rows.high, rows.low))
    farthest = start[0] + np.sign(start[0]) * ((np.abs(start[1]) + turn) ** 2 / limits.acceleration + 2e-6)
    assert TRACK[0, 1] < high[:, 0].max() <= farthest[0]
    assert TRACK[1, 0] > low[:, 1].min() >= farthest[1]
    block = rows.block("stop")
    np.testing.assert_allclose(
        [rows.high[block] * units[0], rows.low[block] * units[0]], TRACK.T[::-1], rtol=2.0 * CLOSER
    )
    block = rows.block("hull_speed")
    most = np.maximum(limits.speed, np.abs(start[1]) + turn)
    assert (rows.high[block].reshape(-1, 2)[1:] * units[1] <= most + 1e-12).all()
    np.testing.assert_allclose(rows.upper[p.sd[-1]] * units[1], limits.speed, rtol=2.0 * CLOSER)
    assert (rows.P[p.missing.ravel(), p.missing.ravel()] == WEIGHTS.missing).all()
    # what is missing of an equation is one unknown of it, and enters no other
    equations = rows.A[:, p.missing.ravel()]
    assert set(np.unique(equations)) == {0.0, 1.0}
    assert (np.count_nonzero(equations, axis=0) <= 2).all()
