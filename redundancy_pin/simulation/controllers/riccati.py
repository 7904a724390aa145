"""Finite-horizon Riccati equations, backwards from a final cost: for sampled control and for continuous control."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve, expm

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import InputError

NEGATIVE = 1e-9
"""Share of the largest eigenvalue by which rounding may make the smallest one of P negative."""


@dataclass(frozen=True, eq=False)
class Riccati:
    """Solution of a finite-horizon Riccati equation.

    Attributes:
        P: (N + 1, e, e) cost to go: ξᵀ P ξ; symmetric, positive semidefinite.
        K: (N, p, e) gains: δu = −K ξ.
        least_eigenvalue: smallest eigenvalue of all P, relative to the largest of the same P.
    """

    P: Array
    K: Array
    least_eigenvalue: float


def discrete_riccati(transition: Array, input: Array, Q: Array, R: Array, final: Array) -> Riccati:
    """Minimise ξ_Nᵀ P_N ξ_N + Σ ξ_iᵀ Q ξ_i + u_iᵀ R u_i along ξ_{i+1} = Φ_i ξ_i + Γ_i u_i.

    Joseph's form (Φ − ΓK)ᵀ P (Φ − ΓK) + Q + Kᵀ R K keeps P symmetric and positive whatever the rounding of K.

    Args:
        transition: (N, e, e) Φ.
        input: (N, e, p) Γ.
        Q: (e, e) cost of the state in each step, symmetric, positive semidefinite.
        R: (p, p) cost of the input in each step, symmetric, positive definite.
        final: (e, e) P_N, symmetric, positive semidefinite.

    Raises:
        InputError: R is not positive definite, or P loses its sign.
    """
    count, size, inputs = input.shape
    P = np.empty((count + 1, size, size))
    K = np.empty((count, inputs, size))
    P[-1] = 0.5 * (final + final.T)
    for i in range(count - 1, -1, -1):
        phi, gamma, next_cost = transition[i], input[i], P[i + 1]
        weighted = next_cost @ gamma
        try:
            factor = cho_factor(R + gamma.T @ weighted)
        except LinAlgError as error:
            raise InputError(
                "The cost of the inputs is not positive definite.", remedy="Give every effort a positive weight."
            ) from error
        K[i] = cho_solve(factor, weighted.T @ phi)
        closed = phi - gamma @ K[i]
        found = closed.T @ next_cost @ closed + Q + K[i].T @ R @ K[i]
        P[i] = 0.5 * (found + found.T)
    return Riccati(read_only(P), read_only(K), _checked(P))


def continuous_riccati(A: Array, B: Array, Q: Array, R: Array, final: Array, step: Array) -> Riccati:
    """Solve −Ṗ = AᵀP + PA − P B R⁻¹ Bᵀ P + Q backwards, exactly for A and B constant in each interval.

    With the Hamiltonian H = [[A, −B R⁻¹ Bᵀ], [−Q, −Aᵀ]] and [X; Y] = exp(−H h) [I; P(t + h)], P(t) = Y X⁻¹.

    Args:
        A: (N, e, e) in each interval.
        B: (N, e, p).
        Q: (e, e) cost rate of the state.
        R: (p, p) cost rate of the input.
        final: (e, e) P at the end.
        step: (N,) lengths of the intervals, s.

    Returns:
        P at the N + 1 ends; K (N + 1, p, e) at the same ends, with the B of the interval before (after, at the start).

    Raises:
        InputError: R is not positive definite, or P loses its sign.
    """
    count, size, _ = B.shape
    try:
        factor = cho_factor(R)
    except LinAlgError as error:
        raise InputError(
            "The cost of the inputs is not positive definite.", remedy="Give every effort a positive weight."
        ) from error
    gain = np.array([cho_solve(factor, b.T) for b in B])
    hamiltonian = np.empty((count, 2 * size, 2 * size))
    hamiltonian[:, :size, :size] = A
    hamiltonian[:, :size, size:] = -B @ gain
    hamiltonian[:, size:, :size] = -Q
    hamiltonian[:, size:, size:] = -A.transpose(0, 2, 1)
    powers = expm(-hamiltonian * step[:, None, None])
    P = np.empty((count + 1, size, size))
    P[-1] = 0.5 * (final + final.T)
    for i in range(count - 1, -1, -1):
        stacked = powers[i, :, :size] + powers[i, :, size:] @ P[i + 1]
        found = np.linalg.solve(stacked[:size].T, stacked[size:].T).T
        P[i] = 0.5 * (found + found.T)
    K = np.concatenate([gain[:1], gain]) @ P
    return Riccati(read_only(P), read_only(K), _checked(P))


def _checked(P: Array) -> float:
    """Return the smallest relative eigenvalue.

    Raises:
        InputError: P is not finite, or not positive semidefinite.
    """
    finite = bool(np.isfinite(P).all())
    least = float("nan")
    if finite:
        values = np.linalg.eigvalsh(P)
        least = float((values[:, 0] / np.maximum(np.abs(values).max(axis=1), np.finfo(float).tiny)).min())
    if not finite or least < -NEGATIVE:
        raise InputError(
            f"The Riccati equation has no positive solution: smallest relative eigenvalue {least:.3g}.",
            remedy="Pass Q and the final cost without negative eigenvalues, and less extreme weights.",
            least=least,
        )
    return least
