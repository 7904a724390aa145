"""A robot with its drives: from a state and a command to forces, accelerations and rates."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.dynamics.forward import Accelerations, ForwardKernel
from redundancy_pin.dynamics.tree_loads import TreeLoads, TreeState, tree_energy
from redundancy_pin.errors import IllPosedModelError, InputError, SingularPoseError
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.simulation.controllers.base import Amplifiers, CarrierLaw, Command
from redundancy_pin.simulation.forward import Acceleration, ForwardDynamics
from redundancy_pin.simulation.rank_loss import Sheet
from redundancy_pin.simulation.state import Manifold, State

External = Callable[[State], Array]
"""From a state to further generalised forces (nv,), N or N·m: friction, disturbances."""


class Machine:
    """A robot with its drives, as a differential equation in y = (q, v), without memory from call to call.

    Args:
        robot: the robot.
        amplifiers: the controller behind its amplifiers.
        carrier_law: prescribed motion of the carriers, or None where forces drive them.
        external: further generalised forces.
        kernel: machine code for it, and for the projection; states that it refuses are computed here.
        held: (h,) tree velocities of joints that stops fix.
        q: (nq,) configuration where they do.
        basis: of the closure rows in use there, see ``ClosedChain``.
    """

    def __init__(
        self,
        robot: Robot,
        amplifiers: Amplifiers,
        carrier_law: CarrierLaw | None,
        external: External | None,
        kernel: ForwardKernel | None = None,
        held: Sequence[int] = (),
        q: Array | None = None,
        basis: Array | None = None,
    ) -> None:
        self.robot = robot
        self.kernel = kernel
        self.dynamics = ForwardDynamics(robot, prescribed=carrier_law is not None, held=held, q=q, basis=basis)
        self.free = self
        """The machine without stops."""
        self.held, self.chain = self.dynamics.held, self.dynamics.chain
        self.manifold = Manifold(self.chain, held)
        self.amplifiers, self._law, self._external = amplifiers, carrier_law, external
        # loads except wrenches are in the equations
        wrenches = partial(self._wrench_force, TreeLoads(robot)) if of_kind(robot.loads, Wrench) else None
        self._further = [force for force in (wrenches, external) if force is not None]
        self._split = robot.model.nq

    def with_all_rows(self, q: Array) -> Machine | None:
        """Return the machine with the combinations of all closure rows that suit q (nq,), without machine code.

        None where the rows in use keep their rank. Machine code has the independent rows alone.
        """
        if not self.chain.system.has_dependent_rows:
            return None
        machine = Machine(self.robot, self.amplifiers, self._law, self._external)
        machine.chain.use_basis(self.chain.basis)
        machine.chain.place(q)
        if not machine.chain.renew_basis():
            return None
        machine.dynamics.adapt(q)
        return machine

    def holding(self, held: IntArray, q: Array) -> Machine:
        """Return the machine with joints at rest at q (nq,) that stops hold, by their tree velocities (h,)."""
        free = self.free
        if not len(held):
            return free
        basis = free.chain.basis
        machine = Machine(self.robot, self.amplifiers, self._law, self._external, None, held.tolist(), q, basis)
        machine.free = free
        return machine

    def state(self, t: float, y: Array) -> State:
        """Return the state of y = (q, v) at time t, carriers where the law wants them."""
        if self._law is None:
            return State(self.chain, t, y[: self._split], y[self._split :], self.kernel)
        q, v = y[: self._split].copy(), y[self._split :].copy()
        q[self.robot.carrier_position], v[self.robot.carrier_velocity], _ = self._law(t)
        return State(self.chain, t, q, v, self.kernel)

    def command(self, state: State, hold: Command | None) -> Command:
        """Return the command at a state: the one on hold, or else the controller's answer."""
        return self.amplifiers.command(state) if hold is None else hold

    def rate(self, state: State, command: Command, sheet: Sheet | None = None) -> Array:
        """Return ẏ (nq + nv,) at a state under a command; ``sheet``: see ``ForwardDynamics.acceleration``.

        Raises:
            IllPosedModelError, SingularPoseError: forces do not determine the acceleration.
        """
        model, q, v, force = self.robot.model, state.q, state.v, self._force(state, command)
        solved = self._by_code(state, force, sheet)
        if solved is None:
            acceleration = self.dynamics.acceleration(q, v, force, self._given(state.t), sheet=sheet)
        else:
            acceleration = solved.a
        # defined off the unit circle and the unit sphere too, where the inner stages of an integrator are
        rate = v if model.nq == model.nv else pin.tangentMap(model, q) @ v
        return np.concatenate([rate, acceleration])

    def solve(self, state: State, command: Command, sheet: Sheet | None = None) -> Acceleration:
        """Return accelerations and forces at a closed state under a command; raises like ``rate``."""
        force = self._force(state, command)
        solved = self._by_code(state, force, sheet)
        if solved is None:
            a = self.dynamics.acceleration(state.q, state.v, force, self._given(state.t), sheet=sheet)
            loads = self.dynamics.forces(state.q, state.v, force, a, sheet=sheet)
        else:
            carrier_force = solved.missing[self.robot.carrier_velocity]
            loads = Acceleration(solved.a, solved.closure_force, carrier_force, np.zeros(len(solved.a)))
        if self._law is None:  # what the actuators give, without friction and other external forces on the carriers
            loads = replace(loads, carrier_force=command[1])
        return loads

    def project(self, t: float, y: Array, sheet: Sheet | None = None) -> tuple[Array, float, float]:
        """Return the closed state nearest to y, or on a sheet, and the closure residual before and after, m."""
        state = self.state(t, y)
        motion = None if sheet is None else sheet.at(state.q, state.v)
        if motion is not None:
            return np.concatenate([motion.q, motion.v]), self._gap(state.q), self._gap(motion.q)
        projected = None
        if self.kernel is not None:
            projected = self.kernel.project(np.concatenate([state.q, state.v]), self.manifold.tolerance)
        if projected is None:
            q, v, before, left = self.manifold.project(state.q, state.v)
            projected = np.concatenate([q, v]), before, left
        closed, before, left = projected
        dependent = self.chain.system.dependent_row_residual(closed[None, : self._split])
        return closed, before, max(left, float(dependent[0]))

    def least_inertia(self, t: float, y: Array) -> float:
        """Return the smallest pivot of the mass matrix over the largest, at the last state or, with code, at y."""
        if self.kernel is not None:
            state = self.state(t, y)
            with suppress(IllPosedModelError, SingularPoseError):
                self.dynamics.acceleration(state.q, state.v, np.zeros(len(state.v)), self._given(t))
        return self.dynamics.least_inertia

    @property
    def heeds_time_only(self) -> bool:
        """Whether forces other than the command do not depend on the state."""
        return self._law is None and not self._further

    def forces_at(
        self, t: float, q: Array, v: Array, hold: Command | None
    ) -> tuple[Array, tuple[Array, Array, Array] | None]:
        """Return the forces at a state, for machine code; the command is the one on hold, or the controller's answer.

        NaN if the controller has no answer. Carriers that follow a law are written into q and v.
        """
        law = None if self._law is None else self._law(t)
        if law is not None:
            q[self.robot.carrier_position], v[self.robot.carrier_velocity], _ = law
        state = State(self.chain, t, q, v, self.kernel)
        try:
            return self._force(state, self.command(state, hold)), law
        except InputError:  # a trial step that is too long may leave a controller without an answer
            return np.full(len(v), np.nan), law

    def _gap(self, q: Array) -> float:
        self.chain.update(q, np.zeros(self.robot.model.nv))
        return self.chain.largest_residual()

    def _force(self, state: State, command: Command) -> Array:
        robot = self.robot
        force = np.zeros(len(state.v))
        force[robot.actuated_velocity] = command[0]
        if self._law is None:
            force[robot.carrier_velocity] = command[1]
        return sum((further(state) for further in self._further), start=force)

    def _wrench_force(self, loads: TreeLoads, state: State) -> Array:
        values = wrench_values(state.robot.loads, np.array([state.t]), state.x[None], state.xd[None])
        tree = TreeState(state.q, state.v, 0.0 * state.v, [value[0] for value in values])
        return loads.external(self.chain.data, tree)

    def energy(self, state: State) -> float:
        """Return kinetic and potential energy, rotors and springs included, J (zero height at the world origin)."""
        return tree_energy(self.robot, self.chain.data, state.q, state.v)

    def _by_code(self, state: State, force: Array, sheet: Sheet | None) -> Accelerations | None:
        """Return the result of machine code; None without it, on a sheet, and if it refuses."""
        if self.kernel is None or sheet is not None:
            return None
        return self.kernel.accelerations(state.q, state.v, force, self._given(state.t))

    def _given(self, t: float) -> Array | None:
        return None if self._law is None else self._law(t)[2]
