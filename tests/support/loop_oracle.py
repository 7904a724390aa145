"""Inverse dynamics of trees whose loops are closed at points in a plane, by plain Pinocchio and linear algebra."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array


class Loops:
    """A tree with loops: frames in pairs that coincide along two axes of the world, and joints that are driven.

    Args:
        model: the tree; joints of one degree of freedom.
        ends: names of the frames of each pair.
        driven: names of the driven joints, as many as there are degrees of freedom.
        axes: the two axes of the plane.
    """

    def __init__(
        self, model: pin.Model, ends: Sequence[tuple[str, str]], driven: Sequence[str], axes: tuple[int, int] = (0, 1)
    ) -> None:
        self.model, self.data, self.axes = model, model.createData(), list(axes)
        self.ends = [tuple(model.getFrameId(name) for name in pair) for pair in ends]
        joints = [model.joints[model.getJointId(name)] for name in driven]
        self.driven, self.places = [each.idx_v for each in joints], [each.idx_q for each in joints]

    def rows(self, q: Array, v: Array) -> tuple[Array, Array, Array]:
        """Return residuals, Jacobian and its rate times v of the loops, then of the driven joints."""
        model, data, aligned = self.model, self.data, pin.LOCAL_WORLD_ALIGNED
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        gaps, rows, bias = [], [], []
        for a, b in self.ends:
            gaps.append((data.oMf[b].translation - data.oMf[a].translation)[self.axes])
            rows.append(np.subtract(*(pin.getFrameJacobian(model, data, each, aligned)[self.axes] for each in (b, a))))
            accelerations = (pin.getFrameClassicalAcceleration(model, data, each, aligned).linear for each in (b, a))
            bias.append(np.subtract(*accelerations)[self.axes])
        rows.append(np.eye(model.nv)[self.driven])
        return np.concatenate(gaps), np.concatenate(rows), np.concatenate([*bias, np.zeros(len(self.driven))])

    def torque(self, x: Array, xd: Array, xdd: Array, near: Array | None = None) -> Array:
        """Return efforts of the driven joints at their positions, rates and second rates: Kᵀ (λ, τ) = rnea.

        ``near``: (nq,) a configuration near the closed one, all joints at zero when left out.
        """
        q, still, n = pin.neutral(self.model) if near is None else near, np.zeros(self.model.nv), len(x)
        for _ in range(20):
            gap, K, _ = self.rows(q, still)
            q = pin.integrate(self.model, q, np.linalg.solve(K, np.concatenate([-gap, x - q[self.places]])))
        assert np.abs(self.rows(q, still)[0]).max() < 1e-14
        v = np.linalg.solve(K, np.concatenate([np.zeros(len(K) - n), xd]))
        _, K, bias = self.rows(q, v)
        a = np.linalg.solve(K, np.concatenate([np.zeros(len(K) - n), xdd]) - bias)
        return np.linalg.solve(K.T, pin.rnea(self.model, self.data, q, v, a))[-n:]
