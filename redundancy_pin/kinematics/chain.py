"""One state, or one pose after another, fast: what a simulation and a controller ask for tens of thousands of times.

The rows are those of ``kinematics.closure``, whose batched evaluator walks the tree in numpy; at one configuration
Pinocchio's joint Jacobian and its rate are there already, an order of magnitude faster (``ClosedChain``).

"""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.closure import PlacedRows, constraint_system
from redundancy_pin.kinematics.coordinates import readings
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index
from redundancy_pin.robot.named import is_pose


class ClosedChain:
    """Closure rows and platform rows of a robot at one state.

    An evaluator with a workspace: ``update`` sets the state, the other methods answer for it. It holds Pinocchio data,
    so each thread or process makes its own.

    Args:
        robot: the robot.

    Attributes:
        system: the batched evaluator of the same rows.
        rows: number r of closure rows.
        pose_columns: velocity indices that move the pose.
        closures: the closure rows, placed at the last state.
        vectors: (12 F,) axes and origin of each of Pinocchio's F frames, world axes, at the last state.
        J, dJ: (6, nv) joint Jacobian about the world origin and its rate, at the last state.
    """

    closures: PlacedRows

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.model = model = robot.model
        self.data = data = model.createData()
        self.system = system = constraint_system(robot)
        self.pose_columns, self.rows = system.pose_columns, len(system.rows)
        pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
        self.vectors, self._copied = _frame_memory(model, data)
        platform = None
        if robot.platform is not None:
            platform = data.oMf[find_link_index(model, robot.platform.frame)]
        self._platform_pose = None if platform is None else (platform.rotation, platform.translation)
        self._is_pose = is_pose(robot)
        self._readings = readings(robot)
        joints = (find_joint(model, name) for name in robot.independent_joints)
        self._joints = [(int(joint.idx_q), joint.nq == 2) for joint in joints]
        self.J, self.dJ = (part.reshape(6, -1) for part in (data.J, data.dJ))  # Pinocchio drops the axis of one column

    def __reduce__(self) -> tuple[type[ClosedChain], tuple[Robot]]:
        """Make another one where this is copied or sent to: views into Pinocchio's memory would not be views there."""
        return ClosedChain, (self.robot,)

    def place(self, q: Array) -> None:
        """Set ``vectors`` and ``J`` at q (nq,), and nothing else: for those who place rows of their own."""
        pin.computeJointJacobians(self.model, self.data, q)
        self._update_frames()

    def place_moving(self, q: Array, v: Array) -> None:
        """Set ``vectors``, ``J`` and ``dJ`` at q (nq,) and v (nv,)."""
        pin.computeJointJacobiansTimeVariation(self.model, self.data, q, v)
        self._update_frames()

    def update(self, q: Array, v: Array) -> None:
        """Set the state: q (nq,), v (nv,)."""
        self.place_moving(q, v)
        self.q, self.v = q, v
        self.closures = self.system.closures.place(self.vectors, q)
        self._platform: PlacedRows | None = None  # closures alone are what most calls need

    def _update_frames(self) -> None:
        pin.updateFramePlacements(self.model, self.data)
        for target, source in self._copied:
            target[:] = source

    def residual(self) -> Array:
        """Return (r,) the closure residuals Φ, m; for rotation rows the sine of the angle that is off."""
        return self.closures.residual()

    def jacobian(self) -> Array:
        """Return J_c (r, nv)."""
        return self.closures.jacobian(self.J)

    def bias(self) -> Array:
        """Return J̇_c v (r,)."""
        return self.system.closures.bias_at(self.closures, self.J, self.dJ, self.v)

    def jacobian_rate(self) -> Array:
        """Return J̇_c (r, nv)."""
        return self.closures.jacobian_rate(self.J, self.dJ, self.v)

    def platform_position(self) -> Array:
        """Return the independent coordinates: (n,), or a pose (4, 4); see ``Platform``."""
        return self.coordinates(self.q)

    def coordinates(self, q: Array) -> Array:
        """Return the independent coordinates at the configuration (nq,) that was placed last."""
        if self._platform_pose is None:
            return np.array([math.atan2(q[i + 1], q[i]) if circle else q[i] for i, circle in self._joints])
        rotation, origin = self._platform_pose
        if self._is_pose:
            pose = np.eye(4)
            pose[:3, :3], pose[:3, 3] = rotation, origin
            return pose
        values = []
        for sine, cosine in self._readings:
            if cosine is None:
                values.append(origin[sine[0]])
            elif cosine == sine:
                values.append(math.atan2(-rotation[sine], math.hypot(rotation[0, 0], rotation[1, 0])))
            else:
                values.append(math.atan2(rotation[sine], rotation[cosine]))
        return np.array(values)

    def platform_rows(self) -> PlacedRows:
        """Return the rows of the platform's twist, at the state."""
        if self._platform is None:
            self._platform = self.system.platform.place(self.vectors, self.q)
        return self._platform

    def platform_jacobian(self) -> Array:
        """Return J_x (n, nv): rows of the platform twist, world-aligned at its origin, or unit rows of joints."""
        if self._platform_pose is None:
            return self.system.independent
        return self.platform_rows().jacobian(self.J)

    def platform_jacobian_rate(self) -> Array:
        """Return J̇_x (n, nv)."""
        if self._platform_pose is None:
            return np.zeros_like(self.system.independent)
        return self.platform_rows().jacobian_rate(self.J, self.dJ, self.v)


def _frame_memory(model: pin.Model, data: pin.Data) -> tuple[Array, list[tuple[Array, Array]]]:
    """Return (12 F,) axes and origin of each frame, and what is to be copied into them after each update.

    Pinocchio keeps a placement as three axes and an origin, and one placement behind the other: its memory is the array
    itself. To copy it out frame by frame takes longer than all the arithmetic with it. Where the layout is another one
    (that of an alignment beyond eight bytes), it is copied all the same.
    """
    parts = [(data.oMf[i].rotation, data.oMf[i].translation) for i in range(model.nframes)]
    first = parts[0][0]
    start = _address(first)
    for i, (rotation, translation) in enumerate(parts):
        places = _address(rotation) - start, _address(translation) - start
        if places != (96 * i, 96 * i + 72) or rotation.strides != (8, 24) or translation.strides != (8,):
            break
    else:
        return np.lib.stride_tricks.as_strided(first, (12 * len(parts),), (8,), writeable=False), []
    vectors = np.zeros((len(parts), 4, 3))
    copied = [pair for v, (R, p) in zip(vectors, parts, strict=True) for pair in ((v[:3].T, R), (v[3], p))]
    return vectors.reshape(-1), copied


def _address(array: Array) -> int:
    address: int = array.__array_interface__["data"][0]  # ``array.ctypes.data`` takes ten times as long
    return address
