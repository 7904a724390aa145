"""Virtual work on the 2-RPR: a carrier across each leg (Parsa 2014, section 2.1), and the masses the thesis left out.

Leg i hangs on the base hinge A1 = (0, 0), A2 = (base distance, 0) and spans B - A_i = d_i u_i, with u = (cos θ, sin θ)
and n = (-sin θ, cos θ). Its working mode is the sign of d. No trigonometric function is needed: u is kept as a
vector, x + iy, and n is iu.

Leg i turns about A_i by θ̇ = n·ẋ/d and stretches by ḋ = u·ẋ, so a leg with moment T_θ about its hinge and force
T_d along itself resists the end-effector with n T_θ/d + u T_d. Bodies of a leg, in its own axes (u, n) from A:
cylinder rod, centre at half its length; piston rod, centre at d less half its length; carrier at (L, σ s), with
σ = +1, -1 on legs 1, 2. The end-effector is a point at B.

Arrays that differ from leg to leg are leg-major, (2, N).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, Frozen, checked, read_only
from redundancy_pin.dynamics.virtual_work.mechanism import (
    Body,
    ComplexArray,
    Lengths,
    LinkFrames,
    Parameters,
    Partials,
    PlanarDynamics,
    PlanarFrame,
    PlanarJoint,
    components,
    fixed_frame,
    planar,
    signs,
)
from redundancy_pin.errors import InputError

SIDE = np.array([[1.0], [-1.0]])
"""σ of each leg: the sense across the leg, along n, in which s grows (read off Parsa 2014, eq. 2.13 and 2.15)."""


@dataclass(frozen=True)
class TwoRprGeometry(Lengths):
    """The distance of the two base hinges, m.

    Raises:
        InputError: it is not positive and finite.
    """

    base_distance: float

    @property
    def base_x(self) -> Array:
        """(2, 1) abscissa of the base hinges, m; both lie on y = 0."""
        return read_only(np.array([[0.0], [self.base_distance]]))


@dataclass(frozen=True, eq=False)
class TwoRprLegs(Frozen):
    """The legs of the 2-RPR at sampled positions of the end-effector, in one working mode.

    Attributes:
        mode: sign of d of each leg.
        d: (2, N) signed leg length, m.
        u: (2, N) direction of the leg in the base frame, complex; NaN where d = 0.
        gap: (2, N) what the closure A + d u = B leaves, m; a few roundings, and 0 where d = 0.
    """

    mode: tuple[int, int]
    d: Array
    u: ComplexArray
    gap: Array

    @property
    def margin(self) -> Array:
        """(2, N) |d|, m: at d = 0 the direction of the leg is lost (type I)."""
        return np.abs(self.d)

    @property
    def theta(self) -> Array:
        """(2, N) angle of u against the base line, rad, in (-π, π]."""
        return read_only(np.angle(self.u))

    @property
    def jacobian(self) -> Array:
        """(N, 2, 2) J with ḋ = J ẋ; row i is u_i (Parsa 2014, eq. 2.2)."""
        return read_only(components(self.u))


class TwoRprRates(NamedTuple):
    """Rates, (2, N) each, of the leg lengths, m/s and m/s², and of the leg angles, rad/s and rad/s²."""

    d_rate: Array
    d_acceleration: Array
    theta_rate: Array
    theta_acceleration: Array


def inverse_displacement(geometry: TwoRprGeometry, point: ArrayLike, mode: Sequence[int] = (1, 1)) -> TwoRprLegs:
    """Return the legs that put the end-effector at ``point`` (Parsa 2014, eq. 2.1).

    Args:
        geometry: the lengths.
        point: (N, 2) end-effector B in the base frame, m. NaN passes through.
        mode: sign of d of each leg.

    Raises:
        InputError: ``point`` is not (N, 2) or ``mode`` not two signs.
    """
    sign = signs(mode, 2)
    B = np.asarray(point, dtype=float)
    if B.ndim != 2 or B.shape[1] != 2:
        raise InputError(
            f"point has shape {B.shape}, expected (N, 2).", remedy="Rows are samples, columns are x and y."
        )
    span = planar(B) - geometry.base_x
    span[np.abs(span) < np.finfo(float).tiny] = 0.0  # too short to be divided by
    d = np.abs(span) * sign
    with np.errstate(divide="ignore", invalid="ignore"):  # d = 0 has no direction: NaN says so
        u = span / d
    gap = np.abs(d * u - span)
    gap[d == 0.0] = 0.0  # whatever its direction
    return TwoRprLegs((int(sign[0, 0]), int(sign[1, 0])), *map(read_only, (d, u, gap)))


def leg_rates(legs: TwoRprLegs, velocity: ArrayLike, acceleration: ArrayLike) -> TwoRprRates:
    """Return the rates of the legs (Parsa 2014, eq. 2.2-2.9).

    From B = A + d u: v = ḋ u + d θ̇ n and a = (d̈ - d θ̇²) u + (d θ̈ + 2 ḋ θ̇) n, read along u and n.

    Velocity and acceleration are (N, 2), those of the end-effector's coordinates in the base frame.

    Raises:
        InputError: wrong shapes.
    """
    samples = legs.d.shape[1]
    # along u and across it: the real and the imaginary part
    v = np.conj(legs.u) * planar(checked(velocity, "velocity", (samples, 2)))
    a = np.conj(legs.u) * planar(checked(acceleration, "acceleration", (samples, 2)))
    with np.errstate(divide="ignore", invalid="ignore"):
        theta_rate = v.imag / legs.d
        d_acceleration = a.real + legs.d * theta_rate**2
        theta_acceleration = (a.imag - 2.0 * v.real * theta_rate) / legs.d
    return TwoRprRates(*map(read_only, (v.real, d_acceleration, theta_rate, theta_acceleration)))


class TwoRprMechanism:
    """The 2-RPR in one working mode.

    Args:
        parameters: those of the model ``2rpr``, kg and m. Cylinder and piston are slender rods, from the base hinge
            along the leg and from B back along it.
        gravity: (3,) acceleration of gravity in the base frame, m/s².
        mode: sign of d of each leg.
    """

    frames = (
        "base",
        *(f"{kind}_{leg}" for kind in ("cylinder", "piston", "track", "mass") for leg in (1, 2)),
        "end_effector",
    )
    joints = tuple(f"{kind}_{leg}" for kind in ("swivel", "slide", "carrier") for leg in (1, 2))
    angular_rows: tuple[bool, ...] = (False, False)
    angular_columns: tuple[bool, ...] = (False, False)

    def __init__(self, parameters: Parameters, gravity: Sequence[float], mode: Sequence[int]) -> None:
        self.geometry = TwoRprGeometry.from_parameters(parameters)
        self.tolerance = CLOSURE_TOLERANCE * self.geometry.base_distance
        self.least_margin = self.tolerance  # a leg of no length, m
        self.gravity, self.mode = gravity, mode
        self.track_offset = float(parameters["track_offset"])
        self.carrier_mass = float(parameters["carrier_mass"]) if parameters["carriers"] else 0.0
        self.end_effector_mass = float(parameters["end_effector_mass"])
        self.cylinder_mass, self.cylinder_length = (
            float(parameters["cylinder_mass"]),
            float(parameters["cylinder_length"]),
        )
        self.piston_mass, self.piston_length = float(parameters["piston_mass"]), float(parameters["piston_length"])
        cylinder, piston = self.cylinder_length, self.piston_length
        of_legs = (
            ("cylinder", self.cylinder_mass, 0.5 * cylinder, self.cylinder_mass * cylinder**2 / 12.0),
            ("piston", self.piston_mass, -0.5 * piston, self.piston_mass * piston**2 / 12.0),
            ("mass", self.carrier_mass, 0.0, 0.0),
        )
        self.bodies = tuple(Body(f"{kind}_{leg}", *values) for kind, *values in of_legs for leg in (1, 2))
        self.bodies += (Body("end_effector", self.end_effector_mass, 0.0, 0.0),)

    def legs(self, x: Array) -> TwoRprLegs:
        """Solve the inverse displacement at (N, 2) end-effector positions, m."""
        return inverse_displacement(self.geometry, x, self.mode)

    def along(self, legs: TwoRprLegs, x: Array, xd: Array, xdd: Array) -> TwoRprAlongMotion:
        """Return the dynamics along a motion (N, 2) through poses whose legs are solved."""
        return TwoRprAlongMotion(self, legs, x, xd, xdd)


class TwoRprAlongMotion(PlanarDynamics):
    """Dynamics of the 2-RPR along one motion; what does not depend on the carriers is computed once."""

    def __init__(
        self, mechanism: TwoRprMechanism, legs: TwoRprLegs, point: Array, velocity: Array, acceleration: Array
    ) -> None:
        self._p = p = mechanism
        self.bodies, self.gravity = p.bodies, p.gravity
        self._legs = legs
        self._rates = rates = leg_rates(legs, velocity, acceleration)
        g, u, d = complex(p.gravity[0], p.gravity[1]), legs.u, legs.d
        w, wd = rates.theta_rate, rates.theta_acceleration
        g_of_leg = np.conj(u) * g
        self._g_along, self._g_across = g_of_leg.real, g_of_leg.imag
        # Rods and the carrier's fixed offset L: moment about A_i = rate of angular momentum less moment of the weight.
        piston_arm = d - 0.5 * p.piston_length
        inertia = p.piston_mass * (p.piston_length**2 / 12.0 + piston_arm**2) + (
            p.cylinder_mass * p.cylinder_length**2 / 3.0 + p.carrier_mass * p.track_offset**2
        )
        first_moment = p.piston_mass * piston_arm + (
            0.5 * p.cylinder_mass * p.cylinder_length + p.carrier_mass * p.track_offset
        )
        moment = inertia * wd + 2.0 * p.piston_mass * piston_arm * rates.d_rate * w - first_moment * self._g_across
        thrust = p.piston_mass * (rates.d_acceleration - piston_arm * w * w - self._g_along)
        over_d = 1.0 / d
        self._n_over_d = np.stack([-u.imag * over_d, u.real * over_d])
        self._f_fixed = (self._n_over_d * moment + np.stack([u.real, u.imag]) * thrust).sum(axis=1)
        self._f_fixed += p.end_effector_mass * (acceleration - p.gravity[:2]).T

    def efforts(self, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return f, (2, N), N, and the carrier forces, (2, N), N (Parsa 2014, eq. 2.13-2.17, with gravity).

        The part of the carriers: f = Σ n h/d with h = m[s² θ̈ + 2 s ṡ θ̇ + σ L s̈ + σ s g·u], over the rest that
        does not depend on s. Across the leg, the carrier's actuator gives m[s̈ - s θ̇² + σ L θ̈ - σ g·n].
        """
        m, L = self._p.carrier_mass, self._p.track_offset
        w, wd = self._rates.theta_rate, self._rates.theta_acceleration
        moment = m * (s * (s * wd + 2.0 * w * sd + SIDE * self._g_along) + (SIDE * L) * sdd)
        f = self._f_fixed + (self._n_over_d * moment).sum(axis=1)
        force = m * (sdd - s * w * w + SIDE * (L * wd - self._g_across))
        return f, force

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> tuple[Partials, Partials]:
        """Return the derivatives of ``efforts``: f is quadratic in (s, ṡ) and affine in s̈."""
        m, L = self._p.carrier_mass, self._p.track_offset
        w, wd = self._rates.theta_rate, self._rates.theta_acceleration
        by_s = self._n_over_d * (m * (2.0 * s * wd + 2.0 * w * sd + SIDE * self._g_along))
        by_sd, by_sdd = self._n_over_d * (2.0 * m * s * w), self._n_over_d * (SIDE * (m * L))
        return (by_s, by_sd, by_sdd), (-m * w * w, np.zeros_like(w), np.full_like(w, m))

    def frame(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarFrame:
        """Return a link's frame; carriers (2, N)."""
        kind, _, number = name.rpartition("_")
        links, rates = self._links, self._rates
        if name == "base":
            return fixed_frame(self._legs.d.shape[1])
        leg = 0 if name == "end_effector" else int(number) - 1  # which is mounted on the first piston
        if kind == "mass":
            side = 1j * SIDE[leg, 0]
            zeta, rate, second = self._p.track_offset + side * s[leg], side * sd[leg], side * sdd[leg]
            return links.frame(leg, zeta, rate, second, carrier=leg, track=side * links.u[leg])
        if kind in ("cylinder", "track"):
            return links.frame(leg, self._p.track_offset if kind == "track" else 0.0)
        return links.frame(leg, self._legs.d[leg], rates.d_rate[leg], rates.d_acceleration[leg])

    def joint(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarJoint:
        """Return a joint's motion; carriers (2, N)."""
        kind, _, number = name.rpartition("_")
        leg, rates, u = int(number) - 1, self._rates, self._links.u
        spin = rates.theta_rate[leg], rates.theta_acceleration[leg]
        still = np.zeros(len(spin[0]))
        if kind == "swivel":
            return PlanarJoint(self._legs.theta[leg], *spin, still, still)
        if kind == "slide":
            return PlanarJoint(self._legs.d[leg], rates.d_rate[leg], rates.d_acceleration[leg], *spin, axis=u[leg])
        return PlanarJoint(s[leg], sd[leg], sdd[leg], *spin, carrier=leg, axis=1j * SIDE[leg, 0] * u[leg])

    @cached_property
    def _links(self) -> LinkFrames:
        """The legs, their origins at the base hinges."""
        still = np.zeros(self._legs.d.shape, dtype=np.complex128)
        base = self._p.geometry.base_x + still
        return LinkFrames(base, still, still, self._legs.u, self._rates.theta_rate, self._rates.theta_acceleration)
