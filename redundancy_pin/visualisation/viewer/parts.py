"""The parts of a robot's picture: shapes of its URDF where it has any, bars between its joints where it has none."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import pi

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.visualisation.viewer.scene import (
    ROLE_COLORS,
    Plate,
    Role,
    Shape,
    Solid,
    along_z,
    joint_axis,
    place,
    slides,
)
from redundancy_pin.visualisation.viewer.urdf_shapes import shapes_of_urdf

RAIL_WIDTH, RAIL_HEIGHT = 0.012, 0.06
"""Cross-section of a straight track: narrow and high, so that it stands out of the link it lies on."""

CARRIER_SIDE = 0.06
"""Of a carrier without a shape of its own, in sizes of the machine."""

BALANCED_RADIUS = 0.1
"""Of the arc about a carrier whose centre of mass is on its axis."""

_ARM_RADIUS = 0.01
"""Of the arm that holds a turning carrier, and of the arc it runs along."""

_LONGEST_RAIL = 1.2
"""Half length, in sizes, at which the drawing of an unbounded track ends."""

_BALANCED = 1e-3
"""Distance of the centre of mass from the axis, in sizes, below which it counts as on it."""


@dataclass(frozen=True, eq=False)
class _Turn:
    """How a turning carrier is drawn, in the frame of its joint at angle zero.

    Attributes:
        frame: (4, 4) on the axis, z along it, x towards the carrier.
        radius: of the arc, m.
        balanced: whether the centre of mass is on the axis.
    """

    frame: Array
    radius: float
    balanced: bool


def carrier_solids(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    """Return the tracks of all carriers, and the carriers that the URDF gives no shape.

    Args:
        robot: the robot.
        size: of the machine, m.
        clothed: bodies that the URDF gives a shape.
    """
    solids = []
    for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
        body = int(robot.model.getJointId(name))
        if slides(robot.model, body):
            solids.append(_rail(robot, name, body, limits, size))
            if body not in clothed:
                solids.append(_solid("carrier", body, np.eye(4), "box", (CARRIER_SIDE * size,) * 3))
            continue
        turn = _turn(robot, body, size)
        solids.append(_arc(robot, name, body, limits, turn, size))
        if body not in clothed:
            solids += _turning(body, turn, size)
    return solids


def _rail(robot: Robot, name: str, body: int, limits: CarrierLimits, size: float) -> Solid:
    model = robot.model
    longest = _LONGEST_RAIL * size
    low, high = max(limits.lower, -longest), min(limits.upper, longest)
    axis = joint_axis(model, body)
    upright = along_z(axis)
    if abs(axis[2]) < 0.9:  # high side along the joint's z, which is the plane's normal in a planar machine
        side = np.cross(np.array([0.0, 0.0, 1.0]), axis)
        side /= np.linalg.norm(side)
        upright = np.stack([side, np.cross(axis, side), axis], axis=1)
    home = model.jointPlacements[body].homogeneous @ place(upright, 0.5 * (low + high) * axis)
    sides = (RAIL_WIDTH * size, RAIL_HEIGHT * size, high - low)
    return _solid(f"track_of_{name}", int(model.parents[body]), home, "box", sides, "track")


def _turn(robot: Robot, body: int, size: float) -> _Turn:
    """Find where a turning carrier is: its centre of mass, or beside the axis where that is on the axis."""
    axis = joint_axis(robot.model, body)
    centre: Array = robot.model.inertias[body].lever
    height = float(centre @ axis)
    arm = centre - height * axis
    radius = float(np.linalg.norm(arm))
    balanced = radius < _BALANCED * size
    out = along_z(axis)[:, 0] if balanced else arm / radius
    frame = place(np.stack([out, np.cross(axis, out), axis], axis=1), height * axis)
    return _Turn(frame, BALANCED_RADIUS * size if balanced else radius, balanced)


def _arc(robot: Robot, name: str, body: int, limits: CarrierLimits, turn: _Turn, size: float) -> Solid:
    low, high = limits.lower, limits.upper
    if not high - low < 2.0 * pi:  # more than a round, or without end
        low, high = -pi, pi
    home = robot.model.jointPlacements[body].homogeneous @ turn.frame
    form = (turn.radius, _ARM_RADIUS * size, low, high)
    return _solid(f"track_of_{name}", int(robot.model.parents[body]), home, "arc", form, "track")


def _turning(body: int, turn: _Turn, size: float) -> list[Solid]:
    """Return the mass at the end of its arm; a balanced one is a bar across the axis, that its turning be seen."""
    side = CARRIER_SIDE * size
    if turn.balanced:
        return [_solid("carrier", body, turn.frame, "box", (2.0 * turn.radius, 0.5 * side, 0.5 * side))]
    to_x = place(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.5 * turn.radius, 0.0, 0.0]))
    mass = turn.frame @ place(translation=np.array([turn.radius, 0.0, 0.0]))
    return [
        _solid("carrier", body, mass, "box", (side,) * 3),
        _solid("carrier_arm", body, turn.frame @ to_x, "cylinder", (_ARM_RADIUS * size, turn.radius)),
    ]


def _solid(
    name: str, body: int, placement: Array, shape: Shape, form: tuple[float, ...], role: Role = "carrier"
) -> Solid:
    return Solid(name, body, placement, shape, form, role, ROLE_COLORS[role])


JOINT_RADIUS, JOINT_LENGTH = 0.03, 0.06
"""Of a joint, in sizes of the machine; thicker than the links of the shipped robots."""

BAR_RADIUS = 0.012
"""Of a link that has no shape of its own."""

PLATE_THICKNESS = 0.02
_NO_LENGTH = 1e-9


def solids_of(robot: Robot, size: float) -> tuple[Solid, ...]:
    """Return links, joints, tracks and carriers.

    Args:
        robot: the robot.
        size: of the machine, m.
    """
    drawn = shapes_of_urdf(robot)
    clothed = {solid.body for solid in drawn}
    return (
        *drawn,
        *_bars(robot, size, clothed),
        *_joints(robot, size),
        *carrier_solids(robot, size, clothed),
    )


def plates_of(robot: Robot, size: float) -> tuple[Plate, ...]:
    """Return the base, through the joints fixed to it, and the platform, through the joints on it.

    Args:
        robot: the robot.
        size: of the machine, m.
    """
    base = ordered(body_points(robot, 0))
    plates = [Plate("base", 0, base, PLATE_THICKNESS * size / 2.0, "base")] if len(base) > 1 else []
    if robot.platform is not None:
        frame = robot.model.frames[_link(robot.model, robot.platform.frame)]
        corners = ordered(body_points(robot, int(frame.parentJoint)))
        if len(corners) < 3:
            corners = frame.placement.translation.copy()[None]
        plates.append(Plate("platform", int(frame.parentJoint), corners, PLATE_THICKNESS * size, "platform"))
    return tuple(plates)


def body_points(robot: Robot, body: int) -> Array:
    """Return (c, 3) where a body is jointed to others, closures included, in the frame of its own joint, m."""
    model = robot.model
    points = [] if body == 0 else [np.zeros(3)]
    points += [
        model.jointPlacements[j].translation.copy()
        for j in range(1, model.njoints)
        if model.parents[j] == body and model.names[j] not in robot.carriers
    ]
    for closure in robot.closures:
        for name in (closure.frame_a, closure.frame_b):
            frame = model.frames[_link(model, name)]
            if int(frame.parentJoint) == body:
                points.append(frame.placement.translation.copy())
    kept: list[Array] = []
    for point in points:
        if all(np.linalg.norm(point - other) > _NO_LENGTH for other in kept):
            kept.append(point)
    return np.array(kept).reshape(-1, 3)


def ordered(points: Array) -> Array:
    """Return points (c, 3) in order around their middle, in the plane that fits them best."""
    if len(points) < 3:
        return points
    centred = points - points.mean(axis=0)
    plane = np.linalg.svd(centred).Vh[:2]
    u, v = plane @ centred.T
    result: Array = points[np.argsort(np.arctan2(v, u))]
    return result


def _bars(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    solids = []
    for body in range(1, robot.model.njoints):
        if body in clothed or robot.model.names[body] in robot.carriers:
            continue
        corners = ordered(body_points(robot, body))
        pairs = list(pairwise(corners))
        if len(corners) > 2:
            pairs.append((corners[-1], corners[0]))
        for i, (start, end) in enumerate(pairs):
            length = float(np.linalg.norm(end - start))
            placement = place(along_z((end - start) / length), 0.5 * (start + end))
            form = (BAR_RADIUS * size, length)
            solids.append(Solid(f"bar_{i}", body, placement, "cylinder", form, "link", ROLE_COLORS["link"]))
    return solids


def _joints(robot: Robot, size: float) -> list[Solid]:
    model, solids = robot.model, []
    for body in range(1, model.njoints):
        name = str(model.names[body])
        if name in robot.carriers or model.joints[body].nv != 1:
            continue
        role: Role = "actuated" if name in robot.actuated else "passive"
        axis = along_z(joint_axis(model, body))
        # fixed to what carries the joint: a slide stays where it is while its rod moves
        carrier, home = int(model.parents[body]), model.jointPlacements[body].homogeneous
        if slides(model, body):
            side = 2.0 * JOINT_RADIUS * size
            form: tuple[Shape, tuple[float, ...]] = ("box", (side, side, 1.2 * side))
        else:
            form = ("cylinder", (JOINT_RADIUS * size, JOINT_LENGTH * size))
        solids.append(Solid(f"joint_{name}", carrier, home @ place(axis), *form, role, ROLE_COLORS[role]))
    for closure in robot.closures:
        frame = model.frames[_link(model, closure.frame_a)]
        solids.append(
            Solid(
                f"closure_{closure.name}",
                int(frame.parentJoint),
                frame.placement.homogeneous.copy(),
                "sphere",
                (1.3 * JOINT_RADIUS * size,),
                "closure",
                ROLE_COLORS["closure"],
            )
        )
    return solids


def _link(model: pin.Model, name: str) -> int:
    return int(model.getFrameId(name, pin.FrameType.BODY))
