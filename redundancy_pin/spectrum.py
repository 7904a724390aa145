"""How singular stacked matrices are: scaled singular values, rank, condition and null directions."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import RANK_TOLERANCE, Array, IntArray, read_only

UNIT = 1.0
"""Size of an actuation matrix without units, a lever ratio: where all of it vanishes, as at a singular pose of a
machine with one freedom, its largest singular value is rounding itself and no measure of the others."""

SIGN_TIE = 1e-6
"""Components within this fraction of the largest tie for the sign of a direction; the first of them decides."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Singular values of N stacked matrices (n, m).

    Attributes:
        singular_values: (N, min(n, m)) largest first; NaN for a matrix that is not finite.
    """

    singular_values: Array

    @property
    def margin(self) -> Array:
        """(N,) smallest singular value: the distance (2-norm) to the nearest rank-deficient matrix."""
        return self.singular_values[:, -1]

    @property
    def condition(self) -> Array:
        """(N,) largest over smallest singular value; infinite where the smallest is zero."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            ratio = self.singular_values[:, 0] / self.singular_values[:, -1]
        ratio[self.singular_values[:, -1] == 0.0] = np.inf
        return read_only(ratio)

    def rank(self, tolerance: float = RANK_TOLERANCE) -> IntArray:
        """Return (N,) the number of singular values above ``tolerance`` times the largest one, or times ``UNIT``.

        A matrix that is not finite has rank 0.
        """
        largest = np.maximum(self.singular_values[:, :1], UNIT)
        return read_only((self.singular_values > tolerance * largest).sum(axis=1))


def scaled(W: Array, row_scale: Array, column_scale: Array) -> Array:
    """Return D_x⁻¹ W D_a, an actuation matrix without units, so that its singular values can be compared.

    With D_x = diag(row_scale) a moment on the platform becomes a force, and with D_a = diag(column_scale) the
    torque of a motor becomes the force at the end of a lever of the characteristic length.

    Args:
        W: (N, n, m) actuation matrices, base frame; any mix of units.
        row_scale: (n,) characteristic length, m, for a rotation of the platform, 1 for a translation.
        column_scale: (m,) characteristic length, m, for a revolute actuator, 1 for a prismatic one.
    """
    product: Array = W * (column_scale / row_scale[:, np.newaxis])
    return product


def spectrum_of(matrices: Array) -> Spectrum:
    """Return the singular values of stacked matrices (N, n, m), to machine precision relative to the largest."""
    samples, n, m = matrices.shape
    finite = np.isfinite(matrices).all(axis=(1, 2))
    if not finite.all():
        values = np.full((samples, min(n, m)), np.nan)
        values[finite] = spectrum_of(matrices[finite]).singular_values
    else:
        values = np.linalg.svd(matrices, compute_uv=False).astype(np.float64, copy=False)
    return Spectrum(read_only(values))


def left_singular(matrices: Array) -> tuple[Array, Array]:
    """Return left singular vectors (N, n, c) and singular values (N, c) of stacked matrices (N, n, m), c = min(n, m).

    Largest first; NaN for a matrix that is not finite.
    """
    samples, n, m = matrices.shape
    finite, count = np.isfinite(matrices).all(axis=(1, 2)), min(n, m)
    vectors, values = np.full((samples, n, count), np.nan), np.full((samples, count), np.nan)
    vectors[finite], values[finite], _ = np.linalg.svd(matrices[finite], full_matrices=False)
    return vectors, values


def null_directions(matrices: Array) -> tuple[Array, Array]:
    """Return the left and right unit vectors that finite stacked matrices come nearest to mapping to zero.

    Of a matrix that lacks one rank they are its null vectors. Of a matrix that lacks more they are one member of
    the null space: u (N, n) with the smallest |Aᵀ u| and v (N, m) with the smallest |A v|, ``oriented``.
    """
    u, _, vt = np.linalg.svd(matrices, full_matrices=True)
    return oriented(u[:, :, -1]), oriented(vt[:, -1, :])


def oriented(vectors: Array) -> Array:
    """Return (N, n) vectors with the sign that makes the largest component positive (the first of those that tie)."""
    size = np.abs(vectors)
    leading = (size >= (1.0 - SIGN_TIE) * size.max(axis=1, keepdims=True)).argmax(axis=1)
    flipped = np.take_along_axis(vectors, leading[:, np.newaxis], axis=1) < 0.0
    return read_only(np.where(flipped, -vectors, vectors) + 0.0)  # no negative zeros
