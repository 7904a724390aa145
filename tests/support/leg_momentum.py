"""The massless 2-RPR in closed form, by hand from geometry: what the switch-off planner is judged by.

The carrier of leg i sits at A_i + L u_i + σ_i s_i n_i (σ = +1, −1); its angular momentum about A_i is
m [(L² + s²) θ̇ + σ L ṡ], and the main efforts satisfy Σ u_i τ_i = Σ n_i h_i / d_i with h_i its rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

SIGMA = np.array([1.0, -1.0])
OFFSET = 0.1


@dataclass(frozen=True)
class Legs:
    """Both legs along a platform motion: unit vectors (N, 2, 2), lengths, angular rates and accelerations (N, 2)."""

    u: np.ndarray
    n: np.ndarray
    d: np.ndarray
    rate: np.ndarray
    acceleration: np.ndarray


def legs_along(x: np.ndarray, xd: np.ndarray, xdd: np.ndarray, base_distance: float = 0.5) -> Legs:
    hinges = np.array([[0.0, 0.0], [base_distance, 0.0]])
    along = x[:, None, :] - hinges
    d = np.linalg.norm(along, axis=2)
    u = along / d[..., None]
    n = np.stack([-u[..., 1], u[..., 0]], axis=2)
    rate = np.einsum("nij,nj->ni", n, xd) / d
    stretch = np.einsum("nij,nj->ni", u, xd)
    acceleration = (np.einsum("nij,nj->ni", n, xdd) - 2.0 * stretch * rate) / d
    return Legs(u, n, d, rate, acceleration)


def momentum(legs: Legs, s: np.ndarray, sd: np.ndarray, mass: float = 1.0) -> np.ndarray:
    """(N, 2) angular momentum of each leg about its hinge."""
    return mass * ((OFFSET**2 + s**2) * legs.rate + SIGMA * OFFSET * sd)


def momentum_rate(legs: Legs, s: np.ndarray, sd: np.ndarray, sdd: np.ndarray, mass: float = 1.0) -> np.ndarray:
    """(N, 2) its rate h."""
    return mass * ((OFFSET**2 + s**2) * legs.acceleration + 2.0 * s * sd * legs.rate + SIGMA * OFFSET * sdd)


def imbalance(legs: Legs, h: np.ndarray, tau: np.ndarray) -> np.ndarray:
    """(N, 2) Σ u τ − Σ n h / d, N."""
    return np.einsum("nij,ni->nj", legs.u, tau) - np.einsum("nij,ni->nj", legs.n, h / legs.d)


def free_carriers(
    trajectory, start: float, times: np.ndarray, s0: np.ndarray, H: np.ndarray, mass: float, base_distance: float
):
    """(N, 2) positions with constant momenta H: the first-order equations of the off phase, by another integrator."""

    def slope(t: float, s: np.ndarray) -> np.ndarray:
        point = trajectory.evaluate(np.array([t]))
        legs = legs_along(point.x, point.xd, point.xdd, base_distance)
        return SIGMA * (H / mass - (OFFSET**2 + s**2) * legs.rate[0]) / OFFSET

    solution = solve_ivp(slope, (start, times[-1]), s0, method="DOP853", rtol=1e-12, atol=1e-14, t_eval=times)
    return solution.y.T


def condition(legs: Legs) -> np.ndarray:
    """(N,) cot(γ/2), γ the acute angle between the legs."""
    cosine = np.abs(np.einsum("nj,nj->n", legs.u[:, 0], legs.u[:, 1]))
    sine = np.abs(legs.u[:, 0, 0] * legs.u[:, 1, 1] - legs.u[:, 0, 1] * legs.u[:, 1, 0])
    with np.errstate(divide="ignore"):
        return (1.0 + cosine) / sine
