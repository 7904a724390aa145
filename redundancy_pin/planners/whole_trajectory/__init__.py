"""Carriers and efforts planned together over a whole trajectory: direct transcription, solved by IPOPT."""

from redundancy_pin.planners.limits import Limits
from redundancy_pin.planners.whole_trajectory.options import OBJECTIVES, Mesh, Objective, ObjectiveTerm, Solver
from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory

__all__ = ["OBJECTIVES", "Limits", "Mesh", "Objective", "ObjectiveTerm", "Solver", "plan_whole_trajectory"]
