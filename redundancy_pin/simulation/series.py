"""Piecewise Chebyshev series asked for one instant at a time, in microseconds."""

from __future__ import annotations

import math
from bisect import bisect_right

import numpy as np

from redundancy_pin.arrays import Array

JUMP = 1e-6
"""Difference at the end of a piece, relative to the largest value, from which a function jumps there."""


class Series:
    """A function of time as Chebyshev series in pieces, for one instant at a time.

    A simulation asks for the efforts of one instant after the other; at that, numpy's functions for arrays of instants
    take ten times as long.

    Args:
        edges: (P + 1,) ends of the pieces, s.
        coefficients: (P, D + 1, C) coefficients of each piece.
    """

    def __init__(self, edges: Array, coefficients: Array) -> None:
        self.edges, self.coefficients = edges, coefficients
        self._edges: list[float] = edges.tolist()
        self._starts = self._edges[:-1]
        self._pieces = list(coefficients)
        self._orders = np.arange(float(coefficients.shape[1]))

    def __call__(self, t: float) -> Array:
        """Return the values (C,) at time t, s; after a jump there, and outside the pieces those at their ends."""
        piece = max(bisect_right(self._starts, t) - 1, 0)
        left, right = self._edges[piece], self._edges[piece + 1]
        x = min(max((2.0 * t - left - right) / (right - left), -1.0), 1.0)
        value: Array = np.cos(self._orders * math.acos(x)).dot(self._pieces[piece])
        return value

    def jumps(self) -> Array:
        """Return the inner ends of pieces, s, at which the function jumps."""
        signs = (-1.0) ** self._orders[:, None]
        begins, ends = (signs * self.coefficients).sum(axis=1), self.coefficients.sum(axis=1)
        size = np.abs(ends).max(axis=0, initial=0.0)
        apart = (np.abs(begins[1:] - ends[:-1]) > JUMP * size).any(axis=1)
        found: Array = self.edges[1:-1][apart]
        return found
