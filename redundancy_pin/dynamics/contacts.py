"""Forces in closures as rows of efforts: contacts in friction cones, a squeeze, feet of a floating base.

With more motors than freedoms the efforts decide how hard closures are loaded. Where W τ = f the closure forces are

    λ = λ₀ + Λ τ,      Λ = −(J_cᵀ)⁺ Sᵀ,      λ₀ = (J_cᵀ)⁺ rnea(q, v, a),

affine in τ, so that Coulomb's cone of a contact, linearised from the inside, and a wanted contact force are linear
conditions on τ: ``EffortRows`` for ``distribute``. A foot on the ground is a closure between a frame of
the ground and the foot, the ground's frame first: then λ is the force of the ground on the foot, in the
ground's axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, checked, each, positive, read_only, require_type, rows_of
from redundancy_pin.dynamics.distribution import EffortRows
from redundancy_pin.dynamics.reactions import ClosureEquations
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.motion import CarrierMotion


@dataclass(frozen=True, eq=False)
class ClosureForces(Frozen):
    """Closure forces as functions of the efforts along a motion; made by ``closure_forces``.

    Attributes:
        names: of the r closure rows, such as ``"z of foot_left"``.
        constant: (N, r) λ₀, N or N·m; NaN where the closures do not determine it.
        matrix: (N, r, m) Λ.
    """

    names: tuple[str, ...]
    constant: Array
    matrix: Array

    def at(self, tau: Array) -> Array:
        """Return (N, r) λ for efforts (N, m) that solve W τ = f."""
        return read_only(self.constant + np.einsum("Nrm,Nm->Nr", self.matrix, tau))

    def rows(self, direction: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> EffortRows:
        """Return lower ≤ direction · λ ≤ upper: a preload, or with equal bounds a squeeze of so much.

        Args:
            direction: (c, r) or (r,) in the closure rows, see ``component``; differences squeeze between two contacts.
            lower: scalar or (c,) N; −inf if unbounded.
            upper: scalar or (c,) N; inf if unbounded.

        Raises:
            InputError: wrong shapes, or lower above upper.
        """
        wanted = rows_of(direction, "direction", ("c", len(self.names)))
        low, high = (each(side, name, (len(wanted),)) for side, name in ((lower, "lower"), (upper, "upper")))
        if (low > high).any():
            raise InputError(f"lower is {low.tolist()} and upper is {high.tolist()}.", remedy="Swap or widen them.")
        moved = np.einsum("cr,Nr->Nc", wanted, self.constant)
        matrix = np.einsum("cr,Nrm->Ncm", wanted, self.matrix)
        return EffortRows(*(read_only(part) for part in (matrix, low - moved, high - moved)))

    def component(self, closure: str, axis: str) -> Array:
        """Return (r,) the unit vector of one closure row.

        Raises:
            InputError: an unknown row.
        """
        name = f"{axis} of {closure}"
        if name not in self.names:
            raise InputError(
                f"There is no closure row {name!r}.",
                remedy=f"{did_you_mean(name, self.names)}Choose from {', '.join(self.names)}."
                if self.names
                else "The robot has no closures.",
            )
        unit: Array = np.eye(len(self.names))[self.names.index(name)]
        return unit

    def friction_cone(
        self, closure: str, friction: float, *, normal: str = "z", sides: int = 8, least: float = 0.0
    ) -> EffortRows:
        """Return the limits of a contact: a least normal force, and a tangential force within a pyramid.

        The pyramid lies inside Coulomb's cone |λ_t| ≤ μ λ_n and touches it along its edges.

        Args:
            closure: its name; its rows are the normal and the tangents.
            friction: μ, positive.
            normal: axis of the closure that pushes the second frame away from the first, "x", "y" or "z" of the first
                frame: of a foot let the ground be that, for it does not turn.
            sides: of the pyramid, at least 3; 8 leave at most 8 % of the cone's radius out.
            least: smallest normal force, N.

        Raises:
            InputError: no such closure, μ that is not positive, fewer than 3 sides, no number as least force.
        """
        mu, smallest = positive(friction, "friction", ""), float(checked(least, "least", ()))
        if not isinstance(sides, int | np.integer) or sides < 3:
            raise InputError(f"sides are {shown(sides)}.", remedy="Pass a whole number, at least 3.")
        push = self.component(closure, normal)
        others = [axis for axis in "xyz" if axis != normal and f"{axis} of {closure}" in self.names]
        tangents = [self.component(closure, axis) for axis in others]
        if len(tangents) < 2:  # the cone of a plane has two sides, or one that gives no condition
            sides, within, around = 2, mu, np.array([[1.0, -1.0]])[: len(tangents)]
        else:
            angle = 2.0 * np.pi * np.arange(sides) / sides
            within, around = mu * np.cos(np.pi / sides), np.stack([np.cos(angle), np.sin(angle)])
        faces = within * push - np.einsum("ts,tr->sr", around, np.reshape(tangents, (len(tangents), len(push))))
        directions = np.concatenate([push[None], faces])
        return self.rows(directions, np.array([smallest, *np.zeros(int(sides))]), np.inf)


def closure_forces(along: RneaAlongMotion, carriers: CarrierMotion | None = None) -> ClosureForces:
    """Return the closure forces as functions of the efforts, along a motion.

    Args:
        along: ``RneaDynamics(robot).along(motion)``.
        carriers: carrier motion, parked when left out.

    Raises:
        InputError: ``along`` or ``carriers`` are something else.
    """
    require_type(along, RneaAlongMotion, "RNEA dynamics along a motion", "Pass RneaDynamics(robot).along(motion).")
    robot, model = along.robot, along.robot.model
    equations = ClosureEquations(robot)
    efforts = np.zeros((model.nv, 1 + robot.m))
    efforts[robot.actuated_velocity, 1 + np.arange(robot.m)] = -1.0
    forces = np.full((len(along.motion), len(equations.names), 1 + robot.m), np.nan)
    tree_effort = along.tree_effort(carriers)
    for i, state in enumerate(along.states(carriers)):
        if along.tree.reachable[i]:
            efforts[:, 0] = tree_effort[i]
            solution = equations.solve(state.q, state.v, efforts)
            if solution.determined:
                forces[i] = solution.forces
    return ClosureForces(equations.names, read_only(forces[:, :, 0]), read_only(forces[:, :, 1:]))
