"""Efforts of least weighted norm that balance a generalised force, without bounds, whatever the rank of W."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, IntArray


def minimum_norm(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> tuple[Array, Array]:
    """Return the minimiser of Σ cost_j u_j² among the solutions of A u = P g, and the size of g − P g.

    P projects on the range of A, taken as its first ``rank`` singular directions. The caller decides whether what
    the projection leaves out is negligible; until then u is not a solution of A u = g.

    Args:
        matrices: (N, n, m) A, finite, in scaled units.
        forces: (N, n) g, finite, in scaled units.
        rank: (N,) rank of A; all n where n = m takes a plain linear solve, about a tenth of the cost.
        cost: (m,) positive weights.

    Returns:
        efforts: (N, m) u.
        outside: (N,) ‖g − P g‖; zero where the rank is n.
    """
    samples, n, m = matrices.shape
    efforts = np.empty((samples, m))
    outside = np.zeros(samples)
    square = (rank == n) & (n == m)
    if square.any():
        efforts[square] = np.linalg.solve(matrices[square], forces[square, :, np.newaxis])[:, :, 0]
    if square.all():
        return efforts, outside
    other = ~square
    efforts[other], outside[other] = _by_singular_vectors(matrices[other], forces[other], rank[other], cost)
    return efforts, outside


def null_basis(matrix: Array, rank: int) -> Array:
    """Return (m, m − rank) an orthonormal basis of the null space of one matrix (n, m) of known rank."""
    basis: Array = np.linalg.svd(matrix, full_matrices=True)[2][rank:].T
    return basis


def _by_singular_vectors(matrices: Array, forces: Array, rank: IntArray, cost: Array) -> tuple[Array, Array]:
    _, n, m = matrices.shape
    p = min(n, m)
    u, singular_values, vt = np.linalg.svd(matrices, full_matrices=True)
    kept = np.arange(p) < rank[:, np.newaxis]
    inverse = np.divide(1.0, singular_values, out=np.zeros_like(singular_values), where=kept)
    components = np.einsum("Nij,Ni->Nj", u, forces)
    efforts = np.einsum("Nji,Nj->Ni", vt[:, :p], inverse * components[:, :p])
    # summing the left-out components themselves keeps a tiny remainder accurate, unlike g − P g
    left_out = np.where(np.arange(n) < rank[:, np.newaxis], 0.0, components)
    outside: Array = np.linalg.norm(left_out, axis=1)
    if np.ptp(cost) > 0.0 and (rank < m).any():
        # move along the null space (other columns zeroed) to the least ‖√cost u‖
        null = vt.transpose(0, 2, 1) * (np.arange(m) >= rank[:, np.newaxis])[:, np.newaxis, :]
        root = np.sqrt(cost)
        step = np.linalg.pinv(root[:, np.newaxis] * null) @ (root * efforts)[:, :, np.newaxis]
        efforts = efforts - (null @ step)[:, :, 0]
    return efforts, outside
