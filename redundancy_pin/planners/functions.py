"""What a plan is between its samples: platform, carriers and main efforts as functions of time, and their peaks.

Planners hand over the two motions as they made them, and the efforts where they decided on them (none while the
actuators are off). Everywhere else W τ = f of these motions determines the efforts, and they are evaluated where
somebody plays the plan, not when it is made: ten evaluations of the backend in each step cost as much as the plan.

The dense check looks for the peaks. In every piece in which platform, carriers and prescribed efforts are smooth, main
efforts and carrier forces are evaluated at Chebyshev points. Where the last coefficients of their series are not small,
as beside the spike that a cusp of the path makes, the piece is halved and evaluated again. The peaks are those of the
polynomials, both limits at every jump included. Where det W changes its sign and no halving resolves the efforts, they
are infinite.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev, chebyshev

from redundancy_pin.arrays import Array, BoolArray, Frozen, Side, frozen
from redundancy_pin.dynamics.base import Dynamics, ReducedDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.limits import LIMIT_TOLERANCE, LimitEvent, limit_events
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import velocity_scale
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import (
    PiecewisePolynomial,
    carriers_at,
    chebyshev_points,
    chebyshev_series,
)

DEGREE = 9
"""Of the efforts in each piece. A step of 5 ms of a motion that changes within 50 ms leaves 1e-14."""

BESIDE = 0.3
"""Part of a piece next to a singular instant in which τ = W⁻¹ f magnifies rounding and is not evaluated."""

DEGREE_BESIDE = 5
"""Of τ in the pieces at a singular instant, from the rest of the piece and the τ that the plan has there."""

ROUNDED = 1e-10
"""Times that differ by less than this fraction of the interval are one."""

ROOT = 1e-6
"""How exactly a root of det W is known, relative to the piece: a double one to the square root of rounding."""

POLE = 1e-2
"""Last coefficients of the efforts in a piece, relative to the largest, from which they have a pole there."""

SINGULAR_SAMPLE = 1e-6
"""Margin of W, relative to the largest along the motion, below which a sample of a plan counts as singular."""


@dataclass(frozen=True, eq=False)
class PlanFunctions(Frozen):
    """The functions of time of a plan, from its first to its last sample.

    Attributes:
        platform: motion of the platform.
        carriers: positions (k,) of the carriers, m; ṡ and s̈ are its derivatives.
        prescribed: main efforts (m,) where the planner decided on them, N or N·m, each over its own interval.
        preferred: main efforts (m,); where W leaves a choice, those nearest to them are taken. Where left out, the
            least efforts.
    """

    platform: ContinuousMotion
    carriers: PiecewisePolynomial
    prescribed: tuple[PiecewisePolynomial, ...] = ()
    preferred: PiecewisePolynomial | None = None

    def carriers_at(self, times: Array, side: Side = "right") -> CarrierMotion:
        """Return the carriers at (N,) times, s; ``side`` decides where s̈ jumps."""
        return carriers_at(self.carriers, times, side)

    def efforts(self, reduced: ReducedDynamics) -> Array:
        """Return main efforts (N, m), N or N·m, of the dynamics along these motions; NaN where none are finite."""
        if self.preferred is not None and reduced.W.shape[2] > reduced.W.shape[1]:
            wanted = self.preferred(reduced.t)
            left = reduced.f - np.einsum("nij,nj->ni", reduced.W, wanted)
            tau: Array = wanted + np.einsum("nji,ni->nj", np.linalg.pinv(reduced.W), left)
        else:
            tau = np.array(distribute(reduced).tau)
        for part in self.prescribed:
            inside = (reduced.t >= part.start) & (reduced.t <= part.end)
            tau[inside] = part(reduced.t[inside])
        return tau

    def pieces(self, samples: Array) -> Array:
        """Return (P + 1,) times, s, between which everything is smooth, with the (N,) samples of a plan."""
        platform, decided = self.platform, [part.edges for part in self.prescribed]
        edges = np.concatenate([samples, self.carriers.edges, platform.breaks, platform.knots, *decided])
        return apart(edges[(edges >= samples[0]) & (edges <= samples[-1])])

    def effort_polynomials(
        self, edges: Array, reduced: ReducedDynamics, limits: Mapping[float, Array]
    ) -> PiecewisePolynomial:
        """Return the main efforts (m,) as polynomials.

        ``edges`` (P + 1,) ends of the pieces, s; ``reduced``: dynamics along these motions at the times of
        ``chebyshev_times`` of the pieces; ``limits``: efforts (m,) at edges, s, on a type II singularity, which W⁻¹ f
        tends to.
        """
        left, right, slack = edges[:-1], edges[1:], ROUNDED * (edges[-1] - edges[0])
        times = reduced.t.reshape(len(left), -1)
        tau = self.efforts(reduced).reshape(*times.shape, -1)
        for t, value in limits.items():
            at_end = (np.abs(left - t) <= slack) | (
                np.abs(right - t) <= slack
            )  # an edge may be a knot beside the sample
            for i in np.flatnonzero(at_end):
                tau[i] = _beside((times[i] - t) / (right[i] - left[i]), tau[i], value)
        _require_finite(tau, edges, reduced)
        return PiecewisePolynomial.from_values(edges, tau)


def _beside(distance: Array, tau: Array, value: Array) -> Array:
    """Return τ (d, m) in a piece with a singular instant at one end, from the rest of the piece and τ there.

    ``distance`` (d,) of the times in the piece from the instant, in lengths of the piece; ``tau`` (d, m) W⁻¹ f there;
    ``value`` (m,) at the instant.
    """
    kept = np.abs(distance) > BESIDE
    domain = sorted([0.0, float(np.sign(distance[0]))])
    x, y = np.append(distance[kept], 0.0), np.vstack([tau[kept], value])
    columns = [Chebyshev.fit(x, column, DEGREE_BESIDE, domain=domain)(distance) for column in y.T]
    return np.stack(columns, axis=1)


def _require_finite(tau: Array, edges: Array, reduced: ReducedDynamics) -> None:
    """Check the (P, d, m) efforts in each piece: a pole, which no node need meet, leaves large last coefficients."""
    series = chebyshev_series(tau)
    size = np.abs(series).max(initial=0.0, where=np.isfinite(series))
    bad = ~np.isfinite(series).all(axis=(1, 2)) | (np.abs(series[:, -2:]).max(axis=(1, 2)) > POLE * size)
    for i in np.flatnonzero(bad)[:1].tolist():
        t = _singular_instant(tau[i], edges[i : i + 2], reduced, i)
        raise InfeasiblePlanError(
            f"The motion has no finite efforts at t = {t:.9g} s.",
            remedy="It meets a type II singularity that it may not cross: plan it with plan_whole_trajectory.",
            constraint="effort",
            time=t,
        )


def _singular_instant(tau: Array, ends: Array, reduced: ReducedDynamics, piece: int) -> float:
    """Return where in a piece the (d, m) efforts have their pole: where det W, a polynomial there, is zero."""
    nodes = slice(piece * len(tau), (piece + 1) * len(tau))
    times, W = reduced.t[nodes], np.asarray(reduced.W[nodes])
    lost = np.flatnonzero(~np.isfinite(tau).all(axis=1))
    if len(lost):
        return float(times[lost[0]])
    if W.shape[1] == W.shape[2]:
        determinant = np.linalg.det(W)
        roots = Chebyshev.fit(times, determinant / np.abs(determinant).max(), len(times) - 1, domain=ends).roots()
        slack = ROOT * (ends[1] - ends[0])
        near = np.sort(
            roots.real[(np.abs(roots.imag) <= slack) & (np.abs(roots.real - ends.mean()) <= 0.5 * np.ptp(ends) + slack)]
        )
        if len(near):
            return float(next((end for end in ends if abs(near[0] - end) <= slack), near[0]))
    return float(times[np.abs(tau).max(axis=1).argmax()])


def apart(times: Array) -> Array:
    """Return times in order, those that differ from the one before by rounding left out, the first and last kept."""
    edges = np.unique(times)
    kept: Array = edges[np.append(True, np.diff(edges) > ROUNDED * (edges[-1] - edges[0]))]
    kept[-1] = edges[-1]
    return kept


# --- the dense check ---

ALLOWED = 1.05
"""Largest effort between the samples over the largest at the samples up to which the samples show the efforts."""

MARKED = 1.02
"""Ratio to that, or to a limit, from which a grid is refined; what exceeds a limit by less is met by lower limits at
the nodes (``BetweenSamples.shares``)."""

LOWERED = 6
"""Rounds with lower limits at the nodes."""

SMALL = 1e-3
"""Efforts below this fraction of those that f takes count as zero here."""

PIECE_DEGREE = 5
"""Of efforts and forces in a piece, which is halved where that does not resolve them."""

RESOLVED = 1e-3
"""Last coefficients of a piece, relative to the largest value of the motion, from which it is halved."""

EXACT = 1e-6
"""The same in pieces whose values come near the largest, which decide what is reported."""

NEAR_PEAK = 0.9
"""Fraction of the largest value from which a piece is one of those."""

ROUNDING = 1e-11
"""Last coefficients of an effort, relative to the forces of the motion before they cancel, that are its rounding.

Rounding itself is 1e-16 where W is well conditioned. An actuator without load has nothing else, and no halving ends it.
"""

HALVINGS = 16
"""Of a piece, at most: the spike of a cusp of a micrometre lasts microseconds. Only pieces around spikes get there."""

GROWN = 10.0
"""Growth of the efforts, since the first evaluation, from which a piece that no halving resolves may have a pole."""

FEWEST_PIECES = 64
"""In a motion that is smooth throughout: a spike narrower than a tenth of one would hide."""

NEAR_BEST = 0.998
"""Fraction of the largest of these values from which an extreme is made exact."""

_FINE = np.cos(np.linspace(np.pi, 0.0, 65))
"""Places in a piece, from −1 to 1, among which the extreme of its polynomial is sought first."""


@dataclass(frozen=True, eq=False)
class Peaks:
    """The extremes of main efforts, carrier forces and limited rates in each of P pieces; c columns of these.

    ``left``, ``right`` (P,) ends of the pieces, s; ``time`` (P, c) of the extremes, s; ``value`` (P, c) their signed
    values, N or N·m, m/s or rad/s, infinite where there is none; ``points``: number of points evaluated.
    """

    left: Array
    right: Array
    time: Array
    value: Array
    points: int


@dataclass(frozen=True, eq=False)
class DenseCheck:
    """What the continuous motion of a plan needs, beside what its samples show.

    Attributes:
        peak: (m,) largest |τ| of each main actuator, N or N·m; infinite where the efforts grow beyond all bounds.
        time: (m,) when, s.
        force_peak: (k,) largest force of each carrier's actuator, N.
        ratio: largest |τ| of the motion over the largest at the samples, at least 1. Efforts that are negligible beside
            those that f takes count as equal.
        points: number of points at which the dynamics were evaluated.
    """

    peak: Array
    time: Array
    force_peak: Array
    ratio: float
    points: int

    @property
    def passed(self) -> bool:
        """Whether the samples show the efforts."""
        return self.ratio <= ALLOWED


def peaks_between(
    dynamics: Dynamics,
    functions: PlanFunctions,
    start: float,
    end: float,
    singular: Array | None = None,
    rate: Array | None = None,
) -> Peaks:
    """Return the extremes of efforts, forces and limited rates in pieces from ``start`` to ``end``, s.

    ``singular`` (q,) instants at which W lacks rank and the efforts are finite all the same, s: beside them W⁻¹ f
    magnifies rounding, so pieces that end there are not halved towards them; ``rate`` (m,) limits of the main
    actuators' rates, m/s or rad/s: those that are finite have a column behind the forces.
    """
    most = np.full(dynamics.robot.m, np.inf) if rate is None else rate
    fixed = np.empty(0) if singular is None else np.asarray(singular)
    edges = _edges(functions, start, end, fixed)
    left, right = edges[:-1], edges[1:]
    beside = np.isin(left, fixed) | np.isin(right, fixed)
    size, points = np.empty(0), 0
    rounding = np.zeros(dynamics.robot.m + dynamics.robot.k + int(np.isfinite(most).sum()))
    done: list[tuple[Array, ...]] = []
    for halving in range(HALVINGS + 1):
        order = np.argsort(left)
        left, right, beside = left[order], right[order], beside[order]
        ends = np.stack([left, right], axis=1)
        times = chebyshev_points(left, right, PIECE_DEGREE)
        reduced, flat = _values(dynamics, functions, times, most)
        values = flat.reshape(len(left), PIECE_DEGREE + 1, -1)
        points += len(times)
        if not size.size:
            rounding[: dynamics.robot.m + dynamics.robot.k] = _rounding(dynamics.robot, reduced)
            size = np.abs(values).max(axis=(0, 1), initial=0.0, where=np.isfinite(values))
            limited = most[np.isfinite(most)]  # an actuator that stands has a rate of rounding
            size[len(size) - len(limited) :] = np.maximum(size[len(size) - len(limited) :], SMALL * limited)
        finite: BoolArray = np.logical_and.reduce(np.isfinite(values), axis=(1, 2))
        series = chebyshev_series(np.where(finite[:, None, None], values, 0.0))
        tail, largest = np.abs(series[:, -2:]).max(axis=1), np.abs(values).max(axis=1)
        share = np.where(largest > NEAR_PEAK * size, EXACT, RESOLVED)
        allowed = np.maximum(share * np.maximum(size, np.finfo(float).tiny), rounding)
        settled: BoolArray = np.logical_or(finite & np.logical_and.reduce(tail <= allowed, axis=1), beside)
        rough = ~settled & (halving < HALVINGS)
        kept = ~rough
        if halving == HALVINGS:
            # a pole grows with every halving; a spike that ends does not change the sign of det W
            main = slice(dynamics.robot.m)
            grown = np.logical_or.reduce(largest[:, main] > GROWN * size[main], axis=1)
            pole = np.flatnonzero(~settled & finite & grown)
            pole = pole[_crosses(dynamics, functions, ends[pole])]
            values[pole, :, main] = np.inf
            finite[pole] = False
        done.append((left[kept], right[kept], *_extremes(ends[kept], series[kept], values[kept], finite[kept])))
        if not rough.any():
            break
        middle = 0.5 * (left[rough] + right[rough])
        left, right = np.concatenate([left[rough], middle]), np.concatenate([middle, right[rough]])
        beside = np.zeros(len(left), dtype=bool)
    parts = [np.concatenate(part) for part in zip(*done, strict=True)]
    order = np.argsort(parts[0])
    first, last, time, value = (part[order] for part in parts)
    return Peaks(first, last, time, value, points)


def _edges(functions: PlanFunctions, start: float, end: float, singular: Array) -> Array:
    platform = functions.platform
    pieces = (functions.carriers, *functions.prescribed)
    inner = np.concatenate([platform.kinks, singular, *(part.edges for part in pieces)])
    even = np.linspace(start, end, FEWEST_PIECES + 1)
    times = np.concatenate([[start, end], inner[(inner > start) & (inner < end)]])
    if len(np.unique(times)) <= FEWEST_PIECES:
        times = np.concatenate([times, even])
    edges = apart(times)
    # a singular instant beside an edge by rounding stands for it
    near = np.abs(edges[:, None] - singular).argmin(axis=0) if len(singular) else np.empty(0, dtype=int)
    edges[near] = singular
    return edges


def _values(dynamics: Dynamics, functions: PlanFunctions, times: Array, rate: Array) -> tuple[ReducedDynamics, Array]:
    """Return the dynamics and (N, c) main efforts, carrier forces and limited rates at (N,) times, NaN for none."""
    motion = functions.platform.sample_at(times)
    reduced = dynamics.along(motion).reduce(functions.carriers_at(times))
    turning = np.einsum("nim,ni->nm", reduced.W, motion.xd)[:, np.isfinite(rate)]
    return reduced, np.concatenate([functions.efforts(reduced), np.asarray(reduced.carrier_force), turning], axis=1)


def _rounding(robot: Robot, reduced: ReducedDynamics) -> Array:
    """Return (m + k,) the rounding of main efforts and carrier forces along a motion, N or N·m."""
    if reduced.force_size is None:
        return np.zeros(robot.m + robot.k)
    arms: Array = np.concatenate([reduced.column_scale, velocity_scale(robot)[robot.carrier_velocity]])
    return ROUNDING * float(reduced.force_size.max(initial=0.0)) * arms


def _crosses(dynamics: Dynamics, functions: PlanFunctions, ends: Array) -> BoolArray:
    """Return (P,) whether det W of a square W changes its sign between the (P, 2) ends of pieces."""
    if not len(ends):
        return np.zeros(0, dtype=bool)
    signs = []
    for times in ends.T:
        W = np.asarray(dynamics.along(functions.platform.sample_at(times)).reduce(functions.carriers_at(times)).W)
        signs.append(np.linalg.slogdet(W)[0] if W.shape[1] == W.shape[2] else np.ones(len(W)))
    crosses: BoolArray = signs[0] * signs[1] <= 0.0
    return crosses


def _extremes(ends: Array, series: Array, values: Array, finite: BoolArray) -> tuple[Array, Array]:
    """Return (P, c) times and signed values of the extremes of polynomials; those of one largest of all are exact."""
    fine = np.einsum("xd,pdc->pxc", chebyshev.chebvander(_FINE, PIECE_DEGREE), series)
    best = np.abs(fine).argmax(axis=1)
    place, value = _FINE[best], np.take_along_axis(fine, best[:, None], axis=1)[:, 0]
    for j in range(value.shape[1]):
        top = np.abs(value[:, j]).max(initial=0.0)
        for p in np.flatnonzero(
            finite & (np.abs(value[:, j]) > NEAR_BEST * top) & (np.abs(place[:, j]) < 1.0)
        ).tolist():
            roots = chebyshev.chebroots(chebyshev.chebtrim(chebyshev.chebder(series[p, :, j]), 1e-300))
            roots = roots.real[(np.abs(roots.imag) < 1e-9) & (np.abs(roots.real) <= 1.0)]
            there = chebyshev.chebval(roots, series[p, :, j])
            if len(roots) and np.abs(there).max() > abs(value[p, j]):
                value[p, j], place[p, j] = there[np.abs(there).argmax()], roots[np.abs(there).argmax()]
    lost = np.where(np.isfinite(values).all(axis=1), value, np.inf)
    middle, half = ends.mean(axis=1, keepdims=True), 0.5 * np.diff(ends, axis=1)
    return middle + half * place, lost


@dataclass(frozen=True, eq=False)
class BetweenSamples:
    """What is between the samples of a plan: in P pieces, c columns of efforts, forces and limited rates.

    ``check``: the peaks; ``violated``: limits that are exceeded; ``touched``: limits that are met; ``middle`` (P,) of
    the pieces, s; ``ratio`` (P,) largest effort over the largest at the samples; ``use`` (P, c) fractions of limits.
    """

    check: DenseCheck
    violated: tuple[LimitEvent, ...]
    touched: tuple[LimitEvent, ...]
    middle: Array
    ratio: Array
    use: Array

    @property
    def passed(self) -> bool:
        """Whether the samples show the efforts, and limits hold between them."""
        return self.check.passed and not self.violated

    @property
    def worst(self) -> Array:
        """(P,) the larger of ratio and use."""
        return np.asarray(np.maximum(self.ratio, self.use.max(axis=1, initial=0.0)))

    def too_coarse(self, before: Sequence[float]) -> BoolArray:
        """Return (P,) where a finer grid is needed rather than lower limits at its nodes.

        ``before``: the largest ``worst`` of this look and of those before; lower limits that took off less than half of
        the excess are not enough.
        """
        coarse: BoolArray = self.worst > MARKED
        stuck = len(before) > 1 and before[-1] - 1.0 > 0.5 * (before[-2] - 1.0)
        return np.asarray((self.use > 1.0 + LIMIT_TOLERANCE).any(axis=1)) if stuck and not coarse.any() else coarse

    def shares(self, t: Array, before: Array | None) -> Array:
        """Return (M, c) fractions of their limits that nodes at (M,) times, s, may use so that none is exceeded inside.

        ``before``: those with which this motion was planned, if there were any.
        """
        needed = np.ones((len(t) + 1, self.use.shape[1]))
        over = np.where(self.use > 1.0 + LIMIT_TOLERANCE, 1.0 / np.maximum(self.use, 1.0), 1.0)
        np.minimum.at(needed, np.searchsorted(t, self.middle, side="right"), over)
        shares: Array = np.minimum(needed[:-1], needed[1:])
        return shares if before is None else shares * before


def dense_check(
    dynamics: Dynamics,
    functions: PlanFunctions,
    robot: Robot,
    t: Array,
    tau: Array,
    floor: float,
    effort: Array,
    singular: Array,
    rate: Array | None = None,
) -> BetweenSamples:
    """Look between the samples of a plan, and compare with the samples and with limits.

    ``robot``: with the limits of the carriers' forces that count; ``t`` (N,) and ``tau`` (N, m) samples; ``floor``:
    effort that counts as zero; ``effort`` (m,) and ``rate`` (m,) limits of main actuators, infinite for none;
    ``singular`` as for ``peaks_between``.
    """
    peaks = peaks_between(dynamics, functions, float(t[0]), float(t[-1]), singular, rate)
    m, k, size = robot.m, robot.k, np.abs(peaks.value)
    limited = [j for j in range(m) if rate is not None and np.isfinite(rate[j])]
    at_samples = np.abs(tau[np.isfinite(tau).all(axis=1)])
    largest = max(float(at_samples.max(initial=0.0)), floor)
    worst = size.argmax(axis=0)
    check = DenseCheck(
        peak=frozen(np.maximum(size.max(axis=0)[:m], at_samples.max(axis=0, initial=0.0))),
        time=frozen(peaks.time[worst, range(len(worst))][:m]),
        force_peak=frozen(size.max(axis=0)[m : m + k]),
        ratio=max(float(size[:, :m].max(initial=0.0) / (largest or 1.0)), 1.0),
        points=peaks.points,
    )
    force = np.array([limit.force for limit in robot.carrier_limits])
    kinds = (
        ("effort", robot.actuated, effort),
        ("force", robot.carriers, force),
        ("speed", tuple(robot.actuated[j] for j in limited), np.array([] if rate is None else rate[limited])),
    )
    events, uses, first = [], [], 0
    for quantity, names, limit in kinds:
        columns = slice(first, first + len(names))
        events.append(limit_events(quantity, names, peaks.time[:, columns], peaks.value[:, columns], limit))
        with np.errstate(invalid="ignore"):  # infinite efforts without a limit
            uses.append(np.nan_to_num(size[:, columns] / limit, nan=0.0, posinf=np.inf))
        first += len(names)
    violated, touched = (tuple(event for kind in events for event in kind[i]) for i in range(2))
    ratio = size[:, :m].max(axis=1, initial=0.0) / (largest or 1.0)
    middle = 0.5 * (peaks.left + peaks.right)
    return BetweenSamples(check, violated, touched, middle, ratio, np.concatenate(uses, axis=1))


def least_effort(reduced: ReducedDynamics) -> float:
    """Return the effort below which efforts count as zero, N or N·m: a fraction of those that f takes."""
    needed = float(np.abs(reduced.f / reduced.row_scale).max(initial=0.0))
    largest = np.linalg.norm(reduced.W / reduced.row_scale[:, None], ord=2, axis=(1, 2))
    return SMALL * needed / max(float(np.median(largest)), np.finfo(float).tiny)
