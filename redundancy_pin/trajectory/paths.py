"""What a path is: a curve in space, parametrised by its arc length."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import (
    Array,
    Frozen,
    IntArray,
    Side,
    assign,
    checked,
    frozen,
    inside,
    positive,
    read_only,
    require_side,
)
from redundancy_pin.errors import InputError
from redundancy_pin.motion import require_poses
from redundancy_pin.trajectory.quaternions import HALF_TURN_MARGIN


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


class SmoothPath(ABC):
    """Base of the paths without breaks: they define ``length``, ``dimension`` and ``_at``."""

    length: float
    breaks = frozen(())

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``."""
        require_side(side)
        return self._at(inside(p, 0.0, self.length, "p", "m"))

    @abstractmethod
    def _at(self, p: Array) -> PathPoint:
        """Return x, x', x'' at arc lengths p inside the path, m."""


_UNIT_TOLERANCE = 1e-9
"""How far from orthonormal the axes of an arc may be: a vector written with nine digits passes."""


@dataclass(frozen=True, init=False, eq=False)
class Line(Frozen, SmoothPath):
    """A straight line in any dimension.

    Attributes:
        start, end: (n,) its ends, m.
        length: their distance, m.
        direction: (n,) unit vector from start to end.

    Raises:
        InputError: the ends coincide, differ in dimension, or are not finite.

    Example:
        >>> rp.trajectory.Line([0.0, 0.0], [0.3, 0.4]).length
        0.5
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
        assign(self, start=first, end=last, length=length, direction=frozen((last - first) / length))

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return len(self.start)

    def _at(self, p: Array) -> PathPoint:
        # The convex combination meets both ends exactly, which start + p * direction would not.
        fraction = p[..., None] / self.length
        x = (1.0 - fraction) * self.start + fraction * self.end
        return PathPoint(x, np.broadcast_to(self.direction, x.shape).copy(), np.zeros(x.shape))


@dataclass(frozen=True, init=False, eq=False)
class Arc(Frozen, SmoothPath):
    """A circular arc in a plane of any dimension: x = c + r (u cos φ + w sin φ), φ = p / r.

    Attributes:
        centre: (n,) c, m.
        radius: r, m.
        radial: (n,) unit vector u from the centre to the start.
        tangent: (n,) unit vector w of the motion at the start.
        sweep: angle travelled φ, rad, positive; the sense of rotation is in ``tangent``.
        length: arc length r φ, m.

    Raises:
        InputError: radius or sweep not positive, axes not orthonormal, wrong shapes.

    Example:
        >>> rp.trajectory.Arc([0.0, 0.0], 0.1, [1.0, 0.0], [0.0, 1.0], 2.0).length
        0.2
    """

    centre: Array
    radius: float
    radial: Array
    tangent: Array
    sweep: float
    length: float

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
        r, turn = positive(radius, "radius", "m"), positive(sweep, "sweep", "rad")
        assign(self, centre=middle, radius=r, radial=frozen(axes[0]), tangent=frozen(axes[1]))
        assign(self, sweep=turn, length=r * turn)

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return len(self.centre)

    def _at(self, p: Array) -> PathPoint:
        angle = p[..., None] / self.radius
        cos, sin = np.cos(angle), np.sin(angle)
        outward = self.radial * cos + self.tangent * sin
        forward = self.tangent * cos - self.radial * sin
        return PathPoint(self.centre + self.radius * outward, forward, -outward / self.radius)


@dataclass(frozen=True, init=False, eq=False)
class PoseLine(Frozen, SmoothPath):
    """Poses whose origin moves on a straight line while they turn about an axis fixed in the world.

    At p = κ · length: position p0 + κ d, rotation exp(κ [φ]×) R0; x' is the twist (d, φ)/length, in world-aligned axes
    at the platform origin.

    Attributes:
        start, end: (4, 4) homogeneous poses in the base frame, m.
        length: what p is at the end: one, the distance in metres, or the angle in radians.
        screw: (6,) displacement d, m, and rotation vector φ, rad, world axes.

    Raises:
        InputError: not homogeneous poses, or poses half a turn apart.

    Example:
        >>> end = np.eye(4)
        >>> end[:3, 3] = [0.1, 0.0, 0.2]
        >>> path = rp.trajectory.PoseLine(np.eye(4), end)
        >>> rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(1.0, duration=2.0)).duration
        2.0
    """

    start: Array
    end: Array
    length: float
    screw: Array
    dimension = 6

    def __init__(self, start: ArrayLike, end: ArrayLike, length: float = 1.0) -> None:
        poses = np.stack([checked(start, "start", (4, 4)), checked(end, "end", (4, 4))])
        require_poses(poses)
        turn = Rotation.from_matrix(poses[1, :3, :3] @ poses[0, :3, :3].T).as_rotvec()
        angle = float(np.linalg.norm(turn))
        if angle > np.pi - HALF_TURN_MARGIN:
            raise InputError(
                f"The poses are {angle:.9g} rad apart: at half a turn the axis is not determined.",
                remedy="Go through a pose in between.",
                angle=angle,
            )
        screw = frozen(np.concatenate([poses[1, :3, 3] - poses[0, :3, 3], turn]))
        assign(self, start=frozen(poses[0]), end=frozen(poses[1]), length=positive(length, "length", ""), screw=screw)

    def _at(self, p: Array) -> PathPoint:
        part = p[..., None] / self.length * self.screw
        poses = np.tile(np.eye(4), (*p.shape, 1, 1))
        turned = Rotation.from_rotvec(part[..., 3:].reshape(-1, 3)).as_matrix() @ self.start[:3, :3]
        poses[..., :3, :3], poses[..., :3, 3] = turned.reshape(*p.shape, 3, 3), self.start[:3, 3] + part[..., :3]
        tangent = np.broadcast_to(self.screw / self.length, part.shape)
        return PathPoint(poses, tangent, np.zeros(part.shape))


def circle_path(centre: ArrayLike, radius: float, start_angle: float = 0.0, sweep: float = 2.0 * np.pi) -> Arc:
    """Return a circle, or a part of one, in the plane.

    It starts at ``start_angle``, rad, seen from the centre; ``sweep``, rad, is positive counter-clockwise, and may be
    more than one turn.

    Raises:
        InputError: radius not positive, no sweep, wrong shapes.

    Example:
        >>> round(rp.trajectory.circle_path([0.25, 0.18], 0.2).length, 3)
        1.257
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


@dataclass(frozen=True, init=False, eq=False)
class ConstantAppended(Frozen):
    """A path with constant coordinates appended, such as the orientation of a platform that does not turn.

    Attributes:
        path: the path that moves, n coordinates.
        values: (c,) the constants, m or rad.
    """

    path: Path
    values: Array

    def __init__(self, path: Path, values: ArrayLike) -> None:
        one = np.ndim(np.asarray(values, dtype=object)) == 0
        constants = checked(values, "values", () if one else ("c",))
        assign(self, path=path, values=np.atleast_1d(constants))

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

    @property
    def knots(self) -> Array:
        """(c,) knots of the path that moves, if it has any, m."""
        return frozen(getattr(self.path, "knots", ()))

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``."""
        point = self.path.evaluate(p, side)
        shape = (*point.x.shape[:-1], len(self.values))
        appended = (np.broadcast_to(values, shape) for values in (self.values, 0.0, 0.0))
        return PathPoint(*(np.concatenate(pair, axis=-1) for pair in zip(point, appended, strict=True)))


def with_constant(path: Path, values: ArrayLike) -> ConstantAppended:
    """Return ``path`` with constant coordinates (scalar or (c,), m or rad) appended: (x, y) becomes (x, y, alpha).

    Example:
        >>> line = rp.trajectory.Line([0.8, 0.4], [0.9, 0.4])
        >>> rp.trajectory.with_constant(line, 0.1).dimension
        3
    """
    return ConstantAppended(path, values)


_JOINT_TOLERANCE = 1e-9
"""Largest gap between segments, relative to the length of the chain (positions) or absolute (unit
tangents): a nanometre on a metre, a thousand times above the rounding of the constructions here."""


@dataclass(frozen=True, init=False, eq=False)
class ChainedPath(Frozen):
    """Segments end to end, continuous in position and tangent; curvature may jump at the joints.

    Attributes:
        segments: the segments, in order.
        joints: (len(segments) − 1,) arc lengths where one segment ends and the next starts, m.
        length: total arc length, m.
        breaks: (b,) the arc lengths, of joints and inside segments, where x'' jumps, m.

    Raises:
        InputError: no segment, or two segments that do not meet (position or tangent), with the gap.
    """

    segments: tuple[Path, ...]
    joints: Array
    length: float
    breaks: Array

    def __init__(self, segments: Sequence[Path]) -> None:
        if len(segments) == 0:
            raise InputError("A chain needs at least one segment.")
        ends = np.cumsum([segment.length for segment in segments])
        jumps = _jumping_joints(segments, float(ends[-1]))
        starts = np.concatenate([[0.0], ends[:-1]])
        inner = [start + np.asarray(segment.breaks) for start, segment in zip(starts, segments, strict=True)]
        breaks = frozen(np.sort(np.concatenate([ends[:-1][jumps], *inner])))
        assign(self, segments=tuple(segments), joints=frozen(ends[:-1]), length=float(ends[-1]), breaks=breaks)

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return self.segments[0].dimension

    @property
    def knots(self) -> Array:
        """(c,) knots of the segments, m."""
        starts = np.concatenate([[0.0], self.joints])
        inner = [
            start + np.asarray(getattr(part, "knots", ())) for start, part in zip(starts, self.segments, strict=True)
        ]
        return frozen(np.concatenate(inner))

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``."""
        require_side(side)
        given = inside(p, 0.0, self.length, "p", "m")
        along = given.ravel()
        after = np.searchsorted(self.joints, along, side="right")
        point = self._on_segments(along, after, side)
        if side == "left":
            # x and x' stay those of the right segment, so that both sides agree to the last bit.
            before = np.searchsorted(self.joints, along, side="left")
            at_joint = np.flatnonzero(before != after)
            left = self._on_segments(along[at_joint], before[at_joint], side)
            point.curvature[at_joint] = left.curvature
        return PathPoint(*(part.reshape(*given.shape, self.dimension) for part in point))

    def _on_segments(self, along: Array, index: IntArray, side: Side) -> PathPoint:
        """Evaluate each arc length (N,) on the segment of the given index (N,)."""
        x, tangent, curvature = (np.empty((len(along), self.dimension)) for _ in range(3))
        starts = np.concatenate([[0.0], self.joints])
        for k, segment in enumerate(self.segments):
            here = np.flatnonzero(index == k)
            local = np.clip(along[here] - starts[k], 0.0, segment.length)
            x[here], tangent[here], curvature[here] = segment.evaluate(local, side)
        return PathPoint(x, tangent, curvature)


def _jumping_joints(segments: Sequence[Path], length: float) -> Array:
    """Return (joints,) whether x'' jumps, after checking that x and x' do not."""
    jumps = []
    for k, (first, second) in enumerate(pairwise(segments)):
        if first.dimension != second.dimension:
            raise InputError(
                f"Segments {k} and {k + 1} have {first.dimension} and {second.dimension} coordinates.", segment=k
            )
        end, start = first.evaluate(first.length, "left"), second.evaluate(0.0, "right")
        distance = float(np.linalg.norm(start.x - end.x))
        kink = float(np.linalg.norm(start.tangent - end.tangent))
        if distance > _JOINT_TOLERANCE * length or kink > _JOINT_TOLERANCE:
            message = (
                f"Segments {k} and {k + 1} do not meet: the positions differ by {distance:.3g} m, "
                f"the unit tangents by {kink:.3g}."
            )
            remedy = "A kink cannot be passed at speed: round it (rounded_polygon), or stop there and plan two motions."
            raise InputError(message, remedy=remedy, segment=k, gap=distance, kink=kink)
        change = np.abs(start.curvature - end.curvature).max()
        size = max(np.abs(start.curvature).max(), np.abs(end.curvature).max())
        jumps.append(bool(change > _JOINT_TOLERANCE * size))
    return np.array(jumps, dtype=bool)
