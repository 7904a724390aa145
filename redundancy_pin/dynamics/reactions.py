"""Forces in closures and joints, from the equations of motion of the tree.

With the closures opened the tree needs more than the efforts of its actuators: closure forces λ supply the rest,

    J_cᵀ λ = rnea(q, v, a) − Sᵀ τ − C F.

J_cᵀ has full column rank away from constraint singularities. Redundant rows are kept: motion does not determine how
they share a load, and the solution of least norm is taken, with moments divided by the characteristic length.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import SINGULAR_MARGIN, Array, Frozen, checked, read_only, require_type
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.dynamics.tree_loads import TreeLoads
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_link, joint_names


@dataclass(frozen=True, eq=False)
class JointReactions(Frozen):
    """Forces transmitted by joints and closures along a motion; made by ``joint_reactions``.

    Attributes:
        joints: names of the tree's joints, J of them.
        joint_wrench: (N, J, 6) force and moment that the parent body exerts on the child through each joint, world
            axes, at the joint's origin, N and N·m; actuator efforts included.
        closures: name of each closure row, ``"x of tip_2 = corner_2"``, then of each coupling, r of them.
        closure_force: (N, r) force (or moment) along each closure row: what frame a exerts on frame b, in the axes of
            frame a, N or N·m; of a coupling q = p(q_of) the effort that it exerts in its joint, −p' times that in the
            other. Redundant rows, which the loader leaves out, are among them: these are the forces of least norm.
        residual: (N,) largest generalised force left unbalanced by the given efforts, N or N·m: rounding when the
            efforts produce the motion. Where it is large the reactions mean nothing.
    """

    joints: tuple[str, ...]
    joint_wrench: Array
    closures: tuple[str, ...]
    closure_force: Array
    residual: Array


class ClosureSolution(NamedTuple):
    """Closure forces (r, c) for c columns of efforts, the unbalanced rest (p, c), and whether the forces are unique.

    ``wrench`` (6, r) is the wrench of a unit of each row on frame b, about the world origin, world axes.
    """

    forces: Array
    residual: Array
    determined: bool
    wrench: Array


class ClosureEquations:
    """J_cᵀ λ = effort at one state, all closure rows, redundant ones too.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        independent = constraint_system(robot)
        self.robot, self._rank = independent.every.robot, len(independent.rows)
        self.names = self.robot.constraint_names
        self._chain = ClosedChain(self.robot)
        self._columns = self._chain.pose_columns

    def solve(self, q: Array, v: Array, efforts: Array) -> ClosureSolution:
        """Return λ of least scaled norm for efforts (nv, c) at a state q (nq,), v (nv,) of the closed tree."""
        chain, columns = self._chain, self._columns
        chain.update(q, v)
        transposed, wanted = chain.jacobian()[:, columns].T, efforts[columns]
        unit, scale = 1.0 / chain.system.closure_unit, chain.system.step_unit[:, None]
        left, values, right = np.linalg.svd(chain.closure_rows().T, full_matrices=False)
        left, values, right = left[:, : self._rank], values[: self._rank], right[: self._rank]
        # an open chain has no rows, and nothing that could be undetermined
        determined = bool(values.min(initial=np.inf) > SINGULAR_MARGIN)
        inverse = np.divide(1.0, values, out=np.zeros_like(values), where=values > 0.0)
        forces = unit[:, None] * (right.T @ (inverse[:, None] * (left.T @ (scale * wanted))))
        return ClosureSolution(forces, wanted - transposed @ forces, determined, chain.placed.wrench[:, : chain.rows])


def joint_reactions(along: RneaAlongMotion, tau: ArrayLike, carriers: CarrierMotion | None = None) -> JointReactions:
    """Return the reactions in every joint and closure.

    A second pass of RNEA, with the closure forces among the external ones, gives the joint wrenches. Where the
    closures lose rank (a flat four-bar) the linkage can be prestressed: the reactions are not determined, and NaN.

    Args:
        along: RNEA dynamics along a platform motion.
        tau: (N, m) main efforts, N or N·m; rows of NaN (no finite effort exists) give rows of NaN.
        carriers: carrier motion, parked when left out.

    Raises:
        InputError: ``tau`` has the wrong shape.

    Example:
        >>> along = rp.RneaDynamics("3rrr").along(rp.trajectory.reference.corner().sample(0.1))
        >>> reactions = rp.joint_reactions(along, rp.distribute(along.reduce()).tau)
    """
    require_type(along, RneaAlongMotion, "RNEA dynamics along a motion", "Pass RneaDynamics(robot).along(motion).")
    robot, tree = along.robot, along.tree
    samples, model = len(along.motion), robot.model
    effort = _efforts(tau, samples, robot.m)
    equations, loads, data = ClosureEquations(robot), TreeLoads(robot), model.createData()
    joints = _joints_of_rows(equations.robot)
    forces = np.full((samples, len(equations.names)), np.nan)
    wrench = np.full((samples, model.njoints - 1, 6), np.nan)
    residual = np.full(samples, np.nan)
    tree_effort = along.tree_effort(carriers)
    for i, state in enumerate(along.states(carriers)):
        if np.isnan(effort[i]).any() or not tree.reachable[i]:
            continue
        missing = tree_effort[i].copy()
        missing[robot.actuated_velocity] -= effort[i]
        solution = equations.solve(state.q, state.v, missing[:, None])
        residual[i] = np.abs(solution.residual).max(initial=0.0)
        if not solution.determined:
            continue
        forces[i] = solution.forces[:, 0]
        external = loads.body_forces(data, state)
        pin.forwardKinematics(model, data, state.q)
        for row, (joint_a, joint_b) in enumerate(joints):
            # at an open frame pair the force acts where frame b is, on both bodies
            force = pin.Force(solution.wrench[:, row] * forces[i, row])
            external[joint_b] += data.oMi[joint_b].actInv(force)
            external[joint_a] -= data.oMi[joint_a].actInv(force)
        pin.rnea(model, data, state.q, state.v, state.a, external)
        for joint in range(1, model.njoints):
            rotation, transmitted = data.oMi[joint].rotation, data.f[joint]
            wrench[i, joint - 1] = np.concatenate([rotation @ transmitted.linear, rotation @ transmitted.angular])
    return JointReactions(
        joints=joint_names(model),
        joint_wrench=read_only(wrench),
        closures=equations.names,
        closure_force=read_only(forces),
        residual=read_only(residual),
    )


def _efforts(tau: ArrayLike, samples: int, m: int) -> Array:
    """Return (N, m) efforts whose rows may be NaN."""
    try:
        effort = np.asarray(tau, dtype=float)
    except (TypeError, ValueError):  # such as a Distribution: ``checked`` reports the type
        effort = checked(tau, "tau", (samples, m))
    holes = np.isnan(effort).any(axis=-1, keepdims=True) if effort.ndim == 2 else np.zeros(1, dtype=bool)
    checked(np.where(holes, 0.0, effort), "tau", (samples, m))
    return effort


def _joints_of_rows(robot: Robot) -> list[tuple[int, int]]:
    """Return for each closure row the joints that move frame a and frame b; couplings have none."""
    return [
        (
            int(find_link(robot.model, closure.frame_a).parentJoint),
            int(find_link(robot.model, closure.frame_b).parentJoint),
        )
        for closure in robot.closures
        for _ in closure.axes
    ]
