"""Carriers on the end-effector of the 2-RPR, and on spatial machines under gravity, through type II poses."""

from functools import cache

import numpy as np
import pinocchio as pin
import pytest
import zoo
from point_masses import delta_points
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics

FOLLOWED = 1e-6
"""m and rad, as required."""


def on_the_end_effector(mass=0.0):
    return rp.load_robot("2rpr", carriers=False, end_effector_carriers=True, end_effector_mass=mass, carrier_mass=0.8)


@pytest.mark.long
@pytest.mark.parametrize("mass", [0.0, 0.5])
def test_carriers_on_the_end_effector_cross_and_are_replayed(mass):
    robot, circle = on_the_end_effector(mass), rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), circle, mesh=rp.Mesh(dt=0.01))
    assert plan.status.value == "ok"
    assert len(plan.findings.singular_instants) == 2
    if mass:  # the replay of the other one takes ten seconds
        run = rp.simulate(robot, plan, dt=0.01, stop_at=())
        assert np.abs(run.x - circle.evaluate(np.minimum(run.t, circle.duration)).x).max() < FOLLOWED


@cache
def crossing(dt):
    robot = rp.load_robot("gough", carriers=True)
    trajectory = zoo.gough_crossing()
    return robot, trajectory, rp.plan_whole_trajectory(rp.RneaDynamics(robot), trajectory, mesh=rp.Mesh(dt=dt))


def test_gough_crosses_90_degrees_of_yaw_under_gravity():
    """Without projection: Pinocchio's tree forces less the plan's efforts are forces in the loops, everywhere; and all
    the work is what the machine's energy has become, from rest to rest."""
    robot, _, plan = crossing(0.05)
    assert plan.status.value == "ok"
    np.testing.assert_allclose(plan.findings.singular_instants, [0.5], atol=1e-9)
    tree, model, data = (
        inverse_kinematics(robot, plan.motion).with_carriers(plan.carriers),
        robot.model,
        robot.model.createData(),
    )
    ends = [
        tuple(model.getFrameId(name, pin.FrameType.BODY) for name in (c.frame_a, c.frame_b)) for c in robot.closures
    ]
    power = []
    for sample, (q, v, a) in enumerate(zip(tree.q, tree.v, tree.a, strict=True)):
        left = pin.rnea(model, data, q, v, a).copy()
        left[robot.actuated_velocity] -= plan.tau[sample]
        left[robot.carrier_velocity] -= plan.carrier_force[sample]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        loops = np.vstack(
            [
                pin.getFrameJacobian(model, data, i, world)[:3] - pin.getFrameJacobian(model, data, j, world)[:3]
                for i, j in ends
            ]
        )
        np.testing.assert_allclose(loops @ v, 0.0, atol=1e-9)
        inside = loops.T @ np.linalg.lstsq(loops.T, left, rcond=None)[0]
        np.testing.assert_allclose(left, inside, atol=1e-5)  # of 330 N
        power.append(
            plan.tau[sample] @ v[robot.actuated_velocity] + plan.carrier_force[sample] @ v[robot.carrier_velocity]
        )
    energy = [pin.computeMechanicalEnergy(model, data, tree.q[end], tree.v[end]) for end in (0, 20, -1)]
    assert np.abs(plan.carriers.s).max() > 0.05
    for half in (20, None):  # up to the crossing, and all; the trapezoidal rule is 0.1 J off
        upto = slice(None if half is None else half + 1)
        gained = energy[2 if half is None else 1] - energy[0]
        assert np.trapezoid(power[upto], plan.t[upto]) == pytest.approx(gained, abs=0.15)


@pytest.mark.long
def test_gough_is_replayed_through_90_degrees_of_yaw():
    robot, trajectory, plan = crossing(0.02)
    run = rp.simulate(robot, plan, dt=0.02, stop_at=())
    assert run.status.value == "ok"
    planned = trajectory.evaluate(np.minimum(run.t, 1.0)).x
    turned = Rotation.from_matrix(run.x[:, :3, :3] @ planned[:, :3, :3].transpose(0, 2, 1)).magnitude()
    assert np.abs(run.x[:, :3, 3] - planned[:, :3, 3]).max() < FOLLOWED
    assert turned.max() < FOLLOWED


FLAT = rp.trajectory.Line((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05))
"""Of a delta with rods of 0.35 m: up through the plane of its elbows, where weight acts along the lost direction."""


def raised(**arguments):
    robot = rp.load_robot("delta", rod_length=0.35, **arguments)
    return robot, rp.trajectory.Trajectory(FLAT, rp.trajectory.RestToRest(FLAT.length, 0.5, "4-5-6-7"))


def test_a_delta_with_carriers_across_its_rods_goes_through_the_plane_of_its_elbows_under_gravity():
    robot, motion = raised(rod_carriers=True)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.02))
    assert plan.status.value == "ok"
    (instant,) = plan.findings.singular_instants
    points = delta_points(motion.evaluate(np.array([instant])).x[0], np.zeros(3), "rods")[1:].reshape(3, 7, 3)
    assert abs(np.linalg.det((points[:, 5] - points[:, 3]) / 0.35)) < 1e-9  # the rods lie in a plane
    run = rp.simulate(robot, plan, dt=0.02, stop_at=())
    assert run.status.value == "ok"
    assert np.abs(run.x - motion.evaluate(np.minimum(run.t, 0.5)).x).max() < FOLLOWED


@pytest.mark.long_for("2rpr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_carriers_on_arms_are_replayed_and_their_masses_count(name):
    masses = {"end_effector_mass": 0.5, "cylinder_mass": 0.3} if name == "2rpr" else {}
    motion = rp.trajectory.reference.corner() if name == "3rrr" else rp.trajectory.reference.circle(0.5)
    robots = [rp.load_robot(name, arm_length=0.3, carrier_mass=mass, **masses) for mass in (1.0, 1.01)]
    assert robots[0].closed_form is None
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robots[0]), motion, mesh=rp.Mesh(dt=0.05))
    off = []
    for robot in robots:
        run = rp.simulate(robot, plan, dt=0.05, stop_at=())
        off.append(np.abs(run.x - motion.evaluate(np.minimum(run.t, motion.duration)).x[: len(run.t)]).max())
    assert off[0] < FOLLOWED
    assert off[1] > 100 * FOLLOWED
