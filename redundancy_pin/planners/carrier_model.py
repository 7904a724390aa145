"""f and the carrier forces as exact polynomials of the carrier motion, with coefficients that depend on time alone.

A carrier on a straight track of its link stands at r = r₀ + s u, so its acceleration is r̈₀ + s ü + 2 ṡ u̇ + s̈ u and its
velocity per unit of ẋ is J₀ + s J_u. With J_uᵀ u = 0 its share of f is a combination of s, s², ṡ, s ṡ and s̈: quadratic
in (s, ṡ), affine in s̈, and carriers do not mix. The same holds for its own force. The coefficients are read off the
backend by evaluating it a fixed number of times, so they are exact for whatever backend it is; planners never call it
again.

The actuation matrix and the carrier model as functions of time.

Both are read off the backend in a few batched calls and then interpolated to rounding, so that root finding and the
integration of the carriers' motion can ask for any time without calling the backend again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, ReducedDynamics
from redundancy_pin.dynamics.distribution import SampleStatus, distribute
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.actuation import SAMPLED_TOLERANCE, smooth_edges
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, PiecewisePolynomial

TERMS = 5
"""s, s², ṡ, s ṡ, s̈."""

_MODEL_TOLERANCE = 1e-8
"""Relative deviation of the polynomial from the backend at a random carrier motion that still counts as rounding."""


@dataclass(frozen=True, eq=False)
class CarrierModel:
    """Coefficients of f and of the carrier forces at N instants.

    N samples, n independent coordinates, m main actuators, k carriers; last axis: s, s², ṡ, s ṡ, s̈.

    Attributes:
        t: (N,) time, s.
        W: (N, n, m) actuation matrix.
        f0: (N, n) f with the carriers at rest at s = 0, N and N·m.
        f_terms: (N, n, k, 5) coefficients of f, by carrier and term.
        force0: (N, k) carrier forces with the carriers at rest at s = 0, N.
        force_terms: (N, k, 5) coefficients of each carrier's force in its own motion.
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

    def f(self, s: Array, sd: Array, sdd: Array) -> Array:
        """Return f (N, n) for a carrier motion, each (N, k)."""
        value: Array = self.f0 + np.einsum("nikj,nkj->ni", self.f_terms, terms(s, sd, sdd))
        return value

    def carrier_force(self, s: Array, sd: Array, sdd: Array) -> Array:
        """Return the carrier forces (N, k) for a carrier motion, each (N, k)."""
        value: Array = self.force0 + np.einsum("nkj,nkj->nk", self.force_terms, terms(s, sd, sdd))
        return value


def terms(s: Array, sd: Array, sdd: Array) -> Array:
    """Return the five terms (..., k, 5) of a carrier motion."""
    return np.stack([s, s * s, sd, s * sd, sdd], axis=-1)


def carrier_model(along: DynamicsAlongMotion) -> CarrierModel:
    """Read the coefficients off a backend.

    Args:
        along: dynamics along a platform motion, from either backend.

    Raises:
        UnsupportedRobotError: the robot has no carriers, or f is not of this form (a carrier on a curved track, or one
            that carries another).
    """
    robot, samples = along.robot, len(along.motion)
    if robot.k == 0:
        raise UnsupportedRobotError(
            f"{robot.name} has no carriers to plan for.", remedy="Load it with carriers, or declare some."
        )

    def probe(s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        spread = (np.broadcast_to(part, (samples, robot.k)) for part in (s, sd, sdd))
        reduced = along.reduce(CarrierMotion(*spread))
        return np.asarray(reduced.f), np.asarray(reduced.carrier_force)

    zero = np.zeros(robot.k)
    reduced = along.reduce(CarrierMotion.parked(samples, robot.k))
    f0, force0 = np.asarray(reduced.f), np.asarray(reduced.carrier_force)
    f_terms = np.empty((samples, f0.shape[1], robot.k, TERMS))
    force_terms = np.empty((samples, robot.k, TERMS))
    for i in range(robot.k):
        unit = np.eye(robot.k)[i]
        values = [probe(unit, zero, zero), probe(-unit, zero, zero), probe(zero, unit, zero)]
        values += [probe(unit, unit, zero), probe(zero, zero, unit)]
        for target, base, which in ((f_terms, f0, 0), (force_terms, force0, 1)):
            plus, minus, rate, both, push = (pair[which] - base for pair in values)
            split = (0.5 * (plus - minus), 0.5 * (plus + minus), rate, both - plus - rate, push)
            for term, value in enumerate(split):
                if which == 0:
                    target[:, :, i, term] = value
                else:
                    target[:, i, term] = value[:, i]
    model = CarrierModel(along.motion.t, reduced.W, *(read_only(part) for part in (f0, f_terms, force0, force_terms)))
    _require_polynomial(along, model)
    return model


def _require_polynomial(along: DynamicsAlongMotion, model: CarrierModel) -> None:
    """Compare the polynomial with the backend at one random carrier motion."""
    rng = np.random.default_rng(5)
    s, sd, sdd = (rng.uniform(-1.0, 1.0, (len(model.t), model.k)) for _ in range(3))
    reduced = along.reduce(CarrierMotion(s, sd, sdd))
    for ours, theirs in (
        (model.f(s, sd, sdd), reduced.f),
        (model.carrier_force(s, sd, sdd), reduced.carrier_force),
    ):
        size = float(np.nanmax(np.abs(theirs), initial=1e-9))
        error = float(np.nanmax(np.abs(ours - theirs), initial=0.0)) / size
        if error > _MODEL_TOLERANCE:
            raise UnsupportedRobotError(
                f"The carriers of {along.robot.name} are not on straight tracks: f deviates from a quadratic by "
                f"{error:.2g} of its size.",
                remedy="This planner needs prismatic carriers, each on a link of its own.",
                deviation=error,
            )


@dataclass(frozen=True, eq=False)
class EffortModel:
    """Coefficients of the main efforts at N instants.

    N samples, m main actuators, k carriers; last axis of ``tau_terms``: s, s², ṡ, s ṡ, s̈.

    Attributes:
        t: (N,) time, s.
        tau0: (N, m) efforts with the carriers at rest at s = 0, N or N·m.
        tau_terms: (N, m, k, 5) coefficients, by carrier and term.
        margin: (N,) smallest singular value of the scaled W.
    """

    t: Array
    tau0: Array
    tau_terms: Array
    margin: Array


def effort_model(along: DynamicsAlongMotion, least_margin: float) -> EffortModel:
    """Read the coefficients of the main efforts off a backend.

    With more actuators than freedoms the efforts are those of least norm, as ``distribute`` defines it: they too are
    linear in f.

    Args:
        along: dynamics along a platform motion, from either backend.
        least_margin: smallest margin of W along the motion that is accepted.

    Raises:
        UnsupportedRobotError: no carriers, carriers on curved tracks, fewer actuators than freedoms, or more carriers
            than actuators.
        InfeasiblePlanError: the motion meets or crosses a type II singularity, or comes closer than ``least_margin``.
    """
    robot = along.robot
    if robot.k > robot.m or robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.n} freedoms, {robot.m} main actuators and {robot.k} carriers; the carriers of "
            "least effort are not determined.",
            remedy="This planner needs at least as many main actuators as freedoms and as carriers.",
            n=robot.n,
            m=robot.m,
            k=robot.k,
        )
    model = carrier_model(along)
    inverse, margin = _inverse(along.reduce())
    _require_regular(model, margin, least_margin)
    return EffortModel(
        model.t,
        read_only(np.einsum("nmi,ni->nm", inverse, model.f0)),
        read_only(np.einsum("nmi,nikj->nmkj", inverse, model.f_terms)),
        margin,
    )


def _inverse(reduced: ReducedDynamics) -> tuple[Array, Array]:
    """Return (N, m, n) the map from f to the efforts, and (N,) the margin of W.

    The map is what ``distribute`` makes of each unit vector; NaN where W lacks rank.
    """
    samples, n = reduced.f.shape
    unit = np.tile(np.eye(n), (samples, 1))
    each = {
        name: np.repeat(getattr(reduced, name), n, axis=0) for name in ("t", "W", "carrier_force", "reachable", "gap")
    }
    solved = distribute(replace(reduced, f=unit, **each))
    efforts = np.where((solved.status > SampleStatus.NEAR_SINGULAR)[:, None], np.nan, solved.tau)
    return efforts.reshape(samples, n, -1).swapaxes(1, 2), read_only(np.array(solved.margin[::n]))


def _require_regular(model: CarrierModel, margin: Array, least_margin: float) -> None:
    worst = int(np.argmin(margin))
    remedy = "Plan with plan_switch_off, which crosses it, or lead the platform along another path."
    if margin[worst] < least_margin:
        raise InfeasiblePlanError(
            f"The motion comes too close to a type II singularity: at t = {model.t[worst]:.6g} s the margin of W is "
            f"{margin[worst]:.3g}, below {least_margin:.3g}; this planner needs W⁻¹.",
            remedy=remedy,
            constraint="margin",
            time=float(model.t[worst]),
            margin=float(margin[worst]),
        )
    if model.W.shape[1] == model.W.shape[2]:
        side = np.sign(np.linalg.det(model.W))
        crossed = np.flatnonzero(side[1:] != side[:-1])
        if len(crossed):
            j = int(crossed[0])
            raise InfeasiblePlanError(
                f"The motion crosses a type II singularity between t = {model.t[j]:.6g} and {model.t[j + 1]:.6g} s "
                f"(margins {margin[j]:.3g} and {margin[j + 1]:.3g}).",
                remedy=remedy,
                constraint="margin",
                time=float(model.t[j]),
                margin=0.0,
            )


MODEL_TOLERANCE = 1e-12
"""Of each group of coefficients, relative to its largest entry."""

_LEAST_GROUP = 1e-4
"""A group smaller than this fraction of the largest is held to the tolerance of this size: the rounding of a backend
does not shrink with the group."""


@dataclass(frozen=True, eq=False)
class TimedModel:
    """The carrier model as a function of time.

    Attributes:
        start, end: interval, s.
        breaks: (b,) inner times at which f may jump, s.
        knots: (c,) further ends of the pieces, s.
        interpolant: all coefficients side by side.
        tolerance: of the coefficients, relative.
        n, m, k: numbers of coordinates, main actuators and carriers.
    """

    start: float
    end: float
    breaks: Array
    knots: Array
    interpolant: PiecewisePolynomial
    tolerance: float
    n: int
    m: int
    k: int

    @staticmethod
    def of(dynamics: Dynamics, motion: ContinuousMotion, start: float, end: float) -> TimedModel:
        """Read the model off a backend over a part of a motion.

        Raises:
            UnsupportedRobotError: see ``carrier_model``.
        """
        robot = dynamics.robot

        def values(times: Array) -> Array:
            model = carrier_model(dynamics.along(motion.sample_at(times)))
            parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
            return np.concatenate([np.asarray(part).reshape(len(times), -1) for part in parts], axis=1)

        def scale(found: Array) -> Array:
            group = _groups(robot.n, robot.m, robot.k)
            largest = np.array([np.abs(found[:, group == g]).max() for g in range(group.max() + 1)])
            limited: Array = np.maximum(largest, _LEAST_GROUP * largest.max())[group]
            return limited

        tolerance = MODEL_TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        interpolant = PiecewisePolynomial.fit(values, smooth_edges(motion, start, end), motion.knots, scale, tolerance)
        inner = motion.breaks[(motion.breaks > start) & (motion.breaks < end)]
        knots = np.setdiff1d(interpolant.edges[1:-1], inner)
        return TimedModel(start, end, inner, knots, interpolant, tolerance, robot.n, robot.m, robot.k)

    def at(self, times: Array, side: Side = "right") -> CarrierModel:
        """Return the model at (N,) times inside the interval; ``side`` decides at a break."""
        instants = np.atleast_1d(np.asarray(times, dtype=np.float64))
        W, f0, f_terms, force0, force_terms = np.split(
            self.interpolant(instants, side), np.cumsum(_sizes(self.n, self.m, self.k))[:-1], axis=1
        )
        count = len(instants)
        return CarrierModel(
            instants,
            W.reshape(count, self.n, self.m),
            f0,
            f_terms.reshape(count, self.n, self.k, TERMS),
            force0,
            force_terms.reshape(count, self.k, TERMS),
        )


def _sizes(n: int, m: int, k: int) -> list[int]:
    return [n * m, n, n * k * TERMS, k, k * TERMS]


def _groups(n: int, m: int, k: int) -> Array:
    """Return (C,) the group of each coefficient: those of one unit are held to one tolerance."""
    terms = np.arange(TERMS)
    groups: Array = np.concatenate(
        [
            np.zeros(n * m, dtype=int),
            np.full(n, 1),
            2 + np.tile(terms, n * k),
            np.full(k, 2 + TERMS),
            3 + TERMS + np.tile(terms, k),
        ]
    )
    return groups
