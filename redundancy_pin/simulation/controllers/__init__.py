"""Controllers that hold a planned motion (feed-forward, computed torque, LQR), and the base of one of your own."""

from redundancy_pin.dynamics.allocation import Allocation
from redundancy_pin.simulation.controllers.base import Controller, FeedForward, Sampling, Tracking
from redundancy_pin.simulation.controllers.by_name import NoisyAmplifier, controller_by_name, joint_friction
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque
from redundancy_pin.simulation.controllers.encoders import Encoders, JointFriction
from redundancy_pin.simulation.controllers.lqr import LqrWeights, TimeVaryingLqr, bryson_weights
from redundancy_pin.simulation.controllers.online import OnlinePlanning

__all__ = [
    "Allocation",
    "ComputedTorque",
    "Controller",
    "Encoders",
    "FeedForward",
    "JointFriction",
    "LqrWeights",
    "NoisyAmplifier",
    "OnlinePlanning",
    "Sampling",
    "TimeVaryingLqr",
    "Tracking",
    "bryson_weights",
    "controller_by_name",
    "joint_friction",
]
