"""A joint beyond its range is a status: where the closed form of the joint says so, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory import reference

LINE = reference.line().sample(0.05)
RANGE = {
    "lower": 0.05,
    "upper": 1.1,
}  # rad; the first swivel of the 2-RPR goes from 1.2 to −1.2 on the line


def beyond(motion: rp.PlatformMotion) -> Array:
    """Return (N,) whether the first leg of the shipped 2-RPR is turned too far: its hinge is the origin."""
    angle = np.arctan2(motion.x[:, 1], motion.x[:, 0])
    return (angle > RANGE["upper"]) | (angle < RANGE["lower"])


@pytest.fixture(scope="module")
def robot() -> rp.Robot:
    return zoo.robot_of("2rpr").with_limits({"swivel_1": RANGE})


@pytest.mark.parametrize("backend", ["RneaDynamics", "VirtualWork", "CompiledDynamics"])
def test_passive_joints_beyond_their_range_are_a_status_in_every_backend(robot: rp.Robot, backend: str) -> None:
    if backend == "CompiledDynamics":
        pytest.importorskip("casadi")
    make = getattr(rp, backend)
    unlimited = rp.distribute(make(zoo.robot_of("2rpr")).reduce(LINE))
    distribution = rp.distribute(make(robot).reduce(LINE))
    out = beyond(LINE) & unlimited.solved
    assert out.any()
    assert (~beyond(LINE)).any()
    assert (distribution.status == np.where(out, SampleStatus.OUT_OF_RANGE, unlimited.status)).all()
    assert (distribution.solved == unlimited.solved).all()
    np.testing.assert_array_equal(distribution.tau, unlimited.tau)


def test_statuses_without_a_solution_come_first(robot: rp.Robot) -> None:
    reduced = rp.RneaDynamics(robot).reduce(LINE)
    out = np.ones(len(LINE), dtype=bool)
    W, reachable = np.array(reduced.W), np.array(reduced.reachable)
    W[0], reachable[1] = 0.0, False
    given = replace(reduced, W=W, reachable=reachable, f=reduced.f + 1.0, out_of_range=out)
    distribution = rp.distribute(given, lower=np.where(np.arange(len(LINE)) == 2, 1e6, -np.inf)[:, None].repeat(2, 1))
    assert distribution.status[:3].tolist() == [
        SampleStatus.SINGULAR_INCONSISTENT,
        SampleStatus.UNREACHABLE,
        SampleStatus.BOUND_INFEASIBLE,
    ]
    assert (distribution.status[3:] == SampleStatus.OUT_OF_RANGE).all()
    assert SampleStatus.OUT_OF_RANGE.solved
    assert not SampleStatus.UNREACHABLE.solved


def test_inverse_kinematics_knows_ranges(robot: rp.Robot) -> None:
    tree = rp.inverse_kinematics(robot, LINE)
    assert (tree.out_of_range == beyond(LINE)).all()
    assert tree.reachable.all()


@pytest.mark.parametrize("ends", [(0.0, 0.0), (1.0, -1.0)])
def test_limits_that_are_none_are_none(ends: tuple[float, float]) -> None:
    free = zoo.robot_of("2rpr")
    model = free.model.copy()
    at = model.joints[model.getJointId("swivel_1")].idx_q
    model.lowerPositionLimit[at], model.upperPositionLimit[at] = ends
    assert not rp.inverse_kinematics(replace(free, model=model), LINE).out_of_range.any()


def test_plans_that_leave_a_range_violate_limits_and_say_it_of_samples(robot: rp.Robot) -> None:
    both = zoo.robot_of("2rpr"), robot
    plans = [rp.plan_switch_off(rp.VirtualWork(one), reference.line(), threshold=4.0, dt=0.05) for one in both]
    unlimited, marked = plans
    assert (unlimited.status, marked.status) == (ResultStatus.OK, ResultStatus.LIMIT_VIOLATED)
    left = [event for event in marked.limits.violated if event.quantity == "range"]
    assert {event.limit for event in left} == set(RANGE.values())
    assert {event.carrier for event in left} == {"swivel_1"}
    assert marked.robot.limit_unit("range", "swivel_1") == "rad"
    assert rp.plot.plan(marked).get_suptitle().endswith("(range of swivel_1)")
    np.testing.assert_array_equal(marked.tau, unlimited.tau)
    out = marked.sample_status == SampleStatus.OUT_OF_RANGE
    assert (out == (beyond(unlimited.motion) & (unlimited.sample_status <= SampleStatus.SINGULAR_CONSISTENT))).all()
    assert rp.check_plan(marked, rp.VirtualWork(robot)).deviations == ()


def test_singular_instants_out_of_range_are_not_unbounded_for_that(robot: rp.Robot) -> None:
    unlimited = rp.inverse_dynamics(rp.VirtualWork(zoo.robot_of("2rpr")), LINE)
    result = rp.inverse_dynamics(rp.VirtualWork(robot), LINE)
    assert result.status is unlimited.status
    assert [one.unbounded for one in result.instants] == [one.unbounded for one in unlimited.instants]
    assert [one.limit for one in result.joint_limits] == [RANGE["lower"], RANGE["upper"]]
