"""What to plan: a robot, a motion, a planner and its parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from redundancy_pin.cli.keys import require_choice
from redundancy_pin.cli.options import RobotOptions
from redundancy_pin.cli.plan_parameters import PLANNERS, WITH_BASELINE, read_parameters
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.studies.case import BACKENDS
from redundancy_pin.trajectory import Trajectory

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

    def solve(self, progress: Callable[[str], None] | None = None) -> Plan:
        """Return the plan.

        Args:
            progress: called with a line of text at each stage, by planners that have stages.

        Raises:
            RedundancyPinError: as the planner.
        """
        make = PLANNERS[self.planner]
        told = {"progress": progress} if progress and "progress" in inspect.signature(make).parameters else {}
        return make(self.dynamics, self.motion, **self.parameters, **told)


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
        baseline: robot whose efforts a stepwise or whole-trajectory plan aims at a fraction of.
        step: length of the steps of a stepwise plan along a trajectory, s.

    Raises:
        RedundancyPinError: whatever loading the robots raises, or a parameter that does not fit.
    """
    values = read_parameters(planner, parameters)
    make = BACKENDS[require_choice(backend, tuple(BACKENDS), "the backend")]
    for name, given, takers in (("baseline", baseline, WITH_BASELINE), ("step", step, ("stepwise",))):
        if given is not None and planner not in takers:
            only = f"Only {' and '.join(takers)} {'does' if len(takers) == 1 else 'do'}."
            raise InputError(f"The planner {planner} takes no {name}.", remedy=only, name=name)
    if values.get("lam", 0.0) > 0.0 and baseline is None:
        raise InputError(
            f"lam = {values['lam']:g} asks for a fraction of the efforts of a baseline robot, and none is given.",
            remedy="Write --baseline carriers=false: the same robot without carriers.",
        )
    if planner == "stepwise":
        if isinstance(motion, Trajectory):
            motion = motion.sample(STEP if step is None else step)
        elif step is not None:
            raise InputError(
                "A motion from a file has its own steps.", remedy="Leave the step out, or resample the file."
            )
    if baseline is not None:
        values["baseline"] = make(baseline.load())
    return Problem(planner, make(robot.load()), motion, values)
