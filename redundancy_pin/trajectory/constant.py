"""A path with coordinates appended that do not move."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked
from redundancy_pin.trajectory.domain import Side
from redundancy_pin.trajectory.paths import Path, PathPoint


@dataclass(frozen=True, init=False, eq=False)
class ConstantAppended:
    """A path with constant coordinates appended, such as the orientation of a platform that does not turn.

    Attributes:
        path: the path that moves, n coordinates.
        values: (c,) the constants, m or rad.
    """

    path: Path
    values: Array

    def __init__(self, path: Path, values: ArrayLike) -> None:
        object.__setattr__(self, "path", path)
        object.__setattr__(self, "values", checked(np.atleast_1d(np.asarray(values, dtype=float)), "values", ("c",)))

    @property
    def length(self) -> float:
        """Arc length of the path that moves, m."""
        return self.path.length

    @property
    def dimension(self) -> int:
        """Number n + c of coordinates."""
        return self.path.dimension + len(self.values)

    @property
    def breaks(self) -> Array:
        """(b,) breaks of the path that moves, m."""
        return self.path.breaks

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``.

        Raises:
            InputError: p outside [0, length].
        """
        point = self.path.evaluate(p, side)
        constant = np.broadcast_to(self.values, (*point.x.shape[:-1], len(self.values)))
        zero = np.zeros(constant.shape)
        x, tangent, curvature = (
            np.concatenate(pair, axis=-1) for pair in zip(point, (constant, zero, zero), strict=True)
        )
        return PathPoint(x, tangent, curvature)


def with_constant(path: Path, values: ArrayLike) -> ConstantAppended:
    """Return ``path`` with constant coordinates appended: (x, y) and alpha become (x, y, alpha).

    Args:
        path: a path of n coordinates.
        values: scalar or (c,) constants, m or rad.

    Raises:
        InputError: values that are not finite.
    """
    return ConstantAppended(path, values)
