"""Crossing type II singularities with the main actuators switched off (Parsa 2014, chapter 3)."""

from redundancy_pin.planners.switch_off.planner import plan_switch_off

__all__ = ["plan_switch_off"]
