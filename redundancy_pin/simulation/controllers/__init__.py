"""Controllers that hold a planned motion: feed-forward, computed torque, time-varying LQR."""

from redundancy_pin.dynamics.allocation import Allocation, AllocationStatus
from redundancy_pin.simulation.controllers.base import FeedForward
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.lqr import LqrWeights, TimeVaryingLqr, bryson_weights

__all__ = [
    "Allocation",
    "AllocationStatus",
    "ComputedTorque",
    "FeedForward",
    "LqrWeights",
    "TimeVaryingLqr",
    "bryson_weights",
]
