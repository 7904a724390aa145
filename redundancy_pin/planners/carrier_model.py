"""What planners read off a backend along a motion: W as a function of time, and how f depends on the carriers.

A carrier on a straight track of its link has its centre at r = r₀ + s u. Its acceleration is r̈₀ + s ü + 2 ṡ u̇ + s̈ u,
its velocity per unit of ẋ is J₀ + s J_u. With J_uᵀ u = 0 its share of f is a combination of s, s², ṡ, s ṡ and s̈:
quadratic in (s, ṡ), affine in s̈, and carriers do not mix. The same holds for its own force. The coefficients, which
depend on time alone, are read off a backend in a fixed number of evaluations, so they are exact for whatever backend it
is; as functions of time they are interpolated to machine precision: root finding and integration need no more calls.

The centre of a carrier that turns is r₀ + a cos s + b sin s, and its axes rotate likewise. f contains products of at
most two of these: a combination of 1, cos s, sin s, cos 2s and sin 2s, of the same with ṡ, with ṡ² and with s̈.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, Literal, TypeGuard, cast, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, IntArray, checked, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, terms_along
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.singularities.roots import Interval, below_zero, minima, zeros
from redundancy_pin.spectrum import scaled, spectrum_of
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Measure = Literal["condition", "margin"]

W_TOLERANCE = 1e-11
"""Of the interpolated W, relative to its largest entry: the times of a window are then exact to about 1e-11 of it."""

SAMPLED_TOLERANCE = 1e-9
"""Tolerance of interpolation along a sampled motion: the quintics between samples a few milliseconds apart have kinks
below this, and resolving every one of them would be of no use."""

SAMPLES_A_PIECE = 33
"""A piece is a polynomial of degree 15: its singular values have few dips, and a dip shows in the adjacent samples."""

LARGEST_CONDITION = 1e6
"""Beyond it the times at which W reaches a threshold are lost in the rounding of W."""

ZERO_SINGULAR_VALUE = 1e-9
"""A smallest singular value below this fraction of the largest along the motion is zero."""


@dataclass(frozen=True, eq=False)
class Actuation:
    """W (n, m) as a function of time.

    ``interpolant``: its entries, row by row; ``row_scale``, ``column_scale`` (n,) and (m,) what forces and efforts are
    measured in.
    """

    interpolant: PiecewisePolynomial
    row_scale: Array
    column_scale: Array

    @staticmethod
    def along(dynamics: Dynamics, motion: Motion) -> Actuation:
        """Read W off a backend along a whole motion."""

        def values(times: Array) -> Array:
            return np.asarray(dynamics.along(motion.sample_at(times)).reduce().W).reshape(len(times), -1)

        def scale(values: Array) -> Array:
            return np.full(values.shape[1], np.abs(values).max())

        sample = dynamics.along(motion.sample_at(np.array([motion.start]))).reduce()
        tolerance = W_TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        edges = smooth_edges(motion, motion.start, motion.end)
        entries = PiecewisePolynomial.fit(values, edges, motion.knots, scale, tolerance)
        return Actuation(entries, sample.row_scale, sample.column_scale)

    def at(self, times: Array) -> Array:
        """Return W (N, n, m) at (N,) times."""
        return self.interpolant(times).reshape(len(times), len(self.row_scale), len(self.column_scale))

    @cached_property
    def _times(self) -> Array:
        return dense(self.interpolant.edges)

    def singular_values(self, times: Array) -> Array:
        """Return (N, min(n, m)) singular values of the scaled W, the largest first."""
        return spectrum_of(scaled(self.at(times), self.row_scale, self.column_scale)).singular_values

    def windows(self, measure: Measure, threshold: float) -> list[Interval]:
        """Return the intervals in which W is nearer to singular than a threshold.

        ``measure``: "condition": where the condition number of the scaled W exceeds the threshold (of the Jacobian
        for the 2-RPR, Parsa 2014, section 3.2); "margin": where its smallest singular value is below it; ``threshold``:
        for the condition number above 1, for the margin positive.
        """
        if measure not in get_args(Measure):
            raise InputError(f"measure is {measure!r}.", remedy="Pass 'condition' or 'margin'.", measure=measure)
        lower, upper = (1.0, LARGEST_CONDITION) if measure == "condition" else (0.0, np.inf)
        if not lower < threshold < upper:
            raise InputError(
                f"threshold is {threshold}, but a {measure} between {lower:g} and {upper:g} is needed.",
                remedy="The thesis works with condition numbers from 4 to 20.",
                threshold=threshold,
            )
        least = 1.0 / threshold if measure == "condition" else threshold
        return below_zero(lambda times: self._nearness(times, measure) - least, self._times)

    def worst(self, measure: Measure) -> float:
        """Return the largest condition number (infinite at a singularity), or the smallest margin, along the motion."""
        if measure == "condition" and self.singular_instants:
            return float("inf")
        lowest = min(value for _, value in minima(lambda t: self._nearness(t, measure), self._times, np.inf))
        if measure == "margin":
            return lowest
        return 1.0 / lowest if lowest > ZERO_SINGULAR_VALUE else float("inf")

    @cached_property
    def singular_instants(self) -> tuple[float, ...]:
        """The times, s, at which the motion crosses or touches a type II singularity."""

        def signed(times: Array) -> Array:
            W = self.at(times)
            sign = np.sign(np.linalg.det(W)) if W.shape[1] == W.shape[2] else 1.0
            return np.asarray(self._nearness(times, "condition") * sign)

        return tuple(zero.t for zero in zeros(signed, self._times, ZERO_SINGULAR_VALUE))

    def _nearness(self, times: Array, measure: Measure) -> Array:
        """Return σ_min/σ_max, or σ_min: continuous also at a singularity, where a condition number is not."""
        values = self.singular_values(times)
        return values[:, -1] / values[:, 0] if measure == "condition" else values[:, -1]


def smooth_edges(motion: Motion, start: float, end: float) -> Array:
    """Return (P + 1,) ends of pieces to fit a function along a motion on: jumps, and the few kinks of a trajectory."""
    return np.concatenate([[start], motion.kinks[(motion.kinks > start) & (motion.kinks < end)], [end]])


def dense(edges: Array) -> Array:
    """Return times that sample every piece densely, s; ``edges`` (P + 1,) are the ends of the pieces."""
    fraction = np.linspace(0.0, 1.0, SAMPLES_A_PIECE)[:-1]
    return np.append((edges[:-1, None] + np.diff(edges)[:, None] * fraction).ravel(), edges[-1])


_WAVES = ("cos_s", "sin_s", "cos_2s", "sin_2s")

TERM_NAMES = (
    *("s", "s_s", "sd", "s_sd", "sdd", "sd_sd"),
    *_WAVES,
    *(f"{rate}_{wave}" for rate in ("sd", "sd_sd", "sdd") for wave in _WAVES),
)
"""Products of s, ṡ, s̈ and of waves of s that f may have, in the order of ``terms``; cos_s is cos s − 1."""

SLIDING_TERMS = [TERM_NAMES.index(name) for name in ("s", "s_s", "sd", "s_sd", "sdd")]
"""Places of the terms of a carrier on a straight track."""

TURNING_TERMS = [place for place, name in enumerate(TERM_NAMES) if name not in ("s_s", "s_sd")]
"""Places of the terms of a carrier that turns."""

TERMS, SDD = len(SLIDING_TERMS), TERM_NAMES.index("sdd")

OTHER_TERMS = 1e-8
"""Deviation of the terms from the backend at a random carrier motion, relative to f, from which f has other terms."""


@dataclass(frozen=True, eq=False)
class CarrierModel:
    """Coefficients of f and of the carrier forces at N instants.

    N samples, n independent coordinates, m main actuators, k carriers; last axis: s, s², ṡ, s ṡ, s̈, or as many of
    ``terms`` as there are.

    ``t`` (N,) time, s; ``W`` (N, n, m) actuation matrix; ``f0`` (N, n) f with the carriers at rest at s = 0, N and N·m;
    ``f_terms`` (N, n, k, 5) coefficients of f, by carrier and term; ``force0`` (N, k) carrier forces with the carriers
    at rest at s = 0, N; ``force_terms`` (N, k, 5) coefficients of each carrier's force in its own motion.
    """

    t: Array
    W: Array
    f0: Array
    f_terms: Array
    force0: Array
    force_terms: Array

    @property
    def k(self) -> int:
        """Number of carriers."""
        return int(self.f_terms.shape[2])

    def __getitem__(self, index: slice | IntArray) -> CarrierModel:
        """Return the model at some of the instants."""
        return CarrierModel(*(getattr(self, field.name)[index] for field in fields(self)))

    def f(self, s: Array, sd: Array, sdd: Array) -> Array:
        """Return f (N, n) for a carrier motion, each (N, k)."""
        return self._sum("nikj,nkj->ni", self.f0, self.f_terms, s, sd, sdd)

    def slopes(self, s: Array, sd: Array) -> tuple[Array, Array, Array]:
        """Return the derivatives (N, n, k) of f by s, ṡ and s̈ at carriers (N, k)."""
        by_s, by_s2, by_sd, by_ssd, by_sdd = np.moveaxis(self.f_terms, -1, 0)
        s, sd = s[:, None], sd[:, None]
        return by_s + 2.0 * by_s2 * s + by_ssd * sd, by_sd + by_ssd * s, by_sdd

    def carrier_force(self, s: Array, sd: Array, sdd: Array) -> Array:
        """Return the carrier forces (N, k) for a carrier motion, each (N, k)."""
        return self._sum("nkj,nkj->nk", self.force0, self.force_terms, s, sd, sdd)

    @staticmethod
    def _sum(over: str, first: Array, coefficients: Array, *motion: Array) -> Array:
        s, sd, sdd = motion
        by_term = np.stack(terms(s, sd, sdd, coefficients.shape[-1], np), axis=-1)
        value: Array = first + np.einsum(over, coefficients, by_term)
        return value


def terms(s: Any, sd: Any, sdd: Any, count: int, library: Any) -> list[Any]:
    """Return the first terms of a carrier motion, arrays of numpy or expressions of another ``library``.

    Five on straight tracks. Carriers that turn have ṡ² too, and cos s − 1, sin s, cos 2s − 1 and sin 2s, the same with
    ṡ, with ṡ² and with s̈.
    """
    first = [s, s * s, sd, s * sd, sdd, sd * sd]
    if count <= len(first):
        return first[:count]
    waves = [wave for i in (1.0, 2.0) for wave in (library.cos(i * s) - 1.0, library.sin(i * s))]
    return [*first, *waves, *(rate * wave for rate in (sd, sd * sd, sdd) for wave in waves)]


MASSLESS = 1e-12
"""A carrier with less than this fraction of the largest mass and inertia of the robot has none."""


def require_carriers(robot: Robot) -> None:
    """Check that there are carriers, and that moving them does something: each moves a mass, or an inertia."""
    if robot.k == 0:
        raise UnsupportedRobotError(
            f"{robot.name} has no carriers to plan for.", remedy="Load it with carriers, or declare some."
        )
    bodies = np.abs([body.toDynamicParameters() for body in robot.model.inertias])
    massless = []
    for name in robot.carriers:
        moved = bodies[list(robot.model.subtrees[find_joint_index(robot.model, name)])]
        if (moved.max(axis=0) <= MASSLESS * bodies.max(axis=0)).all():
            massless.append(name)
    if massless:
        several = len(massless) > 1
        raise UnsupportedRobotError(
            f"{', '.join(massless)} of {robot.name} {'have' if several else 'has'} no mass: moving "
            f"{'them' if several else 'it'} changes no effort, so there is nothing to plan.",
            remedy="Give every carrier a mass, or load the robot without carriers and use inverse dynamics.",
            carriers=tuple(massless),
        )


def carrier_model(along: DynamicsAlongMotion, *, turning: bool = False, check: bool = True) -> CarrierModel:
    """Read the coefficients off a backend along a platform motion.

    Args:
        along: the dynamics along the motion.
        turning: whether some carriers turn; f then has all terms of ``TERM_NAMES``, otherwise only the sliding ones.
        check: whether to look that there are carriers, and that f has no other terms. Of a robot without carriers the
            model is W and f.

    Raises:
        UnsupportedRobotError: no carriers; f has other terms, as where a carrier carries another.
    """
    robot = along.robot
    if check:
        require_carriers(robot)
    if turning:
        W, *parts = _turning_terms(along)
    else:
        W, constant, by_carrier = terms_along(along)
        n, own = robot.n, np.arange(robot.k)
        f_terms, force_terms = by_carrier[..., :n].transpose(0, 3, 1, 2), by_carrier[:, own, :, n + own]
        parts = [constant[:, :n], f_terms, constant[:, n:], force_terms.transpose(1, 0, 2)]
    model = CarrierModel(along.motion.t, W, *(read_only(np.ascontiguousarray(part)) for part in parts))
    if check:
        _require_no_other_terms(along, model)
    return model


def _turning_terms(along: DynamicsAlongMotion) -> tuple[Array, Array, Array, Array, Array]:
    """Return W and the coefficients where some carriers turn, from exact derivatives at ten motions of the carriers."""
    robot, samples, count = along.robot, len(along.motion), len(TERM_NAMES)
    parked = along.reduce(CarrierMotion.parked(samples, robot.k))
    # five angles separate the harmonics, and two rates the terms in ṡ and in ṡ²
    at = np.stack([np.tile(0.4 * np.pi * np.arange(5), 2), np.repeat([0.0, 1.0], 5), np.zeros(10)])
    read = [along.carrier_derivatives(CarrierMotion(*(np.full((samples, robot.k), x) for x in one))) for one in at.T]
    by_f, by_force = (
        np.concatenate([[getattr(one, f"{name}_{rate}") for one in read] for rate in ("s", "sd", "sdd")])
        for name in ("f", "force")
    )
    # derivatives of the terms themselves by s, ṡ and s̈: complex steps, which are exact
    steps = (at + 1e-20j * unit[:, None] for unit in np.eye(3))
    slopes = np.concatenate([np.imag(terms(s, sd, sdd, count, np)).T / 1e-20 for s, sd, sdd in steps])
    f_terms, force_terms = np.zeros((samples, robot.n, robot.k, count)), np.zeros((samples, robot.k, count))
    for i, turning in enumerate(turning_velocities(robot)[robot.carrier_velocity]):
        places = TURNING_TERMS if turning else SLIDING_TERMS
        inverse = np.linalg.pinv(slopes[:, places])
        f_terms[:, :, i, places] = np.einsum("jr,rni->nij", inverse, by_f[..., i])
        force_terms[:, i, places] = np.einsum("jr,rn->nj", inverse, by_force[..., i, i])
    return parked.W, parked.f, f_terms, parked.carrier_force, force_terms


def turns(robot: Robot) -> bool:
    """Return whether any carrier turns."""
    return bool(turning_velocities(robot)[robot.carrier_velocity].any())


def has_other_terms(along: DynamicsAlongMotion) -> bool:
    """Return whether f has terms other than those for independent carriers that slide or turn."""
    model = carrier_model(along, turning=turns(along.robot), check=False)
    return _deviation(along, model) > OTHER_TERMS


def _deviation(along: DynamicsAlongMotion, model: CarrierModel) -> float:
    """Return by how much f and forces deviate from the backend at one random carrier motion, relative to theirs."""
    rng = np.random.default_rng(5)
    s, sd, sdd = (rng.uniform(-1.0, 1.0, (len(model.t), model.k)) for _ in range(3))
    reduced = along.reduce(CarrierMotion(s, sd, sdd))
    deviations = [0.0]
    for ours, theirs in ((model.f(s, sd, sdd), reduced.f), (model.carrier_force(s, sd, sdd), reduced.carrier_force)):
        size = float(np.nanmax(np.abs(theirs), initial=1e-9))
        deviations.append(float(np.nanmax(np.abs(ours - theirs), initial=0.0)) / size)
    return max(deviations)


def _require_no_other_terms(along: DynamicsAlongMotion, model: CarrierModel) -> None:
    deviation = _deviation(along, model)
    if deviation > OTHER_TERMS:
        how = "slide or turn" if model.f_terms.shape[-1] > TERMS else "slide"
        raise UnsupportedRobotError(
            f"f of {along.robot.name} deviates by {deviation:.2g} of its size from the terms of carriers that {how}, "
            "each on a link of its own.",
            remedy="This planner needs prismatic carriers, each on a link of its own.",
            deviation=deviation,
        )


@dataclass(frozen=True, eq=False)
class EffortModel:
    """Coefficients of the main efforts at N instants.

    N samples, m main actuators, k carriers; last axis of ``tau_terms``: s, s², ṡ, s ṡ, s̈.

    ``t`` (N,) time, s; ``tau0`` (N, m) efforts with the carriers at rest at s = 0, N or N·m; ``tau_terms`` (N, m, k, 5)
    coefficients, by carrier and term.
    """

    t: Array
    tau0: Array
    tau_terms: Array


def effort_model(along: DynamicsAlongMotion, least_margin: float) -> EffortModel:
    """Read the coefficients of the main efforts off a backend.

    With more actuators than degrees of freedom the efforts have least norm, as ``distribute`` defines it: they too are
    linear in f.

    ``least_margin`` is the smallest margin of W along the motion that is accepted.
    """
    robot = along.robot
    if robot.k > robot.m or robot.m < robot.n:
        message = (
            f"{robot.name} has {robot.n} freedoms, {robot.m} main actuators and {robot.k} carriers; the carriers of "
            "least effort are not determined."
        )
        remedy = "This planner needs at least as many main actuators as freedoms and as carriers."
        raise UnsupportedRobotError(message, remedy=remedy, n=robot.n, m=robot.m, k=robot.k)
    model, parked = carrier_model(along), along.reduce()
    W = scaled(parked.W, parked.row_scale, parked.column_scale)
    _require_regular(model, spectrum_of(W).singular_values[:, -1], least_margin)
    inverse = parked.column_scale[:, None] * np.linalg.pinv(W) / parked.row_scale
    tau0, tau_terms = np.einsum("nmi,ni->nm", inverse, model.f0), np.einsum("nmi,nikj->nmkj", inverse, model.f_terms)
    return EffortModel(model.t, read_only(tau0), read_only(tau_terms))


def _require_regular(model: CarrierModel, margin: Array, least_margin: float) -> None:
    worst = int(np.argmin(margin))
    if margin[worst] < least_margin:
        raise _singular(
            f"comes too close to a type II singularity: at t = {model.t[worst]:.6g} s the margin of W is "
            f"{margin[worst]:.3g}, below {least_margin:.3g}; this planner needs W⁻¹ at every sample.",
            float(model.t[worst]),
            float(margin[worst]),
        )
    if model.W.shape[1] == model.W.shape[2]:
        side = np.sign(np.linalg.det(model.W))
        for j in np.flatnonzero(side[1:] != side[:-1])[:1].tolist():
            raise _singular(
                f"crosses a type II singularity between t = {model.t[j]:.6g} and {model.t[j + 1]:.6g} s "
                f"(margins {margin[j]:.3g} and {margin[j + 1]:.3g}).",
                float(model.t[j]),
                0.0,
            )


def _singular(what: str, t: float, margin: float) -> InfeasiblePlanError:
    remedy = (
        "Plan with plan_whole_trajectory, which crosses it within the limits where carriers can, or with "
        "plan_switch_off; or lead the platform along another path."
    )
    return InfeasiblePlanError(f"The motion {what}", remedy=remedy, constraint="margin", time=t, margin=margin)


COEFFICIENT_TOLERANCE = 1e-12
"""Of each group of coefficients, relative to its largest entry."""

_LEAST_GROUP = 1e-4
"""A group smaller than this fraction of the largest uses the tolerance for this size: the rounding of a backend
does not shrink with the group."""


@dataclass(frozen=True, eq=False)
class TimedModel:
    """The carrier model as a function of time.

    ``breaks`` (b,) inner times at which f may jump, s; ``knots`` (c,) further ends of the pieces, s; ``interpolant``:
    all coefficients side by side; ``tolerance``: of the coefficients, relative; ``shapes``: of W, f0, f_terms, force0
    and force_terms at one instant.
    """

    breaks: Array
    knots: Array
    interpolant: PiecewisePolynomial
    tolerance: float
    shapes: tuple[tuple[int, ...], ...]

    @staticmethod
    def of(dynamics: Dynamics, motion: Motion, start: float, end: float) -> TimedModel:
        """Read the model off a backend over a part of a motion."""
        n, m, k = dynamics.robot.n, dynamics.robot.m, dynamics.robot.k
        shapes = ((n, m), (n,), (n, k, TERMS), (k,), (k, TERMS))
        terms = np.arange(TERMS)
        units = (np.array(0), np.array(1), 2 + terms, np.array(2 + TERMS), 3 + TERMS + terms)
        # coefficients of one unit have one tolerance
        group = np.concatenate([np.broadcast_to(u, shape).ravel() for u, shape in zip(units, shapes, strict=True)])

        def values(times: Array) -> Array:
            model = carrier_model(dynamics.along(motion.sample_at(times)))
            parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
            return np.concatenate([np.asarray(part).reshape(len(times), -1) for part in parts], axis=1)

        def scale(values: Array) -> Array:
            largest = np.array([np.abs(values[:, group == g]).max() for g in range(group.max() + 1)])
            limited: Array = np.maximum(largest, _LEAST_GROUP * largest.max())[group]
            return limited

        tolerance = COEFFICIENT_TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        interpolant = PiecewisePolynomial.fit(values, smooth_edges(motion, start, end), motion.knots, scale, tolerance)
        inner = motion.breaks[(motion.breaks > start) & (motion.breaks < end)]
        knots = np.setdiff1d(interpolant.edges[1:-1], inner)
        return TimedModel(inner, knots, interpolant, tolerance, shapes)

    def at(self, times: Array, side: Side = "right") -> CarrierModel:
        """Return the model at (N,) times inside the interval; ``side`` decides at a break."""
        instants = np.atleast_1d(np.asarray(times, dtype=np.float64))
        ends = np.cumsum([math.prod(shape) for shape in self.shapes])
        parts = zip(np.split(self.interpolant(instants, side), ends[:-1], axis=1), self.shapes, strict=True)
        return CarrierModel(instants, *(part.reshape(len(instants), *shape) for part, shape in parts))


def target_effort(robot: Robot, motion: PlatformMotion, lam: float, baseline: Dynamics | ArrayLike | None) -> Array:
    """Return (N, m) λ τ̂, N or N·m: zero without a baseline."""
    shape = (len(motion), robot.m)
    if baseline is None:
        if lam > 0.0:
            raise InputError(
                f"lam = {lam:g} asks for a fraction of the baseline effort, and there is no baseline.",
                remedy=f'Pass Objective(lam=..., baseline=load_robot("{robot.name}", carriers=False)), or an array '
                "(N, m); on the command line --baseline carriers=false.",
                name="lam",
            )
        return np.zeros(shape)
    if is_dynamics(baseline):
        other = baseline.robot
        if (other.n, other.m) != (robot.n, robot.m):
            raise InputError(
                f"The baseline robot has n, m = {other.n}, {other.m}; {robot.name} has {robot.n}, {robot.m}.",
                remedy="Pass the same mechanism without carriers.",
            )
        tau = distribute(baseline.reduce(motion)).tau
        bad = np.flatnonzero(~np.isfinite(tau).all(axis=1))
        if len(bad):
            raise InfeasiblePlanError(
                f"The baseline robot has no finite efforts at t = {motion.t[bad[0]]:.6g} s.",
                remedy="Use lam = 0, which needs no baseline.",
                constraint="baseline",
                time=float(motion.t[bad[0]]),
            )
    else:
        tau = checked(cast(ArrayLike, baseline), "baseline", shape)
    target: Array = lam * tau
    return target


def is_dynamics(baseline: Dynamics | ArrayLike) -> TypeGuard[Dynamics]:
    """Return whether a baseline is a backend, rather than efforts."""
    return isinstance(getattr(baseline, "robot", None), Robot)
