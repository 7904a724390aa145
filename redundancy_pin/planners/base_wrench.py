"""The wrench on the base for planners: about a point, minus the load at rest, by the carriers' terms.

The base wrench (``DynamicsAlongMotion.base_wrench``) is the gravity of all moving bodies minus the rate of change of
their momentum. Like f, it is a sum of ``carrier_model.terms`` over independent carriers that slide or turn. Its
coefficients follow from as many carrier motions as there are terms, for any backend.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, checked, frozen, read_only, real
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.errors import InputError, UnsupportedRobotError, shown
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.carrier_model import SLIDING_TERMS, TERM_NAMES, TERMS, TURNING_TERMS, terms
from redundancy_pin.robot.scales import turning_velocities

BASE = ("base_force", "base_moment", "base_wrench")
"""Objectives that are about it: the force, the moment, and both, the moment over the characteristic length."""

_TOLERANCE = 1e-8
"""Deviation of the terms from the backend at a random carrier motion, of the largest, that counts as rounding."""


def weights_of(objective: str | Mapping[str, float], known: Collection[str]) -> dict[str, float]:
    """Return the weights above zero of a planner's ``known`` objectives, of which one name is a weight of one."""
    given = {objective: 1.0} if isinstance(objective, str) else objective
    if not isinstance(given, Mapping) or not set(given) <= set(known):
        unknown = [name for name in given if name not in known] if isinstance(given, Mapping) else objective
        raise InputError(
            f"objective is {unknown!r}.", remedy=f"Use {', '.join(known)}, or weights of them.", objective=unknown
        )
    for weight in given.values():
        try:
            usable = math.isfinite(number := real(weight)) and number >= 0.0
        except (TypeError, ValueError, OverflowError):
            usable = False
        if not usable:
            raise InputError(
                f"A weight of the objective is {shown(weight)}.",
                remedy="Weights are numbers that are not negative.",
                weight=weight,
            )
    kept = {name: float(weight) for name, weight in given.items() if weight > 0.0}
    if not kept:
        raise InputError("Nothing to minimise: every weight is zero.", remedy="Give one objective a weight.")
    return kept


def point_of(point: ArrayLike | None) -> Array:
    """Return (3,) the point about which moments on the base are taken, m; the world origin when left out."""
    return frozen(np.zeros(3) if point is None else checked(point, "base_point", (3,)))


def shift_moment_point(wrench: Array, point: Array) -> Array:
    """Return wrenches (N, 6) about a point (3,), m, in place of the world origin: M − p × F."""
    force = wrench[:, :3]
    return read_only(np.concatenate([force, wrench[:, 3:] - np.cross(point, force)], axis=1))


def load_at_rest(dynamics: Dynamics, motion: PlatformMotion, s: Array, point: Array) -> Array:
    """Return (1, 6) the wrench about a point of the robot at rest where a motion begins, carriers at ``s`` (k,)."""
    x, still = motion.x[:1], np.zeros_like(motion.xd[:1])
    parked, rest = s[None], np.zeros((1, len(s)))
    along = dynamics.along(PlatformMotion(motion.t[:1], x, still, still))
    return shift_moment_point(along.base_wrench(CarrierMotion(parked, rest, rest)), point)


@dataclass(frozen=True, eq=False)
class BaseWrench:
    """Coefficients of the wrench at N instants, N and N·m.

    ``w0`` (N, 6) with the carriers at rest at s = 0; ``by_term`` (N, 6, k, c) by carrier and term, as ``CarrierModel``.
    """

    w0: Array
    by_term: Array

    def rows(self, weights: Mapping[str, float], length: float) -> tuple[Array, Array]:
        """Return (N, r) and (N, r, k, c): the rows that carriers change, such that Σ r² is the weighted integrand.

        ``weights`` of ``BASE``; ``length``: by which "base_wrench" divides the moment, m.
        """
        both = weights.get("base_wrench", 0.0)
        of_force, of_moment = both + weights.get("base_force", 0.0), both / length**2 + weights.get("base_moment", 0.0)
        root = np.sqrt(np.repeat([of_force, of_moment], 3))
        at = np.flatnonzero(self.changed & (root > 0.0))
        return self.w0[:, at] * root[at], self.by_term[:, at] * root[at, None, None]

    @property
    def changed(self) -> BoolArray:
        """(6,) whether the carriers change a component."""
        size = np.abs(self.by_term).max(axis=(0, 2, 3), initial=0.0)
        return np.asarray(size > _TOLERANCE * size.max(initial=0.0))

    @property
    def felt(self) -> BoolArray:
        """(6,) whether a component is nonzero; components without carrier influence count: they can be bounded."""
        size = np.abs(self.w0).max(axis=0, initial=0.0)
        return np.asarray(self.changed | (size > _TOLERANCE * size.max(initial=0.0)))

    def sizes(self, sdd: Array) -> Array:
        """Return (6,) sizes of force and moment: of parked carriers or, where that is nothing, of s̈ (k,)."""
        parked, moved = np.abs(self.w0), np.abs(self.by_term[..., 4]) @ sdd  # the fifth term is s̈
        parked, moved = (part.reshape(-1, 2, 3).max(axis=(0, 2)) for part in (parked, moved))
        return np.repeat(np.where(parked > _TOLERANCE * moved, parked, np.where(moved > 0.0, moved, 1.0)), 3)

    def __call__(self, carriers: CarrierMotion) -> Array:
        """Return the wrench (N, 6) of a carrier motion, N samples."""
        by_term = terms(carriers.s, carriers.sd, carriers.sdd, self.by_term.shape[3], np)
        return np.asarray(self.w0 + np.einsum("nikj,nkj->ni", self.by_term, np.stack(by_term, axis=-1)))


def base_wrench(along: DynamicsAlongMotion, rest: Array, point: Array, *, turning: bool = False) -> BaseWrench:
    """Read the coefficients off a backend along a platform motion.

    ``rest`` (1, 6): wrench to subtract (``load_at_rest``), about the ``point`` (3,), m; ``turning``: whether some
    carriers turn.

    Raises:
        UnsupportedRobotError: it has other terms, as where a carrier carries another.
    """
    robot, samples = along.robot, len(along.motion)
    count = len(TERM_NAMES) if turning else TERMS

    def wrench(*motion: Array) -> Array:
        carriers = CarrierMotion(*(np.broadcast_to(part, (samples, robot.k)) for part in motion))
        return np.asarray(shift_moment_point(along.base_wrench(carriers), point) - rest)

    w0 = wrench(*np.zeros((3, robot.k)))
    by_term = np.zeros((samples, 6, robot.k, count))
    for i, turns in enumerate(turning_velocities(robot)[robot.carrier_velocity]):
        # nothing grows with the angle itself
        places, at = (TURNING_TERMS[1:], _TURNING) if turning and turns else (SLIDING_TERMS, _SLIDING)
        inverse = np.linalg.pinv(np.stack(terms(at[0], at[1], at[2], count, np), axis=-1)[:, places])
        unit = np.eye(robot.k)[i]
        added = np.stack([wrench(*(x * unit for x in one)) - w0 for one in at.T])
        by_term[:, :, i, places] = np.einsum("jr,rni->nij", inverse, added)
    model = BaseWrench(w0, by_term)
    tried = np.random.default_rng(7).uniform(-1.0, 1.0, (3, samples, robot.k))
    theirs = wrench(*tried)
    deviation = float(np.abs(model(CarrierMotion(*tried, check_rates=False)) - theirs).max(initial=0.0))
    if deviation > _TOLERANCE * max(float(np.abs(theirs).max(initial=0.0)), 1e-9):
        raise UnsupportedRobotError(
            f"The base wrench of {robot.name} deviates by {deviation:.2g} from a sum over its carriers.",
            remedy="Balancing needs carriers that slide or turn, each on a link of its own.",
            deviation=deviation,
        )
    return model


_SLIDING = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 0, 1]], dtype=float).T
"""(3, 5) s, ṡ and s̈ that separate the terms of a sliding carrier."""

_TURNING = np.concatenate(
    [
        np.stack([0.4 * np.pi * np.arange(5), np.full(5, sd), np.full(5, sdd)])
        for sd, sdd in ((0.0, 0.0), (1.0, 0.0), (-1.0, 0.0), (0.0, 1.0))
    ],
    axis=1,
)
"""(3, 20) the same of one that turns."""
