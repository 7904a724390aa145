"""Who brings up a generalised force: main actuators, carriers that depart from their plan, or nobody.

Platform accelerations ẍ are wanted. With M (ẍ, s̈) + h = (W τ, F) and s̈ = s̈_c + δ they take

    W τ − M_xs δ = M_xx ẍ + M_xs s̈_c + h_x,

n equations in m + k unknowns. Near a type II pose W loses rank and the main actuators alone would take efforts without
bound; the carriers are actuators too. Of all exact solutions the one with the least

    Σ (τ_i − τ_i,plan)² / τ̂_i² + Σ δ_j² / â_j²

is taken: where W is regular and τ̂ is generous against |M_xs| â, δ is small and τ does the work; towards the singularity
the carriers take over, continuously, and δ stays finite as long as [W, −M_xs] has full row rank. Where it has not,
nothing can be done in some direction, and the answer says so.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array


class AllocationStatus(Enum):
    """What became of the wanted acceleration."""

    EXACT = "exact"
    """Efforts and carriers bring it up."""
    SATURATED = "saturated"
    """Main efforts at their limits, carriers bring up the rest exactly."""
    BEYOND_LIMITS = "beyond_limits"
    """Main efforts at their limits and carriers together fall short: ``residual`` is missing."""
    UNBALANCED = "unbalanced"
    """Main actuators and carriers have no effect in some direction (or there is no model: a type I pose); the residual
    is what would be missing there."""


RESIDUAL_TOLERANCE = 1e-9
"""Share of the wanted force that may be missing by rounding."""


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
    """
    m = W.shape[1]
    full = np.concatenate([W, -coupling], axis=1) / row_scale[:, None]
    scale = np.concatenate([effort_scale, carrier_scale])
    start = np.concatenate([planned, np.zeros(coupling.shape[1])])
    wanted = force / row_scale
    weighted = full * scale
    u, values, vt = np.linalg.svd(weighted, full_matrices=False)
    margin = float(values[-1]) if len(values) == len(wanted) else 0.0
    size = RESIDUAL_TOLERANCE * (1.0 + float(np.linalg.norm(wanted)))
    rank = values > RANK_TOLERANCE * values[0]
    answer = start + scale * _solve(u, values, vt, rank, wanted - full @ start)
    residual = float(np.linalg.norm(wanted - full @ answer))
    if residual > size:
        return Allocation(answer[:m], answer[m:], residual, margin, AllocationStatus.UNBALANCED)
    status = AllocationStatus.EXACT
    free = np.ones(len(scale), dtype=bool)
    limit = np.full(m, np.inf) if effort_limit is None else effort_limit
    for _ in range(m):  # each round fixes at least one effort at its limit
        over = np.abs(answer[:m]) > limit
        if not over.any():
            break
        status = AllocationStatus.SATURATED
        free[:m] &= ~over
        answer[:m][over] = np.sign(answer[:m][over]) * limit[over]
        rest = wanted - full[:, ~free] @ answer[~free] - full[:, free] @ start[free]
        parts = np.linalg.svd(weighted[:, free], full_matrices=False)
        rank = parts[1] > RANK_TOLERANCE * values[0]
        answer[free] = start[free] + scale[free] * _solve(*parts, rank, rest)
        residual = float(np.linalg.norm(wanted - full @ answer))
        if residual > size:
            status = AllocationStatus.BEYOND_LIMITS
    answer[:m] = np.clip(answer[:m], -limit, limit)
    residual = float(np.linalg.norm(wanted - full @ answer))
    return Allocation(answer[:m], answer[m:], residual, margin, status)


def _solve(u: Array, values: Array, vt: Array, kept: Array, wanted: Array) -> Array:
    """Return the shortest solution by the kept singular directions."""
    result: Array = vt[kept].T @ ((u[:, kept].T @ wanted) / values[kept])
    return result
