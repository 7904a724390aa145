"""The programme of a whole trajectory: its rows, bounds, sizes and cost at random values, by the other backend."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import casadi
import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.optimal.mesh import first_mesh, grid_of
from redundancy_pin.planners.optimal.problem import Problem, Task, read_problem
from redundancy_pin.planners.optimal.settings import checked_settings
from redundancy_pin.planners.optimal.transcription import (
    BEYOND,
    ELASTIC_OBJECTIVE,
    REGULARISATION,
    RESERVE,
    objective_sizes,
    objective_values,
    slack_name,
    transcribe,
)
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import Motion, as_motion

POINTS = 3

SAME = 1e-9
"""Of the size of a row: rounding of two backends."""

DIFFERENCES = 1e-5
"""Of the size of a row: central differences of the other backend by time."""

ARMS = {"arm_length": 0.15, "end_effector_mass": 0.5, "cylinder_mass": 0.3}
HEAVY = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}

EVERY = {
    "effort": 0.7, "peak": 1.3, "tracking": 0.4, "carrier_force": 0.2, "carrier_acceleration": 0.09, "base_force": 0.6,
    "base_moment": 1.1, "base_wrench": 0.8, "effort_rate": 0.31, "energy": 1.7,
}  # fmt: skip
"""All different, so that none passes for another."""

BOUNDED = {"carrier_force": 90.0, "energy": 3.0}
POINT = np.array([0.2, -0.3, 0.1])


@dataclass(frozen=True)
class Case:
    source: Motion
    other: rp.RneaDynamics | rp.VirtualWork
    baseline: rp.RneaDynamics | None
    problem: Problem
    limits: dict[str, np.ndarray]
    between: np.ndarray


def limits_of(robot: rp.Robot, effort: bool = True) -> dict[str, np.ndarray]:
    k, m = np.arange(robot.k), np.arange(robot.m)
    return {
        "track": np.stack([-0.3 - 0.1 * k, 0.2 + 0.1 * k], axis=1),
        "speed": 3.0 + k,
        "acceleration": 20.0 + 5.0 * k,
        "jerk": 400.0 + 100.0 * k,
        "carrier_force": 30.0 + 10.0 * k,
        "effort": 40.0 + m if effort else np.full(robot.m, np.inf),
    }


@cache
def case(name: str) -> Case:
    settings = {"start": 0.05, "start_speed": 0.4, "end": "datum", "datum": -0.02, "at_most": BOUNDED}
    goal, baseline = Objective(EVERY, base_point=POINT), None
    if name == "corner":
        robot, motion = zoo.robot_of("3rrr", carrier_mass=3.0), reference.corner(0.5)
        baseline = rp.RneaDynamics(zoo.robot_of("3rrr", carriers=False))
        planned, other = rp.VirtualWork(robot), rp.RneaDynamics(robot)
        goal = Objective({"tracking": 0.5, "effort_rate": 0.02}, lam=0.3, baseline=baseline)
        settings |= {"end": "periodic", "at_most": {}}
    elif name == "turning":
        robot, motion = zoo.robot_of("2rpr", **ARMS), reference.circle(0.5, 0.2, 0.05)
        planned = other = rp.RneaDynamics(robot)  # what it says of one motion, and no polynomial
        goal, settings = replace(goal, weights={"effort": 1.0}), settings | {"end": "rest", "at_most": {}}
    else:
        robot, motion = zoo.robot_of("2rpr", **HEAVY), reference.circle(0.5, 0.2, 0.05)
        planned, other = rp.RneaDynamics(robot), rp.VirtualWork(robot)
    limits = limits_of(robot)
    source = as_motion(motion)
    checked = checked_settings(robot, goal, Limits(**limits), Mesh(0.2), **settings)
    grid = first_mesh(planned, source, 0.2)
    problem = read_problem(Task(planned, source, checked), grid)[0]
    return Case(source, other, baseline, problem, limits, (grid.h > 0.0) & (np.arange(len(grid.h)) % 2 == 0))


class Numbers:
    """Random values of the unknowns, scaled and in units, and the rows of the programme there, taken in order."""

    def __init__(self, of: Case, elastic: tuple[str, ...] = ()) -> None:
        self.of, problem = of, of.problem
        self.u, self.grid = problem.scales, problem.grid
        self.nlp = transcribe(problem, elastic, of.between)
        self.bounds, parts, rng = self.nlp.bounds, self.nlp.functions, np.random.default_rng(4)
        value = casadi.Function("value", [parts["x"]], [parts["f"], parts["g"]])
        self.points, self.costs, rows = [], [], []
        for _ in range(POINTS):
            v = {name: rng.uniform(-0.9, 0.9, block.shape) for name, block in self.nlp.blocks.items()}
            cost, g = value(self.nlp.join(v))
            self.points.append(v)
            self.costs.append(float(cost))
            rows.append(np.asarray(g).ravel())
        self.rows, self.before = np.array(rows), 0

    def unit(self, v: dict[str, Array], name: str) -> Array:
        return np.asarray(v[name] * getattr(self.u, name))

    def take(self, expected, low, high, tolerance=SAME):
        """Look at the next rows; those without any bound are not there."""
        expected = np.array(expected)
        low, high = (np.broadcast_to(side, expected[0].shape).ravel(order="F") for side in (low, high))
        kept = np.isfinite(low) | np.isfinite(high)
        flat = np.array([one.ravel(order="F")[kept] for one in expected])
        rows = slice(self.before, self.before + kept.sum())
        self.before = rows.stop
        assert flat.shape == self.rows[:, rows].shape
        np.testing.assert_allclose(self.rows[:, rows], flat, rtol=tolerance, atol=tolerance * np.abs(flat).max())
        np.testing.assert_allclose(self.bounds["lbg"][rows], low[kept], rtol=1e-12, atol=1e-14)
        np.testing.assert_allclose(self.bounds["ubg"][rows], high[kept], rtol=1e-12, atol=1e-14)

    def reduced(self, v):
        platform = self.of.source.sample_at(self.grid.t)
        s, sd, sdd = (self.unit(v, name) for name in ("s", "sd", "sdd"))
        carriers = rp.CarrierMotion(s, sd, sdd, check_rates=False)
        jump = np.flatnonzero(self.grid.h == 0.0)
        reduced = self.of.other.reduce(platform, carriers, check_track=False)
        # two nodes at one time: the reference acceleration is that of either side
        assert len(jump) == len(self.of.source.breaks)
        return reduced

    def rate(self, v, i, u):
        """uᵀ d(W τ − f)/dt at a node, τ held, along the motion that the carriers' jerk makes of it."""
        h, ends = 1e-5, []
        step = i if i < len(self.grid.h) and self.grid.h[i] > 0.0 else i - 1
        s, sd, sdd = (self.unit(v, name) for name in ("s", "sd", "sdd"))
        jerk = (sdd[step + 1] - sdd[step]) / self.grid.h[step]
        for t in (h, -h):
            parts = (
                s[i] + t * sd[i] + t**2 / 2 * sdd[i] + t**3 / 6 * jerk,
                sd[i] + t * sdd[i] + t**2 / 2 * jerk,
                sdd[i] + t * jerk,
            )
            carriers = rp.CarrierMotion(*(part[None] for part in parts), check_rates=False)
            platform = self.of.source.sample_at(np.array([self.grid.t[i] + t]))
            there = self.of.other.reduce(platform, carriers, check_track=False)
            ends.append(u @ (there.W[0] @ self.unit(v, "tau")[i] - there.f[0]))
        return (ends[0] - ends[1]) / (2.0 * h)


def integral(h: Array, integrand: Array) -> float:
    """Trapezoids."""
    return float(np.sum(h[:, None] * (integrand[1:] + integrand[:-1]) / 2.0))


def felt(of: Case, v: dict[str, Array], numbers: Numbers) -> Array:
    """(M, 6) what the base feels about POINT beyond the load at rest, by the other backend."""
    platform = of.source.sample_at(numbers.grid.t)
    carriers = rp.CarrierMotion(*(numbers.unit(v, name) for name in ("s", "sd", "sdd")), check_rates=False)
    start = rp.PlatformMotion(platform.t[:1], platform.x[:1], 0.0 * platform.xd[:1], 0.0 * platform.xdd[:1])
    k = of.other.robot.k
    still = rp.CarrierMotion(np.full((1, k), 0.05), np.zeros((1, k)), np.zeros((1, k)))
    moving, rest = (
        np.asarray(of.other.along(motion).base_wrench(c)) for motion, c in ((platform, carriers), (start, still))
    )
    wrench = moving - rest
    return np.hstack([wrench[:, :3], wrench[:, 3:] - np.cross(POINT, wrench[:, :3])])


@pytest.mark.parametrize("name", ["circle", "corner", "turning"])
def test_rows_are_the_equations_and_limits_of_a_plan(name):
    of = case(name)
    n, u, grid, limits = Numbers(of), of.problem.scales, of.problem.grid, of.limits
    points, h, settings = n.points, of.problem.grid.h[:, None], of.problem.settings
    places, speeds = [], []
    for v in points:
        s, sd, sdd = (n.unit(v, one) for one in ("s", "sd", "sdd"))
        # Gauss' two points integrate cubics exactly
        at = [0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)]
        between = [sdd[:-1] + part * np.diff(sdd, axis=0) for part in at]
        gained = h / 2.0 * (between[0] + between[1])
        moved = h**2 / 2.0 * ((1.0 - at[0]) * between[0] + (1.0 - at[1]) * between[1])
        places.append((s[:-1] + h * sd[:-1] + moved - s[1:]) / u.s)
        speeds.append((sd[:-1] + gained - sd[1:]) / u.sd)
    n.take(places, 0.0, 0.0)
    n.take(speeds, 0.0, 0.0)
    smooth = np.flatnonzero(grid.smooth)
    assert len(smooth) > 3
    line = [[np.interp(grid.t[i], grid.t[[i - 1, i + 1]], column[[i - 1, i + 1]]) for column in v["sdd"].T]
            for v in points for i in smooth]  # fmt: skip
    shape = POINTS, len(smooth), -1
    n.take(np.reshape(line, shape) - [v["sdd"][smooth] for v in points], 0.0, 0.0)
    most = h * limits["jerk"] / u.sdd
    n.take([np.diff(v["sdd"], axis=0) for v in points], -most, most)
    n.take([v["s"][:1] for v in points], 0.05 / u.s, 0.05 / u.s)
    n.take([v["sd"][:1] for v in points], 0.4 / u.sd, 0.4 / u.sd)
    if settings.end in ("datum", "rest"):
        n.take([v["sd"][-1:] for v in points], 0.0, 0.0)
    if settings.end == "datum":
        n.take([v["s"][-1:] for v in points], -0.02 / u.s, -0.02 / u.s)
    if settings.end == "periodic":
        for one in ("s", "sd", "sdd"):
            n.take([v[one][-1:] - v[one][:1] for v in points], 0.0, 0.0)
    reduced = [n.reduced(v) for v in points]
    f0 = of.problem.model.f0 / u.row
    left = [
        (np.einsum("nij,nj->ni", r.W, n.unit(v, "tau")) - r.f) / u.row + f0
        for r, v in zip(reduced, points, strict=True)
    ]
    parked = np.zeros((len(grid.t), of.other.robot.k))
    alone = of.other.reduce(of.source.sample_at(grid.t), rp.CarrierMotion(parked, parked, parked))
    n.take(left, alone.f / u.row, alone.f / u.row)
    nodes = [(node.index, lost) for node in of.problem.singular for lost in node.lost]
    assert len(nodes) == (0 if name == "corner" else 2)
    if nodes:
        rows = slice(n.before, n.before + len(nodes))
        n.before = rows.stop
        found = n.rows[:, rows] - n.bounds["lbg"][rows]
        np.testing.assert_allclose(n.bounds["ubg"][rows], n.bounds["lbg"][rows], rtol=0.0)
        expected = np.array([[n.rate(v, i, lost) for i, lost in nodes] for v in points])
        for i, lost in nodes:
            np.testing.assert_allclose(lost @ reduced[0].W[i], 0.0, atol=1e-9)
        # over the largest entry of uᵀ Ẇ, and the size of efforts
        step, sizes = 1e-5, []
        for i, lost in nodes:
            W = [of.other.reduce(of.source.sample_at(grid.t[i : i + 1] + t)).W[0] for t in (step, -step)]
            sizes.append(u.tau * np.abs(lost @ (W[0] - W[1])).max() / (2.0 * step))
        assert_close(found, expected / sizes, DIFFERENCES)
    forces = [r.carrier_force / u.force - n.unit(v, "force") / u.force for r, v in zip(reduced, points, strict=True)]
    own = alone.carrier_force / u.force
    n.take([own - force for force in forces], own, own, 1e-8)
    copies = [one for one in n.nlp.blocks if one.startswith("largest")]
    if settings.at_most:
        efforts_and_energy(n, reduced, copies)
    at = np.flatnonzero(of.between)
    speed = (1.0 - RESERVE) * limits["speed"] / u.sd
    (low, high), width = limits["track"].T, np.diff(limits["track"]).ravel()
    n.take([v["sd"][at] + h[at] / 2 * n.unit(v, "sdd")[at] / u.sd for v in points], -speed, speed)
    low, high = (low + RESERVE * width) / u.s, (high - RESERVE * width) / u.s
    n.take([v["s"][at] + h[at] / 3 * n.unit(v, "sd")[at] / u.s for v in points], low, high)
    n.take([v["s"][at + 1] - h[at] / 3 * n.unit(v, "sd")[at + 1] / u.s for v in points], low, high)
    assert n.before == n.rows.shape[1]


def assert_close(one: Array, other: Array, tolerance: float) -> None:
    np.testing.assert_allclose(one, other, rtol=tolerance, atol=tolerance * np.abs(other).max())


def efforts_and_energy(n: Numbers, reduced, copies) -> None:
    """Rows of the objectives, in the order of their names: a peak, the base wrench, powers; and of bounds."""
    of, u, points, h = n.of, n.u, n.points, n.grid.h
    (top,) = copies
    n.take([np.diff(v[top], axis=0) for v in points], 0.0, 0.0)
    nodes = np.arange(len(n.grid.t)) // 8
    for sign in (1.0, -1.0):
        n.take([sign * v["tau"] - v[top][nodes] for v in points], -np.inf, 0.0)
    wrench = [felt(of, v, n) / u.base for v in points]
    kept = [i for i in range(6) if np.abs(np.array(wrench)[..., i]).max() > 1e-9]
    assert len(kept) == points[0]["base"].shape[1]
    rows = slice(n.before, n.before + points[0]["base"].size)
    n.before = rows.stop
    np.testing.assert_allclose(n.bounds["lbg"][rows], n.bounds["ubg"][rows], rtol=0.0)
    left = [(v["base"] - w[:, kept]).ravel(order="F") for v, w in zip(points, wrench, strict=True)]
    assert_close(n.rows[:, rows] - n.bounds["lbg"][rows], np.array(left), 1e-8)
    names = [one for one in n.nlp.blocks if one.startswith("absolute")]
    robot = of.other.robot
    platform = of.source.sample_at(n.grid.t)
    rates = rp.kinematics.inverse_kinematics.inverse_kinematics(robot, platform).v[:, robot.actuated_velocity]
    powers = [
        [n.unit(v, "tau") * rates / u.power for v in points],
        [n.unit(v, "force") * n.unit(v, "sd") / u.power for v in points],
    ]
    for one, power in zip(names, powers, strict=True):
        for sign in (1.0, -1.0):
            n.take([v[one] - sign * p for v, p in zip(points, power, strict=True)], 0.0, np.inf)
    n.take([[[integral(h, n.unit(v, "force") ** 2) / BOUNDED["carrier_force"]]] for v in points], -np.inf, 1.0)
    spent = [[[sum(integral(h, v[one]) for one in names) * u.power / BOUNDED["energy"]]] for v in points]
    n.take(spent, -np.inf, 1.0)


def weighed(of: Case, n: Numbers, v: dict[str, Array]) -> dict[str, tuple[float, float]]:
    """Each objective at the unknowns, and its size, by its formula in the docstring of ``plan_whole_trajectory``."""
    u, h, T = of.problem.scales, n.grid.h, of.source.end - of.source.start
    tau, force, sdd = (n.unit(v, name) if name in v else 0.0 * n.unit(v, "s") for name in ("tau", "force", "sdd"))
    steps = h > 0.0
    slope = np.diff(tau, axis=0)[steps] / h[steps][:, None]
    target = 0.0
    if of.baseline is not None:
        target = 0.3 * rp.distribute(of.baseline.reduce(of.source.sample_at(n.grid.t))).tau
    found = {
        "effort": (integral(h, tau**2), T * u.tau**2),
        "tracking": (integral(h, (tau - target) ** 2), T * u.tau**2),
        "carrier_force": (integral(h, force**2), T * max(u.force) ** 2),
        "carrier_acceleration": (integral(h, sdd**2), T * max(u.sdd) ** 2),
        "effort_rate": (float(np.sum(h[steps][:, None] * slope**2)), u.tau**2 / T),
    }
    if "base" in v:
        (top,) = [name for name in v if name.startswith("largest")]
        found["peak"] = float(np.mean(v[top])) * u.tau, u.tau
        found["energy"] = sum(integral(h, v[one]) for one in v if one.startswith("absolute")) * u.power, T * u.power
        components = [i for i in range(6) if i in kept_components(of, n)]
        wrench = v["base"] * u.base[components]
        first = [j for j, i in enumerate(components) if i < 3]
        rest = [j for j, i in enumerate(components) if i >= 3]
        of_force, of_moment = integral(h, wrench[:, first] ** 2), integral(h, wrench[:, rest] ** 2)
        length = of.other.robot.characteristic_length
        found["base_force"] = of_force, T * u.base[0] ** 2
        found["base_moment"] = of_moment, T * u.base[3] ** 2
        found["base_wrench"] = of_force + of_moment / length**2, T * u.base[0] ** 2
    return found


def kept_components(of: Case, n: Numbers) -> list[int]:
    wrench = felt(of, n.points[0], n)
    return [i for i in range(6) if np.abs(wrench[:, i]).max() > 1e-9 * np.abs(wrench).max()]


@pytest.mark.parametrize("name", ["circle", "corner", "turning"])
def test_the_cost_is_the_weighted_objectives_over_their_size(name):
    of = case(name)
    n, weights = Numbers(of), of.problem.settings.objective
    for v, cost in zip(n.points, n.costs, strict=True):
        found = weighed(of, n, v)
        size = sum(weight * found[one][1] for one, weight in weights.items())
        expected = sum(weight * found[one][0] for one, weight in weights.items()) / size
        duration = of.source.end - of.source.start
        expected += REGULARISATION * integral(n.grid.h, v["sdd"] ** 2) / duration
        np.testing.assert_allclose(cost, expected, rtol=1e-10)
        sizes = objective_sizes(of.problem)
        assert list(sizes) == list({**weights, **of.problem.settings.at_most})
        for one, value in sizes.items():
            np.testing.assert_allclose(value, found[one][1], rtol=1e-12)


@pytest.mark.parametrize("name", ["circle", "corner"])
def test_objectives_are_said_by_their_formulas(name):
    """As numbers, of the motion and efforts: a peak is the largest effort, and the base wrench that of the motion."""
    of = case(name)
    n = Numbers(of)
    h = n.grid.h
    for v in n.points:
        said = objective_values(of.problem, {one: v[one] for one in ("s", "sd", "sdd", "tau", "force")})
        expected = {one: value for one, (value, _) in weighed(of, n, v).items() if one in said}
        if name == "circle":
            wrench = felt(of, v, n)
            parts = integral(h, wrench[:, :3] ** 2), integral(h, wrench[:, 3:] ** 2)
            robot = of.other.robot
            rates = rp.kinematics.inverse_kinematics.inverse_kinematics(robot, of.source.sample_at(n.grid.t)).v[
                :, robot.actuated_velocity
            ]
            expected |= {
                "peak": np.abs(n.unit(v, "tau")).max(),
                "energy": integral(h, np.abs(n.unit(v, "tau") * rates))
                + integral(h, np.abs(n.unit(v, "force") * n.unit(v, "sd"))),
                "base_force": parts[0],
                "base_moment": parts[1],
                "base_wrench": parts[0] + parts[1] / robot.characteristic_length**2,
            }
        assert set(said) == set(expected)
        for one, value in said.items():
            np.testing.assert_allclose(value, expected[one], rtol=1e-8, err_msg=one)


@pytest.mark.parametrize("name", ["circle", "corner", "turning"])
def test_unknowns_are_bounded_by_the_limits_a_little_narrowed(name):
    of = case(name)
    n, u, limits = Numbers(of), of.problem.scales, of.limits
    lower, upper = (n.nlp.split(n.bounds[side]) for side in ("lbx", "ubx"))
    width = np.diff(limits["track"]).ravel()
    low, high = limits["track"].T
    sides = {"s": (low + RESERVE * width, high - RESERVE * width)}
    for one, limit in (("sd", "speed"), ("sdd", "acceleration"), ("tau", "effort"), ("force", "carrier_force")):
        sides[one] = -(1.0 - RESERVE) * limits[limit], (1.0 - RESERVE) * limits[limit]
    for one, (least, most) in sides.items():
        size = getattr(u, one)
        # a tenth of what is kept in reserve
        np.testing.assert_allclose(lower[one] * size, np.tile(least, (len(n.grid.t), 1)), rtol=0.1 * RESERVE)
        np.testing.assert_allclose(upper[one] * size, np.tile(most, (len(n.grid.t), 1)), rtol=0.1 * RESERVE)
    for one in set(lower) - set(sides) - {"base"}:
        assert not lower[one].any()
        assert np.isinf(upper[one]).all()


@pytest.mark.parametrize("at", ["track", "datum", "speed", "inside"])
def test_a_limit_on_which_the_carriers_begin_or_end_gives_way_by_less_than_counts(at):
    robot, source = zoo.robot_of("2rpr"), as_motion(reference.circle(0.5, 0.2, 0.05))
    start = {"track": -0.2, "datum": 0.0, "speed": 0.0, "inside": -0.2 + 1e-3}[at]
    datum = {"datum": 0.3}.get(at, 0.1)
    speed = {"speed": -2.0}.get(at, 0.0)
    settings = checked_settings(
        robot, Objective(), Limits(track=(-0.2, 0.3), speed=2.0), Mesh(0.3), start=start, start_speed=speed, datum=datum
    )
    dynamics = rp.RneaDynamics(robot)
    problem = read_problem(Task(dynamics, source, settings), grid_of(source, [], 0.3))[0]
    nlp, u = transcribe(problem), problem.scales
    lower, upper = (nlp.split(nlp.bounds[side]) for side in ("lbx", "ubx"))
    room = {"low": 0.5 * RESERVE, "high": -0.5 * RESERVE, "speed": -2.0 * RESERVE}
    if at == "track":
        room["low"] = -0.5 * BEYOND
    if at == "datum":
        room["high"] = 0.5 * BEYOND
    if at == "speed":
        room["speed"] = 2.0 * BEYOND
    np.testing.assert_allclose(lower["s"] * u.s - -0.2, room["low"], atol=0.05 * RESERVE)
    np.testing.assert_allclose(upper["s"] * u.s - 0.3, room["high"], atol=0.05 * RESERVE)
    np.testing.assert_allclose(upper["sd"] * u.sd - 2.0, room["speed"], atol=0.2 * RESERVE)
    np.testing.assert_allclose(lower["sd"], -upper["sd"], rtol=1e-15)


@pytest.mark.parametrize("limited", [True, False])
def test_sizes_are_those_of_limits_or_of_the_parked_machine(limited):
    robot, source = zoo.robot_of("3rrr", carrier_mass=3.0), as_motion(reference.corner(0.5))
    limits = limits_of(robot)
    if not limited:
        limits |= {"track": (-np.inf, np.inf), "speed": np.inf, "acceleration": np.inf}
    dynamics, other = rp.VirtualWork(robot), rp.RneaDynamics(robot)
    settings = checked_settings(robot, Objective({"base_wrench": 1.0}), Limits(**limits), Mesh(0.2))
    problem = read_problem(Task(dynamics, source, settings), grid_of(source, [], 0.2))[0]
    u, T = problem.scales, source.end - source.start
    assert u.duration == T
    s = np.diff(limits["track"]).ravel() / 2.0 if limited else np.ones(3)
    sd = limits["speed"] if limited else s / (T / 10.0)
    sdd = limits["acceleration"] if limited else sd / (T / 10.0)
    for one, size in (("s", s), ("sd", sd), ("sdd", sdd)):
        np.testing.assert_allclose(getattr(u, one), size, rtol=1e-12)
    platform = source.sample_at(problem.grid.t)
    parked = np.zeros((len(platform.t), 3))
    reduced = other.reduce(platform, rp.CarrierMotion(parked, parked, parked))
    scaled = np.abs(reduced.f / reduced.row_scale).max()
    np.testing.assert_allclose(u.row, scaled * reduced.row_scale, rtol=1e-9)
    largest = np.linalg.norm(reduced.W / reduced.row_scale[:, None], ord=2, axis=(1, 2))
    np.testing.assert_allclose(u.tau, scaled / np.median(largest), rtol=1e-9)
    rates = rp.kinematics.inverse_kinematics.inverse_kinematics(robot, platform).v[:, robot.actuated_velocity]
    np.testing.assert_allclose(problem.actuated_rate, rates, atol=1e-9 * np.abs(rates).max())
    np.testing.assert_allclose(u.power, u.tau * np.abs(rates).max(), rtol=1e-9)
    pushed = [
        other.reduce(platform, rp.CarrierMotion(parked, parked, parked + one, check_rates=False)).carrier_force[:, i]
        - reduced.carrier_force[:, i]
        for i, one in enumerate(np.eye(3))
    ]
    force = np.abs(reduced.carrier_force).max(axis=0) + np.abs(pushed).max(axis=1) * sdd
    np.testing.assert_allclose(u.force, force, rtol=1e-9)
    assert u.length == robot.characteristic_length


@pytest.mark.parametrize("kind", ["track", "speed", "acceleration", "jerk", "effort", "force", "end", "at_most"])
def test_an_elastic_limit_gives_way_by_a_fraction_of_half_its_width(kind):
    of = case("circle")
    n = Numbers(of, (kind,))
    name, u, limits = slack_name(kind), of.problem.scales, of.limits
    lower = n.nlp.split(n.bounds["lbx"])
    assert not lower[name].any()
    # the fraction costs one, and what else there is hardly counts
    for v, cost in zip(n.points, n.costs, strict=True):
        found = weighed(of, n, v)
        weights = of.problem.settings.objective
        size = sum(weight * found[one][1] for one, weight in weights.items())
        rest = sum(weight * found[one][0] for one, weight in weights.items()) / size
        rest += REGULARISATION * integral(n.grid.h, v["sdd"] ** 2) / (of.source.end - of.source.start)
        np.testing.assert_allclose(cost, v[name][0, 0] + ELASTIC_OBJECTIVE * rest, rtol=1e-10)
    block = {"track": "s", "speed": "sd", "acceleration": "sdd", "effort": "tau", "force": "force"}.get(kind)
    if block:  # the limits of the unknown are rows
        assert np.isinf(lower[block]).all()
    # where every fraction is the same e, the room is wider by e on both sides: twice e times half the width
    value = casadi.Function("value", [n.nlp.functions["x"]], [n.nlp.functions["g"]])
    zero = {one: np.zeros(b.shape) for one, b in n.nlp.blocks.items()}
    at = [np.asarray(value(n.nlp.join({**zero, name: zero[name] + e}))).ravel() for e in (0.0, 1.0)]
    moved = at[1] - at[0]
    where = np.flatnonzero(np.abs(moved) > 0.0)
    nodes, grid = len(n.grid.t), n.grid
    between, moving = of.between.sum(), grid.h > 0.0
    half = {
        "track": np.diff(limits["track"]).ravel() / 2.0 * (1.0 - 2.0 * RESERVE) / u.s,
        "speed": (1.0 - RESERVE) * limits["speed"] / u.sd,
        "acceleration": (1.0 - RESERVE) * limits["acceleration"] / u.sdd,
        "effort": (1.0 - RESERVE) * limits["effort"] / u.tau,
        "force": (1.0 - RESERVE) * limits["carrier_force"] / u.force,
    }
    if kind == "jerk":
        expected = [np.where(moving[:, None], grid.h[:, None] * limits["jerk"] / u.sdd, 1.0)]
    elif kind == "end":
        expected = [np.ones((1, 2)), np.ones((1, 2))]
    elif kind == "at_most":
        expected = [np.ones((1, 1))] * 2
    else:
        again = {"track": 2, "speed": 1}.get(kind, 0)
        expected = [np.tile(half[kind], (nodes, 1)), *[np.tile(half[kind], (between, 1))] * again]
    # lower sides gain it, upper ones lose it; bounds of one side have a row of that side alone
    both = [
        sign * part.ravel(order="F") for part in expected for sign in ((-1.0,) if kind == "at_most" else (1.0, -1.0))
    ]
    np.testing.assert_allclose(moved[where], np.concatenate(both), rtol=1e-12)
