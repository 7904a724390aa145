"""Back onto the closures: the nearest closed configuration, and the nearest velocity they allow."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.coordinates import velocity_scale
from redundancy_pin.simulation.chain import ClosedChain

GAP = 1e-13
"""Closure gap, m, at which the projection is done: rounding of a machine of a metre is 1e-16 a row."""

_MOST_STEPS = 8
"""From the end of an integration step, 1e-9 off, two Newton steps reach rounding."""


class Manifold:
    """Projection of states onto closures and their rates, one state at a time.

    The steps are the shortest ones in scaled coordinates (rotations times the characteristic length), and leave the
    carriers alone.

    Args:
        chain: evaluator of the robot.
    """

    def __init__(self, chain: ClosedChain) -> None:
        self.chain = chain
        self._columns = chain.pose_columns
        self._inverse_scale = 1.0 / velocity_scale(chain.robot)[self._columns]
        self._turning_numbers = chain.model.nq != chain.model.nv

    def project(self, q: Array, v: Array) -> tuple[Array, Array, float, float]:
        """Return a closed configuration (nq,), a velocity (nv,) it allows, the gap found and the gap left, m.

        Args:
            q: (nq,) configuration near the closures.
            v: (nv,) velocity.
        """
        chain = self.chain
        q = pin.normalize(chain.model, q) if self._turning_numbers else q.copy()
        v = v.copy()
        gap, found = 0.0, -1.0
        for _ in range(_MOST_STEPS):
            chain.update(q, v)
            residual = chain.residual()
            gap = float(np.abs(residual).max(initial=0.0))
            found = gap if found < 0.0 else found
            if gap <= GAP:
                break
            step = np.zeros(len(v))
            step[self._columns] = -self._shortest(chain.jacobian(), residual)
            q = pin.integrate(chain.model, q, step)
        jacobian = chain.jacobian()
        v[self._columns] -= self._shortest(jacobian, jacobian.dot(v))
        return q, v, found, gap

    def _shortest(self, jacobian: Array, rate: Array) -> Array:
        """Return the shortest scaled velocity of the pose with J_c v = rate."""
        if not len(rate):
            return np.zeros(len(self._columns))
        scaled = jacobian.take(self._columns, 1) * self._inverse_scale
        _, multiplier, failed = lapack.dposv(scaled.dot(scaled.T), rate)
        if failed:  # the closures have lost rank: the partition says so
            return np.zeros(len(self._columns))
        step: Array = self._inverse_scale * scaled.T.dot(multiplier)
        return step
