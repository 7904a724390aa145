"""The solids that stand for a mechanism, as fractions of its characteristic length, and where its bodies are jointed.

Bars stand in for links without a shape of their URDF; joints, closures, tracks, carriers, base and platform are added.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from math import pi

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.kinematics.tree import motion_subspace
from redundancy_pin.robot import CarrierLimits, Closure, Robot
from redundancy_pin.robot.lookup import find_joint_index, find_link
from redundancy_pin.robot.loop_joints import ends_of
from redundancy_pin.robot.types import slides
from redundancy_pin.visualisation.viewer.solids import Mesh, Role, Shape, Solid, shapes_of_urdf

# Cross-section of a straight track: narrow and high, so that it stands out of the link it lies on
RAIL_WIDTH, RAIL_HEIGHT = 0.012, 0.06
CARRIER_SIDE = 0.06  # of a carrier without a shape of its own
BALANCED_RADIUS = 0.1  # of the arc about a carrier whose centre of mass is on its axis
JOINT_RADIUS, JOINT_LENGTH = 0.03, 0.06  # of a joint; thicker than the links of the shipped robots
BAR_RADIUS = 0.012  # of a link that has no shape of its own
PLATE_THICKNESS = 0.02  # of the platform; the base is half as thick
_POINT_RADIUS = 0.09  # of a platform that is a point
_ARM_RADIUS = 0.01  # of the arm that holds a turning carrier, and of the arc it runs along
_LONGEST_RAIL = 1.2  # half length at which the drawing of an unbounded track ends
_BALANCED = 1e-3  # distance of the centre of mass from the axis below which it counts as on it
_CLEAR = 0.35  # opacity of what other things must be seen through
_NO_LENGTH = 1e-9  # in characteristic lengths; points that are nearer are one


# --- the solids of a mechanism --------------------------------------------------------------------------------------


def solids_of(robot: Robot) -> tuple[Solid, ...]:
    """Return base and platform, links, joints, tracks and carriers."""
    size = robot.characteristic_length
    plates = _plates(robot, size)
    # shapes of a platform stand back for the plate whose colour says something
    covered = {plate.body for plate in plates if plate.role == "platform" and plate.shape == "plate"}
    shapes = [
        replace(solid, opacity=_CLEAR) if solid.body in covered and solid.role == "link" else solid
        for solid in shapes_of_urdf(robot)
    ]
    clothed = {solid.body for solid in shapes}
    return (*plates, *shapes, *_bars(robot, size, clothed), *_joints(robot, size), *_carriers(robot, size, clothed))


# --- where bodies are jointed --------------------------------------------------------------------------------------


def body_points(robot: Robot, body: int) -> Array:
    """Return (c, 3) the hinges of a body, closures included, in the frame of the joint that moves it, m."""
    data = _placed(robot, pin.neutral(robot.model))
    points: Array = (_hinges(robot, body, data) - data.oMi[body].translation) @ data.oMi[body].rotation
    return points


def base_hinges(robot: Robot) -> Array:
    """Return (B, 3) where the chains are fixed to the base, m, base frame."""
    return read_only(body_points(robot, 0))


def links(robot: Robot, q: Array) -> tuple[tuple[Array, Array], ...]:
    """Return the ends (3,), (3,) m of the lines that make up the mechanism at a configuration (nq,).

    A link is a line or, with three hinges or more, a polygon between its hinges (its own joint, the joints that follow,
    its closures). The origin of a platform that is a single line is its end. Rods that close loops are lines.
    """
    model, data = robot.model, _placed(robot, q)
    pairs: list[tuple[Array, Array]] = []
    for body in range(1, model.njoints):
        points = _hinges(robot, body, data)
        if robot.platform is not None and len(points) < 3:
            frame = find_link(model, robot.platform.frame)
            if int(frame.parentJoint) == body:
                points = _distinct(robot, [*points, (data.oMi[body] * frame.placement).translation])
        pairs += _outline(points)
    return (*pairs, *(ends_of(rod, model, data) for rod in rods_of(robot)))


def rods_of(robot: Robot) -> tuple[Closure, ...]:
    """Return the rods that close loops. No joint carries them: their numbers follow the numbers of the joints."""
    return tuple(closure for closure in robot.closures if closure.is_rod)


def _placed(robot: Robot, q: Array) -> pin.Data:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.array(q))
    return data


def _hinges(robot: Robot, body: int, data: pin.Data) -> Array:
    """Return (c, 3) where a body is jointed to others in a configuration, m, world.

    The origin of a floating or planar joint is not a point of both bodies, so it does not count.
    """
    model = robot.model
    joints = [body, *(j for j in range(1, model.njoints) if model.parents[j] == body)]
    joints = [j for j in joints if j and not _floats(model, j) and (j == body or model.names[j] not in robot.carriers)]
    frames = [find_link(model, name) for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    placed = [data.oMi[body] * frame.placement for frame in frames if int(frame.parentJoint) == body]
    return _distinct(robot, [*(data.oMi[j].translation for j in joints), *(each.translation for each in placed)])


def _floats(model: pin.Model, index: int) -> bool:
    """Return whether a joint of several degrees of freedom shifts its body."""
    return bool(model.joints[index].nv > 1 and np.abs(_subspace(model, index)[:3]).max() > 0.0)


def _distinct(robot: Robot, points: Sequence[Array]) -> Array:
    """Return (c, 3) points without those that are where an earlier one is."""
    distinct: list[Array] = []
    least = _NO_LENGTH * robot.characteristic_length
    for point in points:
        if all(np.linalg.norm(point - other) > least for other in distinct):
            distinct.append(point)
    return np.array(distinct).reshape(-1, 3)


def _ordered(points: Array) -> Array:
    """Return points (c, 3) in order around their middle, in the plane that fits them best."""
    if len(points) < 3:
        return points
    centred = points - points.mean(axis=0)
    u, v = np.linalg.svd(centred).Vh[:2] @ centred.T
    result: Array = points[np.argsort(np.arctan2(v, u))]
    return result


def _outline(points: Array) -> list[tuple[Array, Array]]:
    """Return the line between two points, or the sides of the polygon of three or more (c, 3)."""
    corners = _ordered(points)
    pairs = list(pairwise(corners))
    return [*pairs, (corners[-1], corners[0])] if len(corners) > 2 else pairs


# --- what is drawn there -------------------------------------------------------------------------------------------


def _plates(robot: Robot, size: float) -> list[Solid]:
    """Return the base, through the joints fixed to it, and the platform: a plate, a bar, or a ball at its origin."""
    thickness = PLATE_THICKNESS * size
    plates: list[Solid] = []
    base = _ordered(body_points(robot, 0))
    if len(base) == 2:
        plates = [replace(_rod("plate", 0, base[0], base[1], 0.5 * thickness, "base"), opacity=_CLEAR)]
    elif len(base) > 2:
        mesh = prism(base, 0.5 * thickness)
        plates = [Solid("plate", 0, np.eye(4), "plate", (), "base", mesh=mesh, opacity=_CLEAR)]
    if robot.platform is not None:
        frame = find_link(robot.model, robot.platform.frame)
        body = int(frame.parentJoint)
        corners = _ordered(body_points(robot, body))
        if len(corners) > 2:
            plates.append(Solid("plate", body, np.eye(4), "plate", (), "platform", mesh=prism(corners, thickness)))
        else:
            ball = place(translation=frame.placement.translation)
            plates.append(Solid("plate", body, ball, "sphere", (_POINT_RADIUS * size,), "platform"))
    return plates


def prism(corners: Array, thickness: float) -> Mesh:
    """Return a prism over a polygon (c, 3), c ≥ 3, m, half of the thickness on either side."""
    middle = corners.mean(axis=0)
    offset = 0.5 * thickness * np.linalg.svd(corners - middle).Vh[2]
    c = len(corners)
    vertices = np.concatenate([corners + offset, corners - offset, [middle + offset, middle - offset]])
    i = np.arange(c)
    j = (i + 1) % c
    faces = [(i, j, 2 * c + 0 * i), (c + j, c + i, 2 * c + 1 + 0 * i), (i, c + i, j), (j, c + i, c + j)]
    return vertices, np.concatenate([np.stack(face, axis=1) for face in faces]).astype(np.intp)


def _bars(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    return [
        _rod(f"bar_{i}", body, start, end, BAR_RADIUS * size, "link")
        for body in range(1, robot.model.njoints)
        if body not in clothed and robot.model.names[body] not in robot.carriers
        for i, (start, end) in enumerate(_outline(body_points(robot, body)))
    ]


def _joints(robot: Robot, size: float) -> list[Solid]:
    model, solids = robot.model, []
    reference, along = np.array(robot.q_reference), np.array([0.0, 0.0, 1.0])
    for body in range(1, model.njoints):
        name = str(model.names[body])
        if name in robot.carriers or model.joints[body].nv != 1:
            continue
        role: Role = "actuated" if name in robot.actuated else "passive"
        axis = place(along_z(joint_axis(model, body)))
        side = 2.0 * JOINT_RADIUS * size
        box: tuple[Shape, tuple[float, ...]] = ("box", (side, side, 1.2 * side))
        shape, form = box if slides(model.joints[body]) else ("cylinder", (JOINT_RADIUS * size, JOINT_LENGTH * size))
        parent, placement = int(model.parents[body]), model.jointPlacements[body].homogeneous @ axis
        if _is_carriage(model, body):
            parent, placement = body, axis
        elif slides(model.joints[body]):  # a cylinder: half way out at the reference, clear of the barrel's hinge
            placement = placement @ place(translation=0.5 * robot.joint_positions(reference, [name]).item() * along)
        solids.append(Solid(f"joint_{name}", parent, placement, shape, form, role))
    ball = (1.3 * JOINT_RADIUS * size,)
    for closure in robot.closures:
        ends = {"": closure.frame_a, "_b": closure.frame_b} if closure.is_rod else {"": closure.frame_a}
        for suffix, link in ends.items():
            frame, label = find_link(model, link), f"closure_{closure.name}{suffix}"
            centre = frame.placement.homogeneous.copy()
            solids.append(Solid(label, int(frame.parentJoint), centre, "sphere", ball, "closure"))
    for body, rod in enumerate(rods_of(robot), start=model.njoints):
        form = (BAR_RADIUS * size, rod.length)
        solids.append(Solid(f"rod_{rod.name}", body, np.eye(4), "cylinder", form, "link"))
    return solids


def _is_carriage(model: pin.Model, body: int) -> bool:
    """Return whether a joint slides on the base or on another slide: it is drawn on the body that it moves.

    Where such a joint is at zero, often the origin of the world, no part of the machine needs to be. On a body that
    turns, a slide is a cylinder, drawn on its barrel.
    """
    parent = int(model.parents[body])
    return slides(model.joints[body]) and (parent == 0 or slides(model.joints[parent]))


def _carriers(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    """Return the tracks of all carriers, and the carriers that the URDF gives no shape."""
    solids = []
    for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
        body = find_joint_index(robot.model, name)
        drawn = _sliding if slides(robot.model.joints[body]) else _turning
        track, *shapes = drawn(robot, body, limits, size)
        solids += [track, *([] if body in clothed else shapes)]
    return solids


def _sliding(robot: Robot, body: int, limits: CarrierLimits, size: float) -> list[Solid]:
    """Return the rail and the carrier on it."""
    model, longest = robot.model, _LONGEST_RAIL * size
    low, high = max(limits.lower, -longest), min(limits.upper, longest)
    axis = joint_axis(model, body)
    home = model.jointPlacements[body].homogeneous @ place(along_z(axis), 0.5 * (low + high) * axis)
    sides = (RAIL_WIDTH * size, RAIL_HEIGHT * size, high - low)
    return [
        Solid(f"track_of_{model.names[body]}", int(model.parents[body]), home, "box", sides, "track"),
        Solid("carrier", body, np.eye(4), "box", (CARRIER_SIDE * size,) * 3, "carrier"),
    ]


def _turning(robot: Robot, body: int, limits: CarrierLimits, size: float) -> list[Solid]:
    """Return the arc through the centre of mass, and the mass at the end of its arm.

    A mass that is balanced about the axis is a bar across it, that its turning be seen.
    """
    model = robot.model
    axis = joint_axis(model, body)
    centre: Array = model.inertias[body].lever
    height = float(centre @ axis)
    arm = centre - height * axis
    radius = float(np.linalg.norm(arm))
    balanced = radius < _BALANCED * size
    out = along_z(axis)[:, 0] if balanced else arm / radius
    radius = BALANCED_RADIUS * size if balanced else radius
    # on the axis, z along it, x towards the carrier at angle zero
    frame = place(np.stack([out, np.cross(axis, out), axis], axis=1), height * axis)
    low, high = limits.lower, limits.upper
    if not high - low < 2.0 * pi:  # more than a round, or without end
        low, high = -pi, pi
    home = model.jointPlacements[body].homogeneous @ frame
    form = (radius, _ARM_RADIUS * size, low, high)
    track = Solid(f"track_of_{model.names[body]}", int(model.parents[body]), home, "arc", form, "track")
    side = CARRIER_SIDE * size
    if balanced:
        return [track, Solid("carrier", body, frame, "box", (2.0 * radius, 0.5 * side, 0.5 * side), "carrier")]
    mass = frame @ place(translation=np.array([radius, 0.0, 0.0]))
    rod = _rod("carrier_arm", body, frame[:3, 3], mass[:3, 3], _ARM_RADIUS * size, "carrier")
    return [track, Solid("carrier", body, mass, "box", (side,) * 3, "carrier"), rod]


def _rod(name: str, body: int, start: Array, end: Array, radius: float, role: Role) -> Solid:
    """Return a cylinder between two points."""
    length = float(np.linalg.norm(end - start))
    placement = place(along_z((end - start) / length), 0.5 * (start + end))
    return Solid(name, body, placement, "cylinder", (radius, length), role)


# --- joints and placements -----------------------------------------------------------------------------------------


def along_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis."""
    # the second column is as near to z as can be: the high side of a rail is up, out of the plane of a planar machine
    helper = np.eye(3)[2 if abs(axis[2]) < 0.9 else 0]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def joint_axis(model: pin.Model, index: int) -> Array:
    """Return (3,) the unit axis of a joint of one degree of freedom in its own frame."""
    linear, angular = np.split(_subspace(model, index)[:, 0], 2)
    axis: Array = angular if angular.any() else linear
    return axis / np.linalg.norm(axis)


def _subspace(model: pin.Model, index: int) -> Array:
    """Return (6, nv) the motion subspace of a joint in its own frame, linear rows first."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return motion_subspace(model, data, index)


def place(rotation: Array | None = None, translation: Array | None = None) -> Array:
    """Return a homogeneous placement (4, 4)."""
    turn, shift = np.eye(3) if rotation is None else rotation, np.zeros(3) if translation is None else translation
    placement: Array = pin.SE3(turn, shift).homogeneous
    return placement
