"""Accelerations under given forces: the equation of motion of the tree, prescribed carriers, what is ill-posed."""

from __future__ import annotations

import moving
import numpy as np
import pinocchio as pin
import pytest
import zoo
from spatial_chains import CHAINS, chain_of

from redundancy_pin.errors import IllPosedModelError, SingularPoseError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.simulation.forward import ForwardDynamics, Partition, choose
from redundancy_pin.simulation.state import closed_state

BALANCE = 1e-10
"""N, N·m and m/s²: terms of order 10 to 100, systems conditioned no worse than 1e3."""


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *CHAINS])
def test_accelerations_and_closure_forces_satisfy_the_equation_of_motion_of_the_tree(name: str) -> None:
    robot = chain_of(name) if name in CHAINS else moving.massive(name)
    dynamics, system, chain = ForwardDynamics(robot), ConstraintSystem(robot), ClosedChain(robot)
    data = robot.model.createData()
    for i, state in enumerate(moving.random_states(robot, 7, 5)):
        force = moving.random_force(robot, i)
        dynamics.adapt(state.q)
        a = dynamics.acceleration(state.q, state.v, force)
        loads = dynamics.forces(state.q, state.v, force, a)
        rows = system.evaluate(state.q[None])
        chain.update(state.q, state.v)
        balance = pin.rnea(robot.model, data, state.q, state.v, a) - force - rows.Jc[0].T @ loads.closure_force
        np.testing.assert_allclose(balance, 0.0, atol=BALANCE)
        np.testing.assert_allclose(rows.Jc[0] @ a, -chain.bias(), atol=BALANCE)


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
def test_prescribed_carriers_take_the_forces_that_produce_the_same_motion(name: str) -> None:
    robot = moving.massive(name)
    free, prescribed = ForwardDynamics(robot), ForwardDynamics(robot, prescribed=True)
    for i, state in enumerate(moving.random_states(robot, 8, 5)):
        force = moving.random_force(robot, i)
        a = free.acceleration(state.q, state.v, force)
        without = force.copy()
        without[robot.carrier_velocity] = 0.0
        again = prescribed.acceleration(state.q, state.v, without, a[robot.carrier_velocity])
        np.testing.assert_allclose(again, a, atol=BALANCE)
        loads = prescribed.forces(state.q, state.v, without, again)
        np.testing.assert_allclose(loads.carrier_force, force[robot.carrier_velocity], atol=BALANCE)
        assert (free.forces(state.q, state.v, force, a).carrier_force == force[robot.carrier_velocity]).all()


def test_any_choice_of_independent_velocities_gives_the_same_acceleration() -> None:
    robot = moving.massive("3rrr")
    state = moving.random_states(robot, 9, 1)[0]
    force = moving.random_force(robot, 1)
    dynamics = ForwardDynamics(robot)
    expected = dynamics.acceleration(state.q, state.v, force)
    chain = dynamics.chain
    chain.update(state.q, state.v)
    for seed in range(6):
        skewed = 10.0 ** np.random.default_rng(seed).uniform(-2.0, 2.0, robot.model.nv)
        relative = chain.closure_rows() / skewed[chain.pose_columns]
        other = choose(relative, chain.pose_columns, robot.carrier_velocity, state.q)
        dynamics.adapt(state.q)
        dynamics.use(other)
        np.testing.assert_allclose(dynamics.acceleration(state.q, state.v, force), expected, atol=BALANCE)


def test_closure_forces_do_not_depend_on_a_choice_that_no_longer_suits() -> None:
    # with the legs in one line, the slides cannot both depend on the swivels
    state = moving.type_two_state()
    robot, model = state.robot, state.robot.model
    force = moving.random_force(robot, 2)
    suited, unsuited = ForwardDynamics(robot), ForwardDynamics(robot)
    suited.adapt(state.q)
    a = suited.acceleration(state.q, state.v, force)
    slides, swivels = (
        np.array([model.joints[model.getJointId(f"{kind}_{leg}")].idx_v for leg in (1, 2)])
        for kind in ("slide", "swivel")
    )
    unsuited.use(Partition(slides, np.concatenate([swivels, robot.carrier_velocity])))
    evaluated = unsuited.forces(state.q, state.v, force, a)
    np.testing.assert_allclose(
        evaluated.closure_force, suited.forces(state.q, state.v, force, a).closure_force, atol=BALANCE
    )


def test_a_massless_machine_at_a_type_two_pose_is_refused_by_name() -> None:
    robot = zoo.robot_of("2rpr")
    state = closed_state(robot, [0.2, 0.0], s=[0.05, -0.1])
    with pytest.raises(IllPosedModelError, match=r"condition number.*slide_.*end_effector_mass=0\.1") as caught:
        ForwardDynamics(robot).acceleration(state.q, state.v, np.zeros(robot.model.nv))
    assert caught.value.details["condition"] > 1e12
    direction = np.array(caught.value.details["direction"])
    # the motion without inertia is that of B along the line of the legs: the legs do not turn
    assert abs(direction[robot.model.joints[robot.model.getJointId("swivel_1")].idx_v]) < 1e-6 * np.abs(direction).max()
    moving_end = closed_state(zoo.robot_of("2rpr", end_effector_mass=0.1), [0.2, 0.0], s=[0.05, -0.1])
    assert np.isfinite(ForwardDynamics(moving_end.robot).acceleration(moving_end.q, moving_end.v, np.zeros(6))).all()


def test_massless_carriers_are_named_by_the_parameter_that_is_zero() -> None:
    robot = zoo.robot_of("3rrr", carrier_mass=0.0)
    with pytest.raises(IllPosedModelError, match=r"carrier_1.*carrier_mass=0\.1") as caught:
        ForwardDynamics(robot).acceleration(robot.q_reference, np.zeros(robot.model.nv), np.zeros(robot.model.nv))
    assert "anew" in caught.value.remedy


def test_closures_that_have_lost_rank_are_refused_with_their_pivots() -> None:
    # a parallelogram four-bar whose links all lie in one line may fold either way
    robot = zoo.robot_of("four_bar", ground_length=0.4, crank_length=0.2, coupler_length=0.4, rocker_length=0.2)
    q = robot.q_reference.copy()
    for name, angle in (("crank", 0.0), ("rocker", 0.0), ("coupler", np.pi)):
        q[robot.model.joints[robot.model.getJointId(name)].idx_q] = angle
    assert np.abs(ConstraintSystem(robot).evaluate(q[None]).phi).max() < 1e-12
    with pytest.raises(SingularPoseError, match="lost rank") as caught:
        ForwardDynamics(robot).adapt(q)
    pivots = caught.value.details["pivots"]
    assert abs(pivots[-1]) < 1e-12 < pivots[0]
