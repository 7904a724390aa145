"""Efforts as functions of time, against the plan they come from and against the other backend."""

import itertools

import numpy as np
import pytest
import zoo
from engine_oracles import Timed
from engines import Task, drive_of_motion, drive_of_plan
from engines.cases import SHORT, straight
from engines.task import segments
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.reference import plan_reference

EFFORT_TOLERANCE = 1e-6
"""N: beside a singular node the planner's own residual of 1e-9 N is divided by the distance to it."""


@pytest.fixture(scope="module")
def planned():
    robot = zoo.robot_of("2rpr", **SHORT.arguments)
    trajectory = SHORT.trajectory(robot)
    return robot, trajectory, rp.plan_whole_trajectory(rp.RneaDynamics(robot), trajectory)


def test_the_short_case_crosses_a_singularity(planned):
    robot, trajectory, _ = planned
    (crossing,) = rp.find_crossings(robot, trajectory)
    assert crossing.crosses
    assert crossing.kind.label == "type_ii"


def test_efforts_are_those_of_the_plan_at_its_nodes_and_of_the_other_backend_between(planned):
    robot, trajectory, plan = planned
    drive = drive_of_plan(rp.RneaDynamics(robot), plan, trajectory)
    np.testing.assert_allclose(drive.task.efforts(plan.t)[:, :2], plan.tau, atol=EFFORT_TOLERANCE)
    assert drive.plan is plan
    assert drive.plan_gap < EFFORT_TOLERANCE
    assert drive.resolution < EFFORT_TOLERANCE
    t = np.sort(np.random.default_rng(0).uniform(0.0, trajectory.duration, 500))
    (crossing,) = rp.find_crossings(robot, trajectory)
    t = t[np.abs(t - crossing.t) > 1e-3]
    reduced = rp.VirtualWork(robot).reduce(trajectory.sample_at(t), drive.carriers(t))
    expected = np.concatenate([rp.distribute(reduced).tau, reduced.carrier_force], axis=1)
    np.testing.assert_allclose(drive.task.efforts(t), expected, atol=EFFORT_TOLERANCE)


def test_every_node_of_a_plan_ends_a_step(planned):
    """There the slope of the efforts jumps; a step across it has an error of lower order."""
    robot, trajectory, plan = planned
    task = drive_of_plan(rp.RneaDynamics(robot), plan, trajectory).task
    ends = np.concatenate([part.t[[0, -1]] for part in segments(task, 0.02)])
    assert set(plan.t) <= set(ends)


def test_a_plan_whose_trajectory_is_not_at_hand_is_read_between_its_samples(planned):
    robot, trajectory, plan = planned
    exact = drive_of_plan(rp.RneaDynamics(robot), plan, trajectory)
    read = drive_of_plan(rp.RneaDynamics(robot), plan)
    t = np.linspace(0.0, trajectory.duration, 777)
    # quintics over 5 ms
    np.testing.assert_allclose(read.platform(t).x, exact.platform(t).x, atol=1e-9)
    np.testing.assert_allclose(read.task.efforts(t), exact.task.efforts(t), atol=2e-3)


def test_a_stepwise_plan_is_the_same_motion_to_an_engine_as_to_the_simulation():
    """Carriers and efforts, sample by sample and in between: two codes, one meaning of a plan."""
    robot = zoo.robot_of("3rrr")
    trajectory = rp.trajectory.reference.corner(0.025)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), trajectory.sample(dt=0.02))
    drive = drive_of_plan(rp.RneaDynamics(robot), plan)
    reference = plan_reference(plan, robot=robot)
    t = np.sort(np.random.default_rng(2).uniform(plan.t[0], plan.t[-1], 200))
    own = drive.carriers(t)
    for values, i in ((own.s, 0), (own.sd, 1), (own.sdd, 2)):
        np.testing.assert_allclose(values, [reference.carriers(time)[i] for time in t], atol=1e-9)
    loads = [np.concatenate(reference.loads(time)) for time in t]
    np.testing.assert_allclose(drive.task.efforts(t), loads, atol=EFFORT_TOLERANCE)
    np.testing.assert_allclose(drive.task.q, reference.tree(0.0)[0], atol=1e-12)
    np.testing.assert_allclose(drive.task.v, reference.tree(0.0)[1], atol=1e-12)
    # in a step of backward differences s̈ is that of the sample that ends it; the lag of s moves the efforts a little
    ends = np.searchsorted(plan.t, t)
    stepped = np.isin(plan.phase[ends], [plan.phases.index(name) for name in ("optimise", "brake")])
    assert stepped.sum() > 100
    np.testing.assert_allclose(own.sdd[stepped], plan.carriers.sdd[ends[stepped]], atol=1e-12)
    assert 1e-3 < drive.plan_gap < 0.05 * np.abs(plan.tau).max()
    assert reference.effort_deviation < 0.05 * np.abs(plan.tau).max()


def test_where_a_plan_has_its_actuators_off_an_engine_gets_no_efforts():
    robot = zoo.robot_of("2rpr")
    circle = rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=5.0, mesh=rp.Mesh(dt=0.02))
    drive = drive_of_plan(rp.RneaDynamics(robot), plan)
    window = plan.diagnostics["windows"][0]
    inside = np.linspace(window["entry"], window["exit"], 100)[1:-1]
    assert not drive.task.efforts(inside)[:, :2].any()
    assert np.abs(drive.task.efforts(inside)[:, 2:]).max() > 0.1
    before = drive.task.efforts(np.array([0.5 * (window["ramp_start"] + window["entry"])]))
    assert np.abs(before[:, :2]).min() > 0.1


def test_the_start_is_closed_and_moves_with_the_platform_and_the_carriers():
    robot = zoo.robot_of("3rrr")
    motion = Timed(robot, 0.2)
    drive = drive_of_motion(rp.RneaDynamics(robot), motion, lambda t: zoo.carriers_at(robot, t))
    state = zoo.system_of(robot).evaluate(np.array(drive.task.q)[None])
    assert np.abs(state.phi).max() < 1e-11
    assert np.abs(state.Jc[0] @ drive.task.v).max() < 1e-11
    np.testing.assert_allclose(state.Jx[0] @ drive.task.v, motion.sample_at([0.0]).xd[0], atol=1e-11)
    np.testing.assert_allclose(drive.task.v[robot.carrier_velocity], zoo.carriers_at(robot, [0.0]).sd[0])


def test_jumping_efforts_are_given_on_both_sides():
    robot = zoo.robot_of("3rrr")
    trajectory = rp.trajectory.reference.corner(0.025)
    drive = drive_of_motion(rp.RneaDynamics(robot), trajectory)
    assert set(trajectory.breaks) <= set(drive.task.breaks)
    both = rp.RneaDynamics(robot).reduce(trajectory.sample_at(np.repeat(trajectory.breaks, 2)))
    expected = rp.distribute(both).tau
    assert np.abs(expected[0] - expected[1]).max() > 1.0
    np.testing.assert_allclose(drive.task.efforts(trajectory.breaks, side="left")[:, :3], expected[0::2], atol=1e-9)
    np.testing.assert_allclose(drive.task.efforts(trajectory.breaks)[:, :3], expected[1::2], atol=1e-9)


def test_steps_end_at_breaks_and_none_is_too_long():
    robot = zoo.robot_of("3rrr")
    task = drive_of_motion(rp.RneaDynamics(robot), rp.trajectory.reference.corner(0.025)).task
    parts = segments(task, 0.003)
    edges = [task.start, *task.breaks, task.end]
    assert [float(part.t[0]) for part in parts] == edges[:-1]
    assert [float(part.t[-1]) for part in parts] == edges[1:]
    for part in parts:
        assert part.step <= 0.003 * (1 + 1e-9)
        np.testing.assert_allclose(np.diff(part.t), part.step, rtol=1e-9)
    np.testing.assert_array_equal(parts[2].effort[-1], task.efforts(parts[2].t[-1:], side="left")[0])
    np.testing.assert_array_equal(parts[3].effort[0], task.efforts(parts[3].t[:1])[0])


def test_a_singular_instant_without_carriers_that_help_has_no_efforts():
    robot = zoo.robot_of("2rpr", end_effector_mass=0.5)
    motion = straight((0.15, 0.1), (0.2, -0.1), 0.6)
    (crossing,) = rp.find_crossings(robot, motion)
    width = 0.009  # one stretch, placed so that the third of its ten points is the crossing
    nodes = width * np.sort(np.cos(np.pi * (np.arange(10) + 0.5) / 10) + 1.0) / 2.0
    shifted = crossing.t - nodes[2]
    with pytest.raises(InfeasiblePlanError, match="no finite efforts") as caught:
        drive_of_motion(rp.RneaDynamics(robot), motion, knots=[shifted, shifted + width])
    assert caught.value.details["time"] == pytest.approx(crossing.t, abs=1e-6)
    assert "plan_whole_trajectory" in caught.value.remedy


def test_another_trajectory_is_refused(planned):
    robot, _, plan = planned
    with pytest.raises(InputError, match=r"The plan runs from 0 to 0\.6 s, the trajectory to 0\.7 s"):
        drive_of_plan(rp.RneaDynamics(robot), plan, straight((0.15, 0.1), (0.2, -0.1), 0.7))


def test_breaks_outside_the_interval_are_refused():
    robot = zoo.robot_of("four_bar")
    q, v = np.array(robot.q_reference), np.zeros(robot.model.nv)
    with pytest.raises(InputError, match="does not increase"):
        Task(robot, 0.0, 1.0, q, v, lambda t, side="right": np.zeros((len(t), 1)), np.array([1.5]))


@examples(30)
@given(step=st.floats(1e-3, 10.0), where=st.lists(st.floats(0.01, 0.99), max_size=5, unique=True))
def test_any_breaks_and_any_step_cut_the_whole_interval(step, where):
    robot = zoo.robot_of("four_bar")
    q, v = np.array(robot.q_reference), np.zeros(robot.model.nv)
    task = Task(robot, 0.0, 1.0, q, v, lambda t, side="right": np.zeros((len(t), 1)), np.sort(where))
    parts = segments(task, step)
    assert [parts[0].t[0], parts[-1].t[-1]] == [0.0, 1.0]
    assert set(where) <= {float(part.t[-1]) for part in parts}
    for part, following in itertools.pairwise(parts):
        assert part.t[-1] == following.t[0]
    for part in parts:
        assert (np.diff(part.t) > 0.0).all()
        assert part.step <= step * (1 + 1e-9)
        assert len(part.effort) == len(part.t)


@pytest.mark.parametrize("step", [0.0, -1e-3, np.nan, np.inf])
def test_a_step_that_is_none_is_refused(step):
    robot = zoo.robot_of("four_bar")
    task = drive_of_motion(rp.RneaDynamics(robot), straight((1.0,), (1.1,), 0.1)).task
    with pytest.raises(InputError, match="The step is"):
        segments(task, step)
