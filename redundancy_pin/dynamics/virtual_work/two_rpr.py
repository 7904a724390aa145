"""Virtual work on the 2-RPR: a carrier across each leg (Parsa 2014, section 2.1), and the masses the thesis left out.

Leg i turns about A_i by θ̇ = n·ẋ/d and stretches by ḋ = u·ẋ, so a leg with moment T_θ about its hinge and force
T_d along itself resists the end-effector with n T_θ/d + u T_d. Bodies of a leg, in its own axes (u, n) from A:
cylinder rod, centre at half its length; piston rod, centre at d less half its length; carrier at (L, σ s), with
σ = +1, -1 on legs 1, 2. The end-effector is a point at B.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.dynamics.virtual_work.mechanism import EffortDerivatives, LinkFrames, PlanarBodies
from redundancy_pin.dynamics.virtual_work.two_rpr_kinematics import (
    TwoRprGeometry,
    TwoRprLegs,
    inverse_displacement,
    leg_rates,
)

SIDE = np.array([[1.0], [-1.0]])
"""σ of each leg: the sense across the leg, along n, in which s grows (read off Parsa 2014, eq. 2.13 and 2.15)."""


@dataclass(frozen=True)
class TwoRprParameters:
    """Geometry and masses of the 2-RPR.

    Attributes:
        geometry: the lengths that fix the kinematics.
        track_offset: L, distance of the track from the base hinge along the leg, m.
        carrier_mass: of each carrier, kg; 0 where there is none.
        end_effector_mass: point mass at B, kg.
        cylinder_mass, cylinder_length: slender rod from the base hinge along the leg, kg and m.
        piston_mass, piston_length: slender rod from B back along the leg, kg and m.
        gravity: acceleration of gravity in the base frame, m/s².
    """

    geometry: TwoRprGeometry
    track_offset: float
    carrier_mass: float
    end_effector_mass: float
    cylinder_mass: float
    cylinder_length: float
    piston_mass: float
    piston_length: float
    gravity: tuple[float, float, float]

    @staticmethod
    def from_parameters(
        parameters: Mapping[str, float | bool | str], gravity: tuple[float, float, float]
    ) -> TwoRprParameters:
        """Read geometry and masses off the parameters of the model ``2rpr``."""
        lengths_and_masses = {
            name: float(parameters[name])
            for name in (
                "track_offset",
                "end_effector_mass",
                "cylinder_mass",
                "cylinder_length",
                "piston_mass",
                "piston_length",
            )
        }
        return TwoRprParameters(
            geometry=TwoRprGeometry.from_parameters(parameters),
            carrier_mass=float(parameters["carrier_mass"]) if parameters["carriers"] else 0.0,
            gravity=gravity,
            **lengths_and_masses,
        )


@dataclass(frozen=True)
class TwoRprMechanism:
    """The 2-RPR in one working mode."""

    parameters: TwoRprParameters
    mode: tuple[int, int]

    angular_rows = (False, False)
    angular_columns = (False, False)

    def legs(self, x: Array) -> TwoRprPoses:
        """Solve the inverse displacement at (N, 2) end-effector positions, m."""
        return TwoRprPoses(self.parameters, x, inverse_displacement(self.parameters.geometry, x, self.mode))


@dataclass(frozen=True, eq=False)
class TwoRprPoses:
    """Poses of the 2-RPR with their legs; ``point`` is (N, 2) the end-effector, m."""

    parameters: TwoRprParameters
    point: Array
    solved: TwoRprLegs

    least_margin = CLOSURE_TOLERANCE

    @property
    def gap(self) -> Array:
        """(2, N) what the closure leaves, m."""
        return self.solved.gap

    @property
    def margin(self) -> Array:
        """(2, N) |d|, m: at d = 0 the direction of the leg is lost (type I)."""
        return np.abs(self.solved.d)

    def along(self, velocity: Array, acceleration: Array) -> TwoRprAlongMotion:
        """Return the dynamics along a motion through these poses."""
        return TwoRprAlongMotion(self.parameters, self.point, self.solved, velocity, acceleration)


class TwoRprAlongMotion:
    """Dynamics of the 2-RPR along one motion; what does not depend on the carriers is computed once."""

    def __init__(
        self, parameters: TwoRprParameters, point: Array, legs: TwoRprLegs, velocity: Array, acceleration: Array
    ) -> None:
        self._p = p = parameters
        self._legs = legs
        self._point, self._velocity, self._acceleration = point, velocity, acceleration
        self._rates = rates = leg_rates(legs, velocity, acceleration)
        gx, gy, _ = p.gravity
        ux, uy, d = legs.ux, legs.uy, legs.d
        w, wd = rates.theta_rate, rates.theta_acceleration
        self._g_along, self._g_across = gx * ux + gy * uy, gy * ux - gx * uy
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
        self._nx_over_d, self._ny_over_d = -uy / d, ux / d
        self._f_fixed = np.empty((2, d.shape[1]))
        self._f_fixed[0] = (self._nx_over_d * moment + ux * thrust).sum(axis=0)
        self._f_fixed[1] = (self._ny_over_d * moment + uy * thrust).sum(axis=0)
        self._f_fixed[0] += p.end_effector_mass * (acceleration[:, 0] - gx)
        self._f_fixed[1] += p.end_effector_mass * (acceleration[:, 1] - gy)

    @property
    def jacobian(self) -> Array:
        """(N, 2, 2) J with ḋ = J ẋ (Parsa 2014, eq. 2.2)."""
        return self._legs.jacobian

    def efforts(self, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return f, (2, N), N, and the carrier forces, (2, N), N (Parsa 2014, eq. 2.13-2.17, with gravity).

        The part of the carriers: f = Σ n h/d with h = m[s² θ̈ + 2 s ṡ θ̇ + σ L s̈ + σ s g·u], over the rest that
        does not depend on s. Across the leg, the carrier's actuator gives m[s̈ - s θ̇² + σ L θ̈ - σ g·n].
        """
        m, L = self._p.carrier_mass, self._p.track_offset
        w, wd = self._rates.theta_rate, self._rates.theta_acceleration
        moment = m * (s * (s * wd + 2.0 * w * sd + SIDE * self._g_along) + (SIDE * L) * sdd)
        f = self._f_fixed + np.stack([(self._nx_over_d * moment).sum(axis=0), (self._ny_over_d * moment).sum(axis=0)])
        force = m * (sdd - s * w * w + SIDE * (L * wd - self._g_across))
        return f, force

    def effort_derivatives(self, s: Array, sd: Array, sdd: Array) -> EffortDerivatives:
        """Return the derivatives of ``efforts``: f is quadratic in (s, ṡ) and affine in s̈."""
        m, L = self._p.carrier_mass, self._p.track_offset
        w, wd = self._rates.theta_rate, self._rates.theta_acceleration
        along_f = np.stack([self._nx_over_d, self._ny_over_d])
        return EffortDerivatives(
            f_s=along_f * (m * (2.0 * s * wd + 2.0 * w * sd + SIDE * self._g_along)),
            f_sd=along_f * (2.0 * m * s * w),
            f_sdd=along_f * (SIDE * (m * L)),
            force_s=-m * w * w,
            force_sd=np.zeros_like(w),
            force_sdd=np.full_like(w, m),
        )

    def bodies(self, s: Array, sd: Array, sdd: Array) -> tuple[PlanarBodies, ...]:
        """Return cylinders, pistons, carriers and the end-effector."""
        p, frames = self._p, self._frames
        d, rates = self._legs.d, self._rates
        x, v, a = self._point, self._velocity, self._acceleration
        still = np.zeros((1, len(x)))
        return (
            frames.bodies(p.cylinder_mass, p.cylinder_mass * p.cylinder_length**2 / 12.0, _at(p.cylinder_length / 2.0)),
            frames.bodies(
                p.piston_mass,
                p.piston_mass * p.piston_length**2 / 12.0,
                (d - 0.5 * p.piston_length, rates.d_rate, rates.d_acceleration),
            ),
            frames.bodies(p.carrier_mass, 0.0, _at(p.track_offset), (SIDE * s, SIDE * sd, SIDE * sdd)),
            PlanarBodies(
                p.end_effector_mass, 0.0, x[None, :, 0], x[None, :, 1], v[None, :, 0], v[None, :, 1],
                a[None, :, 0], a[None, :, 1], still, still,
            ),
        )  # fmt: skip

    @cached_property
    def _frames(self) -> LinkFrames:
        zero = np.zeros_like(self._legs.d)
        return LinkFrames(
            self._p.geometry.base_x + zero, zero, zero, zero, zero, zero,
            self._legs.ux, self._legs.uy, self._rates.theta_rate, self._rates.theta_acceleration,
        )  # fmt: skip


def _at(position: float) -> tuple[float, float, float]:
    return position, 0.0, 0.0
