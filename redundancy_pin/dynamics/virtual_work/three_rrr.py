"""Virtual work on the 3-RRR with a carrier on each distal link (Parsa 2014, section 2.2), gravity included.

Leg i runs from the base hinge G over the elbow B = G + l1 u(θ) to the platform corner A = B + l2 u(β), with
A = P - l3 u(φ) and φ = α + 30°, α + 150°, α - 90°; u(θ) = (cos θ, sin θ), and v⊥ = (-v_y, v_x) is v turned by +90°.
The working mode of a leg is the sign in θ = γ ± ψ, γ the direction of A from G and ψ the angle at G in the triangle
G B A. The links are kept as vectors b = l1 u(θ) and e = l2 u(β), x + iy, found by rotating A - G within its triangle,
so that the cosine and sine of α are the only trigonometric functions.

With ω = θ̇, Ω = β̇, the sums m = m2 + m_s, S = m2 r_a + m_s s (first moment about the elbow B) and
I = I2 + m2 r_a² + m_s s², an acceleration a_B of the elbow less gravity, and u, n along and across the distal link, leg
i resists with

    T_θ = m1 l1²/3 θ̈ - m1 g·b⊥/2 + b⊥·F,    F = m a_B + S (β̈ n - Ω² u) + m_s (s̈ u + 2 ṡ Ω n),
    T_β = I β̈ + S n·a_B + 2 m_s s ṡ Ω,

moments about the base hinge and about the elbow (eq. 2.45-2.50 with the opposite sign). Since θ̇ = -e·v_A/c and
l2² β̇ = e⊥·v_A - θ̇ e·b (v_A the velocity of the platform's corner), their virtual power is R·v_A with

    R = -(T_θ - (e·b/l2²) T_β) e/c + T_β e⊥/l2²:

the force the platform has to put on the corner. The generalised force is Σ R, its moment Σ (A - P) x R, and the
platform's own inertia (eq. 2.51-2.53). The products with 3 x 3 link Jacobians never need to be formed.

Arrays that differ from leg to leg are leg-major, (3, N).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, Frozen, checked, read_only
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

CORNER_ANGLES = (np.pi / 6.0, 5.0 * np.pi / 6.0, -np.pi / 2.0)
"""φ - α of each leg, rad (Parsa 2014, eq. 2.20)."""

LEAST_ELBOW_SINE = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Sine of the elbow below which a pose counts as a type I singularity: a leg that close to straight or folded becomes
exactly so when its end moves by the closure tolerance (relative to the links), so the mode is no longer resolved."""


@dataclass(frozen=True)
class ThreeRrrGeometry(Lengths):
    """Lengths that fix the kinematics of the 3-RRR, m.

    Attributes:
        base_radius: circumradius of the triangle of base hinges; the first hinge is the origin.
        platform_radius: l3, from the platform's centre to its corners.
        proximal_length: l1.
        distal_length: l2.

    Raises:
        InputError: a length is not positive and finite.
    """

    base_radius: float
    platform_radius: float
    proximal_length: float
    distal_length: float

    @property
    def tolerance(self) -> float:
        """Largest closure residual of a closed leg, m."""
        return CLOSURE_TOLERANCE * (self.proximal_length + self.distal_length)

    @property
    def base_points(self) -> Array:
        """(3, 2) base hinges G in the base frame, m."""
        triangle = np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0], [np.sqrt(3.0) / 2.0, 1.5]])
        return read_only(self.base_radius * triangle)

    @property
    def hinges(self) -> ComplexArray:
        """(3, 1) the same, complex."""
        return planar(self.base_points)[:, None]


@dataclass(frozen=True, eq=False)
class ThreeRrrLegs(Frozen):
    """The legs of the 3-RRR at sampled platform poses, in one working mode; each array is (3, N), vectors x + iy.

    Attributes:
        geometry: the lengths.
        mode: sign of each leg in θ = γ ± ψ.
        arm: from the platform's centre to its corner, A - P = -l3 u(φ), m.
        b: proximal link B - G, m; NaN out of reach.
        e: distal link A - B, m; NaN out of reach.
        c: (A - G) x b, m²: minus l1 l2 times the sine of the elbow angle β - θ, zero at a type I
            singularity (Parsa 2014, eq. 2.37); its sign is the mode. NaN out of reach.
        gap: how far the corner is out of the leg's reach, m; where it is within, what the closure
            |A - B| = l2 leaves (a few roundings).
    """

    geometry: ThreeRrrGeometry
    mode: tuple[int, int, int]
    arm: ComplexArray
    b: ComplexArray
    e: ComplexArray
    c: Array
    gap: Array

    @property
    def reachable(self) -> BoolArray:
        """(3, N) whether the leg reaches its corner, to within the closure tolerance."""
        return read_only(self.gap <= self.geometry.tolerance)

    @property
    def theta(self) -> Array:
        """(3, N) angle of the proximal link, rad, in (-π, π]."""
        return read_only(np.angle(self.b))

    @property
    def beta(self) -> Array:
        """(3, N) angle of the distal link, rad, in (-π, π]."""
        return read_only(np.angle(self.e))

    @property
    def margin(self) -> Array:
        """(3, N) |sin(β - θ)|: 0 where the leg is straight or folded (type I)."""
        return read_only(np.abs(self.c) / (self.geometry.proximal_length * self.geometry.distal_length))

    @property
    def jacobian(self) -> Array:
        """(N, 3, 3) J with θ̇ = J ẋ: row i is -(a, b, d)/c (Parsa 2014, eq. 2.34-2.38)."""
        with np.errstate(divide="ignore", invalid="ignore"):
            rows = -self.e / self.c
        return read_only(components(rows, (np.conj(self.arm) * rows).imag))

    @property
    def platform_matrix(self) -> Array:
        """(N, 3, 3) matrix of rows (a, b, d), m, m and m²; singular at a type II singularity (eq. 2.38)."""
        return read_only(components(self.e, (np.conj(self.arm) * self.e).imag))


class ThreeRrrRates(NamedTuple):
    """Rates, (3, N) each, of the angles of the proximal and of the distal links, rad/s and rad/s²."""

    theta_rate: Array
    theta_acceleration: Array
    beta_rate: Array
    beta_acceleration: Array


def inverse_displacement(geometry: ThreeRrrGeometry, pose: ArrayLike, mode: Sequence[int] = (1, 1, 1)) -> ThreeRrrLegs:
    """Return the legs that put the platform at ``pose`` (Parsa 2014, eq. 2.18-2.27).

    With p = A - G, ρ = |p|, q = (l1² + ρ² - l2²)/2 and c = ± sqrt(l1² ρ² - q²), turning p by ±ψ gives
    b = (q p + c p⊥)/ρ². The root is twice the area of the triangle with sides l1, l2, ρ, taken in Heron's
    factored form: it keeps its digits next to a type I singularity.

    Args:
        geometry: the lengths.
        pose: (N, 3) platform centre and orientation (x, y, α) in the base frame, m and rad. NaN passes through.
        mode: sign of each leg.

    Raises:
        InputError: ``pose`` is not (N, 3) or ``mode`` not three signs.
    """
    sign = signs(mode, 3)
    x = np.asarray(pose, dtype=float)
    if x.ndim != 2 or x.shape[1] != 3:
        raise InputError(
            f"pose has shape {x.shape}, expected (N, 3).", remedy="Rows are samples, columns are x, y and α."
        )
    l1, l2 = geometry.proximal_length, geometry.distal_length
    corners = -geometry.platform_radius * np.exp(1j * np.array(CORNER_ANGLES))
    arm = corners[:, None] * np.exp(1j * x[:, 2])
    span = planar(x) + arm - geometry.hinges
    rho_squared = span.real**2 + span.imag**2
    rho = np.sqrt(rho_squared)
    shortage = np.maximum(rho - (l1 + l2), abs(l1 - l2) - rho)
    sixteen_area_squared = (rho + (l1 + l2)) * ((l1 + l2) - rho) * (rho - (l1 - l2)) * (rho + (l1 - l2))
    c = sign * (0.5 * np.sqrt(np.maximum(sixteen_area_squared, 0.0)))
    out_of_reach = shortage > geometry.tolerance
    if out_of_reach.any():
        c[out_of_reach] = np.nan
    q = 0.5 * (rho_squared + (l1 - l2) * (l1 + l2))
    with np.errstate(divide="ignore", invalid="ignore"):  # ρ = 0: every direction closes the leg, and c = 0 says so
        b = (q / rho_squared + 1j * (c / rho_squared)) * span
    e = span - b
    # fmax: the shortage where there is no e
    gap = np.fmax(np.abs(np.sqrt(e.real**2 + e.imag**2) - l2), shortage)
    label = (int(sign[0, 0]), int(sign[1, 0]), int(sign[2, 0]))
    return ThreeRrrLegs(geometry, label, *map(read_only, (arm, b, e, c, gap)))


def leg_rates(legs: ThreeRrrLegs, velocity: ArrayLike, acceleration: ArrayLike) -> ThreeRrrRates:
    """Return the rates of the link angles (Parsa 2014, eq. 2.28-2.38).

    The corner moves with v_A = v + α̇ (A - P)⊥ and a_A = a + α̈ (A - P)⊥ - α̇² (A - P). Since |A - B| = l2:
    e·(v_A - v_B) = 0 and e·(a_A - a_B) + l2² β̇² = 0, with v_B = θ̇ b⊥, a_B = θ̈ b⊥ - θ̇² b and e·b⊥ = -c.
    Across the distal link, l2² β̇ = e⊥·(v_A - v_B) and l2² β̈ = e⊥·(a_A - a_B).

    Velocity and acceleration are (N, 3), those of the platform's coordinates in the base frame.

    Raises:
        InputError: wrong shapes.
    """
    samples = legs.c.shape[1]
    v = checked(velocity, "velocity", (samples, 3))
    a = checked(acceleration, "acceleration", (samples, 3))
    b, across, over_length = legs.b, np.conj(legs.e), 1.0 / legs.geometry.distal_length**2
    corner_v = planar(v) + 1j * v[:, 2] * legs.arm
    corner_a = planar(a) + (1j * a[:, 2] - v[:, 2] ** 2) * legs.arm
    # along e and across it: the real and the imaginary part of ē z
    with np.errstate(divide="ignore", invalid="ignore"):
        over_c = -1.0 / legs.c
        theta_rate = (across * corner_v).real * over_c
        across_v = (across * (corner_v - 1j * theta_rate * b)).imag
        beta_rate = across_v * over_length
        pull = corner_a + theta_rate**2 * b
        theta_acceleration = ((across * pull).real + across_v * beta_rate) * over_c
        beta_acceleration = (across * (pull - 1j * theta_acceleration * b)).imag * over_length
    return ThreeRrrRates(*map(read_only, (theta_rate, theta_acceleration, beta_rate, beta_acceleration)))


class ThreeRrrMechanism:
    """The 3-RRR in one working mode.

    The proximal link is a slender rod from the base hinge to the elbow. The distal link is one from the end of its tail
    to the platform; the tail is there for the carrier, so a robot without carriers has none. A platform inertia of
    "auto" is that of a uniform disc.

    Args:
        parameters: those of the model ``3rrr``, kg and m.
        gravity: (3,) acceleration of gravity in the base frame, m/s².
        mode: sign of each leg in θ = γ ± ψ.
    """

    frames = (
        "base",
        *(f"{kind}_{leg}" for kind in ("proximal", "distal", "tip", "mass") for leg in (1, 2, 3)),
        *("platform_arm", "platform", "corner_2", "corner_3"),
    )
    joints = (*(f"{kind}_{leg}" for kind in ("base", "elbow", "carrier") for leg in (1, 2, 3)), "wrist_1")
    angular_rows: tuple[bool, ...] = (False, False, True)
    angular_columns: tuple[bool, ...] = (True, True, True)
    least_margin = LEAST_ELBOW_SINE

    def __init__(self, parameters: Parameters, gravity: Sequence[float], mode: Sequence[int]) -> None:
        self.geometry = geometry = ThreeRrrGeometry.from_parameters(parameters)
        self.tolerance = geometry.tolerance
        self.gravity, self.mode = gravity, mode
        carriers, given = bool(parameters["carriers"]), parameters["platform_inertia"]
        tail = float(parameters["tail_length"]) if carriers else 0.0
        self.proximal_mass = float(parameters["proximal_mass"])
        self.distal_mass = float(parameters["distal_mass"])
        self.distal_centre = 0.5 * (geometry.distal_length - tail)  # r_a, from the elbow towards the platform
        self.distal_inertia = self.distal_mass * (geometry.distal_length + tail) ** 2 / 12.0
        self.platform_mass = float(parameters["platform_mass"])
        disc = 0.5 * self.platform_mass * geometry.platform_radius**2
        self.platform_inertia = disc if given == "auto" else float(given)
        self.carrier_mass = float(parameters["carrier_mass"]) if carriers else 0.0
        length = geometry.proximal_length
        of_legs = (
            ("proximal", self.proximal_mass, 0.5 * length, self.proximal_mass * length**2 / 12.0),
            ("distal", self.distal_mass, self.distal_centre, self.distal_inertia),
            ("mass", self.carrier_mass, 0.0, 0.0),
        )
        self.bodies = tuple(Body(f"{kind}_{leg}", *values) for kind, *values in of_legs for leg in (1, 2, 3))
        self.bodies += (Body("platform", self.platform_mass, 0.0, self.platform_inertia),)

    def legs(self, x: Array) -> ThreeRrrLegs:
        """Solve the inverse displacement at (N, 3) platform poses (x, y, α), m and rad."""
        return inverse_displacement(self.geometry, x, self.mode)

    def along(self, legs: ThreeRrrLegs, x: Array, xd: Array, xdd: Array) -> ThreeRrrAlongMotion:
        """Return the dynamics along a motion (N, 3) through poses whose legs are solved."""
        return ThreeRrrAlongMotion(self, legs, x, xd, xdd)


class ThreeRrrAlongMotion(PlanarDynamics):
    """Dynamics of the 3-RRR along one motion; what does not depend on the carriers is computed once."""

    def __init__(
        self, mechanism: ThreeRrrMechanism, legs: ThreeRrrLegs, pose: Array, velocity: Array, acceleration: Array
    ) -> None:
        self._p = p = mechanism
        self.bodies, self.gravity = p.bodies, p.gravity
        self._legs = legs
        self._motion = pose, velocity, acceleration
        self._rates = rates = leg_rates(legs, velocity, acceleration)
        g = complex(p.gravity[0], p.gravity[1])
        l1, l2 = p.geometry.proximal_length, p.geometry.distal_length
        b, e, c = legs.b, legs.e, legs.c
        w_squared, wd = rates.theta_rate * rates.theta_rate, rates.theta_acceleration
        W, Wd = rates.beta_rate, rates.beta_acceleration
        # acceleration of the elbow less gravity, θ̈ b⊥ - θ̇² b - g, along and across the distal link
        elbow = np.conj(e) * ((1j * wd - w_squared) * b - g) / l2
        self._a_along, self._a_across = elbow.real, elbow.imag
        # b⊥ along and across the distal link: b⊥·e = -c, b⊥·e⊥ = b·e
        b_dot_e = (np.conj(b) * e).real
        self._along, self._across = c * (-1.0 / l2), b_dot_e * (1.0 / l2)
        self._W, self._Wd, self._W_squared = W, Wd, W * W
        # b⊥·(β̈ n - Ω² u), per unit of first moment
        self._swing = self._across * Wd - self._along * self._W_squared
        m = p.distal_mass + p.carrier_mass
        # b⊥·a_B = l1² θ̈ - g·b⊥, so the moment of the proximal rod's own weight is folded in here
        self._T_theta_fixed = (l1 * l1 * (p.proximal_mass / 3.0 + m)) * wd
        self._T_theta_fixed += (0.5 * p.proximal_mass + m) * (np.conj(g) * b).imag
        # R = -(T_θ - κ T_β) e/c + T_β e⊥/l2²
        self._kappa = b_dot_e * (1.0 / l2**2)
        self._pull, self._turn = e * (-1.0 / c), e * (1j / l2**2)

    def efforts(self, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return f, (3, N), N and N·m, and the carrier forces, (3, N), N.

        The carrier's actuator gives m_s (s̈ - s Ω² + u·a_B).
        """
        p = self._p
        ms = p.carrier_mass
        first_moment = ms * s + p.distal_mass * p.distal_centre
        inertia = (ms * s) * s + (p.distal_inertia + p.distal_mass * p.distal_centre**2)
        coriolis = (2.0 * ms) * (sd * self._W)
        T_theta = self._T_theta_fixed + first_moment * self._swing
        T_theta += (ms * sdd) * self._along + coriolis * self._across
        T_beta = inertia * self._Wd + first_moment * self._a_across + s * coriolis
        force = ms * (sdd - s * self._W_squared + self._a_along)
        f = self._of_each_leg(T_theta, T_beta).sum(axis=1)
        f[:2] += p.platform_mass * (self._motion[2][:, :2] - p.gravity[:2]).T
        f[2] += p.platform_inertia * self._motion[2][:, 2]
        return f, force

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> tuple[Partials, Partials]:
        """Return the derivatives of ``efforts``: f is quadratic in (s, ṡ) and affine in s̈."""
        ms = self._p.carrier_mass
        rate = (2.0 * ms) * self._W
        by_s = self._of_each_leg(ms * self._swing, ms * (2.0 * s * self._Wd + self._a_across) + rate * sd)
        by_sd = self._of_each_leg(rate * self._across, rate * s)
        by_sdd = self._of_each_leg(ms * self._along, np.zeros_like(s))
        return (by_s, by_sd, by_sdd), (-ms * self._W_squared, np.zeros_like(s), np.full_like(s, ms))

    def frame(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarFrame:
        """Return a link's frame; carriers (3, N)."""
        kind, _, number = name.rpartition("_")
        proximal, distal = self._links
        if name == "base":
            return fixed_frame(self._legs.c.shape[1])
        if kind in ("proximal", "distal", "tip", "mass"):
            leg = int(number) - 1
            if kind == "mass":
                return distal.frame(leg, s[leg], sd[leg], sdd[leg], carrier=leg, track=distal.u[leg])
            ahead = self._p.geometry.distal_length if kind == "tip" else 0.0
            return (proximal if kind == "proximal" else distal).frame(leg, ahead)
        x, v, a = self._motion
        centre = PlanarFrame(planar(x), planar(v), planar(a), np.exp(1j * x[:, 2]), v[:, 2], a[:, 2])
        if name == "platform":
            return centre
        corner = {"platform_arm": 0, "corner_2": 1, "corner_3": 2}[name]
        arm = -self._p.geometry.platform_radius * np.exp(1j * CORNER_ANGLES[corner])
        return PlanarFrame(*centre.point(complex(arm)), centre.axis, centre.spin, centre.spin_rate)

    def joint(self, name: str, s: Array, sd: Array, sdd: Array) -> PlanarJoint:
        """Return a joint's motion; carriers (3, N)."""
        kind, _, number = name.rpartition("_")
        leg, legs, rates = int(number) - 1, self._legs, self._rates
        theta = legs.theta[leg], rates.theta_rate[leg], rates.theta_acceleration[leg]
        beta = legs.beta[leg], rates.beta_rate[leg], rates.beta_acceleration[leg]
        still = np.zeros(len(theta[0]))
        if kind == "base":
            return PlanarJoint(*theta, still, still)
        if kind == "elbow":
            angle, rate, acceleration = (after - before for before, after in zip(theta, beta, strict=True))
            return PlanarJoint(angle, rate, acceleration, *theta[1:])
        if kind == "carrier":
            return PlanarJoint(s[leg], sd[leg], sdd[leg], *beta[1:], carrier=leg, axis=self._links[1].u[leg])
        alpha = (part[:, 2] for part in self._motion)
        angle, rate, acceleration = (after - before for before, after in zip(beta, alpha, strict=True))
        return PlanarJoint(angle, rate, acceleration, *beta[1:])

    def _of_each_leg(self, T_theta: Array, T_beta: Array) -> Array:
        """Return (3, legs, N) what the moments of each leg contribute to f, by R, the force that balances them."""
        R = (T_theta - self._kappa * T_beta) * self._pull + T_beta * self._turn
        return np.stack([R.real, R.imag, (np.conj(self._legs.arm) * R).imag])

    @cached_property
    def _links(self) -> tuple[LinkFrames, LinkFrames]:
        """The proximal links, their origins at the base hinges, and the distal links, theirs at the elbows."""
        legs, (w, wd, W, Wd), geometry = self._legs, self._rates, self._p.geometry
        still = np.zeros(legs.c.shape, dtype=np.complex128)
        proximal = LinkFrames(geometry.hinges + still, still, still, legs.b / geometry.proximal_length, w, wd)
        elbow = geometry.hinges + legs.b, 1j * w * legs.b, (1j * wd - w**2) * legs.b
        return proximal, LinkFrames(*elbow, legs.e / geometry.distal_length, W, Wd)
