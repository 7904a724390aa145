"""The parts of a robot's picture: shapes of its URDF where it has any, bars between its joints where it has none."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.scene import Plate, Role, Shape, Solid
from redundancy_pin.visualisation.scene_colors import ROLE_COLORS

JOINT_RADIUS, JOINT_LENGTH = 0.03, 0.06
"""Of a joint, in sizes of the machine; thicker than the links of the shipped robots."""

BAR_RADIUS = 0.012
"""Of a link that has no shape of its own."""

RAIL_WIDTH, RAIL_HEIGHT = 0.012, 0.06
"""Cross-section of a track: narrow and high, so that it stands out of the link it lies on."""

PLATE_THICKNESS = 0.02
_CARRIER_SIDE = 0.06
_LONGEST_RAIL = 1.2
"""Half length, in sizes, at which the drawing of an unbounded track ends."""

_NO_LENGTH = 1e-9


def solids_of(robot: Robot, size: float) -> tuple[Solid, ...]:
    """Return links, joints, tracks and carriers.

    Args:
        robot: the robot.
        size: of the machine, m.
    """
    drawn = _shapes_of_urdf(robot)
    clothed = {solid.body for solid in drawn}
    return (
        *drawn,
        *_bars(robot, size, clothed),
        *_joints(robot, size),
        *_tracks(robot, size),
        *_bare_carriers(robot, size, clothed),
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


def along_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def joint_axis(model: pin.Model, index: int) -> Array:
    """Return (3,) the unit axis of a joint of one freedom in its own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    joint = model.joints[index]
    column = np.reshape(pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL), (6, model.nv))[
        :, joint.idx_v
    ]
    part = column[3:] if np.abs(column[3:]).max() > 0.0 else column[:3]
    axis: Array = part / np.linalg.norm(part)
    return axis


def slides(model: pin.Model, index: int) -> bool:
    """Return whether a joint is prismatic."""
    return str(model.joints[index].shortname()).startswith("JointModelP")


def place(rotation: Array | None = None, translation: Array | None = None) -> Array:
    """Return a homogeneous placement (4, 4)."""
    placement = np.eye(4)
    if rotation is not None:
        placement[:3, :3] = rotation
    if translation is not None:
        placement[:3, 3] = translation
    return placement


def _shapes_of_urdf(robot: Robot) -> list[Solid]:
    """Return the primitive shapes of the URDF; meshes are left out, as their files may be anywhere."""
    try:
        visual = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.VISUAL)
    except (ValueError, RuntimeError):
        return []  # a mesh that is not found spoils the whole model: bars are drawn then
    solids = []
    for item in visual.geometryObjects:
        form = _primitive(item.geometry)
        if form is None:
            continue
        body = int(item.parentJoint)
        name = str(robot.model.names[body])
        role: Role = "carrier" if name in robot.carriers else "base" if body == 0 else "link"
        given = "#" + "".join(f"{round(255 * float(part)):02x}" for part in item.meshColor[:3])
        color = given if role == "link" else ROLE_COLORS[role]
        solids.append(Solid(str(item.name), body, item.placement.homogeneous.copy(), *form, role, color))
    return solids


def _primitive(geometry: Any) -> tuple[Shape, tuple[float, ...]] | None:
    kind = type(geometry).__name__
    if kind == "Box":
        return "box", tuple(2.0 * float(side) for side in geometry.halfSide)
    if kind in ("Cylinder", "Capsule"):
        return "cylinder", (float(geometry.radius), 2.0 * float(geometry.halfLength))
    if kind == "Sphere":
        return "sphere", (float(geometry.radius),)
    return None


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


def _tracks(robot: Robot, size: float) -> list[Solid]:
    model, solids = robot.model, []
    for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
        body = int(model.getJointId(name))
        if not slides(model, body):
            continue
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
        solids.append(
            Solid(f"track_of_{name}", int(model.parents[body]), home, "box", sides, "track", ROLE_COLORS["track"])
        )
    return solids


def _bare_carriers(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    bodies = [int(robot.model.getJointId(name)) for name in robot.carriers]
    side = (_CARRIER_SIDE * size,) * 3
    return [
        Solid("carrier", body, np.eye(4), "box", side, "carrier", ROLE_COLORS["carrier"])
        for body in bodies
        if body not in clothed
    ]


def _link(model: pin.Model, name: str) -> int:
    return int(model.getFrameId(name, pin.FrameType.BODY))
