"""A change-point four-bar (the longest sides one as long as two) from first principles, through its flat pose.

Nothing here knows the package. With p = d − a e^{iθ} and K = (b² − c² − |p|²)/(2c) the loop a e^{iθ} + b e^{iγ} =
d + c e^{iψ} gives e^{iψ} = p (K ± i √D)/|p|², D = |p|² − K², a square in cos θ. At a flat pose D is zero: it has the
factor 1 ∓ cos θ = 2 sin² or 2 cos² of θ/2, and √D with the sign of that sine goes through smoothly: that is the branch.
Then one angle is left, ½ M(θ) θ̇² + V(θ), differentiated by casadi and integrated by scipy.
"""

from __future__ import annotations

from dataclasses import dataclass

import casadi
import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class ChangePoint:
    """Rods of 1 kg a metre on a smooth branch: functions of the crank's angle θ.

    ``angles`` θ → (ψ, γ) as unit vectors (4,), ``rates`` dψ/dθ, dγ/dθ; ``inertia`` M, ``slope`` M', ``energy`` V,
    ``force`` V'.
    """

    angles: casadi.Function
    inertia: casadi.Function
    slope: casadi.Function
    energy: casadi.Function
    force: casadi.Function
    rates: casadi.Function

    def motion(self, angle: float, rate: float, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return θ (N,) and θ̇ (N,) at times from a state at the first of them."""

        def accelerate(t, y):
            push = -0.5 * float(self.slope(y[0])) * y[1] ** 2 - float(self.force(y[0]))
            return [y[1], push / float(self.inertia(y[0]))]

        ends = float(times[0]), float(times[-1])
        run = solve_ivp(accelerate, ends, [angle, rate], "DOP853", times, rtol=1e-12, atol=1e-12)
        return run.y[0], run.y[1]


def factor(lengths: tuple[float, float, float, float]) -> tuple[int, np.ndarray] | None:
    """Return at which cos θ = ±1 (0 for both) the chain is flat, and D without that factor, in powers of cos θ."""
    a, b, c, d = lengths
    size = np.polynomial.Polynomial([a * a + d * d, -2.0 * a * d])
    K = (b * b - c * c - size) / (2.0 * c)
    D = size - K**2
    flat = [x for x in (1.0, -1.0) if abs(D(x)) < 1e-12]
    if not flat:
        return None
    rest = D
    for x in flat:
        rest, _ = divmod(rest, np.polynomial.Polynomial([1.0, -x]))  # 1 − x cos θ
    return (0 if len(flat) == 2 else int(flat[0])), rest.coef


def change_point(lengths: tuple[float, float, float, float], side: int, gravity: float = 9.81) -> ChangePoint:
    """Return a four-bar (crank, coupler, rocker, ground) with √D of the sign of ``side`` at small θ > 0."""
    a, b, c, d = lengths
    at, rest = factor(lengths)
    theta = casadi.SX.sym("theta")
    x = casadi.cos(theta)
    root = casadi.sqrt(sum(float(value) * x**i for i, value in enumerate(rest)))
    sine = {0: casadi.sin(theta), 1: np.sqrt(2.0) * casadi.sin(theta / 2.0), -1: np.sqrt(2.0) * casadi.cos(theta / 2.0)}
    root = side * sine[at] * root
    tip = casadi.vertcat(a * x, a * casadi.sin(theta))
    p = casadi.vertcat(d, 0.0) - tip
    size = casadi.dot(p, p)
    K = (b * b - c * c - size) / (2.0 * c)
    rocker = casadi.vertcat(p[0] * K - p[1] * root, p[0] * root + p[1] * K) / size
    coupler = (casadi.vertcat(d, 0.0) + c * rocker - tip) / b
    rates = [
        casadi.cross(casadi.vertcat(u, 0), casadi.vertcat(casadi.jacobian(u, theta), 0))[2] for u in (rocker, coupler)
    ]
    centres = (0.5 * tip, casadi.vertcat(d, 0.0) + 0.5 * c * rocker, tip + 0.5 * b * coupler)
    inertia, energy = 0.0, 0.0
    for mass, spin, centre in zip((a, c, b), (1.0, *rates), centres, strict=True):
        velocity = casadi.jacobian(centre, theta)
        inertia += mass * casadi.dot(velocity, velocity) + mass**3 / 12.0 * spin**2
        energy += mass * gravity * centre[1]
    make = lambda *out: casadi.Function("f", [theta], [casadi.vertcat(*out)])  # noqa: E731
    slope, force = casadi.jacobian(inertia, theta), casadi.jacobian(energy, theta)
    return ChangePoint(make(rocker, coupler), make(inertia), make(slope), make(energy), make(force), make(*rates))
