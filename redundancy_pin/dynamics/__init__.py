"""Dynamics: the protocol, its two backends, and the distribution of f over the actuators."""
