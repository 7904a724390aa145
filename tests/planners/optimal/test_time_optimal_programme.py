"""The programme of least time as a whole: its rows, bounds and cost at random values, by the other backend."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise
from types import SimpleNamespace

import casadi
import numpy as np
import pytest
import zoo

import redundancy_pin as rp
import redundancy_pin.planners.optimal.problem as problems
import redundancy_pin.planners.optimal.solve as solving
import redundancy_pin.planners.optimal.time_optimal as planner
from redundancy_pin.planners.optimal.mesh import Grid, with_middles
from redundancy_pin.planners.optimal.path_problem import read_path_problem
from redundancy_pin.planners.optimal.problem import Problem, Task
from redundancy_pin.planners.optimal.transcription import REGULARISATION_OF_TIME, RESERVE, transcribe
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Line, Path, circle_path
from redundancy_pin.trajectory.timing import uniform_law
from redundancy_pin.trajectory.trajectory import Trajectory

POINTS = 4
HEAVY = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}


class _EnoughError(Exception):
    pass


@dataclass(frozen=True)
class Case:
    path: Path
    problem: Problem
    other: rp.RneaDynamics
    limits: dict
    options: dict


def problem_of(dynamics, path, **settings):
    """The first programme of a plan, which is not solved."""
    seen = []
    with pytest.MonkeyPatch.context() as patch:

        def stop(problem, *rows, **others):
            seen.append(problem)
            raise _EnoughError

        patch.setattr(solving, "transcribe", stop)
        with pytest.raises(_EnoughError):
            rp.plan_time_optimal(dynamics, path, **in_groups(rp.plan_time_optimal, settings))
    return seen[0]


def unit_speed(path):
    return as_motion(Trajectory(path, uniform_law(path.length, path.length)))


@cache
def case(name: str) -> Case:
    """The numbers of a planning problem, which is not solved."""
    if name != "lap":
        robot, path = zoo.robot_of("3rrr", carrier_mass=3.0), reference.corner().path
        if name == "straight":
            path = Line(zoo.home_of(robot), zoo.home_of(robot) + np.array([0.05, 0.1, 0.3]))
        if name == "heavy":
            robot = zoo.robot_of("3rrr", carrier_mass=3.0, gravity=(0.0, -9.81, 0.0))
        robot = replace(robot, characteristic_length=0.2)
        options = {"begin": "rest", "end": "datum", "datum": (0.1, -0.05, 0.02)}
    else:
        robot = zoo.robot_of("2rpr", **HEAVY, gravity=(0.0, -9.81, 0.0))
        path = circle_path((0.25, 0.05), 0.09, start_angle=0.3)
        options = {"begin": "free", "end": "periodic", "lap": True}
    k = robot.k
    limits = {
        "track": [(-0.3 - 0.1 * i, 0.2 + 0.1 * i) for i in range(k)],
        "speed": [3.0 + i for i in range(k)],
        "acceleration": [20.0 + 5.0 * i for i in range(k)],
        "jerk": [400.0 + 100.0 * i for i in range(k)],
        "carrier_force": [30.0 + 10.0 * i for i in range(k)],
        "effort": [4.0 + i for i in range(robot.m)],
    }
    if name == "lap":
        limits["carrier_force"][0] = np.inf
    if name == "heavy":
        limits["effort"] = [60.0 + i for i in range(robot.m)]
    if name == "rates alone":
        limits |= dict.fromkeys(("effort", "speed", "acceleration"), np.inf)
    rate = None if name in ("efforts alone", "straight", "heavy") else 0.5
    problem = problem_of(rp.VirtualWork(robot), path, steps=6, actuator_speed=rate, **limits, **options)
    return Case(path, problem, rp.RneaDynamics(robot), limits, options)


def units_of(problem: Problem):
    """The size of each unknown."""
    timing, names = problem.timing, ("s", "sd", "sdd", "tau", "force")
    of_time = {"pd": timing.speed, "pdd": timing.acceleration, "h": timing.h[:, None]}
    return {**of_time, **{name: getattr(problem.scales, name) for name in names}}


class Numbers:
    """Random values of the unknowns in units, and the rows of the programme there."""

    def __init__(self, of: Case) -> None:
        problem, self.of = of.problem, of
        self.grid, self.u, self.timing = problem.grid, problem.scales, problem.timing
        count, k, m = len(self.grid.t), problem.model.k, problem.model.W.shape[2]
        self.moving = self.grid.h > 0.0
        self.between = self.moving & (np.arange(count - 1) % 2 == 0)
        self.nlp = transcribe(problem, between=self.between)
        self.bounds = self.nlp.bounds
        parts = self.nlp.functions
        rows, rng = casadi.Function("rows", [parts["x"]], [parts["f"], parts["g"]]), np.random.default_rng(3)
        self.points, self.rows, self.cost = [], [], []
        for _ in range(POINTS):
            v = {name: rng.uniform(-0.5, 0.5, (count, c)) for name, c in
                 (("pd", 1), ("pdd", 1), ("s", k), ("sd", k), ("sdd", k), ("tau", m), ("force", k))}  # fmt: skip
            v["pd"] += 0.7
            v["h"] = np.where(self.moving, rng.uniform(0.5, 1.5, count - 1), 0.0)[:, None]
            cost, g = rows(self.nlp.join(v))
            self.cost.append(float(cost))
            self.rows.append(np.asarray(g).ravel())
            self.points.append({name: v[name] * unit for name, unit in units_of(problem).items()})
        self.rows = np.array(self.rows)

    def motion(self, v, nodes=slice(None)):
        """The platform at nodes by the path, and the carriers; where the curvature jumps each node has its own side."""
        p, jump = self.grid.t, np.append(np.diff(self.grid.t) == 0.0, False)
        sides = [self.of.path.evaluate(p, side) for side in ("right", "left")]
        x, tangent, curve = (np.where(jump[:, None], b, a) for a, b in zip(*sides, strict=True))
        platform = rp.PlatformMotion(np.arange(len(p)), x, tangent * v["pd"], curve * v["pd"] ** 2 + tangent * v["pdd"],
                                     check_rates=False)  # fmt: skip
        return platform[nodes], rp.CarrierMotion(v["s"], v["sd"], v["sdd"], check_rates=False)[nodes]

    def reduced(self, v):
        platform, carriers = self.motion(v)
        return self.of.other.reduce(platform, carriers, check_track=False)

    def rate(self, v, i, u):
        """uᵀ d(W τ − f)/dt at a node, τ held, along the motion that jerks make of it."""
        h, ends = 1e-5, []
        step = i if i < len(self.moving) and self.moving[i] else i - 1
        jerk, jerk_p = ((v[name][step + 1] - v[name][step]) / v["h"][step] for name in ("sdd", "pdd"))
        unit = unit_speed(self.of.path)
        for t in (h, -h):
            p = self.grid.t[i] + t * v["pd"][i] + t**2 / 2 * v["pdd"][i]
            pd, pdd = v["pd"][i] + t * v["pdd"][i] + t**2 / 2 * jerk_p, v["pdd"][i] + t * jerk_p
            at = unit.sample_at(p)
            platform = rp.PlatformMotion(p, at.x, at.xd * pd, at.xdd * pd**2 + at.xd * pdd, check_rates=False)
            s, sd, sdd = (v[name][i] for name in ("s", "sd", "sdd"))
            motion = s + t * sd + t**2 / 2 * sdd + t**3 / 6 * jerk, sd + t * sdd + t**2 / 2 * jerk, sdd + t * jerk
            carriers = rp.CarrierMotion(*(part[None] for part in motion), check_rates=False)
            there = self.of.other.reduce(platform, carriers, check_track=False)
            ends.append(u @ (there.W[0] @ v["tau"][i] - there.f[0]))
        return (ends[0] - ends[1]) / (2.0 * h)


@pytest.fixture(params=["corner", "lap"])
def numbers(request) -> Numbers:
    return Numbers(case(request.param))


def assert_multiples(rows, expected, tolerance=1e-8):
    """Each column of one is a positive multiple of that of the other; zero where two nodes are one place."""
    expected = np.array(expected).reshape(len(rows), -1)
    used = expected.any(axis=0)
    assert not rows[:, ~used].any()
    rows, expected = rows[:, used], expected[:, used]
    size = np.linalg.norm(rows, axis=0) / np.linalg.norm(expected, axis=0)
    assert (size > 1e-6).all()
    assert (size < 1e6).all()
    np.testing.assert_allclose(rows, size * expected, atol=tolerance * np.abs(rows).max())


def test_rows_are_the_equations_and_limits_of_a_plan(numbers):
    of, grid, points = numbers.of, numbers.grid, numbers.points
    problem, moving = of.problem, numbers.moving
    before = 0

    def take(expected, low, high, tolerance=1e-8):
        """Look at the next rows: g − bound, for each bound; what has none on either side has no row."""
        nonlocal before
        sides = [np.broadcast_to(none if limit is None else limit, expected[0].shape).ravel(order="F")
                 for limit, none in ((low, -np.inf), (high, np.inf))]  # fmt: skip
        bounded = np.isfinite(sides).any(axis=0)
        rows = slice(before, before + int(bounded.sum()))
        before = rows.stop
        for bound, limit in zip(("lbg", "ubg"), sides, strict=True):
            given, limit = numbers.bounds[bound][rows], limit[bounded]
            if np.isinf(limit).all():
                np.testing.assert_array_equal(given, limit)
            else:
                left = [np.ravel(value, order="F")[bounded] - limit for value in expected]
                assert_multiples(numbers.rows[:, rows] - given, left, tolerance)

    smooth = np.flatnonzero(grid.smooth)
    for place, rate, bend in (("p", "pd", "pdd"), ("s", "sd", "sdd")):
        position, speed, jerks = [], [], []
        for v in points:
            y = grid.t[:, None] if place == "p" else v[place]
            h, yd, ydd = v["h"], v[rate], v[bend]
            jerk = np.diff(ydd, axis=0) / np.where(h > 0.0, h, 1.0)
            position.append(y[:-1] + h * yd[:-1] + h**2 / 2 * ydd[:-1] + h**3 / 6 * jerk - y[1:])
            speed.append(yd[:-1] + h * ydd[:-1] + h**2 / 2 * jerk - yd[1:])
            # the same jerk on both sides of the node, over the durations
            jerks.append((jerk[smooth] - jerk[smooth - 1]) * h[smooth - 1] * h[smooth])
        take(position, 0.0, 0.0)
        take(speed, 0.0, 0.0)
        if len(smooth):
            take(jerks, 0.0, 0.0)
        if place == "p":
            for name in ("pd", "pdd") if problem.timing.lap else ():
                take([v[name][-1:] - v[name][:1] for v in points], 0.0, 0.0)
            take([v["pd"][:-1] + v["h"] / 2 * v["pdd"][:-1] for v in points], 0.0, None)
    most = np.array(of.limits["jerk"])
    change = [np.diff(v["sdd"], axis=0) for v in points]
    take([c + v["h"] * most for c, v in zip(change, points, strict=True)], 0.0, None)
    take([c - v["h"] * most for c, v in zip(change, points, strict=True)], None, 0.0)
    if not problem.timing.lap:
        take([v["sd"][:1] for v in points], 0.0, 0.0)
        take([v["sd"][-1:] for v in points], 0.0, 0.0)
        park = np.array([of.options["datum"]])
        take([v["s"][-1:] for v in points], park, park)
    else:
        for name in ("s", "sd", "sdd"):
            take([v[name][-1:] - v[name][:1] for v in points], 0.0, 0.0)
    reduced = [numbers.reduced(v) for v in points]
    left = [np.einsum("nij,nj->ni", r.W, v["tau"]) - r.f for r, v in zip(reduced, points, strict=True)]
    take(left, 0.0, 0.0, 1e-7)
    assert (len(problem.singular) > 0) == (problem.timing.lap is True)
    for node in problem.singular:
        for u in node.lost:
            np.testing.assert_allclose(u @ reduced[0].W[node.index], 0.0, atol=1e-9)
            take([np.array([[numbers.rate(v, node.index, u)]]) for v in points], 0.0, 0.0, 1e-4)
    take([v["force"] - r.carrier_force for v, r in zip(points, reduced, strict=True)], 0.0, 0.0, 1e-7)
    at = np.flatnonzero(numbers.between)
    speed = (1.0 - RESERVE) * np.array(of.limits["speed"])
    track = np.array(of.limits["track"])
    low, high = track.T + RESERVE * np.diff(track).T * np.array([[1.0], [-1.0]])
    take([v["sd"][at] + v["h"][at] / 2 * v["sdd"][at] for v in points], -speed, speed)
    take([v["s"][at] + v["h"][at] / 3 * v["sd"][at] for v in points], low, high)
    take([v["s"][at + 1] - v["h"][at] / 3 * v["sd"][at + 1] for v in points], low, high)
    assert before == numbers.rows.shape[1]
    assert moving.sum() > 5


def test_bounds_are_those_of_the_unknowns_and_the_cost_is_time(numbers):
    of, u, nlp, timing = numbers.of, numbers.u, numbers.nlp, numbers.timing
    lower, upper = (nlp.split(numbers.bounds[name]) for name in ("lbx", "ubx"))
    keep, track = 1.0 - RESERVE, np.array(of.limits["track"])
    names = ("sd", "speed"), ("sdd", "acceleration"), ("tau", "effort"), ("force", "carrier_force")
    sides = {
        "s": (u.s, *(track.T + RESERVE * np.diff(track).T * np.array([[1.0], [-1.0]]))),
        **{name: (getattr(u, name), -keep * np.array(of.limits[limit]), keep * np.array(of.limits[limit]))
           for name, limit in names},
    }  # fmt: skip
    for name, (unit, least, most) in sides.items():
        count = len(numbers.grid.t)
        np.testing.assert_allclose(lower[name] * unit, np.tile(least, (count, 1)), rtol=1e-12)
        np.testing.assert_allclose(upper[name] * unit, np.tile(most, (count, 1)), rtol=1e-12)
    # the fastest actuator is at its limit, by differences of the joints' angles along the path
    ones = {name: np.ones_like(value) for name, value in numbers.points[0].items()}
    platform, _ = numbers.motion({**ones, "pdd": 0.0 * ones["pdd"]})
    robot = of.other.robot
    rates = np.abs(
        rp.kinematics.inverse_kinematics.inverse_kinematics(robot, platform).v[:, robot.actuated_velocity]
    ).max(axis=1)
    ends = np.zeros(len(rates), dtype=bool)
    ends[[0, -1]] = not timing.lap
    np.testing.assert_allclose(upper["pd"][:, 0] * timing.speed, np.where(ends, 0.0, 0.5 / rates * keep), rtol=1e-9)
    assert (lower["pd"] == 0.0).all()
    assert (lower["h"][numbers.moving] > 0.0).all()
    assert (lower["h"] <= 1e-2).all()
    assert np.isinf(upper["h"][numbers.moving]).all()
    assert not upper["h"][~numbers.moving].any()
    for v, cost in zip(numbers.points, numbers.cost, strict=True):
        gentle = REGULARISATION_OF_TIME * np.mean((v["sdd"] / u.sdd) ** 2)
        np.testing.assert_allclose(cost, v["h"].sum() / u.duration + gentle, rtol=1e-9)


@pytest.mark.parametrize("name", ["corner", "efforts alone", "rates alone", "straight", "heavy"])
def test_the_first_guess_is_a_harmonic_motion_that_the_parked_machine_can_follow(name):
    of = case(name)
    problem, u, timing, length = of.problem, of.problem.scales, of.problem.timing, of.path.length
    guess = solving.first_guess(problem)
    t = np.append(0.0, np.cumsum(guess["h"][:, 0] * timing.h))
    phase = np.pi * t / t[-1]
    place, rate = 0.5 * length * (1.0 - np.cos(phase)), 0.5 * length * np.pi / t[-1]
    np.testing.assert_allclose(place, problem.grid.t, atol=1e-12)
    np.testing.assert_allclose(guess["pd"][:, 0] * timing.speed, rate * np.sin(phase), atol=1e-9)
    # sizes are those of a motion of this mean speed
    np.testing.assert_allclose(guess["pdd"][:, 0], np.cos(phase), atol=1e-12)
    np.testing.assert_allclose([timing.speed, timing.acceleration], [rate, 2.0 * rate**2 / length], rtol=1e-12)
    np.testing.assert_allclose(u.duration, t[-1], rtol=1e-12)
    if name == "rates alone":  # of carriers without such limits, what takes them far in a tenth of the time
        np.testing.assert_allclose([u.sd * (t[-1] / 10.0), u.sdd * (t[-1] / 10.0) ** 2], [u.s, u.s], rtol=1e-12)
    v = {"pd": guess["pd"] * timing.speed, "pdd": guess["pdd"] * timing.acceleration, "s": guess["s"] * u.s}
    np.testing.assert_allclose(v["s"], np.tile(of.options["datum"], (len(t), 1)), rtol=1e-12)
    v |= {name: np.zeros_like(v["s"]) for name in ("sd", "sdd")}
    reduced = Numbers(of).reduced({**v, "s": 0.0 * v["s"]})
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    most = max((np.abs(tau) / of.limits["effort"]).max(), (v["pd"][:, 0] / timing.fastest).max())
    # 101 speeds are tried, each 1.12 times the one before: efforts grow by its square
    assert 0.9 / 1.123**2 < most <= 0.9
    # efforts are of the size of the least limit, or of those at this speed and acceleration everywhere
    everywhere = {"pd": 0.0 * v["pd"] + timing.speed, "pdd": 0.0 * v["pdd"] + timing.acceleration}
    f = Numbers(of).reduced({**v, **everywhere, "s": 0.0 * v["s"]}).f / reduced.row_scale
    largest = np.linalg.norm(reduced.W / reduced.row_scale[:, None], ord=2, axis=(1, 2))
    size = np.abs(f).max() / np.median(largest)
    np.testing.assert_allclose(u.tau, size if name == "rates alone" else min(of.limits["effort"]), rtol=1e-9)
    np.testing.assert_allclose(u.s, 0.5 * np.diff(of.limits["track"])[:, 0])
    np.testing.assert_allclose(u.row / reduced.row_scale, max(np.abs(f).max(), u.tau * np.median(largest)), rtol=1e-9)


def test_values_are_moved_to_other_nodes_along_the_path():
    """Linear in place, as numpy interpolates; at a jump each side stays what it was."""
    of = case("corner")
    problem, grid, units = of.problem, of.problem.grid, units_of(of.problem)
    point = Numbers(of).points[0]
    values = {name: point[name] / unit for name, unit in units.items()}
    again = problem.resampled(values, problem)
    for name, unit in units.items():
        np.testing.assert_allclose(again[name] * unit, point[name], atol=1e-12)
    finer = with_middles(grid, grid.h > 0.0)
    fine = replace(problem, grid=finer, timing=replace(problem.timing, h=np.ones(len(finer.h))))
    moved = problem.resampled(values, fine)
    side = np.append(False, grid.h == 0.0).cumsum() * 1e-9  # numpy knows no two values at one place
    places = finer.t + np.append(False, finer.h == 0.0).cumsum() * 1e-9
    for name in ("pd", "s", "tau"):
        for column, expected in zip((moved[name] * units[name]).T, point[name].T, strict=True):
            np.testing.assert_allclose(column, np.interp(places, grid.t + side, expected), atol=1e-6)
    t = np.append(0.0, np.cumsum(point["h"]))
    np.testing.assert_allclose(np.cumsum(moved["h"]), np.interp(places[1:], grid.t + side, t), atol=1e-6)


def test_steps_inside_which_a_carrier_leaves_its_limits_are_found():
    """On dense samples of the cubics from node to node: of track ends and speed limits of either side."""
    of = case("corner")
    problem, u = of.problem, of.problem.scales
    rng, count = np.random.default_rng(8), len(problem.grid.t)
    found = []
    for _ in range(40):
        h = np.where(problem.grid.h > 0.0, 0.1, 0.0)
        sdd = rng.uniform(-1.0, 1.0, (count, 3)) * rng.choice([3.0, 30.0, 60.0])
        gained = np.cumsum(h[:, None] / 2 * (sdd[1:] + sdd[:-1]), axis=0)
        sd = rng.uniform(-1.0, 1.0) + np.vstack([np.zeros((1, 3)), gained])
        moved = h[:, None] * sd[:-1] + h[:, None] ** 2 / 6 * (2 * sdd[:-1] + sdd[1:])
        s = rng.uniform(-0.1, 0.1) + np.vstack([np.zeros((1, 3)), np.cumsum(moved, axis=0)])
        values = {"s": s / u.s, "sd": sd / u.sd, "sdd": sdd / u.sdd, "h": (h / problem.timing.h)[:, None]}
        leaves = solving.leaves_limits(problem, values)
        part = np.linspace(0.0, 1.0, 201)[:, None, None] * h[:, None]
        jerk = np.diff(sdd, axis=0) / 0.1
        place = s[:-1] + part * sd[:-1] + part**2 / 2 * sdd[:-1] + part**3 / 6 * jerk
        speed = sd[:-1] + part * sdd[:-1] + part**2 / 2 * jerk
        track, most = np.array(of.limits["track"]), np.array(of.limits["speed"])
        beyond = np.max([place - track[:, 1], track[:, 0] - place, np.abs(speed) - most], axis=0).max(axis=(0, 2))
        clear = (np.abs(beyond) > 1e-3) & (h > 0.0)
        np.testing.assert_array_equal(leaves[clear], beyond[clear] > 0.0)
        found.append(leaves[clear].mean())
    assert min(found) == 0.0
    assert max(found) > 0.5


def test_a_lap_is_first_guessed_at_an_even_speed():
    problem = case("lap").problem
    guess, timing = solving.first_guess(problem), problem.timing
    assert not guess["pdd"].any()
    np.testing.assert_allclose(guess["pd"], 0.5)
    # half the size of speeds, and steps that last as long as they take at it
    np.testing.assert_allclose(guess["h"][:, 0] * timing.h * 0.5 * timing.speed, problem.grid.h, atol=1e-12)


def test_finer_meshes_have_nodes_halfway_in_time_where_it_is_needed():
    """In steps around what exceeds, where no more is free, and in long ones; places are those of the law."""
    t = np.array([0.0, 1.0, 1.0, 1.1, 1.2, 1.3, 1.4, 1.5, 1.6, 1.7, 1.75, 1.8, 1.85, 20.0])
    law = PiecewisePolynomial.linear(np.unique(t), (0.1 * np.unique(t) ** 2)[:, None])
    places = 0.1 * t**2
    grid = Grid(places, np.array([2, 5]), np.arange(14) == 6)
    finer = planner.finer_nodes(grid, t, law, np.array([1.35]))
    # the step from 1.3 to 1.4, two on both sides, and the last; that from 0 to 1 is as long as a twentieth of all
    new = np.setdiff1d(finer.t, places)
    middles = [0.5 * (a + b) for a, b in pairwise(t) if a in (1.1, 1.2, 1.3, 1.4, 1.5, 1.85)]
    np.testing.assert_allclose(new, [law(np.array([m]))[0, 0] for m in middles])
    np.testing.assert_allclose(finer.t[finer.singular], places[[2, 5]])
    smooth = finer.t[finer.smooth]
    np.testing.assert_allclose(smooth, np.sort([*places[[5, 6]], *new[:-1]]))
    # a law that stands still, or runs back, leaves a fiftieth of the step
    stuck = planner.finer_nodes(grid, t, lambda times: np.zeros((len(times), 1)), np.array([1.35])).t
    stuck = np.setdiff1d(stuck, places)
    np.testing.assert_allclose(stuck[-1], places[-2] + 0.02 * (places[-1] - places[-2]))


@pytest.mark.parametrize("steps", [6, 40])
def test_there_are_as_many_steps_as_asked_for_at_least(steps):
    h = np.diff(planned_nodes(steps))
    assert steps <= (h > 0.0).sum() <= 2 * steps


def planned_nodes(steps):
    dynamics = rp.VirtualWork(zoo.robot_of("3rrr", carriers=False))
    return problem_of(dynamics, reference.corner().path, steps=steps, effort=4.0).grid.t


def test_a_solution_is_put_back_into_units(numbers):
    """Motion, law, efforts and where the acceleration jumps."""
    of = numbers.of
    problem, grid = of.problem, numbers.grid
    for v in numbers.points:
        scaled = {name: v[name] / unit for name, unit in units_of(problem).items()}
        t, solution = np.append(0.0, np.cumsum(v["h"])), SimpleNamespace(values=scaled)
        np.testing.assert_allclose(problem.times(scaled), t, rtol=1e-12)
        np.testing.assert_allclose(problem.tau(scaled), v["tau"], rtol=1e-12)
        force = numbers.reduced(v).carrier_force
        np.testing.assert_allclose(problem.carrier_force(scaled), force, atol=1e-9 * np.abs(force).max())
        samples, law = problem.carriers(scaled), planner.law_of(problem, solution)
        for name in ("s", "sd", "sdd"):
            np.testing.assert_allclose(getattr(samples, name), v[name], rtol=1e-12)
        platform = planner.platform_of(of.path, problem, solution)
        first = np.append(numbers.moving, False)  # of nodes at one time the second one is where a piece begins
        for order, expected in enumerate((grid.t, v["pd"][:, 0], v["pdd"][:, 0])):
            own = law.derivative(order) if order else law
            np.testing.assert_allclose(own(t[first])[:, 0], expected[first], atol=1e-9)
        np.testing.assert_allclose(platform.breaks, t[:-1][~numbers.moving])
        assert (platform.start, platform.end) == (0.0, t[-1])
        expected, _ = numbers.motion(v)
        found = platform.sample_at(t[first])
        np.testing.assert_allclose(found.x, expected.x[first], atol=1e-9)
        np.testing.assert_allclose(found.xd, expected.xd[first], atol=1e-9)
        inner = np.setdiff1d(t[1:-1], platform.breaks)
        np.testing.assert_allclose(platform.knots, inner)


def test_laws_that_run_ahead_or_back_leave_a_fiftieth_of_the_step():
    places = np.array([1.0, 2.0, 4.0, 4.0, 9.0])
    grid = Grid(places, np.array([], dtype=int), np.zeros(5, dtype=bool))
    t = np.array([0.0, 1.0, 2.0, 2.0, 3.0])
    for place, part in ((-1e3, 0.02), (1e3, 0.98)):
        law = lambda times, place=place: np.full((len(times), 1), place)  # noqa: E731
        finer = planner.finer_nodes(grid, t, law, np.empty(0))
        new = np.setdiff1d(finer.t, places)
        np.testing.assert_allclose(new, [1.0 + part, 2.0 + 2.0 * part, 4.0 + 5.0 * part])


def test_singular_nodes_on_a_jump_of_the_curvature_have_a_side_each(monkeypatch):
    """Of two nodes at one place the first one ends what is before it."""
    of = case("corner")
    grid, seen = of.problem.grid, []
    (jump, *_) = np.flatnonzero(grid.h == 0.0).tolist()
    last = len(grid.t) - 1
    nodes = Grid(grid.t, np.array([1, jump, jump + 1, last]), grid.smooth)
    monkeypatch.setattr(problems, "singular_node", lambda *asked, dt: seen.append((*asked[2:4], asked[5])))
    task = Task(rp.VirtualWork(of.other.robot), unit_speed(of.path), of.problem.settings)
    read_path_problem(task, nodes, "free", False)
    places = grid.t[[1, jump, jump + 1, last]].tolist()
    assert seen == list(zip([1, jump, jump + 1, last], places, ["right", "left", "right", "right"], strict=True))
