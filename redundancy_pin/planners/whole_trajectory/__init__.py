"""Carriers and efforts planned together over a whole trajectory: direct transcription, solved by IPOPT."""

from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory

__all__ = ["plan_whole_trajectory"]
