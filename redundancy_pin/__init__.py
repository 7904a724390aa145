"""Closed-chain (parallel-robot) dynamics and planning on Pinocchio."""

__version__ = "0.1.0"
