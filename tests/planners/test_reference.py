"""What a plan means between its samples, and the efforts that belong to it."""

from __future__ import annotations

import functools

import numpy as np
import pytest
import zoo
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import motion_reference, plan_reference
from redundancy_pin.trajectory.continuous_motion import as_motion

SERIES = 1e-10
"""m, m/s: ten nodes in 5 ms of a smooth motion leave rounding, magnified by differentiation to 1e-11."""

EFFORTS = 1e-8
"""N, N·m: efforts of order 10 through two codes."""


@functools.cache
def corner() -> rp.trajectory.Trajectory:
    return rp.trajectory.reference.corner(radius=0.025)


@functools.cache
def stepwise_plan() -> Plan:
    return rp.plan_stepwise(rp.CompiledDynamics(zoo.robot_of("3rrr")), corner(), mesh=rp.Mesh(dt=0.01))


@functools.cache
def whole_plan() -> Plan:
    return rp.plan_whole_trajectory(rp.CompiledDynamics(zoo.robot_of("3rrr")), corner(), mesh=rp.Mesh(dt=0.01))


@functools.cache
def off_plan() -> Plan:
    circle = rp.trajectory.reference.circle(speed=0.5)
    return rp.plan_switch_off(rp.CompiledDynamics(zoo.robot_of("2rpr")), circle, threshold=5.0, mesh=rp.Mesh(dt=0.02))


def inside(plan: Plan, seed: int = 0) -> Array:
    """Return random times within a plan, none of them a sample."""
    return np.sort(np.random.default_rng(seed).uniform(plan.t[0], plan.t[-1], 40))


def test_the_reference_of_a_whole_trajectory_plan_has_its_efforts() -> None:
    plan = whole_plan()
    reference = plan_reference(plan, motion=corner())
    assert reference.effort_deviation < EFFORTS
    times = inside(plan)
    # between the samples: W⁻¹ f of the exact trajectory by the other backend
    dynamics = rp.VirtualWork(zoo.robot_of("3rrr"))
    reduced = dynamics.reduce(corner().sample_at(times), plan.carriers_at(times), check_track=False)
    tau = rp.distribute(reduced).tau
    np.testing.assert_allclose([reference.loads(t)[0] for t in times], tau, atol=EFFORTS)
    np.testing.assert_allclose([reference.loads(t)[1] for t in times], reduced.carrier_force, atol=EFFORTS)


def test_a_reference_point_agrees_with_itself_and_the_trajectory() -> None:
    plan = whole_plan()
    reference = plan_reference(plan, motion=corner())
    robot = reference.robot
    for t in inside(plan, 1):
        point, exact = reference.at(float(t)), corner().evaluate(t)
        for ours, theirs in ((point.x, exact.x), (point.xd, exact.xd), (point.xdd, exact.xdd)):
            np.testing.assert_allclose(ours, theirs, atol=SERIES * 100)
        for ours, theirs in (
            (point.s, point.q[robot.carrier_position]),
            (point.sd, point.v[robot.carrier_velocity]),
            (point.sdd, point.a[robot.carrier_velocity]),
        ):
            np.testing.assert_allclose(ours, theirs, atol=SERIES)
    assert reference.at(-1.0).tau == pytest.approx(reference.at(reference.start).tau)
    assert reference.at(99.0).tau == pytest.approx(reference.at(reference.end).tau)


def test_where_a_plan_has_its_actuators_off_the_reference_has_no_efforts() -> None:
    plan = off_plan()
    reference = plan_reference(plan)
    window = plan.diagnostics["windows"][0]
    entry, leave = window["entry"], window["exit"]
    times = np.linspace(entry, leave, 40)[1:-1]
    assert not np.array([reference.loads(t)[0] for t in times]).any()
    assert np.abs(reference.loads(0.5 * (window["ramp_start"] + entry))[0]).min() > 0.1
    assert np.abs(np.array([reference.loads(t)[1] for t in times])).max() > 0.1


def test_between_two_samples_at_rest_a_plan_has_its_efforts() -> None:
    """A step from rest to rest: no effort at either sample, but in between."""
    robot = zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    path = rp.trajectory.Line((0.25, 0.45), (0.2, 0.35))
    motion = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=0.5))
    plan = rp.plan_switch_off(rp.CompiledDynamics(robot), motion, threshold=5.0, mesh=rp.Mesh(dt=0.5))
    assert len(plan.t) == 2
    assert not plan.tau.any()
    reference = plan_reference(plan, robot=robot, motion=motion)
    times = np.array([0.1, 0.2, 0.4])
    expected = rp.distribute(rp.RneaDynamics(robot).reduce(motion.sample_at(times))).tau
    assert np.abs(expected).max() > 0.1
    # half a second is long for one polynomial
    np.testing.assert_allclose([reference.loads(t)[0] for t in times], expected, atol=1e-3)


@pytest.mark.parametrize("name", ["3rrr", "gough"])
def test_every_state_is_that_of_the_motion(name: str) -> None:
    """Of a planar robot, and of one whose platform has poses."""
    robot = zoo.robot_of(name)
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.2, 11))
    reference = motion_reference(robot, motion, step=0.02)
    times = np.array([0.0313, 0.1171, 0.1999])
    exact = as_motion(motion).sample_at(times)
    tree = inverse_kinematics(robot, exact)
    for i, t in enumerate(times):
        point = reference.at(t)
        for part in ("x", "xd", "xdd"):
            np.testing.assert_allclose(getattr(point, part), getattr(exact, part)[i], atol=1e-7)
        for part in ("q", "v", "a"):
            np.testing.assert_allclose(getattr(point, part), getattr(tree, part)[i], atol=1e-6)
        for same, parts in (
            (reference.platform(t), (point.x, point.xd, point.xdd)),
            (reference.carriers(t), (point.s, point.sd, point.sdd)),
            (reference.tree(t), (point.q, point.v, point.a)),
        ):
            for ours, theirs in zip(same, parts, strict=True):
                np.testing.assert_array_equal(ours, theirs)


def test_a_trajectory_that_a_plan_was_not_made_for_is_refused() -> None:
    plan = whole_plan()
    robot = zoo.robot_of("3rrr")
    for radius in (0.013, 0.05):  # shorter, and longer
        other = rp.trajectory.reference.corner(radius=radius)
        with pytest.raises(InputError, match=r"The plan runs from 0 to 1\.79\d* s, the trajectory to"):
            plan_reference(plan, robot=robot, motion=other)


def test_a_platform_stays_where_it_is_while_carriers_go_on() -> None:
    plan = stepwise_plan()
    end = corner().duration
    assert plan.t[-1] > end + 0.1
    reference = plan_reference(plan, motion=corner())
    point = reference.at(0.5 * (end + float(plan.t[-1])))
    np.testing.assert_allclose(point.x, corner().evaluate(end).x, atol=SERIES)
    assert np.abs(np.concatenate([point.xd, point.xdd])).max() < SERIES
    assert np.abs(point.sd).max() > 1e-2


def test_motions_without_finite_efforts_have_no_reference() -> None:
    robot = zoo.robot_of("2rpr", end_effector_mass=0.5)
    # braking across the line of the legs: W⁻¹ f has a pole there, which no node need meet
    path = rp.trajectory.Line([0.2, 0.1], [0.2, -0.05])
    motion = rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=0.4))
    crossing = brentq(lambda t: motion.evaluate(t).x[1], 0.1, 0.35)
    with pytest.raises(InfeasiblePlanError, match="no finite efforts") as caught:
        motion_reference(robot, motion)
    assert caught.value.details["time"] == pytest.approx(crossing, abs=1e-6)
    exactly = rp.PlatformMotion(
        [0.0, 0.1], [[0.2, 0.0], [0.25, 0.0]], [[0.5, 0.0], [0.5, 0.0]], [[0.0, 0.3], [0.0, 0.3]]
    )
    with pytest.raises(InfeasiblePlanError, match="no finite efforts") as caught:
        motion_reference(robot, exactly)
    assert caught.value.details["time"] == 0.0


@pytest.mark.long_for("off_plan", "stepwise_plan")
@pytest.mark.parametrize("plan", [stepwise_plan, whole_plan, off_plan])
def test_a_plan_from_a_file_is_the_same_motion(plan, tmp_path) -> None:
    plan = plan()
    plan.save(tmp_path / "plan.npz")
    again = rp.load_plan(tmp_path / "plan.npz")
    times = inside(plan)
    for ours, theirs in (
        (again.carriers_at(times).sdd, plan.carriers_at(times).sdd),
        (again.platform_at(times).xdd, plan.platform_at(times).xdd),
    ):
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=1e-10 * np.abs(theirs).max())
    first, second = plan_reference(plan), plan_reference(again)
    size = max(float(np.abs(plan.tau).max()), 1.0)
    np.testing.assert_allclose(second.efforts(times), first.efforts(times), rtol=0.0, atol=1e-7 * size)
    again.save(tmp_path / "again.npz")
    assert (tmp_path / "again.npz").read_bytes() == (tmp_path / "plan.npz").read_bytes()
