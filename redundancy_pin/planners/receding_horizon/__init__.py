"""On-line planning: the path is known for a short preview, singularities come up inside it."""

from redundancy_pin.planners.receding_horizon.planner import Command, PlanningStatus, RecedingHorizon
from redundancy_pin.planners.receding_horizon.preview import Preview

__all__ = ["Command", "PlanningStatus", "Preview", "RecedingHorizon"]
