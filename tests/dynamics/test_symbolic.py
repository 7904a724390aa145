"""The casadi Functions of a robot: against the RNEA backend, and in graphs of both kinds."""

from __future__ import annotations

import dataclasses
import pickle

import casadi as ca
import numpy as np
import pytest
import spatial_chains
import zoo

from redundancy_pin import RneaDynamics, joint_reactions, symbolic
from redundancy_pin.dynamics.compiled.symbolic import SymbolicRobot
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.robot import Robot

EQUAL = 1e-11
"""Relative to the largest value, or one; rounding is 1e-14."""


def robot_of(name: str) -> Robot:
    return spatial_chains.chain_of(name) if name in spatial_chains.CHAINS else zoo.robot_of(name)


def assert_equal(got: object, want: np.ndarray, what: str) -> None:
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(np.array(got).reshape(want.shape), want, rtol=0.0, atol=EQUAL * scale, err_msg=what)


@pytest.mark.long_for("gough")
@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_they_say_what_rnea_says(name: str) -> None:
    robot = robot_of(name)
    functions = symbolic(robot)
    t = np.linspace(0.0, 1.0, 3)
    motion, carriers = zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1)
    along = RneaDynamics(robot).along(motion)
    reduced, tree = along.reduce(carriers), lift(robot, motion)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    reactions = joint_reactions(along, tau, carriers)
    wrench, energy, rnea = along.base_wrench(carriers), along.energy(carriers), along.tree_effort(carriers)
    state = zoo.system_of(robot).evaluate(tree.q)
    r, n = state.Jc.shape[1], robot.n
    for k in range(len(t)):
        q, v, a = (part[:, k] for part in along.tree_motion(carriers))
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
        assert_equal(functions.rnea(q, v, a), rnea[:, k], "rnea")
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


def test_what_is_off_is_told() -> None:
    """Residuals that were always zero would pass for closed."""
    robot = robot_of("five_bar")
    functions, q, x = symbolic(robot), np.array(robot.q_reference), zoo.home_of(robot)
    np.testing.assert_allclose(
        np.array(functions.position(q, x + np.array([0.1, -0.2])))[2:, 0], [-0.1, 0.2], atol=1e-12
    )
    np.testing.assert_allclose(np.array(functions.velocity(q, np.zeros(6), [1.0, 2.0]))[2:, 0], [-1.0, -2.0])
    step = np.full(6, 1e-7)
    moved = np.array(functions.moved(q, step))[:, 0]
    np.testing.assert_allclose(functions.closure(moved), functions.Jc(q) @ step, atol=1e-13)
    assert np.abs(np.array(functions.closure(moved))).max() > 1e-9


def test_both_kinds_of_graphs_hold_them() -> None:
    robot = robot_of("3rrr")
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


def test_a_pickle_is_as_good() -> None:
    robot = robot_of("four_bar")
    functions = symbolic(robot)
    other = pickle.loads(pickle.dumps(functions))
    assert_equal(other.W(robot.q_reference), np.array(functions.W(np.array(robot.q_reference))), "W")
    assert "four_bar" in repr(functions)
