"""q̇ from v, for joints whose configuration has more numbers than freedoms."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array

Rate = Callable[[Array, Array], Array]


def configuration_rate(model: pin.Model) -> Rate:
    """Return the function from q (nq,) and v (nv,) to q̇ (nq,).

    It is linear in q and defined off the unit circle and the unit sphere too, so that an integrator may call it at its
    inner stages.
    """
    if model.nq == model.nv:
        return lambda q, v: v
    joints = [(str(joint.shortname()), joint.idx_q, joint.nq, joint.idx_v) for joint in list(model.joints)[1:]]

    def rate(q: Array, v: Array) -> Array:
        result = np.empty(model.nq)
        for kind, iq, nq, iv in joints:
            result[iq : iq + nq] = _joint_rate(kind, q[iq : iq + nq], v[iv : iv + 6])
        return result

    return rate


def _joint_rate(kind: str, q: Array, v: Array) -> Array:
    if kind == "JointModelFreeFlyer":  # its linear velocity is in the frame of the body
        turned = q[3:] / np.linalg.norm(q[3:])
        linear = pin.Quaternion(turned.copy()).toRotationMatrix() @ v[:3]
        return np.concatenate([linear, _quaternion_rate(q[3:], v[3:6])])
    if kind == "JointModelSpherical":
        return _quaternion_rate(q, v[:3])
    if kind == "JointModelPlanar":
        c, s = q[2], q[3]
        return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1], -s * v[2], c * v[2]])
    if len(q) == 2:
        return np.array([-q[1] * v[0], q[0] * v[0]])
    return v[: len(q)]


def _quaternion_rate(q: Array, omega: Array) -> Array:
    """Return half the product of a quaternion (x, y, z, w) and an angular velocity in the body's frame."""
    vector, scalar = q[:3], q[3]
    return 0.5 * np.append(scalar * omega + np.cross(vector, omega), -vector @ omega)
