"""Singularities: kinds and margins of configurations, instants along a motion, curves over the workspace."""
