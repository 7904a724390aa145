"""What controllers along a reference share: the reference, its breaks and end, where to start."""

from __future__ import annotations

from redundancy_pin.arrays import Array
from redundancy_pin.planners.continuous_motion import TimedTrajectory
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.control import Sampling
from redundancy_pin.simulation.reference import MotionReference, plan_reference
from redundancy_pin.simulation.state import State, tree_state


class Tracking:
    """A controller's view of the motion it holds.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        sampling: how it will be sampled, if it will be.
    """

    def __init__(self, plan: Plan | MotionReference, motion: TimedTrajectory | None, sampling: Sampling | None) -> None:
        self.reference = plan if isinstance(plan, MotionReference) else plan_reference(plan, motion=motion)
        self.robot = self.reference.robot
        self.sampling = sampling
        self.breaks = self.reference.edges[1:-1] if sampling is None else self.reference.edges[:0]
        """Efforts kink at the edges of the reference; those of a sampled controller are constant between samples."""
        self.end = self.reference.end
        self.lead = 0.0 if sampling is None else sampling.delay + 0.5 * sampling.period
        """From reading the state to the middle of the interval in which the answer acts, s."""

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return the planned s, ṡ, s̈ (k,) at time t."""
        return self.reference.carriers(t)

    def start_state(self, robot: Robot) -> State:
        """Return the planned state at the start."""
        q, v, _ = self.reference.tree(self.reference.start)
        return tree_state(robot, q.copy(), v.copy(), t=self.reference.start)
