"""Carriers and efforts planned together over a whole trajectory or path: direct transcription, solved by IPOPT."""

from redundancy_pin.planners.optimal.objectives import OBJECTIVES, ObjectiveTerm
from redundancy_pin.planners.optimal.time_optimal import plan_time_optimal
from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory

__all__ = ["OBJECTIVES", "ObjectiveTerm", "plan_time_optimal", "plan_whole_trajectory"]
