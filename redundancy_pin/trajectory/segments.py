"""The elements paths are made of: the straight line and the circular arc."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked, frozen, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.domain import Side, inside, positive, require_side
from redundancy_pin.trajectory.paths import PathPoint

_UNIT_TOLERANCE = 1e-9
"""How far from orthonormal the axes of an arc may be: a vector typed with nine digits passes."""


@dataclass(frozen=True, init=False, eq=False)
class Line:
    """A straight line in any dimension.

    Attributes:
        start, end: (n,) its ends, m.
        length: their distance, m.
        direction: (n,) unit vector from start to end.

    Raises:
        InputError: the ends coincide, differ in dimension, or are not finite.
    """

    start: Array
    end: Array
    length: float
    direction: Array

    def __init__(self, start: ArrayLike, end: ArrayLike) -> None:
        first = checked(start, "start", ("n",))
        last = checked(end, "end", (len(first),))
        length = float(np.linalg.norm(last - first))
        if length == 0.0:
            raise InputError(
                f"The line starts and ends at {first.tolist()}.", remedy="Pass two different points.", start=start
            )
        object.__setattr__(self, "start", first)
        object.__setattr__(self, "end", last)
        object.__setattr__(self, "length", length)
        object.__setattr__(self, "direction", frozen((last - first) / length))

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return len(self.start)

    @property
    def breaks(self) -> Array:
        """(0,) a line has none."""
        return frozen([])

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``.

        Raises:
            InputError: p outside [0, length].
        """
        require_side(side)
        along = inside(p, 0.0, self.length, "p", "m")[..., None]
        # The convex combination meets both ends exactly, which start + p * direction would not.
        fraction = along / self.length
        x = (1.0 - fraction) * self.start + fraction * self.end
        return PathPoint(x, np.broadcast_to(self.direction, x.shape).copy(), np.zeros(x.shape))


@dataclass(frozen=True, init=False, eq=False)
class Arc:
    """A circular arc in a plane of any dimension: x = c + r (u cos φ + w sin φ), φ = p / r.

    Attributes:
        centre: (n,) c, m.
        radius: r, m.
        radial: (n,) unit vector u from the centre to the start.
        tangent: (n,) unit vector w of the motion at the start.
        sweep: angle travelled, rad, positive; the sense of rotation is in ``tangent``.

    Raises:
        InputError: radius or sweep not positive, axes not orthonormal, wrong shapes.
    """

    centre: Array
    radius: float
    radial: Array
    tangent: Array
    sweep: float

    def __init__(self, centre: ArrayLike, radius: float, radial: ArrayLike, tangent: ArrayLike, sweep: float) -> None:
        middle = checked(centre, "centre", ("n",))
        axes = np.stack([checked(radial, "radial", middle.shape), checked(tangent, "tangent", middle.shape)])
        error = float(np.abs(axes @ axes.T - np.eye(2)).max())
        if error > _UNIT_TOLERANCE:
            raise InputError(
                f"radial and tangent miss orthonormality by {error:.2g}.",
                remedy="Pass two perpendicular unit vectors.",
                error=error,
            )
        object.__setattr__(self, "centre", middle)
        object.__setattr__(self, "radius", positive(radius, "radius", "m"))
        object.__setattr__(self, "radial", frozen(axes[0]))
        object.__setattr__(self, "tangent", frozen(axes[1]))
        object.__setattr__(self, "sweep", positive(sweep, "sweep", "rad"))

    @property
    def length(self) -> float:
        """Arc length r φ, m."""
        return self.radius * self.sweep

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return len(self.centre)

    @property
    def breaks(self) -> Array:
        """(0,) an arc has none."""
        return frozen([])

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``.

        Raises:
            InputError: p outside [0, length].
        """
        require_side(side)
        angle = inside(p, 0.0, self.length, "p", "m")[..., None] / self.radius
        cos, sin = np.cos(angle), np.sin(angle)
        outward = self.radial * cos + self.tangent * sin
        forward = self.tangent * cos - self.radial * sin
        return PathPoint(self.centre + self.radius * outward, forward, -outward / self.radius)


def circle_path(centre: ArrayLike, radius: float, start_angle: float = 0.0, sweep: float = 2.0 * np.pi) -> Arc:
    """Return a circle, or a part of one, in the plane.

    Args:
        centre: (2,) m.
        radius: m.
        start_angle: angle of the start seen from the centre, rad, from the x axis.
        sweep: signed angle travelled, rad; positive is counter-clockwise, more than 2π is more than one turn.

    Raises:
        InputError: radius not positive, no sweep, wrong shapes.
    """
    middle = checked(centre, "centre", (2,))
    radial = np.array([np.cos(start_angle), np.sin(start_angle)])
    tangent = np.sign(sweep) * np.array([-radial[1], radial[0]])
    if sweep == 0.0:
        raise InputError("sweep is 0 rad.", remedy="Pass a positive (counter-clockwise) or a negative angle.")
    return Arc(middle, radius, radial, tangent, abs(sweep))


def straight_pieces(points: Array) -> tuple[Array, Array]:
    """Return the (N − 1,) lengths, m, and (N − 1, n) unit directions between consecutive points (N, n).

    Raises:
        InputError: two consecutive points coincide; named by index.
    """
    step = np.diff(points, axis=0)
    lengths = np.linalg.norm(step, axis=1)
    same = np.flatnonzero(lengths == 0.0)
    if len(same):
        k = int(same[0])
        raise InputError(
            f"Points {k} and {(k + 1)} coincide at {points[k].tolist()}.",
            remedy="Remove one of them; a closed list does not repeat its first point.",
            index=k,
        )
    return read_only(lengths), read_only(step / lengths[:, None])
