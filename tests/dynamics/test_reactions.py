"""Joint reactions against free-body diagrams: what every single body needs, and what reaches the ground."""

import numpy as np
import pinocchio as pin
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.dynamics.contacts import closure_forces
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError

FORCE_TOLERANCE = 1e-9
"""N, N·m: forces of 10 to 100, conditioned no worse than 1e3, leave 1e-11."""


@pytest.fixture(scope="module", params=["2rpr", "3rrr"])
def case(request):
    masses = {"2rpr": {"end_effector_mass": 0.7, "cylinder_mass": 0.4, "piston_mass": 0.3}, "3rrr": {}}[request.param]
    robot, t = zoo.robot_of(request.param, gravity=(0.4, -9.81, -2.0), **masses), np.linspace(0.1, 0.7, 5)
    along, carriers = RneaDynamics(robot).along(zoo.smooth_motion(robot, 1).at(t)), zoo.carriers_at(robot, t)
    reduced = along.reduce(carriers)
    tau = np.linalg.solve(reduced.W, reduced.f[:, :, None])[:, :, 0]
    return robot, along, carriers, reduced, tau


def test_efforts_of_the_motion_leave_nothing_unbalanced(case):
    _, along, carriers, _, tau = case
    assert joint_reactions(along, tau, carriers).residual.max() < FORCE_TOLERANCE
    wrong = joint_reactions(along, tau + 1.0, carriers)
    assert wrong.residual.min() > 1e-3


def test_joint_axes_carry_the_actuator_efforts_and_nothing_else(case):
    robot, along, carriers, reduced, tau = case
    reactions = joint_reactions(along, tau, carriers)
    data = robot.model.createData()
    q, _, _ = along.tree_motion(carriers)
    for i in range(len(q)):
        pin.computeJointJacobians(robot.model, data, q[i])
        for name, wrench in zip(reactions.joints, reactions.joint_wrench[i], strict=True):
            joint = robot.model.getJointId(name)
            subspace = pin.getJointJacobian(robot.model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            along_axis = subspace[:, robot.model.joints[joint].idx_v] @ wrench
            expected = 0.0
            if name in robot.actuated:
                expected = tau[i, robot.actuated.index(name)]
            elif name in robot.carriers:
                expected = reduced.carrier_force[i, robot.carriers.index(name)]
            assert along_axis == pytest.approx(expected, abs=FORCE_TOLERANCE)


def test_each_body_obeys_newton_and_euler(case):
    """Sum of joint, closure and gravity forces on one body = its rate of momentum (finite differences of motion)."""
    robot, along, carriers, _, tau = case
    model = robot.model
    reactions = joint_reactions(along, tau, carriers)
    data = model.createData()
    q, v, a = along.tree_motion(carriers)
    gravity = np.array(robot.gravity)
    i, step = 2, 1e-5
    rates = {}
    for sign in (1, -1):
        shifted = pin.integrate(model, q[i], sign * step * v[i] + 0.5 * step**2 * a[i])
        pin.forwardKinematics(model, data, shifted, v[i] + sign * step * a[i])
        for body in range(1, model.njoints):
            momentum = data.oMi[body].act(model.inertias[body] * data.v[body])
            rates[body] = rates.get(body, 0.0) + sign * momentum.vector / (2 * step)
    pin.forwardKinematics(model, data, q[i], v[i])
    net = {}
    for name, wrench in zip(reactions.joints, reactions.joint_wrench[i], strict=True):
        body = model.getJointId(name)
        origin = data.oMi[body].translation
        about_world = np.concatenate([wrench[:3], wrench[3:] + np.cross(origin, wrench[:3])])
        net[body] = net.get(body, 0.0) + about_world
        net[model.parents[body]] = net.get(model.parents[body], 0.0) - about_world
    pin.updateFramePlacements(model, data)
    row = 0
    for closure in robot.closures:
        at_a, at_b = (data.oMf[model.getFrameId(f)] for f in (closure.frame_a, closure.frame_b))
        local = np.zeros(3)
        for axis in closure.axes:
            local["xyz".index(axis)] = reactions.closure_force[i, row]
            row += 1
        force = at_a.rotation @ local
        wrench = np.concatenate([force, np.cross(at_b.translation, force)])
        for frame, sign in ((closure.frame_b, 1), (closure.frame_a, -1)):
            body = model.frames[model.getFrameId(frame)].parentJoint
            net[body] = net.get(body, 0.0) + sign * wrench
    for body in range(1, model.njoints):
        inertia = model.inertias[body]
        weight = inertia.mass * gravity
        centre = data.oMi[body].act(inertia.lever)
        net[body] = net[body] + np.concatenate([weight, np.cross(centre, weight)])
        # central differences of momentum with step 1e-5: 1e-10 truncation, 1e-11/1e-5 rounding
        np.testing.assert_allclose(net[body], rates[body], atol=5e-6)
    ground = -net[0]
    np.testing.assert_allclose(-ground, along.base_wrench(carriers)[i], atol=FORCE_TOLERANCE)


def test_rows_without_effort_have_no_reactions_and_wrong_shapes_are_refused(case):
    _, along, carriers, _, tau = case
    holes = tau.copy()
    holes[1] = np.nan
    reactions = joint_reactions(along, holes, carriers)
    assert np.isnan([*reactions.joint_wrench[1].ravel(), reactions.residual[1]]).all()
    assert np.isfinite(reactions.joint_wrench[0]).all()
    for wrong, message in ((tau[:, :-1], "tau"), (rp.distribute(along.reduce(carriers)), "not an array of numbers")):
        with pytest.raises(InputError, match=message):
            joint_reactions(along, wrong, carriers)


def test_a_chain_without_loops_has_reactions_too():
    """Two hanging links: each joint bears the weight of what hangs on it."""
    model, parent = pin.Model(), 0
    for name in ("upper", "lower"):
        parent = model.addJoint(parent, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3])), name)
        inertia = pin.Inertia(2.0, np.array([0.0, 0.0, -0.1]), 0.01 * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    robot = rp.robot_from_model(model, actuated=["upper", "lower"])
    still = np.zeros((2, 2))
    along = RneaDynamics(robot).along(rp.PlatformMotion([0.0, 1.0], still, still, still))
    reactions = joint_reactions(along, rp.distribute(along.reduce()).tau)
    weight = -2.0 * model.gravity.linear[2]
    np.testing.assert_allclose(reactions.joint_wrench[:, :, 2], [[2 * weight, weight]] * 2, atol=FORCE_TOLERANCE)
    assert reactions.residual.max() < FORCE_TOLERANCE
    assert closure_forces(along).names == ()
    with pytest.raises(InputError, match=r"There is no closure row 'x of grip'. The robot has no closures"):
        closure_forces(along).component("grip", "x")
