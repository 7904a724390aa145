"""Forward dynamics of closed chains: accelerations, simulation, feed-forward of plans, linearisation."""
