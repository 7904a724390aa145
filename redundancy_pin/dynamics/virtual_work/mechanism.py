"""Virtual work of planar mechanisms (Parsa 2014, eqs. 2.39 to 2.53): inertia forces times velocities per unit rate.

A body with centre C resists with the force m (g − a_C) and the moment −I ω̇ (eqs. 2.45 to 2.52). With the link Jacobians
H_j, the velocity of a point per unit of the platform rate ẋ_j, and G_j, the spin of the link per unit of it, their
virtual power and the actuators' must add up to zero (eq. 2.53):

    f_j = Σ Re(conj(m (a_C − g)) H_j) + I ω̇ G_j,      carrier force = Re(conj(m (a_C − g)) t),

where t is the direction of the carrier's track. Vectors of the plane are complex, x + iy in the base frame; u̇ = iω u.
Arrays of all legs are leg-major, (legs, N): one row per leg, one column per sample.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array

Parameters = Mapping[str, float | bool | str]
"""The parameters of a shipped model."""

ComplexArray = NDArray[np.complex128]
Complex = ComplexArray | Array | complex

Carriers = tuple[Array, Array, Array]
"""s, ṡ, s̈ of the carriers, (legs, N) each, m and s."""


def planar(vectors: Array) -> ComplexArray:
    """Return (N,) vectors of the plane as x + iy, from the first two columns of (N, n) coordinates."""
    return np.asarray(vectors[:, 0] + 1j * vectors[:, 1], dtype=np.complex128)


@dataclass(frozen=True, eq=False)
class PlanarFrame:
    """A frame on a link, or on that link of every leg, at N samples; arrays (N,) or (legs, N).

    Attributes:
        place, velocity, acceleration: of its origin, m, m/s, m/s².
        axis: unit vector u along its x axis.
        spin, spin_rate: ω and ω̇, rad/s and rad/s².
        H: (n, ...) velocity of the origin per unit of each platform rate; complex.
        G: (n, ...) spin per unit of each platform rate.
        carrier: index of the carrier that it is on, or None; ``track`` is the unit vector along which it moves.
        moves: false if it is fixed to the base.
    """

    place: ComplexArray
    velocity: ComplexArray
    acceleration: ComplexArray
    axis: ComplexArray
    spin: Array
    spin_rate: Array
    H: ComplexArray
    G: Array
    carrier: int | None = None
    track: ComplexArray | None = None
    moves: bool = True

    @property
    def curl(self) -> ComplexArray:
        """(N,) iω̇ − ω²: acceleration of a point of the link per unit of its distance."""
        return np.asarray(1j * self.spin_rate - self.spin**2, dtype=np.complex128)

    def point(
        self, zeta: Complex, rate: Complex = 0.0, second_rate: Complex = 0.0, unit_rate: Complex = 0.0
    ) -> PlanarFrame:
        """Return the parallel frame at ζ = (along) + i (across) the link; ζ may move, by ∂ζ̇/∂ẋ_j = ``unit_rate``.

        z = z_O + ζ u, v = v_O + (ζ̇ + iω ζ) u, a = a_O + (ζ̈ + 2iω ζ̇ + (iω̇ − ω²) ζ) u.
        """
        u, turn = self.axis, 1j * self.spin
        return replace(
            self,
            place=self.place + zeta * u,
            velocity=self.velocity + (rate + turn * zeta) * u,
            acceleration=self.acceleration + (second_rate + 2.0 * turn * rate + self.curl * zeta) * u,
            H=self.H + (unit_rate + 1j * self.G * zeta) * u,
        )

    def of(self, leg: int) -> PlanarFrame:
        """Return the frame of one leg."""
        parts = self.place, self.velocity, self.acceleration, self.axis, self.spin, self.spin_rate
        place, velocity, acceleration, axis, spin, spin_rate = (part[leg] for part in parts)
        return PlanarFrame(place, velocity, acceleration, axis, spin, spin_rate, self.H[:, leg], self.G[:, leg])

    def carried(self, leg: int, direction: complex, carriers: Carriers) -> PlanarFrame:
        """Return the frame of the carrier of one leg, whose track begins here and runs along ``direction`` u."""
        s, sd, sdd = (direction * part[leg] for part in carriers)
        return replace(self.of(leg).point(s, sd, sdd), carrier=leg, track=direction * self.axis[leg])


def fixed_frame(place: ComplexArray, axis: Complex, n: int, *, moves: bool = False) -> PlanarFrame:
    """Return a frame that does not move, (...,) its origin, for n platform rates."""
    still = np.zeros(place.shape, dtype=np.complex128)
    zero = np.zeros((n, *place.shape))
    return PlanarFrame(place, still, still, still + axis, still.real, still.real, zero + 0j, zero, moves=moves)


@dataclass(frozen=True, eq=False)
class PlanarJoint:
    """A joint at N samples, (N,) each.

    Attributes:
        position, rate, acceleration: m or rad, and s; the position of a revolute joint is known up to full turns.
        unit_rate: (n, N) its rate per unit of each platform rate.
        link: a frame of the link that carries it.
        axis: unit vector along a prismatic joint; None for a revolute one.
        carrier: index of the carrier that it moves, or None.
    """

    position: Array
    rate: Array
    acceleration: Array
    unit_rate: Array
    link: PlanarFrame
    axis: ComplexArray | None = None
    carrier: int | None = None


def revolute(before: PlanarFrame, after: PlanarFrame) -> PlanarJoint:
    """Return the hinge between two links; its angle is in (−π, π]."""
    angle, rate = np.angle(after.axis * np.conj(before.axis)), after.spin - before.spin
    return PlanarJoint(angle, rate, after.spin_rate - before.spin_rate, after.G - before.G, before)


class Efforts:
    """Sum of what bodies and loads require, with its exact derivatives by the carriers where they are wanted.

    Attributes:
        f: (n, N) generalised force, N and N·m.
        force: (legs, N) force of each carrier's actuator, N.
        ground: (N, 6) force and moment on the base about the world origin, world axes, N and N·m.
        energy: (N,) kinetic plus potential energy, J; weight has none at the world origin.
        by_f: (3, n, legs, N) derivatives of f by s, ṡ, s̈ of each carrier.
        by_force: (3, legs, legs, N) derivatives of each carrier's force likewise.
        derivatives: whether the last two are wanted.
    """

    def __init__(self, n: int, legs: int, samples: int, *, derivatives: bool = False) -> None:
        self.f, self.force, self.derivatives = np.zeros((n, samples)), np.zeros((legs, samples)), derivatives
        self.ground, self.energy = np.zeros((samples, 6)), np.zeros(samples)
        self.by_f = np.zeros((3, n, legs, samples if derivatives else 0))
        self.by_force = np.zeros((3, legs, legs, samples if derivatives else 0))

    def resist(
        self,
        point: PlanarFrame,
        push: ComplexArray,
        moment: Array | float = 0.0,
        changes: Mapping[int, Sequence[ComplexArray]] | None = None,
    ) -> None:
        """Balance a force and a moment that act on a link at a point.

        Args:
            point: a frame of the link, its origin at the point.
            push: (N,) the force, N.
            moment: (N,) N·m.
            changes: by carrier the derivatives of the force by its s, ṡ, s̈.
        """
        self.f -= (np.conj(push) * point.H).real + moment * point.G
        track, own = point.track, point.carrier
        if track is not None and own is not None:
            self.force[own] -= (np.conj(push) * track).real
        if not self.derivatives:
            return
        for carrier, parts in (changes or {}).items():
            for order, part in enumerate(parts):
                self.by_f[order, :, carrier] -= (np.conj(part) * point.H).real
                if track is not None and own is not None:
                    self.by_force[order, own, carrier] -= (np.conj(part) * track).real
        if track is not None and own is not None:
            self.by_f[0, :, own] -= (np.conj(push) * 1j * point.G * track).real  # H moves with the carrier


def wrench_on_ground(
    place: ComplexArray, height: float, push: ComplexArray, lift: Array, tilt: ComplexArray, moment: Array
) -> Array:
    """Return (N, 6) the wrench about the world origin of a force (push, lift), N, at a place, and moments, N·m."""
    about_x, about_y = tilt.real + place.imag * lift, tilt.imag - place.real * lift
    turning = about_x - height * push.imag, about_y + height * push.real, moment + (np.conj(place) * push).imag
    return np.stack([push.real, push.imag, lift, *turning], axis=1)


class Body(NamedTuple):
    """A rigid body on a link, its centre of mass in a plane parallel to the plane of motion.

    ``frame``: name of the link; ``mass``, kg; ``centre`` in the axes of the frame, x + iy, m; ``inertia`` about the
    centre and the z axis, kg·m²; ``height`` of the centre, m; ``products`` of inertia about it, xz + i yz, kg·m².
    """

    frame: str
    mass: float
    centre: complex
    inertia: float
    height: float = 0.0
    products: complex = 0.0

    def add_to(self, efforts: Efforts, here: PlanarFrame, gravity: Sequence[float] | Array) -> None:
        """Add what moves the body, whose link has the frame ``here``, to the efforts.

        On the base act weight less rate of momentum. The centre stays at one height, and the inertia is turned about z:
        of the products with z the rates are moments about x and y, d/dt (I_xz + i I_yz) e^{iφ} ω.
        """
        centre, g = here.point(self.centre), complex(gravity[0], gravity[1])
        push, moment = self.mass * (g - centre.acceleration), -self.inertia * centre.spin_rate
        changes = {}
        if here.track is not None and here.carrier is not None:
            per_unit = (here.curl, 2j * here.spin, 1.0)  # of the acceleration along the track, by s, ṡ, s̈
            changes[here.carrier] = [-self.mass * part * here.track for part in per_unit]
        efforts.resist(centre, push, moment, changes)
        if here.moves:
            tilt = -self.products * here.axis * (here.spin_rate + 1j * here.spin**2)
            weight = np.full(len(push), self.mass * gravity[2])
            efforts.ground += wrench_on_ground(centre.place, self.height, push, weight, tilt, moment)
            lifted = (np.conj(g) * centre.place).real + gravity[2] * self.height
            kinetic = 0.5 * self.mass * np.abs(centre.velocity) ** 2 + 0.5 * self.inertia * here.spin**2
            efforts.energy += kinetic - self.mass * lifted


class PlanarDynamics(ABC):
    """Dynamics of a mechanism along one motion of N samples, with carriers (legs, N): sums over its bodies.

    ``bodies``: of all links; ``gravity`` (3,) m/s²; ``shape``: n platform rates, legs and N.
    """

    bodies: Sequence[Body]
    gravity: Sequence[float] | Array
    shape: tuple[int, int, int]

    @abstractmethod
    def frame(self, name: str, carriers: Carriers) -> PlanarFrame:
        """Return a link's frame."""

    @abstractmethod
    def joint(self, name: str, carriers: Carriers) -> PlanarJoint:
        """Return a joint's motion."""

    @cached_property
    def _without_carriers(self) -> Efforts:
        """What all bodies require that are on no carrier."""
        efforts, parked = Efforts(*self.shape), (np.zeros(self.shape[1:]),) * 3
        for body in self.bodies:
            here = self.frame(body.frame, parked)
            if here.carrier is None:
                body.add_to(efforts, here, self.gravity)
        return efforts

    def efforts(self, carriers: Carriers, *, derivatives: bool = False) -> Efforts:
        """Return the generalised forces of the links and carriers (Parsa 2014, eqs. 2.17 and 2.53, with gravity)."""
        efforts, others = Efforts(*self.shape, derivatives=derivatives), self._without_carriers
        efforts.f += others.f
        efforts.ground += others.ground
        efforts.energy += others.energy
        for body in self.bodies:
            if body.frame.startswith("mass_"):
                body.add_to(efforts, self.frame(body.frame, carriers), self.gravity)
        return efforts
