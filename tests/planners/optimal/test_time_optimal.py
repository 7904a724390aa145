"""Least time along a path: against toppra, replay, and known figures."""

from __future__ import annotations

import functools
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import zoo
from scipy.spatial.transform import Rotation

from redundancy_pin import (
    PlatformMotion,
    RneaDynamics,
    VirtualWork,
    check_plan,
    distribute,
    load_plan,
    load_robot,
    plan_time_optimal,
    simulate,
)
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.options import Limits, Mesh
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, circle_path, reference, through_points

pytest.importorskip("casadi")
least_time = pytest.importorskip(
    "path_timing", reason="toppra is not installed: pip install 'redundancy_pin[dev]'", exc_type=ImportError
).least_time

MODE = (1, 1, 1)
CORNER = reference.corner().path
EFFORT = 3.03


def bare() -> VirtualWork:
    return VirtualWork(zoo.robot_of("3rrr", carriers=False, working_mode=MODE))


@functools.cache
def bare_least(rate: float) -> float:
    """Least time round the corner by toppra, s."""
    return float(least_time(bare(), CORNER, EFFORT, rate, steps=100))


def carrying() -> VirtualWork:
    return VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0, working_mode=MODE))


@functools.cache
def free() -> Plan:
    return plan_time_optimal(
        carrying(),
        CORNER,
        limits=Limits(effort=EFFORT, track=(-1.0, 1.0), speed=5.0, acceleration=20.0),
        end="free",
        mesh=Mesh(steps=80),
    )


@pytest.mark.parametrize("rate", [np.inf, 0.35])
def test_without_carriers_the_time_is_that_of_toppra(rate: float) -> None:
    plan = plan_time_optimal(bare(), CORNER, limits=Limits(effort=EFFORT, actuator_speed=rate), mesh=Mesh(steps=60))
    assert plan.status is ResultStatus.OK
    expected = bare_least(rate)
    assert abs(plan.t[-1] / expected - 1.0) < 5e-3
    assert np.abs(plan.actuated_rate).max() <= rate
    if rate == np.inf:
        assert abs(plan.t[-1] - 1.070) < 2e-3
    else:
        assert expected > 1.2


def test_a_coarse_mesh_is_refined_where_the_platform_hardly_moves_until_the_time_is_that_of_toppra() -> None:
    """Where it begins and stops a step lasts longest. Finer nodes round the corner alone leave 6 % of the time."""
    plan = plan_time_optimal(bare(), CORNER, limits=Limits(effort=EFFORT), mesh=Mesh(steps=6))
    assert plan.status is ResultStatus.OK
    assert abs(plan.t[-1] / bare_least(np.inf) - 1.0) < 5e-3


def test_limits_of_actuator_speeds_hold_between_a_few_nodes() -> None:
    """At the nodes alone they are exceeded by a sixth; rates are ∂q/∂x ẋ by a backend that did not plan."""
    most = 0.5
    plan = plan_time_optimal(
        bare(), CORNER, limits=Limits(effort=50.0, actuator_speed=most), mesh=Mesh(steps=6, refinements=0)
    )
    assert plan.status is ResultStatus.OK
    motion = plan.platform_at(np.linspace(0.0, plan.t[-1], 2001))
    rate = np.einsum("nim,ni->nm", RneaDynamics(bare().robot).reduce(motion).W, motion.xd)
    assert 0.99 * most < np.abs(rate).max() <= 1.001 * most


@pytest.mark.parametrize("share", [1.05, pytest.param(1.3, marks=pytest.mark.long)])
def test_a_robot_that_carries_its_weight_has_the_time_of_toppra(share: float) -> None:
    """At rest it needs nearly what its motors have: the first guess of the speed must not be the slowest of all."""
    robot = load_robot("five_bar", gravity=(0.0, -9.81, 0.0))
    home = zoo.home_of(robot)
    end = home + np.array([0.05, -0.08])
    path, dynamics = Line(home, end), RneaDynamics(robot)
    x = np.linspace(home, end, 41)
    at_rest = dynamics.reduce(PlatformMotion(np.arange(41.0), x, 0.0 * x, 0.0 * x, check_rates=False))
    effort = share * np.abs(distribute(at_rest).tau).max()
    plan = plan_time_optimal(dynamics, path, limits=Limits(effort=effort), mesh=Mesh(steps=60))
    assert plan.status is ResultStatus.OK
    assert plan.limits.binding
    assert abs(plan.t[-1] / least_time(dynamics, path, effort, steps=200) - 1.0) < 5e-3


def test_more_actuators_than_freedoms_share_the_load() -> None:
    """An elbow of the 3-RRR is driven as well: the loads they balance are more."""
    robot = bare().robot
    driven = replace(robot, actuated=(*robot.actuated, "elbow_1"))
    plan = plan_time_optimal(RneaDynamics(driven), CORNER, limits=Limits(effort=EFFORT), mesh=Mesh(steps=60))
    assert plan.status is ResultStatus.OK
    assert plan.t[-1] < 0.97
    assert abs(plan.t[-1] / least_time(RneaDynamics(driven), CORNER, EFFORT, steps=80) - 1.0) < 5e-3


def test_carriers_make_the_corner_faster() -> None:
    """0.66 s with a free end, in place of 1.07 s."""
    plan = free()
    assert plan.status is ResultStatus.OK
    assert 0.640 < plan.t[-1] < 0.665
    assert np.abs(plan.motion.xd[[0, -1]]).max() < 1e-9
    assert np.abs(plan.carriers.s).max() <= 1.0
    assert np.abs(plan.carriers.sdd).max() <= 20.0
    assert plan.between is not None
    assert plan.between.peak.max() <= 1.001 * EFFORT
    # finer meshes and lower limits at nodes until the efforts keep their limit between them, and no longer
    *before, last = plan.diagnostics["dense_ratios"]
    assert last <= 1.001
    assert all(ratio > 1.001 for ratio in before)


@pytest.mark.long
@pytest.mark.parametrize(
    ("begin", "end", "acceleration", "least", "most"),
    [
        ("datum", "free", 60.0, 0.40, 0.415),
        ("datum", "datum", 20.0, 1.28, 1.33),
        ("rest", "rest", 20.0, 0.48, 0.51),
        ("free", "periodic", 20.0, 0.48, 0.51),
    ],
)
def test_times_round_the_corner_by_how_carriers_begin_and_end(
    begin: Any, end: Any, acceleration: float, least: float, most: float
) -> None:
    plan = plan_time_optimal(
        carrying(),
        CORNER,
        limits=Limits(effort=EFFORT, track=(-1.0, 1.0), speed=5.0, acceleration=acceleration),
        begin=begin,
        end=end,
    )
    assert plan.status is ResultStatus.OK
    assert least < plan.t[-1] < most


@pytest.mark.long
def test_a_spatial_platform_under_gravity() -> None:
    robot = zoo.robot_of("gough")
    goal = zoo.home_of(robot).copy()
    goal[:3, 3] += [0.1, 0.05, 0.1]
    goal[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix() @ goal[:3, :3]
    path = reference.pose(zoo.home_of(robot), goal).path
    plan = plan_time_optimal(RneaDynamics(robot), path, limits=Limits(effort=80.0), mesh=Mesh(steps=60))
    assert plan.status is ResultStatus.OK
    assert abs(plan.t[-1] / least_time(RneaDynamics(robot), path, 80.0, steps=200) - 1.0) < 5e-3


def test_carriers_that_may_begin_otherwise_and_a_lap_take_less_time() -> None:
    """At rest at the datum, at rest anywhere, anyhow; and round and round, where the platform need not stop."""
    dynamics = VirtualWork(zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))
    circle = circle_path((0.25, 0.4), 0.06)
    parked = plan_time_optimal(dynamics, circle, limits=Limits(effort=2.0), end="datum", mesh=Mesh(steps=20))
    rested = plan_time_optimal(
        dynamics, circle, limits=Limits(effort=2.0), begin="rest", end="rest", mesh=Mesh(steps=20)
    )
    moving = plan_time_optimal(
        dynamics, circle, limits=Limits(effort=2.0), begin="free", end="periodic", mesh=Mesh(steps=20)
    )
    lap = plan_time_optimal(
        dynamics, circle, limits=Limits(effort=2.0), begin="free", end="periodic", lap=True, mesh=Mesh(steps=20)
    )
    assert rested.t[-1] < 0.98 * parked.t[-1]
    assert lap.t[-1] < 0.9 * moving.t[-1]
    for plan in (rested, parked):
        np.testing.assert_allclose(plan.carriers.sd[[0, -1]], 0.0, atol=1e-9)
    np.testing.assert_allclose(parked.carriers.s[[0, -1]], 0.0, atol=1e-9)
    for plan in (moving, lap):
        for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd):
            np.testing.assert_allclose(part[0], part[-1], atol=1e-7)
    for part in (lap.motion.xd, lap.motion.xdd, lap.tau):
        np.testing.assert_allclose(part[0], part[-1], atol=1e-6)
    assert np.abs(lap.motion.xd[0]).max() > 0.1


def test_the_motion_is_on_the_path_and_dynamics_are_the_other_backend_s(tmp_path: Any) -> None:
    plan = free()
    other = RneaDynamics(carrying().robot)
    assert check_plan(plan, other).passed
    plan.save(tmp_path / "fast.npz")
    again = load_plan(tmp_path / "fast.npz")
    t = np.linspace(0.0, plan.t[-1], 50)
    np.testing.assert_allclose(again.platform_at(t).xdd, plan.platform_at(t).xdd, atol=1e-8)
    motion, step = plan.platform_at(t[1:-1]), 1e-6
    ahead, behind = (plan.platform_at(t[1:-1] + sign * step) for sign in (1.0, -1.0))
    np.testing.assert_allclose((ahead.x - behind.x) / (2.0 * step), motion.xd, atol=1e-6)
    near = (np.abs(t[1:-1, None] - plan.motion.t[plan.motion.jumps]) > 2.0 * step).all(axis=1)
    np.testing.assert_allclose(((ahead.xd - behind.xd) / (2.0 * step))[near], motion.xdd[near], atol=1e-3)


def test_forward_dynamics_follow_the_plan() -> None:
    run = simulate(carrying().robot, free())
    np.testing.assert_allclose(run.x, free().platform_at(run.t).x, atol=1e-6)


def test_a_singularity_is_crossed_at_the_limit_of_the_efforts() -> None:
    """The efforts there are what W⁻¹ f tends to from both sides."""
    dynamics = VirtualWork(zoo.robot_of("2rpr", end_effector_mass=0.5))
    plan = plan_time_optimal(
        dynamics, reference.line().path, limits=Limits(effort=1.0), end="free", mesh=Mesh(steps=20)
    )
    assert plan.status is ResultStatus.OK
    (i,) = plan.diagnostics["singular_nodes"]
    for side in (-1e-4, 1e-4):
        (beside,) = plan.efforts_at(plan.t[i : i + 1] + side, RneaDynamics(dynamics.robot))
        np.testing.assert_allclose(plan.tau[i], beside, atol=5e-3)
    assert check_plan(plan, RneaDynamics(dynamics.robot)).passed


def test_a_limit_of_one_motor_alone_is_a_limit() -> None:
    """The others have none: it takes the whole of its torque, and the motion less time than under three limits."""
    plan = plan_time_optimal(bare(), CORNER, limits=Limits(effort=(EFFORT, np.inf, np.inf)), mesh=Mesh(steps=40))
    assert plan.status is ResultStatus.OK
    assert 0.999 * EFFORT <= np.abs(plan.tau[:, 0]).max() <= 1.001 * EFFORT
    assert np.abs(plan.tau[:, 1:]).max() > 2.0 * EFFORT
    assert plan.t[-1] < 0.9 * bare_least(np.inf)


@pytest.mark.long
def test_a_motion_that_the_relaxed_limits_lead_to_is_a_plan() -> None:
    """From a harmonic motion the solver gives up; where all limits may give way, none has to."""
    path, limits = Line((0.0, 0.0, 0.0), (0.03, 0.02, 0.3)), Limits(effort=3.0)
    coarse, fine = (plan_time_optimal("3rrr", path, limits=limits, mesh=Mesh(steps=steps)) for steps in (20, 30))
    assert (coarse.status, fine.status) == (ResultStatus.OK, ResultStatus.OK)
    assert coarse.t[-1] == pytest.approx(fine.t[-1], rel=0.01)  # both within 1 % of a finer one's


def test_what_is_said_to_suffice_under_gravity_suffices_at_a_sharp_turn_too() -> None:
    """Where the platform nearly stops to turn, efforts between the first nodes are 1000 times those at the nodes."""
    links = {"base_distance": 0.2, "proximal_length": 0.37, "distal_length": 0.51, "end_effector_mass": 2.94}
    robot = load_robot("five_bar", gravity=(0.0, -9.81, 0.0), **links)
    path = through_points([(-0.246, 0.471), (-0.107, 0.752), (0.154, 0.524), (-0.081, 0.82)])
    with pytest.raises(InfeasiblePlanError) as caught:
        plan_time_optimal(robot, path, limits=Limits(effort=1.0))
    enough = caught.value.details["limit"]
    for factor in (1.02,):
        plan = plan_time_optimal(robot, path, limits=Limits(effort=factor * enough))
        assert plan.status is ResultStatus.OK
        dense = np.linspace(0.0, plan.t[-1], 1001)
        efforts = distribute(RneaDynamics(robot).reduce(plan.platform_at(dense))).tau
        assert np.abs(efforts).max() <= 1.001 * factor * enough
