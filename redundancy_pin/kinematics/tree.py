"""Frames and joint Jacobian of a Pinocchio tree, placed at one configuration after another.

All vectors are in world coordinates. Velocities are spatial vectors (linear, angular) about the world origin: the
velocity of the point of the body that is there, and the angular velocity (Featherstone, "Rigid Body Dynamics
Algorithms", 2008, chapter 2). A column of J is the spatial velocity per unit rate of a joint.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array

_FRAME = 12
"""Numbers of a frame: three axes, then its origin."""

_COVERED = ("JointModelR", "JointModelP", "JointModelSpherical", "JointModelFreeFlyer", "JointModelTranslation")
"""Beginnings of the names of joints whose q is translations, then one angle, its cosine and sine, or a quaternion."""


class TreePlacement:
    """A tree at one configuration; the arrays are a workspace that each placement overwrites.

    It holds Pinocchio data, so each thread or process makes its own.

    Args:
        model: the Pinocchio tree.

    Attributes:
        q: (nq,) the configuration that was placed last.
        vectors: (12 F,) axes and origin of each of Pinocchio's F frames.
        J, dJ: (6, nv) joint Jacobian and its time derivative.

    Example:
        >>> tree = TreePlacement(model)
        >>> tree.place(q)
        >>> origin = tree.vectors[12 * frame + 9 : 12 * frame + 12]
    """

    q: Array

    def __init__(self, model: pin.Model) -> None:
        self.model = model
        self.data = data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        self.vectors, self._copied = _frame_memory(model, data)
        self.J, self.dJ = (part.reshape(6, -1) for part in (data.J, data.dJ))  # Pinocchio drops the axis of one column

    def place(self, q: Array) -> None:
        """Set ``vectors`` and ``J`` at q (nq,)."""
        self.q = q
        pin.computeJointJacobians(self.model, self.data, q)
        self._update_frames()

    def place_moving(self, q: Array, v: Array) -> None:
        """Set ``vectors``, ``J`` and ``dJ`` at q (nq,) and v (nv,)."""
        self.q = q
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        self._update_frames()

    def _update_frames(self) -> None:
        pin.updateFramePlacements(self.model, self.data)
        for target, source in self._copied:
            target[:] = source


def frame_placement(vectors: Array, frame: int) -> tuple[Array, Array]:
    """Return rotation (3, 3) or (3, 3, N) and origin (3,) or (3, N), m, of a frame of ``TreePlacement.vectors``.

    Args:
        vectors: (12 F,), or (12 F, N) of N configurations.
        frame: Pinocchio's index of the frame.
    """
    block = vectors[_FRAME * frame : _FRAME * (frame + 1)].reshape(4, 3, *vectors.shape[1:])
    return block[:3].swapaxes(0, 1), block[3]


def is_covered(model: pin.Model, index: int) -> bool:
    """Return whether a joint has constant axes and a known order of q: no helical, composite or Euler-angle joint."""
    kind = str(model.joints[index].shortname())
    return kind.startswith(_COVERED) and kind != "JointModelSphericalZYX"


def motion_subspace(model: pin.Model, data: pin.Data, index: int) -> Array:
    """Return (6, nv_joint) the motion subspace of a joint, in its own frame: linear rows, then angular ones.

    Args:
        model: the Pinocchio tree.
        data: its data, after ``pin.computeJointJacobians``.
        index: index of the joint.
    """
    # as the joint has it, exact: a Jacobian has come back from the world with rounding
    columns: Array = np.reshape(data.joints[index].S, (6, model.joints[index].nv))
    return columns


def _frame_memory(model: pin.Model, data: pin.Data) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return (12 F,) axes and origin of each frame, and the data to copy into them after each update.

    Pinocchio keeps a placement as three axes and an origin, and one placement behind the other: its memory is the array
    itself. To copy it out frame by frame takes longer than all the arithmetic with it. Where the layout is another one
    (that of an alignment beyond eight bytes), it is copied all the same.
    """
    parts = [(data.oMf[i].rotation, data.oMf[i].translation) for i in range(model.nframes)]
    first = parts[0][0]
    start, size = _address(first), first.itemsize
    for i in {0, 1, len(parts) - 1} & set(range(len(parts))):
        rotation, translation = parts[i]
        offset = _FRAME * i * size
        places = _address(rotation) - start, _address(translation) - start
        strides = rotation.strides == (size, 3 * size) and translation.strides == (size,)
        if places != (offset, offset + 9 * size) or not strides:
            break
    else:
        return np.lib.stride_tricks.as_strided(first, (_FRAME * len(parts),), (size,), writeable=False), []
    vectors = np.zeros((len(parts), 4, 3))
    copied = [pair for v, (R, p) in zip(vectors, parts, strict=True) for pair in ((v[:3].T, R), (v[3], p))]
    return vectors.reshape(-1), copied


def _address(array: Array) -> int:
    address: int = array.__array_interface__["data"][0]  # ``array.ctypes.data`` takes ten times as long
    return address
