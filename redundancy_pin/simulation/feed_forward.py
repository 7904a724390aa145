"""Feed-forward of a plan: its efforts over time, whatever the machine does."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.continuous_motion import TimedTrajectory
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.reference import MotionReference, plan_reference
from redundancy_pin.simulation.state import State, tree_state


class FeedForward:
    """The efforts of a plan or reference, open loop.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.

    Raises:
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.
    """

    def __init__(self, plan: Plan | MotionReference, *, motion: TimedTrajectory | None = None) -> None:
        self.reference = plan if isinstance(plan, MotionReference) else plan_reference(plan, motion=motion)
        self.breaks = self.reference.edges[1:-1]
        self.jumps = self.reference.jumps
        self.end = self.reference.end

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        return self.reference.loads(t)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return the planned s, ṡ, s̈ (k,) at time t."""
        return self.reference.carriers(t)

    def start_state(self, robot: Robot) -> State:
        """Return the planned state at the start."""
        q, v, _ = self.reference.tree(self.reference.start)
        return tree_state(robot, np.array(q), np.array(v), t=self.reference.start)
