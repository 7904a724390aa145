"""Spatial loops closed on the base: what joints and closure bring to the ground is the rate of the whole momentum."""

import numpy as np
import pinocchio as pin
import pytest
from spatial_chains import chain_of

import redundancy_pin as rp

FORCE_TOLERANCE = 1e-9
"""N, N·m: forces of order 10 to 100, conditioned no worse than 1e3, leave 1e-11."""


def swing(robot, t):
    home = 0.6
    return rp.PlatformMotion(
        t, (home + 0.3 * np.sin(4 * t))[:, None], (1.2 * np.cos(4 * t))[:, None], (-4.8 * np.sin(4 * t))[:, None]
    )


@pytest.mark.parametrize("name", ["hinge", "cylindrical"])
def test_joint_and_closure_reactions_add_up_to_the_base_wrench(name):
    robot = chain_of(name)
    motion = swing(robot, np.linspace(0.0, 1.0, 6))
    along = rp.RneaDynamics(robot).along(motion)
    tau = rp.distribute(along.reduce()).tau
    reactions = rp.joint_reactions(along, tau)
    assert reactions.residual.max() < FORCE_TOLERANCE
    model, data = robot.model, robot.model.createData()
    (closure,) = robot.closures
    for i, q in enumerate(along.tree.q):
        pin.framesForwardKinematics(model, data, q)
        ground = np.zeros(6)
        for joint, wrench in zip(reactions.joints, reactions.joint_wrench[i], strict=True):
            index = model.getJointId(joint)
            if model.parents[index] == 0:
                origin = data.oMi[index].translation
                ground -= np.concatenate([wrench[:3], wrench[3:] + np.cross(origin, wrench[:3])])
        # the pivot, frame a, is on the base: it exerts the closure force on frame b and feels its opposite
        at_a, at_b = (data.oMf[model.getFrameId(f, pin.FrameType.BODY)] for f in (closure.frame_a, closure.frame_b))
        local = np.zeros(6)
        for axis, value in zip(closure.axes, reactions.closure_force[i], strict=True):
            local[("x", "y", "z", "rx", "ry", "rz").index(axis)] = value
        force, moment = at_a.rotation @ local[:3], at_a.rotation @ local[3:]
        ground -= np.concatenate([force, moment + np.cross(at_b.translation, force)])
        assert np.abs(moment).max() > 1e-3  # the rotation rows do carry something
        np.testing.assert_allclose(ground, along.base_wrench()[i], atol=FORCE_TOLERANCE)


@pytest.mark.parametrize("name", ["universal", "hinge", "cylindrical", "continuous"])
def test_base_wrench_is_weight_less_rate_of_momentum(name):
    """Momentum summed over the bodies by Pinocchio, differenced in time."""
    robot = chain_of(name)
    t, h = np.array([0.13, 0.4]), 1e-4
    wrench = rp.RneaDynamics(robot).along(swing(robot, t)).base_wrench()
    model, data = robot.model, robot.model.createData()

    def momentum(when):
        tree = rp.inverse_kinematics(robot, swing(robot, when))
        result = []
        for q, v in zip(tree.q, tree.v, strict=True):
            pin.forwardKinematics(model, data, q, v)
            total = sum(
                (data.oMi[b].act(model.inertias[b] * data.v[b]).vector for b in range(1, model.njoints)), np.zeros(6)
            )
            result.append(total)
        return np.array(result)

    rate = (momentum(t - 2 * h) - 8 * momentum(t - h) + 8 * momentum(t + h) - momentum(t + 2 * h)) / (12 * h)
    for i, q in enumerate(rp.inverse_kinematics(robot, swing(robot, t)).q):
        pin.forwardKinematics(model, data, q)
        weight = np.zeros(6)
        for b in range(1, model.njoints):
            force = model.inertias[b].mass * robot.gravity
            weight += np.concatenate([force, np.cross(data.oMi[b].act(model.inertias[b].lever), force)])
        # fourth-order differences: h^4 times fifth derivatives of order 1e4, rounding 1e-15 / h
        np.testing.assert_allclose(wrench[i], weight - rate[i], atol=1e-8)


def test_what_is_bolted_to_the_base_is_not_the_mechanism(tmp_path):
    """A heavy link fixed to the base changes nothing the robot does to it."""
    import yaml

    from redundancy_pin.robot.shipped import models_root

    source = models_root() / "four_bar"
    text = (source / "four_bar.urdf.xacro").read_text()
    ballast = (
        '<link name="ballast"><inertial><mass value="40"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="bolt" type="fixed"><parent link="base"/><child link="ballast"/>'
        '<origin xyz="0.3 -0.2 0.1"/></joint></robot>'
    )
    (tmp_path / "four_bar.urdf.xacro").write_text(text.replace("</robot>", ballast))
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(yaml.safe_load((source / "robot.yaml").read_text())))
    light, heavy = rp.load_robot("four_bar"), rp.load_robot(tmp_path)
    motion = swing(light, np.linspace(0.0, 0.5, 4))
    wrenches = [rp.RneaDynamics(robot).along(motion).base_wrench() for robot in (light, heavy)]
    np.testing.assert_allclose(wrenches[0], wrenches[1], atol=FORCE_TOLERANCE)
    assert np.abs(wrenches[0]).max() > 1.0


def test_a_weld_closed_wrongly_is_not_closed(tmp_path):
    """Turned by a third of a turn about (1, 1, 1) a weld's three rotation rows vanish too: it must not pass."""
    from written import J, urdf_of, write_robot

    from redundancy_pin.kinematics.assembly import assemble
    from redundancy_pin.kinematics.closure import ConstraintSystem

    joints = [
        J("px", "prismatic", "base", "l1", axis=(1, 0, 0)),
        J("py", "prismatic", "l1", "l2", axis=(0, 1, 0)),
        J("pz", "prismatic", "l2", "l3", axis=(0, 0, 1)),
        J("drive", "revolute", "l3", "l4"),
        J("rx", "revolute", "l4", "l5", axis=(1, 0, 0)),
        J("ry", "revolute", "l5", "l6", axis=(0, 1, 0)),
        J("rz", "revolute", "l6", "l7", axis=(0, 0, 1)),
        J("mount", "fixed", "base", "socket", (0.3, 0.2, 0.1)),
    ]
    path = write_robot(
        tmp_path,
        urdf_of(joints),
        {
            "closures": [{"frames": ["socket", "l7"], "axes": ["x", "y", "z", "rx", "ry", "rz"]}],
            "actuated": ["drive"],
            "independent": {"joints": ["drive"]},
            "reference": {"joints": {"drive": 0.0}},
        },
    )
    system = ConstraintSystem(rp.load_robot(path))
    model, data = system.robot.model, system.robot.model.createData()
    rng = np.random.default_rng(0)
    guesses = rng.uniform(-np.pi, np.pi, (200, model.nq))
    solution = assemble(system, guesses, np.zeros((200, 1)))
    assert solution.closed.any()
    assert not solution.closed.all()
    for q in solution.q[solution.closed]:
        pin.framesForwardKinematics(model, data, q)
        socket, tip = (data.oMf[model.getFrameId(f, pin.FrameType.BODY)] for f in ("socket", "l7"))
        np.testing.assert_allclose(socket.actInv(tip).homogeneous, np.eye(4), atol=1e-10)
