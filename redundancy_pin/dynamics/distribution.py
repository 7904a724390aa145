"""From W τ = f to the efforts of the main actuators, with a status for each sample.

``one_sample.py`` and the C of ``compiled/sample.c`` take the same decisions for one sample of a control loop.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import (
    NEAR_SINGULAR_MARGIN,
    RANK_TOLERANCE,
    Array,
    BoolArray,
    Frozen,
    IntArray,
    checked,
    frozen,
    peak,
    read_only,
    require_type,
)
from redundancy_pin.dynamics.allocation import (
    FORCE_TOLERANCE,
    ROUNDING,
    MinimumNorm,
    fit_into_bounds,
    least_residual,
    leaves_bounds,
    minimum_norm,
)
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InputError
from redundancy_pin.spectrum import oriented, scaled, spectrum_of
from redundancy_pin.status import SampleStatus, solved_status


@dataclass(frozen=True, eq=False, repr=False)
class Distribution(Frozen):
    """Efforts of the main actuators, sample by sample, with the rank and the residual of W τ = f.

    N samples, n independent coordinates, m main actuators. *Scaled* means D_x⁻¹ W D_a and D_x⁻¹ f with
    D_x = diag(row_scale), D_a = diag(column_scale): moments and torques are divided by the robot's characteristic
    length, so that W has no unit and f is in newtons.

    Attributes:
        tau: (N, m) efforts, N or N·m by joint; positive along the joint rate. NaN if none exist.
        status: (N,) a ``SampleStatus`` each.
        rank: (N,) rank of the scaled W; 0 where unreachable.
        residual: (N,) N, scaled. Where tau is finite the norm of W τ − f. Where the status is inconsistent the part
            of f outside the range of W. Where the bounds are infeasible the least norm of W τ − f within them. NaN
            where unreachable.
        margin: (N,) smallest singular value of the scaled W; NaN where unreachable.
        condition: (N,) condition number of the scaled W, infinite where the margin is zero. Of a robot with
            translations and prismatic actuators only it is the condition number of its Jacobian (the 2-RPR in
            Parsa 2014, section 3.2).
        free_direction: (N, m) where the status is singular_consistent, efforts that can be added in any amount
            without changing the motion: W δ = 0, ‖D_a⁻¹ δ‖ = 1, N or N·m by joint. NaN elsewhere. If there are
            several such directions (m − rank > 1), one of them.
        uncontrolled: (N, n) where the rank is below n, a platform velocity that no actuator feels and so none
            resists: Wᵀ ξ = 0, ‖D_x ξ‖ = 1, m/s and rad/s in the base frame. NaN elsewhere. If there are several
            (n − rank > 1), one of them.
    """

    tau: Array
    status: IntArray
    rank: IntArray
    residual: Array
    margin: Array
    condition: Array
    free_direction: Array
    uncontrolled: Array

    def __repr__(self) -> str:
        """Return how many samples have which status, and peaks, not the arrays."""
        samples = [(status, int((self.status == status).sum())) for status in SampleStatus]
        counts = ", ".join(f"{count} {status.label}" for status, count in samples if count)
        return (
            f"Distribution(N={len(self)}, m={self.tau.shape[1]}: {counts}; {peak('tau', self.tau, 'N or N·m')}, "
            f"least margin {np.nanmin(self.margin, initial=np.inf):.4g})"
        )

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.status)

    @property
    def solved(self) -> BoolArray:
        """(N,) true where tau solves W τ = f."""
        return read_only(solved_status(self.status))

    @property
    def status_labels(self) -> NDArray[np.str_]:
        """(N,) the statuses as text, such as ``"ok"``."""
        return read_only(np.array([status.label for status in SampleStatus])[self.status])

    @property
    def status_counts(self) -> dict[str, int]:
        """Number of samples of each status that occurs."""
        counts = Counter(self.status.tolist())
        return {SampleStatus(value).label: counts[value] for value in sorted(counts)}


CONSISTENCY_TOLERANCE = 100.0 * RANK_TOLERANCE
"""Fraction of f that may lie outside the range of W before a rank-deficient sample counts as inconsistent: 1e-7. A pose
that ``RANK_TOLERANCE`` calls singular may be off the singularity by that part of its size, and f changes on that way by
a multiple of it; a hundredfold covers that. To it is added ``FORCE_TOLERANCE`` times ``ForceTerms.force``."""


@dataclass(frozen=True, eq=False)
class EffortRows(Frozen):
    """Linear conditions on the efforts, lower ≤ matrix τ ≤ upper, for example of contacts, a squeeze or a preload.

    ``dynamics.contacts`` makes them of closure forces. Equal bounds make an equation.

    Attributes:
        matrix: (N, c, m), or (c, m) for all samples; each row may have another unit.
        lower, upper: (N, c) or (c,); −inf and inf if unbounded.
    """

    matrix: Array
    lower: Array
    upper: Array


def distribute(
    reduced: ReducedDynamics,
    *,
    weights: ArrayLike | None = None,
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    preferred: ArrayLike | None = None,
    rows: Sequence[EffortRows] = (),
    near_singular: float = NEAR_SINGULAR_MARGIN,
    rank_tolerance: float = RANK_TOLERANCE,
    consistency_tolerance: float = CONSISTENCY_TOLERANCE,
    force_tolerance: float = FORCE_TOLERANCE,
) -> Distribution:
    """Return the efforts τ that balance f, with a status for each sample.

    Solves W τ = f (Parsa 2014, eqs. 2.17 and 2.53, with W = Jᵀ). Where the solution is unique it is returned. Where
    there are several (more actuators than freedoms, or a type II singularity at which f lies in the range of W) the
    one with the least Σ w_j τ_j² is. Without a solution τ is NaN; a least-squares compromise is never returned.
    All decisions are taken on D_x⁻¹ W D_a and D_x⁻¹ f, so that they do not depend on the unit of length.

    With fewer actuators than freedoms (m < n) the motion must ask for an f in the range of W. If it does, the status
    is ok or near_singular; if not, it is underactuated, or singular_inconsistent where W lacks even
    the rank m.

    Args:
        reduced: f (N, n), W (N, n, m) and their scales. Samples that are not reachable, and those whose f, W or
            efforts are not finite or beyond what a double holds, get the status unreachable.
        weights: scalar or (m,) positive weights w, 1/N² or 1/(N·m)² by joint. Left out: 1/column_scale², which counts a
            motor torque as the force it exerts at the characteristic length, so that the sum is one of squared forces.
        lower: scalar, (m,) or (N, m) smallest efforts, N or N·m by joint; −inf for none.
        upper: scalar, (m,) or (N, m) largest efforts; inf for none. Where the efforts of least norm leave the bounds,
            the efforts of least norm within the bounds are returned, or NaN with the status bound_infeasible.
        preferred: scalar, (m,) or (N, m) efforts τ⁰ that are kept to where f leaves a choice: Σ w_j (τ_j − τ⁰_j)² is
            least. Internal forces, such as a squeeze of what two arms hold or a preload against backlash, are
            preferred efforts along W δ = 0, which then hold exactly.
        rows: further conditions that the efforts keep as they keep their bounds, such as friction cones of contacts, or
            the force that two of them squeeze with (``dynamics.contacts``). Bounds, rows, weights and preferred efforts
            are one quadratic program per sample, solved only for samples whose efforts violate them.
        near_singular: margin below which a sample is near-singular (scaled, no unit).
        rank_tolerance: singular values up to this fraction of the largest one, and up to this, count as zero.
        consistency_tolerance: fraction of f that may lie outside the range of W, ...
        force_tolerance: ... plus this fraction of ``reduced.force_size``, if there is one.

    Raises:
        InputError: shapes do not fit; weights that are not positive or too far apart; lower above upper, NaN bounds;
            a tolerance that is negative or not finite, or a rank tolerance below 1e-14.

    Example:
        >>> reduced = rp.RneaDynamics("3rrr").reduce(rp.trajectory.reference.corner().sample(0.01))
        >>> set(rp.distribute(reduced).status_labels.tolist())
        {'ok'}
    """
    if not isinstance(reduced, ReducedDynamics):
        raise InputError(
            f"distribute was given {type(reduced).__name__}.", remedy="Pass the result of a backend's reduce."
        )
    tolerances = {
        "near_singular": near_singular,
        "rank_tolerance": rank_tolerance,
        "consistency_tolerance": consistency_tolerance,
        "force_tolerance": force_tolerance,
    }
    _check_tolerances(tolerances)
    problem = _problem(reduced, weights, lower, upper, rows)
    samples, n, m = problem.A.shape
    force, start = problem.g, np.zeros((samples, m))
    if preferred is not None:
        start = _bound(preferred, "preferred", math.inf, samples, m)
        if not np.isfinite(start).all():
            raise InputError(
                "preferred has values that are not finite.", remedy="Pass finite efforts; 0 expresses no preference."
            )
        start = start / reduced.column_scale
        problem = problem.counted_from(start)
    # no square over- or underflows: the forces of each sample are divided by a power of two, which rounds nothing
    exponent: IntArray = np.frexp(np.maximum(np.abs(force), np.abs(problem.g)).max(axis=1))[1]
    problem, force = problem.divided_by_power(exponent), _times_power(force, -exponent)
    size = np.linalg.norm(force, axis=1)
    spectrum = spectrum_of(problem.A)
    rank = spectrum.rank(rank_tolerance)
    at = problem.solvable
    shapes = (m,), (), (n,), (m, m)
    u, outside, left, right = solution = MinimumNorm(*(np.full((samples, *shape), np.nan) for shape in shapes))
    for whole, part in zip(solution, minimum_norm(problem.A[at], problem.g[at], rank[at], problem.cost), strict=True):
        whole[at] = part
    allowed = consistency_tolerance * size
    if reduced.force_size is not None:
        allowed = allowed + np.ldexp(force_tolerance * reduced.force_size, -exponent)
    consistent = at & (outside <= allowed)
    u[~consistent] = np.nan
    u, infeasible = _within_bounds(problem, u, right, rank)
    full, near = rank == min(problem.A.shape[1:]), spectrum.margin < near_singular
    # the first condition that holds decides, so the order is part of the meaning
    status: IntArray = np.select(
        [~at, infeasible, consistent & ~full, consistent & near, consistent, full],
        [
            SampleStatus.UNREACHABLE,
            SampleStatus.BOUND_INFEASIBLE,
            SampleStatus.SINGULAR_CONSISTENT,
            SampleStatus.NEAR_SINGULAR,
            SampleStatus.OK,
            SampleStatus.UNDERACTUATED,
        ],
        SampleStatus.SINGULAR_INCONSISTENT,
    ).astype(np.intp)
    free_direction, uncontrolled = _directions(problem, left, right, rank, status)
    residual = _residual(problem, u, outside, infeasible)
    u, unbalanced = _times_power(u, exponent), _times_power(residual, exponent)
    with np.errstate(over="ignore"):
        beyond = np.isinf(u * reduced.column_scale).any(axis=1) | (np.isinf(unbalanced) & np.isfinite(residual))
    if beyond.any():  # no double holds the answer: treated as an f that is not finite
        finite = replace(reduced, f=np.where(beyond[:, np.newaxis], np.nan, reduced.f))
        return distribute(
            finite, weights=weights, lower=lower, upper=upper, preferred=preferred, rows=rows, **tolerances
        )
    if reduced.out_of_range is not None:
        status[solved_status(status) & reduced.out_of_range] = SampleStatus.OUT_OF_RANGE
    return Distribution(
        tau=read_only((u + start) * reduced.column_scale),
        status=read_only(status),
        rank=rank,
        residual=read_only(unbalanced),
        margin=spectrum.margin,
        condition=spectrum.condition,
        free_direction=read_only(free_direction * reduced.column_scale),
        uncontrolled=read_only(uncontrolled / reduced.row_scale),
    )


def torque_speed_bounds(rate: ArrayLike, stall: ArrayLike, no_load: ArrayLike) -> tuple[Array, Array]:
    """Return the smallest and the largest efforts (N, m) of motors whose torque falls with speed, for ``distribute``.

    At stall a motor gives ±τ_s; with the motion it gives the less the faster it turns, τ_s (1 − |ω|/ω₀), nothing at ω₀,
    and beyond that it can only brake. Against the motion it gives τ_s at any speed.

    Args:
        rate: (N, m) rates of the main actuators, m/s or rad/s: ``np.einsum("nij,ni->nj", reduced.W, motion.xd)``.
        stall: scalar or (m,) τ_s, N or N·m, positive.
        no_load: scalar or (m,) ω₀, m/s or rad/s, positive.

    Raises:
        InputError: wrong shapes, or numbers that are not positive.
    """
    rates = checked(rate, "rate", ("N", "m"))
    most, fastest = (
        _positive(values, name, rates.shape[1]) for values, name in ((stall, "stall"), (no_load, "no_load"))
    )
    falling = rates / fastest
    upper = most * np.clip(1.0 - falling, -1.0, 1.0)
    lower = -most * np.clip(1.0 + falling, -1.0, 1.0)
    return read_only(lower), read_only(upper)


LARGEST_WEIGHT_RATIO = 1e12
"""Weights (on force-equivalent efforts) further apart than this lose the optimum: its relative error is the root of
their ratio times 1e-16."""


@dataclass(frozen=True, eq=False)
class _Problem:
    """Minimise Σ cost_j u_j² over A u = g, lower ≤ rows u ≤ upper, with u = D_a⁻¹ τ: moments and torques as forces.

    Attributes:
        A: (N, n, m) D_x⁻¹ W D_a; NaN where not solvable.
        g: (N, n) D_x⁻¹ f, N; NaN where not solvable.
        cost: (m,) positive, the largest is 1.
        rows: (N, m + c, m) unit rows; the first m are the identity.
        lower, upper: (N, m + c) bounds, N; infinite for no bound.
        solvable: (N,) the sample is reachable, and its W and f are finite.
    """

    A: Array
    g: Array
    cost: Array
    rows: Array
    lower: Array
    upper: Array
    solvable: BoolArray

    def counted_from(self, start: Array) -> _Problem:
        """Return the problem of u − start, (N, m)."""
        moved = np.einsum("Ncj,Nj->Nc", self.rows, start)
        g = self.g - np.einsum("Nij,Nj->Ni", self.A, start)
        return replace(self, g=g, lower=self.lower - moved, upper=self.upper - moved)

    def divided_by_power(self, exponent: IntArray) -> _Problem:
        """Return the problem with all forces, u among them, divided by 2**exponent, (N,)."""
        g, lower, upper = (_times_power(force, -exponent) for force in (self.g, self.lower, self.upper))
        return replace(self, g=g, lower=lower, upper=upper)


def _problem(
    reduced: ReducedDynamics,
    weights: ArrayLike | None,
    lower: ArrayLike | None,
    upper: ArrayLike | None,
    rows: Sequence[EffortRows],
) -> _Problem:
    """Check the arguments of ``distribute`` and return them without units."""
    shapes = W, f, reachable = np.shape(reduced.W), np.shape(reduced.f), np.shape(reduced.reachable)
    if len(W) != 3 or 0 in W[1:] or f != W[:2] or reachable != W[:1]:
        raise InputError(
            f"W, f and reachable have shapes {W}, {f} and {reachable}, expected (N, n, m), (N, n) and (N,).",
            remedy="Pass the result of a backend's reduce, or arrays of those shapes with n and m at least 1.",
            **dict(zip(("W", "f", "reachable"), shapes, strict=True)),
        )
    if rows is None or isinstance(rows, EffortRows):
        what = "rows is None" if rows is None else "rows is one EffortRows"
        raise InputError(f"{what}.", remedy="Pass a list of EffortRows, rows=[squeeze], an empty one for none.")
    samples, n, m = reduced.W.shape
    row_scale = _positive(reduced.row_scale, "row_scale", n)
    column_scale = _positive(reduced.column_scale, "column_scale", m)
    A = scaled(reduced.W, row_scale, column_scale)
    with np.errstate(over="ignore"):
        g: Array = reduced.f / row_scale
    solvable: BoolArray = reduced.reachable & np.isfinite(A).all(axis=(1, 2)) & np.isfinite(g).all(axis=1)
    A[~solvable] = np.nan
    g[~solvable] = np.nan
    low = _bound(lower, "lower", -math.inf, samples, m)
    high = _bound(upper, "upper", math.inf, samples, m)
    for k, j in np.argwhere(low > high)[:1].tolist():
        raise InputError(
            f"lower is above upper for actuator {j} (first at sample {k}): {low[k, j]:g} > {high[k, j]:g}.",
            remedy="Swap or widen the bounds.",
            sample=k,
            actuator=j,
            name="lower",
        )
    parts = [(np.broadcast_to(np.eye(m), (samples, m, m)), low / column_scale, high / column_scale)]
    parts += [_unit_rows(one, solvable, column_scale) for one in rows]
    matrix, low, high = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
    return _Problem(A, g, _cost(weights, column_scale), matrix, low, high, solvable)


def _unit_rows(rows: EffortRows, solvable: BoolArray, column_scale: Array) -> tuple[Array, Array, Array]:
    """Return rows (N, c, m) of scaled efforts, of length one, with their bounds (N, c)."""
    require_type(rows, EffortRows, "Rows of efforts", "Pass EffortRows, or what dynamics.contacts makes.")
    samples, m = len(solvable), len(column_scale)
    try:
        given = np.asarray(rows.matrix, dtype=np.float64)
    except (TypeError, ValueError):
        given = checked(rows.matrix, "matrix", ("N", "c", m))  # raises, with the reason
    given = np.tile(given, (samples, 1, 1)) if given.ndim == 2 else given.copy()
    c = given.shape[1] if given.ndim == 3 else 0
    if len(given) == samples:
        given[~solvable] = 0.0  # closures of samples that are not reachable have no forces
    matrix = checked(given, "matrix", (samples, c, m)) * column_scale
    size = np.linalg.norm(matrix, axis=2)
    size = np.where(size > 0.0, size, 1.0)  # a row that no effort moves holds or does not
    low, high = (
        _bound(np.where(~solvable[:, None], absent, values), name, absent, samples, c) / size
        for values, name, absent in ((rows.lower, "lower", -math.inf), (rows.upper, "upper", math.inf))
    )
    for k, row in np.argwhere(low > high)[:1].tolist():
        raise InputError(
            f"lower is above upper in row {row} of the rows of efforts (first at sample {k}).",
            remedy="Swap or widen them.",
            sample=k,
            row=row,
        )
    return matrix / size[:, :, None], low, high


def _times_power(values: Array, exponent: IntArray) -> Array:
    """Return (N, …) values times 2**exponent, (N,), infinite where no double holds them."""
    with np.errstate(over="ignore"):
        return np.asarray(np.ldexp(values, exponent.reshape(-1, *[1] * (values.ndim - 1))))


def _positive(values: ArrayLike, name: str, length: int) -> Array:
    array = checked(np.full(length, values) if np.ndim(values) == 0 else values, name, (length,))
    if not (array > 0.0).all():
        j = int(np.argmin(array))
        raise InputError(
            f"{name}[{j}] is {array[j]:g}, but must be positive.", remedy=f"Make all of {name} positive.", index=j
        )
    return array


def _cost(weights: ArrayLike | None, column_scale: Array) -> Array:
    if weights is None:
        return read_only(np.ones(len(column_scale)))
    cost = _positive(weights, "weights", len(column_scale)) * column_scale**2
    ratio = float(cost.max() / cost.min())
    if not ratio <= LARGEST_WEIGHT_RATIO:
        raise InputError(
            f"The weights, times column_scale², differ by a factor of {ratio:.3g}, more than {LARGEST_WEIGHT_RATIO:g}.",
            remedy="To keep an actuator from contributing, bound it to zero instead of making it expensive.",
            ratio=ratio,
        )
    return read_only(cost / cost.max())


def _bound(values: ArrayLike | None, name: str, absent: float, samples: int, m: int) -> Array:
    if values is None:
        return np.broadcast_to(np.float64(absent), (samples, m))
    try:
        given = frozen(values)
    except (TypeError, ValueError):
        return checked(values, name, (m,))  # raises with the reason
    # finite stand-ins make checked() refuse everything but the infinity that means "no bound"
    is_absent = given == absent
    if given.ndim == 0:
        given = np.full(m, given)
    shape = (m,) if given.ndim == 1 else (samples, m)
    array = np.where(is_absent, absent, checked(np.where(is_absent, 0.0, given), name, shape))
    return np.broadcast_to(array, (samples, m))


def _check_tolerances(tolerances: dict[str, float]) -> None:
    for name, value in tolerances.items():
        least = ROUNDING if name == "rank_tolerance" else 0.0  # of a small matrix; it would pass for rank
        if not (math.isfinite(value) and value >= least):
            raise InputError(
                f"{name} is {value}, but must be finite and at least {least:g}.",
                remedy="Leave it out for the default.",
                name=name,
                value=value,
            )


def _within_bounds(problem: _Problem, efforts: Array, right: Array, rank: IntArray) -> tuple[Array, BoolArray]:
    """Return (N, m) efforts within the bounds, and (N,) where none exist although unbounded efforts do."""
    m = efforts.shape[1]
    bounded = np.clip(efforts, problem.lower[:, :m], problem.upper[:, :m])
    at = leaves_bounds(np.einsum("Ncj,Nj->Nc", problem.rows, efforts), problem.lower, problem.upper)
    if at.any():
        limits = problem.lower[at], problem.upper[at], problem.rows[at]
        bounded[at] = fit_into_bounds(efforts[at], right[at], rank[at], problem.cost, *limits)
    return bounded, at & np.isnan(bounded).any(axis=1)


def _residual(problem: _Problem, efforts: Array, outside: Array, infeasible: BoolArray) -> Array:
    solved = np.isfinite(efforts).all(axis=1)
    unbalanced = np.einsum("Nij,Nj->Ni", problem.A, efforts) - problem.g
    residual: Array = np.where(solved, np.linalg.norm(unbalanced, axis=1), outside)
    if infeasible.any():
        parts = problem.A, problem.g, problem.lower, problem.upper, problem.rows
        residual[infeasible] = least_residual(*(part[infeasible] for part in parts))
    return residual


def _directions(problem: _Problem, left: Array, right: Array, rank: IntArray, status: IntArray) -> tuple[Array, Array]:
    """Return (N, m) free effort and (N, n) uncontrolled velocity directions, scaled, NaN where there are none."""
    samples, n, m = problem.A.shape
    free_direction = np.full((samples, m), np.nan)
    uncontrolled = np.full((samples, n), np.nan)
    deficient = problem.solvable & (rank < n)
    if deficient.any():
        uncontrolled[deficient], free_direction[deficient] = oriented(left[deficient]), oriented(right[deficient, -1])
        free_direction[status != SampleStatus.SINGULAR_CONSISTENT] = np.nan
    return free_direction, uncontrolled
