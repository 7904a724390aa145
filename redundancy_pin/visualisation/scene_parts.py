"""The parts of a robot's picture: shapes of its URDF where it has any, bars between its joints where it has none."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.scene import Plate, Role, Shape, Solid
from redundancy_pin.visualisation.scene_carriers import carrier_solids
from redundancy_pin.visualisation.scene_colors import ROLE_COLORS
from redundancy_pin.visualisation.scene_frames import along_z, joint_axis, place, slides
from redundancy_pin.visualisation.urdf_shapes import shapes_of_urdf

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
