"""Forward dynamics of a closed tree by definition: M a + h = τ + Jᵀ λ, J a + J̇ v = 0, from Pinocchio's frames.

For what ``simulation.system.ConstraintDynamics`` does not take: closures that hold directions, couplings, points held
in a plane that is one but for rounding. With r from the origin of frame a to that of b, and ω, α of frame a, a row
along its axis e holds e·r = 0, so that with ė = ω × e

    e·r̈ + 2 ė·ṙ + (α × e + ω × ė)·r = 0,

and one about it e·(ω_b − ω) = 0, so that e·(α_b − α) + ė·(ω_b − ω) = 0, which is what two or three such rows say (what
is left free is a turn about one fixed axis, or none). A single one, of axes e, f, g in cyclic order, is a universal
joint, whose axes stay normal to one another: g of frame a and f of frame b, and f × g takes the place of e. Nothing of
``kinematics`` is used.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import AXES, Closure, Robot

_IDLE = 1e-12
"""Rounding of a row of a one-metre machine."""


def confined_to_planes(robot: Robot, q: Array, v: Array) -> bool:
    """Return whether points that are held along x and y cannot leave that plane at all, as in a plane machine.

    A third row that only rounding makes independent would be a constraint of its own for Pinocchio's solver.
    """
    third = [replace(each, axes=("z",)) for each in robot.closures if "z" not in each.axes]
    rows, _ = ClosedForward(replace(robot, closures=tuple(third), couplings=())).rows(q, v)
    return not np.abs(rows).max(initial=0.0) > _IDLE


class ClosedForward:
    """Accelerations of one robot under generalised forces, one state at a time.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._model, self._data = robot, robot.model, robot.model.createData()

    def __call__(self, q: Array, v: Array, force: Array) -> Array:
        """Return the accelerations (nv,) at q (nq,), v (nv,) under generalised forces (nv,)."""
        model, data = self._model, self._data
        upper = pin.crba(model, data, q)
        mass = np.triu(upper) + np.triu(upper, 1).T
        J, bias = self.rows(q, v)
        # unit rows, so that neither short levers nor gears look like a loss of rank
        size = np.linalg.norm(J, axis=1)
        J, bias = J / size[:, None], bias / size
        heavy = np.abs(mass).max()
        matrix = np.block([[mass / heavy, -J.T], [J, np.zeros((len(J), len(J)))]])
        rest = np.concatenate([(force - pin.nonLinearEffects(model, data, q, v)) / heavy, -bias])
        solution: Array = np.linalg.solve(matrix, rest)
        solution += np.linalg.solve(matrix, rest - matrix @ solution)
        return solution[: model.nv]

    def rows(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return J (r, nv) and J̇ v (r,) of closures and couplings."""
        model, data, rows = self._model, self._data, []
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, data)
        for closure in self._robot.closures:
            rows += self._closure(closure)
        for each in self._robot.couplings:
            powers = np.polynomial.Polynomial(each.polynomial)
            row, own = np.zeros(model.nv), model.joints[model.getJointId(each.joint)]
            row[own.idx_v], bend = 1.0, 0.0
            if each.of:
                other = model.joints[model.getJointId(each.of)]
                row[other.idx_v] -= powers.deriv()(q[other.idx_q])
                bend = -float(powers.deriv(2)(q[other.idx_q])) * v[other.idx_v] ** 2
            rows.append((row, bend))
        return np.array([row for row, _ in rows]), np.array([bias for _, bias in rows])

    def _closure(self, closure: Closure) -> list[tuple[Array, float]]:
        model, data, world = self._model, self._data, pin.LOCAL_WORLD_ALIGNED
        ids = [model.getFrameId(name, pin.FrameType.BODY) for name in (closure.frame_a, closure.frame_b)]
        places = [pin.updateFramePlacement(model, data, each) for each in ids]
        jacobians = [pin.getFrameJacobian(model, data, each, world) for each in ids]
        speeds = [pin.getFrameVelocity(model, data, each, world) for each in ids]
        seconds = [pin.getFrameClassicalAcceleration(model, data, each, world) for each in ids]
        (first, second), (Ja, Jb) = places, jacobians
        r = second.translation - first.translation
        omega, alpha = speeds[0].angular, seconds[0].angular
        rows = []
        for axis in closure.axes:
            place = AXES.index(axis)
            e = first.rotation[:, place % 3]
            turned = np.cross(omega, e)
            if place < 3:
                row = e @ (Jb - Ja)[:3] + np.cross(e, r) @ Ja[3:]
                bias = e @ (seconds[1].linear - seconds[0].linear) + 2.0 * turned @ (
                    speeds[1].linear - speeds[0].linear
                )
                bias += (np.cross(alpha, e) + np.cross(omega, turned)) @ r
            else:
                if sum(each in AXES[3:] for each in closure.axes) == 1:
                    f, g = second.rotation[:, (place + 1) % 3], first.rotation[:, (place + 2) % 3]
                    e, turned = (
                        np.cross(f, g),
                        np.cross(np.cross(speeds[1].angular, f), g) + np.cross(f, np.cross(omega, g)),
                    )
                row = e @ (Jb - Ja)[3:]
                bias = e @ (seconds[1].angular - alpha) + turned @ (speeds[1].angular - omega)
            rows.append((row, float(bias)))
        return rows
