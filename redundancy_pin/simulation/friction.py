"""Friction in the joints, as an external force of a simulation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.simulation.state import State


@dataclass(frozen=True, eq=False)
class JointFriction:
    """−c tanh(v / v₀) − b v in every joint; pass it as ``external`` of ``simulate``.

    Attributes:
        coulomb: (nv,) c, N or N·m.
        viscous: (nv,) b, N·s/m or N·m·s.
        smoothing: (nv,) v₀, the speed at which Coulomb friction has three quarters of its size, m/s or rad/s. Below it
            a joint creeps where a real one would stick.
    """

    coulomb: Array
    viscous: Array
    smoothing: Array

    def __call__(self, state: State) -> Array:
        """Return generalised forces (nv,)."""
        v = state.v
        force: Array = -self.coulomb * np.tanh(v / self.smoothing) - self.viscous * v
        return force
