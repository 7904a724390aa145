"""Virtual work on the 2-RPR: a carrier across each leg (Parsa 2014, section 2.1), and the masses the thesis left out.

Leg i hangs on the base hinge A1 = (0, 0), A2 = (base distance, 0) and spans B - A_i = d_i u_i, with u = (cos θ, sin θ)
and n = (-sin θ, cos θ). Its working mode is the sign of d. No trigonometric function is needed: u is kept as a
vector, x + iy, and n is iu.

Leg i turns about A_i by θ̇ = n·ẋ/d and stretches by ḋ = u·ẋ: these are the link Jacobians (eqs. 2.10 to 2.12). Bodies of
a leg, in its own axes (u, n) from A: cylinder rod, centre at half its length; piston rod, centre at d less half its
length; carrier at (L, σ s), with σ = +1, -1 on legs 1, 2. The end-effector is a point at B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, Frozen, read_only
from redundancy_pin.dynamics.virtual_work.mechanism import (
    Body,
    Carriers,
    ComplexArray,
    Parameters,
    PlanarDynamics,
    PlanarFrame,
    PlanarJoint,
    fixed_frame,
    planar,
    revolute,
)

SIDE = np.array([[1.0], [-1.0]])
"""σ of each leg: the sense across the leg, along n, in which s grows (read off Parsa 2014, eq. 2.13 and 2.15)."""


@dataclass(frozen=True, eq=False)
class TwoRprLegs(Frozen):
    """The legs of the 2-RPR at sampled positions of the end-effector, in one working mode.

    Attributes:
        d: (2, N) signed leg length, m.
        u: (2, N) direction of the leg in the base frame, complex; NaN where d = 0.
        residual: (2, N) what the closure A + d u = B leaves, m; a few roundings, and 0 where d = 0.
    """

    d: Array
    u: ComplexArray
    residual: Array

    @property
    def margin(self) -> Array:
        """(2, N) |d|, m: at d = 0 the direction of the leg is lost (type I)."""
        return np.abs(self.d)

    @property
    def jacobian(self) -> Array:
        """(2, 2, N) ḋ of each leg per unit of ẋ and ẏ: u_i (Parsa 2014, eq. 2.2)."""
        return read_only(np.stack([self.u.real, self.u.imag]))


def base_hinges(base_distance: float) -> Array:
    """Return (2, 1) abscissa of the base hinges, m; both lie on y = 0."""
    return np.array([[0.0], [base_distance]])


def inverse_displacement(base_distance: float, point: ArrayLike, mode: Sequence[int] = (1, 1)) -> TwoRprLegs:
    """Return the legs that put the end-effector at ``point`` (Parsa 2014, eq. 2.1).

    Args:
        base_distance: from hinge to hinge, m.
        point: (N, 2) end-effector B in the base frame, m. NaN passes through.
        mode: sign of d of each leg.
    """
    sign = np.array(mode, dtype=float)[:, None]
    span = planar(np.asarray(point, dtype=float)) - base_hinges(base_distance)
    span[np.abs(span) < np.finfo(float).tiny] = 0.0  # too short to be divided by
    d = np.abs(span) * sign
    with np.errstate(divide="ignore", invalid="ignore"):  # d = 0 has no direction: NaN
        u = span / d
    residual = np.abs(d * u - span)
    residual[d == 0.0] = 0.0  # whatever its direction
    return TwoRprLegs(*map(read_only, (d, u, residual)))


class TwoRprMechanism:
    """The 2-RPR in one working mode.

    Args:
        parameters: parameters of the model ``2rpr``, kg and m. Cylinder and piston are slender rods, from the base
            hinge along the leg and from B back along it.
        gravity: (3,) acceleration of gravity in the base frame, m/s².
        mode: sign of d of each leg.
    """

    frames = (
        "base",
        *(f"{kind}_{leg}" for kind in ("cylinder", "piston", "track", "mass") for leg in (1, 2)),
        "end_effector",
    )
    joints = tuple(f"{kind}_{leg}" for kind in ("swivel", "slide", "carrier") for leg in (1, 2))

    def __init__(self, parameters: Parameters, gravity: Sequence[float], mode: Sequence[int]) -> None:
        self.base_distance = float(parameters["base_distance"])
        self.tolerance = CLOSURE_TOLERANCE * self.base_distance
        self.least_margin = self.tolerance  # a leg of no length, m
        self.gravity, self.mode = gravity, mode
        self.track_offset = float(parameters["track_offset"])
        carrier_mass = float(parameters["carrier_mass"]) if parameters["carriers"] else 0.0
        cylinder, piston = (float(parameters[f"{kind}_mass"]) for kind in ("cylinder", "piston"))
        long_cylinder, long_piston = (float(parameters[f"{kind}_length"]) for kind in ("cylinder", "piston"))
        of_legs = (
            ("cylinder", cylinder, 0.5 * long_cylinder, cylinder * long_cylinder**2 / 12.0),
            ("piston", piston, -0.5 * long_piston, piston * long_piston**2 / 12.0),
            ("mass", carrier_mass, 0.0, 0.0),
        )
        self.bodies = tuple(Body(f"{kind}_{leg}", *values) for kind, *values in of_legs for leg in (1, 2))
        self.bodies += (Body("end_effector", float(parameters["end_effector_mass"]), 0.0, 0.0),)

    def legs(self, x: Array) -> TwoRprLegs:
        """Solve the inverse displacement at (N, 2) end-effector positions, m."""
        return inverse_displacement(self.base_distance, x, self.mode)

    def along(self, legs: TwoRprLegs, x: Array, xd: Array, xdd: Array) -> TwoRprAlongMotion:
        """Return the dynamics along a motion (N, 2) through poses whose legs are solved."""
        return TwoRprAlongMotion(self, legs, x, xd, xdd)


class TwoRprAlongMotion(PlanarDynamics):
    """Dynamics of the 2-RPR along one motion, whose positions, rates and accelerations are (N, 2) each.

    From B = A + d u follow v = ḋ u + d θ̇ n and a = (d̈ - d θ̇²) u + (d θ̈ + 2 ḋ θ̇) n, which are read along u and n
    (Parsa 2014, eq. 2.2-2.9).
    """

    def __init__(
        self, mechanism: TwoRprMechanism, legs: TwoRprLegs, point: Array, velocity: Array, acceleration: Array
    ) -> None:
        self.bodies, self.gravity, d = mechanism.bodies, mechanism.gravity, legs.d
        self.shape, self._legs = (2, *d.shape), legs
        # along u and across it: the real and the imaginary part
        v, a = np.conj(legs.u) * planar(velocity), np.conj(legs.u) * planar(acceleration)
        with np.errstate(divide="ignore", invalid="ignore"):
            theta_rate = v.imag / d
            theta_acceleration = (a.imag - 2.0 * v.real * theta_rate) / d
        self._d_rate, self._d_acceleration = v.real, a.real + d * theta_rate**2
        # per unit of ẋ and ẏ: θ̇ = n·ẋ/d (eq. 2.11)
        unit_theta = np.stack([-legs.u.imag, legs.u.real]) / d
        base = fixed_frame(base_hinges(mechanism.base_distance) + 0j * d, 1.0, 2, moves=True)
        self._cylinders = replace(base, axis=legs.u, spin=theta_rate, spin_rate=theta_acceleration, G=unit_theta)
        self._tracks = self._cylinders.point(mechanism.track_offset)

    def _slide(self, leg: int) -> tuple[Array, Array, Array, Array]:
        """Return d, ḋ, d̈ of a leg (N,), and ḋ per unit of each platform rate (2, N)."""
        return self._legs.d[leg], self._d_rate[leg], self._d_acceleration[leg], self._legs.jacobian[:, leg]

    def frame(self, name: str, carriers: Carriers) -> PlanarFrame:
        """Return a link's frame."""
        kind, _, number = name.rpartition("_")
        if name == "base":
            return fixed_frame(np.zeros(self.shape[2], dtype=np.complex128), 1.0, 2)
        leg = 0 if name == "end_effector" else int(number) - 1  # which is mounted on the first piston
        if kind == "mass":
            return self._tracks.carried(leg, 1j * SIDE[leg, 0], carriers)
        if kind in ("cylinder", "track"):
            return (self._cylinders if kind == "cylinder" else self._tracks).of(leg)
        return self._cylinders.of(leg).point(*self._slide(leg))

    def joint(self, name: str, carriers: Carriers) -> PlanarJoint:
        """Return a joint's motion."""
        kind, _, number = name.rpartition("_")
        leg, link = int(number) - 1, self.frame(f"cylinder_{number}", carriers)
        if kind == "swivel":
            return revolute(self.frame("base", carriers), link)
        if kind == "slide":
            return PlanarJoint(*self._slide(leg), link, axis=link.axis)
        s, sd, sdd = (part[leg] for part in carriers)
        return PlanarJoint(s, sd, sdd, 0.0 * link.G, link, axis=1j * SIDE[leg, 0] * link.axis, carrier=leg)
