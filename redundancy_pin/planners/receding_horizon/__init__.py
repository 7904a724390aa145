"""On-line planning: the path is known for a short time ahead, and singularities come up inside it."""

from redundancy_pin.planners.receding_horizon.command import Command, Weights
from redundancy_pin.planners.receding_horizon.planner import RecedingHorizon
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.planners.receding_horizon.run import OnLineRun, run_online

__all__ = ["Command", "OnLineRun", "Preview", "RecedingHorizon", "Weights", "run_online"]
