"""Control allocation: efforts that bring up a generalised force, the shortest ones, within bounds.

A u = g is to be met by the u of least Σ cost_j (u_j − u⁰_j)², within bounds l ≤ C u ≤ h. Without bounds that is a
pseudoinverse in scaled unknowns, with a decision about rank. With y the scaled unknowns, y₀ the shortest solution and
N a basis of the null space, what bounds ask for is the shortest z with l − C y₀ ≤ C N z ≤ h − C y₀, a quadratic
program in as many unknowns as there are motors too many. DAQP solves it, a dual method of active sets (Arnström,
Bemporad and Axehill 2022): exact, as the bounds that hold the answer are known. Of 12 motors, 6 freedoms and 24 rows it
takes 0.03 ms, non-negative least squares (Lawson and Hanson 1974, chapter 23) 0.41 ms, and all samples as one
block-diagonal program 0.3 ms with an interior point (PIQP, to 3e-7), 4 ms with OSQP, 7 ms with ProxQP. Where no z does,
there is still the u within the bounds that misses g least: least squares over a box.

``distribute`` (``dynamics.distribution``) allots the main efforts of whole motions, with a status for what planning
asks: does a solution exist? ``allocate`` does it at one state for a controller, whose carriers are actuators too.

Platform accelerations ẍ are wanted. With M (ẍ, s̈) + h = (W τ, F) and s̈ = s̈_c + δ they take

    W τ − M_xs δ = M_xx ẍ + M_xs s̈_c + h_x,

n equations in m + k unknowns. Near a type II pose W loses rank and the main actuators alone would take efforts without
bound. Of all exact solutions the one with the least

    Σ (τ_i − τ_i,plan)² / τ̂_i² + Σ δ_j² / â_j²

is taken. Where W is regular and τ̂ is generous against |M_xs| â, δ is small and τ does the work. Towards the singularity
the carriers take over, continuously, and δ stays finite as long as [W, −M_xs] has full row rank. Where it does not, no
actuator acts in some direction, and the status reports it. Limits are |τ| ≤ τ_max, and |F| ≤ F_max for the carrier
forces F = F_0 + M_ss δ, with F = F_0 at δ = 0. What exceeds the limit of one kind of actuator is left to the other.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, BoolArray, Frozen, IntArray
from redundancy_pin.status import SampleStatus

FORCE_TOLERANCE = 1e-9
"""Share of the forces at stake, no unit, that counts as zero: the missing part of a wanted force, the excess of an
effort over its bound (it is then put on the bound, and the residual shows the difference), the rest of f where moving
carriers cancel it. Rounding of f is 1e-13 to 1e-12 of its parts; a plant's forces are known to 1e-3."""

ROUNDING = 1e-14
"""Relative rounding, no unit, of a sum of a few numbers or a solved system of a few unknowns: 50 units in the last
place."""


class MinimumNorm(NamedTuple):
    """Solutions of least norm of N systems A u = P g, and the singular vectors that they were read from.

    Attributes:
        efforts: (N, m) the minimisers of Σ cost_j u_j².
        outside: (N,) sizes of g − P g.
        left: (N, n) the last left singular vector of A; zero where A is square and regular.
        right: (N, m, m) right singular vectors of A, row by row; zero where A is square and regular.
    """

    efforts: Array
    outside: Array
    left: Array
    right: Array


def minimum_norm(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> MinimumNorm:
    """Return the minimisers of Σ cost_j u_j² among the solutions of A u = P g.

    P projects on the range of A (N, n, m), taken as its first ``rank`` singular directions; cost (m,) is positive. The
    caller decides whether what the projection leaves out is negligible; until then u is not a solution of A u = g.
    Full rank of a square A takes a plain linear solve, about a tenth of the cost.
    """
    samples, n, m = matrices.shape
    found = MinimumNorm(np.empty((samples, m)), np.zeros(samples), np.zeros((samples, n)), np.zeros((samples, m, m)))
    square = (rank == n) & (n == m)
    if square.any():
        found.efforts[square] = np.linalg.solve(matrices[square], forces[square, :, np.newaxis])[:, :, 0]
    other = ~square
    if other.any():
        parts = _by_singular_vectors(matrices[other], forces[other], rank[other], cost)
        for whole, part in zip(found, parts, strict=True):
            whole[other] = part
    return found


def _by_singular_vectors(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> MinimumNorm:
    _, n, m = matrices.shape
    p = min(n, m)
    u, singular_values, vt = np.linalg.svd(matrices, full_matrices=True)
    kept = np.arange(p) < rank[:, np.newaxis]
    inverse = np.divide(1.0, singular_values, out=np.zeros_like(singular_values), where=kept)
    components = np.einsum("Nij,Ni->Nj", u, forces)
    efforts = np.einsum("Nji,Nj->Ni", vt[:, :p], inverse * components[:, :p])
    # summing the left-out components themselves keeps a tiny remainder accurate, unlike g − P g
    left_out = np.where(np.arange(n) < rank[:, np.newaxis], 0.0, components)
    outside: Array = np.linalg.norm(left_out, axis=1)
    if np.ptp(cost) > 0.0 and (rank < m).any():
        # move along the null space (other columns zeroed) to the least ‖√cost u‖; weighting A beforehand would be
        # shorter, but the rank is that of A, and the range of its first directions must not depend on the weights
        null = vt.transpose(0, 2, 1) * (np.arange(m) >= rank[:, np.newaxis])[:, np.newaxis, :]
        root = np.sqrt(cost)
        step = np.linalg.pinv(root[:, np.newaxis] * null) @ (root * efforts)[:, :, np.newaxis]
        efforts = efforts - (null @ step)[:, :, 0]
    return MinimumNorm(efforts, outside, u[:, :, -1], vt)


_SETTINGS = {"primal_tol": 0.1 * FORCE_TOLERANCE, "sing_tol": ROUNDING, "iter_limit": 10_000}
"""DAQP's: by how much it may pass bounds; the square of the least angle, rad, between two of them (1e-7; of those 6e-6
apart it takes one for contradictory); and steps, of which it needs a few per bound."""

_FAR = 1e30
"""Bounds that DAQP takes for none: its DAQP_INF."""


def within_bounds(start: Array, null: Array, bounded: Array, lower: Array, upper: Array) -> Array | None:
    """Return the shortest z (d,) with l ≤ C (y₀ + N z) ≤ h; None if the bounds are infeasible.

    ``start`` is y₀ (p,), ``null`` N (p, d), orthonormal, ``bounded`` C (b, p); bounds (b,) may be infinite.
    """
    now = bounded @ start
    return _shortest_within(bounded @ null, np.linalg.norm(bounded, axis=1), lower - now, upper - now)


def _shortest_within(G: Array, reach: Array, low: Array, high: Array) -> Array | None:
    """Return the shortest z (d,) with l ≤ G z ≤ h, (b,) each, or None; ``reach`` (b,) are the lengths of C's rows."""
    size = np.linalg.norm(G, axis=1)
    # what a null direction moves by rounding only, it cannot move: a huge step along it would be no answer
    fixed = size <= RANK_TOLERANCE * reach
    if fixed.any():
        miss = np.maximum(low[fixed], -high[fixed])
        if (miss > RANK_TOLERANCE * (1.0 + np.abs(miss))).any():
            return None  # bounds that z does not move, and that are broken
        G, low, high, size = G[~fixed], low[~fixed], high[~fixed], size[~fixed]
    G, low, high = G / size[:, None], low / size, high / size
    scale = float(np.maximum(low, -high).max(initial=0.0))  # every z is at least that long
    if scale <= 0.0:
        return np.zeros(G.shape[1])
    import daqp

    # far bounds that cannot hold it are left to the test below: numbers of 1e300 are not for a solver
    sides = (np.clip(high / scale, -_FAR, _FAR), np.clip(low / scale, -_FAR, _FAR))
    d = G.shape[1]
    z, _, flag, info = daqp.solve(np.eye(d), np.zeros(d), G, *sides, np.zeros(len(G), dtype=np.int32), **_SETTINGS)
    if flag < 1:  # without an answer, the one that misses least is the safe one
        return None
    active = info["lam"] != 0.0
    side = np.where(info["lam"] > 0.0, sides[0], sides[1])[active]
    if np.abs(G[active] @ z - side).max(initial=0.0) > ROUNDING * max(1.0, np.abs(z).max()):
        z = np.linalg.lstsq(G[active], side, rcond=None)[0]  # from the bounds that hold it, it loses no digits
    z = np.asarray(scale * z)
    broken = np.maximum(low - G @ z, G @ z - high) > RANK_TOLERANCE * max(scale, float(np.linalg.norm(z)))
    return None if broken.any() else z


def least_miss(matrix: Array, goal: Array, lower: Array, upper: Array) -> Array:
    """Return the u (m,) with l ≤ u ≤ h, infinite or equal ones too, that makes ‖A u − g‖ least."""
    free = lower < upper  # lsq_linear takes no empty interiors
    u = np.array(lower)
    if free.any():
        from scipy.optimize import lsq_linear

        rest, ends = goal - matrix[:, ~free] @ u[~free], np.concatenate([lower[free], upper[free]])
        # the solver's tolerances are of numbers of the size of one
        size = max(float(np.abs(rest).max()), float(np.abs(ends[np.isfinite(ends)]).max(initial=0.0))) or 1.0
        problem = matrix[:, free], rest / size, (lower[free] / size, upper[free] / size)
        with np.errstate(divide="ignore", invalid="ignore"):
            fit = lsq_linear(*problem, method="bvls", tol=ROUNDING, max_iter=1000)
        if not np.isfinite(fit.x).all():  # columns equal to machine precision may give 0/0
            fit = lsq_linear(*problem, method="trf", tol=ROUNDING, max_iter=1000)
        u[free] = np.clip(size * fit.x, lower[free], upper[free])
    return u


_WEIGHT = 1e-6
"""Weight of the length, relative to the largest singular value of A, where the equations cannot be met: directions in
which they hardly change are left alone, and a least miss is unique. The root of 1e-12: the miss keeps six digits."""


class Factors(NamedTuple):
    """A (n, p) and its singular value decomposition A = U diag(σ) Vᵀ, made once for all that is asked of A y = w.

    Attributes:
        matrix: (n, p) A.
        left: (n, n) U; values: (min(n, p),) σ, largest first; right: (p, p) Vᵀ.
        rank: how many of the values count.
    """

    matrix: Array
    left: Array
    values: Array
    right: Array
    rank: int

    def least_norm(self, wanted: Array) -> Array:
        """Return the shortest y (p,) that makes ‖A y − w‖ least."""
        components = self.left[:, : self.rank].T @ wanted
        result: Array = self.right[: self.rank].T @ (components / self.values[: self.rank])
        return result


def factorise(matrix: Array) -> Factors:
    """Return the singular value decomposition of A (n, p), with its rank."""
    left, values, right = np.linalg.svd(matrix)
    return Factors(matrix, left, values, right, int((values > RANK_TOLERANCE * values[0]).sum()))


def shortest(equations: Factors, wanted: Array, bounded: Array, lower: Array, upper: Array) -> tuple[Array, bool]:
    """Return the shortest y with A y = w and l ≤ C y ≤ u.

    Where nothing within the bounds meets the equations, it is the y within them that makes ‖A y − w‖² + ε² ‖y‖² least,
    ε small. Both are continuous in w, so an integrator can follow them. A is (n, p), w in its range, C (p, p), l < u.
    Also returns whether y is within the bounds; where C is singular and the bounds exclude every solution it is not.
    """
    start, null = equations.least_norm(wanted), equations.right[equations.rank :].T
    z = within_bounds(start, null, bounded, lower, upper)
    if z is not None:
        return start + null @ z, True
    if np.linalg.cond(bounded) > 1.0 / RANK_TOLERANCE:
        return start, False
    unit, size = np.linalg.norm(bounded, axis=1), len(start)
    inverse = np.linalg.inv(bounded / unit[:, None])
    system = np.concatenate([equations.matrix, _WEIGHT * equations.values[0] * np.eye(size)]) @ inverse
    return inverse @ least_miss(system, np.concatenate([wanted, np.zeros(size)]), lower / unit, upper / unit), True


def leaves_bounds(efforts: Array, lower: Array, upper: Array) -> BoolArray:
    """Return (N,) whether the efforts (N, m) leave the bounds (N, m) by more than the tolerance."""
    slack = FORCE_TOLERANCE * np.abs(efforts).max(axis=1, keepdims=True, initial=0.0)
    outside: BoolArray = ((efforts < lower - slack) | (efforts > upper + slack)).any(axis=1)
    return outside


def fit_into_bounds(
    efforts: Array, right: Array, rank: IntArray, cost: Array, lower: Array, upper: Array, rows: Array
) -> Array:
    """Return the minimisers of Σ cost_j u_j² over the solutions of A u = A u₀ with l ≤ C u ≤ h, NaN if there are none.

    All are scaled: u₀ = ``efforts`` (N, m), solutions without bounds, ``right`` (N, m, m) right singular vectors of A,
    cost (m,) > 0, bounds (N, m + c); C = ``rows`` (N, m + c, m) begins with the identity.
    """
    fitted = np.full_like(efforts, np.nan)
    root, m = np.sqrt(cost), efforts.shape[1]
    # y = √cost u / size: the cost is then a length, and tolerances are relative to the largest effort at stake
    row_values = np.einsum("Ncj,Nj->Nc", rows, efforts)
    size = np.maximum(np.abs(efforts).max(axis=1), np.abs(np.clip(row_values, lower, upper)).max(axis=1))[:, None]
    bounded = rows / root
    reach = np.linalg.norm(bounded, axis=2)
    for freedom in np.unique(rank[rank < m]):
        at = np.flatnonzero(rank == freedom)
        null = np.linalg.qr(root[:, None] * right[at, freedom:].transpose(0, 2, 1))[0]
        start = root * efforts[at] / size[at]
        start -= np.einsum("Njd,Nkd,Nk->Nj", null, null, start)  # the shortest of all solutions
        now, G = np.einsum("Ncj,Nj->Nc", bounded[at], start), bounded[at] @ null
        low, high = lower[at] / size[at] - FORCE_TOLERANCE - now, upper[at] / size[at] + FORCE_TOLERANCE - now
        for i, k in enumerate(at.tolist()):
            z = _shortest_within(G[i], reach[k], low[i], high[i])
            if z is not None:
                fitted[k] = np.clip(size[k] * (start[i] + null[i] @ z) / root, lower[k, :m], upper[k, :m])
    return fitted


def least_residual(matrices: Array, forces: Array, lower: Array, upper: Array, rows: Array) -> Array:
    """Return (N,) min ‖A u − g‖ over l ≤ C u ≤ h, C as in ``fit_into_bounds``: the force left unbalanced, N, scaled.

    Infinite where nothing keeps the bounds, whatever is left.
    """
    m = matrices.shape[2]
    if rows.shape[1] == m:
        boxes = zip(matrices, forces, lower, upper, strict=True)
        return np.array([np.linalg.norm(A @ least_miss(A, g, low, high) - g) for A, g, low, high in boxes])
    import daqp

    residuals = []
    for A, g, C, low, high in zip(matrices, forces, rows, lower, upper, strict=True):
        H = A.T @ A
        H += _WEIGHT**2 * max(np.trace(H), 1.0) * np.eye(m)
        ends = np.concatenate([low, high])
        # tolerances are of numbers of the size of one
        size = float(np.linalg.norm(g)) or float(np.abs(ends[np.isfinite(ends)]).max(initial=0.0)) or 1.0
        sides = (np.clip(high / size, -_FAR, _FAR), np.clip(low / size, -_FAR, _FAR))
        sense = np.zeros(len(C), dtype=np.int32)
        u, _, flag, _ = daqp.solve(H, -A.T @ g / size, np.ascontiguousarray(C), *sides, sense, **_SETTINGS)
        residuals.append(float(np.linalg.norm(size * (A @ u) - g)) if flag > 0 else np.inf)
    return np.array(residuals)


@dataclass(frozen=True, eq=False)
class CarrierForces(Frozen):
    """Forces of the carriers as functions of δ, F = F_0 + M_ss δ, and their limits.

    Attributes:
        planned: (k,) F_0, force for the wanted accelerations of platform and carriers, N.
        mass: (k, k) M_ss, kg.
        limit: (k,) largest |F|, N; infinite for no limit.
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
class Allocation(Frozen):
    """A solution of W τ − M_xs δ = f.

    Attributes:
        tau: (m,) main efforts, N or N·m.
        deviation: (k,) δ, carrier accelerations beyond the wanted ones, m/s².
        residual: scaled norm of f − (W τ − M_xs δ), N.
        margin: smallest singular value of [W τ̂, −M_xs â], row-scaled, N: what can be brought up in the worst direction
            by deviations of the size of the scales.
        status: ``OK``; ``BOUND_INFEASIBLE`` where efforts and carrier forces within their limits fall short together,
            by ``residual``; ``SINGULAR_INCONSISTENT`` or ``UNDERACTUATED`` where they have no effect in some direction;
            ``TYPE_I`` where W does not exist.
        saturated: whether a main effort or a carrier force is at its limit; with status ``OK`` the others make up for
            it exactly.
    """

    tau: Array
    deviation: Array
    residual: float
    margin: float
    status: SampleStatus
    saturated: bool = False

    @property
    def balanced(self) -> bool:
        """Whether main actuators and carriers act in every direction of the wanted force, limits aside."""
        return self.status in (SampleStatus.OK, SampleStatus.BOUND_INFEASIBLE)


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
        effort_limit: (m,) largest |τ|; the other actuators supply the rest.
        carriers: forces of the carriers and their limits; no limit when left out.
    """
    m, k = W.shape[1], coupling.shape[1]
    full = np.concatenate([W, -coupling], axis=1) / row_scale[:, None]
    scale = np.concatenate([effort_scale, carrier_scale])
    start = np.concatenate([planned, np.zeros(k)])
    wanted = force / row_scale
    equations = factorise(full * scale)
    values = equations.values
    margin = float(values[-1]) if len(values) == len(wanted) else 0.0
    size = FORCE_TOLERANCE * (float(values[0]) + float(np.linalg.norm(wanted)))
    rest = wanted - full @ start
    answer = start + scale * equations.least_norm(rest)
    residual = float(np.linalg.norm(wanted - full @ answer))
    if residual > size:
        short = SampleStatus.UNDERACTUATED if equations.rank == len(values) else SampleStatus.SINGULAR_INCONSISTENT
        return Allocation(answer[:m], answer[m:], residual, margin, short)
    most = np.full(m, np.inf) if effort_limit is None else effort_limit
    forces = CarrierForces(np.zeros(k), np.eye(k), np.full(k, np.inf)) if carriers is None else carriers
    if (np.abs(answer[:m]) <= most).all() and forces.allow(answer[m:]):
        return Allocation(answer[:m], answer[m:], residual, margin, SampleStatus.OK)
    # the carriers' forces are bounded unknowns like the main efforts: C maps scaled deviations to both
    bounded = np.zeros((m + k, m + k))
    bounded[:m, :m], bounded[m:, m:] = np.diag(effort_scale), forces.mass * carrier_scale
    now, limits = np.concatenate([planned, forces.planned]), np.concatenate([most, forces.limit])
    deviation, within = shortest(equations, rest, bounded, -limits - now, limits - now)
    answer = start + scale * deviation
    answer[:m] = np.clip(answer[:m], -most, most)
    residual = float(np.linalg.norm(wanted - full @ answer))
    status = SampleStatus.OK if within and residual <= size else SampleStatus.BOUND_INFEASIBLE
    return Allocation(answer[:m], answer[m:], residual, margin, status, saturated=True)
