"""Rows of couplings: joint positions that are polynomials of other positions, q_j = p(q_i), such as gears.

With Φ = q_j − p(q_i), m or rad, as one more row of the constraints,

    Φ̇ = v_j − p' v_i,    J̇ = −p'' v_i e_i,    J̈ = −(p''' v_i² + p'' v̇_i) e_i.

The multiplier is the effort that the coupling exerts in joint j; in joint i it exerts −p' times that. Further
joints may be added by constant factors, q_j = p(q_i) + Σ f_k q_k: they change Φ and its Jacobian alone.
"""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.types import slides


class CouplingRows:
    """The C couplings of a robot, at one configuration (nq,) or at many (N, nq).

    Args:
        robot: the robot.
        first: the place of the first coupling among the rows of the constraints.

    Attributes:
        at: their places among the rows.
        turning: whether each is of a joint that turns.
    """

    def __init__(self, robot: Robot, first: int) -> None:
        model, self._nv = robot.model, robot.model.nv
        self.at = slice(first, first + len(robot.couplings))
        # what is held at a place is coupled to itself by a polynomial of degree zero
        ends = [[find_joint(model, name) for name in (each.joint, each.of or each.joint)] for each in robot.couplings]
        self._q, self._of_q = np.array([[int(joint.idx_q) for joint in pair] for pair in ends], dtype=np.intp).T
        self._v, self._of_v = np.array([[int(joint.idx_v) for joint in pair] for pair in ends], dtype=np.intp).T
        self.turning = [not slides(joint) for joint, _ in ends]
        self._rows = np.arange(len(ends))
        self._more_q, self._more_v = np.zeros((len(ends), model.nq)), np.zeros((len(ends), model.nv))
        for row, each in enumerate(robot.couplings):
            for name, factor in each.also:
                joint = find_joint(model, name)
                self._more_q[row, joint.idx_q] += factor
                self._more_v[row, joint.idx_v] += factor
        degree = max(len(each.polynomial) for each in robot.couplings)
        powers = np.zeros((len(ends), degree))
        for row, each in enumerate(robot.couplings):
            powers[row, : len(each.polynomial)] = each.polynomial
        self._powers = [powers]
        for _ in range(3):  # derivatives
            powers = np.concatenate([powers[:, 1:] * np.arange(1, degree), np.zeros((len(ends), 1))], axis=1)
            self._powers.append(powers)

    def _value(self, derivative: int, q: Array) -> Array:
        """Return p, or one of its derivatives, (C,) or (N, C), by Horner's rule."""
        at = q[..., self._of_q]
        result = np.zeros(at.shape)
        for power in self._powers[derivative].T[::-1]:
            result = result * at + power
        return result

    def residual(self, q: Array) -> Array:
        """Return (C,) or (N, C) Φ."""
        phi: Array = q[..., self._q] - self._value(0, q) - q @ self._more_q.T
        return phi

    def jacobian(self, q: Array) -> Array:
        """Return (C, nv) or (N, C, nv) the rows."""
        rows = self._in_column(-self._value(1, q)) - self._more_v
        rows[..., self._rows, self._v] += 1.0
        return rows

    def jacobian_rate(self, q: Array, v: Array) -> Array:
        """Return (C, nv) J̇ at one state."""
        return self._in_column(-self._value(2, q) * v[self._of_v])

    def jacobian_second_rate(self, q: Array, v: Array, a: Array) -> Array:
        """Return (C, nv) J̈ along a motion."""
        rate, second = v[self._of_v], a[self._of_v]
        return self._in_column(-(self._value(3, q) * rate**2 + self._value(2, q) * second))

    def _in_column(self, values: Array) -> Array:
        rows = np.zeros((*values.shape, self._nv))
        rows[..., self._rows, self._of_v] = values
        return rows
