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
    JointForces,
    PlatformMotion,
    RneaDynamics,
    VirtualWork,
    Wrench,
    check_plan,
    distribute,
    load_plan,
    load_robot,
    plan_time_optimal,
    simulate,
)
from redundancy_pin.errors import InfeasiblePlanError, InputError, UnsupportedRobotError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.planners.options import Limits, Mesh
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import Line, reference

pytest.importorskip("casadi")
least_time = pytest.importorskip(
    "path_timing", reason="toppra is not installed: pip install 'redundancy_pin[dev]'", exc_type=ImportError
).least_time

MODE = (1, 1, 1)
CORNER = reference.corner().path
LIMITS: dict[str, Any] = {"track": (-1.0, 1.0), "speed": 5.0, "acceleration": 20.0}
EFFORT = 3.03


def bare() -> VirtualWork:
    return VirtualWork(zoo.robot_of("3rrr", carriers=False, working_mode=MODE))


def carrying() -> VirtualWork:
    return VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0, working_mode=MODE))


@functools.cache
def free() -> Plan:
    return plan_time_optimal(
        carrying(), CORNER, end="free", **in_groups(plan_time_optimal, dict(effort=EFFORT, steps=80, **LIMITS))
    )


@pytest.mark.parametrize("rate", [np.inf, pytest.param(0.35, marks=pytest.mark.long)])
def test_without_carriers_the_time_is_that_of_toppra(rate: float) -> None:
    plan = plan_time_optimal(bare(), CORNER, limits=Limits(effort=EFFORT, actuator_speed=rate), mesh=Mesh(steps=100))
    assert plan.status is ResultStatus.OK
    expected = least_time(bare(), CORNER, EFFORT, rate, steps=200)
    assert abs(plan.t[-1] / expected - 1.0) < 5e-3
    assert np.abs(plan.actuated_rate).max() <= rate
    if rate == np.inf:
        assert abs(plan.t[-1] - 1.070) < 2e-3
    else:
        assert expected > 1.2


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
    assert abs(plan.t[-1] / least_time(dynamics, path, effort, steps=400) - 1.0) < 5e-3


def test_rates_are_looked_at_between_the_nodes(monkeypatch: pytest.MonkeyPatch) -> None:
    """By differences of the inverse kinematics' angles: few nodes, between which rates exceed 0.35 rad/s by 6 %."""
    options = {"effort": EFFORT, "actuator_speed": 0.35, "steps": 10}
    fine, plan = (
        plan_time_optimal(bare(), CORNER, **in_groups(plan_time_optimal, dict(refinements=often, **options)))
        for often in (3, 0)
    )
    monkeypatch.setattr("redundancy_pin.planners.optimal.refine.LOWERED", 0)
    coarse = plan_time_optimal(bare(), CORNER, **in_groups(plan_time_optimal, dict(refinements=0, **options)))
    robot, worst = bare().robot, []
    for each in (coarse, plan, fine):
        t = np.linspace(0.0, each.t[-1], 1000)
        at = [robot.model.joints[robot.model.getJointId(name)].idx_q for name in robot.actuated]
        angles = np.asarray(inverse_kinematics(robot, each.platform_at(t)).q)[:, at]
        worst.append(np.abs(np.gradient(np.unwrap(angles, axis=0), t, axis=0)).max() / 0.35)
    assert worst[0] > 1.05
    assert coarse.status is ResultStatus.LIMIT_VIOLATED
    events = [event for event in coarse.limits.violated if event.quantity == "speed"]
    assert {event.carrier for event in events} <= set(robot.actuated)
    assert max(abs(event.value) for event in events) == pytest.approx(0.35 * worst[0], rel=2e-3)
    assert check_plan(coarse, RneaDynamics(robot)).passed
    for each, use in zip((plan, fine), worst[1:], strict=True):
        assert 0.999 < use < 1.001
        assert "speed" in {event.quantity for event in each.limits.binding}
        assert "speed" not in {event.quantity for event in each.limits.violated}
    assert fine.status is ResultStatus.OK


def test_more_actuators_than_freedoms_share_the_load() -> None:
    """An elbow of the 3-RRR is driven as well: the loads they balance are more."""
    robot = bare().robot
    driven = replace(robot, actuated=(*robot.actuated, "elbow_1"))
    plan = plan_time_optimal(RneaDynamics(driven), CORNER, limits=Limits(effort=EFFORT), mesh=Mesh(steps=60))
    assert plan.status is ResultStatus.OK
    assert plan.t[-1] < 0.97
    assert abs(plan.t[-1] / least_time(RneaDynamics(driven), CORNER, EFFORT, steps=120) - 1.0) < 5e-3


def test_carriers_make_the_corner_faster() -> None:
    """0.66 s with a free end, in place of 1.07 s."""
    plan = free()
    assert plan.status is ResultStatus.OK
    assert 0.640 < plan.t[-1] < 0.665
    assert np.abs(plan.motion.xd[[0, -1]]).max() < 1e-9
    assert np.abs(plan.carriers.s).max() <= 1.0
    assert np.abs(plan.carriers.sdd).max() <= LIMITS["acceleration"]
    assert plan.between is not None
    assert plan.between.peak.max() <= 1.001 * EFFORT
    # finer meshes and lower limits at nodes until the efforts keep their limit between them, and no longer
    *before, last = plan.diagnostics["dense_ratios"]
    assert last <= 1.001
    assert all(ratio > 1.001 for ratio in before)


@pytest.mark.long
@pytest.mark.parametrize(
    ("options", "least", "most"),
    [
        ({"end": "free", "acceleration": 60.0}, 0.40, 0.415),
        ({}, 1.28, 1.33),
        ({"begin": "rest", "end": "rest"}, 0.48, 0.51),
        ({"begin": "free", "end": "periodic"}, 0.48, 0.51),
    ],
)
def test_times_round_the_corner_by_how_carriers_begin_and_end(options: Any, least: float, most: float) -> None:
    plan = plan_time_optimal(
        carrying(), CORNER, **in_groups(plan_time_optimal, dict(effort=EFFORT, **{**LIMITS, **options}))
    )
    assert plan.status is ResultStatus.OK
    assert least < plan.t[-1] < most
    if options.get("end") == "periodic":
        for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd):
            np.testing.assert_allclose(part[0], part[-1], atol=1e-7)


@pytest.mark.long
def test_forces_and_jerks_of_carriers_are_kept() -> None:
    plan = plan_time_optimal(
        carrying(),
        CORNER,
        end="free",
        **in_groups(plan_time_optimal, dict(effort=EFFORT, carrier_force=30.0, jerk=500.0, steps=60, **LIMITS)),
    )
    assert plan.status is ResultStatus.OK
    assert free().t[-1] < plan.t[-1] < 0.9
    assert 29.9 < np.abs(plan.carrier_force).max() <= 30.0
    step = np.diff(plan.t)
    jerk = np.diff(plan.carriers.sdd, axis=0)[step > 0.0] / step[step > 0.0, None]
    assert 499.0 < np.abs(jerk).max() <= 500.0


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


@pytest.mark.long
def test_a_lap_goes_on_where_it_began() -> None:
    square = reference.square().path
    plans = [
        plan_time_optimal(bare(), square, limits=Limits(effort=EFFORT), lap=True, mesh=Mesh(steps=100)),
        plan_time_optimal(
            carrying(),
            square,
            lap=True,
            begin="free",
            end="periodic",
            **in_groups(plan_time_optimal, dict(effort=EFFORT, steps=100, **LIMITS)),
        ),
    ]
    for plan in plans:
        assert plan.status is ResultStatus.OK
        for part in (plan.motion.xd, plan.motion.xdd, plan.tau):
            np.testing.assert_allclose(part[0], part[-1], atol=1e-6)
        assert np.abs(plan.motion.xd[0]).max() > 0.1
    assert plans[1].t[-1] < 0.5 * plans[0].t[-1]


def test_no_scaled_law_of_a_plan_is_faster() -> None:
    """The same motion run faster exceeds a limit everywhere it is bound: some effort or s̈ is at its limit."""
    plan = free()
    inner = slice(3, -3)
    used = np.maximum(
        np.abs(plan.tau).max(axis=1) / EFFORT, np.abs(plan.carriers.sdd).max(axis=1) / LIMITS["acceleration"]
    )[inner]
    assert (used > 0.99).mean() > 0.95


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


@pytest.mark.long
def test_a_singularity_is_crossed_at_the_limit_of_the_efforts() -> None:
    dynamics = VirtualWork(zoo.robot_of("2rpr", end_effector_mass=0.5))
    plan = plan_time_optimal(
        dynamics, reference.line().path, limits=Limits(effort=1.0), end="free", mesh=Mesh(steps=50)
    )
    assert plan.status is ResultStatus.OK
    (i,) = plan.diagnostics["singular_nodes"]
    beside = plan.efforts_at(plan.t[i] + np.array([-1e-3, 1e-3]), RneaDynamics(dynamics.robot))
    np.testing.assert_allclose(plan.tau[i], beside.mean(axis=0), atol=0.03)  # what W⁻¹ f tends to
    assert check_plan(plan, RneaDynamics(dynamics.robot)).passed
    run = simulate(dynamics.robot, plan)
    np.testing.assert_allclose(run.x, plan.platform_at(run.t).x, atol=1e-6)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ({}, "effort"),
        ({"effort": 3.0, "begin": "anyhow"}, "begin"),
        ({"effort": 3.0, "lap": True}, "closed"),
        ({"effort": -1.0}, "effort"),
        ({"effort": 3.0, "steps": 2}, "steps"),
        ({"effort": 3.0, "actuator_speed": 0.0}, "actuator_speed"),
    ],
)
def test_bad_options_are_named(options: dict[str, Any], word: str) -> None:
    with pytest.raises(InputError, match=word):
        plan_time_optimal(bare(), CORNER, **in_groups(plan_time_optimal, options))


def test_samples_are_no_path() -> None:
    with pytest.raises(InputError, match="path"):
        plan_time_optimal(bare(), reference.corner().sample(0.1), limits=Limits(effort=1.0))  # type: ignore[arg-type]


def test_what_is_not_covered_is_refused() -> None:
    def gust(t: np.ndarray, x: np.ndarray, xd: np.ndarray) -> np.ndarray:
        return np.outer(np.sin(8.0 * t), np.eye(6)[0])

    robot = bare().robot
    for load in (JointForces("base_1", friction=1.0), Wrench(robot.platform.frame, gust)):
        with pytest.raises(UnsupportedRobotError, match="dry friction and loads that depend on time"):
            plan_time_optimal(
                RneaDynamics(robot.loaded(load)), CORNER, limits=Limits(effort=EFFORT), mesh=Mesh(steps=20)
            )


def test_weight_beyond_the_efforts_is_infeasible() -> None:
    heavy = RneaDynamics(zoo.robot_of("3rrr", carriers=False, working_mode=MODE, gravity=(0.0, -9.81, 0.0)))
    with pytest.raises(InfeasiblePlanError) as caught:
        plan_time_optimal(heavy, CORNER, limits=Limits(effort=EFFORT), mesh=Mesh(steps=6))
    assert caught.value.details["constraint"] == "effort"
