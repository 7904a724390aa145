"""Singular values of many small matrices at once, by one-sided Jacobi rotations over all of them."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, BoolArray

ORTHOGONALITY_TOLERANCE = 1e-13
"""Cosine of the angle between two columns below which they count as orthogonal. Left alone, such a pair changes
the singular values by at most this fraction of themselves: three digits below the promised 1e-10."""

MAX_SWEEPS = 12
"""Sweeps over all pairs of columns. Random 3 x 3 matrices need 5, since the convergence is quadratic."""


def jacobi_singular_values(matrices: Array) -> tuple[Array, BoolArray]:
    """Return the singular values of stacked matrices, without forming their Gram matrices.

    Pairs of columns (rows, if they are fewer) are rotated until all are orthogonal; their lengths are then the
    singular values. Squaring the matrix would lose half of the digits of a small singular value, and the
    trigonometric eigenvalue formula those of a double one (every symmetric machine at its centre); rotations lose
    neither. See Demmel and Veselić, "Jacobi's method is more accurate than QR", 1992. All N matrices share each
    rotation, so the cost of one is that of a few dozen array operations: worth it for two or three columns.

    Args:
        matrices: (N, n, m) finite matrices, entries far from overflow when squared.

    Returns:
        singular values: (N, min(n, m)) largest first.
        converged: (N,) false where ``MAX_SWEEPS`` were not enough.
    """
    samples, n, m = matrices.shape
    columns = np.ascontiguousarray(matrices.transpose((2, 1, 0) if m <= n else (1, 2, 0)))
    pairs = [(p, q) for p in range(len(columns)) for q in range(p + 1, len(columns))]
    moved = np.zeros(samples, dtype=bool)
    for _ in range(MAX_SWEEPS):
        moved = np.zeros(samples, dtype=bool)
        for p, q in pairs:
            moved |= _orthogonalise(columns[p], columns[q])
        if not moved.any():
            break
    values = np.sqrt(np.einsum("pkN,pkN->Np", columns, columns))
    values.sort(axis=1)
    return values[:, ::-1], ~moved


def _orthogonalise(x: Array, y: Array) -> BoolArray:
    """Rotate the columns x and y, both (k, N), in place; return (N,) where they were not orthogonal yet."""
    xx = np.einsum("kN,kN->N", x, x)
    yy = np.einsum("kN,kN->N", y, y)
    xy = np.einsum("kN,kN->N", x, y)
    oblique: BoolArray = xy * xy > ORTHOGONALITY_TOLERANCE**2 * xx * yy
    if not oblique.any():
        return oblique
    # tangent of the smaller of the two angles that zero the inner product; 0 / tiny = 0 where both columns vanish
    half_difference = 0.5 * (yy - xx)
    root = np.sqrt(half_difference * half_difference + xy * xy) + np.finfo(np.float64).tiny
    tangent = xy / (half_difference + np.copysign(root, half_difference))
    cosine = 1.0 / np.sqrt(1.0 + tangent * tangent)
    sine = tangent * cosine
    rotated = cosine * x - sine * y
    y *= cosine
    y += sine * x
    x[:] = rotated
    return oblique
