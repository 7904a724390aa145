"""A planned motion between its samples: the extremes of all limited quantities of the continuous motion.

A planner hands over one record, ``PlannedMotion``; ``intersample_check`` evaluates it. Track, speed, acceleration and
jerk of the carriers are polynomials, whose extremes are exact. Main efforts, carrier forces and rates of the main
actuators are evaluated at Chebyshev points of every piece in which platform, carriers and prescribed efforts are
smooth. Where the last coefficients of their series are not small, as near the spike that a cusp of the path makes, the
piece is halved and evaluated again. The peaks are peaks of the polynomials, both limits at every jump included. Where
det W changes its sign and no halving resolves the efforts, they are infinite.

Example:
    >>> check = intersample_check(planned)
    >>> check.violated, check.peaks.peak
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import chebyshev

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, frozen, largest, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import SINGULAR_SAMPLE, PlanFunctions, unique_times
from redundancy_pin.planners.limits import (
    LIMIT_TOLERANCE,
    QUANTITIES,
    LimitedQuantity,
    LimitEvent,
    ResolvedLimits,
    States,
    limit_events,
    motion_quantities,
    range_quantities,
)
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.singular_instant import SingularInstant
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.scales import velocity_scale
from redundancy_pin.singularities.roots import zeros
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import chebyshev_points, chebyshev_series

BALANCE_TOLERANCE = 1e-6
"""Largest imbalance W τ − f, relative to the size of f along the motion, of efforts that a planner prescribes."""

ALLOWED = 1.05
"""``IntersamplePeaks.ratio`` up to which the samples show the efforts."""

MARKED = 1.02
"""Ratio to that, or to a limit, from which a grid is refined; what exceeds a limit by less is met by lower limits at
the nodes (``IntersampleCheck.shares``)."""

LOWERED = 6
"""Rounds with lower limits at the nodes."""

SMALL = 1e-3
"""Efforts below this fraction of those that f takes count as zero here."""

PIECE_DEGREE = 5
"""Of efforts and forces in a piece, which is halved where that does not resolve them."""

RESOLVED = 1e-3
"""Last coefficients of a piece, relative to the largest value of the motion, from which it is halved."""

EXACT = 1e-6
"""The same in pieces whose values come near the largest, which decide the reported peaks."""

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

RANK_LOST = 1e-6
"""Smallest over largest singular value of the closures at which their rank counts as lost: known to 1e-8 there."""

RANGE_PARTS = 8
"""Parts of a step, at whose ends joints are evaluated that come near the end of their range there."""

_FINE = np.cos(np.linspace(np.pi, 0.0, 65))
"""Places in a piece, from −1 to 1, among which the extreme of its polynomial is sought first."""


@dataclass(frozen=True)
class Findings:
    """What a planner found and others read: ``Plan.status``, figures and the command line.

    What one planner alone reports is ``Plan.diagnostics``.

    Attributes:
        optimal: whether the optimiser reached an optimum; true where nothing was optimised.
        solver: message of the optimiser on termination; empty if nothing was optimised.
        singular_instants: times at which the motion is on a type II singularity, s.
        least_cost: least weighted objective that was found, in its unit; None if none was minimised.
        closure_rank: "time", s, and pose "x" of each rank loss of the closures along the motion.
    """

    optimal: bool = True
    solver: str = ""
    singular_instants: tuple[float, ...] = ()
    least_cost: float | None = None
    closure_rank: tuple[Mapping[str, object], ...] = ()


@dataclass(frozen=True, eq=False)
class PlannedMotion:
    """What a planner planned, by which dynamics and within which limits. N samples, m main actuators, k carriers.

    Attributes:
        dynamics: the backend that evaluates it.
        functions: platform, carriers and prescribed efforts as functions of time.
        along: the dynamics along N samples of the platform; an instant at which its acceleration jumps occurs twice.
        carriers: (N,) samples of the carriers.
        limits: what the motion must keep to.
        planner: name of the planner.
        prescribed: (N, m) main efforts the planner decided on, N or N·m; NaN where W τ = f decides. Their imbalance is
            reported, never corrected. None for none.
        singular: indices of samples at which the efforts are the limits from both sides of a type II singularity;
            ``SingularInstant`` has those that are not prescribed.
        phase: (N,) index into ``phases`` of each sample; None if there is only one phase.
        phases: names of the phases.
        chooses_timing: whether the planner chose the motion of the platform, and so the rates of the actuators.
        parameters: the planner's parameters, in plain data.
        findings: what the planner found that others read.
        diagnostics: what else it found, in plain data.
    """

    dynamics: Dynamics
    functions: PlanFunctions
    along: DynamicsAlongMotion
    carriers: CarrierMotion
    limits: ResolvedLimits
    planner: str
    prescribed: Array | None = None
    singular: IntArray | None = None
    phase: IntArray | None = None
    phases: tuple[str, ...] = ("all",)
    chooses_timing: bool = False
    parameters: Mapping[str, object] = field(default_factory=dict)
    findings: Findings = field(default_factory=Findings)
    diagnostics: Mapping[str, object] = field(default_factory=dict)

    @property
    def motion(self) -> PlatformMotion:
        """The samples of the platform."""
        return self.along.motion

    @cached_property
    def reduced(self) -> ReducedDynamics:
        """W and f at the samples, evaluated once."""
        return self.along.reduce(self.carriers)

    @cached_property
    def samples(self) -> Distribution:
        """The main efforts at the samples, prescribed or from W τ = f, with status and residual; evaluated once."""
        reduced = self.reduced
        solved = distribute(reduced)
        tau, status, residual = np.array(solved.tau), np.array(solved.status), np.array(solved.residual)
        prescribed = np.full(tau.shape, np.nan) if self.prescribed is None else np.array(self.prescribed)
        for i in () if self.singular is None else self.singular.tolist():
            if not np.isfinite(prescribed[i]).all():
                prescribed[i] = self._limit_efforts(i)
        given = np.isfinite(prescribed).all(axis=1)
        if given.any():
            tau[given] = prescribed[given]
            left, size = imbalance(reduced, tau)
            residual[given] = left[given]
            balanced = left[given] <= BALANCE_TOLERANCE * size
            fine = np.where(status[given] == SampleStatus.OUT_OF_RANGE, SampleStatus.OUT_OF_RANGE, SampleStatus.OK)
            status[given] = np.where(balanced, fine, SampleStatus.SINGULAR_INCONSISTENT)
        if self.singular is not None:  # however well W τ = f looks at one instant
            regular = self.singular[status[self.singular] == SampleStatus.OK]
            status[regular] = SampleStatus.SINGULAR_CONSISTENT
        return replace(solved, tau=read_only(tau), status=read_only(status), residual=read_only(residual))

    def _limit_efforts(self, i: int) -> Array:
        """Return the efforts (m,) that W⁻¹ f tends to at a sample on a singularity; of a jump from its own side."""
        t, functions = self.motion.t, self.functions

        def evaluate(times: Array) -> ReducedDynamics:
            return self.dynamics.along(functions.platform.sample_at(times)).reduce(functions.carriers_at(times))

        before = i + 1 < len(t) and t[i + 1] == t[i]
        instant = SingularInstant.along(evaluate, functions.pieces(t), float(t[i]), "left" if before else "right")
        return instant.efforts(None if functions.preferred is None else functions.preferred.at(float(t[i])))

    @property
    def singular_instants(self) -> Array:
        """(q,) times of the samples on a type II singularity, s."""
        t, margin = self.motion.t, self.samples.margin
        on_it = t[margin <= SINGULAR_SAMPLE * margin.max(initial=0.0)]
        return np.unique(on_it if self.singular is None else np.append(on_it, t[self.singular]))


@dataclass(frozen=True, eq=False)
class IntersamplePeaks(Frozen):
    """Largest efforts of the continuous motion of a plan, compared with its samples.

    Attributes:
        peak: (m,) largest |τ| of each main actuator, N or N·m; infinite where the efforts grow beyond all bounds.
        time: (m,) when, s.
        force_peak: (k,) largest force of each carrier's actuator, N or N·m.
        ratio: 1 + max_j (|τ_j| of the motion − |τ_j| at the samples) / max_i |τ_i| at the samples, each |τ| the
            largest of its actuator: an actuator that shows nothing at the samples and moves half the largest effort
            between them has 1.5. Efforts that are negligible against those that f takes count as equal.
    """

    peak: Array
    time: Array
    force_peak: Array
    ratio: float

    @property
    def passed(self) -> bool:
        """Whether the samples show the efforts."""
        return self.ratio <= ALLOWED


@dataclass(frozen=True, eq=False)
class IntersampleCheck:
    """What the continuous motion of a plan needs: in P pieces, c columns of efforts, forces and limited rates.

    Attributes:
        peaks: the largest efforts and forces.
        violated: limits that are exceeded, of every quantity.
        touched: limits that are met, of every quantity.
        middle: (P,) middles of the pieces, s.
        ratio: (P,) ``IntersamplePeaks.ratio`` of each piece by itself; below 1 where no effort reaches its largest.
        use: (P, c) used fractions of limits, with the columns of ``ResolvedLimits.evaluated``.
    """

    peaks: IntersamplePeaks
    violated: tuple[LimitEvent, ...]
    touched: tuple[LimitEvent, ...]
    middle: Array
    ratio: Array
    use: Array

    @property
    def within_limits(self) -> bool:
        """Whether efforts, forces and rates keep their limits wherever they are finite."""
        return not (self.use[np.isfinite(self.use)] > 1.0 + LIMIT_TOLERANCE).any()

    @property
    def passed(self) -> bool:
        """Whether the samples show the efforts, and efforts, forces and rates keep their limits between them."""
        return self.peaks.passed and self.within_limits

    @property
    def worst(self) -> Array:
        """(P,) the larger of ratio and use."""
        return np.asarray(np.maximum(self.ratio, self.use.max(axis=1, initial=0.0)))

    @property
    def exceeding(self) -> BoolArray:
        """(P,) where a limit of efforts, forces or rates is exceeded."""
        return np.asarray((self.use > 1.0 + LIMIT_TOLERANCE).any(axis=1))

    def too_coarse(self, before: Sequence[float]) -> BoolArray:
        """Return (P,) where a finer grid is needed rather than lower limits at its nodes.

        ``before``: the largest ``worst`` of this check and of those before; lower limits that took off less than half
        of the excess are not enough.
        """
        coarse: BoolArray = self.worst > MARKED
        stuck = len(before) > 1 and before[-1] - 1.0 > 0.5 * (before[-2] - 1.0)
        return self.exceeding if stuck and not coarse.any() else coarse

    def shares(self, t: Array, before: Array | None) -> Array:
        """Return (M, c) fractions of their limits that nodes at (M,) times, s, may use so that none is exceeded inside.

        ``before``: those with which this motion was planned, if there were any.
        """
        needed = np.ones((len(t) + 1, self.use.shape[1]))
        over = np.where(self.use > 1.0 + LIMIT_TOLERANCE, 1.0 / np.maximum(self.use, 1.0), 1.0)
        np.minimum.at(needed, np.searchsorted(t, self.middle, side="right"), over)
        shares: Array = np.minimum(needed[:-1], needed[1:])
        return shares if before is None else shares * before


def intersample_check(planned: PlannedMotion) -> IntersampleCheck:
    """Evaluate the continuous motion of a plan between its samples, and compare it with its limits.

    Args:
        planned: the motion, its dynamics and its limits.

    Returns:
        Peaks of efforts and forces to 0.1 % or better, and the limits that are exceeded or touched: of efforts, forces,
        actuator rates, track, speed, acceleration and jerk of carriers, and ranges of joints.

    Raises:
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``Dynamics.along``.
    """
    robot, limits, samples = planned.dynamics.robot, planned.limits, planned.samples
    t, m, k = planned.motion.t, robot.m, robot.k
    pieces = extremes_between(
        planned.dynamics,
        planned.functions,
        float(t[0]),
        float(t[-1]),
        planned.singular_instants,
        limits,
    )
    time, value = _with_samples(pieces, t, np.concatenate([samples.tau, planned.reduced.carrier_force], axis=1))
    size = np.abs(value)
    at_samples = largest(samples.tau[np.isfinite(samples.tau).all(axis=1)])
    unit = max(float(at_samples.max(initial=0.0)), least_effort(planned.reduced)) or 1.0
    ratio = 1.0 + (size[:, :m] - at_samples).max(axis=1, initial=-np.inf) / unit
    worst = size.argmax(axis=0)
    peaks = IntersamplePeaks(
        peak=frozen(size.max(axis=0)[:m]),
        time=frozen(time[worst, range(len(worst))][:m]),
        force_peak=frozen(size.max(axis=0)[m : m + k]),
        ratio=float(ratio.max(initial=1.0)),
    )
    columns = limits.evaluated()
    rows, first = [], 0
    for key, joints in columns.items():
        quantity, limit = QUANTITIES[key], limits.of(key)[joints]
        names = tuple(getattr(robot, quantity.owner)[j] for j in joints)
        own = slice(first, first + len(joints))
        rows.append(LimitedQuantity(quantity.name, names, time[:, own], value[:, own], -limit, limit))
        first += len(joints)
    rows += [*motion_quantities(limits, planned.functions.carriers, t), *joint_ranges_of(planned)]
    violated, touched = limit_events(rows)
    with np.errstate(invalid="ignore"):  # infinite efforts without a limit
        bounds = np.concatenate([limits.of(key)[joints] for key, joints in columns.items()])
        use = np.nan_to_num(size / bounds, nan=0.0, posinf=np.inf)
    # without the columns of what the planner cannot change, which come last
    use = use[:, : sum(len(joints) for joints in limits.evaluated(planned.chooses_timing).values())]
    return IntersampleCheck(
        peaks=peaks,
        violated=violated,
        touched=touched,
        middle=pieces.ends.mean(axis=1),
        ratio=ratio,
        use=use,
    )


def _with_samples(pieces: PieceExtremes, t: Array, loads: Array) -> tuple[Array, Array]:
    """Return (P, c) times and values of the extremes of pieces, the values at the samples included.

    ``t`` (N,) times of the samples, s; ``loads`` (N, m + k) their efforts and forces, which polynomials of the pieces
    do not hold at singular instants.
    """
    time, value = np.array(pieces.time), np.array(pieces.value)
    inside = np.searchsorted(pieces.ends[1:, 0], t, side="right")
    size = np.where(np.isfinite(loads), np.abs(loads), 0.0)
    for j in range(loads.shape[1]):
        order = np.argsort(size[:, j], kind="stable")  # of several samples in a piece the largest is written last
        larger = order[size[order, j] > np.abs(value[inside[order], j])]
        value[inside[larger], j], time[inside[larger], j] = loads[larger, j], t[larger]
    return time, value


def imbalance(reduced: ReducedDynamics, tau: Array) -> tuple[Array, float]:
    """Return (N,) |W τ − f| for efforts (N, m), N, moments over the characteristic length; and the largest f."""
    left = (np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f) / reduced.row_scale
    return np.linalg.norm(left, axis=1), float(np.abs(reduced.f / reduced.row_scale).max(initial=0.0))


def least_effort(reduced: ReducedDynamics) -> float:
    """Return the effort below which efforts count as zero, N or N·m: a fraction of those that f takes."""
    needed = float(np.abs(reduced.f / reduced.row_scale).max(initial=0.0))
    amplification = np.linalg.norm(reduced.W / reduced.row_scale[:, None], ord=2, axis=(1, 2))
    return SMALL * needed / max(float(np.median(amplification)), np.finfo(float).tiny)


# --- efforts, forces and rates ---


@dataclass(frozen=True, eq=False)
class PieceExtremes:
    """The extremes of main efforts, carrier forces and limited rates in each of P pieces; c columns of these.

    ``ends`` (P, 2) of the pieces, s; ``time`` (P, c) of the extremes, s; ``value`` (P, c) their signed
    values, N or N·m, m/s or rad/s, infinite if unbounded.
    """

    ends: Array
    time: Array
    value: Array


def extremes_between(
    dynamics: Dynamics,
    functions: PlanFunctions,
    start: float,
    end: float,
    singular: Array | None = None,
    limits: ResolvedLimits | None = None,
) -> PieceExtremes:
    """Return the extremes of efforts, forces and other limited quantities in pieces from ``start`` to ``end``, s.

    ``singular`` (q,) instants at which W lacks rank and the efforts are finite all the same, s: near them W⁻¹ f
    magnifies rounding, so pieces that end there are not halved towards them; ``limits``: which quantities have columns
    (``ResolvedLimits.evaluated``); efforts and forces alone when left out.
    """
    limits = Limits(effort=np.inf, actuator_speed=np.inf).resolved(dynamics.robot) if limits is None else limits
    fixed = np.empty(0) if singular is None else np.asarray(singular)
    edges = _edges(functions, start, end, fixed)
    ends = np.stack([edges[:-1], edges[1:]], axis=1)
    at_singularity = np.isin(ends, fixed).any(axis=1)
    scale = None
    found: list[tuple[Array, ...]] = []
    for halving in range(HALVINGS + 1):
        reduced, values = _values(dynamics, functions, ends, limits)
        scale = _Scale.of(dynamics.robot, reduced, values, limits) if scale is None else scale
        finite = np.asarray(np.isfinite(values).all(axis=(1, 2)))
        series = chebyshev_series(np.where(finite[:, None, None], values, 0.0))
        settled = np.asarray((finite & scale.resolves(series, values)) | at_singularity)
        if halving == HALVINGS:
            pole = _poles(dynamics, functions, ends, values, ~settled & finite, scale)
            values[pole, :, : dynamics.robot.m] = np.inf
            finite[pole] = False
            settled[:] = True
        found.append((ends[settled], *_extremes(ends[settled], series[settled], values[settled], finite[settled])))
        if settled.all():
            break
        rough = ends[~settled]
        halves = np.insert(rough, 1, rough.mean(axis=1), axis=1)
        ends = np.concatenate([halves[:, :2], halves[:, 1:]])
        ends = ends[np.argsort(ends[:, 0])]
        at_singularity = np.zeros(len(ends), dtype=bool)
    parts = [np.concatenate(part) for part in zip(*found, strict=True)]
    order = np.argsort(parts[0][:, 0])
    pieces, time, value = (part[order] for part in parts)
    return PieceExtremes(pieces, time, value)


@dataclass(frozen=True, eq=False)
class _Scale:
    """Sizes (c,) of efforts, forces and limited rates along a motion, and of their rounding."""

    size: Array
    rounding: Array

    @staticmethod
    def of(robot: Robot, reduced: ReducedDynamics, values: Array, limits: ResolvedLimits) -> _Scale:
        """Return the scale of (P, d, c) values."""
        size = np.abs(values).max(axis=(0, 1), initial=0.0, where=np.isfinite(values))
        loads = robot.m + robot.k
        limited = np.concatenate([limits.of(key)[joints] for key, joints in limits.evaluated().items()])[loads:]
        size[loads:] = np.maximum(size[loads:], SMALL * limited)  # an actuator at rest has a rate of rounding errors
        rounding = np.zeros(len(size))
        if reduced.force_size is not None:
            arms = np.concatenate([reduced.column_scale, velocity_scale(robot)[robot.carrier_velocity]])
            rounding[:loads] = ROUNDING * float(reduced.force_size.max(initial=0.0)) * arms
        return _Scale(size, rounding)

    def resolves(self, series: Array, values: Array) -> BoolArray:
        """Return (P,) whether Chebyshev series (P, d, c) of the values (P, d, c) resolve them."""
        share = np.where(np.abs(values).max(axis=1) > NEAR_PEAK * self.size, EXACT, RESOLVED)
        allowed = np.maximum(share * np.maximum(self.size, np.finfo(float).tiny), self.rounding)
        return np.asarray((np.abs(series[:, -2:]).max(axis=1) <= allowed).all(axis=1))


def _poles(
    dynamics: Dynamics, functions: PlanFunctions, ends: Array, values: Array, unsettled: BoolArray, scale: _Scale
) -> IntArray:
    """Return the indices of unsettled pieces in which the main efforts have a pole.

    A pole grows with every halving, and det W of a square W changes its sign there; at a spike that ends it does not.
    """
    main = slice(dynamics.robot.m)
    grown = (np.abs(values[:, :, main]).max(axis=1) > GROWN * scale.size[main]).any(axis=1)
    candidates = np.flatnonzero(unsettled & grown)
    if not len(candidates) or dynamics.robot.n != dynamics.robot.m:
        return candidates[:0]
    times = ends[candidates].ravel()
    W = dynamics.along(functions.platform.sample_at(times)).reduce(functions.carriers_at(times)).W
    sides = np.linalg.slogdet(W)[0].reshape(-1, 2)
    poles: IntArray = candidates[sides.prod(axis=1) <= 0.0]
    return poles


def _edges(functions: PlanFunctions, start: float, end: float, singular: Array) -> Array:
    platform = functions.platform
    pieces = (functions.carriers, *functions.prescribed)
    inner = np.concatenate([platform.kinks, singular, *(part.edges for part in pieces)])
    even = np.linspace(start, end, FEWEST_PIECES + 1)
    times = np.concatenate([[start, end], inner[(inner > start) & (inner < end)]])
    if len(np.unique(times)) <= FEWEST_PIECES:
        times = np.concatenate([times, even])
    edges = unique_times(times)
    # an edge that differs from a singular instant by rounding only is moved onto it
    near = np.abs(edges[:, None] - singular).argmin(axis=0) if len(singular) else np.empty(0, dtype=int)
    edges[near] = singular
    return edges


def _values(
    dynamics: Dynamics, functions: PlanFunctions, ends: Array, limits: ResolvedLimits
) -> tuple[ReducedDynamics, Array]:
    """Return the dynamics at the Chebyshev points of pieces with (P, 2) ends, s, and their values (P, d, c).

    Columns as in ``ResolvedLimits.evaluated``; NaN without efforts.
    """
    times = chebyshev_points(ends[:, 0], ends[:, 1], PIECE_DEGREE)
    motion, carriers = functions.platform.sample_at(times), functions.carriers_at(times)
    reduced = dynamics.along(motion).reduce(carriers)
    rate: Array = np.einsum("nim,ni->nm", reduced.W, motion.xd)
    states = States(functions.efforts(reduced), rate, reduced.carrier_force, carriers.s, carriers.sd, carriers.sdd)
    values = []
    for key, joints in limits.evaluated().items():
        values.append(np.asarray(QUANTITIES[key].values(states))[:, joints])
    return reduced, np.concatenate(values, axis=1).reshape(len(ends), PIECE_DEGREE + 1, -1)


def _extremes(ends: Array, series: Array, values: Array, finite: BoolArray) -> tuple[Array, Array]:
    """Return (P, c) times and signed values of the extremes of polynomials; a polynomial with the largest is exact."""
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


# --- motions of carriers and joints ---


def joint_ranges_of(planned: PlannedMotion) -> tuple[LimitedQuantity, ...]:
    """Return the positions of joints that have a range, passive ones too, at the samples and between them."""
    along, platform, robot = planned.along, planned.functions.platform, planned.dynamics.robot
    joints = joint_ranges(robot)
    if not joints:
        return ()
    if along.q is None or along.gamma is None:  # of a closed form, which knows no passive joints
        with warnings.catch_warnings():  # a note that another backend takes longer does not concern this one
            warnings.simplefilter("ignore", RuntimeWarning)
            along = as_dynamics(robot).along(planned.motion, unreachable="mark")
    t, q, gamma = planned.motion.t, along.q, along.gamma
    if q is None or gamma is None:
        raise ValueError("The default backend has no tree.")
    known = np.flatnonzero(np.isfinite(q).all(axis=1))
    if len(known) > 1:
        at, near = t[known], np.zeros(len(known) - 1, dtype=bool)
        for joint in joints:
            beyond, step = joint.excess(q[known, joint.at], True), np.abs(np.diff(q[known, joint.at]))
            near |= np.maximum(beyond[:-1], beyond[1:]) > -step
        near &= np.diff(at) > 0.0
        bounds = np.flatnonzero(np.diff(near, prepend=False, append=False)).reshape(-1, 2)
        for first, last in bounds:  # each run of steps from the sample before it
            own, parts = at[first : last + 1], np.arange(1, RANGE_PARTS) / RANGE_PARTS
            inside = (own[:-1, None] + np.diff(own)[:, None] * parts).ravel()
            times = np.sort(np.concatenate([own[1:], inside]))
            sample = known[first]
            start = follower(robot).state_at(q[sample], planned.motion.x[sample], gamma[sample])
            between = inverse_kinematics(robot, platform.sample_at(times), mark_unreachable=True, start=start)
            new = np.isin(times, inside)
            t, q = np.append(t, times[new]), np.append(q, between.q[new], axis=0)
        order = np.argsort(t, kind="stable")
        t, q = t[order], q[order]
    return range_quantities(robot, t, q)


def closure_rank_losses(
    dynamics: Dynamics, along: DynamicsAlongMotion, platform: Motion
) -> tuple[Mapping[str, object], ...]:
    """Return "time", s, and pose "x" of each rank loss of the closures on the way: the branch is carried across it.

    ``along``: dynamics along samples of the platform's motion. Only where these show a rank loss are more needed.
    """
    t, first = np.unique(along.motion.t, return_index=True)
    known, chain = along.closure_margin()[first], ClosedChain(dynamics.robot)

    def followed(times: Array) -> tuple[DynamicsAlongMotion, IntArray]:
        every = np.union1d(t, times)  # the branch is followed from the start
        return dynamics.along(platform.sample_at(every), unreachable="mark"), np.searchsorted(every, times)

    def margin(times: Array) -> Array:
        if times is t:
            return known
        there, at = followed(times)
        return there.closure_margin()[at]

    def rank_is_kept(time: float) -> bool:
        """Return whether the rows in use alone lose rank, which the sign of their determinant does not show."""
        there, at = followed(np.array([time]))
        if there.q is None or not np.isfinite(there.q[at]).all():
            return False
        chain.place(there.q[at][0])
        return chain.dependent_rows_restore_rank()

    roots = [zero.t for zero in zeros(margin, t, RANK_LOST)] if len(t) > 1 else []
    if chain.system.has_dependent_rows:
        roots = [time for time in roots if not rank_is_kept(time)]
    return tuple({"time": time, "x": platform.sample_at(np.array([time])).x[0].tolist()} for time in roots)
