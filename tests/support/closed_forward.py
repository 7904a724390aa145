"""Forward dynamics of a closed tree by definition, an oracle: M a + h = τ + Jᵀ λ, J a + J̇ v = 0, by Pinocchio's frames.

With r from the origin of frame a to that of b, and ω, α of frame a, a row
along its axis e holds e·r = 0, so that with ė = ω × e

    e·r̈ + 2 ė·ṙ + (α × e + ω × ė)·r = 0,

and one about it e·(ω_b − ω) = 0, so that e·(α_b − α) + ė·(ω_b − ω) = 0, which is what two or three such rows say (what
is left free is a turn about one fixed axis, or none). A single one, of axes e, f, g in cyclic order, is a universal
joint, whose axes stay normal to one another: g of frame a and f of frame b, and f × g takes the place of e. A rod
holds r·r = L², so that (r·r̈ + ṙ·ṙ)/L = 0. Nothing of ``kinematics`` is used.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_joint, find_link_index


class ClosedForward:
    """Accelerations of one robot under generalised forces, one state at a time.

    Args:
        robot: the robot.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot, self._model, self._data = robot, robot.model, robot.model.createData()
        self._depth = max(len(support) - 1 for support in robot.model.supports)

    def __call__(self, q: Array, v: Array, force: Array) -> tuple[Array, float]:
        """Return the accelerations (nv,) at q (nq,), v (nv,) under generalised forces (nv,), and their rounding.

        The latter is |A⁻¹| (|δA| |x| + |δb|), the largest of the accelerations, for one unit in the last place of each
        term and each joint on the longest way from the root: so many placements are multiplied for it. Entries of J are
        differences of lever arms, of the size of the largest one: a row of nothing but short ones has a λ so large
        that λ times this, and no solver, decides what the accelerations are.
        """
        model, data = self._model, self._data
        upper = pin.crba(model, data, q)
        mass = np.triu(upper) + np.triu(upper, 1).T
        J, bias = self.rows(q, v)
        bent = pin.nonLinearEffects(model, data, q, v)
        # unit rows, so that neither short levers nor gears look like a loss of rank
        heavy, size = np.abs(mass).max(), np.linalg.norm(J, axis=1)
        J, bias, levers = J / size[:, None], bias / size, np.abs(J).max(initial=0.0) * (J != 0.0) / size[:, None]
        none = np.zeros((len(J), len(J)))
        matrix, rest = np.block([[mass / heavy, -J.T], [J, none]]), np.concatenate([(force - bent) / heavy, -bias])
        inverse = np.linalg.inv(matrix)
        solution: Array = inverse @ rest
        solution += inverse @ (rest - matrix @ solution)
        terms = np.block([[np.abs(mass) / heavy, levers.T], [levers, none]]) @ np.abs(solution)
        terms += np.concatenate([(np.abs(force) + np.abs(bent)) / heavy, np.abs(bias)])
        rounding = self._depth * np.finfo(float).eps * (np.abs(inverse) @ terms)[: model.nv]
        return solution[: model.nv], float(rounding.max())

    def rows(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Return J (r, nv) and J̇ v (r,) of closures and couplings."""
        model, data, rows = self._model, self._data, []
        pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
        pin.computeJointJacobians(model, data)
        for closure in self._robot.closures:
            rows += self._closure(closure)
        for each in self._robot.couplings:
            powers = np.polynomial.Polynomial(each.polynomial)
            row, own = np.zeros(model.nv), find_joint(model, each.joint)
            row[own.idx_v], bend = 1.0, 0.0
            if each.of:
                other = find_joint(model, each.of)
                row[other.idx_v] -= powers.deriv()(q[other.idx_q])
                bend = -float(powers.deriv(2)(q[other.idx_q])) * v[other.idx_v] ** 2
            for name, factor in each.also:
                row[find_joint(model, name).idx_v] -= factor
            rows.append((row, bend))
        J = np.array([row for row, _ in rows]).reshape(-1, model.nv)  # an open chain has no row
        return J, np.array([bias for _, bias in rows])

    def _closure(self, closure: Closure) -> list[tuple[Array, float]]:
        model, data, world = self._model, self._data, pin.LOCAL_WORLD_ALIGNED
        ids = [find_link_index(model, name) for name in (closure.frame_a, closure.frame_b)]
        places = [pin.updateFramePlacement(model, data, each) for each in ids]
        jacobians = [pin.getFrameJacobian(model, data, each, world) for each in ids]
        speeds = [pin.getFrameVelocity(model, data, each, world) for each in ids]
        seconds = [pin.getFrameClassicalAcceleration(model, data, each, world) for each in ids]
        (first, second), (Ja, Jb) = places, jacobians
        r = second.translation - first.translation
        if closure.is_rod:
            rate = speeds[1].linear - speeds[0].linear
            bias = r @ (seconds[1].linear - seconds[0].linear) + rate @ rate
            return [(r @ (Jb - Ja)[:3] / closure.length, float(bias) / closure.length)]
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
