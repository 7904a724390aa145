"""Controllers that hold a planned motion: feed-forward, computed torque, time-varying LQR."""

from redundancy_pin.simulation.controllers.allocation import Allocation, AllocationStatus
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr
from redundancy_pin.simulation.controllers.weights import LqrWeights, bryson_weights
from redundancy_pin.simulation.feed_forward import FeedForward

__all__ = [
    "Allocation",
    "AllocationStatus",
    "ComputedTorque",
    "FeedForward",
    "LqrWeights",
    "TimeVaryingLqr",
    "bryson_weights",
]
