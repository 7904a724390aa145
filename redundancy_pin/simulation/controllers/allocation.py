"""Who brings up a generalised force: main actuators, carriers that depart from their plan, or nobody.

Platform accelerations ẍ are wanted. With M (ẍ, s̈) + h = (W τ, F) and s̈ = s̈_c + δ they take

    W τ − M_xs δ = M_xx ẍ + M_xs s̈_c + h_x,

n equations in m + k unknowns. Near a type II pose W loses rank and the main actuators alone would take efforts without
bound; the carriers are actuators too. Of all exact solutions the one with the least

    Σ (τ_i − τ_i,plan)² / τ̂_i² + Σ δ_j² / â_j²

is taken: where W is regular and τ̂ is generous against |M_xs| â, δ is small and τ does the work; towards the singularity
the carriers take over, continuously, and δ stays finite as long as [W, −M_xs] has full row rank. Where it has not,
nothing can be done in some direction, and the answer says so.

Limits are part of the problem: |τ| ≤ τ_max, and |F| ≤ F_max for the carrier forces F = F_0 + M_ss δ, F_0 that of δ = 0.
What one kind of actuator cannot give is left to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np
from scipy.optimize import lsq_linear, nnls

from redundancy_pin.arrays import RANK_TOLERANCE, Array

_WEIGHT = 1e-6
"""Weight of the length, relative to the largest singular value, where the equations cannot be met: directions in which
they hardly change are left alone."""

_ROUNDING = 1e-14
"""Relative change of the squares at which they count as least."""

_MOST = 20
"""Changes of the active set, for each unknown."""

_NOTHING_LEFT = 1e-9
"""Residual of the non-negative least squares below which bounds contradict one another; it is 1 / √(1 + ‖z‖²)."""


def shortest(matrix: Array, wanted: Array, bounded: Array, lower: Array, upper: Array) -> tuple[Array, bool]:
    """Return the shortest y with A y = w and l ≤ C y ≤ u.

    Along y = A⁺ w + N z this is a least-distance problem, which non-negative least squares solves (Lawson and Hanson
    1974, chapter 23). Where nothing within the bounds meets the equations, it is the y within them that makes
    ‖A y − w‖² + ε² ‖y‖² least, ε small: least squares over a box in C y. Both are continuous in w, so an integrator can
    follow them.

    Args:
        matrix: (n, p) A.
        wanted: (n,) w, in the range of A.
        bounded: (p, p) C.
        lower: (p,) l, −inf where there is none; below u.
        upper: (p,) u, inf where there is none.

    Returns:
        y (p,), and whether it is within the bounds; it is not where C is singular and they forbid what is asked.
    """
    limits = _rows(bounded, lower, upper)
    u, values, vt = np.linalg.svd(matrix)
    rank = int((values > RANK_TOLERANCE * values[0]).sum())
    particular = vt[:rank].T @ ((u[:, :rank].T @ wanted) / values[:rank])
    null = vt[rank:].T
    z = _least_distance(limits[0] @ null, limits[1] - limits[0] @ particular)
    if z is not None:
        return particular + null @ z, True
    size = matrix.shape[1]
    if np.linalg.cond(bounded) > 1.0 / RANK_TOLERANCE:
        return particular, False
    system = np.concatenate([matrix, _WEIGHT * values[0] * np.eye(size)])
    goal = np.concatenate([wanted, np.zeros(size)])
    unit = np.linalg.norm(bounded, axis=1)
    inverse = np.linalg.inv(bounded / unit[:, None])
    found = lsq_linear(
        system @ inverse, goal, (lower / unit, upper / unit), method="bvls", tol=_ROUNDING, max_iter=_MOST * size
    )
    return inverse @ found.x, True


def _rows(bounded: Array, lower: Array, upper: Array) -> tuple[Array, Array]:
    """Return the finite bounds as G y ≥ h."""
    below, above = np.isfinite(lower), np.isfinite(upper)
    return np.concatenate([bounded[below], -bounded[above]]), np.concatenate([lower[below], -upper[above]])


def _least_distance(G: Array, h: Array) -> Array | None:
    """Return the shortest z with G z ≥ h, or None where there is none."""
    size = np.linalg.norm(G, axis=1)
    none = size <= RANK_TOLERANCE * size.max(initial=0.0)
    if (h[none] > RANK_TOLERANCE * (1.0 + np.abs(h[none]))).any():
        return None  # bounds that z does not move, and that are broken
    G, h = G[~none] / size[~none, None], h[~none] / size[~none]
    scale = float(h.max(initial=0.0))  # every z is at least that long: one of length 1 or more is sought
    if scale <= 0.0:
        return np.zeros(G.shape[1])
    system = np.concatenate([G.T, h[None] / scale])
    goal = np.zeros(len(system))
    goal[-1] = 1.0
    try:
        found, left = nnls(system, goal)
    except RuntimeError:  # it did not converge: the answer that misses least is the safe one
        return None
    if left < _NOTHING_LEFT:
        return None
    residual = system @ found - goal
    answer: Array = -scale * residual[:-1] / residual[-1]
    return answer


class AllocationStatus(Enum):
    """What became of the wanted acceleration."""

    EXACT = "exact"
    """Efforts and carriers bring it up."""
    SATURATED = "saturated"
    """Main efforts or carrier forces at their limits, the others bring up the rest exactly."""
    BEYOND_LIMITS = "beyond_limits"
    """Main efforts and carrier forces within their limits fall short together: ``residual`` is missing."""
    UNBALANCED = "unbalanced"
    """Main actuators and carriers have no effect in some direction (or there is no model: a type I pose); the residual
    is what would be missing there."""


RESIDUAL_TOLERANCE = 1e-9
"""Share of the wanted force that may be missing by rounding."""


@dataclass(frozen=True, eq=False)
class CarrierForces:
    """Forces of the carriers as δ changes them, F = F_0 + M_ss δ, and what they may be.

    Attributes:
        planned: (k,) F_0, force for the wanted accelerations of platform and carriers, N.
        mass: (k, k) M_ss, kg.
        limit: (k,) largest |F|, N; infinite where there is none.
    """

    planned: Array
    mass: Array
    limit: Array

    def of(self, deviation: Array) -> Array:
        """Return F (k,), cut off at the limits, for deviations δ (k,)."""
        force: Array = np.clip(self.planned + self.mass @ deviation, -self.limit, self.limit)
        return force

    def allow(self, deviation: Array) -> bool:
        """Return whether the forces for deviations δ (k,) are within the limits."""
        return bool((np.abs(self.planned + self.mass @ deviation) <= self.limit).all())


@dataclass(frozen=True, eq=False)
class Allocation:
    """A solution of W τ − M_xs δ = f.

    Attributes:
        tau: (m,) main efforts, N or N·m.
        deviation: (k,) δ, carrier accelerations beyond the wanted ones, m/s².
        residual: scaled norm of f − (W τ − M_xs δ), N.
        margin: smallest singular value of [W τ̂, −M_xs â], row-scaled, N: what can be brought up in the worst direction
            by deviations of the size of the scales.
        status: what became of it.
    """

    tau: Array
    deviation: Array
    residual: float
    margin: float
    status: AllocationStatus


def allocate(
    W: Array,
    coupling: Array,
    force: Array,
    planned: Array,
    *,
    effort_scale: Array,
    carrier_scale: Array,
    row_scale: Array,
    effort_limit: Array | None = None,
    carriers: CarrierForces | None = None,
) -> Allocation:
    """Return efforts and carrier deviations that bring up a generalised force with the least weighted deviation.

    Args:
        W: (n, m) generalised force per unit of effort.
        coupling: (n, k) M_xs, generalised force per unit of carrier acceleration.
        force: (n,) f, N or N·m.
        planned: (m,) efforts from which deviations count.
        effort_scale: (m,) τ̂, positive, N or N·m.
        carrier_scale: (k,) â, positive, m/s².
        row_scale: (n,) lengths that turn moments into forces.
        effort_limit: (m,) largest |τ|; what they cut off is left to the others.
        carriers: forces of the carriers and their limits; no limit when left out.
    """
    m, k = W.shape[1], coupling.shape[1]
    full = np.concatenate([W, -coupling], axis=1) / row_scale[:, None]
    scale = np.concatenate([effort_scale, carrier_scale])
    start = np.concatenate([planned, np.zeros(k)])
    wanted = force / row_scale
    weighted = full * scale
    u, values, vt = np.linalg.svd(weighted, full_matrices=False)
    margin = float(values[-1]) if len(values) == len(wanted) else 0.0
    size = RESIDUAL_TOLERANCE * (1.0 + float(np.linalg.norm(wanted)))
    rank = values > RANK_TOLERANCE * values[0]
    rest = wanted - full @ start
    answer = start + scale * (vt[rank].T @ ((u[:, rank].T @ rest) / values[rank]))
    residual = float(np.linalg.norm(wanted - full @ answer))
    if residual > size:
        return Allocation(answer[:m], answer[m:], residual, margin, AllocationStatus.UNBALANCED)
    most = np.full(m, np.inf) if effort_limit is None else effort_limit
    forces = CarrierForces(np.zeros(k), np.eye(k), np.full(k, np.inf)) if carriers is None else carriers
    if (np.abs(answer[:m]) <= most).all() and forces.allow(answer[m:]):
        return Allocation(answer[:m], answer[m:], residual, margin, AllocationStatus.EXACT)
    bounded = np.zeros((m + k, m + k))
    bounded[:m, :m], bounded[m:, m:] = np.diag(effort_scale), forces.mass * carrier_scale
    now, limits = np.concatenate([planned, forces.planned]), np.concatenate([most, forces.limit])
    deviation, within = shortest(weighted, rest, bounded, -limits - now, limits - now)
    answer = start + scale * deviation
    answer[:m] = np.clip(answer[:m], -most, most)
    residual = float(np.linalg.norm(wanted - full @ answer))
    status = AllocationStatus.SATURATED if within and residual <= size else AllocationStatus.BEYOND_LIMITS
    return Allocation(answer[:m], answer[m:], residual, margin, status)
