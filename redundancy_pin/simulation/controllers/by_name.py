"""Controllers by name, and disturbances of the machine: noise of its amplifiers, friction of its joints."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, not_negative, one_of
from redundancy_pin.errors import InputError
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.simulation.controllers.base import (
    Adapted,
    Command,
    Controller,
    EffortLaw,
    FeedForward,
    Sampling,
)
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import JointFriction
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr
from redundancy_pin.simulation.state import State

Drive = Literal["open loop", "computed torque", "LQR"]
DRIVES: tuple[Drive, ...] = ("open loop", "computed torque", "LQR")


def controller_by_name(
    name: str,
    reference: MotionReference,
    *,
    sampling: Sampling | None = None,
    effort_limit: ArrayLike | None = None,
    carrier_force_limit: ArrayLike | None = None,
    **settings: Any,
) -> Controller:
    """Return a controller that holds a motion.

    Args:
        name: one of ``DRIVES``; the others are ``ComputedTorque`` and ``TimeVaryingLqr``, and open loop has the planned
            efforts: if sampled, taken at the middle of the interval in which they will act.
        reference: the motion, of the robot that the controller knows.
        sampling: of the simulation.
        effort_limit: of the amplifiers, as for ``simulate``.
        carrier_force_limit: the same.
        settings: further arguments of the controller.

    Raises:
        InputError: an unknown name, or a setting that the controller refuses.

    Example:
        >>> from redundancy_pin.simulation import controllers
        >>> from redundancy_pin.simulation import plan_reference
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> type(controllers.controller_by_name("open loop", plan_reference(plan))).__name__
        'FeedForward'
    """
    one_of(name, "The controller", DRIVES)
    if name == "open loop":
        for unknown in settings.keys() - {"dynamics"}:
            remedy = f"Leave it out, or choose one of {', '.join(DRIVES[1:])}."
            raise InputError(f"Open loop has no setting {unknown}.", remedy=remedy, name=unknown)
        return FeedForward(reference, sampling=sampling)
    made: Any = ComputedTorque if name == "computed torque" else TimeVaryingLqr
    limits = {"effort_limit": effort_limit, "carrier_force_limit": carrier_force_limit}
    controller: Controller = made(reference, sampling=sampling, **limits, **settings)
    return controller


class NoisyAmplifier(Adapted):
    """A controller whose forces come out with noise of a standard deviation, N or N·m; one value a period.

    It goes with a sampled simulation: a force that is another at every instant has no integral.
    """

    def __init__(self, controller: Controller | EffortLaw, random: np.random.Generator, noise: float) -> None:
        super().__init__(controller)
        self._random, self._noise = random, not_negative(noise, "noise")

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,) and carrier forces (k,) with noise."""
        tau, force = (part + self._noise * self._random.standard_normal(len(part)) for part in super().effort(t, state))
        return tau, force


def joint_friction(
    robot: Robot,
    *,
    prismatic_coulomb: float = 0.0,
    prismatic_viscous: float = 0.0,
    revolute_coulomb: float = 0.0,
    revolute_viscous: float = 0.0,
    prismatic_smoothing: float = 0.01,
    revolute_smoothing: float = 0.05,
    coulomb_factor: Array | float = 1.0,
    viscous_factor: Array | float = 1.0,
) -> JointFriction:
    """Return the friction of every joint of a robot, by whether it slides or turns.

    Args:
        robot: the robot.
        prismatic_coulomb: Coulomb friction of joints that slide, N.
        prismatic_viscous: their viscous friction, N·s/m.
        revolute_coulomb: of joints that turn, N·m.
        revolute_viscous: N·m·s.
        prismatic_smoothing: speed v₀ of tanh(v / v₀), m/s.
        revolute_smoothing: rad/s.
        coulomb_factor: scalar or (nv,) factors on Coulomb friction, each joint its own.
        viscous_factor: the same on viscous friction.

    Raises:
        InputError: negative friction.

    Example:
        >>> from redundancy_pin.simulation import controllers
        >>> friction = controllers.joint_friction(rp.load_robot("four_bar"), revolute_coulomb=0.1)
        >>> rp.simulate("four_bar", duration=0.05, external=friction).status.value
        'ok'
    """
    given = {"prismatic_coulomb": prismatic_coulomb, "prismatic_viscous": prismatic_viscous,
             "revolute_coulomb": revolute_coulomb, "revolute_viscous": revolute_viscous}  # fmt: skip
    for name, value in given.items():
        not_negative(value, name)
    turning = turning_velocities(robot)
    return JointFriction(
        coulomb_factor * np.where(turning, revolute_coulomb, prismatic_coulomb),
        viscous_factor * np.where(turning, revolute_viscous, prismatic_viscous),
        np.where(turning, revolute_smoothing, prismatic_smoothing),
    )
