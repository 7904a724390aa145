"""What virtual work asks of a mechanism, and sums over its bodies, which move in the plane z = 0.

Arrays are leg-major, (legs, N): one row a leg (or a platform coordinate), one column a sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Protocol, TypeVar

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError

Parameters = Mapping[str, float | bool | str]
"""The parameters of a shipped model."""

Partials = tuple[Array, Array, Array]
"""Derivatives by s, ṡ, s̈."""

_Lengths = TypeVar("_Lengths", bound="Lengths")


@dataclass(frozen=True)
class Lengths:
    """Lengths that fix the kinematics of a mechanism, m.

    Raises:
        InputError: a length is not positive and finite.
    """

    def __post_init__(self) -> None:
        for field in fields(self):
            length = getattr(self, field.name)
            if not (np.isfinite(length) and length > 0.0):
                raise InputError(
                    f"{field.name} is {length}.", remedy="Pass a positive length in metres.", name=field.name
                )

    @classmethod
    def from_parameters(cls: type[_Lengths], parameters: Parameters) -> _Lengths:
        """Read the lengths off the parameters of the shipped model."""
        return cls(**{field.name: float(parameters[field.name]) for field in fields(cls)})


def signs(mode: Sequence[int], legs: int) -> Array:
    """Return (legs, 1) the signs of a working mode.

    Raises:
        InputError: not one sign, 1 or -1, for each leg.
    """
    if len(mode) != legs or any(sign not in (1, -1) for sign in mode):
        raise InputError(f"mode is {tuple(mode)}.", remedy=f"Pass one sign, 1 or -1, for each of the {legs} legs.")
    return np.array(mode, dtype=float)[:, None]


class Legs(Protocol):
    """The inverse displacement at sampled poses: enough to sort out bad poses before any rate is computed."""

    @property
    def gap(self) -> Array:
        """(legs, N) what each leg lacks to close, m."""

    @property
    def margin(self) -> Array:
        """(legs, N) distance of each leg from its type I singularity."""

    @property
    def jacobian(self) -> Array:
        """(N, m, n) J with q̇_a = J ẋ."""


class MechanismAlongMotion(Protocol):
    """The dynamics of a mechanism along a motion of its platform, for any motion of its carriers, (legs, N) each."""

    def efforts(self, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return f, (n, N), and the carrier forces, (legs, N)."""

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> tuple[Partials, Partials]:
        """Return the derivatives of f, (n, legs, N), and of each carrier's force, (legs, N), by the carrier of the leg.

        Carrier i rides on leg i and acts on no other leg.
        """

    def bodies(self, s: Array, sd: Array, sdd: Array) -> Iterable[PlanarBodies]:
        """Return every body with its motion."""


class Mechanism(Protocol):
    """A mechanism with closed-form kinematics, in one working mode.

    Attributes:
        angular_rows: (n,) whether each platform coordinate is an angle.
        angular_columns: (m,) whether each main actuator is revolute.
        least_margin: margin of a leg at or below which a pose counts as singular (type I).
    """

    angular_rows: tuple[bool, ...]
    angular_columns: tuple[bool, ...]
    least_margin: float

    def legs(self, x: Array) -> Any:
        """Solve the inverse displacement at platform coordinates (N, n); returns ``Legs``. NaN passes through."""

    def along(self, legs: Any, x: Array, xd: Array, xdd: Array) -> MechanismAlongMotion:
        """Return the dynamics along a motion (N, n) through poses whose legs are solved."""


Coordinate = tuple[Array | float, Array | float, Array | float]
"""A coordinate of a point in a moving frame, its rate and its second rate; m, m/s, m/s²."""


@dataclass(frozen=True, eq=False)
class PlanarBodies:
    """Alike bodies (one a leg) that move in the plane; every array is (legs, N), in the base frame.

    Attributes:
        mass: of each body, kg.
        inertia: of each about its centre of mass, kg·m².
        x, y: centre of mass, m.
        vx, vy: its velocity, m/s.
        ax, ay: its acceleration, m/s².
        spin, spin_rate: angular velocity and acceleration, rad/s and rad/s².
    """

    mass: float
    inertia: float
    x: Array
    y: Array
    vx: Array
    vy: Array
    ax: Array
    ay: Array
    spin: Array
    spin_rate: Array


@dataclass(frozen=True, eq=False)
class LinkFrames:
    """Frames that move with the links of the legs; every array is (legs, N), in the base frame.

    Attributes:
        x, y: origin, m.
        vx, vy: its velocity, m/s.
        ax, ay: its acceleration, m/s².
        ux, uy: unit vector u along the link; n = (-uy, ux) points across it.
        spin, spin_rate: angular velocity and acceleration, rad/s and rad/s².
    """

    x: Array
    y: Array
    vx: Array
    vy: Array
    ax: Array
    ay: Array
    ux: Array
    uy: Array
    spin: Array
    spin_rate: Array

    def bodies(
        self, mass: float, inertia: float, along: Coordinate, across: Coordinate = (0.0, 0.0, 0.0)
    ) -> PlanarBodies:
        """Return bodies that turn with the links, their centre of mass at ``along`` u + ``across`` n.

        With ξ along and η across, u̇ = ω n and ṅ = -ω u give
        v = v_O + (ξ̇ - η ω) u + (η̇ + ξ ω) n,
        a = a_O + (ξ̈ - 2 η̇ ω - η ω̇ - ξ ω²) u + (η̈ + 2 ξ̇ ω + ξ ω̇ - η ω²) n.

        Args:
            mass: of each body, kg.
            inertia: of each about its centre of mass, kg·m².
            along: coordinate of the centre of mass along the link and its two rates; (legs, N) or numbers.
            across: the same across the link.
        """
        (xi, xi_d, xi_dd), (eta, eta_d, eta_dd) = along, across
        w, wd = self.spin, self.spin_rate
        ux, uy = self.ux, self.uy
        v_along, v_across = xi_d - eta * w, eta_d + xi * w
        a_along = xi_dd - 2.0 * eta_d * w - eta * wd - xi * w * w
        a_across = eta_dd + 2.0 * xi_d * w + xi * wd - eta * w * w
        return PlanarBodies(
            mass=mass,
            inertia=inertia,
            x=self.x + xi * ux - eta * uy,
            y=self.y + xi * uy + eta * ux,
            vx=self.vx + v_along * ux - v_across * uy,
            vy=self.vy + v_along * uy + v_across * ux,
            ax=self.ax + a_along * ux - a_across * uy,
            ay=self.ay + a_along * uy + a_across * ux,
            spin=w,
            spin_rate=wd,
        )


def base_wrench(bodies: Iterable[PlanarBodies], gravity: Array) -> Array:
    """Return the wrench of the bodies on the base: their weight less the rate of their momentum.

    The bodies stay in z = 0, so gravity along z enters the force along z and the moments about x and y only.

    Args:
        bodies: every body with mass.
        gravity: (3,) acceleration of gravity in the base frame, m/s².

    Returns:
        (N, 6) force, N, and moment about the world origin, N·m, in world axes.
    """
    rows: Array | float = 0.0
    for body in bodies:
        force_x = body.mass * (gravity[0] - body.ax)
        force_y = body.mass * (gravity[1] - body.ay)
        weight_z = body.mass * gravity[2]
        rows = rows + np.stack(
            [
                force_x.sum(axis=0),
                force_y.sum(axis=0),
                np.full(body.x.shape[1], weight_z * len(body.x)),
                (body.y * weight_z).sum(axis=0),
                (-body.x * weight_z).sum(axis=0),
                (body.x * force_y - body.y * force_x - body.inertia * body.spin_rate).sum(axis=0),
            ],
            axis=1,
        )
    return np.asarray(rows)


def energy(bodies: Iterable[PlanarBodies], gravity: Array) -> Array:
    """Return (N,) kinetic plus potential energy, J; the potential energy -m g·r is zero at the world origin.

    Args:
        bodies: every body with mass.
        gravity: (3,) acceleration of gravity in the base frame, m/s².
    """
    total: Array | float = 0.0
    for body in bodies:
        kinetic = 0.5 * body.mass * (body.vx**2 + body.vy**2) + 0.5 * body.inertia * body.spin**2
        potential = -body.mass * (gravity[0] * body.x + gravity[1] * body.y)
        total = total + (kinetic + potential).sum(axis=0)
    return np.asarray(total)
