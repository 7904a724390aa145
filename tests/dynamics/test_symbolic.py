"""The casadi Functions of a robot: against the RNEA backend, and in graphs of both kinds."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from machines import machine
from scipy.spatial.transform import Rotation

from redundancy_pin import CompiledDynamics, RneaDynamics, inverse_kinematics, joint_reactions, symbolic
from redundancy_pin.dynamics.compiled.symbolic import SymbolicRobot
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator, moved
from redundancy_pin.loading import robot_from_model
from redundancy_pin.robot import Robot

EQUAL = 1e-11
"""Relative to the largest value, or one; rounding is 1e-14."""


def assert_equal(got: object, want: np.ndarray, what: str) -> None:
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(np.array(got).reshape(want.shape), want, rtol=0.0, atol=EQUAL * scale, err_msg=what)


@pytest.mark.long_for("gough")
@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_they_say_what_rnea_says(name: str) -> None:
    robot = machine(name)
    functions = symbolic(robot)
    t = np.linspace(0.0, 1.0, 3)
    motion, carriers = zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1)
    along = RneaDynamics(robot).along(motion)
    reduced, tree = along.reduce(carriers), inverse_kinematics(robot, motion)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    reactions = joint_reactions(along, tau, carriers)
    wrench, energy, rnea = along.base_wrench(carriers), along.energy(carriers), along.tree_effort(carriers)
    state = zoo.system_of(robot).evaluate(tree.q)
    r, n = state.Jc.shape[1], robot.n
    for k in range(len(t)):
        q, v, a = (part[k] for part in along.tree_motion(carriers))
        still = np.zeros(r + n)
        assert_equal(functions.closure(q), np.zeros(r), "closure")
        assert_equal(functions.coordinates(q), motion.x[k], "coordinates")
        assert_equal(functions.position(q, motion.x[k]), still, "position")
        assert_equal(functions.velocity(q, v, motion.xd[k]), still, "velocity")
        assert_equal(functions.acceleration(q, v, a, motion.xdd[k]), still, "acceleration")
        assert_equal(functions.Jc(q), state.Jc[k], "Jc")
        assert_equal(functions.Jx(q), state.Jx[k], "Jx")
        assert_equal(functions.K(q), state.K[k], "K")
        assert_equal(functions.gamma(q), tree.gamma[k], "gamma")
        assert_equal(functions.rnea(q, v, a), rnea[k], "rnea")
        assert_equal(functions.f(q, v, a), reduced.f[k], "f")
        assert_equal(functions.W(q), reduced.W[k], "W")
        assert_equal(functions.carrier_force(q, v, a), reduced.carrier_force[k], "carrier force")
        assert_equal(functions.base_wrench(q, v, a), wrench[k], "base wrench")
        assert_equal(functions.energy(q, v), energy[k : k + 1], "energy")
        efforts = (tau[k], reduced.carrier_force[k], reactions.closure_force[k])
        assert_equal(functions.balance(q, v, a, *efforts), np.zeros(robot.model.nv), "balance")
        assert (np.array(functions.mode(q)) > 0.0).all()
        assert (np.array(functions.alignment(q)) > 0.0).all()
        # the bias is the rest of the acceleration rows, those of the platform included
        rows = np.concatenate([state.Jc[k], state.Jx[k]]) @ a + np.array(functions.bias(q, v))[:, 0]
        assert_equal(rows, np.concatenate([np.zeros(r), motion.xdd[k]]), "bias")


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_off_the_motion_they_are_pinocchios_and_the_kinematics(name: str) -> None:
    """The tree, whether its loops are closed or not; and what is missing to a pose that is turned away."""
    robot, rng = machine(name), np.random.default_rng(8)
    functions, model = symbolic(robot), robot.model.copy()
    data, home = model.createData(), np.array(robot.q_reference)
    for _ in range(2):
        q = pin.integrate(model, home, rng.uniform(-0.5, 0.5, model.nv))
        v, a = rng.normal(size=(2, model.nv))
        assert_equal(functions.rnea(q, v, a), pin.rnea(model, data, q, v, a), "rnea")
        energy = pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)
        assert_equal(functions.energy(q, v), np.array([energy]), "energy")
        # the force that holds the base is what the momentum of all changes by, less its weight
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        force = data.dhg.linear - data.mass[0] * model.gravity.linear
        assert_equal(-np.array(functions.base_wrench(q, v, a))[:3, 0], force, "base wrench")
    state = zoo.system_of(robot).evaluate(home[None])
    indicators = mode_indicator(robot, home[None])[0] * robot.working_mode if robot.working_mode else np.empty(0)
    assert_equal(functions.mode(home), indicators, "mode")
    x = coordinates(robot, state)
    target = moved(robot, x, rng.uniform(-0.4, 0.4, (1, robot.n)))
    missing = -difference(robot, target, x)[0]
    if robot.platform is not None and robot.platform.is_pose:  # the sine of the angle, about its axis
        turn = Rotation.from_matrix(target[0, :3, :3] @ x[0, :3, :3].T).as_rotvec()
        angle = np.linalg.norm(turn)
        missing[3:] = -turn * np.sin(angle) / angle
    assert_equal(np.array(functions.position(home, target[0]))[-robot.n :, 0], missing, "position")


def test_a_weld_whose_axes_changed_places_is_told_from_a_true_one() -> None:
    """All rows vanish there, and the cosines are zero: CompiledDynamics took it for closed where they rounded up."""
    model = pin.Model()
    joints = (pin.JointModelRZ(), pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelSpherical())
    for number, joint in enumerate(joints):
        name = ("turn", "x", "y", "z", "ball")[number]
        index = model.addJoint(number if number > 1 else 0, joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name, joint in (("hand", 1), ("end", 5)):
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    weld = ("hand", "end", ["x", "y", "z", "rx", "ry", "rz"])
    robot = robot_from_model(model, closures=[weld], actuated=["turn"])
    functions, rng = symbolic(robot), np.random.default_rng(0)
    assert (np.array(functions.alignment(np.array(robot.q_reference))) > 0.0).all()
    false = np.concatenate([np.zeros(4), [-0.5, -0.5, -0.5, 0.5]])
    for step in 1e-9 * rng.normal(size=(20, robot.model.nv)):
        q = pin.integrate(robot.model, false, step)
        assert np.abs(np.array(functions.closure(q))).max() < 1e-7
        assert (np.array(functions.alignment(q)) < 0.0).any()


def test_both_kinds_of_graphs_hold_them() -> None:
    robot = machine("3rrr")
    functions = symbolic(robot)
    assert {field.name for field in dataclasses.fields(SymbolicRobot)} > {"f", "W", "rnea", "balance"}
    nv = robot.model.nv
    numbers = [np.array(robot.q_reference), np.linspace(0.1, 1.0, nv), np.linspace(-1.0, 2.0, nv)]
    for kind in (ca.SX, ca.MX):
        symbols = [kind.sym(name, nv) for name in "qva"]
        f = functions.f(*symbols)
        slope = ca.Function("slope", symbols, [f, ca.jacobian(f, symbols[2])])
        value, by_a = slope(*numbers)
        assert_equal(value, np.array(functions.f(*numbers)), "f")
        # linear in a
        rest = np.array(functions.f(*numbers[:2], np.zeros(nv)))
        assert_equal(np.array(by_a) @ numbers[2][:, None] + rest, np.array(value), "f by a")


def test_expressions_of_the_carriers_motion_have_the_values_of_rnea(shipped: Robot) -> None:
    """Of many samples at once, each with its own influence matrix."""
    t = np.linspace(0.0, 1.0, 4)
    motion, carriers = zoo.smooth_motion(shipped, 5).at(t), zoo.carriers_at(shipped, t)
    along = CompiledDynamics(shipped).along(motion)
    f, force = along.expressions(*(ca.DM(part.T) for part in (carriers.s, carriers.sd, carriers.sdd)))
    wanted = RneaDynamics(shipped).reduce(motion, carriers)
    for got, want in ((f, wanted.f), (force, wanted.carrier_force)):
        np.testing.assert_allclose(np.array(got).T, want, rtol=1e-9, atol=1e-9 * np.abs(wanted.f).max())
