"""Measurements of a real machine for a controller: encoders with steps, and speeds filtered from their differences."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, checked, positive
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.simulation.controllers.base import Command, Controller, EffortLaw
from redundancy_pin.simulation.state import Manifold, State


@dataclass(frozen=True, eq=False)
class JointFriction:
    """−c tanh(v / v₀) − b v in every joint; pass it as ``external`` of ``simulate``.

    Attributes:
        coulomb: (nv,) c, N or N·m.
        viscous: (nv,) b, N·s/m or N·m·s.
        smoothing: (nv,) v₀, the speed at which Coulomb friction has three quarters of its size, m/s or rad/s. Below it
            a joint creeps where a real one would stick.
    """

    coulomb: Array
    viscous: Array
    smoothing: Array

    def __call__(self, state: State) -> Array:
        """Return generalised forces (nv,)."""
        v = state.v
        force: Array = -self.coulomb * np.tanh(v / self.smoothing) - self.viscous * v
        return force


REVOLUTE_STEP = 2.0 * np.pi / 2**16
"""16 bits a turn, rad."""

PRISMATIC_STEP = 1e-6
"""m."""


class Encoders(Controller):
    """A controller that sees the machine through encoders on every joint; for sampled simulations.

    Encoders of the actuated joints alone would not do: at a type II pose they do not determine the pose. Readings are
    rounded to steps, homed where the simulation starts (there they read the planned configuration, whatever the true
    geometry) or by ``home``, and fitted to the closures of the robot that the controller knows, by the shortest
    step. Speeds are the planned speeds plus first-order filtered differences of the deviation from the plan, so the
    filter does not lag behind the planned motion.

    Args:
        controller: the controller that receives the estimated state.
        reference: the planned motion of the robot that the controller knows.
        period: sampling period, s.
        time_constant: of the filter, s.
        revolute_step: rad.
        prismatic_step: m.
        phase: (nq,) position of each encoder within a step when homed, fractions; zero when left out.
        home: (nq,) joint positions at which the machine was homed, minus the positions assigned to the encoders, m and
            rad; a start off the plan is then measured.

    Raises:
        InputError: a setting that is not positive, or a ``home`` of the wrong shape.
        UnsupportedRobotError: a joint whose position is more than one number.
    """

    def __init__(
        self,
        controller: Controller | EffortLaw,
        reference: MotionReference,
        *,
        period: float,
        time_constant: float = 5e-3,
        revolute_step: float = REVOLUTE_STEP,
        prismatic_step: float = PRISMATIC_STEP,
        phase: Array | None = None,
        home: Array | None = None,
    ) -> None:
        self.period, self.time_constant = positive(period, "period", "s"), positive(time_constant, "time_constant", "s")
        steps = positive(revolute_step, "revolute_step", "rad"), positive(prismatic_step, "prismatic_step", "m")
        robot = reference.robot
        if robot.model.nq != robot.model.nv:
            raise UnsupportedRobotError(
                f"{robot.name} has joints whose position is more than one number.",
                remedy="Build it from revolute and prismatic joints.",
            )
        self.controller, self.reference = controller, reference
        self.step = np.where(turning_velocities(robot), *steps)
        self.phase = np.zeros(robot.model.nq) if phase is None else phase
        self._chain = ClosedChain(robot)
        self._manifold = Manifold(self._chain)
        self._share = period / (time_constant + period)
        self._home: Array | None = None if home is None else checked(home, "home", (robot.model.nq,))
        self._last = -np.inf
        self._away = np.zeros(robot.model.nq)
        self._rate = np.zeros(robot.model.nv)

    def estimate(self, t: float, state: State) -> State:
        """Return the estimated state. Call it in order of time; the same time twice is one reading.

        Args:
            t: time of the reading, s.
            state: the true state, whose joint positions are read; of any robot with the same joints.

        Raises:
            InputError: a time before the last reading: the encoders were homed for another simulation.
        """
        if t < self._last:
            raise InputError(
                f"The encoders are read at {t:.6g} s, after they were read at {self._last:.6g} s.",
                remedy="Make new Encoders for each simulation: they are homed at its start.",
            )
        planned, speed, _ = self.reference.tree(t)
        first = not np.isfinite(self._last)
        if self._home is None:
            self._home = state.q - planned
        counts = np.round((state.q - self._home) / self.step + self.phase)
        reading = (counts - self.phase) * self.step
        if t > self._last:
            away = reading - planned
            if not first:
                self._rate = self._rate + self._share * ((away - self._away) / (t - self._last) - self._rate)
            self._away, self._last = away, t
        q, v, _, _ = self._manifold.project(reading, speed + self._rate)
        return State(self._chain, t, q, v, state.kernel)

    def effort(self, t: float, state: State) -> Command:
        """Return the efforts for the estimated state."""
        return self.controller.effort(t, self.estimate(t, state))
