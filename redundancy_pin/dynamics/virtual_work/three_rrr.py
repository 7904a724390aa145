"""Virtual work on the 3-RRR with a carrier on each distal link (Parsa 2014, section 2.2), gravity included.

Notation of ``three_rrr_kinematics``: b and e are the link vectors, v⊥ is v turned by +90°, ω = θ̇ and Ω = β̇. With
the sums m = m2 + m_s, S = m2 r_a + m_s s (first moment about the elbow B) and I = I2 + m2 r_a² + m_s s², an
acceleration a_B of the elbow less gravity, and u, n along and across the distal link, leg i resists with

    T_θ = m1 l1²/3 θ̈ - m1 g·b⊥/2 + b⊥·F,    F = m a_B + S (β̈ n - Ω² u) + m_s (s̈ u + 2 ṡ Ω n),
    T_β = I β̈ + S n·a_B + 2 m_s s ṡ Ω,

moments about the base hinge and about the elbow (eq. 2.45-2.50 with the opposite sign). Since θ̇ = -e·v_A/c and
l2² β̇ = e⊥·v_A - θ̇ e·b (v_A the velocity of the platform's corner), their virtual power is R·v_A with

    R = -(T_θ - (e·b/l2²) T_β) e/c + T_β e⊥/l2²:

the force the platform has to put on the corner. The generalised force is Σ R, its moment Σ (A - P) x R, and the
platform's own inertia (eq. 2.51-2.53). The products with 3 x 3 link Jacobians never need to be formed.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.dynamics.virtual_work.mechanism import EffortDerivatives, LinkFrames, PlanarBodies
from redundancy_pin.dynamics.virtual_work.three_rrr_kinematics import (
    ThreeRrrGeometry,
    ThreeRrrLegs,
    inverse_displacement,
    leg_rates,
)

LEAST_ELBOW_SINE = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Sine of the elbow below which a pose counts as a type I singularity: a leg that close to straight or folded becomes
exactly so when its end moves by the closure tolerance (relative to the links), so the mode is no longer resolved."""


@dataclass(frozen=True)
class ThreeRrrParameters:
    """Geometry and masses of the 3-RRR.

    Attributes:
        geometry: the lengths that fix the kinematics.
        proximal_mass: slender rod from the base hinge to the elbow, kg.
        distal_mass: of the distal link with its track, kg.
        distal_centre: r_a, its centre of mass from the elbow towards the platform, m.
        distal_inertia: about that centre, kg·m².
        platform_mass, platform_inertia: about the platform's centre, kg and kg·m².
        carrier_mass: of each carrier, kg; 0 where there is none.
        gravity: acceleration of gravity in the base frame, m/s².
    """

    geometry: ThreeRrrGeometry
    proximal_mass: float
    distal_mass: float
    distal_centre: float
    distal_inertia: float
    platform_mass: float
    platform_inertia: float
    carrier_mass: float
    gravity: tuple[float, float, float]

    @staticmethod
    def from_parameters(
        parameters: Mapping[str, float | bool | str], gravity: tuple[float, float, float]
    ) -> ThreeRrrParameters:
        """Read geometry and masses off the parameters of the model ``3rrr``.

        The distal link is a slender rod from the end of its tail to the platform; the tail is there for the
        carrier, so a robot without carriers has none. A platform inertia of "auto" is that of a uniform disc.
        """
        geometry = ThreeRrrGeometry.from_parameters(parameters)
        carriers = bool(parameters["carriers"])
        tail = float(parameters["tail_length"]) if carriers else 0.0
        distal_mass, platform_mass = float(parameters["distal_mass"]), float(parameters["platform_mass"])
        given = parameters["platform_inertia"]
        disc = 0.5 * platform_mass * geometry.platform_radius**2
        return ThreeRrrParameters(
            geometry=geometry,
            proximal_mass=float(parameters["proximal_mass"]),
            distal_mass=distal_mass,
            distal_centre=0.5 * (geometry.distal_length - tail),
            distal_inertia=distal_mass * (geometry.distal_length + tail) ** 2 / 12.0,
            platform_mass=platform_mass,
            platform_inertia=disc if given == "auto" else float(given),
            carrier_mass=float(parameters["carrier_mass"]) if carriers else 0.0,
            gravity=gravity,
        )


@dataclass(frozen=True)
class ThreeRrrMechanism:
    """The 3-RRR in one working mode."""

    parameters: ThreeRrrParameters
    mode: tuple[int, int, int]

    angular_rows = (False, False, True)
    angular_columns = (True, True, True)

    def legs(self, x: Array) -> ThreeRrrPoses:
        """Solve the inverse displacement at (N, 3) platform poses (x, y, α), m and rad."""
        return ThreeRrrPoses(self.parameters, x, inverse_displacement(self.parameters.geometry, x, self.mode))


@dataclass(frozen=True, eq=False)
class ThreeRrrPoses:
    """Poses of the 3-RRR with their legs; ``pose`` is (N, 3), m and rad."""

    parameters: ThreeRrrParameters
    pose: Array
    solved: ThreeRrrLegs

    least_margin = LEAST_ELBOW_SINE

    @property
    def gap(self) -> Array:
        """(3, N) how far each corner is out of reach, or what its closure leaves, m."""
        return self.solved.gap

    @property
    def margin(self) -> Array:
        """(3, N) |sine| of the elbow angle: 0 where the leg is straight or folded (type I)."""
        return self.solved.elbow_sine

    def along(self, velocity: Array, acceleration: Array) -> ThreeRrrAlongMotion:
        """Return the dynamics along a motion through these poses."""
        return ThreeRrrAlongMotion(self.parameters, self.pose, self.solved, velocity, acceleration)


class ThreeRrrAlongMotion:
    """Dynamics of the 3-RRR along one motion; what does not depend on the carriers is computed once."""

    def __init__(
        self, parameters: ThreeRrrParameters, pose: Array, legs: ThreeRrrLegs, velocity: Array, acceleration: Array
    ) -> None:
        self._p = p = parameters
        self._legs = legs
        self._pose, self._velocity, self._acceleration = pose, velocity, acceleration
        self._rates = rates = leg_rates(legs, velocity, acceleration)
        gx, gy, _ = p.gravity
        l1, l2 = p.geometry.proximal_length, p.geometry.distal_length
        bx, by, ex, ey, c = legs.bx, legs.by, legs.ex, legs.ey, legs.c
        w_squared, wd = rates.theta_rate * rates.theta_rate, rates.theta_acceleration
        W, Wd = rates.beta_rate, rates.beta_acceleration
        # acceleration of the elbow less gravity, θ̈ b⊥ - θ̇² b - g
        aB_x = -wd * by - w_squared * bx - gx
        aB_y = wd * bx - w_squared * by - gy
        self._a_along = (ex * aB_x + ey * aB_y) / l2
        self._a_across = (ex * aB_y - ey * aB_x) / l2
        # b⊥ along and across the distal link: b⊥·e = -c, b⊥·e⊥ = b·e
        b_dot_e = bx * ex + by * ey
        self._along, self._across = c * (-1.0 / l2), b_dot_e * (1.0 / l2)
        self._W, self._Wd, self._W_squared = W, Wd, W * W
        # b⊥·(β̈ n - Ω² u), per unit of first moment
        self._swing = self._across * Wd - self._along * self._W_squared
        m = p.distal_mass + p.carrier_mass
        # b⊥·a_B = l1² θ̈ - g·b⊥, so the moment of the proximal rod's own weight is folded in here
        self._T_theta_fixed = (l1 * l1 * (p.proximal_mass / 3.0 + m)) * wd
        self._T_theta_fixed += (0.5 * p.proximal_mass + m) * (gx * by - gy * bx)
        # R = -(T_θ - κ T_β) e/c + T_β e⊥/l2²
        self._kappa = b_dot_e * (1.0 / l2**2)
        self._pull_x, self._pull_y = -ex / c, -ey / c
        self._turn_x, self._turn_y = ey * (-1.0 / l2**2), ex * (1.0 / l2**2)

    @property
    def jacobian(self) -> Array:
        """(N, 3, 3) J with θ̇ = J ẋ (Parsa 2014, eq. 2.34-2.38)."""
        return self._legs.jacobian

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
        Rx, Ry = self._corner_force(T_theta, T_beta)
        f = np.empty_like(s)
        np.sum(Rx, axis=0, out=f[0])
        np.sum(Ry, axis=0, out=f[1])
        np.sum(self._legs.arm_x * Ry - self._legs.arm_y * Rx, axis=0, out=f[2])
        gx, gy, _ = p.gravity
        a = self._acceleration
        f[0] += p.platform_mass * (a[:, 0] - gx)
        f[1] += p.platform_mass * (a[:, 1] - gy)
        f[2] += p.platform_inertia * a[:, 2]
        return f, force

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> EffortDerivatives:
        """Return the derivatives of ``efforts``: f is quadratic in (s, ṡ) and affine in s̈."""
        ms = self._p.carrier_mass
        rate = (2.0 * ms) * self._W
        by_s = ms * self._swing, ms * (2.0 * s * self._Wd + self._a_across) + rate * sd
        by_sd = rate * self._across, rate * s
        by_sdd = ms * self._along, np.zeros_like(s)
        return EffortDerivatives(
            f_s=self._of_each_leg(*by_s),
            f_sd=self._of_each_leg(*by_sd),
            f_sdd=self._of_each_leg(*by_sdd),
            force_s=-ms * self._W_squared,
            force_sd=np.zeros_like(s),
            force_sdd=np.full_like(s, ms),
        )

    def bodies(self, s: Array, sd: Array, sdd: Array) -> tuple[PlanarBodies, ...]:
        """Return proximal links, distal links, carriers and the platform."""
        p = self._p
        l1 = p.geometry.proximal_length
        proximal, distal = self._frames
        x, v, a = (np.ascontiguousarray(array.T)[:, None] for array in (self._pose, self._velocity, self._acceleration))
        return (
            proximal.bodies(p.proximal_mass, p.proximal_mass * l1**2 / 12.0, (l1 / 2.0, 0.0, 0.0)),
            distal.bodies(p.distal_mass, p.distal_inertia, (p.distal_centre, 0.0, 0.0)),
            distal.bodies(p.carrier_mass, 0.0, (s, sd, sdd)),
            PlanarBodies(p.platform_mass, p.platform_inertia, x[0], x[1], v[0], v[1], a[0], a[1], v[2], a[2]),
        )

    def _corner_force(self, T_theta: Array, T_beta: Array) -> tuple[Array, Array]:
        """Return R, (3, N) each component, N: the force on the corner of each leg that balances T_θ and T_β."""
        pull = T_theta - self._kappa * T_beta
        return pull * self._pull_x + T_beta * self._turn_x, pull * self._pull_y + T_beta * self._turn_y

    def _of_each_leg(self, T_theta: Array, T_beta: Array) -> Array:
        """Return (3, legs, N) what the moments of each leg contribute to f."""
        Rx, Ry = self._corner_force(T_theta, T_beta)
        return np.stack([Rx, Ry, self._legs.arm_x * Ry - self._legs.arm_y * Rx])

    @cached_property
    def _frames(self) -> tuple[LinkFrames, LinkFrames]:
        """The frames of the proximal links, at the base hinges, and of the distal links, at the elbows."""
        legs, rates, geometry = self._legs, self._rates, self._p.geometry
        G = geometry.base_points
        zero = np.zeros_like(legs.c)
        l1, l2 = geometry.proximal_length, geometry.distal_length
        w, wd = rates.theta_rate, rates.theta_acceleration
        proximal = LinkFrames(
            G[:, :1] + zero, G[:, 1:] + zero, zero, zero, zero, zero, legs.bx / l1, legs.by / l1, w, wd
        )
        elbow = proximal.bodies(0.0, 0.0, (l1, 0.0, 0.0))
        distal = LinkFrames(
            elbow.x, elbow.y, elbow.vx, elbow.vy, elbow.ax, elbow.ay,
            legs.ex / l2, legs.ey / l2, rates.beta_rate, rates.beta_acceleration,
        )  # fmt: skip
        return proximal, distal
