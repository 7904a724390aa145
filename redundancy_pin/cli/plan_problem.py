"""What to plan: a robot, a motion, a planner and its parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from redundancy_pin.cli.keys import require_choice
from redundancy_pin.cli.options import RobotOptions
from redundancy_pin.cli.plan_parameters import read_parameters
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.experiments.backends import BACKENDS
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise import plan_stepwise
from redundancy_pin.planners.switch_off import plan_switch_off
from redundancy_pin.trajectory import Trajectory

PLANNERS: Mapping[str, Callable[..., Plan]] = {"switch-off": plan_switch_off, "stepwise": plan_stepwise}
"""Planners, by the name the command line uses."""

STEP = 5e-3
"""Length of the steps of the stepwise planner along a trajectory, s, where none is given."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Everything a planner needs.

    Attributes:
        planner: a key of ``PLANNERS``.
        dynamics: the dynamics of the robot.
        motion: the platform motion.
        parameters: keyword arguments of the planner.
    """

    planner: str
    dynamics: Dynamics
    motion: PlatformMotion | Trajectory
    parameters: Mapping[str, Any]

    def solve(self) -> Plan:
        """Return the plan.

        Raises:
            RedundancyPinError: as the planner.
        """
        return PLANNERS[self.planner](self.dynamics, self.motion, **self.parameters)


def problem(
    planner: str,
    robot: RobotOptions,
    backend: str,
    motion: PlatformMotion | Trajectory,
    parameters: Mapping[str, object],
    *,
    baseline: RobotOptions | None = None,
    step: float | None = None,
) -> Problem:
    """Put a problem together.

    Args:
        planner: a key of ``PLANNERS``.
        robot: the robot.
        backend: a key of ``BACKENDS``.
        motion: the platform motion.
        parameters: parameters of the planner as written.
        baseline: robot whose efforts a stepwise plan aims at a fraction of.
        step: length of the steps of a stepwise plan along a trajectory, s.

    Raises:
        RedundancyPinError: whatever loading the robots raises, or a parameter that does not fit.
    """
    values = read_parameters(planner, parameters)
    make = BACKENDS[require_choice(backend, tuple(BACKENDS), "the backend")]
    if planner != "stepwise":
        for name, given in (("baseline", baseline), ("step", step)):
            if given is not None:
                raise InputError(f"The planner {planner} takes no {name}.", remedy="Only stepwise does.", name=name)
        return Problem(planner, make(robot.load()), motion, values)
    if values.get("lam", 0.0) > 0.0 and baseline is None:
        raise InputError(
            f"lam = {values['lam']:g} asks for a fraction of the efforts of a baseline robot, and none is given.",
            remedy="Write --baseline carriers=false: the same robot without carriers.",
        )
    if isinstance(motion, Trajectory):
        motion = motion.sample(STEP if step is None else step)
    elif step is not None:
        raise InputError("A motion from a file has its own steps.", remedy="Leave the step out, or resample the file.")
    if baseline is not None:
        values["baseline"] = make(baseline.load())
    return Problem(planner, make(robot.load()), motion, values)
