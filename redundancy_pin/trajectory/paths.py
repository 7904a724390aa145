"""What a path is: a curve in space, parametrised by its arc length."""

from __future__ import annotations

from typing import NamedTuple, Protocol

from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.trajectory.domain import Side


class PathPoint(NamedTuple):
    """A path at some arc lengths p.

    Attributes:
        x: (..., n) platform coordinates, m and rad.
        tangent: (..., n) x' = dx/dp; a unit vector in the coordinates that p measures.
        curvature: (..., n) x'' = d²x/dp², 1/m.
    """

    x: Array
    tangent: Array
    curvature: Array


class Path(Protocol):
    """A path x(p), p the arc length in metres, continuous in x and in x'.

    Where a straight meets an arc x'' jumps. Those arc lengths are the ``breaks``; there, and only there,
    ``evaluate`` depends on the side, and only in x'': x and x' are bit-equal from both sides.
    """

    @property
    def length(self) -> float:
        """Total arc length, m."""

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""

    @property
    def breaks(self) -> Array:
        """(b,) increasing arc lengths strictly inside (0, length) where x'' jumps, m."""

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p (scalar or any shape, m), from one side at a break.

        Raises:
            InputError: p outside [0, length].
        """
