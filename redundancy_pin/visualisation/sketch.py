"""A mechanism as straight lines between its joints, for pictures."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.robot import Robot


def base_hinges(robot: Robot) -> Array:
    """Return (B, 3) where the chains are fixed to the base: origins of the first joints, m, base frame."""
    model = robot.model
    first = [j for j in range(1, model.njoints) if model.parents[j] == 0 and model.names[j] not in robot.carriers]
    points = [model.jointPlacements[j].translation for j in first]
    for frame in _closure_frames(robot):
        if model.frames[frame].parentJoint == 0:
            points.append(model.frames[frame].placement.translation)
    return read_only(np.array(points).reshape(-1, 3))


def links(robot: Robot, q: Array) -> tuple[tuple[Array, Array], ...]:
    """Return the ends (3,), (3,) m of the lines that make up the mechanism at a configuration (nq,).

    A link is a line or, with three hinges or more, a polygon between its hinges (its own joint, the joints that follow,
    its closures). The origin of a platform that is a single line is its end.
    """
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    points: dict[int, list[Array]] = {j: [data.oMi[j].translation.copy()] for j in range(1, model.njoints)}
    for joint in range(1, model.njoints):
        if model.parents[joint] > 0 and model.names[joint] not in robot.carriers:
            points[model.parents[joint]].append(data.oMi[joint].translation.copy())
    for frame in _closure_frames(robot):
        points.setdefault(model.frames[frame].parentJoint, []).append(data.oMf[frame].translation.copy())
    if robot.platform is not None:
        frame = _body(model, robot.platform.frame)
        on_link = points[model.frames[frame].parentJoint]
        if len(_distinct(on_link)) < 3:
            on_link.append(data.oMf[frame].translation.copy())
    points.pop(0, None)
    return tuple(pair for hinges in points.values() for pair in _outline(_distinct(hinges)))


def _distinct(points: list[Array]) -> list[Array]:
    kept: list[Array] = []
    for point in points:
        if all(np.linalg.norm(point - other) > _NO_LENGTH for other in kept):
            kept.append(point)
    return kept


def _outline(points: list[Array]) -> list[tuple[Array, Array]]:
    pairs = list(pairwise(points))
    return [*pairs, (points[-1], points[0])] if len(points) > 2 else pairs


def _closure_frames(robot: Robot) -> list[int]:
    names = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    return [_body(robot.model, name) for name in names]


def _body(model: pin.Model, name: str) -> int:
    return int(model.getFrameId(name, pin.FrameType.BODY))


_NO_LENGTH = 1e-9
