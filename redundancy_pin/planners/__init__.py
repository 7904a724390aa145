"""Planners: carrier motion and efforts for a given platform motion, through the protocol of the backends."""
