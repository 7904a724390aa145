"""Reaction forces in the joints and the closures, from the RNEA backend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, read_only
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.tree import cross
from redundancy_pin.motion import CarrierMotion


@dataclass(frozen=True, eq=False)
class JointReactions:
    """What the joints transmit along a motion.

    Attributes:
        joints: names of the tree's joints, J of them.
        joint_wrench: (N, J, 6) force and moment that the parent body exerts on the child through each joint, world
            axes, at the joint's origin, N and N·m; actuator efforts included.
        closures: name of each closure row, ``"x of tip_2 = corner_2"``, r of them.
        closure_force: (N, r) force (or moment) along each closure row: what frame a exerts on frame b, in the axes of
            frame a, N or N·m.
        residual: (N,) largest generalised force left unbalanced by the given efforts, N or N·m. Rounding when the
            efforts produce the motion; large when they do not, and then the reactions mean nothing.
    """

    joints: tuple[str, ...]
    joint_wrench: Array
    closures: tuple[str, ...]
    closure_force: Array
    residual: Array


def joint_reactions(along: RneaAlongMotion, tau: ArrayLike, carriers: CarrierMotion | None = None) -> JointReactions:
    """Compute the reactions in every joint and closure.

    The closure forces λ follow from the equations of motion of the tree, J_cᵀ λ = rnea(q, v, a) − Sᵀ τ − C F, which
    have full column rank away from type I singularities; a second pass of RNEA with λ as external forces gives the
    joint wrenches.

    Args:
        along: RNEA dynamics along a platform motion.
        tau: (N, m) main efforts, N or N·m; rows of NaN (no finite effort exists) give rows of NaN.
        carriers: carrier motion, parked when left out.

    Raises:
        InputError: ``tau`` has the wrong shape.
    """
    robot, tree = along.robot, along.tree
    effort = np.asarray(tau, dtype=float)
    holes = np.isnan(effort).any(axis=-1, keepdims=True) if effort.ndim == 2 else np.zeros(1, dtype=bool)
    checked(np.where(holes, 0.0, effort), "tau", (len(along.motion), robot.m))
    usable = ~holes[:, 0] & tree.reachable
    system = ConstraintSystem(robot)
    state = system.evaluate(tree.q)
    rest = along.tree_effort(carriers).T.copy()
    rest[:, robot.actuated_velocity] -= effort
    rest[~usable] = 0.0
    columns = system.pose_columns
    transposed = np.where(usable[:, None, None], state.Jc[:, :, columns], 0.0).transpose(0, 2, 1)
    multipliers = (np.linalg.pinv(transposed) @ rest[:, columns, None])[:, :, 0]
    left = rest[:, columns] - (transposed @ multipliers[:, :, None])[:, :, 0]
    forces = _closure_wrenches(system, state, multipliers)
    wrench = _second_pass(along, carriers, forces)
    for array in (multipliers, left, wrench):
        array[~usable] = np.nan
    return JointReactions(
        joints=tuple(str(name) for name in robot.model.names)[1:],
        joint_wrench=read_only(wrench),
        closures=tuple(f"{axis} of {closure.name}" for closure in robot.closures for axis in closure.axes),
        closure_force=read_only(multipliers),
        residual=read_only(np.abs(left).max(axis=1, initial=0.0)),
    )


def _closure_wrenches(system: ConstraintSystem, state: ConstraintState, multipliers: Array) -> dict[int, Array]:
    """Return by joint index the closure forces on its body: (6, N) about the world origin, world axes."""
    model = system.robot.model
    total: dict[int, Array] = {}
    for index, (closure, row) in enumerate(system.rows):
        a = state.pose.frame_rotation[closure.frame_a][:, row.axis_a]
        wrench = np.zeros((6, state.pose.samples))
        if row.rotation:
            b = state.pose.frame_rotation[closure.frame_b][:, row.axis_b] * row.sign
            wrench[3:] = cross(b, a) * multipliers[:, index]
        else:
            # at an open frame pair the force acts where frame b is, on both bodies
            wrench[:3] = a * multipliers[:, index]
            wrench[3:] = cross(state.pose.frame_origin[closure.frame_b], wrench[:3])
        for frame, sign in ((closure.frame_b, 1.0), (closure.frame_a, -1.0)):
            joint = int(model.frames[model.getFrameId(frame, pin.FrameType.BODY)].parentJoint)
            total[joint] = total.get(joint, 0.0) + sign * wrench
    return total


def _second_pass(along: RneaAlongMotion, carriers: CarrierMotion | None, forces: dict[int, Array]) -> Array:
    model = along.robot.model
    data = model.createData()
    q, v, a = along.tree_motion(carriers)
    external = pin.StdVec_Force()
    for _ in range(model.njoints):
        external.append(pin.Force.Zero())
    result = np.empty((q.shape[1], model.njoints - 1, 6))
    for i in range(q.shape[1]):
        # places first: RNEA takes external forces in the frames of the joints, and these are in world axes
        pin.forwardKinematics(model, data, q[:, i])
        for joint, wrench in forces.items():
            if joint > 0:
                external[joint] = data.oMi[joint].actInv(pin.Force(wrench[:, i]))
        pin.rnea(model, data, q[:, i], v[:, i], a[:, i], external)
        for joint in range(1, model.njoints):
            rotation = data.oMi[joint].rotation
            result[i, joint - 1, :3] = rotation @ data.f[joint].linear
            result[i, joint - 1, 3:] = rotation @ data.f[joint].angular
    return result
