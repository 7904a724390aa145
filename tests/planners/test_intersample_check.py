"""Peaks of the continuous motion: by hand, and against the other backend on random motions, cusps among them."""

from __future__ import annotations

import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
import random_problems
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import ALLOWED, extremes_between, least_effort
from redundancy_pin.planners.limits import LimitedQuantity, limit_events, motion_quantities
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import (
    RestToRest,
    SpeedProfile,
    SplinePath,
    Trajectory,
    reference,
    rounded_polygon,
    with_constant,
)
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

MANY = 100 * int(os.environ.get("EXAMPLES", "1"))
"""Random problems of the long test: 1,000 in ``make long``."""

PEAK = 1e-2
"""Relative: beside a spike the oracle, which samples, is less exact than the polynomials."""


def cusp(turn: float, long: float = 0.1, centre: tuple[float, ...] = (1.0, 0.55)) -> SplinePath:
    """Return a path that comes back beside itself: the spline turns within about ``turn``, m."""
    points = [[-long, -turn], [-0.45 * long, -turn], [0.0, 0.0], [-0.5 * long, 1.4 * turn], [-1.1 * long, turn]]
    return SplinePath(np.array(centre) + points)


# --- by hand ---


def test_an_effort_that_counts_as_zero_is_a_fraction_of_what_f_asks_for() -> None:
    reduced = rp.RneaDynamics(zoo.robot_of("3rrr")).reduce(
        zoo.smooth_motion(zoo.robot_of("3rrr")).at(np.linspace(0.0, 1.0, 9))
    )
    least = least_effort(reduced)
    assert 0.0 < least < 1e-2 * np.abs(rp.distribute(reduced).tau).max()
    # a motion of a machine of grams, and one whose motors have longer levers
    assert least_effort(replace(reduced, f=1e-3 * reduced.f)) == pytest.approx(1e-3 * least)
    assert least_effort(replace(reduced, W=10.0 * reduced.W)) == pytest.approx(0.1 * least)


def test_a_spike_a_thousandth_of_a_piece_wide_is_resolved() -> None:
    """A carrier whose position has a bump: its force is m s̈ on a track that does not move."""
    robot = zoo.robot_of("3rrr")
    still = rp.PlatformMotion([0.0, 1.0], np.tile([1.0, 0.5, 0.0], (2, 1)), np.zeros((2, 3)), np.zeros((2, 3)))
    place = PiecewisePolynomial.constant(np.zeros(3), 0.0, 1.0)
    parked = PlanFunctions(as_motion(still), place)
    at_rest = extremes_between(rp.VirtualWork(robot), parked, 0.0, 1.0)
    width, size = 1e-5, 10.0
    edges = np.array([0.0, 0.5 - width, 0.5, 0.5 + width, 1.0])
    zero, bump = np.zeros((1, 4, 3)), np.zeros((1, 4, 3))
    bump[0, 1:3, 0] = [0.5 * size, -0.5 * size]
    pulse = PiecewisePolynomial(edges, np.concatenate([bump, zero, zero])).remove_offsets()
    peaks = extremes_between(rp.VirtualWork(robot), PlanFunctions(as_motion(still), pulse), 0.0, 1.0)
    mass = float(robot.model.inertias[robot.model.getJointId(robot.carriers[0])].mass)
    change = np.abs(peaks.value[:, 3]).max() - np.abs(at_rest.value[:, 3]).max()
    assert change == pytest.approx(mass * size, rel=1e-3)
    assert peaks.time[np.abs(peaks.value[:, 3]).argmax(), 3] == pytest.approx(0.5, abs=2.0 * width)


@pytest.mark.long_for("-0.0002-False", "0.0002-True")
@pytest.mark.parametrize(("depth", "finite"), [(-2e-4, False), (-1e-5, False), (1e-5, True), (2e-4, True)])
def test_a_singularity_crossed_twice_between_two_samples_has_no_peak(depth: float, finite: bool) -> None:
    """The platform dips below the line of the two bases and is back before the next sample; or it just does not."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.2, cylinder_mass=0.1)
    path = SplinePath(np.array([[0.15, 0.1], [0.2, 0.03], [0.25, depth], [0.3, 0.03], [0.35, 0.1]]))
    motion = Trajectory(path, RestToRest(path.length, 0.98))
    unlimited = Limits(effort=np.inf)  # the motors are of 1000 N
    plan = rp.plan_stepwise(rp.VirtualWork(robot), motion, mesh=rp.Mesh(dt=0.02), limits=unlimited)
    assert np.isfinite(plan.tau).all()
    assert plan.motion.x[:, 1].min() > 2e-4
    again = rp.check_plan(plan, rp.RneaDynamics(robot))
    assert again.passed
    if finite:
        assert plan.status is ResultStatus.UNRESOLVED
        assert np.isfinite(plan.peak_effort).all()
    else:
        assert plan.status is again.status is ResultStatus.UNBOUNDED
        assert np.isinf(plan.peak_effort).all()
        assert plan.motion.t[-1] > plan.between.time[0] > 0.48
        assert np.isfinite(plan.between.force_peak).all()


def test_a_turn_of_a_micrometre_far_from_a_singularity_has_a_peak() -> None:
    """At 0.3 m/s it lasts microseconds: no halving resolves it, and its peak is that of samples denser still."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.2)
    path = SplinePath(np.array([[0.15, 0.2], [0.25, 0.25], [0.15, 0.201]]))
    motion = Trajectory(path, SpeedProfile(path.length, 0.3, 0.1))
    plan = rp.plan_stepwise(rp.VirtualWork(robot), motion, mesh=rp.Mesh(dt=0.02), limits=Limits(effort=np.inf))
    t = plan.between.time[0] + np.linspace(-1e-5, 1e-5, 2001)
    turn = rp.RneaDynamics(robot).reduce(motion.sample_at(t), plan.carriers_at(t))
    assert plan.peak_effort == pytest.approx(np.abs(rp.distribute(turn).tau).max(axis=0), rel=PEAK)
    assert plan.peak_effort.min() > 1e4


def test_a_jump_of_the_acceleration_is_a_jerk_over_the_shorter_piece() -> None:
    """By hand: s̈ of one carrier is 0 for 1 s, jumps by 2 m/s², then has a jerk of -3 m/s³ for 0.5 s."""
    robot = zoo.robot_of("2rpr")
    cubic = np.zeros((4, 2, 2))
    cubic[:2, 1, 0] = [-0.5, 1.0]
    position = PiecewisePolynomial(np.array([0.0, 1.0, 1.5]), cubic)

    def jerks(position: PiecewisePolynomial, limit: float) -> list[LimitedQuantity]:
        rows = motion_quantities(Limits(jerk=limit).resolved(robot), position)
        return [row for row in rows if row.name == "jerk"]

    for limit, amount in ((3.9, 0.1), (4.1, None), (2.9, 1.1)):
        violated, touched = limit_events(jerks(position, limit))
        assert touched == ()
        assert {(event.joint, event.quantity) for event in violated} <= {(robot.carriers[0], "jerk")}
        assert [event.value < 0.0 for event in violated] == {3.9: [False], 4.1: [], 2.9: [False, True]}[limit]
        for event in violated[:1]:
            assert event.worst == 1.0
            assert event.value == pytest.approx(4.0)
            assert event.amount == pytest.approx(amount)
    smooth = PiecewisePolynomial(np.array([0.0, 0.5]), cubic[:, 1:])
    (event,), _ = limit_events(jerks(smooth, 2.9))
    assert event.value == pytest.approx(-3.0)


@pytest.mark.long_for("270")
@pytest.mark.parametrize("number", [69, 270])
def test_random_plans_that_leave_a_track_between_the_samples_do_not_count_as_within_limits(number: int) -> None:
    plan, _, other = random_problems.solved(number)
    upper = plan.limits.judged_by.track[:, 1]
    assert (plan.carriers.s <= upper + 1e-9).all()
    beyond = plan.carriers_at(np.linspace(plan.t[0], plan.t[-1], 20_001)).s - upper
    assert beyond.max() > 5e-5
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    (event,) = plan.limits.violated
    assert event.quantity == "track"
    assert event.amount == pytest.approx(beyond.max(), rel=1e-3)
    assert rp.check_plan(plan, other).passed


def test_efforts_that_jump_count_from_both_sides() -> None:
    """Carriers that stand, along a corner: the efforts are those of the robot on both sides of each jump."""
    robot, corner = zoo.robot_of("3rrr"), reference.corner()
    parked = PlanFunctions(as_motion(corner), PiecewisePolynomial.constant(np.zeros(3), 0.0, corner.duration))
    peaks = extremes_between(rp.VirtualWork(robot), parked, 0.0, corner.duration)
    both = rp.RneaDynamics(robot).reduce(corner.sample_at(np.repeat(corner.breaks, 2)))
    expected = np.abs(rp.distribute(both).tau)
    for instant, values in zip(np.repeat(corner.breaks, 2), expected, strict=True):
        near = (peaks.ends == instant).any(axis=1)
        assert near.any()
        assert (np.abs(peaks.value[near, :3]).max(axis=0) >= values * (1.0 - 1e-9)).all()


# --- random motions ---


def problem(seed: int) -> tuple[Robot, Trajectory, np.random.Generator]:
    """Draw a robot, a motion (cusps, splines through random points, polygons with tiny corners) and its speed."""
    random = np.random.default_rng(seed)
    spatial = random.random() < 0.6
    if spatial:
        robot = rp.load_robot("3rrr", working_mode=tuple(int(sign) for sign in random.choice([-1, 1], 3)))
    else:
        masses = {
            "end_effector_mass": float(random.choice([0.0, 0.2])),
            "cylinder_mass": float(random.uniform(0.05, 0.3)),
        }
        robot = rp.load_robot("2rpr", **masses)
    centre = np.array([1.0, 0.55]) if spatial else np.array([0.25, 0.2])
    kind = random.choice(["cusp", "spline", "polygon"])
    if kind == "cusp":
        path = cusp(10.0 ** random.uniform(-3.0, -1.3), random.uniform(0.05, 0.15), (0.0, 0.0))
        angle = random.uniform(0.0, 2.0 * np.pi)
        turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]])
        path = SplinePath(centre + path.points @ turn)
    elif kind == "spline":
        count, closed = int(random.integers(3, 7)), bool(random.random() < 0.4)
        path = SplinePath(centre + random.uniform(-0.12, 0.12, (count, 2)), closed=closed)
    else:
        corners = centre + random.uniform(-0.15, 0.15, (3, 2))
        path = rounded_polygon(corners, 10.0 ** random.uniform(-3.5, -1.7), closed=False)
    placed = with_constant(path, float(random.uniform(-0.3, 0.3))) if spatial else path
    return (
        robot,
        Trajectory(placed, RestToRest(path.length, path.length / random.uniform(0.05, 0.3), "4-5-6-7")),
        random,
    )


def planned(dynamics: Dynamics, motion: Trajectory, random: np.random.Generator) -> Plan:
    n = dynamics.robot.n
    planner = random.choice(["stepwise", "samples", "whole"] if n == 3 else ["whole", "switch off"])
    dt = float(random.choice([5e-3, 1e-2, 2e-2]))
    if planner == "stepwise":
        return rp.plan_stepwise(dynamics, motion, mesh=rp.Mesh(dt=dt))
    if planner == "samples":
        return rp.plan_stepwise(dynamics, motion.sample(dt=dt, two_sided=bool(random.random() < 0.5)))
    if planner == "switch off":
        return rp.plan_switch_off(dynamics, motion, threshold=float(random.uniform(4.0, 15.0)), mesh=rp.Mesh(dt=5e-3))
    step, objective = float(random.choice([0.02, 0.05])), str(random.choice(["effort", "effort", "peak"]))
    end, refinements = str(random.choice(["free", "datum"])), int(random.choice([0, 1, 3]))
    mesh, solver = rp.Mesh(dt=step, refinements=refinements), rp.Solver(seconds=5.0)
    return rp.plan_whole_trajectory(dynamics, motion, objective=objective, end=end, mesh=mesh, solver=solver)


def resampled(plan: Plan, dynamics: Dynamics, count: int) -> tuple[Array, int]:
    """Return (m,) the largest |τ| by a backend on samples graded towards edges and peaks of ẍ, and how many."""
    functions, edges = plan.functions, plan.functions.pieces(plan.t)
    towards = np.geomspace(1e-3, 0.5, 15)
    fractions = np.unique(np.concatenate([towards, 1.0 - towards, np.linspace(0.02, 0.98, 15)]))
    even = np.linspace(plan.t[0], min(plan.t[-1], functions.platform.moves_until), count)
    times = [(edges[:-1, None] + np.diff(edges)[:, None] * fractions).ravel(), even]
    size = np.abs(functions.platform.sample_at(even).xdd).max(axis=1)
    tops = 1 + np.flatnonzero((size[1:-1] >= size[:-2]) & (size[1:-1] >= size[2:]))
    for centre in even[tops[np.argsort(-size[tops])[:4]]]:
        width = even[1] - even[0]
        for _ in range(7):  # zoom in: a spike is narrower than any even grid
            closer = np.unique(np.clip(np.linspace(centre - width, centre + width, 41), even[0], even[-1]))
            centre = closer[np.abs(functions.platform.sample_at(closer).xdd).max(axis=1).argmax()]
            times.append(closer)
            width /= 8.0
    t = np.setdiff1d(np.concatenate(times), edges)
    singular = plan.t[plan.margin < 1e-6 * plan.margin.max()]
    if len(singular):  # beside them W⁻¹ f magnifies rounding
        t = t[np.abs(t[:, None] - singular).min(axis=1) > 1e-5]
    reduced = dynamics.along(functions.platform.sample_at(t)).reduce(functions.carriers_at(t))
    largest = np.nanmax(np.abs(functions.efforts(reduced)), axis=0)
    return np.maximum(largest, plan.peak_effort_at_samples), len(t)


def judged(seeds: range, samples: int) -> Counter[str]:
    """Plan random problems and compare what the plans say of their peaks with the oracle; return the counts."""
    counts: Counter[str] = Counter()
    for seed in seeds:
        try:
            robot, motion, random = problem(seed)
        except InputError:  # a spline with a true cusp, corners that do not fit
            counts["no problem"] += 1
            continue
        first, second = random.permutation([rp.VirtualWork, rp.RneaDynamics])
        try:
            plan = planned(first(robot), motion, random)
        except RedundancyPinError as error:
            counts[type(error).__name__] += 1
            continue
        peak, looked_at = resampled(plan, second(robot), samples)
        counts["samples"] += looked_at
        counts[plan.status.value] += 1
        shown = plan.peak_effort_at_samples
        ratio = 1.0 + (peak - shown).max() / shown.max()
        if plan.status in (ResultStatus.OK, ResultStatus.NOT_CONVERGED):
            assert ratio <= ALLOWED * (1.0 + PEAK), seed
        if plan.status is ResultStatus.UNRESOLVED:
            assert ratio > ALLOWED * (1.0 - PEAK), seed
        if np.isfinite(plan.peak_effort).all():
            assert plan.peak_effort.max() == pytest.approx(peak.max(), rel=PEAK), seed
    return counts


def test_random_motions_keep_what_their_status_says() -> None:
    counts = judged(range(1, 6), 1_001)
    assert counts["ok"] > 1


@pytest.mark.long
def test_many_random_motions_keep_what_their_status_says(capsys: pytest.CaptureFixture[str]) -> None:
    counts = judged(range(1000, 1000 + MANY), 10_001)
    with capsys.disabled():
        print(f"\n{MANY} random plans against the other backend: {dict(counts)}")  # noqa: T201 # the counts are the result
    assert counts["ok"] > 0.2 * MANY
    assert counts["unresolved"] > 0.05 * MANY
