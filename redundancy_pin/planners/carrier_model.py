"""f and the carrier forces as exact polynomials of the carrier motion, with coefficients that depend on time alone.

A carrier on a straight track of its link stands at r = r₀ + s u, so its acceleration is r̈₀ + s ü + 2 ṡ u̇ + s̈ u and its
velocity per unit of ẋ is J₀ + s J_u. With J_uᵀ u = 0 its share of f is a combination of s, s², ṡ, s ṡ and s̈: quadratic
in (s, ṡ), affine in s̈, and carriers do not mix. The same holds for its own force. The coefficients are read off the
backend by evaluating it a fixed number of times, so they are exact for whatever backend it is; planners never call it
again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import DynamicsAlongMotion
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion

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
