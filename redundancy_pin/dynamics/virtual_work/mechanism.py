"""What virtual work asks of a mechanism, and sums over its bodies, which move in the plane z = 0.

Arrays are leg-major, (legs, N): one row a leg (or a platform coordinate), one column a sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, NamedTuple, TypeVar

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


def planar(vectors: Array) -> ComplexArray:
    """Return (N,) vectors of the plane as x + iy, from the first two columns of (N, n) coordinates."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1], dtype=np.complex128)


def components(vectors: ComplexArray, *others: Array) -> Array:
    """Return (N, legs, 2 or more) x and y of vectors (legs, N), and other components of the same shape."""
    return np.stack([vectors.real.T, vectors.imag.T, *(other.T for other in others)], axis=2)


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

    def frame(
        self, leg: int, zeta: Complex = 0.0, rate: Complex = 0.0, second_rate: Complex = 0.0, **carried: Any
    ) -> PlanarFrame:
        """Return a frame on the link of one leg, turned like it, its origin at ζ = (along) + i (across) the link.

        With u̇ = iω u: z = z_O + ζ u, v = v_O + (ζ̇ + iω ζ) u, a = a_O + (ζ̈ + 2iω ζ̇ + (iω̇ - ω²) ζ) u.
        """
        u, spin, spin_rate = self.u[leg], self.spin[leg], self.spin_rate[leg]
        turn, curl = 1j * spin, 1j * spin_rate - spin**2
        return PlanarFrame(
            self.origin[leg] + zeta * u,
            self.velocity[leg] + (rate + turn * zeta) * u,
            self.acceleration[leg] + (second_rate + 2.0 * turn * rate + curl * zeta) * u,
            u,
            spin,
            spin_rate,
            **carried,
        )


def fixed_frame(samples: int) -> PlanarFrame:
    """Return the frame of the base."""
    still = np.zeros(samples, dtype=np.complex128)
    return PlanarFrame(still, still, still, still + 1.0, still.real, still.real, moves=False)


def wrench_on_ground(
    place: ComplexArray, height: float, push: ComplexArray, lift: Array, tilt: ComplexArray, moment: Array
) -> Array:
    """Return (N, 6) the wrench about the world origin of a force (push, lift), N, at a place, and moments, N·m."""
    about_x, about_y = tilt.real + place.imag * lift, tilt.imag - place.real * lift
    turning = about_x - height * push.imag, about_y + height * push.real, moment + (np.conj(place) * push).imag
    return np.stack([push.real, push.imag, lift, *turning], axis=1)


class Body(NamedTuple):
    """A rigid body on a link, its centre of mass in a plane that is parallel to that of the motion.

    ``frame``: of the link; ``mass``, kg; ``centre`` in the axes of the frame, x + iy, m; ``inertia`` about the centre
    and the z axis, kg·m²; ``height`` of the centre, m; ``products`` of inertia about it, xz + i yz, kg·m².
    """

    frame: str
    mass: float
    centre: complex
    inertia: float
    height: float = 0.0
    products: complex = 0.0

    def load(self, here: PlanarFrame, gravity: Sequence[float] | Array) -> tuple[ComplexArray, ComplexArray, Array]:
        """Return (N,) place of the centre, m, weight less mass times acceleration there, N, and moment, N·m."""
        place, _, acceleration = here.point(self.centre)
        return place, self.mass * (complex(gravity[0], gravity[1]) - acceleration), -self.inertia * here.spin_rate

    def on_ground(self, here: PlanarFrame, gravity: Sequence[float] | Array) -> Array:
        """Return (N, 6) force and moment on the base about the world origin: weight less rate of momentum.

        The centre stays at one height, and the inertia is turned about z: of the products with z the rates are moments
        about x and y, d/dt (I_xz + i I_yz) e^{iφ} ω.
        """
        place, push, moment = self.load(here, gravity)
        tilt = -self.products * here.axis * (here.spin_rate + 1j * here.spin**2)
        weight = np.full(len(push), self.mass * gravity[2])
        return wrench_on_ground(place, self.height, push, weight, tilt, moment)

    def energy(self, here: PlanarFrame, gravity: Sequence[float] | Array) -> Array:
        """Return (N,) kinetic plus potential energy, J; the potential energy -m g·r is zero at the world origin."""
        place, velocity, _ = here.point(self.centre)
        kinetic = 0.5 * self.mass * np.abs(velocity) ** 2 + 0.5 * self.inertia * here.spin**2
        lifted = (complex(gravity[0], -gravity[1]) * place).real + gravity[2] * self.height
        energy: Array = kinetic - self.mass * lifted
        return energy


class PlanarDynamics(ABC):
    """Dynamics of a mechanism along one motion: what loads and sums over bodies need of it.

    ``bodies``: of all links; ``gravity`` (3,) m/s².
    """

    bodies: Sequence[Body]
    gravity: Sequence[float] | Array

    @abstractmethod
    def frame(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarFrame:
        """Return a link's frame; carriers (legs, N)."""

    @abstractmethod
    def joint(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarJoint:
        """Return a joint's motion; carriers (legs, N)."""

    def base_wrench(self, *carriers: Array) -> Array:
        """Return (N, 6) force and moment of the links on the base: their weight less the rate of their momentum."""
        wrenches = [body.on_ground(self.frame(body.frame, *carriers), self.gravity) for body in self.bodies]
        return np.asarray(np.sum(wrenches, axis=0))

    def energy(self, *carriers: Array) -> Array:
        """Return (N,) kinetic plus potential energy of the links, J."""
        energies = [body.energy(self.frame(body.frame, *carriers), self.gravity) for body in self.bodies]
        return np.asarray(np.sum(energies, axis=0))
