"""What the virtual-work backend asks of a mechanism: a pose test, and the dynamics once the pose has passed it.

Arrays are leg-major, (legs, N): one row a leg (or a platform coordinate), one column a sample.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.virtual_work.planar import PlanarBodies


@dataclass(frozen=True, eq=False)
class EffortDerivatives:
    """Derivatives of the generalised force and of the carrier forces by the carrier motion.

    Carrier i rides on leg i and acts on no other leg, so the derivatives of the carrier forces are diagonal.

    Attributes:
        f_s, f_sd, f_sdd: (n, legs, N) of f by s, ṡ, s̈ of the carrier of each leg.
        force_s, force_sd, force_sdd: (legs, N) of the force of each carrier by its own s, ṡ, s̈.
    """

    f_s: Array
    f_sd: Array
    f_sdd: Array
    force_s: Array
    force_sd: Array
    force_sdd: Array


class MechanismAlongMotion(Protocol):
    """The dynamics of a mechanism along a motion of its platform, for any motion of its carriers."""

    @property
    def jacobian(self) -> Array:
        """(N, m, n) J with q̇_a = J ẋ."""

    def efforts(self, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return f, (n, N), and the carrier forces, (legs, N), for carrier motions (legs, N)."""

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> EffortDerivatives:
        """Return the derivatives of both."""

    def bodies(self, s: Array, sd: Array, sdd: Array) -> Iterable[PlanarBodies]:
        """Return every body with its motion."""


class MechanismLegs(Protocol):
    """The inverse displacement at sampled poses: enough to sort out bad poses before any rate is computed."""

    @property
    def gap(self) -> Array:
        """(legs, N) what each leg lacks to close, m."""

    @property
    def margin(self) -> Array:
        """(legs, N) distance of each leg from its type I singularity."""

    @property
    def least_margin(self) -> float:
        """Margin at or below which the pose counts as singular; in the unit of ``margin``."""

    def along(self, velocity: Array, acceleration: Array) -> MechanismAlongMotion:
        """Return the dynamics along a motion through these poses, (N, n) each."""


class Mechanism(Protocol):
    """A mechanism with closed-form kinematics, in one working mode."""

    @property
    def angular_rows(self) -> tuple[bool, ...]:
        """(n,) whether each platform coordinate is an angle."""

    @property
    def angular_columns(self) -> tuple[bool, ...]:
        """(m,) whether each main actuator is revolute."""

    def legs(self, x: Array) -> MechanismLegs:
        """Solve the inverse displacement at platform coordinates (N, n); NaN passes through."""
