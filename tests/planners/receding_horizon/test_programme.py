"""The programme of a tick as a whole: each row and the cost at random plans, by the other backend and by formulas."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.interpolate import BPoly, PPoly

import redundancy_pin as rp
from redundancy_pin.planners.limits import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon, Weights
from redundancy_pin.planners.receding_horizon.tick import FORCE_KEPT, Tick
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


@cache
def other() -> rp.VirtualWork:
    return rp.VirtualWork(rp.load_robot("2rpr", **ROBOT))


@cache
def ticks() -> dict[str, Tick]:
    """The first tick, the second round of it, one on the way, and one that begins at a singular instant."""
    seen, command = [], Tick.command
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Tick, "command", lambda self, *rest: seen.append(self) or command(self, *rest))
        dynamics = rp.CompiledDynamics(rp.load_robot("2rpr", **ROBOT))
        planner = RecedingHorizon(dynamics, objective=WEIGHTS, limits=LIMITS)
        crossing = rp.find_crossings(dynamics.robot, ACROSS)[0].t
        for t in (*np.arange(0.0, crossing - 0.01, 0.02), crossing - 0.003):
            planner.update(t, ACROSS)
    return {"first": seen[0], "second round": seen[1], "on the way": seen[6], "begins there": seen[-1]}


class Rows:
    """The numbers of a tick's programme, dense, and the blocks of its rows."""

    def __init__(self, tick: Tick, elastic: bool = False) -> None:
        self.tick, self.lin, self.programme = tick, tick.lin, tick.setup.programme(elastic)
        self.values = v = tick.values(elastic)
        p = self.programme
        self.A, self.G = (self._dense(part, entries) for part, entries in ((p.equal, v.A), (p.within, v.G)))
        self.P = np.zeros((p.variables, p.variables))
        self.P[p.pattern[0], np.repeat(np.arange(p.variables), np.diff(p.pattern[1]))] = v.P
        lin, units = tick.lin, tick._u
        rng = np.random.default_rng(5)
        sizes = 0.02, 0.2, 2.0
        at = lin.at.s, lin.at.sd, lin.at.sdd
        self.plans = []
        for _ in range(PLANS):
            motion = [own + size * rng.uniform(-1.0, 1.0, own.shape) for own, size in zip(at, sizes, strict=True)]
            tau, peak = 5.0 * rng.uniform(-1.0, 1.0, (len(lin.nodes), 2)), 5.0 * rng.random()
            x = np.zeros(p.variables)
            for place, part, unit in zip((p.s, p.sd, p.sdd), motion, units, strict=True):
                x[place] = part / unit
            x[p.tau], x[p.peak] = tau / tick.sizes.tau, peak / tick.sizes.tau
            self.plans.append((x, *motion, tau, peak))

    @staticmethod
    def _dense(rows, entries):
        matrix = np.zeros(rows.shape)
        matrix[rows.rows, np.repeat(np.arange(rows.shape[1]), np.diff(rows.starts))] = entries
        return matrix

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
        return np.array([self.A[rows] @ plan[0] - self.values.b[rows] for plan in self.plans])

    def room(self, name):
        """The room below the upper and above the lower bound of each row of a block at each plan, (2, plans, rows)."""
        rows = self.block(name)
        value = np.array([self.G[rows] @ plan[0] for plan in self.plans])
        return np.array([self.values.high[rows] - value, value - self.values.low[rows]])

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
        at, every = (self.lin.at.s, self.lin.at.sd, self.lin.at.sdd), slice(None)
        change = [1e-2 * (new - old) for new, old in zip(plan[1:4], at, strict=True)]
        ends = [self.f(every, [a + sign * c for a, c in zip(at, change, strict=True)], 0.0, what) for sign in (1, -1)]
        return self.f(every, at, 0.0, what) + (ends[0] - ends[1]) / 2e-2

    def rate(self, index, plan, jerk):
        """uᵀ Ẇ τ − uᵀ ḟ at a singular instant, ḟ linear about the last plan, by differences of the other backend."""
        q = self.lin.singular[index]
        at = [part[q] for part in (self.lin.at.s, self.lin.at.sd, self.lin.at.sdd)] + [np.zeros(2)]
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
    return Rows(ticks()[request.param])


def test_rows_are_the_equations_of_a_plan(rows):
    lin, tick = rows.lin, rows.tick
    assert lin.known.all()
    position, speed = (
        np.array([part.T for part in parts]) for parts in zip(*map(rows.pieces, rows.plans), strict=True)
    )
    s, sd = (np.array([plan[i][1:].T for plan in rows.plans]) for i in (1, 2))
    for name, end, node in (("position", position[..., -1], s), ("speed", speed[..., -1], sd)):
        left = (end - node).transpose(0, 2, 1).reshape(PLANS, -1)
        assert_multiples(rows.left(name), left)
    W = rows.f(slice(None), [np.zeros((len(lin.nodes), 2))] * 3, 0.0, "W")
    left = np.array([np.einsum("nij,nj->ni", W, plan[4]) - rows.linear(plan, "f") for plan in rows.plans])
    counts = np.ones(len(lin.nodes), dtype=bool)
    if not tick.free:
        begins = lin.singular[0] == 0
        counts[0] = begins
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
    limits, plans = rows.tick.setup.limits, rows.plans
    position, speed = (np.array(parts) for parts in zip(*map(rows.pieces, plans), strict=True))
    h = np.diff(rows.lin.nodes)[:, None]
    jerk = np.array([np.diff(plan[3], axis=0) / h for plan in plans])
    tau, peak = np.array([plan[4] for plan in plans]), np.array([plan[5] for plan in plans])[:, None, None]
    s, sd = (np.array([plan[i][-1:] for plan in plans]) for i in (1, 2))
    # the hull's second last point is seen from the end: where nodes do not follow each other's motion these differ
    at_end = np.array([plan[1][1:] - h / 3.0 * plan[2][1:] for plan in plans])
    speed_most, force = limits.speed, FORCE_KEPT * limits.carrier_force
    fastest = np.minimum(limits.speed, np.sqrt(2.0 * limits.acceleration * np.diff(TRACK)[:, 0]))
    stop = fastest**2 / (2.0 * limits.acceleration) * sd / fastest  # at this speed, and no more at any lower
    forces = np.array([rows.linear(plan, "carrier_force") for plan in plans])
    expected = {
        "above": (-(tau - peak), None),
        "below": (None, tau + peak),
        "hull_left": (TRACK[:, 1] - position[:, 1], position[:, 1] - TRACK[:, 0]),
        "hull_right": (TRACK[:, 1] - at_end, at_end - TRACK[:, 0]),
        "hull_speed": (speed_most - speed[:, 1], speed[:, 1] + speed_most),
        "stop": (TRACK[:, 1] - s - stop, s + stop - TRACK[:, 0]),
        "stop_back": (TRACK[:, 1] - s + stop, s - stop - TRACK[:, 0]),
        "jerk": (limits.jerk - jerk, jerk + limits.jerk),
        "force": (force - forces, forces + force),
    }
    assert expected.keys() == rows.programme.within.blocks.keys()
    counts = np.ones(len(rows.lin.nodes), dtype=bool)
    counts[0] = rows.tick.free or rows.lin.singular[0] == 0
    for name, rooms in expected.items():
        for found, room in zip(rows.room(name), rooms, strict=True):
            if room is None:
                assert np.isinf(found).all()
                continue
            efforts = np.repeat(counts, 2) if name in ("above", "below") else slice(None)
            room = room.reshape(PLANS, -1)
            assert_multiples(found[:, efforts], room[:, efforts], 1e-5 if name == "force" else 1e-9)


def test_bounds_are_the_limits_at_the_nodes_and_what_the_start_is(rows):
    tick, p, limits = rows.tick, rows.programme, rows.tick.setup.limits
    lower, upper = rows.values.lower, rows.values.upper
    ut = tick.sizes.tau
    sides = [
        (p.s, tick._u[0], *TRACK.T),
        (p.sd, tick._u[1], -limits.speed, limits.speed),
        (p.sdd, tick._u[2], -limits.acceleration, limits.acceleration),
    ]
    for place, unit, least, most in sides:
        given = place is not p.sdd or not tick.free
        np.testing.assert_allclose(lower[place[int(given) :]] * unit - least, 0.0, atol=1e-12)
        np.testing.assert_allclose(upper[place[int(given) :]] * unit - most, 0.0, atol=1e-12)
    for place, unit, value in zip((p.s, p.sd, p.sdd), tick._u, tick.first, strict=True):
        if place is not p.sdd or not tick.free:
            np.testing.assert_allclose([lower[place[0]] * unit, upper[place[0]] * unit], [value, value], atol=1e-12)
    decided = not tick.free and rows.lin.singular[0] != 0  # by the start
    np.testing.assert_allclose(upper[p.tau[int(decided) :]] * ut - limits.effort, 0.0, atol=1e-12)
    np.testing.assert_allclose(lower[p.tau[int(decided) :]] * ut + limits.effort, 0.0, atol=1e-12)
    np.testing.assert_allclose(lower[p.peak] * ut, WEIGHTS.memory * tick.setup.largest)
    if decided:
        assert not upper[p.tau[0]].any()
        assert not lower[p.tau[0]].any()


def test_the_cost_is_the_weighted_mean_squares_of_the_page(rows):
    tick, lin, w = rows.tick, rows.lin, WEIGHTS
    duration, steps = lin.nodes[-1] - lin.nodes[0], np.diff(lin.nodes)[:, None]

    def mean(values):
        return np.trapezoid((values**2).sum(axis=1), lin.nodes) / duration

    for x, *motion, tau, peak in rows.plans:
        s, sd, sdd = (part / unit for part, unit in zip(motion, tick._u, strict=True))
        tau, peak = tau / tick.sizes.tau, peak / tick.sizes.tau
        jerk = np.diff(sdd, axis=0) * tick.setup.step / steps  # over that which reaches the limit in a step
        change, about = sdd - lin.at.sdd / tick._u[2], lin.at.sdd / tick._u[2]
        expected = (
            w.effort * mean(tau)
            + w.peak * peak**2
            + w.acceleration * mean(sdd)
            + w.jerk * (jerk**2 * steps).sum() / (tick.setup.count * tick.setup.step)
            + w.centre * mean(s)
            + w.end * (s[-1] ** 2).sum()
            + w.end_speed * (sd[-1] ** 2).sum()
            + tick.proximal * (mean(change) - mean(about))
        )
        np.testing.assert_allclose(0.5 * x @ rows.P @ x + rows.values.q @ x, expected, rtol=1e-6)


def test_sizes_divide_unknowns_by_what_they_are_at_most(rows):
    limits = rows.tick.setup.limits
    half = 0.5 * np.diff(TRACK)[:, 0]
    for unit, expected in zip(rows.tick._u, (half, limits.speed, limits.acceleration), strict=True):
        np.testing.assert_allclose(unit, expected)


def test_an_elastic_programme_has_room_to_come_back_and_pays_for_what_is_missing():
    """A carrier too fast to stay on its track comes back with half of its acceleration; no farther."""
    tick = ticks()["on the way"]
    start = np.array([0.1, -0.1]), np.array([1.0, -1.2]), np.array([9.0, -11.0])
    rows = Rows(replace(tick, first=start), elastic=True)
    p, v, units, limits = rows.programme, rows.values, tick._u, tick.setup.limits
    t = tick.lin.nodes - tick.lin.nodes[0]
    # as hard as it may outwards, at once after the first node half as hard back
    sdd = np.where(t[:, None] > 0.0, -0.5 * np.sign(start[0]) * limits.acceleration, start[2])
    curve = PPoly(np.array([np.diff(sdd, axis=0) / np.diff(t)[:, None], sdd[:-1]]), t)
    speed = curve.antiderivative()
    sd, s = start[1] + speed(t), start[0] + t[:, None] * start[1] + speed.antiderivative()(t)
    back = np.argmax((np.abs(s) < 0.15) & (sd * start[0] < 0.0), axis=0)  # from there on it may stop
    assert (back > 0).all()
    for place, unit, value in ((p.s, units[0], s), (p.sd, units[1], sd)):
        for j in range(2):
            x = value[: back[j], j] / unit[j]
            assert (x <= v.upper[place[: back[j], j]] + 1e-12).all()
            assert (x >= v.lower[place[: back[j], j]] - 1e-12).all()
    turn = 1.5 * limits.acceleration * t[1]  # of speed, at most, until it has turned round
    upper, lower = v.upper[p.s[1:]] * units[0], v.lower[p.s[1:]] * units[0]
    farthest = start[0] + np.sign(start[0]) * ((np.abs(start[1]) + turn) ** 2 / limits.acceleration + 2e-6)
    assert upper[:, 0].max() <= farthest[0]
    assert lower[:, 1].min() >= farthest[1]
    np.testing.assert_allclose([upper[-1], lower[-1]], TRACK.T[::-1])
    assert (v.upper[p.sd[1:]] * units[1] <= np.maximum(limits.speed, np.abs(start[1]) + turn) + 1e-12).all()
    np.testing.assert_allclose(v.upper[p.sd[-1]] * units[1], limits.speed)
    np.testing.assert_array_equal(v.lower[p.sd[1:]], -v.upper[p.sd[1:]])
    assert (rows.P[p.missing.ravel(), p.missing.ravel()] == WEIGHTS.missing).all()
    # what is missing of an equation is one unknown of it, and enters no other
    equations = rows.A[:, p.missing.ravel()]
    assert set(np.unique(equations)) == {0.0, 1.0}
    assert (np.count_nonzero(equations, axis=0) <= 2).all()
