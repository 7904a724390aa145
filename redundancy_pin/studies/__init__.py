"""Studies: plans and simulations by the hundred, kept as they are finished."""
