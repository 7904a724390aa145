"""``simulate`` against outside engines: the same torques and carrier forces, planned or not, give the same motion."""

import functools

import numpy as np
import pytest
import zoo
from engines import Task, deviation, drive_of_plan, run_exudyn, run_mujoco, run_own
from engines.cases import CASES, SHORT, prepare
from engines.own import TaskEfforts
from scipy.interpolate import CubicHermiteSpline

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.simulation import closed_state
from redundancy_pin.status import ResultStatus

TOLERANCE = 1e-5
"""m and rad, every joint of the tree."""

EXTRAPOLATED = 1e-8
"""m and rad: what is of higher order, Newton's tolerance and the softness of constraints; measured 1e-9 or less."""

OWN_TOLERANCE = 1e-9
"""m and rad: a plan followed by the default settings; the efforts are planned to 1e-9 N."""

ACROSS_KINKS = 1e-4
"""m and rad: steps across kinks of the efforts. What such a step misses depends on where it falls: 0.8e-5 to 1.9e-5 at
relative tolerances of 1e-7, 5e-8 and 3e-8, on two plans of the same motion."""

MASSES = {"2rpr": SHORT.arguments, "3rrr": {}}
"""Everything that moves has mass, which MuJoCo asks for."""

TURN = next(case for case in CASES if case.name == "3-RRR turn while moving")


@pytest.fixture(params=["exudyn", "mujoco"])
def engine(request):
    pytest.importorskip(request.param, reason=f"{request.param} is in the extra engines")
    return {"exudyn": run_exudyn, "mujoco": run_mujoco}[request.param]


@pytest.fixture(scope="module")
def planned():
    cases = {case.robot: case for case in (SHORT, TURN)}
    return functools.cache(lambda name: prepare(cases[name], rp.RneaDynamics))


def waves(robot, size):
    """Efforts that no plan asks for."""

    def efforts(t, side="right"):
        return size * np.sin(7.0 * np.asarray(t)[:, None] + np.arange(robot.m + robot.k))

    return efforts


def thrown(name):
    """A machine thrown through a type II pose, and driven by some efforts or other."""
    robot = zoo.robot_of(name, **MASSES[name])
    if name == "2rpr":
        start, duration = closed_state(robot, [0.2, 0.1], [0.1, -1.0], [0.05, -0.05], [0.2, -0.1]), 0.25
    else:
        start, duration = closed_state(robot, xd=[0.1, -0.1, -5.0], s=0.1, sd=[0.3, -0.2, 0.1]), 0.35
    return Task(robot, 0.0, duration, start.q, start.v, waves(robot, 0.5))


def difference(other, run):
    """Distances (N, nq) of all joints at the instants of ``found``, the engine's steps joined by cubics."""
    assert run.status is ResultStatus.OK
    return CubicHermiteSpline(run.t, run.q, run.v)(other.t) - other.q


def crossings(simulation):
    return [event for event in simulation.events if event.kind == "type_II"]


@pytest.mark.long_for("exudyn-3rrr", "mujoco-3rrr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_the_same_efforts_give_the_same_motion_through_a_type_ii_pose(engine, name):
    task = thrown(name)
    own = rp.simulate(task.robot, TaskEfforts(task), stop_at=(), dt=0.01)
    assert len(crossings(own)) == 1
    assert np.abs(own.q[-1] - own.q[0]).max() > 0.1
    coarse, fine = (difference(own, engine(task, step=step)) for step in (2.5e-4, 1.25e-4))
    assert np.abs(fine).max() < TOLERANCE
    # what is left is the error of the engine, of second order in the step
    assert np.abs(4.0 * fine - coarse).max() / 3.0 < EXTRAPOLATED


@pytest.mark.long_for("exudyn-3rrr", "mujoco-3rrr", "exudyn-2rpr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_planned_efforts_too(engine, planned, name):
    task = planned(name).task
    own = rp.simulate(task.robot, TaskEfforts(task), stop_at=(), dt=0.01)
    assert len(crossings(own)) == 1
    assert np.abs(difference(own, engine(task, step=1e-3))).max() < TOLERANCE


@pytest.mark.long
@pytest.mark.long_for("exudyn")
def test_a_stepwise_plan_too_whose_carriers_jump_in_acceleration_at_every_sample(engine):
    robot, trajectory = zoo.robot_of("3rrr"), rp.trajectory.reference.corner(0.025)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), trajectory.sample(dt=0.02))
    drive = drive_of_plan(rp.RneaDynamics(robot), plan, trajectory)
    assert deviation(drive, run_own(drive.task)).largest < OWN_TOLERANCE
    assert deviation(drive, engine(drive.task, step=1e-3)).largest < TOLERANCE
    # the samples themselves are elsewhere: the lag of backward differences, here half of 20 ms at up to 1 m/s
    assert np.abs(drive.carriers(plan.t).s - plan.carriers.s).max() > 1e-3


@pytest.mark.long_for("3rrr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_a_plan_is_followed_by_the_efforts_that_engines_get(planned, name):
    drive = planned(name)
    run = run_own(drive.task)
    assert run.status is ResultStatus.OK
    assert run.engine == "redundancy_pin"
    assert run.t[-1] == drive.task.end
    assert deviation(drive, run).largest < OWN_TOLERANCE
    assert run.gap.max() < 1e-9


@pytest.mark.long
def test_steps_may_reach_across_kinks_where_the_tolerance_is_loose(planned):
    drive = planned("3rrr")
    loose = {"integrator": "RK45", "rtol": 1e-7, "atol": 1e-8}
    every, jumps = (run_own(drive.task, restart_at=where, **loose) for where in ("breaks", "jumps"))
    assert jumps.steps < every.steps / 2
    assert deviation(drive, jumps).largest < ACROSS_KINKS
    assert deviation(drive, jumps).largest > deviation(drive, every).largest
    with pytest.raises(InputError, match="restart_at is 'kinks'"):
        run_own(drive.task, restart_at="kinks")


def test_efforts_are_those_of_the_task_from_the_side_of_their_jumps():
    robot = zoo.robot_of("2rpr", **SHORT.arguments)
    smooth = waves(robot, 1.0)

    def jumping(t, side="right"):
        after = t >= 0.3 if side == "right" else t > 0.3
        kinked = np.maximum(np.asarray(t)[:, None] - 0.1, 0.0)
        return smooth(t) + kinked + after[:, None]

    q, v = np.array(robot.q_reference), np.zeros(robot.model.nv)
    drive = TaskEfforts(Task(robot, 0.0, 0.5, q, v, jumping, np.array([0.1, 0.3])))
    np.testing.assert_array_equal(drive.breaks, [0.1, 0.3])
    np.testing.assert_array_equal(drive.jumps, [0.3])
    for t in (0.0, 0.05, 0.1, 0.25, 0.3, 0.41, 0.5):
        effort = np.concatenate(drive.effort(t, closed_state(robot)))
        np.testing.assert_allclose(effort, jumping(np.array([t]))[0], atol=1e-10)
    before = np.concatenate(drive.effort(np.nextafter(0.3, 0.0), closed_state(robot)))
    np.testing.assert_allclose(before, jumping(np.array([0.3]), side="left")[0], atol=1e-10)


def test_a_task_that_cannot_go_on_is_a_result():
    """Forces under which a millimetre takes 1e-9 s: every step is too short to be a machine's."""
    robot = zoo.robot_of("2rpr", **SHORT.arguments)
    q, v = np.array(robot.q_reference), np.zeros(robot.model.nv)
    run = run_own(Task(robot, 0.0, 1.0, q, v, lambda t, side="right": np.full((len(t), 4), 1e16)))
    assert run.status is ResultStatus.NOT_CONVERGED
    assert run.t[-1] < 1.0
    assert run.message


def test_a_task_may_start_at_any_time():
    first = thrown("2rpr")
    early = waves(first.robot, 0.5)
    later = Task(first.robot, 0.2, 0.45, first.q, first.v, lambda t, side="right": early(np.asarray(t) - 0.2, side))
    run, same = run_own(later), run_own(first)
    assert (run.t[0], run.t[-1]) == (0.2, 0.45)
    np.testing.assert_allclose(run.q, same.q, atol=EXTRAPOLATED)
