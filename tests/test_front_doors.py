"""What users pass: names wherever a robot is wanted, one number for all joints, and one sentence for the rest."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.errors import InputError, ModelFileError, RedundancyPinError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import motion_reference, plan_reference
from redundancy_pin.trajectory import Trajectory, reference

CIRCLE = reference.circle(speed=0.5)
MOTION = CIRCLE.sample(dt=0.2)


@pytest.fixture(scope="module")
def robot() -> Robot:
    return rp.load_robot("2rpr")


@pytest.fixture(scope="module")
def plan(robot: Robot) -> Plan:
    return rp.plan_switch_off(rp.VirtualWork(robot), CIRCLE, threshold=20.0, mesh=rp.Mesh(dt=0.05))


def compiled(robot: Any) -> Any:
    pytest.importorskip("casadi")
    return rp.CompiledDynamics(robot)


def symbolic(robot: Any) -> Any:
    pytest.importorskip("casadi")
    return rp.symbolic(robot)


ROBOTS: dict[str, Callable[[Any], Any]] = {
    "RneaDynamics": lambda robot: rp.RneaDynamics(robot).reduce(MOTION).f,
    "VirtualWork": lambda robot: rp.VirtualWork(robot).reduce(MOTION).f,
    "CompiledDynamics": lambda robot: compiled(robot).reduce(MOTION).f,
    "symbolic": lambda robot: str(symbolic(robot).W),
    "with_parameters": lambda robot: rp.with_parameters(robot, carrier_mass=2.0).moving_mass,
    "inverse_kinematics": lambda robot: rp.inverse_kinematics(robot, MOTION).q,
    "forward_kinematics": lambda robot: rp.forward_kinematics(robot, [0.4, 0.5]).x,
    "assembly_modes": lambda robot: rp.assembly_modes(robot, [0.4, 0.5]).x,
    "performance": lambda robot: rp.performance(robot, rp.load_robot("2rpr").q_reference).manipulability,
    "platform_play": lambda robot: rp.platform_play(robot, rp.load_robot("2rpr").q_reference, 0.001),
    "platform_stiffness": lambda robot: rp.platform_stiffness(robot, rp.load_robot("2rpr").q_reference, 1.0),
    "workspace": lambda robot: rp.workspace(robot, bounds=[(0.0, 0.5), (0.2, 0.5)], resolution=3).margin,
    "classify": lambda robot: rp.classify(robot, rp.load_robot("2rpr").q_reference).parallel_margin,
    "find_crossings": lambda robot: [crossing.t for crossing in rp.find_crossings(robot, CIRCLE)],
    "singular_locus": lambda robot: rp.singular_locus(robot, resolution=6).points,
    "with_limits": lambda robot: rp.with_limits(robot, speed=1.0).q_reference,
    "simulate": lambda robot: rp.simulate(robot, duration=0.01).q,
    "motion_reference": lambda robot: motion_reference(robot, reference.line().sample(times=[0.0, 0.1])).at(0.1).q,
}
"""Whatever takes a robot, and something that depends on which one it is."""


@pytest.mark.parametrize("name", ROBOTS)
def test_a_name_or_a_path_is_as_good_as_the_robot(name: str, robot: Robot) -> None:
    shipped = "five_bar" if name == "simulate" else "2rpr"  # the other has no mass at its end
    expected = ROBOTS[name](robot if shipped == "2rpr" else rp.load_robot(shipped))
    np.testing.assert_array_equal(ROBOTS[name](shipped), expected)
    if name == "inverse_kinematics":  # they share what turns a name into a robot
        np.testing.assert_array_equal(ROBOTS[name](Path(rp.__file__).parents[1] / "models" / "2rpr"), expected)


@pytest.mark.parametrize("name", ROBOTS)
def test_what_is_no_robot_is_named(name: str) -> None:
    for wrong in (None, 5, ["2rpr"], MOTION):
        with pytest.raises(InputError, match=rf"^A robot was expected, not {type(wrong).__name__}\. Pass load_robot"):
            ROBOTS[name](wrong)
    with pytest.raises(ModelFileError, match="2rpr"):
        ROBOTS[name]("2rp")


def test_a_plan_goes_with_the_name_of_its_robot(plan: Plan) -> None:
    np.testing.assert_array_equal(plan.table(10, robot="2rpr").effort, plan.table(10).effort)
    assert plan_reference(plan, robot="2rpr").robot.name == "2rpr"


OTHERS: dict[str, Callable[[Any, Robot, Plan], Any]] = {
    "inverse_kinematics, motion": lambda wrong, robot, plan: rp.inverse_kinematics(robot, wrong),
    "find_crossings, motion": lambda wrong, robot, plan: rp.find_crossings(robot, wrong),
    "along, motion": lambda wrong, robot, plan: rp.RneaDynamics(robot).along(wrong),
    "reduce, carriers": lambda wrong, robot, plan: rp.RneaDynamics(robot).reduce(MOTION, wrong),
    "along.reduce, carriers": lambda wrong, robot, plan: rp.VirtualWork(robot).along(MOTION).reduce(wrong),
    "distribute": lambda wrong, robot, plan: rp.distribute(wrong),
    "classify, q": lambda wrong, robot, plan: rp.classify(robot, wrong),
    "classify_motion": lambda wrong, robot, plan: rp.classify_motion(wrong),
    "joint_reactions": lambda wrong, robot, plan: rp.joint_reactions(wrong, plan.tau),
    "plan_switch_off, dynamics": lambda wrong, robot, plan: rp.plan_switch_off(wrong, CIRCLE),
    "plan_stepwise, motion": lambda wrong, robot, plan: rp.plan_stepwise(rp.VirtualWork(robot), wrong),
    "plan_whole_trajectory, motion": lambda wrong, robot, plan: whole(robot, wrong),
    "check_plan": lambda wrong, robot, plan: rp.check_plan(wrong, rp.VirtualWork(robot)),
    "check_plan, dynamics": lambda wrong, robot, plan: rp.check_plan(plan, wrong),
    "load_robot_of": lambda wrong, robot, plan: rp.load_robot_of(wrong),
    "plan_reference": lambda wrong, robot, plan: plan_reference(wrong),
    "motion_reference, motion": lambda wrong, robot, plan: motion_reference(robot, wrong),
    "efforts_at, dynamics": lambda wrong, robot, plan: plan.efforts_at([0.1], wrong),
    "functions_along": lambda wrong, robot, plan: plan.functions_along(wrong),
    "Trajectory, path": lambda wrong, robot, plan: Trajectory(wrong, CIRCLE.timing),
    "Trajectory, timing": lambda wrong, robot, plan: Trajectory(CIRCLE.path, wrong),
    "simulate, drive": lambda wrong, robot, plan: rp.simulate(robot, wrong, duration=0.01),
    "show": lambda wrong, robot, plan: rp.show(wrong),
}


def whole(robot: Robot, motion: Any) -> Plan:
    pytest.importorskip("casadi")
    return rp.plan_whole_trajectory(rp.VirtualWork(robot), motion)


@pytest.mark.parametrize("name", OTHERS)
def test_wrong_types_are_one_sentence_and_a_remedy(name: str, robot: Robot, plan: Plan) -> None:
    for wrong in (5, "no such thing", [1, 2]):
        if name == "show" and isinstance(wrong, str):
            continue  # the name of a robot
        with pytest.raises(RedundancyPinError) as caught:
            OTHERS[name](wrong, robot, plan)
        assert caught.value.message.count("\n") == 0
        assert caught.value.remedy


def test_one_number_stands_for_each_actuator() -> None:
    dynamics = rp.RneaDynamics("3rrr")
    reduced = dynamics.reduce(reference.corner().sample(dt=0.2))
    free = rp.distribute(reduced).tau
    bound = 0.9 * np.abs(free).max()
    each = rp.distribute(reduced, lower=[-bound] * 3, upper=[bound] * 3, weights=[2.0] * 3)
    one = rp.distribute(reduced, lower=-bound, upper=bound, weights=2.0)
    np.testing.assert_array_equal(one.status, each.status)
    np.testing.assert_array_equal(one.tau, each.tau)
    assert "bound_infeasible" in one.status_labels  # the bound is felt
    with pytest.raises(InputError, match="weights"):
        rp.distribute(reduced, weights=-1.0)


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.VirtualWork, compiled])
def test_one_number_stands_for_each_carrier(backend: Any) -> None:
    dynamics = backend("3rrr")
    x, still = [1.0, 0.5, 0.0], [0.0] * 3
    np.testing.assert_array_equal(
        dynamics.sample(x, still, still, 0.1, 0.2, 0.3).carrier_force,
        dynamics.sample(x, still, still, [0.1] * 3, [0.2] * 3, [0.3] * 3).carrier_force,
    )
    assert not np.allclose(dynamics.sample(x, still, still, 0.0, 0.0, 0.1).f, dynamics.sample(x, still, still).f)
