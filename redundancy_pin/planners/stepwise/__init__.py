"""Least effort one time step at a time (Parsa 2014, chapter 4)."""

from redundancy_pin.planners.stepwise.planner import plan_stepwise

__all__ = ["plan_stepwise"]
