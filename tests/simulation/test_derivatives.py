"""Analytic derivatives against finite differences along the closures: positions closed anew, velocities solved for."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import moving
import numpy as np
import pytest
import zoo
from spatial_chains import chain_of

from redundancy_pin.arrays import Array
from redundancy_pin.errors import SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.reference import inverse_dynamics
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.derivatives import inverse_derivatives, linearise, state_error
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import State, closed_state

ACCURACY = 1e-6
"""Relative to the largest entry, as required. Central differences over 2e-5 leave 1e-9, and their rounding as much."""

STEP = 2e-5


def difference_quotient(function: Callable[[Array], Array], size: int) -> Array:
    """Return the Jacobian of a function at zero, by central differences."""
    return np.array([(function(unit) - function(-unit)) / (2.0 * STEP) for unit in np.eye(size) * STEP]).T


class Nearby:
    """States near one, in coordinates y = (x, s) and ζ = (ẋ, ṡ), and the accelerations (ẍ, s̈) of forces there."""

    def __init__(self, state: State) -> None:
        self.state, self.robot = state, state.robot
        self.dynamics = ForwardDynamics(self.robot)

    def at(self, dy: Array, dz: Array) -> State:
        robot, chain = self.robot, self.dynamics.chain
        guess = np.array(self.state.q)
        guess[robot.carrier_position] += dy[robot.n :]
        assembled = assemble(chain.system, guess[None], moved(robot, np.array(self.state.x)[None], dy[None, : robot.n]))
        assert assembled.closed.all()
        rate = np.concatenate([self.state.xd, self.state.sd]) + dz
        rows = np.concatenate([assembled.state.Jc[0], assembled.state.Jx[0]])[:, chain.pose_columns]
        v = np.zeros(robot.model.nv)
        v[chain.pose_columns] = np.linalg.solve(rows, np.concatenate([np.zeros(chain.rows), rate[: robot.n]]))
        v[robot.carrier_velocity] = rate[robot.n :]
        return State(chain, 0.0, assembled.q[0], v)

    def acceleration(self, state: State, force: Array) -> Array:
        a = self.dynamics.acceleration(state.q, state.v, force)
        chain = ClosedChain(self.robot)
        chain.update(state.q, state.v)
        second = chain.platform_jacobian() @ a + chain.full_rate()[chain.rows :] @ state.v
        return np.concatenate([second, a[self.robot.carrier_velocity]])


def require_linearisation(state: State, force: Array) -> None:
    robot, nearby = state.robot, Nearby(state)
    d, zero = robot.n + robot.k, np.zeros(robot.n + robot.k)
    driven = np.concatenate([robot.actuated_velocity, robot.carrier_velocity])
    linear = linearise(robot, state, force[robot.actuated_velocity], force[robot.carrier_velocity])

    def pushed(push: Array) -> Array:
        total = force.copy()
        total[driven] += push
        return nearby.acceleration(state, total)

    expected = (
        (linear.A[d:, :d], difference_quotient(lambda dy: nearby.acceleration(nearby.at(dy, zero), force), d)),
        (linear.A[d:, d:], difference_quotient(lambda dz: nearby.acceleration(nearby.at(zero, dz), force), d)),
        (linear.B[d:], difference_quotient(pushed, len(driven))),
    )
    for ours, theirs in expected:
        np.testing.assert_allclose(ours, theirs, atol=ACCURACY * np.abs(theirs).max())
    np.testing.assert_allclose(linear.acceleration, nearby.acceleration(state, force), rtol=1e-9, atol=1e-9)
    assert (linear.B[:d] == 0.0).all()
    assert (linear.A[:d, d:] == np.eye(d)).all()


@pytest.mark.parametrize("name", [*zoo.SHIPPED, "3rps"])
def test_forward_dynamics_are_linearised_along_the_closures(name: str) -> None:
    robot = moving.massive(name)
    for i, state in enumerate(moving.random_states(robot, 21, 2)):
        require_linearisation(state, moving.random_force(robot, i))


def test_the_linearisation_is_finite_and_right_at_a_type_two_pose() -> None:
    state = moving.type_two_state()
    require_linearisation(state, moving.random_force(state.robot, 3))


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "gough", "rod"])
def test_inverse_dynamics_are_differentiated_along_the_closures(name: str) -> None:
    # (f, F) of the batched inverse dynamics, whose accelerations come from the inverse kinematics: another code
    robot = chain_of(name) if name == "rod" else moving.massive(name)
    d, zero = robot.n + robot.k, np.zeros(robot.n + robot.k)
    state = moving.random_states(robot, 22, 1)[0]
    nearby = Nearby(state)
    rate = np.random.default_rng(1).normal(size=d)

    def force(dy: Array, dz: Array, da: Array) -> Array:
        there, second = nearby.at(dy, dz), rate + da
        motion = PlatformMotion([0.0], np.array(there.x)[None], there.xd[None], second[None, : robot.n])
        carriers = CarrierMotion(there.s[None], there.sd[None], second[None, robot.n :])
        _, reduced = inverse_dynamics(robot, motion, carriers)
        return np.concatenate([reduced.f[0], reduced.carrier_force[0]])

    motion = PlatformMotion([0.0], np.array(state.x)[None], state.xd[None], rate[None, : robot.n])
    along, _ = inverse_dynamics(robot, motion, CarrierMotion(state.s[None], state.sd[None], rate[None, robot.n :]))
    derivatives = inverse_derivatives(robot, state.q, state.v, along.a[0])
    np.testing.assert_allclose(derivatives.force, force(zero, zero, zero), rtol=1e-9, atol=1e-9)
    for ours, theirs in (
        (derivatives.force_y, difference_quotient(lambda dy: force(dy, zero, zero), d)),
        (derivatives.force_z, difference_quotient(lambda dz: force(zero, dz, zero), d)),
        (derivatives.mass, difference_quotient(lambda da: force(zero, zero, da), d)),
    ):
        np.testing.assert_allclose(ours, theirs, atol=ACCURACY * np.abs(theirs).max())


def test_a_rotating_pose_turns_its_own_error() -> None:
    # for a constant world-aligned twist on both machines, the rotation vector between them obeys δθ' = δω + ω × δθ
    robot = moving.massive("gough")
    state = moving.random_states(robot, 23, 1)[0]
    linear = linearise(robot, state, np.zeros(6))
    wx, wy, wz = state.xd[3:]
    np.testing.assert_allclose(linear.A[3:6, 3:6], [[0, -wz, wy], [wz, 0, -wx], [-wy, wx, 0]])
    assert np.count_nonzero(linear.A[:3, :6]) == 0


def test_the_error_of_a_state_is_its_difference_from_the_reference() -> None:
    state = closed_state(zoo.robot_of("3rrr"), [0.9, 0.45, 0.1], [0.1, 0.2, 0.3], 0.2, 0.4)
    error = state_error(state.robot, state, np.array([0.8, 0.5, 0.0]), np.zeros(3), np.zeros(3), np.ones(3))
    np.testing.assert_allclose(error, [0.1, -0.05, 0.1, 0.2, 0.2, 0.2, 0.1, 0.2, 0.3, -0.6, -0.6, -0.6], atol=1e-12)


def stretched(robot: Robot) -> Array:
    """Return the four-bar with coupler and rocker in one line: its crank has turned as far as these reach."""
    ground, crank, coupler, rocker = (
        float(robot.parameters[f"{name}_length"]) for name in ("ground", "crank", "coupler", "rocker")
    )
    reach = coupler + rocker
    cosine = (ground**2 + crank**2 - reach**2) / (2 * ground * crank)
    angle = float(np.arccos(cosine))
    pin = crank * np.array([np.cos(angle), np.sin(angle)])
    q = np.array(robot.q_reference)
    direction = float(np.arctan2(pin[1], pin[0] - ground))
    for name, value in (("crank", angle), ("rocker", direction), ("coupler", 0.0)):
        q[robot.model.joints[robot.model.getJointId(name)].idx_q] = value
    return q


def test_type_one_poses_are_refused_with_their_margin() -> None:
    robot = zoo.robot_of("four_bar", ground_length=0.5, crank_length=0.3, coupler_length=0.4, rocker_length=0.3)
    q = stretched(robot)
    zero = np.zeros(robot.model.nv)
    with pytest.raises(SingularPoseError, match="type I") as caught:
        inverse_derivatives(robot, q, zero, zero)
    assert caught.value.details["margin"] < 1e-7
    # forward dynamics itself does not mind
    assert np.isfinite(ForwardDynamics(robot).acceleration(q, zero, zero)).all()


def test_joints_of_several_freedoms_are_refused_by_name(tmp_path: Path) -> None:
    robot = moving.floating(tmp_path)
    zero = np.zeros(robot.model.nv)
    with pytest.raises(UnsupportedRobotError, match="root") as caught:
        inverse_derivatives(robot, np.array(robot.q_reference), zero, zero)
    assert caught.value.details["joint"] == "root"
