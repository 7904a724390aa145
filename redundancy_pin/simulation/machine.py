"""The right-hand side that is integrated: state, controller, forces, accelerations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import IllPosedModelError, InputError, RedundancyPinError, SingularPoseError
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.control import CarrierLaw, Drive
from redundancy_pin.simulation.forward import Acceleration, ForwardDynamics
from redundancy_pin.simulation.manifold import Manifold
from redundancy_pin.simulation.pinocchio_way import ConstraintDynamics
from redundancy_pin.simulation.rates import configuration_rate
from redundancy_pin.simulation.state import State

Way = Literal["projected", "constraint_dynamics"]
External = Callable[[State], Array]
"""From a state to further generalised forces (nv,), N or N·m: friction, disturbances."""

Command = tuple[Array, Array]


class Machine:
    """A robot with what drives it, as a differential equation in y = (q, v).

    Args:
        robot: the robot.
        drive: controller and amplifiers.
        carrier_law: prescribed motion of the carriers, or None where forces drive them.
        external: further generalised forces.
        way: how accelerations are computed.

    Raises:
        InputError: ``way`` is unknown, or cannot take prescribed carriers.
        UnsupportedRobotError: ``way`` does not cover the robot.
    """

    def __init__(
        self, robot: Robot, drive: Drive, carrier_law: CarrierLaw | None, external: External | None, way: Way
    ) -> None:
        self.robot = robot
        self.dynamics = ForwardDynamics(robot, prescribed=carrier_law is not None)
        self.chain = self.dynamics.chain
        self.manifold = Manifold(self.chain)
        self._law, self._external, self._drive = carrier_law, external, drive
        self._rate = configuration_rate(robot.model)
        self._other = _second_way(robot, way, carrier_law is not None)
        self._split = robot.model.nq
        self.held: Command | None = None
        """Efforts that a sampled controller holds; None where the controller is asked at every instant."""
        self.until = np.inf
        """End of the present stretch, s: efforts that jump there are asked for just before it."""
        self.evaluations = 0
        self.trouble: RedundancyPinError | None = None
        """Why the last evaluation had no answer."""

    def state(self, t: float, y: Array) -> State:
        """Return the state of y = (q, v) at time t, carriers where the law wants them."""
        if self._law is None:
            return State(self.chain, t, y[: self._split], y[self._split :])
        q, v = y[: self._split].copy(), y[self._split :].copy()
        q[self.robot.carrier_position], v[self.robot.carrier_velocity], _ = self._law(t)
        return State(self.chain, t, q, v)

    def command(self, state: State) -> Command:
        """Return the efforts at a state: held, or asked for.

        Raises:
            InputError: see ``Drive.command``.
        """
        return self.held if self.held is not None else self.asked(state)

    def asked(self, state: State) -> Command:
        """Return what the controller wants at a state.

        Raises:
            InputError: see ``Drive.command``.
        """
        return self._drive.command(state.t, state)

    def __call__(self, t: float, y: Array) -> Array:
        """Return ẏ; NaN where there is none, with ``trouble`` saying why: the integrator then tries a shorter step."""
        self.evaluations += 1
        if y[0] != y[0]:  # a stage after one that had no answer
            return np.full(len(y), np.nan)
        state = self.state(t if t < self.until else float(np.nextafter(self.until, -np.inf)), y)
        try:
            acceleration = self._acceleration(state, self._force(state, self.command(state)))
        except (IllPosedModelError, SingularPoseError, InputError) as error:
            # a controller may have no answer to the state of a trial step that is too long
            self.trouble = error
            return np.full(len(y), np.nan)
        return np.concatenate([self._rate(state.q, state.v), acceleration])

    def loads(self, state: State) -> tuple[Command, Acceleration]:
        """Return efforts, accelerations and forces at a closed state.

        Raises:
            IllPosedModelError, SingularPoseError: there are none.
            InputError: see ``command``.
        """
        command = self.command(state)
        force = self._force(state, command)
        acceleration = self._acceleration(state, force)
        found = self.dynamics.forces(state.q, state.v, force, acceleration)
        if self._law is None:  # what the actuators give, without friction and other external forces on the carriers
            found = replace(found, carrier_force=command[1])
        return command, found

    def project(self, t: float, y: Array) -> tuple[Array, float, float]:
        """Return the closed state nearest to y, the gap that y had, and the gap left, m."""
        state = self.state(t, y)
        q, v, found, left = self.manifold.project(state.q, state.v)
        return np.concatenate([q, v]), found, left

    def _force(self, state: State, command: Command) -> Array:
        robot = self.robot
        force = np.zeros(len(state.v))
        force[robot.actuated_velocity] = command[0]
        if self._law is None:
            force[robot.carrier_velocity] = command[1]
        return force if self._external is None else force + self._external(state)

    def _acceleration(self, state: State, force: Array) -> Array:
        if self._other is not None:
            return self._other(state.q, state.v, force)
        given = None if self._law is None else self._law(state.t)[2]
        return self.dynamics.acceleration(state.q, state.v, force, given)


def _second_way(robot: Robot, way: str, prescribed: bool) -> ConstraintDynamics | None:
    if way == "projected":
        return None
    if way != "constraint_dynamics":
        raise InputError(f"way is {way!r}.", remedy='Pass "projected" or "constraint_dynamics".')
    if prescribed:
        raise InputError(
            "Pinocchio's constraintDynamics cannot drive carriers by motion.",
            remedy='Use way="projected", or drive the carriers by force.',
        )
    return ConstraintDynamics(robot)
