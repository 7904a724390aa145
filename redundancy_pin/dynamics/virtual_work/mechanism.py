"""What virtual work asks of a mechanism, and sums over its bodies, which move in the plane z = 0.

Arrays are leg-major, (legs, N): one row a leg (or a platform coordinate), one column a sample.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError

Parameters = Mapping[str, float | bool | str]
"""The parameters of a shipped model."""

ComplexArray = NDArray[np.complex128]
Complex = ComplexArray | Array | complex

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


def planar(x: Array, y: Array) -> ComplexArray:
    """Return vectors of the plane as x + iy."""
    return np.asarray(x + 1j * y, dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class PlanarBodies:
    """Alike bodies (one a leg) that move in the plane; vectors are complex, x + iy in the base frame, (legs, N) each.

    Attributes:
        mass: of each body, kg.
        inertia: of each about its centre of mass, kg·m².
        place, velocity, acceleration: of the centre of mass, m, m/s, m/s².
        spin, spin_rate: angular velocity and acceleration, rad/s and rad/s².
    """

    mass: float
    inertia: float
    place: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    spin: Array
    spin_rate: Array


@dataclass(frozen=True, eq=False)
class PlanarFrame:
    """A link's frame at N samples, (N,) each; vectors are complex, x + iy in the base frame.

    Attributes:
        place, velocity, acceleration: of its origin, m, m/s, m/s².
        axis: unit vector along its x axis.
        spin, spin_rate: rad/s and rad/s².
        moves: false of what is fixed to the base.
        carrier: index of the carrier that it is, or None; it moves along ``track`` (unit vector) then.
    """

    place: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    axis: ComplexArray
    spin: Array
    spin_rate: Array
    moves: bool = True
    carrier: int | None = None
    track: ComplexArray | None = None

    def point(self, offset: complex) -> tuple[ComplexArray, ComplexArray, ComplexArray]:
        """Return place, velocity and acceleration of a point that is fixed in the frame, ``offset`` in its axes."""
        arm = self.axis * offset
        velocity = self.velocity + 1j * self.spin * arm
        return self.place + arm, velocity, self.acceleration + (1j * self.spin_rate - self.spin**2) * arm


@dataclass(frozen=True, eq=False)
class PlanarJoint:
    """A joint at N samples, (N,) each: position, rate and its rate; and those of the link that carries it.

    ``carrier``: its index where it is a carrier's; ``axis``: unit vector along a prismatic one, None of a revolute one,
    whose position is known up to full turns.
    """

    position: Array
    rate: Array
    acceleration: Array
    link_spin: Array
    link_spin_rate: Array
    carrier: int | None = None
    axis: ComplexArray | None = None


@dataclass(frozen=True, eq=False)
class LinkFrames:
    """Frames that move with the links of the legs; vectors are complex, x + iy in the base frame, (legs, N) each.

    Attributes:
        origin, velocity, acceleration: of the frame's origin, m, m/s, m/s².
        u: unit vector along the link; iu points across it.
        spin, spin_rate: angular velocity and acceleration, rad/s and rad/s².
    """

    origin: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    u: ComplexArray
    spin: Array
    spin_rate: Array

    def bodies(
        self, mass: float, inertia: float, zeta: Complex, rate: Complex = 0.0, second_rate: Complex = 0.0
    ) -> PlanarBodies:
        """Return bodies that turn with the links, their centre of mass at ζ = (along) + i (across) the link.

        With u̇ = iω u: z = z_O + ζ u, v = v_O + (ζ̇ + iω ζ) u, a = a_O + (ζ̈ + 2iω ζ̇ + (iω̇ - ω²) ζ) u.
        """
        turn, u = 1j * self.spin, self.u
        curl = 1j * self.spin_rate - self.spin**2
        return PlanarBodies(
            mass=mass,
            inertia=inertia,
            place=self.origin + zeta * u,
            velocity=self.velocity + (rate + turn * zeta) * u,
            acceleration=self.acceleration + (second_rate + 2.0 * turn * rate + curl * zeta) * u,
            spin=self.spin,
            spin_rate=self.spin_rate,
        )

    def frame(
        self, leg: int, zeta: Complex = 0.0, rate: Complex = 0.0, second_rate: Complex = 0.0, **carried: Any
    ) -> PlanarFrame:
        """Return a frame on the link of one leg, turned like it, its origin at ζ as in ``bodies``."""
        parts = (self.origin, self.velocity, self.acceleration, self.u, self.spin, self.spin_rate)
        one = LinkFrames(*(part[leg] for part in parts)).bodies(0.0, 0.0, zeta, rate, second_rate)
        return PlanarFrame(one.place, one.velocity, one.acceleration, self.u[leg], one.spin, one.spin_rate, **carried)


def fixed_frame(samples: int) -> PlanarFrame:
    """Return the frame of the base."""
    still = np.zeros(samples, dtype=np.complex128)
    return PlanarFrame(still, still, still, still + 1.0, still.real, still.real, moves=False)


def base_wrench(bodies: Iterable[PlanarBodies], gravity: Array) -> Array:
    """Return (N, 6) force and moment of the bodies on the base: their weight less the rate of their momentum.

    The bodies stay in z = 0, so gravity along z enters the force along z and the moments about x and y only.
    """
    rows: Array | float = 0.0
    for body in bodies:
        force = body.mass * (complex(gravity[0], gravity[1]) - body.acceleration)
        weight_z = np.full(body.place.shape, body.mass * gravity[2])
        moment = (np.conj(body.place) * force).imag - body.inertia * body.spin_rate
        parts = (force.real, force.imag, weight_z, body.place.imag * weight_z, -body.place.real * weight_z, moment)
        rows = rows + np.stack([part.sum(axis=0) for part in parts], axis=1)
    return np.asarray(rows)


def energy(bodies: Iterable[PlanarBodies], gravity: Array) -> Array:
    """Return (N,) kinetic plus potential energy, J; the potential energy -m g·r is zero at the world origin."""
    total: Array | float = 0.0
    for body in bodies:
        kinetic = 0.5 * body.mass * np.abs(body.velocity) ** 2 + 0.5 * body.inertia * body.spin**2
        potential = -body.mass * (complex(gravity[0], -gravity[1]) * body.place).real
        total = total + (kinetic + potential).sum(axis=0)
    return np.asarray(total)
