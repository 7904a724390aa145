"""Least time along a path, the carriers planned together with the timing."""

from redundancy_pin.planners.time_optimal.planner import plan_time_optimal

__all__ = ["plan_time_optimal"]
