"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio."""

from redundancy_pin.loading import load_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion

__all__ = ["CarrierMotion", "PlatformMotion", "load_robot"]
__version__ = "0.1.0"
