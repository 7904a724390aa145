"""Inverse dynamics of the 2-RPR and the 3-RRR, derived by hand from the principle of virtual work."""

from redundancy_pin.dynamics.virtual_work.backend import VirtualWork, VirtualWorkAlongMotion

__all__ = ["VirtualWork", "VirtualWorkAlongMotion"]
