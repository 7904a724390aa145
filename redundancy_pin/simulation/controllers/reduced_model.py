"""Equations of motion in platform and carrier coordinates at one state: what model-based control evaluates."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack

from redundancy_pin.arrays import RANK_TOLERANCE, Array
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.chain import ClosedChain


@dataclass(frozen=True, eq=False)
class ReducedEquations:
    """M (ẍ, s̈) + h = (W τ, F) at one state; d = n + k.

    Attributes:
        mass: (d, d) M, kg, kg·m, kg·m².
        bias: (d,) h: velocity terms and gravity, N or N·m.
        W: (n, m) generalised force on the platform per unit of main effort.
    """

    mass: Array
    bias: Array
    W: Array


class ReducedModel:
    """Evaluator of ``ReducedEquations`` for one robot. It holds a workspace: one for each thread or process.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.chain = ClosedChain(robot)
        nv = robot.model.nv
        self._columns = np.array(self.chain.pose_columns)
        self._identity = np.eye(len(self._columns))
        self._basis = np.zeros((nv, robot.n + robot.k))
        self._basis[robot.carrier_velocity, robot.n + np.arange(robot.k)] = 1.0
        self._particular = np.zeros(nv)

    def at(self, q: Array, v: Array) -> ReducedEquations:
        """Return the equations at a closed state.

        Args:
            q: (nq,) configuration.
            v: (nv,) velocity that the closures allow.

        Raises:
            SingularPoseError: a type I pose, where platform and carriers are no coordinates.
        """
        robot, chain = self.robot, self.chain
        model, data, n, rows = robot.model, chain.data, robot.n, chain.rows
        chain.update(q, v)
        stacked = np.concatenate([chain.jacobian(), chain.platform_jacobian()])
        system = stacked[:, self._columns]
        _, _, inverse, singular = lapack.dgesv(system, self._identity)
        if singular or np.abs(system).max() * np.abs(inverse).max() * RANK_TOLERANCE > 1.0:
            raise SingularPoseError(
                f"{robot.name} is at a type I pose: platform and carriers do not describe its motion there.",
                remedy="Control it along a motion that keeps away from this pose.",
            )
        rates = np.concatenate([chain.jacobian_rate().dot(v), chain.platform_jacobian_rate().dot(v)])
        self._basis[self._columns, :n] = inverse[:, rows:]
        self._particular[self._columns] = -inverse.dot(rates)
        effort = pin.rnea(model, data, q, v, self._particular)
        mass = pin.crba(model, data, q)
        mass = np.triu(mass) + np.triu(mass, 1).T
        basis = self._basis
        return ReducedEquations(
            basis.T.dot(mass.dot(basis)), basis.T.dot(effort), basis[robot.actuated_velocity, :n].T.copy()
        )
