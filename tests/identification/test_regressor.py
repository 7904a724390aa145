"""f is linear in the parameters, and the base parameters are all that f shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.identification import base_parameters, chain_regressor, parameters_of
from redundancy_pin.identification.parameters import Parameter, with_values
from redundancy_pin.robot import Robot

EXACT = 1e-9
"""Relative error of numbers that rounding alone changes."""


def with_every_load(robot: Robot) -> Robot:
    model = robot.model
    joints = [str(model.names[j]) for j in range(1, model.njoints) if model.joints[j].nv == 1]
    springs = {name: model.joints[model.getJointId(name)].nq == 1 for name in joints}
    return robot.loaded(
        *(
            rp.JointForces(
                name,
                damping=0.1,
                friction=0.2,
                friction_speed=0.3,
                stiffness=1.5 * springs[name],
                rest=0.2 * springs[name],
                rotor_inertia=1e-3,
                gear=-7.0,
            )
            for name in joints
        )
    )


def test_every_column_is_what_f_changes_by(shipped: Robot) -> None:
    robot, t = with_every_load(shipped), np.linspace(0.0, 1.0, 4)
    motion, carriers = zoo.smooth_motion(robot, seed=3).at(t), zoo.carriers_at(robot, t)
    along = RneaDynamics(robot).along(motion)
    parameters = parameters_of(robot, ["*"])
    Y = chain_regressor(along, parameters, carriers)
    values = np.array([p.value for p in parameters])
    before = np.concatenate(along.forces(carriers), axis=1)
    for k, parameter in enumerate(parameters):
        if parameter.kind.startswith(("moment", "inertia")) and not robot.model.inertias[parameter.joint].mass:
            continue  # no pin.Inertia has moments without a mass
        changed = values.copy()
        changed[k] += parameter.size
        other = RneaAlongMotion(replace(along.tree, robot=with_values(robot, parameters, changed)))
        found = (np.concatenate(other.forces(carriers), axis=1) - before) / parameter.size
        scale = np.abs(before).max() / parameter.size + np.abs(Y[..., k]).max()
        assert np.abs(found - Y[..., k]).max() < EXACT * scale, parameter.name


@pytest.mark.parametrize("name", ["five_bar", "delta"])
def test_a_payload_is_parameters_of_its_body(name: str) -> None:
    robot, t = zoo.robot_of(name), np.linspace(0.0, 1.0, 5)
    frame, load = robot.platform.frame, rp.Payload(robot.platform.frame, 0.7, [0.1, 0.05, 0.02], 0.01)
    motion, carriers = zoo.smooth_motion(robot, seed=5).at(t), zoo.carriers_at(robot, t)
    change = rp.VirtualWork if robot.closed_form else rp.RneaDynamics
    difference = change(robot.loaded(load)).reduce(motion, carriers).f - change(robot).reduce(motion, carriers).f
    place = robot.model.frames[robot.model.getFrameId(frame, pin.FrameType.BODY)]
    ten = place.placement.act(pin.Inertia(0.7, load.centre, load.inertia)).toDynamicParameters()
    body = next(one.name for index, one in enumerate(robot.bodies, 1) if index == place.parentJoint)
    own = parameters_of(robot, [f"* of {body}"])
    Y = chain_regressor(RneaDynamics(robot).along(motion), own, carriers)[:, : robot.n]
    assert np.abs(Y @ ten - difference).max() < EXACT * np.abs(difference).max()


def rows_of(robot: Robot, parameters: Sequence[Parameter], seed: int) -> Array:
    """Return the regressor (M, p) along a motion with carriers."""
    t = np.linspace(0.0, 4.0, 120)
    along = RneaDynamics(robot).along(zoo.smooth_motion(robot, seed=seed).at(t))
    return chain_regressor(along, parameters, zoo.carriers_at(robot, t)).reshape(-1, len(parameters))


def test_base_parameters_say_all_that_f_does(shipped: Robot) -> None:
    """Those of one motion explain the rows of another."""
    parameters = parameters_of(shipped)
    base = base_parameters(rows_of(shipped, parameters, seed=7), parameters)
    Y = rows_of(shipped, parameters, seed=8)
    by_base = Y[:, base.independent] @ base.combination
    sizes = base.sizes
    assert np.abs((by_base - Y) * sizes).max() < EXACT * np.abs(Y * sizes).max()
    # another order finds as many: a rank, and no matter of taste
    backwards = parameters[::-1]
    assert len(base_parameters(rows_of(shipped, backwards, seed=7), backwards)) == len(base)


def test_the_five_bar_has_the_base_parameters_of_the_book() -> None:
    """Flat: of each proximal link one inertia, of each distal link two moments and an inertia, less what the joint at
    the tip makes of one mass: seven, and two of friction a motor."""
    robot = rp.load_robot("five_bar")
    base = base_parameters(rows_of(robot, parameters_of(robot), seed=7), parameters_of(robot))
    assert len([name for name in base.names if "friction" in name or "damping" in name]) == 4
    assert len(base) == 11
    assert "inertia zz of proximal_1 + 0.25 mass of distal_1 + inertia zz of distal_2" in base.names
    assert "mass of proximal_1" in base.unseen


def test_what_is_no_parameter_is_named() -> None:
    with pytest.raises(rp.errors.InputError, match=r"mass of distl_1.*Did you mean 'mass of distal_1'"):
        parameters_of(zoo.robot_of("five_bar"), ["mass of distl_1"])
    twice = zoo.robot_of("delta").loaded(*2 * [rp.JointForces(zoo.robot_of("delta").actuated[0], damping=1.0)])
    with pytest.raises(rp.errors.UnsupportedRobotError, match="2 JointForces"):
        parameters_of(twice)
