"""Lagrange's equations for point masses, by differentiation of positions alone.

What the tests of the virtual-work backend are judged by. Nothing here knows a velocity or force formula: every body
is replaced by point masses with the same mass, centre and inertia (a slender rod by Simpson's 1:4:1, a disc by three
points on a ring), their positions are written down as functions of the generalised coordinates q = (x, s), and the rest
is differentiation: complex steps, exact to rounding, for the first derivative of positions; central differences of
order eight for the derivatives of kinetic energy and of momentum.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

COMPLEX_STEP = 1e-30
CENTRAL = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
STEP = 2e-3
"""Step of the central differences: the error is of the order (step / length of variation)^8, far below rounding
over step, 1e-13."""


def derivative(function: Callable[[float], np.ndarray], step: float = STEP) -> np.ndarray:
    """Derivative at 0 by central differences of order eight."""
    return sum(weight * (function(k * step) - function(-k * step)) for k, weight in CENTRAL) / step


@dataclass(frozen=True)
class PointMasses:
    """``positions`` maps q (complex allowed) to (P, 2); ``masses`` is (P,)."""

    masses: np.ndarray
    positions: Callable[[np.ndarray], np.ndarray]

    def velocities(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """(P, 2) velocities."""
        return self.positions(q + 1j * COMPLEX_STEP * qd).imag / COMPLEX_STEP

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(P, 2, len(q)) derivatives of the positions."""
        return np.stack([self.velocities(q, direction) for direction in np.eye(len(q))], axis=2)

    def kinetic(self, q: np.ndarray, qd: np.ndarray) -> float:
        """Kinetic energy."""
        return 0.5 * float(self.masses @ (self.velocities(q, qd) ** 2).sum(axis=1))

    def energy(self, q: np.ndarray, qd: np.ndarray, gravity: np.ndarray) -> float:
        """Kinetic plus potential energy, zero height at the origin."""
        return self.kinetic(q, qd) - float(self.masses @ self.positions(q) @ gravity[:2])

    def momentum(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """(3,) linear momentum and angular momentum about the origin."""
        r, v = self.positions(q), self.velocities(q, qd)
        return np.array([*(self.masses @ v), self.masses @ (r[:, 0] * v[:, 1] - r[:, 1] * v[:, 0])])

    def generalised_force(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """d/dt (dT/dq̇) - dT/dq + dU/dq at a state and acceleration."""

        def conjugate(t: float) -> np.ndarray:
            q_t, qd_t = q + qd * t + 0.5 * qdd * t * t, qd + qdd * t
            return np.einsum("p,pcj,pc->j", self.masses, self.jacobian(q_t), self.velocities(q_t, qd_t))

        def kinetic_gradient(direction: np.ndarray) -> float:
            return float(derivative(lambda h: np.asarray(self.kinetic(q + h * direction, qd))))

        weight = np.einsum("p,pcj,c->j", self.masses, self.jacobian(q), gravity[:2])
        return derivative(conjugate) - np.array([kinetic_gradient(e) for e in np.eye(len(q))]) - weight

    def base_wrench(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """(6,) weight less the rate of momentum, moments about the origin."""
        rate = derivative(lambda t: self.momentum(q + qd * t + 0.5 * qdd * t * t, qd + qdd * t))
        r = np.column_stack([self.positions(q), np.zeros(len(self.masses))])
        weight = self.masses[:, None] * gravity
        total = np.concatenate([weight.sum(axis=0), np.cross(r, weight).sum(axis=0)])
        return total - np.array([rate[0], rate[1], 0.0, 0.0, 0.0, rate[2]])


def rod(mass: float) -> list[float]:
    """Masses of the two ends and the middle that stand for a slender rod."""
    return [mass / 6, 4 * mass / 6, mass / 6]


def angle_of(v: np.ndarray) -> complex:
    """atan2 for a complex step: the step rides along in the imaginary part, to first order."""
    re, im = v.real, v.imag
    return np.arctan2(re[1], re[0]) + 1j * (re[0] * im[1] - re[1] * im[0]) / (re @ re)


def arccos(value: complex) -> complex:
    """Arc cosine for a complex step."""
    return np.arccos(value.real) - 1j * value.imag / np.sqrt(1.0 - value.real**2)


def two_rpr_masses(parameters: dict, mode: tuple[int, int]) -> PointMasses:
    """The 2-RPR as point masses; q = (x, y, s1, s2)."""
    p = parameters
    masses = [p["end_effector_mass"]]
    for _ in range(2):
        masses += rod(p["cylinder_mass"]) + rod(p["piston_mass"]) + [p["carrier_mass"] if p["carriers"] else 0.0]

    def positions(q: np.ndarray) -> np.ndarray:
        B = q[:2]
        points = [B]
        for leg in range(2):
            A = np.array([leg * p["base_distance"], 0.0])
            u = mode[leg] * (B - A) / np.sqrt(((B - A) ** 2).sum())
            n = np.array([-u[1], u[0]])
            points += [A + k * p["cylinder_length"] * u for k in (0.0, 0.5, 1.0)]
            points += [B - k * p["piston_length"] * u for k in (0.0, 0.5, 1.0)]
            points += [A + p["track_offset"] * u + (1, -1)[leg] * q[2 + leg] * n]
        return np.array(points)

    return PointMasses(np.array(masses), positions)


def three_rrr_masses(parameters: dict, mode: tuple[int, int, int]) -> PointMasses:
    """The 3-RRR as point masses; q = (x, y, α, s1, s2, s3). Angles by eq. 2.22-2.27 of the thesis."""
    p = parameters
    l1, l2, l3, R = (p[k] for k in ("proximal_length", "distal_length", "platform_radius", "base_radius"))
    given = p["platform_inertia"]
    gyration = l3 * np.sqrt(0.5) if given == "auto" else np.sqrt(given / p["platform_mass"])
    tail = p["tail_length"] if p["carriers"] else 0.0
    masses = [p["platform_mass"] / 3] * 3
    for _ in range(3):
        masses += rod(p["proximal_mass"]) + rod(p["distal_mass"]) + [p["carrier_mass"] if p["carriers"] else 0.0]

    def u(angle: complex) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle)])

    def positions(q: np.ndarray) -> np.ndarray:
        P, alpha = q[:2], q[2]
        points = [P + gyration * u(alpha + k * 2 * np.pi / 3) for k in range(3)]
        for leg in range(3):
            G = R * np.array([(0, 0), (np.sqrt(3), 0), (np.sqrt(3) / 2, 1.5)][leg])
            A = P - l3 * u(alpha + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg])
            rho = np.sqrt(((A - G) ** 2).sum())
            theta = angle_of(A - G) + mode[leg] * arccos((l1**2 + rho**2 - l2**2) / (2 * l1 * rho))
            B = G + l1 * u(theta)
            along = (A - B) / l2
            points += [G + k * l1 * u(theta) for k in (0.0, 0.5, 1.0)]
            points += [B + (-tail + k * (l2 + tail)) * along for k in (0.0, 0.5, 1.0)]
            points += [B + q[3 + leg] * along]
        return np.array(points) if np.iscomplexobj(q) else np.array(points).real

    return PointMasses(np.array(masses), positions)
