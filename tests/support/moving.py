"""Robots with mass in every part, in motion: states that the tests of the simulation share."""

from __future__ import annotations

import functools
from pathlib import Path

import numpy as np
import zoo
from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import State, closed_state

MASSES: dict[str, dict[str, float]] = {
    "2rpr": {"end_effector_mass": 0.5, "cylinder_mass": 0.8, "piston_mass": 0.4},
    "five_bar": {"end_effector_mass": 0.3},
}
"""Masses that are zero by default."""


def massive(name: str) -> Robot:
    """Return a shipped robot all of whose parts have mass."""
    return zoo.robot_of(name, **MASSES.get(name, {}))


@functools.cache
def type_two_state() -> State:
    """Return the 2-RPR with its legs in one line: B between A1 and A2."""
    return closed_state(massive("2rpr"), [0.2, 0.0], [0.3, -0.7], [0.05, -0.1], [0.4, 0.2])


def random_states(robot: Robot, seed: int, count: int) -> list[State]:
    """Return closed states in random motion, carriers anywhere on the inner half of their tracks."""
    rng = np.random.default_rng(seed)
    dynamics = ForwardDynamics(robot)
    states = []
    for q in zoo.random_closed(robot, seed, count).copy():
        for i, limits in zip(robot.carrier_position, robot.carrier_limits, strict=True):
            q[i] = 0.5 * rng.uniform(limits.lower, limits.upper)
        dynamics.adapt(q)
        basis = dynamics.velocity_basis(q)
        v = basis @ rng.normal(size=basis.shape[1])
        states.append(State(ClosedChain(robot), 0.0, q, v))
    return states


def random_force(robot: Robot, seed: int) -> Array:
    """Return random generalised forces of main actuators and carriers, (nv,)."""
    rng = np.random.default_rng(seed)
    force = np.zeros(robot.model.nv)
    force[robot.actuated_velocity] = rng.normal(0.0, 5.0, robot.m)
    force[robot.carrier_velocity] = rng.normal(0.0, 5.0, robot.k)
    return force


def floating(folder: Path, left: float = 0.0) -> Robot:
    """Return a triangle of a free body and two bars with a carrier on one of them: nothing touches the base.

    ``left``: of the hinge of that bar from the origin of the free body, m.
    """
    joints = [
        J("root", "floating", "base", "body"),
        J("left", "revolute", "body", "left_bar", (left, 0, 0)),
        J("left_mount", "fixed", "left_bar", "left_tip", (0.5, 0, 0)),
        J("right", "revolute", "body", "right_bar", (0.6, 0, 0)),
        J("right_mount", "fixed", "right_bar", "right_tip", (0.5, 0, 0)),
        J("slider", "prismatic", "left_bar", "mass", axis=(1, 0, 0)),
    ]
    declaration = {
        "closures": [{"frames": ["left_tip", "right_tip"], "axes": ["x", "y"]}],
        "actuated": ["left"],
        "carriers": [{"joint": "slider"}],
        "independent": {"platform": "body", "axes": ["x", "y", "z", "rx", "ry", "rz"]},
        "reference": {"platform": {"xyz": [0, 0, 0], "rpy": [0, 0, 0]}, "guess": {"left": 0.9, "right": 2.2}},
    }
    return load_robot(write_robot(folder, urdf_of(joints), declaration))
