"""Problems W τ = f whose singular values, range and null space are known because they were built from them."""

import numpy as np

from redundancy_pin.dynamics.results import ReducedDynamics


def reduced(W, f, row_scale=None, column_scale=None, reachable=None):
    """Wrap W (N, n, m) and f (N, n) as a backend would return them, with no carriers."""
    W, f = np.asarray(W, float), np.asarray(f, float)
    samples, n, m = W.shape
    return ReducedDynamics(
        t=np.arange(float(samples)),
        f=f,
        W=W,
        carrier_force=np.zeros((samples, 0)),
        reachable=np.ones(samples, bool) if reachable is None else np.asarray(reachable),
        residual=np.zeros(samples),
        row_scale=np.ones(n) if row_scale is None else np.asarray(row_scale, float),
        column_scale=np.ones(m) if column_scale is None else np.asarray(column_scale, float),
    )


def orthogonal(rng, samples, size):
    """Return (samples, size, size) random orthogonal matrices."""
    return np.linalg.qr(rng.normal(size=(samples, size, size)))[0]


def factors(rng, samples, n, m, values):
    """Return U (N, n, n), W = U Σ Vᵀ (N, n, m) with the given singular values, and V (N, m, m)."""
    p = min(n, m)
    U, V = orthogonal(rng, samples, n), orthogonal(rng, samples, m)
    return U, U[:, :, :p] * np.asarray(values, float) @ V.transpose(0, 2, 1)[:, :p], V


def times(matrices, vectors):
    """Return the products of stacked matrices (N, n, m) and vectors (N, m)."""
    return np.einsum("Nij,Nj->Ni", matrices, vectors)
