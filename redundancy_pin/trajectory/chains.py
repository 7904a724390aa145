"""Segments joined end to end, with their jumps of curvature."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, IntArray, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.domain import Side, inside, require_side
from redundancy_pin.trajectory.paths import Path, PathPoint

_JOINT_TOLERANCE = 1e-9
"""Largest gap between segments, relative to the length of the chain (positions) or absolute (unit
tangents): a nanometre on a metre, a thousand times above the rounding of the constructions here."""


@dataclass(frozen=True, init=False, eq=False)
class ChainedPath:
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
        object.__setattr__(self, "segments", tuple(segments))
        object.__setattr__(self, "joints", frozen(ends[:-1]))
        object.__setattr__(self, "length", float(ends[-1]))
        object.__setattr__(self, "breaks", frozen(np.sort(np.concatenate([ends[:-1][jumps], *inner]))))

    @property
    def dimension(self) -> int:
        """Number n of coordinates."""
        return self.segments[0].dimension

    def evaluate(self, p: ArrayLike, side: Side = "right") -> PathPoint:
        """Return x, x', x'' at arc lengths p, m; see ``Path.evaluate``.

        Raises:
            InputError: p outside [0, length].
        """
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
        x, tangent, curvature = (part.reshape(*given.shape, self.dimension) for part in point)
        return PathPoint(x, tangent, curvature)

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
        gap = float(np.linalg.norm(start.x - end.x))
        kink = float(np.linalg.norm(start.tangent - end.tangent))
        if gap > _JOINT_TOLERANCE * length or kink > _JOINT_TOLERANCE:
            raise InputError(
                f"Segments {k} and {k + 1} do not meet: the positions differ by {gap:.3g} m, "
                f"the unit tangents by {kink:.3g}.",
                remedy="A kink cannot be passed at speed: join straights by an arc (see rounded_polygon).",
                segment=k,
                gap=gap,
                kink=kink,
            )
        change = np.abs(start.curvature - end.curvature).max()
        size = max(np.abs(start.curvature).max(), np.abs(end.curvature).max())
        jumps.append(bool(change > _JOINT_TOLERANCE * size))
    return np.array(jumps, dtype=bool)
