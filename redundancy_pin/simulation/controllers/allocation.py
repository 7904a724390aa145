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
    if effort_limit is None or (np.abs(answer[:m]) <= effort_limit).all():
        return Allocation(answer[:m], answer[m:], residual, margin, AllocationStatus.EXACT)
    room = np.full((2, len(scale)), np.inf)
    room[:, :m] = (effort_limit - planned) / effort_scale, (effort_limit + planned) / effort_scale
    answer = start + scale * _bounded(weighted, wanted - full @ start, -room[1], room[0])
    residual = float(np.linalg.norm(wanted - full @ answer))
    status = AllocationStatus.SATURATED if residual <= size else AllocationStatus.BEYOND_LIMITS
    return Allocation(answer[:m], answer[m:], residual, margin, status)


def _bounded(matrix: Array, wanted: Array, lower: Array, upper: Array) -> Array:
    """Return the shortest y within bounds with A y = wanted, or as near to it as the clamped entries allow.

    An active set: the entry that is farthest beyond its bound is clamped there, and one that would come back into its
    bounds if it were free is freed. The answer is continuous in ``wanted``, so an integrator can follow it.
    """
    clamped = np.zeros(matrix.shape[1], dtype=bool)
    value = np.zeros(matrix.shape[1])
    for _ in range(_MOST_CHANGES * matrix.shape[1]):
        rest = wanted - matrix[:, clamped] @ value[clamped]
        u, values, vt = np.linalg.svd(matrix[:, ~clamped], full_matrices=False)
        kept = values > RANK_TOLERANCE * np.abs(matrix).max()
        value[~clamped] = _solve(u, values, vt, kept, rest)
        multiplier = u[:, kept] @ ((u[:, kept].T @ rest) / values[kept] ** 2)
        beyond = np.where(clamped, 0.0, np.maximum(value - upper, lower - value))
        if beyond.max() > 0.0:
            worst = int(beyond.argmax())
            clamped[worst] = True
            value[worst] = min(max(value[worst], lower[worst]), upper[worst])
            continue
        wish = matrix.T @ multiplier
        returning = np.where(clamped, np.where(value == upper, upper - wish, wish - lower), 0.0)
        if returning.max() <= RESIDUAL_TOLERANCE or not kept.all() or len(values) < len(wanted):
            break
        clamped[int(returning.argmax())] = False
    return np.clip(value, lower, upper)


_MOST_CHANGES = 4
"""Changes of the active set for each entry before the last answer is taken as it is; its residual tells."""


def _solve(u: Array, values: Array, vt: Array, kept: Array, wanted: Array) -> Array:
    """Return the shortest solution by the kept singular directions."""
    result: Array = vt[kept].T @ ((u[:, kept].T @ wanted) / values[kept])
    return result
